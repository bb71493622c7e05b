//! What a user sees when something goes wrong.

use planish::{Error, ErrorKind};
use std::error::Error as _;
use std::io::Write;

/// Says of every panic that it is a bug of ours; the exit code is then 101.
pub fn announce_bugs() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        usual(info);
        let _ = writeln!(
            std::io::stderr(),
            "planish: this is a bug in planish {}; please report it with the command line and, if you can, the input",
            env!("CARGO_PKG_VERSION")
        );
    }));
}

/// Prints an error with its causes, and what to do.
pub fn print(error: &Error, command: &str) {
    // Nothing can be done where stderr itself is closed.
    let _ = write!(std::io::stderr().lock(), "{}", text(error, command));
}

/// The lines that are printed.
fn text(error: &Error, command: &str) -> String {
    let mut said = format!("planish: {error}");
    // An error's own words quote its direct cause; deeper ones are added where they say more.
    let mut cause = error.source();
    while let Some(inner) = cause {
        let words = inner.to_string();
        if !said.contains(&words) {
            said.push_str(&format!("\n  because {words}"));
        }
        cause = inner.source();
    }
    said.push('\n');
    if let Some(hint) = hint(error.kind(), command) {
        said.push_str(&format!("  hint: {hint}\n"));
    }
    said
}

fn hint(kind: ErrorKind, command: &str) -> Option<String> {
    match kind {
        ErrorKind::Undetermined => Some(match command {
            "fit" => "give more readings, or from more sides; check that the scans share one frame and unit".to_owned(),
            "solid" => {
                "look at the drawing where a place is named; a view or line that is missing may tell what is meant"
                    .to_owned()
            }
            "contour" => "give readings from more sides, or name a simpler --kind".to_owned(),
            _ if command.starts_with("sense") => {
                "check the order of the pictures, the mask and the calibration; the picture may show too little"
                    .to_owned()
            }
            "merge" | "compare" | "next" | "shell fit" | "shell texture" => {
                "check that the files are of the same thing, in one frame and unit".to_owned()
            }
            _ => "`planish info FILE` and `planish view FILE` show what there is".to_owned(),
        }),
        ErrorKind::Unsupported => Some(format!("`planish {command} --help` says what this version can do")),
        ErrorKind::Io => Some("check the path, and that it may be read or written".to_owned()),
        ErrorKind::Interrupted => None,
        _ => Some(format!(
            "correct what is named above; `planish {command} --help` has options, units and examples"
        )),
    }
}
