//! A rectangular plate with round through holes and sharp edges.

use super::faces::{self, FaceMesh, TrueEdge};
use super::{ImplicitSolid, TrueHole};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, TriangleMesh};
use serde::Serialize;

/// Length, width and thickness, relative to the size.
const SIDES: DVec3 = DVec3::new(1.0, 0.6, 0.1);
/// Largest radius of a hole, relative to the size.
const MAX_RADIUS: f64 = 0.12;
/// Maximum number of holes; more would be too small to see through from most views.
const MAX_HOLES: usize = 8;

/// A plate around the origin, with its thickness along z and a row of holes along x.
///
/// The genus is the number of holes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlateForm {
    /// Length, width and thickness.
    pub sides: DVec3,
    /// The holes.
    #[serde(skip)]
    pub(super) holes: Vec<TrueHole>,
}

impl PlateForm {
    /// A plate that is `size` long, with this number of holes.
    ///
    /// # Errors
    /// `Input` for no hole or more than eight.
    pub(super) fn new(holes: usize, size: f64) -> Result<Self> {
        if !(1..=MAX_HOLES).contains(&holes) {
            return Err(Error::input(format!("expected 1 to {MAX_HOLES} holes in the plate, found {holes}")));
        }
        let sides = size * SIDES;
        let pitch = sides.x / holes as f64;
        let hole = |k: usize| TrueHole {
            point: DVec3::new(pitch * (k as f64 + 0.5) - 0.5 * sides.x, 0.0, 0.0),
            axis: DVec3::Z,
            // Every other hole is smaller, so that the holes differ.
            radius: (0.32 * pitch).min(MAX_RADIUS * size) * if k.is_multiple_of(2) { 1.0 } else { 0.75 },
            length: sides.z,
        };
        Ok(Self { sides, holes: (0..holes).map(hole).collect() })
    }
}

impl ImplicitSolid for PlateForm {
    fn value(&self, p: DVec3) -> f64 {
        let block = (p.abs() - 0.5 * self.sides).max_element();
        self.holes.iter().fold(block, |value, hole| value.max(hole.depth(p)))
    }

    fn bounds(&self) -> BoundingBox {
        BoundingBox { min: -0.5 * self.sides, max: 0.5 * self.sides }
    }

    fn genus(&self) -> usize {
        self.holes.len()
    }

    fn cell(&self) -> f64 {
        0.008 * self.sides.x
    }

    fn holes(&self) -> &[TrueHole] {
        &self.holes
    }

    fn exact_mesh(&self, spacing: f64) -> Option<Result<(TriangleMesh, Vec<TrueEdge>)>> {
        let mut mesh = FaceMesh::new(spacing);
        let half = 0.5 * self.sides;
        // Counter-clockwise from above, at the lower and at the upper side.
        let corners = [-1.0, 1.0].map(|z| {
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                .map(|[x, y]| mesh.vertex(half * DVec3::new(x, y, z)))
        });
        let upright: Vec<Vec<u32>> = (0..4).map(|k| mesh.line(corners[0][k], corners[1][k])).collect();
        let sides = corners.map(|at| [0, 1, 2, 3].map(|k| mesh.line(at[k], at[(k + 1) % 4])));
        for k in 0..4 {
            let [lower, upper] = [0, 1].map(|z| &sides[z][k]);
            mesh.ruled(lower, upper, Some([&upright[k], &upright[(k + 1) % 4]]));
        }
        let mut curves = sides.map(|sides| vec![faces::boundary(&sides)]);
        for hole in &self.holes {
            let [lower, upper] = [-half.z, half.z]
                .map(|z| mesh.circle(hole.point + z * DVec3::Z, DVec3::Z, DVec3::X, hole.radius));
            // The wall of a hole faces its axis.
            mesh.ruled(&upper, &lower, None);
            curves[0].push(lower);
            curves[1].push(upper);
        }
        let [lower, upper] = &curves;
        let filled = mesh.plane(-DVec3::Z, lower).and_then(|()| mesh.plane(DVec3::Z, upper));
        Some(filled.map(|()| mesh.finish()))
    }
}
