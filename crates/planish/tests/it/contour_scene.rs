//! The scene `contours` against `sense contours`.

use planish::Job;
use planish::Unit;
use planish::occluding::{OccludingJob, OccludingOptions};
use planish::progress::Silent;
use planish::simulate::{ContoursOptions, ContoursShape, write_contours_scene};
use planish_exchange::ply::read_scan;

/// Points of the scene's contours lie on the object to within their σ, for both shapes, and follow from
/// the masks alone, too.
#[test]
fn points_of_the_scene_lie_on_the_object() {
    for shape in [ContoursShape::Hyperboloid, ContoursShape::Carafe] {
        let folder = tempfile::tempdir().unwrap();
        let options = ContoursOptions { shape, views: 11, sigma_px: 0.2, seed: 4, unit: Unit::Millimetre };
        let made = write_contours_scene(&options, folder.path()).unwrap();
        assert!(made.files.iter().all(|path| path.is_file()) && made.views.len() == 2);
        let output = folder.path().join("points.ply");
        let mut job = OccludingJob {
            views: made.views[0].clone(),
            outputs: vec![output.clone()],
            patches: Vec::new(),
            min_points: 200,
            hull: None,
            surface: None,
            judged: None,
            options: OccludingOptions::default(),
            unit: None,
            seed: 0,
        };
        let report = job.run(&Silent).unwrap();
        assert!(report.observations > 800, "{report:?}");
        assert!((report.chi2 - 1.0).abs() < 0.1, "{}", report.chi2);
        let off = |scan: &planish_sense::Scan| {
            let squares: Vec<f64> = (0..scan.points.len())
                .map(|k| {
                    let p = scan.points[k];
                    let [r, slope] = shape.profile(p[2]);
                    let height = (p[0].hypot(p[1]) - r) / slope.hypot(1.0);
                    let normal = scan.normals.as_ref().unwrap()[k];
                    height * height / scan.covariance.as_ref().unwrap()[k].along(normal)
                })
                .collect();
            (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
        };
        let normalised = off(&read_scan(&output).unwrap());
        assert!((0.7..1.25).contains(&normalised), "{shape:?} {normalised}");
        // The same of masks: places of rims are among them, and are not on the profile.
        let text = std::fs::read_to_string(&made.views[0]).unwrap();
        let masks: Vec<&str> = text.lines().filter(|line| !line.starts_with("contours")).collect();
        job.views = folder.path().join("masks.toml");
        std::fs::write(&job.views, masks.join("\n")).unwrap();
        let report = job.run(&Silent).unwrap();
        let scan = read_scan(&output).unwrap();
        let sides = (scan.points.iter())
            .filter(|p| p[2].abs() < 40.0)
            .map(|p| (p[0].hypot(p[1]) - shape.profile(p[2])[0]).abs());
        let near = sides.clone().filter(|d| *d < 0.1).count();
        assert!(report.observations > 600 && near as f64 > 0.97 * sides.count() as f64, "{near} {report:?}");
    }
}
