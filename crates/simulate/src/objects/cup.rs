//! A cup with a thin wall, a rounded rim and a handle.

use super::ImplicitSolid;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::BoundingBox;
use serde::Serialize;

/// Radius of the middle of the wall, height of its upper end and radius of its lower corner, relative to the
/// size.
const BODY: [f64; 3] = [0.35, 0.75, 0.12];
/// Height of the centre of the handle, radius of its centre line and radius of its tube, relative to the
/// size.
const HANDLE: [f64; 3] = [0.4, 0.21, 0.045];
/// Width of the blend of wall and handle, relative to the size.
const BLEND: f64 = 0.05;
/// Thickness of the wall, relative to the size: default, minimum and maximum.
///
/// Below the minimum, the mesh of the ground truth would need millions of triangles for the rounded rim;
/// above the maximum, the handle would leave too little room between it and the wall.
const WALL: [f64; 3] = [0.04, 0.03, 0.1];
/// Side of the cells of the mesh, relative to the size: at most a quarter of the wall, so that the rounded
/// rim has several cells. The chord error of the rim is then about 0.1 % of the size.
const CELL: f64 = 0.0075;

/// A cup around the z axis whose bottom is at `z = 0`, with a handle in the plane `y = 0` at positive x.
///
/// The wall has half its thickness on either side of a curve that is rotated about the axis: a straight line
/// from the axis, a quarter of a circle, and a straight line upwards. The handle is the part of a torus
/// outside this surface. Wall and handle join by the quadratic smooth minimum
/// `min(a, b) − max(w − |a − b|, 0)² / 4w` of their distances. The genus is 1.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CupForm {
    /// Radius of the middle of the wall.
    pub radius: f64,
    /// Height of the upper end of the middle of the wall; the rim is half a thickness higher.
    pub height: f64,
    /// Radius of the lower corner of the middle of the wall.
    pub corner_radius: f64,
    /// Thickness of the wall; the rim is rounded with half of it.
    pub thickness: f64,
    /// Height of the centre of the handle above the bottom of the middle of the wall.
    pub handle_height: f64,
    /// Radius of the centre line of the handle.
    pub handle_radius: f64,
    /// Radius of the tube of the handle.
    pub handle_tube_radius: f64,
    /// Width `w` of the blend of wall and handle.
    pub blend: f64,
}

impl CupForm {
    /// A cup of about `size`.
    ///
    /// # Errors
    /// `Input` for a thickness below 3 % or above 10 % of the size.
    pub(super) fn new(thickness: Option<f64>, size: f64) -> Result<Self> {
        let [default, min, max] = WALL.map(|share| share * size);
        let thickness = thickness.unwrap_or(default);
        if !(thickness >= min && thickness <= max) {
            return Err(Error::input(format!(
                "expected a wall thickness from 3 % to 10 % of the size of the cup, {size}, found {thickness}"
            )));
        }
        let [radius, height, corner_radius] = BODY.map(|share| share * size);
        let [handle_height, handle_radius, handle_tube_radius] = HANDLE.map(|share| share * size);
        Ok(Self {
            radius,
            height,
            corner_radius,
            thickness,
            handle_height,
            handle_radius,
            handle_tube_radius,
            blend: BLEND * size,
        })
    }

    /// Distance from the wall at a distance `rho` from the axis and a height `z`.
    fn wall(&self, rho: f64, z: f64) -> f64 {
        let corner = self.radius - self.corner_radius;
        let middle = if rho > corner && z < self.corner_radius {
            ((rho - corner).hypot(z - self.corner_radius) - self.corner_radius).abs()
        } else {
            let bottom = (rho - corner).max(0.0).hypot(z);
            let above = (z - self.height).max(0.0) + (self.corner_radius - z).max(0.0);
            bottom.min((rho - self.radius).hypot(above))
        };
        middle - 0.5 * self.thickness
    }
}

impl ImplicitSolid for CupForm {
    fn value(&self, p: DVec3) -> f64 {
        let z = p.z - 0.5 * self.thickness;
        let rho = p.x.hypot(p.y);
        let wall = self.wall(rho, z);
        let ring = (p.x - self.radius).hypot(z - self.handle_height) - self.handle_radius;
        let handle = ring.hypot(p.y) - self.handle_tube_radius;
        let overlap = (self.blend - (wall - handle).abs()).max(0.0);
        let joined = wall.min(handle) - 0.25 * overlap * overlap / self.blend;
        // Neither the handle nor the blend may reach the inner side of the wall.
        wall.min(joined.max(self.radius - rho))
    }

    fn bounds(&self) -> BoundingBox {
        let radius = self.radius + 0.5 * self.thickness;
        let handle = self.radius + self.handle_radius + self.handle_tube_radius;
        BoundingBox {
            min: DVec3::new(-radius, -radius, 0.0),
            max: DVec3::new(radius.max(handle), radius, self.height + self.thickness),
        }
    }

    fn genus(&self) -> usize {
        1
    }

    fn cell(&self) -> f64 {
        CELL * self.height / BODY[1]
    }

    /// More views from above: only those see the inner wall. Of twelve evenly spread views, 10 % of the
    /// surface remained unmeasured.
    fn view_height(&self, share: f64) -> f64 {
        1.0 - 2.0 * share * share
    }
}
