//! The job `planish sense`: raw data of a sensor in, points that state their covariance out.
//!
//! Input: a [`SenseJob`]. Output: the files that it names and a [`SenseReport`]. Outputs are checked
//! before anything is read, and written when everything else has succeeded.
//!
//! | kind | comes in | goes out beside points (`.ply`) |
//! |---|---|---|
//! | stereo | two pictures, rectified or not | disparities and their σ (`.tif`, `.npy`) |
//! | grid | a picture of crossed stripes | |
//! | photometric | pictures under known lights, or a picture of normals | normals and their σ (`.tif`, `.npy`) |
//! | depth | a depth image | |
//!
//! Not guaranteed: an undistorted lens; pictures are taken to be so, but for two views of stereo whose
//! calibration states their distortion.

use crate::job::Job;
use crate::output::{as_text, refuse_input_as_output};
use planish_core::{Progress, ProgressPart, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::calibration::{
    LightSource, StereoCalibration, StereoCameras, read_grid_calibration, read_lights,
    read_stereo_calibration,
};
use planish_exchange::depth::{calibration_of, read_depth};
use planish_exchange::picture::{read_brightness, read_picture};
use planish_exchange::ply::write_scan;
use planish_exchange::raster::write_raster;
use planish_exchange::{Unit, extension};
use planish_sense::stripes::{GridOptions, GridRejected, read_grid};
use planish_sense::{
    Image, PhotometricOptions, Rectification, Scan, StereoOptions, StereoPoints, StereoRejected,
    lights_from_ball, match_stereo, normals_from_colours, photometric_normals,
};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A direction with a larger σ, in degrees, is not known.
const MOST_SIGMA_DEG: f64 = 90.0;

/// Residuals of brightness that are so many times the stated σ are told.
const MOST_BRIGHTNESS_MISFIT: f64 = 3.0;
/// And those that are so large a share of the brightest: matte objects under far lights stay below a few per
/// cent.
const MOST_BRIGHTNESS_SHARE: f64 = 0.1;
/// So small a share of pixels with a match is told: of true pairs a third to nine tenths have one, of
/// exchanged ones some per cent.
const LEAST_MATCHED: f64 = 0.1;

/// What is to be sensed, from which files.
#[derive(Debug, Clone)]
pub enum SenseKind {
    /// Two pictures; rectified, or with a calibration that says how both cameras stand.
    Stereo {
        /// The left one, whose pixels get points.
        left: PathBuf,
        /// The right one.
        right: PathBuf,
        /// The two cameras; none where only disparities are wanted.
        calibration: Option<PathBuf>,
        /// How they are matched.
        options: StereoOptions,
        /// Which of the disparities are written as points.
        points: StereoPoints,
    },
    /// A picture of crossed stripes.
    Grid {
        /// The picture.
        image: PathBuf,
        /// The same view without stripes, whose brightness tells the object's texture.
        plain: Option<PathBuf>,
        /// Camera, projector and stripes.
        calibration: PathBuf,
        /// How stripes are looked for.
        options: GridOptions,
    },
    /// Pictures of one view under several lights.
    Photometric {
        /// One for each light, in the calibration's order.
        images: Vec<PathBuf>,
        /// White where the object is; none where all that is not dark is.
        mask: Option<PathBuf>,
        /// The lights.
        calibration: PathBuf,
    },
    /// A picture whose colours are normals.
    NormalMap {
        /// The picture.
        image: PathBuf,
        /// σ of its normals, in degrees: no picture states it.
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

/// What to sense, and what to write of it.
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

/// A file that was written, and what went into it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensedFile {
    /// Its path as the user gave it.
    #[serde(serialize_with = "as_text")]
    pub file: PathBuf,
    /// Points, of a scan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<usize>,
    /// What the bands of an image are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub bands: Vec<&'static str>,
}

/// σ over all points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SigmaSummary {
    /// The median.
    pub median: f64,
    /// Nineteen of twenty are no larger.
    pub p95: f64,
    /// The largest.
    pub max: f64,
}

/// The figures of a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SenseReport {
    /// What was sensed.
    pub kind: &'static str,
    /// Pixels of an image.
    pub pixels: usize,
    /// Pixels with a result.
    pub observations: usize,
    /// Pixels without, by cause.
    pub rejected: BTreeMap<&'static str, usize>,
    /// σ of the disparities, or of the places where stripes cross, in pixels.
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
    /// By how much σ of crossings is larger than the noise of the picture alone would make it, as their
    /// epipolar lines say.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub enlarged: Option<f64>,
    /// Share of light from everywhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ambient: Option<f64>,
    /// σ of the brightness, in the images' scale.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_brightness: Option<f64>,
    /// Unit of every length.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Files that were read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Files that were written.
    pub written: Vec<SensedFile>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

/// Columns, rows, and the bands by their names.
type Raster = (usize, usize, Vec<(&'static str, Vec<f32>)>);

/// What was sensed, before it is written.
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
    unit: Option<Unit>,
    /// Files that a calibration named.
    more_inputs: Vec<PathBuf>,
    /// Warnings for the user.
    warnings: Vec<String>,
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

/// Reads, senses and writes; nothing is written unless everything else succeeds.
fn sense(job: &SenseJob, progress: &dyn Progress) -> Result<SenseReport> {
    progress.check("reading", 0.0)?;
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
    for output in &job.outputs {
        refuse_input_as_output(output, &inputs)?;
    }
    let unit = sensed.unit.or(job.unit);
    let mut warnings = std::mem::take(&mut sensed.warnings);
    if unit.is_none() && sensed.scan.is_some() && !matches!(job.kind, SenseKind::NormalMap { .. }) {
        warnings.push(
            "the calibration states no unit of length: add `unit` to it, or use --unit mm, m, in or ft"
                .to_owned(),
        );
    }
    let crossings = |cause: &str| sensed.rejected.get(cause).copied().unwrap_or(0);
    let lost = crossings("no_index") + crossings("off_line") + crossings("undetermined");
    if matches!(job.kind, SenseKind::Grid { .. }) && lost > 2 * sensed.observations {
        warnings.push(format!(
            "{} of {} crossings of stripes agree with the calibration: are spacing, directions and origin \
             of [stripes], and the projector, those of the picture?",
            sensed.observations,
            sensed.observations + lost
        ));
    }
    progress.check(WRITING_STAGE, 0.95)?;
    let written = job.outputs.iter().map(|path| write(path, &sensed, unit)).collect::<Result<_>>()?;
    progress.advance("done", 1.0);
    Ok(SenseReport {
        kind: job.kind.name(),
        pixels: sensed.pixels,
        observations: sensed.observations,
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
        unit,
        inputs,
        written,
        warnings,
    })
}

fn stereo(
    [left, right]: [&Path; 2],
    calibration: Option<&Path>,
    options: &StereoOptions,
    points: &StereoPoints,
    progress: &dyn Progress,
) -> Result<Sensed> {
    let known = calibration.map(read_stereo_calibration).transpose()?;
    let mut images = [read_brightness(left)?, read_brightness(right)?];
    let blame = || format!("{}, {}", left.display(), right.display());
    let rectification = match &known {
        Some(StereoCalibration { cameras: StereoCameras::Views(rig), .. }) => {
            progress.check("rectifying", 0.0)?;
            let made = Rectification::new(rig, [0, 1].map(|k| [images[k].columns, images[k].rows]));
            let made = made.map_err(|e| e.in_context(calibration.unwrap_or(left).display()))?;
            images = [made.picture(0, &images[0])?, made.picture(1, &images[1])?];
            Some(made)
        }
        _ => None,
    };
    let mut map =
        match_stereo(&images[0], &images[1], options, &mut |share| progress.check("matching", share))
            .map_err(|e| in_context(e, blame()))?;
    let outside = rectification.as_ref().map_or(0, |r| r.without_outside(&mut map));
    let scan = match (&rectification, &known) {
        (Some(rectification), _) => Some(rectification.scan(&map, points, "stereo")),
        (None, Some(StereoCalibration { cameras: StereoCameras::Rectified(camera), .. })) => {
            Some(camera.scan(&map, points, "stereo"))
        }
        _ => None,
    };
    let scan = scan.transpose().map_err(|e| e.in_context(blame()))?;
    let known_unit = known.and_then(|c| c.unit);
    let known: Vec<f64> = map.sigma.iter().filter(|s| s.is_finite()).map(|s| f64::from(*s)).collect();
    if known.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: no disparity is to be believed: are the pictures rectified (or does the calibration say \
             how both cameras stand), left before right, and the range of disparities wide enough, also \
             below 0?",
            blame()
        )));
    }
    let StereoRejected { ambiguous, left_right, speckle, range } = map.rejected;
    let causes = [
        ("ambiguous", ambiguous),
        ("left_right", left_right),
        ("speckle", speckle),
        ("range", range),
        ("outside", outside),
    ];
    let mut warnings = Vec::new();
    if (known.len() as f64) < LEAST_MATCHED * map.disparity.len() as f64 {
        warnings.push(format!(
            "only {:.1} % of the pixels have a match, and many of those may be chance: is the left picture \
             the first, are the pictures rectified, and is --disparities wide enough?",
            100.0 * known.len() as f64 / map.disparity.len() as f64
        ));
    }
    Ok(Sensed {
        warnings,
        pixels: map.disparity.len(),
        observations: known.len(),
        rejected: causes.into_iter().filter(|(_, n)| *n > 0).collect(),
        sigma_px: summary(known),
        raster: Some((map.columns, map.rows, vec![("disparity", map.disparity), ("sigma", map.sigma)])),
        unit: known_unit,
        scan,
        ..Sensed::default()
    })
}

/// An interruption is nobody's file.
fn in_context(e: Error, context: String) -> Error {
    match e.kind() {
        planish_estimate::ErrorKind::Interrupted => e,
        _ => e.in_context(context),
    }
}

fn grid(image: &Path, plain: Option<&Path>, calibration: &Path, options: &GridOptions) -> Result<Sensed> {
    let known = read_grid_calibration(calibration)?;
    let picture = read_brightness(image)?;
    let without = plain.map(read_brightness).transpose()?;
    let found = read_grid(&picture, without.as_ref(), &known.grid, options)
        .map_err(|e| e.in_context(image.display()))?;
    let GridRejected { no_crossing, no_index, off_line, undetermined } = found.rejected;
    let bent: Vec<f64> = (found.readings.iter()).filter_map(|r| r.curvature).map(|c| c.sigma).collect();
    let causes = [
        ("no_crossing", no_crossing),
        ("no_index", no_index),
        ("off_line", off_line),
        ("undetermined", undetermined),
        ("no_curvature", found.readings.len() - bent.len()),
    ];
    Ok(Sensed {
        pixels: picture.values.len(),
        observations: found.readings.len(),
        rejected: causes.into_iter().filter(|(_, n)| *n > 0).collect(),
        sigma_n_deg: summary(found.readings.iter().map(|r| r.orientation.sigma_normal_deg).collect()),
        sigma_k: summary(bent),
        sigma_px: summary(found.sigma_px.clone()),
        enlarged: found.enlarged,
        unit: known.unit,
        scan: Some(found.scan("grid")),
        ..Sensed::default()
    })
}

fn photometric(
    images: &[PathBuf],
    mask: Option<&Path>,
    calibration: &Path,
    progress: &dyn Progress,
) -> Result<Sensed> {
    let known = read_lights(calibration)?;
    let read = |paths: &[PathBuf]| paths.iter().map(|p| read_brightness(p)).collect::<Result<Vec<Image>>>();
    let pictures = read(images)?;
    let mask_file = mask;
    let mask = mask.map(read_brightness).transpose()?;
    let first = (pictures.first()).map_or((0, 0), |p| (p.columns, p.rows));
    for (file, picture) in
        images.iter().map(PathBuf::as_path).chain(mask_file).zip(pictures.iter().chain(&mask))
    {
        if (picture.columns, picture.rows) != first {
            return Err(Error::input(format!(
                "{}: needed {} × {} pixels like {}, found {} × {}",
                file.display(),
                first.0,
                first.1,
                images[0].display(),
                picture.columns,
                picture.rows
            )));
        }
    }
    progress.check("lights", 0.1)?;
    let blame = |e: Error| e.in_context(calibration.display());
    let mut more_inputs = Vec::new();
    let lights = match &known.source {
        LightSource::Directions(lights) => lights.clone(),
        LightSource::Ball { images, mask } => {
            more_inputs.extend(images.iter().chain([mask]).cloned());
            lights_from_ball(&read(images)?, &read_brightness(mask)?).map_err(blame)?
        }
    };
    let options = PhotometricOptions {
        sigma_brightness: known.sigma_brightness,
        sigma_light_deg: known.sigma_light_deg,
        ..PhotometricOptions::default()
    };
    progress.check("normals", 0.2)?;
    let map = photometric_normals(&pictures, &lights, mask.as_ref(), &options).map_err(blame)?;
    let mut sensed = of_normals(&map, known.pixel_size)?;
    sensed.ambient = Some(map.ambient);
    sensed.sigma_brightness = Some(map.sigma_brightness);
    sensed.unit = known.unit;
    sensed.more_inputs = more_inputs;
    sensed.warnings = unlike_brightness(&map, known.sigma_brightness);
    Ok(sensed)
}

/// Residuals that the stated σ of brightness, or any matte surface, does not explain.
fn unlike_brightness(map: &planish_sense::NormalMap, stated: Option<f64>) -> Vec<String> {
    let Some(found) = map.sigma_of_residuals else {
        return Vec::new();
    };
    let mut warnings = Vec::new();
    if let Some(stated) = stated.filter(|stated| found > MOST_BRIGHTNESS_MISFIT * stated) {
        warnings.push(format!(
            "the brightness of the typical pixel departs from that of a matte surface by {found:.3}, {:.0} \
             times the stated sigma_brightness: σ of the normals is too \
             small by as much; leave sigma_brightness out, or are the pictures in the order of the lights?",
            found / stated
        ));
    }
    if found > MOST_BRIGHTNESS_SHARE * map.brightest {
        warnings.push(format!(
            "the brightness of the typical pixel departs from that of a matte surface by {:.0} % of the \
             brightest: are the pictures in the order of the lights, and of one view?",
            100.0 * found / map.brightest
        ));
    }
    warnings
}

fn normal_map(image: &Path, sigma_deg: f64) -> Result<Sensed> {
    if !(sigma_deg > 0.0 && sigma_deg < MOST_SIGMA_DEG) {
        return Err(Error::input(format!(
            "needed a σ of the normals above 0 and below {MOST_SIGMA_DEG} degrees, found {sigma_deg}"
        )));
    }
    let picture = read_picture(image)?;
    let map = normals_from_colours(picture.columns, picture.rows, &picture.values, picture.white, sigma_deg);
    map.and_then(|map| of_normals(&map, 1.0)).map_err(|e| e.in_context(image.display()))
}

fn of_normals(map: &planish_sense::NormalMap, pixel_size: f64) -> Result<Sensed> {
    let scan = map.scan(pixel_size, "normals")?;
    let band =
        |k: usize| map.normals.iter().map(|n| n.map_or(f32::NAN, |n| n[k] as f32)).collect::<Vec<f32>>();
    let sigma = map.sigma_deg.iter().map(|s| *s as f32).collect();
    let bands = vec![("nx", band(0)), ("ny", band(1)), ("nz", band(2)), ("sigma_n_deg", sigma)];
    Ok(Sensed {
        pixels: map.normals.len(),
        observations: scan.points.len(),
        rejected: [("undetermined", map.undetermined)].into_iter().filter(|(_, n)| *n > 0).collect(),
        sigma_n_deg: summary(map.sigma_deg.iter().copied().filter(|s| s.is_finite()).collect()),
        raster: Some((map.columns, map.rows, bands)),
        scan: Some(scan),
        ..Sensed::default()
    })
}

fn depth(image: &Path, calibration: Option<&Path>) -> Result<Sensed> {
    let calibration = calibration_of(image, calibration)?;
    let (scan, unit) = read_depth(image, &calibration)?;
    if scan.points.is_empty() {
        return Err(Error::undetermined(format!("{}: no pixel has a depth", image.display())));
    }
    let mut warnings = Vec::new();
    if extension(image) == "png" && read_picture(image)?.white <= 255.0 {
        warnings.push(format!(
            "{}: has 8 bits, 256 depths at most: is it a depth image, or a picture of one for people?",
            image.display()
        ));
    }
    Ok(Sensed {
        warnings,
        pixels: scan.points.len() + scan.dropped_not_finite,
        observations: scan.points.len(),
        rejected: [("no_reading", scan.dropped_not_finite)].into_iter().filter(|(_, n)| *n > 0).collect(),
        unit,
        more_inputs: vec![calibration],
        scan: Some(scan),
        ..Sensed::default()
    })
}

/// σ along the rays from the sensor.
fn along_rays(scan: &Scan) -> Option<SigmaSummary> {
    let covariances = scan.covariance.as_ref()?.iter().zip(&scan.points);
    summary(
        covariances
            .filter_map(|(c, p)| {
                Some(planish_sense::variance_along(c, planish_estimate::vector3::unit(*p)?).sqrt())
            })
            .collect(),
    )
}

pub(crate) fn summary(mut values: Vec<f64>) -> Option<SigmaSummary> {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get(((values.len() as f64 - 1.0) * share).round() as usize).copied();
    Some(SigmaSummary { median: at(0.5)?, p95: at(0.95)?, max: at(1.0)? })
}

fn check_formats(job: &SenseJob) -> Result<()> {
    let images = !matches!(job.kind, SenseKind::Depth { .. } | SenseKind::Grid { .. });
    for path in &job.outputs {
        let kind = extension(path);
        let packed = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
        match kind.as_str() {
            "ply" if !packed => {
                if let SenseKind::Stereo { calibration: None, .. } = job.kind {
                    return Err(Error::input(format!(
                        "{}: points need the calibration of the cameras: say --calib, or write disparities \
                         as .tif",
                        path.display()
                    )));
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
                    "{}: cannot write this format: needed {wanted}, found `{other}`",
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
        ("ply", None, _) | (_, _, None) => {
            return Err(Error::input(format!("{}: there is nothing of that kind to write", path.display())));
        }
        (_, _, Some((columns, rows, bands))) => {
            let values: Vec<&[f32]> = bands.iter().map(|(_, band)| &band[..]).collect();
            write_raster(path, *columns, *rows, &values)?;
            written.bands = bands.iter().map(|(name, _)| *name).collect();
        }
    }
    Ok(written)
}
