//! Parts of a mesh that stay rigid while the rest deforms.
//!
//! In: a deformation and parts, which are lists of vertices that stay fixed or move rigidly. Out: a
//! deformation whose parameters are those of the given one, then six for each moving part.
//!
//! The weight `w_p` of a part is 1 on it and falls to 0 within the blend distance as `1 − (6s⁵ − 15s⁴ +
//! 10s³)`. Both its derivatives vanish at either end, so seams have no crease. Weights of several parts are
//! combined as `u_p = w_p Π_{q≠p} (1 − w_q)`. Then
//!
//! `V = V0 + (1 − Σ u_p) W q + Σ u_p (t_p + (R(ω_p) − I)(V0 − c_p))`
//!
//! with the rotation `R(ω)` about the axis `ω` by the angle `|ω|`. Fits linearise it where they are:
//! `∂(R r)/∂ω = −[R r]ₓ J(ω)` with the left Jacobian `J = I + (1 − cos θ)/θ² [ω]ₓ + (θ − sin θ)/θ³ [ω]ₓ²`
//! (J. Solà, J. Deray, D. Atchuthan, *A micro Lie theory for state estimation in robotics*, 2018, eq. 145).
//!
//! Not guaranteed: distances are measured in space, so a vertex that is near a part but far along the mesh (a
//! hand on a hip) is blended with that part.

use super::{Deformation, displacements};
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use rayon::prelude::*;

/// How a part moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PartMotion {
    /// It stays where it is.
    Fixed,
    /// It has six parameters: a translation, then a rotation vector about its centre times its radius
    /// (lengths).
    Free,
}

/// A rigid part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigidPart {
    /// Its vertices.
    pub vertices: Vec<u32>,
    /// How it moves.
    pub motion: PartMotion,
}

/// A part with its centre and the index of its parameters.
#[derive(Debug, Clone)]
struct Part {
    center: DVec3,
    /// Largest distance of its vertices from the centre.
    radius: f64,
    /// Index of the first of its six parameters, counted after those of the inner deformation.
    first: Option<usize>,
    vertices: Vec<u32>,
}

/// A deformation with rigid parts.
///
/// # Examples
/// ```
/// use nalgebra::DVector;
/// use planish_mesh::grid_sheet;
/// use planish_shell::{Deformation, PartMotion, RigidPart, RigidParts, VertexDisplacements, displacements};
/// let sheet = grid_sheet(10.0, 1.0, 10, 1);
/// let inner = Box::new(VertexDisplacements::new(&sheet.positions));
/// let part = RigidPart { vertices: vec![0, 1, 11, 12], motion: PartMotion::Free };
/// let made = RigidParts::new(&sheet, inner, &[part], 3.0)?;
/// let mut q = DVector::zeros(made.parameters());
/// q[66 + 2] = 1.0; // the part moves along z
/// let moved = displacements(&made, &q);
/// assert!(moved[1][2] == 1.0 && moved[3][2] > 0.0 && moved[3][2] < 1.0 && moved[10][2] == 0.0);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub struct RigidParts<'a> {
    inner: Box<dyn Deformation + 'a>,
    rest: Vec<DVec3>,
    parts: Vec<Part>,
    /// For each vertex its weight of the inner deformation, and the parts that it follows with their weights.
    own: Vec<f64>,
    following: Vec<Vec<(u32, f64)>>,
    reduction: Option<DMatrix<f64>>,
    free: usize,
}

/// Parameters of a moving part.
const NUMBERS: usize = 6;

impl<'a> RigidParts<'a> {
    /// Makes parts of `mesh` rigid, blended over the distance `blend`.
    ///
    /// # Errors
    /// `Input` for a part without vertices, a vertex that does not exist or is in two parts, a negative blend
    /// distance, or a deformation with a different number of vertices.
    pub fn new(
        mesh: &TriangleMesh,
        inner: Box<dyn Deformation + 'a>,
        parts: &[RigidPart],
        blend: f64,
    ) -> Result<Self> {
        let count = mesh.positions.len();
        if inner.vertices() != count {
            return Err(Error::input(format!(
                "expected a deformation of {count} vertices, as many as the mesh has, found {}",
                inner.vertices()
            )));
        }
        if !(blend.is_finite() && blend >= 0.0) {
            return Err(Error::input(format!("expected a blending length of at least 0, found {blend}")));
        }
        let mut weights: Vec<Vec<(u32, f64)>> = vec![Vec::new(); count];
        let mut part_of = vec![None; count];
        let (mut made, mut free) = (Vec::new(), 0);
        for (index, part) in parts.iter().enumerate() {
            for &v in &part.vertices {
                match part_of.get(v as usize) {
                    Some(None) => part_of[v as usize] = Some(index),
                    // A repeated vertex of one part is harmless; a vertex of two parts could not follow both.
                    Some(Some(other)) if *other != index => {
                        return Err(Error::input(format!(
                            "expected each vertex in at most one rigid part, found vertex {v} in {other} \
                             and {index}"
                        )));
                    }
                    Some(_) => {}
                    None => {
                        return Err(Error::input(format!(
                            "rigid part {index}: expected vertices below {count}, found {v}"
                        )));
                    }
                }
            }
            if part.vertices.is_empty() {
                return Err(Error::input(format!("rigid part {index}: expected vertices, found none")));
            }
            let places = || part.vertices.iter().map(|v| mesh.positions[*v as usize]);
            let center = 1.0 / part.vertices.len() as f64 * places().sum::<DVec3>();
            let radius = places().map(|p| p.distance(center)).fold(0.0, f64::max);
            let first = (part.motion == PartMotion::Free).then(|| {
                free += NUMBERS;
                free - NUMBERS
            });
            made.push(Part {
                center,
                radius: if radius > 0.0 { radius } else { 1.0 },
                first,
                vertices: part.vertices.clone(),
            });
        }
        for index in 0..parts.len() {
            // A vertex of a part follows that part alone, whatever other parts are near.
            let far = distances(mesh, &part_of, index, blend)?;
            for (v, far) in far.into_iter().enumerate() {
                let weight = match part_of[v] {
                    Some(own) => f64::from(u8::from(own == index)),
                    None => falling(far / blend),
                };
                if weight > 0.0 {
                    weights[v].push((index as u32, weight));
                }
            }
        }
        // The products keep the sum of weights at most one, and a vertex of one part has weight zero in all
        // others.
        let following: Vec<Vec<(u32, f64)>> = (weights.into_iter())
            .map(|near| {
                let weight_of = |k: usize| {
                    let others = near.iter().enumerate().filter(|(other, _)| *other != k);
                    near[k].1 * others.map(|(_, (_, w))| 1.0 - w).product::<f64>()
                };
                (0..near.len()).map(|k| (near[k].0, weight_of(k))).collect()
            })
            .collect();
        // Motions of parts are parameters themselves, so their block is the identity.
        let reduction = inner.reduction().map(|r| {
            let mut extended = DMatrix::zeros(r.nrows() + free, r.ncols() + free);
            extended.view_mut((0, 0), r.shape()).copy_from(r);
            for k in 0..free {
                extended[(r.nrows() + k, r.ncols() + k)] = 1.0;
            }
            extended
        });
        Ok(Self {
            own: (following.iter())
                .map(|near| (1.0 - near.iter().map(|(_, w)| w).sum::<f64>()).max(0.0))
                .collect(),
            inner,
            rest: mesh.positions.clone(),
            parts: made,
            following,
            reduction,
            free,
        })
    }

    /// The stiffness of all parameters, from that of the inner deformation. Rigid motions of parts cost
    /// nothing.
    #[must_use]
    pub fn stiffness(&self, inner: &DMatrix<f64>) -> DMatrix<f64> {
        let mut extended = DMatrix::zeros(inner.nrows() + self.free, inner.ncols() + self.free);
        extended.view_mut((0, 0), inner.shape()).copy_from(inner);
        extended
    }

    /// Parameters of all parts such that each moves by the rigid motion nearest to what the inner deformation
    /// with parameters `inner` does to it (W. Kabsch 1976).
    #[must_use]
    pub fn rigid_start(&self, inner: &DVector<f64>) -> DVector<f64> {
        let by = displacements(&*self.inner, inner);
        let mut q = DVector::zeros(self.parameters());
        q.rows_mut(0, inner.len()).copy_from(inner);
        for part in &self.parts {
            let Some(first) = part.first else { continue };
            let per = 1.0 / part.vertices.len() as f64;
            let moved = |v: &u32| self.rest[*v as usize] + by[*v as usize];
            let center = per * part.vertices.iter().map(moved).sum::<DVec3>();
            let mut products = Matrix3::zeros();
            for v in &part.vertices {
                let from = Vector3::from(self.rest[*v as usize] - part.center);
                products += Vector3::from(moved(v) - center) * from.transpose();
            }
            let rotation =
                Rotation3::from_matrix_eps(&nearest_rotation(&products), 1e-12, 100, Rotation3::identity());
            // Times the radius, so that all parameters are lengths and damping treats them alike.
            let turn = rotation.scaled_axis() * part.radius;
            let slide = center - part.center;
            for k in 0..3 {
                q[inner.len() + first + k] = slide[k];
                q[inner.len() + first + 3 + k] = turn[k];
            }
        }
        q
    }

    /// Rotation vector and translation of each part.
    fn motions(&self, q: &DVector<f64>) -> Vec<[Vector3<f64>; 2]> {
        let count = self.inner.parameters();
        let of_part = |part: &Part| match part.first {
            None => [Vector3::zeros(); 2],
            Some(first) => {
                let components_from = |k: usize| Vector3::from_fn(|axis, _| q[count + first + k + axis]);
                [components_from(3) / part.radius, components_from(0)]
            }
        };
        self.parts.iter().map(of_part).collect()
    }

    /// The row of a vertex; each part turns by its rotation and the transpose of its Jacobian.
    fn row_of_turned(
        &self,
        vertex: u32,
        direction: DVec3,
        turned: impl Fn(usize) -> Option<[Matrix3<f64>; 2]>,
        visit: &mut dyn FnMut(usize, f64),
    ) {
        let v = vertex as usize;
        if self.own[v] > 0.0 {
            self.inner.row(vertex, direction.map(|d| self.own[v] * d), visit);
        }
        for &(number, weight) in &self.following[v] {
            let part = &self.parts[number as usize];
            let Some(first) = part.first else { continue };
            // `d·(b × a) = b·(a × d)`, with `a = R r` and `b = J δω`.
            let arm = self.rest[v] - part.center;
            let turn = match turned(number as usize) {
                None => arm.cross(direction),
                Some([rotation, jacobian]) => {
                    let arm = DVec3::from(rotation * Vector3::from(arm));
                    DVec3::from(jacobian * Vector3::from(arm.cross(direction)))
                }
            };
            for k in 0..3 {
                visit(self.inner.basis() + first + k, weight * direction[k]);
                visit(self.inner.basis() + first + 3 + k, weight * turn[k] / part.radius);
            }
        }
    }
}

/// Rigid parts with their rows at given parameters.
struct TurnedParts<'a> {
    parts: &'a RigidParts<'a>,
    /// Rotation, and transpose of its left Jacobian, of each part.
    turned: Vec<[Matrix3<f64>; 2]>,
}

impl Deformation for TurnedParts<'_> {
    fn parameters(&self) -> usize {
        self.parts.parameters()
    }

    fn basis(&self) -> usize {
        self.parts.basis()
    }

    fn vertices(&self) -> usize {
        self.parts.vertices()
    }

    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64)) {
        self.parts.row_of_turned(vertex, direction, |part| Some(self.turned[part]), visit);
    }

    fn reduction(&self) -> Option<&DMatrix<f64>> {
        self.parts.reduction()
    }
}

/// The left Jacobian of rotations at a rotation vector.
fn left_jacobian(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = turn.norm();
    let cross = turn.cross_matrix();
    // Series near zero, where the quotients lose their digits.
    let [first, second] = match angle < 1e-3 {
        true => [0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0],
        false => [(1.0 - angle.cos()) / angle.powi(2), (angle - angle.sin()) / angle.powi(3)],
    };
    Matrix3::identity() + first * cross + second * cross * cross
}

impl Deformation for RigidParts<'_> {
    fn parameters(&self) -> usize {
        self.inner.parameters() + self.free
    }

    fn basis(&self) -> usize {
        self.inner.basis() + self.free
    }

    fn vertices(&self) -> usize {
        self.rest.len()
    }

    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64)) {
        self.row_of_turned(vertex, direction, |_| None, visit);
    }

    fn nonlinear_displacements(&self, q: &DVector<f64>) -> Option<Vec<DVec3>> {
        let by = displacements(&*self.inner, &q.rows(0, self.inner.parameters()).into_owned());
        let motions: Vec<(Rotation3<f64>, Vector3<f64>)> = (self.motions(q).into_iter())
            .map(|[turn, slide]| (Rotation3::from_scaled_axis(turn), slide))
            .collect();
        let moved = |v: usize| {
            let mut moved = self.own[v] * by[v];
            for &(part, weight) in &self.following[v] {
                let (rotation, slide) = &motions[part as usize];
                let off = Vector3::from(self.rest[v] - self.parts[part as usize].center);
                moved += weight * DVec3::from(rotation * off - off + slide);
            }
            moved
        };
        Some((0..self.rest.len()).into_par_iter().map(moved).collect())
    }

    fn linearised_at(&self, q: &DVector<f64>) -> Option<Box<dyn Deformation + '_>> {
        let turned = (self.motions(q).into_iter())
            .map(|[turn, _]| {
                let rotation = Rotation3::from_scaled_axis(turn).into_inner();
                [rotation, left_jacobian(&turn).transpose()]
            })
            .collect();
        Some(Box::new(TurnedParts { parts: self, turned }))
    }

    fn reduction(&self) -> Option<&DMatrix<f64>> {
        self.reduction.as_ref()
    }
}

/// Falls from 1 at 0 to 0 at 1, with two vanishing derivatives at either end.
fn falling(s: f64) -> f64 {
    if s.is_nan() || s >= 1.0 {
        return 0.0;
    }
    let s = s.max(0.0);
    1.0 - s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// Distances of all vertices from a part: from its faces, or from its vertices if it has no faces.
fn distances(mesh: &TriangleMesh, part_of: &[Option<usize>], index: usize, blend: f64) -> Result<Vec<f64>> {
    let is_in = |v: &u32| part_of[*v as usize] == Some(index);
    let mut triangles: Vec<[u32; 3]> =
        (mesh.triangles.iter().copied()).filter(|t| t.iter().all(is_in)).collect();
    if triangles.is_empty() {
        // Degenerate triangles stand for single vertices in the search.
        triangles = (0..mesh.positions.len() as u32).filter(is_in).map(|v| [v; 3]).collect();
    }
    let search = MeshSearch::try_new(&TriangleMesh { positions: mesh.positions.clone(), triangles })?;
    Ok((mesh.positions.par_iter())
        .map(|p| match blend > 0.0 {
            true => search.closest(*p).map_or(f64::INFINITY, |foot| foot.distance),
            false => f64::INFINITY,
        })
        .collect())
}

/// The rotation that is nearest to a matrix.
pub(crate) fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    let svd = m.svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else {
        return Matrix3::identity();
    };
    // The sign keeps a reflection from being taken for a rotation.
    let mut turn = Matrix3::identity();
    turn[(2, 2)] = (u * v).determinant().signum();
    u * turn * v
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deformation::{displaced_positions, parameter_row};
    use crate::{Dirichlet, VertexDisplacements};
    use planish_mesh::{grid_sheet, icosphere};

    fn lower(mesh: &TriangleMesh, below: f64) -> Vec<u32> {
        (0..mesh.positions.len() as u32).filter(|v| mesh.positions[*v as usize][2] < below).collect()
    }

    /// Distances within a rigid part are constant under any deformation, and a fixed part stays in place.
    #[test]
    fn parts_keep_their_shape() {
        let ball = icosphere(1.0, 3);
        let controls = icosphere(1.2, 1).positions;
        let part = lower(&ball, -0.3);
        for motion in [PartMotion::Free, PartMotion::Fixed] {
            let inner = Box::new(Dirichlet::new(&controls, &ball.positions).unwrap());
            let parts = [RigidPart { vertices: part.clone(), motion }];
            let made = RigidParts::new(&ball, inner, &parts, 0.4).unwrap();
            let turn = Rotation3::from_euler_angles(0.5, -0.4, 1.0);
            let q = DVector::from_iterator(
                3 * controls.len(),
                (controls.iter().enumerate()).flat_map(|(k, p)| {
                    let bulge = if k == 3 { 1.3 } else { 1.0 };
                    (DVec3::from(bulge * (turn * Vector3::from(*p))) - *p).to_array()
                }),
            );
            let moved = displaced_positions(&ball.positions, &made, &made.rigid_start(&q));
            for pair in part.windows(2) {
                let [a, b] = [pair[0] as usize, pair[1] as usize];
                let [before, after] = [&ball.positions, &moved].map(|p| p[a].distance(p[b]));
                assert!((before - after).abs() < 1e-12);
                if motion == PartMotion::Fixed {
                    assert_eq!(moved[a], ball.positions[a]);
                }
            }
        }
    }

    /// Rows are the derivatives of the motion, at rest and after a turn of 66°.
    #[test]
    fn rows_are_derivatives() {
        let ball = icosphere(1.0, 2);
        let parts = [
            RigidPart { vertices: lower(&ball, -0.5), motion: PartMotion::Free },
            RigidPart { vertices: vec![0, 5], motion: PartMotion::Free },
        ];
        let parts = match lower(&ball, -0.5).iter().any(|v| [0, 5].contains(v)) {
            true => &parts[..1],
            false => &parts[..],
        };
        let controls = icosphere(1.2, 0).positions;
        let inner = Box::new(Dirichlet::new(&controls, &ball.positions).unwrap());
        let made = RigidParts::new(&ball, inner, parts, 0.6).unwrap();
        let count = made.parameters();
        let turned = DVector::from_fn(count, |k, _| if k < count - 6 { 0.1 } else { 0.6 * (k as f64).sin() });
        for at in [DVector::zeros(count), turned] {
            let linear = made.linearised_at(&at).unwrap();
            let direction = DVec3::new(0.3, -0.5, 0.8);
            for k in 0..count {
                let by = |step: f64| {
                    let mut q = at.clone();
                    q[k] += step;
                    displacements(&made, &q)
                };
                let [after, before] = [1e-4, -1e-4].map(by);
                for v in 0..ball.positions.len() as u32 {
                    let change = (after[v as usize] - before[v as usize]).dot(direction) / 2e-4;
                    let row = parameter_row(&*linear, v, direction);
                    assert!((row[k] - change).abs() < 1e-7, "{k} {v}: {} {change}", row[k]);
                }
            }
        }
    }

    /// The slope of the displacement is continuous at the seam of a moving part: halving the grid spacing
    /// halves its jumps between edges.
    #[test]
    fn seams_have_no_crease() {
        let worst = |columns: usize| {
            let sheet = grid_sheet(10.0, 1.0, columns, 1);
            let vertices: Vec<u32> = (0..sheet.positions.len() as u32)
                .filter(|v| sheet.positions[*v as usize][0] < -2.0)
                .collect();
            let inner = Box::new(VertexDisplacements::new(&sheet.positions));
            let part = RigidPart { vertices, motion: PartMotion::Free };
            let made = RigidParts::new(&sheet, inner, &[part], 4.0).unwrap();
            let mut q = DVector::zeros(made.parameters());
            q[made.parameters() - NUMBERS + 2] = 1.0;
            let step = 10.0 / columns as f64;
            let heights: Vec<f64> = displacements(&made, &q)[..=columns].iter().map(|d| d[2]).collect();
            assert!(heights[0] == 1.0 && heights[columns] == 0.0);
            let slopes: Vec<f64> = heights.windows(2).map(|h| (h[1] - h[0]) / step).collect();
            slopes.windows(2).map(|s| (s[1] - s[0]).abs()).fold(0.0, f64::max)
        };
        let (coarse, fine) = (worst(100), worst(200));
        assert!(fine < 0.6 * coarse && fine < 0.02, "{coarse} {fine}");
    }

    #[test]
    fn messages_name_the_invalid_part() {
        let ball = icosphere(1.0, 1);
        let made = |lists: &[Vec<u32>], blend: f64| {
            let parts: Vec<RigidPart> = (lists.iter().cloned())
                .map(|vertices| RigidPart { vertices, motion: PartMotion::Fixed })
                .collect();
            let inner = Box::new(VertexDisplacements::new(&ball.positions));
            RigidParts::new(&ball, inner, &parts, blend).err().unwrap().to_string()
        };
        assert!(made(&[vec![0, 999]], 1.0).contains("found 999"));
        assert!(made(&[vec![0], vec![1, 0]], 1.0).contains("at most one rigid part"));
        assert!(made(&[vec![]], 1.0).contains("expected vertices"));
        assert!(made(&[vec![0]], -1.0).contains("length"));
    }
}
