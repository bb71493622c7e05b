//! Laws of sparse information, against dense algebra.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{ErrorKind, Result};

/// A problem on the parameter plane: elements, coordinates and random positive definite information.
struct Problem {
    elements: Vec<Vec<u32>>,
    coordinates: Vec<[f64; 2]>,
}

impl Problem {
    /// A grid of `across × along` nodes with elements of `degree + 1` nodes each way, optionally periodic in
    /// u.
    fn grid(across: usize, along: usize, degree: usize, periodic: bool) -> Self {
        let mut elements = Vec::new();
        for v in 0..along - degree {
            for u in 0..if periodic { across } else { across - degree } {
                elements.push(
                    (0..=degree)
                        .flat_map(|dv| {
                            (0..=degree).map(move |du| (((v + dv) * across) + (u + du) % across) as u32)
                        })
                        .collect(),
                );
            }
        }
        let coordinates =
            (0..across * along).map(|node| [(node % across) as f64, (node / across) as f64]).collect();
        Self { elements, coordinates }
    }

    /// Nodes scattered in the unit square, elements of up to ten nodes near a random point, in random order.
    fn scattered(nodes: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let coordinates: Vec<[f64; 2]> = (0..nodes).map(|_| [random.random(), random.random()]).collect();
        let elements = (0..nodes)
            .map(|_| {
                let (u, v): (f64, f64) = (random.random(), random.random());
                let mut near: Vec<u32> = (0..nodes as u32).collect();
                near.sort_by(|&a, &b| {
                    let distance = |node: u32| {
                        let [x, y] = coordinates[node as usize];
                        (x - u).powi(2) + (y - v).powi(2)
                    };
                    distance(a).total_cmp(&distance(b))
                });
                let mut nodes = near[..random.random_range(2..=10)].to_vec();
                nodes.reverse();
                nodes
            })
            .collect();
        Self { elements, coordinates }
    }

    fn pattern(&self) -> Arc<BlockPattern> {
        Arc::new(BlockPattern::from_elements(self.coordinates.len(), &self.elements).unwrap())
    }

    /// `Σ GᵀG` over the elements plus a small prior, with random vectors.
    fn information(
        &self,
        pattern: &Arc<BlockPattern>,
        b: usize,
        columns: usize,
        seed: u64,
    ) -> BlockInformation {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut information = BlockInformation::zeros(Arc::clone(pattern), b, columns).unwrap();
        for element in &self.elements {
            let size = element.len() * b;
            let gains = DMatrix::from_fn(size, size, |_, _| random.random_range(-1.0..1.0));
            let matrix = gains.transpose() * gains;
            let vector: Vec<f64> = (0..size * columns).map(|_| random.random_range(-1.0..1.0)).collect();
            information.add_element(element, matrix.as_slice(), &vector).unwrap();
        }
        information.add_diagonal(0.3);
        information
    }

    fn factor(&self, information: &BlockInformation) -> CholeskyFactor {
        let ordering = NodeOrdering::nested_dissection(information.pattern(), &self.coordinates).unwrap();
        factor_with(information, &ordering).unwrap()
    }
}

fn factor_with(information: &BlockInformation, ordering: &NodeOrdering) -> Result<CholeskyFactor> {
    let symbolic = SymbolicFactor::analyse(information.pattern(), ordering, information.block_size())?;
    CholeskyFactor::factorize(&Arc::new(symbolic), information)
}

fn problems() -> Vec<(&'static str, Problem)> {
    vec![
        ("open bicubic grid", Problem::grid(17, 12, 3, false)),
        ("periodic bicubic grid", Problem::grid(16, 11, 3, true)),
        ("tightly periodic grid", Problem::grid(4, 30, 3, true)),
        ("scattered", Problem::scattered(160, 7)),
        ("scattered, sparse", Problem::scattered(90, 8)),
        ("one node", Problem { elements: vec![vec![0]], coordinates: vec![[0.0, 0.0]] }),
        ("no elements", Problem { elements: Vec::new(), coordinates: vec![[1.0, 1.0]; 70] }),
    ]
}

fn assert_close(what: &str, found: &[f64], expected: &[f64], relative: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let scale = expected.iter().fold(0.0_f64, |max, value| max.max(value.abs()));
    for (at, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= relative * scale, "{what}: entry {at} is {a}, expected {b}");
    }
}

#[test]
fn accumulation_equals_the_dense_sum() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    // Unsorted nodes and a repeated node, as on a periodic surface with fewer columns than the degree
    // requires.
    let elements: [&[u32]; 4] = [&[4, 1, 2], &[0, 3], &[2, 5, 2], &[5]];
    let pattern = Arc::new(BlockPattern::from_elements(6, elements).unwrap());
    for (b, columns) in [(1, 3), (3, 1), (2, 2)] {
        let mut information = BlockInformation::zeros(Arc::clone(&pattern), b, columns).unwrap();
        let mut dense = DMatrix::zeros(6 * b, 6 * b);
        let mut vector = DMatrix::zeros(6 * b, columns);
        for nodes in elements {
            let size = nodes.len() * b;
            let half = DMatrix::from_fn(size, size, |_, _| random.random_range(-1.0..1.0));
            let matrix = &half + half.transpose();
            let part: Vec<f64> = (0..size * columns).map(|_| random.random()).collect();
            information.add_element(nodes, matrix.as_slice(), &part).unwrap();
            let unknown = |k: usize| nodes[k / b] as usize * b + k % b;
            for i in 0..size {
                for j in 0..size {
                    dense[(unknown(i), unknown(j))] += matrix[(i, j)];
                }
                for c in 0..columns {
                    vector[(unknown(i), c)] += part[i * columns + c];
                }
            }
        }
        assert_close("matrix", information.to_dense().as_slice(), dense.as_slice(), 1e-14);
        assert_close("vector", information.vector(), vector.transpose().as_slice(), 1e-14);
        assert_eq!(information.diagonal(), information.to_dense().diagonal().as_slice());

        let x: Vec<f64> = (0..6 * b * 2).map(|_| random.random()).collect();
        let wide = DMatrix::from_row_slice(6 * b, 2, &x);
        let mut product = vec![0.0; x.len()];
        information.multiply(&x, &mut product).unwrap();
        assert_close("product", &product, (&dense * &wide).transpose().as_slice(), 1e-13);
        let form = (wide.transpose() * &dense * &wide).trace();
        assert!((information.quadratic_form(&x).unwrap() - form).abs() < 1e-12);
        for (i, j) in [(4, 1), (1, 4), (2, 2)] {
            let expected = dense.view((i * b, j * b), (b, b)).transpose();
            let block = information.block(i as u32, j as u32).unwrap();
            assert_close("block", &block, expected.as_slice(), 1e-14);
        }
        assert!(information.block(0, 5).is_none());
    }
}

#[test]
fn solutions_agree_with_dense_algebra() {
    for (name, problem) in problems() {
        for (b, columns) in [(1, 3), (3, 1)] {
            let information = problem.information(&problem.pattern(), b, columns, 2);
            let dense = information.to_dense();
            let n = information.dimension();
            let factor = problem.factor(&information);
            let expected = dense
                .clone()
                .cholesky()
                .unwrap()
                .solve(&DMatrix::from_row_slice(n, columns, information.vector()))
                .transpose();
            let mut x = information.vector().to_vec();
            factor.solve_in_place(&mut x).unwrap();
            assert_close(name, &x, expected.as_slice(), 1e-9);

            let log_determinant: f64 =
                2.0 * dense.cholesky().unwrap().l().diagonal().iter().map(|value| value.ln()).sum::<f64>();
            let scale = log_determinant.abs().max(1.0);
            assert!(
                (factor.log_determinant() - log_determinant).abs() < 1e-10 * scale,
                "{name}: log-determinant"
            );

            // The two halves of a solution, and the whitened norm.
            let mut halves = information.vector().to_vec();
            factor.solve_lower_in_place(&mut halves).unwrap();
            let norm: f64 = halves.iter().map(|value| value * value).sum();
            let direct: f64 = information.vector().iter().zip(&x).map(|(a, b)| a * b).sum();
            assert!(
                (norm - direct).abs() <= 1e-9 * direct.abs(),
                "{name}: |L⁻¹Pη|² = {norm}, ηᵀΛ⁻¹η = {direct}"
            );
            factor.solve_lower_transpose_in_place(&mut halves).unwrap();
            assert_close(name, &halves, &x, 1e-10);
        }
    }
}

#[test]
fn samples_have_the_covariance() {
    // Columns of Pᵀ L⁻ᵀ: their outer products sum to the covariance.
    let problem = Problem::scattered(40, 3);
    let information = problem.information(&problem.pattern(), 3, 1, 4);
    let n = information.dimension();
    let mut identity = DMatrix::<f64>::identity(n, n);
    problem.factor(&information).solve_lower_transpose_in_place(identity.as_mut_slice()).unwrap();
    let root = identity.transpose();
    let covariance = information.to_dense().try_inverse().unwrap();
    assert_close("covariance", (&root * root.transpose()).as_slice(), covariance.as_slice(), 1e-10);
}

#[test]
fn selected_inverse_agrees_with_the_dense_inverse() {
    for (name, problem) in problems() {
        for b in [1, 3] {
            let information = problem.information(&problem.pattern(), b, 0, 5);
            let inverse = information.to_dense().cholesky().unwrap().inverse();
            let selected = SelectedInverse::new(&problem.factor(&information));
            assert_close(name, &selected.diagonal(), inverse.diagonal().as_slice(), 1e-9);
            let nodes = problem.coordinates.len() as u32;
            let mut found = 0;
            for i in 0..nodes {
                for j in 0..nodes {
                    let expected = inverse.view((i as usize * b, j as usize * b), (b, b)).transpose();
                    match selected.block(i, j) {
                        Some(block) => {
                            found += 1;
                            let scale = inverse[(i as usize * b, i as usize * b)];
                            for (a, e) in block.iter().zip(expected.iter()) {
                                assert!((a - e).abs() < 1e-9 * scale, "{name}, b = {b}: block ({i}, {j})");
                            }
                        }
                        None => assert!(
                            information.block(i, j).is_none(),
                            "{name}: coupled pair ({i}, {j}) is missing"
                        ),
                    }
                }
            }
            assert!(found >= 2 * information.pattern().entries() - nodes as usize);
            for element in &problem.elements {
                let unknowns: Vec<usize> =
                    element.iter().flat_map(|&node| (0..b).map(move |k| node as usize * b + k)).collect();
                let expected = inverse.select_rows(&unknowns).select_columns(&unknowns);
                assert_close(name, &selected.dense(element).unwrap(), expected.as_slice(), 1e-9);
            }
            assert!(selected.block(nodes, 0).is_none());
        }
    }
}

#[test]
fn traces_agree_with_dense_algebra() {
    let problem = Problem::grid(13, 12, 3, true);
    let pattern = problem.pattern();
    let penalty = problem.information(&pattern, 1, 3, 6);
    for b in [1, 3] {
        let information = problem.information(&pattern, b, 0, 7);
        let factor = problem.factor(&information);
        let wide = if b == 1 { penalty.clone() } else { penalty.expanded(b).unwrap() };
        let exact = (information.to_dense().try_inverse().unwrap() * wide.to_dense()).trace();
        let selected = SelectedInverse::new(&factor);
        for matrix in [&wide, &penalty] {
            let trace = selected.trace_with(matrix).unwrap();
            assert!((trace - exact).abs() < 1e-10 * exact, "b = {b}: {trace} instead of {exact}");
        }
        let estimate = stochastic_trace(&factor, &wide, 60, 11).unwrap();
        assert!(
            (estimate.value - exact).abs() < 4.0 * estimate.standard_error,
            "{estimate:?} instead of {exact}"
        );
        assert!(estimate.standard_error < 0.1 * exact);
        assert_eq!(estimate, stochastic_trace(&factor, &wide, 60, 11).unwrap());
        assert_ne!(estimate.value, stochastic_trace(&factor, &wide, 60, 12).unwrap().value);
    }
}

#[test]
fn the_ordering_does_not_change_the_answer() {
    for (name, problem) in problems() {
        let information = problem.information(&problem.pattern(), 3, 1, 8);
        let pattern = information.pattern();
        let reference = problem.factor(&information);
        let mut x = information.vector().to_vec();
        reference.solve_in_place(&mut x).unwrap();
        let variances = SelectedInverse::new(&reference).diagonal();
        let reversed = (0..pattern.nodes() as u32).rev().collect();
        for ordering in [
            NodeOrdering::amd(pattern).unwrap(),
            NodeOrdering::natural(pattern.nodes()),
            NodeOrdering::from_permutation(reversed).unwrap(),
        ] {
            let factor = factor_with(&information, &ordering).unwrap();
            let mut y = information.vector().to_vec();
            factor.solve_in_place(&mut y).unwrap();
            assert_close(name, &y, &x, 1e-10);
            assert_close(name, &SelectedInverse::new(&factor).diagonal(), &variances, 1e-10);
            let difference = factor.log_determinant() - reference.log_determinant();
            assert!(
                difference.abs() < 1e-10 * reference.log_determinant().abs().max(1.0),
                "{name}: {difference}"
            );
        }
    }
}

#[test]
fn orderings_are_permutations_and_keep_the_factor_sparse() {
    let problem = Problem::grid(100, 100, 3, false);
    let pattern = problem.pattern();
    let entries = |ordering: &NodeOrdering| {
        let mut nodes = ordering.old_from_new().to_vec();
        nodes.sort_unstable();
        assert!(nodes.iter().enumerate().all(|(at, &node)| at == node as usize));
        SymbolicFactor::analyse(&pattern, ordering, 1).unwrap().factor_entries()
    };
    let natural = entries(&NodeOrdering::natural(pattern.nodes()));
    let amd = entries(&NodeOrdering::amd(&pattern).unwrap());
    let dissected = entries(&NodeOrdering::nested_dissection(&pattern, &problem.coordinates).unwrap());
    assert!(
        dissected < amd && 3 * dissected < 2 * natural,
        "natural {natural}, AMD {amd}, nested dissection {dissected}"
    );
}

#[test]
fn merging_commutes_and_associates() {
    let problem = Problem::scattered(60, 12);
    let pattern = problem.pattern();
    let [a, b, c] = [13, 14, 15].map(|seed| problem.information(&pattern, 3, 1, seed));
    let sum = |parts: &[&BlockInformation]| {
        let mut total = parts[0].clone();
        for part in &parts[1..] {
            total.add_scaled(part, 1.0).unwrap();
        }
        total
    };
    let (ab, ba) = (sum(&[&a, &b]), sum(&[&b, &a]));
    assert_eq!(ab.values(), ba.values());
    assert_eq!(ab.vector(), ba.vector());
    let (left, right) = (sum(&[&ab, &c]), sum(&[&a, &sum(&[&b, &c])]));
    assert_close("matrix", left.values(), right.values(), 1e-15);
    assert_close("vector", left.vector(), right.vector(), 1e-15);

    // Subtraction of what was added.
    let mut back = left;
    back.add_scaled(&c, -1.0).unwrap();
    assert_close("difference", back.values(), ab.values(), 1e-14);

    // Another pattern is rejected; the union of both patterns accepts both.
    let other = Arc::new(BlockPattern::from_elements(60, [[0, 59]]).unwrap());
    let far = BlockInformation::zeros(Arc::clone(&other), 3, 1).unwrap();
    assert_eq!(back.add_scaled(&far, 1.0).unwrap_err().kind(), ErrorKind::Input);
    let both = Arc::new(pattern.union(&other).unwrap());
    let mut wide = a.on_pattern(&both).unwrap();
    assert_eq!(wide.to_dense(), a.to_dense());
    wide.add_scaled(&far.on_pattern(&both).unwrap(), 1.0).unwrap();
}

#[test]
fn symbolic_reuse_gives_the_same_bytes() {
    let problem = Problem::grid(20, 15, 3, true);
    let pattern = problem.pattern();
    let (first, second) = (problem.information(&pattern, 3, 1, 16), problem.information(&pattern, 3, 1, 17));
    let ordering = NodeOrdering::nested_dissection(&pattern, &problem.coordinates).unwrap();
    let shared = Arc::new(SymbolicFactor::analyse(&pattern, &ordering, 3).unwrap());
    let solved = |factor: &CholeskyFactor| {
        let mut x = second.vector().to_vec();
        factor.solve_in_place(&mut x).unwrap();
        let inverse = SelectedInverse::new(factor);
        let variances = inverse.diagonal();
        assert_eq!(inverse.refresh(factor).diagonal(), variances);
        (x, factor.log_determinant(), variances)
    };
    let fresh = factor_with(&second, &ordering).unwrap();
    let shared_first = CholeskyFactor::factorize(&shared, &first).unwrap();
    let reused = shared_first.refactorize(&second).unwrap();
    let again = CholeskyFactor::factorize(&shared, &second).unwrap();
    assert_eq!(solved(&fresh), solved(&reused));
    assert_eq!(solved(&fresh), solved(&again));
}

#[test]
fn the_number_of_threads_does_not_change_a_byte() {
    let problem = Problem::grid(70, 50, 3, true);
    let pattern = problem.pattern();
    let dissected = NodeOrdering::nested_dissection(&pattern, &problem.coordinates).unwrap();
    for (b, ordering) in [(1, dissected.clone()), (3, dissected), (1, NodeOrdering::natural(pattern.nodes()))]
    {
        let information = problem.information(&pattern, b, 2, 7);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let factor = factor_with(&information, &ordering).unwrap();
                let mut x = information.vector().to_vec();
                factor.solve_in_place(&mut x).unwrap();
                let inverse = SelectedInverse::new(&factor).diagonal();
                let all = x.into_iter().chain(inverse).chain([factor.log_determinant()]);
                all.map(f64::to_bits).collect::<Vec<_>>()
            })
        };
        let one = run(1);
        for threads in [2, 5] {
            assert!(one == run(threads), "{threads} threads give different bytes with b = {b}");
        }
    }
}

#[test]
fn scatter_maps_give_the_same_bytes_as_a_search() {
    let problem = Problem::scattered(50, 18);
    let pattern = problem.pattern();
    let by_search = problem.information(&pattern, 3, 1, 19);
    let maps: Vec<_> =
        problem.elements.iter().map(|nodes| ElementScatter::new(&pattern, nodes).unwrap()).collect();
    let mut random = ChaCha8Rng::seed_from_u64(19);
    let mut by_map = BlockInformation::zeros(Arc::clone(&pattern), 3, 1).unwrap();
    for map in &maps {
        let size = map.nodes().len() * 3;
        let gains = DMatrix::from_fn(size, size, |_, _| random.random_range(-1.0..1.0));
        let matrix = gains.transpose() * gains;
        let vector: Vec<f64> = (0..size).map(|_| random.random_range(-1.0..1.0)).collect();
        by_map.add_scattered(map, matrix.as_slice(), &vector).unwrap();
    }
    by_map.add_diagonal(0.3);
    assert_eq!(by_map.values(), by_search.values());
    assert_eq!(by_map.vector(), by_search.vector());
}

#[test]
fn three_columns_of_one_unknown_equal_one_column_of_three() {
    let problem = Problem::grid(9, 8, 3, true);
    let narrow = problem.information(&problem.pattern(), 1, 3, 20);
    let wide = narrow.expanded(3).unwrap();
    assert_eq!(wide.vector(), narrow.vector());
    let (mut x, mut y) = (narrow.vector().to_vec(), wide.vector().to_vec());
    problem.factor(&narrow).solve_in_place(&mut x).unwrap();
    problem.factor(&wide).solve_in_place(&mut y).unwrap();
    assert_close("solution", &x, &y, 1e-11);
    let difference =
        3.0 * problem.factor(&narrow).log_determinant() - problem.factor(&wide).log_determinant();
    assert!(difference.abs() < 1e-10);
}

#[test]
fn an_undetermined_node_is_named() {
    let problem = Problem::grid(12, 12, 3, false);
    let pattern = problem.pattern();
    let ordering = NodeOrdering::nested_dissection(&pattern, &problem.coordinates).unwrap();
    for b in [1, 3] {
        let mut block = vec![0.0; b * b];
        block[b * b - 1] = -1e6;
        for node in [0, 65, 143] {
            let mut information = problem.information(&pattern, b, 0, 21);
            information.add_to_diagonal_block(node, &block).unwrap();
            let failure = factor_with(&information, &ordering).unwrap_err();
            assert_eq!(failure.kind(), ErrorKind::Undetermined);
            // A negative diagonal breaks down at its own node or earlier.
            assert!(failure.to_string().contains(&format!("node {node}")), "{failure}");
        }
    }
    // No data and no prior at one node.
    let loose = Arc::new(BlockPattern::from_elements(3, [[0, 1]]).unwrap());
    let mut information = BlockInformation::zeros(loose, 1, 0).unwrap();
    information.add_element(&[0, 1], &[2.0, 1.0, 1.0, 2.0], &[]).unwrap();
    let failure = factor_with(&information, &NodeOrdering::natural(3)).unwrap_err();
    assert!(failure.kind() == ErrorKind::Undetermined && failure.to_string().contains("node 2"), "{failure}");
}

#[test]
fn singular_information_is_undetermined_although_rounding_leaves_a_pivot() {
    // Differences do not determine the mean. Rounding may leave a tiny positive last pivot.
    let mut random = ChaCha8Rng::seed_from_u64(22);
    for seed in 0..20 {
        let problem = Problem::grid(8, 7, 1, false);
        let mut information = BlockInformation::zeros(problem.pattern(), 1, 0).unwrap();
        for nodes in problem.elements.iter().flat_map(|element| element.windows(2)) {
            let w: f64 = random.random_range(0.5..2.0);
            information.add_element(nodes, &[w, -w, -w, w], &[]).unwrap();
        }
        let ordering = NodeOrdering::nested_dissection(information.pattern(), &problem.coordinates).unwrap();
        let failure = factor_with(&information, &ordering).unwrap_err();
        assert_eq!(failure.kind(), ErrorKind::Undetermined, "seed {seed}");
    }
}

#[test]
fn weak_priors_are_accepted() {
    // Twelve orders of magnitude between data and prior still determine the answer.
    let pattern = Arc::new(BlockPattern::from_elements(2, [[0, 1]]).unwrap());
    let mut information = BlockInformation::zeros(pattern, 1, 1).unwrap();
    information.add_element(&[0, 1], &[1.0, -1.0, -1.0, 1.0], &[1.0, -1.0]).unwrap();
    information.add_diagonal(1e-12);
    assert!(factor_with(&information, &NodeOrdering::natural(2)).is_ok());
}

#[test]
fn wrong_use_is_an_input_error() {
    let pattern = Arc::new(BlockPattern::from_elements(4, [[0, 1], [2, 3]]).unwrap());
    let mut information = BlockInformation::zeros(Arc::clone(&pattern), 1, 1).unwrap();
    let kinds = [
        BlockPattern::from_elements(4, [[0, 4]]).unwrap_err(),
        information.add_element(&[0, 2], &[0.0; 4], &[0.0; 2]).unwrap_err(),
        information.add_element(&[0, 1], &[0.0; 3], &[0.0; 2]).unwrap_err(),
        information.add_element(&[0, 1], &[0.0; 4], &[0.0; 1]).unwrap_err(),
        NodeOrdering::nested_dissection(&pattern, &[[0.0, 0.0]; 3]).unwrap_err(),
        NodeOrdering::nested_dissection(&pattern, &[[0.0, f64::NAN]; 4]).unwrap_err(),
        NodeOrdering::from_permutation(vec![0, 0, 1, 2]).unwrap_err(),
        SymbolicFactor::analyse(&pattern, &NodeOrdering::natural(3), 1).unwrap_err(),
    ];
    assert!(kinds.iter().all(|error| error.kind() == ErrorKind::Input));

    information.add_diagonal(1.0);
    information.values_mut()[1] = f64::NAN;
    let failure = factor_with(&information, &NodeOrdering::natural(4)).unwrap_err();
    assert_eq!(failure.kind(), ErrorKind::Input);
    information.values_mut()[1] = 0.0;
    let factor = factor_with(&information, &NodeOrdering::natural(4)).unwrap();
    assert_eq!(factor.solve_in_place(&mut [0.0; 5]).unwrap_err().kind(), ErrorKind::Input);
    let other = BlockInformation::zeros(Arc::clone(&pattern), 3, 1).unwrap();
    assert_eq!(factor.refactorize(&other).unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn solution_of_a_chain_is_analytic() {
    // Second differences on n nodes with fixed ends: Λ⁻¹_ij = (i+1)(n−j)/(n+1) for i ≤ j.
    let n = 50_usize;
    let pattern = Arc::new(BlockPattern::from_elements(n, (0..n as u32 - 1).map(|i| [i, i + 1])).unwrap());
    let mut information = BlockInformation::zeros(Arc::clone(&pattern), 1, 1).unwrap();
    for i in 0..n as u32 - 1 {
        information.add_element(&[i, i + 1], &[1.0, -1.0, -1.0, 1.0], &[0.0, 0.0]).unwrap();
    }
    information.add_to_diagonal_block(0, &[1.0]).unwrap();
    information.add_to_diagonal_block(n as u32 - 1, &[1.0]).unwrap();
    let factor = factor_with(&information, &NodeOrdering::amd(&pattern).unwrap()).unwrap();
    assert!((factor.log_determinant() - (n as f64 + 1.0).ln()).abs() < 1e-12);
    let selected = SelectedInverse::new(&factor);
    let exact = |i: usize, j: usize| (i + 1) as f64 * (n - j) as f64 / (n + 1) as f64;
    for i in 0..n {
        assert!((selected.block(i as u32, i as u32).unwrap()[0] - exact(i, i)).abs() < 1e-11);
        let mut unit = DVector::<f64>::zeros(n);
        unit[i] = 1.0;
        factor.solve_in_place(unit.as_mut_slice()).unwrap();
        for j in i..n {
            assert!((unit[j] - exact(i, j)).abs() < 1e-11);
        }
    }
}
