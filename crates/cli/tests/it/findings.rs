//! Codes of findings: the page of the book and the JSON output.
//!
//! `PLANISH_WRITE_DOCS=1 cargo test -p planish-cli --test it findings` writes the page.

use crate::support::{pebble, planish, repository};
use planish::FindingCode;
use std::fmt::Write as _;

/// The page, generated from the registry.
fn page() -> String {
    let mut page = "\
# Findings

A finding is a statement about a result. It has a code, a level and a text. The terminal, the report and
`--json` show the same findings:

- `--json` has `findings` with `code`, `level`, `text` and, if the result depends on settings, their names in
  `settings`. The list `warnings` has the texts of level `warning`.
- The terminal prints findings of the levels `warning` and `error` to stderr, with the options that would
  change the result.
- The report marks `info` by ✓, `warning` by ! and `error` by ✕.

Codes are stable. Texts may change between versions, so programs should compare codes.

| Level | Meaning |
|---|---|
| `info` | as expected |
| `warning` | should be checked |
| `error` | the result should not be used before the problem is solved; the exit code is still 0 |

## Codes

| Code | Level | Meaning |
|---|---|---|
"
    .to_owned();
    for code in FindingCode::ALL {
        writeln!(page, "| `{code}` | {} | {} |", code.level().name(), code.meaning()).expect("a string");
    }
    page
}

#[test]
fn the_book_lists_all_codes() {
    let path = repository().join("docs/findings.md");
    if std::env::var_os("PLANISH_WRITE_DOCS").is_some() {
        std::fs::write(&path, page()).expect("a page is written");
    }
    let written = std::fs::read_to_string(&path).expect("docs/findings.md");
    assert_eq!(written, page(), "see the head of this file for how to write it anew");
}

#[test]
fn json_has_codes_and_the_texts_of_warnings() {
    let folder = tempfile::tempdir().expect("a folder");
    let cloud: String = (0..400)
        .map(|k| {
            let (x, y) = (f64::from(k % 20), f64::from(k / 20));
            format!("{x} {y} {}\n", 0.01 * (x * y).sin())
        })
        .collect();
    std::fs::write(folder.path().join("a.xyz"), cloud).expect("a file");
    let result = planish(folder.path(), &["fit", "a.xyz", "--json"]).ok();
    let json = result.json();
    let findings = json["findings"].as_array().expect("a list");
    let unit = &findings[0];
    assert_eq!((&unit["code"], &unit["level"]), (&"unit-assumed".into(), &"warning".into()), "{json:#}");
    assert_eq!(unit["settings"], serde_json::json!(["unit"]));
    assert_eq!(json["warnings"][0], unit["text"]);
    let warnings = findings.iter().filter(|finding| finding["level"] == "warning").count();
    assert_eq!(json["warnings"].as_array().map(Vec::len), Some(warnings), "{json:#}");
    // People see the option, too.
    assert!(result.stderr.contains(&format!("{} (option --unit)", unit["text"].as_str().expect("a text"))));
    let same = planish(folder.path(), &["compare", &pebble("truth.ply"), &pebble("truth.ply"), "--json"]);
    let codes = same.ok().json()["findings"].clone();
    assert_eq!(codes[0]["code"], "model-without-sigma", "{codes:#}");
}
