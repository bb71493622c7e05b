//! Effect of displacements that many readings share on the parameters of a contour.
//!
//! In: a fit and modes of displacement, such as the rounding of one side to whole pixels. Out: the covariance
//! that these modes add. Not guaranteed: anything beyond first order, or for an object that moves.

use super::curve::{distance, nearest_piece};
use super::fit::ContourFit;
use super::reading::ContourReading;
use nalgebra::{DMatrix, DVector};

/// Place on a contour to which a reading belongs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Index of the piece.
    pub piece: usize,
    /// Nearest point of that piece, or of the line or circle that continues it.
    pub position: [f64; 2],
    /// Unit normal of the contour there; outwards for closed contours.
    pub normal: [f64; 2],
    /// Derivatives of the distance by the parameters.
    by_theta: [f64; planish_estimate::implicit::MAX_STATE],
}

impl ContourFit {
    /// The place of each reading on the contour; `None` where it has none, as at the centre of a circle.
    #[must_use]
    pub fn feet(&self, readings: &[ContourReading]) -> Vec<Option<Foot>> {
        let theta = &self.state.as_slice()[..self.kind.parameters()];
        let foot = |reading: &ContourReading| {
            let p = reading.point();
            let piece = match self.kind.pieces() {
                1 => 0,
                _ => nearest_piece(&self.kind, theta, p, reading.covariance())?,
            };
            let mut by_theta = [0.0; planish_estimate::implicit::MAX_STATE];
            let at = distance(&self.kind, theta, piece, p, &mut by_theta[..theta.len()]);
            let position = [0, 1].map(|k| p[k] - at.value * at.by_point[k]);
            (position.iter().all(|c| c.is_finite())).then_some(Foot {
                piece,
                position,
                normal: at.by_point,
                by_theta,
            })
        };
        readings.iter().map(foot).collect()
    }

    /// Covariance of the state by independent modes of unit variance that displace many readings at once.
    ///
    /// A mode `m` displaces reading `i` by the vector `m_i`. With the gradient `g_i` of its distance by the
    /// parameters, the normal `n_i` and the variance `s_i²` of the distance, the least-squares contour
    /// moves by
    /// `δ = −P Σ g_i (n_i·m_i)/s_i²`, `P` being the covariance of the fit. The result is `Σ δ δᵀ` over the
    /// modes.
    ///
    /// # Examples
    /// ```
    /// use planish_contour::planar::{ContourFitOptions, ContourKind, fit, points};
    ///
    /// let readings = points(&ContourKind::Circle, &[0.0, 0.0, 10.0], 200, 0.05, 1).noisy;
    /// let circle = fit(&ContourKind::Circle, &readings, &ContourFitOptions::default())?;
    /// // All readings are displaced along x by an unknown error of σ = 0.3: only the centre moves.
    /// let shared = circle.covariance_of_modes(&readings, &[vec![[0.3, 0.0]; 200]]);
    /// assert!((shared[(0, 0)].sqrt() - 0.3).abs() < 0.02 && shared[(2, 2)].sqrt() < 0.02);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    #[must_use]
    pub fn covariance_of_modes(&self, readings: &[ContourReading], modes: &[Vec<[f64; 2]>]) -> DMatrix<f64> {
        let n = self.state.len();
        let feet = self.feet(readings);
        let mut covariance = DMatrix::zeros(n, n);
        for mode in modes {
            let mut vector = DVector::zeros(n);
            for (i, foot) in feet.iter().enumerate() {
                let Some(foot) = foot.as_ref().filter(|_| self.used[i]) else { continue };
                let [xx, xy, yy] = readings[i].covariance();
                let [a, b] = foot.normal;
                let variance = (a * a * xx + 2.0 * a * b * xy + b * b * yy).max(f64::MIN_POSITIVE);
                let weighted = (a * mode[i][0] + b * mode[i][1]) / variance;
                for (sum, g) in vector.iter_mut().zip(&foot.by_theta) {
                    *sum += weighted * g;
                }
            }
            let moved = &self.covariance * vector;
            covariance += &moved * moved.transpose();
        }
        covariance
    }
}
