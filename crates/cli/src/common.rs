//! What all commands share: common options, the option `--report`, and the end of the short help.

use crate::progress::Audience;
use crate::values::{memory, seed, threads};
use clap::{Args, ValueEnum, ValueHint};
use planish::Unit;
use planish::report::ReportOutput;
use std::path::PathBuf;

/// The last line of `-h`: where the other options are, and one example.
macro_rules! short_help {
    ($example:literal) => {
        concat!("Run with --help for all options.\nExample: ", $example)
    };
}
pub(crate) use short_help;

// Options allow negative numbers even where these are out of range. Otherwise clap reports an unknown
// option, and the user does not learn the range. Rare options are hidden from `-h`, which must fit one
// screen (see the tests in `main.rs`).
/// Options of every command that does work.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Common options")]
pub struct CommonArgs {
    /// Print one JSON object to stdout instead of the summary
    #[arg(long)]
    pub json: bool,
    /// Do not print the summary, progress or warnings
    #[arg(long, short, hide_short_help = true)]
    pub quiet: bool,
    /// How to report progress on stderr
    #[arg(long, value_name = "HOW", value_enum, default_value_t = ProgressName::Auto, hide_short_help = true)]
    pub progress: ProgressName,
    /// Number of threads [default: one per core]. The result does not depend on it
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true,
          hide_short_help = true)]
    pub threads: Option<usize>,
    /// Maximum memory, such as 8GB [default: three quarters of the machine]. Without it, a small file that
    /// describes something huge is rejected as damaged
    #[arg(long, value_name = "SIZE", value_parser = memory, hide_short_help = true)]
    pub max_memory: Option<u64>,
    /// Seed of the random numbers; equal seeds give identical output files
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = seed, allow_negative_numbers = true,
          hide_short_help = true)]
    pub seed: u64,
    /// Unit of lengths in files without a unit: mm, m, in, ft [default: mm]
    #[arg(long, value_name = "UNIT", value_enum, hide_possible_values = true)]
    pub unit: Option<UnitName>,
}

impl CommonArgs {
    /// The reader of progress reports.
    pub fn audience(&self) -> Audience {
        match self.progress {
            // `--quiet` is for people; a program that asked for events gets them.
            ProgressName::Json => Audience::Program,
            ProgressName::Auto if !self.quiet => Audience::People,
            ProgressName::Auto | ProgressName::None => Audience::None,
        }
    }
}

/// Value of `--progress`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProgressName {
    /// A progress bar if stderr is a terminal
    Auto,
    /// One JSON object per line, for programs
    Json,
    /// Nothing
    None,
}

/// The option `--report`.
#[derive(Debug, Clone, Args)]
pub struct ReportArgs {
    /// Write an HTML report: the result in 3D, its quality and the next steps
    #[arg(long, value_name = "FILE.html", help_heading = "Common options", value_hint = ValueHint::FilePath)]
    pub report: Option<PathBuf>,
}

impl ReportArgs {
    /// The report to write, which quotes the command line of this process.
    pub fn output(&self, common: &CommonArgs) -> Option<ReportOutput> {
        self.report.as_ref().map(|path| ReportOutput {
            path: path.clone(),
            command: command_line(),
            seed: common.seed,
        })
    }

    /// The line of the summary about the report.
    pub fn written(&self) -> Option<String> {
        (self.report.as_ref()).map(|path| format!("Wrote {}: HTML report", path.display()))
    }
}

/// The command line of this process, quoted for a POSIX shell.
pub fn command_line() -> String {
    // A report shows this line, and people paste it into a shell.
    let quoted = |word: String| {
        let plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%".contains(c);
        if !word.is_empty() && word.chars().all(plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', r"'\''"))
        }
    };
    // The path of the program is left out, so that a report does not depend on where it is installed.
    let words = std::env::args_os().skip(1).map(|word| quoted(word.to_string_lossy().into_owned()));
    std::iter::once("planish".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

// The variants have no doc comments: the names are the units, and a doc comment would become help.
/// Value of `--unit`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum UnitName {
    Mm,
    M,
    In,
    Ft,
}

impl From<UnitName> for Unit {
    fn from(name: UnitName) -> Self {
        match name {
            UnitName::Mm => Self::Millimetre,
            UnitName::M => Self::Metre,
            UnitName::In => Self::Inch,
            UnitName::Ft => Self::Foot,
        }
    }
}
