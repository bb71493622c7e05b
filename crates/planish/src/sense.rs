//! The job `planish sense`: converts raw data of a sensor to points with covariances.
//!
//! Input: a [`SenseJob`]. Output: the files that it names and a [`SenseReport`]. Outputs are checked before
//! anything is read, and written after everything else has succeeded.
//!
//! | kind | input | output besides points (`.ply`) |
//! |---|---|---|
//! | stereo | two pictures, rectified or not | disparities and their σ (`.tif`, `.npy`) |
//! | grid | a picture of crossed stripes | |
//! | photometric | images under known lights, or an image of normals | normals, their σ (`.tif`, `.npy`) |
//! | depth | a depth image | |
//!
//! Not guaranteed: lens distortion is corrected only for stereo pairs whose calibration states it. All other
//! pictures must be undistorted.

mod front_ends;
mod photometric;

use crate::job::Job;
use crate::output::{as_text, refuse_input_as_output};
use front_ends::{depth, grid, normal_map, stereo};
use photometric::photometric;
use planish_core::finding::with_warnings;
use planish_core::{Finding, FindingCode, Setting};
use planish_core::{Progress, ProgressPart, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::calibration::{
    LightSource, StereoCalibration, StereoCameras, read_grid_calibration, read_lights,
    read_stereo_calibration,
};
use planish_exchange::depth::{find_calibration, read_depth};
use planish_exchange::picture::{read_brightness, read_picture};
use planish_exchange::ply::write_scan;
use planish_exchange::raster::write_raster;
use planish_exchange::{Unit, extension};
use planish_sense::stripes::{GridOptions, GridRejected, read_grid};
use planish_sense::{
    PhotometricOptions, Rectification, Scan, StereoOptions, StereoPoints, StereoRejected, lights_from_ball,
    match_stereo, normals_from_colours, photometric_normals,
};
pub use planish_surface::model::SigmaSummary;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A measurement and its input files.
#[derive(Debug, Clone)]
pub enum SenseKind {
    /// Two pictures: rectified, or with a calibration that contains the poses of both cameras.
    Stereo {
        /// The left one, whose pixels get points.
        left: PathBuf,
        /// The right one.
        right: PathBuf,
        /// The two cameras; none if only disparities are written.
        calibration: Option<PathBuf>,
        /// Settings of the matching.
        options: StereoOptions,
        /// Selection of the disparities that are written as points.
        points: StereoPoints,
    },
    /// A picture of crossed stripes.
    Grid {
        /// The picture.
        image: PathBuf,
        /// The same view without stripes. Its brightness shows the texture of the object.
        plain: Option<PathBuf>,
        /// Camera, projector and stripes.
        calibration: PathBuf,
        /// Settings of the detection of stripes.
        options: GridOptions,
    },
    /// Pictures of one view under several lights.
    Photometric {
        /// One for each light, in the calibration's order.
        images: Vec<PathBuf>,
        /// White where the object is. Without a mask, every pixel that is not dark counts as object.
        mask: Option<PathBuf>,
        /// The lights.
        calibration: PathBuf,
    },
    /// A picture whose colours are normals.
    NormalMap {
        /// The picture.
        image: PathBuf,
        /// σ of its normals, in degrees. It must be given, because no picture states it.
        sigma_deg: f64,
    },
    /// A depth image.
    Depth {
        /// The image.
        image: PathBuf,
        /// Its camera; a file of the image's name with the extension `.toml` if none is given.
        calibration: Option<PathBuf>,
    },
}

impl SenseKind {
    /// Its name on the command line.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Stereo { .. } => "stereo",
            Self::Grid { .. } => "grid",
            Self::Photometric { .. } | Self::NormalMap { .. } => "photometric",
            Self::Depth { .. } => "depth",
        }
    }

    /// The files that it names.
    fn inputs(&self) -> Vec<PathBuf> {
        match self {
            Self::Stereo { left, right, calibration, .. } => {
                [left, right].into_iter().chain(calibration).cloned().collect()
            }
            Self::Grid { image, plain, calibration, .. } => {
                [image].into_iter().chain(plain).chain([calibration]).cloned().collect()
            }
            Self::Photometric { images, mask, calibration } => {
                images.iter().chain(mask).chain([calibration]).cloned().collect()
            }
            Self::NormalMap { image, .. } => vec![image.clone()],
            Self::Depth { image, calibration } => [image].into_iter().chain(calibration).cloned().collect(),
        }
    }
}

/// A measurement and the files to write.
///
/// # Examples
/// ```no_run
/// use planish::Job;
/// use planish::progress::Silent;
/// use planish::sense::{SenseJob, SenseKind};
/// let job = SenseJob {
///     kind: SenseKind::Depth { image: "frame.png".into(), calibration: Some("camera.toml".into()) },
///     outputs: vec!["points.ply".into()],
///     unit: None,
/// };
/// println!("{} points", job.run(&Silent)?.observations);
/// # Ok::<(), planish::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct SenseJob {
    /// The sensor and its files.
    pub kind: SenseKind,
    /// Files to write: points as `.ply`, images of numbers as `.tif`, `.tiff` or `.npy`.
    pub outputs: Vec<PathBuf>,
    /// The unit of calibrations that name none.
    pub unit: Option<Unit>,
}

/// A file that was written, and its contents.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensedFile {
    /// Path as the user gave it.
    #[serde(serialize_with = "as_text")]
    pub file: PathBuf,
    /// Points, of a scan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<usize>,
    /// Meaning of the bands of an image.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub bands: Vec<&'static str>,
}

/// The figures of a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SenseReport {
    /// Kind of the measurement.
    pub kind: &'static str,
    /// Pixels of an image.
    pub pixels: usize,
    /// Pixels with a result.
    pub observations: usize,
    /// Pixels without a result, by cause.
    pub rejected: BTreeMap<&'static str, usize>,
    /// σ of the disparities, or of the crossings of stripes, in pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_px: Option<SigmaSummary>,
    /// σ of the points along their rays, in the unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma: Option<SigmaSummary>,
    /// σ of the normals, in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_n_deg: Option<SigmaSummary>,
    /// σ of the curvatures, one over the unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_k: Option<SigmaSummary>,
    /// Ratio of σ of the crossings, as estimated from their epipolar distances, to σ from picture noise
    /// alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub enlarged: Option<f64>,
    /// Share of ambient light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ambient: Option<f64>,
    /// σ of the brightness due to noise, in the images' scale.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_brightness: Option<f64>,
    /// σ of the errors of lights and of the law of reflection, as a share of the brightness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model_error: Option<f64>,
    /// Readings of brightness by their use.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub readings: BTreeMap<&'static str, usize>,
    /// Unit of every length.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Files that were read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Files that were written.
    pub written: Vec<SensedFile>,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

/// Columns, rows, and the bands by their names.
type Raster = (usize, usize, Vec<(&'static str, Vec<f32>)>);

/// Results before they are written.
#[derive(Default)]
struct Sensed {
    scan: Option<Scan>,
    raster: Option<Raster>,
    pixels: usize,
    observations: usize,
    rejected: BTreeMap<&'static str, usize>,
    sigma_px: Option<SigmaSummary>,
    sigma_n_deg: Option<SigmaSummary>,
    sigma_k: Option<SigmaSummary>,
    enlarged: Option<f64>,
    ambient: Option<f64>,
    sigma_brightness: Option<f64>,
    model_error: Option<f64>,
    readings: BTreeMap<&'static str, usize>,
    unit: Option<Unit>,
    /// Files that a calibration named.
    more_inputs: Vec<PathBuf>,
    /// Findings for the user.
    findings: Vec<Finding>,
}

impl Job for SenseJob {
    type Report = SenseReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(self.kind.inputs())
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        check_formats(self)?;
        Ok(self.outputs.clone())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<SenseReport> {
        sense(self, progress)
    }
}

/// Reads the inputs, computes points and writes them. Nothing is written unless everything else succeeds.
fn sense(job: &SenseJob, progress: &dyn Progress) -> Result<SenseReport> {
    progress.check("reading", 0.0)?;
    // The computation takes nearly all of the time.
    let working = ProgressPart::new(progress, 0.05, 0.9);
    let mut sensed = match &job.kind {
        SenseKind::Stereo { left, right, calibration, options, points } => {
            stereo([left, right], calibration.as_deref(), options, points, &working)?
        }
        SenseKind::Grid { image, plain, calibration, options } => {
            grid(image, plain.as_deref(), calibration, options)?
        }
        SenseKind::Photometric { images, mask, calibration } => {
            photometric(images, mask.as_deref(), calibration, &working)?
        }
        SenseKind::NormalMap { image, sigma_deg } => normal_map(image, *sigma_deg)?,
        SenseKind::Depth { image, calibration } => depth(image, calibration.as_deref())?,
    };
    let mut inputs = job.kind.inputs();
    inputs.append(&mut sensed.more_inputs);
    // A calibration may name further pictures, so outputs are compared with the inputs only here.
    for output in &job.outputs {
        refuse_input_as_output(output, &inputs)?;
    }
    // The calibration knows best; the option only fills a gap.
    let unit = sensed.unit.or(job.unit);
    let mut findings = std::mem::take(&mut sensed.findings);
    // A normal map has no lengths, so it needs no unit.
    if unit.is_none() && sensed.scan.is_some() && !matches!(job.kind, SenseKind::NormalMap { .. }) {
        let text = "expected a unit of length in the calibration, found none: add `unit` to it, or specify \
            the unit (mm, m, in or ft)";
        findings.push(Finding::new(FindingCode::UnitAssumed, text).with_setting(Setting::Unit));
    }
    let crossings = |cause: &str| sensed.rejected.get(cause).copied().unwrap_or(0);
    let lost = crossings("no_index") + crossings("off_line") + crossings("undetermined");
    // A wrong calibration still matches some crossings by chance. The few points would look like a sparse but
    // correct scan.
    if matches!(job.kind, SenseKind::Grid { .. }) && lost > 2 * sensed.observations {
        let text = format!(
            "only {} of {} crossings of stripes agree with the calibration: check spacing, directions and \
             origin of [stripes], and the projector",
            sensed.observations,
            sensed.observations + lost
        );
        findings.push(Finding::new(FindingCode::CrossingsInconsistent, text));
    }
    progress.check(WRITING_STAGE, 0.95)?;
    let written = job.outputs.iter().map(|path| write(path, &sensed, unit)).collect::<Result<_>>()?;
    progress.advance("done", 1.0);
    Ok(SenseReport {
        kind: job.kind.name(),
        pixels: sensed.pixels,
        observations: sensed.observations,
        // Sorted by name, so that reports of equal runs are equal.
        rejected: sensed.rejected,
        sigma_px: sensed.sigma_px,
        sigma: match &job.kind {
            // Depth is not measured there.
            SenseKind::Photometric { .. } | SenseKind::NormalMap { .. } => None,
            _ => sensed.scan.as_ref().and_then(along_rays),
        },
        sigma_n_deg: sensed.sigma_n_deg,
        sigma_k: sensed.sigma_k,
        enlarged: sensed.enlarged,
        ambient: sensed.ambient,
        sigma_brightness: sensed.sigma_brightness,
        model_error: sensed.model_error,
        readings: sensed.readings,
        unit,
        inputs,
        written,
        findings,
    })
}

/// σ along the rays from the sensor.
fn along_rays(scan: &Scan) -> Option<SigmaSummary> {
    // Points are in the sensor's frame, so the direction of a point is that of its ray.
    let covariances = scan.covariance.as_ref()?.iter().zip(&scan.points);
    summary(covariances.filter_map(|(c, p)| Some(c.along(p.try_normalize()?).sqrt())).collect())
}

pub(crate) fn summary(mut values: Vec<f64>) -> Option<SigmaSummary> {
    values.sort_by(f64::total_cmp);
    // For an empty list, −1 becomes index 0, which does not exist: the summary is absent.
    let at = |share: f64| values.get(((values.len() as f64 - 1.0) * share).round() as usize).copied();
    Some(SigmaSummary { median: at(0.5)?, p95: at(0.95)?, max: at(1.0)? })
}

fn check_formats(job: &SenseJob) -> Result<()> {
    // A depth image would only be copied, and crossings of stripes lie on no pixel grid.
    let images = !matches!(job.kind, SenseKind::Depth { .. } | SenseKind::Grid { .. });
    for path in &job.outputs {
        let kind = extension(path);
        let packed = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
        match kind.as_str() {
            "ply" if !packed => {
                // Checked before matching, which takes most of the time.
                if let SenseKind::Stereo { calibration: None, .. } = job.kind {
                    return Err(Error::input(format!(
                        "{}: expected the calibration of the cameras for points, found none: specify it, \
                         or write disparities as .tif",
                        path.display()
                    ))
                    .with_setting(Setting::Calibration));
                }
            }
            "tif" | "tiff" | "npy" if images && !packed => {}
            other => {
                let wanted = if images {
                    ".ply (points), or .tif or .npy (an image of numbers)"
                } else {
                    ".ply (points)"
                };
                return Err(Error::unsupported(format!(
                    "{}: cannot write this format: expected {wanted}, found `{other}`",
                    path.display()
                )));
            }
        }
    }
    Ok(())
}

fn write(path: &Path, sensed: &Sensed, unit: Option<Unit>) -> Result<SensedFile> {
    let mut written = SensedFile { file: path.to_path_buf(), points: None, bands: Vec::new() };
    match (extension(path).as_str(), &sensed.scan, &sensed.raster) {
        ("ply", Some(scan), _) => {
            write_scan(path, scan, unit)?;
            written.points = Some(scan.points.len());
        }
        // Formats were checked before, so this is a result that lacks what its kind usually has.
        ("ply", None, _) | (_, _, None) => {
            return Err(Error::input(format!(
                "{}: expected data for this output, found none",
                path.display()
            )));
        }
        (_, _, Some((columns, rows, bands))) => {
            let values: Vec<&[f32]> = bands.iter().map(|(_, band)| &band[..]).collect();
            write_raster(path, *columns, *rows, &values)?;
            written.bands = bands.iter().map(|(name, _)| *name).collect();
        }
    }
    Ok(written)
}
