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

#[test]
fn shapes_are_recognised_from_their_clouds() {
    let sample = |base: BaseShape, u_range: f64| -> (Vec<DVec3>, Vec<DVec3>) {
        let mut points = Vec::new();
        let mut normals = Vec::new();
        for a in 0..60 {
            for b in 0..30 {
                let (u, v) = (u_range * a as f64 / 60.0, (b as f64 + 0.5) / 30.0);
                let h = 1e-5;
                let p = base.point(u, v);
                let (du, dv) = (base.point(u + h, v) - p, base.point(u, v + h) - p);
                points.push(p);
                normals.push(du.cross(dv).try_normalize().unwrap());
            }
        }
        (points, normals)
    };
    let sheet = BaseShape::plane(DVec3::ZERO, [DVec3::new(0.8, 0.6, 0.0), DVec3::Z], [2.0, 1.0]);
    let tube = BaseShape::cylinder(DVec3::new(5.0, 0.0, 0.0), DVec3::new(0.6, 0.0, 0.8), 1.0, 4.0);
    let ball = BaseShape::sphere(DVec3::ZERO, 1.0, DVec3::Z);
    for (base, range) in [(sheet, 1.0), (tube, 1.0), (ball, 1.0)] {
        let (points, normals) = sample(base, range);
        let found = choose_base_shape(&points, &normals, None).unwrap();
        assert_eq!(found.shape, base.shape);
        if base.shape == Shape::Tube {
            assert!((found.size[0] - 1.0).abs() < 0.01 && found.frame[2].dot(base.frame[2]).abs() > 0.9999);
        }
    }
    // A quarter of a cylinder is a curved sheet.
    let (points, normals) = sample(tube, 0.25);
    assert_eq!(choose_base_shape(&points, &normals, None).unwrap().shape, Shape::Sheet);
}

/// Long ellipsoids have hardly any normals along their axis; truncated cones are open.
#[test]
fn a_body_that_narrows_to_tips_is_no_tube() {
    for (length, closed) in [(2.0, true), (4.0, true), (6.0, true), (6.0, false)] {
        let mut points = Vec::new();
        let mut normals = Vec::new();
        for i in 0..2000 {
            // Even in height and angle, so that the density is that of a cylinder.
            let z = 2.0 * (f64::from(i) + 0.5) / 2000.0 - 1.0;
            let angle = f64::from(i) * std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
            let (radius, slope) = if closed {
                ((1.0 - z * z).sqrt(), -z / (1.0 - z * z).sqrt())
            } else {
                (0.75 - 0.25 * z, -0.25)
            };
            let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
            points.push(radius * out + length * z * DVec3::Z);
            normals.push((out - slope / length * DVec3::Z).normalize());
        }
        let found = choose_base_shape(&points, &normals, None).unwrap();
        assert_eq!(found.shape, if closed { Shape::Ball } else { Shape::Tube }, "{length}");
    }
}

#[test]
fn too_few_or_collinear_points_are_undetermined() {
    use planish_estimate::ErrorKind;
    let line: Vec<DVec3> = (0..50).map(|i| DVec3::new(f64::from(i), 2.0 * f64::from(i), 1.0)).collect();
    for cloud in [&line[..], &line[..3], &[DVec3::ONE; 20][..]] {
        assert_eq!(choose_base_shape(cloud, &[], None).unwrap_err().kind(), ErrorKind::Undetermined);
    }
}
