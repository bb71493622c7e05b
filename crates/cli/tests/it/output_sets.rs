//! The outputs of a run appear together or not at all, whatever ends the process.

use crate::support::{pebble, planish, repository};
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const OUTPUTS: [&str; 4] = ["a.step", "a.stl", "a.glb", "a.obj"];

/// `planish solid` of the bracket in the repository, with all outputs in `folder`.
fn bracket(folder: &Path) -> Command {
    let data = repository().join("examples/data/bracket");
    let mut command = Command::new(env!("CARGO_BIN_EXE_planish"));
    command.arg("solid").args(["front.dxf", "top.dxf", "side.dxf"].map(|name| data.join(name)));
    for name in OUTPUTS {
        command.arg("-o").arg(folder.join(name));
    }
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// The contents of a folder by name.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| {
            let path = entry.expect("an entry").path();
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            (name, fs::read(path).expect("a file"))
        })
        .collect()
}

#[test]
fn a_killed_run_leaves_the_old_files_or_the_new_ones() {
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path();
    let begun = Instant::now();
    assert!(bracket(place).status().expect("a run").success());
    let time = begun.elapsed();
    let new = contents(place);
    assert_eq!(new.keys().map(String::as_str).collect::<Vec<_>>(), ["a.glb", "a.obj", "a.step", "a.stl"]);
    let old: BTreeMap<String, Vec<u8>> = new.keys().map(|name| (name.clone(), b"old".to_vec())).collect();
    let runs = 40_u32;
    let mut ended = [0, 0];
    for k in 0..runs {
        for (name, bytes) in &old {
            fs::write(place.join(name), bytes).expect("a file");
        }
        let mut child = bracket(place).spawn().expect("a run");
        // Runs write in their second half; the last kills come when most of them are done.
        std::thread::sleep(
            time.mul_f64(0.4 + 0.9 * f64::from(k) / f64::from(runs)).max(Duration::from_micros(50)),
        );
        child.kill().expect("a running or ended child");
        child.wait().expect("an end");
        // Any command that reads a file of the folder completes or removes what was left.
        planish(place, &["info", "a.glb"]);
        let found = contents(place);
        assert!(found == old || found == new, "kill {k}: {:?}", found.keys());
        ended[usize::from(found == new)] += 1;
    }
    println!("{} runs left the old files, {} the new ones", ended[0], ended[1]);
}

#[cfg(unix)]
#[test]
fn a_termination_signal_counts_as_an_interruption() {
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path();
    let data = pebble("job.toml");
    for signal in ["-TERM", "-HUP"] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_planish"))
            .arg("fit")
            .arg(&data)
            .args(["-o", "a.ply", "-o", "a.step", "--progress", "json"])
            .current_dir(place)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("a run");
        // The handler is installed before the first report of progress.
        let mut lines = BufReader::new(child.stderr.take().expect("a pipe")).lines();
        let first = lines.next().expect("progress").expect("text");
        assert!(first.contains("progress"), "{first}");
        let sent = Command::new("kill").arg(signal).arg(child.id().to_string()).status().expect("kill");
        assert!(sent.success());
        // A full pipe would block the child.
        lines.for_each(drop);
        let status = child.wait().expect("an end");
        assert_eq!(status.code(), Some(130), "{signal}");
        assert!(contents(place).is_empty(), "{signal}: {:?}", contents(place).keys());
    }
}

#[test]
fn a_name_that_is_too_long_is_refused_before_the_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let name = format!("{}.ply", "long".repeat(70));
    let data = pebble("job.toml");
    let result = planish(folder.path(), &["fit", &data, "-o", "a.step", "-o", &name]);
    assert_eq!(result.code, 3, "{}", result.stderr);
    assert!(result.stderr.contains("could not be written"), "{}", result.stderr);
    assert!(contents(folder.path()).is_empty());
}
