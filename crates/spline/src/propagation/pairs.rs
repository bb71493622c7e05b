//! Facets of a cloud that a symmetry maps onto each other.

use super::facets::{COEFFICIENTS, Facet, Facets};
use super::maps::{MAX_PARAMETERS, Map, Symmetry};
use nalgebra::SVector;
use planish_core::DVec3;
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Minimum cosine between the normals of an image and its partner: 37°. A smaller cosine would pair the sides
/// of an edge, a larger one would reject partners of inaccurate starts.
const MIN_COSINE: f64 = 0.8;
/// Maximum distance of an image along the normal, relative to the reach. Farther images belong to another
/// part.
const MAX_DISTANCE: f64 = 3.0;
/// Minimum distance of a facet from the fixed points, relative to the reach. A closer facet is mapped onto
/// itself and agrees with any symmetry.
const MIN_DISTANCE: f64 = 1.5;
/// Maximum number of partners of a facet. It bounds the cost for rings, which have many.
const MAX_PARTNERS: usize = 12;

/// The image of a facet and its partner.
pub(super) struct Pair {
    pub from: u32,
    pub to: u32,
    /// Height of the image over the partner, and derivatives with respect to the symmetry and the
    /// coefficients of both facets.
    pub residual: f64,
    pub by_symmetry: SVector<f64, MAX_PARAMETERS>,
    /// The derivative with the normal of the image, whose error is independent of the residual.
    pub instrument: SVector<f64, MAX_PARAMETERS>,
    pub by_from: SVector<f64, COEFFICIENTS>,
    pub by_to: SVector<f64, COEFFICIENTS>,
    /// Variance of the residual from the errors of both facets.
    pub variance: f64,
    /// Weight, smaller towards the border of the partner.
    pub weight: f64,
}

/// The pairs of every `stride`-th facet with all facets within `reach` of its images.
pub(super) fn pairs(facets: &Facets, symmetry: &Symmetry, reach: f64, stride: usize) -> Vec<Pair> {
    let sources: Vec<u32> = (0..facets.all.len() as u32).step_by(stride).collect();
    // Collected in the order of the sources, so the result does not depend on the number of threads.
    let found: Vec<Vec<Pair>> = if let Symmetry::Rotation { order: None, .. } = symmetry {
        let places: Vec<[f64; 3]> = facets.all.iter().map(|f| symmetry.cylindrical(f.point)).collect();
        sources.par_iter().map(|&from| on_one_ring(facets, symmetry, &places, reach, from)).collect()
    } else {
        let maps = symmetry.maps();
        sources.par_iter().map(|&from| images(facets, symmetry, &maps, reach, from)).collect()
    };
    found.into_iter().flatten().collect()
}

/// Partners of a facet under the maps of a finite symmetry; each pair occurs once.
fn images(facets: &Facets, symmetry: &Symmetry, maps: &[Map], reach: f64, from: u32) -> Vec<Pair> {
    let facet = &facets.all[from as usize];
    let side = (facet.point - symmetry.point()).dot(symmetry.direction());
    let mut found = Vec::new();
    let maps = match symmetry {
        // The inverse map gives the same comparison.
        Symmetry::Mirror { .. } if side <= MIN_DISTANCE * reach => return found,
        Symmetry::Mirror { .. } => maps,
        // Rotations by more than half a turn are inverses of smaller ones.
        Symmetry::Rotation { .. } => &maps[..maps.len().div_ceil(2)],
    };
    for &map in maps {
        let image = symmetry.apply(map, facet.point);
        if distance2(image, facet.point) <= (MIN_DISTANCE * reach).powi(2) {
            continue;
        }
        let mut near: Vec<Pair> = (0..facets.all.len() as u32)
            .filter(|&to| distance2(image, facets.all[to as usize].point) < (MAX_DISTANCE * reach).powi(2))
            .filter_map(|to| pair(facets, symmetry, map, from, to, reach))
            .collect();
        // Two partners at most: more neighbours of one image repeat the same information.
        near.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        near.truncate(2);
        found.append(&mut near);
    }
    found
}

/// Partners of a facet on its ring about an axis.
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
                && (h - height).abs() < MAX_DISTANCE * reach
                && (r - radius).abs() < MAX_DISTANCE * reach
                && chord > MIN_DISTANCE * reach
        })
        .collect();
    // A reproducible sample: the first in the order of a hash.
    near.sort_by_key(|&to| (u64::from(to) << 20 ^ u64::from(from)).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mut found = Vec::new();
    for to in near {
        let map = Map::turn(places[to as usize][2] - angle);
        found.extend(pair(facets, symmetry, map, from, to, reach));
        if found.len() >= MAX_PARTNERS {
            break;
        }
    }
    found
}

fn pair(facets: &Facets, symmetry: &Symmetry, map: Map, from: u32, to: u32, reach: f64) -> Option<Pair> {
    let (facet, other) = (&facets.all[from as usize], &facets.all[to as usize]);
    let normal = symmetry.carry(map, facet.normal);
    if normal.dot(other.normal) < MIN_COSINE {
        return None;
    }
    let height = other.height(symmetry.apply(map, facet.point));
    if height.slip >= reach || height.value.abs() >= MAX_DISTANCE * reach {
        return None;
    }
    let by_from = Facet::own() * normal.dot(height.normal);
    let derivatives = symmetry.derivatives(map, facet.point);
    Some(Pair {
        from,
        to,
        residual: height.value,
        by_symmetry: SVector::from_fn(|k, _| height.normal.dot(derivatives[k])),
        instrument: SVector::from_fn(|k, _| normal.dot(derivatives[k])),
        variance: facet.variance(&by_from) + other.variance(&height.by_coefficients),
        by_from,
        by_to: height.by_coefficients,
        weight: (1.0 - (height.slip / reach).powi(2)).powi(2),
    })
}

fn distance2(a: DVec3, b: DVec3) -> f64 {
    let d = a - b;
    d.length_squared()
}
