//! Patches of known surfaces, merged: what comes out is nearer to the truth than what went in, and σ says how near.

// Helpers of tests may print as tests do.
#![allow(clippy::print_stdout)]

use planish::merge::{MergeMethod, MergeOptions, Merged, NamedPatch, PatchSet, merge};
use planish::progress::Silent;
use planish_estimate::vector3::{add_scaled, dot, norm, scale, unit};
use planish_mesh::{MeshSearch, Patch, icosphere};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIGMA: f64 = 0.03;

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

/// A ball of radius 10 with a swell, at a direction.
fn radius(d: [f64; 3]) -> f64 {
    10.0 + 0.4 * (3.0 * d[0]).sin() * (2.0 * d[1] + d[2]).cos()
}

/// The part of the swollen ball about an axis, with noise along the normals' rays.
fn patch(name: &str, axis: [f64; 3], least: f64, turn: f64, rng: &mut ChaCha8Rng) -> NamedPatch {
    let mut ball = icosphere(1.0, 5);
    let (s, c) = turn.sin_cos();
    for p in &mut ball.positions {
        let [x, y, z] = *p;
        *p = [c * x - s * y, s * x + c * y, z];
        let [x, y, z] = *p;
        *p = [x, c * y - s * z, s * y + c * z];
    }
    ball.triangles
        .retain(|t| t.iter().all(|v| dot(ball.positions[*v as usize], axis) >= least));
    for p in &mut ball.positions {
        let d = unit(*p).expect("a direction");
        *p = add_scaled(scale(radius(d), d), SIGMA * normal(rng), d);
    }
    let sigma = vec![SIGMA; ball.positions.len()];
    NamedPatch {
        name: name.to_owned(),
        patch: Patch::tidy(&ball, &sigma).expect("a patch").0,
        dropped: 0,
        observed: Vec::new(),
    }
}

fn four_patches() -> Vec<NamedPatch> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    corners
        .iter()
        .enumerate()
        .map(|(k, axis)| {
            let axis = unit(*axis).expect("a direction");
            patch(&format!("patch {k}"), axis, -0.1, 0.3 + 0.5 * k as f64, &mut rng)
        })
        .collect()
}

fn merged(patches: Vec<NamedPatch>, method: MergeMethod) -> Merged {
    let set = PatchSet {
        patches,
        ..PatchSet::default()
    };
    let options = MergeOptions {
        method: Some(method),
        ..MergeOptions::default()
    };
    merge(set, &options, &Silent).expect("a whole")
}

/// Root mean square errors, over σ and as they are.
fn errors(whole: &Merged) -> (f64, f64) {
    let n = whole.mesh.positions.len() as f64;
    let (mut normalized, mut squares) = (0.0, 0.0);
    for (p, s) in whole.mesh.positions.iter().zip(&whole.sigma) {
        let d = unit(*p).expect("a direction");
        let off = norm(*p) - radius(d);
        squares += off * off / n;
        normalized += (off / s).powi(2) / n;
    }
    (normalized.sqrt(), squares.sqrt())
}

#[test]
fn a_whole_is_nearer_to_the_truth_than_its_patches_and_sigma_says_how_near() {
    let mut rms = Vec::new();
    for method in [MergeMethod::Mean, MergeMethod::Refit, MergeMethod::Information] {
        let whole = merged(four_patches(), method);
        let report = &whole.report;
        assert!(
            report.watertight && report.nonmanifold_edges == 0,
            "{method:?}: {report:?}"
        );
        let (normalized, error) = errors(&whole);
        println!(
            "{method:?}: rms {error:.5} for σ {SIGMA}, over σ {normalized:.3}, {} triangles",
            report.triangles
        );
        assert!((0.8..1.25).contains(&normalized), "{method:?}: {normalized}");
        rms.push(error);
    }
    assert!(rms[0] < 0.95 * SIGMA && rms[2] < 0.7 * rms[0], "{rms:?}");
}

#[test]
fn the_order_of_patches_does_not_matter() {
    let patches = four_patches();
    let pick = |order: [usize; 4]| order.iter().map(|k| patches[*k].clone()).collect();
    let first = merged(pick([0, 1, 2, 3]), MergeMethod::Information);
    for order in [[3, 2, 1, 0], [1, 3, 0, 2], [2, 0, 3, 1]] {
        let other = merged(pick(order), MergeMethod::Information);
        let search = MeshSearch::try_new(&other.mesh).expect("a mesh");
        let mut off: Vec<f64> = first
            .mesh
            .positions
            .iter()
            .zip(&first.sigma)
            .map(|(p, s)| search.closest(*p).expect("finite").distance / s)
            .collect();
        off.sort_by(f64::total_cmp);
        let (median, p95) = (off[off.len() / 2], off[off.len() * 95 / 100]);
        println!("{order:?}: {median:.3} σ in the median, {p95:.3} σ at 95 %");
        assert!(median < 0.2, "{order:?}: {median}, {p95}");
    }
}
