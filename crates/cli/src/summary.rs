//! Runs the work of a command and prints its result: the summary on stdout, warnings and errors on stderr.
//!
//! In: a function that does the work. Out: the exit code. With `--json`, stdout gets one JSON object, also if
//! the command fails.

use crate::common::CommonArgs;
use crate::failure;
use crate::options::with_options;
use crate::progress::{Audience, Terminal};
use planish::finding::with_warnings;
use planish::progress::Progress;
use planish::{Error, ErrorKind, Finding, FindingLevel, Result, Setting, Unit, write_as_set};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Instant;

/// The result of a command, as JSON and as text.
pub struct Summary<B> {
    /// JSON keys of this command; `termination`, `warnings` and `findings` are among them.
    pub body: B,
    /// Unit of all lengths, if known.
    pub unit: Option<Unit>,
    /// Files that were read.
    pub inputs: Vec<PathBuf>,
    /// Files that were written.
    pub outputs: Vec<PathBuf>,
    /// The summary for people.
    pub text: String,
    /// What a user should know. Warnings and errors are printed to stderr.
    pub findings: Vec<Finding>,
}

/// The JSON object: common keys first, then the keys of the command.
#[derive(Serialize)]
struct Json<'a, B: Serialize> {
    command: &'a str,
    version: &'a str,
    seconds: f64,
    threads: usize,
    seed: u64,
    unit: Option<&'a str>,
    inputs: Vec<String>,
    outputs: Vec<String>,
    #[serde(flatten)]
    body: B,
}

/// JSON keys of a command that failed.
#[derive(Serialize)]
struct FailedBody {
    #[serde(flatten, serialize_with = "with_warnings")]
    findings: Vec<Finding>,
    termination: Option<&'static str>,
    error: FailedError,
}

#[derive(Serialize)]
struct FailedError {
    kind: &'static str,
    message: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    settings: Vec<Setting>,
}

/// Sets up threads and progress, runs `work`, prints its result and returns the exit code.
///
/// `name` is the command as in the JSON object and in `planish NAME --help`.
pub fn run<B: Serialize>(
    name: &str,
    common: &CommonArgs,
    work: impl FnOnce(&dyn Progress) -> Result<Summary<B>>,
) -> u8 {
    run_with_code(name, common, |progress| work(progress).map(|summary| (summary, 0)))
}

/// [`run`] for work that ends with an exit code of its own.
pub fn run_with_code<B: Serialize>(
    name: &str,
    common: &CommonArgs,
    work: impl FnOnce(&dyn Progress) -> Result<(Summary<B>, u8)>,
) -> u8 {
    let begun = Instant::now();
    let progress = Terminal::new(common.audience());
    planish::budget::set_max_memory(common.max_memory);
    // Threads come first: the global pool can be set only before its first use.
    let outcome = set_threads(common).and_then(|()| write_as_set(|| work(&progress)));
    // Programs take the event `finished` as the end of stderr, so warnings are printed before it.
    let code = print_outcome(name, common, begun, outcome, &progress);
    progress.finished(code);
    code
}

/// Prints the summary or the error; returns the exit code.
fn print_outcome<B: Serialize>(
    name: &str,
    common: &CommonArgs,
    begun: Instant,
    outcome: Result<(Summary<B>, u8)>,
    progress: &Terminal,
) -> u8 {
    progress.clear();
    let head = |unit: Option<Unit>, inputs: &[PathBuf], outputs: &[PathBuf]| {
        let names = |paths: &[PathBuf]| paths.iter().map(|p| p.display().to_string()).collect();
        (unit.map(Unit::name), names(inputs), names(outputs))
    };
    let seconds = begun.elapsed().as_secs_f64();
    let (code, printed) = match outcome {
        Ok((summary, code)) => {
            let (unit, inputs, outputs) = head(summary.unit, &summary.inputs, &summary.outputs);
            let printed = if common.json {
                print_json(&json(name, seconds, common, unit, inputs, outputs, &summary.body))
            } else if common.quiet {
                Ok(())
            } else {
                print(&summary.text)
            };
            // Warnings go to stderr, so that they do not mix with JSON on stdout.
            if !common.quiet {
                print_findings(&summary.findings);
            }
            (code, printed)
        }
        Err(e) => {
            // Errors are printed even with --quiet: without them, a failure would look like a success.
            failure::print(&e, name);
            let body = FailedBody {
                findings: Vec::new(),
                termination: (e.kind() == ErrorKind::Undetermined).then_some("undetermined"),
                error: FailedError {
                    kind: kind_name(e.kind()),
                    message: e.to_string(),
                    settings: e.settings().to_vec(),
                },
            };
            let printed = match common.json {
                true => {
                    let unit = common.unit.map(Unit::from);
                    let (unit, inputs, outputs) = head(unit, &[], e.outputs());
                    print_json(&json(name, seconds, common, unit, inputs, outputs, &body))
                }
                false => Ok(()),
            };
            (e.kind().exit_code(), printed)
        }
    };
    match printed {
        // The reader closed the pipe on purpose (`planish info a.ply | head -1`): not an error.
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => code,
        Err(e) => {
            let e = Error::io("the summary could not be printed").with_source(e);
            failure::print(&e, name);
            e.kind().exit_code()
        }
        Ok(()) => code,
    }
}

/// Prints a document (a script, a page of the manual) to stdout, or the error; returns the exit code.
pub fn print_document(name: &str, document: Result<Vec<u8>>) -> u8 {
    let printed = document.and_then(|bytes| {
        let mut stdout = io::stdout().lock();
        match stdout.write_all(&bytes).and_then(|()| stdout.flush()) {
            // The reader closed the pipe on purpose (`planish man | head`): not an error.
            Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
                Err(Error::io("the document could not be printed").with_source(e))
            }
            _ => Ok(()),
        }
    });
    match printed {
        Ok(()) => 0,
        Err(e) => {
            failure::print(&e, name);
            e.kind().exit_code()
        }
    }
}

/// Prints help, version or the error of a command line that was not parsed; returns the exit code.
///
/// With `--json`, the error is also printed as JSON. With `--progress json`, the event `finished` is printed.
/// Both options are searched in the raw words, because there are no parsed arguments.
pub fn print_parse_error(error: &clap::Error, command: clap::Command) -> u8 {
    // If stderr is closed, there is nowhere to report that.
    let _ = error.print();
    // Help and version also end the parsing, but they are no errors and go to stdout.
    let is_error = error.use_stderr();
    if is_error && std::env::args_os().any(|word| word == "--json") {
        print_parse_error_json(error, command);
    }
    let code = if is_error { ErrorKind::Input.exit_code() } else { 0 };
    let words: Vec<_> = std::env::args_os().collect();
    let asks = |pair: &[std::ffi::OsString]| pair[0] == "--progress" && pair[1] == "json";
    if is_error && (words.windows(2).any(asks) || words.iter().any(|word| word == "--progress=json")) {
        Terminal::new(Audience::Program).finished(code);
    }
    code
}

fn print_parse_error_json(error: &clap::Error, command: clap::Command) {
    let rendered = error.render().to_string();
    // The first paragraph is the error; usage and tips follow.
    let paragraph = rendered.lines().take_while(|line| !line.trim().is_empty()).map(str::trim);
    let message = paragraph.collect::<Vec<_>>().join(" ");
    let object = Json {
        command: &command_name(command),
        version: env!("CARGO_PKG_VERSION"),
        seconds: 0.0,
        threads: rayon::current_num_threads(),
        seed: 0,
        unit: None,
        inputs: Vec::new(),
        outputs: Vec::new(),
        body: FailedBody {
            findings: Vec::new(),
            termination: None,
            error: FailedError {
                kind: kind_name(ErrorKind::Input),
                message: message.trim_start_matches("error: ").to_owned(),
                settings: Vec::new(),
            },
        },
    };
    // If stdout is closed, the exit code still reports the error.
    let _ = print_json(&object);
}

/// The subcommand at the start of the command line, such as `sense stereo`; empty if there is none.
fn command_name(mut command: clap::Command) -> String {
    let mut names: Vec<String> = Vec::new();
    for word in std::env::args_os().skip(1) {
        let Some(next) = command.find_subcommand(&word).cloned() else {
            break;
        };
        names.push(word.to_string_lossy().into_owned());
        command = next;
    }
    names.join(" ")
}

fn json<'a, B: Serialize>(
    command: &'a str,
    seconds: f64,
    common: &CommonArgs,
    unit: Option<&'a str>,
    inputs: Vec<String>,
    outputs: Vec<String>,
    body: &'a B,
) -> Json<'a, &'a B> {
    Json {
        command,
        version: env!("CARGO_PKG_VERSION"),
        seconds,
        threads: rayon::current_num_threads(),
        seed: common.seed,
        unit,
        inputs,
        outputs,
        body,
    }
}

fn kind_name(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::Undetermined => "undetermined",
        ErrorKind::Unsupported => "unsupported",
        ErrorKind::Io => "io",
        ErrorKind::Interrupted => "interrupted",
        _ => "input",
    }
}

fn set_threads(common: &CommonArgs) -> Result<()> {
    // The main thread joins the pool: otherwise each parallel call would wait for a hand-over to another
    // thread, which takes longer than small tasks.
    let pool = rayon::ThreadPoolBuilder::new().use_current_thread();
    match common.threads {
        None => pool.build_global().map_err(|e| Error::input("threads could not be started").with_source(e)),
        Some(threads) => pool.num_threads(threads).build_global().map_err(|e| {
            Error::input(format!("{threads} threads could not be started: use a smaller number"))
                .with_source(e)
        }),
    }
}

/// Prints findings that need attention; those as expected are only in the JSON output and in the report.
fn print_findings(findings: &[Finding]) {
    let mut stderr = io::stderr().lock();
    for finding in findings.iter().filter(|finding| finding.level > FindingLevel::Info) {
        let text = with_options(&finding.text, &finding.settings);
        // If stderr is closed, there is nowhere to report that.
        let _ = writeln!(stderr, "planish: {}: {text}", finding.level.name());
    }
}

fn print(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes())?;
    stdout.flush()
}

fn print_json(object: &impl Serialize) -> io::Result<()> {
    let mut text = serde_json::to_string_pretty(object).map_err(io::Error::other)?;
    text.push('\n');
    print(&text)
}
