//! What is written of a model: the format follows the file's extension.
//!
//! Comes in: paths, before any work; then a model. Goes out: the files, each whole or not there. Everything that can go wrong
//! with a path is found by [`plan_outputs`], before the work; everything that can go wrong with the model by [`prepare`], before
//! the first file is written. What is left is a full disk.

use crate::brep::{BrepOptions, brep_from_surface};
use crate::mesh_output::{ModelMesh, mesh_from_model, write_model_mesh};
use crate::model::{Posterior, SurfaceModel};
use crate::saved::{Session, save};
use planish_estimate::{Error, Result};
use planish_exchange::step::{Brep, StepOptions, write_step};
use planish_exchange::{Unit, check_writable, real_path};
use serde::{Serialize, Serializer};
use std::path::{Path, PathBuf};

/// Vertices, edges and faces of a STEP file meet within this, in millimetres.
const STEP_UNCERTAINTY_MM: f64 = 1e-6;

/// A path's extension in lower case; empty where it has none.
fn extension(path: &Path) -> String {
    path.extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default()
}

/// What can be written of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputFormat {
    /// The exact surface for CAD programs: `.step`, `.stp`.
    Step,
    /// A mesh whose vertices carry σ and `observed`: `.ply`.
    Ply,
    /// The model itself, to be updated and compared: `.planish`.
    Planish,
}

impl OutputFormat {
    /// The format that a path's extension asks for.
    ///
    /// # Errors
    /// `Unsupported` for any other extension, or none.
    pub fn of(path: &Path) -> Result<Self> {
        match extension(path).as_str() {
            "step" | "stp" => Ok(Self::Step),
            "ply" => Ok(Self::Ply),
            "planish" => Ok(Self::Planish),
            other => {
                let found = match other {
                    "" => "none".to_owned(),
                    other => format!("`{other}`"),
                };
                Err(Error::unsupported(format!(
                    "{}: the extension says what to write: needed .step or .stp (exact surface), .ply (mesh with σ) or .planish \
                     (saved model), found {found}",
                    path.display()
                )))
            }
        }
    }
}

/// A file to be written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedOutput {
    /// Where.
    pub path: PathBuf,
    /// What.
    pub format: OutputFormat,
}

/// A file that was written, and what went into it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WrittenFile {
    /// Its path as the user gave it.
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
    /// How far the chords of a mesh leave the surface at most.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
}

/// A path for programs; what is no text in it is replaced, as in every message.
fn as_text<S: Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// Checks every output before the work begins.
///
/// # Errors
/// `Unsupported` for extensions that cannot be written; `Input` for an output that is named twice or is one of the `inputs`; `Io`
/// where the folder is missing, the path names a folder, or writing is not allowed.
pub fn plan_outputs(paths: &[PathBuf], inputs: &[PathBuf]) -> Result<Vec<PlannedOutput>> {
    let mut planned = Vec::with_capacity(paths.len());
    for (k, path) in paths.iter().enumerate() {
        let format = OutputFormat::of(path)?;
        if paths[..k].iter().any(|other| real_path(other) == real_path(path)) {
            return Err(Error::input(format!(
                "{}: named twice as an output: needed a name for each",
                path.display()
            )));
        }
        refuse_input_as_output(path, inputs)?;
        check_writable(path)?;
        planned.push(PlannedOutput {
            path: path.clone(),
            format,
        });
    }
    Ok(planned)
}

/// Refuses to write over a file that is read.
///
/// # Errors
/// `Input` where the path is one of the inputs, by whatever name.
pub fn refuse_input_as_output(path: &Path, inputs: &[PathBuf]) -> Result<()> {
    match inputs.iter().find(|input| real_path(input) == real_path(path)) {
        Some(input) => Err(Error::input(format!(
            "{}: is also the input {}: needed another name for the output, so that the input is kept",
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
    brep: Option<Brep>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// Makes what the outputs need of a model; a mesh within `mesh_tolerance` of the surface, or within half its median σ.
///
/// # Errors
/// `Input` for a mesh tolerance that is not positive or takes too many triangles; `Undetermined` where the model has no covariance.
pub fn prepare<'a>(
    model: &'a SurfaceModel,
    posterior: &Posterior<'_>,
    outputs: &'a [PlannedOutput],
    mesh_tolerance: Option<f64>,
) -> Result<Prepared<'a>> {
    let wanted = |format| outputs.iter().any(|output| output.format == format);
    let mesh = match wanted(OutputFormat::Ply) {
        true => Some(mesh_from_model(model, posterior, mesh_tolerance)?),
        false => None,
    };
    let brep = wanted(OutputFormat::Step).then(|| brep_from_surface(&model.surface, &BrepOptions::default()));
    if let Some(brep) = &brep {
        brep.check(step_uncertainty(model.unit))?;
    }
    Ok(Prepared {
        model,
        outputs,
        warnings: mesh.iter().flat_map(|mesh| mesh.warnings.clone()).collect(),
        mesh,
        brep,
    })
}

impl Prepared<'_> {
    /// Writes every output; `provenance` goes into saved models.
    ///
    /// # Errors
    /// `Io` when a file cannot be written; the ones before it are whole, and the message names them.
    pub fn write(&self, provenance: &[Session]) -> Result<Vec<WrittenFile>> {
        let mut written: Vec<WrittenFile> = Vec::with_capacity(self.outputs.len());
        for output in self.outputs {
            match self.write_one(output, provenance) {
                Ok(file) => written.push(file),
                Err(e) if written.is_empty() => return Err(e),
                Err(e) => {
                    let names: Vec<String> = written.iter().map(|w| w.file.display().to_string()).collect();
                    return Err(e.in_context(format_args!("after {} was written", names.join(", "))));
                }
            }
        }
        Ok(written)
    }

    fn write_one(&self, output: &PlannedOutput, provenance: &[Session]) -> Result<WrittenFile> {
        let path = &output.path;
        let mut written = WrittenFile {
            file: path.clone(),
            format: output.format,
            faces: None,
            vertices: None,
            triangles: None,
            tolerance: None,
        };
        match (output.format, &self.brep, &self.mesh) {
            (OutputFormat::Step, Some(brep), _) => {
                let options = StepOptions {
                    name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
                    unit: self.model.unit,
                    uncertainty: step_uncertainty(self.model.unit),
                    ..StepOptions::default()
                };
                write_step(path, brep, &options)?;
                written.faces = Some(brep.faces.len());
            }
            (OutputFormat::Ply, _, Some(mesh)) => {
                write_model_mesh(mesh, path)?;
                written.vertices = Some(mesh.mesh.positions.len());
                written.triangles = Some(mesh.mesh.triangles.len());
                written.tolerance = Some(mesh.tolerance);
            }
            _ => save(self.model, provenance, path)?,
        }
        Ok(written)
    }
}

fn step_uncertainty(unit: Unit) -> f64 {
    STEP_UNCERTAINTY_MM / unit.millimetres()
}
