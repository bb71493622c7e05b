//! Initial values for the search for a symmetry.

use super::facets::Facets;
use super::maps::Symmetry;
use super::symmetry::SymmetryKind;
use crate::principal_axes;
use nalgebra::{Matrix3, Vector3};
use planish_core::{DVec3, SymmetricMatrix3};
use std::f64::consts::TAU;

/// Number of random pairs of facets to examine, and maximum number of starts. More pairs find weaker
/// symmetries at a higher cost.
const EXAMINED_PAIRS: u64 = 20_000;
const MAX_STARTS: usize = 200;
/// Minimum cosine between the normal of a facet and that of the image of its partner: 14°. Normals of
/// matching facets differ by their errors and by the curvature over a facet.
const MIN_COSINE: f64 = 0.97;
/// Minimum distance of a pair, in sides of a facet. Closer pairs do not determine a symmetry.
const MIN_SEPARATION: f64 = 3.0;

/// Initial values of a symmetry.
pub(super) fn starts(facets: &Facets, kind: SymmetryKind, middle: DVec3) -> Vec<Symmetry> {
    let points: Vec<DVec3> = facets.all.iter().map(|f| f.point).collect();
    let (_, axes, _) = principal_axes(&points);
    match kind {
        SymmetryKind::Rotation { order, towards } => {
            let complex = LineComplex::new(facets, middle);
            let directions =
                towards.into_iter().chain(complex.directions()).chain(axes).filter_map(DVec3::try_normalize);
            let mut all: Vec<Symmetry> = directions
                .map(|direction| Symmetry::Rotation {
                    point: middle + complex.point(direction),
                    direction,
                    order,
                })
                .collect();
            if let Some(order) = order {
                all.extend(random_pairs(facets, |a, b| turn_between(facets, a, b, order)));
            }
            all
        }
        SymmetryKind::Mirror { towards } => {
            let through_middle = towards.into_iter().chain(axes).filter_map(DVec3::try_normalize);
            let mut all: Vec<Symmetry> =
                through_middle.map(|normal| Symmetry::Mirror { point: middle, normal }).collect();
            all.extend(random_pairs(facets, |a, b| plane_between(facets, a, b)));
            all
        }
    }
}

/// Symmetries of random pairs of facets that can be images of each other.
fn random_pairs(facets: &Facets, guess: impl Fn(usize, usize) -> Option<Symmetry>) -> Vec<Symmetry> {
    let count = facets.all.len() as u64;
    // A fixed seed: the same cloud gives the same symmetry.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut next = || {
        // An xorshift generator (Marsaglia 2003).
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) % count
    };
    let candidates = (0..EXAMINED_PAIRS).filter_map(|_| {
        let (a, b) = (next() as usize, next() as usize);
        guess(a, b)
    });
    candidates.take(MAX_STARTS).collect()
}

/// The mid-plane of two facets, if it maps the normal of one to that of the other.
fn plane_between(facets: &Facets, a: usize, b: usize) -> Option<Symmetry> {
    let (a, b) = (&facets.all[a], &facets.all[b]);
    let apart = b.point - a.point;
    let normal = apart.try_normalize()?;
    let image = a.normal - 2.0 * a.normal.dot(normal) * normal;
    (apart.dot(normal) > MIN_SEPARATION * facets.side && image.dot(b.normal) > MIN_COSINE)
        .then(|| Symmetry::Mirror { point: 0.5 * (a.point + b.point), normal })
}

/// The axis about which a turn by `2π/order` maps one facet to another, including normals.
fn turn_between(facets: &Facets, a: usize, b: usize, order: u32) -> Option<Symmetry> {
    let (a, b) = (&facets.all[a], &facets.all[b]);
    let apart = b.point - a.point;
    if apart.length_squared() < (MIN_SEPARATION * facets.side).powi(2) {
        return None;
    }
    // The axis lies in the plane spanned by the bisector of both normals and their cross product. Its angle β
    // with each normal follows from sin(ψ/2) = sin(φ/2) sin β, where ψ is the angle between the normals and φ
    // that of the rotation.
    let half = 0.5 * TAU / f64::from(order);
    let (sum, across) = (a.normal + b.normal, a.normal.cross(b.normal));
    let (bisector, across) = (sum.try_normalize()?, across.try_normalize()?);
    let cos_half = 0.5 * sum.length();
    let sin_beta = (1.0 - cos_half * cos_half).max(0.0).sqrt() / half.sin();
    if sin_beta > 1.0 {
        return None;
    }
    let along = (1.0 - sin_beta * sin_beta).sqrt() / cos_half;
    let rest = (1.0 - along * along).max(0.0).sqrt();
    [1.0, -1.0].into_iter().find_map(|sign| {
        let direction = (rest * across + sign * along * bisector).try_normalize()?;
        let slide = apart.dot(direction);
        let flat = apart - slide * direction;
        (slide.abs() < facets.side).then(|| Symmetry::Rotation {
            point: 0.5 * (a.point + b.point) + 0.5 / half.tan() * direction.cross(flat),
            direction,
            order: Some(order),
        })
    })
}

/// The sums of a linear line complex: an axis `(d, m)` meets the normal line of `p` where
/// `m·n + d·(p × n) = 0`.
struct LineComplex {
    moments: Matrix3<f64>,
    mixed: Matrix3<f64>,
    normals: Matrix3<f64>,
}

impl LineComplex {
    fn new(facets: &Facets, middle: DVec3) -> Self {
        let mut made = Self {
            moments: Matrix3::zeros(),
            mixed: Matrix3::zeros(),
            // Normals of a plane or cylinder span less than space; the small term keeps the matrix regular.
            normals: Matrix3::identity() * (1e-9 * facets.all.len() as f64),
        };
        for facet in &facets.all {
            let n = Vector3::from(facet.normal);
            let moment = Vector3::from((facet.point - middle).cross(facet.normal));
            made.moments += moment * moment.transpose();
            made.mixed += n * moment.transpose();
            made.normals += n * n.transpose();
        }
        made
    }

    /// `m` of the axis with this direction that is nearest to all normal lines.
    fn moment(&self, d: Vector3<f64>) -> Vector3<f64> {
        self.normals.cholesky().map_or_else(Vector3::zeros, |c| -c.solve(&(self.mixed * d)))
    }

    /// The stationary directions, the nearest to all normal lines last.
    fn directions(&self) -> [DVec3; 3] {
        let Some(factor) = self.normals.cholesky() else {
            return [DVec3::ZERO; 3];
        };
        let left = self.moments - self.mixed.transpose() * factor.solve(&self.mixed);
        SymmetricMatrix3::from_entries(|i, j| 0.5 * (left[(i, j)] + left[(j, i)])).eigen().0
    }

    /// A point of the axis of this direction, from the middle.
    fn point(&self, d: DVec3) -> DVec3 {
        d.cross(self.moment(Vector3::from(d)).into())
    }
}
