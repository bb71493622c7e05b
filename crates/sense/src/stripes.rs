//! Structured light with crossed stripes: points, normals and curvatures where stripes cross.
//!
//! [`read_grid`] reads an image of such stripes: it finds the junctions and identifies the stripes.
//!
//! In: a camera, a projector, and junctions: where two stripes cross in the image, their directions there,
//! and where they cross in the projector's image. Out: for each junction its point and normal
//! ([`orientation`]), and with its neighbours its principal curvatures ([`curvature`]), all with covariance.
//!
//! A stripe lies in the plane through the projector's centre and its line in the projector's image, and in
//! the plane through the camera's centre and its line in the camera's image. Its tangent is in both planes,
//! `t = N_projector × N_camera`, and the normal is perpendicular to two tangents, `n = t₁ × t₂`. Orientation
//! therefore needs one image and no search for depth.
//!
//! A curve on the surface passes from a neighbour through a junction to the opposite neighbour. By Meusnier's
//! theorem the normal component of its curvature is the normal curvature in its direction,
//! `κ(φ) = Δ₊·n/|Δ₊|² + Δ₋·n/|Δ₋|²` with the steps Δ to both. By Euler's theorem
//! `κ(φ) = κ₁ cos²(φ−φ₁) + κ₂ sin²(φ−φ₁)`, which three directions determine.
//!
//! Not guaranteed: curvature is an average over the spacing of the stripes, not that of a point.
//!
//! # References
//! - Shrikhande and Stockman, *Surface orientation from a projected grid*, PAMI 1989.
//! - Hu and Stockman, *3-D surface solution using structured light and constraint propagation*, PAMI 1989.
//! - do Carmo, *Differential Geometry of Curves and Surfaces*, 1976, section 3-2, for Meusnier and Euler.

use planish_core::vector3::tangents;
use planish_core::{DVec3, Pinhole, SymmetricMatrix3};
use planish_estimate::{Error, Result};

mod crossings;
mod find;
mod indexing;
mod network;
mod pattern;
mod ridges;

pub use find::{GridCamera, GridOptions, GridReading, GridReadings, GridRejected, read_grid};
pub use pattern::StripePattern;

/// Where two stripes cross.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Junction {
    /// Its pixel in the camera's image.
    pub image: [f64; 2],
    /// The angles of both stripes in the image, from x to y, in radians.
    pub angles_rad: [f64; 2],
    /// Its pixel in the projector's image.
    pub projector: [f64; 2],
}

/// Accuracy of the measured position and angles of a junction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JunctionSigma {
    /// σ of each coordinate of the pixel, in pixels.
    pub place_px: f64,
    /// σ of each angle, in radians: `σ_px / √Σ i²` of a line through points i pixels from the middle, each
    /// with σ_px.
    pub angle_rad: f64,
}

impl JunctionSigma {
    /// The accuracy of a line that is fitted to points on a stripe, one per pixel, up to `reach` pixels to
    /// both sides, from the σ of a point.
    #[must_use]
    pub fn from_single_places(sigma_px: f64, reach: usize) -> Self {
        let squares: f64 = (1..=reach).map(|i| 2.0 * (i * i) as f64).sum();
        Self { place_px: sigma_px / (2.0 * reach as f64 + 1.0).sqrt(), angle_rad: sigma_px / squares.sqrt() }
    }
}

impl JunctionSigma {
    /// The covariance of independent errors and an exact projector.
    #[must_use]
    pub fn covariance(&self) -> JunctionCovariance {
        let mut image = [[0.0; 4]; 4];
        for (k, row) in image.iter_mut().enumerate() {
            row[k] = if k < 2 { self.place_px } else { self.angle_rad }.powi(2);
        }
        JunctionCovariance { image, projector_px: 0.0 }
    }
}

/// Covariance of a junction in both images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JunctionCovariance {
    /// Covariance of both coordinates of its pixel, in pixels, and of both angles, in radians.
    pub image: [[f64; 4]; 4],
    /// σ of each coordinate of its pixel in the projector's image, in pixels.
    pub projector_px: f64,
}

/// A point of the surface and its normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orientation {
    /// The point, in the world.
    pub point: DVec3,
    /// Its covariance.
    pub covariance: SymmetricMatrix3,
    /// The unit normal, towards the camera.
    pub normal: DVec3,
    /// Covariance of the normal; zero along the normal itself.
    pub normal_covariance: SymmetricMatrix3,
    /// σ of one tangential component of the normal, in degrees (root mean square of both).
    pub sigma_normal_deg: f64,
}

/// The point and normal of a junction.
///
/// `stripes` are the directions of the two sets in the projector's image. The point minimises the sum of
/// squared distances to two planes of the camera's ray and the planes of both stripes. The covariance is
/// propagated from both images as `J Σ Jᵀ`, with `J` by central differences.
///
/// # Errors
/// `Undetermined` if a stripe is parallel to the baseline as both devices see it, the two tangents coincide,
/// or the point is behind the camera.
pub fn orientation(
    camera: &Pinhole,
    projector: &Pinhole,
    stripes: [[f64; 2]; 2],
    junction: &Junction,
    covariance: &JunctionCovariance,
) -> Result<Orientation> {
    let undetermined = || {
        Error::undetermined(format!(
            "expected a junction that determines an orientation, found another at pixel {} {}",
            junction.image[0], junction.image[1]
        ))
    };
    let solved_at = |z: [f64; 6]| {
        let junction = Junction { image: [z[0], z[1]], angles_rad: [z[2], z[3]], projector: [z[4], z[5]] };
        point_and_normal(camera, projector, stripes, &junction)
    };
    let [[x, y], [a, b], [u, v]] = [junction.image, junction.angles_rad, junction.projector];
    let z = [x, y, a, b, u, v];
    let (point, normal) = solved_at(z).ok_or_else(undetermined)?;
    let mut by = [(DVec3::ZERO, DVec3::ZERO); 6];
    for (k, derivative) in by.iter_mut().enumerate() {
        // Central differences: the derivative of the whole chain of planes by hand is long. The steps are in
        // radians and pixels, far above rounding and far below the curvature of the mapping.
        let step = if matches!(k, 2 | 3) { 1e-5 } else { 1e-3 };
        let moved = |s: f64| {
            let mut z = z;
            z[k] += s;
            solved_at(z).ok_or_else(undetermined)
        };
        let (ahead, behind) = (moved(step)?, moved(-step)?);
        let slope = |a: DVec3, b: DVec3| 0.5 / step * (a - b);
        *derivative = (slope(ahead.0, behind.0), slope(ahead.1, behind.1));
    }
    let carried = |derivative: &dyn Fn(usize) -> DVec3| {
        SymmetricMatrix3::from_entries(|i, j| {
            // Errors of the two devices are independent, so the products between them are absent.
            let seen: f64 = (0..4)
                .map(|k| {
                    (0..4).map(|l| derivative(k)[i] * covariance.image[k][l] * derivative(l)[j]).sum::<f64>()
                })
                .sum();
            let projected: f64 = (4..6).map(|k| derivative(k)[i] * derivative(k)[j]).sum();
            seen + covariance.projector_px.powi(2) * projected
        })
    };
    let (of_point, of_normal) = (carried(&|k| by[k].0), carried(&|k| by[k].1));
    let (e1, e2) = tangents(normal);
    // The normal has unit length, so its covariance is zero along it, and the mean of the two tangential
    // variances describes it.
    let tangential = 0.5 * (of_normal.along(e1) + of_normal.along(e2));
    Ok(Orientation {
        point,
        covariance: of_point,
        normal,
        normal_covariance: of_normal,
        sigma_normal_deg: tangential.sqrt().to_degrees(),
    })
}

fn point_and_normal(
    camera: &Pinhole,
    projector: &Pinhole,
    stripes: [[f64; 2]; 2],
    junction: &Junction,
) -> Option<(DVec3, DVec3)> {
    let directions = junction.angles_rad.map(|a| [a.cos(), a.sin()]);
    let seen = directions.map(|d| camera.plane_of_line(junction.image, d));
    let lit = stripes.map(|d| projector.plane_of_line(junction.projector, d));
    let tangent = |k: usize| {
        let (a, b) = (lit[k].try_normalize()?, seen[k].try_normalize()?);
        // Nearly parallel planes do not determine their common line.
        Some(a.cross(b)).filter(|t| t.length() > 1e-6).and_then(DVec3::try_normalize)
    };
    let normal = tangent(0)?.cross(tangent(1)?).try_normalize()?;
    // Four planes through the point: two of the camera's ray, two of the stripes.
    let ray = [[1.0, 0.0], [0.0, 1.0]].map(|d| camera.plane_of_line(junction.image, d));
    let (from_camera, from_projector) = (camera.center(), projector.center());
    let planes = ray.map(|n| (n, from_camera)).into_iter().chain(lit.map(|n| (n, from_projector)));
    let (mut m, mut r) = ([DVec3::ZERO; 3], DVec3::ZERO);
    for (n, through) in planes {
        let n = n.try_normalize()?;
        let offset = n.dot(through);
        for i in 0..3 {
            (0..3).for_each(|j| m[i][j] += n[i] * n[j]);
            r[i] += n[i] * offset;
        }
    }
    let determinant = m[0].dot(m[1].cross(m[2]));
    // The normals have unit length, so the determinant is a pure number. It is zero if all four planes share
    // a direction, and the point lies at infinity.
    if determinant < 1e-12 {
        return None;
    }
    // Cramer's rule; the matrix is symmetric, so its rows are its columns.
    let columns = [m[1].cross(m[2]), m[2].cross(m[0]), m[0].cross(m[1])];
    let point = DVec3::from_array(columns.map(|c| c.dot(r) / determinant));
    camera.project(point)?;
    // The order of the tangents leaves the sign of the normal open; a visible surface faces the camera.
    let towards = normal.dot(from_camera - point).signum();
    Some((point, towards * normal))
}

/// Principal curvatures of the surface at a junction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StripeCurvature {
    /// The larger one; positive where the surface bends towards its normal.
    pub k1: f64,
    /// The smaller one.
    pub k2: f64,
    /// The unit tangent in which the surface bends by `k1`.
    pub d1: DVec3,
    /// σ of a component of the second fundamental form (root mean square of the two on its diagonal).
    pub sigma: f64,
}

/// The principal curvatures at a junction from pairs of opposite neighbours, along both stripes and along the
/// diagonals.
///
/// Each pair gives the normal curvature in its direction. Weighted least squares gives the second fundamental
/// form, whose eigenvectors are the principal directions. The variance of a pair comes from its three points
/// along n, and from the normal if the steps differ in length.
///
/// # Errors
/// `Undetermined` for fewer than three directions that differ.
pub fn curvature(middle: &Orientation, pairs: &[[Orientation; 2]]) -> Result<StripeCurvature> {
    let n = middle.normal;
    let (e1, e2) = tangents(n);
    let (mut m, mut r) = ([DVec3::ZERO; 3], DVec3::ZERO);
    for pair in pairs {
        let steps = pair.map(|p| p.point - middle.point);
        let lengths = steps.map(DVec3::length);
        let across = steps[0] - steps[1];
        let (x, y) = (across.dot(e1), across.dot(e2));
        let square = x * x + y * y;
        if !(square > 0.0 && lengths.iter().all(|l| *l > 0.0)) {
            continue;
        }
        let shares = lengths.map(|l| 1.0 / (l * l));
        // A step d along the surface rises by `κ d²/2`. The mean of `2 (step · n)/d²` over both sides cancels
        // an error of the normal if the steps are equally long.
        let kappa = shares[0] * steps[0].dot(n) + shares[1] * steps[1].dot(n);
        let of_points: f64 = (0..2).map(|i| shares[i] * shares[i] * pair[i].covariance.along(n)).sum();
        let of_middle = (shares[0] + shares[1]).powi(2) * middle.covariance.along(n);
        // What is left of an error of the normal if they are not.
        let lever = shares[0] * steps[0] + shares[1] * steps[1];
        let of_normal = middle.normal_covariance.along(lever);
        let weight = 1.0 / (of_points + of_middle + of_normal);
        // κ = a c² + 2 b c s + d s² in the direction (c, s).
        let row = [x * x / square, 2.0 * x * y / square, y * y / square];
        for i in 0..3 {
            (0..3).for_each(|j| m[i][j] += weight * row[i] * row[j]);
            r[i] += weight * row[i] * kappa;
        }
    }
    let determinant = m[0].dot(m[1].cross(m[2]));
    let size = m[0][0] + m[1][1] + m[2][2];
    // Relative to the trace: the matrix has the unit of the weights.
    let determined = determinant > 1e-9 * size.powi(3);
    if !determined {
        return Err(Error::undetermined("expected neighbours in three directions for the curvature"));
    }
    let inverse = [m[1].cross(m[2]), m[2].cross(m[0]), m[0].cross(m[1])].map(|c| 1.0 / determinant * c);
    let [a, b, d] = inverse.map(|row| row.dot(r));
    let (mean, half) = (0.5 * (a + d), (0.25 * (a - d) * (a - d) + b * b).sqrt());
    let angle = 0.5 * (2.0 * b).atan2(a - d);
    let d1 = angle.cos() * e1 + angle.sin() * e2;
    Ok(StripeCurvature {
        k1: mean + half,
        k2: mean - half,
        d1,
        sigma: (0.5 * (inverse[0][0] + inverse[2][2])).sqrt(),
    })
}

#[cfg(test)]
mod tests;
