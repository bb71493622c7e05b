//! The report of a shape in space: a plane, sphere, cylinder or box on its readings.

use super::page::{figures, headline, part_blocks};
use crate::contour::ContourReport;
use crate::report::scenes::{kinds, numbers};
use crate::report::title_of;
use crate::report::words::with_article;
use planish_contour::primitive::{PrimitiveFit, PrimitiveKind};
use planish_core::{DVec3, vector3::tangents};
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, TriangleMesh, icosphere, parallelepiped};
use planish_report::{Cloud, FieldKind, Page, Scene, Section, SurfaceShown};
use std::path::{Path, PathBuf};

/// Number of sides of a drawn cylinder. Its chords miss the circle by 0.05 % of the radius.
const SIDES: u32 = 96;

/// The page of a shape in space, with the points that were read.
pub(crate) fn shape_page(
    report: &ContourReport,
    fit: &PrimitiveFit,
    points: Vec<DVec3>,
    input: &Path,
    gate: Option<f64>,
) -> Result<Page> {
    let unit = report.unit.map_or("", |unit| unit.name());
    // Rejected readings must not enlarge a plane or a cylinder.
    let counting: Vec<DVec3> =
        (points.iter().zip(&fit.used)).filter(|(_, used)| **used).map(|(p, _)| *p).collect();
    let mesh = mesh_of(fit.shape, &fit.parameters, &counting)?;
    let used = fit.used.iter().map(|used| u16::from(*used)).collect();
    Ok(Page {
        job: "contour".to_owned(),
        title: title_of(&[PathBuf::from(input)]),
        headline: headline(report),
        findings: report.findings.clone(),
        figures: figures(report, unit),
        scene: Some(Scene {
            unit: unit.to_owned(),
            surfaces: vec![SurfaceShown {
                name: fit.shape.to_string(),
                positions: mesh.positions,
                triangles: mesh.triangles,
                // Averaged normals would round off the edges of a box.
                flat: fit.shape == PrimitiveKind::Box,
                // Readings lie on both sides of the surface and must stay visible.
                translucent: true,
                ..SurfaceShown::default()
            }],
            clouds: vec![Cloud {
                name: "readings".to_owned(),
                positions: points,
                fields: vec![
                    numbers(
                        "distance",
                        "normalised distance",
                        "",
                        // Colours saturate where readings are rejected.
                        FieldKind::Signed(gate),
                        fit.distances.clone(),
                    ),
                    kinds(
                        "used",
                        "used",
                        FieldKind::Categories(vec![(1, "yes".to_owned()), (0, "no: rejected".to_owned())]),
                        used,
                    ),
                ],
                width: 4,
                ..Cloud::default()
            }],
            ..Scene::default()
        }),
        drawings: Vec::new(),
        sections: (report.contours.iter())
            .map(|part| Section::new(with_article(&part.kind), part_blocks(part, unit)))
            .collect(),
    })
}

/// A shape as triangles. A shape without ends is as large as its readings.
fn mesh_of(shape: PrimitiveKind, parameters: &[f64], used: &[DVec3]) -> Result<TriangleMesh> {
    let bounds = BoundingBox::from_points(used).ok_or_else(|| Error::undetermined("no reading counts"))?;
    let number = |k: usize| parameters[k];
    let place = |k: usize| DVec3::new(number(k), number(k + 1), number(k + 2));
    let reach = |along: DVec3, from: DVec3| {
        let values = used.iter().map(|p| (*p - from).dot(along));
        [values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max)]
    };
    match shape {
        PrimitiveKind::Sphere => {
            let mut ball = icosphere(number(3), 5);
            ball.positions.iter_mut().for_each(|p| *p += place(0));
            Ok(ball)
        }
        PrimitiveKind::Plane => {
            let normal =
                place(0).try_normalize().ok_or_else(|| Error::undetermined("a plane without a normal"))?;
            let middle = bounds.center();
            // The point of the plane nearest to the middle of the readings. The origin may be far away.
            let foot = middle + (number(3) - normal.dot(middle)) * normal;
            let (a, b) = tangents(normal);
            let [along, across] = [reach(a, foot), reach(b, foot)];
            let corner = |x: f64, y: f64| foot + x * a + y * b;
            TriangleMesh::try_new(
                vec![
                    corner(along[0], across[0]),
                    corner(along[1], across[0]),
                    corner(along[1], across[1]),
                    corner(along[0], across[1]),
                ],
                vec![[0, 1, 2], [0, 2, 3]],
            )
        }
        PrimitiveKind::Cylinder => {
            let axis =
                place(3).try_normalize().ok_or_else(|| Error::undetermined("a cylinder without an axis"))?;
            let (a, _) = tangents(axis);
            let b = axis.cross(a);
            // A cylinder has no ends, so the outermost readings along the axis are used.
            let ends = reach(axis, place(0));
            let ring = |end: f64, side: u32| {
                let (sine, cosine) = (std::f64::consts::TAU * f64::from(side) / f64::from(SIDES)).sin_cos();
                let out = number(6) * cosine * a + number(6) * sine * b;
                place(0) + end * axis + out
            };
            let positions = ends.iter().flat_map(|end| (0..SIDES).map(|side| ring(*end, side)));
            let triangles = (0..SIDES).flat_map(|k| {
                let next = (k + 1) % SIDES;
                [[k, next, SIDES + next], [k, SIDES + next, SIDES + k]]
            });
            TriangleMesh::try_new(positions.collect(), triangles.collect())
        }
        PrimitiveKind::Box => {
            let edges = [0, 1, 2].map(|d| number(3 + d) * place(6 + 3 * d));
            Ok(parallelepiped(place(0), edges))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_contour::primitive::{SimulatedPrimitive, SpaceSensor, rays};
    use planish_mesh::MeshSearch;

    /// Readings without errors are on the drawn triangles of their shape.
    #[test]
    fn the_drawing_shows_the_shape() {
        let sensor = SpaceSensor {
            standoff: 10.0,
            sigma_position: 1e-3,
            sigma_angle_rad: 1e-4,
            sigma_range_share: 1e-4,
        };
        for shape in PrimitiveKind::ALL {
            let solid = SimulatedPrimitive {
                shape,
                center: DVec3::new(0.4, -0.2, 0.3),
                turn: DVec3::new(0.3, 0.5, -0.2),
                size: [1.2, 0.8, 0.6],
            };
            let points: Vec<DVec3> =
                rays(&solid, 300, &sensor, 1).exact.iter().map(|ray| ray.point()).collect();
            let mesh = mesh_of(shape, &solid.parameters(), &points).unwrap();
            let search = MeshSearch::try_new(&mesh).unwrap();
            for foot in search.closest_all(&points) {
                let off = foot.unwrap().signed_distance.abs();
                // Facets of round shapes cut inside of them.
                assert!(off < 2e-3, "{shape}: {off}");
            }
        }
    }
}
