//! Chains of creases: short ones are removed, and sharp turns become corners.
//!
//! Input: a mesh with creases. Output: the same mesh without branches and components that are too short, and
//! with its corners.
//!
//! Not guaranteed: corners at turns that are closer to each other than [`STRAIGHT`] spacings.

use crate::layout::CreasedMesh;
use planish_core::{DVec3, DisjointSets};
use std::collections::{BTreeMap, BTreeSet};

/// Length of a branch that ends freely, and of all connected creases, at least, in spacings.
const MIN_BRANCH: f64 = 2.5;
const MIN_LENGTH: f64 = 6.0;
/// Length of a crease between two vertices where others meet, at least, in spacings.
const MIN_LINK: f64 = 2.5;
/// Length on both sides of a vertex over which directions are compared, in spacings, and the cosine of the
/// smallest turn of a corner (45°).
const STRAIGHT: f64 = 2.0;
const TURN_COSINE: f64 = 0.71;

/// Neighbours of each vertex along creases.
pub(super) type Graph = BTreeMap<u32, BTreeSet<u32>>;

/// Removes short creases and finds corners. Returns as well the corners that were close to each other before
/// short creases between them were removed: an edge is hardly one there, or several are close to each other.
pub(super) fn tidy(creased: CreasedMesh, spacing: f64) -> (CreasedMesh, Vec<u32>) {
    let CreasedMesh { mesh, creases, .. } = creased;
    let (mut graph, at) = (graph_of(&creases), &mesh.positions);
    let corners_and_close_ones = |graph: &Graph| {
        let corners = corners(graph, at, STRAIGHT * spacing);
        let close = close_corners(graph, at, &corners, MIN_LINK * spacing);
        (corners, close)
    };
    remove_short_branches(&mut graph, at, MIN_BRANCH * spacing);
    remove_short_components(&mut graph, at, MIN_LENGTH * spacing);
    let (_, clusters) = corners_and_close_ones(&graph);
    remove_short_links(&mut graph, at, MIN_LINK * spacing);
    remove_short_branches(&mut graph, at, MIN_BRANCH * spacing);
    remove_short_components(&mut graph, at, MIN_LENGTH * spacing);
    // Where a crease turns back soon, or meets others, its turn is noise.
    let (mut corners, close) = corners_and_close_ones(&graph);
    corners.retain(|v| !close.contains(v));
    (CreasedMesh { creases: edges(&graph), corners, mesh }, clusters)
}

/// Corners, and ends of creases, from which a crease leads to another one within a length. `turns` are the
/// corners of two creases.
pub(super) fn close_corners(graph: &Graph, at: &[DVec3], turns: &[u32], length: f64) -> Vec<u32> {
    let is_corner = |v: &u32| graph[v].len() != 2 || turns.contains(v);
    let leads_to_one = |v: u32, w: u32| {
        let (path, total) = walk(graph, at, [v, w], length);
        let within = if total > length { &path[1..path.len() - 1] } else { &path[1..] };
        within.iter().any(is_corner)
    };
    let is_close = |v: &u32| graph[v].iter().any(|&w| leads_to_one(*v, w));
    graph.keys().copied().filter(|v| is_corner(v) && is_close(v)).collect()
}

pub(super) fn graph_of(creases: &[[u32; 2]]) -> Graph {
    let mut graph = Graph::new();
    for &[a, b] in creases {
        graph.entry(a).or_default().insert(b);
        graph.entry(b).or_default().insert(a);
    }
    graph
}

fn edges(graph: &Graph) -> Vec<[u32; 2]> {
    let all = graph.iter().flat_map(|(&a, others)| others.iter().map(move |&b| [a, b]));
    all.filter(|[a, b]| a < b).collect()
}

fn remove(graph: &mut Graph, a: u32, b: u32) {
    for (from, to) in [(a, b), (b, a)] {
        if let Some(others) = graph.get_mut(&from) {
            others.remove(&to);
            if others.is_empty() {
                graph.remove(&from);
            }
        }
    }
}

/// The vertices from `first` over `second` on, up to one that ends, branches, or was the first, or up to a
/// length.
fn walk(graph: &Graph, at: &[DVec3], [first, second]: [u32; 2], longest: f64) -> (Vec<u32>, f64) {
    let mut path = vec![first, second];
    let mut length = at[first as usize].distance(at[second as usize]);
    while length < longest {
        let [before, last] = [path[path.len() - 2], path[path.len() - 1]];
        let others = &graph[&last];
        let (Some(&next), 2) = (others.iter().find(|w| **w != before), others.len()) else { break };
        if next == first {
            break;
        }
        length += at[last as usize].distance(at[next as usize]);
        path.push(next);
    }
    (path, length)
}

/// Branches that leave a chain and end soon are noise at it.
fn remove_short_branches(graph: &mut Graph, at: &[DVec3], shortest: f64) {
    let ends: Vec<u32> = graph.iter().filter(|(_, others)| others.len() == 1).map(|(&v, _)| v).collect();
    for end in ends {
        let Some(&second) = graph.get(&end).and_then(|others| others.first()) else { continue };
        let (path, length) = walk(graph, at, [end, second], shortest);
        let last = path[path.len() - 1];
        if length < shortest && graph[&last].len() > 2 {
            path.windows(2).for_each(|pair| remove(graph, pair[0], pair[1]));
        }
    }
}

/// Short creases between two vertices where others meet are noise: rungs between parallel chains of one edge,
/// and one side of a small loop.
fn remove_short_links(graph: &mut Graph, at: &[DVec3], shortest: f64) {
    let junctions: Vec<u32> = graph.iter().filter(|(_, others)| others.len() > 2).map(|(&v, _)| v).collect();
    for v in junctions {
        while let Some(others) = graph.get(&v).filter(|others| others.len() > 2) {
            let links = others.iter().map(|&w| walk(graph, at, [v, w], shortest));
            let ends_at_another =
                |path: &[u32]| path.last().is_some_and(|last| *last != v && graph[last].len() > 2);
            let short = links.filter(|(path, length)| *length < shortest && ends_at_another(path));
            let Some((path, _)) = short.min_by(|x, y| x.1.total_cmp(&y.1)) else { break };
            path.windows(2).for_each(|pair| remove(graph, pair[0], pair[1]));
        }
    }
}

fn remove_short_components(graph: &mut Graph, at: &[DVec3], shortest: f64) {
    let all = edges(graph);
    let mut sets = DisjointSets::new(at.len());
    for &[a, b] in &all {
        sets.join(a, b);
    }
    let roots = sets.into_roots();
    let mut lengths: BTreeMap<u32, f64> = BTreeMap::new();
    for &[a, b] in &all {
        *lengths.entry(roots[a as usize]).or_default() += at[a as usize].distance(at[b as usize]);
    }
    for [a, b] in all {
        if lengths[&roots[a as usize]] < shortest {
            remove(graph, a, b);
        }
    }
}

/// Vertices of two creases where the direction over a length turns by more than elsewhere near them, and by
/// more than 45°.
fn corners(graph: &Graph, at: &[DVec3], length: f64) -> Vec<u32> {
    let mut turns: BTreeMap<u32, f64> = BTreeMap::new();
    for (&v, others) in graph.iter().filter(|(_, others)| others.len() == 2) {
        let mut directions = others.iter().map(|&w| {
            let (path, _) = walk(graph, at, [v, w], length);
            (at[path[path.len() - 1] as usize] - at[v as usize]).normalize_or_zero()
        });
        let (Some(a), Some(b)) = (directions.next(), directions.next()) else { continue };
        let cosine = -a.dot(b);
        if cosine < TURN_COSINE {
            turns.insert(v, cosine);
        }
    }
    let is_sharpest = |&(&v, &own): &(&u32, &f64)| {
        graph[&v].iter().all(|&w| {
            let (path, _) = walk(graph, at, [v, w], length);
            path[1..].iter().all(|w| turns.get(w).is_none_or(|other| (own, v) < (*other, *w)))
        })
    };
    turns.iter().filter(is_sharpest).map(|(&v, _)| v).collect()
}
