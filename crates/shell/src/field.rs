//! The field of an implicit shell: metaballs on every facet of a mesh, and how far a place is from the mesh
//! by it.
//!
//! Comes in: any triangle mesh, open or closed, manifold or not. Goes out: at a place the paper's field, a
//! distance, and its derivatives by the place and by the mesh's vertices.
//!
//! Facet `i` has a skeleton at distance `r_i(x)`: itself (triangular metaballs), or the centre of the
//! smallest circle around it (spherical ones, [`crate::skeleton`]). C eq. 8:
//! `F(x) = T − Σ_i exp(−k (r_i(x) − ρ_i))`, with `ρ_i` the circle's radius or the one thickness `d0`. The
//! shell `F = 0` has two sheets, one on either side of the mesh, at `d0 − ln(T)/k` of a facet, and bulges by
//! up to `ln(n)/k` where `n` metaballs overlap. In the mesh the sum is flat, just where fits need a slope.
//!
//! Fits want the mesh itself. [`Shell::distance`] is therefore the height over the facets, each weighed with
//! what its metaball gives to the sum:
//!
//! `D(x) = Σ_i p_i n_i·(x − y_i)`, `p_i ∝ A_i exp(−k r_i)`,
//!
//! with `y_i` the nearest point of the skeleton and `A_i` the area that a sphere stands for (one for
//! triangles). It has a sign, no thickness and no bulge: on a plane it is exact at any `k`, and elsewhere as
//! `k` grows. Normals that point the other way than that of the nearest facet are turned, as meshes need not
//! be oriented.
//!
//! Terms less than `exp(−reach)` of the largest are left out: together less than `n · exp(−reach)` of the sum
//! (A. Madan, D. Levin 2022). Exponents are taken from the largest, so that nothing under- or overflows
//! anywhere.
//!
//! Not guaranteed: derivatives where two facets of a thin part are equally near (the sign flips there), where
//! one is cut off, or, of spherical metaballs, of facets with a right angle. Beyond the border of an open
//! mesh `D` is the height over the border's planes.

mod derivatives;
mod subdivision;

pub use subdivision::subdivide_for_spheres;

use crate::skeleton::{Skeleton, skeleton};
use nalgebra::Vector3;
use planish_estimate::vector3::{cross, norm, scale, sub};
use planish_estimate::{Error, Result};
use planish_mesh::{FacetTree, NearFacet, TriangleMesh};
use rayon::prelude::*;

/// The share of the sum that is left out where nothing is said.
const USUAL_ERROR: f64 = 1e-6;
/// Normals with a cosine below this face the other way; sharper edges are rarer than facets that are turned.
const TURNED: f64 = -0.5;

/// What a metaball is built around.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Metaball {
    /// The middle of each facet: cheap and smooth, for small facets of about one size.
    Spherical,
    /// The whole facet: for any mesh.
    Triangular,
}

/// How a mesh is wrapped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShellOptions {
    /// What a metaball is built around.
    pub metaball: Metaball,
    /// `k`, in one over the unit: how fast the field dies away.
    pub sharpness: f64,
    /// `d0`: how thick triangular metaballs are.
    pub thickness: f64,
    /// `T`: the field's value at the shell.
    pub threshold: f64,
    /// Terms less than `exp(−reach)` of the largest are left out; where none is given, those that together
    /// are less than a millionth.
    pub reach: Option<f64>,
    /// Whether normals are taken as they are, so that the two walls of a thin part stay apart and `D` is
    /// negative within: for meshes whose facets are all turned the same way. Elsewhere normals that point the
    /// other way than that of the nearest facet are turned.
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
    normal: [f64; 3],
    area: f64,
}

/// A mesh wrapped in metaballs.
///
/// # Examples
/// ```
/// use planish_mesh::icosphere;
/// use planish_shell::{Metaball, Shell, ShellOptions};
/// let ball = icosphere(10.0, 4);
/// let shell = Shell::new(&ball, &ShellOptions::new(Metaball::Triangular, 20.0))?;
/// let near = shell.distance([0.0, 0.0, 12.0], &mut Vec::new()).expect("a place that is finite");
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
    /// How much farther than the nearest a facet is that still counts.
    slack: f64,
    /// The same for the paper's field, whose spheres have radii of their own.
    paper_slack: f64,
}

/// How far a place is from the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShellDistance {
    /// The distance `D` by the field, in the unit of the mesh.
    pub distance: f64,
    /// `∂D/∂x`.
    pub gradient: [f64; 3],
    /// The nearest facet.
    pub facet: u32,
    /// The distance of its skeleton.
    pub nearest: f64,
}

/// A facet's part in a distance: what its derivatives are made of.
#[derive(Debug, Clone, Copy)]
pub struct FacetShare {
    near: NearFacet,
    /// `p_i`, of all that are near.
    share: f64,
}

/// What a distance and its gradient are made of, each weighed by shares `p_i`.
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
    fn add(&mut self, at: [f64; 3], one: &FacetShare, (height, normal): (f64, Vector3<f64>)) {
        let p = one.share;
        let away = p * away(at, &one.near);
        self.share += p;
        self.height += p * height;
        self.normal += p * normal;
        self.away += away;
        self.away_by_height += height * away;
    }
}

/// A place over the plane of a facet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Over {
    /// How high, along `normal`.
    pub height: f64,
    pub normal: [f64; 3],
    /// How far the foot is from the skeleton.
    pub across: f64,
    /// The facet's area.
    pub area: f64,
}

impl<'a> Shell<'a> {
    /// Wraps a mesh. Cost O(n log n); some milliseconds for 20 000 facets.
    ///
    /// # Errors
    /// `Undetermined` for a mesh without triangles; `Input` for one that fails
    /// [`TriangleMesh::sanity_check`], or options that make no sense.
    pub fn new(mesh: &'a TriangleMesh, options: &ShellOptions) -> Result<Self> {
        mesh.sanity_check()?;
        if mesh.triangles.is_empty() {
            return Err(Error::undetermined("a mesh without triangles has no shell: give one with faces"));
        }
        let positive = [
            ("sharpness", options.sharpness),
            ("threshold", options.threshold),
            ("reach", options.reach.unwrap_or(1.0)),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::input(format!("the {name} of a shell is a positive number, got {value}")));
            }
        }
        if !options.thickness.is_finite() || options.thickness < 0.0 {
            return Err(Error::input(format!(
                "the thickness of a shell is a length, got {}",
                options.thickness
            )));
        }
        let count = mesh.triangles.len();
        let facets: Vec<Facet> = (0..count)
            .into_par_iter()
            .map(|t| {
                let corners = mesh.corners(t);
                let m = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
                let twice = norm(m);
                Facet {
                    normal: if twice > 0.0 { scale(1.0 / twice, m) } else { [0.0; 3] },
                    area: 0.5 * twice,
                }
            })
            .collect();
        let skeletons: Vec<Skeleton> = match options.metaball {
            Metaball::Triangular => Vec::new(),
            Metaball::Spherical => (0..count).into_par_iter().map(|t| skeleton(&mesh.corners(t))).collect(),
        };
        let total: f64 = facets.iter().map(|facet| facet.area).sum();
        if total.is_nan() || total <= 0.0 {
            return Err(Error::undetermined("a shell needs facets with an area, and the mesh has none"));
        }
        let tree = FacetTree::new(count, |t| match skeletons.get(t) {
            None => mesh.corners(t),
            Some(skeleton) => [skeleton.center; 3],
        });
        let smallest = (facets.iter().map(|f| f.area).filter(|a| *a > 0.0)).fold(f64::INFINITY, f64::min);
        // The nearest facet may be a small one.
        let others = match options.metaball {
            Metaball::Triangular => count as f64,
            Metaball::Spherical => total / smallest,
        };
        let (least, most) = (skeletons.iter().map(|s| s.radius))
            .fold((f64::INFINITY, 0.0_f64), |(least, most), r| (least.min(r), most.max(r)));
        let reach = |others: f64| options.reach.unwrap_or_else(|| (others / USUAL_ERROR).ln());
        Ok(Self {
            mesh,
            tree,
            options: *options,
            slack: reach(others) / options.sharpness,
            paper_slack: reach(count as f64) / options.sharpness + (most - least).max(0.0),
            facets,
            skeletons,
        })
    }

    /// The paper's field `F = T − Σ exp(−k (r − ρ))`: negative inside of the shell, `T` far away. Overflows
    /// to `−∞` deep inside of very sharp shells.
    #[must_use]
    pub fn field(&self, at: [f64; 3]) -> f64 {
        let k = self.options.sharpness;
        let mut sum = 0.0;
        self.tree.visit_near(at, self.paper_slack, |near| {
            let radius =
                (self.skeletons.get(near.facet as usize)).map_or(self.options.thickness, |s| s.radius);
            sum += (-k * (near.distance - radius)).exp();
        });
        self.options.threshold - sum
    }

    /// How far a place is from the shell by its field, `(ln T − ln Σ exp(−k (r − ρ)))/k`: negative inside,
    /// zero where [`Self::field`] is, and no steeper than one. Exponents are taken from the largest: neither
    /// end overflows.
    #[must_use]
    pub fn level(&self, at: [f64; 3]) -> f64 {
        let k = self.options.sharpness;
        let (mut largest, mut sum) = (f64::NEG_INFINITY, 0.0);
        self.tree.visit_near(at, self.paper_slack, |near| {
            let radius =
                (self.skeletons.get(near.facet as usize)).map_or(self.options.thickness, |s| s.radius);
            let exponent = -k * (near.distance - radius);
            if exponent > largest {
                sum = sum * (largest - exponent).exp() + 1.0;
                largest = exponent;
            } else {
                sum += (exponent - largest).exp();
            }
        });
        (self.options.threshold.ln() - largest - sum.ln()) / k
    }

    /// The smooth distance from the mesh without a sign: the mean distance of the skeletons, weighed as in
    /// [`Self::distance`]. Between that of the nearest and `reach/k` more.
    #[must_use]
    pub fn unsigned_distance(&self, at: [f64; 3]) -> f64 {
        let k = self.options.sharpness;
        let (mut nearest, mut sum, mut heights) = (f64::INFINITY, 0.0, 0.0);
        self.tree.visit_near(at, self.slack, |near| {
            let weight = self.weight(near.facet);
            if near.distance < nearest {
                let fading = (-k * (nearest - near.distance)).exp();
                (sum, heights) = (sum * fading, heights * fading);
                nearest = near.distance;
            }
            let share = weight * (-k * (near.distance - nearest)).exp();
            sum += share;
            heights += share * near.distance;
        });
        if sum > 0.0 { heights / sum } else { nearest }
    }

    /// The distance of the nearest skeleton.
    pub(crate) fn nearest(&self, at: [f64; 3]) -> f64 {
        let mut nearest = f64::INFINITY;
        (self.tree).visit_near(at, 0.0, |near| nearest = nearest.min(near.distance));
        nearest
    }

    /// From where on a skeleton is too near, or too far, for the shell to pass: the sum is at least its
    /// largest term and at most as many times as there are facets.
    pub(crate) fn band(&self) -> [f64; 2] {
        let k = self.options.sharpness;
        let radii = || self.skeletons.iter().map(|s| s.radius);
        let [least, most] = if self.skeletons.is_empty() {
            [self.options.thickness; 2]
        } else {
            [radii().fold(f64::INFINITY, f64::min), radii().fold(0.0, f64::max)]
        };
        let inner = -self.options.threshold.ln() / k;
        [least + inner, most + inner + (self.facets.len() as f64).ln() / k]
    }

    /// The largest radius of a spherical metaball; zero for triangular ones.
    pub(crate) fn largest_radius(&self) -> f64 {
        self.skeletons.iter().map(|s| s.radius).fold(0.0, f64::max)
    }

    /// The largest amount by which [`Self::unsigned_distance`] exceeds the nearest.
    pub(crate) fn slack(&self) -> f64 {
        self.slack
    }

    /// The mesh that is wrapped.
    #[must_use]
    pub fn mesh(&self) -> &TriangleMesh {
        self.mesh
    }

    /// The distance of a place from the mesh by the field, and what it is made of, for [`Self::by_vertices`].
    /// `None` where the place is not finite.
    pub fn distance(&self, at: [f64; 3], shares: &mut Vec<FacetShare>) -> Option<ShellDistance> {
        let k = self.options.sharpness;
        shares.clear();
        let mut nearest: Option<NearFacet> = None;
        self.tree.visit_near(at, self.slack, |near| {
            let nearer = |best: &NearFacet| (near.distance, near.facet) < (best.distance, best.facet);
            if nearest.as_ref().is_none_or(nearer) {
                nearest = Some(*near);
            }
            shares.push(FacetShare { near: *near, share: 0.0 });
        });
        let nearest = nearest?;
        // Visited before the nearest was known.
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
            // Facets without area only: the nearest stands for them.
            let alone = FacetShare { near: nearest, share: 1.0 };
            shares.clear();
            shares.push(alone);
            sums = Sums::default();
            sums.add(at, &alone, self.height(at, &nearest, facing));
        }
        let mean = sums.height / sums.share;
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

    /// How high a place is over a facet's plane, and the plane's normal, turned where it faces away.
    fn height(&self, at: [f64; 3], near: &NearFacet, facing: Vector3<f64>) -> (f64, Vector3<f64>) {
        let normal = Vector3::from(self.facets[near.facet as usize].normal);
        let turned = if !self.options.oriented && normal.dot(&facing) < TURNED { -normal } else { normal };
        (turned.dot(&Vector3::from(sub(at, near.point))), turned)
    }
}

/// The direction from a skeleton to a place; zero on it.
fn away(at: [f64; 3], near: &NearFacet) -> Vector3<f64> {
    if near.distance > 0.0 { Vector3::from(sub(at, near.point)) / near.distance } else { Vector3::zeros() }
}

#[cfg(test)]
mod tests;
