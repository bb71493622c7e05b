//! The field of an implicit shell: metaballs on every facet of a mesh, and a smooth distance from the mesh.
//!
//! In: any triangle mesh, open or closed, manifold or not. Out: at a point the paper's field, a distance, and
//! its derivatives by the point and by the vertices of the mesh.
//!
//! Facet `i` has a skeleton at distance `r_i(x)`: itself (triangular metaballs), or the centre of the
//! smallest circle around it (spherical ones, [`crate::skeleton`]). C eq. 8:
//! `F(x) = T − Σ_i exp(−k (r_i(x) − ρ_i))`, with `ρ_i` the circle's radius or the one thickness `d0`. The
//! shell `F = 0` has two sheets, one on either side of the mesh, at `d0 − ln(T)/k` of a facet, and bulges by
//! up to `ln(n)/k` where `n` metaballs overlap. In the mesh the sum is flat, just where fits need a slope.
//!
//! Fits need the distance from the mesh itself. [`Shell::distance`] is therefore the mean height over the
//! facets, weighted by their metaballs:
//!
//! `D(x) = Σ_i p_i n_i·(x − y_i)`, `p_i ∝ A_i exp(−k r_i)`,
//!
//! with `y_i` the nearest point of the skeleton and `A_i` the area of the facet of a sphere (one for
//! triangles). It has a sign, no thickness and no bulge. On a plane it is exact at any `k`, and elsewhere it
//! converges as `k` grows. Normals opposite to that of the nearest facet are flipped, because meshes need not
//! be oriented.
//!
//! Terms below `exp(−reach)` of the largest are ignored; together they are less than `n · exp(−reach)` of the
//! sum (A. Madan, D. Levin 2022). Exponents are relative to the largest, so that nothing underflows or
//! overflows.
//!
//! Not guaranteed: derivatives where two facets of a thin part are equally near (the sign flips there), where
//! a facet is cut off, or, for spherical metaballs, at facets with a right angle. Outside the boundary of an
//! open mesh `D` is the height over the planes of the boundary facets.

mod derivatives;
mod subdivision;

pub use subdivision::subdivide_for_spheres;

use crate::skeleton::{Skeleton, skeleton};
use nalgebra::Vector3;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{FacetTree, NearFacet, TriangleMesh, distinct_triangles};
use rayon::prelude::*;

/// Default share of the sum that may be ignored. Smaller shares visit more facets per point.
const DEFAULT_TRUNCATION: f64 = 1e-6;
/// Cosine to the nearest facet's normal below which a normal is flipped. An angle above 120° is more often an
/// inconsistently oriented facet than a sharp edge.
const FLIPPED_COSINE: f64 = -0.5;

/// The skeleton of a metaball.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Metaball {
    /// The centre of each facet: fast and smooth, for small facets of similar size.
    Spherical,
    /// The whole facet: for any mesh.
    Triangular,
}

/// Options of a [`Shell`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShellOptions {
    /// What the metaballs are built around.
    pub metaball: Metaball,
    /// Decay rate `k` of the field, in one over the unit.
    pub sharpness: f64,
    /// Thickness `d0` of triangular metaballs.
    pub thickness: f64,
    /// Value `T` of the field on the shell.
    pub threshold: f64,
    /// Terms below `exp(−reach)` of the largest are ignored (default: such that all ignored terms are less
    /// than a millionth of the sum).
    pub reach: Option<f64>,
    /// True for meshes with consistent orientation: normals are used as they are, the two walls of a thin
    /// part stay apart, and `D` is negative inside. Otherwise normals opposite to that of the nearest facet
    /// are flipped.
    pub oriented: bool,
}

impl ShellOptions {
    /// A shell of sharpness `k` with the paper's threshold of one.
    #[must_use]
    pub fn new(metaball: Metaball, sharpness: f64) -> Self {
        Self { metaball, sharpness, thickness: 0.0, threshold: 1.0, reach: None, oriented: false }
    }
}

/// A facet's plane.
#[derive(Debug, Clone, Copy)]
struct Facet {
    normal: DVec3,
    area: f64,
}

/// A mesh wrapped in metaballs.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::icosphere;
/// use planish_shell::{Metaball, Shell, ShellOptions};
/// let ball = icosphere(10.0, 4);
/// let shell = Shell::new(&ball, &ShellOptions::new(Metaball::Triangular, 20.0))?;
/// let near = shell.distance(12.0 * DVec3::Z, &mut Vec::new()).expect("the point is finite");
/// assert!((near.distance - 2.0).abs() < 0.1 && near.gradient[2] > 0.99);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Shell<'a> {
    mesh: &'a TriangleMesh,
    tree: FacetTree,
    options: ShellOptions,
    facets: Vec<Facet>,
    /// The skeletons of spherical metaballs; empty for triangular ones, whose skeletons are the facets.
    skeletons: Vec<Skeleton>,
    /// Maximum distance of a facet beyond that of the nearest one.
    slack: f64,
    /// The same for the paper's field, whose spheres have individual radii.
    paper_slack: f64,
}

/// The smooth distance of a point from the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShellDistance {
    /// The distance `D` by the field, in the unit of the mesh.
    pub distance: f64,
    /// `∂D/∂x`.
    pub gradient: DVec3,
    /// The nearest facet.
    pub facet: u32,
    /// The distance of its skeleton.
    pub nearest: f64,
}

/// The contribution of one facet to a distance, from which derivatives are computed.
#[derive(Debug, Clone, Copy)]
pub struct FacetShare {
    near: NearFacet,
    /// The weight `p_i` among all facets near the point.
    share: f64,
}

/// Sums for a distance and its gradient, weighted by the shares `p_i`.
#[derive(Default)]
struct Sums {
    share: f64,
    height: f64,
    normal: Vector3<f64>,
    away: Vector3<f64>,
    away_by_height: Vector3<f64>,
}

impl Sums {
    #[inline]
    fn add(&mut self, at: DVec3, one: &FacetShare, (height, normal): (f64, Vector3<f64>)) {
        let p = one.share;
        let away = p * away(at, &one.near);
        self.share += p;
        self.height += p * height;
        self.normal += p * normal;
        self.away += away;
        self.away_by_height += height * away;
    }
}

/// The position of a point relative to the plane of a facet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FacetHeight {
    /// Height along `normal`.
    pub height: f64,
    pub normal: DVec3,
    /// Distance of the foot point from the skeleton, in the plane.
    pub across: f64,
    /// The facet's area.
    pub area: f64,
}

impl<'a> Shell<'a> {
    /// Wraps a mesh. Cost: O(n log n), a few milliseconds for 20 000 facets.
    ///
    /// # Errors
    /// `Undetermined` for a mesh without triangles; `Input` for a mesh that fails
    /// [`TriangleMesh::sanity_check`], or invalid options.
    pub fn new(mesh: &'a TriangleMesh, options: &ShellOptions) -> Result<Self> {
        mesh.sanity_check()?;
        if mesh.triangles.is_empty() {
            return Err(Error::undetermined("expected a mesh with faces for a shell, found none"));
        }
        let positive = [
            ("sharpness", options.sharpness),
            ("threshold", options.threshold),
            ("reach", options.reach.unwrap_or(1.0)),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::input(format!("expected a {name} of a shell above 0, found {value}")));
            }
        }
        if !options.thickness.is_finite() || options.thickness < 0.0 {
            return Err(Error::input(format!(
                "expected a thickness of a shell of at least 0, found {}",
                options.thickness
            )));
        }
        let count = mesh.triangles.len();
        let facets: Vec<Facet> = (0..count)
            .into_par_iter()
            .map(|t| {
                let corners = mesh.corners(t);
                let m = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                let twice = m.length();
                Facet { normal: if twice > 0.0 { 1.0 / twice * m } else { DVec3::ZERO }, area: 0.5 * twice }
            })
            .collect();
        let skeletons: Vec<Skeleton> = match options.metaball {
            Metaball::Triangular => Vec::new(),
            Metaball::Spherical => (0..count).into_par_iter().map(|t| skeleton(&mesh.corners(t))).collect(),
        };
        let total: f64 = facets.iter().map(|facet| facet.area).sum();
        if total.is_nan() || total <= 0.0 {
            return Err(Error::undetermined("expected facets with an area for a shell, found none"));
        }
        // Copies of a facet would weigh it more than its neighbours.
        let tree = FacetTree::of_some(&distinct_triangles(&mesh.triangles), |t| match skeletons.get(t) {
            None => mesh.corners(t),
            Some(skeleton) => [skeleton.center; 3],
        });
        let smallest = (facets.iter().map(|f| f.area).filter(|a| *a > 0.0)).fold(f64::INFINITY, f64::min);
        // The weights of spheres are areas, and the nearest facet may be the smallest.
        let others = match options.metaball {
            Metaball::Triangular => count as f64,
            Metaball::Spherical => total / smallest,
        };
        // A far sphere with a large radius can contribute more than a near small one, so the range of radii
        // is added.
        let (smallest_radius, largest_radius) = (skeletons.iter().map(|s| s.radius))
            .fold((f64::INFINITY, 0.0_f64), |(smallest_radius, largest_radius), r| {
                (smallest_radius.min(r), largest_radius.max(r))
            });
        let reach = |others: f64| options.reach.unwrap_or_else(|| (others / DEFAULT_TRUNCATION).ln());
        Ok(Self {
            mesh,
            tree,
            options: *options,
            slack: reach(others) / options.sharpness,
            paper_slack: reach(count as f64) / options.sharpness
                + (largest_radius - smallest_radius).max(0.0),
            facets,
            skeletons,
        })
    }

    /// The paper's field `F = T − Σ exp(−k (r − ρ))`: negative inside of the shell, `T` far away. Overflows
    /// to `−∞` deep inside of very sharp shells.
    #[must_use]
    pub fn field(&self, at: DVec3) -> f64 {
        let k = self.options.sharpness;
        let mut sum = 0.0;
        self.tree.visit_near(at, self.paper_slack, |near| {
            let radius =
                (self.skeletons.get(near.facet as usize)).map_or(self.options.thickness, |s| s.radius);
            sum += (-k * (near.distance - radius)).exp();
        });
        self.options.threshold - sum
    }

    /// The field as a distance, `(ln T − ln Σ exp(−k (r − ρ)))/k`: negative inside, zero where
    /// [`Self::field`] is, with a slope of at most one. Exponents are relative to the largest, so it does not
    /// overflow.
    #[must_use]
    pub fn level(&self, at: DVec3) -> f64 {
        let k = self.options.sharpness;
        let (mut largest, mut sum) = (f64::NEG_INFINITY, 0.0);
        self.tree.visit_near(at, self.paper_slack, |near| {
            let radius =
                (self.skeletons.get(near.facet as usize)).map_or(self.options.thickness, |s| s.radius);
            let exponent = -k * (near.distance - radius);
            // The sum is rescaled when a larger term arrives: one pass, without overflow at any sharpness.
            if exponent > largest {
                sum = sum * (largest - exponent).exp() + 1.0;
                largest = exponent;
            } else {
                sum += (exponent - largest).exp();
            }
        });
        (self.options.threshold.ln() - largest - sum.ln()) / k
    }

    /// The smooth distance from the mesh without a sign: the mean distance of the skeletons, weighted as in
    /// [`Self::distance`]. It exceeds the distance of the nearest by at most `reach/k`.
    #[must_use]
    pub fn unsigned_distance(&self, at: DVec3) -> f64 {
        let k = self.options.sharpness;
        let (mut nearest, mut sum, mut heights) = (f64::INFINITY, 0.0, 0.0);
        self.tree.visit_near(at, self.slack, |near| {
            let weight = self.weight(near.facet);
            if near.distance < nearest {
                // Terms are relative to the nearest facet so far; when a nearer one arrives, the sums are
                // rescaled.
                let factor = (-k * (nearest - near.distance)).exp();
                (sum, heights) = (sum * factor, heights * factor);
                nearest = near.distance;
            }
            let share = weight * (-k * (near.distance - nearest)).exp();
            sum += share;
            heights += share * near.distance;
        });
        if sum > 0.0 { heights / sum } else { nearest }
    }

    /// The distance of the nearest skeleton.
    pub(crate) fn nearest(&self, at: DVec3) -> f64 {
        let mut nearest = f64::INFINITY;
        (self.tree).visit_near(at, 0.0, |near| nearest = nearest.min(near.distance));
        nearest
    }

    /// The minimum and maximum distance of the nearest skeleton on the shell. They follow because the sum is
    /// at least its largest term, and at most the number of facets times that term.
    pub(crate) fn band(&self) -> [f64; 2] {
        let k = self.options.sharpness;
        let radii = || self.skeletons.iter().map(|s| s.radius);
        let [low, high] = if self.skeletons.is_empty() {
            [self.options.thickness; 2]
        } else {
            [radii().fold(f64::INFINITY, f64::min), radii().fold(0.0, f64::max)]
        };
        let inner = -self.options.threshold.ln() / k;
        [low + inner, high + inner + (self.facets.len() as f64).ln() / k]
    }

    /// The mesh that is wrapped.
    #[must_use]
    pub fn mesh(&self) -> &TriangleMesh {
        self.mesh
    }

    /// The smooth signed distance of a point from the mesh; `None` if the point is not finite. It fills
    /// `shares` with the contributions of facets for [`Self::by_vertices`].
    pub fn distance(&self, at: DVec3, shares: &mut Vec<FacetShare>) -> Option<ShellDistance> {
        let k = self.options.sharpness;
        shares.clear();
        let mut nearest: Option<NearFacet> = None;
        self.tree.visit_near(at, self.slack, |near| {
            // Ties go by index. The orientation follows the nearest facet and must not depend on the order of
            // the tree.
            let nearer = |best: &NearFacet| (near.distance, near.facet) < (best.distance, best.facet);
            if nearest.as_ref().is_none_or(nearer) {
                nearest = Some(*near);
            }
            shares.push(FacetShare { near: *near, share: 0.0 });
        });
        let nearest = nearest?;
        // The tree may visit facets that are too far before it finds the nearest.
        shares.retain(|one| one.near.distance <= nearest.distance + self.slack);
        let facing = Vector3::from(self.facets[nearest.facet as usize].normal);
        let mut sums = Sums::default();
        for one in shares.iter_mut() {
            one.share = (-k * (one.near.distance - nearest.distance)).exp() * self.weight(one.near.facet);
            sums.add(at, one, self.height(at, &one.near, facing));
        }
        if sums.share > 0.0 {
            shares.iter_mut().for_each(|one| one.share /= sums.share);
        } else {
            // All weights vanish if only degenerate facets are near: then the nearest one is used alone.
            let alone = FacetShare { near: nearest, share: 1.0 };
            shares.clear();
            shares.push(alone);
            sums = Sums::default();
            sums.add(at, &alone, self.height(at, &nearest, facing));
        }
        let mean = sums.height / sums.share;
        // The second term is the change of the weights. It vanishes on a plane, where all heights are equal.
        let gradient = sums.normal - k * (sums.away_by_height - mean * sums.away);
        Some(ShellDistance {
            distance: mean,
            gradient: (gradient / sums.share).into(),
            facet: nearest.facet,
            nearest: nearest.distance,
        })
    }

    fn weight(&self, facet: u32) -> f64 {
        let area = self.facets[facet as usize].area;
        match self.options.metaball {
            Metaball::Spherical => area,
            // A facet without area has no plane.
            Metaball::Triangular => f64::from(u8::from(area > 0.0)),
        }
    }

    /// Height of a point over a facet's plane, and the plane's normal, flipped if it faces away.
    fn height(&self, at: DVec3, near: &NearFacet, facing: Vector3<f64>) -> (f64, Vector3<f64>) {
        let normal = Vector3::from(self.facets[near.facet as usize].normal);
        // Opposite walls of a thin part face away from each other. Without consistent orientation only a
        // normal that opposes the nearest facet's is flipped.
        let turned =
            if !self.options.oriented && normal.dot(&facing) < FLIPPED_COSINE { -normal } else { normal };
        (turned.dot(&Vector3::from(at - near.point)), turned)
    }
}

/// The direction from a skeleton to a place; zero on it.
fn away(at: DVec3, near: &NearFacet) -> Vector3<f64> {
    if near.distance > 0.0 { Vector3::from(at - near.point) / near.distance } else { Vector3::zeros() }
}

#[cfg(test)]
mod tests;
