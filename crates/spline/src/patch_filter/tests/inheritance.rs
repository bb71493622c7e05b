//! What children inherit from a subdivided patch, and what neighbours share.

use super::*;

/// Children of one parent have the same information, so reconciliation must not change them. (Eq. 21 of the
/// paper as printed halves their variance without any new reading.)
#[test]
fn reconciling_inherited_information_has_no_effect() {
    let mut filter = filter_to_depth(1, [4, 4], StateLayout::Isotropic, PRIOR);
    for reading in positions([4, 4], 30, 0.05, 17) {
        filter.observe(&reading).unwrap();
    }
    filter.subdivide(&[filter.patches()[0]]).unwrap();
    let before = filter.state();
    filter.reconcile().unwrap();
    assert_eq!(before, filter.state(), "there is no new reading");

    // As printed: the covariances of the 21 vertices shared by two children, combined as if independent.
    // Patches are ordered by column: the third lies east of the first.
    let [a, b] = [0, 2].map(|p| filter.belief(p).covariance_matrix());
    let shared: Vec<(usize, usize)> =
        (0..7).flat_map(|row| (0..3).map(move |c| (7 * row + 4 + c, 7 * row + c))).collect();
    let shared_block = |m: &DMatrix<f64>, side: usize| {
        let at = |k: usize| if side == 0 { shared[k].0 } else { shared[k].1 };
        DMatrix::from_fn(21, 21, |r, c| m[(at(r), at(c))])
    };
    let (a, b) = (shared_block(&a, 0), shared_block(&b, 1));
    let difference = (&a - &b).amax() / a.amax();
    assert!(difference < 1e-9, "both inherit the same covariance: {difference:e}");
    let printed = &a * (&a + &b).pseudo_inverse(1e-12).unwrap() * &b;
    assert!((printed[(10, 10)] / a[(10, 10)] - 0.5).abs() < 1e-6, "as printed the variance is halved");
}

#[test]
fn children_inherit_the_coarse_projection_and_gain_detail() {
    let mut filter = filter_to_depth(1, [4, 4], StateLayout::Isotropic, PRIOR);
    for reading in positions([4, 4], 60, 0.02, 19) {
        filter.observe(&reading).unwrap();
    }
    let parent = filter.belief(0).covariance_matrix();
    let before = filter.surface().unwrap();
    filter.subdivide(&[filter.patches()[0]]).unwrap();
    let after = filter.surface().unwrap();
    for (p, patch) in filter.patches().iter().enumerate() {
        let alpha = quarter_matrix([patch.i as usize, patch.j as usize]);
        let printed = &alpha * &parent * alpha.transpose();
        let child = filter.belief(p).covariance_matrix();
        let rank = |m: &DMatrix<f64>| {
            let values = m.clone().symmetric_eigen().eigenvalues;
            assert!(values.min() > -1e-10 * values.amax(), "a covariance must be positive semidefinite");
            values.iter().filter(|&&x| x > 1e-10 * values.amax()).count()
        };
        assert_eq!(rank(&printed), 25, "eq. 18 alone has the rank of a quarter of the parent");
        assert_eq!(rank(&child), VERTICES, "with Q all detail is possible");
        let smallest = (child - printed).symmetric_eigen().eigenvalues.min();
        assert!(smallest > -1e-9 * parent.amax(), "Q never reduces a variance: {smallest:e}");
    }
    for k in 0..50 {
        let (u, v) = (0.077 * f64::from(k), 4.0 - 0.08 * f64::from(k));
        let (a, b) = (before.point(u, v), after.point(u, v));
        assert!((0..3).all(|d| (a[d] - b[d]).abs() < 1e-9), "subdivision does not move the surface");
    }
    // The prior of the children is that of the finer space: α Σ_prior αᵀ + Q.
    let global = Global::new(filter.space(), PRIOR).solve();
    let fresh = {
        let mut fresh = filter_to_depth(1, [4, 4], StateLayout::Isotropic, PRIOR);
        fresh.subdivide(&[fresh.patches()[0]]).unwrap();
        fresh
    };
    let (mean, sigma) = differences(&fresh, &global, DVec3::Z);
    assert!(mean < 1e-7 && sigma < 1e-7, "patch and global prior agree: {mean:e} {sigma:e}");
}

/// Adjacent patches of two levels: the prior of every patch is that of the truncated hierarchy, before and
/// after neighbours are subdivided.
#[test]
fn priors_follow_the_hierarchy_when_neighbours_are_subdivided() {
    let mut filter = filter_to_depth(3, [8, 8], StateLayout::Isotropic, PRIOR);
    for patch in [0, 0, 0] {
        filter.subdivide(&[filter.patches()[patch]]).unwrap();
        let global = Global::new(filter.space(), PRIOR).solve();
        let (mean, sigma) = differences(&filter, &global, DVec3::Z);
        assert!(mean < 1e-6 && sigma < 1e-6, "{mean:e} {sigma:e}");
    }
}

#[test]
fn shared_functions_of_neighbours_are_equal_on_any_surface() {
    for (shape, base, marks) in [
        (Shape::Sheet, [8, 8], vec![true, false, false, false]),
        (Shape::Tube, [8, 8], vec![true, false, false, false]),
        (Shape::Torus, [8, 8], vec![false, false, false, true]),
        (Shape::Ball, [8, 12], vec![true, false, false, false, false, false]),
    ] {
        let uniform = Quadtree::new(Arc::new(Hierarchy::uniform(shape, base).unwrap())).unwrap();
        let tree = uniform.subdivided(&marks).unwrap();
        let space = Arc::clone(&tree.space);
        let vertices = (0..space.node_count())
            .map(|i| DVec3::from_array([0, 1, 2].map(|d| ((7 * i + 3 * d) as f64).sin())))
            .collect();
        let surface = Surface::new(space, vertices).unwrap();
        let levels: std::collections::HashSet<u8> = tree.patches.iter().map(|p| p.depth).collect();
        assert!(levels.len() == 2 || shape == Shape::Ball, "{shape:?} has two levels");
        let mut mixed = 0;
        for separator in &tree.separators {
            let coefficients = separator
                .patches
                .map(|p| tree.coefficients(p as usize, |leaf| *surface.leaf_coefficients(leaf)));
            mixed += usize::from(separator.rows[1][0].len() > 1);
            for (a, b) in separator.rows[0].iter().zip(&separator.rows[1]) {
                for d in 0..3 {
                    let value = |row: &[(u16, f64)], c: &[DVec3]| -> f64 {
                        row.iter().map(|&(k, w)| w * c[usize::from(k)][d]).sum()
                    };
                    let difference = value(a, &coefficients[0]) - value(b, &coefficients[1]);
                    assert!(difference.abs() < 1e-10, "{shape:?} {:?}: {difference}", separator.patches);
                }
            }
        }
        assert!(mixed > 0 || shape == Shape::Ball, "{shape:?} has neighbours of two levels");
    }
}

#[test]
fn a_patch_in_a_grid_has_nine_classes_of_vertices() {
    let tree = Quadtree::new(Arc::new(Hierarchy::uniform(Shape::Sheet, [12, 12]).unwrap())).unwrap();
    let mut copies = std::collections::HashMap::new();
    for patch in &tree.patches {
        for k in 0..VERTICES {
            *copies.entry(tree.function(*patch, k)).or_insert(0) += 1;
        }
    }
    let middle = FilterPatch { depth: 0, i: 1, j: 1 };
    let mut classes = std::collections::HashMap::new();
    for k in 0..VERTICES {
        let class = VertexSharing::new(k % 7, k / 7);
        assert_eq!(copies[&tree.function(middle, k)], class.copies(), "vertex {k}");
        *classes.entry((class.west, class.east, class.south, class.north)).or_insert(0) += 1;
    }
    let mut sizes: Vec<i32> = classes.into_values().collect();
    sizes.sort_unstable();
    assert_eq!(sizes, [1, 3, 3, 3, 3, 9, 9, 9, 9]);
    assert!(tree.separators.iter().all(|s| s.rows[0].len() == 21));
}
