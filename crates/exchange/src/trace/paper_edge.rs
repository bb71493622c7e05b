//! The page in a photograph: a light quadrilateral on a darker background.

use nalgebra::{Matrix2, Vector2};
use planish_sense::Image;

/// Side of the blocks in which the page is looked for, in pixels.
const BLOCK: usize = 8;
/// Minimum share of the border of a photograph that is background, and the maximum share of the pixels.
const MIN_BACKGROUND_BORDER: f64 = 0.6;
const MAX_BACKGROUND: f64 = 0.8;
/// Profiles across each side of the page, and the share of them that must have a step.
const PROFILES: usize = 160;
const MIN_STEPS: f64 = 0.6;
/// Reach of the profiles in both passes, in pixels.
const REACHES: [i32; 2] = [28, 8];
/// A step has at least this share of the difference between page and background.
const STEP_SHARE: f32 = 0.4;
/// Shadows and the thickness of the paper beside its edge, in pixels.
const INSET: f64 = 6.0;

/// A straight edge: a point, its direction, and σ of its direction in radians.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) middle: [f64; 2],
    pub(super) along: [f64; 2],
    pub(super) sigma: f64,
}

/// A page in a photograph.
#[derive(Debug, Clone)]
pub(super) struct Quad {
    /// Upper left, upper right, lower right and lower left corner in pixels, y down.
    pub(super) corners: [[f64; 2]; 4],
    /// Upper, right, lower and left edge.
    pub(super) edges: [Edge; 4],
}

impl Quad {
    /// Whether a pixel is on the page, and not at its edge.
    pub(super) fn contains(&self, x: usize, y: usize) -> bool {
        let p = [x as f64, y as f64];
        (0..4).all(|k| {
            let (a, b) = (self.corners[k], self.corners[(k + 1) % 4]);
            let along = [b[0] - a[0], b[1] - a[1]];
            along[0] * (p[1] - a[1]) - along[1] * (p[0] - a[0]) > INSET * along[0].hypot(along[1])
        })
    }

    /// The page in a photograph; none if the picture has no darker background around a quadrilateral.
    pub(super) fn find(image: &Image) -> Option<Self> {
        let (wide, high) = (image.columns / BLOCK, image.rows / BLOCK);
        if wide < 20 || high < 20 {
            return None;
        }
        let mean = |k: usize| {
            let (i, j) = (k % wide * BLOCK, k / wide * BLOCK);
            let rows = (j..j + BLOCK).flat_map(|y| &image.values[y * image.columns + i..][..BLOCK]);
            rows.sum::<f32>() / (BLOCK * BLOCK) as f32
        };
        let blocks: Vec<f32> = (0..wide * high).map(mean).collect();
        let (level, dark, light) = two_levels(&blocks)?;
        let is_border =
            |k: usize| k.is_multiple_of(wide) || k % wide == wide - 1 || k < wide || k >= wide * (high - 1);
        let border: Vec<usize> = (0..blocks.len()).filter(|k| is_border(*k)).collect();
        let background = border.iter().filter(|k| blocks[**k] < level).count();
        let all_background = blocks.iter().filter(|b| **b < level).count();
        if (background as f64) < MIN_BACKGROUND_BORDER * border.len() as f64
            || all_background as f64 > MAX_BACKGROUND * blocks.len() as f64
        {
            return None;
        }
        let page = largest_part(&blocks, level, wide);
        let farthest = |sx: f64, sy: f64| {
            let place = |k: &usize| [(k % wide) as f64, (k / wide) as f64];
            let value = |k: &usize| sx * place(k)[0] + sy * place(k)[1];
            let found = page.iter().max_by(|a, b| value(a).total_cmp(&value(b)))?;
            Some(place(found).map(|c| (c + 0.5) * BLOCK as f64 - 0.5))
        };
        let mut corners =
            [farthest(-1.0, -1.0)?, farthest(1.0, -1.0)?, farthest(1.0, 1.0)?, farthest(-1.0, 1.0)?];
        let mut edges = None;
        for reach in REACHES {
            let found = [0, 1, 2, 3]
                .map(|k| edge_between(image, corners[k], corners[(k + 1) % 4], reach, light - dark));
            let [Some(a), Some(b), Some(c), Some(d)] = found else { return None };
            let sides = [a, b, c, d];
            for k in 0..4 {
                corners[k] = crossing(&sides[(k + 3) % 4], &sides[k])?;
            }
            edges = Some(sides);
        }
        Some(Self { corners, edges: edges? })
    }
}

/// The level between dark and light values (Otsu 1979), and both means; none if they are close.
fn two_levels(values: &[f32]) -> Option<(f32, f32, f32)> {
    let [low, high] = values.iter().fold([f32::MAX, f32::MIN], |[l, h], v| [l.min(*v), h.max(*v)]);
    let step = (high - low) / 64.0;
    if step.is_nan() || step <= 0.0 {
        return None;
    }
    let mut best: Option<(f64, f32, f32, f32)> = None;
    for k in 1..64 {
        let level = low + step * k as f32;
        let (mut sums, mut counts) = ([0.0_f64; 2], [0.0_f64; 2]);
        for v in values {
            let class = usize::from(*v >= level);
            sums[class] += f64::from(*v);
            counts[class] += 1.0;
        }
        if counts[0] == 0.0 || counts[1] == 0.0 {
            continue;
        }
        let means = [sums[0] / counts[0], sums[1] / counts[1]];
        let between = counts[0] * counts[1] * (means[1] - means[0]).powi(2);
        if best.is_none_or(|b| between > b.0) {
            best = Some((between, level, means[0] as f32, means[1] as f32));
        }
    }
    best.map(|(_, level, dark, light)| (level, dark, light))
}

/// The largest connected part of light blocks.
fn largest_part(blocks: &[f32], level: f32, wide: usize) -> Vec<usize> {
    let mut is_seen = vec![false; blocks.len()];
    let mut best = Vec::new();
    for first in 0..blocks.len() {
        if is_seen[first] || blocks[first] < level {
            continue;
        }
        is_seen[first] = true;
        let mut own = vec![first];
        let mut next = 0;
        while let Some(&k) = own.get(next) {
            next += 1;
            let beside = [
                (k % wide > 0).then(|| k - 1),
                (k % wide + 1 < wide).then_some(k + 1),
                k.checked_sub(wide),
                (k + wide < blocks.len()).then_some(k + wide),
            ];
            for other in beside.into_iter().flatten() {
                if !is_seen[other] && blocks[other] >= level {
                    is_seen[other] = true;
                    own.push(other);
                }
            }
        }
        if own.len() > best.len() {
            best = own;
        }
    }
    best
}

/// The edge of the page near a line, with the page at its right as one sees the picture.
fn edge_between(image: &Image, a: [f64; 2], b: [f64; 2], reach: i32, contrast: f32) -> Option<Edge> {
    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
    if length < 10.0 * BLOCK as f64 {
        return None;
    }
    let along = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    let inwards = [-along[1], along[0]];
    let mut points: Vec<[f64; 2]> = Vec::new();
    for k in 0..PROFILES {
        let t = length * (0.04 + 0.92 * (k as f64 + 0.5) / PROFILES as f64);
        let value = |n: i32| {
            let sum = (-2..=2).map(|d| {
                let (t, n) = (t + f64::from(d), f64::from(n));
                let p = [0, 1].map(|c| a[c] + t * along[c] + n * inwards[c]);
                image.between(p[0], p[1]).unwrap_or(f32::NAN)
            });
            sum.sum::<f32>() / 5.0
        };
        let profile: Vec<f32> = (-reach - 3..=reach + 3).map(value).collect();
        let rise = |k: usize| profile[k + 2] + profile[k + 1] - profile[k - 1] - profile[k - 2];
        let inner = 2..profile.len() - 2;
        let best = inner.filter(|k| rise(*k).is_finite()).max_by(|a, b| rise(*a).total_cmp(&rise(*b)));
        let Some(best) = best.filter(|k| rise(*k) > 2.0 * STEP_SHARE * contrast) else { continue };
        let mut off = best as f64 - f64::from(reach + 3);
        if best > 2 && best + 3 < profile.len() {
            let [l, m, r] = [rise(best - 1), rise(best), rise(best + 1)].map(f64::from);
            let bend = l - 2.0 * m + r;
            if bend < 0.0 {
                off += (0.5 * (l - r) / bend).clamp(-1.0, 1.0);
            }
        }
        points.push([t, off]);
    }
    if (points.len() as f64) < MIN_STEPS * PROFILES as f64 {
        return None;
    }
    let (level, slope, sigma) = robust_line(&mut points)?;
    let middle = [0, 1].map(|c| a[c] + 0.5 * length * along[c] + (level + slope * 0.5 * length) * inwards[c]);
    let direction = [0, 1].map(|c| along[c] + slope * inwards[c]);
    let norm = direction[0].hypot(direction[1]);
    Some(Edge { middle, along: direction.map(|c| c / norm), sigma })
}

/// Offset, slope and σ of the slope of a line through points, without those far from it.
fn robust_line(points: &mut Vec<[f64; 2]>) -> Option<(f64, f64, f64)> {
    let mut found = None;
    for _ in 0..6 {
        let n = points.len() as f64;
        if n < 10.0 {
            return None;
        }
        let mut m = Matrix2::zeros();
        let mut v = Vector2::zeros();
        for [t, off] in points.iter() {
            m += Matrix2::new(1.0, *t, *t, t * t);
            v += Vector2::new(*off, t * off);
        }
        let inverse = m.try_inverse()?;
        let line = inverse * v;
        let residual = |p: &[f64; 2]| (p[1] - line[0] - line[1] * p[0]).abs();
        let mut all: Vec<f64> = points.iter().map(residual).collect();
        all.sort_by(f64::total_cmp);
        let scale = (1.48 * all[all.len() / 2]).max(0.1);
        points.retain(|p| residual(p) <= 3.0 * scale);
        // Profiles beside each other share errors.
        found = Some((line[0], line[1], scale * (4.0 * inverse[(1, 1)]).sqrt()));
    }
    found
}

fn crossing(a: &Edge, b: &Edge) -> Option<[f64; 2]> {
    let cross = a.along[0] * b.along[1] - a.along[1] * b.along[0];
    let apart = [b.middle[0] - a.middle[0], b.middle[1] - a.middle[1]];
    let t = (apart[0] * b.along[1] - apart[1] * b.along[0]) / cross;
    t.is_finite().then(|| [0, 1].map(|c| a.middle[c] + t * a.along[c]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A light quadrilateral on a dark ground with a dark frame in it; a picture without a ground has none.
    #[test]
    fn the_edges_of_a_page_are_found_within_a_tenth_of_a_pixel() {
        let corners = [[60.3, 50.7], [540.2, 80.1], [520.9, 420.6], [40.4, 440.2]];
        let inside = |x: f64, y: f64| {
            let side = |k: usize| {
                let (a, b) = (corners[k], corners[(k + 1) % 4]);
                let along = [b[0] - a[0], b[1] - a[1]];
                (along[0] * (y - a[1]) - along[1] * (x - a[0])) / along[0].hypot(along[1])
            };
            (0..4).map(side).fold(f64::INFINITY, f64::min)
        };
        let value = |k: usize| {
            let depth = inside((k % 600) as f64, (k / 600) as f64);
            let is_line = (depth - 40.0).abs() < 1.0;
            let page = if is_line { 40.0 } else { 220.0 };
            (70.0 + (page - 70.0) * (depth + 0.5).clamp(0.0, 1.0)) as f32
        };
        let image = Image { columns: 600, rows: 500, values: (0..600 * 500).map(value).collect() };
        let page = Quad::find(&image).unwrap();
        for (found, true_corner) in page.corners.iter().zip(corners) {
            assert!((0..2).all(|k| (found[k] - true_corner[k]).abs() < 0.1), "{found:?} {true_corner:?}");
        }
        assert!(page.contains(300, 250) && !page.contains(30, 250));
        let paper = Image { columns: 600, rows: 500, values: vec![220.0; 600 * 500] };
        assert!(Quad::find(&paper).is_none());
    }
}
