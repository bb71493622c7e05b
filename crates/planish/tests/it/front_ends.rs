//! Dense stereo on a real pair with its true disparities, where it is at hand: in `../shared/data` beside the
//! repository, or in the folder that PLANISH_DATA names.

#![allow(clippy::print_stdout, reason = "a skipped test is said aloud")]

use planish::Job;
use planish::progress::Silent;
use planish::sense::{SenseJob, SenseKind};
use planish::{StereoOptions, StereoPoints};
use planish_exchange::picture::{read_brightness, read_picture};
use std::path::PathBuf;

fn cones() -> Option<PathBuf> {
    let data = std::env::var_os("PLANISH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")),
        PathBuf::from,
    );
    let folder = data.join("stereo/cones");
    if folder.join("Cones_LEFT.tif").is_file() {
        return Some(folder);
    }
    println!("skipped: the pair is not at {}", folder.display());
    None
}

#[test]
fn gross_errors_are_few_and_occur_where_sigma_is_large() {
    let Some(folder) = cones() else { return };
    let out = tempfile::tempdir().unwrap();
    let path = out.path().join("cones.npy");
    let job = SenseJob {
        kind: SenseKind::Stereo {
            left: folder.join("Cones_LEFT.tif"),
            right: folder.join("Cones_RIGHT.tif"),
            calibration: None,
            options: StereoOptions::default(),
            points: StereoPoints::default(),
        },
        outputs: vec![path.clone()],
        unit: None,
    };
    let report = job.run(&Silent).unwrap();
    assert_eq!(report.pixels, 450 * 375);
    let bytes = std::fs::read(&path).unwrap();
    let values: Vec<f32> = bytes[bytes.len() - 8 * report.pixels..]
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect();
    let truth = read_picture(&folder.join("Cones_LEFT_GT.tif")).unwrap();
    let seen = read_brightness(&folder.join("Occlusion_LEFT.png")).unwrap();
    let counted = (0..report.pixels).filter(|k| truth.values[*k] > 0.0 && seen.values[*k] > 0.0);
    let (mut all, mut known) = (0, Vec::new());
    for k in counted {
        all += 1;
        let error = (values[2 * k] - truth.values[k]).abs();
        if error.is_finite() {
            known.push((values[2 * k + 1], error));
        }
    }
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let bad = |part: &[(f32, f32)]| part.iter().filter(|(_, e)| *e > 1.0).count() as f64;
    let covered = known.iter().filter(|(sigma, e)| *e < 1.96 * sigma).count() as f64 / known.len() as f64;
    let (share, worst) =
        (bad(&known) / known.len() as f64, bad(&known[known.len() * 9 / 10..]) / bad(&known));
    println!(
        "{} of {all} matched, {share:.4} bad, {worst:.3} of them in the worst tenth, {covered:.3} covered",
        known.len()
    );
    assert!(known.len() * 100 > all * 95, "{} of {all}", known.len());
    assert!(share < 0.03 && worst > 0.65 && covered > 0.9, "{share} {worst} {covered}");
}
