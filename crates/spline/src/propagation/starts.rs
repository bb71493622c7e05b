//! Initial values for the search for a symmetry.

use super::facets::Facets;
use super::maps::Symmetry;
use super::symmetry::SymmetryKind;
use crate::principal_axes;
use nalgebra::{Matrix3, Vector3};
use planish_core::{DVec3, SymmetricMatrix3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Number of random pairs of facets to examine, and of symmetries that are compared. More pairs find weaker
/// symmetries at a higher cost.
const EXAMINED_PAIRS: u64 = 60_000;
const MAX_CANDIDATES: usize = 4000;
/// Maximum number of starts.
const MAX_STARTS: usize = 200;
/// Symmetries are alike if they move points about the middle to places no farther apart than this share of
/// the size: about the error of a symmetry from two facets.
const ALIKE: f64 = 0.06;
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
                all.extend(random_pairs(facets, middle, |a, b| turn_between(facets, a, b, order)));
            }
            all
        }
        SymmetryKind::Mirror { towards } => {
            let through_middle = towards.into_iter().chain(axes).filter_map(DVec3::try_normalize);
            let mut all: Vec<Symmetry> =
                through_middle.map(|normal| Symmetry::Mirror { point: middle, normal }).collect();
            all.extend(random_pairs(facets, middle, |a, b| plane_between(facets, a, b)));
            all
        }
    }
}

/// Symmetries of random pairs of facets that can be images of each other, those that most pairs agree on
/// first.
///
/// On smooth bodies most pairs are such images by chance, for all kinds of symmetries. Those of a true
/// symmetry agree, so that it has the most votes (Mitra, Guibas and Pauly, Partial and approximate symmetry
/// detection for 3D geometry, 2006, section 3).
fn random_pairs(
    facets: &Facets,
    middle: DVec3,
    guess: impl Fn(usize, usize) -> Option<Symmetry>,
) -> Vec<Symmetry> {
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
    most_voted(facets, middle, candidates.take(MAX_CANDIDATES).collect())
}

/// The candidates that most others are like, without those like a better one.
fn most_voted(facets: &Facets, middle: DVec3, candidates: Vec<Symmetry>) -> Vec<Symmetry> {
    let reach = 0.25 * facets.size;
    let probes = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|d| middle + reach * d);
    let images: Vec<[DVec3; 4]> = (candidates.iter())
        .map(|candidate| {
            let maps = candidate.maps();
            probes.map(|p| maps.first().map_or(p, |map| candidate.apply(*map, p)))
        })
        .collect();
    let bound = (ALIKE * facets.size).powi(2);
    let alike = |a: usize, b: usize| {
        let squares = images[a].iter().zip(&images[b]).map(|(p, q)| p.distance_squared(*q));
        squares.sum::<f64>() <= bound * probes.len() as f64
    };
    let votes: Vec<usize> = (0..candidates.len())
        .into_par_iter()
        .map(|a| (0..candidates.len()).filter(|&b| alike(a, b)).count())
        .collect();
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    // Ties are broken by the number, so that the result is always the same.
    order.sort_by_key(|&a| (std::cmp::Reverse(votes[a]), a));
    let mut chosen: Vec<usize> = Vec::new();
    for a in order {
        if chosen.len() < MAX_STARTS && !chosen.iter().any(|&b| alike(a, b)) {
            chosen.push(a);
        }
    }
    chosen.into_iter().map(|a| candidates[a]).collect()
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
