//! Pieces of a cloud that a symmetry lays on one another.

use super::facets::{COEFFICIENTS, Facet, Facets};
use super::maps::{MOST_PARAMETERS, Map, Symmetry};
use nalgebra::SVector;
use planish_estimate::vector3::{dot, sub};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Cosine between the normals of pieces that may be each other's images, at least.
const LEAST_COSINE: f64 = 0.8;
/// Images farther than so many reaches along the normal are of another part.
const FARTHEST: f64 = 3.0;
/// A piece nearer to the fixed points than so many reaches meets itself, and agrees whatever the symmetry.
const TOO_NEAR: f64 = 1.5;
/// Partners of a piece, at most; a ring has many.
const MOST_PARTNERS: usize = 12;

/// One piece's image beside another.
pub(super) struct Pair {
    pub from: u32,
    pub to: u32,
    /// How far the image lies above the other, and the derivatives by the symmetry and by both pieces'
    /// coefficients.
    pub residual: f64,
    pub by_symmetry: SVector<f64, MOST_PARAMETERS>,
    /// The same with the image's own normal, whose error is independent of the residual's.
    pub instrument: SVector<f64, MOST_PARAMETERS>,
    pub by_from: SVector<f64, COEFFICIENTS>,
    pub by_to: SVector<f64, COEFFICIENTS>,
    /// Variance that the errors of both pieces give the residual.
    pub variance: f64,
    /// Less where the image lies towards the border of the other piece.
    pub weight: f64,
}

/// The pairs of every `stride`-th piece with those that its images lie within `reach` of.
pub(super) fn pairs(facets: &Facets, symmetry: &Symmetry, reach: f64, stride: usize) -> Vec<Pair> {
    let sources: Vec<u32> = (0..facets.all.len() as u32).step_by(stride).collect();
    let found: Vec<Vec<Pair>> = if let Symmetry::Rotation { order: None, .. } = symmetry {
        let places: Vec<[f64; 3]> = facets.all.iter().map(|f| symmetry.cylindrical(f.point)).collect();
        sources.par_iter().map(|&from| on_one_ring(facets, symmetry, &places, reach, from)).collect()
    } else {
        let maps = symmetry.maps();
        sources.par_iter().map(|&from| images(facets, symmetry, &maps, reach, from)).collect()
    };
    found.into_iter().flatten().collect()
}

/// Partners of a piece under the maps of a finite symmetry; each pair is met once.
fn images(facets: &Facets, symmetry: &Symmetry, maps: &[Map], reach: f64, from: u32) -> Vec<Pair> {
    let facet = &facets.all[from as usize];
    let side = dot(sub(facet.point, symmetry.point()), symmetry.direction());
    let mut found = Vec::new();
    let maps = match symmetry {
        // The image of the other half is the same comparison again.
        Symmetry::Mirror { .. } if side <= TOO_NEAR * reach => return found,
        Symmetry::Mirror { .. } => maps,
        // So are turns by more than half.
        Symmetry::Rotation { .. } => &maps[..maps.len().div_ceil(2)],
    };
    for &map in maps {
        let image = symmetry.apply(map, facet.point);
        if distance2(image, facet.point) <= (TOO_NEAR * reach).powi(2) {
            continue;
        }
        let mut near: Vec<Pair> = (0..facets.all.len() as u32)
            .filter(|&to| distance2(image, facets.all[to as usize].point) < (FARTHEST * reach).powi(2))
            .filter_map(|to| pair(facets, symmetry, map, from, to, reach))
            .collect();
        near.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        near.truncate(2);
        found.append(&mut near);
    }
    found
}

/// Partners of a piece on its ring about an axis.
fn on_one_ring(
    facets: &Facets,
    symmetry: &Symmetry,
    places: &[[f64; 3]],
    reach: f64,
    from: u32,
) -> Vec<Pair> {
    let [height, radius, angle] = places[from as usize];
    let mut near: Vec<u32> = (0..facets.all.len() as u32)
        .filter(|&to| {
            let [h, r, a] = places[to as usize];
            let turn = (a - angle + PI).rem_euclid(TAU) - PI;
            let chord = 2.0 * radius * (0.5 * turn).sin().abs();
            to != from
                && (h - height).abs() < FARTHEST * reach
                && (r - radius).abs() < FARTHEST * reach
                && chord > TOO_NEAR * reach
        })
        .collect();
    // Any few of them, the same each time: those in the order of a hash.
    near.sort_by_key(|&to| (u64::from(to) << 20 ^ u64::from(from)).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mut found = Vec::new();
    for to in near {
        let map = Map::turn(places[to as usize][2] - angle);
        found.extend(pair(facets, symmetry, map, from, to, reach));
        if found.len() >= MOST_PARTNERS {
            break;
        }
    }
    found
}

fn pair(facets: &Facets, symmetry: &Symmetry, map: Map, from: u32, to: u32, reach: f64) -> Option<Pair> {
    let (facet, other) = (&facets.all[from as usize], &facets.all[to as usize]);
    let normal = symmetry.carry(map, facet.normal);
    if dot(normal, other.normal) < LEAST_COSINE {
        return None;
    }
    let height = other.height(symmetry.apply(map, facet.point));
    if height.slip >= reach || height.value.abs() >= FARTHEST * reach {
        return None;
    }
    let by_from = Facet::own() * dot(normal, height.normal);
    let derivatives = symmetry.derivatives(map, facet.point);
    Some(Pair {
        from,
        to,
        residual: height.value,
        by_symmetry: SVector::from_fn(|k, _| dot(height.normal, derivatives[k])),
        instrument: SVector::from_fn(|k, _| dot(normal, derivatives[k])),
        variance: facet.variance(&by_from) + other.variance(&height.by_coefficients),
        by_from,
        by_to: height.by_coefficients,
        weight: (1.0 - (height.slip / reach).powi(2)).powi(2),
    })
}

fn distance2(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = sub(a, b);
    dot(d, d)
}
