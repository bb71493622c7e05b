use super::*;
use planish_core::progress::Silent;
use planish_surface::saved::save;
use planish_surface::test_support::small_model;
use std::fs;

/// The state of one file.
fn verified(path: &Path) -> VerifiedFile {
    let job = VerifyJob { files: vec![path.to_path_buf()], unit: Some(Unit::Millimetre) };
    job.run(&Silent).unwrap().files.remove(0)
}

#[test]
fn whole_files_of_every_kind_pass() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let model = folder.path().join("a.planish");
    save(&small_model(planish_spline::Shape::Ball), &[], &model).unwrap();
    let picture = folder.path().join("mask.png");
    planish_exchange::picture::write_grey_png(&picture, 2, 1, &[0, 255]).unwrap();
    write("points.csv", "x,y,z\n0,0,0\n1,0,0\n0,1,0\n");
    for (path, words) in [
        (model, "ball of"),
        (write("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), "mesh of 3 vertices and 1 triangles"),
        (write("a.xyz", "0 0 0\n1 0 0\n"), "scan of 2 points"),
        (write("a.csv", "x,y,heading_deg,range\n0,0,90,2\n"), "1 readings of a contour"),
        (write("b.csv", "x,y,z,azimuth_deg,elevation_deg,range\n0,0,0,90,0,2\n"), "1 readings in space"),
        (
            write(
                "job.toml",
                "[sensor.a]\nkind = \"range\"\nsigma = 0.1\n[[scan]]\nsensor = \"a\"\n\
                            file = \"points.csv\"\n",
            ),
            "1 scans of 3 points",
        ),
        (write("camera.toml", "fx = 1\nfy = 1\ncx = 0\ncy = 0\n"), "depth camera"),
        (
            write("views.toml", "[[view]]\nmask = \"mask.png\"\nP = [[1,0,0,0],[0,1,0,0],[0,0,1,0]]\n"),
            "1 views",
        ),
        (picture, "picture of 2 × 1 pixels"),
        (
            write("a.svg", "<svg xmlns=\"http://www.w3.org/2000/svg\"><line x2=\"3\"/></svg>"),
            "drawing of 1 curves",
        ),
    ] {
        let found = verified(&path);
        assert!(found.whole && found.text.contains(words), "{}: {}", path.display(), found.text);
    }
}

#[test]
fn every_file_is_verified_also_after_a_defect() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("bad.xyz"), "0 0 0\n1 0\n").unwrap();
    fs::write(path("good.xyz"), "0 0 0\n1 0 0\n").unwrap();
    fs::write(path("a.docx"), "").unwrap();
    let files = ["bad.xyz", "missing.xyz", "a.docx", "good.xyz"].map(path).to_vec();
    let report = VerifyJob { files, unit: None }.run(&Silent).unwrap();
    let states: Vec<_> = report.files.iter().map(|f| (f.whole, f.error)).collect();
    let kinds = [Some(ErrorKind::Input), Some(ErrorKind::Io), Some(ErrorKind::Unsupported), None];
    assert_eq!(states, kinds.map(|kind| (kind.is_none(), kind)));
    assert!(report.files[0].text.starts_with("line 2: expected 3 numbers"), "{}", report.files[0].text);
    assert_eq!(report.defective, 3);
    let defects = report.findings.iter().filter(|f| f.code == FindingCode::FileDefective).count();
    assert_eq!(defects, 3);
}

#[test]
fn values_of_a_mesh_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let write = |sigma: f64, observed: u8| {
        let vertex = |p: &str| format!("{p} {sigma} {observed}\n");
        let vertices: String = ["0 0 0", "1 0 0", "0 1 0"].map(vertex).concat();
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty \
             double z\n\
             property double sigma\nproperty uchar observed\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n{vertices}3 0 1 2\n"
        );
        fs::write(&path, text).unwrap();
        verified(&path)
    };
    assert!(write(0.1, 3).whole);
    for (sigma, observed, words) in
        [(-1.0, 1, "vertex 0: expected a number ≥ 0 in the column sigma, found -1"), (0.1, 9, "0, 1, 2 or 3")]
    {
        let found = write(sigma, observed);
        assert!(!found.whole && found.text.contains(words), "{}", found.text);
    }
}

#[test]
fn a_changed_model_is_defective() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.planish");
    save(&small_model(planish_spline::Shape::Sheet), &[], &path).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&path, bytes).unwrap();
    let found = verified(&path);
    assert!(!found.whole && found.text.contains("expected the SHA-256"), "{}", found.text);
}
