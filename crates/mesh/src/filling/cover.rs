//! Covers a loop with triangles between its vertices.
//!
//! In: a border loop, the normals along it, and the existing edges. Out: triangles of minimum area (G.
//! Barequet, M. Sharir, *Filling gaps in the boundary of a polyhedron*, 1995), oriented against the loop.
//! Cost O(n³) for up to [`MAX_LOOP_EDGES`] edges; longer loops are first split by short chords. Not
//! guaranteed: that the triangles do not intersect anything; minimum area for long loops.

use crate::edges::edge;
use planish_core::DVec3;
use std::collections::HashSet;

/// Factor on the area of triangles that face against the normals of their corners, so that folds are avoided.
///
/// A larger factor would accept much larger covers to avoid a slightly tilted triangle.
const FOLD_PENALTY: f64 = 4.0;
/// Maximum number of edges of a loop that is covered at once; longer ones are split, as the cost is cubic.
const MAX_LOOP_EDGES: usize = 300;
/// Maximum number of vertices of a loop between which chords are searched; the cost is quadratic.
const MAX_CHORD_ENDS: usize = 2000;

/// The mesh around a loop.
pub(super) struct Surroundings<'a> {
    pub positions: &'a [DVec3],
    pub normals: &'a [DVec3],
    /// Existing edges between vertices of loops.
    pub edges: &'a HashSet<[u32; 2]>,
}

/// The triangulation of minimum area without existing inner edges, oriented against the loop; `None` if there
/// is none.
pub(super) fn minimal_cover(around: &Surroundings<'_>, vertices: &[u32]) -> Option<Vec<[u32; 3]>> {
    let mut cover = Vec::with_capacity(vertices.len());
    let mut parts = vec![vertices.to_vec()];
    // Chords go into the cover as ordinary edges. Each part is a loop of its own, closed by the chord.
    while let Some(part) = parts.pop() {
        if part.len() <= MAX_LOOP_EDGES {
            cover.extend(minimal_cover_of_short(around, &part)?);
        } else {
            let [from, to] = best_chord(around, &part)?;
            let rest = part[to..].iter().chain(&part[..=from]).copied().collect();
            parts.extend([part[from..=to].to_vec(), rest]);
        }
    }
    Some(cover)
}

/// The shortest chord with at least a quarter of the loop on each side, among a sample of chords.
fn best_chord(around: &Surroundings<'_>, vertices: &[u32]) -> Option<[usize; 2]> {
    let n = vertices.len();
    let step = n.div_ceil(MAX_CHORD_ENDS);
    let at = |k: usize| around.positions[vertices[k] as usize];
    let chords = (0..n).step_by(step).flat_map(|from| {
        let last = (from + 3 * n / 4).min(n - 1);
        (from + n / 4..=last).step_by(step).map(move |to| [from, to])
    });
    chords
        .filter(|[from, to]| !around.edges.contains(&edge(vertices[*from], vertices[*to])))
        .map(|[from, to]| (at(from).distance(at(to)), [from, to]))
        .filter(|(length, _)| *length > 0.0)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, chord)| chord)
}

/// [`minimal_cover`] of a short loop, by dynamic programming over spans of the loop.
fn minimal_cover_of_short(around: &Surroundings<'_>, vertices: &[u32]) -> Option<Vec<[u32; 3]>> {
    let n = vertices.len();
    if n < 3 {
        return None;
    }
    let at = |k: usize| around.positions[vertices[k] as usize];
    let cost = |i: usize, j: usize, k: usize| {
        // The triangle is k, j, i: against the loop.
        let up = (at(j) - at(k)).cross(at(i) - at(k));
        let facing: f64 = [i, j, k].iter().map(|v| around.normals[vertices[*v] as usize].dot(up)).sum();
        up.length() * if facing > 0.0 { 1.0 } else { FOLD_PENALTY }
    };
    // Split fans have vertices at equal positions: an edge between them would have no length.
    let free = |i: usize, j: usize| at(i) != at(j) && !around.edges.contains(&edge(vertices[i], vertices[j]));
    let mut best = vec![0.0; n * n];
    let mut split = vec![usize::MAX; n * n];
    for gap in 2..n {
        for i in 0..n - gap {
            let k = i + gap;
            best[i * n + k] = f64::INFINITY;
            // The chord from i to k must not exist already; the last one is the closing edge of the loop
            // itself.
            if gap + 1 < n && !free(i, k) {
                continue;
            }
            for j in i + 1..k {
                let sum = best[i * n + j] + best[j * n + k] + cost(i, j, k);
                if sum < best[i * n + k] {
                    best[i * n + k] = sum;
                    split[i * n + k] = j;
                }
            }
        }
    }
    if !best[n - 1].is_finite() {
        return None;
    }
    let mut cover = Vec::with_capacity(n - 2);
    let mut spans = vec![(0, n - 1)];
    while let Some((i, k)) = spans.pop() {
        if k < i + 2 {
            continue;
        }
        let j = split[i * n + k];
        cover.push([vertices[k], vertices[j], vertices[i]]);
        spans.push((i, j));
        spans.push((j, k));
    }
    Some(cover)
}
