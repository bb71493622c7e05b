use super::position_sums::{PART, PARTS};
use super::*;
use crate::hierarchy::{Hierarchy, Shape};
use crate::surface::leaf_weights;
use crate::system::SurfaceSystem;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

fn readings(n: usize, extent: [f64; 2], seed: u64) -> (Vec<[f64; 2]>, Vec<DVec3>, Vec<f64>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let at: Vec<[f64; 2]> =
        (0..n).map(|_| [random.random::<f64>() * extent[0], random.random::<f64>() * extent[1]]).collect();
    let z = at.iter().map(|&[u, v]| DVec3::new(u, v + 0.1 * u, random.random::<f64>())).collect();
    let w = (0..n).map(|_| 0.5 + random.random::<f64>()).collect();
    (at, z, w)
}

/// Information from the weights of each reading.
fn by_weights(local: &[[f64; 2]], z: &[DVec3], w: &[f64]) -> ([[f64; 16]; 16], [[f64; 3]; 16]) {
    let (mut matrix, mut vector) = ([[0.0; 16]; 16], [[0.0; 3]; 16]);
    for ((x, z), w) in local.iter().zip(z).zip(w) {
        let b = leaf_weights(x[0], x[1]);
        for k in 0..16 {
            for l in 0..16 {
                matrix[k][l] += w * b[k] * b[l];
            }
            for d in 0..3 {
                vector[k][d] += w * b[k] * z[d];
            }
        }
    }
    (matrix, vector)
}

fn assert_same(
    found: &([[f64; 16]; 16], [[f64; 3]; 16]),
    wanted: &([[f64; 16]; 16], [[f64; 3]; 16]),
    scale: f64,
) {
    for k in 0..16 {
        for l in 0..16 {
            assert!((found.0[k][l] - wanted.0[k][l]).abs() < 1e-14 * scale, "entry {k}, {l}");
        }
        for d in 0..3 {
            assert!((found.1[k][d] - wanted.1[k][d]).abs() < 1e-14 * scale, "vector {k}, {d}");
        }
    }
}

/// Moments must be lossless, or every fit with known parameters would be wrong.
#[test]
fn moments_of_one_cell_give_the_information_of_its_weights() {
    let (at, z, w) = readings(500, [1.0, 1.0], 1);
    let mut cell = CellMoments::default();
    for ((&x, &z), &w) in at.iter().zip(&z).zip(&w) {
        cell.add(x, z, w);
    }
    assert_same(&cell.information(), &by_weights(&at, &z, &w), 500.0);
}

/// Compares the fast path, with sorting, SIMD and threads, to the direct one.
#[test]
fn the_stream_equals_the_direct_path_on_every_leaf() {
    for shape in [Shape::Sheet, Shape::Tube, Shape::Ball, Shape::Torus] {
        let uniform = Hierarchy::uniform(shape, [6, 5]).unwrap();
        let marked: Vec<usize> =
            [(2.5, 2.5), (3.5, 2.5), (2.5, 3.5), (3.5, 3.5)].map(|(u, v)| uniform.locate(u, v).0).to_vec();
        let space = Arc::new(uniform.refine(&marked));
        let (at, z, w) = readings(PART * PARTS + 3 * PART + 17, space.extent(), 2);
        let mut sums = PositionSums::new(&space);
        sums.add(&at, &z, Some(&w)).unwrap();
        let mut plain = vec![CellMoments::default(); space.leaves().len()];
        for ((&[u, v], z), &w) in at.iter().zip(&z).zip(&w) {
            let (leaf, local) = space.locate(u, v);
            plain[leaf].add(local, DVec3::from_array(std::array::from_fn(|d| z[d] - sums.origin()[d])), w);
        }
        for (cell, plain) in sums.cells.iter().zip(&plain) {
            assert_eq!(cell.count(), plain.count());
            assert_same(&cell.information(), &plain.information(), plain.count() as f64);
        }
        let squares: f64 = plain.iter().map(|cell| cell.squares[2]).sum();
        assert!((sums.squares()[2] - squares).abs() < 1e-12 * squares);
    }
}

#[test]
fn sums_do_not_depend_on_threads_or_pieces() {
    let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [20, 30]).unwrap());
    let (at, z, _) = readings(2 * PART * PARTS + 5, space.extent(), 3);
    let summed = |threads: usize, pieces: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut sums = PositionSums::new(&space);
        pool.install(|| {
            for (at, z) in at.chunks(pieces).zip(z.chunks(pieces)) {
                sums.add(at, z, None).unwrap();
            }
        });
        sums.cells
    };
    let alone = summed(1, usize::MAX);
    assert!(alone == summed(3, usize::MAX) && alone == summed(2, PART * PARTS));
}

#[test]
fn sums_of_two_sessions_with_different_origins_add() {
    let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4]).unwrap());
    let system = SurfaceSystem::new(&space).unwrap();
    let (at, z, w) = readings(1000, space.extent(), 4);
    let mut all = PositionSums::new(&space);
    all.add(&at, &z, Some(&w)).unwrap();
    let mut merged = PositionSums::new(&space);
    merged.add(&at[..400], &z[..400], Some(&w[..400])).unwrap();
    let mut other = PositionSums::new(&space);
    other.add(&at[400..], &z[400..], Some(&w[400..])).unwrap();
    merged.merge(&other, 1.0).unwrap();
    assert_eq!(merged.count(), 1000);
    let (a, b) = (all.information(&system).unwrap(), merged.information(&system).unwrap());
    for (a, b) in a.values().iter().zip(b.values()).chain(a.vector().iter().zip(b.vector())) {
        assert!((a - b).abs() < 1e-11);
    }
    for d in 0..3 {
        assert!((all.squares()[d] - merged.squares()[d]).abs() < 1e-9);
    }
}

#[test]
fn messages_name_the_invalid_reading() {
    let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4]).unwrap());
    let mut sums = PositionSums::new(&space);
    sums.add(&[[1.0, 1.0]], &[DVec3::ZERO], None).unwrap();
    for (at, z, w, words) in [
        ([4.1, 0.0], DVec3::ZERO, 1.0, "reading 0: expected parameters in [0, 4] × [0, 4], found (4.1, 0)"),
        ([f64::NAN, 0.0], DVec3::ZERO, 1.0, "found (NaN, 0)"),
        ([0.0, 0.0], DVec3::new(0.0, f64::INFINITY, 0.0), 1.0, "reading 0: expected finite coordinates"),
        ([0.0, 0.0], DVec3::ZERO, -1.0, "not negative, found -1"),
    ] {
        let message = sums.add(&[at], &[z], Some(&[w])).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    assert!(sums.add(&[[0.0; 2]], &[], None).unwrap_err().to_string().contains("1 parameters, 0 positions"));
}

/// The metric of a sheet and the choice of exact coordinates depend on this map.
#[test]
fn the_affine_map_of_the_readings_is_found_for_any_cells() {
    let uniform = Hierarchy::uniform(Shape::Sheet, [6, 5]).unwrap();
    let marked: Vec<usize> =
        [(2.5, 2.5), (3.5, 2.5), (2.5, 3.5), (3.5, 3.5)].map(|(u, v)| uniform.locate(u, v).0).to_vec();
    let space = Arc::new(uniform.refine(&marked));
    let (at, mut z, w) = readings(5000, space.extent(), 5);
    let mut sums = PositionSums::new(&space);
    for (z, [u, v]) in z.iter_mut().zip(&at) {
        *z = DVec3::new(1e3 + 2.0 * u, 3.0 - u + 0.5 * v, u * v);
    }
    sums.add(&at, &z, Some(&w)).unwrap();
    let affine = sums.affine().unwrap();
    for (d, wanted) in [[1e3, 2.0, 0.0], [3.0, -1.0, 0.5]].into_iter().enumerate() {
        for k in 0..3 {
            assert!((affine.map[k][d] - wanted[k]).abs() < 1e-9, "{affine:?}");
        }
        assert!(affine.unexplained_share[d].abs() < 1e-12);
    }
    assert!(affine.unexplained_share[2] > 0.01);
    let mut line = PositionSums::new(&space);
    line.add(&[[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]], &[DVec3::ZERO; 3], None).unwrap();
    assert_eq!(line.affine(), None);
}

#[test]
fn coarser_cells_have_the_sums_of_their_positions() {
    let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [7, 4]).unwrap());
    let (parameters, positions, weights) = readings(3_000, [7.0, 4.0], 11);
    let mut sums = PositionSums::new(&space);
    sums.add(&parameters, &positions, Some(&weights)).unwrap();
    let coarse = sums.coarsened().unwrap();
    assert_eq!(coarse.space().base(), [4, 2]);
    let mut wanted = PositionSums::new(coarse.space());
    let halves: Vec<[f64; 2]> = parameters.iter().map(|p| p.map(|x| 0.5 * x)).collect();
    wanted.add(&halves, &positions, Some(&weights)).unwrap();
    assert_eq!(coarse.count(), wanted.count());
    for (found, wanted) in coarse.cells.iter().zip(&wanted.cells) {
        assert_eq!(found.count(), wanted.count());
        assert_same(&found.information(), &wanted.information(), found.gram[0][0]);
    }
    let tube = Arc::new(Hierarchy::uniform(Shape::Tube, [6, 4]).unwrap());
    assert!(PositionSums::new(&tube).coarsened().is_err());
}
