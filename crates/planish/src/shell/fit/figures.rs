//! The figures of a shell fit.

use planish_core::Finding;
use planish_core::finding::with_warnings;
use planish_exchange::Unit;
use planish_shell::SourceFit;
use planish_surface::model::SigmaSummary;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Figures of the readings of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReadingsReport {
    /// Number of readings.
    pub count: usize,
    /// Number of gross errors among them.
    pub outliers: usize,
    /// Root mean square of the other residuals: distances of points, pixels of outlines, σ of tracks,
    /// distances of landmarks along each axis.
    pub rms: f64,
    /// Ratio of their estimated to their stated σ.
    pub sigma_factor: f64,
}

impl ReadingsReport {
    pub(super) fn from_source(source: &SourceFit) -> Option<Self> {
        // `outliers` has one entry for each reading. Without readings, an rms of 0 would look like a perfect
        // fit.
        (!source.outliers.is_empty()).then(|| Self {
            count: source.outliers.len(),
            outliers: source.outliers.iter().filter(|outlier| **outlier).count(),
            rms: source.rms,
            sigma_factor: source.sigma_factor,
        })
    }
}

/// A camera pose that the fit estimated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraPoseReport {
    /// Its view.
    pub view: String,
    /// Angle of its estimated rotation, in degrees.
    pub turned_deg: f64,
    /// Length of its estimated translation.
    pub moved: f64,
    /// `R`, row by row.
    pub r: [[f64; 3]; 3],
    /// `t`.
    pub t: [f64; 3],
    /// σ about each axis of the camera, in degrees.
    pub sigma_rotation_deg: [f64; 3],
    /// σ along each axis of the camera.
    pub sigma_translation: [f64; 3],
}

/// A frame of a sequence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameReport {
    /// Its folder's name.
    pub frame: String,
    /// Root mean square of the distances of points that are no gross errors.
    pub rms_points: Option<f64>,
    /// The same for points on outlines, in pixels.
    pub rms_silhouettes_px: Option<f64>,
    /// Mean overlap (IoU) of the mesh with the masks of its views.
    pub iou: Option<f64>,
    /// Root mean square difference of the parameters from their prediction, relative to that of their σ.
    /// Absent for the first frame.
    #[serde(rename = "surprise")]
    pub prediction_error: Option<f64>,
    /// The median σ of vertices along normals.
    pub sigma: f64,
}

/// The flow of a rough start before the fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowReport {
    /// Number of times that the mesh was rebuilt.
    pub rounds: usize,
    /// Facets of the mesh that was fitted.
    pub facets: usize,
    /// Number of its parts.
    pub parts: usize,
    /// Overlap (IoU) with each mask.
    // Maps of views are sorted by name, so that reports of equal runs are equal.
    pub iou: BTreeMap<String, f64>,
}

/// The result of a shell fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShellFitReport {
    /// Root mean square of the distances of points that are no gross errors.
    pub rms_points: Option<f64>,
    /// The same for points on outlines, in pixels.
    pub rms_silhouettes_px: Option<f64>,
    /// Overlap (IoU) of the mesh with the mask of each view.
    pub iou: BTreeMap<String, f64>,
    /// The same before the fit.
    pub iou_before: BTreeMap<String, f64>,
    /// Held-out views.
    pub held_out: Vec<String>,
    /// Number of controls; for modes, the number of parameters.
    pub controls: usize,
    /// Gross errors of all kinds.
    pub outliers: usize,
    /// Points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<ReadingsReport>,
    /// Places on outlines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outlines: Option<ReadingsReport>,
    /// Tracked features.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracks: Option<ReadingsReport>,
    /// Landmarks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub landmarks: Option<ReadingsReport>,
    /// Poses of cameras that were estimated.
    pub poses: Vec<CameraPoseReport>,
    /// σ of the vertices that were measured, along normals.
    pub sigma: SigmaSummary,
    /// Fraction of vertices that are near points, or of which outlines give most of the information.
    pub observed_fraction: f64,
    /// The weight of smoothness, by marginal likelihood.
    pub smoothness_weight: f64,
    /// σ of the model error along normals: shape that the controls cannot represent. σ of vertices includes
    /// it.
    #[serde(rename = "lack_of_fit")]
    pub unresolved_shape: f64,
    /// Number of iterations.
    pub iterations: usize,
    /// The flow of a rough start before the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow: Option<FlowReport>,
    /// Frames of a sequence; the other fields describe the last frame.
    // A single fit has no key `frames`: an empty list would look like a sequence without frames.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<FrameReport>,
    /// Why the iteration ended.
    pub termination: &'static str,
    /// The unit of lengths.
    #[serde(skip)]
    pub unit: Unit,
    /// Every file that was read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Every file that was written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}
