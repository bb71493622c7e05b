//! The true surface of a simulated scene, known exactly at every point.
//!
//! Input: a closed form, or a spline surface that is given, random in a given space, or drawn from a prior.
//! Output: points, normals, curvatures, area-uniform samples, a dense mesh, and distances of nearby points.
//!
//! Not guaranteed: the nearest point of a point whose distance is about the radius of curvature, or that is
//! equally far from two parts of the surface within the resolution of the dense mesh.

use super::form::{ClosedForm, parameters};
use planish_core::DVec3;
use planish_estimate::sparse::CholeskyFactor;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh, icosphere};
use planish_spline::{BaseShape, Curvature, Hierarchy, Jet, ProjectionOptions, Shape, Surface, fit_function};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::sync::{Arc, OnceLock};

/// Number of triangles of the dense mesh from which searches and rays start.
///
/// With more, start values are better and rays near silhouettes are missed less often, but every truth takes
/// longer to prepare. The results hardly depend on it, because Newton's method refines them.
const SEARCH_TRIANGLES: usize = 80_000;

/// A surface that is known exactly, over parameters `(u, v)` in `[0, 1]²`.
#[derive(Debug, Clone)]
pub struct Truth {
    form: Form,
    dense: OnceLock<Dense>,
}

/// The representation of a true surface.
#[derive(Debug, Clone)]
enum Form {
    Closed(ClosedForm),
    Spline(Shape, Surface),
}

/// # Errors
/// `Input` for a space over quads.
fn shape_of(space: &Hierarchy) -> Result<Shape> {
    space.shape().ok_or_else(|| Error::input("expected the space of a sheet, tube, ball or torus"))
}

/// A dense mesh of the surface with the parameters of its vertices.
#[derive(Debug, Clone)]
struct Dense {
    mesh: TriangleMesh,
    parameters: Vec<[f64; 2]>,
    search: MeshSearch,
    /// Largest area element at a vertex, in the measure in which samples are proposed.
    largest_element: f64,
    /// Diagonal of the bounding box.
    diagonal: f64,
}

/// A point of a true surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruthPoint {
    /// Parameters `(u, v)`, if the surface is given over parameters.
    pub parameters: Option<[f64; 2]>,
    /// Position.
    pub position: DVec3,
    /// Outward unit normal; zero where a spline is degenerate.
    pub normal: DVec3,
}

/// The point of the true surface that is nearest to a given point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruthFoot {
    /// Nearest point of the true surface.
    pub point: TruthPoint,
    /// Distance, positive on the side of the normal.
    pub signed_distance: f64,
    /// True if the nearest point is on an open border and the given point lies beyond it.
    pub at_border: bool,
}

impl Truth {
    /// A smooth freeform surface in closed form, about `size` long: a sheet, a tube or a ball.
    ///
    /// # Errors
    /// As [`ClosedForm::random`].
    ///
    /// # Examples
    /// ```
    /// use planish_simulate::Truth;
    /// use planish_spline::Shape;
    /// # fn main() -> planish_estimate::Result<()> {
    /// let ball = Truth::freeform(Shape::Ball, 100.0, 4)?;
    /// // A point 0.5 above the surface has its foot below it.
    /// let (p, n) = (ball.point(0.3, 0.6), ball.normal(0.3, 0.6));
    /// let above = p + 0.5 * n;
    /// let foot = ball.foot(above).expect("the point is finite");
    /// assert!((foot.signed_distance - 0.5).abs() < 1e-9 && !foot.at_border);
    /// # Ok(())
    /// # }
    /// ```
    pub fn freeform(shape: Shape, size: f64, seed: u64) -> Result<Self> {
        Ok(Self::from_form(Form::Closed(ClosedForm::random(shape, size, seed)?)))
    }

    /// A true surface with the given closed form.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_simulate::{BallForm, ClosedForm, Truth};
    /// let form = BallForm { semi_axes: DVec3::new(2.0, 2.0, 1.0), bumps: Vec::new() };
    /// let ellipsoid = Truth::from_closed_form(ClosedForm::Ball(form));
    /// let foot = ellipsoid.foot(DVec3::new(3.0, 0.0, 0.0)).expect("the point is finite");
    /// assert!((foot.signed_distance - 1.0).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn from_closed_form(form: ClosedForm) -> Self {
        Self::from_form(Form::Closed(form))
    }

    /// A random smooth surface of exactly this spline space, about `size` long.
    ///
    /// It is a freeform (for a torus, a round one) fitted on the base grid, with every control vertex moved
    /// by a few per cent of its cell. A fit in the same space can represent it without approximation error.
    ///
    /// # Errors
    /// As [`Truth::freeform`], but a torus is supported.
    pub fn in_space(space: &Arc<Hierarchy>, size: f64, seed: u64) -> Result<Self> {
        let base = Arc::new(space.unrefined());
        let [columns, rows] = base.extent();
        let shape = shape_of(space)?;
        let smooth = if shape == Shape::Torus {
            BaseShape::torus(DVec3::ZERO, DVec3::Z, 0.35 * size, 0.15 * size).surface(space.base())?
        } else {
            let form = ClosedForm::random(shape, size, seed)?;
            fit_function(&base, |u, v| form.jet(u / columns, v / rows).point)?
        };
        let smooth = smooth.refined(Arc::clone(space))?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // The freeform uses stream 0 of the same seed; the displacements must not repeat its numbers.
        rng.set_stream(1);
        let moved = (space.node_anchors().iter().zip(smooth.vertices())).map(|(anchor, vertex)| {
            let [u, v] = space.wrap(anchor[0], anchor[1]);
            let side = space.leaves()[space.locate(u, v).0].side();
            // The cell size is taken along v: at the poles of a ball the derivative with respect to u
            // vanishes.
            let sigma = 0.04 * side * smooth.jet(u, v).dv.length();
            vertex.map(|c| c + sigma * rng.sample::<f64, _>(StandardNormal))
        });
        let moved = moved.collect();
        Ok(Self::from_form(Form::Spline(shape, Surface::new(Arc::clone(space), moved)?)))
    }

    /// A surface whose control vertices are drawn from a Gaussian.
    ///
    /// `x = mean + L⁻ᵀ z` with standard normal `z`, where `factor` is the Cholesky factor `L` of the
    /// information `Λ = L Lᵀ`. A posterior is calibrated for truths that are drawn from its prior.
    ///
    /// # Errors
    /// `Input` if the size of the factor differs from the number of coordinates of `mean`.
    pub fn drawn(mean: &Surface, factor: &CholeskyFactor, seed: u64) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let unknowns = 3 * mean.space().node_count();
        let mut draw: Vec<f64> = (0..unknowns).map(|_| rng.sample(StandardNormal)).collect();
        factor.solve_lower_transpose_in_place(&mut draw)?;
        let moved = mean.vertices().iter().zip(draw.chunks_exact(3));
        let vertices = moved.map(|(p, d)| DVec3::new(p[0] + d[0], p[1] + d[1], p[2] + d[2])).collect();
        let shape = shape_of(mean.space())?;
        Ok(Self::from_form(Form::Spline(shape, Surface::new(Arc::clone(mean.space()), vertices)?)))
    }

    fn from_form(form: Form) -> Self {
        Self { form, dense: OnceLock::new() }
    }

    /// The topology.
    #[must_use]
    pub fn shape(&self) -> Shape {
        match &self.form {
            Form::Closed(form) => form.shape(),
            Form::Spline(shape, _) => *shape,
        }
    }

    /// The closed form, if the surface has one.
    #[must_use]
    pub fn closed_form(&self) -> Option<&ClosedForm> {
        match &self.form {
            Form::Closed(form) => Some(form),
            Form::Spline(..) => None,
        }
    }

    /// The spline surface, if the surface is a spline.
    #[must_use]
    pub fn surface(&self) -> Option<&Surface> {
        match &self.form {
            Form::Closed(_) => None,
            Form::Spline(_, surface) => Some(surface),
        }
    }

    /// The point at `(u, v)`.
    #[must_use]
    pub fn point(&self, u: f64, v: f64) -> DVec3 {
        self.jet(u, v).point
    }

    /// The point at `(u, v)` with its first and second derivatives with respect to u and v.
    #[must_use]
    pub fn jet(&self, u: f64, v: f64) -> Jet {
        match &self.form {
            Form::Closed(form) => form.jet(u, v),
            Form::Spline(_, surface) => {
                let [a, b] = surface.space().extent();
                let jet = surface.jet(u * a, v * b);
                // The spline is parametrised by base cells: the chain rule to [0, 1]².
                let by = |s: f64, d: DVec3| d.map(|c| s * c);
                Jet {
                    point: jet.point,
                    du: by(a, jet.du),
                    dv: by(b, jet.dv),
                    duu: by(a * a, jet.duu),
                    duv: by(a * b, jet.duv),
                    dvv: by(b * b, jet.dvv),
                }
            }
        }
    }

    /// The point and derivatives in a chart that is regular there, poles of a closed form included.
    fn regular_jet(&self, u: f64, v: f64) -> Jet {
        match &self.form {
            Form::Closed(form) => form.regular_jet(u, v),
            Form::Spline(..) => self.jet(u, v),
        }
    }

    /// The outward unit normal; zero where a spline is degenerate.
    #[must_use]
    pub fn normal(&self, u: f64, v: f64) -> DVec3 {
        self.regular_jet(u, v).normal().unwrap_or(DVec3::ZERO)
    }

    /// The area element `|S_u × S_v|`.
    #[must_use]
    pub fn area_element(&self, u: f64, v: f64) -> f64 {
        let jet = self.jet(u, v);
        jet.du.cross(jet.dv).length()
    }

    /// Principal curvatures and directions; `None` where a spline is degenerate.
    #[must_use]
    pub fn curvature(&self, u: f64, v: f64) -> Option<Curvature> {
        self.regular_jet(u, v).curvature()
    }

    /// The point of the surface at these parameters.
    fn at(&self, parameters: [f64; 2]) -> TruthPoint {
        let jet = self.regular_jet(parameters[0], parameters[1]);
        TruthPoint {
            parameters: Some(parameters),
            position: jet.point,
            normal: jet.normal().unwrap_or(DVec3::ZERO),
        }
    }

    /// A mesh of about `triangles` triangles that face outwards, and the exact normals of its vertices.
    ///
    /// The vertices lie on the surface. A ball in closed form is a subdivided icosahedron.
    ///
    /// # Examples
    /// ```
    /// use planish_simulate::Truth;
    /// use planish_spline::Shape;
    /// # fn main() -> planish_estimate::Result<()> {
    /// let (mesh, normals) = Truth::freeform(Shape::Ball, 100.0, 4)?.mesh(6000);
    /// assert_eq!(mesh.positions.len(), normals.len());
    /// assert!(mesh.check().watertight && mesh.triangles.len() <= 6000);
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn mesh(&self, triangles: usize) -> (TriangleMesh, Vec<DVec3>) {
        let (mesh, parameters) = self.mesh_and_parameters(triangles);
        let normals = parameters.iter().map(|&[u, v]| self.normal(u, v)).collect();
        (mesh, normals)
    }

    /// As [`Truth::mesh`], with the parameters of the vertices.
    fn mesh_and_parameters(&self, triangles: usize) -> (TriangleMesh, Vec<[f64; 2]>) {
        if matches!(self.form, Form::Closed(ClosedForm::Ball(_))) {
            // A grid of (u, v) would have slivers at the poles; the icosahedron is uniform.
            let subdivisions = (1..9).take_while(|&k| 20 << (2 * k) <= triangles).last().unwrap_or(1);
            let sphere = icosphere(1.0, subdivisions);
            let parameters: Vec<[f64; 2]> = sphere.positions.iter().map(|&d| parameters(d)).collect();
            return (self.mesh_over(sphere.triangles, &parameters), parameters);
        }
        let (shape, ratio) = match &self.form {
            Form::Closed(ClosedForm::Sheet(form)) => (Shape::Sheet, form.sides[0] / form.sides[1]),
            Form::Closed(ClosedForm::Bent(form)) => (Shape::Sheet, form.sides[0] / form.sides[1]),
            Form::Closed(_) => (Shape::Tube, 1.25),
            Form::Spline(shape, surface) => {
                let [columns, rows] = surface.space().extent();
                (*shape, columns / rows)
            }
        };
        // Two triangles per cell, and cells that are about square.
        let columns = ((0.5 * triangles as f64 * ratio).sqrt() as usize).max(8);
        let rows = (triangles / (2 * columns)).max(4);
        let (around, along) = (shape.periodic_u(), shape.periodic_v());
        // A pole is a single vertex. Both precede all others.
        let (first, inner) =
            if shape.polar() { (2, 1..rows) } else { (0, 0..if along { rows } else { rows + 1 }) };
        let across = if around { columns } else { columns + 1 };
        let mut parameters = if shape.polar() { vec![[0.0, 0.0], [0.0, 1.0]] } else { Vec::new() };
        for j in inner {
            parameters.extend((0..across).map(|i| [i as f64 / columns as f64, j as f64 / rows as f64]));
        }
        let vertex = |i: usize, j: usize| -> u32 {
            if shape.polar() && (j == 0 || j == rows) {
                return u32::from(j == rows);
            }
            let row = if shape.polar() { j - 1 } else { j % if along { rows } else { rows + 1 } };
            (first + row * across + i % across) as u32
        };
        let mut faces = Vec::with_capacity(2 * columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
                // At a pole, one of the two triangles of a cell has two equal corners.
                faces.extend(
                    [[a, b, c], [a, c, d]]
                        .into_iter()
                        .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]),
                );
            }
        }
        (self.mesh_over(faces, &parameters), parameters)
    }

    /// The mesh of these triangles, with vertices at these parameters.
    fn mesh_over(&self, triangles: Vec<[u32; 3]>, parameters: &[[f64; 2]]) -> TriangleMesh {
        TriangleMesh { positions: parameters.iter().map(|&[u, v]| self.point(u, v)).collect(), triangles }
    }

    /// The dense mesh from which searches start; built on first use.
    fn dense(&self) -> &Dense {
        self.dense.get_or_init(|| {
            let triangles = match &self.form {
                Form::Closed(_) => SEARCH_TRIANGLES + 2_000,
                Form::Spline(_, surface) => {
                    (100 * surface.space().leaves().len()).clamp(8_000, SEARCH_TRIANGLES)
                }
            };
            let (mesh, parameters) = self.mesh_and_parameters(triangles);
            let search = MeshSearch::try_new(&mesh).expect("a grid over a finite surface is a valid mesh");
            let largest_element =
                parameters.iter().map(|&[u, v]| self.proposal_element(u, v)).fold(0.0_f64, f64::max);
            let diagonal = mesh.bounding_box().map_or(0.0, |b| b.diagonal());
            Dense { mesh, parameters, search, largest_element, diagonal }
        })
    }

    /// A dense mesh for rays and closest points, with vertices on the surface; built on first use.
    #[must_use]
    pub fn search(&self) -> &MeshSearch {
        &self.dense().search
    }

    /// Area element in the measure in which [`Truth::propose`] is uniform.
    fn proposal_element(&self, u: f64, v: f64) -> f64 {
        let jet = self.regular_jet(u, v);
        jet.du.cross(jet.dv).length()
    }

    /// Random parameters, uniform over the unit sphere for a ball in closed form, else uniform in `(u, v)`.
    ///
    /// Uniform `(u, v)` of a ball crowd at the poles, where rejection would discard nearly all.
    fn propose(&self, rng: &mut impl Rng) -> [f64; 2] {
        let (u, v): (f64, f64) = (rng.random(), rng.random());
        match &self.form {
            Form::Closed(ClosedForm::Ball(_)) => [u, (1.0 - 2.0 * v).acos() / std::f64::consts::PI],
            _ => [u, v],
        }
    }

    /// Independent random points with uniform density per area of the true surface, by rejection.
    ///
    /// Cost: two to four evaluations of derivatives per point.
    ///
    /// # Examples
    /// ```
    /// use planish_simulate::Truth;
    /// use planish_spline::Shape;
    /// use rand::SeedableRng;
    /// use rand_chacha::ChaCha8Rng;
    /// # fn main() -> planish_estimate::Result<()> {
    /// let tube = Truth::freeform(Shape::Tube, 100.0, 4)?;
    /// let points = tube.sample_area_uniform(50, &mut ChaCha8Rng::seed_from_u64(1));
    /// let [u, v] = points[0].parameters.expect("a tube has parameters");
    /// assert_eq!((points.len(), points[0].position), (50, tube.point(u, v)));
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn sample_area_uniform(&self, count: usize, rng: &mut impl Rng) -> Vec<TruthPoint> {
        // Rejection needs an upper bound of the element. The margin covers maxima between vertices.
        let bound = 1.05 * self.dense().largest_element;
        let mut points = Vec::with_capacity(count);
        while points.len() < count {
            let [u, v] = self.propose(rng);
            if rng.random::<f64>() * bound < self.proposal_element(u, v) {
                points.push(self.at([u, v]));
            }
        }
        points
    }

    /// The nearest point of the true surface and the signed distance from it.
    ///
    /// Newton's method refines the nearest point of the dense mesh, to about 1e-12 of the size. `None` only
    /// for a point that is not finite.
    #[must_use]
    pub fn foot(&self, z: DVec3) -> Option<TruthFoot> {
        let dense = self.dense();
        let near = dense.search.closest(z)?;
        // The nearest corner, because parameters cannot be interpolated across a seam or a pole.
        let start = dense.parameters[self.nearest_vertex(near.triangle, near.barycentric)];
        let (point, at_border) = match &self.form {
            Form::Closed(form) => nearest_point(form, z, start),
            Form::Spline(_, surface) => {
                let space = surface.space();
                let [a, b] = space.extent();
                let options = ProjectionOptions { max_steps: 60, relative_tolerance: 1e-12 };
                let foot = surface.project(z, [start[0] * a, start[1] * b], &options);
                let [u, v] = space.parameters(foot.leaf as usize, foot.local);
                let position = foot.jet.point;
                let parameters = Some([u / a, v / b]);
                (TruthPoint { parameters, position, normal: foot.normal }, foot.at_border)
            }
        };
        let offset = z - point.position;
        let signed_distance = offset.length().copysign(offset.dot(point.normal));
        Some(TruthFoot { point, signed_distance, at_border })
    }

    /// The corner of a triangle of the dense mesh with the largest barycentric weight.
    fn nearest_vertex(&self, triangle: u32, barycentric: [f64; 3]) -> usize {
        let k = (0..3).max_by(|&a, &b| barycentric[a].total_cmp(&barycentric[b])).unwrap_or(0);
        self.dense().mesh.triangles[triangle as usize][k] as usize
    }

    /// The first point where a ray meets the true surface from either side, and its distance.
    ///
    /// `direction` is a unit vector. Newton's method refines the first hit of the dense mesh. `None` if the
    /// ray misses the mesh, or if it is so grazing that the refinement fails.
    #[must_use]
    pub fn first_hit(&self, origin: DVec3, direction: DVec3) -> Option<(TruthPoint, f64)> {
        let dense = self.dense();
        let hit = dense.search.first_hit(origin, direction)?;
        let mut at = dense.parameters[self.nearest_vertex(hit.triangle, hit.barycentric)];
        let mut along = hit.distance;
        for _ in 0..30 {
            let jet = self.regular_jet(at[0], at[1]);
            let r = origin + along * direction - jet.point;
            // One Newton step of S(u, v) = o + λ d: S_u s + S_v t − d λ = r, solved by Cramer's rule.
            let normal = jet.du.cross(jet.dv);
            let determinant = -normal.dot(direction);
            // The ray is parallel to the surface within rounding errors.
            if determinant.abs() <= 1e-9 * normal.length() {
                return None;
            }
            let s = -r.cross(jet.dv).dot(direction) / determinant;
            let t = -jet.du.cross(r).dot(direction) / determinant;
            along += normal.dot(r) / determinant;
            at = self.moved(at, [s, t]);
            if self.point(at[0], at[1]).distance(origin + along * direction) <= 1e-12 * (1.0 + along.abs()) {
                let point = self.at(at);
                // The facets deviate from the surface by much less than a thousandth of the size. A larger
                // step along the normal means that Newton's method found another part of the surface.
                let cosine = point.normal.dot(direction).abs().max(0.05);
                return ((along - hit.distance).abs() * cosine <= 1e-3 * dense.diagonal)
                    .then_some((point, along));
            }
        }
        None
    }

    /// Parameters after a step in the regular chart, shortened if it is long.
    fn moved(&self, at: [f64; 2], step: [f64; 2]) -> [f64; 2] {
        // The start is within one facet. A longer step comes from a nearly singular system.
        let longest = step[0].hypot(step[1]);
        let share = if longest > 0.05 { 0.05 / longest } else { 1.0 };
        let step = step.map(|s| share * s);
        match &self.form {
            Form::Closed(form) => form.moved(at, step),
            Form::Spline(_, surface) => {
                let [a, b] = surface.space().extent();
                let [u, v] = surface.space().wrap((at[0] + step[0]) * a, (at[1] + step[1]) * b);
                [u / a, v / b]
            }
        }
    }

    /// Diagonal of the bounding box of the surface.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        self.dense().diagonal
    }
}

/// The nearest point of a closed form to `z`, and whether an open border holds it.
///
/// Damped Newton's method: with the full Hessian where it is positive definite, else Gauss–Newton, whose
/// matrix always gives a descent direction.
fn nearest_point(form: &ClosedForm, z: DVec3, start: [f64; 2]) -> (TruthPoint, bool) {
    let open = match form {
        ClosedForm::Sheet(_) | ClosedForm::Bent(_) => [true, true],
        ClosedForm::Tube(_) => [false, true],
        ClosedForm::Ball(_) => [false, false],
    };
    let mut at = start;
    let mut jet = form.regular_jet(at[0], at[1]);
    let mut held = [false; 2];
    for _ in 0..60 {
        let r = jet.point - z;
        let gradient = [jet.du.dot(r), jet.dv.dot(r)];
        // Active set of the box: at a border with the gradient outwards, the parameter stays there.
        for d in 0..2 {
            held[d] = open[d] && ((at[d] <= 0.0 && gradient[d] > 0.0) || (at[d] >= 1.0 && gradient[d] < 0.0));
        }
        let [e, f, g] = jet.first_form();
        let full = [e + jet.duu.dot(r), f + jet.duv.dot(r), g + jet.dvv.dot(r)];
        // The margin keeps a nearly singular Hessian from giving very long steps.
        let definite = full[0] > 0.0 && full[0] * full[2] - full[1] * full[1] > 0.05 * (e * g - f * f);
        let [a, b, c] = if definite { full } else { [e, f, g] };
        let step = match held {
            [true, true] => break,
            [true, false] => [0.0, -gradient[1] / c],
            [false, true] => [-gradient[0] / a, 0.0],
            [false, false] => {
                let determinant = a * c - b * b;
                [
                    -(c * gradient[0] - b * gradient[1]) / determinant,
                    -(a * gradient[1] - b * gradient[0]) / determinant,
                ]
            }
        };
        // Steps are shortened until the distance does not grow. The tolerance accepts rounding at the
        // minimum.
        let mut share = (0.05 / step[0].hypot(step[1])).min(1.0);
        let mut moved = false;
        for _ in 0..12 {
            let next = form.moved(at, step.map(|s| share * s));
            let next_jet = form.regular_jet(next[0], next[1]);
            if (next_jet.point - z).length() <= r.length() * (1.0 + 1e-15) {
                (at, jet) = (next, next_jet);
                moved = true;
                break;
            }
            share *= 0.4;
        }
        if !moved || share * step[0].hypot(step[1]) < 1e-14 {
            break;
        }
    }
    let normal = jet.normal().unwrap_or(DVec3::ZERO);
    (TruthPoint { parameters: Some(at), position: jet.point, normal }, held[0] || held[1])
}

/// Rejects a value that is not positive and finite; `name` names it in the message.
pub(super) fn positive(name: &str, value: f64) -> Result<f64> {
    if value > 0.0 && value.is_finite() {
        return Ok(value);
    }
    Err(Error::input(format!("expected {name} > 0, found {value}")))
}
