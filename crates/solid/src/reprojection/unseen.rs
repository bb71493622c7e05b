//! Edges of a solid that no view shows, so that a drawing without hidden lines leaves open where they are.

use super::ReprojectionOptions;
use super::compare::{Prepared, projected};
use super::cut;
use super::nearby::{Nearby, Piece};
use super::outlines::{Outline, outlines};
use super::scene::{Eye, Scene};
use crate::brep::Solid;
use crate::drawing::Drawing;
use planish_core::{BoundingBox, DVec3};
use std::collections::BTreeSet;

/// Positions of samples along a line, as shares of its points.
const SHARES: [f64; 3] = [0.23, 0.52, 0.81];

/// The edges that no view shows in front of all other lines, and that are not in the outer border of a face
/// at an end of the part, nor between ends of such edges.
///
/// The rim at which a hole leaves the part has the same image as the rim at which it enters, so it is such an
/// edge; the lower edges of a block are not.
pub(super) fn unseen_edges(solid: &Solid, drawing: &Drawing, options: &ReprojectionOptions) -> Vec<usize> {
    let prepared = Prepared::new(solid, drawing);
    let mut seen: BTreeSet<usize> = BTreeSet::new();
    let views = drawing.views.iter().filter(|view| view.is_compared());
    for view in views {
        let eye = Eye::new(view);
        let mut lines = outlines(solid, &prepared.scene.faces, &prepared.edges, eye, prepared.scene.size);
        if eye.is_section() {
            lines = cut::behind(lines, eye, options.near * prepared.scene.size);
        }
        seen.extend(nearest_lines(&lines, &prepared.scene, eye, options));
    }
    let bounds: BoundingBox = solid.vertices.iter().copied().collect();
    let near = options.near * prepared.scene.size;
    let is_end =
        |p: DVec3, k: usize| (p[k] - bounds.min[k]).abs() < near || (p[k] - bounds.max[k]).abs() < near;
    let mut at_ends: BTreeSet<usize> = BTreeSet::new();
    for face in &solid.faces {
        let Some(outer) = face.loops.first() else { continue };
        let points = outer.iter().map(|coedge| middle(solid, coedge.edge));
        if (0..3).any(|k| points.clone().all(|p| is_end(p, k))) {
            at_ends.extend(outer.iter().map(|coedge| coedge.edge));
        }
    }
    // An edge between two places that are known is known: the inner corner of a step.
    let known: BTreeSet<usize> = (seen.iter().filter(|group| **group < solid.edges.len()))
        .chain(&at_ends)
        .flat_map(|edge| [solid.edges[*edge].start, solid.edges[*edge].end])
        .collect();
    let is_open = |index: &usize| {
        let edge = &solid.edges[*index];
        let is_between = edge.start != edge.end && known.contains(&edge.start) && known.contains(&edge.end);
        let is_sharp = prepared.edges.is_sharp(solid, &prepared.scene.faces, *index);
        is_sharp && !seen.contains(index) && !at_ends.contains(index) && !is_between
    };
    (0..solid.edges.len()).filter(is_open).collect()
}

fn middle(solid: &Solid, edge: usize) -> DVec3 {
    let edge = &solid.edges[edge];
    edge.curve.point((edge.range[0] + edge.range[1]) / 2.0)
}

/// The groups of lines that are visible in a view and have no other line before them.
fn nearest_lines(
    lines: &[Outline],
    scene: &Scene<'_>,
    eye: Eye,
    options: &ReprojectionOptions,
) -> Vec<usize> {
    let near = options.near * scene.size;
    let pieces: Vec<Piece> = (lines.iter().enumerate())
        .flat_map(|(line, outline)| {
            let points = projected(outline, eye);
            let ends: Vec<[[f64; 2]; 2]> = points.windows(2).map(|p| [p[0], p[1]]).collect();
            ends.into_iter().enumerate().map(move |(index, ends)| Piece { ends, line, index })
        })
        .collect();
    let all = Nearby::new(pieces, near, 0.02 * scene.size);
    let mut found = Vec::new();
    for line in lines {
        let count = line.points.len() - 1;
        let is_nearest = |share: &f64| {
            let place = share * count as f64;
            let piece = (place as usize).min(count - 1);
            let [a, b] = [line.points[piece], line.points[piece + 1]];
            let p = a + (place - piece as f64) * (b - a);
            let [from, to] = [a, b].map(|end| eye.seen(end));
            let d = [to[0] - from[0], to[1] - from[1]];
            let length = d[0].hypot(d[1]);
            // An edge along the line of sight is a point in the view.
            if length < near.min(0.5 * (b - a).length()) {
                return false;
            }
            let before = |(piece, share, _): (Piece, f64, f64)| {
                let [a, b] = [piece.index, piece.index + 1].map(|k| lines[piece.line].points[k]);
                eye.nearness(a + share * (b - a)) > eye.nearness(p) + near
            };
            let across = [-d[1] / length, d[0] / length];
            scene.is_visible(eye, p, across) && !all.at(eye.seen(p)).any(before)
        };
        if SHARES.iter().any(is_nearest) {
            found.push(line.group);
        }
    }
    found
}
