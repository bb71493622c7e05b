//! Dimensions, leaders, marks and symbols: by arrowheads, and by the pens they are drawn with.
//!
//! An edge of a part ends where other edges end or cross. Extension lines, leaders and hatching lines end
//! freely. So most curves of a pen for annotations have a free end, and hardly any of a pen for edges. Pens
//! that draw both, such as thin lines, are judged curve by curve.

use super::groups::{is_within, touch};
use super::{SetAsideReason, SheetReader};
use crate::drawing::{Curve2, LineStyle, distance, nearest_on_curve};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Share of a pen's curves with a free end from which on all of them are annotations. Of a drawing with one
/// wrong line, few curves have one.
const FREE_SHARE: f64 = 0.3;
/// Maximum length of an extension line beyond the tip of an arrowhead, relative to the arrowhead.
const BEYOND_TIP: f64 = 1.2;
/// Cosine of the angle between an arrowhead and its extension line.
const ACROSS: f64 = 0.1;
/// Size of an arrowhead, relative to which its tip and its foot meet a line.
const ARROW_REACH: f64 = 0.2;

impl SheetReader<'_> {
    /// Sets aside dimensions, leaders, marks and symbols.
    pub(super) fn set_aside_annotations(&mut self) {
        self.set_aside_arrows();
        let Some(main) = self.main_pen() else { return };
        let mut pens: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
        for k in self.beside(main) {
            let (all, free) = pens.entry(self.annotations.pen(k)).or_default();
            *all += 1;
            *free += usize::from(self.contacts.free_ends(k, |other| self.is_left(other)) > 0);
        }
        let draws_annotations =
            |pen: u32| pens.get(&pen).is_some_and(|(all, free)| *free as f64 >= FREE_SHARE * *all as f64);
        let of_pens: Vec<usize> =
            self.beside(main).filter(|k| draws_annotations(self.annotations.pen(*k))).collect();
        self.set_aside(of_pens, SetAsideReason::Annotation);
        let marks: Vec<usize> = self.beside(main).filter(|k| self.is_detail_mark(*k)).collect();
        self.set_aside(marks, SetAsideReason::Annotation);
        // An end that touched an annotation is free now.
        loop {
            let is_loose = |k: &usize| self.contacts.free_ends(*k, |other| self.is_left(other)) > 0;
            let loose: Vec<usize> = self.beside(main).filter(is_loose).collect();
            if loose.is_empty() {
                return;
            }
            self.set_aside(loose, SetAsideReason::Annotation);
        }
    }

    /// Visible curves of other pens that are left.
    fn beside(&self, main: u32) -> impl Iterator<Item = usize> + '_ {
        (0..self.curves.len()).filter(move |k| {
            self.is_left(*k)
                && self.curves[*k].style == LineStyle::Visible
                && self.annotations.pen(*k) != main
        })
    }

    /// The pen of the outlines: that which draws the longest visible curves without free ends.
    fn main_pen(&self) -> Option<u32> {
        let mut lengths: BTreeMap<u32, f64> = BTreeMap::new();
        for k in (0..self.curves.len()).filter(|k| self.is_left(*k)) {
            if self.curves[k].style == LineStyle::Visible
                && self.contacts.free_ends(k, |other| self.is_left(other)) == 0
            {
                *lengths.entry(self.annotations.pen(k)).or_default() += self.curves[k].curve.length();
            }
        }
        lengths.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(pen, _)| pen)
    }

    /// Sets aside curves that end at an arrowhead or carry it, and lines that only touch these.
    fn set_aside_arrows(&mut self) {
        let mut with_arrows = Vec::new();
        let mut extension_lines = Vec::new();
        for arrow in &self.annotations.arrowheads {
            // The tip is the corner opposite to the shortest side.
            let side = |k: usize| distance(arrow[(k + 1) % 3], arrow[(k + 2) % 3]);
            let tip = (0..3).min_by(|a, b| side(*a).total_cmp(&side(*b))).unwrap_or(0);
            let foot = [0, 1].map(|k| 0.5 * (arrow[(tip + 1) % 3][k] + arrow[(tip + 2) % 3][k]));
            let length = distance(arrow[tip], foot);
            let reach = ARROW_REACH * length;
            let bounds =
                [0, 1].map(|k| [arrow[tip][k].min(foot[k]) - reach, arrow[tip][k].max(foot[k]) + reach]);
            // The shaft runs through the foot, and not across it.
            for k in
                (0..self.curves.len()).filter(|k| self.is_left(*k) && touch(&self.boxes[*k], &bounds, 0.0))
            {
                let near = |p: [f64; 2]| distance(nearest_on_curve(&self.curves[k].curve, p), p) <= reach;
                let middle = [0, 1].map(|c| 0.5 * (arrow[tip][c] + foot[c]));
                if near(arrow[tip]) && self.is_extension_line(k, arrow[tip], foot) {
                    extension_lines.push(k);
                }
                if near(foot) && (near(arrow[tip]) || near(middle) || self.ends_at(k, foot, reach)) {
                    with_arrows.push(k);
                }
            }
        }
        self.set_aside(with_arrows.iter().copied(), SetAsideReason::Annotation);
        self.set_aside(extension_lines, SetAsideReason::Annotation);
        // Extension lines, and landings of leaders.
        let beside: Vec<usize> = with_arrows.iter().flat_map(|k| self.contacts.of(*k)).collect();
        let is_loose = |k: &usize| {
            matches!(self.curves[*k].curve, Curve2::Segment(..))
                && self.is_left(*k)
                && self.contacts.free_ends(*k, |other| self.is_left(other)) == 2
        };
        let loose: Vec<usize> = beside.into_iter().filter(is_loose).collect();
        self.set_aside(loose, SetAsideReason::Annotation);
    }

    /// Whether a line crosses the tip of an arrowhead and ends freely a little beyond it. Lines of dimensions
    /// may end at the foot of the arrowhead, so that they do not touch the extension line.
    fn is_extension_line(&self, curve: usize, tip: [f64; 2], foot: [f64; 2]) -> bool {
        let Curve2::Segment(a, b) = &self.curves[curve].curve else { return false };
        let (line, arrow) = ([b[0] - a[0], b[1] - a[1]], [tip[0] - foot[0], tip[1] - foot[1]]);
        let length = arrow[0].hypot(arrow[1]);
        let along = line[0] * arrow[0] + line[1] * arrow[1];
        along.abs() <= ACROSS * length * line[0].hypot(line[1])
            && self.ends_at(curve, tip, BEYOND_TIP * length)
            && self.contacts.free_ends(curve, |other| self.is_left(other)) > 0
    }

    fn ends_at(&self, curve: usize, p: [f64; 2], reach: f64) -> bool {
        let points = self.curves[curve].curve.points();
        [points.first(), points.last()].into_iter().flatten().any(|end| distance(*end, p) <= reach)
    }

    /// Whether a circle encloses a detail: it crosses other curves, and none ends at it.
    fn is_detail_mark(&self, circle: usize) -> bool {
        let Curve2::Arc { center, radius, sweep, .. } = &self.curves[circle].curve else { return false };
        if *sweep < TAU - 1e-6 || self.contacts.of(circle).any(|other| self.is_left(other)) {
            return false;
        }
        let bounds = center.map(|c| [c - radius, c + radius]);
        (0..self.curves.len()).filter(|k| *k != circle && self.is_left(*k)).any(|k| {
            let is_inside = |p: &[f64; 2]| distance(*p, *center) < *radius;
            let points = self.curves[k].curve.points();
            touch(&self.boxes[k], &bounds, 0.0)
                && !is_within(&self.boxes[k], &bounds, 0.0)
                && points.iter().any(is_inside) != points.iter().all(is_inside)
        })
    }
}
