//! Dashed lines and centre lines from single dashes.
//!
//! Dashes of a line have gaps of one length, and their ends are free: no other stroke ends there. So rows of
//! equal edges with gaps between them, such as those of a comb, are not taken for dashes.

use super::{Accuracy, PointGrid, Stroke, ends};
use planish_solid::views::{Curve2, LineStyle, distance, nearest_on_curve};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Relative tolerance of lengths of gaps and dashes.
const SAME_LENGTH: f64 = 0.03;
/// Ratio of dashes from which on a line alternates.
const ALTERNATING: f64 = 1.5;
/// Maximum ratio of a gap to the longer dash beside it (ISO 128-2: dashed spaced lines have 1.5).
const GAP_RATIO: f64 = 2.0;
/// Maximum angle between dashes of a straight line, in radians.
const SAME_DIRECTION: f64 = 2e-3;
/// Lines and curves whose ends are compared with each other; more would take long.
const MAX_COMPARED: usize = 100_000_000;

/// Dashes in their order; true for one that is drawn backwards.
type Row = Vec<(usize, bool)>;

/// A dashed line.
struct Dashed {
    curve: Curve2,
    gap: f64,
    dash: f64,
    is_centre_line: bool,
}

/// Replaces dashes by hidden lines; returns the strokes, and the number of centre lines that were left out.
pub(crate) fn join_dashes(strokes: Vec<Stroke>, accuracy: &Accuracy) -> (Vec<Stroke>, usize) {
    let joiner = Joiner::new(&strokes, accuracy);
    let rows: Vec<Row> = joiner.rows().into_iter().flat_map(|row| joiner.with_equal_gaps(row)).collect();
    let mut found: Vec<Option<Dashed>> = rows.iter().map(|row| joiner.dashed(row)).collect();
    // Two dashes are a line only if their gap is that of other lines of the pen.
    let mut known: BTreeMap<u32, Vec<(f64, f64)>> = BTreeMap::new();
    for (row, dashed) in rows.iter().zip(&found) {
        if let Some(dashed) = dashed.as_ref().filter(|d| !d.is_centre_line) {
            known.entry(strokes[row[0].0].pen).or_default().push((dashed.gap, dashed.dash));
        }
    }
    for (row, dashed) in rows.iter().zip(&mut found) {
        let known = known.get(&strokes[row[0].0].pen).map_or(&[][..], |all| all);
        if dashed.is_none() && row.len() == 2 {
            *dashed = joiner.short(row, known);
        }
    }
    let mut by_first: BTreeMap<usize, (&Row, Dashed)> = BTreeMap::new();
    let mut is_used = vec![false; strokes.len()];
    for (row, dashed) in rows.iter().zip(found) {
        if let Some(dashed) = dashed {
            row.iter().for_each(|(k, _)| is_used[*k] = true);
            by_first.insert(row.iter().map(|(k, _)| *k).min().unwrap_or(0), (row, dashed));
        }
    }
    let is_hidden = joiner.hidden_pens(&is_used, &known);
    let centre_lines = by_first.values().filter(|(_, dashed)| dashed.is_centre_line).count();
    let mut joined = Vec::new();
    let mut gaps = Vec::new();
    for (k, stroke) in strokes.iter().enumerate() {
        let mut own = stroke.clone();
        match by_first.get(&k) {
            Some((_, dashed)) if dashed.is_centre_line => continue,
            Some((row, dashed)) => {
                own.drawn.entity = format!("{} ({} dashes)", own.drawn.entity, row.len());
                own.drawn.style = LineStyle::Hidden;
                own.drawn.curve = dashed.curve.clone();
                gaps.push((joined.len(), dashed.gap));
            }
            None if is_used[k] => continue,
            None if is_hidden(k) => own.drawn.style = LineStyle::Hidden,
            None => {}
        }
        joined.push(own);
    }
    extend_to_others(&mut joined, &gaps, accuracy);
    (joined, centre_lines)
}

struct Joiner<'a> {
    strokes: &'a [Stroke],
    accuracy: &'a Accuracy,
    lengths: Vec<f64>,
    /// Ends of all strokes, numbered 2 k and 2 k + 1.
    places: Vec<[f64; 2]>,
    grid: PointGrid,
}

impl<'a> Joiner<'a> {
    fn new(strokes: &'a [Stroke], accuracy: &'a Accuracy) -> Self {
        let places: Vec<[f64; 2]> = strokes.iter().flat_map(|s| ends(&s.drawn.curve)).collect();
        let grid = PointGrid::new(
            0.5 * accuracy.longest_gap,
            places.iter().enumerate().map(|(k, p)| (k as u32, *p)),
        );
        let length = |stroke: &Stroke| match &stroke.drawn.curve {
            Curve2::Arc { radius, sweep, .. } => radius * sweep,
            other => other.length(),
        };
        Self { strokes, accuracy, lengths: strokes.iter().map(length).collect(), places, grid }
    }

    /// Direction in which a stroke would go on beyond one of its ends.
    fn outwards(&self, end: usize) -> [f64; 2] {
        let is_last = end % 2 == 1;
        match &self.strokes[end / 2].drawn.curve {
            Curve2::Arc { start, sweep, .. } => match is_last {
                true => [-(start + sweep).sin(), (start + sweep).cos()],
                false => [start.sin(), -start.cos()],
            },
            curve => {
                let points = curve.points();
                let n = points.len();
                let (from, to) =
                    if is_last { (points[n - 2], points[n - 1]) } else { (points[1], points[0]) };
                let length = distance(from, to).max(f64::MIN_POSITIVE);
                [(to[0] - from[0]) / length, (to[1] - from[1]) / length]
            }
        }
    }

    /// Whether another stroke ends at an end.
    fn has_contact(&self, end: usize) -> bool {
        let p = self.places[end];
        let reach = 2.0 * self.accuracy.position;
        self.grid.around(p, reach).any(|(k, q)| k as usize / 2 != end / 2 && distance(p, q) <= reach)
    }

    fn may_be_dash(&self, stroke: usize) -> bool {
        let drawn = &self.strokes[stroke].drawn;
        drawn.style == LineStyle::Visible && !matches!(drawn.curve, Curve2::Chain(_))
    }

    /// The end of the next dash beyond an end.
    fn next(&self, end: usize) -> Option<usize> {
        let own = end / 2;
        if !self.may_be_dash(own) || self.has_contact(end) {
            return None;
        }
        let (p, along) = (self.places[end], self.outwards(end));
        let mut nearest: Option<(f64, usize)> = None;
        for (other, q) in self.grid.around(p, self.accuracy.longest_gap) {
            let (other, step) = (other as usize, [q[0] - p[0], q[1] - p[1]]);
            let gap = step[0] * along[0] + step[1] * along[1];
            let longer = self.lengths[own].max(self.lengths[other / 2]);
            if other / 2 == own
                || self.strokes[other / 2].pen != self.strokes[own].pen
                || !self.may_be_dash(other / 2)
                || gap <= 2.0 * self.accuracy.position
                || gap > self.accuracy.longest_gap.min(GAP_RATIO * longer)
                || nearest.is_some_and(|(nearest, _)| nearest <= gap)
                || !self.are_on_one_curve(end, other)
            {
                continue;
            }
            nearest = Some((gap, other));
        }
        nearest.map(|(_, other)| other).filter(|other| !self.has_contact(*other))
    }

    /// Whether the strokes of two ends lie on one line or circle, and go on towards each other.
    fn are_on_one_curve(&self, end: usize, other: usize) -> bool {
        let (p, q) = (self.places[end], self.places[other]);
        let (u, v) = (self.outwards(end), self.outwards(other));
        let near = 2.0 * self.accuracy.position;
        match (&self.strokes[end / 2].drawn.curve, &self.strokes[other / 2].drawn.curve) {
            (Curve2::Arc { center: c, radius: r, .. }, Curve2::Arc { center: d, radius: s, .. }) => {
                // The error of the centre grows with the radius over the length.
                let share = r / self.lengths[end / 2].min(self.lengths[other / 2]).max(near);
                let near = near * (1.0 + share * share);
                distance(*c, *d) <= near && (r - s).abs() <= near && u[0] * v[0] + u[1] * v[1] < 0.0
            }
            (Curve2::Segment(..), Curve2::Segment(..)) => {
                let step = [q[0] - p[0], q[1] - p[1]];
                let turn = near / self.lengths[end / 2].min(self.lengths[other / 2]) + SAME_DIRECTION;
                let off = (u[0] * step[1] - u[1] * step[0]).abs();
                off <= near + turn.min(0.05) * step[0].hypot(step[1])
                    && u[0] * v[0] + u[1] * v[1] < 0.0
                    && (u[0] * v[1] - u[1] * v[0]).abs() <= turn.min(0.2)
            }
            _ => false,
        }
    }

    /// Rows of strokes that are each other's next.
    fn rows(&self) -> Vec<Row> {
        let next: Vec<Option<usize>> = (0..self.places.len()).map(|end| self.next(end)).collect();
        let linked: Vec<Option<usize>> =
            (0..next.len()).map(|end| next[end].filter(|other| next[*other] == Some(end))).collect();
        let mut is_used = vec![false; self.strokes.len()];
        let mut rows = Vec::new();
        // Open rows first, from an end without a next dash; then closed ones.
        for is_closed in [false, true] {
            for k in 0..self.strokes.len() {
                let first = [2 * k, 2 * k + 1].into_iter().find(|end| is_closed || linked[*end].is_none());
                let Some(first) = first.filter(|_| !is_used[k] && self.may_be_dash(k)) else { continue };
                let mut row = Row::new();
                // The row goes on at the other end of the stroke.
                let mut at = first;
                loop {
                    let stroke = at / 2;
                    if std::mem::replace(&mut is_used[stroke], true) {
                        break;
                    }
                    row.push((stroke, at % 2 == 1));
                    match linked[at ^ 1] {
                        Some(other) => at = other,
                        None => break,
                    }
                }
                rows.push(row);
            }
        }
        rows
    }

    /// First and last point of a dash in its row.
    fn ends_in_row(&self, (stroke, is_backwards): (usize, bool)) -> [[f64; 2]; 2] {
        let [a, b] = [self.places[2 * stroke], self.places[2 * stroke + 1]];
        if is_backwards { [b, a] } else { [a, b] }
    }

    fn gaps(&self, row: &Row) -> Vec<f64> {
        row.windows(2)
            .map(|pair| distance(self.ends_in_row(pair[0])[1], self.ends_in_row(pair[1])[0]))
            .collect()
    }

    fn is_same(&self, a: f64, b: f64) -> bool {
        (a - b).abs() <= SAME_LENGTH * a.max(b) + 4.0 * self.accuracy.position
    }

    /// Parts of a row between gaps of other lengths.
    fn with_equal_gaps(&self, row: Row) -> Vec<Row> {
        let gaps = self.gaps(&row);
        let mut sorted = gaps.clone();
        sorted.sort_by(f64::total_cmp);
        let Some(median) = sorted.get(sorted.len() / 2).copied() else { return vec![row] };
        let mut parts = vec![Row::new()];
        for (k, dash) in row.into_iter().enumerate() {
            if k > 0 && !self.is_same(gaps[k - 1], median) {
                parts.push(Row::new());
            }
            if let Some(part) = parts.last_mut() {
                part.push(dash);
            }
        }
        parts
    }

    /// The line of three or more dashes.
    fn dashed(&self, row: &Row) -> Option<Dashed> {
        if row.len() < 3 {
            return None;
        }
        let lengths: Vec<f64> = row.iter().map(|(k, _)| self.lengths[*k]).collect();
        let inner = &lengths[1..lengths.len() - 1];
        let (shortest, longest) =
            inner.iter().fold((f64::MAX, 0.0_f64), |(lo, hi), l| (lo.min(*l), hi.max(*l)));
        let outer = lengths[0].max(lengths[lengths.len() - 1]);
        let gap = self.gaps(row)[0];
        let all_same = inner.iter().all(|l| self.is_same(*l, longest));
        if all_same && (outer <= longest || self.is_same(outer, longest)) {
            return Some(Dashed { curve: self.curve(row), gap, dash: longest, is_centre_line: false });
        }
        // Long and short dashes in turn; the outer ones may be cut.
        let alternates = inner.windows(3).all(|l| self.is_same(l[0], l[2]));
        let is_centre_line = alternates && outer.max(longest) > ALTERNATING * shortest;
        is_centre_line.then(|| Dashed { curve: self.curve(row), gap, dash: longest, is_centre_line })
    }

    /// The line of two dashes with a known gap.
    fn short(&self, row: &Row, known: &[(f64, f64)]) -> Option<Dashed> {
        let (gap, longest) =
            (self.gaps(row)[0], row.iter().map(|(k, _)| self.lengths[*k]).fold(0.0, f64::max));
        let fits = |(known, dash): &&(f64, f64)| {
            self.is_same(gap, *known) && (longest <= *dash || self.is_same(longest, *dash))
        };
        let (gap, dash) = *known.iter().find(fits)?;
        Some(Dashed { curve: self.curve(row), gap, dash, is_centre_line: false })
    }

    /// The curve from the first to the last dash.
    fn curve(&self, row: &Row) -> Curve2 {
        let (first, last) = (row[0], row[row.len() - 1]);
        let longest =
            row.iter().map(|(k, _)| *k).max_by(|a, b| self.lengths[*a].total_cmp(&self.lengths[*b]));
        let [begin, end] = [self.ends_in_row(first)[0], self.ends_in_row(last)[1]];
        match longest.map(|k| &self.strokes[k].drawn.curve) {
            Some(Curve2::Arc { center, radius, .. }) => {
                let (center, radius) = (*center, *radius);
                // Arcs run counter-clockwise, a row perhaps not.
                let (from, to) = if first.1 { (end, begin) } else { (begin, end) };
                let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
                let covered: f64 = row.iter().map(|(k, _)| self.lengths[*k]).sum::<f64>()
                    + self.gaps(row).iter().sum::<f64>();
                let gap = self.gaps(row).first().copied().unwrap_or(0.0);
                let sweep = (angle(to) - angle(from)).rem_euclid(TAU);
                // The last gap of a full circle lies between its ends.
                if TAU * radius - covered <= 1.1 * gap {
                    return Curve2::Arc { center, radius, start: 0.0, sweep: TAU };
                }
                Curve2::Arc { center, radius, start: angle(from), sweep }
            }
            _ => Curve2::Segment(begin, end),
        }
    }

    /// Pens that draw nothing but dashes: lines shorter than a dash are dashed lines, too.
    fn hidden_pens(
        &self,
        is_used: &[bool],
        known: &BTreeMap<u32, Vec<(f64, f64)>>,
    ) -> impl Fn(usize) -> bool + use<> {
        let mut longest: BTreeMap<u32, f64> = known
            .iter()
            .map(|(pen, all)| (*pen, all.iter().map(|(_, dash)| *dash).fold(0.0, f64::max)))
            .collect();
        for (k, stroke) in self.strokes.iter().enumerate() {
            if let Some(dash) = longest.get(&stroke.pen)
                && !is_used[k]
                && self.lengths[k] > *dash
                && !self.is_same(self.lengths[k], *dash)
            {
                longest.remove(&stroke.pen);
            }
        }
        let pens: Vec<u32> = self.strokes.iter().map(|s| s.pen).collect();
        move |k| longest.contains_key(&pens[k])
    }
}

/// A line may end within a gap. Then it is extended to the next line, at most by the gap.
fn extend_to_others(strokes: &mut [Stroke], gaps: &[(usize, f64)], accuracy: &Accuracy) {
    if gaps.len().saturating_mul(strokes.len()) > MAX_COMPARED {
        return;
    }
    let others = strokes.to_vec();
    for &(at, gap) in gaps {
        let curve = &others[at].drawn.curve;
        let mut extended = curve.clone();
        for is_last in [false, true] {
            let end = ends(curve)[usize::from(is_last)];
            let beside = || others.iter().enumerate().filter(|(k, _)| *k != at).map(|(_, s)| &s.drawn.curve);
            let near = 2.0 * accuracy.position;
            if beside().any(|c| distance(nearest_on_curve(c, end), end) <= near) {
                continue;
            }
            let reach = (1.0 + SAME_LENGTH) * gap + near;
            match &mut extended {
                Curve2::Segment(a, b) => {
                    let (from, to) = if is_last { (*a, *b) } else { (*b, *a) };
                    let length = distance(from, to);
                    let along = [0, 1].map(|k| (to[k] - from[k]) / length);
                    let steps = beside().filter_map(|c| first_crossing(end, along, reach, c));
                    if let Some(step) = steps.min_by(f64::total_cmp) {
                        let p = [0, 1].map(|k| end[k] + step * along[k]);
                        if is_last { *b = p } else { *a = p }
                    }
                }
                Curve2::Arc { center, radius, start, sweep } if *sweep < TAU => {
                    let (c, r, s, w) = (*center, *radius, *start, *sweep);
                    let on_circle = |p: &[f64; 2]| (distance(*p, c) - r).abs() <= 4.0 * near;
                    let beyond = |p: [f64; 2]| {
                        let angle = (p[1] - c[1]).atan2(p[0] - c[0]);
                        if is_last { (angle - s - w).rem_euclid(TAU) } else { (s - angle).rem_euclid(TAU) }
                    };
                    let steps =
                        beside().flat_map(ends).filter(on_circle).map(beyond).filter(|a| a * r <= reach);
                    if let Some(step) = steps.min_by(f64::total_cmp) {
                        *start -= if is_last { 0.0 } else { step };
                        *sweep = (*sweep + step).min(TAU);
                    }
                }
                _ => {}
            }
        }
        strokes[at].drawn.curve = extended;
    }
}

/// The distance along a ray to a curve, if it is at most `reach`.
fn first_crossing(from: [f64; 2], along: [f64; 2], reach: f64, curve: &Curve2) -> Option<f64> {
    if let Curve2::Arc { center, radius, .. } = curve {
        let off = [center[0] - from[0], center[1] - from[1]];
        let middle = off[0] * along[0] + off[1] * along[1];
        let across = off[0] * along[1] - off[1] * along[0];
        let half = (radius * radius - across * across).max(0.0).sqrt();
        let is_on = |step: &f64| {
            let p = [0, 1].map(|k| from[k] + step * along[k]);
            (0.0..=reach).contains(step) && distance(nearest_on_curve(curve, p), p) <= 1e-6 * radius
        };
        return [middle - half, middle + half].into_iter().find(is_on);
    }
    let points = curve.points();
    let crossing = |pair: &[[f64; 2]]| {
        let d = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
        let off = [pair[0][0] - from[0], pair[0][1] - from[1]];
        let cross = along[0] * d[1] - along[1] * d[0];
        let step = (off[0] * d[1] - off[1] * d[0]) / cross;
        let share = (off[0] * along[1] - off[1] * along[0]) / cross;
        ((0.0..=reach).contains(&step) && (-1e-6..=1.0 + 1e-6).contains(&share)).then_some(step)
    };
    points.windows(2).filter_map(crossing).min_by(f64::total_cmp)
}
