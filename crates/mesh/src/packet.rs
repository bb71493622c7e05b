//! The nearest points of all facets of a leaf, computed together in vector instructions (SIMD).
//!
//! In: up to [`LANES`] facets; a lane without a facet repeats the first. Out: [`Feet`], one for each lane.
//!
//! If a point projects into a triangle, its foot lies there: the barycentric coordinates are dot products
//! with two precomputed vectors, and the distance is the height over the plane. Otherwise the foot is the
//! nearest of those on the three sides. All cases are computed for every lane and selected afterwards,
//! because lanes cannot branch separately.
//!
//! Not guaranteed: the same last bit as [`crate::triangle::closest_on_triangle`].

use crate::bvh::LEAF;
use crate::triangle::area_vector;
use planish_core::DVec3;
use pulp::Simd;

/// Number of facets of a packet: a leaf fills it.
pub(crate) const LANES: usize = LEAF;

/// One coordinate of each facet.
type Lanes = [f64; LANES];

/// The nearest points of the facets of a packet.
#[derive(Default)]
pub(crate) struct Feet {
    pub squared_distance: Lanes,
    pub point: [Lanes; 3],
    pub barycentric: [Lanes; 3],
}

/// Facets that are processed together.
pub(crate) trait Packet {
    /// Creates a packet of one to [`LANES`] facets with these indices.
    fn new(corners: &[[DVec3; 3]], facets: &[u32]) -> Self;

    /// The index of the facet in a lane.
    fn facet(&self, lane: usize) -> u32;

    /// Computes the nearest point of each facet to a point.
    fn feet<S: Simd>(&self, simd: S, at: DVec3, feet: &mut Feet);
}

/// Triangles that are processed together.
#[derive(Debug, Clone)]
pub(crate) struct TrianglePacket {
    /// Corner `a`, and the sides from it to the corners `b` and `c`.
    a: [Lanes; 3],
    ab: [Lanes; 3],
    ac: [Lanes; 3],
    /// Unit normal; zero without area.
    normal: [Lanes; 3],
    /// Dotted with a point relative to `a`, these give the barycentric weights of `b` and `c`. Zero without
    /// area, so that no point projects inside.
    to_b: [Lanes; 3],
    to_c: [Lanes; 3],
    /// Inverse squared lengths of `ab`, `bc` and `ac`; zero without length, so that the foot is the start.
    per_length: [Lanes; 3],
    facets: [u32; LANES],
}

impl Packet for TrianglePacket {
    fn new(corners: &[[DVec3; 3]], facets: &[u32]) -> Self {
        let mut made = Self {
            a: [[0.0; LANES]; 3],
            ab: [[0.0; LANES]; 3],
            ac: [[0.0; LANES]; 3],
            normal: [[0.0; LANES]; 3],
            to_b: [[0.0; LANES]; 3],
            to_c: [[0.0; LANES]; 3],
            per_length: [[0.0; LANES]; 3],
            facets: [0; LANES],
        };
        for lane in 0..LANES {
            // Unused lanes repeat the first facet: zeros could be nearer than every real facet.
            let source = if lane < corners.len() { lane } else { 0 };
            let t = &corners[source];
            let (ab, ac) = (t[1] - t[0], t[2] - t[0]);
            let m = area_vector(t);
            let mm = m.length_squared();
            // Zero instead of infinity without area: infinity times zero would be NaN in every lane.
            let per_area = if mm > 0.0 { 1.0 / mm } else { 0.0 };
            let columns = [
                (&mut made.a, t[0]),
                (&mut made.ab, ab),
                (&mut made.ac, ac),
                (&mut made.normal, per_area.sqrt() * m),
                (&mut made.to_b, per_area * ac.cross(m)),
                (&mut made.to_c, per_area * m.cross(ab)),
                (
                    &mut made.per_length,
                    DVec3::from_array([ab, ac - ab, ac].map(|side| {
                        let length = side.length_squared();
                        if length > 0.0 { 1.0 / length } else { 0.0 }
                    })),
                ),
            ];
            for (column, values) in columns {
                for k in 0..3 {
                    column[k][lane] = values[k];
                }
            }
            made.facets[lane] = facets[source];
        }
        made
    }

    fn facet(&self, lane: usize) -> u32 {
        self.facets[lane]
    }

    #[inline(always)]
    fn feet<S: Simd>(&self, simd: S, at: DVec3, feet: &mut Feet) {
        let m = Vectors { simd };
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let place = [simd.splat_f64s(at[0]), simd.splat_f64s(at[1]), simd.splat_f64s(at[2])];
        for group in 0..LANES / S::F64_LANES {
            let (a, ab) = (m.read(&self.a, group), m.read(&self.ab, group));
            let (ac, normal) = (m.read(&self.ac, group), m.read(&self.normal, group));
            let per_length = m.read(&self.per_length, group);
            let ap = m.minus(place, a);
            let (bc, bp) = (m.minus(ac, ab), m.minus(ap, ab));
            // The nearest of the feet on the three sides.
            // Without length, the position is zero and the foot the start of the side, which is also
            // right for points.
            let on_ab = m.share(m.product(ap, ab), per_length[0]);
            let on_bc = m.share(m.product(bp, bc), per_length[1]);
            let on_ac = m.share(m.product(ap, ac), per_length[2]);
            let off_bc = m.minus_along(bp, on_bc, bc);
            let off_ac = m.minus_along(ap, on_ac, ac);
            // Sides are always compared, even if the foot is inside: a branch would have to be the same
            // for all lanes.
            let mut off = m.minus_along(ap, on_ab, ab);
            let mut squared = m.product(off, off);
            let mut weights = [simd.sub_f64s(one, on_ab), on_ab, zero];
            let (to_bc, to_ac) = (m.product(off_bc, off_bc), m.product(off_ac, off_ac));
            let nearer = simd.less_than_f64s(to_bc, squared);
            squared = simd.select_f64s(nearer, to_bc, squared);
            off = m.select(nearer, off_bc, off);
            weights = m.select(nearer, [zero, simd.sub_f64s(one, on_bc), on_bc], weights);
            let nearer = simd.less_than_f64s(to_ac, squared);
            squared = simd.select_f64s(nearer, to_ac, squared);
            off = m.select(nearer, off_ac, off);
            weights = m.select(nearer, [simd.sub_f64s(one, on_ac), zero, on_ac], weights);
            // The foot inside, if all three weights are positive. At a border of the triangle, both cases
            // agree.
            let v = m.product(ap, m.read(&self.to_b, group));
            let w = m.product(ap, m.read(&self.to_c, group));
            let u = simd.sub_f64s(simd.sub_f64s(one, v), w);
            let inside = simd.less_than_f64s(zero, simd.min_f64s(simd.min_f64s(v, w), u));
            let height = m.product(ap, normal);
            squared = simd.select_f64s(inside, simd.mul_f64s(height, height), squared);
            off = m.select(inside, m.times(height, normal), off);
            weights = m.select(inside, [u, v, w], weights);
            m.write(squared, &mut feet.squared_distance, group);
            for k in 0..3 {
                m.write(simd.sub_f64s(place[k], off[k]), &mut feet.point[k], group);
                m.write(weights[k], &mut feet.barycentric[k], group);
            }
        }
    }
}

/// Operations on vectors in space, one per lane.
///
/// They are written out by coordinate: the body of a closure would not be compiled for wide vectors.
struct Vectors<S> {
    simd: S,
}

impl<S: Simd> Vectors<S> {
    #[inline(always)]
    fn read(&self, column: &[Lanes; 3], group: usize) -> [S::f64s; 3] {
        [
            S::as_simd_f64s(&column[0]).0[group],
            S::as_simd_f64s(&column[1]).0[group],
            S::as_simd_f64s(&column[2]).0[group],
        ]
    }

    #[inline(always)]
    fn write(&self, value: S::f64s, lanes: &mut Lanes, group: usize) {
        S::as_mut_simd_f64s(lanes).0[group] = value;
    }

    #[inline(always)]
    fn minus(&self, a: [S::f64s; 3], b: [S::f64s; 3]) -> [S::f64s; 3] {
        [self.simd.sub_f64s(a[0], b[0]), self.simd.sub_f64s(a[1], b[1]), self.simd.sub_f64s(a[2], b[2])]
    }

    #[inline(always)]
    fn times(&self, s: S::f64s, a: [S::f64s; 3]) -> [S::f64s; 3] {
        [self.simd.mul_f64s(s, a[0]), self.simd.mul_f64s(s, a[1]), self.simd.mul_f64s(s, a[2])]
    }

    /// Position of a foot along a side, from a dot product and the inverse squared length, clamped to 0 to 1.
    #[inline(always)]
    fn share(&self, product: S::f64s, per_length: S::f64s) -> S::f64s {
        let (zero, one) = (self.simd.splat_f64s(0.0), self.simd.splat_f64s(1.0));
        (self.simd).max_f64s(self.simd.min_f64s(self.simd.mul_f64s(product, per_length), one), zero)
    }

    /// `a − s b`.
    #[inline(always)]
    fn minus_along(&self, a: [S::f64s; 3], s: S::f64s, b: [S::f64s; 3]) -> [S::f64s; 3] {
        [
            self.simd.sub_f64s(a[0], self.simd.mul_f64s(s, b[0])),
            self.simd.sub_f64s(a[1], self.simd.mul_f64s(s, b[1])),
            self.simd.sub_f64s(a[2], self.simd.mul_f64s(s, b[2])),
        ]
    }

    /// Dot product.
    #[inline(always)]
    fn product(&self, a: [S::f64s; 3], b: [S::f64s; 3]) -> S::f64s {
        let first = self.simd.mul_f64s(a[0], b[0]);
        let second = self.simd.mul_add_e_f64s(a[1], b[1], first);
        self.simd.mul_add_e_f64s(a[2], b[2], second)
    }

    #[inline(always)]
    fn select(&self, mask: S::m64s, yes: [S::f64s; 3], no: [S::f64s; 3]) -> [S::f64s; 3] {
        [
            self.simd.select_f64s(mask, yes[0], no[0]),
            self.simd.select_f64s(mask, yes[1], no[1]),
            self.simd.select_f64s(mask, yes[2], no[2]),
        ]
    }
}

/// Points that are processed together.
#[derive(Debug, Clone)]
pub(crate) struct PointPacket {
    at: [Lanes; 3],
    facets: [u32; LANES],
}

impl Packet for PointPacket {
    fn new(corners: &[[DVec3; 3]], facets: &[u32]) -> Self {
        let source = |lane: usize| if lane < corners.len() { lane } else { 0 };
        Self {
            at: std::array::from_fn(|k| std::array::from_fn(|lane| corners[source(lane)][0][k])),
            facets: std::array::from_fn(|lane| facets[source(lane)]),
        }
    }

    fn facet(&self, lane: usize) -> u32 {
        self.facets[lane]
    }

    #[inline(always)]
    fn feet<S: Simd>(&self, _: S, at: DVec3, feet: &mut Feet) {
        for lane in 0..LANES {
            let off = [at[0] - self.at[0][lane], at[1] - self.at[1][lane], at[2] - self.at[2][lane]];
            feet.squared_distance[lane] = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
            for k in 0..3 {
                feet.point[k][lane] = self.at[k][lane];
                feet.barycentric[k][lane] = if k == 0 { 1.0 } else { 0.0 };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::triangle::closest_on_triangle;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    struct OfPacket<'a> {
        packet: &'a TrianglePacket,
        at: DVec3,
        feet: &'a mut Feet,
    }

    impl pulp::WithSimd for OfPacket<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            self.packet.feet(simd, self.at, self.feet);
        }
    }

    /// Results match the scalar code for triangles of every shape, including slivers, segments and points,
    /// and for points on them.
    #[test]
    fn feet_match_the_scalar_code() {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        for round in 0..2000 {
            let count = 1 + round % LANES;
            let corners: Vec<[DVec3; 3]> = (0..count)
                .map(|k| {
                    let [a, b, mut c]: [DVec3; 3] = std::array::from_fn(|_| {
                        DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)))
                    });
                    match k % 4 {
                        0 => return [a; 3],
                        1 => c = 0.3 * a + 0.7 * b,
                        2 => c = 0.3 * a + 0.7 * b + 1e-4 * c,
                        _ => {}
                    }
                    [a, b, c]
                })
                .collect();
            let facets: Vec<u32> = (0..count as u32).map(|k| k + 5).collect();
            let packet = TrianglePacket::new(&corners, &facets);
            let at: DVec3 = match round % 3 {
                0 => corners[count - 1][1],
                _ => DVec3::from_array(std::array::from_fn(|_| random.random_range(-2.0..2.0))),
            };
            let mut feet = Feet::default();
            pulp::Arch::new().dispatch(OfPacket { packet: &packet, at, feet: &mut feet });
            for (lane, t) in corners.iter().enumerate() {
                let plain = closest_on_triangle(at, t, f64::INFINITY).unwrap();
                assert_eq!(packet.facet(lane), facets[lane]);
                let (made, wanted) = (feet.squared_distance[lane].sqrt(), plain.squared_distance.sqrt());
                assert!((made - wanted).abs() < 1e-9, "{t:?} {at:?}: {made} {wanted}");
                let by_weights = crate::triangle::point_at(t, feet.barycentric.map(|w| w[lane]));
                let point = DVec3::from_array(feet.point.map(|x| x[lane]));
                for other in [by_weights, plain.point] {
                    assert!(point.distance(other) < 1e-7, "{t:?} {at:?}");
                }
            }
        }
    }
}
