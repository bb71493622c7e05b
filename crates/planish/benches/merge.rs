//! Two patches of a million triangles each into one, from files to a file:
//! `cargo bench -p planish --bench merge`; a number after `--` is that of the vertices along a side.
//!
//! Four tenths of each patch lie on the other. A row for each method: seconds of each stage and of all, edges
//! of the result that are not right, and vertices with more than six edges.
#![allow(clippy::print_stdout, reason = "a bench prints its table")]
#![allow(clippy::unwrap_used, reason = "a bench stops at the first surprise")]

use planish::Unit;
use planish::merge::{MergeMethod, MergeOptions, merge, read_patches, write_merged};
use planish::progress::Progress;
use planish_core::DVec3;
use planish_exchange::mesh::{Column, MeshColumns, write_mesh};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::Instant;

const SIGMA: f64 = 0.02;
/// Length of a patch, and shift of the second against the first.
const LENGTH: f64 = 100.0;
const SHIFT: f64 = 60.0;

/// The time at which each stage was first reported.
#[derive(Default)]
struct Stages(RefCell<Vec<(String, Instant)>>);

impl Progress for Stages {
    fn advance(&self, stage: &str, _share: f64) {
        let mut stages = self.0.borrow_mut();
        if stages.last().is_none_or(|(last, _)| last != stage) {
            stages.push((stage.to_owned(), Instant::now()));
        }
    }
}

fn write_patch(folder: &Path, name: &str, begin: f64, side: usize, random: &mut ChaCha8Rng) -> PathBuf {
    let step = LENGTH / (side - 1) as f64;
    let points: Vec<DVec3> = (0..side * side)
        .map(|k| {
            let noise: f64 = StandardNormal.sample(random);
            // A quarter of a step apart, so that vertices do not lie on one another.
            let [x, y] =
                [begin + step * (k % side) as f64, (step * (k / side) as f64) + 0.25 * step * begin.signum()];
            DVec3::new(x, y, 4.0 * (0.11 * x).sin() * (0.09 * y).cos() + SIGMA * noise)
        })
        .collect();
    let triangles: Vec<[u32; 3]> = (0..(side - 1) * (side - 1))
        .flat_map(|k| {
            let v = (k / (side - 1) * side + k % (side - 1)) as u32;
            let above = v + side as u32;
            [[v, v + 1, above + 1], [v, above + 1, above]]
        })
        .collect();
    let sigma = vec![SIGMA; points.len()];
    let path = folder.join(name);
    let columns = MeshColumns {
        points: &points,
        triangles: &triangles,
        columns: vec![("sigma", Column::F64(&sigma))],
        unit: Some(Unit::Millimetre),
        ..MeshColumns::default()
    };
    write_mesh(&path, &columns).unwrap();
    path
}

fn main() {
    let side = std::env::args().filter_map(|a| a.parse().ok()).next().unwrap_or(708);
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let files = [("left.ply", 0.0), ("right.ply", SHIFT)]
        .map(|(name, begin)| write_patch(folder.path(), name, begin, side, &mut random));
    for method in [MergeMethod::Mean, MergeMethod::Refit, MergeMethod::Information] {
        let options = MergeOptions { method, ..MergeOptions::default() };
        let (stages, begun) = (Stages::default(), Instant::now());
        let set = read_patches(&files, None, None, None).unwrap();
        let merged = merge(set, &options, &stages).unwrap();
        write_merged(&merged, &folder.path().join("whole.ply"), &stages).unwrap();
        let end = Instant::now();
        let recorded = stages.0.borrow();
        let ends = recorded.iter().skip(1).map(|(_, at)| *at).chain([end]);
        println!(
            "{method:?}: {:.2} s, {} triangles, {} edges of three and more, {} open, valences {:?}",
            (end - begun).as_secs_f64(),
            merged.report.triangles,
            merged.report.nonmanifold_edges,
            merged.report.boundary_edges,
            merged.report.valence,
        );
        for ((stage, at), until) in recorded.iter().zip(ends) {
            println!("    {stage:<28} {:.2}", (until - *at).as_secs_f64());
        }
    }
}
