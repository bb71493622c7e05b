//! Times of sparse information on bicubic grids: `cargo bench -p planish-estimate --bench sparse`.
//!
//! One row per problem: best of several runs in milliseconds, with reused memory. `ratio` is the time of the
//! selected inverse divided by that of the factorisation.
#![allow(clippy::print_stdout, reason = "a bench prints its table")]
#![allow(clippy::unwrap_used, reason = "a bench stops at the first error")]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use planish_estimate::sparse::{
    BlockInformation, BlockPattern, CholeskyFactor, ElementScatter, NodeOrdering, SelectedInverse,
    SymbolicFactor,
};

fn best<T>(runs: usize, mut work: impl FnMut() -> T) -> (f64, T) {
    let mut result = None;
    let mut minimum = f64::INFINITY;
    for _ in 0..runs {
        drop(result.take());
        let start = Instant::now();
        result = Some(black_box(work()));
        minimum = minimum.min(start.elapsed().as_secs_f64() * 1e3);
    }
    (minimum, result.unwrap())
}

fn row(name: &str, across: usize, along: usize, periodic: bool, b: usize, dissect: bool) {
    let nodes = across * along;
    let mut elements: Vec<Vec<u32>> = Vec::new();
    for v in 0..along - 3 {
        for u in 0..if periodic { across } else { across - 3 } {
            let at = |k: usize| ((v + k / 4) * across + (u + k % 4) % across) as u32;
            elements.push((0..16).map(at).collect());
        }
    }
    let coordinates: Vec<[f64; 2]> =
        (0..nodes).map(|node| [(node % across) as f64, (node / across) as f64]).collect();

    let (pattern_ms, pattern) = best(3, || Arc::new(BlockPattern::from_elements(nodes, &elements).unwrap()));
    let (order_ms, ordering) = best(3, || {
        if dissect {
            NodeOrdering::nested_dissection(&pattern, &coordinates).unwrap()
        } else {
            NodeOrdering::amd(&pattern).unwrap()
        }
    });
    let (symbolic_ms, symbolic) =
        best(3, || Arc::new(SymbolicFactor::analyse(&pattern, &ordering, b).unwrap()));

    let maps: Vec<_> = elements.iter().map(|nodes| ElementScatter::new(&pattern, nodes).unwrap()).collect();
    let size = 16 * b;
    let weights: Vec<f64> = (0..size).map(|k| ((k * 7 + 3) % 11) as f64 / 11.0 - 0.4).collect();
    let matrix: Vec<f64> = (0..size * size)
        .map(|k| weights[k / size] * weights[k % size] + if k / size == k % size { 1.0 } else { 0.0 })
        .collect();
    let (add_ms, information) = best(3, || {
        let mut information = BlockInformation::zeros(Arc::clone(&pattern), b, 3 / b).unwrap();
        for map in &maps {
            information.add_scattered(map, &matrix, &[1.0; 48]).unwrap();
        }
        information
    });
    let mut factor = CholeskyFactor::factorize(&symbolic, &information).unwrap();
    let mut factor_ms = f64::INFINITY;
    for _ in 0..7 {
        let start = Instant::now();
        factor = factor.refactorize(&information).unwrap();
        factor_ms = factor_ms.min(start.elapsed().as_secs_f64() * 1e3);
    }
    let (solve_ms, _) = best(5, || {
        let mut x = information.vector().to_vec();
        factor.solve_in_place(&mut x).unwrap();
        x
    });
    let mut selected = SelectedInverse::new(&factor);
    let mut inverse_ms = f64::INFINITY;
    for _ in 0..5 {
        let start = Instant::now();
        selected = selected.refresh(&factor);
        inverse_ms = inverse_ms.min(start.elapsed().as_secs_f64() * 1e3);
    }
    println!(
        "{name:<28} {:>7} {b:>2} {pattern_ms:>8.1} {order_ms:>8.1} {symbolic_ms:>8.1} {add_ms:>8.1} \
         {factor_ms:>8.1} {solve_ms:>7.1} {inverse_ms:>8.1} {:>6.2} {:>8.2} {:>7.2} {:>7}",
        nodes * b,
        inverse_ms / factor_ms,
        symbolic.factor_entries() as f64 / 1e6,
        symbolic.flops() / 1e9,
        selected.bytes() >> 20,
    );
}

fn main() {
    println!(
        "{:<28} {:>7} {:>2} {:>8} {:>8} {:>8} {:>8} {:>8} {:>7} {:>8} {:>6} {:>8} {:>7} {:>7}",
        "grid",
        "n",
        "b",
        "pattern",
        "order",
        "symbolic",
        "add",
        "factor",
        "solve",
        "inverse",
        "ratio",
        "1e6 nnz",
        "Gflop",
        "MiB"
    );
    row("200x200 open", 200, 200, false, 1, true);
    row("200x200 open, AMD", 200, 200, false, 1, false);
    row("200x200 periodic", 200, 200, true, 1, true);
    row("64x64 periodic", 64, 64, true, 1, true);
    row("64x64 periodic", 64, 64, true, 3, true);
    row("96x96 periodic", 96, 96, true, 3, true);
}
