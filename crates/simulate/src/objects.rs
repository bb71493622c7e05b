//! Solid objects of known genus: a row of rings, a plate with holes, a cup and a bracket.
//!
//! In: a kind of object and a size. Out: a [`SolidObject`] with points that rays meet, a fine watertight
//! mesh, and its genus, holes, fillets and sharp edges.
//!
//! An object is the set of points where a function is negative. The function changes by at most the distance
//! between two points, so it is a lower bound of the distance from the surface. Rays step by it (Hart 1996),
//! which gives points of the surface itself rather than of its mesh. The mesh of an object with sharp edges
//! is built from its faces; that of a smooth object is the zero surface of the function.
//!
//! Not guaranteed: that the function is the distance itself, where surfaces join.
//!
//! # References
//! Hart, *Sphere tracing: a geometric method for the antialiased ray tracing of implicit surfaces*, The
//! Visual Computer 1996.

mod bracket;
mod cup;
mod faces;
mod handles;
mod plate;
#[cfg(test)]
mod tests;

pub use bracket::BracketForm;
pub use cup::CupForm;
pub use faces::TrueEdge;
pub use handles::HandlesForm;
pub use plate::PlateForm;

use crate::truth::{TruthPoint, positive};
use crate::virtual_sensor::ScannedSurface;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, TriangleMesh, isosurface};
use serde::Serialize;

/// Largest genus of `handles`; with more rings, tubes would be thinner than 2 % of the length.
const MAX_GENUS: usize = 16;
/// Distance at which a ray has met the surface, relative to the size.
const HIT: f64 = 1e-10;
/// Maximum number of steps of a ray.
///
/// A ray at 75° from the normal needs about 80 steps. Only rays that pass very close to a silhouette need
/// more.
const MAX_STEPS: usize = 2_000;
/// Step of the differences that give normals, relative to the size.
///
/// Rounding errors of a smaller step exceed 1e-10; a larger one mixes the normals of two faces at more
/// points.
const DIFFERENCE: f64 = 1e-6;

/// A kind of object. Lengths are in the unit of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ObjectKind {
    /// A row of rings that are joined smoothly.
    Handles {
        /// Number of rings, from 1 to 16.
        genus: usize,
    },
    /// A rectangular plate with round through holes.
    Plate {
        /// Number of holes, from 1 to 8.
        holes: usize,
    },
    /// A cup with a thin wall and a handle.
    Cup {
        /// Thickness of the wall. Default: 4 % of the size.
        wall: Option<f64>,
    },
    /// An angle bracket with holes and a fillet.
    Bracket {
        /// Radius of the fillet. Default: 8 % of the size.
        fillet: Option<f64>,
    },
}

/// A solid object with an exactly known surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum SolidObject {
    /// A row of rings.
    Handles(HandlesForm),
    /// A plate with holes.
    Plate(PlateForm),
    /// A cup with a handle.
    Cup(CupForm),
    /// An angle bracket.
    Bracket(BracketForm),
}

/// A round through hole.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrueHole {
    /// Middle of the axis within the material.
    pub point: DVec3,
    /// Unit direction of the axis.
    pub axis: DVec3,
    /// Radius.
    pub radius: f64,
    /// Length of the axis within the material.
    pub length: f64,
}

impl TrueHole {
    /// Distance of a point from the wall of the hole; positive inside the hole.
    fn depth(&self, p: DVec3) -> f64 {
        let d = p - self.point;
        self.radius - (d - d.dot(self.axis) * self.axis).length()
    }
}

/// A concave fillet: a quarter of a cylinder that is tangent to two planes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrueFillet {
    /// Middle of the axis of the cylinder.
    pub point: DVec3,
    /// Unit direction of the axis.
    pub axis: DVec3,
    /// Radius.
    pub radius: f64,
    /// Length along the axis.
    pub length: f64,
}

/// The ground truth of an object as a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectMesh {
    /// A watertight mesh that faces outwards. Its vertices lie on the surface.
    pub mesh: TriangleMesh,
    /// Unit normal of each vertex. At a sharp edge it is the mean of those of the faces.
    pub normals: Vec<DVec3>,
    /// Sharp edges of the object.
    pub edges: Vec<TrueEdge>,
    /// Maximum distance of the centre of a triangle from the surface.
    pub chord_error: f64,
}

/// A solid object, given by a function that is negative inside.
///
/// Laws, which the tests check for each object: `|value(p) − value(q)| ≤ |p − q|`, the surface lies within
/// `bounds`, and the mesh has the genus.
trait ImplicitSolid {
    /// The function: negative inside, zero on the surface, positive outside.
    fn value(&self, p: DVec3) -> f64;

    /// A box around the object.
    fn bounds(&self) -> BoundingBox;

    /// Number of handles of the surface.
    fn genus(&self) -> usize;

    /// Distance of neighbouring vertices of the mesh.
    fn cell(&self) -> f64;

    /// Height, from 1 to −1, of the direction of a view at this share of all views, from 0 to 1.
    ///
    /// The default spreads views evenly over all directions.
    fn view_height(&self, share: f64) -> f64 {
        1.0 - 2.0 * share
    }

    /// Round through holes.
    fn holes(&self) -> &[TrueHole] {
        &[]
    }

    /// Fillets.
    fn fillets(&self) -> Vec<TrueFillet> {
        Vec::new()
    }

    /// A mesh with vertices about `spacing` apart and exact sharp edges; `None` for a smooth object.
    fn exact_mesh(&self, _spacing: f64) -> Option<Result<(TriangleMesh, Vec<TrueEdge>)>> {
        None
    }
}

impl SolidObject {
    /// An object of about this size.
    ///
    /// # Errors
    /// `Input` for a genus, a number of holes, a thickness or a radius out of range.
    ///
    /// # Examples
    /// ```
    /// use planish_simulate::{ObjectKind, SolidObject};
    /// # fn main() -> planish_estimate::Result<()> {
    /// let plate = SolidObject::new(ObjectKind::Plate { holes: 2 }, 100.0)?;
    /// assert_eq!((plate.genus(), plate.holes().len()), (2, 2));
    /// let truth = plate.mesh()?;
    /// assert!(truth.mesh.check().watertight);
    /// // 12 straight edges and two circles for each hole.
    /// assert_eq!(truth.edges.len(), 12 + 4);
    /// # Ok(())
    /// # }
    /// ```
    pub fn new(kind: ObjectKind, size: f64) -> Result<Self> {
        positive("size", size)?;
        Ok(match kind {
            ObjectKind::Handles { genus } => {
                if !(1..=MAX_GENUS).contains(&genus) {
                    return Err(Error::input(format!(
                        "expected a genus from 1 to {MAX_GENUS}, found {genus}"
                    )));
                }
                Self::Handles(HandlesForm::new(genus, size))
            }
            ObjectKind::Plate { holes } => Self::Plate(PlateForm::new(holes, size)?),
            ObjectKind::Cup { wall } => Self::Cup(CupForm::new(wall, size)?),
            ObjectKind::Bracket { fillet } => Self::Bracket(BracketForm::new(fillet, size)?),
        })
    }

    fn solid(&self) -> &dyn ImplicitSolid {
        match self {
            Self::Handles(form) => form,
            Self::Plate(form) => form,
            Self::Cup(form) => form,
            Self::Bracket(form) => form,
        }
    }

    /// Name of the scene.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Handles(_) => "handles",
            Self::Plate(_) => "plate",
            Self::Cup(_) => "cup",
            Self::Bracket(_) => "bracket",
        }
    }

    /// Number of handles of the surface.
    #[must_use]
    pub fn genus(&self) -> usize {
        self.solid().genus()
    }

    /// Round through holes.
    #[must_use]
    pub fn holes(&self) -> &[TrueHole] {
        self.solid().holes()
    }

    /// Fillets.
    #[must_use]
    pub fn fillets(&self) -> Vec<TrueFillet> {
        self.solid().fillets()
    }

    /// A box around the object.
    #[must_use]
    pub fn bounds(&self) -> BoundingBox {
        self.solid().bounds()
    }

    /// Height, from 1 to −1, of the direction of a view at this share of all views, from 0 to 1.
    pub(super) fn view_height(&self, share: f64) -> f64 {
        self.solid().view_height(share)
    }

    /// A function of a point that is negative inside, zero on the surface and positive outside.
    ///
    /// It changes by at most the distance between two points.
    #[must_use]
    pub fn value(&self, p: DVec3) -> f64 {
        self.solid().value(p)
    }

    /// Gradient of the function, by central differences.
    fn gradient(&self, p: DVec3) -> DVec3 {
        let h = DIFFERENCE * self.bounds().longest_side();
        let slope = |e: DVec3| (self.value(p + h * e) - self.value(p - h * e)) / (2.0 * h);
        DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z))
    }

    /// The ground truth as a fine mesh: 30 000 to 700 000 triangles.
    ///
    /// # Errors
    /// None for an object of [`SolidObject::new`].
    pub fn mesh(&self) -> Result<ObjectMesh> {
        let solid = self.solid();
        let (mesh, edges) = match solid.exact_mesh(solid.cell()) {
            Some(made) => made?,
            None => (self.zero_surface()?, Vec::new()),
        };
        // The gradient is undefined at a sharp edge. Elsewhere it is more accurate than normals of facets.
        let normals = if edges.is_empty() {
            let normal = |&p: &DVec3| self.gradient(p).try_normalize().unwrap_or(DVec3::ZERO);
            mesh.positions.iter().map(normal).collect()
        } else {
            mesh.vertex_normals()
        };
        let chord_error = (0..mesh.triangles.len())
            .map(|t| self.distance(mesh.point_at(t, [1.0 / 3.0; 3])))
            .fold(0.0, f64::max);
        Ok(ObjectMesh { mesh, normals, edges, chord_error })
    }

    /// Distance of a point close to the surface, to first order.
    fn distance(&self, p: DVec3) -> f64 {
        self.value(p).abs() / self.gradient(p).length().clamp(0.1, 1.0)
    }

    /// The zero surface of the function.
    fn zero_surface(&self) -> Result<TriangleMesh> {
        let (bounds, cell) = (self.bounds(), self.solid().cell());
        // An irrational offset: corners of the grid on the surface would give triangles without area.
        let margin = DVec3::new(1.618, 1.414, 1.732) * cell;
        let bounds = BoundingBox { min: bounds.min - margin, max: bounds.max + 2.0 * margin };
        isosurface(&bounds, cell, |p| self.value(p), |p, reach| self.value(p).abs() <= reach)
    }
}

impl ScannedSurface for SolidObject {
    /// Steps along the ray by the value of the function, which no surface is nearer than.
    fn first_point(&self, origin: DVec3, direction: DVec3) -> Option<TruthPoint> {
        let bounds = self.bounds();
        let size = bounds.longest_side();
        // The part of the ray within a ball around the object.
        let radius = 0.51 * bounds.diagonal();
        let middle = (bounds.center() - origin).dot(direction);
        let off_axis = (origin + middle * direction).distance(bounds.center());
        let half = (radius * radius - off_axis * off_axis).max(0.0).sqrt();
        let mut along = (middle - half).max(0.0);
        for _ in 0..MAX_STEPS {
            if along > middle + half {
                return None;
            }
            let p = origin + along * direction;
            let value = self.value(p);
            if value < HIT * size {
                let normal = self.gradient(p).try_normalize()?;
                return Some(TruthPoint { parameters: None, position: p, normal });
            }
            along += value;
        }
        None
    }
}
