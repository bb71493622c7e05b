//! Tests of the book (`docs/`, built by mdBook): commands run and print what the book shows, and links work.
//!
//! A block ```` ```console ```` has commands (`$ planish …`) and lines of their output, in order; `…` stands
//! for any lines. Words must be equal and numbers must agree within a fifth, because the last digits depend
//! on the machine. A block ```` ```toml file=NAME ```` is written to that file. Each chapter runs in its own
//! folder, with the repository's `examples` in it.
//!
//! `PLANISH_WRITE_DOCS=1 cargo test --release -p planish-cli --test it book` rewrites the shown lines and the
//! images.

use crate::support::{RunOutput, command, repository};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Maximum relative difference of numbers.
const MAX_DIFFERENCE: f64 = 0.2;

/// A chapter: its file and text.
struct Chapter {
    path: PathBuf,
    text: String,
}

/// The chapters that `SUMMARY.md` names, in its order.
fn chapters() -> Vec<Chapter> {
    let docs = repository().join("docs");
    let summary = std::fs::read_to_string(docs.join("SUMMARY.md")).expect("SUMMARY.md");
    links(&summary)
        .into_iter()
        .map(|link| {
            let path = docs.join(link);
            let text = std::fs::read_to_string(&path)
                .unwrap_or_else(|e| panic!("SUMMARY.md: {}: {e}", path.display()));
            Chapter { path, text }
        })
        .collect()
}

/// Targets of the links and images of a page.
fn links(text: &str) -> Vec<&str> {
    let mut found = Vec::new();
    let mut in_code = false;
    for line in text.lines() {
        in_code ^= line.starts_with("```");
        if in_code || line.starts_with("    ") {
            continue;
        }
        let mut rest = line;
        while let Some(at) = rest.find("](") {
            rest = &rest[at + 2..];
            let Some(end) = rest.find(')') else { break };
            found.push(&rest[..end]);
            rest = &rest[end..];
        }
    }
    found
}

/// The anchor of a heading.
fn anchor(heading: &str) -> String {
    let plain = heading.trim_start_matches('#').trim().to_lowercase();
    plain
        .chars()
        .filter(|c| c.is_alphanumeric() || *c == ' ' || *c == '-' || *c == '_')
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

#[test]
fn every_page_is_in_the_book_and_links_work() {
    let chapters = chapters();
    let docs = repository().join("docs");
    for entry in std::fs::read_dir(&docs).expect("docs") {
        let path = entry.expect("an entry").path();
        let is_page = path.extension().is_some_and(|e| e == "md") && !path.ends_with("SUMMARY.md");
        assert!(
            !is_page || chapters.iter().any(|c| c.path == path),
            "{} is not in SUMMARY.md",
            path.display()
        );
    }
    for chapter in &chapters {
        for link in links(&chapter.text) {
            if link.starts_with("https://") {
                continue;
            }
            let (file, place) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => chapter.path.clone(),
                _ => chapter.path.parent().expect("a folder").join(file),
            };
            assert!(target.exists(), "{}: {link} leads nowhere", chapter.path.display());
            if !place.is_empty() {
                let text = std::fs::read_to_string(&target).expect("a page");
                assert!(
                    text.lines().any(|l| l.starts_with('#') && anchor(l) == place),
                    "{}: no heading of {link}",
                    chapter.path.display()
                );
            }
        }
    }
}

#[test]
fn commands_of_the_book_print_what_it_shows() {
    let writing = std::env::var_os("PLANISH_WRITE_DOCS").is_some();
    let wrong: Vec<String> = chapters()
        .par_iter()
        .filter(|chapter| chapter.text.contains("```console"))
        .flat_map_iter(|chapter| {
            let run = run_chapter(chapter, writing);
            if writing && run.text != chapter.text {
                std::fs::write(&chapter.path, &run.text).expect("a chapter is written");
            }
            run.wrong
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The result of a chapter's commands.
struct Run {
    text: String,
    wrong: Vec<String>,
}

fn run_chapter(chapter: &Chapter, writing: bool) -> Run {
    let folder = tempfile::tempdir().expect("a folder");
    std::os::unix::fs::symlink(repository().join("examples"), folder.path().join("examples"))
        .expect("a link");
    let name = chapter.path.file_name().expect("a name").to_string_lossy().into_owned();
    let mut run = Run { text: String::new(), wrong: Vec::new() };
    let mut lines = chapter.text.lines().enumerate().peekable();
    while let Some((number, line)) = lines.next() {
        run.text.push_str(line);
        run.text.push('\n');
        let Some(kind) = line.strip_prefix("```").filter(|kind| !kind.is_empty()) else {
            continue;
        };
        let mut block = Vec::new();
        while let Some((_, inner)) = lines.next_if(|(_, l)| *l != "```") {
            block.push(inner);
        }
        if let Some(file) = kind.split("file=").nth(1) {
            std::fs::write(folder.path().join(file), block.join("\n")).expect("a file is written");
        }
        if kind == "console" {
            for part in commands(&block) {
                let place = format!("{name}:{}: {}", number + 1, part.command);
                run_part(&part, folder.path(), &place, &mut run);
            }
        } else {
            block.iter().for_each(|l| {
                run.text.push_str(l);
                run.text.push('\n');
            });
        }
    }
    // Images that commands of the chapter wrote.
    for picture in links(&chapter.text).into_iter().filter_map(|l| l.strip_prefix("images/")) {
        let made = folder.path().join(picture);
        if writing && made.exists() {
            std::fs::copy(&made, repository().join("docs/images").join(picture))
                .expect("a picture is copied");
        }
    }
    run
}

/// A command and the shown lines of its output.
struct Part<'a> {
    command: &'a str,
    shown: Vec<&'a str>,
}

fn commands<'a>(block: &[&'a str]) -> Vec<Part<'a>> {
    let mut parts: Vec<Part> = Vec::new();
    for line in block {
        match (line.strip_prefix("$ "), parts.last_mut()) {
            (Some(command), _) => parts.push(Part { command, shown: Vec::new() }),
            (None, Some(part)) => part.shown.push(line),
            (None, None) => panic!("a block of commands begins with one: {line}"),
        }
    }
    parts
}

fn run_part(part: &Part, folder: &Path, place: &str, run: &mut Run) {
    run.text.push_str(&format!("$ {}\n", part.command));
    let words: Vec<&str> = part.command.split_whitespace().collect();
    assert_eq!(words[0], "planish", "{place}: the book runs nothing else");
    let result = RunOutput::new(command(folder, &words[1..]).output().expect("planish runs"));
    if result.code != 0 {
        run.wrong.push(format!("{place}: exit code {}: {}", result.code, result.stderr));
    }
    let printed: Vec<&str> = result.stdout.lines().collect();
    let mut next = 0;
    for shown in &part.shown {
        let found = match *shown {
            "…" => None,
            shown => (next..printed.len()).find(|k| agree(shown, printed[*k])),
        };
        match found {
            Some(at) => {
                run.text.push_str(printed[at]);
                next = at + 1;
            }
            None => {
                run.text.push_str(shown);
                if *shown != "…" {
                    run.wrong.push(format!("{place}: it does not print: {shown}\nbut:\n{}", result.stdout));
                }
            }
        }
        run.text.push('\n');
    }
}

/// Whether two lines have the same words and nearly the same numbers.
fn agree(shown: &str, printed: &str) -> bool {
    let (shown, printed) = (tokens(shown), tokens(printed));
    let writing = std::env::var_os("PLANISH_WRITE_DOCS").is_some();
    shown.len() == printed.len()
        && shown.iter().zip(&printed).all(|(a, b)| match (number(a), number(b)) {
            (Some(x), Some(y)) => writing || (x - y).abs() <= MAX_DIFFERENCE * x.abs().max(y.abs()),
            _ => a == b,
        })
}

/// Words; spaces between groups of digits are removed.
fn tokens(line: &str) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for word in line.split_whitespace() {
        let is_continuation = word.len() >= 3
            && word.bytes().take(3).all(|b| b.is_ascii_digit())
            && all.last().is_some_and(|last| last.bytes().all(|b| b.is_ascii_digit()));
        match (is_continuation, all.last_mut()) {
            (true, Some(last)) => last.push_str(word),
            _ => all.push(word.to_owned()),
        }
    }
    all
}

fn number(word: &str) -> Option<f64> {
    word.trim_matches(|c: char| !c.is_ascii_digit() && c != '-').parse().ok()
}
