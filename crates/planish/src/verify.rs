//! Verifies files: each is read completely, and everything that can be checked in it is checked.
//!
//! Input: files of any kind that Planish reads. Output: a [`VerifyReport`] with one entry for each file. A
//! defect is data and not an error, so one bad file does not hide the state of the others.
//!
//! | kind | checks besides those of the reader |
//! |---|---|
//! | saved model | checksums, ranges, vertices against the information, positive definite information |
//! | mesh | triangles, `sigma` ≥ 0, `observed` in 0 to 3, materials and texture |
//! | faces (STEP) | every face |
//! | list of scans, views | every file that it names |
//! | others | none |
//!
//! Not guaranteed: that contents are right. A file without checksums may be changed so that it stays valid.

use crate::info::{Contents, FileInfo, MeshFile, MeshInfo, info, mesh, scans};
use crate::job::Job;
use planish_core::finding::with_warnings;
use planish_core::{Finding, FindingCode, Progress};
use planish_estimate::{Error, ErrorKind, Result};
use planish_exchange::calibration::{
    read_calibration, read_grid_calibration, read_lights, read_stereo_calibration, read_view_sensor,
};
use planish_exchange::contours::{
    CarmenOptions, SigmaDefaults, read_contour_json, read_contour_readings, read_ray_readings,
};
use planish_exchange::depth::find_calibration;
use planish_exchange::mesh::PolygonMesh;
use planish_exchange::picture::read_picture;
use planish_exchange::poses::read_poses;
use planish_exchange::textured::{TexturedMesh, read_materials, read_textured};
use planish_exchange::views::read_views;
use planish_exchange::{FileKind, Unit, read_drawing};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Placeholder for a σ that a file of readings leaves to an option: only the file is verified.
const UNSTATED_SIGMA: f64 = 1.0;

/// Files to verify.
///
/// # Examples
/// ```
/// use planish::{Job, progress::Silent, verify::VerifyJob};
/// let files = vec!["../../examples/data/pebble/truth.ply".into()];
/// let report = VerifyJob { files, ..VerifyJob::default() }.run(&Silent)?;
/// assert!(report.files[0].whole, "{}", report.files[0].text);
/// # Ok::<(), planish::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct VerifyJob {
    /// The files.
    pub files: Vec<PathBuf>,
    /// Unit of files without one.
    pub unit: Option<Unit>,
}

/// The state of every file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VerifyReport {
    /// One entry for each file, in the order of the job.
    pub files: Vec<VerifiedFile>,
    /// Number of files with a defect.
    pub defective: usize,
    /// Findings about all files; a defect is one of level error.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

/// The state of a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VerifiedFile {
    /// The file.
    pub file: PathBuf,
    /// Its kind, such as `saved model`; none if it is of no kind that Planish reads.
    pub kind: Option<&'static str>,
    /// True if no defect was found.
    pub whole: bool,
    /// The contents of a whole file, or the defect.
    pub text: String,
    /// Category of the defect.
    #[serde(skip)]
    pub error: Option<ErrorKind>,
}

impl Job for VerifyJob {
    type Report = VerifyReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(self.files.clone())
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        Ok(Vec::new())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<VerifyReport> {
        let mut report = VerifyReport { files: Vec::new(), defective: 0, findings: Vec::new() };
        for (k, file) in self.files.iter().enumerate() {
            progress.check("reading", k as f64 / self.files.len() as f64)?;
            let kind = FileKind::of_file(file);
            let name = kind.as_ref().ok().map(|kind| kind.name());
            let checked = kind.and_then(|kind| verify(file, kind, self.unit));
            let (text, error) = match checked {
                Ok(Checked { contents, findings }) => {
                    let of_file = |finding: Finding| finding.in_context(file.display());
                    report.findings.extend(findings.into_iter().map(of_file));
                    (contents, None)
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => return Err(e),
                Err(e) => {
                    let text = with_causes(&e, file);
                    let finding = Finding::new(FindingCode::FileDefective, &text);
                    report.findings.push(finding.in_context(file.display()));
                    report.defective += 1;
                    (text, Some(e.kind()))
                }
            };
            let whole = error.is_none();
            report.files.push(VerifiedFile { file: file.clone(), kind: name, whole, text, error });
        }
        Ok(report)
    }
}

/// The message of an error without the name of the file, which every line begins with.
fn with_causes(error: &Error, file: &Path) -> String {
    let text = error.to_string();
    let name = format!("{}: ", file.display());
    text.strip_prefix(&name).unwrap_or(&text).to_owned()
}

/// A file without a defect.
struct Checked {
    contents: String,
    findings: Vec<Finding>,
}

impl Checked {
    fn new(contents: String) -> Self {
        Self { contents, findings: Vec::new() }
    }

    /// Contents in which nothing is counted, if they can be read.
    fn read(result: Result<()>, contents: &str) -> Result<Self> {
        result.map(|()| Self::new(contents.to_owned()))
    }

    /// A number of items.
    fn count(count: usize, items: &str) -> Self {
        Self::new(format!("{count} {items}"))
    }
}

/// Reads a file of that kind completely.
fn verify(path: &Path, kind: FileKind, unit: Option<Unit>) -> Result<Checked> {
    Ok(match kind {
        FileKind::Model | FileKind::Points | FileKind::ScanList => described(info(path, unit)?),
        FileKind::Mesh => verify_mesh(path, unit)?,
        FileKind::Step => verify_faces(path, unit)?,
        FileKind::Views => verify_views(path)?,
        FileKind::Poses => Checked::count(read_poses(path)?.poses.len(), "poses"),
        FileKind::DepthCamera => Checked::read(read_calibration(path).map(drop), "depth camera")?,
        FileKind::StereoCalibration => {
            Checked::read(read_stereo_calibration(path).map(drop), "stereo calibration")?
        }
        FileKind::GridCalibration => {
            Checked::read(read_grid_calibration(path).map(drop), "camera, projector and stripes")?
        }
        FileKind::Lights => Checked::read(read_lights(path).map(drop), "lights")?,
        FileKind::ViewSensor => Checked::read(read_view_sensor(path).map(drop), "sensor for planned views")?,
        FileKind::Drawing => {
            let drawing = read_drawing(path)?;
            let contents = format!("drawing of {} curves", drawing.curves.len());
            Checked { contents, findings: drawing.findings }
        }
        FileKind::Contour => Checked::count(read_contour_json(path)?.contours.len(), "contours"),
        FileKind::ContourReadings => {
            // A log is read completely, not only its first scan.
            let options = CarmenOptions { count: usize::MAX >> 1, ..CarmenOptions::default() };
            let readings = read_contour_readings(path, &sigma_defaults(), &options)?;
            Checked::count(readings.sightings.len(), "readings of a contour")
        }
        FileKind::RayReadings => {
            Checked::count(read_ray_readings(path, &sigma_defaults())?.len(), "readings in space")
        }
        FileKind::Materials => Checked::count(read_materials(path)?.len(), "materials with pictures"),
        // With a calibration beside it, a picture is a depth image.
        FileKind::Picture => match find_calibration(path, None) {
            Ok(_) => described(info(path, unit)?),
            Err(_) => {
                let picture = read_picture(path)?;
                Checked::new(format!("picture of {} × {} pixels", picture.columns, picture.rows))
            }
        },
    })
}

fn sigma_defaults() -> SigmaDefaults {
    let sigma = Some(UNSTATED_SIGMA);
    SigmaDefaults { position: sigma, heading_deg: sigma, range: sigma, point: sigma }
}

/// The contents that `info` describes; it has read the whole file.
fn described(info: FileInfo) -> Checked {
    let contents = match &info.contents {
        Contents::Scan(scan) => format!("scan of {} points", scan.points),
        Contents::Scans(list) => format!("{} scans of {} points", list.scans.len(), list.points),
        Contents::Mesh(mesh) => {
            format!("mesh of {} vertices and {} triangles", mesh.vertices, mesh.triangles)
        }
        Contents::Model(model) => {
            format!(
                "{} of {} control vertices, {} readings",
                model.topology, model.coefficients, model.observations
            )
        }
    };
    Checked { contents, findings: info.findings }
}

/// Checks that every face can be read.
fn verify_faces(path: &Path, unit: Option<Unit>) -> Result<Checked> {
    let checked = info(path, unit)?;
    match &checked.contents {
        Contents::Mesh(MeshInfo { faces: Some(faces), .. }) if !faces.unreadable.is_empty() => {
            Err(Error::input(format!(
                "{} of {} faces cannot be read; the first is {}",
                faces.unreadable.len(),
                faces.unreadable.len() + faces.faces,
                faces.unreadable[0]
            )))
        }
        _ => Ok(described(checked)),
    }
}

/// Checks triangles, values of vertices, and texture.
fn verify_mesh(path: &Path, unit: Option<Unit>) -> Result<Checked> {
    // With materials and texture, where the format has them.
    let mut missing = Vec::new();
    let read = |path: &Path| -> Result<PolygonMesh> {
        let TexturedMesh { points, triangles, columns, unit, findings, .. } = read_textured(path)?;
        missing = findings;
        Ok(PolygonMesh { points, triangles, columns, unit })
    };
    let (file, columns) = match MeshFile::read(path, read)? {
        MeshFile::Mesh(file, columns) => (file, columns),
        MeshFile::Points(stated) => return Ok(described(scans(path, stated, unit)?)),
    };
    type Valid = fn(f64) -> bool;
    let ranges: [(&str, &str, Valid); 2] = [
        ("sigma", "a number ≥ 0", |sigma| sigma >= 0.0 && sigma.is_finite()),
        ("observed", "0, 1, 2 or 3", |mark| [0.0, 1.0, 2.0, 3.0].contains(&mark)),
    ];
    for (name, expected, valid) in ranges {
        let column = file.column(name).unwrap_or_default();
        if let Some(at) = column.iter().position(|&value| !valid(value)) {
            return Err(Error::input(format!(
                "{}: vertex {at}: expected {expected} in the column {name}, found {}",
                path.display(),
                column[at]
            )));
        }
    }
    let mut checked = described(mesh(path, file, columns, unit)?);
    checked.findings.extend(missing);
    Ok(checked)
}

/// Checks the cameras, and that every picture can be read.
fn verify_views(path: &Path) -> Result<Checked> {
    let views = read_views(path)?;
    for view in &views.views {
        for picture in view.image.iter().chain(&view.mask) {
            read_picture(picture).map_err(|e| e.in_context(format!("view {}", view.name)))?;
        }
    }
    Ok(Checked::count(views.views.len(), "views"))
}

#[cfg(test)]
mod tests;
