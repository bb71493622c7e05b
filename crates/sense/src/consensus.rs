//! Which points lie on a surface that their neighbours agree on, before any surface is fitted.
//!
//! In: points, of which up to nearly half may be gross errors. Out: for each point a mark, and the plane of
//! the surface near it. A fit chooses its shape from marked points only.
//!
//! Around each of a set of *reference points* a plane is fitted to the nearest others by least median of
//! squares: the median of the absolute residuals is the smallest of many planes through three neighbours
//! (Rousseeuw 1984, *Least median of squares regression*, JASA 79). Up to half of the neighbours may be
//! wrong. A quadratic height field over this plane, fitted to the neighbours near it, is the *patch* of the
//! reference; its scatter is that of the noise, whatever the curvature. A patch counts if most neighbours
//! are near it and its scatter is small against its radius and like that of other patches; neighbours in a
//! volume of gross errors have no such patch. A point is on a surface if patches of references near it pass
//! within [`GATE`] scatters of it.
//!
//! Where the noise is larger than the spacing, no neighbourhood is flat. References are then thinned until
//! the typical neighbourhood is.
//!
//! Not guaranteed: parts thinner than a neighbourhood, wires for example, have no flat plane and are not
//! marked. A cluster of gross errors that itself forms a surface is marked.

use crate::neighbours::surrounding;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{SMatrix, SVector};
use planish_core::DVec3;
use planish_core::random::SplitMix64;
use planish_core::vector3::{as_arrays, tangents};
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::num::NonZero;

/// Smallest cloud with a consensus: below it, neighbourhoods span the object.
pub const MIN_FOR_CONSENSUS: usize = 100;
/// Most reference points. More would only take longer: each stands for the readings around it.
const MAX_REFERENCES: usize = 40_000;
/// Fewest reference points after thinning.
const MIN_REFERENCES: usize = 400;
/// Neighbours of a plane; in small clouds a share of the points, at least the minimum.
const NEIGHBOURS: usize = 28;
const MIN_NEIGHBOURS: usize = 12;
const NEIGHBOURS_SHARE: usize = 16;
/// Planes through three neighbours that are tried. With 45 % of gross errors among the neighbours, all of 24
/// contain one with a probability of 1 %.
const TRIED_PLANES: usize = 24;
/// Median distance over radius of a plane after which no other is tried. So near are 7 % of the points of an
/// evenly filled ball, so that chance brings no half of them.
const SURELY_FLAT: f64 = 0.05;
/// Neighbours near the patch, as a share of all, below which it does not count.
const MIN_INLIERS: f64 = 0.5;
/// Largest scatter over radius of a patch that counts. Points that fill a ball evenly have about 0.4.
const MAX_FLATNESS: f64 = 0.27;
/// A patch counts only if its scatter is at most this many times that of the more even part of the patches,
/// or this share of its radius. Gross errors in a volume can be flat by chance, but not as flat as a surface.
const MAX_TYPICAL_SCATTERS: f64 = 6.0;
const EVENLY_FLAT: f64 = 0.02;
/// References are thinned while the scatter over radius of the flattest third is above this value.
const THINNING_FLATNESS: f64 = 0.1;
/// The consensus is repeated among the marked points so many times if their share is between these two: gross
/// errors among the neighbours widen patches, which then pass through others. Points that fill a volume would
/// thin out to surfaces.
const REPEATS: usize = 2;
const MOST: f64 = 0.5;
const CLEAN: f64 = 0.93;
/// A patch passes a point within this many scatters. A smaller gate loses readings in the tails of the
/// noise, a larger one takes gross errors along.
const GATE: f64 = 3.5;
/// A patch says nothing about points farther from its reference than this many radii.
const MAX_DISTANCE_RADII: f64 = 1.2;
/// References that are asked about a point, and how many patches have to pass it.
const ASKED: usize = 6;
const MIN_VOTES: usize = 2;
/// Normals agree alike with the others if the sums of their cosines are within this factor.
const ALIKE: f64 = 0.95;
/// A patch that passes a point at more than this many scatters belongs to another layer if its normal is
/// parallel up to 25°.
const LAYER_GATE: f64 = 7.0;
const PARALLEL: f64 = 0.9;
/// σ of a normal distribution over its median absolute deviation.
const MAD_TO_SIGMA: f64 = 1.4826;

/// What the neighbours of each point of a cloud agree on.
#[derive(Debug, Clone, Default)]
pub struct SurfaceConsensus {
    /// True for points on a surface that their neighbours agree on.
    pub on_surface: Vec<bool>,
    /// Unit normal of the surface near each point, with arbitrary sign; zero for other points.
    pub normals: Vec<DVec3>,
    /// Share of the points on a surface near which another surface runs parallel, farther away than noise
    /// explains: a second layer, or the other side of a thin plate.
    pub layered_share: f64,
    /// Typical scatter about the surface: σ of the noise along the normal.
    pub scatter: f64,
}

/// Coefficients of a quadratic height field.
const COEFFICIENTS: usize = 6;

/// The patch of a reference point: heights over a plane.
#[derive(Clone, Copy)]
struct Patch {
    middle: DVec3,
    /// Two tangents and the normal; the normal is zero if the neighbours have no patch.
    frame: [DVec3; 3],
    /// Height `c · (1, x, y, x², xy, y²)`, where x and y are in radii.
    heights: [f64; COEFFICIENTS],
    scatter: f64,
    /// Distance of the farthest neighbour.
    radius: f64,
}

impl Patch {
    fn exists(&self) -> bool {
        self.frame[2] != DVec3::ZERO
    }

    /// Distance of a point, relative to the middle, from the patch: along the plane's normal, less what the
    /// slope adds to it.
    fn distance(&self, d: DVec3) -> f64 {
        let [x, y] = [0, 1].map(|k| d.dot(self.frame[k]) / self.radius);
        let height: f64 = self.heights.iter().zip(monomials(x, y)).map(|(c, m)| c * m).sum();
        let [_, cx, cy, xx, xy, yy] = self.heights;
        let slope = [cx + 2.0 * xx * x + xy * y, cy + xy * x + 2.0 * yy * y].map(|s| s / self.radius);
        (d.dot(self.frame[2]) - height).abs() / (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt()
    }

    /// The normal at the foot of a point, relative to the middle.
    fn normal(&self, d: DVec3) -> DVec3 {
        let [x, y] = [0, 1].map(|k| d.dot(self.frame[k]) / self.radius);
        let [_, cx, cy, xx, xy, yy] = self.heights;
        let slope = [cx + 2.0 * xx * x + xy * y, cy + xy * x + 2.0 * yy * y].map(|s| s / self.radius);
        (self.frame[2] - slope[0] * self.frame[0] - slope[1] * self.frame[1]).normalize_or_zero()
    }
}

fn monomials(x: f64, y: f64) -> [f64; COEFFICIENTS] {
    [1.0, x, y, x * x, x * y, y * y]
}

/// Finds the points that lie on a surface with their neighbours; none for clouds of fewer than
/// [`MIN_FOR_CONSENSUS`] points, whose neighbourhoods span the object.
///
/// Cost: one tree of at most 40,000 points, a robust patch for each of them, and one query for each point,
/// in parallel.
///
/// # Errors
/// `Undetermined` if the points cannot be searched, as too many at one position.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::surface_consensus;
/// // A plate of 400 points, and 100 points far above it.
/// let plate = (0..400).map(|k| DVec3::new(f64::from(k % 20), f64::from(k / 20), 0.0));
/// let error = |k| DVec3::new(f64::from(k * 7 % 20), f64::from(k / 5), f64::from(5 + k * 13 % 31));
/// let errors = (0..100).map(error);
/// let points: Vec<DVec3> = plate.chain(errors).collect();
/// let found = surface_consensus(&points)?.expect("enough points");
/// assert!(found.on_surface[..400].iter().all(|on| *on));
/// assert!(found.on_surface[400..].iter().filter(|on| **on).count() < 5);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn surface_consensus(points: &[DVec3]) -> Result<Option<SurfaceConsensus>> {
    if points.len() < MIN_FOR_CONSENSUS {
        return Ok(None);
    }
    let mut references = References::new(points)?;
    let mut found = references.judge_all(points);
    for _ in 0..REPEATS {
        let count = found.iter().filter(|f| f.on_surface).count();
        let share = count as f64 / points.len() as f64;
        if !(MOST..=CLEAN).contains(&share) || count < MIN_FOR_CONSENSUS {
            break;
        }
        let marked: Vec<DVec3> =
            (points.iter().zip(&found)).filter(|(_, f)| f.on_surface).map(|(p, _)| *p).collect();
        references = References::new(&marked)?;
        found = references.judge_all(points);
    }
    let on = found.iter().filter(|f| f.on_surface);
    let (count, layered) =
        on.fold((0_usize, 0_usize), |(count, layered), f| (count + 1, layered + usize::from(f.is_layered)));
    Ok(Some(SurfaceConsensus {
        on_surface: found.iter().map(|f| f.on_surface).collect(),
        normals: found.iter().map(|f| f.normal).collect(),
        layered_share: layered as f64 / count.max(1) as f64,
        scatter: references.scatter,
    }))
}

/// What patches say about a point.
#[derive(Clone, Copy, Default)]
struct Judgement {
    on_surface: bool,
    normal: DVec3,
    is_layered: bool,
}

/// The reference points with their patches.
struct References {
    tree: ImmutableKdTree<f64, 3>,
    patches: Vec<Patch>,
    /// Typical scatter of the patches.
    scatter: f64,
}

impl References {
    fn new(points: &[DVec3]) -> Result<Self> {
        let mut wanted = points.len().min(MAX_REFERENCES);
        let mut best: Option<(f64, Vec<DVec3>)> = None;
        loop {
            let chosen = thinned(points, wanted);
            let flatness = typical_flatness(&chosen)?;
            let improved = best.as_ref().is_none_or(|(before, _)| flatness < *before);
            if improved {
                best = Some((flatness, chosen));
            }
            if flatness <= THINNING_FLATNESS || wanted / 4 < MIN_REFERENCES {
                break;
            }
            wanted /= 4;
        }
        let chosen = best.map(|(_, chosen)| chosen).unwrap_or_default();
        let tree = tree_of(&chosen)?;
        let mut patches: Vec<Patch> = (0..chosen.len())
            .into_par_iter()
            .with_min_len(128)
            .map(|i| patch_around(&chosen, &tree, i))
            .collect();
        let mut scatters: Vec<f64> = patches.iter().filter(|p| p.exists()).map(|p| p.scatter).collect();
        let mut scatter = 0.0;
        if !scatters.is_empty() {
            let quarter = scatters.len() / 4;
            let typical = *scatters.select_nth_unstable_by(quarter, f64::total_cmp).1;
            for patch in &mut patches {
                if patch.scatter > (MAX_TYPICAL_SCATTERS * typical).max(EVENLY_FLAT * patch.radius) {
                    patch.frame[2] = DVec3::ZERO;
                }
            }
            scatter = typical;
        }
        Ok(Self { tree, patches, scatter })
    }

    fn judge_all(&self, points: &[DVec3]) -> Vec<Judgement> {
        points.par_iter().with_min_len(256).map(|p| self.judge(*p)).collect()
    }

    /// Whether a point is on a surface, the normal there, and whether another surface runs parallel.
    fn judge(&self, p: DVec3) -> Judgement {
        let asked = NonZero::new(ASKED.min(self.patches.len())).unwrap_or(NonZero::<usize>::MIN);
        let near = self.tree.query(p.as_ref()).nearest_n::<SquaredEuclidean<f64>>(asked).execute();
        let mut passing: Vec<(DVec3, f64)> = Vec::with_capacity(ASKED);
        let mut others: Vec<&Patch> = Vec::new();
        for neighbour in near {
            let patch = &self.patches[neighbour.item as usize];
            let reach = MAX_DISTANCE_RADII * patch.radius;
            if !patch.exists() || (p - patch.middle).length() > reach {
                continue;
            }
            let off = patch.distance(p - patch.middle) / patch.scatter;
            if off <= GATE {
                passing.push((patch.normal(p - patch.middle), off));
            } else if off > LAYER_GATE {
                others.push(patch);
            }
        }
        if passing.len() < MIN_VOTES {
            return Judgement::default();
        }
        // A patch across a row of points passes all of them, so others have to agree with the normal. Of
        // those that agree alike the nearest counts.
        let agreement = |normal: DVec3| passing.iter().map(|(other, _)| other.dot(normal).abs()).sum::<f64>();
        let most = passing.iter().map(|(normal, _)| agreement(*normal)).fold(0.0, f64::max);
        let nearest = (passing.iter().filter(|(normal, _)| agreement(*normal) >= ALIKE * most))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let normal = nearest.map_or(DVec3::ZERO, |(normal, _)| *normal);
        let is_parallel = |other: &&&Patch| other.normal(p - other.middle).dot(normal).abs() > PARALLEL;
        let parallel = others.iter().filter(is_parallel).count();
        Judgement { on_surface: true, normal, is_layered: parallel >= MIN_VOTES }
    }
}

/// About `wanted` of the points, chosen by a hash of their number: every n-th point of a grid would be a
/// row.
fn thinned(points: &[DVec3], wanted: usize) -> Vec<DVec3> {
    if wanted >= points.len() {
        return points.to_vec();
    }
    let share = wanted as f64 / points.len() as f64;
    let chosen =
        |i: &usize| planish_core::random::unit_interval(planish_core::random::nth(*i as u64)) < share;
    (0..points.len()).filter(chosen).map(|i| points[i]).collect()
}

/// Scatter over radius of the flattest third of the neighbourhoods of a cloud, from a sample.
///
/// Not the median: up to half of the neighbourhoods may consist of gross errors.
fn typical_flatness(points: &[DVec3]) -> Result<f64> {
    const SAMPLE: usize = 400;
    let tree = tree_of(points)?;
    let mut ratios: Vec<f64> = (0..points.len())
        .step_by(points.len().div_ceil(SAMPLE).max(1))
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|i| {
            let patch = patch_around(points, &tree, i);
            if patch.exists() { patch.scatter / patch.radius } else { 1.0 }
        })
        .collect();
    let third = ratios.len() / 3;
    Ok(*ratios.select_nth_unstable_by(third, f64::total_cmp).1)
}

fn tree_of(points: &[DVec3]) -> Result<ImmutableKdTree<f64, 3>> {
    ImmutableKdTree::new_from_slice(as_arrays(points))
        .map_err(|e| Error::undetermined(format!("the points cannot be searched: {e:?}")))
}

/// The robust patch of the neighbours of point `i`.
fn patch_around(points: &[DVec3], tree: &ImmutableKdTree<f64, 3>, i: usize) -> Patch {
    let k = (points.len() / NEIGHBOURS_SHARE).clamp(MIN_NEIGHBOURS, NEIGHBOURS).min(points.len());
    let count = NonZero::new(k).unwrap_or(NonZero::<usize>::MIN);
    let found = surrounding(tree, points, points[i], count);
    // About the reference: far from the origin, products of coordinates lose the digits that matter here.
    let near: Vec<DVec3> = found.iter().map(|&j| points[j as usize] - points[i]).collect();
    let radius = near.iter().map(|d| d.length()).fold(0.0_f64, f64::max);
    let none = Patch {
        middle: points[i],
        frame: [DVec3::ZERO; 3],
        heights: [0.0; COEFFICIENTS],
        scatter: f64::MAX,
        radius,
    };
    if near.len() <= COEFFICIENTS || radius <= 0.0 {
        return none;
    }
    let Some((normal, offset, median)) = least_median_plane(&near, radius, i) else {
        return none;
    };
    // With few neighbours, the smallest median is too small by about 1 + 5/(n − 3) (Rousseeuw & Leroy 1987).
    let correction = 1.0 + 5.0 / (near.len() as f64 - 3.0);
    // Exact points of a quadric have no scatter at all: rounding takes its place.
    let floor = 1e-9 * radius + 4.0 * f64::EPSILON * points[i].length();
    let (along, across) = tangents(normal);
    let base = Patch {
        frame: [along, across, normal],
        heights: [offset, 0.0, 0.0, 0.0, 0.0, 0.0],
        scatter: (MAD_TO_SIGMA * correction * median).max(floor),
        ..none
    };
    // The plane finds most of the correct neighbours, the height field over it all of them.
    let mut patch = base;
    for _ in 0..2 {
        let inliers: Vec<DVec3> =
            near.iter().copied().filter(|d| patch.distance(*d) <= 3.0 * patch.scatter).collect();
        let degrees = inliers.len() as f64 - COEFFICIENTS as f64;
        if (inliers.len() as f64) < MIN_INLIERS * near.len() as f64 || degrees <= 0.0 {
            return none;
        }
        let Some(heights) = height_field(&base, &inliers) else {
            return none;
        };
        patch.heights = heights;
        let squares: f64 = inliers.iter().map(|d| patch.distance(*d).powi(2)).sum();
        patch.scatter = (squares / degrees).sqrt().max(floor);
    }
    if patch.scatter <= MAX_FLATNESS * radius { patch } else { none }
}

/// Least-squares heights of points, relative to its middle, over the plane of a patch; none if the points do
/// not determine them.
fn height_field(patch: &Patch, points: &[DVec3]) -> Option<[f64; COEFFICIENTS]> {
    let mut normal_equations = SMatrix::<f64, COEFFICIENTS, COEFFICIENTS>::zeros();
    let mut right = SVector::<f64, COEFFICIENTS>::zeros();
    for d in points {
        let [x, y] = [0, 1].map(|k| d.dot(patch.frame[k]) / patch.radius);
        let row = SVector::from(monomials(x, y));
        normal_equations += row * row.transpose();
        right += d.dot(patch.frame[2]) * row;
    }
    // A trace of ridge: neighbours in a row determine no curvature across it.
    for k in 0..COEFFICIENTS {
        normal_equations[(k, k)] += 1e-6 * points.len() as f64;
    }
    Some(normal_equations.cholesky()?.solve(&right).into())
}

/// Normal, offset and median absolute residual of the best of the planes through three of the points, or of
/// the first that is surely near most of them.
fn least_median_plane(near: &[DVec3], radius: f64, seed: usize) -> Option<(DVec3, f64, f64)> {
    let mut random = SplitMix64::new(seed as u64);
    let mut draw = || (random.next_u64() % near.len() as u64) as usize;
    let mut residuals = vec![0.0; near.len()];
    let mut best: Option<(DVec3, f64, f64)> = None;
    for _ in 0..TRIED_PLANES {
        let [a, b, c] = [draw(), draw(), draw()].map(|k| near[k]);
        // Three points that are equal or on one line span no plane.
        let Some(normal) = (b - a).cross(c - a).try_normalize() else {
            continue;
        };
        let offset = normal.dot(a);
        for (residual, p) in residuals.iter_mut().zip(near) {
            *residual = (normal.dot(*p) - offset).abs();
        }
        let middle = near.len() / 2;
        let median = *residuals.select_nth_unstable_by(middle, f64::total_cmp).1;
        if best.is_none_or(|(.., least)| median < least) {
            best = Some((normal, offset, median));
        }
        if median <= SURELY_FLAT * radius {
            break;
        }
    }
    best
}

/// The nearest neighbours of every point of a cloud.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::Neighbourhoods;
/// let points: Vec<DVec3> = (0..20).map(|k| DVec3::new(f64::from(k), 0.0, 0.0)).collect();
/// let near = Neighbourhoods::new(&points, 4)?;
/// // Of the neighbours of point 9, which are 7, 8, 10 and 11, two are marked.
/// assert_eq!(near.share(9, |j| Some(j < 10)), Some(0.5));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub struct Neighbourhoods {
    /// Neighbours of each point.
    count: usize,
    indices: Vec<u32>,
    /// Distance to the farthest of them.
    radii: Vec<f64>,
}

impl Neighbourhoods {
    /// Finds the `count` nearest neighbours of each point, or all others if there are fewer.
    ///
    /// # Errors
    /// `Undetermined` if the points cannot be searched.
    pub fn new(points: &[DVec3], count: usize) -> Result<Self> {
        let tree = tree_of(points)?;
        let count = count.min(points.len().saturating_sub(1));
        let asked = NonZero::new(count + 1).unwrap_or(NonZero::<usize>::MIN);
        let found: Vec<(Vec<u32>, f64)> = (0..points.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|i| {
                let near = tree.query(points[i].as_ref()).nearest_n::<SquaredEuclidean<f64>>(asked).execute();
                let radius = near.iter().map(|n| n.distance).fold(0.0, f64::max).sqrt();
                // Of several points at one position, the query may return others than the point itself.
                let others = near.iter().map(|n| n.item).filter(|&j| j as usize != i);
                (others.take(count).collect(), radius)
            })
            .collect();
        let radii = found.iter().map(|(_, radius)| *radius).collect();
        Ok(Self { count, indices: found.into_iter().flat_map(|(near, _)| near).collect(), radii })
    }

    /// The neighbours of a point.
    #[must_use]
    pub fn neighbours(&self, i: usize) -> &[u32] {
        &self.indices[i * self.count..(i + 1) * self.count]
    }

    /// Side of the square that each point near this one has on a surface: `√(π/k)` times the distance of its
    /// `k`-th neighbour.
    #[must_use]
    pub fn spacing(&self, i: usize) -> f64 {
        self.radii[i] * (std::f64::consts::PI / self.count.max(1) as f64).sqrt()
    }

    /// Among the neighbours for which `marked` has an answer, the share of those with `true`; none if it has
    /// no answer for any.
    pub fn share(&self, i: usize, marked: impl Fn(usize) -> Option<bool>) -> Option<f64> {
        let answers = self.neighbours(i).iter().filter_map(|&j| marked(j as usize));
        let (count, yes) = answers.fold((0_u32, 0_u32), |(count, yes), is| (count + 1, yes + u32::from(is)));
        (count > 0).then(|| f64::from(yes) / f64::from(count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::random::unit_interval;

    /// Numbers in (−1, 1), uniform and roughly normal.
    struct Draws(SplitMix64);

    impl Draws {
        fn uniform(&mut self) -> f64 {
            2.0 * unit_interval(self.0.next_u64()) - 1.0
        }

        fn normal(&mut self) -> f64 {
            (0..12).map(|_| 0.5 * self.uniform()).sum()
        }
    }

    /// A paraboloid with noise, of which a share is displaced along z by `error`.
    fn paraboloid(
        n: usize,
        share: f64,
        noise: f64,
        error: impl Fn(&mut Draws) -> f64,
    ) -> (Vec<DVec3>, Vec<bool>) {
        let mut draws = Draws(SplitMix64::new(11));
        (0..n)
            .map(|k| {
                let (x, y) = (5.0 * draws.uniform(), 5.0 * draws.uniform());
                let wrong = (k as f64 + 0.5) / (n as f64) < share;
                let off = if wrong { error(&mut draws) } else { noise * draws.normal() };
                (DVec3::new(x, y, 0.04 * (x * x + y * y) + off), !wrong)
            })
            .unzip()
    }

    /// Shares of the correct points and of the gross errors that are marked.
    fn marked(points: &[DVec3], correct: &[bool]) -> (f64, f64) {
        let found = surface_consensus(points).unwrap().unwrap();
        let share = |of: bool| {
            let all = correct.iter().zip(&found.on_surface).filter(|(c, _)| **c == of);
            let (n, on) = all.fold((0_i32, 0_i32), |(n, on), (_, o)| (n + 1, on + i32::from(*o)));
            f64::from(on) / f64::from(n.max(1_i32))
        };
        (share(true), share(false))
    }

    #[test]
    fn nearly_half_of_the_points_may_be_gross_errors() {
        for share in [0.05, 0.15, 0.3, 0.45] {
            let (points, correct) = paraboloid(3000, share, 0.01, |d| 20.0 * d.uniform());
            let (kept, taken) = marked(&points, &correct);
            assert!(kept > 0.93 && taken < 0.05, "uniform, {share}: {kept} {taken}");
        }
        let (points, correct) = paraboloid(3000, 0.3, 0.01, |d| 2.0 + d.uniform());
        let (kept, taken) = marked(&points, &correct);
        assert!(kept > 0.93 && taken < 0.05, "to one side: {kept} {taken}");
    }

    #[test]
    fn noise_larger_than_the_spacing_is_no_gross_error() {
        // 40,000 points on 100 square units have a spacing of 0.05.
        let (points, correct) = paraboloid(40_000, 0.0, 0.3, |_| 0.0);
        let (kept, _) = marked(&points, &correct);
        assert!(kept > 0.97, "{kept}");
    }

    #[test]
    fn both_sides_of_an_edge_are_on_a_surface() {
        let mut draws = Draws(SplitMix64::new(5));
        let points: Vec<DVec3> = (0..4000)
            .map(|k| {
                let (along, across) = (draws.uniform(), 0.5 + 0.5 * draws.uniform());
                let off = 0.002 * draws.normal();
                if k % 2 == 0 { DVec3::new(along, across, off) } else { DVec3::new(along, off, across) }
            })
            .collect();
        let (kept, _) = marked(&points, &vec![true; 4000]);
        assert!(kept > 0.97, "{kept}");
    }

    #[test]
    fn errors_in_a_volume_have_no_surface() {
        let mut draws = Draws(SplitMix64::new(3));
        let points: Vec<DVec3> =
            (0..2000).map(|_| DVec3::new(draws.uniform(), draws.uniform(), draws.uniform())).collect();
        let found = surface_consensus(&points).unwrap().unwrap();
        let on = found.on_surface.iter().filter(|on| **on).count();
        assert!(on < 1000, "{on} of 2000 points in a volume count as surface");
    }
}
