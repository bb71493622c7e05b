//! Tests of domains, and laws of the weights around an extraordinary vertex.

use super::test_meshes::{grid, two_holes, voxels};
use super::*;
use crate::surface::leaf_weights as basis_weights;
use planish_core::DVec3;

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
fn creases_that_are_not_possible_are_named() {
    let message = |quads: &[[u32; 4]], creases: &[[u32; 2]], corners: &[u32]| {
        QuadDomain::with_creases(quads, creases, corners).unwrap_err().to_string()
    };
    let (sheet, torus) = (grid(4, 4, false), grid(6, 6, true));
    assert!(message(&sheet, &[[6, 12]], &[]).contains("from vertex 6 to 12 is no edge of a quad"));
    assert!(message(&sheet, &[[6, 99]], &[]).contains("from vertex 6 to 99 is no edge of a quad"));
    // Vertices from 25 on lie beyond the border.
    assert!(message(&sheet, &[[1, 26]], &[]).contains("is no edge of a quad"));
    assert!(message(&sheet, &[[1, 2]], &[]).contains("from vertex 1 to 2 lies on a border"));
    assert!(message(&torus, &[[7, 8]], &[7]).contains("corner at vertex 7 has not two creases"));
    assert!(message(&torus, &[[7, 8]], &[20]).contains("corner at vertex 20 has not two creases"));
    assert!(message(&torus, &[[6, 7], [7, 8]], &[7]).contains("vertex 7 has as many quads on both sides"));
    // Two vertices at which the same quad has no uniform spline: both ends of a crease.
    let short = QuadDomain::with_creases(&torus, &[[7, 8]], &[]).unwrap();
    let error = short.check_spline().unwrap_err().to_string();
    assert!(error.contains("vertices 8 and 7") && error.contains("divide the domain once"), "{error}");
    assert!(short.divided().unwrap().domain.check_spline().is_ok());
    // Given in any order, and twice.
    let domain = QuadDomain::with_creases(&torus, &[[8, 7], [7, 8], [9, 8]], &[]).unwrap();
    assert_eq!(domain.creases(), [[7, 8], [8, 9]]);
    assert!(domain.is_crease([9, 8]) && !domain.is_crease([9, 10]));
}

#[test]
fn weights_sum_to_one_and_are_hardly_negative() {
    for valence in [3, 5, 6, 7, 8, 12] {
        let shape = extraordinary::FanShape { quads: valence, kind: extraordinary::FanKind::Smooth };
        let leaves = &extraordinary::leaf_weights(shape)[0];
        // The basis functions at a grid of places on each leaf.
        let mut least = f64::INFINITY;
        for leaf in leaves.iter() {
            for at in 0..25 {
                let values = basis_weights(f64::from(at % 5) / 4.0, f64::from(at / 5) / 4.0);
                let of = |w: &[f64; 16]| w.iter().zip(values).map(|(w, b)| w * b).sum::<f64>();
                let functions: Vec<f64> = leaf.iter().map(of).collect();
                assert!((functions.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                least = functions.into_iter().fold(least, f64::min);
            }
        }
        assert!(least > -1.5e-3, "valence {valence}: {least}");
    }
}

/// Fans between creases, and at ends of creases: weights, and the Jacobian over a flat fan.
#[test]
fn fans_at_creases_do_not_fold() {
    use extraordinary::{FanKind, FanShape, PLACES};
    let shape = |kind, quads| FanShape { quads, kind };
    let fans =
        [(FanKind::Dart, 3..9), (FanKind::Through, 3..7), (FanKind::Convex, 2..5), (FanKind::Concave, 2..8)];
    for (kind, quads) in fans.into_iter().flat_map(|(kind, counts)| counts.map(move |n| (kind, n))) {
        let fan = shape(kind, quads);
        let angle = match kind {
            FanKind::Through => 0.5,
            FanKind::Convex => 1.0 / 3.0,
            FanKind::Concave => 0.75,
            _ => 1.0,
        } * std::f64::consts::TAU
            / quads as f64;
        let along = |k: usize| DVec3::new((k as f64 * angle).cos(), (k as f64 * angle).sin(), 0.0);
        let mut flat = vec![DVec3::ZERO];
        for k in 0..quads {
            flat.extend(PLACES.map(|[s, t]| f64::from(s) * along(k) + f64::from(t) * along(k + 1)));
        }
        if fan.is_open() {
            flat.extend([along(quads), 2.0 * along(quads)]);
        }
        if kind == FanKind::Through {
            flat.extend([along(0), along(quads)]);
        }
        let [mut least, mut low, mut high] = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for leaf in extraordinary::leaf_weights(fan).iter().flatten() {
            assert_eq!(leaf.len(), flat.len());
            let c: [DVec3; 16] =
                std::array::from_fn(|k| leaf.iter().zip(&flat).map(|(w, &p)| w[k] * p).sum());
            for at in 0..25 {
                let [s, t] = [at % 5, at / 5].map(|x| f64::from(x) / 4.0);
                let values = basis_weights(s, t);
                for w in leaf {
                    least = least.min(w.iter().zip(values).map(|(w, b)| w * b).sum());
                }
                let jet = crate::surface::jet_of(&c, 4.0, s, t);
                let jacobian = jet.du.cross(jet.dv).z / angle.sin().max(0.2);
                [low, high] = [low.min(jacobian), high.max(jacobian)];
            }
        }
        println!("{kind:?} {quads}: least weight {least:.1e}, Jacobian {low:.2} to {high:.2}");
        // At a concave corner, an edge inside of the fan has the direction opposite to that of a crease.
        let bound = if kind == FanKind::Concave { 0.05 } else { 0.012 };
        assert!(least > -bound, "{kind:?} {quads}: {least}");
        assert!(low > 0.35 && high < 1.6, "{kind:?} {quads}: {low} to {high}");
    }
}
