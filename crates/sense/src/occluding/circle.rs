//! Depth at an occluding contour, by the circle that three lines of sight touch.
//!
//! In: a line of sight that touches a surface, the surface's normal there, and lines of sight of two other
//! views in the epipolar planes that touch the same surface. Out: depth and radius.
//!
//! The line of sight `C + λ v` touches the surface at `P`. A plane that contains it cuts the surface in a
//! curve that it touches, whose radius is `R cos φ` where `R` is the radius of the section along the normal
//! and `φ`
//! the angle between that plane and the normal (Meusnier). Another view's line, `C' + μ w` in the same plane,
//! touches that curve too; for a circle of that radius,
//!
//! `λ (m'·v) + R cos φ (1 − m·m') = m'·(C' − C)`,
//!
//! with `m` and `m'` the normals of both lines in the plane, outwards. That is linear in `λ` and `R`, so that
//! two other views determine both, whether or not all three cameras are in line.
//!
//! The model error of the circle comes from the change of radius along the curve, `R' = dR/dα`. With the
//! other lines turned by `α` and `β` to either side, the depth is off by `R' α β / 6` (Taylor's series of the
//! support function `p = R α²/2 + R' α³/6`), along the line of sight.
//!
//! # References
//! R. Cipolla, A. Blake, *Surface shape from the deformation of apparent contours*, IJCV 1992; R. Vaillant,
//! O. Faugeras, *Using extremal boundaries for 3-D object modeling*, PAMI 1992; E. Boyer, M.-O. Berger, *3D
//! surface reconstruction using occluding contours*, IJCV 1997 (for three views).

use super::curve::Local;
use planish_core::matrix3::{inverse, times, transposed_times};
use planish_core::{DVec3, Pinhole};
use planish_estimate::{Error, Result};

/// A pinhole camera with precomputed centre and directions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Eye {
    pub camera: Pinhole,
    pub centre: DVec3,
    /// A pixel `(x, y, 1)` to its direction of the world.
    directions: [[f64; 3]; 3],
}

impl Eye {
    pub fn new(camera: Pinhole) -> Result<Self> {
        let inverse =
            inverse(&camera.k).ok_or_else(|| Error::input("expected a matrix K that has an inverse"))?;
        let r = camera.r;
        Ok(Self {
            camera,
            centre: camera.center(),
            directions: [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| r[k][i] * inverse[k][j]).sum())),
        })
    }

    pub fn direction(&self, p: [f64; 2]) -> DVec3 {
        times(&self.directions, DVec3::new(p[0], p[1], 1.0))
    }

    /// `l` with `l·(x, y, 1) = 0` for pixels whose lines of sight lie in a plane with this normal.
    pub fn line(&self, normal: DVec3) -> DVec3 {
        transposed_times(&self.directions, normal)
    }

    /// The width of a pixel, at distance one.
    pub fn pixel(&self) -> f64 {
        1.0 / self.camera.focal_px()
    }
}

/// A line of sight that touches the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    pub centre: DVec3,
    /// Unit direction.
    pub way: DVec3,
    /// Unit normal of the surface, outwards: perpendicular to the line of sight and the tangent of the
    /// contour.
    pub normal: DVec3,
}

impl Sight {
    pub fn new(eye: &Eye, place: [f64; 2], along: [f64; 2]) -> Option<Self> {
        let way = eye.direction(place).try_normalize()?;
        let next = eye.direction([place[0] + along[0], place[1] + along[1]]);
        let normal = way.cross(next).try_normalize()?;
        let outside = eye.direction([place[0] + along[1], place[1] - along[0]]);
        let side = normal.dot(outside - eye.direction(place));
        Some(Self { centre: eye.centre, way, normal: side.signum() * normal })
    }

    /// The normal of the plane of this line and another camera; `None` if the line is along the baseline.
    pub fn epipolar_plane(&self, other: DVec3) -> Option<DVec3> {
        let baseline = (other - self.centre).try_normalize()?;
        let normal = self.way.cross(baseline);
        // Within a tenth of a degree of the baseline the plane is not determined.
        (normal.length() > 2e-3).then(|| normal.try_normalize()).flatten()
    }

    /// The outward direction in a plane that contains the line of sight, and its cosine to the normal.
    pub fn outward_in(&self, plane: DVec3) -> Option<(DVec3, f64)> {
        let m = plane.cross(self.way).try_normalize()?;
        let cosine = m.dot(self.normal);
        Some((cosine.signum() * m, cosine.abs()))
    }
}

/// Another view's line of sight in the epipolar plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Touch {
    pub centre: DVec3,
    pub way: DVec3,
    pub plane: DVec3,
}

/// Depth, radius, and the angles to both other lines, positive and negative.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solved {
    pub depth: f64,
    pub radius: f64,
    pub angles: [f64; 2],
}

/// The circle that all three lines touch.
pub(super) fn solve(sight: &Sight, others: &[Touch; 2]) -> Option<Solved> {
    let mut rows = [[0.0; 3]; 2];
    let mut angles = [0.0; 2];
    for (k, other) in others.iter().enumerate() {
        let (m, cosine) = sight.outward_in(other.plane)?;
        let m_other = other.plane.cross(other.way).try_normalize()?;
        let m_other = m.dot(m_other).signum() * m_other;
        let sine = m_other.dot(sight.way);
        rows[k] = [sine, cosine * (1.0 - m.dot(m_other)), m_other.dot(other.centre - sight.centre)];
        angles[k] = sine.asin();
    }
    let [[a, b, c], [d, e, f]] = rows;
    let determinant = a * e - b * d;
    // Two views on the same side give nearly the same equation.
    if a * d >= 0.0 || determinant == 0.0 {
        return None;
    }
    let solved =
        Solved { depth: (c * e - b * f) / determinant, radius: (a * f - c * d) / determinant, angles };
    (solved.depth.is_finite() && solved.radius.is_finite()).then_some(solved)
}

/// The intersection of the line `place + t along` with an epipolar line, and `t`.
pub(super) fn meet(line: DVec3, place: [f64; 2], along: [f64; 2]) -> Option<([f64; 2], f64)> {
    let rate = line[0] * along[0] + line[1] * along[1];
    let t = -(line[0] * place[0] + line[1] * place[1] + line[2]) / rate;
    t.is_finite().then(|| ([0, 1].map(|k| place[k] + t * along[k]), t))
}

/// A point with its covariance.
pub(super) struct Placed {
    pub solved: Solved,
    pub position: DVec3,
    /// Covariance of the position by the errors of all three contours.
    pub covariance: [DVec3; 3],
    /// Variances of the depth and of the radius.
    pub depth: f64,
    pub radius: f64,
}

/// Solves with the estimated tangents of the contours, and propagates the σ of all three contours by
/// differences.
pub(super) fn placed(eyes: [&Eye; 3], point: &Local, others: [&Local; 2]) -> Option<Placed> {
    let solve_at = |shift: [f64; 2], across: [f64; 2]| -> Option<(Solved, DVec3)> {
        let outward = point.outward();
        let place = [0, 1].map(|k| point.place[k] + shift[0] * outward[k] + shift[1] * point.along[k]);
        let sight = Sight::new(eyes[0], place, point.along)?;
        let mut touches = [None; 2];
        for k in 0..2 {
            let plane = sight.epipolar_plane(eyes[k + 1].centre)?;
            let other = others[k];
            let outward = other.outward();
            let shifted = [0, 1].map(|j| other.place[j] + across[k] * outward[j]);
            let (met, _) = meet(eyes[k + 1].line(plane), shifted, other.along)?;
            touches[k] = Some(Touch {
                centre: eyes[k + 1].centre,
                way: eyes[k + 1].direction(met).try_normalize()?,
                plane,
            });
        }
        let solved = solve(&sight, &[touches[0]?, touches[1]?])?;
        Some((solved, sight.centre + solved.depth * sight.way))
    };
    let (solved, position) = solve_at([0.0; 2], [0.0; 2])?;
    let sigmas = [
        point.sigma_across,
        // Along the contour the position is a choice; σ across is used for its error, too.
        point.sigma_across,
        others[0].sigma_across,
        others[1].sigma_across,
    ];
    let mut covariance = [DVec3::ZERO; 3];
    let (mut depth, mut radius) = (0.0, 0.0);
    for (k, sigma) in sigmas.into_iter().enumerate() {
        // Differences over a tenth of σ: derivatives of matches and planes by hand would be long, and the
        // step is far from both rounding and curvature.
        let step = 0.1 * sigma;
        let moved = |by: f64| {
            let mut e = [0.0; 4];
            e[k] = by;
            solve_at([e[0], e[1]], [e[2], e[3]])
        };
        let ((plus, after), (minus, before)) = (moved(step)?, moved(-step)?);
        let slope = 5.0 * (after - before);
        for i in 0..3 {
            covariance[i] += slope[i] * slope;
        }
        depth += (5.0 * (plus.depth - minus.depth)).powi(2);
        radius += (5.0 * (plus.radius - minus.radius)).powi(2);
    }
    Some(Placed { solved, position, covariance, depth, radius })
}

/// Adds the model error of the circle, a variance along the line of sight.
pub(super) fn add_along(covariance: &mut [DVec3; 3], way: DVec3, variance: f64) {
    for i in 0..3 {
        covariance[i] += variance * way[i] * way;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras in a plane through a ball's centre, collinear or not: depth and radius are exact, because the
    /// curve is a circle.
    #[test]
    fn a_ball_is_reconstructed_exactly() {
        let radius = 1.3;
        let far = 6.0;
        let mut sights = Vec::new();
        for angle in [0.0_f64, 0.15, -0.23] {
            let centre = far * DVec3::new(angle.cos(), angle.sin(), 0.0);
            // Rotated from the line to the centre by the angle whose sine is radius / distance.
            let towards = (-centre).try_normalize().unwrap();
            let side = DVec3::Z.cross(towards);
            let sine: f64 = radius / far;
            let way = (1.0 - sine * sine).sqrt() * towards + sine * side;
            let contact = centre + (far * far - radius * radius).sqrt() * way;
            sights.push((Sight { centre, way, normal: contact.try_normalize().unwrap() }, contact));
        }
        let plane = DVec3::Z;
        let others = [1, 2].map(|k| Touch { centre: sights[k].0.centre, way: sights[k].0.way, plane });
        let solved = solve(&sights[0].0, &others).unwrap();
        assert!((solved.radius - radius).abs() < 1e-9, "{}", solved.radius);
        let at = sights[0].0.centre + solved.depth * sights[0].0.way;
        assert!((at - sights[0].1).length() < 1e-9);
        assert!((solved.angles[0].abs() - 0.15).abs() < 1e-9 && (solved.angles[1].abs() - 0.23).abs() < 1e-9);
        // Two lines on the same side do not determine a circle.
        assert!(solve(&sights[0].0, &[others[0], others[0]]).is_none());
    }
}
