//! How fast fields and weights are: `cargo bench -p planish-shell --bench shell`.
//!
//! Fields: a ball of 20 480 facets, 200 000 places within a hundredth of its radius of it, and the sharpness
//! and the reach with which a fit ends: softness `1/k` a thousandth of the mesh's diagonal, terms below
//! `exp(−9)` left out. "Facets" is how many of them count at a place. In brackets: by processor time, as if
//! no other program ran. Weights: 50 000 vertices under 200 controls anywhere in the box about them.
#![allow(clippy::print_stdout, reason = "a bench prints its table")]
#![allow(clippy::unwrap_used, reason = "a bench stops at the first surprise")]

use planish_core::DVec3;
use planish_mesh::{BoundingBox, icosphere};
use planish_shell::{Dirichlet, Metaball, NaturalNeighbours, Shell, ShellOptions};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::time::Instant;

const PLACES: usize = 200_000;
const ROUNDS: usize = 3;

/// Seconds of processor time of this process; `None` on systems without `/proc`.
fn processor_seconds() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = status.rsplit(')').next()?.split_whitespace().skip(11);
    let ticks: f64 = fields.next()?.parse::<f64>().ok()? + fields.next()?.parse::<f64>().ok()?;
    Some(ticks / 100.0)
}

/// The shortest of some runs in seconds, and an estimate of its time on an idle machine: its processor time
/// divided by the number of threads.
fn shortest(mut run: impl FnMut()) -> [f64; 2] {
    let threads = rayon::current_num_threads() as f64;
    (0..ROUNDS)
        .map(|_| {
            let (start, before) = (Instant::now(), processor_seconds());
            run();
            let used = processor_seconds().zip(before).map_or(f64::NAN, |(after, before)| after - before);
            [start.elapsed().as_secs_f64(), used / threads]
        })
        .fold([f64::INFINITY; 2], |shortest, run| [0, 1].map(|k| run[k].min(shortest[k])))
}

/// Places a second, as it went and by processor time, in thousands.
fn rates(seconds: [f64; 2]) -> String {
    let [wall, alone] = seconds.map(|seconds| PLACES as f64 / seconds / 1e3);
    format!("{wall:.0} ({alone:.0})")
}

fn main() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let ball = icosphere(1.0, 5);
    let size = BoundingBox::from_points(&ball.positions).unwrap().diagonal();
    let places: Vec<DVec3> = (0..PLACES)
        .map(|_| {
            let at: DVec3 = DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
            let length = at.length();
            let radius = random.random_range(0.99..1.01);
            at.map(|x| x * radius / length)
        })
        .collect();
    println!("{} threads, {} facets, {PLACES} places", rayon::current_num_threads(), ball.triangles.len());
    println!(
        "{:<12} {:>9} {:>8} {:>14} {:>14}",
        "metaball", "softness", "facets", "distance + ∇/s", "field/s"
    );
    for metaball in [Metaball::Triangular, Metaball::Spherical] {
        for softness in [1e-3, 3e-3] {
            let options =
                ShellOptions { reach: Some(9.0), ..ShellOptions::new(metaball, 1.0 / (softness * size)) };
            let shell = Shell::new(&ball, &options).unwrap();
            let mut shares = Vec::new();
            let counted: usize = (places.iter().step_by(100))
                .map(|at| {
                    shell.distance(*at, &mut shares).unwrap();
                    shares.len()
                })
                .sum();
            let of_distance = shortest(|| {
                let sum: f64 = (places.par_chunks(1024))
                    .map(|places| {
                        let mut shares = Vec::new();
                        (places.iter())
                            .map(|at| {
                                let found = shell.distance(*at, &mut shares).unwrap();
                                found.distance + found.gradient[0]
                            })
                            .sum::<f64>()
                    })
                    .sum();
                std::hint::black_box(sum);
            });
            let of_field = shortest(|| {
                let sum: f64 = (places.par_iter().with_min_len(1024)).map(|at| shell.field(*at)).sum();
                std::hint::black_box(sum);
            });
            println!(
                "{:<12} {softness:>9} {:>8.1} {:>20} {:>20}",
                format!("{metaball:?}"),
                counted as f64 / (PLACES / 100) as f64,
                rates(of_distance),
                rates(of_field),
            );
        }
    }
    let mut random_points = |count: usize| -> Vec<DVec3> {
        (0..count)
            .map(|_| DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0))))
            .collect()
    };
    let (controls, vertices) = (random_points(200), random_points(50_000));
    let neighbours = NaturalNeighbours::new(&controls, &vertices).unwrap();
    let of_weights = shortest(|| {
        std::hint::black_box(neighbours.weights_of_all(&vertices).unwrap());
    });
    let of_deformation = shortest(|| {
        std::hint::black_box(Dirichlet::new(&controls, &vertices).unwrap());
    });
    println!(
        "Sibson weights of {} vertices under {} controls: {:.3} s ({:.3} s by processor time); a whole \
        Dirichlet deformation: {:.3} s ({:.3} s)",
        vertices.len(),
        controls.len(),
        of_weights[0],
        of_weights[1],
        of_deformation[0],
        of_deformation[1]
    );
}
