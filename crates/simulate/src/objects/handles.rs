//! A row of rings that are joined smoothly: a closed surface of any genus.

use super::ImplicitSolid;
use planish_core::DVec3;
use planish_mesh::BoundingBox;
use serde::Serialize;

/// Radius of the tube of a ring, relative to the radius of the ring.
const TUBE_RADIUS: f64 = 0.35;
/// Width of the blend of two rings, relative to the radius of the tube.
///
/// A wider blend closes the holes: their radius is 1.86 tube radii, and the blend thickens a junction by up
/// to `ln 2` widths.
const BLEND: f64 = 0.3;

/// Rings in the plane `z = 0`, side by side along x; each touches the next along its centre line.
///
/// With the distances `d_k` of a point from the centre lines, circles of radius `R`, the surface is
///
/// ```text
/// −w ln Σ_k exp(−d_k / w) = r
/// ```
///
/// For one ring it is a torus. The surface is smooth, and its genus is the number of rings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HandlesForm {
    /// Centres of the rings.
    pub centers: Vec<DVec3>,
    /// Radius `R` of the centre line of a ring.
    pub ring_radius: f64,
    /// Radius `r` of the tube.
    pub tube_radius: f64,
    /// Width `w` of the blend between rings.
    pub blend: f64,
}

impl HandlesForm {
    /// A row of `genus` rings that is about `size` long.
    pub(super) fn new(genus: usize, size: f64) -> Self {
        let ring_radius = 0.5 * size / (genus as f64 + TUBE_RADIUS);
        let tube_radius = TUBE_RADIUS * ring_radius;
        let x = |k: usize| ring_radius * (2.0 * k as f64 + 1.0 - genus as f64);
        Self {
            centers: (0..genus).map(|k| DVec3::new(x(k), 0.0, 0.0)).collect(),
            ring_radius,
            tube_radius,
            blend: BLEND * tube_radius,
        }
    }
}

impl ImplicitSolid for HandlesForm {
    fn value(&self, p: DVec3) -> f64 {
        let distances = (self.centers.iter()).map(|center| {
            let d = p - *center;
            (d.x.hypot(d.y) - self.ring_radius).hypot(d.z)
        });
        // The smallest distance is taken out of the sum, so that no exponential underflows.
        let nearest = distances.clone().fold(f64::INFINITY, f64::min);
        let sum: f64 = distances.map(|d| ((nearest - d) / self.blend).exp()).sum();
        nearest - self.blend * sum.ln() - self.tube_radius
    }

    fn bounds(&self) -> BoundingBox {
        let mut bounds = BoundingBox::EMPTY;
        // Where two rings meet, the tube is thicker by at most `ln 2` blends.
        let thick = self.tube_radius + self.blend;
        let reach = DVec3::new(self.ring_radius + thick, self.ring_radius + thick, thick);
        for &center in &self.centers {
            bounds.include(center - reach);
            bounds.include(center + reach);
        }
        bounds
    }

    fn genus(&self) -> usize {
        self.centers.len()
    }

    /// The number of triangles, about 200 000, hardly depends on the genus. The chord error is at most a
    /// hundredth of the radius of the tube.
    fn cell(&self) -> f64 {
        self.tube_radius * (self.centers.len() as f64).sqrt() / 16.0
    }
}
