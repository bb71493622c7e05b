//! The table of docs/shells.md: meshes deformed by known controls, noisy points of them with gross errors,
//! and how far the fitted shell is from the truth beside a fit that is told which place of the mesh each
//! point is of.
//!
//! `cargo run --release -p planish --example shell_accuracy POINTS CONTROLS MESH...`
//!
//! `seeds=N` before a mesh gives it N deformations and sets of points, a row each. `flange:MESH` is the mesh
//! cut across its middle, with a flange glued on that lies in the plane of the cut; `fins:MESH` has a fin
//! along the edges of facets there, which run to and fro, so that it is pleated. Every edge at their roots
//! has three facets.

#![allow(clippy::print_stdout, reason = "a program whose output is its table")]

use nalgebra::{DMatrix, DVector};
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::read_mesh;
use planish_mesh::{BoundingBox, MeshSearch, TriangleMesh, sample_points};
use planish_shell::{
    Deformation, Dirichlet, Metaball, PointReading, ShellFitOptions, automatic_controls, displacements,
    fit_points, stiffness, stiffness_for_xyz,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::{HashMap, HashSet};
use std::time::Instant;

/// Of the deformation, the points and their errors.
const FIRST_SEED: u64 = 11;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize| arguments.get(k).and_then(|word| word.parse::<usize>().ok());
    let (Some(points), Some(controls)) = (number(0), number(1)) else {
        return Err(Error::input("expected POINTS CONTROLS MESH..."));
    };
    println!(
        "| mesh | facets | metaballs | open / non-manifold edges | start, σ | shell, σ | true places, σ | \
         ratio | covered | gross found | good lost | s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut seeds = 1;
    for path in &arguments[2..] {
        if let Some(count) = path.strip_prefix("seeds=").and_then(|n| n.parse::<u64>().ok()) {
            seeds = count;
            continue;
        }
        let file = read_mesh(path.rsplit(':').next().unwrap_or(path).as_ref())?;
        let mut mesh = TriangleMesh { positions: file.points, triangles: file.triangles };
        if path.starts_with("fins:") {
            mesh = with_fins(&mesh)?;
        } else if path.starts_with("flange:") {
            mesh = with_flange(&mesh)?;
        }
        for metaball in [Metaball::Triangular, Metaball::Spherical] {
            for seed in 0..seeds {
                one(path, &mesh, points, controls, (metaball, FIRST_SEED + seed))?;
            }
        }
    }
    Ok(())
}

/// The bounds of a mesh, and which of their sides is the longest.
fn longest_side(mesh: &TriangleMesh) -> Result<(BoundingBox, usize)> {
    let bounds = BoundingBox::from_points(&mesh.positions).ok_or_else(|| Error::input("an empty mesh"))?;
    let sides = bounds.max - bounds.min;
    let axis = (0..3).fold(0, |best, k| if sides[k] > sides[best] { k } else { best });
    Ok((bounds, axis))
}

/// The mesh cut where it crosses the middle of its longest side, with a flange in that plane: 6 % of its size
/// wide.
fn with_flange(mesh: &TriangleMesh) -> Result<TriangleMesh> {
    let (bounds, axis) = longest_side(mesh)?;
    // A little off, as vertices of what is symmetric lie in the middle.
    let level = bounds.center()[axis] + 1e-4 * bounds.diagonal();
    let welded = mesh.welded();
    let normals = welded.vertex_normals();
    let above: Vec<bool> = welded.positions.iter().map(|p| p[axis] > level).collect();
    let (mut positions, mut triangles) = (welded.positions.clone(), Vec::new());
    // The place on an edge, and the edge of the flange beyond it.
    let mut cuts = HashMap::new();
    let mut cut = |from: u32, to: u32| -> [u32; 2] {
        let [a, b] = [from.min(to), from.max(to)];
        *cuts.entry([a, b]).or_insert_with(|| {
            let [p, q] = [a, b].map(|v| welded.positions[v as usize]);
            let share = (level - p[axis]) / (q[axis] - p[axis]);
            let between = |p: DVec3, q: DVec3| p + share * (q - p);
            let mut outward = between(normals[a as usize], normals[b as usize]);
            outward[axis] = 0.0;
            let root = between(p, q);
            let tip = root + 0.06 * bounds.diagonal() / outward.length().max(1e-9) * outward;
            positions.extend([root, tip]);
            let count = positions.len() as u32;
            [count - 2, count - 1]
        })
    };
    let mut flange = Vec::new();
    for t in &welded.triangles {
        let side = t.map(|v| above[v as usize]);
        let Some(alone) = (0..3).find(|k| side[*k] != side[(k + 1) % 3] && side[*k] != side[(k + 2) % 3])
        else {
            triangles.push(*t);
            continue;
        };
        let [a, b, c] = [0, 1, 2].map(|k| t[(alone + k) % 3]);
        let ([p, p_tip], [q, q_tip]) = (cut(a, b), cut(a, c));
        triangles.extend([[a, p, q], [p, b, c], [p, c, q]]);
        flange.extend([[p, q, q_tip], [p, q_tip, p_tip]]);
    }
    triangles.extend(flange);
    Ok(TriangleMesh { positions, triangles })
}

/// The mesh with a fin where its facets cross the middle of its longest side: 6 % of its size high, along
/// normals.
fn with_fins(mesh: &TriangleMesh) -> Result<TriangleMesh> {
    let (bounds, axis) = longest_side(mesh)?;
    let mut made = mesh.welded();
    let normals = made.vertex_normals();
    let low: Vec<bool> = (made.triangles.iter())
        .map(|t| {
            t.iter().map(|v| made.positions[*v as usize][axis]).sum::<f64>() < 3.0 * bounds.center()[axis]
        })
        .collect();
    // Edges of the lower part that the upper has the other way round.
    let upper: HashSet<[u32; 2]> = (made.triangles.iter().zip(&low))
        .filter(|(_, low)| !**low)
        .flat_map(|(t, _)| (0..3).map(|k| [t[k], t[(k + 1) % 3]]))
        .collect();
    let roots: Vec<[u32; 2]> = (made.triangles.iter().zip(&low))
        .filter(|(_, low)| **low)
        .flat_map(|(t, _)| (0..3).map(|k| [t[k], t[(k + 1) % 3]]))
        .filter(|[a, b]| upper.contains(&[*b, *a]))
        .collect();
    let mut tips = HashMap::new();
    for [a, b] in roots {
        let [c, d] = [a, b].map(|v| {
            *tips.entry(v).or_insert_with(|| {
                let tip = made.positions[v as usize] + 0.06 * bounds.diagonal() * normals[v as usize];
                made.positions.push(tip);
                made.positions.len() as u32 - 1
            })
        });
        made.triangles.extend([[a, b, d], [a, d, c]]);
    }
    Ok(made)
}

fn one(
    path: &str,
    mesh: &TriangleMesh,
    count: usize,
    controls: usize,
    (metaball, seed): (Metaball, u64),
) -> Result<()> {
    let size = BoundingBox::from_points(&mesh.positions).map_or(0.0, |b| b.diagonal());
    let sigma = 0.002 * size;
    let controls = automatic_controls(mesh, controls)?;
    let deformation = Dirichlet::new(&controls.points, &mesh.positions)?;
    let k = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    let affine: [f64; 9] = std::array::from_fn(|_| 0.04 * normal());
    let wave: [f64; 9] = std::array::from_fn(|_| 5.0 / size * normal());
    let center = BoundingBox::from_points(&mesh.positions).map_or(DVec3::ZERO, |b| b.center());
    let q = DVector::from_iterator(
        deformation.parameters(),
        controls.points.iter().flat_map(|p| {
            let p = *p - center;
            let applied = |matrix: &[f64; 9], k: usize| (0..3).map(|j| matrix[3 * k + j] * p[j]).sum::<f64>();
            [0, 1, 2].map(|k| applied(&affine, k) + 0.015 * size * applied(&wave, k).sin())
        }),
    );
    let by = displacements(&deformation, &q);
    let truth = TriangleMesh {
        positions: mesh.positions.iter().zip(by).map(|(p, by)| *p + by).collect(),
        triangles: mesh.triangles.clone(),
    };
    let bounds = BoundingBox::from_points(&truth.positions).ok_or_else(|| Error::input("an empty mesh"))?;
    let mut places = ChaCha8Rng::seed_from_u64(12);
    let samples = sample_points(&truth, count, || places.random_range(0.0..1.0))?;
    let (mut readings, mut good) = (Vec::new(), Vec::new());
    for sample in &samples {
        let gross = places.random_range(0.0..1.0) < 0.1;
        let at = DVec3::from_array(std::array::from_fn(|k| {
            if gross {
                bounds.center()[k] + size * places.random_range(-0.5..0.5)
            } else {
                sample.position[k] + sigma * normal()
            }
        }));
        let v = sigma * sigma;
        readings.push(PointReading { at, covariance: SymmetricMatrix3::isotropic(v) });
        good.push(!gross);
    }
    let options = ShellFitOptions { metaball, stiffness: Some(k.clone()), ..ShellFitOptions::default() };
    let started = Instant::now();
    let made = fit_points(mesh, &deformation, &readings, &options)?;
    let seconds = started.elapsed().as_secs_f64();
    // The same, with the facet that each good point is of, along its normal.
    let normals = truth.face_normals();
    let basis = deformation.basis();
    let (mut information, mut vector) = (DMatrix::zeros(basis, basis), DVector::zeros(basis));
    for ((reading, sample), _) in readings.iter().zip(&samples).zip(&good).filter(|(_, good)| **good) {
        let vertices = mesh.triangles[sample.triangle as usize];
        let direction = normals[sample.triangle as usize];
        let rest = (0..3)
            .fold(DVec3::ZERO, |sum, k| sum + sample.barycentric[k] * mesh.positions[vertices[k] as usize]);
        let mut row = DVector::zeros(basis);
        for (vertex, w) in vertices.iter().zip(sample.barycentric) {
            deformation.row(*vertex, direction, &mut |k, entry| row[k] += w * entry);
        }
        vector.axpy((reading.at - rest).dot(direction) / (sigma * sigma), &row, 1.0);
        information.ger(1.0 / (sigma * sigma), &row, &row, 1.0);
    }
    let r = deformation.reduction().ok_or_else(|| Error::input("no reduction"))?;
    let equations = r.tr_mul(&(information * r)) + made.smoothness_weight * k;
    let reference = (equations.cholesky())
        .ok_or_else(|| Error::undetermined("no fit by true places"))?
        .solve(&r.tr_mul(&vector));
    let by = displacements(&deformation, &reference);
    let reference: Vec<DVec3> = mesh.positions.iter().zip(by).map(|(p, by)| *p + by).collect();

    let search = MeshSearch::try_new(&truth)?;
    // Places spread over the area, not vertices: those crowd where a mesh is fine.
    let mut spread = ChaCha8Rng::seed_from_u64(13);
    let judged = sample_points(mesh, 4000, || spread.random_range(0.0..1.0))?;
    let heights = |positions: &[DVec3]| -> Vec<f64> {
        (judged.iter())
            .map(|place| {
                let corners = mesh.triangles[place.triangle as usize];
                let at = (0..3)
                    .fold(DVec3::ZERO, |sum, k| sum + place.barycentric[k] * positions[corners[k] as usize]);
                search.closest(at).map_or(0.0, |foot| foot.distance)
            })
            .collect()
    };
    let rms = |values: &[f64]| (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt();
    let fitted_heights = heights(&made.positions);
    let reference_heights = heights(&reference);
    let before = heights(&mesh.positions);
    let mut covered = 0;
    for (place, height) in judged.iter().zip(&fitted_heights) {
        let corners = mesh.triangles[place.triangle as usize];
        let mut row = DVector::zeros(basis);
        for (vertex, w) in corners.iter().zip(place.barycentric) {
            deformation.row(*vertex, normals[place.triangle as usize], &mut |k, entry| row[k] += w * entry);
        }
        let row = r.tr_mul(&row);
        let stated = row.dot(&(&made.covariance * &row)).max(0.0).sqrt();
        covered += usize::from(height.abs() < 1.96 * stated);
    }
    let found = made.points.outliers.iter().zip(&good).filter(|(o, good)| **o && !**good).count();
    let lost = made.points.outliers.iter().zip(&good).filter(|(o, good)| **o && **good).count();
    let good_count = good.iter().filter(|good| **good).count();
    let check = mesh.welded().check();
    let fins = match path.split_once(':') {
        Some(("fins", _)) => ", with a fin",
        Some(("flange", _)) => ", with a flange",
        _ => "",
    };
    let name = format!("{}{fins}", path.rsplit('/').next().unwrap_or(path));
    println!(
        "| {name} | {} | {metaball:?} | {} / {} | {:.2} | {:.3} | {:.3} | {:.2} | {:.3} | {:.3} | {:.4} | \
         {seconds:.1} |",
        mesh.triangles.len(),
        check.boundary_edges,
        check.nonmanifold_edges,
        rms(&before) / sigma,
        rms(&fitted_heights) / sigma,
        rms(&reference_heights) / sigma,
        rms(&fitted_heights) / rms(&reference_heights),
        covered as f64 / judged.len() as f64,
        found as f64 / (good.len() - good_count) as f64,
        lost as f64 / good_count as f64
    );
    Ok(())
}
