//! Arrowheads: the width of a line rises suddenly at their base and falls evenly to zero at their tip.

use super::ink::STROKE;
use super::lines::Chain;

/// Steps inside of the end of a line where the base of an arrowhead is looked for; that of a drawing at 300 dpi
/// is 40 pixels long.
const INSIDE: usize = 60;
/// Steps beyond the end of a line.
const BEYOND: usize = 80;
/// Runs across a line of more pixels are extension lines.
const WIDEST: usize = 40;
/// Length of arrowheads in widths of their base.
const SLENDERNESS: std::ops::RangeInclusive<f64> = 1.2..=8.0;
/// Slope of lines along rows or columns of a page tilted by up to 3°. Strokes of letters such as `4` are steeper.
const STEEPEST: f64 = 0.06;
/// Maximum distance of the middle of a base from the line, in widths of the base.
const ASYMMETRY: f64 = 0.1;

/// Ink as seen along a line.
pub(super) struct InkAlong<F: Fn(usize, usize) -> f32> {
    pub(super) length: usize,
    pub(super) across: usize,
    pub(super) ink: F,
}

/// What is seen across a line at a step.
#[derive(Debug, Clone, Copy, Default)]
struct Width {
    /// Number of pixels of strokes.
    pixels: usize,
    /// Sum of their ink and that of the rim.
    ink: f64,
}

impl<F: Fn(usize, usize) -> f32> InkAlong<F> {
    fn is_stroke(&self, along: usize, at: usize) -> bool {
        (self.ink)(along, at) > STROKE
    }

    fn width(&self, along: usize, at: f64) -> Width {
        self.run(along, at).map_or(Width::default(), |(low, high)| {
            let rim = low.saturating_sub(1)..=(high + 1).min(self.across - 1);
            Width { pixels: high - low + 1, ink: rim.map(|at| f64::from((self.ink)(along, at))).sum() }
        })
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
pub(super) fn arrowheads_of<F: Fn(usize, usize) -> f32>(
    chain: &Chain,
    view: &InkAlong<F>,
) -> Vec<[[f64; 2]; 3]> {
    let slope = f64::from(chain.slope());
    if slope.abs() > STEEPEST {
        return Vec::new();
    }
    let middle = f64::from(chain.middle(chain.bands.len() / 2));
    let centre = (chain.first + chain.bands.len() / 2) as f64;
    let axis = |along: f64| middle + slope * (along - centre);
    let head = |forwards: bool| {
        let end = if forwards { chain.end() - 1 } else { chain.first };
        let place = |k: usize| match forwards {
            true => (end + k).checked_sub(INSIDE).filter(|p| *p < view.length),
            false => (end + INSIDE).checked_sub(k).filter(|p| *p < view.length),
        };
        let profile: Vec<(usize, Width)> =
            (0..INSIDE + BEYOND).filter_map(|k| place(k).map(|at| (at, view.width(at, axis(at as f64))))).collect();
        let (base, tip) = head_in(&profile.iter().map(|p| p.1).collect::<Vec<Width>>())?;
        let along = |step: f64| {
            let first = profile[0].0 as f64;
            if forwards { first + step } else { first - step }
        };
        // Flags of `1` and serifs are on one side.
        let at = profile[base].0;
        let (low, high) = view.run(at, axis(at as f64))?;
        let off = 0.5 * (low + high) as f64 - axis(at as f64);
        if off.abs() > 0.7 + ASYMMETRY * profile[base].1.ink {
            return None;
        }
        let half = 0.5 * profile[base].1.ink;
        let corner = |step: f64, off: f64| [along(step), axis(along(step)) + off];
        Some([corner(tip, 0.0), corner(base as f64, -half), corner(base as f64, half)])
    };
    [true, false].into_iter().filter_map(head).collect()
}

/// The step of the base and the tip of an arrowhead in the widths along a line towards its end.
fn head_in(widths: &[Width]) -> Option<(usize, f64)> {
    let mut inside: Vec<f64> = widths.iter().take(INSIDE).map(|w| w.ink).filter(|w| *w > 0.0).collect();
    let at = inside.len() / 2;
    let line = if inside.is_empty() { return None } else { *inside.select_nth_unstable_by(at, f64::total_cmp).1 };
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
        let near = middle.filter(|m| crossing.len() < 9 && (m - tip).abs() <= 2.0 + 0.2 * length);
        Some((base, near.unwrap_or(tip)))
    })
}
