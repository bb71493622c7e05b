//! Damaged inputs and wrong use: the message, the exit code, and no incomplete output.

use crate::support::{names, part_of_pebble, pebble, planish};
use std::path::Path;

/// Bytes of no file format; the same in every run.
fn garbage(length: usize) -> Vec<u8> {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let next = |_| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u8
    };
    (0..length).map(next).collect()
}

/// Fills a folder with invalid inputs.
fn hostile(folder: &Path) {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a file");
    let laser = std::fs::read(pebble("laser-1.ply")).expect("a scan");
    let xyz = |point: fn(usize) -> String| (0..200).map(|k| point(k) + "\n").collect::<String>();
    write("good.xyz", xyz(|k| format!("{} {} 0.0{}", k % 20, k / 20, (7 * k) % 10)).as_bytes());
    write("empty.ply", b"");
    write("empty.xyz", b"");
    write("empty.planish", b"");
    write("truncated.ply", &laser[..laser.len() / 2]);
    write("header_only.ply", &laser[..100]);
    write("nan.xyz", xyz(|_| "nan 1 2".to_owned()).as_bytes());
    write("three.xyz", b"0 0 0\n1 0 0\n0 1 0\n");
    write("collinear.xyz", xyz(|k| format!("{k} {k} {k}")).as_bytes());
    write("identical.xyz", xyz(|_| "1 2 3".to_owned()).as_bytes());
    write("word.xyz", b"0 0 0\n1 zero 0\n");
    write("comma.csv", b"x;y;z\n1,5;2,5;3,5\n");
    write("sigma.csv", b"x,y,z,sigma\n0,0,0,0.1\n1,0,0,0\n0,1,0,0.1\n1,1,0,0.1\n");
    write("nan_sigma.csv", b"x,y,z,sigma\n0,0,0,nan\n");
    write("no_z.csv", b"x,y\n0,0\n");
    write(
        "sigma.toml",
        b"unit = \"mm\"\n[sensor.a]\nkind = \"range\"\nsigma = -0.1\n[[scan]]\nfile = \"good.xyz\"\n",
    );
    write("unit.toml", b"unit = \"cm\"\n[[scan]]\nfile = \"good.xyz\"\n");
    write("misspelt.toml", b"[sensor.a]\nkind = \"range\"\nsigm = 0.1\n[[scan]]\nfile = \"good.xyz\"\n");
    write("syntax.toml", b"unit = mm\n");
    write("no_scan.toml", b"unit = \"mm\"\n");
    write("missing.toml", b"unit = \"mm\"\n\n[[scan]]\nfile = \"gone.ply\"\n");
    write("missing.conf", b"camera 0 0 0 0 0 0 1\nbmesh gone.ply 0 0 0 0 0 0 1\n");
    write("short.conf", b"bmesh good.xyz 0 0 0\n");
    write("quaternion.conf", b"bmesh good.xyz 0 0 0 0 0 0 2\n");
    for name in ["garbage.ply", "garbage.xyz", "garbage.toml", "garbage.conf", "garbage.planish"] {
        write(name, &garbage(5000));
    }
    write(
        "promises.ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000000\nproperty float x\n\
         property float y\n\
          property float z\nend_header\nabc",
    );
    write(
        "index.ply",
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
          element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
    );
    std::fs::create_dir(folder.join("folder.ply")).expect("a folder");
}

/// Runs a command that must fail and write nothing; returns its exit code and stderr.
#[track_caller]
fn refused(folder: &Path, line: &str) -> (i32, String) {
    let before = names(folder);
    let result = planish(folder, &line.split(' ').collect::<Vec<_>>());
    assert!(result.code != 0 && result.code != 101, "{line}: {} {}", result.code, result.stderr);
    assert_eq!(result.stdout, "", "{line}");
    assert_eq!(names(folder), before, "{line}");
    (result.code, result.stderr)
}

/// The messages and exit codes of these commands, for a snapshot.
fn refusals(folder: &Path, lines: &[&str]) -> String {
    let masked = |line: &&str| {
        let (code, stderr) = refused(folder, line);
        format!("$ planish {line}\n{stderr}[exit {code}]\n\n")
    };
    lines.iter().map(masked).collect()
}

#[test]
fn hostile_scans() {
    let folder = tempfile::tempdir().expect("a folder");
    hostile(folder.path());
    // Each command names outputs, which must not be created.
    let fit = |name: &str| format!("fit {name} -o out.step -o out.ply -o out.planish");
    let lines: Vec<String> = [
        "empty.ply",
        "empty.xyz",
        "truncated.ply",
        "header_only.ply",
        "nan.xyz",
        "three.xyz",
        "collinear.xyz",
        "identical.xyz",
        "word.xyz",
        "comma.csv",
        "sigma.csv",
        "nan_sigma.csv",
        "no_z.csv",
        "sigma.toml",
        "unit.toml",
        "misspelt.toml",
        "syntax.toml",
        "no_scan.toml",
        "missing.toml",
        "missing.conf",
        "short.conf",
        "quaternion.conf",
        "garbage.ply",
        "garbage.xyz",
        "garbage.toml",
        "garbage.conf",
        "promises.ply",
        "folder.ply",
        ".",
        "gone.ply",
        "gone/gone.ply",
        "good.xyz good.xyz",
    ]
    .map(fit)
    .to_vec();
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    insta::assert_snapshot!(refusals(folder.path(), &lines));
}

#[test]
fn outputs_are_checked_before_the_work() {
    let folder = tempfile::tempdir().expect("a folder");
    hostile(folder.path());
    std::fs::write(folder.path().join("kept.ply"), "kept").expect("a file");
    let protect = |readonly: bool| {
        let path = folder.path().join("kept.ply");
        let mut permissions = std::fs::metadata(&path).expect("a file").permissions();
        permissions.set_readonly(readonly);
        std::fs::set_permissions(&path, permissions).expect("permissions");
    };
    protect(true);
    // The input does not exist. A message about it would show that the work began before the check of the
    // outputs.
    let lines = [
        "fit gone.xyz -o a.3mf",
        "fit gone.xyz -o a",
        "fit gone.xyz -o no/such/folder/a.step",
        "fit gone.xyz -o folder.ply",
        "fit gone.xyz -o kept.ply",
        "fit gone.xyz -o a.ply -o ./a.ply",
        "fit gone.xyz --animate a.glb -o a.glb",
        "fit gone.ply -o gone.ply",
        "fit good.xyz --update good.planish -o good.planish",
        // Only the job names this file as an input.
        "fit unit.toml -o a.ply -o unit.toml",
    ];
    insta::assert_snapshot!(refusals(folder.path(), &lines));
    protect(false);
    assert_eq!(std::fs::read(folder.path().join("kept.ply")).expect("a file"), b"kept");
}

#[test]
fn scan_of_a_job_is_not_overwritten() {
    let folder = tempfile::tempdir().expect("a folder");
    let scan = std::fs::read(pebble("laser-1.ply")).expect("a scan");
    std::fs::write(folder.path().join("a.ply"), &scan).expect("a file");
    std::fs::write(folder.path().join("a.toml"), "[[scan]]\nfile = \"a.ply\"\n").expect("a file");
    let (code, stderr) = refused(folder.path(), "fit a.toml -o a.ply");
    assert!(code == 2 && stderr.contains("is also the input"), "{code} {stderr}");
    assert!(std::fs::read(folder.path().join("a.ply")).expect("a file") == scan);
}

#[test]
fn wrong_use() {
    let folder = tempfile::tempdir().expect("a folder");
    hostile(folder.path());
    let lines = [
        "fit",
        "frobnicate",
        "fit good.xyz --threads 0",
        "fit good.xyz --threads -1",
        "fit good.xyz --threads many",
        "fit good.xyz --seed -1",
        "fit good.xyz --unit cm",
        "fit good.xyz --shape cube",
        "fit good.xyz --tolerance 0",
        "fit good.xyz --tolerance -1",
        "fit good.xyz --tolerance inf",
        "fit good.xyz --mesh-tolerance nan",
        "fit good.xyz --max-coefficients 1",
        "fit good.xyz --max-coefficients -5",
        "fit good.xyz --gate NaN",
        "fit good.xyz --gate 0.5",
        "fit good.xyz --held-out 1",
        "fit good.xyz --held-out -0.1",
        "fit good.xyz --update old.planish --tolerance 1",
        "simulate scene scans",
        "simulate scene scans --out s --shape torus",
        "simulate scene scans --out s --readings 0",
        "simulate scene scans --out s --readings -1",
        "simulate scene scans --out s --outliers 1.5",
        "simulate scene scans --out s --sigma 50",
        "simulate scene scans --out s --misstated 0",
        "simulate scene scans --out good.xyz",
        "simulate scene grid --out s --size 0x0",
        "simulate scene handles --out s --genus 0",
        "simulate scene handles --out s --genus 17",
        "simulate scene handles --out s --sigma-normal-deg 90",
        "simulate scene handles --out s --views 0",
        "simulate scene plate --out s --holes 9",
        "simulate scene cup --out s --wall 1",
        "simulate scene cup --out s --unit m --wall 4",
        "simulate scene bracket --out s --fillet 30",
        "fit good.xyz --filter patch --symmetry auto",
        "fit good.xyz --filter patch --complete smooth",
        "fit good.xyz --filter patch --align",
        "fit good.xyz --filter patch --motion rigid",
        "fit good.xyz --motion bend --align",
        "fit good.xyz --motion bend --animate a.glb",
        "fit good.xyz --motion rigid",
        "simulate sphere",
        "simulate sphere -o figure.png",
        "simulate sphere -o figure.csv --sets 0",
        "simulate sphere -o figure.csv --depth 9",
        "simulate sphere -o figure.csv --readings 3",
        "simulate sphere -o figure.csv --orientation-deg 90",
    ];
    insta::assert_snapshot!(refusals(folder.path(), &lines));
}

#[test]
fn files_that_info_and_compare_cannot_use() {
    let folder = tempfile::tempdir().expect("a folder");
    hostile(folder.path());
    std::fs::write(folder.path().join("job.toml"), part_of_pebble(&["laser-1.ply"])).expect("a job");
    let model = folder.path().join("good.planish");
    planish(folder.path(), &["fit", "job.toml", "-o", "good.planish", "--quiet"]).ok();
    let bytes = std::fs::read(&model).expect("a model");
    std::fs::write(folder.path().join("truncated.planish"), &bytes[..bytes.len() / 2]).expect("a file");
    let lines = [
        "info gone",
        "info empty.planish",
        "info garbage.planish",
        "info truncated.planish",
        "info truncated.ply",
        "info index.ply",
        "info folder.ply",
        "compare truncated.planish good.xyz",
        "compare truncated.ply good.xyz",
        "compare good.planish empty.ply",
        "compare good.planish gone.ply",
        "compare good.planish index.ply",
        "compare good.planish good.planish",
        "compare good.planish sigma.csv",
        "fit good.xyz --update truncated.planish -o out.planish",
        "fit good.xyz --update good.xyz -o out.planish",
        "fit good.xyz --update good.planish --unit in -o out.planish",
    ];
    insta::assert_snapshot!(refusals(folder.path(), &lines));
}

#[test]
fn truncated_model_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("job.toml"), part_of_pebble(&["laser-1.ply"])).expect("a job");
    planish(folder.path(), &["fit", "job.toml", "-o", "a.planish", "--quiet"]).ok();
    let bytes = std::fs::read(folder.path().join("a.planish")).expect("a model");
    for share in [0.0001, 0.001, 0.01, 0.3, 0.9, 0.999_999] {
        let length = (bytes.len() as f64 * share) as usize;
        std::fs::write(folder.path().join("cut.planish"), &bytes[..length]).expect("a file");
        let (code, stderr) = refused(folder.path(), "info cut.planish");
        assert!(code == 2 && stderr.starts_with("planish: cut.planish: "), "{code} {stderr}");
    }
}
