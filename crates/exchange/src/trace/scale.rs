//! The length of a pixel, as dimensions of a picture state it.
//!
//! Tips of arrowheads are accurate to about a pixel, sizes of traced views to a few tenths. A dimension
//! between the ends of a view therefore counts with the size of the view. One number may be misread, so at
//! least two dimensions must agree, and more than those that do not.

use planish_solid::sheet::SheetDimension;

/// Maximum difference of a dimension from the size of the view that it measures, in pixels.
const SAME_SIZE: f64 = 2.5;
/// σ of sizes of views and of distances between tips of arrowheads, in pixels.
const SIGMAS: [f64; 2] = [0.3, 0.7];
/// Dimensions agree up to this many σ.
const AGREEMENT: f64 = 3.0;

/// The length of a pixel, and how many dimensions agree on it.
pub(super) fn pixel_length(dimensions: &[SheetDimension], sizes: &[f64]) -> Option<(f64, usize)> {
    let measured: Vec<Measured> = dimensions.iter().filter_map(|d| Measured::new(d, sizes)).collect();
    let agreeing = |of: &Measured| -> Vec<&Measured> { measured.iter().filter(|m| m.agrees(of)).collect() };
    let best = measured.iter().map(agreeing).max_by_key(Vec::len)?;
    if best.len() < 2 || 2 * best.len() <= measured.len() {
        return None;
    }
    let (mut product, mut square) = (0.0, 0.0);
    for m in &best {
        let weight = m.sigma.powi(-2);
        product += weight * m.stated * m.drawn;
        square += weight * m.drawn * m.drawn;
    }
    Some((product / square, best.len()))
}

/// A dimension with the σ of its drawn length.
#[derive(Debug, Clone, Copy)]
struct Measured {
    drawn: f64,
    stated: f64,
    /// Half of the last digit of the number.
    rounding: f64,
    /// In pixels.
    sigma: f64,
}

impl Measured {
    fn new(dimension: &SheetDimension, sizes: &[f64]) -> Option<Self> {
        let &SheetDimension { drawn, stated, rounding, .. } = dimension;
        let off = |size: &f64| (size - drawn).abs();
        let nearest = sizes.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)));
        let (drawn, sigma) = match nearest.filter(|size| off(size) <= SAME_SIZE) {
            Some(size) => (size, SIGMAS[0]),
            None => (drawn, SIGMAS[1]),
        };
        (drawn > 0.0 && stated > 0.0).then_some(Self { drawn, stated, rounding, sigma })
    }

    /// Whether both have the same length of a pixel.
    fn agrees(&self, other: &Self) -> bool {
        let scale = other.stated / other.drawn;
        let ratio = self.drawn / other.drawn;
        let sigma = scale * self.sigma.hypot(ratio * other.sigma);
        let rounding = self.rounding + ratio * other.rounding;
        (self.stated - scale * self.drawn).abs() <= AGREEMENT * sigma + rounding
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dimension(drawn: f64, stated: f64) -> SheetDimension {
        SheetDimension { drawn, stated, rounding: 0.0 }
    }

    /// Tips are off by a pixel, views are not. One misread number is outvoted; a single dimension, or two
    /// that disagree, are no evidence.
    #[test]
    fn dimensions_that_agree_give_the_length_of_a_pixel() {
        let sizes = [400.1, 239.9, 160.0];
        let three = [dimension(401.0, 100.0), dimension(239.0, 60.0), dimension(160.5, 40.0)];
        let (length, count) = pixel_length(&three, &sizes).unwrap();
        assert_eq!(count, 3);
        assert!((length - 0.25).abs() < 2e-4, "{length}");
        let misread = [three[0], three[1], dimension(160.5, 46.0)];
        let (length, count) = pixel_length(&misread, &sizes).unwrap();
        assert!(count == 2 && (length - 0.25).abs() < 2e-4, "{length}");
        assert!(pixel_length(&three[..1], &sizes).is_none());
        assert!(pixel_length(&misread[1..], &sizes).is_none());
        assert!(pixel_length(&[], &sizes).is_none());
    }
}
