//! The field of an implicit shell: metaballs on every facet of a mesh, and how far a place is from the mesh by it.
//!
//! Comes in: any triangle mesh, open or closed, manifold or not. Goes out: at a place the paper's field, a distance, and its derivatives by the place and by the mesh's vertices.
//!
//! Facet `i` has a skeleton at distance `r_i(x)`: itself (triangular metaballs), or the centre of the smallest circle around it (spherical ones, [`crate::skeleton`]). C eq. 8:
//! `F(x) = T − Σ_i exp(−k (r_i(x) − ρ_i))`, with `ρ_i` the circle's radius or the one thickness `d0`. The shell `F = 0` has two sheets, one on either side of the mesh, and bulges where
//! metaballs overlap. Fits want the mesh itself, without thickness and bulge; that is [`Shell::distance`]:
//!
//! - triangular: `D = −(1/k) ln Σ_i exp(−k r_i)`, never negative but for the bulge, which is at most `ln(n)/k` where `n` facets are equally near;
//! - spherical: skeletons stand for areas `A_i` and know their plane, so that `D = Σ_i p_i n_i·(x − c_i)` with `p_i ∝ A_i exp(−k r_i)`, normals turned to agree with that of the nearest facet. It has a
//!   sign, no thickness and no bulge; on a plane it is exact. (The sum of exponentials alone is flat in the mesh, where fits need its slope.)
//!
//! Facets that are more than a slack farther than the nearest are left out: together they change the sum by less than the share [`ShellOptions::error`], as
//! `Σ_far ≤ n · exp(−k (r_min + slack))` (A. Madan, D. Levin 2022). Exponents are taken from the largest, so that nothing under- or overflows anywhere.
//!
//! Not guaranteed: a derivative where two facets of a thin part are equally near (the sign flips there), or of spherical metaballs of facets with a right angle.

use crate::skeleton::{Skeleton, skeleton};
use nalgebra::{Matrix3, Vector3};
use planish_estimate::vector3::{cross, distance, norm, scale, sub};
use planish_estimate::{Error, Result};
use planish_mesh::{FacetTree, NearFacet, TriangleMesh};

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
    /// The share of the sum that may be left out.
    pub error: f64,
}

impl ShellOptions {
    /// A shell of sharpness `k` with the paper's threshold of one.
    #[must_use]
    pub fn new(metaball: Metaball, sharpness: f64) -> Self {
        Self {
            metaball,
            sharpness,
            thickness: 0.0,
            threshold: 1.0,
            error: 1e-6,
        }
    }
}

/// A spherical metaball.
#[derive(Debug, Clone, Copy)]
struct Ball {
    skeleton: Skeleton,
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
    balls: Vec<Ball>,
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
pub struct Share {
    near: NearFacet,
    /// `p_i`, of all that are near.
    share: f64,
}

impl<'a> Shell<'a> {
    /// Wraps a mesh. Cost O(n log n); some milliseconds for 20 000 facets.
    ///
    /// # Errors
    /// `Undetermined` for a mesh without triangles; `Input` for one that fails [`TriangleMesh::sanity_check`], or options that make no sense.
    pub fn new(mesh: &'a TriangleMesh, options: &ShellOptions) -> Result<Self> {
        mesh.sanity_check()?;
        if mesh.triangles.is_empty() {
            return Err(Error::undetermined(
                "a mesh without triangles has no shell: give one with faces",
            ));
        }
        let positive = [
            ("sharpness", options.sharpness),
            ("threshold", options.threshold),
            ("error", options.error),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::input(format!(
                    "the {name} of a shell is a positive number, got {value}"
                )));
            }
        }
        if !options.thickness.is_finite() || options.thickness < 0.0 {
            return Err(Error::input(format!(
                "the thickness of a shell is a length, got {}",
                options.thickness
            )));
        }
        let count = mesh.triangles.len();
        let balls: Vec<Ball> = match options.metaball {
            Metaball::Triangular => Vec::new(),
            Metaball::Spherical => (0..count)
                .map(|t| {
                    let corners = mesh.corners(t);
                    let m = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
                    let twice = norm(m);
                    Ball {
                        skeleton: skeleton(&corners),
                        normal: if twice > 0.0 { scale(1.0 / twice, m) } else { [0.0; 3] },
                        area: 0.5 * twice,
                    }
                })
                .collect(),
        };
        let total: f64 = balls.iter().map(|ball| ball.area).sum();
        if options.metaball == Metaball::Spherical && (total.is_nan() || total <= 0.0) {
            return Err(Error::undetermined(
                "spherical metaballs need facets with an area, and the mesh has none",
            ));
        }
        let tree = match options.metaball {
            Metaball::Triangular => FacetTree::new(count, |t| mesh.corners(t)),
            Metaball::Spherical => FacetTree::new(count, |t| [balls[t].skeleton.center; 3]),
        };
        // The nearest facet may be a small one.
        let smallest = (balls.iter().map(|b| b.area).filter(|a| *a > 0.0)).fold(f64::INFINITY, f64::min);
        let others = match options.metaball {
            Metaball::Triangular => count as f64,
            Metaball::Spherical => total / smallest,
        };
        let (least, most) = (balls.iter().map(|b| b.skeleton.radius))
            .fold((f64::INFINITY, 0.0_f64), |(least, most), r| (least.min(r), most.max(r)));
        Ok(Self {
            mesh,
            tree,
            options: *options,
            slack: (others / options.error).ln() / options.sharpness,
            paper_slack: (count as f64 / options.error).ln() / options.sharpness + (most - least).max(0.0),
            balls,
        })
    }

    /// The paper's field `F = T − Σ exp(−k (r − ρ))`: negative inside of the shell, `T` far away. Overflows to `−∞` deep inside of very sharp shells.
    #[must_use]
    pub fn field(&self, at: [f64; 3]) -> f64 {
        let k = self.options.sharpness;
        let mut sum = 0.0;
        self.tree.visit_near(at, self.paper_slack, |near| {
            let radius = match self.options.metaball {
                Metaball::Triangular => self.options.thickness,
                Metaball::Spherical => self.balls[near.facet as usize].skeleton.radius,
            };
            sum += (-k * (near.distance - radius)).exp();
        });
        self.options.threshold - sum
    }

    /// The distance of a place from the mesh by the field, and what it is made of, for [`Self::by_vertices`]. `None` where the place is not finite.
    pub fn distance(&self, at: [f64; 3], shares: &mut Vec<Share>) -> Option<ShellDistance> {
        let k = self.options.sharpness;
        shares.clear();
        self.tree.visit_near(at, self.slack, |near| {
            shares.push(Share {
                near: *near,
                share: 0.0,
            });
        });
        let nearest = *(shares.iter().map(|s| &s.near))
            .min_by(|a, b| (a.distance.total_cmp(&b.distance)).then(a.facet.cmp(&b.facet)))?;
        let mut sum = 0.0;
        for one in shares.iter_mut() {
            one.share = (-k * (one.near.distance - nearest.distance)).exp() * self.weight(one.near.facet);
            sum += one.share;
        }
        if sum > 0.0 {
            shares.iter_mut().for_each(|one| one.share /= sum);
        } else {
            // Facets without area only: the nearest stands for them.
            let alone = Share {
                near: nearest,
                share: 1.0,
            };
            shares.clear();
            shares.push(alone);
        }
        let mut gradient = Vector3::zeros();
        let distance = match self.options.metaball {
            Metaball::Triangular => {
                for one in shares.iter() {
                    gradient += one.share * away(at, &one.near);
                }
                nearest.distance - sum.ln() / k
            }
            Metaball::Spherical => {
                let facing = self.facing(nearest.facet);
                let heights = |one: &Share| self.height(at, one, facing).0;
                let mean: f64 = shares.iter().map(|one| one.share * heights(one)).sum();
                for one in shares.iter() {
                    let (height, normal) = self.height(at, one, facing);
                    gradient += one.share * (normal - k * (height - mean) * away(at, &one.near));
                }
                mean
            }
        };
        Some(ShellDistance {
            distance,
            gradient: gradient.into(),
            facet: nearest.facet,
            nearest: nearest.distance,
        })
    }

    /// `∂²D/∂x²` of triangular metaballs, from what [`Self::distance`] left: `Σ p_i (H_i − k u_i u_iᵀ) + k u uᵀ` with `u = Σ p_i u_i`; symmetric. `None` for spherical ones.
    #[must_use]
    pub fn hessian(&self, at: [f64; 3], shares: &[Share]) -> Option<Matrix3<f64>> {
        if self.options.metaball == Metaball::Spherical {
            return None;
        }
        let k = self.options.sharpness;
        let (mut mean, mut sum) = (Vector3::zeros(), Matrix3::zeros());
        for one in shares {
            let u = away(at, &one.near);
            mean += one.share * u;
            sum += one.share * (self.bending(&one.near, u) - k * u * u.transpose());
        }
        Some(sum + k * mean * mean.transpose())
    }

    /// The Hessian of the distance from a triangle: 0 over its face, one curvature of `1/r` beside an edge, two beside a corner.
    fn bending(&self, near: &NearFacet, u: Vector3<f64>) -> Matrix3<f64> {
        if near.distance == 0.0 {
            return Matrix3::zeros();
        }
        let corners = self.mesh.corners(near.facet as usize);
        let mut flat = Matrix3::identity() - u * u.transpose();
        let within: Vec<usize> = (0..3).filter(|&k| near.barycentric[k] > 0.0).collect();
        match within[..] {
            [_] => {}
            [a, b] => {
                let along = Vector3::from(sub(corners[b], corners[a])).normalize();
                flat -= along * along.transpose();
            }
            _ => return Matrix3::zeros(),
        }
        flat / near.distance
    }

    /// `∂D/∂V_j` for every vertex that the distance depends on; a vertex of several facets comes several times.
    pub fn by_vertices(
        &self,
        at: [f64; 3],
        shares: &[Share],
        of: &ShellDistance,
        mut visit: impl FnMut(u32, [f64; 3]),
    ) {
        let k = self.options.sharpness;
        for one in shares {
            let vertices = self.mesh.triangles[one.near.facet as usize];
            let away = away(at, &one.near);
            match self.options.metaball {
                Metaball::Triangular => {
                    for (vertex, weight) in vertices.into_iter().zip(one.near.barycentric) {
                        if weight != 0.0 {
                            visit(vertex, (-one.share * weight * away).into());
                        }
                    }
                }
                Metaball::Spherical => {
                    let ball = &self.balls[one.near.facet as usize];
                    let corners = self.mesh.corners(one.near.facet as usize);
                    let facing = self.facing(of.facet);
                    let (height, normal) = self.height(at, one, facing);
                    let (own, twice) = (Vector3::from(ball.normal), 2.0 * ball.area);
                    let sign = own.dot(&normal);
                    let off = Vector3::from(sub(at, ball.skeleton.center));
                    // n = m / |m|: dn = (I − n nᵀ) dm / |m|; d ln A = n·dm / |m|.
                    // A facet without area has no share, and nothing to turn.
                    let by_m = if twice > 0.0 {
                        (one.share / twice) * (sign * (off - off.dot(&own) * own) + (height - of.distance) * own)
                    } else {
                        Vector3::zeros()
                    };
                    let by_center = -one.share * (normal - k * (height - of.distance) * away);
                    for corner in 0..3 {
                        // m changes by dV × (the side opposite, turned back).
                        let side = Vector3::from(sub(corners[(corner + 2) % 3], corners[(corner + 1) % 3]));
                        let moved = ball.skeleton.by_corner[corner].tr_mul(&by_center) + by_m.cross(&side);
                        visit(vertices[corner], moved.into());
                    }
                }
            }
        }
    }

    fn weight(&self, facet: u32) -> f64 {
        match self.options.metaball {
            Metaball::Triangular => 1.0,
            Metaball::Spherical => self.balls[facet as usize].area,
        }
    }

    /// The normal that others are turned to agree with.
    fn facing(&self, facet: u32) -> Vector3<f64> {
        self.balls[facet as usize].normal.into()
    }

    /// How high a place is over a facet's plane, and the plane's normal, turned.
    fn height(&self, at: [f64; 3], one: &Share, facing: Vector3<f64>) -> (f64, Vector3<f64>) {
        let ball = &self.balls[one.near.facet as usize];
        let normal = Vector3::from(ball.normal);
        let turned = if normal.dot(&facing) < 0.0 { -normal } else { normal };
        (turned.dot(&Vector3::from(sub(at, ball.skeleton.center))), turned)
    }
}

/// The direction from a skeleton to a place; zero on it.
fn away(at: [f64; 3], near: &NearFacet) -> Vector3<f64> {
    if near.distance > 0.0 {
        Vector3::from(sub(at, near.point)) / near.distance
    } else {
        Vector3::zeros()
    }
}

/// Subdivides a mesh until no circle about a facet is larger than `radius`, halving longest sides all over; stops before there are more than `most` facets.
///
/// What comes with it: for every new vertex the corners of the facet that it lies on, and their weights, by which it moves with the mesh.
#[must_use]
pub fn subdivided(mesh: &TriangleMesh, radius: f64, most: usize) -> (TriangleMesh, Vec<[(u32, f64); 3]>) {
    let mut positions = mesh.positions.clone();
    let mut origins: Vec<[(u32, f64); 3]> = (0..positions.len() as u32)
        .map(|v| [(v, 1.0), (v, 0.0), (v, 0.0)])
        .collect();
    let mut triangles = Vec::with_capacity(mesh.triangles.len());
    let room = most.max(mesh.triangles.len());
    let mut total: usize = 0;
    let pieces: Vec<usize> = (mesh.triangles.iter())
        .map(|t| {
            let corners = t.map(|c| mesh.positions[c as usize]);
            let longest = (0..3)
                .map(|k| distance(corners[k], corners[(k + 1) % 3]))
                .fold(0.0, f64::max);
            // The circle about a piece is at most half of its longest side where it is obtuse, and less than 0.58 of it anywhere.
            let along = (longest / (1.73 * radius)).ceil().clamp(1.0, 1e4) as usize;
            total = total.saturating_add(along * along);
            along
        })
        .collect();
    let shrink = if total > room {
        (room as f64 / total as f64).sqrt()
    } else {
        1.0
    };
    for (t, pieces) in mesh.triangles.iter().zip(pieces) {
        let n = ((pieces as f64 * shrink) as usize).max(1);
        if n == 1 {
            triangles.push(*t);
            continue;
        }
        // A triangle of n × n pieces with vertices of its own: shells do not ask that neighbours share any.
        let first = positions.len() as u32;
        let row_start = |row: usize| (row * (n + 1) - row * row.saturating_sub(1) / 2) as u32;
        for row in 0..=n {
            for column in 0..=n - row {
                let [b, c] = [column, row].map(|i| i as f64 / n as f64);
                let weights = [1.0 - b - c, b, c];
                let at = std::array::from_fn(|k| (0..3).map(|i| weights[i] * mesh.positions[t[i] as usize][k]).sum());
                positions.push(at);
                origins.push(std::array::from_fn(|i| (t[i], weights[i])));
            }
        }
        for row in 0..n {
            for column in 0..n - row {
                let here = first + row_start(row) + column as u32;
                let above = first + row_start(row + 1) + column as u32;
                triangles.push([here, here + 1, above]);
                if column + 1 < n - row {
                    triangles.push([here + 1, above + 1, above]);
                }
            }
        }
    }
    (TriangleMesh { positions, triangles }, origins)
}

#[cfg(test)]
mod tests;
