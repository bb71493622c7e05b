//! Parts of a mesh that extend beyond an outline.

use super::super::equations::{Equations, Source};
use super::super::problem::{Problem, State};
use super::outlines::{FOCAL, camera_at};
use super::*;
use crate::field::ShellOptions;

/// A part beyond its outline is moved by the distance in the image, also for a plate that faces the camera.
/// The depth of a line of sight within it, half its thickness, is unrelated to the distance from its rim.
#[test]
fn a_plate_larger_than_its_outline_is_reduced() {
    let mut mesh = icosphere(1.0, 3);
    mesh.positions.iter_mut().for_each(|p| p[2] *= 0.02);
    let controls = automatic_controls(&mesh, 12).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let camera = camera_at(DVec3::new(0.1, 0.0, 5.0), 0.3);
    let (middle, _) = camera.project(DVec3::ZERO).unwrap();
    let towards = |k: usize, r: f64| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / 360.0).sin_cos();
        [middle[0] + r * cos, middle[1] + r * sin]
    };
    let outline = (0..360)
        .map(|k| OutlinePoint { pixel: towards(k, 100.0), sigma_px: 1.0, kind: OutlineKind::Border })
        .collect();
    let beyond = 23.0;
    let views = [ShellView {
        camera,
        pose: None,
        outline,
        inside: Vec::new(),
        outside: vec![towards(77, 100.0 + beyond), towards(200, 700.0)],
    }];
    let problem = Problem {
        mesh: &mesh,
        origins: None,
        triangles: &mesh.triangles,
        deformation: &deformation,
        readings: &ShellReadings { views: &views, ..ShellReadings::default() },
        shell: ShellOptions { oriented: true, ..ShellOptions::new(Metaball::Triangular, 10.0) },
        slots: &[None],
        chosen: &[],
        by_sheets: false,
    };
    let state = State { q: DVector::zeros(deformation.parameters()), cameras: vec![camera] };
    let made = problem.equations(&state, None).unwrap();
    let search = MeshSearch::try_new(&mesh).unwrap();
    let first = search.first_hit(camera.center(), camera.direction(views[0].outside[0])).unwrap();
    let along = towards(77, 1.0);
    let in_picture = |at: DVec3| {
        let (pixel, _) = camera.project(at).unwrap();
        (pixel[0] - middle[0]) * (along[0] - middle[0]) + (pixel[1] - middle[1]) * (along[1] - middle[1])
    };
    let mut found = 0;
    for (equation, vertices, _) in
        made.iter().flat_map(Equations::iter).filter(|(e, ..)| e.source == Source::Region)
    {
        found += 1;
        assert!((equation.distance - beyond).abs() < 0.01, "{}", equation.distance);
        // A common motion of all vertices changes the value by the motion in the image.
        for k in 0..3 {
            let stated: f64 = vertices.iter().map(|(_, by)| by[k]).sum();
            let axis = [DVec3::X, DVec3::Y, DVec3::Z][k];
            let moved = |by: f64| in_picture(first.point + by * axis);
            let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            // The far side is 1 % farther from the camera.
            assert!((stated - difference).abs() < 0.02 * FOCAL / 5.0, "{stated} {difference}");
        }
    }
    // Near and far side; a line without hits has no reading.
    assert_eq!(found, 2);
}
