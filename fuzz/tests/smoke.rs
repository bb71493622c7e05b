//! A few thousand damaged files for every reader, in every check: more of them are a matter of patience, not
//! of another program.

use std::process::Command;

#[test]
fn no_reader_breaks_on_damaged_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = Command::new(env!("CARGO_BIN_EXE_planish-fuzz"))
        .args(["--cases", "2000", "--out"])
        .arg(folder.path())
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    for line in said.lines().skip(1) {
        let numbers: Vec<u64> =
            line.split_whitespace().skip(1).take(3).map(|w| w.parse().expect("a count")).collect();
        // Damage that every file survives, or none, tests nothing.
        assert!(numbers[0] == 2000 && numbers[1] > 0 && numbers[2] > 200, "{line}");
    }
}
