//! Simulated measurements with known truth, and the figures of paper A as a job.

mod page;

use crate::animation::{AnimationOutput, FRAMES, write_forming};
use crate::report::ReportOutput;
use page::sphere_page;
use planish_core::{Error, Progress, ProgressPart, Result, WRITING_STAGE};
use planish_exchange::{Unit, check_writable, extension, write_atomically};
pub use planish_simulate::*;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Simulates and writes: `.csv` holds the rows, `.svg` draws them; `animation`, where one is asked for, shows
/// the sphere forming (see [`sphere_forming`]), and `page` shows the curves with all rows.
///
/// # Errors
/// `Unsupported` for other extensions, `Io` for paths that cannot be written, before any work; else as for
/// [`sphere`].
pub fn write_sphere(
    options: &SphereOptions,
    outputs: &[PathBuf],
    animation: Option<&Path>,
    page: Option<&ReportOutput>,
    progress: &dyn Progress,
) -> Result<Vec<SphereRow>> {
    for path in outputs {
        if !["csv", "svg"].contains(&extension(path).as_str()) {
            return Err(Error::unsupported(format!(
                "{}: the extension says what to write: needed .csv (the numbers) or .svg (the figures)",
                path.display()
            )));
        }
        check_writable(path)?;
    }
    if let Some(page) = page {
        page.check(&[], outputs)?;
    }
    let animation = animation.map(|path| AnimationOutput::plan(path, &[])).transpose()?;
    let rows = sphere(options, &ProgressPart::new(progress, 0.0, 0.9))?;
    if let Some(output) = &animation {
        let forming = sphere_forming(options, FRAMES)?;
        write_forming(&forming, Unit::Metre, output, &ProgressPart::new(progress, 0.9, 0.99))?;
    }
    progress.check(WRITING_STAGE, 0.99)?;
    for path in outputs {
        let text = match extension(path).as_str() {
            "csv" => sphere_csv(&rows),
            _ => sphere_figure(options, &rows),
        };
        write_atomically(path, |writer| writer.write_all(text.as_bytes()))?;
    }
    if let Some(page) = page {
        page.write(sphere_page(options, &rows, sphere_figure(options, &rows)), &[])?;
    }
    progress.advance(WRITING_STAGE, 1.0);
    Ok(rows)
}
