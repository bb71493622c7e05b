//! The workspace's own source files, as text, for the tests of its structure.

use crate::support::repository;
use std::path::{Path, PathBuf};

/// A Rust file of the workspace.
pub struct Source {
    /// Folder of its crate below `crates/`, or `fuzz`, `examples`.
    pub krate: String,
    /// Path below the crate's folder, with `/`.
    pub path: String,
    pub text: String,
}

impl Source {
    /// The top-level module below `src` that the file belongs to, except for `lib.rs` and `main.rs`.
    pub fn module(&self) -> Option<&str> {
        let name = self.path.strip_prefix("src/")?.split('/').next()?;
        let name = name.strip_suffix(".rs").unwrap_or(name);
        (!["lib", "main", "bin"].contains(&name)).then_some(name)
    }

    /// Whether the file holds only tests.
    pub fn is_test(&self) -> bool {
        self.path.split('/').any(|part| {
            ["tests", "benches", "examples", "tests.rs", "test_support.rs"].contains(&part)
                || part.ends_with("_tests.rs")
        })
    }

    /// The code without comments and without what follows the first `#[cfg(test)] mod … {` of the file.
    pub fn code(&self) -> String {
        let mut code = String::new();
        let mut lines = self.text.lines().peekable();
        while let Some(line) = lines.next() {
            let opens_tests = line == "#[cfg(test)]"
                && lines.peek().is_some_and(|next| next.contains("mod ") && next.ends_with('{'));
            if opens_tests {
                break;
            }
            if !line.trim_start().starts_with("//") {
                code.push_str(line);
                code.push('\n');
            }
        }
        code
    }
}

/// All Rust files of the workspace, sorted by path.
pub fn sources() -> Vec<Source> {
    let root = repository();
    let mut found = Vec::new();
    for folder in ["crates", "fuzz", "examples"] {
        let mut files = Vec::new();
        collect(&root.join(folder), &mut files);
        files.sort();
        for file in files {
            let below = file.strip_prefix(&root).expect("a file of the repository");
            let parts: Vec<String> = below.iter().map(|part| part.to_string_lossy().into_owned()).collect();
            let depth = if folder == "crates" { 1 } else { 0 };
            found.push(Source {
                krate: parts[depth].clone(),
                path: parts[depth + 1..].join("/"),
                text: std::fs::read_to_string(&file).expect("a source file"),
            });
        }
    }
    assert!(found.len() > 500, "{} files", found.len());
    found
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder").map(|e| e.expect("an entry").path()) {
        if entry.is_dir() && !entry.ends_with("target") {
            collect(&entry, files);
        } else if entry.extension().is_some_and(|e| e == "rs") {
            files.push(entry);
        }
    }
}
