//! Joins shapes to words and finds the glyphs of a word.

use super::grammar::{ReadWord, read};
use super::ink::{Ink, STROKE};
use super::network::{CLASS_COUNT, NO_GLYPH, Network};
use super::shape::{Line, Patch, PixelBox, Reading, Shape};

/// Heights of shapes in pixels that glyphs have; smaller ones are points, dashes and rings of a glyph.
const GLYPH_HEIGHT: std::ops::RangeInclusive<f32> = 6.0..=100.0;
/// Glyphs that touch make shapes up to this times as wide as high.
const WIDEST: f32 = 4.0;
/// Maximum gap between glyphs in heights: digits of fonts of equal advance have 0.7 around a point.
const WIDEST_GAP: f32 = 0.8;
/// Heights of glyphs of a word differ by at most this factor, apart from points and the like.
const HEIGHT_RATIO: f32 = 2.2;
/// Height of points, dashes and rings relative to the glyphs beside them.
const SMALL: f32 = 0.45;
/// Maximum number of shapes of a word. Hatches are chains of many more.
const LONGEST: usize = 60;
/// Maximum number of parts that make one glyph: `%` has three; touching glyphs are cut into more.
const MOST_PARTS: usize = 5;
/// Maximum width of a glyph and maximum gap between its parts in heights.
const WIDEST_GLYPH: f32 = 1.7;
const GAP_INSIDE: f32 = 0.12;
/// Class of `-`.
const DASH: usize = 13;
/// Ink between two glyphs that is more than noise and blur.
const UNREAD_INK: f32 = 0.2;
/// Logarithm of the probability below which a part is rather no glyph at all.
const SKIPPED: f32 = -3.0;

/// A word as it was found.
pub(super) struct FoundWord {
    pub(super) reading: Reading,
    pub(super) read: ReadWord,
    pub(super) line: Line,
    /// Box of every glyph in the frame of the reader.
    pub(super) glyphs: Vec<PixelBox>,
    /// Numbers of the shapes.
    pub(super) shapes: Vec<usize>,
    /// Whether parts between its glyphs are unexplained.
    pub(super) has_unread: bool,
    /// Probability that its shapes are glyphs at all (mean of the glyphs).
    pub(super) glyph_chance: f64,
    /// How much better this explains its shapes than none.
    pub(super) score: f32,
}

/// A shape or a part of one.
struct Part {
    patch: Patch,
    shape: usize,
    /// Whether it is a part of a shape.
    is_cut: bool,
}

/// What makes words of shapes.
pub(super) struct WordFinder<'a> {
    pub(super) ink: &'a Ink,
    pub(super) network: &'a Network,
    pub(super) shapes: &'a [Shape],
}

impl WordFinder<'_> {
    /// The words in one direction of reading. Some are wrong: their shapes may also be words in the other.
    pub(super) fn find(&self, reading: Reading) -> Vec<FoundWord> {
        let groups = self.groups(reading);
        groups.into_iter().flat_map(|group| self.words_of(&group, reading)).collect()
    }

    /// Box of a shape in the frame of the reader.
    fn bounds(&self, shape: usize, reading: Reading) -> PixelBox {
        let own = self.shapes[shape].bounds;
        let top = self.ink.rows as f32 - 1.0;
        match reading {
            Reading::Rightwards => own,
            Reading::Upwards => {
                PixelBox { low: [top - own.high[1], own.low[0]], high: [top - own.low[1], own.high[0]] }
            }
        }
    }

    /// Shapes beside each other on a line.
    fn groups(&self, reading: Reading) -> Vec<Vec<usize>> {
        let mut boxes: Vec<(usize, PixelBox)> = (0..self.shapes.len())
            .map(|k| (k, self.bounds(k, reading)))
            .filter(|(_, b)| b.size(0).max(b.size(1)) <= WIDEST * GLYPH_HEIGHT.end())
            .filter(|(_, b)| b.size(1) <= *GLYPH_HEIGHT.end())
            .collect();
        boxes.sort_by(|a, b| a.1.low[0].total_cmp(&b.1.low[0]));
        let reach = WIDEST_GAP * GLYPH_HEIGHT.end();
        let mut parents: Vec<usize> = (0..boxes.len()).collect();
        for (i, (_, own)) in boxes.iter().enumerate() {
            for (j, (_, next)) in boxes.iter().enumerate().skip(i + 1) {
                // Boxes are sorted by their left sides.
                if next.low[0] - own.high[0] > reach {
                    break;
                }
                if belong_together(own, next) {
                    let [a, b] = [top(&mut parents, i), top(&mut parents, j)];
                    parents[a.max(b)] = a.min(b);
                }
            }
        }
        let mut groups: Vec<Vec<usize>> = vec![Vec::new(); boxes.len()];
        for (k, (shape, _)) in boxes.iter().enumerate() {
            groups[top(&mut parents, k)].push(*shape);
        }
        let has_core = |g: &Vec<usize>| g.iter().any(|k| is_core(&self.bounds(*k, reading)));
        groups.retain(|g| (1..=LONGEST).contains(&g.len()) && has_core(g));
        groups
    }

    fn words_of(&self, group: &[usize], reading: Reading) -> Vec<FoundWord> {
        let patch = |k: &usize| Some((*k, Patch::of(self.ink, &[&self.shapes[*k]], reading)?));
        let parts: Vec<(usize, Patch)> = group.iter().filter_map(patch).collect();
        let boxes: Vec<PixelBox> = parts.iter().map(|(_, p)| p.bounds).collect();
        // Small letters without ascenders are nearly as high as capitals, and parentheses are higher: the
        // better one of both heights of the line wins.
        let best = lines_of(&boxes).into_iter().map(|line| {
            let cut = self.parts(&parts, &line);
            let spans = self.spans(&cut, &line);
            let (chosen, score) = best_path(cut.len(), &spans);
            (score, self.split(&cut, &spans, &chosen, line, reading))
        });
        best.max_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(Vec::new, |(_, words)| words)
    }

    /// The shapes, cut where glyphs may touch, from left to right.
    fn parts(&self, shapes: &[(usize, Patch)], line: &Line) -> Vec<Part> {
        let mut parts: Vec<Part> = Vec::new();
        for (shape, patch) in shapes {
            let pieces = self.cut(patch, line);
            let is_cut = pieces.len() > 1;
            parts.extend(pieces.into_iter().map(|patch| Part { patch, shape: *shape, is_cut }));
        }
        parts.sort_by(|a, b| a.patch.bounds.low[0].total_cmp(&b.patch.bounds.low[0]));
        parts
    }

    /// A shape, or its parts where glyphs may touch.
    fn cut(&self, patch: &Patch, line: &Line) -> Vec<Patch> {
        /// A shape that is a glyph with this probability is not cut.
        const CLEAR: f32 = 0.8;
        const MAX_CUTS: usize = 8;
        let bounds = patch.bounds;
        if bounds.size(0) < 0.5 * line.height || bounds.size(1) < SMALL * line.height {
            return vec![patch.clone()];
        }
        let chances = self.network.chances(&patch.glyph(line));
        if best_glyph(&chances).1 >= CLEAR {
            return vec![patch.clone()];
        }
        let sums = patch.column_sums();
        let margin = 0.12 * line.height;
        let lowest = |k: usize| {
            let (x, sum) = sums[k];
            let around = &sums[k.saturating_sub(2)..(k + 3).min(sums.len())];
            let inside = x > bounds.low[0] + margin && x < bounds.high[0] - margin;
            (inside && around.iter().all(|(_, other)| sum <= *other)).then_some((x, sum))
        };
        let mut places: Vec<(f32, f32)> = (0..sums.len()).filter_map(lowest).collect();
        places.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut cuts: Vec<f32> = Vec::new();
        for (x, sum) in places {
            let apart = cuts.iter().all(|c| (c - x).abs() >= margin);
            if apart && sum <= 0.5 * line.height && cuts.len() < MAX_CUTS {
                cuts.push(x);
            }
        }
        cuts.sort_by(f32::total_cmp);
        cuts.push(f32::MAX);
        let mut left = 0.0;
        let mut found = Vec::new();
        for right in cuts {
            found.extend(patch.part(left, right));
            left = right;
        }
        found
    }

    /// What consecutive parts are as one glyph.
    fn spans(&self, parts: &[Part], line: &Line) -> Vec<Span> {
        let mut spans = Vec::new();
        for first in 0..parts.len() {
            let mut bounds = parts[first].patch.bounds;
            for last in first..(first + MOST_PARTS).min(parts.len()) {
                let own = parts[last].patch.bounds;
                if last > first && own.low[0] - bounds.high[0] > GAP_INSIDE * line.height {
                    break;
                }
                bounds = bounds.joined(&own);
                if last > first && bounds.size(0) > WIDEST_GLYPH * line.height {
                    break;
                }
                let together: Vec<&Patch> = parts[first..=last].iter().map(|p| &p.patch).collect();
                let glyph = match together[..] {
                    [one] => one.glyph(line),
                    _ => Patch::joined(&together).glyph(line),
                };
                let mut chances = self.network.chances(&glyph);
                // Dashes do not touch glyphs; pieces of dimension lines look like them.
                if first == last && parts[first].is_cut {
                    chances[NO_GLYPH] += std::mem::take(&mut chances[DASH]);
                }
                let is_torn =
                    first > 0 && overlap(&parts[first - 1].patch.bounds, &parts[first].patch.bounds);
                spans.push(Span { first, last, bounds, chances, is_torn });
            }
        }
        spans
    }

    /// Words of the chosen spans, split at parts that are no glyphs.
    fn split(
        &self,
        parts: &[Part],
        spans: &[Span],
        chosen: &[usize],
        line: Line,
        reading: Reading,
    ) -> Vec<FoundWord> {
        let is_dash = |k: &usize| best_glyph(&spans[*k].chances).0 == DASH;
        let mut words: Vec<Vec<&Span>> = vec![Vec::new()];
        let mut next = 0;
        for (at, k) in chosen.iter().enumerate() {
            let span = &spans[*k];
            let too_large =
                |part: &Part| part.patch.bounds.size(0).max(part.patch.bounds.size(1)) > SMALL * line.height;
            // Two dashes in a row are parts of a line.
            let is_line = is_dash(k)
                && [at.wrapping_sub(1), at + 1].iter().any(|n| chosen.get(*n).is_some_and(is_dash));
            if is_line || parts[next..span.first].iter().any(too_large) {
                words.push(Vec::new());
            }
            next = span.last + 1;
            if let Some(word) = words.last_mut().filter(|_| !is_line) {
                word.push(span);
            }
        }
        let trimmed = words.iter().map(|word| {
            let dash = |s: &&Span| best_glyph(&s.chances).0 == DASH;
            let first = word.iter().take_while(|s| dash(s)).count();
            let last = word.iter().rev().take_while(|s| dash(s)).count();
            &word[first..word.len().saturating_sub(last).max(first)]
        });
        trimmed
            .filter_map(|spans| word(spans, parts, line, reading, self.has_unread(spans, &line, reading)))
            .collect()
    }

    /// Whether there is ink between the glyphs of a word, or beside it where a dimension line would not be.
    fn has_unread(&self, spans: &[&Span], line: &Line, reading: Reading) -> bool {
        /// Columns beside a word that are looked at, in heights: glyphs of the word would be there.
        const BESIDE: f32 = 0.6;
        let ink = |left: f32, right: f32, high: f32, low: f32| {
            let base = line.base_at(0.5 * (left + right));
            let rows = [base - high * line.height, base - low * line.height];
            if left <= right { self.ink.strongest([left, rows[0]], [right, rows[1]], reading) } else { 0.0 }
        };
        let between = |pair: &[&Span]| {
            ink(pair[0].bounds.high[0] + 2.0, pair[1].bounds.low[0] - 2.0, 0.9, -0.12) > UNREAD_INK
        };
        let beside =
            |left: f32, right: f32| ink(left, right, 1.05, 0.68).max(ink(left, right, 0.32, 0.0)) > STROKE;
        let reach = BESIDE * line.height;
        let first = spans.first().is_some_and(|s| beside(s.bounds.low[0] - reach, s.bounds.low[0] - 2.0));
        let last = spans.last().is_some_and(|s| beside(s.bounds.high[0] + 2.0, s.bounds.high[0] + reach));
        first || last || spans.windows(2).any(between)
    }
}

/// Consecutive parts as one glyph.
struct Span {
    first: usize,
    last: usize,
    bounds: PixelBox,
    chances: [f32; CLASS_COUNT],
    /// Whether it begins above or below the part before it, as the point of `i` does.
    is_torn: bool,
}

/// Whether two shapes are above each other.
fn overlap(a: &PixelBox, b: &PixelBox) -> bool {
    let common = a.high[0].min(b.high[0]) - a.low[0].max(b.low[0]) + 1.0;
    common > 0.6 * a.size(0).min(b.size(0))
}

/// Whether glyphs on both sides of a word's line may have this box.
fn is_core(bounds: &PixelBox) -> bool {
    bounds.size(1) >= *GLYPH_HEIGHT.start() && bounds.size(0) <= WIDEST * bounds.size(1)
}

/// Whether two shapes, the first with the smaller left side, are beside each other in a word.
fn belong_together(a: &PixelBox, b: &PixelBox) -> bool {
    let (high, low) = if a.size(1) >= b.size(1) { (a, b) } else { (b, a) };
    let height = high.size(1);
    if !is_core(high) || height > *GLYPH_HEIGHT.end() {
        return false;
    }
    let gap = b.low[0] - a.high[0] - 1.0;
    if is_core(low) && low.size(1) >= SMALL * height && height <= HEIGHT_RATIO * low.size(1) {
        let overlap = high.high[1].min(low.high[1]) - high.low[1].max(low.low[1]) + 1.0;
        return gap <= WIDEST_GAP * height && overlap >= 0.5 * low.size(1);
    }
    let is_inside = low.low[1] >= high.low[1] - 0.5 * height && low.high[1] <= high.high[1] + 0.4 * height;
    low.size(1) < SMALL * height && low.size(0) <= 0.9 * height && gap <= WIDEST_GAP * height && is_inside
}

fn top(parents: &mut [usize], mut at: usize) -> usize {
    while parents[at] != at {
        parents[at] = parents[parents[at]];
        at = parents[at];
    }
    at
}

/// Heights of the line and their baselines: of the highest shapes, and of all high ones if that differs.
fn lines_of(boxes: &[PixelBox]) -> Vec<Line> {
    /// Heights above these shares of the highest: digits beside letters with serifs, and beside parentheses.
    const SHARES: [f32; 2] = [0.86, 0.7];
    let highest = boxes.iter().filter(|b| is_core(b)).map(|b| b.size(1)).fold(0.0, f32::max);
    let line = |share: f32| line_of(boxes.iter().filter(|b| b.size(1) >= share * highest).collect());
    let mut lines: Vec<Line> = SHARES.into_iter().filter_map(line).collect();
    lines.dedup_by(|b, a| b.height > 0.93 * a.height);
    lines
}

/// Height and baseline of a line of shapes of about the same height.
fn line_of(high: Vec<&PixelBox>) -> Option<Line> {
    /// Steepest baseline: a page tilted by 3°.
    const STEEPEST: f32 = 0.06;
    let height = median(high.iter().map(|b| b.size(1)).collect())?;
    let feet: Vec<[f32; 2]> = high.iter().map(|b| [b.middle(0), b.high[1] + 0.5]).collect();
    let mut slopes = Vec::new();
    for (k, a) in feet.iter().enumerate() {
        let far = feet[k + 1..].iter().filter(|b| (b[0] - a[0]).abs() >= 2.0 * height);
        slopes.extend(far.map(|b| (b[1] - a[1]) / (b[0] - a[0])));
    }
    let slope = median(slopes).unwrap_or(0.0).clamp(-STEEPEST, STEEPEST);
    let base = median(feet.iter().map(|p| p[1] - slope * p[0]).collect())?;
    Some(Line { height, base: [base, slope] })
}

fn median(mut values: Vec<f32>) -> Option<f32> {
    let at = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(at, f32::total_cmp).1)
}

/// The most probable glyph, and its probability.
fn best_glyph(chances: &[f32; CLASS_COUNT]) -> (usize, f32) {
    let of_glyphs = chances[..NO_GLYPH].iter().copied().enumerate();
    of_glyphs.fold((0, 0.0), |best, own| if own.1 > best.1 { own } else { best })
}

/// The spans that explain the parts best; parts between them are skipped.
fn best_path(parts: usize, spans: &[Span]) -> (Vec<usize>, f32) {
    let mut best: Vec<(f32, Option<usize>)> = vec![(0.0, None); parts + 1];
    for end in 1..=parts {
        best[end] = (best[end - 1].0 + SKIPPED, None);
        for (k, span) in spans.iter().enumerate().filter(|(_, s)| s.last + 1 == end) {
            let torn = if span.is_torn { SKIPPED } else { 0.0 };
            let score = best[span.first].0 + best_glyph(&span.chances).1.max(1e-9).ln() + torn;
            if score > best[end].0 {
                best[end] = (score, Some(k));
            }
        }
    }
    let mut path = Vec::new();
    let mut end = parts;
    while end > 0 {
        match best[end].1 {
            Some(k) => {
                path.push(k);
                end = spans[k].first;
            }
            None => end -= 1,
        }
    }
    path.reverse();
    (path, best[parts].0)
}

fn word(
    spans: &[&Span],
    parts: &[Part],
    line: Line,
    reading: Reading,
    has_unread: bool,
) -> Option<FoundWord> {
    if spans.is_empty() {
        return None;
    }
    let mut shapes: Vec<usize> =
        spans.iter().flat_map(|s| parts[s.first..=s.last].iter().map(|p| p.shape)).collect();
    shapes.sort_unstable();
    shapes.dedup();
    let chances: Vec<[f32; CLASS_COUNT]> = spans.iter().map(|s| s.chances).collect();
    let glyph_chance = chances.iter().map(|c| f64::from(1.0 - c[NO_GLYPH])).sum::<f64>() / spans.len() as f64;
    // Cuts give more glyphs, but no more shapes are explained by them.
    let sum: f32 = chances.iter().map(|c| best_glyph(c).1.max(1e-9).ln() - SKIPPED).sum();
    let score = sum * shapes.len() as f32 / spans.len() as f32;
    let glyphs = spans.iter().map(|s| s.bounds).collect();
    Some(FoundWord { reading, read: read(&chances), line, glyphs, shapes, has_unread, glyph_chance, score })
}
