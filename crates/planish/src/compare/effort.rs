//! Closest points on meshes whose triangles overlap each other.
//!
//! A search visits few triangles if they form a surface. If they are random or long spikes, each search
//! visits nearly all of them. Then only every nth point is compared, with a finding.

use planish_core::{DVec3, Finding, FindingCode};
use planish_mesh::{ClosestPoint, MeshSearch};
use planish_report::numbers::count;

/// Maximum number of triangles that all searches of one direction visit. It bounds the time to a few seconds;
/// a million points on a surface need a tenth of it.
const MAX_VISITS: usize = 400_000_000;
/// Number of points from which the cost of all is estimated.
const SAMPLES: usize = 64;

/// The closest point of as many of the points as the effort allows, evenly sampled; `None` for the others.
/// `name` names the points in the finding.
pub(super) fn closest_of_affordable(
    search: &MeshSearch,
    points: &[DVec3],
    name: &str,
    findings: &mut Vec<Finding>,
) -> Vec<Option<ClosestPoint>> {
    let sample = || points.iter().step_by(points.len().div_ceil(SAMPLES).max(1));
    let visits: usize = sample().map(|p| search.visits(*p)).sum();
    let all = visits as f64 / sample().count().max(1) as f64 * points.len() as f64;
    let step = (all / MAX_VISITS as f64).ceil().max(1.0) as usize;
    if step == 1 {
        return search.closest_all(points);
    }
    let kept: Vec<DVec3> = points.iter().copied().step_by(step).collect();
    findings.push(Finding::new(
        FindingCode::PointsThinned,
        format!(
            "of {} {name} {} were compared, evenly sampled: the triangles of the mesh overlap, and a search \
             visits {} of them",
            count(points.len()),
            count(kept.len()),
            count(visits / sample().count().max(1))
        ),
    ));
    let mut feet = vec![None; points.len()];
    for (k, foot) in search.closest_all(&kept).into_iter().enumerate() {
        feet[k * step] = foot;
    }
    feet
}
