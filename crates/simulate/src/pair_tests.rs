//! Stereo matching of images from converging cameras, compared with a rectified pair of the same object.

use super::render::{Exposure, Light, Texture};
use planish_core::matrix3::from_columns;
use planish_core::{DVec3, Pinhole};
use planish_mesh::{MeshSearch, icosphere};
use planish_sense::{
    Image, LensCamera, Pose, Rectification, Scan, StereoCamera, StereoOptions, StereoPoints, StereoRig,
    match_stereo,
};

const SIZE: [usize; 2] = [240, 180];
const FOCAL: f64 = 500.0;
const RADIUS: f64 = 8.0;

/// A camera at a position that looks along a direction, with y of the world downwards.
fn camera(at: DVec3, along: DVec3) -> Pinhole {
    let z = along.try_normalize().unwrap();
    let x = DVec3::Y.cross(z).try_normalize().unwrap();
    let y = z.cross(x);
    let world_from_camera = Pose { rotation: from_columns([x, y, z]), translation: at };
    Pinhole::new([[FOCAL, 0.0, 119.5], [0.0, FOCAL, 89.5], [0.0, 0.0, 1.0]], &world_from_camera)
}

fn picture(ball: &MeshSearch, camera: &Pinhole, seed: u64) -> Image {
    let exposure = Exposure {
        camera,
        size: SIZE,
        light: &Light::Lamp(DVec3::new(0.0, -15.0, -50.0)),
        texture: &Texture { contrast: 0.7, grain: 0.3, seed: 5 },
        sigma_brightness: 1.0,
        seed,
    };
    let grey = exposure.take(ball, &mut |_| Ok(())).unwrap();
    Image::try_new(SIZE[0], SIZE[1], grey.into_iter().map(f32::from).collect()).unwrap()
}

/// Number of points in the middle of the ball, and their median distance from its surface.
fn count_and_median(scan: &Scan) -> (usize, f64) {
    let central = scan.points.iter().filter(|p| DVec3::new(p[0], p[1], 0.0).length() < 0.7 * RADIUS);
    let mut off: Vec<f64> = central.map(|p| (p.length() - RADIUS).abs()).collect();
    off.sort_by(f64::total_cmp);
    (off.len(), off[off.len() / 2])
}

#[test]
fn converging_cameras_are_as_accurate_as_a_rectified_pair() {
    let ball = MeshSearch::try_new(&icosphere(RADIUS, 5)).unwrap();
    let places = [DVec3::new(-3.0, 0.0, -50.0), DVec3::new(3.0, 0.0, -50.0)];
    let options = StereoOptions { min_disparity: -40, disparities: 120, ..StereoOptions::default() };
    let choice = StereoPoints { max_sigma_px: 0.3, ..StereoPoints::default() };
    let matched =
        |images: &[Image; 2]| match_stereo(&images[0], &images[1], &options, &mut |_| Ok(())).unwrap();

    let level = places.map(|at| camera(at, DVec3::Z));
    let images = [picture(&ball, &level[0], 1), picture(&ball, &level[1], 2)];
    let rectified =
        StereoCamera { focal: FOCAL, center: [119.5, 89.5], baseline: 6.0, doffs: 0.0, sigma_disparity: 0.0 };
    let mut scan = rectified.scan(&matched(&images), &choice, "level").unwrap();
    for p in &mut scan.points {
        *p += places[0];
    }
    let (level_count, level_median) = count_and_median(&scan);

    // Both cameras look at the middle of the ball, the second from a slightly higher position.
    let places = [DVec3::new(-3.0, 0.0, -50.0), DVec3::new(3.0, -1.0, -50.0)];
    let cameras = places.map(|at| camera(at, -at));
    let images = [picture(&ball, &cameras[0], 1), picture(&ball, &cameras[1], 2)];
    let rig = StereoRig {
        cameras: cameras.map(|pinhole| LensCamera { pinhole, distortion: [0.0; 5] }),
        sigma_disparity: 0.0,
    };
    let made = Rectification::new(&rig, [SIZE; 2]).unwrap();
    let images = [0, 1].map(|k| made.picture(k, &images[k]).unwrap());
    let mut map = matched(&images);
    let _ = made.without_outside(&mut map);
    let scan = made.scan(&map, &choice, "converging").unwrap();
    let (count, median) = count_and_median(&scan);
    assert!(
        5 * count > 4 * level_count && median < 1.3 * level_median && median < 0.05,
        "{count} of {level_count}: {median} {level_median}"
    );
}
