//! The job `simulate sphere`: files written and options refused.

use planish::progress::Silent;
use planish::simulate::{SphereJob, SphereOptions, sphere};
use planish::{ErrorKind, Job};

#[test]
fn figures_have_all_rows_and_invalid_options_write_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let small = SphereOptions {
        sets: 1,
        readings: vec![50],
        noise_percent: vec![0.0, 6.0],
        depth: 0,
        ..SphereOptions::default()
    };
    let paths = ["a.csv", "a.svg"].map(|name| folder.path().join(name));
    let job = |outputs: &[std::path::PathBuf]| SphereJob {
        options: small.clone(),
        outputs: outputs.to_vec(),
        ..SphereJob::default()
    };
    let rows = job(&paths).run(&Silent).unwrap();
    let [table, drawing] = paths.map(|path| std::fs::read_to_string(path).unwrap());
    assert_eq!(table.lines().count(), rows.len() + 1);
    assert!(table.starts_with("readings,noise_percent,orientation_deg,depth,leaf_patches,patch_percent"));
    assert!(drawing.starts_with("<svg") && drawing.ends_with("</svg>\n"));
    assert!(drawing.contains("maximum position noise / % of the radius") && !drawing.contains("NaN"));
    assert_eq!(rows, sphere(&small, &Silent).unwrap(), "the same seed gives the same numbers");

    let wrong = folder.path().join("a.png");
    let refused = job(&[wrong]).run(&Silent).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::Unsupported);
    for bad in [
        SphereOptions { sets: 0, ..small.clone() },
        SphereOptions { readings: vec![5], ..small.clone() },
        SphereOptions { noise_percent: vec![-1.0], ..small.clone() },
    ] {
        assert_eq!(sphere(&bad, &Silent).unwrap_err().kind(), ErrorKind::Input);
    }
}
