//! Fits of objects with sharp edges.

use super::tests::{SIGMA, set_of};
use crate::fit::finish::{FinishInput, finish};
use crate::fit::refine::refine_to_noise;
use crate::fit::{Fit, FitOptions, FitVerdict, GlobalOptions, Strategy, observation_options, observe};
use crate::model::Posterior;
use crate::observe::ScanErrors;
use planish_core::{DVec3, Silent};
use planish_spline::{FootPointSearch, Hierarchy, ProjectionOptions, QuadDomain, Surface};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Half sides of the solid.
const HALF: [f64; 3] = [30.0, 20.0, 10.0];
/// Heights of its two curved faces above the middle of a flat one.
const BULGE: f64 = 4.0;

/// The surface of the solid over a point of a cube's surface. Top and bottom are curved, and meet the sides
/// in circular arcs.
fn on_solid(q: DVec3) -> DVec3 {
    let [x, y, z] = [q.x * HALF[0], q.y * HALF[1], q.z * HALF[2]];
    DVec3::new(x, y, z * (1.0 + BULGE / HALF[2] * (1.0 - q.x * q.x)))
}

/// The cube's faces, each of `n × n` quads, with creases along its edges, and the positions of all vertices.
fn cube(n: i32) -> (QuadDomain, Vec<DVec3>) {
    let (mut numbers, mut positions) = (std::collections::HashMap::new(), Vec::new());
    let mut quads = Vec::new();
    for axis in 0..3 {
        for side in [0, n] {
            for k in 0..n * n {
                let mut corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[p, q]| {
                    let mut at = [side; 3];
                    (at[(axis + 1) % 3], at[(axis + 2) % 3]) = (k % n + p, k / n + q);
                    *numbers.entry(at).or_insert_with(|| {
                        positions
                            .push(DVec3::from_array(at.map(|x| 2.0 * f64::from(x) / f64::from(n) - 1.0)));
                        positions.len() as u32 - 1
                    })
                });
                if side == 0 {
                    corners.reverse();
                }
                quads.push(corners);
            }
        }
    }
    let is_edge = |a: u32, b: u32| {
        let [a, b] = [a, b].map(|v| positions[v as usize]);
        (0..3).filter(|&d| a[d].abs() == 1.0 && a[d] == b[d]).count() == 2
    };
    let sides = quads.iter().flat_map(|quad| (0..4).map(move |k| [quad[k], quad[(k + 1) % 4]]));
    let creases: Vec<[u32; 2]> = sides.filter(|&[a, b]| is_edge(a, b)).collect();
    (QuadDomain::with_creases(&quads, &creases, &[]).unwrap(), positions)
}

/// Points all over the solid with their normals, uniform over the cube's surface, and how far they are from
/// its nearest edge.
fn points(count: usize, seed: u64) -> Vec<(DVec3, DVec3, f64)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let axis = rng.random_range(0..3);
            let mut q = DVec3::from_array([(); 3].map(|()| rng.random_range(-1.0..1.0)));
            q[axis] = if rng.random() { 1.0 } else { -1.0 };
            let [a, b] = [(axis + 1) % 3, (axis + 2) % 3].map(|d| {
                let mut along = DVec3::ZERO;
                along[d] = 1e-6;
                on_solid(q + along) - on_solid(q - along)
            });
            let p = on_solid(q);
            let normal = q[axis] * a.cross(b).normalize();
            let to_edge = (0..3).filter(|&d| d != axis).map(|d| HALF[d] * (1.0 - q[d].abs()));
            (p, normal, to_edge.fold(f64::INFINITY, f64::min))
        })
        .collect()
}

/// A fit of readings of the solid that starts wrong by four σ everywhere, at the edges as well. The second
/// half of the readings is a scan of its own, of which the stated position is wrong by `shift`.
fn fitted(count: usize, seed: u64, shift: Option<DVec3>) -> Fit {
    let mut rng = ChaCha8Rng::seed_from_u64(seed + 100);
    let mut noise = |size: f64| size * DVec3::from_array([(); 3].map(|()| rng.sample(StandardNormal)));
    let (mut readings, mut normals) = (Vec::new(), Vec::new());
    for (p, normal, _) in points(count, seed) {
        readings.push(p + noise(SIGMA));
        normals.push(normal);
    }
    let (domain, positions) = cube(6);
    let start = positions.iter().map(|q| on_solid(*q) + noise(4.0 * SIGMA)).collect();
    let surface = Surface::new(Hierarchy::over(domain.into()).unwrap().into(), start).unwrap();
    let strategy = Strategy::Global(GlobalOptions::default());
    let options = FitOptions { strategy, ..FitOptions::default() };
    let mut set = set_of(readings, normals);
    if let Some(shift) = shift {
        let mut second = set.scans[0].clone();
        let first = &mut set.scans[0].scan;
        second.scan.points = first.points.split_off(count / 2).iter().map(|p| *p + shift).collect();
        second.scan.normals = first.normals.as_mut().map(|normals| normals.split_off(count / 2));
        second.sigma_translation = Some(0.5);
        set.scans.push(second);
    }
    let mut observations = observe(&set, &observation_options(&set, &options)).unwrap();
    observations.scan_errors = ScanErrors::new(&set, &observations, DVec3::ZERO, false, None);
    let subset = observations.fitted();
    let converged = refine_to_noise(&mut observations, surface, subset, &options, &Silent).unwrap();
    finish(FinishInput::new(&set, &observations, &options, DVec3::ZERO), converged, &Silent).unwrap()
}

/// Edges move to their places, in both directions, and σ beside them is right.
#[test]
fn sharp_edges_are_fitted_and_covered() {
    let (mut near, mut far, mut missed) = (Vec::new(), Vec::new(), 0);
    for seed in 1..4 {
        let made = fitted(12_000, seed, None);
        assert_eq!(made.report.verdict, FitVerdict::Converged);
        let (surface, posterior) = (&made.model.surface, made.posterior());
        let search = FootPointSearch::new(surface, 2, 0.0).unwrap();
        for (p, normal, to_edge) in points(2000, seed + 200) {
            let foot = surface.project(p, search.nearest(p, normal), &ProjectionOptions::default());
            let (leaf, local) = (foot.leaf as usize, foot.local);
            let Some(along) = foot.jet.normal() else { continue };
            let sigma = Posterior::sigma_along(&posterior.leaf(leaf).unwrap(), local, along);
            let error = (p - foot.jet.point).length();
            missed += usize::from(error > 5.0 * sigma);
            (if to_edge < 2.0 { &mut near } else { &mut far }).push(error < 1.96 * sigma);
        }
    }
    let share = |all: &[bool]| all.iter().filter(|inside| **inside).count() as f64 / all.len() as f64;
    let [near, far] = [share(&near), share(&far)];
    assert!(near > 0.92 && far > 0.92 && missed < 20, "near {near}, far {far}, missed {missed}");
}

/// Positions of scans are found together with edges.
#[test]
fn the_position_of_a_scan_is_found_beside_sharp_edges() {
    let shift = DVec3::new(0.3, -0.2, 0.25);
    let made = fitted(6000, 5, Some(shift));
    assert!(made.report.creases.is_some_and(|creases| creases.sigma_median < SIGMA));
    let pose = &made.report.poses[1];
    let sigma = pose.sigma_translation.unwrap();
    let error = (DVec3::from(pose.translation) + shift).length();
    assert!(sigma < 0.1 * SIGMA && error < 5.0 * sigma, "{error} with σ {sigma}");
}
