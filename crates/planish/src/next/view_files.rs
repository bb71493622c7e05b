//! `planish next --views`: plans sensor poses from a saved model and the file of a sensor.

use super::findings::judge_views;
use super::page::views_page;
use super::{NextOptions, NextView, ViewsReport, check_view_count, next_views};
use crate::job::Job;
use crate::output::unsupported_extension;
use crate::report::{ReportOutput, with_page};
use planish_core::Progress;
use planish_core::finding::with_warnings;
use planish_core::{DVec3, Finding, Length};
use planish_estimate::Result;
use planish_exchange::calibration::read_view_sensor;
use planish_exchange::ply::{Column, MeshColumns, write_points};
use planish_exchange::{Unit, extension, write_atomically};
use planish_sense::{Pose, ViewSensor};
use planish_surface::saved::load;
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// The job `planish next --views`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NextViewsJob {
    /// A saved model.
    pub model: PathBuf,
    /// The sensor's file.
    pub sensor: PathBuf,
    /// Maximum number of views, and the other options. Lengths are given separately.
    pub options: NextOptions,
    /// Stop when the largest σ is at most this.
    pub goal: Option<Length>,
    /// Files of the poses: `.toml`, `.csv` or `.ply`.
    pub outputs: Vec<PathBuf>,
    /// A page that shows them.
    pub report: Option<ReportOutput>,
}

/// Result of a [`NextViewsJob`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextViewsJobReport {
    /// The poses and figures.
    #[serde(flatten)]
    pub next: ViewsReport,
    /// The model's unit.
    #[serde(skip)]
    pub unit: Unit,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

impl Job for NextViewsJob {
    type Report = NextViewsJobReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.model.clone(), self.sensor.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        let is_written = |path: &&PathBuf| matches!(extension(path).as_str(), "toml" | "csv" | "ply");
        if let Some(path) = self.outputs.iter().find(|path| !is_written(path)) {
            return Err(unsupported_extension(path, ".toml (scans of a job), .csv or .ply (poses)"));
        }
        with_page(self.outputs.clone(), self.report.as_ref())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<NextViewsJobReport> {
        choose_views(self, progress)
    }
}

/// Reads a saved model and a sensor, chooses poses, and writes them.
fn choose_views(job: &NextViewsJob, progress: &dyn Progress) -> Result<NextViewsJobReport> {
    check_view_count(&job.options)?;
    progress.check("reading", 0.0)?;
    // The sensor first: its file is small, and an error in it needs no model.
    let known = read_view_sensor(&job.sensor)?;
    let model = load(&job.model)?;
    // A sensor without a unit is assumed to be in that of the model.
    let factor = known.unit.map_or(1.0, |unit| unit.millimetres() / model.unit.millimetres());
    let sensor = known.sensor.scaled(factor);
    let options =
        NextOptions { goal: job.goal.map(|length| length.in_unit(model.unit)), ..job.options.clone() };
    let next =
        next_views(&model, &sensor, &options, progress).map_err(|e| e.in_context(job.model.display()))?;
    for path in &job.outputs {
        match extension(path).as_str() {
            "toml" => write_job(path, &next, &sensor, model.unit)?,
            "csv" => write_csv(path, &next.views)?,
            _ => write_ply(path, &next.views, model.unit)?,
        }
    }
    let findings = judge_views(&next, options.count, model.unit);
    if let Some(page) = &job.report {
        let made = views_page(&model, &next, &sensor, findings.clone(), &job.model)?;
        let inputs = [(&job.model, "the model"), (&job.sensor, "the sensor")];
        page.write(made, &inputs.map(|(path, role)| (path.clone(), role.to_owned())))?;
    }
    Ok(NextViewsJobReport { next, unit: model.unit, findings })
}

/// Writes a job file for the scans to be taken.
fn write_job(path: &Path, next: &ViewsReport, sensor: &ViewSensor, unit: Unit) -> Result<()> {
    // σ of a triangulating sensor depends on the distance, and a job states one number per sensor.
    let along = next.sigma_along.unwrap_or(sensor.sigma_along);
    let mut text = format!(
        "# Views to take, best first, by `planish next`. The sensor looks along its z, with x right and y \
         down.\n# Save each scan, in the sensor's frame, in the file that is named here.\nunit \
         = \"{unit}\"\n\n[sensor.next]\nkind = \"range\"\n# The mean of all readings.\nsigma_along = \
         {along:?}\nsigma_across = {:?}\n",
        sensor.sigma_across
    );
    for (k, view) in next.views.iter().enumerate() {
        // `{:?}` keeps a decimal point, without which TOML would read an integer. The viewpoint is the
        // origin, because scans are in the sensor's frame.
        let _ = write!(
            text,
            "\n[[scan]]\nsensor = \"next\"\nfile = \"view-{}.ply\"\npose = {{ translation = {:?}, \
             quaternion_xyzw = {:?} }}\nviewpoint = [0.0, 0.0, 0.0]\n",
            k + 1,
            view.translation.to_array(),
            view.quaternion_xyzw
        );
    }
    write_atomically(path, |writer| writer.write_all(text.as_bytes()))
}

fn write_csv(path: &Path, views: &[NextView]) -> Result<()> {
    write_atomically(path, |writer| {
        writeln!(writer, "x,y,z,qx,qy,qz,qw,readings,seen,seen_so_far,worst_sigma_after,mean_sigma_after")?;
        for v in views {
            // All digits, so that a pose that is read back is the same.
            let place: Vec<String> =
                v.translation.to_array().iter().chain(&v.quaternion_xyzw).map(f64::to_string).collect();
            writeln!(
                writer,
                "{},{},{},{},{},{}",
                place.join(","),
                v.readings,
                v.seen,
                v.seen_so_far,
                v.worst_sigma_after,
                v.mean_sigma_after
            )?;
        }
        Ok(())
    })
}

/// The sensor's places, with the directions in which it looks as normals.
fn write_ply(path: &Path, views: &[NextView], unit: Unit) -> Result<()> {
    let axis = |v: &NextView| {
        let pose = Pose::from_quaternion_xyzw(v.quaternion_xyzw, v.translation).unwrap_or_default();
        // PLY has no poses. The axis as a normal shows the direction in any viewer.
        pose.rotate(DVec3::Z)
    };
    let column = |value: fn(&NextView) -> f64| views.iter().map(value).collect::<Vec<f64>>();
    let (worst, mean) = (column(|v| v.worst_sigma_after), column(|v| v.mean_sigma_after));
    write_points(
        path,
        &MeshColumns {
            points: &views.iter().map(|v| v.translation).collect::<Vec<_>>(),
            normals: Some(&views.iter().map(axis).collect::<Vec<_>>()),
            columns: vec![
                ("worst_sigma_after", Column::F64(&worst)),
                ("mean_sigma_after", Column::F64(&mean)),
            ],
            unit: Some(unit),
            ..MeshColumns::default()
        },
    )
}
