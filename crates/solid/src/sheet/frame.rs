//! Frames, title blocks and tables.

use super::groups::{is_within, joined_box};
use super::{Projection, SetAsideReason, SheetBox, SheetReader};
use crate::drawing::{Curve2, LineStyle};
use std::f64::consts::TAU;

/// Maximum number of rectangles within each other: border, frame, and marks.
const MAX_FRAMES: usize = 4;
/// Share of each side of a frame that lines must cover. Folding marks and centring marks interrupt none.
const COVERED: f64 = 0.9;
/// Share of the outer frame's sides from which on a rectangle within it is a frame, even with marks between
/// both.
const INNER_FRAME: f64 = 0.8;
/// Share of the frame's area above which a title block is no box, but lines along several sides.
const MAX_TITLE_BLOCK: f64 = 0.4;
/// Minimum number of texts and of lines of a table.
const TABLE_TEXTS: usize = 3;
const TABLE_LINES: usize = 5;

/// What frames tell about the sheet.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FoundFrame {
    /// Sides of all frames, the outermost first.
    pub sizes: Vec<[f64; 2]>,
    /// The convention that the symbol in the title block shows.
    pub projection: Option<Projection>,
}

impl SheetReader<'_> {
    /// Sets aside the frames, what touches them, and what lies in their title blocks.
    pub(super) fn set_aside_frames(&mut self) -> Option<FoundFrame> {
        let mut found: Option<FoundFrame> = None;
        for _ in 0..MAX_FRAMES {
            let outer = found.as_ref().and_then(|f| f.sizes.last()).copied();
            let Some((curves, rectangle)) = self.outermost_rectangle(outer) else { break };
            let projection = self.set_aside_title_blocks(&curves, &rectangle);
            self.set_aside(curves, SetAsideReason::Frame);
            // Marks between two frames.
            let outside: Vec<usize> = (0..self.curves.len())
                .filter(|k| self.is_left(*k) && !is_within(&self.boxes[*k], &rectangle, self.near))
                .collect();
            self.set_aside(outside, SetAsideReason::Frame);
            let frame = found.get_or_insert(FoundFrame { sizes: Vec::new(), projection: None });
            frame.sizes.push(rectangle.map(|side| side[1] - side[0]));
            frame.projection = frame.projection.or(projection);
        }
        found
    }

    /// A rectangle that contains all curves but those connected with it, and these curves.
    fn outermost_rectangle(&self, outer: Option<[f64; 2]>) -> Option<(Vec<usize>, SheetBox)> {
        let mut is_seen = vec![false; self.curves.len()];
        let mut long: Vec<usize> = (0..self.curves.len()).filter(|k| self.is_left(*k)).collect();
        let extent = |k: usize| self.boxes[k].iter().map(|s| s[1] - s[0]).fold(0.0, f64::max);
        long.sort_by(|a, b| extent(*b).total_cmp(&extent(*a)));
        for start in long {
            if is_seen[start] || self.level(start).is_none() {
                continue;
            }
            let connected = self.contacts.connected([start], |k| self.is_left(k));
            connected.iter().for_each(|k| is_seen[*k] = true);
            let Some(rectangle) = self.rectangle_of(&connected) else { continue };
            let others =
                (0..self.curves.len()).filter(|k| self.is_left(*k) && connected.binary_search(k).is_err());
            let (inside, outside): (Vec<usize>, Vec<usize>) =
                others.partition(|k| is_within(&self.boxes[*k], &rectangle, self.near));
            let is_inner = outer.is_some_and(|outer| {
                (0..2).all(|k| rectangle[k][1] - rectangle[k][0] > INNER_FRAME * outer[k])
            });
            if (outside.is_empty() || is_inner) && inside.len() >= 2 {
                return Some((connected, rectangle));
            }
        }
        None
    }

    /// Axis and position of a line that is parallel to an axis: 0 for a vertical line at an x.
    fn level(&self, curve: usize) -> Option<(usize, f64)> {
        let Curve2::Segment(a, b) = &self.curves[curve].curve else { return None };
        (0..2).find(|k| (a[*k] - b[*k]).abs() <= self.near).map(|k| (k, 0.5 * (a[k] + b[k])))
    }

    /// The largest rectangle whose sides are covered by lines of these curves.
    fn rectangle_of(&self, curves: &[usize]) -> Option<SheetBox> {
        let bounds = joined_box(curves.iter().map(|k| self.boxes[*k]));
        let mut sides = [[0.0; 2]; 2];
        for (axis, side) in sides.iter_mut().enumerate() {
            let along = 1 - axis;
            let mut lines: Vec<(f64, f64)> = (curves.iter())
                .filter_map(|k| Some((self.level(*k).filter(|(own, _)| *own == axis)?.1, *k)))
                .map(|(at, k)| (at, self.boxes[k][along][1] - self.boxes[k][along][0]))
                .collect();
            lines.sort_by(|a, b| a.0.total_cmp(&b.0));
            let long_lines = lines.chunk_by(|a, b| b.0 - a.0 <= self.near).filter(|same| {
                let length: f64 = same.iter().map(|line| line.1).sum();
                length >= 0.5 * (bounds[along][1] - bounds[along][0])
            });
            let places: Vec<f64> = long_lines.map(|same| same[0].0).collect();
            *side = [*places.first()?, *places.last()?];
        }
        let is_covered = |axis: usize, at: f64| {
            let along = 1 - axis;
            let [from, to] = sides[along];
            let on = curves.iter().filter(|k| {
                self.level(**k)
                    .is_some_and(|(own, place)| own == axis && (place - at).abs() <= 2.0 * self.near)
            });
            let length: f64 = on
                .map(|k| (self.boxes[*k][along][1].min(to) - self.boxes[*k][along][0].max(from)).max(0.0))
                .sum();
            length >= COVERED * (to - from)
        };
        let has_area = sides.iter().all(|s| s[1] - s[0] > 10.0 * self.near);
        (has_area && (0..2).all(|axis| sides[axis].iter().all(|at| is_covered(axis, *at)))).then_some(sides)
    }

    /// Sets aside the lines within a frame that are connected with it, and all curves between them. Returns
    /// the convention that a projection symbol between them shows.
    fn set_aside_title_blocks(&mut self, frame: &[usize], rectangle: &SheetBox) -> Option<Projection> {
        let is_side = |k: usize| {
            self.level(k).is_some_and(|(axis, at)| {
                rectangle[axis].iter().any(|side| (side - at).abs() <= 2.0 * self.near)
            })
        };
        let mut inner: Vec<usize> = frame.iter().copied().filter(|k| !is_side(*k)).collect();
        let mut found = None;
        while let Some(start) = inner.last().copied() {
            let block = self.contacts.connected([start], |k| inner.contains(&k));
            inner.retain(|k| block.binary_search(k).is_err());
            let bounds = joined_box(block.iter().map(|k| self.boxes[*k]));
            let area = |sides: &SheetBox| (sides[0][1] - sides[0][0]) * (sides[1][1] - sides[1][0]);
            if block.len() < 2 || area(&bounds) > MAX_TITLE_BLOCK * area(rectangle) {
                continue;
            }
            found = found.or(self.set_aside_block(&block, &bounds));
        }
        found
    }

    fn set_aside_block(&mut self, block: &[usize], bounds: &SheetBox) -> Option<Projection> {
        let within: Vec<usize> = (0..self.curves.len())
            .filter(|k| self.is_left(*k) && is_within(&self.boxes[*k], bounds, self.near))
            .filter(|k| block.binary_search(k).is_err())
            .collect();
        let projection = self.projection_symbol(&within);
        self.set_aside(block.iter().copied(), SetAsideReason::TitleBlock);
        self.set_aside(within, SetAsideReason::TitleBlock);
        projection
    }

    /// Sets aside tables that touch no frame: connected lines parallel to the axes with texts between them.
    pub(super) fn set_aside_tables(&mut self) {
        let mut is_seen = vec![false; self.curves.len()];
        for start in 0..self.curves.len() {
            if is_seen[start] || !self.is_left(start) || self.annotations.texts.len() < TABLE_TEXTS {
                continue;
            }
            let lines = self.contacts.connected([start], |k| self.is_left(k));
            lines.iter().for_each(|k| is_seen[*k] = true);
            let is_line = |k: &usize| self.level(*k).is_some() && self.curves[*k].style == LineStyle::Visible;
            let bounds = joined_box(lines.iter().map(|k| self.boxes[*k]));
            let has = |p: [f64; 2]| is_within(&p.map(|x| [x, x]), &bounds, 0.0);
            let texts = self.annotations.texts.iter().filter(|text| has(text.at)).count();
            if lines.len() >= TABLE_LINES
                && texts >= TABLE_TEXTS
                && 3 * texts >= lines.len()
                && lines.iter().all(is_line)
            {
                self.set_aside_block(&lines, &bounds);
            }
        }
    }

    /// The convention that a truncated cone in two views shows: two concentric circles, and a trapezoid whose
    /// narrow side they show in front.
    fn projection_symbol(&self, curves: &[usize]) -> Option<Projection> {
        let mut circles: Vec<([f64; 2], f64)> = Vec::new();
        let mut verticals: Vec<(f64, f64)> = Vec::new();
        for &k in curves {
            match &self.curves[k].curve {
                Curve2::Arc { center, radius, sweep, .. } if *sweep > TAU - 1e-6 => {
                    circles.push((*center, *radius))
                }
                Curve2::Segment(a, b) if (a[0] - b[0]).abs() <= self.near => {
                    verticals.push((a[0], (a[1] - b[1]).abs()));
                }
                _ => {}
            }
        }
        let (center, radius) = *circles.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let inner =
            circles.iter().find(|(c, r)| *r < 0.9 * radius && (c[0] - center[0]).abs() < 0.1 * radius)?;
        // The cone's sides are as long as the diameters of the circles.
        let side = |r: f64| {
            verticals.iter().filter(|(_, length)| (length - 2.0 * r).abs() < 0.1 * r).map(|(x, _)| *x).next()
        };
        let (narrow, wide) = (side(inner.1)?, side(radius)?);
        let is_seen_from_left = narrow < wide;
        let is_at_right = center[0] > narrow.max(wide);
        Some(match is_seen_from_left == is_at_right {
            true => Projection::FirstAngle,
            false => Projection::ThirdAngle,
        })
    }
}
