//! The spheres of spherical metaballs: centre and radius for each facet, and the derivative of the centre by
//! the corners.
//!
//! In: a facet. Out: the centre of the smallest circle around it. Without an obtuse angle it is the
//! circumcentre (C eq. 2), otherwise the middle of the longest side: the circumcentre of an obtuse facet lies
//! outside of it, and a facet without area has none. At a right angle both points coincide.
//!
//! Not guaranteed: a derivative at right angles, where it jumps.

use nalgebra::{Matrix3, Vector3};
use planish_core::DVec3;

/// A skeleton point with its derivatives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Skeleton {
    pub center: DVec3,
    /// Radius of the circle about the facet.
    pub radius: f64,
    /// `∂center/∂corner_k`.
    pub by_corner: [Matrix3<f64>; 3],
}

/// The corner opposite the longest side, if its angle is at least 90°.
fn obtuse_corner(t: &[DVec3; 3]) -> Option<usize> {
    let at = |k: usize| {
        let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
        (b - a).dot(c - a)
    };
    let opposite = |k: usize| {
        let side = t[(k + 1) % 3] - t[(k + 2) % 3];
        side.length_squared()
    };
    let longest = (1..3).fold(0, |best, k| if opposite(k) > opposite(best) { k } else { best });
    (at(longest) <= 0.0).then_some(longest)
}

/// The skeleton point of a facet and how it moves.
pub(crate) fn skeleton(t: &[DVec3; 3]) -> Skeleton {
    let obtuse = obtuse_corner(t);
    let acute = if obtuse.is_none() { circumcenter(t) } else { None };
    acute.unwrap_or_else(|| {
        let corner = obtuse.unwrap_or(0);
        let [a, b] = [t[(corner + 1) % 3], t[(corner + 2) % 3]];
        let mut by_corner = [Matrix3::from_diagonal_element(0.5); 3];
        by_corner[corner] = Matrix3::zeros();
        Skeleton { center: 0.5 * (a + b), radius: 0.5 * (a - b).length(), by_corner }
    })
}

/// `M C = h` with rows `b − a`, `c − a`, `n` and `h = ((|b|² − |a|²)/2, (|c|² − |a|²)/2, 0)`, all from corner
/// `a`; its differential for the derivatives.
fn circumcenter(t: &[DVec3; 3]) -> Option<Skeleton> {
    let [b, c] = [1, 2].map(|k| t[k] - t[0]);
    let n = b.cross(c);
    let nn = n.length_squared();
    let (bb, cc) = (b.length_squared(), c.length_squared());
    let off = 0.5 / nn * (bb * c.cross(n) - cc * b.cross(n));
    if !off.is_finite() {
        return None;
    }
    let row = |v: DVec3| Vector3::from(v).transpose();
    // The third row keeps the centre in the plane of the facet, which two equations of distances do not.
    let inverse = Matrix3::from_rows(&[row(b), row(c), row(n)]).try_inverse()?;
    let skew = |v: DVec3| Vector3::from(v).cross_matrix();
    // With b alone moving: (b − C)·db in the first row; −C·dn in the third, dn = db × c.
    let by_b = inverse * Matrix3::from_rows(&[row(b - off), row(DVec3::ZERO), -(row(off) * -skew(c))]);
    let by_c = inverse * Matrix3::from_rows(&[row(DVec3::ZERO), row(c - off), -(row(off) * skew(b))]);
    Some(Skeleton {
        center: t[0] + off,
        radius: off.length(),
        by_corner: [Matrix3::identity() - by_b - by_c, by_b, by_c],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn centers_are_in_the_facet_and_move_as_stated() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let (mut acute, mut obtuse) = (0, 0);
        for _ in 0..1000 {
            let t: [DVec3; 3] = std::array::from_fn(|_| {
                DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)))
            });
            let made = skeleton(&t);
            let far = t.map(|corner| corner.distance(made.center));
            for r in far {
                assert!(r <= made.radius + 1e-9, "a corner is outside of the circle");
            }
            if far.iter().all(|r| (r - made.radius).abs() < 1e-9) {
                acute += 1;
            } else {
                obtuse += 1;
            }
            let step = 1e-6;
            for corner in 0..3 {
                for axis in 0..3 {
                    let moved = |by: f64| {
                        let mut t = t;
                        t[corner][axis] += by;
                        skeleton(&t).center
                    };
                    let difference = 0.5 / step * (moved(step) - moved(-step));
                    let stated = made.by_corner[corner].column(axis).into_owned();
                    let off = (Vector3::from(difference) - stated).norm();
                    assert!(off < 1e-4 * (1.0 + stated.norm()), "{t:?}: {difference:?} {stated:?}");
                }
            }
        }
        assert!(acute > 100 && obtuse > 100);
    }

    #[test]
    fn facets_without_area_have_the_middle_of_their_longest_side() {
        let line = skeleton(&[DVec3::ZERO, DVec3::new(4.0, 0.0, 0.0), DVec3::X]);
        assert_eq!((line.center, line.radius), (DVec3::new(2.0, 0.0, 0.0), 2.0));
        let point = skeleton(&[DVec3::new(1.0, 2.0, 3.0); 3]);
        assert_eq!((point.center, point.radius), (DVec3::new(1.0, 2.0, 3.0), 0.0));
    }
}
