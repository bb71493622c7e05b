//! Limits of the source text that no lint of the compiler checks.

use crate::sources::{Source, sources};

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

/// Crates whose messages must not name options: only the command has options.
const LIBRARIES: [&str; 13] = [
    "core", "estimate", "spline", "mesh", "contour", "solid", "sense", "shell", "exchange", "surface",
    "simulate", "report", "planish",
];

/// Strings of the code of a file, outside comments and tests.
fn strings(source: &Source) -> Vec<String> {
    let code = source.code();
    let mut found = Vec::new();
    let mut letters = code.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            // A character in quotes may be a quote; a lifetime has no second one.
            '\'' => {
                let next = letters.next();
                if next == Some('\\') {
                    letters.next();
                }
                if letters.peek() == Some(&'\'') {
                    letters.next();
                }
            }
            '"' => {
                let mut string = String::new();
                while let Some(next) = letters.next().filter(|next| *next != '"') {
                    string.push(next);
                    if next == '\\' {
                        string.extend(letters.next());
                    }
                }
                found.push(string);
            }
            '/' if letters.peek() == Some(&'/') => while letters.next().is_some_and(|next| next != '\n') {},
            _ => {}
        }
    }
    found
}

/// Whether a text has two hyphens before a letter, as options have.
fn names_option(text: &str) -> bool {
    text.match_indices("--").any(|(at, _)| text[at + 2..].starts_with(|c: char| c.is_ascii_alphabetic()))
}

#[test]
fn messages_of_the_library_name_no_options() {
    let mut found = Vec::new();
    for source in sources().iter().filter(|s| LIBRARIES.contains(&s.krate.as_str()) && !s.is_test()) {
        for string in strings(source).iter().filter(|string| names_option(string)) {
            found.push(format!("{}/{}: {string:?}", source.krate, source.path));
        }
    }
    assert!(found.is_empty(), "state a `Setting`, and the command adds its option:\n{}", found.join("\n"));
}

#[test]
fn options_in_strings_are_found() {
    let source = |text: &str| Source {
        krate: "mesh".to_owned(),
        path: "src/part.rs".to_owned(),
        text: text.to_owned(),
    };
    let has = |text: &str| strings(&source(text)).iter().any(|string| names_option(string));
    assert!(has("fn f() { g('\"', \"raise --max-depth\"); }\n"));
    assert!(has("fn f<'a>() { \"a \\\"quoted\\\" \\\n    --gate\"; }\n"));
    assert!(!has("// \"--gate\"\nfn f() { \"n1 -- n2\"; } // \"--gate\"\n"));
    assert!(!has("#[cfg(test)]\nmod tests {\n    const A: &str = \"--gate\";\n}\n"));
}
