//! Simulated measurements with known truth, and the figures of paper A as a job.

mod page;

use crate::animation::{AnimationOutput, FRAMES, write_forming};
use crate::job::Job;
use crate::output::unsupported_extension;
use crate::report::{ReportOutput, with_page};
use page::sphere_page;
use planish_core::{Progress, ProgressPart, Result, WRITING_STAGE};
use planish_exchange::{Unit, extension, write_atomically};
pub use planish_simulate::*;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// The figures of the sphere: simulated, written and shown.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SphereJob {
    /// Settings of the figures.
    pub options: SphereOptions,
    /// Files to write: the rows as `.csv`, the curves as `.svg`.
    pub outputs: Vec<PathBuf>,
    /// A `.glb` file or a folder of pictures that shows the sphere forming (see [`sphere_forming`]).
    pub animation: Option<PathBuf>,
    /// A page with the curves and all rows.
    pub report: Option<ReportOutput>,
}

impl Job for SphereJob {
    type Report = Vec<SphereRow>;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(Vec::new())
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        for path in &self.outputs {
            if !["csv", "svg"].contains(&extension(path).as_str()) {
                return Err(unsupported_extension(path, ".csv (the numbers) or .svg (the figures)"));
            }
        }
        let mut outputs = with_page(self.outputs.clone(), self.report.as_ref())?;
        // A folder of pictures is no file; `planned` has checked that it is new or empty.
        if let Some(AnimationOutput::Mesh(path)) = planned(self.animation.as_deref())? {
            outputs.push(path);
        }
        Ok(outputs)
    }

    fn execute(&self, progress: &dyn Progress) -> Result<Vec<SphereRow>> {
        let options = &self.options;
        let rows = sphere(options, &ProgressPart::new(progress, 0.0, 0.9))?;
        if let Some(output) = planned(self.animation.as_deref())? {
            // A run of its own: the figures need many runs, the animation one.
            let forming = sphere_forming(options, FRAMES)?;
            write_forming(&forming, Unit::Metre, &output, &ProgressPart::new(progress, 0.9, 0.99))?;
        }
        progress.check(WRITING_STAGE, 0.99)?;
        for path in &self.outputs {
            let text = match extension(path).as_str() {
                "csv" => sphere_csv(&rows),
                _ => sphere_figure(options, &rows),
            };
            write_atomically(path, |writer| writer.write_all(text.as_bytes()))?;
        }
        if let Some(page) = &self.report {
            page.write(sphere_page(options, &rows, sphere_figure(options, &rows)), &[])?;
        }
        progress.advance(WRITING_STAGE, 1.0);
        Ok(rows)
    }
}

fn planned(animation: Option<&Path>) -> Result<Option<AnimationOutput>> {
    animation.map(AnimationOutput::plan).transpose()
}
