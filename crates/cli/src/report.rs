//! What every command does with its result: the summary on stdout, warnings on stderr, the exit code.

use crate::args::{Cli, CommonArgs};
use crate::failure;
use crate::numbers::{count, significant};
use crate::progress::{Audience, Terminal};
use clap::CommandFactory;
use planish::model::{ScanPoseReport, SensorReport};
use planish::progress::Progress;
use planish::sense::SigmaSummary;
use planish::{Error, ErrorKind, Result, Unit};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Instant;

/// What a command has to say once it is done.
pub struct Summary<B> {
    /// The keys of its own: `termination` and `warnings` among them.
    pub body: B,
    /// Unit of every length, where it is known.
    pub unit: Option<Unit>,
    /// Files that were read.
    pub inputs: Vec<PathBuf>,
    /// Files that were written.
    pub outputs: Vec<PathBuf>,
    /// The same for people.
    pub text: String,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// The JSON object: the common keys, then those of the command.
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

/// The keys of a command that failed.
#[derive(Serialize)]
struct FailedBody {
    warnings: [String; 0],
    termination: Option<&'static str>,
    error: FailedError,
}

#[derive(Serialize)]
struct FailedError {
    kind: &'static str,
    message: String,
}

/// Runs a command with its threads and progress, prints what it says, and returns the exit code.
///
/// `name` is the command as in the JSON summary and in `planish NAME --help`.
pub fn run<B: Serialize>(
    name: &str,
    common: &CommonArgs,
    work: impl FnOnce(&dyn Progress) -> Result<Summary<B>>,
) -> u8 {
    let begun = Instant::now();
    let progress = Terminal::new(common.audience());
    let outcome = set_threads(common).and_then(|()| work(&progress));
    // Programs hear of the end as the last of stderr: after warnings.
    let code = said(name, common, begun, outcome, &progress);
    progress.finished(code);
    code
}

/// Prints what a command has to say, or why it failed; the exit code.
fn said<B: Serialize>(
    name: &str,
    common: &CommonArgs,
    begun: Instant,
    outcome: Result<Summary<B>>,
    progress: &Terminal,
) -> u8 {
    progress.clear();
    let head = |unit: Option<Unit>, inputs: &[PathBuf], outputs: &[PathBuf]| {
        let names = |paths: &[PathBuf]| paths.iter().map(|p| p.display().to_string()).collect();
        (unit.map(Unit::name), names(inputs), names(outputs))
    };
    let seconds = begun.elapsed().as_secs_f64();
    let (code, printed) = match outcome {
        Ok(summary) => {
            let (unit, inputs, outputs) = head(summary.unit, &summary.inputs, &summary.outputs);
            let printed = if common.json {
                print_json(&json(name, seconds, common, unit, inputs, outputs, &summary.body))
            } else if common.quiet {
                Ok(())
            } else {
                print(&summary.text)
            };
            if !common.quiet {
                warn(&summary.warnings);
            }
            (0, printed)
        }
        Err(e) => {
            failure::print(&e, name);
            let body = FailedBody {
                warnings: [],
                termination: (e.kind() == ErrorKind::Undetermined).then_some("undetermined"),
                error: FailedError { kind: kind_name(e.kind()), message: e.to_string() },
            };
            let printed = match common.json {
                true => {
                    let unit = common.unit.map(|u| Unit::from(u).name());
                    print_json(&json(name, seconds, common, unit, Vec::new(), Vec::new(), &body))
                }
                false => Ok(()),
            };
            (e.kind().exit_code(), printed)
        }
    };
    match printed {
        // The reader has seen enough (`planish info a.ply | head -1`).
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => code,
        Err(e) => {
            let e = Error::io("the summary could not be printed").with_source(e);
            failure::print(&e, name);
            e.kind().exit_code()
        }
        Ok(()) => code,
    }
}

/// Prints the help or version that was asked for, or what is wrong with a command line; returns the exit
/// code.
///
/// Programs that ask for `--json` are told in JSON, as of every other failure, and those that ask for
/// `--progress json` hear of the end.
pub fn not_understood(error: &clap::Error) -> u8 {
    // Nothing can be done where stderr itself is closed.
    let _ = error.print();
    let wrong = error.use_stderr();
    if wrong && std::env::args_os().any(|word| word == "--json") {
        let rendered = error.render().to_string();
        let paragraph = rendered.lines().take_while(|line| !line.trim().is_empty()).map(str::trim);
        let message = paragraph.collect::<Vec<_>>().join(" ");
        let object = Json {
            command: &command_named(),
            version: env!("CARGO_PKG_VERSION"),
            seconds: 0.0,
            threads: rayon::current_num_threads(),
            seed: 0,
            unit: None,
            inputs: Vec::new(),
            outputs: Vec::new(),
            body: FailedBody {
                warnings: [],
                termination: None,
                error: FailedError {
                    kind: kind_name(ErrorKind::Input),
                    message: message.trim_start_matches("error: ").to_owned(),
                },
            },
        };
        // The exit code says enough where stdout is closed.
        let _ = print_json(&object);
    }
    let code = if wrong { ErrorKind::Input.exit_code() } else { 0 };
    let words: Vec<_> = std::env::args_os().collect();
    let asks = |pair: &[std::ffi::OsString]| pair[0] == "--progress" && pair[1] == "json";
    if wrong && (words.windows(2).any(asks) || words.iter().any(|word| word == "--progress=json")) {
        Terminal::new(Audience::Program).finished(code);
    }
    code
}

/// The command that a command line begins with, as far as it is one.
fn command_named() -> String {
    let mut names: Vec<String> = Vec::new();
    let mut command = Cli::command();
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

/// Quantiles of σ, or nothing where there are none.
pub fn sigma_quantiles(sigma: Option<SigmaSummary>, unit: &str) -> String {
    sigma.map_or(String::new(), |s| {
        format!(
            "{} {unit} median, {} p95, {} max",
            significant(s.median, 3),
            significant(s.p95, 3),
            significant(s.max, 3)
        )
    })
}

/// A sensor's name, readings, σ stated and estimated, and which of the two was used: the cells that tables of
/// sensors share.
pub fn sensor_cells(sensor: &SensorReport) -> [String; 5] {
    let used = if sensor.sigma_used_is_estimated { "estimated" } else { "stated" };
    let name = match sensor.quantity.as_str() {
        "normal" => format!("{} (normals, °)", sensor.name),
        "curvature" => format!("{} (curvatures)", sensor.name),
        _ => sensor.name.clone(),
    };
    [
        name,
        count(sensor.observations),
        sensor.sigma_stated.map_or("–".to_owned(), |s| significant(s, 3)),
        significant(sensor.sigma_estimated, 3),
        used.to_owned(),
    ]
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
    // The work runs on a thread of the pool: handing every small task over to others would cost more than
    // some tasks.
    let pool = rayon::ThreadPoolBuilder::new().use_current_thread();
    match common.threads {
        None => pool.build_global().map_err(|e| Error::input("threads could not be started").with_source(e)),
        Some(threads) => pool.num_threads(threads).build_global().map_err(|e| {
            Error::input(format!("{threads} threads could not be started: ask for fewer")).with_source(e)
        }),
    }
}

fn warn(warnings: &[String]) {
    let mut stderr = io::stderr().lock();
    for warning in warnings {
        // Where stderr is closed nobody wants to know.
        let _ = writeln!(stderr, "planish: warning: {warning}");
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

/// Lines of a summary, aligned.
#[derive(Default)]
pub struct Lines {
    text: String,
}

/// How a column of a table stands.
#[derive(Clone, Copy)]
pub enum Align {
    /// Words.
    Left,
    /// Numbers.
    Right,
}

impl Lines {
    /// A line as it is.
    pub fn line(&mut self, text: impl AsRef<str>) {
        self.text.push_str(text.as_ref().trim_end());
        self.text.push('\n');
    }

    /// An empty line.
    pub fn gap(&mut self) {
        self.text.push('\n');
    }

    /// Names and what they are, one each a line.
    pub fn facts<const N: usize>(&mut self, facts: [(&str, String); N]) {
        let rows: Vec<Vec<String>> = facts
            .into_iter()
            .filter(|(_, value)| !value.is_empty())
            .map(|(name, value)| vec![name.to_owned(), value])
            .collect();
        self.rows(&[Align::Left, Align::Left], &rows);
    }

    /// A table of the poses that were not taken as exact, after a gap.
    pub fn poses(&mut self, poses: &[ScanPoseReport], unit: Unit) {
        let uncertain = |p: &&ScanPoseReport| p.sigma_translation.is_some() || p.sigma_rotation_deg.is_some();
        let rows: Vec<Vec<String>> = poses
            .iter()
            .filter(uncertain)
            .map(|pose| {
                let known = |sigma: Option<f64>| sigma.map_or("exact".to_owned(), |s| significant(s, 3));
                vec![
                    pose.scan.clone(),
                    known(pose.sigma_translation),
                    known(pose.sigma_rotation_deg),
                    pose.moved.map_or("as stated".to_owned(), |moved| significant(moved, 3)),
                    pose.turned_deg.map_or(String::new(), |turned| significant(turned, 3)),
                ]
            })
            .collect();
        if !rows.is_empty() {
            self.gap();
            self.table(
                &[
                    ("pose", Align::Left),
                    (&format!("σ of translation / {unit}"), Align::Right),
                    ("σ of rotation / °", Align::Right),
                    (&format!("moved / {unit}"), Align::Right),
                    ("turned / °", Align::Right),
                ],
                &rows,
            );
        }
    }

    /// A table with a head.
    pub fn table(&mut self, head: &[(&str, Align)], rows: &[Vec<String>]) {
        let titles = head.iter().map(|(title, _)| (*title).to_owned()).collect();
        let align: Vec<Align> = head.iter().map(|(_, align)| *align).collect();
        let mut all: Vec<Vec<String>> = vec![titles];
        all.extend_from_slice(rows);
        self.rows(&align, &all);
    }

    fn rows(&mut self, align: &[Align], rows: &[Vec<String>]) {
        let width = |column: usize| rows.iter().map(|r| r[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..align.len()).map(width).collect();
        for row in rows {
            let mut line = String::from("  ");
            for ((cell, &width), align) in row.iter().zip(&widths).zip(align) {
                let pad = " ".repeat(width - cell.chars().count());
                match align {
                    Align::Left => line.push_str(&format!("{cell}{pad}   ")),
                    Align::Right => line.push_str(&format!("{pad}{cell}   ")),
                }
            }
            self.line(line);
        }
    }

    /// The text.
    pub fn into_text(self) -> String {
        self.text
    }
}
