//! Hatches from single lines: parallel lines of one pen at one distance, whose ends are no corners.

use super::{Accuracy, PointGrid, Stroke, ends};
use planish_solid::sheet::SheetBox;
use planish_solid::views::{Curve2, LineStyle, distance};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Minimum number of lines of a hatch.
const MIN_LINES: usize = 5;
/// Minimum angle to the sides of the page, in radians. Rows of edges are often parallel to them.
const MIN_ANGLE: f64 = 0.05;
/// Relative tolerance of distances between lines.
const SAME_DISTANCE: f64 = 0.03;
/// Share of ends at corners from which on lines are edges.
const CORNER_SHARE: f64 = 0.3;

/// A line as direction, offset to its left, and range along the direction.
struct Line {
    stroke: usize,
    offset: f64,
    range: [f64; 2],
}

/// Takes out the lines of hatches; returns the other strokes, the number of lines, and the box of each hatch.
pub(crate) fn take_hatching(
    strokes: Vec<Stroke>,
    accuracy: &Accuracy,
) -> (Vec<Stroke>, usize, Vec<SheetBox>) {
    let places = strokes.iter().enumerate();
    let places = places.flat_map(|(k, s)| ends(&s.drawn.curve).map(|p| (k as u32, p)));
    let corners = PointGrid::new(accuracy.longest_gap, places);
    let mut families: BTreeMap<(u32, i64), Vec<Line>> = BTreeMap::new();
    for (k, stroke) in strokes.iter().enumerate() {
        let Curve2::Segment(a, b) = stroke.drawn.curve else { continue };
        let angle = (b[1] - a[1]).atan2(b[0] - a[0]).rem_euclid(PI);
        let is_oblique = (angle / (0.5 * PI)).fract().min(1.0 - (angle / (0.5 * PI)).fract()) > MIN_ANGLE;
        if stroke.drawn.style != LineStyle::Visible || !is_oblique {
            continue;
        }
        // Hatches have angles of whole degrees.
        let degrees = angle.to_degrees().round();
        if (angle.to_degrees() - degrees).abs() > 0.1 {
            continue;
        }
        let (sin, cos) = degrees.to_radians().sin_cos();
        let [from, to] = [a, b].map(|p| cos * p[0] + sin * p[1]);
        let offset = cos * 0.5 * (a[1] + b[1]) - sin * 0.5 * (a[0] + b[0]);
        let line = Line { stroke: k, offset, range: [from.min(to), from.max(to)] };
        families.entry((stroke.pen, degrees as i64)).or_default().push(line);
    }
    let mut is_hatch = vec![false; strokes.len()];
    let mut boxes = Vec::new();
    for lines in families.values_mut().filter(|lines| lines.len() >= MIN_LINES) {
        for group in groups(lines, accuracy) {
            let is_corner = |p: &[f64; 2], own: usize| {
                let near = 2.0 * accuracy.position;
                corners.around(*p, near).any(|(k, q)| k as usize != own && distance(*p, q) <= near)
            };
            let count = group
                .iter()
                .map(|k| ends(&strokes[*k].drawn.curve).iter().filter(|p| is_corner(p, *k)).count());
            if count.sum::<usize>() as f64 > CORNER_SHARE * 2.0 * group.len() as f64 {
                continue;
            }
            let bounds = group.iter().fold([[f64::MAX, f64::MIN]; 2], |all, k| {
                let own = strokes[*k].drawn.curve.bounds();
                [0, 1].map(|c| [all[c][0].min(own[c][0]), all[c][1].max(own[c][1])])
            });
            boxes.push(bounds);
            group.iter().for_each(|k| is_hatch[*k] = true);
        }
    }
    let count = is_hatch.iter().filter(|h| **h).count();
    let others = strokes.into_iter().zip(&is_hatch).filter(|(_, is_hatch)| !**is_hatch).map(|(s, _)| s);
    (others.collect(), count, boxes)
}

/// Groups of lines of one direction that lie beside each other at one distance.
fn groups(lines: &mut [Line], accuracy: &Accuracy) -> Vec<Vec<usize>> {
    lines.sort_by(|a, b| a.offset.total_cmp(&b.offset));
    let overlap = |a: &Line, b: &Line| a.range[0] < b.range[1] && b.range[0] < a.range[1];
    // The nearest line beside each.
    let nearest = |k: usize| {
        let beside = lines[k + 1..].iter().take_while(|l| l.offset - lines[k].offset < accuracy.longest_gap);
        let beyond = beside.filter(|l| l.offset - lines[k].offset > 4.0 * accuracy.position);
        beyond.filter(|l| overlap(l, &lines[k])).map(|l| l.offset - lines[k].offset).next()
    };
    let mut distances: Vec<f64> = (0..lines.len()).filter_map(nearest).collect();
    distances.sort_by(f64::total_cmp);
    let Some(usual) = distances.get(distances.len() / 2).copied() else { return Vec::new() };
    let mut parent: Vec<usize> = (0..lines.len()).collect();
    for k in 0..lines.len() {
        for other in k + 1..lines.len() {
            let off = lines[other].offset - lines[k].offset;
            if off > (1.0 + SAME_DISTANCE) * usual + 4.0 * accuracy.position {
                break;
            }
            if (off - usual).abs() <= SAME_DISTANCE * usual + 4.0 * accuracy.position
                && overlap(&lines[k], &lines[other])
            {
                let (a, b) = (root(&mut parent, k), root(&mut parent, other));
                parent[a] = b;
            }
        }
    }
    let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for k in 0..lines.len() {
        groups.entry(root(&mut parent, k)).or_default().push(lines[k].stroke);
    }
    groups.into_values().filter(|group| group.len() >= MIN_LINES).collect()
}

fn root(parent: &mut [usize], mut k: usize) -> usize {
    while parent[k] != k {
        parent[k] = parent[parent[k]];
        k = parent[k];
    }
    k
}
