//! Compares the outlines of meshes with masks.
//!
//! Input: views with masks, and meshes. Output: the intersection over union of each view, and findings if the
//! visual hull agrees better with held-out views than a surface does.

use super::mask_options;
use planish_core::{Finding, FindingCode};
use planish_estimate::Result;
use planish_exchange::views::ViewFile;
use planish_mesh::TriangleMesh;
use planish_sense::silhouette;
use planish_shell::intersection_over_union;
use rayon::prelude::*;
use serde::Serialize;

/// Minimum difference of the mean overlap with held-out views that is reported. It is below the effect of a
/// pixel along the whole outline of an object of 1000 pixels.
const MIN_DIFFERENCE: f64 = 0.001;

/// Overlap of surfaces with a mask: intersection over union of their pixels.
#[derive(Debug, Clone, Serialize)]
pub struct OutlineAgreement {
    /// The view.
    pub view: String,
    /// Whether it was held out.
    pub held_out: bool,
    /// Of the visual hull.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hull: Option<f64>,
    /// Of the surface that agrees best with all masks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<f64>,
    /// Of the judged mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub judged: Option<f64>,
}

/// The meshes that are compared with masks.
pub(super) struct Compared<'a> {
    pub hull: Option<&'a TriangleMesh>,
    pub surface: Option<&'a TriangleMesh>,
    pub judged: Option<&'a TriangleMesh>,
}

/// The overlap of the meshes with the mask of each view.
pub(super) fn agreements(views: &[ViewFile], meshes: &Compared<'_>) -> Result<Vec<OutlineAgreement>> {
    // A hull agrees with the masks that it was made from. Without a held-out view, the figure shows nothing.
    if !views.iter().any(|v| v.held_out) && meshes.judged.is_none() {
        return Ok(Vec::new());
    }
    let rows: Vec<Option<OutlineAgreement>> = (views.par_iter())
        .map(|view| {
            let (Some(path), Some(picture)) = (&view.mask, view.read_mask()?) else { return Ok(None) };
            let read = silhouette(&picture, &mask_options(view)).map_err(|e| e.in_context(path.display()))?;
            let agreement = |mesh: &TriangleMesh| {
                intersection_over_union(mesh, &view.camera, &read.mask, read.columns, read.rows)
            };
            Ok(Some(OutlineAgreement {
                view: view.name.clone(),
                held_out: view.held_out,
                hull: meshes.hull.map(agreement),
                surface: meshes.surface.map(agreement),
                judged: meshes.judged.map(agreement),
            }))
        })
        .collect::<Result<_>>()?;
    Ok(rows.into_iter().flatten().collect())
}

/// A finding for each mesh with which held-out views agree less than with the visual hull.
pub(super) fn hull_findings(rows: &[OutlineAgreement]) -> Vec<Finding> {
    let held: Vec<&OutlineAgreement> = rows.iter().filter(|row| row.held_out).collect();
    let mean = |value: &dyn Fn(&OutlineAgreement) -> Option<f64>| -> Option<f64> {
        let values: Vec<f64> = held.iter().map(|row| value(row)).collect::<Option<_>>()?;
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let Some(hull) = mean(&|row| row.hull) else { return Vec::new() };
    let meshes = [
        ("the mesh", mean(&|row| row.judged)),
        ("the surface that agrees best with all masks", mean(&|row| row.surface)),
    ];
    (meshes.into_iter())
        .filter_map(|(name, own)| Some((name, own?)))
        .filter(|(_, own)| *own < hull - MIN_DIFFERENCE)
        .map(|(name, own)| {
            Finding::new(
                FindingCode::HullBetter,
                format!(
                    "the visual hull alone agrees better with the {} held-out views than {name}: mean \
                     intersection over union {hull:.4} instead of {own:.4}",
                    held.len()
                ),
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only held-out views count, and only a mesh that is worse than the hull is reported.
    #[test]
    fn a_mesh_worse_than_the_hull_is_reported() {
        let row = |held_out, hull, judged| OutlineAgreement {
            view: String::new(),
            held_out,
            hull: Some(hull),
            surface: None,
            judged: Some(judged),
        };
        let worse = hull_findings(&[row(true, 0.97, 0.95), row(true, 0.98, 0.97), row(false, 0.5, 0.99)]);
        assert!(worse.len() == 1 && worse[0].text.contains("0.9750 instead of 0.9600"), "{worse:?}");
        assert!(hull_findings(&[row(true, 0.97, 0.9695), row(false, 0.99, 0.5)]).is_empty());
        assert!(hull_findings(&[row(false, 0.99, 0.5)]).is_empty());
    }
}
