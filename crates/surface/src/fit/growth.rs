//! Growth of a ball into the solid that the points enclose.
//!
//! Input: a base ball and the [`Indicator`]. Output: a surface near the points everywhere.
//!
//! The surface follows the level set of the indicator from strong to weak blur. Details such as ears appear
//! as bumps and lengthen. Four terms form one *step* `d`:
//! - a motion along the normal to the level set, where the surface faces it;
//! - a motion down the gradient instead, for a piece that was turned inside out;
//! - a motion by mean curvature for a film outside the solid, as between two ears, so that it retracts like a
//!   soap film;
//! - a drift of vertices along the surface towards where it is stretched most, which keeps cells even.
//!
//! The step, not the surface, is smoothed: `(M + ℓ⁴ K) δ = M d` in the metric of the base. Smooth steps
//! compose to a smooth map, and thin features are not shrunk. The matrix is the same for every step of a
//! level: it is factored once.
//!
//! Not guaranteed: shapes with handles. A ball cannot follow them and leaves films across.

use super::indicator::{BlurredIndicator, Indicator, MIN_BLUR_CELLS};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_spline::{BaseShape, FieldPoints, Surface, SurfaceSystem};
use rayon::prelude::*;
use std::sync::Arc;

/// Largest number of uniform refinements of the base grid.
///
/// At 112 × 72 cells the ears of a 150 mm bunny grow without folds; at 56 × 36 they do not.
pub(super) const MAX_LEVELS: usize = 3;
/// Strongest blur, as a share of the largest half extent, and the factor from one blur to the next. The first
/// level set has to be so round that a ball reaches it without folds. A factor nearer to 1 costs more stages;
/// a smaller one moves the level set farther than a few steps can follow.
const FIRST_BLUR: f64 = 0.25;
const BLUR_FACTOR: f64 = 0.8;
/// Offset of the level into the solid at the strongest blur, as a share of the difference
/// between the indicator inside and at the points. Without it thin gaps would close.
const INWARD_SHARE: f64 = 0.3;
/// Smoothing length of a step, longest step, drift (squared) and retraction of films (squared), all in cells
/// of the base.
const SMOOTHING_CELLS: f64 = 0.6;
const MAX_STEP_CELLS: f64 = 0.3;
const MAX_DRIFT: f64 = 0.12;
const RETRACTION: f64 = 4.0;
/// Minimum and maximum number of steps of a stage. A stage ends early if no vertex moves by more than 5 % of
/// a cell.
const MIN_STEPS: usize = 8;
const MAX_STEPS: usize = 36;
/// Stretch changes slowly: it is measured anew after this many steps.
const STRETCH_EVERY: usize = 4;

/// Grows the base into the indicator's solid, with `levels` uniform refinements on the way. `points` define
/// the level of the indicator.
///
/// # Errors
/// `Undetermined` if the surface degenerates; what `check` returns.
pub(super) fn grow(
    base: &BaseShape,
    grid: [usize; 2],
    levels: usize,
    points: &[DVec3],
    indicator: &Indicator,
    check: &dyn Fn(f64) -> Result<()>,
) -> Result<Surface> {
    let largest = base.size.iter().fold(0.0_f64, |a, &b| a.max(b));
    // With a last blur of 1.2 cells thin ear tips of the bunny end 6 mm short; with 0.7 a film stays between
    // its ears.
    let last = MIN_BLUR_CELLS * indicator.cell();
    let mut blurs = vec![FIRST_BLUR * largest];
    // A stage within 10 % of the last blur would only repeat it.
    while blurs[blurs.len() - 1] * BLUR_FACTOR > 1.1 * last {
        blurs.push(blurs[blurs.len() - 1] * BLUR_FACTOR);
    }
    blurs.push(last);
    let mut surface = base.surface(grid)?;
    let mut reference = surface.clone();
    let mut level = 0;
    let mut stage_of_level = Stage::new(&surface, &reference, base, grid, level)?;
    for (stage, &sigma) in blurs.iter().enumerate() {
        // Levels are spread over the stages, with the last ones left for the finest grid.
        let wanted = (((stage + 1) * levels) / (blurs.len() - 3).max(1)).min(levels);
        while level < wanted {
            let finer = Arc::new(surface.space().refine_all());
            surface = surface.refined(Arc::clone(&finer))?;
            // The reference is refined along, because steps are smoothed in its metric at every level.
            reference = reference.refined(finer)?;
            level += 1;
            stage_of_level = Stage::new(&surface, &reference, base, grid, level)?;
        }
        let field = indicator.blurred(sigma);
        let median = field.level(points);
        let left = 1.0 - stage as f64 / (blurs.len() - 1) as f64;
        let target = Target {
            iso: median + INWARD_SHARE * left * (field.inside() - median),
            steep: field.steepness(points),
            field,
        };
        let mut stretch = Vec::new();
        for step in 0..MAX_STEPS {
            check((stage as f64 + step as f64 / MAX_STEPS as f64) / blurs.len() as f64)?;
            if step % STRETCH_EVERY == 0 {
                stretch = stage_of_level.stretch(&surface)?;
            }
            let moved = stage_of_level.step(&surface, &stretch, &target)?;
            let longest =
                moved.chunks_exact(3).map(|d| DVec3::new(d[0], d[1], d[2]).length()).fold(0.0, f64::max);
            let vertices = surface
                .vertices()
                .iter()
                .zip(moved.chunks_exact(3))
                .map(|(p, d)| *p + DVec3::new(d[0], d[1], d[2]));
            surface = surface.with_vertices(vertices.collect())?;
            if step + 1 >= MIN_STEPS && longest < 0.05 * stage_of_level.cell {
                break;
            }
        }
    }
    Ok(surface)
}

/// The level set that the surface grows to.
struct Target {
    field: BlurredIndicator,
    iso: f64,
    steep: f64,
}

/// The equations of one level: the same for all of its steps.
struct Stage {
    system: SurfaceSystem,
    factor: planish_estimate::sparse::CholeskyFactor,
    /// Points of a leaf at which steps are evaluated. The middle alone would be cheaper, but shortens thin
    /// parts of scans with gaps.
    points: FieldPoints,
    /// Area of the base that each point stands for.
    weights: Vec<[f64; FieldPoints::COUNT]>,
    side: f64,
    cell: f64,
}

impl Stage {
    fn new(
        surface: &Surface,
        reference: &Surface,
        base: &BaseShape,
        grid: [usize; 2],
        level: usize,
    ) -> Result<Self> {
        let system = SurfaceSystem::new(surface.space())?;
        let cell = std::f64::consts::TAU * (base.size[0] * base.size[1]).sqrt() / (grid[0] << level) as f64;
        let mut matrix = system.mass(reference)?;
        matrix.add_scaled(&system.thin_plate(reference)?, (SMOOTHING_CELLS * cell).powi(4))?;
        let factor = system.factorize_scalar(&matrix)?;
        let points = FieldPoints::default();
        let weights = system.field_weights(&points, reference);
        Ok(Self { system, factor, points, weights, side: surface.space().leaves()[0].side(), cell })
    }

    /// Derivatives along u and v, at the points, of the smoothed logarithm of the stretch against the base.
    fn stretch(&self, surface: &Surface) -> Result<Vec<[[f64; 2]; FieldPoints::COUNT]>> {
        let share = self.side * self.side / FieldPoints::COUNT as f64;
        // The logarithm makes stretch and compression symmetric.
        let mut field = self.system.project_field(&self.points, &self.weights, |leaf| {
            let mut values = [DVec3::ZERO; FieldPoints::COUNT];
            let frames = self.points.frames(surface.leaf_coefficients(leaf), self.side);
            for ((value, [_, du, dv]), weight) in values.iter_mut().zip(frames).zip(&self.weights[leaf]) {
                // The bounds keep the logarithm finite on a collapsed leaf.
                let base = (weight / share).max(1e-300);
                value[0] = (du.cross(dv).length() / base).max(1e-6).ln();
            }
            values
        });
        self.factor.solve_in_place(&mut field)?;
        let smooth = self.system.surface(&field)?;
        Ok((0..surface.space().leaves().len())
            .into_par_iter()
            .with_min_len(64)
            .map(|leaf| {
                self.points
                    .frames(smooth.leaf_coefficients(leaf), self.side)
                    .map(|[_, along_u, along_v]| [along_u[0], along_v[0]])
            })
            .collect())
    }

    /// The smoothed step of every node.
    fn step(
        &self,
        surface: &Surface,
        stretch: &[[[f64; 2]; FieldPoints::COUNT]],
        target: &Target,
    ) -> Result<Vec<f64>> {
        let mut step = self.system.project_field(&self.points, &self.weights, |leaf| {
            let frames = self.points.frames(surface.leaf_coefficients(leaf), self.side);
            let mean_curvature = |n| {
                let [s, t] = self.points.local(n);
                surface.leaf_jet(leaf, s, t).mean_curvature()
            };
            std::array::from_fn(|n| self.step_at(frames[n], stretch[leaf][n], target, || mean_curvature(n)))
        });
        self.factor.solve_in_place(&mut step)?;
        Ok(step)
    }

    /// The step at a point with its tangents, before smoothing.
    #[inline]
    fn step_at(
        &self,
        [point, du, dv]: [DVec3; 3],
        stretch: [f64; 2],
        target: &Target,
        mean_curvature: impl Fn() -> Option<f64>,
    ) -> DVec3 {
        let cell = self.cell;
        let longest = MAX_STEP_CELLS * cell;
        let Some(normal) = du.cross(dv).try_normalize() else {
            return DVec3::ZERO;
        };
        let (value, gradient) = target.field.sample(point);
        let slope = gradient.length();
        let (mut d, mut facing) = (DVec3::ZERO, 0.0);
        if slope > 0.0 {
            let downhill = -1.0 / slope * gradient;
            facing = downhill.dot(normal);
            let height = ((value - target.iso) / slope).clamp(-longest, longest);
            // The two motions blend over a cosine from −0.1 to 0.1: a sudden change would tear the step.
            let along_normal = (5.0 * (facing + 0.1)).clamp(0.0, 1.0);
            d = along_normal * height * normal + (1.0 - along_normal) * height * downhill;
        }
        // A film is recognised by low values of the indicator on both of its sides.
        // The denominator is the fall of the indicator over half a cell next to the points.
        let outside = ((target.iso - value) / (target.steep * 0.5 * cell)).clamp(0.0, 1.0);
        if outside > 0.0
            && let Some(mean) = mean_curvature()
        {
            let draw = (RETRACTION * cell * cell * mean).clamp(-longest, longest);
            d += outside * draw * normal;
        }
        let strength = MAX_DRIFT * cell * cell * (2.0 * facing).clamp(0.0, 1.0);
        d + drift(du, dv, stretch, strength, longest)
    }
}

/// `strength · ∇_S f` of a field with the derivatives `f` along the tangents `du` and `dv`, no longer than
/// `longest`.
fn drift(du: DVec3, dv: DVec3, f: [f64; 2], strength: f64, longest: f64) -> DVec3 {
    let [e, m, g] = [du.length_squared(), du.dot(dv), dv.length_squared()];
    let area2 = e * g - m * m;
    // Tangents that are nearly parallel define no gradient.
    if area2 <= 1e-12 * (e + g) * (e + g) {
        return DVec3::ZERO;
    }
    let [fu, fv] = f;
    let gradient = (g * fu - m * fv) / area2 * du + (e * fv - m * fu) / area2 * dv;
    let length = strength * gradient.length();
    (strength * if length > longest { longest / length } else { 1.0 }) * gradient
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball with two long horns, which is not star-shaped.
    #[test]
    fn ball_grows_into_a_horned_shape_without_turning_inside_out() {
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        let capsule = |points: &mut Vec<DVec3>,
                       normals: &mut Vec<DVec3>,
                       from: DVec3,
                       to: DVec3,
                       r: f64,
                       count: usize| {
            let axis = to - from;
            let length = axis.length();
            let axis = 1.0 / length * axis;
            let (e1, e2) = planish_core::vector3::tangents(axis);
            for i in 0..count {
                let h = (length + 2.0 * r) * (i as f64 + 0.5) / count as f64 - r;
                let a = i as f64 * 2.399_963_229_728_653;
                let over = if h < 0.0 {
                    h
                } else if h > length {
                    h - length
                } else {
                    0.0
                };
                let ring = (r * r - over * over).max(0.0).sqrt();
                let n = ring / r * (a.cos() * e1 + a.sin() * e2) + over / r * axis;
                points.push(from + (h - over) * axis + r * n);
                normals.push(n);
            }
        };
        capsule(&mut points, &mut normals, DVec3::ZERO, DVec3::new(0.02, 0.0, 0.0), 1.0, 8000);
        capsule(&mut points, &mut normals, DVec3::new(0.4, 0.0, 0.7), DVec3::new(0.9, 0.0, 2.0), 0.22, 2500);
        capsule(
            &mut points,
            &mut normals,
            DVec3::new(-0.4, 0.0, 0.7),
            DVec3::new(-0.9, 0.0, 2.0),
            0.22,
            2500,
        );
        // Points inside another part are not on the surface.
        let inside = |p: &DVec3| {
            let to_segment = |a: DVec3, b: DVec3| {
                let ab = b - a;
                let t = ((*p - a).dot(ab) / ab.length_squared()).clamp(0.0, 1.0);
                (*p - (a + t * ab)).length()
            };
            to_segment(DVec3::ZERO, DVec3::new(0.02, 0.0, 0.0)) < 0.99
                || to_segment(DVec3::new(0.4, 0.0, 0.7), DVec3::new(0.9, 0.0, 2.0)) < 0.21
                || to_segment(DVec3::new(-0.4, 0.0, 0.7), DVec3::new(-0.9, 0.0, 2.0)) < 0.21
        };
        let keep: Vec<bool> = points.iter().map(|p| !inside(p)).collect();
        let mut k = keep.iter();
        points.retain(|_| *k.next().unwrap());
        let mut k = keep.iter();
        normals.retain(|_| *k.next().unwrap());
        let base =
            planish_spline::choose_base_shape(&points, &normals, Some(planish_spline::Shape::Ball)).unwrap();
        let indicator = Indicator::new(&points, &normals);
        let surface = grow(&base, base.grid(128), MAX_LEVELS, &points, &indicator, &|_| Ok(())).unwrap();
        let search = planish_spline::FootPointSearch::new(&surface, 2, 0.3).unwrap();
        let far = points
            .iter()
            .zip(&normals)
            .filter(|(p, n)| {
                let foot = surface.project(
                    **p,
                    search.nearest(**p, **n),
                    &planish_spline::ProjectionOptions::default(),
                );
                foot.height.abs() > 0.15 || foot.normal.dot(**n) < 0.0
            })
            .count();
        assert!(
            far * 100 < points.len(),
            "{far} of {} points have no surface near them that faces their way",
            points.len()
        );
    }
}
