//! Extraction of the cells around a vertex that has not four quads.
//!
//! Input: the number `n` of quads around a vertex, all other corners of which have four. Output: the
//! coefficients of 4 × 4 leaves on each of them, as weights of the `6 n + 1` control vertices of its cells
//! and their neighbours.
//!
//! With a single bicubic piece for each quad, normals cannot be continuous (Fan, Peters 2008). So each of
//! these cells has 4 × 4 pieces. Let `t` run along the edge between two of the cells, from 0 at the vertex to
//! 1, `e(t)` be their common edge, and `d`, `d'` the derivatives into the two cells. Normals are continuous
//! if
//!
//! ```text
//! d(t) + d'(t) = λ(t) e'(t)        λ(0) = 2 cos(2π/n)   λ(1) = λ'(1) = 0
//! ```
//!
//! `λ` is fixed: linear up to `t = 1/2`, quadratic and continuously differentiable from there. Where it is
//! quadratic, `e` has to be quadratic, so that both sides are cubic. These equations, continuous derivatives
//! between the pieces, and the value and derivative on the far sides of the cells, which belong to the
//! neighbours, are linear in the coefficients. Of their solutions the one nearest to a patch of bicubic
//! Bézier pieces (Loop, Schaefer 2008) is taken. Constants fulfil the equations, so weights sum to one.
//! Weights are at least −0.0015.
//!
//! Not guaranteed: continuous curvature along the edges of these cells.
//!
//! # References
//! Fan, Peters, *On smooth bicubic surfaces from quad meshes*, ISVC 2008.
//! Loop, Schaefer, *Approximating Catmull-Clark subdivision surfaces with bicubic patches*, ACM TOG 2008.

use nalgebra::{DMatrix, DVector, SVD};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex, PoisonError};

/// Pieces along each side of a cell, and number of Bézier ordinates along it.
pub(crate) const PIECES: usize = 4;
const ORDINATES: usize = 3 * PIECES + 1;
/// Control vertices for each cell around the vertex.
pub(crate) const VERTICES_PER_CELL: usize = 6;
/// Singular values of the equations below this share of the largest are zero. For 3 to 12 cells, all others
/// are above 7e-4, and these below 1e-15.
const MIN_SINGULAR: f64 = 1e-8;

/// The number of the control vertex at a place in the frame of a cell: 0 for the common vertex, which is at
/// (0, 0), then six for each cell.
fn vertex_at(valence: usize, cell: usize, place: [i8; 2]) -> usize {
    // Places beyond the two edges at the vertex belong to the neighbours.
    let (of, own) = match place {
        [0, 0] => return 0,
        [0, t] => (cell + 1, [t, 0]),
        [-1, t] => (cell + 1, [t, 1]),
        [s, -1] => (cell + valence - 1, [1, s]),
        own => (cell, own),
    };
    let k = PLACES.iter().position(|p| *p == own).unwrap_or_default();
    1 + VERTICES_PER_CELL * (of % valence) + k
}

/// A coefficient as an affine function of the unknowns, and of the control vertices.
#[derive(Clone)]
struct Affine {
    unknowns: DVector<f64>,
    vertices: DVector<f64>,
}

impl Affine {
    fn plus(&self, scale: f64, other: &Self) -> Self {
        Self {
            unknowns: &self.unknowns + scale * &other.unknowns,
            vertices: &self.vertices + scale * &other.vertices,
        }
    }

    fn scaled(&self, scale: f64) -> Self {
        Self { unknowns: scale * &self.unknowns, vertices: scale * &self.vertices }
    }
}

/// Weights of the control vertices in the Bézier ordinates of a cell, row by row along `t`.
type Ordinates = Vec<DVector<f64>>;

/// For each leaf of a cell, the sixteen coefficients as weights of the control vertices.
type LeafWeights = Arc<Vec<Vec<[f64; 16]>>>;

/// The leaves of one cell around a vertex of `valence` quads, row by row along `t`: for each, the sixteen
/// coefficients as weights of the control vertices. Computed once for each valence.
///
/// Control vertices are numbered from the vertex at (0, 0) and this cell on: see [`PLACES`].
pub(crate) fn leaf_weights_around(valence: usize) -> LeafWeights {
    static KNOWN: Mutex<BTreeMap<usize, LeafWeights>> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    Arc::clone(known.entry(valence).or_insert_with(|| Arc::new(find_leaf_weights(valence))))
}

fn find_leaf_weights(valence: usize) -> Vec<Vec<[f64; 16]>> {
    let fan = Fan::new(valence);
    let solution = fan.solve();
    let ordinates: Vec<DVector<f64>> = (0..ORDINATES * ORDINATES)
        .map(|at| {
            let found = fan.ordinate(0, [at % ORDINATES, at / ORDINATES]);
            &found.vertices + solution.tr_mul(&found.unknowns)
        })
        .collect();
    let leaves = (0..PIECES).flat_map(|row| (0..PIECES).map(move |column| [column, row]));
    leaves
        .map(|[column, row]| {
            let of_vertex = |vertex: usize| {
                let bezier: [f64; 16] = std::array::from_fn(|k| {
                    let [s, t] = [3 * column + k % 4, 3 * row + k / 4];
                    ordinates[t * ORDINATES + s][vertex]
                });
                spline_coefficients(&bezier)
            };
            (0..=VERTICES_PER_CELL * valence).map(of_vertex).collect()
        })
        .collect()
}

/// Uniform cubic B-spline coefficients of a bicubic piece from its Bézier ordinates.
fn spline_coefficients(bezier: &[f64; 16]) -> [f64; 16] {
    let line = |b: [f64; 4]| {
        [
            6.0 * b[0] - 7.0 * b[1] + 2.0 * b[2],
            2.0 * b[1] - b[2],
            2.0 * b[2] - b[1],
            2.0 * b[1] - 7.0 * b[2] + 6.0 * b[3],
        ]
    };
    let rows: [[f64; 4]; 4] = std::array::from_fn(|r| line(std::array::from_fn(|c| bezier[4 * r + c])));
    let columns: [[f64; 4]; 4] = std::array::from_fn(|c| line(std::array::from_fn(|r| rows[r][c])));
    std::array::from_fn(|k| columns[k % 4][k / 4])
}

/// The cells around a vertex with their initial ordinates.
struct Fan {
    valence: usize,
    initial: Vec<Ordinates>,
    unknowns: usize,
}

/// Indices of ordinates that are unknown on their own: those between pieces are means of their neighbours,
/// and the last two belong to the neighbours of the cells.
const FREE: [usize; 7] = [1, 2, 4, 5, 7, 8, 10];

impl Fan {
    fn new(valence: usize) -> Self {
        let patches = bezier_patches(valence);
        let initial = patches.iter().map(|patch| divided(patch)).collect();
        // The vertex; for each cell an edge, and the ordinates beside both of its edges.
        Self { valence, initial, unknowns: 1 + valence * (3 * FREE.len() - 1) }
    }

    /// The number of an unknown ordinate, if it is one.
    fn unknown(&self, cell: usize, [s, t]: [usize; 2]) -> Option<usize> {
        let free = |j: usize| FREE.iter().position(|&f| f == j);
        let of_cell = |cell: usize, k: usize| 1 + (cell % self.valence) * (3 * FREE.len() - 1) + k;
        match [s, t] {
            [0, 0] => Some(0),
            [s, 0] => free(s).map(|k| of_cell(cell, k)),
            [0, t] => free(t).map(|k| of_cell(cell + 1, k)),
            [s, 1] => free(s).map(|k| of_cell(cell, FREE.len() + k)),
            [1, t] => free(t).map(|k| of_cell(cell, 2 * FREE.len() - 1 + k)),
            _ => None,
        }
    }

    /// An ordinate of a cell.
    fn ordinate(&self, cell: usize, [s, t]: [usize; 2]) -> Affine {
        let is_between = |j: usize| j.is_multiple_of(3) && j > 0 && j < ORDINATES - 1;
        let mean = |a: [usize; 2], b: [usize; 2]| {
            self.ordinate(cell, a).plus(1.0, &self.ordinate(cell, b)).scaled(0.5)
        };
        if is_between(s) {
            return mean([s - 1, t], [s + 1, t]);
        }
        if is_between(t) {
            return mean([s, t - 1], [s, t + 1]);
        }
        let mut unknowns = DVector::zeros(self.unknowns);
        let mut vertices = DVector::zeros(VERTICES_PER_CELL * self.valence + 1);
        let is_of_neighbour = s.max(t) >= ORDINATES - 2;
        match self.unknown(cell, [s, t]).filter(|_| !is_of_neighbour) {
            Some(k) => unknowns[k] = 1.0,
            None => vertices.copy_from(&self.initial[cell][t * ORDINATES + s]),
        }
        Affine { unknowns, vertices }
    }

    /// The values of the unknowns in the initial ordinates, one row for each.
    fn initial_unknowns(&self) -> DMatrix<f64> {
        let mut values = DMatrix::zeros(self.unknowns, VERTICES_PER_CELL * self.valence + 1);
        for (cell, own) in self.initial.iter().enumerate() {
            for t in 0..ORDINATES - 2 {
                for s in 0..ORDINATES - 2 {
                    if let Some(k) = self.unknown(cell, [s, t]) {
                        values.set_row(k, &own[t * ORDINATES + s].transpose());
                    }
                }
            }
        }
        values
    }

    /// Expressions that are zero where normals are continuous across the edge at the start of a cell.
    fn equations(&self, cell: usize) -> Vec<Affine> {
        let before = (cell + self.valence - 1) % self.valence;
        let lambda = lambda_pieces(self.valence);
        (0..PIECES)
            .flat_map(|piece| {
                let e: [Affine; 4] = std::array::from_fn(|j| self.ordinate(cell, [3 * piece + j, 0]));
                let slope = |j: usize| e[j + 1].plus(-1.0, &e[j]);
                // Bézier ordinates of e', and of λ e' with those of λ.
                let [l0, l1, l2] = lambda[piece];
                let is_quadratic = 2 * piece >= PIECES;
                let product: [Affine; 4] = if is_quadratic {
                    let [a, b] = [slope(0), slope(2)];
                    [
                        a.scaled(l0),
                        a.scaled(2.0 * l1 / 3.0).plus(l0 / 3.0, &b),
                        a.scaled(l2 / 3.0).plus(2.0 * l1 / 3.0, &b),
                        b.scaled(l2),
                    ]
                } else {
                    let [a, b, c] = [slope(0), slope(1), slope(2)];
                    [
                        a.scaled(l0),
                        a.scaled(l2 / 3.0).plus(2.0 * l0 / 3.0, &b),
                        b.scaled(2.0 * l2 / 3.0).plus(l0 / 3.0, &c),
                        c.scaled(l2),
                    ]
                };
                let across = |j: usize| {
                    self.ordinate(cell, [3 * piece + j, 1])
                        .plus(1.0, &self.ordinate(before, [1, 3 * piece + j]))
                        .plus(-2.0, &e[j])
                };
                let third_difference =
                    is_quadratic.then(|| e[3].plus(-3.0, &e[2]).plus(3.0, &e[1]).plus(-1.0, &e[0]));
                let smooth: Vec<Affine> = (0..4).map(|j| across(j).plus(-1.0, &product[j])).collect();
                smooth.into_iter().chain(third_difference)
            })
            .collect()
    }

    /// The unknowns as weights of the control vertices: the solution of the equations that is nearest to the
    /// initial ordinates.
    ///
    /// With `A x + B = 0` and the initial `x₀`, it is `x₀ − A⁺ (A x₀ + B)`.
    fn solve(&self) -> DMatrix<f64> {
        let equations: Vec<Affine> = (0..self.valence).flat_map(|cell| self.equations(cell)).collect();
        let rows = |of: fn(&Affine) -> &DVector<f64>| {
            DMatrix::from_columns(&equations.iter().map(|e| of(e).clone()).collect::<Vec<_>>()).transpose()
        };
        let (a, b) = (rows(|e| &e.unknowns), rows(|e| &e.vertices));
        let initial = self.initial_unknowns();
        let defect = &a * &initial + b;
        let SVD { u: Some(u), v_t: Some(v), singular_values } = SVD::new(a, true, true) else {
            unreachable!("both factors were asked for");
        };
        let least = MIN_SINGULAR * singular_values.max();
        let mut parts = u.tr_mul(&defect);
        for (mut row, value) in parts.row_iter_mut().zip(singular_values.iter()) {
            row *= if *value > least { 1.0 / value } else { 0.0 };
        }
        initial - v.tr_mul(&parts)
    }
}

/// Bézier ordinates of `λ` on each piece.
fn lambda_pieces(valence: usize) -> [[f64; 3]; PIECES] {
    let first = 2.0 * (TAU / valence as f64).cos();
    // Value and slope of both parts agree at 1/2.
    let lambda = |t: f64| {
        let share = if t < 0.5 { 1.0 - 4.0 / 3.0 * t } else { 4.0 / 3.0 * (1.0 - t) * (1.0 - t) };
        first * share
    };
    std::array::from_fn(|k| {
        let [a, c] = [k, k + 1].map(|j| j as f64 / PIECES as f64);
        let middle = 2.0 * lambda(0.5 * (a + c)) - 0.5 * (lambda(a) + lambda(c));
        [lambda(a), middle, lambda(c)]
    })
}

/// One bicubic Bézier patch for each cell (Loop, Schaefer 2008, section 3): sixteen ordinates as weights of
/// the control vertices. Uniform bicubic away from the vertex.
fn bezier_patches(valence: usize) -> Vec<Vec<DVector<f64>>> {
    let count = VERTICES_PER_CELL * valence + 1;
    let vertex = |cell: usize, at: [i8; 2]| {
        let mut weights = DVector::zeros(count);
        weights[vertex_at(valence, cell, at)] = 1.0;
        weights
    };
    // The ordinate inside a quad next to a corner with `n` quads, from its corners in order.
    let inside = |cell: usize, n: f64, corners: [[i8; 2]; 4]| {
        let [c, a, d, b] = corners.map(|at| vertex(cell, at));
        (n * c + 2.0 * (a + b) + d) / (n + 5.0)
    };
    let regular = |cell: usize, corners| inside(cell, 4.0, corners);
    let inner: Vec<[DVector<f64>; 4]> = (0..valence)
        .map(|cell| {
            let n = valence as f64;
            [
                inside(cell, n, [[0, 0], [1, 0], [1, 1], [0, 1]]),
                regular(cell, [[1, 0], [1, 1], [0, 1], [0, 0]]),
                regular(cell, [[1, 1], [0, 1], [0, 0], [1, 0]]),
                regular(cell, [[0, 1], [0, 0], [1, 0], [1, 1]]),
            ]
        })
        .collect();
    let middle = inner.iter().fold(DVector::zeros(count), |sum, own| sum + &own[0]) / valence as f64;
    (0..valence)
        .map(|cell| {
            let [a, b, c, d] = &inner[cell];
            let (before, after) = (&inner[(cell + valence - 1) % valence], &inner[(cell + 1) % valence]);
            // Of the regular quads beyond the far sides.
            let b_right = regular(cell, [[1, 0], [2, 0], [2, 1], [1, 1]]);
            let c_right = regular(cell, [[1, 1], [1, 0], [2, 0], [2, 1]]);
            let d_above = regular(cell, [[0, 1], [1, 1], [1, 2], [0, 2]]);
            let c_above = regular(cell, [[1, 1], [1, 2], [0, 2], [0, 1]]);
            let c_beyond = regular(cell, [[1, 1], [2, 1], [2, 2], [1, 2]]);
            let b_below = regular(cell, [[1, 0], [1, -1], [2, -1], [2, 0]]);
            let d_left = regular(cell, [[0, 1], [0, 2], [-1, 2], [-1, 1]]);
            let half = |x: &DVector<f64>, y: &DVector<f64>| 0.5 * (x + y);
            vec![
                middle.clone(),
                half(a, &before[0]),
                half(b, &before[3]),
                0.25 * (b + &b_right + &before[3] + &b_below),
                half(a, &after[0]),
                a.clone(),
                b.clone(),
                half(b, &b_right),
                half(d, &after[1]),
                d.clone(),
                c.clone(),
                half(c, &c_right),
                0.25 * (d + &d_above + &after[1] + &d_left),
                half(d, &d_above),
                half(c, &c_above),
                0.25 * (c + &c_right + &c_above + &c_beyond),
            ]
        })
        .collect()
}

/// The ordinates of all pieces of a patch, row by row along `t`.
fn divided(patch: &[DVector<f64>]) -> Ordinates {
    let along_s: Vec<Vec<DVector<f64>>> = patch.chunks_exact(4).map(divided_line).collect();
    let columns: Vec<Vec<DVector<f64>>> = (0..ORDINATES)
        .map(|s| divided_line(&along_s.iter().map(|row| row[s].clone()).collect::<Vec<_>>()))
        .collect();
    (0..ORDINATES * ORDINATES).map(|at| columns[at % ORDINATES][at / ORDINATES].clone()).collect()
}

/// The ordinates of all pieces of a cubic, by blossoms.
fn divided_line(b: &[DVector<f64>]) -> Vec<DVector<f64>> {
    let blossom = |arguments: [f64; 3]| {
        let mut points = b.to_vec();
        for t in arguments {
            points = points.windows(2).map(|pair| (1.0 - t) * &pair[0] + t * &pair[1]).collect();
        }
        points.swap_remove(0)
    };
    (0..ORDINATES)
        .map(|k| {
            let [from, to] = [k / 3, k / 3 + 1].map(|j| j as f64 / PIECES as f64);
            match k % 3 {
                0 => blossom([from; 3]),
                1 => blossom([from, from, to]),
                _ => blossom([from, to, to]),
            }
        })
        .collect()
}

/// Where the control vertices lie, in the frame of the cell to which each belongs: (1, 0), (1, 1), (2, 0),
/// (2, 1), (2, 2) and (1, 2), in the order of their numbers. The vertex itself comes before all.
pub(super) const PLACES: [[i8; 2]; VERTICES_PER_CELL] = [[1, 0], [1, 1], [2, 0], [2, 1], [2, 2], [1, 2]];
