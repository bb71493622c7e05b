//! Laws of rectification.

use super::*;
use planish_core::Pinhole;

const K: [[f64; 3]; 3] = [[200.0, 0.0, 79.5], [0.0, 200.0, 59.5], [0.0, 0.0, 1.0]];
const SIZE: [usize; 2] = [160, 120];

/// A camera at a position, rotated about y, x and z, in this order.
fn camera(at: DVec3, turns: DVec3, distortion: [f64; 5]) -> LensCamera {
    let about = |axis: DVec3, angle: f64| Pose::from_rotation_vector(angle * axis, DVec3::ZERO);
    let world_from_camera = Pose {
        translation: at,
        ..about(DVec3::Y, turns[0]).after(&about(DVec3::X, turns[1])).after(&about(DVec3::Z, turns[2]))
    };
    LensCamera { pinhole: Pinhole::new(K, &world_from_camera), distortion }
}

fn converging() -> StereoRig {
    StereoRig {
        cameras: [
            camera(DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.1, 0.03, -0.02), [-0.2, 0.05, 1e-3, -2e-3, 0.01]),
            camera(DVec3::new(2.0, 2.1, 2.9), DVec3::new(-0.15, -0.02, 0.04), [-0.1, 0.02, -1e-3, 1e-3, 0.0]),
        ],
        sigma_disparity: 0.1,
    }
}

#[test]
fn points_have_equal_rows_and_are_recovered_from_their_disparity() {
    let rig = converging();
    let made = Rectification::new(&rig, [SIZE; 2]).unwrap();
    let camera = *made.camera();
    for point in [[1.4, 2.0, 8.0], [1.0, 1.5, 9.0], [1.9, 2.6, 7.0]] {
        let point = DVec3::from_array(point);
        let local = made.world_from_rectified().inverse().apply(point);
        let left = [0, 1].map(|k| camera.focal * local[k] / local[2] + camera.center[k]);
        let disparity = camera.focal * camera.baseline / local[2] - camera.doffs;
        let right = [left[0] - disparity, left[1]];
        for (which, place) in [left, right].into_iter().enumerate() {
            let source = made.source(which, place).unwrap();
            let lens = rig.cameras[which];
            let expected = lens.pixel(point - lens.pinhole.center()).unwrap();
            assert!((0..2).all(|k| (source[k] - expected[k]).abs() < 1e-9), "{source:?} {expected:?}");
        }
        let found = made.world_from_rectified().apply(camera.point(left[0], left[1], disparity).unwrap());
        assert!((found - point).length() < 1e-9, "{found:?}");
    }
}

#[test]
fn distortion_and_its_inverse_cancel() {
    for lens in converging().cameras {
        for pixel in [[0.0, 0.0], [159.0, 119.0], [40.0, 100.0]] {
            let again = lens.pixel(lens.direction(pixel).unwrap()).unwrap();
            assert!((0..2).all(|k| (again[k] - pixel[k]).abs() < 1e-6), "{again:?}");
        }
    }
}

#[test]
fn rectified_images_stay_unchanged() {
    let mut rig = StereoRig {
        cameras: [
            camera(DVec3::ZERO, DVec3::ZERO, [0.0; 5]),
            camera(DVec3::new(0.5, 0.0, 0.0), DVec3::ZERO, [0.0; 5]),
        ],
        sigma_disparity: 0.0,
    };
    rig.cameras[1].pinhole.k[0][2] += 7.0;
    let made = Rectification::new(&rig, [SIZE; 2]).unwrap();
    assert!((made.camera().doffs - 7.0).abs() < 1e-9 && (made.camera().center[0] - 79.5).abs() < 1e-9);
    let values = (0..160 * 120).map(|k| ((k * 7919) % 251) as f32).collect();
    let image = Image::try_new(160, 120, values).unwrap();
    for which in 0..2 {
        assert_eq!(made.picture(which, &image).unwrap(), image);
    }
}

#[test]
fn points_and_covariances_rotate_with_the_rig() {
    let [columns, rows] = [40, 30];
    let map = DisparityMap {
        columns,
        rows,
        disparity: (0..columns * rows).map(|k| 20.0 + (k % 7) as f32).collect(),
        sigma: vec![0.2; columns * rows],
        rejected: crate::StereoRejected::default(),
    };
    let rig = converging();
    let motion = Pose::from_rotation_vector(DVec3::new(0.7, -0.4, 1.1), DVec3::new(5.0, -3.0, 2.0));
    let mut moved = rig;
    for camera in &mut moved.cameras {
        let camera_from_world =
            Pose { rotation: camera.pinhole.r, translation: camera.pinhole.t }.after(&motion.inverse());
        (camera.pinhole.r, camera.pinhole.t) = (camera_from_world.rotation, camera_from_world.translation);
    }
    let scan = |rig: &StereoRig| {
        let made = Rectification::new(rig, [SIZE; 2]).unwrap();
        made.scan(&map, &StereoPoints::default(), "stereo").unwrap()
    };
    let (before, after) = (scan(&rig), scan(&moved));
    let (c, d) = (before.covariance.unwrap(), after.covariance.unwrap());
    for k in (0..before.points.len()).step_by(97) {
        let expected = motion.apply(before.points[k]);
        assert!((expected - after.points[k]).length() < 1e-9 * expected.length().max(1.0));
        for n in [DVec3::X, DVec3::new(0.0, 0.6, 0.8), DVec3::new(0.48, -0.6, 0.64)] {
            let same = d[k].along(motion.rotate(n)) / c[k].along(n);
            assert!((same - 1.0).abs() < 1e-6, "{same}");
        }
    }
}

#[test]
fn rigs_that_cannot_be_rectified_are_rejected() {
    let with = |second: LensCamera| {
        let rig =
            StereoRig { cameras: [camera(DVec3::ZERO, DVec3::ZERO, [0.0; 5]), second], sigma_disparity: 0.0 };
        Rectification::new(&rig, [SIZE; 2]).unwrap_err().to_string()
    };
    let e = with(camera(DVec3::new(0.1, 0.0, 3.0), DVec3::ZERO, [0.0; 5]));
    assert!(e.contains("epipole inside the image of the first camera"), "{e}");
    assert!(with(camera(DVec3::ZERO, DVec3::new(0.1, 0.0, 0.0), [0.0; 5])).contains("different positions"));
    assert!(with(camera(DVec3::X, DVec3::new(3.0, 0.0, 0.0), [0.0; 5])).contains("90° apart"));
    assert!(with(camera(DVec3::X, DVec3::ZERO, [-9.0, 0.0, 0.0, 0.0, 0.0])).contains("cannot be inverted"));
}
