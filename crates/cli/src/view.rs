//! `planish view`: renders an image of a file, or shows it in the browser.

mod args;

use crate::common::command_line;
use crate::lines::Lines;
use crate::numbers::{percent, significant};
use crate::serve::{ServedPage, Server};
use crate::summary::{self, Summary};
pub use args::ViewArgs;
use planish::Finding;
use planish::Job;
use planish::compare::CompareOptions;
use planish::finding::with_warnings;
use planish::output::check_outputs;
use planish::progress::{Progress, SHOWING_STAGE};
use planish::report::ReportOutput;
use planish::view::{PictureJob, PictureOptions, PictureReport, ViewedFile, view_page};
use planish::{Error, Result, Unit};
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};

/// JSON keys of `view`.
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
        /// Address at which the page was served.
        address: Option<String>,
        /// Number of requests for the page.
        requests: usize,
        #[serde(flatten, serialize_with = "with_warnings")]
        findings: Vec<Finding>,
        termination: &'static str,
    },
}

/// Runs the command; returns the exit code.
pub fn run(args: &ViewArgs) -> u8 {
    summary::run("view", &args.common, |progress| work(args, progress))
}

fn work(args: &ViewArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let viewed = ViewedFile {
        file: args.file.clone(),
        reference: args.reference.clone(),
        compare: CompareOptions {
            part: args.part.into(),
            unit: args.common.unit.map(Unit::from),
            // A picture needs no finer mesh than the default of `compare`.
            mesh_tolerance: None,
        },
    };
    let inputs: Vec<PathBuf> = std::iter::once(&args.file).chain(&args.reference).cloned().collect();
    let page = ReportOutput {
        // A served page has no file; its path is never used.
        path: args.output.clone().unwrap_or_default(),
        command: command_line(),
        seed: args.common.seed,
    };
    match &args.output {
        Some(path) if is_page(path) => {
            refuse_picture_options(args, path)?;
            // Outputs are checked before the work: an error should not come after minutes of computation.
            check_outputs(&[page.file()?], &inputs)?;
            let made = view_page(&viewed, &page, progress)?;
            page.write_text(&made.html)?;
            let mut lines = Lines::default();
            lines.line(format!("{}: {}", args.file.display(), made.what));
            lines.line(format!("Wrote {}: HTML page", path.display()));
            Ok(page_summary(made, None, 0, lines, vec![path.clone()]))
        }
        Some(path) => picture(args, &viewed, path, progress),
        None => show(args, &viewed, &page, progress),
    }
}

/// Serves the page and opens the browser, until Ctrl-C.
fn show(
    args: &ViewArgs,
    viewed: &ViewedFile,
    page: &ReportOutput,
    progress: &dyn Progress,
) -> Result<Summary<Body>> {
    // The port is bound before the work: an error should not come after minutes of computation.
    let server = Server::on(args.port)?;
    let made = view_page(viewed, page, progress)?;
    let url = server.url();
    // From here on, Ctrl-C is the normal end.
    progress.advance(SHOWING_STAGE, 1.0);
    let announce = |text: String| {
        // If stderr is closed, there is nowhere to report that.
        let _ = writeln!(std::io::stderr(), "planish: {text}");
    };
    let address = || format!("{url} shows {}; press Ctrl-C to stop", args.file.display());
    // Nobody can guess the address, so --quiet does not hide it unless a browser opens it.
    if !args.common.quiet || args.no_open {
        announce(address());
    }
    if !args.no_open && open::that_detached(&url).is_err() {
        if args.common.quiet {
            announce(address());
        }
        announce("no browser could be started: open the address above in a browser".to_owned());
    }
    // The job's own interruption flag ends the server, so Ctrl-C works as for all commands.
    let served = ServedPage { html: &made.html, policy: planish_report::content_policy() };
    let requests = server.serve(&served, || progress.interrupted())?;
    Ok(page_summary(made, Some(url), requests, Lines::default(), Vec::new()))
}

/// Refuses options of images for a page: its viewer has controls for them.
fn refuse_picture_options(args: &ViewArgs, path: &Path) -> Result<()> {
    let given = [
        ("--color", args.color.is_some()),
        ("--camera", args.camera.is_some()),
        ("--up", args.up.is_some()),
        ("--size", args.size.is_some()),
    ];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => Err(Error::unsupported(format!(
            "{}: {option} applies only to images (.png); the page has its own controls",
            path.display()
        ))),
        None => Ok(()),
    }
}

fn is_page(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("html") || e.eq_ignore_ascii_case("htm"))
}

fn page_summary(
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
        findings: made.findings.clone(),
        body: Body::Page {
            what: made.what,
            address,
            requests,
            findings: made.findings,
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
        // Fixed colours, such as those of normals, have no range.
        Some([low, high]) => format!(
            "{} from {} to {} {unit}",
            quantity_name(&report.color),
            significant(low, 3),
            significant(high, 3)
        ),
        None => quantity_name(&report.color),
    };
    lines.line(format!(
        "Wrote {}: {} × {} pixels, {} covered by the object; colours: {}",
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
        findings: report.findings.clone(),
        body: Body::Picture { report, termination: "converged" },
    })
}

/// The name of a quantity that is shown by colour.
fn quantity_name(key: &str) -> String {
    match key {
        "sigma" => "σ".to_owned(),
        "observed" => "measured or completed".to_owned(),
        other => other.replace('_', " "),
    }
}
