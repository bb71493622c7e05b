//! Finds long straight lines, so that texts that touch them can be read, and arrowheads at ends of lines.

use super::arrows::{Arrowhead, InkAlong, arrowheads_of};
use super::ink::Ink;
use planish_solid::views::distance;

/// Thickest line in pixels.
const THICKEST: usize = 10;
/// A line is longer than strokes of letters. Shorter ones, such as dashes, do not connect texts.
const SHORTEST: usize = 70;
/// Longest part of a line that is hidden by glyphs.
const LONGEST_GAP: usize = 60;
/// Distance of corners of one arrowhead that was found twice, in pixels.
const SAME_HEAD: f64 = 3.0;
/// Maximum distance of two parts from each other's direction, in pixels.
const OFFSET: f32 = 1.5;

/// Straight lines along rows and columns (± 3°).
pub(super) struct LineWork {
    /// Pixels of long lines, except where strokes touch them.
    pub(super) long: Vec<bool>,
    /// Arrowheads at the ends of lines, in pixels.
    pub(super) arrowheads: Vec<Arrowhead>,
}

impl LineWork {
    pub(super) fn of(ink: &Ink, mask: &[bool]) -> Self {
        let [columns, rows] = [ink.columns, ink.rows];
        let mut found = Self { long: vec![false; mask.len()], arrowheads: Vec::new() };
        for transposed in [false, true] {
            let (length, across) = if transposed { (rows, columns) } else { (columns, rows) };
            let index = |along: usize, across: usize| match transposed {
                true => along * columns + across,
                false => across * columns + along,
            };
            let is_ink = |along, at| mask[index(along, at)];
            let chains = chains(length, across, is_ink);
            let view = InkAlong { length, across, ink: |along, at| ink.values[index(along, at)] };
            let heads = chains.iter().flat_map(|chain| arrowheads_of(chain, &view));
            let place = |p: [f64; 2]| if transposed { [p[1], p[0]] } else { p };
            for (corners, head) in heads.map(|(corners, head)| (corners.map(place), head)) {
                // Parts of a line that glyphs divide find the same arrowhead.
                let is_known = |own: &Arrowhead| (0..3).all(|k| distance(own.0[k], corners[k]) < SAME_HEAD);
                if !found.arrowheads.iter().any(is_known) {
                    found.arrowheads.push((corners, head));
                }
            }
            for band in joined(chains) {
                band.mark(across, is_ink, |along, at| found.long[index(along, at)] = true);
            }
        }
        found
    }
}

/// Part of a line: for every step along it the first and the last pixel across.
pub(super) struct Chain {
    pub(super) first: usize,
    pub(super) bands: Vec<(u32, u32)>,
}

impl Chain {
    pub(super) fn middle(&self, k: usize) -> f32 {
        0.5 * (self.bands[k].0 + self.bands[k].1) as f32
    }

    pub(super) fn end(&self) -> usize {
        self.first + self.bands.len()
    }

    /// Slope of the line through the middles of its quarters.
    pub(super) fn slope(&self) -> f32 {
        let quarter = self.bands.len() / 4;
        let mean = |from: usize| {
            (from..from + quarter.max(1)).map(|k| self.middle(k)).sum::<f32>() / quarter.max(1) as f32
        };
        (mean(self.bands.len() - quarter.max(1)) - mean(0))
            / (self.bands.len() - quarter.max(1)).max(1) as f32
    }

    /// Marks the pixels of the line where no stroke goes on beside it.
    fn mark(&self, across: usize, is_ink: impl Fn(usize, usize) -> bool, mut mark: impl FnMut(usize, usize)) {
        for (k, (low, high)) in self.bands.iter().enumerate() {
            let [along, low, high] = [self.first + k, *low as usize, *high as usize];
            let is_touched =
                (low > 0 && is_ink(along, low - 1)) || (high + 1 < across && is_ink(along, high + 1));
            if !is_touched {
                (low..=high).for_each(|at| mark(along, at));
            }
        }
    }
}

/// Thin runs of pixels that continue each other.
fn chains(length: usize, across: usize, is_ink: impl Fn(usize, usize) -> bool) -> Vec<Chain> {
    let mut open: Vec<Chain> = Vec::new();
    let mut done: Vec<Chain> = Vec::new();
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for along in 0..length {
        runs.clear();
        let mut at = 0;
        while at < across {
            if !is_ink(along, at) {
                at += 1;
                continue;
            }
            let begin = at;
            while at < across && is_ink(along, at) {
                at += 1;
            }
            if at - begin <= THICKEST {
                runs.push((begin as u32, at as u32 - 1));
            }
        }
        let mut next: Vec<Chain> = Vec::with_capacity(runs.len());
        let mut continued = open.into_iter().peekable();
        for run in &runs {
            let middle = 0.5 * (run.0 + run.1) as f32;
            let mut found = None;
            while let Some(chain) = continued.peek() {
                let last = *chain.bands.last().unwrap_or(&(0, 0));
                let step = middle - 0.5 * (last.0 + last.1) as f32;
                let thickness = (last.1 - last.0).abs_diff(run.1 - run.0);
                if step < -1.0 {
                    break;
                }
                let chain = continued.next();
                if step <= 1.0 && thickness <= 2 && found.is_none() {
                    found = chain;
                } else {
                    done.extend(chain.filter(|c| c.bands.len() >= SHORTEST / 3));
                }
            }
            let mut chain = found.unwrap_or_else(|| Chain { first: along, bands: Vec::new() });
            chain.bands.push(*run);
            next.push(chain);
        }
        done.extend(continued.filter(|c| c.bands.len() >= SHORTEST / 3));
        open = next;
    }
    done.extend(open.into_iter().filter(|c| c.bands.len() >= SHORTEST / 3));
    done
}

/// Long chains, joined over the gaps that touching glyphs leave.
fn joined(mut chains: Vec<Chain>) -> Vec<Chain> {
    chains.sort_by_key(|c| c.first);
    let mut found: Vec<Chain> = Vec::new();
    for chain in chains {
        let fits = |own: &&mut Chain| {
            let gap = chain.first.checked_sub(own.end()).filter(|gap| *gap <= LONGEST_GAP);
            let Some(gap) = gap else { return false };
            let reach = own.slope() * (gap + 1) as f32;
            (own.middle(own.bands.len() - 1) + reach - chain.middle(0)).abs() <= OFFSET
                && (chain.slope() - own.slope()).abs() < 0.03
        };
        // Recent chains are at the end.
        match found.iter_mut().rev().take(4000).find(fits) {
            Some(own) => {
                let (from, to) = (own.bands[own.bands.len() - 1], chain.bands[0]);
                let gap = chain.first - own.end();
                for k in 0..gap {
                    let part = (k + 1) as f32 / (gap + 1) as f32;
                    let between = |a: u32, b: u32| (a as f32 + part * (b as f32 - a as f32)).round() as u32;
                    own.bands.push((between(from.0, to.0), between(from.1, to.1)));
                }
                own.bands.extend(chain.bands);
            }
            None => found.push(chain),
        }
    }
    found.retain(|c| c.bands.len() >= SHORTEST);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain goes on after a gap; one that begins beside another is a line of its own.
    #[test]
    fn chains_are_joined_over_gaps() {
        let chain = |first, at, count| Chain { first, bands: vec![(at, at + 1); count] };
        let (long, gap) = (2 * SHORTEST, LONGEST_GAP / 2);
        let joined_chains = joined(vec![chain(0, 5, long), chain(long + gap, 5, long)]);
        assert_eq!(joined_chains.iter().map(|c| c.bands.len()).collect::<Vec<_>>(), [2 * long + gap]);
        assert_eq!(joined(vec![chain(0, 5, long), chain(SHORTEST, 5, long)]).len(), 2);
    }
}
