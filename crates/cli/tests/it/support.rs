//! Runs the built command in a folder of its own.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The root of the repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the repository")
}

/// Path of a file of the example data.
pub fn pebble(name: &str) -> String {
    repository().join("examples/data/pebble").join(name).display().to_string()
}

/// The output of a command.
pub struct RunOutput {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl RunOutput {
    pub fn new(output: Output) -> Self {
        Self {
            code: output.status.code().expect("an exit code"),
            stdout: String::from_utf8(output.stdout).expect("text"),
            stderr: String::from_utf8(output.stderr).expect("text"),
        }
    }

    /// The JSON object on stdout.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|e| panic!("{e}: {:?}; {}", self.stdout, self.stderr))
    }

    /// The same, after asserting success.
    #[track_caller]
    pub fn ok(self) -> Self {
        assert_eq!(self.code, 0, "{}", self.stderr);
        self
    }
}

/// A command that runs in a folder, with a fixed text width and without colours.
pub fn command<S: AsRef<std::ffi::OsStr>>(folder: &Path, args: &[S]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_planish"));
    command.args(args).current_dir(folder).env("COLUMNS", "100").env("NO_COLOR", "1");
    command
}

/// Runs the command in a folder.
pub fn planish<S: AsRef<std::ffi::OsStr>>(folder: &Path, args: &[S]) -> RunOutput {
    RunOutput::new(command(folder, args).output().expect("planish runs"))
}

/// Sorted names of all files in a folder.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The pebble's job with some of its scans and with absolute paths.
pub fn part_of_pebble(scans: &[&str]) -> String {
    let text = std::fs::read_to_string(pebble("job.toml")).expect("the job");
    let mut parts = text.split("[[scan]]");
    let mut job = parts.next().expect("the sensors").to_owned();
    for part in parts.filter(|part| scans.iter().any(|name| part.contains(&format!("\"{name}\"")))) {
        job.push_str("[[scan]]");
        job.push_str(&part.replace("file = \"", &format!("file = \"{}", pebble(""))));
    }
    job
}
