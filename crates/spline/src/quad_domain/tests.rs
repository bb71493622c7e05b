//! Tests of domains, and laws of the weights around an extraordinary vertex.

use super::test_meshes::{grid, two_holes, voxels};
use super::*;
use crate::surface::leaf_weights;

#[test]
fn components_borders_and_genus_are_counted() {
    let count = |quads: &[[u32; 4]]| {
        let domain = QuadDomain::new(quads).unwrap();
        (domain.components(), domain.borders(), domain.genus())
    };
    assert_eq!(count(&grid(3, 4, false)), (1, 1, 0));
    assert_eq!(count(&grid(4, 5, true)), (1, 0, 1));
    assert_eq!(count(&two_holes().0), (1, 0, 2));
    let (two, _) = voxels(&[[0, 0, 0], [2, 0, 0]]);
    assert_eq!(count(&two), (2, 0, 0));
    // A plate with a hole is an annulus on each side: without its walls there are two, with two borders each.
    let annulus: Vec<_> = grid(3, 3, false).into_iter().enumerate().filter(|(k, _)| *k != 4).collect();
    assert_eq!(count(&annulus.into_iter().map(|(_, quad)| quad).collect::<Vec<_>>()), (1, 2, 0));
}

#[test]
fn defects_are_named() {
    let message = |quads: &[[u32; 4]]| QuadDomain::new(quads).unwrap_err().to_string();
    assert!(message(&[[0, 1, 1, 2]]).contains("quad 0 has corner 1 twice"));
    assert!(message(&[[0, 1, 2, 3], [0, 1, 4, 5]]).contains("quads 0 and 1 both have the edge"));
    assert!(message(&[[0, 1, 2, 4]]).contains("vertex 3 has no quad"));
    assert!(message(&[[0, 1, 2, 3], [2, 4, 5, 6]]).contains("at vertex 2 several fans"));
    let corners = QuadDomain::new(&two_holes().0).unwrap();
    let error = corners.check_spline().unwrap_err().to_string();
    assert!(error.contains("divide the domain once"), "{error}");
}

#[test]
fn weights_sum_to_one_and_are_hardly_negative() {
    for valence in [3, 5, 6, 7, 8, 12] {
        let leaves = extraordinary::leaf_weights_around(valence);
        // The basis functions at a grid of places on each leaf.
        let mut least = f64::INFINITY;
        for leaf in leaves.iter() {
            for at in 0..25 {
                let values = leaf_weights(f64::from(at % 5) / 4.0, f64::from(at / 5) / 4.0);
                let of = |w: &[f64; 16]| w.iter().zip(values).map(|(w, b)| w * b).sum::<f64>();
                let functions: Vec<f64> = leaf.iter().map(of).collect();
                assert!((functions.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                least = functions.into_iter().fold(least, f64::min);
            }
        }
        assert!(least > -1.5e-3, "valence {valence}: {least}");
    }
}
