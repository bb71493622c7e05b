use super::*;
use planish_core::vector3::tangents;
use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const SIGMA: f64 = 0.01;
const AXIS: DVec3 = DVec3::new(0.2, -0.3, 0.932_737_905_308_881_5);
const POINT: DVec3 = DVec3::new(5.0, -2.0, 1.0);

/// A cloud over `(h, a)` with `r(h, a)` about an axis, seen from one side if `half_angle` is less than π.
fn cloud(seed: u64, half_angle: f64, radius: impl Fn(f64, f64) -> f64) -> Facets {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let d = AXIS.try_normalize().unwrap();
    let (e1, e2) = tangents(d);
    let at = |h: f64, a: f64| {
        let r = radius(h, a);
        let (sin, cos) = a.sin_cos();
        POINT + h * d + r * (cos * e1 + sin * e2)
    };
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for _ in 0..12_000 {
        let h = 3.0 * (rng.random::<f64>() - 0.5);
        let a = half_angle * (2.0 * rng.random::<f64>() - 1.0);
        let step = 1e-5;
        let along = at(h + step, a) - at(h - step, a);
        let around = at(h, a + step) - at(h, a - step);
        let n = around.cross(along).try_normalize().unwrap();
        let noise = SIGMA * rng.sample::<f64, _>(StandardNormal);
        let p = at(h, a);
        points.push(p + noise * n);
        normals.push(n);
    }
    Facets::new(&points, &normals, &vec![SIGMA * SIGMA; points.len()], true).unwrap()
}

fn vase(h: f64, _: f64) -> f64 {
    1.0 + 0.3 * (2.0 * h).sin() + 0.1 * h
}

/// The deviation of an estimate in its parameters: shifts, tilts.
fn axis_errors(found: &FittedSymmetry) -> [f64; 4] {
    let Symmetry::Rotation { point, direction, .. } = found.symmetry else {
        panic!("no rotation");
    };
    let mut d = AXIS.try_normalize().unwrap();
    if d.dot(direction) < 0.0 {
        d = -d;
    }
    let (e1, e2) = tangents(direction);
    // The point of the true axis nearest to the estimated point.
    let along = (point - POINT).dot(direction) / d.dot(direction);
    let nearest = POINT + along * d;
    let off = nearest - point;
    [off.dot(e1), off.dot(e2), d.dot(e1), d.dot(e2)]
}

#[test]
fn axis_of_a_vase_seen_from_one_side_lies_within_its_sigma() {
    let mut nees = 0.0;
    let runs = 6;
    for seed in 0..runs {
        let facets = cloud(seed, 1.1, vase);
        let kind = SymmetryKind::Rotation { order: None, towards: None };
        let found = fit_symmetry(&facets, kind).unwrap();
        assert!(found.supported, "{} of {} agree", found.agreeing, found.compared);
        let e = SVector::from(axis_errors(&found));
        nees += (e.transpose() * found.covariance.try_inverse().unwrap() * e)[(0, 0)] / runs as f64;
        assert!(e.norm() < 0.05, "{e}");
    }
    // The mean of 24 values of χ² with four degrees of freedom: 4 ± 1.15 (two standard errors).
    assert!((1.0..8.0).contains(&nees), "{nees}");
}

#[test]
fn plane_of_a_mirrored_shape_lies_within_its_sigma() {
    let mut nees = 0.0;
    let runs = 10;
    for seed in 0..runs {
        // Even in the angle: the mirror plane contains the axis and e1.
        let shape =
            |h: f64, a: f64| vase(h, a) + 0.2 * (a.cos() * (1.5 * h).cos()) + 0.1 * (2.0 * a).cos() * h;
        let facets = cloud(seed, 2.0, shape);
        let found = fit_symmetry(&facets, SymmetryKind::Mirror { towards: None }).unwrap();
        assert!(found.supported, "{} of {} agree", found.agreeing, found.compared);
        let (_, e2) = tangents(AXIS.try_normalize().unwrap());
        let Symmetry::Mirror { point, normal } = found.symmetry else {
            panic!("no mirror");
        };
        let m = if e2.dot(normal) < 0.0 { e2.map(|c| -c) } else { e2 };
        let (t1, t2) = tangents(normal);
        let shift = (POINT - point).dot(m) / m.dot(normal);
        let e = nalgebra::Vector3::new(shift, m.dot(t1), m.dot(t2));
        let covariance = found.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        nees += (e.transpose() * covariance.try_inverse().unwrap() * e)[(0, 0)] / runs as f64;
        assert!(e.norm() < 0.05, "{e}");
    }
    assert!((1.2..5.4).contains(&nees), "{nees}");
}

#[test]
fn proposed_symmetries_exist_and_a_freeform_surface_has_none() {
    let facets = cloud(1, 1.2, vase);
    let found = propose_symmetry(&facets).unwrap();
    assert!(matches!(found.symmetry, Symmetry::Rotation { order: None, .. }));

    let three = |h: f64, a: f64| 1.5 + 0.1 * (h + 0.4).powi(2) + 0.2 * (3.0 * a + 0.8 * h).cos();
    let found = propose_symmetry(&cloud(2, std::f64::consts::PI, three)).unwrap();
    assert!(matches!(found.symmetry, Symmetry::Rotation { order: Some(3), .. }), "{:?}", found.symmetry);
    assert!(axis_errors(&found).iter().all(|e| e.abs() < 0.02));

    for seed in 3..5 {
        let s = seed as f64;
        let free = |h: f64, a: f64| {
            1.4 + 0.25 * (a + s).cos() * (h + 0.3 * s).sin()
                + 0.15 * (2.0 * a - h + s).sin()
                + 0.1 * (3.0 * a + 2.0 * h).cos()
        };
        let found = propose_symmetry(&cloud(seed, std::f64::consts::PI, free));
        assert!(found.is_none(), "{:?}", found.map(|f| (f.symmetry, f.agreeing, f.compared)));
    }
}

#[test]
fn a_handle_does_not_belong_to_the_revolution() {
    // A bump of a fifth of the radius on one side.
    let handled = |h: f64, a: f64| vase(h, a) + 0.25 * (-(h * h + (a - 0.3).powi(2)) / 0.04).exp();
    let facets = cloud(7, 1.2, handled);
    let kind = SymmetryKind::Rotation { order: None, towards: None };
    let found = fit_symmetry(&facets, kind).unwrap();
    assert!(found.supported);
    let e = axis_errors(&found);
    assert!(e.iter().all(|e| e.abs() < 0.03), "{e:?}");
    // Facets on the bump must not be propagated; most others may.
    let d = AXIS.try_normalize().unwrap();
    let (e1, e2) = tangents(d);
    let (mut on, mut kept_on, mut off, mut kept_off) = (0, 0, 0, 0);
    for (facet, &is_symmetric) in facets.all.iter().zip(&found.is_symmetric) {
        let r = facet.point - POINT;
        let (h, a) = (r.dot(d), r.dot(e2).atan2(r.dot(e1)));
        let height = 0.25 * (-(h * h + (a - 0.3).powi(2)) / 0.04).exp();
        if height > 0.12 {
            on += 1;
            kept_on += usize::from(is_symmetric);
        } else if height < 0.001 {
            off += 1;
            kept_off += usize::from(is_symmetric);
        }
    }
    assert!(on > 0 && kept_on == 0, "{kept_on} of {on}");
    assert!(kept_off * 10 > off * 8, "{kept_off} of {off}");
}
