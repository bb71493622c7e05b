//! Foot points: parameters of the surface point nearest to a measured point.
//!
//! Input: a [`Surface`], a point, and either starting parameters or a [`FootPointSearch`]. Output: a
//! [`FootPoint`] with leaf, local coordinates, jet and signed distance.
//!
//! A projection does not cross creases. Where one is near the foot point, it is repeated from the other side,
//! and the nearer foot point is taken.
//!
//! Not guaranteed: the *global* nearest point. A projection descends from its start. The search starts at the
//! sample whose position and normal agree best, which distinguishes the two sides of a thin part.

use crate::hierarchy::{Hierarchy, Shape};
use crate::surface::{Jet, Surface};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::vector3::as_arrays;
use planish_core::{DVec3, vector3::tangents};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// The foot point of a measured point.
#[derive(Debug, Clone, Copy)]
pub struct FootPoint {
    /// The leaf of the foot point.
    pub leaf: u32,
    /// Coordinates inside the leaf, in `[0, 1]²`.
    pub local: [f64; 2],
    /// Point and derivatives at the foot point.
    pub jet: Jet,
    /// Unit normal at the foot point (zero if the surface is degenerate).
    pub normal: DVec3,
    /// Signed distance of the measured point along the normal.
    pub height: f64,
    /// Distance of the measured point from the normal line: zero up to the tolerance unless the foot point is
    /// at a border.
    pub slip: f64,
    /// True if the foot point lies on the border of an open surface and the measured point lies beyond it.
    pub at_border: bool,
    /// True if the iteration reached its tolerance.
    pub converged: bool,
}

/// Stopping criteria of a projection.
#[derive(Debug, Clone, Copy)]
pub struct ProjectionOptions {
    /// Maximum number of steps.
    pub max_steps: usize,
    /// Tolerance of the foot point as a fraction of the side of the leaf.
    pub relative_tolerance: f64,
}

impl Default for ProjectionOptions {
    fn default() -> Self {
        // An error h of the foot point changes the height by κh²/2, so 1e-5 of a cell is far below any noise.
        Self { max_steps: 20, relative_tolerance: 1e-5 }
    }
}

impl Surface {
    /// The foot point of `z`, by damped Newton iteration from `(u, v)`.
    ///
    /// Minimises `|S(u, v) − z|²/2`: full Newton steps where the Hessian is positive definite, Gauss–Newton
    /// steps elsewhere. Each step is shortened until the distance decreases. Steps may cross cells; open
    /// borders constrain the foot point.
    ///
    /// Cost: typically 2 or 3 jets from a neighbouring sample, and 1 if the surface has hardly moved.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::{BaseShape, ProjectionOptions};
    ///
    /// let ball = BaseShape::sphere(DVec3::ZERO, 2.0, DVec3::Z).surface([16, 8])?;
    /// let foot = ball.project(3.0 * DVec3::X, [0.5, 4.5], &ProjectionOptions::default());
    /// assert!(foot.converged);
    /// assert!((foot.height - 1.0).abs() < 0.01); // 1 outside a radius of 2
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn project(&self, z: DVec3, start: [f64; 2], options: &ProjectionOptions) -> FootPoint {
        project_onto(self.space(), |leaf, [s, t]| self.leaf_jet(leaf, s, t), z, start, options)
    }
}

/// [`Surface::project`] for a surface given by its jets: `jet_at(leaf, local)`.
pub(crate) fn project_onto(
    space: &Hierarchy,
    jet_at: impl Fn(usize, [f64; 2]) -> Jet,
    z: DVec3,
    start: [f64; 2],
    options: &ProjectionOptions,
) -> FootPoint {
    let foot = descend(space, &jet_at, z, start, options);
    match space.domain() {
        Some(domain) if !domain.creases().is_empty() => beyond_creases(space, &jet_at, z, foot, options),
        _ => foot,
    }
}

/// The nearest foot point of this one and of those on other sides of creases that are near it.
#[inline(never)]
fn beyond_creases(
    space: &Hierarchy,
    jet_at: &impl Fn(usize, [f64; 2]) -> Jet,
    z: DVec3,
    first: FootPoint,
    options: &ProjectionOptions,
) -> FootPoint {
    let mut nearest = first;
    let mut found = vec![first];
    let mut quads = vec![space.parameters(first.leaf as usize, first.local)[0] as u32];
    // Feet at a corner of several faces have the same distance, and any of its faces may have a nearer one.
    let is_near = |foot: &FootPoint, nearest: &FootPoint| {
        foot.jet.point.distance(z) <= nearest.jet.point.distance(z) * (1.0 + 1e-9)
    };
    while let Some(foot) = found.pop() {
        if !is_near(&foot, &nearest) {
            continue;
        }
        let reach = 2.0 * foot.jet.point.distance(z);
        let at = space.parameters(foot.leaf as usize, foot.local);
        for [[u, v], beyond] in space.across_creases(at) {
            let (leaf, local) = space.locate(u, v);
            let quad = beyond[0] as u32;
            // Beyond this distance, the crease is farther from the point than the foot.
            if quads.contains(&quad) || jet_at(leaf, local).point.distance(foot.jet.point) > reach {
                continue;
            }
            quads.push(quad);
            let other = descend(space, jet_at, z, beyond, options);
            if other.jet.point.distance_squared(z) < nearest.jet.point.distance_squared(z) {
                nearest = other;
            }
            found.push(other);
        }
    }
    nearest
}

/// A foot point on this side of all creases.
#[inline(always)]
fn descend(
    space: &Hierarchy,
    jet_at: &impl Fn(usize, [f64; 2]) -> Jet,
    z: DVec3,
    [u, v]: [f64; 2],
    options: &ProjectionOptions,
) -> FootPoint {
    let mut at = space.wrap(u, v);
    let (mut leaf, mut local) = space.locate(at[0], at[1]);
    let mut jet = jet_at(leaf, local);
    let mut distance2 = squared(jet.point - z);
    let mut converged = false;
    let mut at_border = false;
    for _ in 0..options.max_steps {
        let side = space.leaves()[leaf].side();
        let r = jet.point - z;
        let gradient = [jet.du.dot(r), jet.dv.dot(r)];
        // A bound is active only while the point pulls outwards. Otherwise the foot could never leave the
        // border.
        let borders = space.on_border(at);
        let creases = space.on_crease(at);
        at_border = held_by(borders, gradient).contains(&true);
        let held = held_by(std::array::from_fn(|k| borders[k] || creases[k]), gradient);
        let step = newton_step(&jet, r, gradient, held);
        // Limit steps to two cells, because the quadratic model of the distance is local.
        let longest = step[0].abs().max(step[1].abs());
        if longest == 0.0 {
            converged = true;
            break;
        }
        // The last step is so short that the Taylor expansion replaces another evaluation.
        let inside = [0, 1].map(|d| local[d] + step[d] / side);
        if (longest / side).powi(2) < options.relative_tolerance
            && inside.iter().all(|c| (0.0..1.0).contains(c))
        {
            (local, jet) = (inside, jet.shifted(step));
            converged = true;
            break;
        }
        // Line search: shorten the step until the distance decreases.
        let mut share = (2.0 * side / longest).min(1.0);
        let mut moved = false;
        for _ in 0..6 {
            let part = step.map(|x| share * x);
            let mut next = [at[0] + part[0], at[1] + part[1]];
            let inside = [0, 1].map(|d| local[d] + part[d] / side);
            let (next_leaf, next_local) = if inside.iter().all(|c| (0.0..1.0).contains(c)) {
                (leaf, inside)
            } else {
                next = space.moved_to_crease(at, part);
                space.locate(next[0], next[1])
            };
            let next_jet = jet_at(next_leaf, next_local);
            let next2 = squared(next_jet.point - z);
            // Near the foot point, the distance changes by less than its rounding.
            if next2 <= distance2 * (1.0 + 1e-12) {
                (at, leaf, local, jet, distance2) = (next, next_leaf, next_local, next_jet, next2);
                moved = true;
                break;
            }
            share *= 0.35;
        }
        // Newton converges quadratically: after a full step of s leaf sides the error is about s².
        let left = if share < 1.0 { longest * share / side } else { (longest / side).powi(2) };
        // A step that ended at a crease was not a full one.
        if !moved || (left < options.relative_tolerance && space.on_crease(at) == creases) {
            converged = true;
            break;
        }
    }
    let normal = jet.normal().unwrap_or_default();
    let offset = z - jet.point;
    let height = offset.dot(normal);
    FootPoint {
        leaf: leaf as u32,
        local,
        jet,
        normal,
        height,
        slip: (offset - height * normal).length(),
        at_border,
        converged,
    }
}

/// The directions in which a point pulls out of the sides (left, right, bottom, top) that a foot is on.
#[inline(always)]
fn held_by([left, right, bottom, top]: [bool; 4], gradient: [f64; 2]) -> [bool; 2] {
    [
        (left && gradient[0] > 0.0) || (right && gradient[0] < 0.0),
        (bottom && gradient[1] > 0.0) || (top && gradient[1] < 0.0),
    ]
}

#[inline(always)]
fn squared(a: DVec3) -> f64 {
    a.length_squared()
}

/// The step `−H⁻¹ g` without the constrained directions.
#[inline(always)]
fn newton_step(jet: &Jet, r: DVec3, g: [f64; 2], held: [bool; 2]) -> [f64; 2] {
    let [e, f, gg] = jet.first_form();
    // Beyond the centre of curvature the Hessian is indefinite and Newton's method climbs to a maximum. Close
    // to it, its steps are very long. Gauss–Newton always descends.
    let full = [e + jet.duu.dot(r), f + jet.duv.dot(r), gg + jet.dvv.dot(r)];
    let one = |a: f64, a_full: f64, g: f64| {
        let a = if a_full > 0.1 * a { a_full } else { a };
        if a > 0.0 { -g / a } else { 0.0 }
    };
    match held {
        [true, true] => [0.0; 2],
        [true, false] => [0.0, one(gg, full[2], g[1])],
        [false, true] => [one(e, full[0], g[0]), 0.0],
        [false, false] => {
            let area2 = e * gg - f * f;
            let determinant = full[0] * full[2] - full[1] * full[1];
            let [a, b, c, det] = if full[0] > 0.0 && determinant > 0.05 * area2 {
                [full[0], full[1], full[2], determinant]
            } else {
                [e, f, gg, area2]
            };
            // At a pole S_u is zero, and only v can move.
            if det > 1e-14 * a * c {
                [-(c * g[0] - b * g[1]) / det, -(a * g[1] - b * g[0]) / det]
            } else {
                [0.0, one(gg, full[2], g[1])]
            }
        }
    }
}

/// Search for start parameters of projections: samples of the surface in a tree over position and scaled
/// normal.
pub struct FootPointSearch {
    tree: SampleTree,
    parameters: Vec<[f64; 2]>,
    normal_scale: f64,
}

/// Search structure of the samples. Splitting a tree along equal normals costs ten times as much without
/// benefit, so there is a tree of positions alone. A sheet that covers a plane once needs only a raster.
enum SampleTree {
    Raster(Raster),
    Positions(ImmutableKdTree<f64, 3>),
    WithNormals(ImmutableKdTree<f64, 6>),
}

/// Minimum cosine (60°) between all normals and the mean normal for a sheet to be a single layer. Beyond 90°
/// the layer would overlap itself in the plane; the margin covers normals between samples (test
/// `a_rolled_up_sheet_is_not_a_single_layer`).
const MIN_LAYER_COSINE: f64 = 0.5;

/// For each cell of a raster in a plane, the sample nearest to its centre.
struct Raster {
    origin: DVec3,
    /// Two directions in the plane, divided by the size of a cell.
    axes: [DVec3; 2],
    size: [usize; 2],
    sample: Vec<u32>,
}

impl Raster {
    /// A raster over the mean plane of samples with unit normals; `None` if they are not a single layer.
    fn from_layer(samples: &[DVec3], normals: &[DVec3]) -> Option<Self> {
        let mut mean = DVec3::ZERO;
        for normal in normals {
            mean += *normal;
        }
        let up = 1.0 / mean.length() * mean;
        let is_layer = normals.iter().all(|normal| normal.dot(up) > MIN_LAYER_COSINE);
        if !is_layer {
            return None;
        }
        let (along, across) = tangents(up);
        let axes = [along, across];
        let origin = samples[0];
        let in_plane = |p: &DVec3| axes.map(|axis| axis.dot(*p - origin));
        let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for p in samples {
            for (range, x) in bounds.iter_mut().zip(in_plane(p)) {
                *range = [range[0].min(x), range[1].max(x)];
            }
        }
        let sides = bounds.map(|[low, high]| high - low);
        // About one cell per sample; slivers get more.
        let cell = (sides[0] * sides[1] / samples.len() as f64).sqrt();
        let is_sliver = sides.iter().any(|side| side / cell > samples.len() as f64);
        if cell.is_nan() || cell <= 0.0 || is_sliver {
            return None;
        }
        let size = sides.map(|side| (side / cell) as usize + 1);
        let origin = origin + (bounds[0][0] * axes[0] + bounds[1][0] * axes[1]);
        let mut raster = Self {
            origin,
            axes: axes.map(|axis| 1.0 / cell * axis),
            size,
            sample: vec![NO_SAMPLE; size[0] * size[1]],
        };
        raster.fill(samples);
        Some(raster)
    }

    /// Enters every sample in its cell. Each empty cell then gets the nearest sample of its neighbours.
    fn fill(&mut self, samples: &[DVec3]) {
        let places: Vec<[f64; 2]> = samples.iter().map(|p| self.place(*p)).collect();
        let [columns, rows] = self.size;
        let distance = |sample: u32, cell: usize| {
            let middle = [(cell % columns) as f64 + 0.5, (cell / columns) as f64 + 0.5];
            let [x, y] = places[sample as usize];
            (x - middle[0]).powi(2) + (y - middle[1]).powi(2)
        };
        for (k, p) in (0..).zip(samples) {
            let cell = self.cell(*p);
            if self.sample[cell] == NO_SAMPLE || distance(k, cell) < distance(self.sample[cell], cell) {
                self.sample[cell] = k;
            }
        }
        // Two sweeps, downwards and upwards, propagate nearest samples (Danielsson 1980).
        // Distances are those of the sample itself, not sums of steps between cells: errors do not add up.
        let mut propose = |from: Option<usize>, cell: usize| {
            let Some(offered) = from.map(|from| self.sample[from]).filter(|&k| k != NO_SAMPLE) else {
                return;
            };
            let own = self.sample[cell];
            if own == NO_SAMPLE || distance(offered, cell) < distance(own, cell) {
                self.sample[cell] = offered;
            }
        };
        for j in 0..rows {
            (0..columns).for_each(|i| {
                let cell = j * columns + i;
                propose(cell.checked_sub(columns), cell);
                propose((i > 0).then(|| cell - 1), cell);
            });
            // Each row is passed in both directions: one pass would not carry samples to the other side.
            (0..columns).rev().for_each(|i| {
                let cell = j * columns + i;
                propose((i + 1 < columns).then(|| cell + 1), cell);
            });
        }
        for j in (0..rows).rev() {
            (0..columns).rev().for_each(|i| {
                let cell = j * columns + i;
                propose((j + 1 < rows).then(|| cell + columns), cell);
                propose((i + 1 < columns).then(|| cell + 1), cell);
            });
            (0..columns).for_each(|i| {
                let cell = j * columns + i;
                propose((i > 0).then(|| cell - 1), cell);
            });
        }
    }

    /// Coordinates in the plane, in cells.
    #[inline]
    fn place(&self, p: DVec3) -> [f64; 2] {
        self.axes.map(|axis| axis.dot(p - self.origin))
    }

    /// The cell of a point, or the nearest cell for points outside.
    #[inline]
    fn cell(&self, p: DVec3) -> usize {
        let [x, y] = self.place(p);
        // The cast saturates: negative numbers become zero.
        (y as usize).min(self.size[1] - 1) * self.size[0] + (x as usize).min(self.size[0] - 1)
    }
}

const NO_SAMPLE: u32 = u32::MAX;

impl FootPointSearch {
    /// Samples every leaf at `per_side × per_side` points.
    ///
    /// `normal_scale` weighs normals against positions: opposite normals count like a distance of
    /// `2 · normal_scale`. Zero searches by position alone.
    ///
    /// # Errors
    /// `Undetermined` when no sample of the surface is usable.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::{BaseShape, FootPointSearch, ProjectionOptions};
    ///
    /// let ball = BaseShape::sphere(DVec3::ZERO, 2.0, DVec3::Z).surface([16, 8])?;
    /// let search = FootPointSearch::new(&ball, 2, 0.0)?;
    /// let point = DVec3::new(0.0, -2.5, 0.1);
    /// let foot = ball.project(point, search.nearest(point, DVec3::ZERO), &ProjectionOptions::default());
    /// assert!(foot.converged && (foot.height - 0.5).abs() < 0.01);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn new(surface: &Surface, per_side: usize, normal_scale: f64) -> Result<Self> {
        let space = surface.space();
        // Positions alone cannot distinguish the two sides of a thin wall, so normals may take part in the
        // search.
        let of_leaf = |leaf: usize| {
            (0..per_side * per_side).filter_map(move |k| {
                let local = [k % per_side, k / per_side].map(|k| (k as f64 + 0.5) / per_side as f64);
                let jet = surface.leaf_jet(leaf, local[0], local[1]);
                let normal = jet.normal().unwrap_or_default();
                (jet.point.is_finite() && normal.is_finite())
                    .then(|| ((jet.point, normal), space.parameters(leaf, local)))
            })
        };
        let leaves = (0..space.leaves().len()).into_par_iter().with_min_len(256);
        let (places, parameters): (Vec<(DVec3, DVec3)>, Vec<[f64; 2]>) =
            leaves.flat_map_iter(of_leaf).unzip();
        let (samples, normals): (Vec<DVec3>, Vec<DVec3>) = places.into_iter().unzip();
        if samples.is_empty() {
            return Err(Error::undetermined("the surface has no usable sample"));
        }
        let unusable = |e| Error::undetermined(format!("the surface samples cannot be searched: {e:?}"));
        let layer = || Raster::from_layer(&samples, &normals).filter(|_| space.shape() == Some(Shape::Sheet));
        let tree = if normal_scale > 0.0 {
            let with_normals = samples.iter().zip(&normals).map(|(p, n)| {
                let n = normal_scale * *n;
                [p[0], p[1], p[2], n[0], n[1], n[2]]
            });
            let with_normals: Vec<[f64; 6]> = with_normals.collect();
            SampleTree::WithNormals(ImmutableKdTree::new_from_slice(&with_normals).map_err(unusable)?)
        } else if let Some(raster) = layer() {
            SampleTree::Raster(raster)
        } else {
            SampleTree::Positions(ImmutableKdTree::new_from_slice(as_arrays(&samples)).map_err(unusable)?)
        };
        Ok(Self { tree, parameters, normal_scale })
    }

    /// Parameters of the sample nearest to a point with this normal (zero if unknown). For a sheet of one
    /// layer, of the nearest sample along the mean normal, without regard to the normal.
    #[must_use]
    pub fn nearest(&self, z: DVec3, normal: DVec3) -> [f64; 2] {
        let item = match &self.tree {
            SampleTree::Raster(raster) => return self.parameters[raster.sample[raster.cell(z)] as usize],
            SampleTree::Positions(tree) => {
                tree.query(&z.to_array()).nearest_one::<SquaredEuclidean<f64>>().execute().item
            }
            SampleTree::WithNormals(tree) => {
                let n = self.normal_scale * normal;
                let query = [z[0], z[1], z[2], n[0], n[1], n[2]];
                tree.query(&query).nearest_one::<SquaredEuclidean<f64>>().execute().item
            }
        };
        self.parameters[item as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::BaseShape;
    use planish_core::SymmetricMatrix3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn projections_onto_a_sphere_point_to_its_centre_poles_included() {
        let sphere = BaseShape::sphere(DVec3::ZERO, 1.0, DVec3::Z).surface([32, 16]).unwrap();
        let search = FootPointSearch::new(&sphere, 2, 0.5).unwrap();
        for n in 0..500 {
            let z = 1.0 - 2.0 * (n as f64 + 0.5) / 500.0;
            let a = n as f64 * 2.399_963;
            let r = 1.0_f64 - z * z;
            let p = 1.1 * DVec3::new(r.sqrt() * a.cos(), r.sqrt() * a.sin(), z);
            let foot = sphere.project(p, search.nearest(p, 1.0 / 1.1 * p), &ProjectionOptions::default());
            assert!(foot.converged && (foot.height - 0.1).abs() < 1e-4 && foot.slip < 1e-4, "{p:?} {foot:?}");
        }
    }

    /// Curvature biases naive foot points by about `H σ_t²`: 0.25 % of the radius for σ = 5 % of it.
    #[test]
    fn tangential_noise_on_a_sphere_causes_no_bias_after_correction() {
        let sigma = 0.05;
        let sphere = BaseShape::sphere(DVec3::ZERO, 1.0, DVec3::Z).surface([32, 16]).unwrap();
        let search = FootPointSearch::new(&sphere, 2, 0.0).unwrap();
        let options = ProjectionOptions::default();
        let covariance = SymmetricMatrix3::isotropic(sigma * sigma);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut naive, mut corrected) = (0.0, 0.0);
        let count = 60_000;
        for n in 0..count {
            let z = 1.0 - 2.0 * (f64::from(n) + 0.5) / f64::from(count);
            let (r, a) = (f64::sqrt(1.0 - z * z), f64::from(n) * 2.399_963);
            let p = DVec3::new(r * a.cos(), r * a.sin(), z)
                .map(|x| x + sigma * Distribution::<f64>::sample(&StandardNormal, &mut rng));
            let foot = sphere.project(p, search.nearest(p, DVec3::ZERO), &options);
            naive += foot.height / f64::from(count);
            corrected += (foot.height + foot.jet.tangential_bias(&covariance).unwrap()) / f64::from(count);
        }
        let standard_error = sigma / f64::from(count).sqrt();
        assert!((naive - sigma * sigma).abs() < 4.0 * standard_error, "{naive}");
        assert!(
            naive > 10.0 * standard_error && corrected.abs() < 4.0 * standard_error,
            "{naive} {corrected}"
        );
    }

    #[test]
    fn the_raster_of_a_single_layer_finds_samples_as_near_as_a_tree() {
        // Waves on a tilted plane, whose corners do not fill the raster: some cells have no sample of their
        // own.
        let along = [DVec3::new(0.8, 0.0, 0.6), DVec3::Y];
        let plane =
            BaseShape::plane(DVec3::new(100.0, -50.0, 7.0), along, [2.0, 1.0]).surface([16, 8]).unwrap();
        let vertices = (plane.vertices().iter())
            .map(|p| DVec3::new(p.x, p.y + 0.3 * p.x, p.z + 0.02 * (5.0 * p.y).sin()))
            .collect();
        let sheet = Surface::new(std::sync::Arc::clone(plane.space()), vertices).unwrap();
        let search = FootPointSearch::new(&sheet, 2, 0.0).unwrap();
        assert!(matches!(search.tree, SampleTree::Raster(_)));
        for n in 0..2_000 {
            let [u, v] =
                [(f64::from(n) * 0.618_034).fract() * 16.0, (f64::from(n) * 0.754_878).fract() * 8.0];
            let jet = sheet.jet(u, v);
            let normal = jet.normal().unwrap();
            let height = 0.05 * f64::from(n % 7 - 3);
            let p = jet.point + height * normal;
            let start = search.nearest(p, DVec3::ZERO);
            assert!((start[0] - u).abs() < 2.0 && (start[1] - v).abs() < 2.0, "{start:?} {u} {v}");
            let foot = sheet.project(p, start, &ProjectionOptions::default());
            assert!(foot.converged && (foot.height - height).abs() < 1e-5, "{foot:?}");
        }
        // Far outside, the nearest cell is used.
        let foot = sheet.project(
            DVec3::new(1e3, 1e3, 0.0),
            search.nearest(DVec3::new(1e3, 1e3, 0.0), DVec3::ZERO),
            &ProjectionOptions::default(),
        );
        assert!(foot.at_border);
    }

    #[test]
    fn a_rolled_up_sheet_is_not_a_single_layer() {
        let space = std::sync::Arc::new(crate::Hierarchy::uniform(Shape::Sheet, [16, 8]).unwrap());
        let rolled =
            crate::base::fit_function(&space, |u, v| DVec3::new((0.3 * u).cos(), (0.3 * u).sin(), v))
                .unwrap();
        let search = FootPointSearch::new(&rolled, 2, 0.0).unwrap();
        assert!(matches!(search.tree, SampleTree::Positions(_)));
    }

    #[test]
    fn foot_points_of_points_beyond_an_open_border_stay_on_it() {
        let sheet = BaseShape::plane(DVec3::ZERO, [DVec3::X, DVec3::Y], [1.0, 1.0]).surface([4, 4]).unwrap();
        let foot = sheet.project(DVec3::new(1.4, 0.3, 0.1), [2.0, 2.0], &ProjectionOptions::default());
        assert!(
            foot.at_border
                && (foot.jet.point[0] - 1.0).abs() < 1e-9
                && (foot.jet.point[1] - 0.3).abs() < 1e-6
        );
        assert!((foot.slip - 0.4).abs() < 1e-6);
    }
}
