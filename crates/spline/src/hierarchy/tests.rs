use super::*;
use crate::Surface;

/// A repeatable value in [0, 1).
fn hash01(n: u64) -> f64 {
    let mut x = n.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03;
    x ^= x >> 29;
    x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x ^= x >> 32;
    (x >> 11) as f64 / (1_u64 << 53) as f64
}

fn refined(shape: Shape, seed: u64) -> Hierarchy {
    let mut hierarchy = Hierarchy::uniform(shape, [8, 6]).unwrap();
    for round in 0..3 {
        let supports = hierarchy.support_leaves();
        let mut marked: Vec<usize> = Vec::new();
        for (node, leaves) in supports.iter().enumerate() {
            if hash01(seed + 1000 * round + node as u64) < 0.06 {
                marked.extend(leaves.iter().map(|&l| l as usize));
            }
        }
        hierarchy = hierarchy.refine(&marked);
    }
    hierarchy
}

const SHAPES: [Shape; 4] = [Shape::Sheet, Shape::Tube, Shape::Ball, Shape::Torus];

fn some_vertices(n: usize) -> Vec<DVec3> {
    (0..n).map(|i| DVec3::from_array([0, 1, 2].map(|d| hash01((3 * i + d) as u64 + 77)))).collect()
}

#[test]
fn partition_of_unity_holds_on_every_leaf_of_every_shape() {
    for shape in SHAPES {
        for seed in 0..4 {
            let hierarchy = refined(shape, seed);
            assert!(hierarchy.levels() > 1, "{shape:?}: nothing was refined");
            hierarchy.sanity_check().unwrap();
        }
    }
}

#[test]
fn spaces_are_nested_and_refinement_is_exact() {
    for shape in SHAPES {
        let coarse = refined(shape, 5);
        let surface = Surface::new(coarse.clone().into(), some_vertices(coarse.node_count())).unwrap();
        let some: Vec<usize> = (0..coarse.leaves().len()).filter(|&l| hash01(l as u64 + 9) < 0.2).collect();
        for fine in [coarse.refine(&some), coarse.refine_all()] {
            let carried = surface.refined(fine.into()).unwrap();
            for n in 0..2000_u64 {
                let (u, v) = (hash01(2 * n) * 8.0, hash01(2 * n + 1) * 6.0);
                let (a, b) = (surface.point(u, v), carried.point(u, v));
                for d in 0..3 {
                    assert!((a[d] - b[d]).abs() < 1e-12, "{shape:?} at ({u}, {v}): {a:?} {b:?}");
                }
            }
        }
    }
}

#[test]
fn surfaces_are_twice_continuously_differentiable_across_levels() {
    for shape in SHAPES {
        let hierarchy = refined(shape, 3);
        let surface = Surface::new(hierarchy.clone().into(), some_vertices(hierarchy.node_count())).unwrap();
        let h = 1e-9;
        for &cell in hierarchy.leaves() {
            let (u, v) = (f64::from(cell.i) * cell.side(), (f64::from(cell.j) + 0.37) * cell.side());
            if u == 0.0 && !shape.periodic_u() {
                continue;
            }
            let (a, b) = (surface.jet(u - h, v), surface.jet(u + h, v));
            for (x, y) in [
                (a.point, b.point),
                (a.du, b.du),
                (a.dv, b.dv),
                (a.duu, b.duu),
                (a.duv, b.duv),
                (a.dvv, b.dvv),
            ] {
                for d in 0..3 {
                    assert!((x[d] - y[d]).abs() < 1e-4, "{shape:?} {cell:?}: {x:?} {y:?}");
                }
            }
        }
    }
}

#[test]
fn ball_has_one_point_and_one_tangent_plane_at_each_pole() {
    let hierarchy = refined(Shape::Ball, 2);
    let surface = Surface::new(hierarchy.clone().into(), some_vertices(hierarchy.node_count())).unwrap();
    for v in [0.0, 6.0] {
        let first = surface.jet(0.0, v);
        let second = surface.jet(2.0, v);
        let normal = first.dv.cross(second.dv);
        for n in 0..40 {
            let jet = surface.jet(8.0 * n as f64 / 40.0, v);
            for d in 0..3 {
                assert!((jet.point[d] - first.point[d]).abs() < 1e-12);
                assert!(jet.du[d].abs() < 1e-11);
            }
            let out_of_plane = jet.dv.dot(normal);
            assert!(out_of_plane.abs() < 1e-12, "derivative leaves the tangent plane by {out_of_plane}");
        }
    }
}

#[test]
fn only_a_completely_split_support_activates_a_function() {
    let uniform = Hierarchy::uniform(Shape::Sheet, [8, 8]).unwrap();
    let (middle, _) = uniform.locate(4.5, 4.5);
    assert_eq!(uniform.refine(&[middle]).node_count(), uniform.node_count());
    let block: Vec<usize> =
        [(4.5, 4.5), (3.5, 4.5), (4.5, 3.5), (3.5, 3.5)].map(|(u, v)| uniform.locate(u, v).0).to_vec();
    assert_eq!(uniform.refine(&block).node_count(), uniform.node_count() + 1);
}

#[test]
fn neighbouring_leaves_differ_by_at_most_one_level() {
    for shape in SHAPES {
        let hierarchy = refined(shape, 11);
        for (leaf, &cell) in hierarchy.leaves().iter().enumerate() {
            for (du, dv) in [(-0.5, 0.5), (1.5, 0.5), (0.5, -0.5), (0.5, 1.5)] {
                let [u, v] = hierarchy.parameters(leaf, [du, dv]);
                let (other, _) = hierarchy.locate(u, v);
                let other = hierarchy.leaves()[other];
                assert!(cell.level.abs_diff(other.level) <= 1, "{cell:?} {other:?}");
            }
        }
    }
}

#[test]
fn hierarchy_is_rebuilt_from_its_leaves() {
    for shape in SHAPES {
        let hierarchy = refined(shape, 8);
        let mut shuffled = hierarchy.leaves().to_vec();
        shuffled.reverse();
        let again = Hierarchy::from_leaves(shape, [8, 6], &shuffled).unwrap();
        assert_eq!(again.leaves(), hierarchy.leaves());
        assert_eq!(again.node_count(), hierarchy.node_count());
        shuffled.pop();
        assert!(Hierarchy::from_leaves(shape, [8, 6], &shuffled).is_err());
    }
}
