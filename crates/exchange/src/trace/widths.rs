//! Widths of lines: on most sheets, visible lines are twice as wide as all others (ISO 128-2).
//!
//! Thin lines are hidden lines if they have dashes of one length. Chain lines (centre lines), continuous thin
//! lines (dimensions, leaders, hatching) and what is left of arrowheads belong to no view.

use super::ink::Ink;
use super::joining::max_gap;
use super::marks::PixelBox;
use super::moments::Shape;
use super::pieces::{LineScale, Piece, PieceGraph};
use planish_solid::views::distance;

/// Minimum ratio of both widths, and minimum share of the length of each.
const MIN_RATIO: f64 = 1.45;
const MIN_SHARE: f64 = 0.04;
/// Maximum number of pieces; the effort grows with its square. A dense A2 sheet has a tenth.
const MAX_PIECES: usize = 20_000;
/// Pieces shorter than this many pixels do not count for the widths.
const MIN_LENGTH: f64 = 8.0;
/// Maximum distance of pieces of one line from its direction, in pixels.
const SAME_LINE: f64 = 1.5;
/// Sine of the angle below which a thin line runs along an axis.
const ALONG_AXIS: f64 = 0.06;
/// A dash between two others of which one is so much longer is a part of a chain line.
const CHAIN_RATIO: f64 = 0.45;
/// A thin line without gaps is no dash if it is longer than the dashes of hidden lines by this factor.
const CONTINUOUS: f64 = 1.5;
/// Ratio of a gap of a hidden line to the usual one up to which dashes are joined.
const GAP_RATIO: f64 = 1.6;
/// Length of a dash if the picture has no hidden line of three dashes, in wide widths.
const USUAL_DASH: f64 = 8.0;
/// Ratio of the widths at four fifths and one fifth of an arrowhead; blur changes that of lines by a tenth.
const TAPER: f64 = 1.7;
/// Longest remainder of an arrowhead, in wide widths.
const ARROWHEAD: f64 = 8.0;
/// Largest letter, in wide widths: texts are about ten times as high as visible lines are wide (ISO 3098).
const LETTER: f64 = 12.0;
/// Share of the length of a small hole that is one circle.
const HOLE_SHARE: f64 = 0.6;
/// Bend of an arc in pixels below which its dashes may be those of a line.
const FLAT: f64 = 0.8;
/// Accuracy of the box of an outline in pixels.
const OUTSIDE: f64 = 0.5;
/// Minimum size of an outline, relative to the picture.
const MIN_OUTLINE: f64 = 0.02;

impl PieceGraph {
    /// Measures the widths of pieces in the ink before y is flipped; returns the width of wide lines if
    /// there are two widths.
    pub(super) fn measure_widths(&mut self, ink: &Ink, scale: LineScale) -> Option<f64> {
        if self.pieces.len() > MAX_PIECES {
            return None;
        }
        let ranges: Vec<[f64; 3]> = self.pieces.iter().map(|p| width_of(p, ink, scale.width)).collect();
        let widths: Vec<f64> = ranges.iter().map(|r| r[1]).collect();
        let length = |p: &Piece| p.raw.len() as f64;
        let all: Vec<(f64, f64)> = (self.pieces.iter().zip(&widths))
            .map(|(p, w)| (*w, length(p)))
            .filter(|(_, length)| *length >= MIN_LENGTH)
            .collect();
        let (limit, wide) = two_widths(all)?;
        for (piece, [low, width, high]) in self.pieces.iter_mut().zip(ranges) {
            // An arrowhead belongs to the thin line that it ends.
            let is_short = piece.raw.len() as f64 <= ARROWHEAD * wide && piece.raw.len() as f64 > 2.0 * wide;
            let is_line = matches!(piece.shape, Shape::Line(..));
            piece.is_thin = Some(width < limit || is_short && is_line && high > TAPER * low);
        }
        Some(wide)
    }

    /// Drops thin lines that are no hidden lines, and arrowheads; returns how many pieces were dropped.
    pub(super) fn drop_annotation(&mut self, wide: f64, scale: LineScale) -> usize {
        let lines = self.thin_lines(scale);
        let dash = usual_dash(&lines).unwrap_or(USUAL_DASH * wide);
        let mut dropped = Vec::new();
        for line in &lines {
            if line.is_continuous(CONTINUOUS * dash)
                || line.is_chain()
                || self.is_mark(line)
                || self.ends_in_the_open(line, scale)
            {
                dropped.extend(line.pieces.iter().copied());
            }
        }
        dropped.iter().for_each(|k| self.pieces[*k].is_dropped = true);
        lines.iter().for_each(|line| self.join_thin_line(line, scale));
        let is_continuous = |p: &Piece| {
            p.is_thin == Some(true)
                && matches!(p.shape, Shape::Circle(..))
                && p.raw.len() as f64 > CONTINUOUS * dash
        };
        dropped.extend((0..self.pieces.len()).filter(|k| is_continuous(&self.pieces[*k])));
        dropped.iter().for_each(|k| self.pieces[*k].is_dropped = true);
        // What is left of arrowheads ends freely, or only at dropped lines.
        let mut count = dropped.len();
        loop {
            let is_free = |piece: &Piece, k: usize, end: usize| {
                piece.nodes[end].is_none_or(|node| {
                    self.members[node].iter().all(|other| *other == k || self.pieces[*other].is_dropped)
                })
            };
            let is_rest = |k: &usize| {
                let piece = &self.pieces[*k];
                !piece.is_dropped
                    && !piece.is_closed
                    && piece.is_thin == Some(false)
                    && piece.raw.len() as f64 <= ARROWHEAD * wide
                    && (0..2).any(|end| is_free(piece, *k, end))
            };
            let rests: Vec<usize> = (0..self.pieces.len()).filter(is_rest).collect();
            if rests.is_empty() {
                break;
            }
            count += rests.len();
            rests.iter().for_each(|k| self.pieces[*k].is_dropped = true);
        }
        count += self.drop_letters(wide);
        for members in &mut self.members {
            members.retain(|k| !self.pieces[*k].is_dropped);
        }
        count
    }

    /// Joins the dashes of a hidden line, but not over gaps larger than its usual one.
    fn join_thin_line(&mut self, line: &ThinLine, scale: LineScale) {
        let mut gaps: Vec<f64> = line.dashes.windows(2).map(|d| d[1].from - d[0].to).collect();
        gaps.sort_by(f64::total_cmp);
        let Some(usual) = gaps.get(gaps.len() / 2) else { return };
        let largest = GAP_RATIO * usual + 2.0;
        let mut own = line.pieces[0];
        for &next in &line.pieces[1..] {
            if [own, next].iter().any(|k| self.pieces[*k].is_dropped) {
                own = next;
                continue;
            }
            let off = |(a, b): (usize, usize)| distance(self.pieces[own].ends[a], self.pieces[next].ends[b]);
            let pairs = [(0, 0), (0, 1), (1, 0), (1, 1)];
            let Some((a, b)) = pairs.into_iter().min_by(|p, q| off(*p).total_cmp(&off(*q))) else { return };
            let gap = off((a, b));
            let fit = self.pieces[own].moments.plus(&self.pieces[next].moments).line();
            match fit.filter(|_| gap <= largest) {
                Some(fit) => {
                    let is_gap = gap > scale.width + 1.5;
                    self.join((own, a), (next, b), fit, is_gap.then_some(gap));
                }
                None => own = next,
            }
        }
    }

    /// Whether a line is one dash that crosses others and ends freely: a mark of a centre.
    fn is_mark(&self, line: &ThinLine) -> bool {
        let is_free = |(k, end): &(usize, usize)| self.pieces[*k].nodes[*end].is_none();
        line.dashes.len() == 1 && line.pieces.len() > 1 && line.ends.iter().all(is_free)
    }

    /// Whether a line ends where no other line is within a gap: hidden lines end at other lines.
    fn ends_in_the_open(&self, line: &ThinLine, scale: LineScale) -> bool {
        let gaps = line.dashes.windows(2).map(|d| d[1].from - d[0].to);
        let gap = gaps.fold(0.0, f64::max);
        let gap = if gap > 0.0 { gap } else { max_gap(scale) };
        let reach = 1.3 * gap + 1.5 * scale.width + 3.0;
        line.ends.iter().any(|(k, end)| {
            self.pieces[*k].nodes[*end].is_none()
                && self.nearest_crossing(*k, *end, reach).is_none()
                && !self.goes_on(line, (*k, *end), reach)
        })
    }

    /// Whether another dash is ahead of an end: short dashes of an arc are straight.
    fn goes_on(&self, line: &ThinLine, (k, end): (usize, usize), reach: f64) -> bool {
        let (from, into) = (self.pieces[k].ends[end], self.pieces[k].outwards(end));
        let is_ahead = |p: &[f64; 2]| {
            let step = [p[0] - from[0], p[1] - from[1]];
            let length = step[0].hypot(step[1]);
            length <= reach && -(step[0] * into[0] + step[1] * into[1]) > 0.5 * length
        };
        self.pieces.iter().enumerate().any(|(other, piece)| {
            piece.is_thin == Some(true)
                && !piece.is_dropped
                && !line.pieces.contains(&other)
                && (0..2).any(|e| piece.nodes[e].is_none() && is_ahead(&piece.ends[e]))
        })
    }

    /// Drops small connected pieces that are neither a circle nor dashes: letters at other angles than those
    /// that are read.
    fn drop_letters(&mut self, wide: f64) -> usize {
        let groups = self.connected(|p| !p.is_dropped);
        let mut boxes = vec![[[f64::MAX, f64::MIN]; 2]; self.pieces.len()];
        let mut is_letter = vec![true; self.pieces.len()];
        let (mut length, mut on_circle) = (vec![0; self.pieces.len()], vec![0; self.pieces.len()]);
        for k in (0..self.pieces.len()).filter(|k| !self.pieces[*k].is_dropped) {
            let (piece, own) = (&self.pieces[k], groups[k]);
            let is_dash = piece.is_thin == Some(true) && matches!(piece.shape, Shape::Line(..));
            is_letter[own] &= !(piece.is_closed || is_dash && piece.nodes == [None; 2]);
            length[own] += piece.raw.len();
            if let Shape::Circle(center, radius) = piece.shape
                && radius > wide
            {
                let same = |j: &usize| match self.pieces[*j].shape {
                    Shape::Circle(other, r) => {
                        let is_near = distance(other, center) < 2.0 && (r - radius).abs() < 2.0;
                        is_near && groups[*j] == own && !self.pieces[*j].is_dropped
                    }
                    Shape::Line(..) => false,
                };
                let arcs: usize = (0..self.pieces.len()).filter(same).map(|j| self.pieces[j].raw.len()).sum();
                on_circle[own] = on_circle[own].max(arcs);
            }
            for p in &piece.raw {
                for (range, c) in boxes[own].iter_mut().zip(p) {
                    *range = [range[0].min(*c), range[1].max(*c)];
                }
            }
        }
        let is_small = |own: usize| boxes[own].iter().all(|r| r[1] - r[0] <= LETTER * wide);
        // A hole, also if the rest of an arrowhead touches it.
        let is_hole = |own: usize| on_circle[own] as f64 >= HOLE_SHARE * length[own] as f64;
        let letters: Vec<usize> = (0..self.pieces.len())
            .filter(|k| !self.pieces[*k].is_dropped)
            .filter(|k| is_letter[groups[*k]] && is_small(groups[*k]) && !is_hole(groups[*k]))
            .collect();
        letters.iter().for_each(|k| self.pieces[*k].is_dropped = true);
        letters.len()
    }

    /// For each piece, the number of a piece that it is connected with over nodes, the same for all.
    fn connected(&self, is_used: impl Fn(&Piece) -> bool) -> Vec<usize> {
        fn root(group: &mut [usize], mut k: usize) -> usize {
            while group[k] != k {
                group[k] = group[group[k]];
                k = group[k];
            }
            k
        }
        let mut group: Vec<usize> = (0..self.pieces.len()).collect();
        for members in &self.members {
            let mut first = None;
            for k in members.iter().copied().filter(|k| is_used(&self.pieces[*k])) {
                let (a, b) = (root(&mut group, k), root(&mut group, *first.get_or_insert(k)));
                group[a] = b;
            }
        }
        (0..group.len()).map(|k| root(&mut group, k)).collect()
    }

    /// Makes lines of dashed arcs that bend by less than a pixel: directions of short dashes are inaccurate.
    pub(super) fn straighten_flat_arcs(&mut self) {
        for piece in self.pieces.iter_mut().filter(|p| p.is_thin == Some(true) && !p.is_closed) {
            let Shape::Circle(_, radius) = piece.shape else { continue };
            let chord = distance(piece.ends[0], piece.ends[1]);
            if chord * chord < 8.0 * FLAT * radius
                && chord < radius
                && let Some(fit) = piece.moments.line()
            {
                piece.shape = fit.shape;
                piece.squares = fit.squares;
            }
        }
    }

    /// Moves nodes that near-parallel lines have drawn out of the outline of their view back to it.
    pub(super) fn keep_nodes_in(&mut self, boxes: &[PixelBox]) {
        for piece in self.pieces.iter().filter(|p| !p.is_dropped && p.is_thin.is_some()) {
            let Some(own) = boxes.iter().find(|b| super::marks::contains(b, piece.ends[0], 2.0)) else {
                continue;
            };
            for node in piece.nodes.into_iter().flatten() {
                for (c, [low, high]) in self.nodes[node].iter_mut().zip(own) {
                    *c = c.clamp(low - OUTSIDE, high + OUTSIDE);
                }
            }
        }
    }

    /// Boxes of connected wide lines with a loop; boxes that overlap are one.
    pub(super) fn outline_boxes(&self, size: f64) -> Vec<PixelBox> {
        let is_wide = |p: &Piece| !p.is_dropped && p.is_thin == Some(false);
        let groups = self.connected(is_wide);
        // Edges minus nodes of a connected graph: −1 for a tree, more for each loop.
        let mut loops = vec![0_i64; self.pieces.len()];
        for members in &self.members {
            if let Some(k) = members.iter().find(|k| is_wide(&self.pieces[**k])) {
                loops[groups[*k]] -= 1;
            }
        }
        let mut boxes = vec![[[f64::MAX, f64::MIN]; 2]; self.pieces.len()];
        for (k, piece) in self.pieces.iter().enumerate().filter(|(_, p)| is_wide(p)) {
            let own = groups[k];
            let free = piece.nodes.iter().filter(|n| n.is_none()).count() as i64;
            loops[own] += if piece.is_closed { 1 } else { 1 - free };
            for p in piece.raw.iter().chain(&piece.ends) {
                for (range, c) in boxes[own].iter_mut().zip(p) {
                    *range = [range[0].min(*c), range[1].max(*c)];
                }
            }
        }
        let extent = |k: &usize| boxes[*k].iter().map(|r| r[1] - r[0]).fold(0.0, f64::max);
        let outlines = (0..boxes.len())
            .filter(|k| loops[*k] >= 0 && boxes[*k][0][0] <= boxes[*k][0][1])
            .filter(|k| extent(k) >= MIN_OUTLINE * size);
        super::marks::joined_boxes(outlines.map(|k| boxes[k]))
    }

    /// Thin straight pieces that lie on one line with gaps no larger than those between dashes.
    fn thin_lines(&self, scale: LineScale) -> Vec<ThinLine> {
        let thin: Vec<usize> = (0..self.pieces.len())
            .filter(|k| {
                let p = &self.pieces[*k];
                !p.is_dropped && p.is_thin == Some(true) && matches!(p.shape, Shape::Line(..))
            })
            .collect();
        let mut order = thin.clone();
        order.sort_by_key(|k| std::cmp::Reverse(self.pieces[*k].raw.len()));
        let mut is_used = vec![false; self.pieces.len()];
        let reach = max_gap(scale);
        let mut lines = Vec::new();
        for first in order {
            if is_used[first] {
                continue;
            }
            let Shape::Line(at, along) = self.pieces[first].shape else { continue };
            // Directions of dashes are inaccurate near junctions; most lines run along an axis.
            let along = match (0..2).find(|k| along[*k].abs() < ALONG_AXIS) {
                Some(k) => [0, 1].map(|c| if c == k { 0.0 } else { along[c].signum() }),
                None => along,
            };
            let place = |p: &[f64; 2]| (p[0] - at[0]) * along[0] + (p[1] - at[1]) * along[1];
            let off = |p: &[f64; 2]| (along[0] * (p[1] - at[1]) - along[1] * (p[0] - at[0])).abs();
            // The ends of skeletons are inaccurate.
            let is_near = |k: usize| {
                let raw = &self.pieces[k].raw;
                [raw.len() / 5, raw.len() / 2, raw.len() - 1 - raw.len() / 5]
                    .iter()
                    .all(|n| off(&raw[*n]) <= SAME_LINE)
            };
            let mut beside: Vec<(Dash, usize)> = (thin.iter().copied())
                .filter(|k| *k == first || !is_used[*k] && is_near(*k))
                .map(|k| {
                    let ends = [0, 1].map(|e| place(&self.pieces[k].ends[e]));
                    (Dash { from: ends[0].min(ends[1]), to: ends[0].max(ends[1]) }, k)
                })
                .collect();
            beside.sort_by(|a, b| a.0.from.total_cmp(&b.0.from));
            // Those that are connected with the first piece.
            let own = beside.iter().position(|(_, k)| *k == first).unwrap_or(0);
            let (mut low, mut high) = (own, own);
            while low > 0 && beside[low].0.from - beside[low - 1].0.to <= reach {
                low -= 1;
            }
            while high + 1 < beside.len() && beside[high + 1].0.from - beside[high].0.to <= reach {
                high += 1;
            }
            let end_at = |k: usize, last: bool| {
                let ends = [0, 1].map(|e| place(&self.pieces[k].ends[e]));
                (k, usize::from((ends[1] > ends[0]) == last))
            };
            let ends = [end_at(beside[low].1, false), end_at(beside[high].1, true)];
            let mut line = ThinLine { pieces: Vec::new(), dashes: Vec::new(), ends };
            for (dash, k) in &beside[low..=high] {
                is_used[*k] = true;
                line.pieces.push(*k);
                match line.dashes.last_mut() {
                    // Divided where another line crosses it.
                    Some(last) if dash.from - last.to <= scale.width + 1.5 => last.to = last.to.max(dash.to),
                    _ => line.dashes.push(*dash),
                }
            }
            lines.push(line);
        }
        lines
    }
}

/// A dash along its line.
#[derive(Debug, Clone, Copy)]
struct Dash {
    from: f64,
    to: f64,
}

impl Dash {
    fn length(&self) -> f64 {
        self.to - self.from
    }
}

/// Dashes on one line.
#[derive(Debug, Clone)]
struct ThinLine {
    pieces: Vec<usize>,
    dashes: Vec<Dash>,
    /// The piece and its end (0 or 1) at both ends of the line.
    ends: [(usize, usize); 2],
}

impl ThinLine {
    /// Whether most of it is in dashes longer than those of hidden lines. A line that crosses a hidden one in
    /// a gap makes two of its dashes one.
    fn is_continuous(&self, longest: f64) -> bool {
        let all: f64 = self.dashes.iter().map(Dash::length).sum();
        let long: f64 = self.dashes.iter().map(Dash::length).filter(|length| *length > longest).sum();
        long > 0.5 * all
    }

    /// Whether it has alternating dashes. Dashes of a hidden line have one length, except for the first and
    /// the last, which may be shorter.
    fn is_chain(&self) -> bool {
        self.dashes.windows(3).any(|d| {
            let [a, b, c] = [d[0].length(), d[1].length(), d[2].length()];
            b < CHAIN_RATIO * a.max(c)
        })
    }
}

/// The largest length of inner dashes of most hidden lines.
fn usual_dash(lines: &[ThinLine]) -> Option<f64> {
    let hidden = lines.iter().filter(|l| l.dashes.len() >= 3 && !l.is_chain());
    let inner = |l: &ThinLine| {
        let inner = &l.dashes[1..l.dashes.len() - 1];
        inner.iter().map(Dash::length).fold(0.0, f64::max)
    };
    let mut lengths: Vec<f64> = hidden.map(inner).collect();
    lengths.sort_by(f64::total_cmp);
    lengths.get(lengths.len() / 2).copied()
}

/// The limit between thin and wide lines and the width of wide ones; none if there is one width. Values have
/// weights.
fn two_widths(mut widths: Vec<(f64, f64)>) -> Option<(f64, f64)> {
    widths.sort_by(|a, b| a.0.total_cmp(&b.0));
    let all: f64 = widths.iter().map(|w| w.1).sum();
    let total: f64 = widths.iter().map(|w| w.0.max(1e-3).ln() * w.1).sum();
    let (mut weight, mut sum) = (0.0, 0.0);
    let mut best: Option<(f64, usize, f64, f64)> = None;
    for (k, (width, own)) in widths.iter().enumerate() {
        weight += own;
        sum += own * width.max(1e-3).ln();
        if weight < MIN_SHARE * all || weight > (1.0 - MIN_SHARE) * all {
            continue;
        }
        let means = [sum / weight, (total - sum) / (all - weight)];
        let between = weight * (all - weight) * (means[1] - means[0]).powi(2);
        if best.is_none_or(|b| between > b.0) {
            best = Some((between, k, means[0], means[1]));
        }
    }
    let (_, _, thin, wide) = best?;
    (wide - thin >= MIN_RATIO.ln()).then(|| ((0.5 * (thin + wide)).exp(), wide.exp()))
}

/// Coverage summed across a piece: a fifth, half and four fifths of the places have at most this width.
fn width_of(piece: &Piece, ink: &Ink, usual: f64) -> [f64; 3] {
    let points = if piece.points.len() >= 3 { &piece.points } else { &piece.raw };
    let step = points.len().div_ceil(25).max(1);
    let mut widths: Vec<f64> = (points.iter().step_by(step))
        .map(|p| across(ink, *p, piece.shape.normal(*p), 2.0 * usual + 4.0))
        .collect();
    widths.sort_by(f64::total_cmp);
    let at = |share: f64| widths[((widths.len() - 1) as f64 * share).round() as usize];
    if widths.is_empty() { [0.0; 3] } else { [at(0.2), at(0.5), at(0.8)] }
}

/// Coverage along a direction up to the edges of a line.
fn across(ink: &Ink, p: [f64; 2], along: [f64; 2], reach: f64) -> f64 {
    const STEP: f64 = 0.5;
    let coverage = |t: f64| ink.at([p[0] + t * along[0], p[1] + t * along[1]]);
    let own = coverage(0.0);
    let mut sum = own;
    for side in [1.0, -1.0] {
        let mut least = own;
        let mut t = STEP;
        while t <= reach {
            let c = coverage(side * t);
            if c < 0.04 || (least < 0.6 * own && c > least + 0.04) {
                break;
            }
            least = least.min(c);
            sum += c;
            t += STEP;
        }
    }
    STEP * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(dashes: &[[f64; 2]]) -> ThinLine {
        let dashes = dashes.iter().map(|[from, to]| Dash { from: *from, to: *to }).collect();
        ThinLine { pieces: Vec::new(), dashes, ends: [(0, 0); 2] }
    }

    /// Short first and last dashes are usual for hidden lines; a short one between long ones is not.
    #[test]
    fn chain_lines_have_short_dashes_between_long_ones() {
        assert!(!line(&[[0.0, 3.0], [8.0, 20.0], [25.0, 37.0], [42.0, 44.0]]).is_chain());
        assert!(line(&[[0.0, 30.0], [35.0, 37.0], [42.0, 72.0]]).is_chain());
        let usual = usual_dash(&[line(&[[0.0, 3.0], [8.0, 20.0], [25.0, 37.0]])]);
        assert_eq!(usual, Some(12.0));
    }

    #[test]
    fn widths_are_of_two_kinds_only_if_they_differ_clearly() {
        let (limit, wide) = two_widths(vec![(1.0, 50.0), (1.1, 40.0), (2.0, 30.0), (2.1, 60.0)]).unwrap();
        assert!(limit > 1.1 && limit < 2.0 && (wide - 2.07).abs() < 0.05, "{limit} {wide}");
        assert!(two_widths(vec![(1.9, 50.0), (2.0, 40.0), (2.1, 60.0)]).is_none());
        assert!(two_widths(Vec::new()).is_none());
    }
}
