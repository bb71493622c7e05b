//! Candidate planes and cylinders oblique to all views.
//!
//! Input: a drawing of three views. Output: walls, and the curves that they explain without any surface
//! seen edge-on.
//!
//! - Two edges of the wireframe that meet at an angle span a plane. It is a candidate if it is oblique to all
//!   views and contains at least three edges, each of which continues at both ends in another edge or in a
//!   curve.
//! - A curve of a view is lifted into such a plane, or into one that another view sees edge-on. If it is a
//!   circle there and all views show its points, it is an end of a cylinder along the normal of the plane.
//!   Exported curves are inaccurate, so centre and radius come from straight lines if there are any: points
//!   of the wireframe on the circle, and outlines parallel to the image of the axis.
//!
//! Limits: drawings of two views, planes whose edges are mostly smooth and not drawn, and cylinders with
//! oblique cuts at all ends are not found.

use super::candidate_surface::CandidateSurface;
use super::circles::circles;
use super::oblique_wall::{Form, Oblique};
use super::wireframe::{Wireframe, wireframe};
use crate::brep::unit;
use crate::drawing::{Curve2, Drawing};
use nalgebra::{Matrix3, SymmetricEigen};
use planish_core::DVec3;
use std::collections::BTreeSet;

/// Maximum distance of ends of lines at one point, relative to the size of the drawing.
///
/// A larger value joins points by chance; a smaller one loses points of inaccurate drawings.
const COINCIDENT: f64 = 1e-5;
/// Minimum component of the normal of an oblique plane along each axis. Other planes are seen edge-on.
const MIN_LEAN: f64 = 1e-4;
/// Minimum sine of the angle between an axis and the plane of a view, above which the axis is oblique to it.
const ROUGH_LEAN: f64 = 1e-3;
/// Minimum sine of the angle between two edges that span a plane. Errors of the normal grow with its inverse.
const MIN_ANGLE: f64 = 1e-3;
/// Minimum number of edges of a face.
const MIN_EDGES: usize = 3;
/// Maximum number of candidates. More of them are mostly false, and each divides the cells further.
const MAX_WALLS: usize = 24;

/// Oblique walls of a drawing, and the curves (view and index) that these explain completely.
pub(super) struct ObliqueSurfaces {
    pub(super) walls: Vec<CandidateSurface>,
    pub(super) explained: BTreeSet<(usize, usize)>,
}

/// The oblique walls of a drawing; `None` if there are none or too many.
pub(super) fn oblique(drawing: &Drawing) -> Option<ObliqueSurfaces> {
    let near = COINCIDENT * drawing.size();
    let frame = wireframe(drawing, near)?;
    let planes = planes(&frame, near);
    // Ends of cylinders may lie in oblique planes, so planes come first.
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
    let mut tried: Vec<(DVec3, f64)> = Vec::new();
    let mut found = Vec::new();
    for (i, ends) in at.iter().enumerate() {
        for (n, &j) in ends.iter().enumerate() {
            for &k in &ends[n + 1..] {
                let p = frame.points[i];
                let (a, b) = (unit(frame.points[j] - p), unit(frame.points[k] - p));
                // For unit vectors this is the sine of the angle between them.
                let normal = a.cross(b);
                if normal.length() < MIN_ANGLE {
                    continue;
                }
                let normal = unit(normal);
                let three = [i, j, k].map(|v| frame.points[v]);
                let is_known =
                    |(n, d): &(DVec3, f64)| three.iter().all(|p| (n.dot(*p) - d).abs() < 3.0 * near);
                if normal.to_array().iter().any(|c| c.abs() < MIN_LEAN) || tried.iter().any(is_known) {
                    continue;
                }
                let offset = normal.dot(p);
                tried.push((normal, offset));
                found.extend(face_plane(frame, normal, offset, near));
            }
        }
    }
    found
}

/// The plane fitted to the edges near a plane that continue at both ends; `None` if there are too few.
///
/// Edges with a free end cannot bound a face. Removing one may free another, so this repeats.
fn face_plane(frame: &Wireframe, normal: DVec3, offset: f64, near: f64) -> Option<Oblique> {
    let is_in = |k: usize| (normal.dot(frame.points[k]) - offset).abs() < 3.0 * near;
    let mut edges: Vec<[usize; 2]> =
        frame.edges.iter().copied().filter(|e| e.iter().all(|k| is_in(*k))).collect();
    loop {
        let continues = |k: usize| frame.ends_curve[k] || edges.iter().filter(|e| e.contains(&k)).count() > 1;
        let kept: Vec<[usize; 2]> =
            edges.iter().copied().filter(|e| e.iter().all(|k| continues(*k))).collect();
        if kept.len() == edges.len() {
            break;
        }
        edges = kept;
    }
    if edges.len() < MIN_EDGES {
        return None;
    }
    let ends: BTreeSet<usize> = edges.iter().flatten().copied().collect();
    let points: Vec<DVec3> = ends.into_iter().map(|k| frame.points[k]).collect();
    let (normal, offset) = plane_through(&points);
    let bounds = bounds_of(&points);
    Some(Oblique::within(Form::Plane { normal, offset }, bounds))
}

/// The plane fitted to points by least squares.
///
/// `Σ (n · (p − c))²` has its minimum at the eigenvector of the smallest eigenvalue of `Σ (p − c)(p − c)ᵀ`.
fn plane_through(points: &[DVec3]) -> (DVec3, f64) {
    let count = points.len() as f64;
    let center = DVec3::from_array([0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / count));
    let mut moments = Matrix3::zeros();
    for p in points {
        let d = *p - center;
        moments += Matrix3::from_fn(|i, j| d[i] * d[j]);
    }
    let eigen = SymmetricEigen::new(moments);
    let smallest = eigen.eigenvalues.imin();
    let normal = eigen.eigenvectors.column(smallest);
    let normal = unit(DVec3::new(normal[0], normal[1], normal[2]));
    // The sign of an eigenvector is arbitrary; this makes the result independent of the solver.
    let normal = if normal[2] < 0.0 { -normal } else { normal };
    (normal, normal.dot(center))
}

/// The box around some points.
pub(super) fn bounds_of(points: &[DVec3]) -> [[f64; 2]; 3] {
    [0, 1, 2].map(|k| {
        let values = points.iter().map(|p| p[k]);
        values.fold([f64::MAX, f64::MIN], |m, v| [m[0].min(v), m[1].max(v)])
    })
}

/// Curves of the views that need no surface seen edge-on.
///
/// These are lines that consist of edges on two walls, or on one wall and a plane across an axis, and
/// outlines of cylinders.
fn explained(drawing: &Drawing, frame: &Wireframe, walls: &[Oblique], near: f64) -> BTreeSet<(usize, usize)> {
    let on_two: Vec<bool> = frame
        .edges
        .iter()
        .map(|e| {
            let middle = DVec3::from_array(
                [0, 1, 2].map(|k| e.iter().map(|i| frame.points[*i][k]).sum::<f64>() / 2.0),
            );
            let [p, q] = e.map(|i| frame.points[i]);
            let is_on = |w: &&Oblique| [p, middle, q].iter().all(|p| w.value(*p).abs() < 3.0 * near);
            // An edge parallel to a view lies in a plane that the other two views see edge-on and draw.
            let in_axis_plane = (0..3).any(|k| (p[k] - q[k]).abs() < near);
            walls.iter().filter(is_on).count() + usize::from(in_axis_plane) > 1
        })
        .collect();
    let mut found = BTreeSet::new();
    for (v, view) in drawing.views.iter().enumerate() {
        let [right, up, sight] = view.kind.axes();
        let image = |p: DVec3| [p[right], p[up]];
        let outlines: Vec<[[f64; 2]; 2]> = walls
            .iter()
            .filter_map(|w| w.outlines(sight))
            // If the axis is parallel to the view, the outline may also be a tangent plane seen edge-on. Such
            // a line is kept on the grid.
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
            let distance = |p: [f64; 2], from: [f64; 2], d: [f64; 2]| {
                ((p[0] - from[0]) * d[1] - (p[1] - from[1]) * d[0]).abs() / d[0].hypot(d[1])
            };
            let is_outline = outlines
                .iter()
                .any(|[from, d]| distance(a, *from, *d) < 2.0 * near && distance(b, *from, *d) < 2.0 * near);
            if is_outline {
                found.insert((v, index));
                continue;
            }
            // The intervals of the line that edges cover. All must be explained, and together they must
            // cover the line.
            let length = crate::drawing::distance(a, b);
            let d = [0, 1].map(|k| (b[k] - a[k]) / length);
            let along = |p: [f64; 2]| (p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1];
            let mut runs = Vec::new();
            let mut all_on_two = true;
            for (e, on_two) in frame.edges.iter().zip(&on_two) {
                let ends = e.map(|k| image(frame.points[k]));
                if ends.iter().any(|p| distance(*p, a, d) > 2.0 * near) {
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
