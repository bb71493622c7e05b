//! Error output: the message, its causes and a hint.

use crate::options::with_options;
use planish::{Error, ErrorKind};
use std::error::Error as _;
use std::io::Write;

/// Adds a request for a bug report to the message of a panic. The exit code of a panic is 101.
pub fn announce_bugs() {
    let default_hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        // The usual message comes first, because it names the place in the source.
        default_hook(info);
        let _ = writeln!(
            std::io::stderr(),
            "planish: this is a bug in planish {}; please report it with the command line and, if possible, \
             the input",
            env!("CARGO_PKG_VERSION")
        );
    }));
}

/// Prints an error with its causes and a hint to stderr.
pub fn print(error: &Error, command: &str) {
    // If stderr is closed, there is nowhere to report that.
    let _ = write!(std::io::stderr().lock(), "{}", text(error, command));
}

/// The printed lines.
fn text(error: &Error, command: &str) -> String {
    let mut text = format!("planish: {}", with_options(&error.to_string(), error.settings()));
    // The message of an error quotes its direct cause. Deeper causes are added unless they repeat it.
    let mut cause = error.source();
    while let Some(inner) = cause {
        let words = inner.to_string();
        if !text.contains(&words) {
            text.push_str(&format!("\n  cause: {words}"));
        }
        cause = inner.source();
    }
    text.push('\n');
    if let Some(hint) = hint(error.kind(), command) {
        text.push_str(&format!("  hint: {hint}\n"));
    }
    text
}

fn hint(kind: ErrorKind, command: &str) -> Option<String> {
    match kind {
        ErrorKind::Undetermined => Some(match command {
            "fit" => "add readings, or readings from more sides; check that the scans have the same frame \
                and unit"
                .to_owned(),
            "solid" => {
                "check the drawing at the positions above; another view or line may resolve the ambiguity"
                    .to_owned()
            }
            "contour" => "add readings from more sides, or specify a simpler --kind".to_owned(),
            _ if command.starts_with("sense") => {
                "check the order of the images, the mask and the calibration; the images may lack detail"
                    .to_owned()
            }
            "merge" | "compare" | "next" | "shell fit" | "shell texture" => {
                "check that the files show the same object in the same frame and unit".to_owned()
            }
            _ => "`planish info FILE` and `planish view FILE` show the contents of a file".to_owned(),
        }),
        ErrorKind::Unsupported => {
            Some(format!("`planish {command} --help` lists the supported formats and options"))
        }
        ErrorKind::Io => Some("check the path and its permissions".to_owned()),
        // The user pressed Ctrl-C and knows why.
        ErrorKind::Interrupted => None,
        _ => Some(format!(
            "correct the input above; `planish {command} --help` explains options, units and formats"
        )),
    }
}
