//! One target, one fit, every deformation: `cargo run --release -p planish-shell --example deformations`.
//!
//! A ball of 2562 vertices is bent by a smooth motion that none of the deformations can make exactly; 20 000
//! points of it, with σ of a thousandth of its size and a tenth of them anywhere, are what each is fitted to.
//! A row each: parameters, rms distance of the fitted vertices from the true surface, and seconds. With a
//! folder (`-- FOLDER`) the ball, the points and dense places of the truth with their normals are written
//! there, for peers; `-- FOLDER NAME` makes only the rows whose name begins so.
#![allow(clippy::print_stdout, reason = "an example prints its table")]
#![allow(clippy::unwrap_used, reason = "an example stops at the first surprise")]

use nalgebra::DMatrix;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_mesh::{BoundingBox, MeshSearch, TriangleMesh, icosphere, sample_points};
use planish_shell::{
    Deformation, Dirichlet, Lattice, LatticeBasis, Modes, PointReading, ShellFitOptions, VertexDisplacements,
    automatic_controls, fit_points, nearest_pairs, stiffness, stiffness_for_xyz,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// Neighbours that points without a triangulation are joined to.
const NEIGHBOURS: usize = 6;

/// A bend, a twist and a bulge of so much.
fn bent(p: DVec3, [bend, twist, bulge]: [f64; 3]) -> DVec3 {
    let DVec3 { x, y, z } = p;
    let (s, c) = (twist * z).sin_cos();
    let grown = 1.0 + bulge * (-4.0 * ((x - 0.6).powi(2) + y * y)).exp();
    DVec3::new(grown * (c * x - s * y) + bend * z * z, grown * (s * x + c * y), z * (1.0 + 0.3 * bend * x))
}

/// What a peer needs for the same task.
fn written(
    folder: &Path,
    ball: &TriangleMesh,
    points: &[PointReading],
    truth: &TriangleMesh,
) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let mut text = String::new();
    for DVec3 { x, y, z } in &ball.positions {
        writeln!(text, "v {x} {y} {z}").unwrap();
    }
    for t in &ball.triangles {
        writeln!(text, "f {} {} {}", t[0] + 1, t[1] + 1, t[2] + 1).unwrap();
    }
    std::fs::write(folder.join("ball.obj"), text)?;
    let mut text = String::from("x,y,z,sigma\n");
    for point in points {
        let DVec3 { x, y, z } = point.at;
        writeln!(text, "{x},{y},{z},{}", point.covariance.xx.sqrt()).unwrap();
    }
    std::fs::write(folder.join("points.csv"), text)?;
    let mut text = String::from("x,y,z,nx,ny,nz\n");
    for (DVec3 { x, y, z }, n) in truth.positions.iter().zip(truth.vertex_normals()) {
        writeln!(text, "{x},{y},{z},{},{},{}", n.x, n.y, n.z).unwrap();
    }
    std::fs::write(folder.join("truth.csv"), text)
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    // Vertices that may each move are many unknowns: the coarse ball is for them.
    let (ball, coarse) = (icosphere(1.0, 4), icosphere(1.0, 3));
    let moved = |mesh: &TriangleMesh, how: [f64; 3]| TriangleMesh {
        positions: mesh.positions.iter().map(|p| bent(*p, how)).collect(),
        triangles: mesh.triangles.clone(),
    };
    let truth = moved(&icosphere(1.0, 6), [0.25, 0.4, 0.15]);
    let size = BoundingBox::from_points(&truth.positions).unwrap().diagonal();
    let sigma = 1e-3 * size;
    let places = sample_points(&truth, 20_000, || random.random()).unwrap();
    let points: Vec<PointReading> = (places.iter().enumerate())
        .map(|(k, place)| PointReading {
            at: DVec3::from_array(std::array::from_fn(|axis| {
                let noise: f64 = StandardNormal.sample(&mut random);
                match k % 10 {
                    0 => random.random_range(-1.2..1.2),
                    _ => place.position[axis] + sigma * noise,
                }
            })),
            covariance: SymmetricMatrix3::isotropic(sigma * sigma),
        })
        .collect();
    let search = MeshSearch::try_new(&truth).unwrap();
    let joined = |controls: &[DVec3], triangles: &[[u32; 3]], edges: &[[u32; 2]]| -> DMatrix<f64> {
        stiffness_for_xyz(&stiffness(controls, triangles, edges))
    };
    let controls = automatic_controls(&ball, 60).unwrap();
    let by_controls = joined(&controls.points, &controls.triangles, &controls.edges);
    let lattice = Lattice::new(&ball.positions, [5, 5, 5], LatticeBasis::CubicBSpline).unwrap();
    let of_lattice = Deformation::controls(&lattice).unwrap().to_vec();
    let by_lattice = joined(&of_lattice, &[], &nearest_pairs(&of_lattice, NEIGHBOURS));
    let vertices = VertexDisplacements::new(&coarse.positions);
    let by_vertices = joined(&coarse.positions, &coarse.triangles, &[]);
    let family: Vec<Vec<DVec3>> = (0..30)
        .map(|_| {
            let how = [(); 3].map(|()| random.random_range(-0.5..0.5));
            moved(&ball, how).positions
        })
        .collect();
    let modes = Modes::from_meshes(&family, 12).unwrap();
    let mean = TriangleMesh { positions: modes.mean().to_vec(), triangles: ball.triangles.clone() };
    let by_modes = DMatrix::identity(modes.parameters(), modes.parameters());
    let dirichlet = Dirichlet::new(&controls.points, &ball.positions).unwrap();
    println!("size {size:.3}, σ {sigma:.5}, {} points", points.len());
    println!("{:<26} {:>10} {:>12} {:>8}", "deformation", "parameters", "rms / σ", "seconds");
    let rows: [(&str, &TriangleMesh, &dyn Deformation, DMatrix<f64>); 4] = [
        ("Dirichlet, 60 controls", &ball, &dirichlet, by_controls),
        ("lattice, 5 × 5 × 5 splines", &ball, &lattice, by_lattice),
        ("vertices, 642", &coarse, &vertices, by_vertices),
        ("modes, of 30 meshes", &mean, &modes, by_modes),
    ];
    if let Some(folder) = arguments.first() {
        written(Path::new(folder), &ball, &points, &truth).unwrap();
    }
    let only = arguments.get(1).map_or("", String::as_str);
    for (name, mesh, deformation, stiffness) in rows.into_iter().filter(|row| row.0.starts_with(only)) {
        let options = ShellFitOptions { stiffness: Some(stiffness), ..ShellFitOptions::default() };
        let start = Instant::now();
        let fit = fit_points(mesh, deformation, &points, &options).unwrap();
        let seconds = start.elapsed().as_secs_f64();
        let squares: f64 = (fit.positions.iter()).map(|p| search.closest(*p).unwrap().distance.powi(2)).sum();
        println!(
            "{name:<26} {:>10} {:>12.3} {seconds:>8.2}",
            deformation.parameters(),
            (squares / fit.positions.len() as f64).sqrt() / sigma
        );
    }
}
