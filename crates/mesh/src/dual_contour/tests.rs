use super::*;
use crate::search::MeshSearch;
use planish_core::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The union of boxes in different orientations.
struct Boxes(Vec<(Pose, DVec3)>);

impl DistanceField for Boxes {
    fn distance(&self, at: DVec3) -> f64 {
        self.distance_and_gradient(at).0
    }

    fn distance_and_gradient(&self, at: DVec3) -> (f64, DVec3) {
        let of_box = |(pose, half): &(Pose, DVec3)| {
            let rows = pose.rotation.map(DVec3::from_array);
            let local = at - pose.translation;
            let faces = (0..3).flat_map(|k| [1.0, -1.0].map(|side| (side * rows[k], half[k])));
            faces
                .map(|(normal, half)| (normal.dot(local) - half, normal))
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .unwrap()
        };
        self.0.iter().map(of_box).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
    }
}

fn unit_box(half: f64) -> BoundingBox {
    BoundingBox { min: DVec3::splat(-half), max: DVec3::splat(half) }
}

fn random_pose(random: &mut ChaCha8Rng, shift: f64) -> Pose {
    let mut vector = |size: f64| DVec3::from_array([0, 1, 2].map(|_| random.random_range(-size..size)));
    Pose::from_rotation_vector(vector(2.0), vector(shift))
}

/// A box in any orientation keeps its edges and corners: its volume is exact, and all places lie on it.
#[test]
fn boxes_keep_their_edges() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..5 {
        let field = Boxes(vec![(random_pose(&mut random, 0.1), DVec3::new(0.9, 0.7, 0.5))]);
        let mesh = dual_contour(&unit_box(1.5), 0.11, &field).unwrap();
        let check = mesh.check();
        assert!(check.watertight && check.manifold && check.oriented && check.euler_characteristic == 2);
        let volume = mesh.signed_volume().unwrap();
        assert!((volume / (8.0 * 0.9 * 0.7 * 0.5) - 1.0).abs() < 2e-3, "{volume}");
        let far = |t: usize| field.distance(mesh.point_at(t, [1.0 / 3.0; 3])).abs();
        let far: Vec<f64> = (0..mesh.triangles.len()).map(far).collect();
        let rms = (far.iter().map(|d| d * d).sum::<f64>() / far.len() as f64).sqrt();
        assert!(rms < 0.003 && far.iter().all(|d| *d < 0.04), "{rms}");
    }
}

/// Boxes that cross under any angle have a manifold surface that does not intersect itself.
#[test]
fn crossing_boxes_do_not_intersect() {
    let mut random = ChaCha8Rng::seed_from_u64(8);
    for _ in 0..4 {
        let one = |random: &mut ChaCha8Rng| {
            let half = DVec3::from_array([0, 1, 2].map(|_| random.random_range(0.15..0.8)));
            (random_pose(random, 0.3), half)
        };
        let field = Boxes((0..5).map(|_| one(&mut random)).collect());
        let mesh = dual_contour(&unit_box(2.0), 0.08, &field).unwrap();
        let check = mesh.check();
        assert!(check.watertight && check.manifold && check.oriented, "{check:?}");
        assert_eq!(MeshSearch::try_new(&mesh).unwrap().self_crossings().pairs, 0);
    }
}

/// Independent random values at every point are the hardest case for the topology.
#[test]
fn noise_is_closed_and_manifold() {
    struct Noise(u64);
    impl DistanceField for Noise {
        fn distance(&self, at: DVec3) -> f64 {
            if at.abs().max_element() > 0.9 {
                return 1.0;
            }
            let mix = |h: u64, x: u64| (h ^ x).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (h >> 29);
            let bits = at.to_array().map(f64::to_bits).iter().fold(self.0, |h, x| mix(h, *x));
            ChaCha8Rng::seed_from_u64(bits).random_range(-1.0..1.0)
        }
        fn distance_and_gradient(&self, at: DVec3) -> (f64, DVec3) {
            (self.distance(at), at.normalize_or_zero())
        }
        fn may_pass(&self, _: DVec3, _: f64) -> bool {
            true
        }
    }
    for seed in 0..5 {
        let mesh = dual_contour(&unit_box(1.1), 0.2, &Noise(seed)).unwrap();
        let check = mesh.check();
        assert!(check.watertight && check.oriented && check.manifold, "{check:?}");
        assert!(mesh.triangles.len() > 500);
    }
}
