//! An angle bracket with a fillet, through holes and sharp edges.

use super::faces::{FaceMesh, TrueEdge, boundary};
use super::{ImplicitSolid, TrueFillet, TrueHole};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, TriangleMesh};
use serde::Serialize;

/// Length of the base along x, width along y and height of the upright along z, relative to the size.
const SIDES: DVec3 = DVec3::new(1.0, 0.6, 0.7);
/// Thickness of both legs, relative to the size.
const THICKNESS: f64 = 0.1;
/// Radius of the fillet, relative to the size: default, minimum and maximum.
///
/// A larger fillet would reach the hole of the upright.
const FILLET: [f64; 3] = [0.08, 0.005, 0.2];
/// Distance along x, distance along y from the middle, and radius of the two holes of the base.
const BASE_HOLES: [f64; 3] = [0.7, 0.16, 0.06];
/// Height and radius of the hole of the upright.
const UPRIGHT_HOLE: [f64; 2] = [0.46, 0.12];

/// Two plates at a right angle: the base at `z ≥ 0` and the upright at `x ≥ 0`, with `y = 0` in the middle.
///
/// The inner corner has a fillet. Two holes through the base are parallel to z, one through the upright is
/// parallel to x. The genus is 3.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BracketForm {
    /// Length of the base, width, and height of the upright.
    pub sides: DVec3,
    /// Thickness of both legs.
    pub thickness: f64,
    /// Radius of the fillet.
    pub fillet_radius: f64,
    /// The holes.
    #[serde(skip)]
    pub(super) holes: Vec<TrueHole>,
}

impl BracketForm {
    /// A bracket that is `size` long.
    ///
    /// # Errors
    /// `Input` for a radius of the fillet below 0.5 % or above 20 % of the size.
    pub(super) fn new(fillet_radius: Option<f64>, size: f64) -> Result<Self> {
        let [default, min, max] = FILLET.map(|share| share * size);
        let fillet_radius = fillet_radius.unwrap_or(default);
        if !(fillet_radius >= min && fillet_radius <= max) {
            return Err(Error::input(format!(
                "expected a fillet radius from 0.5 % to 20 % of the size of the bracket, {size}, found \
                 {fillet_radius}"
            )));
        }
        let thickness = THICKNESS * size;
        let [x, y, radius] = BASE_HOLES.map(|share| share * size);
        let base = [-y, y].map(|y| TrueHole {
            point: DVec3::new(x, y, 0.5 * thickness),
            axis: DVec3::Z,
            radius,
            length: thickness,
        });
        let [z, radius] = UPRIGHT_HOLE.map(|share| share * size);
        let point = DVec3::new(0.5 * thickness, 0.0, z);
        let upright = TrueHole { point, axis: DVec3::X, radius, length: thickness };
        let holes = base.into_iter().chain([upright]).collect();
        Ok(Self { sides: size * SIDES, thickness, fillet_radius, holes })
    }

    /// Distance from the legs of the centre line of the fillet.
    fn fillet_center(&self) -> f64 {
        self.thickness + self.fillet_radius
    }

    /// Corners of the profile in the plane of x and z, counter-clockwise seen from −y. The fillet is between
    /// the fourth and the fifth.
    fn profile(&self) -> [[f64; 2]; 7] {
        let (length, height) = (self.sides.x, self.sides.z);
        let (thickness, inner) = (self.thickness, self.fillet_center());
        [
            [0.0, 0.0],
            [length, 0.0],
            [length, thickness],
            [inner, thickness],
            [thickness, inner],
            [thickness, height],
            [0.0, height],
        ]
    }
}

/// Index of the corner of the profile where the fillet starts.
const FILLET_START: usize = 3;
/// Outward normals of the planes from each corner of the profile to the next; the fillet has none.
const NORMALS: [Option<DVec3>; 7] = [
    Some(DVec3::NEG_Z),
    Some(DVec3::X),
    Some(DVec3::Z),
    None,
    Some(DVec3::X),
    Some(DVec3::Z),
    Some(DVec3::NEG_X),
];

impl ImplicitSolid for BracketForm {
    fn value(&self, p: DVec3) -> f64 {
        let middle = DVec3::new(0.5 * self.sides.x, 0.0, 0.5 * self.sides.z);
        let block = ((p - middle).abs() - 0.5 * self.sides).max_element();
        // The space between the legs is a quadrant that is rounded by the fillet.
        let (a, b) = (self.fillet_center() - p.x, self.fillet_center() - p.z);
        let space = a.max(0.0).hypot(b.max(0.0)) + a.max(b).min(0.0) - self.fillet_radius;
        self.holes.iter().fold(block.max(-space), |value, hole| value.max(hole.depth(p)))
    }

    fn bounds(&self) -> BoundingBox {
        let half_width = 0.5 * self.sides.y * DVec3::Y;
        BoundingBox { min: -half_width, max: self.sides - half_width }
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

    fn fillets(&self) -> Vec<TrueFillet> {
        let center = self.fillet_center();
        vec![TrueFillet {
            point: DVec3::new(center, 0.0, center),
            axis: DVec3::Y,
            radius: self.fillet_radius,
            length: self.sides.y,
        }]
    }

    fn exact_mesh(&self, spacing: f64) -> Option<Result<(TriangleMesh, Vec<TrueEdge>)>> {
        Some(self.faces(spacing).map(FaceMesh::finish))
    }
}

impl BracketForm {
    /// The faces of the bracket with their sharp edges.
    fn faces(&self, spacing: f64) -> Result<FaceMesh> {
        let mut mesh = FaceMesh::new(spacing);
        let half = 0.5 * self.sides.y;
        let next = |k: usize| (k + 1) % NORMALS.len();
        // The ends of the extrusion, at −y and at +y.
        let ends = [-half, half].map(|y| {
            let corners = self.profile().map(|[x, z]| mesh.vertex(DVec3::new(x, y, z)));
            let center = DVec3::new(self.fillet_center(), y, self.fillet_center());
            let curves: Vec<Vec<u32>> = (0..corners.len())
                .map(|k| match k {
                    FILLET_START => mesh.arc(center, DVec3::Y, [corners[k], corners[next(k)]]),
                    _ => mesh.line(corners[k], corners[next(k)]),
                })
                .collect();
            (corners, curves)
        });
        let [(front, front_curves), (back, back_curves)] = &ends;
        let along: Vec<Vec<u32>> = (0..NORMALS.len())
            .map(|k| {
                // The fillet is tangent to both legs, so its borders are not sharp.
                let is_smooth = k == FILLET_START || k == next(FILLET_START);
                if is_smooth { mesh.smooth_line(back[k], front[k]) } else { mesh.line(back[k], front[k]) }
            })
            .collect();
        mesh.plane(DVec3::NEG_Y, &[boundary(front_curves)])?;
        mesh.plane(DVec3::Y, &[boundary(back_curves)])?;

        let mut rims: Vec<(DVec3, DVec3, Vec<u32>)> = Vec::new();
        for hole in &self.holes {
            let x = if hole.axis == DVec3::Z { DVec3::X } else { DVec3::Y };
            let [start, end] = [-0.5, 0.5].map(|share| {
                let center = hole.point + share * hole.length * hole.axis;
                (center, mesh.circle(center, hole.axis, x, hole.radius))
            });
            mesh.ruled(&end.1, &start.1, None);
            rims.push((end.0, hole.axis, end.1));
            rims.push((start.0, -hole.axis, start.1));
        }
        for (k, normal) in NORMALS.iter().enumerate() {
            let sides = [&along[k], &along[next(k)]];
            let Some(normal) = *normal else {
                mesh.ruled(&back_curves[k], &front_curves[k], Some(sides.map(Vec::as_slice)));
                continue;
            };
            let mut curves = vec![boundary(&[&front_curves[k], sides[1], &back_curves[k], sides[0]])];
            let height = |p: DVec3| p.dot(normal);
            let [x, z] = self.profile()[k];
            let plane = height(DVec3::new(x, 0.0, z));
            // A rim belongs to the plane that contains it and faces away from the hole.
            let is_here = |(center, axis, _): &&(DVec3, DVec3, Vec<u32>)| {
                *axis == normal && (height(*center) - plane).abs() < 1e-9 * self.thickness
            };
            curves.extend(rims.iter().filter(is_here).map(|(_, _, rim)| rim.clone()));
            mesh.plane(normal, &curves)?;
        }
        Ok(mesh)
    }
}
