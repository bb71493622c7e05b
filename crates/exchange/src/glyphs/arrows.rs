//! Arrowheads: the width of a line rises suddenly at their base and falls evenly to zero at their tip.

use super::ink::STROKE;
use super::lines::Chain;

/// Steps inside of the end of a line where the base of an arrowhead is looked for; that of a drawing at
/// 300 dpi is 40 pixels long.
const INSIDE: usize = 60;
/// Steps beyond the end of a line.
const BEYOND: usize = 80;
/// Runs across a line of more pixels are extension lines.
const WIDEST: usize = 40;
/// Length of arrowheads in widths of their base.
const SLENDERNESS: std::ops::RangeInclusive<f64> = 1.2..=8.0;
/// Maximum distance of a stroke of an open arrowhead from its line, in pixels.
const OPEN_GAP: usize = 10;
/// Slope of lines along rows or columns of a page tilted by up to 3°. Strokes of letters such as `4` are
/// steeper.
const STEEPEST: f64 = 0.06;
/// Maximum mean distance of the middle of a filled head from its line, in pixels.
const ASYMMETRY: f64 = 0.75;

/// Ink as seen along a line.
pub(super) struct InkAlong<F: Fn(usize, usize) -> f32> {
    pub(super) length: usize,
    pub(super) across: usize,
    pub(super) ink: F,
}

/// An arrowhead: its corners, the tip first, and how it is drawn.
pub(super) type Arrowhead = ([[f64; 2]; 3], Head);

/// How arrowheads are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Head {
    Filled,
    Open,
}

/// What is seen across a line at a step.
#[derive(Debug, Clone, Copy, Default)]
struct Width {
    /// Number of pixels of strokes.
    pixels: usize,
    /// Sum of their ink and that of the rim; of open heads the distance of their outer sides.
    ink: f64,
}

impl<F: Fn(usize, usize) -> f32> InkAlong<F> {
    fn is_stroke(&self, along: usize, at: usize) -> bool {
        (self.ink)(along, at) > STROKE
    }

    fn width(&self, along: usize, at: f64, head: Head) -> Width {
        let Some((low, high)) = self.run(along, at) else { return Width::default() };
        let pixels = high - low + 1;
        if head == Head::Filled || pixels > WIDEST {
            let rim = low.saturating_sub(1)..=(high + 1).min(self.across - 1);
            return Width { pixels, ink: rim.map(|at| f64::from((self.ink)(along, at))).sum() };
        }
        // The two strokes of an open head, or the line alone.
        let above = (low.saturating_sub(OPEN_GAP)..low).find(|at| self.is_stroke(along, *at)).unwrap_or(low);
        let beyond = (high + OPEN_GAP).min(self.across - 1);
        let below = (high + 1..=beyond).rev().find(|at| self.is_stroke(along, *at)).unwrap_or(high);
        let is_even = (low - above).abs_diff(below - high) <= 2;
        Width { pixels, ink: if is_even { (below - above + 1) as f64 } else { pixels as f64 } }
    }

    /// The run of ink through a place, if it is not wider than arrowheads.
    fn run(&self, along: usize, at: f64) -> Option<(usize, usize)> {
        let start = at.round();
        let inside = start >= 0.0 && (start as usize) < self.across && self.is_stroke(along, start as usize);
        if !inside {
            return None;
        }
        let (mut low, mut high) = (start as usize, start as usize);
        while low > 0 && high - low <= WIDEST && self.is_stroke(along, low - 1) {
            low -= 1;
        }
        while high + 1 < self.across && high - low <= WIDEST && self.is_stroke(along, high + 1) {
            high += 1;
        }
        Some((low, high))
    }
}

/// Arrowheads at the two ends of a part of a line: their corners along and across it, the tip first.
pub(super) fn arrowheads_of<F: Fn(usize, usize) -> f32>(chain: &Chain, view: &InkAlong<F>) -> Vec<Arrowhead> {
    let slope = f64::from(chain.slope());
    if slope.abs() > STEEPEST {
        return Vec::new();
    }
    let middle = f64::from(chain.middle(chain.bands.len() / 2));
    let centre = (chain.first + chain.bands.len() / 2) as f64;
    let axis = |along: f64| middle + slope * (along - centre);
    let head = |forwards: bool, head: Head| {
        let end = if forwards { chain.end() - 1 } else { chain.first };
        let place = |k: usize| match forwards {
            true => (end + k).checked_sub(INSIDE).filter(|p| *p < view.length),
            false => (end + INSIDE).checked_sub(k).filter(|p| *p < view.length),
        };
        let profile: Vec<(usize, Width)> = (0..INSIDE + BEYOND)
            .filter_map(|k| place(k).map(|at| (at, view.width(at, axis(at as f64), head))))
            .collect();
        let (base, tip) = head_in(&profile.iter().map(|p| p.1).collect::<Vec<Width>>())?;
        let along = |step: f64| {
            let first = profile[0].0 as f64;
            if forwards { first + step } else { first - step }
        };
        // Flags of `1` and serifs are on one side.
        let off_axis = |p: &(usize, Width)| {
            let at = axis(p.0 as f64);
            view.run(p.0, at).map(|(low, high)| (0.5 * (low + high) as f64 - at).abs())
        };
        let wider: Vec<f64> =
            profile[base..=base + (tip - base as f64) as usize / 2].iter().filter_map(off_axis).collect();
        if head == Head::Filled && wider.iter().sum::<f64>() > ASYMMETRY * wider.len() as f64 {
            return None;
        }
        let half = 0.5 * profile[base].1.ink;
        let corner = |step: f64, off: f64| [along(step), axis(along(step)) + off];
        Some(([corner(tip, 0.0), corner(base as f64, -half), corner(base as f64, half)], head))
    };
    let either = |forwards| head(forwards, Head::Filled).or_else(|| head(forwards, Head::Open));
    [true, false].into_iter().filter_map(either).collect()
}

/// The step of the base and the tip of an arrowhead in the widths along a line towards its end.
fn head_in(widths: &[Width]) -> Option<(usize, f64)> {
    let mut inside: Vec<f64> = widths.iter().take(INSIDE).map(|w| w.ink).filter(|w| *w > 0.0).collect();
    let at = inside.len() / 2;
    let line =
        if inside.is_empty() { return None } else { *inside.select_nth_unstable_by(at, f64::total_cmp).1 };
    let rises = |k: &usize| {
        let own = widths[*k].ink;
        own >= line + 2.0 && own >= 2.0 * line && widths[*k - 3..*k].iter().any(|w| w.ink <= line + 1.0)
    };
    let is_top = |k: &usize| widths[*k].ink >= widths[*k + 1].ink && widths[*k].pixels > 0;
    (3..widths.len().saturating_sub(5)).filter(rises).filter(is_top).find_map(|base| {
        let top = widths[base].ink;
        let mut half = None;
        let mut end = base;
        while end + 1 < widths.len() && widths[end + 1].ink <= widths[end].ink + 0.5 {
            end += 1;
            if widths[end].ink <= 0.5 * top {
                let [before, own] = [widths[end - 1].ink, widths[end].ink];
                half = Some((end - 1) as f64 + (before - 0.5 * top) / (before - own).max(1e-9));
                break;
            }
        }
        let length = 2.0 * (half? - base as f64);
        // An even fall has three quarters of the width on average until half of it.
        let mean = widths[base..end].iter().map(|w| w.ink).sum::<f64>() / (end - base) as f64;
        if !SLENDERNESS.contains(&(length / top)) || (mean / top - 0.77).abs() > 0.13 {
            return None;
        }
        let tip = base as f64 + length;
        // Tips touch the middle of an extension line, which is a wide run.
        let wide = |k: &usize| widths[*k].pixels as f64 > top.max(widths[end].pixels as f64 + 3.0);
        let crossing: Vec<usize> =
            (end + 1..widths.len().min(end + 80)).skip_while(|k| !wide(k)).take_while(wide).collect();
        let middle = crossing.first().map(|first| 0.5 * (first + crossing[crossing.len() - 1]) as f64);
        let near = middle.filter(|m| crossing.len() < 9 && (m - tip).abs() <= 2.0 + 0.8 * length);
        Some((base, near.unwrap_or(tip)))
    })
}
