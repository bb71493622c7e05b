use super::*;

#[test]
fn sphere_has_gaussian_curvature_one_over_r_squared_everywhere_poles_included() {
    let r = 2.5;
    let sphere = BaseShape::sphere(DVec3::new(1.0, -2.0, 0.5), r, DVec3::new(0.0, 0.6, 0.8))
        .surface([64, 32])
        .unwrap();
    let mut worst = 0.0_f64;
    for b in 0..=64 {
        for a in 0..32 {
            let curvature = sphere.curvature(2.0 * a as f64 + 0.3, b as f64 / 2.0).unwrap();
            worst = worst.max((curvature.gaussian() * r * r - 1.0).abs());
            assert!((curvature.mean() * r + 1.0).abs() < 0.02, "outward normals make H = −1/r, at row {b}");
        }
    }
    assert!(worst < 0.02, "the error of K r² is {worst}");
}

#[test]
fn parameters_undo_points() {
    for base in [
        BaseShape::plane(DVec3::new(1.0, 2.0, 3.0), [DVec3::Y, DVec3::Z], [2.0, 1.0]),
        BaseShape::cylinder(DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.0, 0.6, 0.8), 2.0, 3.0),
        BaseShape::sphere(DVec3::new(1.0, 2.0, 3.0), 2.0, DVec3::new(0.6, 0.0, 0.8)),
        BaseShape::torus(DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.6, 0.0, 0.8), 3.0, 1.0),
    ] {
        for (u, v) in [(0.1, 0.2), (0.9, 0.7), (0.5, 0.5)] {
            let back = base.parameters(base.point(u, v));
            assert!((back[0] - u).abs() < 1e-12 && (back[1] - v).abs() < 1e-12, "{:?}", base.shape);
        }
    }
}
