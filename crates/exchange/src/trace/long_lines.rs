//! Long straight lines of a picture, from which its rotation and perspective follow.

use super::ink::Ink;

/// Largest thickness of a line in pixels.
const THICKEST: usize = 24;
/// Minimum length in pixels, and relative to the longest side of the picture: lines of texts are shorter.
const SHORTEST: [f64; 2] = [60.0, 0.02];
/// Pixels at each end of a line where others may join it.
const TRIM: usize = 4;
/// Largest slope: 20 degrees of tilt and of rotation together.
const STEEPEST: f64 = 0.36;
/// Bend of a straight line (mean of the middle third beside those of the outer thirds) in pixels. An arc of
/// 60 pixels has more below a radius of 900 pixels.
const STRAIGHT: f64 = 0.3;
/// σ of a point, in pixels; neighbours share errors over this many.
const POINT_SIGMA: f64 = 0.15;
const CORRELATION: f64 = 8.0;
/// σ of directions of drawn lines, in radians: paper and scanners are not exact.
const DIRECTION_SIGMA: f64 = 2e-4;

/// A long line that runs along rows, or along columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct LongLine {
    /// Place of its middle: along the rows (or columns) and across them.
    pub(super) middle: [f64; 2],
    /// Step across per step along.
    pub(super) slope: f64,
    /// σ of the slope.
    pub(super) sigma: f64,
    pub(super) length: f64,
    /// Coverage summed across the line: its width in pixels.
    pub(super) width: f64,
}

/// A run of ink across the lines: first and last pixel, the middle of the ink and its sum.
#[derive(Debug, Clone, Copy)]
struct Run {
    first: usize,
    last: usize,
    middle: f64,
    width: f64,
}

/// Runs that continue each other.
#[derive(Debug, Clone)]
struct Chain {
    first: usize,
    runs: Vec<Run>,
}

/// Long lines along rows, or along columns.
pub(super) fn long_lines(ink: &Ink, along_columns: bool) -> Vec<LongLine> {
    let size = ink.columns.max(ink.rows) as f64;
    let shortest = SHORTEST[0].max(SHORTEST[1] * size) as usize + 2 * TRIM;
    let (length, across) = match along_columns {
        true => (ink.rows, ink.columns),
        false => (ink.columns, ink.rows),
    };
    let index = |along: usize, across: usize| match along_columns {
        true => along * ink.columns + across,
        false => across * ink.columns + along,
    };
    let mut found = Vec::new();
    let mut keep = |chain: Chain| {
        if chain.runs.len() >= shortest
            && let Some(line) = straight(&chain)
        {
            found.push(line);
        }
    };
    let mut open: Vec<Chain> = Vec::new();
    for along in 0..length {
        let runs = runs_of(across, |at| ink.mask[index(along, at)], |at| ink.coverage[index(along, at)]);
        let mut next: Vec<Chain> = Vec::with_capacity(runs.len());
        let mut earlier = open.into_iter().peekable();
        for run in runs {
            let mut own = None;
            while let Some(chain) = earlier.peek() {
                let last = chain.runs[chain.runs.len() - 1];
                let step = run.middle - last.middle;
                if step < -1.0 {
                    break;
                }
                let is_next = step <= 1.0
                    && (last.last - last.first).abs_diff(run.last - run.first) <= 2
                    && own.is_none();
                let chain = earlier.next();
                match is_next {
                    true => own = chain,
                    false => chain.into_iter().for_each(&mut keep),
                }
            }
            let mut chain = own.unwrap_or_else(|| Chain { first: along, runs: Vec::new() });
            chain.runs.push(run);
            next.push(chain);
        }
        earlier.for_each(&mut keep);
        open = next;
    }
    open.into_iter().for_each(&mut keep);
    found
}

fn runs_of(across: usize, is_ink: impl Fn(usize) -> bool, coverage: impl Fn(usize) -> f32) -> Vec<Run> {
    let mut runs = Vec::new();
    let mut at = 0;
    while at < across {
        if !is_ink(at) {
            at += 1;
            continue;
        }
        let first = at;
        while at < across && is_ink(at) {
            at += 1;
        }
        let last = at - 1;
        if last - first >= THICKEST {
            continue;
        }
        let (mut sum, mut moment) = (0.0, 0.0);
        for k in first.saturating_sub(2)..=(last + 2).min(across - 1) {
            let own = f64::from(coverage(k).max(0.0));
            sum += own;
            moment += own * k as f64;
        }
        runs.push(Run { first, last, middle: moment / sum.max(1e-9), width: sum });
    }
    runs
}

/// The line through a chain; none if it is bent or steep.
fn straight(chain: &Chain) -> Option<LongLine> {
    let runs = &chain.runs[TRIM..chain.runs.len() - TRIM];
    let n = runs.len() as f64;
    let center = 0.5 * (n - 1.0);
    let mean = |values: &[Run]| values.iter().map(|r| r.middle).sum::<f64>() / values.len().max(1) as f64;
    let across = mean(runs);
    let (mut top, mut bottom) = (0.0, 0.0);
    for (k, run) in runs.iter().enumerate() {
        let t = k as f64 - center;
        top += t * (run.middle - across);
        bottom += t * t;
    }
    let slope = top / bottom;
    let third = runs.len() / 3;
    let bend = mean(&runs[third..runs.len() - third])
        - 0.5 * (mean(&runs[..third]) + mean(&runs[runs.len() - third..]));
    if slope.abs() > STEEPEST || bend.abs() > STRAIGHT {
        return None;
    }
    let squares: f64 = (runs.iter().enumerate())
        .map(|(k, run)| (run.middle - across - slope * (k as f64 - center)).powi(2))
        .sum();
    let sigma = (squares / n).sqrt().max(POINT_SIGMA);
    let mut widths: Vec<f64> = runs.iter().map(|r| r.width).collect();
    widths.sort_by(f64::total_cmp);
    Some(LongLine {
        middle: [chain.first as f64 + TRIM as f64 + center, across],
        slope,
        sigma: (sigma * (CORRELATION / bottom).sqrt()).hypot(DIRECTION_SIGMA),
        length: n,
        width: widths[widths.len() / 2] / (1.0 + slope * slope).sqrt(),
    })
}
