//! Reads landmarks and finds their places on the mesh.

use planish_core::{Finding, FindingCode, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use planish_exchange::landmarks::{Landmark, LandmarkPlace, read_landmarks};
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_report::numbers::significant;
use planish_shell::LandmarkReading;
use std::path::Path;

/// σ of a landmark without a stated one, relative to the mesh's size: places are picked by hand.
const ASSUMED_SIGMA: f64 = 5e-3;
/// Maximum distance of a place from the mesh, relative to its size. Farther ones have another frame or unit.
const MAX_DISTANCE: f64 = 0.02;

/// The landmarks of a file on a mesh of a size, and their names.
///
/// # Errors
/// `Input` for a vertex that the mesh does not have, and for a place far from it.
pub(super) fn read(
    path: &Path,
    mesh: &TriangleMesh,
    size: f64,
    findings: &mut Vec<Finding>,
) -> Result<(Vec<LandmarkReading>, Vec<String>)> {
    let landmarks = read_landmarks(path)?;
    let search = MeshSearch::try_new(mesh)?;
    let assumed = ASSUMED_SIGMA * size;
    let reading = |landmark: &Landmark| {
        let (vertices, weights) = match landmark.place {
            LandmarkPlace::Vertex(v) if (v as usize) < mesh.positions.len() => ([v; 3], [1.0, 0.0, 0.0]),
            LandmarkPlace::Vertex(v) => {
                let last = mesh.positions.len() - 1;
                return Err(Error::input(format!("expected a vertex from 0 to {last}, found {v}")));
            }
            LandmarkPlace::Near(at) => match search.closest(at).filter(|f| f.distance <= MAX_DISTANCE * size)
            {
                Some(foot) => (mesh.triangles[foot.triangle as usize], foot.barycentric),
                None => {
                    let distance = search.closest(at).map_or(f64::INFINITY, |foot| foot.distance);
                    return Err(Error::input(format!(
                        "expected a place on the mesh, found one at a distance of {}: check frame and unit",
                        significant(distance, 3)
                    )));
                }
            },
        };
        let sigma = landmark.sigma.unwrap_or(assumed);
        Ok(LandmarkReading {
            vertices,
            weights,
            at: landmark.at,
            covariance: SymmetricMatrix3::isotropic(sigma * sigma),
        })
    };
    let mut readings = Vec::with_capacity(landmarks.len());
    for landmark in &landmarks {
        let found = reading(landmark).map_err(|e| e.in_context(format!("landmark {}", landmark.name)));
        readings.push(found.map_err(|e| e.in_context(path.display()))?);
    }
    let unknown = landmarks.iter().filter(|landmark| landmark.sigma.is_none()).count();
    if unknown > 0 {
        let text = format!(
            "{unknown} of {} landmarks state no σ: {} was assumed",
            landmarks.len(),
            significant(assumed, 3)
        );
        findings.push(Finding::new(FindingCode::SigmaAssumed, text));
    }
    Ok((readings, landmarks.into_iter().map(|landmark| landmark.name).collect()))
}
