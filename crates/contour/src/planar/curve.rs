//! Signed distance of a point to a piece of a contour, with its derivatives.
//!
//! Distances are those to the *carrier* of a piece (the infinite line or the whole circle), so that they are
//! smooth and their derivatives exact. Whether the foot point lies on the piece is a separate question
//! ([`beyond`], [`within`]).

use super::kind::ContourKind;

/// Signed distance `g` of a point `p`, and `∂g/∂p`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Distance {
    pub(crate) value: f64,
    pub(crate) by_point: [f64; 2],
}

/// Signed distance of `p` to the carrier of a piece, positive outside; fills `by_theta` with `∂g/∂θ`.
///
/// For an ellipse it is `√(ab) (|(q₁/a, q₂/b)| − 1)`, `q` being `p` in the axes of the ellipse. This is not
/// the Euclidean distance, but zero at the same points, in closed form, and singular only at the centre; the
/// exact distance needs the root of a quartic and has kinks on the major axis. The estimator divides by the
/// gradient, so only the zero set matters to first order.
pub(crate) fn distance(
    kind: &ContourKind,
    theta: &[f64],
    piece: usize,
    p: [f64; 2],
    by_theta: &mut [f64],
) -> Distance {
    by_theta.fill(0.0);
    match kind {
        ContourKind::Line => line(theta, p, by_theta),
        ContourKind::Circle => circle(theta, p, by_theta),
        ContourKind::Ellipse => ellipse(theta, p, by_theta),
        _ => {
            let (from, to) = ends(kind, piece);
            let (a, b) = (kind.vertex(theta, from), kind.vertex(theta, to));
            let (bulge, index) = kind.bulge(theta, piece);
            let at = if bulge == 0.0 { segment(a, b, p) } else { arc(a, b, bulge, p) };
            kind.add_vertex_derivative(theta, from, at.by_from, by_theta);
            kind.add_vertex_derivative(theta, to, at.by_to, by_theta);
            if let Some(index) = index {
                by_theta[index] += at.by_bulge;
            }
            at.distance
        }
    }
}

/// `∂²g/∂p²` of the distance to the carrier of a piece: `[xx, xy, yy]`.
pub(crate) fn distance_hessian(kind: &ContourKind, theta: &[f64], piece: usize, p: [f64; 2]) -> [f64; 3] {
    match kind {
        ContourKind::Line => [0.0; 3],
        ContourKind::Circle => round_hessian([theta[0], theta[1]], 1.0, p),
        ContourKind::Ellipse => {
            let (a, b) = (theta[2], theta[3]);
            let (sin, cos) = theta[4].sin_cos();
            let d = [p[0] - theta[0], p[1] - theta[1]];
            let scaled = [(cos * d[0] + sin * d[1]) / a, (cos * d[1] - sin * d[0]) / b];
            let length = scaled[0].hypot(scaled[1]);
            // In the scaled plane the Hessian is √(ab) (I − q qᵀ) / |q| with q a unit vector. That matrix has
            // rank one in the plane, so the result is an outer product of one vector w.
            let factor = (a * b).sqrt() / length.powi(3);
            let w = [scaled[1] / a, -scaled[0] / b];
            let world = [cos * w[0] - sin * w[1], sin * w[0] + cos * w[1]];
            [factor * world[0] * world[0], factor * world[0] * world[1], factor * world[1] * world[1]]
        }
        _ => {
            let bulge = kind.bulge(theta, piece).0;
            if bulge == 0.0 {
                return [0.0; 3];
            }
            let (from, to) = ends(kind, piece);
            let (center, _) = arc_circle(kind.vertex(theta, from), kind.vertex(theta, to), bulge);
            round_hessian(center, bulge.signum(), p)
        }
    }
}

/// Hessian `[xx, xy, yy]` of `side (|p − center| − r)`: it does not depend on the radius.
fn round_hessian(center: [f64; 2], side: f64, p: [f64; 2]) -> [f64; 3] {
    let d = [p[0] - center[0], p[1] - center[1]];
    let squared = d[0] * d[0] + d[1] * d[1];
    let factor = side / (squared * squared.sqrt());
    [factor * d[1] * d[1], -factor * d[0] * d[1], factor * d[0] * d[0]]
}

/// The piece that best explains a point with covariance `[xx, xy, yy]`; `None` above 48 pieces and vertices.
///
/// Minimises `d²/nᵀCn + (o/σ_o)²`: the squared Mahalanobis distance to the carrier plus that of the foot
/// point's overshoot `o` beyond the ends of the piece. Without the second term, a point outside a corner
/// would be assigned to the extension of a side that it does not belong to.
pub(crate) fn nearest_piece(
    kind: &ContourKind,
    theta: &[f64],
    p: [f64; 2],
    [xx, xy, yy]: [f64; 3],
) -> Option<usize> {
    // On the stack, as this runs for every reading and iteration: no allocation here.
    let mut room = [[0.0; 2]; 48];
    let pieces = kind.pieces();
    let count = pieces + usize::from(!kind.is_closed());
    let vertices = room.get_mut(..count)?;
    kind.vertices(theta, vertices);
    let determinant = (xx * yy - xy * xy).max(f64::MIN_POSITIVE);
    let mut best = (f64::INFINITY, 0);
    for piece in 0..pieces {
        let (a, b) = (vertices[piece], vertices[(piece + 1) % count]);
        let bulge = kind.bulge(theta, piece).0;
        let at = if bulge == 0.0 { segment(a, b, p).distance } else { arc(a, b, bulge, p).distance };
        let n = at.by_point;
        let pull = [xx * n[0] + xy * n[1], xy * n[0] + yy * n[1]];
        let across = n[0] * pull[0] + n[1] * pull[1];
        let step = at.value / across;
        let squared = at.value * step;
        // The overshoot can only add to the cost; most pieces are rejected before it is computed.
        if squared.is_nan() || squared >= best.0 {
            continue;
        }
        // The most probable foot point moves along C n, not along n. On the carrier its σ is √(det C / nᵀCn).
        let over = overshoot(a, b, bulge, [p[0] - step * pull[0], p[1] - step * pull[1]]);
        let cost = squared + over * over * across / determinant;
        if cost < best.0 {
            best = (cost, piece);
        }
    }
    Some(best.1)
}

/// Length by which a point lies beyond the nearer end of a piece, measured along it; 0 between the ends.
///
/// It is 0 for lines, circles and ellipses, which have no ends.
pub(crate) fn beyond(kind: &ContourKind, theta: &[f64], piece: usize, p: [f64; 2]) -> f64 {
    if kind.pieces() == 1 && !matches!(kind, ContourKind::Chain { .. }) {
        return 0.0;
    }
    let (from, to) = ends(kind, piece);
    let (a, b) = (kind.vertex(theta, from), kind.vertex(theta, to));
    overshoot(a, b, kind.bulge(theta, piece).0, p)
}

/// [`beyond`] for a piece given by its end points and its bulge.
fn overshoot(a: [f64; 2], b: [f64; 2], bulge: f64, p: [f64; 2]) -> f64 {
    if bulge == 0.0 {
        let e = [b[0] - a[0], b[1] - a[1]];
        let length = e[0].hypot(e[1]).max(f64::MIN_POSITIVE);
        let along = ((p[0] - a[0]) * e[0] + (p[1] - a[1]) * e[1]) / length;
        return (-along).max(along - length).max(0.0);
    }
    let (center, radius) = arc_circle(a, b, bulge);
    // Measured from the middle of the arc, the overshoot is symmetric and the branch cut of atan2 lies
    // opposite the arc. Seen from the centre, the middle is to the right of the chord for positive bulges.
    let e = [b[0] - a[0], b[1] - a[1]];
    let side = bulge.signum();
    let towards = [side * e[1], -side * e[0]];
    let d = [p[0] - center[0], p[1] - center[1]];
    let turn = (towards[0] * d[1] - towards[1] * d[0]).atan2(towards[0] * d[0] + towards[1] * d[1]);
    let half = 2.0 * bulge.abs().atan();
    radius * (turn.abs() - half).max(0.0)
}

/// Distance along a straight piece from a point to the nearer corner, negative beyond it.
///
/// Infinite for kinds without sharp corners between known sides: their pieces join smoothly or not at all.
/// Chains are excluded, too: their joints may be smooth.
pub(crate) fn within(kind: &ContourKind, theta: &[f64], piece: usize, p: [f64; 2]) -> f64 {
    if !matches!(kind, ContourKind::Rectangle | ContourKind::RegularPolygon(_) | ContourKind::Polygon(_)) {
        return f64::INFINITY;
    }
    let (from, to) = ends(kind, piece);
    let (a, b) = (kind.vertex(theta, from), kind.vertex(theta, to));
    let e = [b[0] - a[0], b[1] - a[1]];
    let length = e[0].hypot(e[1]).max(f64::MIN_POSITIVE);
    let along = ((p[0] - a[0]) * e[0] + (p[1] - a[1]) * e[1]) / length;
    along.min(length - along)
}

/// Indices of the two vertices that a piece joins.
pub(crate) fn ends(kind: &ContourKind, piece: usize) -> (usize, usize) {
    let count = kind.pieces() + usize::from(!kind.is_closed());
    (piece, (piece + 1) % count)
}

/// `g = −sin·x + cos·y − offset`.
fn line(theta: &[f64], p: [f64; 2], by_theta: &mut [f64]) -> Distance {
    let (sin, cos) = theta[0].sin_cos();
    by_theta[0] = -cos * p[0] - sin * p[1];
    by_theta[1] = -1.0;
    Distance { value: cos * p[1] - sin * p[0] - theta[1], by_point: [-sin, cos] }
}

/// `g = |p − c| − r`.
fn circle(theta: &[f64], p: [f64; 2], by_theta: &mut [f64]) -> Distance {
    let d = [p[0] - theta[0], p[1] - theta[1]];
    let length = d[0].hypot(d[1]);
    let by_point = [d[0] / length, d[1] / length];
    by_theta[0] = -by_point[0];
    by_theta[1] = -by_point[1];
    by_theta[2] = -1.0;
    Distance { value: length - theta[2], by_point }
}

/// `g = √(ab) (|(q₁/a, q₂/b)| − 1)`; see [`distance`] for the choice of this function.
fn ellipse(theta: &[f64], p: [f64; 2], by_theta: &mut [f64]) -> Distance {
    let (a, b) = (theta[2], theta[3]);
    let (sin, cos) = theta[4].sin_cos();
    let d = [p[0] - theta[0], p[1] - theta[1]];
    let q = [cos * d[0] + sin * d[1], cos * d[1] - sin * d[0]];
    let scaled = [q[0] / a, q[1] / b];
    let length = scaled[0].hypot(scaled[1]);
    let size = (a * b).sqrt();
    let value = size * (length - 1.0);
    // ∂g/∂q in the axes of the ellipse, rotated into the world below.
    let by_q = [size * scaled[0] / (length * a), size * scaled[1] / (length * b)];
    let by_point = [cos * by_q[0] - sin * by_q[1], sin * by_q[0] + cos * by_q[1]];
    by_theta[0] = -by_point[0];
    by_theta[1] = -by_point[1];
    by_theta[2] = 0.5 * value / a - by_q[0] * scaled[0];
    by_theta[3] = 0.5 * value / b - by_q[1] * scaled[1];
    by_theta[4] = by_q[0] * q[1] - by_q[1] * q[0];
    Distance { value, by_point }
}

/// Distance to a piece with its derivatives by the two end points and by the bulge.
struct Piece {
    distance: Distance,
    by_from: [f64; 2],
    by_to: [f64; 2],
    by_bulge: f64,
}

/// Distance to the line through `a` and `b`, positive to the right of it (outside, as outlines run
/// counter-clockwise).
fn segment(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> Piece {
    let e = [b[0] - a[0], b[1] - a[1]];
    let length = e[0].hypot(e[1]);
    let normal = [e[1] / length, -e[0] / length];
    let d = [p[0] - a[0], p[1] - a[1]];
    // Rotating the line about one end moves the foot point in proportion to its place between the ends.
    let along = (d[0] * e[0] + d[1] * e[1]) / (length * length);
    Piece {
        distance: Distance { value: normal[0] * d[0] + normal[1] * d[1], by_point: normal },
        by_from: normal.map(|n| -n * (1.0 - along)),
        by_to: normal.map(|n| -n * along),
        by_bulge: 0.0,
    }
}

/// Centre and radius of the arc from `a` to `b` with this bulge (the tangent of a quarter of its angle).
///
/// # Examples
/// ```
/// use planish_contour::planar::arc_circle;
///
/// // A half circle has the bulge 1.
/// let (center, radius) = arc_circle([0.0, 0.0], [2.0, 0.0], 1.0);
/// assert_eq!((center, radius), ([1.0, 0.0], 1.0));
/// ```
#[must_use]
pub fn arc_circle(a: [f64; 2], b: [f64; 2], bulge: f64) -> ([f64; 2], f64) {
    let e = [b[0] - a[0], b[1] - a[1]];
    let height = (1.0 - bulge * bulge) / (4.0 * bulge);
    let center = [0.5 * (a[0] + b[0]) - e[1] * height, 0.5 * (a[1] + b[1]) + e[0] * height];
    let radius = e[0].hypot(e[1]) * (1.0 + bulge * bulge) / (4.0 * bulge.abs());
    (center, radius)
}

/// Distance to the circle of an arc, positive outside the outline: inside the circle if the arc is concave.
fn arc(a: [f64; 2], b: [f64; 2], bulge: f64, p: [f64; 2]) -> Piece {
    let side = bulge.signum();
    let e = [b[0] - a[0], b[1] - a[1]];
    let length = e[0].hypot(e[1]);
    let height = (1.0 - bulge * bulge) / (4.0 * bulge);
    let (center, radius) = arc_circle(a, b, bulge);
    let d = [p[0] - center[0], p[1] - center[1]];
    let reach = d[0].hypot(d[1]);
    let towards = [d[0] / reach, d[1] / reach];
    // g = side (|p − c| − r), c = ½(a + b) + h J(b − a), r = f |b − a|, where h and f depend on the bulge
    // only and J rotates by a quarter turn. The derivatives follow by the chain rule through c and r.
    let growth = radius / length;
    let by_center = towards.map(|t| -side * t);
    // h Jᵀ ∂g/∂c: the part of a moving end that rotates the chord.
    let turned = [by_center[1] * height, -by_center[0] * height];
    let by_radius = e.map(|component| -side * growth * component / length);
    let squared = bulge * bulge;
    let height_slope = -(1.0 + squared) / (4.0 * squared);
    let growth_slope = side * (squared - 1.0) / (4.0 * squared);
    Piece {
        distance: Distance { value: side * (reach - radius), by_point: towards.map(|t| side * t) },
        by_from: [0, 1].map(|k| 0.5 * by_center[k] - turned[k] - by_radius[k]),
        by_to: [0, 1].map(|k| 0.5 * by_center[k] + turned[k] + by_radius[k]),
        by_bulge: height_slope * (-e[1] * by_center[0] + e[0] * by_center[1]) - side * length * growth_slope,
    }
}
