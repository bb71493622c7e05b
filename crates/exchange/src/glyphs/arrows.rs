//! Arrowheads: the width of a line rises suddenly at their base and falls evenly to zero at their tip.

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

/// A mask as seen along a line.
pub(super) struct MaskView<F: Fn(usize, usize) -> bool> {
    pub(super) length: usize,
    pub(super) across: usize,
    pub(super) is_ink: F,
}

impl<F: Fn(usize, usize) -> bool> MaskView<F> {
    /// The run of ink through a place, if it is not wider than arrowheads.
    fn run(&self, along: usize, at: f64) -> Option<(usize, usize)> {
        let start = at.round();
        let inside = start >= 0.0 && (start as usize) < self.across && (self.is_ink)(along, start as usize);
        if !inside {
            return None;
        }
        let (mut low, mut high) = (start as usize, start as usize);
        while low > 0 && high - low <= WIDEST && (self.is_ink)(along, low - 1) {
            low -= 1;
        }
        while high + 1 < self.across && high - low <= WIDEST && (self.is_ink)(along, high + 1) {
            high += 1;
        }
        Some((low, high))
    }
}

/// Arrowheads at the two ends of a part of a line: their corners along and across it, the tip first.
pub(super) fn arrowheads_of<F: Fn(usize, usize) -> bool>(
    chain: &Chain,
    view: &MaskView<F>,
) -> Vec<[[f64; 2]; 3]> {
    let mut widths: Vec<u32> = chain.bands.iter().map(|(low, high)| high - low + 1).collect();
    widths.sort_unstable();
    let line = f64::from(widths[widths.len() / 2]);
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
        let profile: Vec<(usize, f64)> = (0..INSIDE + BEYOND)
            .filter_map(|k| {
                let at = place(k)?;
                let run = view.run(at, axis(at as f64));
                Some((at, run.map_or(0.0, |(low, high)| (high - low + 1) as f64)))
            })
            .collect();
        let (base, tip) = head_in(&profile.iter().map(|p| p.1).collect::<Vec<f64>>(), line)?;
        let along = |step: f64| {
            let first = profile[0].0 as f64;
            if forwards { first + step } else { first - step }
        };
        // Flags of `1` and serifs are on one side.
        let at = profile[base].0;
        let (low, high) = view.run(at, axis(at as f64))?;
        let off = 0.5 * (low + high) as f64 - axis(at as f64);
        if off.abs() > 0.7 + ASYMMETRY * profile[base].1 {
            return None;
        }
        let half = 0.5 * profile[base].1;
        let corner = |step: f64, off: f64| [along(step), axis(along(step)) + off];
        Some([corner(tip, 0.0), corner(base as f64, -half), corner(base as f64, half)])
    };
    [true, false].into_iter().filter_map(head).collect()
}

/// The step of the base and the tip of an arrowhead in the widths along a line towards its end.
fn head_in(widths: &[f64], line: f64) -> Option<(usize, f64)> {
    let rises = |k: &usize| widths[*k] >= line + 3.0 && widths[*k - 3..*k].iter().any(|w| *w <= line + 1.5);
    let is_top =
        |k: &usize| widths[*k] > widths[*k + 1] || widths[*k..].windows(2).take(3).any(|w| w[1] < w[0]);
    (3..widths.len().saturating_sub(5)).filter(rises).filter(is_top).find_map(|base| {
        let mut end = base;
        let mut least = widths[base];
        while end + 1 < widths.len() && widths[end + 1] > 0.0 && widths[end + 1] <= least + 1.0 {
            end += 1;
            least = least.min(widths[end]);
        }
        // The fall may go on along a line behind the tip of an arrowhead that points inwards.
        let tip = (base..=end).find(|k| widths[*k] <= line.min(2.0)).unwrap_or(end);
        let length = (tip - base + 1) as f64;
        let area: f64 = widths[base..=tip].iter().sum();
        let even = area / (0.5 * length * (widths[base] + widths[tip]));
        let is_head = widths[tip] <= line + 1.5
            && widths[base] >= 2.0 * widths[tip]
            && SLENDERNESS.contains(&(length / widths[base]))
            && (0.75..=1.25).contains(&even);
        if !is_head {
            return None;
        }
        // Tips touch the middle of an extension line, which is a wide run.
        let wide = |k: &usize| widths[*k] > least + 3.0;
        let crossing: Vec<usize> =
            (tip + 1..widths.len().min(tip + 12)).skip_while(|k| !wide(k)).take_while(wide).collect();
        let near = crossing.first().is_some_and(|k| k - tip <= 4) && crossing.len() < 9;
        let at = match near {
            true => 0.5 * (crossing[0] + crossing[crossing.len() - 1]) as f64,
            // The width falls to zero about half a pixel behind the last one.
            false => tip as f64 + 0.5,
        };
        Some((base, at))
    })
}
