//! Fairing: moves the vertices of a cover so that it continues the surrounding surface.
//!
//! In: triangles of a cover and those around its border. Out: positions of its inner vertices that minimise
//! `E = Σ_v |Σ_j w_vj (x_j − x_v) − 2 H A_v n_v|² / A_v` over the inner vertices and those of the border.
//! With `H = 0` it is the bending of a thin plate (M. Botsch, L. Kobbelt, *An intuitive framework for
//! real-time freeform modeling*, 2004, equation 3 with k = 2), which keeps the tangent planes of the loop but
//! does not leave a ball a ball; with the mean curvature of what lies around, it does (R. Schneider, L.
//! Kobbelt, *Geometric fairing of irregular meshes for free-form surface design*, 2001, where `H` is
//! interpolated). `w_vj` are half the sums of the cotangents across an edge and `A_v` the area nearest to a
//! vertex (M. Meyer, M. Desbrun, P. Schröder, A. Barr, *Discrete differential-geometry operators for
//! triangulated 2-manifolds*, 2003, section 3.3); in the first step, all are one. Normals, weights and areas
//! are those of the previous step, so that the system is linear; it is solved repeatedly.
//!
//! Not guaranteed: that the cover does not intersect anything.

use planish_core::DVec3;
use planish_estimate::Result;
use planish_estimate::sparse::{
    BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SymbolicFactor,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Lower clamp of cotangents, so that every neighbour has an influence and the system stays definite.
const MIN_COTANGENT: f64 = 0.01;
/// Upper clamp of cotangents, so that sliver triangles do not dominate.
const MAX_COTANGENT: f64 = 20.0;

/// The target shape of a cover.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Goal {
    /// Even triangles and minimum bending: all neighbours have equal weights.
    Even,
    /// This mean curvature (negative for a ball), with cotangent weights.
    MeanCurvature(f64),
}

/// One row of the Laplacian: a vertex and its neighbours.
struct Row {
    vertex: u32,
    /// Weights of the neighbours.
    neighbours: BTreeMap<u32, f64>,
    area: f64,
    /// The sum of the area vectors of its triangles.
    up: DVec3,
}

/// Moves the vertices from `first` on; `triangles` are those of the cover and all that meet a vertex of its
/// loop, over `positions`, and `rim` the vertices of the loop.
pub(super) fn fair(
    positions: &mut [DVec3],
    triangles: &[[u32; 3]],
    rim: &[u32],
    first: usize,
    goal: Goal,
) -> Result<()> {
    let unknowns = positions.len() - first;
    if unknowns == 0 {
        return Ok(());
    }
    let rows = rows(positions, triangles, rim, first, goal);
    // Vertices of the border are constants. Their rows of the Laplacian still contain unknowns: this is what
    // continues the tangent planes.
    let inner = |v: u32| (v as usize >= first).then(|| (v as usize - first) as u32);
    let elements: Vec<Vec<(u32, f64)>> = rows
        .iter()
        .map(|row| {
            let sum: f64 = row.neighbours.values().sum();
            let own = (row.vertex, -sum);
            std::iter::once(own).chain(row.neighbours.iter().map(|(v, w)| (*v, *w))).collect()
        })
        .collect();
    let nodes =
        |element: &[(u32, f64)]| -> Vec<u32> { element.iter().filter_map(|(v, _)| inner(*v)).collect() };
    let pattern = Arc::new(BlockPattern::from_elements(unknowns, elements.iter().map(|e| nodes(e)))?);
    let mut information = BlockInformation::zeros(Arc::clone(&pattern), 1, 3)?;
    for (row, element) in rows.iter().zip(&elements) {
        let nodes = nodes(element);
        let coefficients: Vec<f64> =
            element.iter().filter(|(v, _)| inner(*v).is_some()).map(|e| e.1).collect();
        let (mut known, area) = match goal {
            Goal::Even => (DVec3::ZERO, 1.0),
            Goal::MeanCurvature(h) => {
                let normal = row.up.normalize_or_zero();
                (-2.0 * h * row.area * normal, row.area)
            }
        };
        for (v, w) in element.iter().filter(|(v, _)| inner(*v).is_none()) {
            known += *w * positions[*v as usize];
        }
        let matrix: Vec<f64> =
            coefficients.iter().flat_map(|a| coefficients.iter().map(move |b| a * b / area)).collect();
        let vector: Vec<f64> = coefficients.iter().flat_map(|a| (-a * known / area).to_array()).collect();
        information.add_element(&nodes, &matrix, &vector)?;
    }
    // One matrix for all three coordinates.
    let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::amd(&pattern)?, 1)?);
    let factor = CholeskyFactor::factorize(&symbolic, &information)?;
    let solved: Vec<Vec<f64>> = (0..3)
        .map(|k| {
            let mut x: Vec<f64> = information.vector().iter().skip(k).step_by(3).copied().collect();
            factor.solve_in_place(&mut x)?;
            Ok(x)
        })
        .collect::<Result<_>>()?;
    for (v, p) in positions[first..].iter_mut().enumerate() {
        *p = DVec3::from_array(std::array::from_fn(|k| solved[k][v]));
    }
    Ok(())
}

/// The rows of all vertices with a closed ring of triangles: the inner ones, and border vertices that touch
/// no other hole.
fn rows(positions: &[DVec3], triangles: &[[u32; 3]], rim: &[u32], first: usize, goal: Goal) -> Vec<Row> {
    let mut at = vec![usize::MAX; positions.len()];
    let mut rows: Vec<Row> = Vec::new();
    for v in rim.iter().copied().chain(first as u32..positions.len() as u32) {
        at[v as usize] = rows.len();
        rows.push(Row { vertex: v, neighbours: BTreeMap::new(), area: 0.0, up: DVec3::ZERO });
    }
    let mut around = vec![0; rows.len()];
    for t in triangles {
        let corner = t.map(|v| positions[v as usize]);
        let up = (corner[1] - corner[0]).cross(corner[2] - corner[0]);
        let doubled = up.length();
        for k in 0..3 {
            let (v, next, previous) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
            let Some(row) = rows.get_mut(at[v as usize]) else {
                continue;
            };
            around[at[v as usize]] += 1;
            row.area += crate::triangle::mixed_area(&corner, k);
            row.up += up;
            // The edge to one neighbour is opposite to the other neighbour.
            for (to, across) in [(next, (k + 2) % 3), (previous, (k + 1) % 3)] {
                let weight = match goal {
                    Goal::Even => 0.5,
                    Goal::MeanCurvature(_) => {
                        let sides = [(across + 1) % 3, (across + 2) % 3].map(|s| corner[s] - corner[across]);
                        let cotangent = sides[0].dot(sides[1]) / doubled.max(f64::MIN_POSITIVE);
                        0.5 * cotangent.clamp(MIN_COTANGENT, MAX_COTANGENT)
                    }
                };
                *row.neighbours.entry(to).or_default() += weight;
            }
        }
    }
    // A closed ring has as many triangles as neighbours, an open one has one triangle fewer.
    let mut around = around.iter();
    rows.retain(|row| around.next() == Some(&row.neighbours.len()));
    let mean = rows.iter().map(|row| row.area).sum::<f64>() / rows.len().max(1) as f64;
    for row in &mut rows {
        // Slivers without area must not get infinite weight.
        row.area = row.area.max(1e-3 * mean);
    }
    rows
}
