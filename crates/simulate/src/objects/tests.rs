use super::*;
use planish_estimate::ErrorKind;
use planish_mesh::MeshSearch;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIZE: f64 = 100.0;

fn objects() -> Vec<SolidObject> {
    [
        ObjectKind::Handles { genus: 1 },
        ObjectKind::Handles { genus: 2 },
        ObjectKind::Handles { genus: 16 },
        ObjectKind::Plate { holes: 1 },
        ObjectKind::Plate { holes: 3 },
        ObjectKind::Plate { holes: 8 },
        ObjectKind::Cup { wall: None },
        ObjectKind::Cup { wall: Some(3.0) },
        ObjectKind::Cup { wall: Some(10.0) },
        ObjectKind::Bracket { fillet: None },
        ObjectKind::Bracket { fillet: Some(0.5) },
        ObjectKind::Bracket { fillet: Some(20.0) },
    ]
    .map(|kind| SolidObject::new(kind, SIZE).unwrap())
    .to_vec()
}

fn random_point(bounds: &BoundingBox, rng: &mut ChaCha8Rng) -> DVec3 {
    let share = DVec3::new(rng.random(), rng.random(), rng.random());
    bounds.center() + 1.3 * bounds.extent() * (share - 0.5)
}

#[test]
fn meshes_are_watertight_face_outwards_and_have_the_genus() {
    for object in objects() {
        let truth = object.mesh().unwrap();
        let check = truth.mesh.check();
        assert!(check.watertight && check.manifold && check.oriented, "{object:?} {check:?}");
        assert_eq!(check.components, 1, "{object:?}");
        assert_eq!(check.euler_characteristic, 2 - 2 * object.genus() as i64, "{object:?}");
        assert!(truth.mesh.signed_volume().unwrap() > 0.0);
        let triangles = truth.mesh.triangles.len();
        assert!((30_000..700_000).contains(&triangles), "{object:?} {triangles}");
        // The rim of a thin cup is the roundest part.
        let chords = if object.name() == "cup" { 1.5e-3 } else { 2.5e-4 };
        assert!(truth.chord_error < chords * SIZE, "{object:?} {}", truth.chord_error);
        assert!(truth.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-9));
    }
}

#[test]
fn vertices_lie_on_the_surface_and_the_box_contains_it() {
    for object in objects() {
        let truth = object.mesh().unwrap();
        let bounds = object.bounds();
        for &p in &truth.mesh.positions {
            assert!(object.value(p).abs() < 1e-5, "{object:?} {p} {}", object.value(p));
            assert!(p.cmpge(bounds.min - 1e-6).all() && p.cmple(bounds.max + 1e-6).all(), "{object:?} {p}");
        }
    }
}

#[test]
fn the_function_is_a_lower_bound_of_the_distance_with_the_right_sign() {
    for object in objects() {
        let truth = object.mesh().unwrap();
        let search = MeshSearch::try_new(&truth.mesh).unwrap();
        let bounds = object.bounds();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..2_000 {
            let [p, q] = [0; 2].map(|_| random_point(&bounds, &mut rng));
            let [a, b] = [p, q].map(|p| object.value(p));
            assert!((a - b).abs() <= p.distance(q) * (1.0 + 1e-12), "{object:?} {p} {q}");
            let distance = search.closest(p).unwrap().signed_distance;
            // The centre of a triangle is nearer to the surface than the middle of its longest side.
            let slack = 1.2 * truth.chord_error + 1e-9;
            assert!(a.abs() <= distance.abs() + slack, "{object:?} {p} {a} {distance}");
            assert!(
                distance.abs() < slack || a.signum() == distance.signum(),
                "{object:?} {p} {a} {distance}"
            );
        }
    }
}

#[test]
fn rays_meet_the_surface_where_they_meet_its_mesh() {
    for object in objects() {
        let truth = object.mesh().unwrap();
        let search = MeshSearch::try_new(&truth.mesh).unwrap();
        let bounds = object.bounds();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut hits, mut different) = (0, 0);
        for _ in 0..2_000 {
            let target = random_point(&bounds, &mut rng);
            let away = random_point(&bounds, &mut rng) - bounds.center();
            let origin = bounds.center() + 4.0 * SIZE * away.try_normalize().unwrap();
            let direction = (target - origin).try_normalize().unwrap();
            match (object.first_point(origin, direction), search.first_hit(origin, direction)) {
                (Some(exact), Some(hit)) => {
                    hits += 1;
                    assert!(object.value(exact.position).abs() < 1e-7);
                    // A grazing ray can pass the mesh by the chord error and meet another part.
                    different += usize::from(exact.position.distance(hit.point) > 0.1);
                }
                (None, None) => {}
                _ => different += 1,
            }
        }
        assert!(hits > 150 && 50 * different <= hits, "{object:?} {hits} {different}");
    }
}

/// The features are exact: circles of holes, lines of a box, and the arc of a fillet.
#[test]
fn sharp_edges_are_those_of_the_object() {
    let plate = SolidObject::new(ObjectKind::Plate { holes: 3 }, SIZE).unwrap();
    let truth = plate.mesh().unwrap();
    let radii: Vec<f64> = plate.holes().iter().map(|hole| hole.radius).collect();
    assert!((radii[1] / radii[0] - 0.75).abs() < 1e-12 && radii[0] == radii[2]);
    let bracket = SolidObject::new(ObjectKind::Bracket { fillet: Some(5.0) }, SIZE).unwrap();
    let count = |edges: &[TrueEdge], is_line: bool| {
        edges.iter().filter(|edge| matches!(edge, TrueEdge::Line { .. }) == is_line).count()
    };
    assert_eq!([count(&truth.edges, true), count(&truth.edges, false)], [12, 6]);
    // 6 straight edges at either end and 5 along; the arcs of the fillet and two circles of each hole.
    let edges = bracket.mesh().unwrap().edges;
    assert_eq!([count(&edges, true), count(&edges, false)], [17, 8]);
    assert_eq!(bracket.fillets()[0].radius, 5.0);
    // The volume of a plate: block less cylinders, up to the chords of the circles.
    let area: f64 = radii.iter().map(|r| std::f64::consts::PI * r * r).sum();
    let volume = 10.0 * (6_000.0 - area);
    assert!((truth.mesh.signed_volume().unwrap() / volume - 1.0).abs() < 1e-3);
}

#[test]
fn sizes_out_of_range_are_rejected() {
    for kind in [
        ObjectKind::Handles { genus: 0 },
        ObjectKind::Handles { genus: 17 },
        ObjectKind::Plate { holes: 0 },
        ObjectKind::Plate { holes: 9 },
        ObjectKind::Cup { wall: Some(2.9) },
        ObjectKind::Cup { wall: Some(f64::NAN) },
        ObjectKind::Bracket { fillet: Some(0.0) },
        ObjectKind::Bracket { fillet: Some(21.0) },
    ] {
        assert_eq!(SolidObject::new(kind, SIZE).unwrap_err().kind(), ErrorKind::Input, "{kind:?}");
    }
    assert!(SolidObject::new(ObjectKind::Cup { wall: None }, -1.0).is_err());
}
