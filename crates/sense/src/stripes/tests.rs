use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use planish_core::Pinhole;
use planish_core::SymmetricMatrix3;
use planish_core::matrix3::{IDENTITY, from_rows, times, transposed_times};

const K: [[f64; 3]; 3] = [[1200.0, 0.0, 320.0], [0.0, 1200.0, 240.0], [0.0, 0.0, 1.0]];
const STRIPES: [[f64; 2]; 2] = [[0.0, 1.0], [1.0, 0.0]];

fn camera() -> Pinhole {
    Pinhole { k: K, r: IDENTITY, t: DVec3::ZERO }
}

/// 150 to the right and 60 up, turned towards the axis at a distance of 500.
fn projector() -> Pinhole {
    let centre = DVec3::new(150.0, -60.0, 0.0);
    let z = (DVec3::new(0.0, 0.0, 500.0) - centre).try_normalize().unwrap();
    let x = DVec3::Y.cross(z).try_normalize().unwrap();
    let r = from_rows([x, z.cross(x), z]);
    Pinhole { k: K, r, t: -times(&r, centre) }
}

/// The intersection of a ray with an ellipsoid around (0, 0, 560), and the normal there.
const AXES: DVec3 = DVec3::new(90.0, 70.0, 80.0);
const MIDDLE: DVec3 = DVec3::new(0.0, 0.0, 560.0);

fn hit(from: DVec3, along: DVec3) -> Option<DVec3> {
    let o = (from - MIDDLE) / AXES;
    let d = along / AXES;
    let (a, b, c) = (d.length_squared(), o.dot(d), o.length_squared() - 1.0);
    let root = b * b - a * c;
    (root > 0.0).then(|| {
        let s = (-b - root.sqrt()) / a;
        from + s * along
    })
}

fn surface_normal(p: DVec3) -> DVec3 {
    ((p - MIDDLE) / (AXES * AXES)).try_normalize().unwrap()
}

fn lit(pixel: [f64; 2]) -> Option<DVec3> {
    let p = projector();
    let inside = DVec3::new((pixel[0] - 320.0) / 1200.0, (pixel[1] - 240.0) / 1200.0, 1.0);
    hit(p.center(), transposed_times(&p.r, inside))
}

/// The junction of a projector's pixel; the directions of its stripes are from finite differences.
fn junction(pixel: [f64; 2]) -> Option<Junction> {
    let seen = |pixel: [f64; 2]| camera().project(lit(pixel)?);
    let h = 1e-3;
    let angle = |d: [f64; 2]| {
        let (a, b) = (
            seen([pixel[0] - h * d[0], pixel[1] - h * d[1]])?,
            seen([pixel[0] + h * d[0], pixel[1] + h * d[1]])?,
        );
        Some((b[1] - a[1]).atan2(b[0] - a[0]))
    };
    Some(Junction {
        image: seen(pixel)?,
        angles_rad: [angle(STRIPES[0])?, angle(STRIPES[1])?],
        projector: pixel,
    })
}

fn normal_number(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (TAU * b).cos()
}

fn noisy(j: &Junction, sigma: &JunctionSigma, rng: &mut ChaCha8Rng) -> Junction {
    let mut j = *j;
    j.image.iter_mut().for_each(|c| *c += sigma.place_px * normal_number(rng));
    j.angles_rad.iter_mut().for_each(|a| *a += sigma.angle_rad * normal_number(rng));
    j
}

const SIGMA: JunctionSigma = JunctionSigma { place_px: 0.1, angle_rad: 0.01 };

fn oriented(j: &Junction) -> Orientation {
    orientation(&camera(), &projector(), STRIPES, j, &SIGMA.covariance()).unwrap()
}

#[test]
fn point_and_normal_are_exact_without_noise() {
    for pixel in [[320.0, 240.0], [250.0, 200.0], [400.0, 300.0]] {
        let found = oriented(&junction(pixel).unwrap());
        let truth = lit(pixel).unwrap();
        assert!((found.point - truth).length() < 1e-6, "{:?} {truth:?}", found.point);
        let angle = found.normal.dot(surface_normal(truth)).clamp(-1.0, 1.0).acos();
        assert!(angle < 1e-5, "{angle}");
    }
}

#[test]
fn covariances_match_a_simulation() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for pixel in [[330.0, 250.0], [260.0, 210.0]] {
        let exact = junction(pixel).unwrap();
        let stated = oriented(&exact);
        let (e1, e2) = tangents(stated.normal);
        let draws = 8000;
        let (mut place, mut turn) = (DVec3::ZERO, 0.0);
        for _ in 0..draws {
            let found = oriented(&noisy(&exact, &SIGMA, &mut rng));
            let e = found.point - stated.point;
            (0..3).for_each(|k| place[k] += e[k] * e[k] / f64::from(draws));
            turn += 0.5 * (found.normal.dot(e1).powi(2) + found.normal.dot(e2).powi(2)) / f64::from(draws);
        }
        let SymmetricMatrix3 { xx, yy, zz, .. } = stated.covariance;
        for (k, variance) in [xx, yy, zz].into_iter().enumerate() {
            assert!((place[k] / variance - 1.0).abs() < 0.07, "{k}: {} {variance}", place[k]);
        }
        let ratio = turn.sqrt().to_degrees() / stated.sigma_normal_deg;
        assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
    }
}

/// The pairs about a pixel, along both stripes and both diagonals.
fn pairs(pixel: [f64; 2], step: f64, see: &mut dyn FnMut([f64; 2]) -> Orientation) -> Vec<[Orientation; 2]> {
    [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
        .map(|d| [1.0, -1.0].map(|s| see([pixel[0] + s * step * d[0], pixel[1] + s * step * d[1]])))
        .to_vec()
}

/// Principal curvatures of the ellipsoid from its Gaussian and mean curvature in implicit form (Goldman
/// 2005).
fn true_curvatures(p: DVec3) -> (f64, f64) {
    let g = 2.0 * (p - MIDDLE) / (AXES * AXES);
    let h = AXES.map(|a| 2.0 / (a * a));
    let square = g.length_squared();
    let gauss = (g[0] * g[0] * h[1] * h[2] + g[1] * g[1] * h[0] * h[2] + g[2] * g[2] * h[0] * h[1])
        / (square * square);
    let along: f64 = (0..3).map(|k| g[k] * g[k] * h[k]).sum();
    let mean = (along - square * (h[0] + h[1] + h[2])) / (2.0 * square.powf(1.5));
    let root = (mean * mean - gauss).max(0.0).sqrt();
    (mean + root, mean - root)
}

#[test]
fn curvatures_of_an_ellipsoid_are_accurate() {
    for pixel in [[320.0, 240.0], [270.0, 215.0], [380.0, 280.0]] {
        let middle = oriented(&junction(pixel).unwrap());
        let found = curvature(&middle, &pairs(pixel, 8.0, &mut |p| oriented(&junction(p).unwrap()))).unwrap();
        let (k1, k2) = true_curvatures(middle.point);
        // It bends away from its normal.
        assert!(k2 < k1 && k1 < 0.0);
        assert!(
            (found.k1 / k1 - 1.0).abs() < 0.02 && (found.k2 / k2 - 1.0).abs() < 0.02,
            "{found:?} {k1} {k2}"
        );
        assert!(found.d1.dot(middle.normal).abs() < 1e-9);
    }
}

#[test]
fn sigma_of_curvatures_matches_a_simulation() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let pixel = [300.0, 230.0];
    let sigma = JunctionSigma { place_px: 0.1, angle_rad: 0.004 };
    let truth = curvature(
        &oriented(&junction(pixel).unwrap()),
        &pairs(pixel, 24.0, &mut |p| oriented(&junction(p).unwrap())),
    )
    .unwrap();
    let draws = 3000;
    let (mut squares, mut stated) = (0.0, 0.0);
    for _ in 0..draws {
        let mut see = |p: [f64; 2]| {
            let j = noisy(&junction(p).unwrap(), &sigma, &mut rng);
            orientation(&camera(), &projector(), STRIPES, &j, &sigma.covariance()).unwrap()
        };
        let middle = see(pixel);
        let found = curvature(&middle, &pairs(pixel, 24.0, &mut see)).unwrap();
        // The trace does not turn with the axes: its σ is at most twice that of one entry.
        squares += 0.25 * (found.k1 + found.k2 - truth.k1 - truth.k2).powi(2) / f64::from(draws);
        stated += found.sigma / f64::from(draws);
    }
    let ratio = squares.sqrt() / stated;
    assert!((0.5..1.05).contains(&ratio), "{ratio}");
}

#[test]
fn degenerate_junctions_are_rejected() {
    let j = junction([320.0, 240.0]).unwrap();
    let one = Junction { angles_rad: [j.angles_rad[0]; 2], ..j };
    let same = orientation(&camera(), &projector(), [STRIPES[0]; 2], &one, &SIGMA.covariance());
    assert_eq!(same.unwrap_err().kind(), planish_estimate::ErrorKind::Undetermined);
    let middle = oriented(&j);
    let two = &pairs([320.0, 240.0], 8.0, &mut |p| oriented(&junction(p).unwrap()))[..2];
    assert!(curvature(&middle, two).is_err());
}
