//! Tests every reader with a few thousand damaged files. `planish-fuzz --cases` runs more of them.

use std::process::Command;

#[test]
fn no_reader_breaks_on_damaged_files() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let output = Command::new(env!("CARGO_BIN_EXE_planish-fuzz"))
        .args(["--cases", "2000", "--out"])
        .arg(folder.path())
        .output()
        .expect("planish-fuzz starts");
    let table = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{table}{}", String::from_utf8_lossy(&output.stderr));
    for line in table.lines().skip(1) {
        let numbers: Vec<u64> =
            line.split_whitespace().skip(1).take(3).map(|w| w.parse().expect("a count")).collect();
        // Damage that all readers accept, or all reject, would test nothing.
        // A command gets a hundredth of the cases.
        let is_command = numbers[0] == 20;
        assert!(is_command || numbers[0] == 2000 && numbers[1] > 0 && numbers[2] > 200, "{line}");
    }
}
