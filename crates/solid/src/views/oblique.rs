//! Which planes and cylinders oblique to all views a drawing may mean.
//!
//! Input: a drawing of three views. Output: walls, and the curves that they explain without any surface
//! seen edge-on.
//!
//! - Two edges of the wireframe that meet and are not parallel span a plane. It is a candidate where it is
//!   oblique to all views and holds at least three edges of which each goes on, at both ends, in another one
//!   or in a curve.
//! - A curve of a view, lifted into such a plane or into one that another view sees edge-on, is an end of a
//!   cylinder where it is a circle there and all views show its points. Its axis is the plane's normal.
//!   Exported curves are rough, so centre and radius are measured by straight lines where there are any:
//!   points of the wireframe on the circle, and outlines parallel to the axis' image.
//!
//! Not guaranteed: drawings of two views, planes whose edges are mostly smooth and not drawn, cylinders whose
//! ends are all cut obliquely.

use super::candidate_surface::CandidateSurface;
use super::circles::circles;
use super::oblique_wall::{Form, Oblique};
use super::wireframe::{Wireframe, wireframe};
use crate::brep::unit;
use crate::drawing::{Curve2, Drawing};
use nalgebra::{Matrix3, SymmetricEigen};
use planish_estimate::vector3::{cross, dot, norm, scale, sub};
use std::collections::BTreeSet;

/// Ends of lines that mean one point agree within this share of the drawing's size.
const COINCIDENT: f64 = 1e-5;
/// A plane is oblique to a view where its normal leans so far out of the view's own plane.
const MIN_LEAN: f64 = 1e-4;
/// An axis leans out of a view's plane where the sine of the angle is so large.
const ROUGH_LEAN: f64 = 1e-3;
/// Edges span a plane where the sine of the angle between them is so large.
const MIN_ANGLE: f64 = 1e-3;
/// So many edges make a face at least.
const MIN_EDGES: usize = 3;
/// More candidates tell nothing.
const MAX_WALLS: usize = 24;

/// Oblique walls of a drawing, and the curves for which nothing else is needed, by view and index.
pub(super) struct ObliqueSurfaces {
    pub(super) walls: Vec<CandidateSurface>,
    pub(super) explained: BTreeSet<(usize, usize)>,
}

/// The oblique walls of a drawing; none where there are none, or too many.
pub(super) fn oblique(drawing: &Drawing) -> Option<ObliqueSurfaces> {
    let near = COINCIDENT * drawing.size();
    let frame = wireframe(drawing, near)?;
    let planes = planes(&frame, near);
    let mut forms: Vec<Oblique> = planes.clone();
    if forms.len() <= MAX_WALLS {
        forms.extend(circles(drawing, &frame, &planes, near));
    }
    if forms.is_empty() || forms.len() > MAX_WALLS {
        return None;
    }
    let explained = explained(drawing, &frame, &forms, near);
    let walls = forms.into_iter().map(CandidateSurface::Oblique).collect();
    Some(ObliqueSurfaces { walls, explained })
}

/// Planes oblique to all views that hold closed chains of edges.
fn planes(frame: &Wireframe, near: f64) -> Vec<Oblique> {
    let mut at: Vec<Vec<usize>> = vec![Vec::new(); frame.points.len()];
    for [i, j] in &frame.edges {
        at[*i].push(*j);
        at[*j].push(*i);
    }
    let mut tried: Vec<([f64; 3], f64)> = Vec::new();
    let mut found = Vec::new();
    for (i, ends) in at.iter().enumerate() {
        for (n, &j) in ends.iter().enumerate() {
            for &k in &ends[n + 1..] {
                let p = frame.points[i];
                let (a, b) = (unit(sub(frame.points[j], p)), unit(sub(frame.points[k], p)));
                let normal = cross(a, b);
                if norm(normal) < MIN_ANGLE {
                    continue;
                }
                let normal = unit(normal);
                let three = [i, j, k].map(|v| frame.points[v]);
                let is_known =
                    |(n, d): &([f64; 3], f64)| three.iter().all(|p| (dot(*n, *p) - d).abs() < 3.0 * near);
                if normal.iter().any(|c| c.abs() < MIN_LEAN) || tried.iter().any(is_known) {
                    continue;
                }
                let offset = dot(normal, p);
                tried.push((normal, offset));
                found.extend(face_plane(frame, normal, offset, near));
            }
        }
    }
    found
}

/// The plane of the edges that lie in a plane and go on at both ends; none where there are too few.
fn face_plane(frame: &Wireframe, normal: [f64; 3], offset: f64, near: f64) -> Option<Oblique> {
    let is_in = |k: usize| (dot(normal, frame.points[k]) - offset).abs() < 3.0 * near;
    let mut edges: Vec<[usize; 2]> =
        frame.edges.iter().copied().filter(|e| e.iter().all(|k| is_in(*k))).collect();
    loop {
        let goes_on = |k: usize| frame.ends_curve[k] || edges.iter().filter(|e| e.contains(&k)).count() > 1;
        let kept: Vec<[usize; 2]> = edges.iter().copied().filter(|e| e.iter().all(|k| goes_on(*k))).collect();
        if kept.len() == edges.len() {
            break;
        }
        edges = kept;
    }
    if edges.len() < MIN_EDGES {
        return None;
    }
    let ends: BTreeSet<usize> = edges.iter().flatten().copied().collect();
    let points: Vec<[f64; 3]> = ends.into_iter().map(|k| frame.points[k]).collect();
    let (normal, offset) = plane_through(&points);
    let bounds = bounds_of(&points);
    Some(Oblique::within(Form::Plane { normal, offset }, bounds))
}

/// The plane with the least squares of distances to some points: `Σ (n · (p − c))²` is least for the
/// eigenvector of the smallest eigenvalue.
fn plane_through(points: &[[f64; 3]]) -> ([f64; 3], f64) {
    let count = points.len() as f64;
    let center = [0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / count);
    let mut moments = Matrix3::zeros();
    for p in points {
        let d = sub(*p, center);
        moments += Matrix3::from_fn(|i, j| d[i] * d[j]);
    }
    let eigen = SymmetricEigen::new(moments);
    let least = eigen.eigenvalues.imin();
    let normal = eigen.eigenvectors.column(least);
    let normal = unit([normal[0], normal[1], normal[2]]);
    // One sign for both directions.
    let normal = if normal[2] < 0.0 { scale(-1.0, normal) } else { normal };
    (normal, dot(normal, center))
}

/// The box around some points.
pub(super) fn bounds_of(points: &[[f64; 3]]) -> [[f64; 2]; 3] {
    [0, 1, 2].map(|k| {
        let values = points.iter().map(|p| p[k]);
        values.fold([f64::MAX, f64::MIN], |m, v| [m[0].min(v), m[1].max(v)])
    })
}

/// Curves of the views that need no surface seen edge-on: lines of edges of which each lies on two walls, or
/// on one and on a plane across an axis, and outlines of cylinders.
fn explained(drawing: &Drawing, frame: &Wireframe, walls: &[Oblique], near: f64) -> BTreeSet<(usize, usize)> {
    let on_two: Vec<bool> = frame
        .edges
        .iter()
        .map(|e| {
            let middle = [0, 1, 2].map(|k| e.iter().map(|i| frame.points[*i][k]).sum::<f64>() / 2.0);
            let [p, q] = e.map(|i| frame.points[i]);
            let is_on = |w: &&Oblique| [p, middle, q].iter().all(|p| w.value(*p).abs() < 3.0 * near);
            // An edge parallel to a view lies in a plane that the other two see edge-on, and that they draw
            // there.
            let in_axis_plane = (0..3).any(|k| (p[k] - q[k]).abs() < near);
            walls.iter().filter(is_on).count() + usize::from(in_axis_plane) > 1
        })
        .collect();
    let mut found = BTreeSet::new();
    for (v, view) in drawing.views.iter().enumerate() {
        let [right, up, sight] = view.kind.axes();
        let image = |p: [f64; 3]| [p[right], p[up]];
        let outlines: Vec<[[f64; 2]; 2]> = walls
            .iter()
            .filter_map(|w| w.outlines(sight))
            // Where the axis lies in the view, planes that touch the cylinder are seen edge-on along its
            // outlines.
            .filter(|(_, d)| d[sight].abs() > ROUGH_LEAN)
            .flat_map(|(points, d)| points.map(|p| [image(p), image(d)]))
            .collect();
        for (index, drawn) in view.curves.iter().enumerate() {
            let Curve2::Segment(a, b) = drawn.curve else {
                continue;
            };
            if (0..2).any(|k| (a[k] - b[k]).abs() <= near) {
                continue;
            }
            let beside = |p: [f64; 2], from: [f64; 2], d: [f64; 2]| {
                ((p[0] - from[0]) * d[1] - (p[1] - from[1]) * d[0]).abs() / d[0].hypot(d[1])
            };
            let is_outline = outlines
                .iter()
                .any(|[from, d]| beside(a, *from, *d) < 2.0 * near && beside(b, *from, *d) < 2.0 * near);
            if is_outline {
                found.insert((v, index));
                continue;
            }
            // Along the line, what edges cover.
            let length = crate::drawing::distance(a, b);
            let d = [0, 1].map(|k| (b[k] - a[k]) / length);
            let along = |p: [f64; 2]| (p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1];
            let mut runs = Vec::new();
            let mut all_on_two = true;
            for (e, on_two) in frame.edges.iter().zip(&on_two) {
                let ends = e.map(|k| image(frame.points[k]));
                if ends.iter().any(|p| beside(*p, a, d) > 2.0 * near) {
                    continue;
                }
                let [s, t] = ends.map(along);
                let run = [s.min(t).max(0.0), s.max(t).min(length)];
                if run[1] - run[0] > 4.0 * near {
                    all_on_two &= on_two;
                    runs.push(run);
                }
            }
            runs.sort_by(|p, q| p[0].total_cmp(&q[0]));
            let mut reached = 0.0;
            for run in runs {
                if run[0] < reached + 4.0 * near {
                    reached = f64::max(reached, run[1]);
                }
            }
            if all_on_two && reached > length - 4.0 * near {
                found.insert((v, index));
            }
        }
    }
    found
}
