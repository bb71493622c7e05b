use super::super::reading::{ContourReading, ContourTarget};
use super::{WallMap, find_walls, wall_corners};
use crate::planar::ContourFitOptions;
use planish_core::random::{SplitMix64, unit_interval};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A corridor of 12 m by 2 m with a door gap in each long wall and a niche, as segments.
const CORRIDOR: [[[f64; 2]; 2]; 10] = [
    [[0.0, 0.0], [4.0, 0.0]],
    [[5.0, 0.0], [12.0, 0.0]],
    [[12.0, 0.0], [12.0, 2.0]],
    [[12.0, 2.0], [9.0, 2.0]],
    [[9.0, 2.0], [9.0, 2.6]],
    [[9.0, 2.6], [7.0, 2.6]],
    [[7.0, 2.6], [7.0, 2.0]],
    [[7.0, 2.0], [3.0, 2.0]],
    [[2.0, 2.0], [0.0, 2.0]],
    [[0.0, 2.0], [0.0, 0.0]],
];

/// Distance along a ray to the nearest segment.
fn cast(segments: &[[[f64; 2]; 2]], origin: [f64; 2], heading: f64) -> Option<f64> {
    let (sin, cos) = heading.sin_cos();
    let hit = |&[a, b]: &[[f64; 2]; 2]| {
        let (e, d) = ([b[0] - a[0], b[1] - a[1]], [a[0] - origin[0], a[1] - origin[1]]);
        let cross = cos * e[1] - sin * e[0];
        let range = (d[0] * e[1] - d[1] * e[0]) / cross;
        let share = (d[0] * sin - d[1] * cos) / cross;
        (range > 0.0 && (0.0..=1.0).contains(&share)).then_some(range)
    };
    segments.iter().filter_map(hit).min_by(f64::total_cmp)
}

fn uniform(random: &mut SplitMix64) -> f64 {
    unit_interval(random.next_u64())
}

/// A standard normal number (Box and Muller 1958).
fn normal(random: &mut SplitMix64) -> f64 {
    let (a, b) = (uniform(random), uniform(random));
    (-2.0 * (1.0 - a).ln()).sqrt() * (TAU * b).cos()
}

/// Noise of a range.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Noise {
    Normal,
    Uniform,
    /// A tenth with four times the σ of the others, together σ.
    Heavy,
}

fn noise(kind: Noise, random: &mut SplitMix64) -> f64 {
    match kind {
        Noise::Normal => normal(random),
        Noise::Uniform => 12f64.sqrt() * (uniform(random) - 0.5),
        Noise::Heavy => {
            let wide = if uniform(random) < 0.1 { 4.0 } else { 1.0 };
            wide * normal(random) / 2.5f64.sqrt()
        }
    }
}

/// One turn of a scanner: a ray per half degree, a share of them stopped by clutter on the way.
fn scan(origin: [f64; 2], sigma: f64, clutter: f64, kind: Noise, seed: u64) -> Vec<ContourReading> {
    let mut random = SplitMix64::new(seed);
    let phase = uniform(&mut random);
    (0..720)
        .filter_map(|k| {
            let heading_rad = TAU * (f64::from(k) + phase) / 720.0;
            let mut range = cast(&CORRIDOR, origin, heading_rad)?;
            if uniform(&mut random) < clutter {
                range *= uniform(&mut random);
            }
            range += sigma * noise(kind, &mut random);
            let target = ContourTarget::Range { origin, heading_rad, range, sigma: [0.0, 0.0, 0.0, sigma] };
            Some(ContourReading { target, pose: None, time_s: 0.0, line: k as usize })
        })
        .collect()
}

/// The wall of a true segment: its index, and the offset from the middle of the segment in σ.
fn nearest(map: &WallMap, [a, b]: [[f64; 2]; 2]) -> (usize, f64) {
    let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
    let direction = (b[1] - a[1]).atan2(b[0] - a[0]);
    let mut best = (usize::MAX, f64::INFINITY, 0.0);
    for (k, wall) in map.walls.iter().enumerate() {
        let turn = (wall.fit.state[0] - direction + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2;
        let (sin, cos) = wall.fit.state[0].sin_cos();
        let off = cos * middle[1] - sin * middle[0] - wall.fit.state[1];
        let t = cos * middle[0] + sin * middle[1];
        let c = &wall.fit.covariance;
        let sigma = (c[(1, 1)] + 2.0 * t * c[(0, 1)] + t * t * c[(0, 0)]).sqrt();
        if turn.abs() < 0.2 && off.abs() < best.1 {
            best = (k, off.abs(), off / sigma);
        }
    }
    (best.0, best.2)
}

#[test]
fn walls_of_a_corridor_are_found_and_covered() {
    // Walls in line are one wall with a door between them: segments 0 and 1, and 3, 7 and 8.
    let options = ContourFitOptions::default();
    for kind in [Noise::Normal, Noise::Uniform, Noise::Heavy] {
        let (mut inside, mut all, mut extra, mut used) = (0_usize, 0_usize, 0_usize, 0.0);
        for seed in 0..60 {
            let readings = scan([6.0, 1.1], 0.02, 0.05, kind, seed);
            let map = find_walls(&readings, &options).unwrap();
            let on_walls = readings.len() - map.others.len();
            assert!(on_walls as f64 > 0.8 * readings.len() as f64, "{kind:?} {seed}: {on_walls}");
            used += on_walls as f64 / readings.len() as f64;
            extra += map.walls.len().saturating_sub(7);
            for segment in [0, 1, 2, 3, 5, 7, 9] {
                let (_, offset) = nearest(&map, CORRIDOR[segment]);
                all += 1;
                inside += usize::from(offset.abs() < 1.96);
            }
        }
        let share = inside as f64 / all as f64;
        println!("{kind:?}: coverage {share:.3}, {extra} walls of clutter in 60 scans");
        assert!((0.92..0.98).contains(&share), "{kind:?}: coverage {share:.3}");
        assert!(used > 0.92 * 60.0, "{kind:?}: {used} of 60");
        assert!(extra < 20, "{extra} walls of clutter");
    }
}

#[test]
fn a_wall_behind_a_door_is_one_wall_with_two_spans() {
    let readings = scan([6.0, 1.1], 0.01, 0.0, Noise::Normal, 3);
    let map = find_walls(&readings, &ContourFitOptions::default()).unwrap();
    assert_eq!(nearest(&map, CORRIDOR[0]).0, nearest(&map, CORRIDOR[1]).0);
    let wall = &map.walls[nearest(&map, CORRIDOR[0]).0];
    assert_eq!(wall.spans.len(), 2, "{:?}", wall.spans);
    let gap: Vec<f64> = [wall.spans[0][1][0], wall.spans[1][0][0]].to_vec();
    assert!((gap[0].min(gap[1]) - 4.0).abs() < 0.2 && (gap[0].max(gap[1]) - 5.0).abs() < 0.2, "{gap:?}");
    // The niche is a wall of its own, 0.6 m behind.
    assert_ne!(nearest(&map, CORRIDOR[5]).0, nearest(&map, CORRIDOR[7]).0);
}

#[test]
fn corners_are_covered() {
    // Four of the corridor, and both of the niche that the sensor sees.
    let truth = [[12.0, 0.0], [12.0, 2.0], [0.0, 0.0], [0.0, 2.0], [9.0, 2.0], [9.0, 2.6]];
    let (mut inside, mut all, mut missing, mut extra) = (0_usize, 0_usize, 0_usize, 0_usize);
    for seed in 0..60 {
        let readings = scan([5.0, 0.9], 0.02, 0.03, Noise::Normal, 100 + seed);
        let map = find_walls(&readings, &ContourFitOptions::default()).unwrap();
        let corners = wall_corners(&map.walls);
        let is_true = |p: [f64; 2]| truth.iter().any(|c| (p[0] - c[0]).hypot(p[1] - c[1]) < 0.2);
        extra += corners.iter().filter(|one| !is_true(one.position)).count();
        for corner in truth {
            let away = |p: [f64; 2]| (p[0] - corner[0]).hypot(p[1] - corner[1]);
            // Clutter may hide the last readings of a wall that is seen at a small angle.
            let Some(found) = corners.iter().find(|one| away(one.position) < 0.2) else {
                missing += 1;
                continue;
            };
            for (axis, variance) in [(0, found.covariance[0]), (1, found.covariance[2])] {
                all += 1;
                inside += usize::from((found.position[axis] - corner[axis]).abs() < 1.96 * variance.sqrt());
            }
        }
    }
    let share = inside as f64 / all as f64;
    println!("corners: coverage {share:.3} of {all}, {missing} of 360 corners missing, {extra} others");
    assert!(missing < 30 && extra < 4, "{missing} corners missing, {extra} where no walls meet");
    assert!((0.92..0.98).contains(&share), "{share}");
}

#[test]
fn walls_are_found_from_outside_and_without_an_order() {
    // A sensor that drives around a box and turns: every reading has its own pose.
    let mut random = SplitMix64::new(5);
    let square = [[2.0, 1.0], [-2.0, 1.0], [-2.0, -1.0], [2.0, -1.0]];
    let segments: Vec<[[f64; 2]; 2]> = (0..4).map(|k| [square[k], square[(k + 1) % 4]]).collect();
    let readings: Vec<ContourReading> = (0..400)
        .map(|k| {
            let angle = TAU * uniform(&mut random);
            let origin = [6.0 * angle.cos(), 6.0 * angle.sin()];
            let heading_rad = angle + PI + 0.15 * (uniform(&mut random) - 0.5);
            let range = cast(&segments, origin, heading_rad).unwrap() + 0.01 * normal(&mut random);
            let target = ContourTarget::Range { origin, heading_rad, range, sigma: [0.0, 0.0, 0.0, 0.01] };
            ContourReading { target, pose: None, time_s: 0.0, line: k }
        })
        .collect();
    let map = find_walls(&readings, &ContourFitOptions::default()).unwrap();
    assert_eq!(map.walls.len(), 4);
    assert!(map.others.len() < 8, "{} on no wall", map.others.len());
}

#[test]
fn scattered_readings_are_rarely_walls() {
    let mut walls = 0;
    for seed in 0..20 {
        let mut random = SplitMix64::new(seed);
        let readings: Vec<ContourReading> = (0..60)
            .map(|line| {
                let position = [10.0 * uniform(&mut random), 10.0 * uniform(&mut random)];
                let target = ContourTarget::Point { position, sigma: 0.01 };
                ContourReading { target, pose: None, time_s: 0.0, line }
            })
            .collect();
        walls += find_walls(&readings, &ContourFitOptions::default()).map_or(0, |map| map.walls.len());
    }
    assert!(walls <= 2, "{walls} walls in 20 sets");
}

/// A scan of a square room whose walls wave by `wave` (σ) with a period of about a metre.
fn waved(wave: f64, seed: u64) -> Vec<ContourReading> {
    let mut random = SplitMix64::new(seed);
    let square = [[3.0, 2.0], [-3.0, 2.0], [-3.0, -2.0], [3.0, -2.0]];
    let segments: Vec<[[f64; 2]; 2]> = (0..4).map(|k| [square[k], square[(k + 1) % 4]]).collect();
    let phases: Vec<f64> = (0..12).map(|_| TAU * uniform(&mut random)).collect();
    (0..360)
        .map(|k| {
            let heading_rad = TAU * f64::from(k) / 360.0;
            let (sin, cos) = heading_rad.sin_cos();
            let range = cast(&segments, [0.0, 0.0], heading_rad).unwrap();
            let (x, y) = (range * cos, range * sin);
            let is_vertical = x.abs() > 3.0 - 1e-9;
            let (t, across) = if is_vertical { (y, cos.abs()) } else { (x, sin.abs()) };
            let side = 3 * (2 * usize::from(is_vertical) + usize::from(x + y > 0.0));
            // Three waves per wall with periods of 0.8, 1.2 and 2 m.
            let form: f64 =
                (0..3).map(|j| (TAU * t / [0.8, 1.2, 2.0][j] + phases[side + j]).sin()).sum::<f64>();
            let range = range + (2f64 / 3.0).sqrt() * wave * form / across + 0.01 * normal(&mut random);
            let sigma = [0.0, 0.0, 0.0, 0.01];
            let target = ContourTarget::Range { origin: [0.0, 0.0], heading_rad, range, sigma };
            ContourReading { target, pose: None, time_s: 0.0, line: k as usize }
        })
        .collect()
}

#[test]
fn waves_of_walls_enlarge_their_sigma() {
    let truth = [
        [[3.0, -2.0], [3.0, 2.0]],
        [[-3.0, -2.0], [-3.0, 2.0]],
        [[-3.0, 2.0], [3.0, 2.0]],
        [[-3.0, -2.0], [3.0, -2.0]],
    ];
    for (wave, form) in [(0.0, 0.0..0.004), (0.01, 0.006..0.02)] {
        let (mut inside, mut estimates) = (0_usize, 0.0);
        for seed in 0..12 {
            let map = find_walls(&waved(wave, 500 + seed), &ContourFitOptions::default()).unwrap();
            inside += truth.iter().filter(|side| nearest(&map, **side).1.abs() < 1.96).count();
            estimates += map.errors.form / 12.0;
        }
        println!("waves of {wave}: {inside} of 48 within 1.96 sigma, deviation {estimates:.4}");
        assert!(form.contains(&estimates), "waves of {wave}: {estimates}");
        assert!(inside > 40, "waves of {wave}: {inside} of 48");
    }
}
