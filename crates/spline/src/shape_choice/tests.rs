use super::*;

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

/// On rings far apart, normals from neighbours are any that are perpendicular to the ring's tangent.
#[test]
fn open_tubes_are_recognised_without_good_normals() {
    let on_tube = |caps: u32| -> (Vec<DVec3>, Vec<DVec3>) {
        (0..4000_u32)
            .map(|k| {
                let (angle, turn) = (std::f64::consts::TAU * f64::from(k) * 0.618_034, f64::from(k));
                let (radius, height) = if k < caps {
                    (12.0 * (f64::from(k) / f64::from(caps)).sqrt(), 60.0 * f64::from(k % 2))
                } else {
                    (12.0, 4.0 * f64::from(k % 16))
                };
                let outwards = DVec3::new(angle.cos(), angle.sin(), 0.0);
                (radius * outwards + height * DVec3::Z, turn.cos() * outwards + turn.sin() * DVec3::Z)
            })
            .unzip()
    };
    let (points, normals) = on_tube(0);
    let found = choose_base_shape(&points, &normals, None).unwrap();
    assert_eq!(found.shape, Shape::Tube);
    assert!(found.frame[2].z.abs() > 0.999 && (found.size[0] - 12.0).abs() < 0.1, "{found:?}");
    let (points, normals) = on_tube(800);
    assert_eq!(choose_base_shape(&points, &normals, None).unwrap().shape, Shape::Ball, "with caps");
}

#[test]
fn a_ball_is_no_torus() {
    let points: Vec<DVec3> = (0..4000)
        .map(|k| {
            let z = 1.0 - 2.0 * (f64::from(k) + 0.5) / 4000.0;
            let (sin, cos) = (f64::from(k) * 2.399_963).sin_cos();
            DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        })
        .collect();
    let text = choose_base_shape(&points, &[], Some(Shape::Torus)).unwrap_err().to_string();
    assert!(text.contains("hole is empty"), "{text}");
}

#[test]
fn a_gross_error_does_not_thicken_a_torus() {
    let mut points: Vec<DVec3> = (0..3000)
        .map(|k| {
            let [a, b] = [2.399_963, 0.618_034].map(|step| f64::from(k) * step);
            let (sin, cos) = b.sin_cos();
            DVec3::new((20.0 + 6.0 * cos) * a.cos(), (20.0 + 6.0 * cos) * a.sin(), 6.0 * sin)
        })
        .collect();
    points.extend([DVec3::new(1.0, 0.5, 2.0), DVec3::new(60.0, 0.0, 5.0)]);
    let base = choose_base_shape(&points, &[], Some(Shape::Torus)).unwrap();
    assert!((base.size[0] - 20.0).abs() < 0.2 && (base.size[2] - 6.0).abs() < 0.2, "{base:?}");
}
