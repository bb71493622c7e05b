//! Writes models. The extension of a file determines its format.
//!
//! Input: paths before the work, and a model after it. Output: files, each complete or absent.
//! [`plan_outputs`] finds problems with paths before the work. [`prepare`] finds problems with the model
//! before the first file is written. The remaining failures are those of the disk.

use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_exchange::geotiff::write_geotiff;
use planish_exchange::step::{Brep, StepOptions, write_step};
use planish_exchange::{
    GeoReference, Unit, check_writable, extension, make_folder, real_path, stl, write_atomically,
};
use planish_surface::export::{BrepOptions, Closing, brep_from_model};
use planish_surface::export::{Dem, dem_from_model};
use planish_surface::export::{ModelMesh, trimmed_mesh_from_model, write_model_mesh};
use planish_surface::model::{Posterior, SurfaceModel};
use planish_surface::saved::{Session, save};
use serde::{Serialize, Serializer};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Stated uncertainty of STEP files, in millimetres: vertices, edges and faces meet within it. CAD programs
/// use it as the tolerance of sewing. [`prepare`] checks the boundary representation against it.
const STEP_UNCERTAINTY_MM: f64 = 1e-6;

/// Writes files into a folder and creates it if necessary. If one file cannot be created, none is written.
///
/// # Errors
/// `Io` if the folder cannot be created or a file cannot be written.
pub fn write_files(folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
    make_folder(folder)?;
    for (name, _) in files {
        // All names are checked before the first file is written.
        check_writable(&folder.join(name))?;
    }
    (files.iter())
        .try_for_each(|(name, bytes)| write_atomically(&folder.join(name), |writer| writer.write_all(bytes)))
}

/// Formats in which a model can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputFormat {
    /// The exact surface for CAD programs: `.step`, `.stp`.
    Step,
    /// A mesh whose vertices carry σ and `observed`: `.ply`.
    Ply,
    /// A raster of heights with their σ, of a sheet: `.tif`, `.tiff`.
    Tiff,
    /// A mesh with normals: `.obj`.
    Obj,
    /// Triangles: `.stl`.
    Stl,
    /// A mesh for viewers, coloured by σ: `.glb`.
    Glb,
    /// The model itself, to be updated and compared: `.planish`.
    Planish,
}

impl OutputFormat {
    /// The format that the extension of a path selects; meshes and STEP may be compressed (`.ply.gz`).
    ///
    /// # Errors
    /// `Unsupported` for any other extension, or none.
    pub fn from_path(path: &Path) -> Result<Self> {
        match extension(path).as_str() {
            "step" | "stp" => Ok(Self::Step),
            "ply" => Ok(Self::Ply),
            // Rasters and saved models are not among the formats that are read from gzip.
            "tif" | "tiff" if !is_packed(path) => Ok(Self::Tiff),
            "obj" => Ok(Self::Obj),
            "stl" => Ok(Self::Stl),
            "glb" => Ok(Self::Glb),
            "planish" if !is_packed(path) => Ok(Self::Planish),
            other => {
                // Formats that can be read are not all written, so the message lists what can be written.
                let found = match other {
                    "" => "none".to_owned(),
                    "planish" => "`planish.gz`".to_owned(),
                    other => format!("`{other}`"),
                };
                Err(Error::unsupported(format!(
                    "{}: cannot write this format: expected .step or .stp (exact surface), .ply or .glb \
                     (mesh with σ), .obj or .stl (mesh), .tif (raster of heights) or .planish (saved \
                     model), found {found}",
                    path.display()
                )))
            }
        }
    }
}

impl OutputFormat {
    /// Whether the format stores triangles.
    pub fn is_mesh(self) -> bool {
        matches!(self, Self::Ply | Self::Obj | Self::Stl | Self::Glb)
    }
}

fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"))
}

/// The name of a file without its extension, also without `.gz`.
fn plain_name(path: &Path) -> String {
    let stem = Path::new(path.file_stem().unwrap_or_default());
    let stem = if is_packed(path) { stem.file_stem() } else { Some(stem.as_os_str()) };
    stem.unwrap_or_default().to_string_lossy().into_owned()
}

/// A file to be written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedOutput {
    /// Its path.
    pub path: PathBuf,
    /// Its format.
    pub format: OutputFormat,
}

/// A file that was written, and its contents.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WrittenFile {
    /// Path as the user gave it.
    #[serde(serialize_with = "as_text")]
    pub file: PathBuf,
    /// Its format.
    pub format: OutputFormat,
    /// Faces of a STEP file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub faces: Option<usize>,
    /// Vertices of a mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertices: Option<usize>,
    /// Triangles of a mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triangles: Option<usize>,
    /// Maximum chord error of a mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Columns, rows and cells with a height of a raster.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cells: Option<[usize; 3]>,
    /// Side of the cells of a raster.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cell_size: Option<f64>,
}

/// Options for writing outputs.
#[derive(Debug, Clone, Default)]
pub struct OutputOptions {
    /// Chord error of meshes, in the model's unit; half the median σ if none is given.
    pub mesh_tolerance: Option<f64>,
    /// Side of the cells of rasters, in the model's unit; about the spacing of the readings if none is
    /// given.
    pub cell_size: Option<f64>,
    /// Which parts that were neither measured nor inferred meshes and STEP files have.
    pub closing: Closing,
    /// The map that rasters belong to.
    pub georeference: Option<GeoReference>,
}

/// Serialises a path. Bytes that are not valid text are replaced, as in messages.
pub(crate) fn as_text<S: Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// The formats of outputs, by their extensions.
///
/// # Errors
/// `Unsupported` for extensions that cannot be written.
pub fn plan_outputs(paths: &[PathBuf]) -> Result<Vec<PlannedOutput>> {
    paths
        .iter()
        .map(|path| Ok(PlannedOutput { path: path.clone(), format: OutputFormat::from_path(path)? }))
        .collect()
}

/// Checks all outputs before the work begins.
///
/// # Errors
/// `Input` for an output that is given twice or is one of the `inputs`; `Io` if its folder does not exist, if
/// the path is a folder, or if writing is not permitted.
pub fn check_outputs(paths: &[PathBuf], inputs: &[PathBuf]) -> Result<()> {
    for (k, path) in paths.iter().enumerate() {
        refuse_same_output(path, &paths[..k])?;
        // Inputs are kept even if the run fails: a scan may not be repeatable.
        refuse_input_as_output(path, inputs)?;
        check_writable(path)?;
    }
    Ok(())
}

/// The error for an output whose extension names no format of the job; `needed` lists those that do.
pub(crate) fn unsupported_extension(path: &Path, needed: &str) -> Error {
    Error::unsupported(format!("{}: cannot write this format: expected {needed}", path.display()))
}

/// Refuses to write two outputs to one file.
fn refuse_same_output(path: &Path, others: &[PathBuf]) -> Result<()> {
    // Real paths, so that links and `./` do not hide that two names are one file.
    if others.iter().any(|other| real_path(other) == real_path(path)) {
        return Err(Error::input(format!(
            "{}: expected a different name for each output, found this one twice",
            path.display()
        )));
    }
    Ok(())
}

/// Refuses an output that would overwrite an input.
///
/// # Errors
/// `Input` if the path is one of the inputs, also through a link or another spelling.
pub fn refuse_input_as_output(path: &Path, inputs: &[PathBuf]) -> Result<()> {
    match inputs.iter().find(|input| real_path(input) == real_path(path)) {
        Some(input) => Err(Error::input(format!(
            "{}: is also the input {}: expected another name for the output, so that the input is kept",
            path.display(),
            input.display()
        ))),
        None => Ok(()),
    }
}

/// Outputs made and checked, ready to be written.
pub struct Prepared<'a> {
    model: &'a SurfaceModel,
    outputs: &'a [PlannedOutput],
    mesh: Option<ModelMesh>,
    dem: Option<Dem>,
    brep: Option<Brep>,
    /// Warnings for the user.
    pub findings: Vec<Finding>,
}

/// Prepares the meshes and rasters that the outputs need.
///
/// # Errors
/// `Input` for a mesh tolerance that is not positive or needs too many triangles, and for a raster of a
/// surface that is not a height field over z; `Undetermined` if the model has no covariance.
pub fn prepare<'a>(
    model: &'a SurfaceModel,
    posterior: &Posterior<'_>,
    outputs: &'a [PlannedOutput],
    options: &OutputOptions,
) -> Result<Prepared<'a>> {
    // One mesh serves all mesh formats, so that they agree with each other.
    // An opened surface has the borders of its mesh.
    let is_opened = options.closing == Closing::Never;
    let mesh = match is_opened || outputs.iter().any(|output| output.format.is_mesh()) {
        true => Some(trimmed_mesh_from_model(model, posterior, options.closing, options.mesh_tolerance)?),
        false => None,
    };
    let dem = match outputs.iter().any(|output| output.format == OutputFormat::Tiff) {
        true => Some(dem_from_model(model, posterior, options.cell_size, options.georeference.clone())?),
        false => None,
    };
    let step = outputs.iter().any(|output| output.format == OutputFormat::Step);
    let brep = step.then(|| brep_from_model(model, options.closing, &BrepOptions::default()));
    if let Some(brep) = &brep {
        // Faces that do not meet are of no use for CAD, so this is an error before anything is written.
        brep.check(step_uncertainty(model.unit))?;
    }
    let mut findings: Vec<Finding> = (mesh.iter().flat_map(|mesh| &mesh.findings))
        .chain(dem.iter().flat_map(|dem| &dem.findings))
        .cloned()
        .collect();
    if let Some(mesh) = &mesh {
        findings.extend(stl_findings(mesh, outputs));
    }
    Ok(Prepared { model, outputs, findings, mesh, dem, brep })
}

/// STL files whose seven digits are too few for a mesh.
fn stl_findings(mesh: &ModelMesh, outputs: &[PlannedOutput]) -> Vec<Finding> {
    let rounding = stl::rounding(&mesh.mesh.positions);
    // Rounding below half the chord error is not visible in the mesh.
    if rounding <= 0.5 * mesh.tolerance {
        return Vec::new();
    }
    let files = outputs.iter().filter(|output| output.format == OutputFormat::Stl);
    files
        .map(|output| {
            let text = format!(
                "{}: STL has seven digits, which moves points so far from the origin by up to \
                 {rounding:.1e} {}; use .ply, .obj or .glb",
                output.path.display(),
                mesh.unit
            );
            Finding::new(FindingCode::StlPrecision, text)
        })
        .collect()
}

impl Prepared<'_> {
    /// Border loops of the mesh; none if no output needs one.
    pub fn borders(&self) -> Option<usize> {
        self.mesh.as_ref().map(|mesh| mesh.mesh.check().boundary_loops)
    }

    /// Writes all outputs. Saved models contain `provenance`.
    ///
    /// # Errors
    /// `Io` if a file cannot be written.
    pub fn write(&self, provenance: &[Session]) -> Result<Vec<WrittenFile>> {
        let mut written: Vec<WrittenFile> = Vec::with_capacity(self.outputs.len());
        for output in self.outputs {
            written.push(self.write_one(output, provenance)?);
        }
        Ok(written)
    }

    fn write_one(&self, output: &PlannedOutput, provenance: &[Session]) -> Result<WrittenFile> {
        let path = &output.path;
        let mut written = WrittenFile {
            file: path.clone(),
            format: output.format,
            // A format has only its own figures; the JSON object omits the others.
            faces: None,
            vertices: None,
            triangles: None,
            tolerance: None,
            cells: None,
            cell_size: None,
        };
        match (output.format, &self.brep, &self.mesh, &self.dem) {
            (OutputFormat::Step, Some(brep), ..) => {
                let options = StepOptions {
                    // CAD programs show this name in their tree.
                    name: plain_name(path),
                    unit: self.model.unit,
                    uncertainty: step_uncertainty(self.model.unit),
                    ..StepOptions::default()
                };
                write_step(path, brep, &options)?;
                written.faces = Some(brep.faces.len());
            }
            (OutputFormat::Tiff, .., Some(dem)) => {
                write_geotiff(path, &dem.grid)?;
                written.cells = Some([dem.grid.columns, dem.grid.rows, dem.known]);
                written.cell_size = Some(dem.grid.cell);
            }
            (format, _, Some(mesh), _) if format.is_mesh() => {
                write_model_mesh(mesh, path)?;
                written.vertices = Some(mesh.mesh.positions.len());
                written.triangles = Some(mesh.mesh.triangles.len());
                written.tolerance = Some(mesh.tolerance);
            }
            // `prepare` has made what all other formats need, so only saved models arrive here.
            _ => save(self.model, provenance, path)?,
        }
        Ok(written)
    }
}

fn step_uncertainty(unit: Unit) -> f64 {
    // The tolerance is a real length, whatever unit the file has.
    STEP_UNCERTAINTY_MM / unit.millimetres()
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;
    use planish_mesh::TriangleMesh;

    #[test]
    fn the_extension_selects_the_format() {
        for (name, format) in [
            ("a.step", OutputFormat::Step),
            ("a.STP.gz", OutputFormat::Step),
            ("a.ply.gz", OutputFormat::Ply),
            ("a.obj", OutputFormat::Obj),
            ("a.STL", OutputFormat::Stl),
            ("a.glb", OutputFormat::Glb),
            ("a.planish", OutputFormat::Planish),
        ] {
            assert_eq!(OutputFormat::from_path(Path::new(name)).unwrap(), format, "{name}");
        }
        for name in ["a", "a.gz", "a.3mf", "a.planish.gz"] {
            assert!(OutputFormat::from_path(Path::new(name)).is_err(), "{name}");
        }
        assert_eq!(
            (plain_name(Path::new("d/a.step")), plain_name(Path::new("a.b.step.gz"))),
            ("a".to_owned(), "a.b".to_owned())
        );
    }

    #[test]
    fn an_stl_file_too_coarse_for_its_mesh_is_reported() {
        let mesh = |offset: f64| ModelMesh {
            mesh: TriangleMesh {
                positions: vec![
                    DVec3::new(offset, 0.0, 0.0),
                    DVec3::new(offset + 1.0, 0.0, 0.0),
                    DVec3::new(offset, 1.0, 0.0),
                ],
                triangles: vec![[0, 1, 2]],
            },
            normals: vec![DVec3::Z; 3],
            sigma: vec![0.02; 3],
            observed: vec![1; 3],
            tolerance: 0.01,
            unit: Unit::Metre,
            findings: Vec::new(),
        };
        let outputs = ["a.ply", "a.stl"].map(|name| PlannedOutput {
            path: name.into(),
            format: OutputFormat::from_path(Path::new(name)).unwrap(),
        });
        assert!(stl_findings(&mesh(100.0), &outputs).is_empty());
        let [warning] = &stl_findings(&mesh(4e6), &outputs)[..] else { panic!("expected one warning") };
        assert!(
            warning.text.starts_with("a.stl: ") && warning.text.contains("m; use .ply, .obj or .glb"),
            "{warning}"
        );
    }
}
