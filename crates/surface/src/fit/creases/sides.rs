//! One-sided patches: the shape near each reading, without readings across an edge.
//!
//! Input: oriented readings. Output: for each reading a patch that its nearest readings of one side agree on,
//! the noise, and whether the surface is smooth there.
//!
//! A plain fit to all near readings is kept if its residuals are those of noise. Elsewhere, weights of
//! readings that are off the patch, or turned against it, fall to zero while the gates become narrower.
//!
//! Not guaranteed: that a patch keeps to one side where normals are wrong by more than about 25°. Such
//! patches have few readings and do not count.

use super::patch::{Patch, Scales, Weighted};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::DVec3;
use planish_core::vector3::as_arrays;
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::num::NonZero;

/// Readings around a place: those within about four spacings.
const NEAREST: NonZero<usize> = NonZero::new(48).unwrap();
/// Readings of a patch, at least.
const MIN_READINGS: f64 = 9.0;
/// Gates of distances, in spacings, and of angles, as cosines (45°, 40°, 32°, 25°), one for each fit.
const DISTANCE_GATES: [f64; 4] = [1.2, 0.8, 0.4, 0.0];
const COSINE_GATES: [f64; 4] = [0.70, 0.77, 0.85, 0.90];
/// Gates of distances in σ, at least.
const GATE_SIGMAS: f64 = 3.5;
/// Gate of distances in spacings, at least: a quadric misses curved sides by some of it.
const MIN_GATE: f64 = 0.12;
/// A plain fit is kept if its residuals are at most this many σ, and normals differ from it by at most this
/// many σ of slopes, or this angle. Residuals alone do not show edges between flat sides in strong noise.
const SMOOTH_SIGMAS: f64 = 1.45;
const SMOOTH_SLOPES: f64 = 1.6;
const SMOOTH_TURN: f64 = 0.13;
/// Readings near which the surface is not smooth, at least, if there are creases; they have this share of
/// such readings around them. A crease of ten spacings has more beside it, noise has fewer.
const MIN_ROUGH: usize = 40;
const ROUGH_SHARE: f64 = 0.3;
/// Residuals of plain fits of this share of the readings are taken as noise.
const NOISE_SHARE: f64 = 0.25;
/// Bounds of σ of normals.
const SLOPE_SIGMAS: [f64; 2] = [0.08, 0.5];
/// Readings of which patches give a reading its normal. What a patch costs there if it has few readings, and
/// for each spacing to its reading, beside its distance. Distances that cost nothing, in σ; the number of
/// readings that are enough; and the largest cost.
const ASKED: NonZero<usize> = NonZero::new(24).unwrap();
const FEW_COST: f64 = 0.6;
const AWAY_COST: f64 = 0.08;
const ENOUGH: f64 = 8.0;
const FREE_SIGMAS: f64 = 1.5;
const MAX_COST: f64 = 1.2;
/// Readings whose normals differ by more belong to the other side of a thin wall.
const OTHER_WALL: f64 = -0.5;

/// Readings with a search tree.
pub(super) struct Cloud<'a> {
    pub(super) points: &'a [DVec3],
    pub(super) normals: Vec<DVec3>,
    tree: ImmutableKdTree<f64, 3>,
    /// Median side of the square that each reading has.
    pub(super) spacing: f64,
    pub(super) scales: Scales,
}

/// Readings near a place.
pub(super) struct Near {
    pub(super) indices: Vec<u32>,
    /// Distance of the farthest.
    pub(super) radius: f64,
}

impl Near {
    /// Side of the square that each reading has.
    pub(super) fn spacing(&self) -> f64 {
        self.radius * (std::f64::consts::PI / self.indices.len().max(1) as f64).sqrt()
    }
}

/// The patch around a reading.
#[derive(Debug, Clone, Copy)]
pub(super) struct Side {
    pub(super) patch: Patch,
    /// Sum of the weights of its readings.
    pub(super) support: f64,
    /// True if a plain fit to all readings is as good as the noise.
    pub(super) is_smooth: bool,
}

impl<'a> Cloud<'a> {
    /// Prepares the search and estimates the noise.
    ///
    /// # Errors
    /// `Undetermined` if the points cannot be searched.
    pub(super) fn new(points: &'a [DVec3], normals: &'a [DVec3], sigma: f64) -> Result<Self> {
        let tree = ImmutableKdTree::new_from_slice(as_arrays(points))
            .map_err(|e| Error::undetermined(format!("the points cannot be searched: {e:?}")))?;
        let scales = Scales { height: sigma, slope: SLOPE_SIGMAS[0] };
        Ok(Self { points, normals: normals.to_vec(), tree, spacing: 0.0, scales })
    }

    /// The nearest readings.
    pub(super) fn near(&self, at: DVec3, count: NonZero<usize>) -> Near {
        let found = self.tree.query(at.as_ref()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let radius = found.iter().map(|n| n.distance).fold(0.0, f64::max).sqrt();
        Near { indices: found.iter().map(|n| n.item).collect(), radius }
    }

    /// A weight that falls to zero at the radius.
    pub(super) fn window(&self, i: u32, at: DVec3, radius: f64) -> f64 {
        let share = self.points[i as usize].distance_squared(at) / (radius * radius).max(f64::MIN_POSITIVE);
        (1.0 - share).max(0.0).powi(2)
    }

    /// A reading with a weight.
    pub(super) fn weighted(&self, i: u32, weight: f64) -> Weighted {
        Weighted { point: self.points[i as usize], normal: self.normals[i as usize], weight }
    }

    /// Patches of all readings; none if the surface is smooth everywhere. Plain fits show σ of heights and
    /// slopes.
    pub(super) fn sides(&mut self) -> Option<Vec<Option<Side>>> {
        let plain: Vec<Option<(Plain, Near)>> =
            (0..self.points.len()).into_par_iter().with_min_len(64).map(|i| self.plain(i)).collect();
        let share = |values: &mut Vec<f64>, share: f64| -> f64 {
            if values.is_empty() {
                return 0.0;
            }
            let place = (share * (values.len() - 1) as f64) as usize;
            *values.select_nth_unstable_by(place, f64::total_cmp).1
        };
        let found = || plain.iter().flatten();
        let noise = share(&mut found().map(|(plain, _)| plain.rms).collect(), NOISE_SHARE);
        self.spacing = share(&mut found().map(|(_, near)| near.spacing()).collect(), 0.5);
        self.scales.height = self.scales.height.max(noise).max(1e-3 * self.spacing);
        let turned = share(&mut found().map(|(plain, _)| plain.turned).collect(), 0.5);
        self.scales.slope = turned.clamp(SLOPE_SIGMAS[0], SLOPE_SIGMAS[1]);
        let (patches, near): (Vec<_>, Vec<_>) = plain.into_iter().map(Option::unzip).unzip();
        let sides = self.made_sides(&patches, &near, &vec![None; near.len()]);
        if self.is_smooth_everywhere(&sides) {
            return None;
        }
        // Estimated normals are wrong next to edges. Those of patches are not.
        self.sharpen_normals(&sides);
        Some(self.made_sides(&patches, &near, &sides))
    }

    /// True unless there are places where the surface is not smooth at many readings next to each other.
    fn is_smooth_everywhere(&self, sides: &[Option<Side>]) -> bool {
        let is_rough = |i: usize| sides[i].is_some_and(|side| !side.is_smooth);
        let among_rough = |&i: &usize| {
            let near = self.near(self.points[i], NEAREST).indices;
            let rough = near.iter().filter(|j| is_rough(**j as usize)).count();
            rough as f64 >= ROUGH_SHARE * near.len() as f64
        };
        (0..sides.len()).filter(|&i| is_rough(i)).filter(among_rough).nth(MIN_ROUGH).is_none()
    }

    /// The side of each reading: a plain patch if it is as good as the noise. Smooth ones of `known` stay.
    fn made_sides(
        &self,
        plain: &[Option<Plain>],
        near: &[Option<Near>],
        known: &[Option<Side>],
    ) -> Vec<Option<Side>> {
        (0..self.points.len())
            .into_par_iter()
            .with_min_len(64)
            .map(|i| {
                let (plain, near) = (plain[i].as_ref()?, near[i].as_ref()?);
                if known[i].is_some_and(|side| side.is_smooth) {
                    return known[i];
                }
                if self.is_smooth(plain) {
                    let support = near.indices.len() as f64;
                    return Some(Side { patch: plain.patch, support, is_smooth: true });
                }
                self.one_sided(i, near)
            })
            .collect()
    }

    fn is_smooth(&self, plain: &Plain) -> bool {
        plain.rms <= SMOOTH_SIGMAS * self.scales.height
            && plain.turned <= (SMOOTH_SLOPES * self.scales.slope).max(SMOOTH_TURN)
    }

    /// Gives readings where the surface is not smooth the normal of the patch near them that they lie on.
    fn sharpen_normals(&mut self, sides: &[Option<Side>]) {
        let this = &*self;
        let sharpened = (0..self.points.len())
            .into_par_iter()
            .with_min_len(64)
            .map(|i| {
                let (at, own) = (this.points[i], this.normals[i]);
                if sides[i].is_some_and(|side| side.is_smooth) {
                    return own;
                }
                let near = this.near(at, ASKED);
                let spacing = near.spacing();
                let found = near.indices.iter().filter_map(|&j| {
                    let side = sides[j as usize].as_ref()?;
                    let (off, normal) = side.patch.distance(at);
                    let few = (1.0 - side.support / ENOUGH).max(0.0);
                    let away = AWAY_COST * this.points[j as usize].distance(at) / spacing;
                    let off = (off.abs() / this.scales.height - FREE_SIGMAS).max(0.0) / GATE_SIGMAS;
                    let cost = off + FEW_COST * few + away;
                    (normal.dot(own) > 0.0).then_some((cost, normal))
                });
                let (cost, normal) = found.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, own));
                if cost < MAX_COST { normal } else { own }
            })
            .collect();
        self.normals = sharpened;
    }

    fn plain(&self, i: usize) -> Option<(Plain, Near)> {
        let at = self.points[i];
        let near = self.near(at, NEAREST);
        let own = self.normals[i];
        let readings: Vec<Weighted> = (near.indices.iter())
            .map(|&j| self.weighted(j, self.window(j, at, near.radius)))
            .filter(|reading| reading.normal.dot(own) > OTHER_WALL && reading.weight > 0.0)
            .collect();
        let normal = readings.iter().map(|reading| reading.normal).sum::<DVec3>().try_normalize()?;
        let scales = Scales { height: self.scales.height.max(0.05 * near.spacing()), slope: 0.2 };
        let patch = Patch::fit(at, normal, near.radius, &readings, scales)?.patch;
        let (mut squares, mut turned, mut all) = (0.0, 0.0, 0.0);
        for reading in &readings {
            let (distance, normal) = patch.distance(reading.point);
            squares += reading.weight * distance * distance;
            turned += reading.weight * normal.cross(reading.normal).length_squared();
            all += reading.weight;
        }
        // Six coefficients of about a third of the readings, which their weights amount to, with slopes.
        let degrees = (1.0 - 3.0 / all.max(6.0)).max(0.5);
        Some((
            Plain { patch, rms: (squares / all / degrees).sqrt(), turned: (0.5 * turned / all).sqrt() },
            near,
        ))
    }

    fn one_sided(&self, i: usize, near: &Near) -> Option<Side> {
        let (at, spacing) = (self.points[i], near.spacing());
        let mut normal = self.normals[i].try_normalize()?;
        let mut made: Option<(Patch, f64)> = None;
        for (distance_gate, cosine_gate) in DISTANCE_GATES.into_iter().zip(COSINE_GATES) {
            let gate = (distance_gate.max(MIN_GATE) * spacing).max(GATE_SIGMAS * self.scales.height);
            let weight = |j: u32| {
                let (point, own) = (self.points[j as usize], self.normals[j as usize]);
                let (off, towards) = match &made {
                    Some((patch, _)) => patch.distance(point),
                    None => (normal.dot(point - at), normal),
                };
                let cosine = own.dot(towards);
                let near_patch = (1.0 - (off / gate).powi(2)).max(0.0).powi(2);
                let along = ((cosine - cosine_gate) / (1.0 - cosine_gate)).clamp(0.0, 1.0).sqrt();
                self.window(j, at, near.radius) * near_patch * along
            };
            let readings: Vec<Weighted> = (near.indices.iter())
                .map(|&j| self.weighted(j, weight(j)))
                .filter(|reading| reading.weight > 0.0)
                .collect();
            let support: f64 = readings.iter().map(|reading| reading.weight).sum();
            if readings.len() < MIN_READINGS as usize {
                return None;
            }
            let patch = Patch::fit(at, normal, near.radius, &readings, self.scales)?.patch;
            normal = patch.distance(patch.foot(at)).1;
            made = Some((patch, support));
        }
        let (patch, support) = made?;
        Some(Side { patch, support, is_smooth: false })
    }
}

/// A fit to all readings around one.
struct Plain {
    patch: Patch,
    /// Root mean square of the residuals, for one degree of freedom each.
    rms: f64,
    /// Root mean square of the sine between normals, for each direction.
    turned: f64,
}
