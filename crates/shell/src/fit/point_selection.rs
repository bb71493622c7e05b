//! Selects and orders the points of a stage.
//!
//! In: points, and the mesh's bounds. Out: indices of points. Neighbours in space follow one another, so that
//! facets, vertices and weights of one point are still in the cache for the next.

use super::readings::PointReading;
use planish_core::DVec3;
use planish_core::random::{nth, unit_interval};
use planish_mesh::BoundingBox;

/// Bits of the cell number along each axis; three times ten fit a `u32`.
const BITS: u32 = 10;

/// About `wanted` of the points, spread evenly whatever their order, or all if there are fewer. They are
/// ordered along a Morton curve through the bounds.
pub(super) fn chosen_points(points: &[PointReading], wanted: usize, bounds: &BoundingBox) -> Vec<u32> {
    let share = wanted as f64 / points.len().max(1) as f64;
    let mut keyed: Vec<(u32, u32)> = (0..points.len() as u32)
        .filter(|i| share >= 1.0 || hashed(*i) < share)
        .map(|i| (morton(points[i as usize].at, bounds), i))
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// A hash of the index in `[0, 1)`. Multiples of the golden ratio would correlate with the rows of a grid.
fn hashed(i: u32) -> f64 {
    unit_interval(nth(u64::from(i)))
}

/// The interleaved bits of the three cell numbers; points outside of the bounds belong to the outermost
/// cells.
fn morton(at: DVec3, bounds: &BoundingBox) -> u32 {
    let cells = f64::from(1_u32 << BITS);
    let mut key = 0;
    for axis in 0..3 {
        let side = (bounds.max[axis] - bounds.min[axis]).max(f64::MIN_POSITIVE);
        let cell = ((at[axis] - bounds.min[axis]) / side * cells).clamp(0.0, cells - 1.0) as u32;
        for bit in 0..BITS {
            key |= (cell >> bit & 1) << (3 * bit + axis as u32);
        }
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::SymmetricMatrix3;

    fn readings(count: u32) -> Vec<PointReading> {
        (0..count)
            .map(|i| PointReading {
                at: DVec3::from_array([0, 1, 2].map(|axis| hashed(3 * i + axis))),
                covariance: SymmetricMatrix3::isotropic(1.0),
            })
            .collect()
    }

    /// A point that came twice would count twice, one that is missing would be called a gross error.
    #[test]
    fn all_points_are_chosen_once_where_all_are_wanted() {
        let mut points = readings(500);
        points[7].at = DVec3::new(1e9, -1e9, 0.5);
        let bounds = BoundingBox::from_points(&[DVec3::ZERO, DVec3::splat(1.0)]).unwrap();
        let mut chosen = chosen_points(&points, 500, &bounds);
        chosen.sort_unstable();
        assert_eq!(chosen, (0..500).collect::<Vec<u32>>());
        assert!(chosen_points(&[], 10, &bounds).is_empty());
    }

    /// A share of the points is spread over all of them, and neighbours in the order are near in space.
    #[test]
    fn a_share_is_spread_evenly_and_follows_space() {
        let points = readings(8000);
        let bounds = BoundingBox::from_points(&[DVec3::ZERO, DVec3::splat(1.0)]).unwrap();
        let chosen = chosen_points(&points, 2000, &bounds);
        assert!((1800..2200).contains(&chosen.len()), "{}", chosen.len());
        let early = chosen.iter().filter(|i| **i < 4000).count();
        assert!((900..1100).contains(&early), "{early}");
        let way = |order: &[u32]| -> f64 {
            (order.windows(2)).map(|w| points[w[0] as usize].at.distance(points[w[1] as usize].at)).sum()
        };
        let mut unordered = chosen.clone();
        unordered.sort_unstable();
        assert!(way(&chosen) < 0.3 * way(&unordered));
    }
}
