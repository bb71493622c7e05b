//! `planish view`.

use crate::args::command_line;
use crate::numbers::{percent, significant};
use crate::report::{self, Lines, Summary};
use crate::serve::Server;
use crate::view_args::ViewArgs;
use planish::Job;
use planish::compare::CompareOptions;
use planish::output::check_outputs;
use planish::progress::{Progress, SHOWING_STAGE};
use planish::report::ReportOutput;
use planish::view::{PictureJob, PictureOptions, PictureReport, ViewedFile, view_page};
use planish::{Error, Result, Unit};
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The keys of `view` beside the common ones.
#[derive(Serialize)]
#[serde(untagged)]
enum Body {
    Picture {
        #[serde(flatten)]
        report: PictureReport,
        termination: &'static str,
    },
    Page {
        what: String,
        /// Where the page was served, and how often it was asked for.
        address: Option<String>,
        requests: usize,
        warnings: Vec<String>,
        termination: &'static str,
    },
}

/// Runs the command; returns the exit code.
pub fn run(args: &ViewArgs) -> u8 {
    report::run("view", &args.common, |progress| work(args, progress))
}

fn work(args: &ViewArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let viewed = ViewedFile {
        file: args.file.clone(),
        reference: args.reference.clone(),
        compare: CompareOptions {
            part: args.part.into(),
            unit: args.common.unit.map(Unit::from),
            mesh_tolerance: None,
        },
    };
    let inputs: Vec<PathBuf> = std::iter::once(&args.file).chain(&args.reference).cloned().collect();
    let page = ReportOutput {
        path: args.output.clone().unwrap_or_default(),
        command: command_line(),
        seed: args.common.seed,
    };
    match &args.output {
        Some(path) if is_page(path) => {
            refuse_picture_options(args, path)?;
            check_outputs(&[page.file()?], &inputs)?;
            let made = view_page(&viewed, &page, progress)?;
            page.write_text(&made.html)?;
            let mut lines = Lines::default();
            lines.line(format!("{}: {}", args.file.display(), made.what));
            lines.line(format!("Wrote {}: the page, for any browser", path.display()));
            Ok(of_page(made, None, 0, lines, vec![path.clone()]))
        }
        Some(path) => picture(args, &viewed, path, progress),
        None => {
            let server = Server::on(args.port)?;
            let made = view_page(&viewed, &page, progress)?;
            let url = server.url();
            progress.advance(SHOWING_STAGE, 1.0);
            if !args.common.quiet {
                // Where stderr is closed nobody wants to know.
                let _ =
                    writeln!(std::io::stderr(), "planish: {url} shows {}; Ctrl-C ends", args.file.display());
            }
            if !args.no_open && open::that_detached(&url).is_err() && !args.common.quiet {
                let _ = writeln!(
                    std::io::stderr(),
                    "planish: no browser could be started: open that address in one"
                );
            }
            let asked = server.serve(&made.html, || progress.interrupted())?;
            Ok(of_page(made, Some(url), asked, Lines::default(), Vec::new()))
        }
    }
}

/// A page is turned and coloured by who looks at it.
fn refuse_picture_options(args: &ViewArgs, path: &Path) -> Result<()> {
    let given = [
        ("--color", args.color.is_some()),
        ("--camera", args.camera.is_some()),
        ("--up", args.up.is_some()),
        ("--size", args.size.is_some()),
    ];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => Err(Error::unsupported(format!(
            "{}: {option} is for pictures (.png); a page is turned and coloured by who looks at it",
            path.display()
        ))),
        None => Ok(()),
    }
}

fn is_page(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("html") || e.eq_ignore_ascii_case("htm"))
}

fn of_page(
    made: planish::view::ViewedPage,
    address: Option<String>,
    requests: usize,
    lines: Lines,
    outputs: Vec<PathBuf>,
) -> Summary<Body> {
    Summary {
        text: lines.into_text(),
        unit: made.unit,
        inputs: made.inputs,
        outputs,
        warnings: made.warnings.clone(),
        body: Body::Page {
            what: made.what,
            address,
            requests,
            warnings: made.warnings,
            termination: "converged",
        },
    }
}

fn picture(
    args: &ViewArgs,
    viewed: &ViewedFile,
    path: &Path,
    progress: &dyn Progress,
) -> Result<Summary<Body>> {
    let options = PictureOptions {
        camera: args.camera,
        up: args.up,
        colour: args.color.map(Into::into),
        size: args.size.unwrap_or(PictureOptions::default().size),
    };
    let job = PictureJob { viewed: viewed.clone(), options, output: path.to_path_buf() };
    let report = job.run(progress)?;
    let mut lines = Lines::default();
    lines.line(format!("{}: {}", args.file.display(), report.what));
    let unit = &report.color_unit;
    let colours = match report.color_range {
        Some([low, high]) => format!(
            "{} from {} to {} {unit}",
            words(&report.color),
            significant(low, 3),
            significant(high, 3)
        ),
        None => words(&report.color),
    };
    lines.line(format!(
        "Wrote {}: {} × {} pixels, {} of them covered; colours: {}",
        path.display(),
        report.size[0],
        report.size[1],
        percent(report.covered),
        colours.trim_end()
    ));
    Ok(Summary {
        text: lines.into_text(),
        unit: report.unit,
        inputs: report.inputs.clone(),
        outputs: vec![path.to_path_buf()],
        warnings: report.warnings.clone(),
        body: Body::Picture { report, termination: "converged" },
    })
}

/// The key of what a picture is coloured by, in words.
fn words(key: &str) -> String {
    match key {
        "sigma" => "σ".to_owned(),
        "observed" => "what it is known by".to_owned(),
        other => other.replace('_', " "),
    }
}
