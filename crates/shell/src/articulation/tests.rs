use super::*;
use planish_mesh::cylinder;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A cross with arms of different lengths on a column: no rotation maps it to itself.
fn body() -> TriangleMesh {
    let mut mesh = cylinder(1.0, 20.0, 24, 60, true);
    for p in &mut mesh.positions {
        // Fins along the column, and one at its upper end.
        let angle = p[1].atan2(p[0]);
        let fins =
            1.0 + 1.2 * (angle - 0.3).cos().max(0.0).powi(8) + 0.7 * (angle - 2.6).cos().max(0.0).powi(8);
        *p = DVec3::new(fins * p[0], fins * p[1], p[2]);
    }
    mesh
}

/// The mesh with the part above a height turned about an axis, blended over a joint.
fn turned(mesh: &TriangleMesh, axis: Vector3<f64>, angle: f64) -> TriangleMesh {
    let (low, high) =
        (mesh.positions.iter()).fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[2]), b.max(p[2])));
    let middle = 0.5 * (low + high);
    let motion =
        PartRotation { pivot: DVec3::new(0.0, 0.0, middle), turn: angle.to_radians() * axis.normalize() };
    let positions = (mesh.positions.iter())
        .map(|p| motion.applied(*p, DVec3::Z, ((p[2] - middle) / 4.0 + 0.5).clamp(0.0, 1.0)).0)
        .collect();
    TriangleMesh { positions, triangles: mesh.triangles.clone() }
}

fn points_on(mesh: &TriangleMesh, random: &mut ChaCha8Rng) -> Vec<DVec3> {
    let mut uniform = ChaCha8Rng::seed_from_u64(11);
    let samples = planish_mesh::sample_points(mesh, 4000, || uniform.random_range(0.0..1.0)).unwrap();
    let mut number = || -> f64 { StandardNormal.sample(random) };
    samples.iter().map(|s| s.position + 0.01 * DVec3::new(number(), number(), number())).collect()
}

fn rms(a: &[DVec3], b: &[DVec3]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| a.distance_squared(*b)).sum::<f64>() / a.len() as f64).sqrt()
}

/// A half that turned by a right angle, about the long axis or across it, is found with its joint, whose
/// profile is another one here.
#[test]
fn turned_halves_are_found() {
    let mesh = body();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for axis in [Vector3::new(0.1, -0.2, 1.0), Vector3::new(1.0, 0.3, 0.1)] {
        let truth = turned(&mesh, axis, 85.0);
        let found = far_pose(&mesh, &points_on(&truth, &mut random)).unwrap().expect("a pose");
        let [before, after] = [&mesh.positions, &found].map(|p| rms(p, &truth.positions));
        assert!(after < 0.05 * before, "{axis:?}: {after} of {before}");
    }
}

/// A whole object that turned is found. Objects at rest have no other pose, and too few points none at all.
#[test]
fn whole_objects_turn_and_others_stay() {
    let mesh = body();
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let motion = PartRotation { pivot: DVec3::ZERO, turn: Vector3::new(1.1, -0.9, 0.4) };
    let truth = TriangleMesh {
        positions: mesh.positions.iter().map(|p| motion.applied(*p, DVec3::Z, 1.0).0).collect(),
        triangles: mesh.triangles.clone(),
    };
    let found = far_pose(&mesh, &points_on(&truth, &mut random)).unwrap().expect("a pose");
    assert!(rms(&found, &truth.positions) < 0.5, "{}", rms(&found, &truth.positions));
    assert!(far_pose(&mesh, &points_on(&mesh, &mut random)).unwrap().is_none());
    assert!(far_pose(&mesh, &mesh.positions[..5]).unwrap().is_none());
}

/// A joint moves positions of weight 1 as its part and those of weight 0 as the rest, and shares the motion
/// between them.
#[test]
fn joints_move_parts_as_given() {
    let mesh = body();
    let samples = Samples::new(&mesh).unwrap();
    let parts = Parts::new(&mesh, &samples, 25.0);
    let cut = parts.all[1].cut.unwrap();
    let turn = |by: [f64; 3], pivot| PartRotation { pivot, turn: by.into() }.rigid();
    let rest = turn([0.1, 0.2, -0.1], DVec3::X);
    let part = turn([0.3, -1.2, 0.8], DVec3::new(2.0, -1.0, 4.0));
    let joint = Joint::new(cut, [rest, part], samples.center());
    let at = DVec3::new(3.0, 1.0, -2.0);
    for (weight, motion) in [(0.0, rest), (1.0, part)] {
        let off = joint.applied(at, DVec3::Z, weight).0.distance(motion.applied(at));
        assert!(off < 1e-9, "{weight}: {off}");
    }
    // Two halves of a motion, one after the other, are the motion.
    let still = Joint::new(cut, [motion::RigidMotion::IDENTITY, part], samples.center());
    let half = |p: DVec3| still.applied(p, DVec3::Z, 0.5).0;
    assert!(half(half(at)).distance(part.applied(at)) < 1e-9);
}
