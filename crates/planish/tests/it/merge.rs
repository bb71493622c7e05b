//! Merged patches of known surfaces: the result is closer to the truth than the patches, and its σ is
//! consistent.

use planish::compare::{CompareOptions, Compared, Reference, compare};
use planish::merge::{MergeMethod, MergeOptions, Merged, NamedPatch, PatchSet, merge, merged_spline};
use planish::progress::Silent;
use planish_core::{DVec3, FindingCode};
use planish_mesh::{MergePatch, MeshSearch, icosphere};
use planish_sense::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIGMA: f64 = 0.03;

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

/// A ball of radius 10 with a swell, at a direction.
fn radius(d: DVec3) -> f64 {
    10.0 + 0.4 * (3.0 * d[0]).sin() * (2.0 * d[1] + d[2]).cos()
}

/// The part of the swollen ball about an axis, with noise along the normals' rays, of which a share is waves
/// nine edges long and longer.
fn patch(name: &str, axis: DVec3, lowest: f64, turn: f64, smooth: f64, rng: &mut ChaCha8Rng) -> NamedPatch {
    let mut ball = icosphere(1.0, 5);
    let (s, c) = turn.sin_cos();
    for p in &mut ball.positions {
        let DVec3 { x, y, z } = *p;
        *p = DVec3::new(c * x - s * y, s * x + c * y, z);
        let DVec3 { x, y, z } = *p;
        *p = DVec3::new(x, c * y - s * z, s * y + c * z);
    }
    ball.triangles.retain(|t| t.iter().all(|v| ball.positions[*v as usize].dot(axis) >= lowest));
    let waves: Vec<(DVec3, f64)> = (0..12)
        .map(|_| {
            let d = DVec3::new(normal(rng), normal(rng), normal(rng)).try_normalize().expect("a direction");
            (20.0 * d, std::f64::consts::TAU * rng.random::<f64>())
        })
        .collect();
    for p in &mut ball.positions {
        let d = p.try_normalize().expect("a direction");
        let wave: f64 = waves.iter().map(|(k, phase)| (k.dot(d) + phase).sin()).sum();
        let noise = (1.0 - smooth).sqrt() * normal(rng) + (smooth / 6.0).sqrt() * wave;
        *p = radius(d) * d + SIGMA * noise * d;
    }
    let sigma = vec![SIGMA; ball.positions.len()];
    NamedPatch {
        name: name.to_owned(),
        tidied: MergePatch::make_manifold(&ball, &sigma).expect("a patch"),
        observed: Vec::new(),
    }
}

fn four_patches() -> Vec<NamedPatch> {
    four_patches_with(0.0)
}

fn four_patches_with(smooth: f64) -> Vec<NamedPatch> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let corners = [
        DVec3::new(1.0, 1.0, 1.0),
        DVec3::new(1.0, -1.0, -1.0),
        DVec3::new(-1.0, 1.0, -1.0),
        DVec3::new(-1.0, -1.0, 1.0),
    ];
    corners
        .iter()
        .enumerate()
        .map(|(k, axis)| {
            let axis = axis.try_normalize().expect("a direction");
            patch(&format!("patch {k}"), axis, -0.1, 0.3 + 0.5 * k as f64, smooth, &mut rng)
        })
        .collect()
}

fn merged(patches: Vec<NamedPatch>, method: MergeMethod) -> Merged {
    let set = PatchSet { patches, ..PatchSet::default() };
    let options = MergeOptions { method, ..MergeOptions::default() };
    merge(set, &options, &Silent).expect("a merged mesh")
}

/// Root mean square errors, over σ and as they are.
fn errors(merged: &Merged) -> (f64, f64) {
    let n = merged.mesh.positions.len() as f64;
    let (mut normalized, mut squares) = (0.0, 0.0);
    for (p, s) in merged.mesh.positions.iter().zip(&merged.sigma) {
        let d = p.try_normalize().expect("a direction");
        let off = p.length() - radius(d);
        squares += off * off / n;
        normalized += (off / s).powi(2) / n;
    }
    (normalized.sqrt(), squares.sqrt())
}

#[test]
fn a_merged_mesh_is_more_accurate_than_its_patches_and_sigma_is_calibrated() {
    let mut rms = Vec::new();
    for method in [MergeMethod::Mean, MergeMethod::Refit, MergeMethod::Information] {
        let merged = merged(four_patches(), method);
        let report = &merged.report;
        assert!(report.watertight && report.nonmanifold_edges == 0, "{method:?}: {report:?}");
        let (normalized, error) = errors(&merged);
        println!(
            "{method:?}: rms {error:.5} for σ {SIGMA}, over σ {normalized:.3}, {} triangles",
            report.triangles
        );
        assert!((0.8..1.25).contains(&normalized), "{method:?}: {normalized}");
        rms.push(error);
    }
    assert!(rms[0] < 0.95 * SIGMA && rms[2] < 0.7 * rms[0], "{rms:?}");
}

/// A refit does not reduce correlated noise, and σ includes this. Patches of models and of scans with pose
/// errors have such noise.
#[test]
fn sigma_is_correct_for_correlated_errors_of_neighbours() {
    for smooth in [0.5, 1.0] {
        for method in [MergeMethod::Mean, MergeMethod::Refit, MergeMethod::Information] {
            let (normalized, error) = errors(&merged(four_patches_with(smooth), method));
            println!("{smooth} smooth, {method:?}: rms {error:.5} for σ {SIGMA}, over σ {normalized:.3}");
            assert!((0.75..1.35).contains(&normalized), "{smooth} {method:?}: {normalized}");
        }
    }
}

/// σ is multiplied in the patches, which keep their noise.
fn with_sigma(mut patches: Vec<NamedPatch>, factors: [f64; 4]) -> Vec<NamedPatch> {
    for (patch, factor) in patches.iter_mut().zip(factors) {
        patch.tidied.patch.sigma.iter_mut().for_each(|s| *s *= factor);
    }
    patches
}

/// The texts of the findings with a code.
fn texts(merged: &Merged, code: FindingCode) -> Vec<&str> {
    merged.report.findings.iter().filter(|f| f.code == code).map(|f| f.text.as_str()).collect()
}

/// A σ that is too small is found by the differences of patches and enlarged, for white and smooth errors;
/// with the right σ nothing is found. A stated σ can be kept.
#[test]
fn sigma_that_is_too_small_is_enlarged_and_reported() {
    for smooth in [0.0, 0.5] {
        let patches = four_patches_with(smooth);
        let right = merged(patches.clone(), MergeMethod::Mean);
        assert!(texts(&right, FindingCode::SensorSigmaMisstated).is_empty(), "{:?}", right.report.findings);
        assert!(texts(&right, FindingCode::SharedErrors).is_empty(), "{:?}", right.report.findings);
        let small = with_sigma(patches, [1.0 / 3.0; 4]);
        let corrected = merged(small.clone(), MergeMethod::Mean);
        let (normalized, _) = errors(&corrected);
        println!("{smooth} smooth: over σ {normalized:.3}, {:?}", corrected.report.patches);
        assert_eq!(texts(&corrected, FindingCode::SensorSigmaMisstated).len(), 4);
        assert!((0.75..1.3).contains(&normalized), "{normalized}");
        let set = PatchSet { patches: small, ..PatchSet::default() };
        let options = MergeOptions { believe_sigma: true, ..MergeOptions::default() };
        let believed = merge(set, &options, &Silent).expect("a merged mesh");
        assert!(errors(&believed).0 > 2.0);
        assert_eq!(texts(&believed, FindingCode::SensorSigmaMisstated).len(), 4);
    }
}

/// Of four patches, the one whose σ is wrong is named, and the σ of the others stay.
#[test]
fn the_patch_with_the_wrong_sigma_is_named() {
    let patches = with_sigma(four_patches(), [1.0, 1.0, 0.25, 1.0]);
    let merged = merged(patches, MergeMethod::Mean);
    let misstated = texts(&merged, FindingCode::SensorSigmaMisstated);
    assert!(misstated.len() == 1 && misstated[0].starts_with("patch 2:"), "{misstated:?}");
    let factors: Vec<f64> = merged.report.patches.iter().filter_map(|p| p.sigma_factor).collect();
    println!("{factors:?}, over σ {:.3}", errors(&merged).0);
    assert!((3.0..5.0).contains(&factors[2]), "{factors:?}");
    assert!((0.8..1.25).contains(&errors(&merged).0));
}

/// Patches with the same errors, such as two models of one scan, do not make σ smaller.
#[test]
fn shared_errors_do_not_reduce_sigma() {
    let mut patches = four_patches();
    let mut again = patches.clone();
    for (k, patch) in again.iter_mut().enumerate() {
        patch.name = format!("copy {k}");
        // Far more than rounding, far less than σ.
        for p in &mut patch.tidied.patch.mesh.positions {
            *p = (1.0 + 1e-4) * *p;
        }
    }
    let alone = merged(patches.clone(), MergeMethod::Mean);
    patches.extend(again);
    let both = merged(patches, MergeMethod::Mean);
    let (of_one, of_both) = (errors(&alone).0, errors(&both).0);
    println!("over σ {of_one:.3} without and {of_both:.3} with copies: {:?}", both.report.findings);
    assert!(of_both < 1.25, "{of_both}");
}

/// A hole in all patches is filled with continued curvature, marked, and within its σ. The output includes
/// its curvature.
#[test]
fn a_hole_is_filled_with_continued_curvature() {
    let mut patches = four_patches();
    for patch in &mut patches {
        let mut mesh = patch.tidied.patch.mesh.clone();
        mesh.triangles.retain(|t| t.iter().all(|v| mesh.positions[*v as usize][2] < 8.5));
        let sigma = vec![SIGMA; mesh.positions.len()];
        patch.tidied = MergePatch::make_manifold(&mesh, &sigma).expect("a patch");
    }
    let set = PatchSet { patches, ..PatchSet::default() };
    let options = MergeOptions { fill: Some(1000), curvature: true, ..MergeOptions::default() };
    let merged = merge(set, &options, &Silent).expect("a merged mesh");
    let report = &merged.report;
    let filled = report.filled.as_ref().expect("lids");
    assert!(report.watertight && report.nonmanifold_edges == 0, "{report:?}");
    assert_eq!((filled.holes, filled.outer_rims, filled.unfilled), (1, 0, 0), "{filled:?}");
    let lid: Vec<usize> = (0..merged.mesh.positions.len()).filter(|v| merged.observed[*v] == 2).collect();
    assert_eq!(lid.len(), filled.vertices);
    let off = |v: usize| {
        let p = merged.mesh.positions[v];
        (p.length() - radius(p.try_normalize().expect("a direction"))).abs()
    };
    let covered = lid.iter().filter(|v| off(**v) < 1.96 * merged.sigma[**v]).count();
    let worst = lid.iter().map(|v| off(*v)).fold(0.0, f64::max);
    println!("{} vertices, {covered} within 1.96 σ, off by {worst:.3} at most", lid.len());
    // A flat lid is off by 1.5.
    assert!(lid.len() > 100 && worst < 0.5 && 100 * covered >= 95 * lid.len());
    let curvature = merged.curvature.expect("curvature");
    let mean: f64 = lid.iter().map(|v| curvature.mean[*v]).sum::<f64>() / lid.len() as f64;
    assert!((mean + 0.1).abs() < 0.04, "{mean}");
}

/// The two sides of a plate thinner than an edge keep their orientations if σ separates them. A sheet that
/// faces against an overlapping one is reversed.
#[test]
fn sides_of_a_thin_plate_keep_their_orientation() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut side = |from: f64, height: f64, down: bool| {
        let mut mesh = planish_mesh::grid_sheet(40.0, 30.0, 40, 30);
        for p in &mut mesh.positions {
            *p = DVec3::new(p[0] + from, p[1], height + 0.02 * normal(&mut rng));
        }
        if down {
            mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let sigma = vec![0.02; mesh.positions.len()];
        NamedPatch {
            name: format!("{from} {height}"),
            tidied: MergePatch::make_manifold(&mesh, &sigma).expect("a patch"),
            observed: Vec::new(),
        }
    };
    let plate =
        vec![side(0.0, 0.0, false), side(25.3, 0.0, false), side(0.0, -0.35, true), side(25.3, -0.35, true)];
    let joined = merged(plate, MergeMethod::Mean);
    assert!(joined.report.patches.iter().all(|p| !p.reversed), "{:?}", joined.report);
    assert!(joined.report.parts == 2 && joined.report.nonmanifold_edges == 0);
    let turned = merged(vec![side(0.0, 0.0, false), side(25.3, 0.0, true)], MergeMethod::Mean);
    assert!(turned.report.patches.iter().any(|p| p.reversed) && turned.report.parts == 1);
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
        let near = off.iter().filter(|o| **o <= 0.2).count() as f64 / off.len() as f64;
        println!("{order:?}: {median:.4} σ in the median, {p95:.3} σ at 95 %, {near:.4} of all within 0.2 σ");
        assert!(near == 1.0, "{order:?}: {near}, {median}, {p95}");
    }
}

#[test]
fn a_merged_ball_becomes_one_spline_with_the_sigma_of_the_mesh() {
    is_one_spline_with_the_sigma_of_the_mesh(MergeMethod::Information, 1.3);
    // σ of the mean changes from vertex to vertex with the number of patches, which a surface does not
    // follow.
    is_one_spline_with_the_sigma_of_the_mesh(MergeMethod::Mean, 1.5);
}

/// Merges patches of a ball to one spline whose σ is up to `most` times that of the mesh.
fn is_one_spline_with_the_sigma_of_the_mesh(method: MergeMethod, most: f64) {
    let merged = merged(four_patches(), method);
    let spline = merged_spline(&merged, 0, &Silent).expect("a ball has no handles");
    let report = &spline.report;
    println!(
        "{} of {} control vertices, rms {:.4} from the mesh, σ {:.4} (mesh {:.4}), variances times {:.1}",
        report.topology.shape,
        report.coefficients,
        report.rms,
        report.sigma.median,
        merged.report.sigma.median,
        report.variance_factor
    );
    assert_eq!(report.topology.shape, "ball");
    // Vertices that no other patch shares keep their noise, and are smoothed.
    let squares: f64 = merged.sigma.iter().map(|s| s * s).sum();
    let rms_sigma = (squares / merged.sigma.len() as f64).sqrt();
    assert!(report.rms < 1.2 * rms_sigma, "σ {rms_sigma}: {report:?}");
    let ratio = report.sigma.median / merged.report.sigma.median;
    assert!((0.8..most).contains(&ratio), "σ {ratio} times the mesh's");
    // Against the truth, at places that no vertex is at.
    let truth: Vec<DVec3> = icosphere(1.0, 4)
        .positions
        .iter()
        .map(|p| {
            let DVec3 { x, y, z } = *p;
            let d = DVec3::new(x + 0.01, y - 0.013, z + 0.007).try_normalize().expect("a direction");
            radius(d) * d
        })
        .collect();
    let reference = Reference { points: truth, ..Reference::default() };
    let compared =
        compare(&Compared::Surface(Box::new(spline.model)), reference, &CompareOptions::default(), &Silent)
            .expect("a comparison");
    let covered = compared.coverage95.expect("σ");
    println!("{covered:.3} within 1.96 σ");
    assert!(covered > 0.9, "{covered}");
}

/// Two overlapping halves of a torus, and its outer and inner half: the spline has the handle, and a valid
/// B-rep.
#[test]
fn a_merged_torus_becomes_one_spline_with_a_handle() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (large, small) = (10.0, 4.0);
    let [columns, rows] = [96_u32, 48];
    let torus = |shift: f64| {
        let at = |k: u32, n: u32| std::f64::consts::TAU * (f64::from(k) + shift) / f64::from(n);
        let places: Vec<(f64, f64)> =
            (0..columns * rows).map(|k| (at(k % columns, columns), at(k / columns, rows))).collect();
        let corner = |i: u32, j: u32| j % rows * columns + i % columns;
        let triangles: Vec<[u32; 3]> = (0..columns * rows)
            .flat_map(|k| {
                let [i, j] = [k % columns, k / columns];
                let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        (places, triangles)
    };
    let mut half = |number: usize, is_inside: &dyn Fn(f64, f64) -> bool| {
        let (places, mut triangles) = torus(0.25 * number as f64);
        triangles.retain(|t| t.iter().all(|v| is_inside(places[*v as usize].0, places[*v as usize].1)));
        let position = |&(u, v): &(f64, f64), r: f64| {
            DVec3::new((large + r * v.cos()) * u.cos(), (large + r * v.cos()) * u.sin(), r * v.sin())
        };
        let positions = places.iter().map(|at| position(at, small + SIGMA * normal(&mut rng))).collect();
        let mesh = planish_mesh::TriangleMesh::try_new(positions, triangles).expect("a mesh");
        let sigma = vec![SIGMA; mesh.positions.len()];
        NamedPatch {
            name: format!("half {number}"),
            tidied: MergePatch::make_manifold(&mesh, &sigma).expect("a patch"),
            observed: Vec::new(),
        }
    };
    let patches = vec![
        half(0, &|u, _| u.sin() > -0.2),
        half(1, &|u, _| u.sin() < 0.2),
        half(2, &|_, v| v.cos() > -0.1),
    ];
    let merged = merge(PatchSet { patches, ..PatchSet::default() }, &MergeOptions::default(), &Silent);
    let spline = merged_spline(&merged.expect("halves overlap"), 0, &Silent).expect("one part");
    let topology = &spline.report.topology;
    assert_eq!((topology.genus, topology.borders), (1, 0), "{topology}");
    assert!(spline.report.rms < 2.0 * SIGMA, "{:?}", spline.report);
    let brep = planish::export::brep_from_model(
        &spline.model,
        planish::export::Closing::Auto,
        &planish::export::BrepOptions::default(),
    );
    brep.check(1e-6).expect("faces that meet");
    assert!(brep.closed);
}

#[test]
fn other_topologies_than_sheet_tube_and_ball_stay_meshes() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut patches = four_patches();
    patches.truncate(2);
    let mut far = patch("far", DVec3::Z, 0.0, 0.0, 0.0, &mut rng);
    for p in &mut far.tidied.patch.mesh.positions {
        p[0] += 100.0;
    }
    patches.push(far);
    let set = PatchSet { patches, ..PatchSet::default() };
    let merged = merge(set, &MergeOptions::default(), &Silent).expect("two of three overlap");
    let refused = merged_spline(&merged, 0, &Silent).expect_err("two parts").to_string();
    assert!(refused.contains("found 2 (the second has"), "{refused}");
}

/// A patch with a pose error makes two layers or a step. After alignment, the result is as good as with the
/// correct pose.
#[test]
fn misaligned_patches_are_aligned_first() {
    let mut patches = four_patches();
    let off = Pose::from_rotation_vector(DVec3::new(0.006, -0.004, 0.005), DVec3::new(0.08, -0.06, 0.1));
    for p in &mut patches[2].tidied.patch.mesh.positions {
        *p = off.apply(*p);
    }
    let set = PatchSet { patches, ..PatchSet::default() };
    let merged = |align: bool| {
        let options = MergeOptions { align, ..MergeOptions::default() };
        merge(set.clone(), &options, &Silent)
    };
    let aligned = merged(true).expect("a merged mesh");
    let (normalized, rms) = errors(&aligned);
    let pose = &aligned.report.poses[2];
    println!("rms {rms:.4}, over σ {normalized:.2}; moved by {:?}", pose.moved);
    assert!(normalized < 1.3, "{normalized}");
    assert!(aligned.report.watertight);
    // Without an alignment, the patch is named, and its σ includes its displacement.
    let left = merged(false).expect("a merged mesh");
    let misstated = texts(&left, FindingCode::SensorSigmaMisstated);
    assert!(
        misstated.iter().any(|text| text.starts_with("patch 2:") && text.contains("common displacement")),
        "{misstated:?}"
    );
    assert!(errors(&left).1 > 1.2 * rms && errors(&left).0 < 1.5, "{:?} {rms}", errors(&left));
}
