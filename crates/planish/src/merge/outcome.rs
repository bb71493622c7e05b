//! Results of a merge: [`Merged`] and its [`MergeReport`].
//!
//! These are plain records. The fields of the report are the keys of the JSON output.

use super::MergeMethod;
use planish_core::finding::with_warnings;
use planish_core::{DVec3, Finding};
use planish_exchange::Unit;
use planish_mesh::{TriangleMesh, VertexCurvature};
use planish_surface::model::{ScanPoseReport, SigmaSummary};
use serde::Serialize;
use std::path::PathBuf;

/// A region in which two patches overlap.
#[derive(Debug, Clone, Serialize, PartialEq)]
pub struct RegionReport {
    /// Both patches, counted from 0 in the order of [`MergeReport::patches`].
    pub patches: [usize; 2],
    /// Vertices of either patch that overlap the other.
    pub points: usize,
    /// Root mean square of the heights between both, before they were merged. Heights above ε do not count.
    pub rms: f64,
    /// ε: the maximum distance of corresponding points, on average over the region.
    pub epsilon: f64,
    /// θ: the maximum angle between their normals, in degrees.
    pub theta_deg: f64,
}

/// A merged patch.
#[derive(Debug, Clone, Serialize)]
pub struct PatchReport {
    /// Its file or scan.
    pub name: String,
    /// Its triangles.
    pub triangles: usize,
    /// Number of its vertices in the merged mesh.
    pub vertices_kept: usize,
    /// Whether the patch was flipped because it faced against the patches that it overlaps.
    #[serde(rename = "turned_over")]
    pub reversed: bool,
    /// Median of its σ, as used: estimated if none was stated, and enlarged if it was too small.
    pub sigma: f64,
    /// σ by the differences from other patches, divided by the stated σ. None without a stated σ or an
    /// overlap of at least 50 points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_factor: Option<f64>,
    /// Root mean square of the part of these differences that a rigid motion or an offset explains.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub displacement: Option<f64>,
}

/// The shapes of triangles.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct TriangleQuality {
    /// Median of their smallest angles, in degrees.
    pub smallest_angle_median_deg: f64,
    /// The smallest angle that 99 of 100 exceed, in degrees.
    pub smallest_angle_p1_deg: f64,
    /// Longest edge over height on it: the median, and what 99 of 100 stay below. 1.15 is best.
    pub aspect_median: f64,
    /// As above.
    pub aspect_p99: f64,
}

/// The part of a completed mesh that comes from the bound.
#[derive(Debug, Clone, Serialize)]
pub struct CompletionReport {
    /// Its file.
    pub name: String,
    /// Number of its vertices in the merged mesh. Their `observed` is 2 (completed).
    pub vertices: usize,
    /// Triangles of the patches and of closed holes that were removed because they lie outside it.
    pub carved: usize,
}

/// The filled holes.
#[derive(Debug, Clone, Serialize)]
pub struct FillReport {
    /// Holes that were filled.
    pub holes: usize,
    /// Number of vertices in them. Their `observed` is 2 (completed).
    pub vertices: usize,
    /// Triangles in them.
    pub triangles: usize,
    /// Outer boundaries, such as that of a sheet; they were left open.
    pub outer_rims: usize,
    /// Holes that are larger than was allowed, and those that could not be covered: they were left open.
    #[serde(rename = "left_open")]
    pub unfilled: usize,
}

/// The figures of a merge.
#[derive(Debug, Clone, Serialize)]
pub struct MergeReport {
    /// How corresponding points were fused.
    pub method: MergeMethod,
    /// Vertices of the merged mesh.
    pub vertices: usize,
    /// Its triangles.
    pub triangles: usize,
    /// Edges of one triangle.
    pub boundary_edges: usize,
    /// Edges of three and more: none, by construction.
    // Counted and not assumed, so that an error of the stitching would be reported.
    pub nonmanifold_edges: usize,
    /// Whether the mesh has no boundary.
    pub watertight: bool,
    /// Connected parts.
    pub parts: usize,
    /// Common regions, largest first.
    // The command lists only the first of them.
    pub regions: Vec<RegionReport>,
    /// The patches, in the order of the files.
    pub patches: Vec<PatchReport>,
    /// Motions of the patches onto the first one, if they were aligned.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub poses: Vec<ScanPoseReport>,
    /// The completion by a bound, if one was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub completed: Option<CompletionReport>,
    /// The filled holes, unless none were to be filled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filled: Option<FillReport>,
    /// Whether σ was estimated from the differences between patches.
    pub sigma_estimated: bool,
    /// Quantiles of σ over the vertices of the merged mesh.
    pub sigma: SigmaSummary,
    /// Triangles that stitch patches together.
    pub stitched_triangles: usize,
    /// Holes of the seams that were closed.
    pub holes_closed: usize,
    /// Number of removed fragments of a few triangles.
    #[serde(rename = "fragments_left_out")]
    pub removed_fragments: usize,
    /// `valence[n]`: vertices of seams where n edges meet.
    pub valence: Vec<usize>,
    /// `valence_mesh[n]`: vertices of the whole mesh where n edges meet.
    pub valence_mesh: Vec<usize>,
    /// The shapes of all triangles.
    pub quality: Option<TriangleQuality>,
    /// Files read.
    #[serde(skip)]
    // The command has keys for inputs and unit in the JSON object of every job.
    pub inputs: Vec<PathBuf>,
    /// Unit of every length.
    #[serde(skip)]
    pub unit: Unit,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

/// A merged mesh.
#[derive(Debug, Clone)]
pub struct Merged {
    /// Positions and triangles.
    pub mesh: TriangleMesh,
    /// Unit normals of the vertices.
    pub normals: Vec<DVec3>,
    /// σ along them.
    pub sigma: Vec<f64>,
    /// 1 where it was measured, 2 where it was completed.
    // Bytes as in the columns of files.
    pub observed: Vec<u8>,
    /// Curvature at the vertices, if requested.
    pub curvature: Option<VertexCurvature>,
    /// Result of the job.
    pub report: MergeReport,
}
