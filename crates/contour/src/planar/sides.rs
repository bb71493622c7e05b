//! Lengths of straight sides and radii of arcs, with σ, for kinds whose parameters are vertices.
//!
//! In: parameters of a polygon or a chain, and their covariance. Out: the size of each side with σ by
//! first-order propagation. Not guaranteed: σ of sides that are as short as their own σ.

use super::ContourKind;
use nalgebra::{DMatrix, DVector};

/// A side of a contour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// Index of the piece: from vertex `piece` to the next.
    pub piece: usize,
    /// True for an arc, false for a straight side.
    pub is_arc: bool,
    /// Length of a straight side, or radius of an arc.
    pub size: f64,
    /// σ of the size.
    pub sigma: f64,
}

impl ContourKind {
    /// Sides of a polygon or a chain with σ, from the parameters and their covariance (one row per
    /// parameter).
    ///
    /// A side from `P` to `Q` has the length `l = |Q − P|`; an arc over it with the bulge `b` has the radius
    /// `l (1 + b²) / 4|b|`. `σ² = ∇ᵀ Σ ∇`.
    ///
    /// A regular polygon returns its first side only, because all are equal. Other kinds return none: their
    /// sizes are parameters. The straight ends of an open chain are omitted, because they end with the
    /// readings and not with the object.
    ///
    /// # Examples
    /// ```
    /// use nalgebra::DMatrix;
    /// use planish_contour::planar::ContourKind;
    ///
    /// let triangle = [0.0, 0.0, 4.0, 0.0, 0.0, 3.0];
    /// let sides = ContourKind::Polygon(3).sides(&triangle, &(DMatrix::identity(6, 6) * 0.01));
    /// assert_eq!(sides[1].size, 5.0);
    /// assert!((sides[1].sigma - 0.1 * 2f64.sqrt()).abs() < 1e-12); // both ends move
    /// ```
    #[must_use]
    pub fn sides(&self, theta: &[f64], covariance: &DMatrix<f64>) -> Vec<Side> {
        let pieces = match self {
            Self::RegularPolygon(_) => 0..1,
            Self::Polygon(count) => 0..*count,
            Self::Chain { arcs, .. } => 0..arcs.len(),
            _ => 0..0,
        };
        let last = pieces.len().saturating_sub(1);
        pieces
            .filter_map(|piece| {
                let side = self.side(theta, covariance, piece)?;
                let has_open_end = !self.is_closed() && (piece == 0 || piece == last);
                // The radius of an arc at an open end is determined by its readings; its length is not.
                (side.is_arc || !has_open_end).then_some(side)
            })
            .collect()
    }

    /// One side; `None` if its length is zero or not finite, where the gradient is undefined.
    fn side(&self, theta: &[f64], covariance: &DMatrix<f64>, piece: usize) -> Option<Side> {
        let vertices = self.pieces() + usize::from(!self.is_closed());
        let ends = [piece, (piece + 1) % vertices];
        let [p, q] = ends.map(|i| self.vertex(theta, i));
        let chord = [q[0] - p[0], q[1] - p[1]];
        let length = chord[0].hypot(chord[1]);
        if !(length > 0.0 && length.is_finite()) {
            return None;
        }
        let (bulge, parameter) = self.bulge(theta, piece);
        let is_arc = bulge != 0.0;
        let factor = if is_arc { (1.0 + bulge * bulge) / (4.0 * bulge.abs()) } else { 1.0 };
        let mut gradient = DVector::zeros(covariance.nrows());
        // The chord enters through both of its ends, with opposite signs.
        for (end, sign) in ends.into_iter().zip([-1.0, 1.0]) {
            let along = chord.map(|c| sign * factor * c / length);
            self.add_vertex_derivative(theta, end, along, gradient.as_mut_slice());
        }
        if let Some(parameter) = parameter {
            gradient[parameter] += bulge.signum() * length * (bulge * bulge - 1.0) / (4.0 * bulge * bulge);
        }
        Some(Side {
            piece,
            is_arc,
            size: factor * length,
            sigma: gradient.dot(&(covariance * &gradient)).max(0.0).sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A covariance with off-diagonal entries.
    fn covariance(n: usize) -> DMatrix<f64> {
        let root = DMatrix::from_fn(n, n, |i, j| 0.01 * (((7 * i + 3 * j) % 11) as f64 - 4.0) / 11.0);
        &root * root.transpose()
    }

    /// Compares σ with `∇ᵀ Σ ∇`, the gradient by central differences.
    fn assert_sigma(kind: &ContourKind, theta: &[f64]) {
        let covariance = covariance(theta.len());
        let exact = DMatrix::zeros(theta.len(), theta.len());
        for side in kind.sides(theta, &covariance) {
            let size = |theta: &[f64]| {
                let sides = kind.sides(theta, &exact);
                sides.iter().find(|s| s.piece == side.piece).map_or(f64::NAN, |s| s.size)
            };
            let gradient = DVector::from_fn(theta.len(), |i, _| {
                let at = |step: f64| {
                    let mut moved = theta.to_vec();
                    moved[i] += step;
                    size(&moved)
                };
                (at(1e-5) - at(-1e-5)) / 2e-5
            });
            let expected = gradient.dot(&(&covariance * &gradient)).sqrt();
            assert!((side.sigma / expected - 1.0).abs() < 1e-7, "{side:?}, by differences {expected}");
        }
    }

    #[test]
    fn sigma_of_polygon_sides_follows_from_the_vertices() {
        let triangle = [0.0, 0.0, 4.0, 0.0, 0.0, 3.0];
        let sides = ContourKind::Polygon(3).sides(&triangle, &covariance(6));
        let sizes: Vec<f64> = sides.iter().map(|side| side.size).collect();
        assert_eq!(sizes, [4.0, 5.0, 3.0]);
        assert_sigma(&ContourKind::Polygon(3), &triangle);
        // The sides of a hexagon are as long as its circumradius.
        let hexagon = [1.0, 2.0, 5.0, 0.3];
        let side =
            ContourKind::RegularPolygon(6).sides(&hexagon, &DMatrix::from_diagonal_element(4, 4, 0.04))[0];
        assert!((side.size - 5.0).abs() < 1e-12 && (side.sigma - 0.2).abs() < 1e-12, "{side:?}");
        assert_sigma(&ContourKind::RegularPolygon(6), &hexagon);
    }

    #[test]
    fn chains_report_radii_of_arcs_but_no_open_ends() {
        let quarter = (std::f64::consts::PI / 8.0).tan();
        let closed = ContourKind::Chain { arcs: vec![false, true, false], closed: true };
        let theta = [0.0, 0.0, 2.0, 0.0, 0.0, 2.0, quarter];
        let sides = closed.sides(&theta, &covariance(7));
        assert_eq!(sides.len(), 3);
        assert!(sides[1].is_arc && (sides[1].size - 2.0).abs() < 1e-12, "{sides:?}");
        assert_sigma(&closed, &theta);
        let open = ContourKind::Chain { arcs: vec![false, false, true], closed: false };
        let theta = [0.0, 0.0, 2.0, 0.0, 2.0, 2.0, 1.0, 4.0, -0.2];
        let sides = open.sides(&theta, &covariance(9));
        assert_eq!(sides.iter().map(|s| s.piece).collect::<Vec<_>>(), [1, 2]);
        assert_sigma(&open, &theta);
        assert!(ContourKind::Circle.sides(&[0.0, 0.0, 1.0], &covariance(3)).is_empty());
    }
}
