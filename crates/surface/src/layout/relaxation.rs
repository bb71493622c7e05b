//! Even quads: vertices move towards the means of their neighbours, along the mesh.
//!
//! Away from extraordinary vertices only a few times: on a bent tube, all would slide to its inner side.

use planish_core::DVec3;
use planish_mesh::MeshSearch;
use planish_spline::QuadDomain;
use rayon::prelude::*;

/// Steps of all vertices, and of those near extraordinary ones.
const ROUNDS_OF_ALL: usize = 6;
const ROUNDS: usize = 40;
/// Edges from an extraordinary vertex within which vertices move.
const REACH: usize = 3;
/// Share of the way to the mean of the neighbours.
const STEP: f64 = 0.5;

/// Moves vertices of a closed domain along a mesh.
pub(super) fn relax(domain: &QuadDomain, positions: &mut Vec<DVec3>, mesh: &MeshSearch) {
    let mut neighbours = vec![Vec::new(); positions.len()];
    for quad in domain.cells() {
        for k in 0..4 {
            // Each edge has two quads, which pass it in opposite directions.
            neighbours[quad[k] as usize].push(quad[(k + 1) % 4]);
        }
    }
    let mut moves = vec![false; positions.len()];
    domain.extraordinary_vertices().into_iter().for_each(|v| moves[v as usize] = true);
    for _ in 0..REACH {
        let near = |v: usize| moves[v] || neighbours[v].iter().any(|&n| moves[n as usize]);
        moves = (0..moves.len()).map(near).collect();
    }
    *positions = positions.par_iter().map(|p| mesh.closest(*p).map_or(*p, |on| on.point)).collect();
    for round in 0..ROUNDS {
        *positions = (0..positions.len())
            .into_par_iter()
            .map(|v| {
                if round >= ROUNDS_OF_ALL && !moves[v] {
                    return positions[v];
                }
                let Some(on) = mesh.closest(positions[v]) else { return positions[v] };
                let mean: DVec3 = neighbours[v].iter().map(|&n| positions[n as usize]).sum::<DVec3>()
                    / neighbours[v].len() as f64;
                // Without its part along the normal, the step stays near this side of a thin part.
                let step = STEP * (mean - on.point);
                let along = step - step.dot(on.normal) * on.normal;
                mesh.closest(on.point + along).map_or(on.point, |moved| moved.point)
            })
            .collect();
    }
}
