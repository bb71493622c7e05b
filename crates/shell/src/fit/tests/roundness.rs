//! Flat facets of meshes whose vertices are on a smooth surface, and of polyhedra.

use super::*;
use planish_mesh::parallelepiped;

const SIGMA: f64 = 0.005;

fn fitted(mesh: &TriangleMesh, points: &[PointReading]) -> (Dirichlet, ShellFit) {
    let controls = automatic_controls(mesh, 20).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let k = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
    let options = ShellFitOptions { stiffness: Some(k), ..ShellFitOptions::default() };
    let fit = fit_points(mesh, &deformation, points, &options).unwrap();
    (deformation, fit)
}

/// Vertices of a coarse ball are on the true sphere if its points are measured, and stay vertices of the
/// polyhedron if points of its facets are. Their sagitta is half of σ, and σ of the vertices a tenth.
#[test]
fn vertices_are_on_round_surfaces_and_on_polyhedra() {
    let mesh = icosphere(1.0, 3);
    let normals = mesh.vertex_normals();
    for seed in [1, 2, 3] {
        for is_round in [true, false] {
            let truth = TriangleMesh {
                positions: mesh.positions.iter().map(|p| 1.04 * *p).collect(),
                triangles: mesh.triangles.clone(),
            };
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut points = noisy_points(&truth, 6000, 0.0, 100 + seed, &mut random);
            for point in &mut points {
                let noise = DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(&mut random)));
                let on = if is_round { 1.04 * point.at.normalize() } else { point.at };
                *point = PointReading {
                    at: on + SIGMA * noise,
                    covariance: SymmetricMatrix3::isotropic(SIGMA * SIGMA),
                };
            }
            let (deformation, fit) = fitted(&mesh, &points);
            let found = fit.facet_roundness.unwrap();
            let expected = f64::from(u8::from(is_round));
            println!("{seed} {is_round}: {found:?}");
            assert!(found.sigma < 0.15 && (found.share - expected).abs() < 3.0 * found.sigma, "{found:?}");
            let [error, variance, mean] = (normals.iter().enumerate()).fold([0.0; 3], |sum, (v, n)| {
                let error = fit.positions[v].length() - 1.04;
                let sigma = fit.sigma_along(&deformation, v as u32, *n);
                [sum[0] + error * error, sum[1] + sigma * sigma, sum[2] + error]
            });
            println!("{} {}", (error / variance).sqrt(), mean / normals.len() as f64 / SIGMA);
            assert!((error / variance).sqrt() < 1.5, "{}", (error / variance).sqrt());
            // Flat facets of the mean distance of the sphere would be 0.4 σ outside of it.
            assert!((mean / normals.len() as f64).abs() < 0.12 * SIGMA, "{mean}");
        }
    }
}

/// The faces of a box are flat, whatever the triangles around its edges.
#[test]
fn boxes_are_not_inflated() {
    let mesh = parallelepiped(DVec3::ZERO, [2.0 * DVec3::X, DVec3::Y, 0.5 * DVec3::Z]);
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let points = noisy_points(&mesh, 3000, SIGMA, 5, &mut random);
    let (_, fit) = fitted(&mesh, &points);
    let off: Vec<f64> =
        mesh.positions.iter().zip(&fit.positions).map(|(rest, found)| rest.distance(*found)).collect();
    assert!(rms(&off) < 0.3 * SIGMA, "{}", rms(&off));
}
