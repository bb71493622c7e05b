//! Compares a view in both directions: points of drawn curves with the lines of the solid, and points of
//! these lines with the drawn curves.

use super::cut;
use super::nearby::{Nearby, Piece};
use super::outlines::{Edges, Outline, outlines};
use super::scene::{Eye, Scene};
use super::{Difference, Disagreement, ReprojectionOptions};
use crate::brep::Solid;
use crate::brep::TrimmedFace;
use crate::drawing::{Curve2, Drawing, LineStyle, View};
use planish_core::{BoundingBox, DVec3};
use std::collections::BTreeMap;

/// What is the same for all views of a solid.
pub(super) struct Prepared<'a> {
    pub(super) edges: Edges,
    pub(super) scene: Scene<'a>,
}

impl<'a> Prepared<'a> {
    pub(super) fn new(solid: &'a Solid, drawing: &Drawing) -> Self {
        let size = drawing.size();
        let reach = reach(solid, size);
        let mut body_of = vec![0; solid.faces.len()];
        for (index, body) in solid.bodies().iter().enumerate() {
            body.outer.iter().chain(body.voids.iter().flatten()).for_each(|face| body_of[*face] = index);
        }
        let faces = solid.faces.iter().map(|f| TrimmedFace::new(solid, f, reach)).collect();
        Self { edges: Edges::new(solid, size), scene: Scene { faces, body_of, size, reach } }
    }
}

pub(super) fn disagreements(
    solid: &Solid,
    drawing: &Drawing,
    options: &ReprojectionOptions,
) -> Vec<Disagreement> {
    let Prepared { edges, scene } = Prepared::new(solid, drawing);
    let mut found = Vec::new();
    for view in drawing.views.iter().filter(|view| view.is_compared()) {
        let eye = Eye::new(view);
        let mut lines = outlines(solid, &scene.faces, &edges, eye, scene.size);
        if eye.is_section() {
            lines = cut::behind(lines, eye, options.near * scene.size);
        }
        let compared = Compared::new(view, &lines, &scene, eye, options);
        found.extend(compared.drawn_but_not_shown());
        found.extend(compared.shown_but_not_drawn());
        found.extend(cut::wrong_hatches(view, &scene, eye));
    }
    found
}

/// A box around a solid. The margin (the size of the drawing) covers faces that bulge beyond their edges,
/// such as a sphere, of which the samples show only a few points.
fn reach(solid: &Solid, size: f64) -> [DVec3; 2] {
    let points = solid.edges.iter().flat_map(|e| {
        let [from, to] = e.range;
        [0.0, 0.25, 0.5, 0.75].map(|s| e.curve.point(from + s * (to - from)))
    });
    let bounds: BoundingBox = points.collect();
    [bounds.min - size, bounds.max + size]
}

/// A view with the drawn curves and the lines of the solid.
struct Compared<'a> {
    view: &'a View,
    lines: &'a [Outline],
    shown: Nearby,
    drawn: Nearby,
    scene: &'a Scene<'a>,
    eye: Eye,
    options: &'a ReprojectionOptions,
}

/// A sample point of a polygon.
struct Sample {
    /// Arc length from the start of the polygon.
    arc_length: f64,
    /// Length of the part that the sample represents.
    length: f64,
}

/// A polygon with the arc length at each of its points.
struct Chain {
    points: Vec<[f64; 2]>,
    arc_lengths: Vec<f64>,
}

impl Chain {
    fn new(points: Vec<[f64; 2]>) -> Self {
        let mut arc_lengths = vec![0.0];
        for p in points.windows(2) {
            arc_lengths
                .push(arc_lengths[arc_lengths.len() - 1] + (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1]));
        }
        Self { points, arc_lengths }
    }

    fn length(&self) -> f64 {
        self.arc_lengths[self.arc_lengths.len() - 1]
    }

    /// The straight piece at an arc length, and the share of it there.
    fn place(&self, arc_length: f64) -> (usize, f64) {
        let last = self.points.len() - 2;
        let piece = self.arc_lengths.partition_point(|w| *w <= arc_length).clamp(1, last + 1) - 1;
        let length = self.arc_lengths[piece + 1] - self.arc_lengths[piece];
        let share = if length > 0.0 { (arc_length - self.arc_lengths[piece]) / length } else { 0.0 };
        (piece, share.clamp(0.0, 1.0))
    }

    fn point(&self, arc_length: f64) -> [f64; 2] {
        let (piece, share) = self.place(arc_length);
        let [a, b] = [self.points[piece], self.points[piece + 1]];
        [0, 1].map(|k| a[k] + share * (b[k] - a[k]))
    }

    fn samples(&self, spacing: f64) -> Vec<Sample> {
        let n = (self.length() / spacing).ceil().max(1.0);
        (0..n as usize)
            // Not in the middle: symmetric parts have crossings there.
            .map(|k| Sample { arc_length: self.length() * (k as f64 + 0.42) / n, length: self.length() / n })
            .collect()
    }
}

/// Differences of a line by kind: positions and total length.
#[derive(Default)]
struct Differences(Vec<(Difference, Vec<[f64; 2]>, f64)>);

impl Differences {
    fn add(&mut self, difference: Difference, at: [f64; 2], length: f64) {
        match self.0.iter_mut().find(|d| d.0 == difference) {
            Some(known) => {
                known.1.push(at);
                known.2 += length;
            }
            None => self.0.push((difference, vec![at], length)),
        }
    }
}

impl<'a> Compared<'a> {
    fn new(
        view: &'a View,
        lines: &'a [Outline],
        scene: &'a Scene<'a>,
        eye: Eye,
        options: &'a ReprojectionOptions,
    ) -> Self {
        let size = scene.size;
        // Chord errors of drawn arcs are a twentieth of the tolerance, so they do not cause differences.
        let shown = pieces(lines.iter().map(|line| projected(line, eye)));
        let drawn = pieces(view.curves.iter().map(|c| drawn_points(&c.curve, 0.05 * options.near * size)));
        let (near, side) = (options.near * size, 0.02 * size);
        Self {
            view,
            lines,
            shown: Nearby::new(shown, near, side),
            drawn: Nearby::new(drawn, near, side),
            scene,
            eye,
            options,
        }
    }

    /// Drawn curves that the solid does not show in their style.
    fn drawn_but_not_shown(&self) -> Vec<Disagreement> {
        let mut found = Vec::new();
        for curve in &self.view.curves {
            let chain = Chain::new(drawn_points(&curve.curve, 0.05 * self.options.near * self.scene.size));
            let mut differences = Differences::default();
            self.add_differences(&chain, &mut differences, |arc_length| {
                let near: Vec<_> = self.shown.at(chain.point(arc_length)).collect();
                if self.eye.is_section() && self.is_cut_border(&chain, arc_length) {
                    return None;
                }
                match curve.style {
                    style if near.is_empty() => Some(Difference::NotShown(style)),
                    // Several edges may have the same image, so a hidden line over a visible edge is no
                    // contradiction here. If no visible line is drawn there, the other direction finds it.
                    LineStyle::Hidden => None,
                    LineStyle::Visible => {
                        (!near.iter().any(|(piece, share, _)| self.is_seen(piece.line, piece.index, *share)))
                            .then_some(Difference::IsHidden)
                    }
                }
            });
            found.extend(self.named(differences, Some(&curve.entity)));
        }
        found
    }

    /// Lines of the solid that are not drawn in the style in which they are seen.
    fn shown_but_not_drawn(&self) -> Vec<Disagreement> {
        // By group, so that an outline in many parts is one line in the result; ordered, so that results do
        // not depend on hashing.
        let mut found: BTreeMap<usize, Differences> = BTreeMap::new();
        for (index, line) in self.lines.iter().enumerate().filter(|(_, l)| l.is_required) {
            let chain = Chain::new(projected(line, self.eye));
            let differences = found.entry(line.group).or_default();
            self.add_differences(&chain, differences, |arc_length| {
                let near = self.drawn.at(chain.point(arc_length));
                let styles: Vec<LineStyle> =
                    near.map(|(piece, ..)| self.view.curves[piece.line].style).collect();
                if styles.contains(&LineStyle::Visible) {
                    return None;
                }
                let (piece, share) = chain.place(arc_length);
                match (self.is_seen(index, piece, share), styles.is_empty()) {
                    (true, false) => Some(Difference::IsVisible),
                    (true, true) => Some(Difference::NotDrawn(LineStyle::Visible)),
                    (false, true) if !self.view.shows_hidden_edges() => None,
                    (false, true) => Some(Difference::NotDrawn(LineStyle::Hidden)),
                    (false, false) => None,
                }
            });
        }
        found.into_values().flat_map(|differences| self.named(differences, None)).collect()
    }

    /// Tests the sample points of a line. A difference at a point counts only if there is one on both sides
    /// of it, too: single points differ where lines cross or where visibility changes.
    fn add_differences(
        &self,
        chain: &Chain,
        differences: &mut Differences,
        difference_at: impl Fn(f64) -> Option<Difference>,
    ) {
        let (size, length) = (self.scene.size, chain.length());
        // A line along the line of sight is a point in the view.
        if length < 1e-3 * self.options.shortest * size {
            return;
        }
        // A difference at three points spans at least the shortest length that is reported. Short lines are
        // compared at points nearer to each other.
        let offset = (0.5 * self.options.shortest * size).min(0.4 * length);
        for sample in chain.samples(self.options.spacing * size) {
            let Some(difference) = difference_at(sample.arc_length) else { continue };
            let sides = [sample.arc_length - offset, sample.arc_length + offset];
            if sides.iter().all(|arc_length| difference_at(arc_length.clamp(0.0, length)).is_some()) {
                differences.add(difference, chain.point(sample.arc_length), sample.length);
            }
        }
    }

    /// The differences of a line that are long enough to report.
    fn named<'b>(
        &'b self,
        differences: Differences,
        entity: Option<&'b String>,
    ) -> impl Iterator<Item = Disagreement> + 'b {
        let shortest = self.options.shortest * self.scene.size;
        let long = differences.0.into_iter().filter(move |d| d.2 >= shortest);
        long.map(move |(difference, places, _)| Disagreement {
            view: self.view.kind,
            entity: entity.cloned(),
            places,
            difference,
        })
    }

    /// True if a drawn curve of a section is the border of the material that is cut, or of two bodies.
    fn is_cut_border(&self, chain: &Chain, arc_length: f64) -> bool {
        let (piece, _) = chain.place(arc_length);
        let [a, b] = [chain.points[piece], chain.points[piece + 1]];
        let length = (b[0] - a[0]).hypot(b[1] - a[1]).max(f64::MIN_POSITIVE);
        let (p, near) = (chain.point(arc_length), self.options.near * self.scene.size);
        let cut_body = |sign: f64| {
            let off = sign * near / length;
            self.scene.cut_body(self.eye, [p[0] - off * (b[1] - a[1]), p[1] + off * (b[0] - a[0])])
        };
        cut_body(1.0) != cut_body(-1.0)
    }

    /// True if a line of the solid is visible at a point of it.
    fn is_seen(&self, line: usize, piece: usize, share: f64) -> bool {
        let [a, b] = [self.lines[line].points[piece], self.lines[line].points[piece + 1]];
        let p = a + share * (b - a);
        let [from, to] = [self.eye.seen(a), self.eye.seen(b)];
        let d = [to[0] - from[0], to[1] - from[1]];
        let length = d[0].hypot(d[1]);
        // A piece along the line of sight has no direction in the view; any one serves.
        let across = if length > 0.0 { [-d[1] / length, d[0] / length] } else { [1.0, 0.0] };
        self.scene.is_visible(self.eye, p, across)
    }
}

fn pieces(lines: impl Iterator<Item = Vec<[f64; 2]>>) -> Vec<Piece> {
    let of_line = |(line, points): (usize, Vec<[f64; 2]>)| -> Vec<Piece> {
        let ends = points.windows(2).map(|p| [p[0], p[1]]);
        ends.enumerate().map(|(index, ends)| Piece { ends, line, index }).collect()
    };
    lines.enumerate().flat_map(of_line).collect()
}

pub(super) fn projected(line: &Outline, eye: Eye) -> Vec<[f64; 2]> {
    line.points.iter().map(|p| eye.seen(*p)).collect()
}

/// Points along a drawn curve, with a chord error of at most `chord` on arcs.
fn drawn_points(curve: &Curve2, chord: f64) -> Vec<[f64; 2]> {
    let Curve2::Arc { center, radius, start, sweep } = curve else {
        return curve.points();
    };
    // A chord over the angle θ has the error r (1 − cos θ/2). The bound of a half keeps the step below 120°.
    let step = 2.0 * (1.0 - (chord / radius).min(0.5)).acos();
    let n = (sweep / step).ceil().clamp(2.0, 10_000.0) as usize;
    (0..=n)
        .map(|k| {
            let (sin, cos) = (start + sweep * k as f64 / n as f64).sin_cos();
            [center[0] + radius * cos, center[1] + radius * sin]
        })
        .collect()
}
