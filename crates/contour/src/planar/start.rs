//! Initial parameters of a contour, derived from the readings alone.
//!
//! In: readings and a kind. Out: one or more starts; the fit tries all and keeps the best. Not guaranteed: a
//! start near the optimum for readings of a small part of the contour.

mod hull;
mod sampled;
mod segments;
mod sequence;
mod tour;

use super::fit::reading_count;
use super::kind::ContourKind;
use super::reading::ContourReading;
use nalgebra::{Matrix3, Vector3};
use planish_estimate::Result;
use sampled::Curve;
pub(crate) use segments::MAX_PIECES;
use segments::{chains, polygon};
use sequence::Sequence;
pub(super) use sequence::Sums;

/// Initial parameters of a kind, most promising first; empty if the readings suggest none.
///
/// | kind | method |
/// |---|---|
/// | line | least squares, and least median of distances |
/// | circle | Taubin's algebraic fit, and least median of distances |
/// | ellipse | direct fit of Halíř and Flusser, and least median of distances |
/// | rectangle, slot | box with the smallest mean distance over all orientations |
/// | regular polygon | search over the phase around Taubin's circle |
/// | polygon | optimal segmentation by dynamic programming; up to four corners, also the convex hull |
///
/// The least median is added only if outliers pull the other fit away. Chains have no starts here, because
/// the segmentation also determines their kind.
///
/// # Errors
/// `Undetermined` with fewer readings than parameters.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourKind, points, starts};
///
/// let readings = points(&ContourKind::Circle, &[1.0, 2.0, 5.0], 100, 0.01, 1).noisy;
/// let circles = starts(&ContourKind::Circle, &readings)?;
/// assert!((circles[0][2] - 5.0).abs() < 0.01);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Taubin 1991, *Estimation of planar curves*; Halíř and Flusser 1998, *Numerically stable direct least
/// squares fitting of ellipses*; Bellman 1961, *On the approximation of curves by line segments using dynamic
/// programming*.
pub fn starts(kind: &ContourKind, readings: &[ContourReading]) -> Result<Vec<Vec<f64>>> {
    let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
    if points.len() < kind.parameters() {
        return Err(planish_estimate::Error::undetermined(format!(
            "{} cannot determine the {} parameters of a {kind}",
            reading_count(points.len()),
            kind.parameters()
        )));
    }
    Ok(match kind {
        ContourKind::Line => {
            let curve = Curve {
                needed: 2,
                fit: &|p| (p.len() > 1).then(|| line(p)),
                distance: &|l, p| p[1] * l[0].cos() - p[0] * l[0].sin() - l[1],
            };
            with_sampled(&curve, vec![line(&points)], &points)
        }
        ContourKind::Circle => {
            let curve =
                Curve { needed: 3, fit: &circle, distance: &|c, p| (p[0] - c[0]).hypot(p[1] - c[1]) - c[2] };
            with_sampled(&curve, circle(&points).into_iter().collect(), &points)
        }
        ContourKind::Ellipse => {
            let curve = Curve { needed: 5, fit: &direct_ellipse, distance: &|e, p| from_ellipse(e, p) };
            with_sampled(&curve, ellipse_starts(&points), &points)
        }
        ContourKind::Rectangle => boxes(&points).into_iter().map(|b| b.to_vec()).collect(),
        ContourKind::RoundedRectangle => {
            // Two corner radii, as fractions of the shorter side: a fit that starts far from its radius
            // assigns readings to the wrong pieces.
            let shares = [0.35, 0.15];
            let with = |b: &[f64; 5], share: f64| [&b[..], &[share * b[2].min(b[3])]].concat();
            boxes(&points).iter().flat_map(|b| shares.map(|share| with(b, share))).collect()
        }
        ContourKind::Slot => boxes(&points).into_iter().map(slot_of).collect(),
        ContourKind::RegularPolygon(sides) => regular(&points, *sides),
        ContourKind::Polygon(count) => {
            let mut found: Vec<Vec<f64>> =
                Sequence::closed(readings).iter().filter_map(|sequence| polygon(sequence, *count)).collect();
            // Segments easily miss a sharp corner with few readings; the hull contains it. Only polygons of
            // few corners have sharp ones, if they are convex.
            if *count <= 4 {
                found.extend(hull::polygon(&points, *count));
            }
            found
        }
        ContourKind::Chain { .. } => Vec::new(),
    })
}

/// Adds the least-median curve to the starts if it is clearly nearer to half of the points than any of them.
fn with_sampled(curve: &Curve<'_>, mut starts: Vec<Vec<f64>>, points: &[[f64; 2]]) -> Vec<Vec<f64>> {
    // Without outliers, the least-median curve is a noisier version of the same start and would only cost
    // time.
    const CLEARLY_SMALLER: f64 = 0.85;
    if let Some(sampled) = curve.least_median_curve(points) {
        let min_median = starts.iter().map(|s| curve.median(s, points)).fold(f64::INFINITY, f64::min);
        if curve.median(&sampled, points) < CLEARLY_SMALLER * min_median {
            starts.push(sampled);
        }
    }
    starts
}

/// Signed distance of a point from an ellipse along the line to its centre.
fn from_ellipse(e: &[f64], p: [f64; 2]) -> f64 {
    let (sin, cos) = e[4].sin_cos();
    let d = [p[0] - e[0], p[1] - e[1]];
    let scaled = ((cos * d[0] + sin * d[1]) / e[2]).hypot((cos * d[1] - sin * d[0]) / e[3]);
    d[0].hypot(d[1]) * (1.0 - 1.0 / scaled.max(f64::MIN_POSITIVE))
}

/// Closed and open chains of lines and arcs that may explain the readings: their kinds with parameters.
#[must_use]
pub(crate) fn chain_starts(readings: &[ContourReading]) -> Vec<(ContourKind, Vec<f64>)> {
    let mut found: Vec<_> = Sequence::closed(readings).iter().flat_map(chains).collect();
    found.extend(Sequence::open(readings).iter().flat_map(chains));
    found
}

/// Centroid of the points.
pub(crate) fn mean(points: &[[f64; 2]]) -> [f64; 2] {
    let n = points.len().max(1) as f64;
    [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / n)
}

/// Line of total least squares: `angle_rad offset`.
fn line(points: &[[f64; 2]]) -> Vec<f64> {
    let c = mean(points);
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for p in points {
        let d = [p[0] - c[0], p[1] - c[1]];
        xx += d[0] * d[0];
        xy += d[0] * d[1];
        yy += d[1] * d[1];
    }
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    vec![angle, c[1] * angle.cos() - c[0] * angle.sin()]
}

/// Taubin's algebraic circle fit: `center_x center_y radius`; `None` if the points are collinear.
///
/// Uses Newton's method on the characteristic polynomial (Chernov's implementation). Unlike Kåsa's fit, it
/// does not shrink circles of which a short arc was observed.
///
/// # Examples
/// ```
/// use planish_contour::planar::circle_of_points;
///
/// let circle = circle_of_points(&[[2.0, 0.0], [0.0, 2.0], [-2.0, 0.0]]).ok_or("no circle")?;
/// assert!((circle[2] - 2.0).abs() < 1e-12);
/// assert!(circle_of_points(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]).is_none());
/// # Ok::<(), &str>(())
/// ```
#[must_use]
pub fn circle(points: &[[f64; 2]]) -> Option<Vec<f64>> {
    let c = mean(points);
    let n = points.len() as f64;
    let [mut xx, mut xy, mut yy, mut xz, mut yz, mut zz] = [0.0; 6];
    for p in points {
        let (x, y) = (p[0] - c[0], p[1] - c[1]);
        let z = x * x + y * y;
        xx += x * x / n;
        xy += x * y / n;
        yy += y * y / n;
        xz += x * z / n;
        yz += y * z / n;
        zz += z * z / n;
    }
    let ([x, y], radius) = circle_of_moments([xx, xy, yy, xz, yz, zz])?;
    Some(vec![x + c[0], y + c[1], radius])
}

/// Taubin's circle of points about their centroid, given the means of `x², xy, y², xz, yz` and `z²` with
/// `z = x² + y²`: its centre, relative to the centroid, and its radius. `None` if the points are collinear.
#[must_use]
pub fn circle_of_moments([xx, xy, yy, xz, yz, zz]: [f64; 6]) -> Option<([f64; 2], f64)> {
    let z = xx + yy;
    let determinant = xx * yy - xy * xy;
    let variance = zz - z * z;
    let a3 = 4.0 * z;
    let a2 = -3.0 * z * z - zz;
    let a1 = variance * z + 4.0 * determinant * z - xz * xz - yz * yz;
    let a0 = xz * (xz * yy - yz * xy) + yz * (yz * xx - xz * xy) - variance * determinant;
    // From zero, Newton's method converges monotonically to the smallest root, which is the one wanted.
    let (mut x, mut y) = (0.0, a0);
    for _ in 0..99 {
        let slope = a1 + x * (2.0 * a2 + 3.0 * a3 * x);
        let next = x - y / slope;
        if !next.is_finite() || (next - x).abs() <= 1e-15 * x.abs() {
            break;
        }
        let value = a0 + next * (a1 + next * (a2 + next * a3));
        if value.abs() >= y.abs() {
            break;
        }
        (x, y) = (next, value);
    }
    let d = x * x - x * z + determinant;
    let center = [(xz * (yy - x) - yz * xy) / (2.0 * d), (yz * (xx - x) - xz * xy) / (2.0 * d)];
    let radius = (center[0] * center[0] + center[1] * center[1] + z).sqrt();
    (radius.is_finite() && radius > 0.0).then_some((center, radius))
}

/// The direct fit, and an ellipse slightly larger than half the best box, for readings where the direct fit
/// fails.
fn ellipse_starts(points: &[[f64; 2]]) -> Vec<Vec<f64>> {
    let mut found: Vec<Vec<f64>> = direct_ellipse(points).into_iter().collect();
    if let Some(b) = boxes(points).first() {
        found.push(vec![b[0], b[1], 0.52 * b[2], 0.52 * b[3], b[4]]);
    }
    found
}

/// Direct least-squares fit of an ellipse (Halíř and Flusser); `None` if there is no elliptic solution.
fn direct_ellipse(points: &[[f64; 2]]) -> Option<Vec<f64>> {
    let c = mean(points);
    // Centring and scaling keep the fourth powers of the coordinates comparable with 1.
    let spread = points.iter().map(|p| (p[0] - c[0]).hypot(p[1] - c[1])).sum::<f64>() / points.len() as f64;
    let (mut s1, mut s2, mut s3) = (Matrix3::zeros(), Matrix3::zeros(), Matrix3::zeros());
    for p in points {
        let (x, y) = ((p[0] - c[0]) / spread, (p[1] - c[1]) / spread);
        let quadratic = Vector3::new(x * x, x * y, y * y);
        let linear = Vector3::new(x, y, 1.0);
        s1 += quadratic * quadratic.transpose();
        s2 += quadratic * linear.transpose();
        s3 += linear * linear.transpose();
    }
    // Eliminate the linear terms, then solve the reduced eigenproblem of order 3; the full one of order 6 has
    // a singular constraint matrix and is ill-conditioned.
    let t = -s3.try_inverse()? * s2.transpose();
    let reduced = s1 + s2 * t;
    let swapped = Matrix3::from_rows(&[0.5 * reduced.row(2), -reduced.row(1), 0.5 * reduced.row(0)]);
    // The eigenvalue iteration does not terminate for NaN, which arises if all readings coincide.
    if !swapped.iter().all(|value| value.is_finite()) {
        return None;
    }
    let values = swapped.complex_eigenvalues();
    let mut best: Option<[f64; 6]> = None;
    for value in values.iter().filter(|v| v.im.abs() < 1e-9 * (1.0 + v.re.abs())) {
        let shifted = swapped - Matrix3::identity() * value.re;
        let decomposition = shifted.svd(false, true);
        let vector = decomposition.v_t?.row(2).transpose();
        // Exactly one eigenvector satisfies 4ac − b² > 0, the condition of an ellipse.
        if 4.0 * vector[0] * vector[2] - vector[1] * vector[1] > 0.0 {
            let rest = t * vector;
            best = Some([vector[0], vector[1], vector[2], rest[0], rest[1], rest[2]]);
        }
    }
    let [a, b, d, e, f, g] = best?;
    // Centre of the conic, then the axes from the quadratic form about it.
    let determinant = 4.0 * a * d - b * b;
    let center = [(b * f - 2.0 * d * e) / determinant, (b * e - 2.0 * a * f) / determinant];
    let value = g + 0.5 * (e * center[0] + f * center[1]);
    let angle = 0.5 * b.atan2(a - d);
    let (sin, cos) = angle.sin_cos();
    let along = a * cos * cos + b * sin * cos + d * sin * sin;
    let across = a * sin * sin - b * sin * cos + d * cos * cos;
    let axes = [(-value / along).sqrt(), (-value / across).sqrt()];
    let result =
        [c[0] + spread * center[0], c[1] + spread * center[1], spread * axes[0], spread * axes[1], angle];
    result.iter().all(|v| v.is_finite()).then(|| result.to_vec())
}

/// The two best boxes `cx cy w h angle` among 45 orientations, by the mean squared distance of the points to
/// their sides.
///
/// The second differs in direction by at least 0.2 rad: noise and uneven readings can make a wrong
/// orientation the best one.
pub(crate) fn boxes(points: &[[f64; 2]]) -> Vec<[f64; 5]> {
    let steps = 45;
    let mut found: Vec<(f64, [f64; 5])> = (0..steps)
        .map(|k| {
            let angle = std::f64::consts::FRAC_PI_2 * f64::from(k) / f64::from(steps);
            box_at(points, angle)
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(first) = found.first().copied() else {
        return Vec::new();
    };
    let far = |angle: f64| {
        let apart = (angle - first.1[4]).rem_euclid(std::f64::consts::FRAC_PI_2);
        apart.min(std::f64::consts::FRAC_PI_2 - apart) > 0.2
    };
    let second = found.iter().find(|b| far(b.1[4])).copied();
    std::iter::once(first).chain(second).map(|b| b.1).collect()
}

/// The box of the points at an angle, with the sum of squared distances to its sides.
fn box_at(points: &[[f64; 2]], angle: f64) -> (f64, [f64; 5]) {
    let (sin, cos) = angle.sin_cos();
    let mut axes = [0, 1].map(|axis| -> Vec<f64> {
        let along = |p: &[f64; 2]| {
            if axis == 0 { cos * p[0] + sin * p[1] } else { cos * p[1] - sin * p[0] }
        };
        points.iter().map(along).collect()
    });
    let raw = axes.clone();
    let bounds = [0, 1].map(|axis: usize| {
        let values = &mut axes[axis];
        values.sort_by(f64::total_cmp);
        let n = values.len();
        // Noise and outliers lie outside of the true sides: cut 4 % of the points at each end.
        let cut = n / 25;
        [values[cut], values[n - 1 - cut]]
    });
    let mut sum = 0.0;
    for i in 0..points.len() {
        let nearest = [0, 1]
            .iter()
            .flat_map(|&axis| bounds[axis].map(|bound| (raw[axis][i] - bound).abs()))
            .fold(f64::INFINITY, f64::min);
        sum += nearest * nearest;
    }
    let middle = [0, 1].map(|axis: usize| 0.5 * (bounds[axis][0] + bounds[axis][1]));
    let size = [0, 1].map(|axis: usize| bounds[axis][1] - bounds[axis][0]);
    (
        sum,
        [
            cos * middle[0] - sin * middle[1],
            sin * middle[0] + cos * middle[1],
            size[0].max(f64::MIN_POSITIVE),
            size[1].max(f64::MIN_POSITIVE),
            angle,
        ],
    )
}

/// A slot in a box; its length exceeds its width by at least 5 %, as the kind requires.
fn slot_of(b: [f64; 5]) -> Vec<f64> {
    let turned = if b[2] >= b[3] { b } else { [b[0], b[1], b[3], b[2], b[4] + std::f64::consts::FRAC_PI_2] };
    vec![turned[0], turned[1], turned[2].max(1.05 * turned[3]), turned[3], turned[4]]
}

/// Regular polygons of the two best phases around Taubin's circle.
fn regular(points: &[[f64; 2]], sides: usize) -> Vec<Vec<f64>> {
    let Some(around) = circle(points) else {
        return Vec::new();
    };
    let center = [around[0], around[1]];
    let sector = std::f64::consts::TAU / sides as f64;
    let steps = 16;
    let mut found: Vec<(f64, Vec<f64>)> = (0..steps)
        .map(|k| {
            let phase = sector * f64::from(k) / f64::from(steps);
            // The circumradius that each point implies if it lies on the side of its sector.
            let radii: Vec<f64> = points
                .iter()
                .map(|p| {
                    let d = [p[0] - center[0], p[1] - center[1]];
                    let within = (d[1].atan2(d[0]) - phase).rem_euclid(sector) - 0.5 * sector;
                    d[0].hypot(d[1]) * within.cos() / (0.5 * sector).cos()
                })
                .collect();
            let radius = radii.iter().sum::<f64>() / radii.len() as f64;
            let cost = radii.iter().map(|r| (r - radius).powi(2)).sum::<f64>() / (radius * radius);
            (cost, vec![center[0], center[1], radius, phase])
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().take(2).map(|(_, start)| start).collect()
}
