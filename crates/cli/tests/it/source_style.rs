//! Limits of the source text that no lint of the compiler checks.

use crate::sources::sources;

/// Columns of a line: code, comments and strings.
const MAX_COLUMNS: usize = 110;
/// Lines of a file.
const MAX_LINES: usize = 600;

#[test]
fn lines_and_files_keep_their_limits() {
    let mut found = Vec::new();
    for source in sources() {
        let lines = source.text.lines().count();
        if lines > MAX_LINES {
            found.push(format!("{}/{}: {lines} lines", source.krate, source.path));
        }
        for (number, line) in source.text.lines().enumerate() {
            let columns = line.chars().count();
            if columns > MAX_COLUMNS {
                found.push(format!("{}/{}:{}: {columns} columns", source.krate, source.path, number + 1));
            }
        }
    }
    assert!(found.is_empty(), "over {MAX_COLUMNS} columns or {MAX_LINES} lines:\n{}", found.join("\n"));
}

#[test]
fn modules_are_named_by_their_file() {
    let found: Vec<String> = (sources().iter())
        .filter(|source| source.path.ends_with("mod.rs"))
        .map(|source| format!("{}/{}: name it after its module, x.rs beside x/", source.krate, source.path))
        .collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}
