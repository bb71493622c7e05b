//! Rotation and perspective of scanned and photographed sheets.
//!
//! **Input.** The ink of a picture, and the edges of the page in a photograph.
//!
//! **Output.** The homography from pixels of the picture to those of the straight sheet, and the ink after
//! one resampling.
//!
//! Parallel lines of the sheet meet in a vanishing point. With the origin in the middle of the picture, that
//! of the horizontal lines is (1, m, e) in homogeneous coordinates: a line through (x, y) of slope t has
//! t = m − e (y − t x), which is linear in m and e. The same holds for the vertical lines. Rotation alone is
//! e = 0 for both, with one angle; it is preferred unless the lines or the edges of a page show perspective.
//!
//! **Limits.** Vanishing points do not determine the ratio of height to width. In photographs, the page is
//! assumed to have the ratio √2 of the A series (ISO 216) if it nearly has it. Curved pages and distortion of
//! lenses are not corrected.
//!
//! # References
//! Hartley, Zisserman, *Multiple View Geometry in Computer Vision*, 2003, section 2.7 (rectification from the
//! vanishing line) and 8.6 (vanishing points).

use super::ink::Ink;
use super::long_lines::{LongLine, long_lines};
use super::paper_edge::{Edge, Quad};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Residuals of slopes of lines of one family: in σ, and radians.
const AGREEMENT: [f64; 2] = [3.0, 1e-3];
/// Number of the longest lines that hypotheses are made of.
const HYPOTHESES: usize = 40;
/// Share of the length that agrees with a perspective from which a rotation is used instead.
const SUFFICIENT: f64 = 0.85;
/// Width of wide lines after resampling, in pixels: wider ones are made smaller, because the points of their
/// middles are no more accurate and noise is averaged. The tracing of lines has been tested at 1 to 4.
const WIDTH: f64 = 4.0;
/// Displacements below this many pixels are left as they are.
const NEGLIGIBLE: f64 = 0.25;
/// Largest difference of the logarithm of the ratio of a page from that of the A series.
const SAME_RATIO: f64 = 0.12;
/// Maximum number of pixels of the straight sheet.
const MAX_PIXELS: f64 = 120e6;

/// How a sheet lies in its picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placement {
    /// The straight sheet's pixels (y down) from those of the picture.
    pub(super) sheet_from_picture: Matrix3<f64>,
    /// Clockwise rotation in the middle of the picture as one sees it, in radians, and its σ.
    pub(super) rotation_rad: f64,
    pub(super) sigma_rad: f64,
    pub(super) perspective: Perspective,
}

/// Perspective of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Perspective {
    /// None: a scan.
    None,
    /// The ratio of height to width is that of a page of the A series.
    PageOfSeriesA,
    /// The ratio of height to width is not known: equal scales in the middle of the picture are assumed.
    UnknownRatio,
}

/// A vanishing point as (m, e), and the covariance.
#[derive(Debug, Clone, Copy)]
struct Vanishing {
    slope: f64,
    change: f64,
    covariance: Matrix2<f64>,
}

/// A line of one family in coordinates from the middle of the picture.
#[derive(Debug, Clone, Copy)]
struct Slope {
    along: f64,
    across: f64,
    slope: f64,
    sigma: f64,
    weight: f64,
}

impl Slope {
    /// Residual of the slope.
    fn off(&self, slope: f64, change: f64) -> f64 {
        self.slope - slope + change * (self.across - self.slope * self.along)
    }

    fn agrees(&self, slope: f64, change: f64) -> bool {
        self.off(slope, change).abs() <= AGREEMENT[0] * self.sigma + AGREEMENT[1]
    }
}

impl Placement {
    /// The placement that the long lines of a picture show; none if it needs no resampling.
    pub(super) fn find(ink: &Ink, page: Option<&Quad>) -> Option<Self> {
        let middle = [0.5 * (ink.columns as f64 - 1.0), 0.5 * (ink.rows as f64 - 1.0)];
        let lines = [long_lines(ink, false), long_lines(ink, true)];
        let widths: Vec<(f64, f64)> = lines.iter().flatten().map(|l| (l.width, l.length)).collect();
        let width = wide_width(widths)?;
        let mut families = [slopes(&lines[0], middle, 0), slopes(&lines[1], middle, 1)];
        if let Some(page) = page {
            for (k, edge) in page.edges.iter().enumerate() {
                families[k % 2].push(edge_slope(edge, middle, k % 2));
            }
        }
        families.iter_mut().for_each(|f| f.sort_by(|a, b| b.weight.total_cmp(&a.weight)));
        let rotation = rotation_of(&families)?;
        let points = [perspective_of(&families[0]), perspective_of(&families[1])];
        let length = |points: [(f64, f64); 2]| {
            let agreeing = |k: usize| families[k].iter().filter(move |s| s.agrees(points[k].0, points[k].1));
            (0..2).flat_map(agreeing).map(|s| s.weight).sum::<f64>()
        };
        let rotated = length([(rotation.0, 0.0), (-rotation.0, 0.0)]);
        let made = match points {
            [Some(h), Some(v)]
                if page.is_some()
                    || rotated < SUFFICIENT * length([(h.slope, h.change), (v.slope, v.change)]) =>
            {
                Self::with_perspective(h, v, middle, page)
            }
            _ => Self::with_rotation(rotation, middle),
        };
        let scale = (WIDTH / width).min(1.0);
        let is_known = rotation.0.abs() > 3.0 * rotation.1;
        let is_turned = is_known && rotation.0.abs() * ink.columns.max(ink.rows) as f64 > NEGLIGIBLE;
        let is_straight = made.perspective == Perspective::None && !is_turned;
        (!is_straight || scale < 0.9).then(|| made.scaled(scale))
    }

    fn with_rotation((slope, sigma): (f64, f64), middle: [f64; 2]) -> Self {
        let point = |slope: f64| Vanishing { slope, change: 0.0, covariance: Matrix2::zeros() };
        let made = Self::with_perspective(point(slope), point(-slope), middle, None);
        Self { sigma_rad: sigma, perspective: Perspective::None, ..made }
    }

    fn with_perspective(h: Vanishing, v: Vanishing, middle: [f64; 2], page: Option<&Quad>) -> Self {
        let (to_right, downwards) =
            (Vector3::new(1.0, h.slope, h.change), Vector3::new(v.slope, 1.0, v.change));
        let line = to_right.cross(&downwards);
        let line = line / line[2];
        let rows = [
            Vector3::new(1.0, -v.slope, 0.0) / (1.0 + v.slope * v.slope).sqrt(),
            Vector3::new(-h.slope, 1.0, 0.0) / (1.0 + h.slope * h.slope).sqrt(),
            line,
        ];
        let centred = Matrix3::from_rows(&rows.map(|r| r.transpose()));
        let shift = Matrix3::new(1.0, 0.0, -middle[0], 0.0, 1.0, -middle[1], 0.0, 0.0, 1.0);
        let mut made = Self {
            sheet_from_picture: centred * shift,
            rotation_rad: h.slope.atan(),
            sigma_rad: h.covariance[(0, 0)].sqrt().hypot(v.covariance[(0, 0)].sqrt()) * 0.5,
            perspective: Perspective::UnknownRatio,
        };
        if let Some(page) = page {
            let [a, b, c, d] = page.corners.map(|p| made.to_sheet(p));
            let (wide, high) = (0.5 * (b[0] - a[0] + c[0] - d[0]), 0.5 * (d[1] - a[1] + c[1] - b[1]));
            let ratio = (high / wide).abs().ln();
            let nominal = ratio.signum() * 2.0_f64.ln() / 2.0;
            if (ratio - nominal).abs() <= SAME_RATIO {
                // Half of the change for each axis keeps the number of pixels.
                let factor = (0.5 * (nominal - ratio)).exp();
                let change = Matrix3::from_diagonal(&Vector3::new(1.0 / factor, factor, 1.0));
                made.sheet_from_picture = change * made.sheet_from_picture;
                made.perspective = Perspective::PageOfSeriesA;
            }
        }
        made
    }

    fn scaled(mut self, scale: f64) -> Self {
        let change = Matrix3::from_diagonal(&Vector3::new(scale, scale, 1.0));
        self.sheet_from_picture = change * self.sheet_from_picture;
        self
    }

    /// A place of the picture on the straight sheet.
    pub(super) fn to_sheet(&self, p: [f64; 2]) -> [f64; 2] {
        mapped(&self.sheet_from_picture, p)
    }

    /// The ink of the straight sheet; the placement then refers to its pixels.
    pub(super) fn resampled(&mut self, ink: &Ink, page: Option<&Quad>) -> Option<Ink> {
        let [right, bottom] = [ink.columns as f64 - 1.0, ink.rows as f64 - 1.0];
        let whole = [[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]];
        let corners = page.map_or(whole, |page| page.corners).map(|p| self.to_sheet(p));
        let low = [0, 1].map(|k| corners.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min).floor());
        let high = [0, 1].map(|k| corners.iter().map(|c| c[k]).fold(f64::NEG_INFINITY, f64::max).ceil());
        let size = [0, 1].map(|k| high[k] - low[k] + 1.0);
        let is_possible = size[0] * size[1] < MAX_PIXELS;
        if !is_possible {
            return None;
        }
        self.sheet_from_picture =
            Matrix3::new(1.0, 0.0, -low[0], 0.0, 1.0, -low[1], 0.0, 0.0, 1.0) * self.sheet_from_picture;
        let inverse = self.sheet_from_picture.try_inverse()?;
        let [columns, rows] = size.map(|s| s as usize);
        // Pixels of the picture per pixel of the sheet.
        let at = |x: f64, y: f64| mapped(&inverse, [x, y]);
        let center = [0.5 * size[0], 0.5 * size[1]];
        let [p, q] = [at(center[0], center[1]), at(center[0] + 1.0, center[1])];
        let count = ((q[0] - p[0]).hypot(q[1] - p[1]) - 0.1).ceil().clamp(1.0, 6.0) as usize;
        let offsets: Vec<f64> = (0..count).map(|k| (k as f64 + 0.5) / count as f64 - 0.5).collect();
        let mut contrast = Vec::with_capacity(columns * rows);
        for y in 0..rows {
            for x in 0..columns {
                let mut sum = 0.0;
                for dy in &offsets {
                    for dx in &offsets {
                        let [u, v] = at(x as f64 + dx, y as f64 + dy);
                        if u >= 0.0 && v >= 0.0 && u <= right && v <= bottom {
                            sum += ink.at([u, v]);
                        }
                    }
                }
                contrast.push((sum / (count * count) as f64) as f32);
            }
        }
        Some(Ink::from_contrast(columns, rows, contrast))
    }
}

/// A point after a homography.
pub(super) fn mapped(map: &Matrix3<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    let p = map * Vector3::new(x, y, 1.0);
    [p[0] / p[2], p[1] / p[2]]
}

/// The width of wide lines: three quarters of the length of lines are at most as wide.
fn wide_width(mut widths: Vec<(f64, f64)>) -> Option<f64> {
    widths.sort_by(|a, b| a.0.total_cmp(&b.0));
    let all: f64 = widths.iter().map(|w| w.1).sum();
    let mut sum = 0.0;
    widths
        .iter()
        .find(|w| {
            sum += w.1;
            sum >= 0.75 * all
        })
        .map(|w| w.0)
}

fn slopes(lines: &[LongLine], middle: [f64; 2], axis: usize) -> Vec<Slope> {
    let from = |line: &LongLine| Slope {
        along: line.middle[0] - middle[axis],
        across: line.middle[1] - middle[1 - axis],
        slope: line.slope,
        sigma: line.sigma,
        weight: line.length,
    };
    lines.iter().map(from).collect()
}

/// An edge of the page as a line of the sheet; its length counts as a quarter of the picture.
fn edge_slope(edge: &Edge, middle: [f64; 2], axis: usize) -> Slope {
    let slope = edge.along[1 - axis] / edge.along[axis];
    Slope {
        along: edge.middle[axis] - middle[axis],
        across: edge.middle[1 - axis] - middle[1 - axis],
        slope,
        // Edges of paper are straight to a few tenths of a millimetre.
        sigma: edge.sigma.hypot(1e-3),
        weight: 0.5 * middle[axis],
    }
}

/// The rotation on which most lines of both families agree, as the slope of horizontal lines, and its σ.
fn rotation_of(families: &[Vec<Slope>; 2]) -> Option<(f64, f64)> {
    let mut all: Vec<Slope> = (families[0].iter().copied())
        .chain(families[1].iter().map(|s| Slope { slope: -s.slope, ..*s }))
        .collect();
    all.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let score = |slope: f64| all.iter().filter(|s| s.agrees(slope, 0.0)).map(|s| s.weight).sum::<f64>();
    let candidates = all.iter().take(2 * HYPOTHESES);
    let best = candidates.max_by(|a, b| score(a.slope).total_cmp(&score(b.slope)))?.slope;
    let (mut sum, mut weight) = (0.0, 0.0);
    for s in all.iter().filter(|s| s.agrees(best, 0.0)) {
        sum += s.slope / (s.sigma * s.sigma);
        weight += 1.0 / (s.sigma * s.sigma);
    }
    Some((sum / weight, 1.0 / weight.sqrt()))
}

/// The vanishing point on which most lines of a family agree.
fn perspective_of(family: &[Slope]) -> Option<Vanishing> {
    let few = &family[..family.len().min(HYPOTHESES)];
    let lever = |s: &Slope| s.across - s.slope * s.along;
    let score = |m: f64, e: f64| family.iter().filter(|s| s.agrees(m, e)).map(|s| s.weight).sum::<f64>();
    let mut best: Option<(f64, f64, f64)> = None;
    for (k, a) in few.iter().enumerate() {
        for b in &few[k + 1..] {
            let apart = lever(a) - lever(b);
            if apart.abs() < 20.0 {
                continue;
            }
            let change = (b.slope - a.slope) / apart;
            let slope = a.slope + change * lever(a);
            let own = score(slope, change);
            if best.is_none_or(|b| own > b.0) {
                best = Some((own, slope, change));
            }
        }
    }
    let (_, mut slope, mut change) = best?;
    let mut covariance = Matrix2::zeros();
    for _ in 0..3 {
        let mut m = Matrix2::zeros();
        let mut v = Vector2::zeros();
        for s in family.iter().filter(|s| s.agrees(slope, change)) {
            let (weight, row) = (1.0 / (s.sigma * s.sigma), Vector2::new(1.0, -lever(s)));
            m += weight * row * row.transpose();
            v += weight * row * s.slope;
        }
        covariance = m.try_inverse()?;
        let found = covariance * v;
        (slope, change) = (found[0], found[1]);
    }
    Some(Vanishing { slope, change, covariance })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ink of a grid of lines of a sheet, 2 pixels wide, seen through a map from the sheet to the picture.
    fn grid(picture_from_sheet: &Matrix3<f64>, size: usize) -> Ink {
        let back = picture_from_sheet.try_inverse().unwrap();
        let near = |c: f64| 1.5 - (c - 100.0 * (c / 100.0).round()).abs();
        let contrast = (0..size * size).map(|k| {
            let p = mapped(&back, [(k % size) as f64, (k / size) as f64]);
            near(p[0]).max(near(p[1])).clamp(0.0, 1.0) as f32
        });
        Ink::from_contrast(size, size, contrast.collect())
    }

    /// Largest change of angles and relative lengths of a square after rectification.
    fn misfit(placement: &Placement, picture_from_sheet: &Matrix3<f64>) -> f64 {
        let corners = [[120.0, 120.0], [480.0, 120.0], [480.0, 480.0], [120.0, 480.0]];
        let [a, b, c, d] = corners.map(|p| placement.to_sheet(mapped(picture_from_sheet, p)));
        let along = |p: [f64; 2], q: [f64; 2]| [q[0] - p[0], q[1] - p[1]];
        let [ab, dc, ad, bc] = [along(a, b), along(d, c), along(a, d), along(b, c)];
        let level = ab[1].abs().max(dc[1].abs()).max(ad[0].abs()).max(bc[0].abs());
        level.max((ab[0] - dc[0]).abs()).max((ad[1] - bc[1]).abs())
    }

    #[test]
    fn a_rotated_scan_is_turned_back() {
        let (sin, cos) = 0.03_f64.sin_cos();
        let map = Matrix3::new(cos, -sin, 10.0, sin, cos, -5.0, 0.0, 0.0, 1.0);
        let placement = Placement::find(&grid(&map, 600), None).unwrap();
        assert_eq!(placement.perspective, Perspective::None);
        assert!((placement.rotation_rad - 0.03).abs() < 5e-5 + 3.0 * placement.sigma_rad, "{placement:?}");
        assert!(misfit(&placement, &map) < 0.1, "{}", misfit(&placement, &map));
    }

    #[test]
    fn perspective_is_found_from_lines_alone() {
        let map = Matrix3::new(1.0, 0.01, 0.0, -0.02, 1.0, 12.0, 1e-4, 5e-5, 1.0);
        let placement = Placement::find(&grid(&map, 600), None).unwrap();
        assert_eq!(placement.perspective, Perspective::UnknownRatio);
        assert!(misfit(&placement, &map) < 0.3, "{}", misfit(&placement, &map));
    }

    #[test]
    fn a_straight_picture_is_left_as_it_is() {
        assert_eq!(Placement::find(&grid(&Matrix3::identity(), 600), None), None);
    }
}
