//! Extraction of the cells around a vertex that has not four quads, or where creases end or meet.
//!
//! Input: the number `n` of quads around a vertex, all other corners of which have four, or in a fan between
//! two creases. Output: the coefficients of 4 × 4 leaves on each of them, as weights of the `6 n + 1` control
//! vertices of its cells and their neighbours, and of a few more for a fan.
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
//! The creases at both ends of a fan have given curves, and no equation. Between them, `λ(0) = 2 cos(α/n)`:
//! the tangents of the common edges are those of a fan with the angle `α`, or an affine image of it.
//! - Where a curve passes, `α = π`.
//! - At a corner, `α` is 120° if it is convex, and 270° if it is concave. Any angle below 180°, or above, is
//!   an affine image of these.
//! - At the end of a crease, the quads are all those around the vertex. Only the equation of the crease is
//!   absent. From its other end on, the rows of cells on both sides are those of a crease.
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

/// What a fan of quads around a vertex consists of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct FanShape {
    pub(crate) quads: usize,
    pub(crate) kind: FanKind,
}

/// Creases at the vertex of a fan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum FanKind {
    /// None: the quads are all those around the vertex.
    Smooth,
    /// One ends, at the start of the first of all quads around the vertex.
    Dart,
    /// The fan lies between two creases, and a curve passes through the vertex along two of all.
    Through,
    /// The fan lies between two creases that end at the vertex, with less than 180° between them.
    Convex,
    /// The same with more than 180°.
    Concave,
}

impl FanShape {
    /// True if the quads have uniform splines.
    pub(crate) fn is_regular(self) -> bool {
        self.kind != FanKind::Dart
            && self.quads
                == match self.kind {
                    FanKind::Smooth | FanKind::Dart => 4,
                    FanKind::Through => 2,
                    FanKind::Convex | FanKind::Concave => 1,
                }
    }

    /// True if it lies between two creases.
    pub(crate) fn is_open(self) -> bool {
        !matches!(self.kind, FanKind::Smooth | FanKind::Dart)
    }

    /// The number of quads of this angle that make a full turn.
    fn quads_of_turn(self) -> f64 {
        match (self.kind, self.quads) {
            (FanKind::Smooth | FanKind::Dart, n) => n as f64,
            // A single quad has no angle of its own.
            (_, 1) => 4.0,
            (FanKind::Through, n) => 2.0 * n as f64,
            (FanKind::Convex, n) => 3.0 * n as f64,
            (FanKind::Concave, n) => n as f64 / 0.75,
        }
    }

    /// The tangent of the edge before a cell at the vertex, as a sum of those of the first and the last
    /// crease: directions with even angles, up to an affine map.
    pub(crate) fn shares_of_creases(self, cell: usize) -> [f64; 2] {
        let angle = TAU / self.quads_of_turn();
        let sine = |quads: usize| (quads as f64 * angle).sin() / (self.quads as f64 * angle).sin();
        [sine(self.quads - cell), sine(cell)]
    }

    /// `λ` at the vertex.
    fn first_lambda(self) -> f64 {
        let first = 2.0 * (TAU / self.quads_of_turn()).cos();
        // A quarter turn is no exact zero.
        if first.abs() < 1e-12 { 0.0 } else { first }
    }

    /// Number of control vertices. After six of each cell, a fan between creases has two on its last crease,
    /// and the neighbours on a curve that passes.
    fn vertices(self) -> usize {
        1 + VERTICES_PER_CELL * self.quads
            + match self.kind {
                FanKind::Smooth | FanKind::Dart => 0,
                FanKind::Through => 4,
                FanKind::Convex | FanKind::Concave => 2,
            }
    }

    /// The number of the control vertex at a place in the frame of a cell: 0 for the common vertex, which is
    /// at (0, 0), then six for each cell.
    fn vertex_at(self, cell: usize, place: [i8; 2]) -> usize {
        // Places beyond the two edges at the vertex belong to the neighbours.
        let (of, own) = match place {
            [0, 0] => return 0,
            [0, t] => (cell + 1, [t, 0]),
            [-1, t] => (cell + 1, [t, 1]),
            [s, -1] => (cell + self.quads - 1, [1, s]),
            own => (cell, own),
        };
        if self.is_open() && of == self.quads && own[1] == 0 {
            return VERTICES_PER_CELL * self.quads + own[0] as usize;
        }
        let k = PLACES.iter().position(|p| *p == own).unwrap_or_default();
        1 + VERTICES_PER_CELL * (of % self.quads) + k
    }

    /// True if the edge at the start of a cell lies on a crease. The edge after the last cell has the next
    /// number.
    fn is_crease(self, edge: usize) -> bool {
        self.kind != FanKind::Smooth && edge.is_multiple_of(self.quads)
    }

    /// True if it lies on a crease with a given curve.
    fn is_given(self, edge: usize) -> bool {
        self.is_open() && self.is_crease(edge)
    }
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
type LeafWeights = Vec<Vec<[f64; 16]>>;

/// The leaves of each cell of a fan, row by row along `t` in the frame of the vertex: for each, the sixteen
/// coefficients as weights of the control vertices. Computed once for each shape. In a smooth fan all cells
/// are alike, so there is only the first.
///
/// Control vertices are numbered from the vertex at (0, 0) and the first cell on: see [`PLACES`].
pub(crate) fn leaf_weights(shape: FanShape) -> Arc<Vec<LeafWeights>> {
    static KNOWN: Mutex<BTreeMap<FanShape, Arc<Vec<LeafWeights>>>> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    Arc::clone(known.entry(shape).or_insert_with(|| {
        let fan = Fan::new(shape);
        let solution = fan.solve();
        let cells = if shape.kind == FanKind::Smooth { 1 } else { shape.quads };
        Arc::new((0..cells).map(|cell| fan.leaf_weights(cell, &solution)).collect())
    }))
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
    shape: FanShape,
    initial: Vec<Ordinates>,
    unknowns: usize,
}

/// Indices of ordinates that are unknown on their own: those between pieces are means of their neighbours,
/// and the last two belong to the neighbours of the cells.
const FREE: [usize; 7] = [1, 2, 4, 5, 7, 8, 10];

impl Fan {
    fn new(shape: FanShape) -> Self {
        let patches = bezier_patches(shape);
        let initial = patches.iter().map(|patch| divided(patch)).collect();
        // The vertex; for each cell an edge, and the ordinates beside both of its edges.
        Self { shape, initial, unknowns: 1 + shape.quads * (3 * FREE.len() - 1) }
    }

    /// The leaves of a cell.
    fn leaf_weights(&self, cell: usize, solution: &DMatrix<f64>) -> LeafWeights {
        let ordinates: Vec<DVector<f64>> = (0..ORDINATES * ORDINATES)
            .map(|at| {
                let found = self.ordinate(cell, [at % ORDINATES, at / ORDINATES]);
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
                (0..self.shape.vertices()).map(of_vertex).collect()
            })
            .collect()
    }

    /// The number of an unknown ordinate, if it is one.
    fn unknown(&self, cell: usize, [s, t]: [usize; 2]) -> Option<usize> {
        let free = |j: usize| FREE.iter().position(|&f| f == j);
        let of_cell = |cell: usize, k: usize| 1 + (cell % self.shape.quads) * (3 * FREE.len() - 1) + k;
        match [s, t] {
            [0, 0] => Some(0).filter(|_| !self.shape.is_open()),
            [_, 0] if self.shape.is_given(cell) => None,
            [0, _] if self.shape.is_given(cell + 1) => None,
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
        let mut vertices = DVector::zeros(self.shape.vertices());
        let is_of_neighbour = s.max(t) >= ORDINATES - 2;
        match self.unknown(cell, [s, t]).filter(|_| !is_of_neighbour) {
            Some(k) => unknowns[k] = 1.0,
            None => vertices.copy_from(&self.initial[cell][t * ORDINATES + s]),
        }
        Affine { unknowns, vertices }
    }

    /// The values of the unknowns in the initial ordinates, one row for each.
    fn initial_unknowns(&self) -> DMatrix<f64> {
        let mut values = DMatrix::zeros(self.unknowns, self.shape.vertices());
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
        let before = (cell + self.shape.quads - 1) % self.shape.quads;
        let first = self.shape.first_lambda();
        let lambda = lambda_pieces(first);
        (0..PIECES)
            .flat_map(|piece| {
                let e: [Affine; 4] = std::array::from_fn(|j| self.ordinate(cell, [3 * piece + j, 0]));
                let slope = |j: usize| e[j + 1].plus(-1.0, &e[j]);
                // Bézier ordinates of e', and of λ e' with those of λ.
                let [l0, l1, l2] = lambda[piece];
                // Nor has `e` to be quadratic if λ is zero.
                let is_quadratic = 2 * piece >= PIECES && first != 0.0;
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
        let smooth = (0..self.shape.quads).filter(|&edge| !self.shape.is_crease(edge));
        let equations: Vec<Affine> = smooth.flat_map(|edge| self.equations(edge)).collect();
        let initial = self.initial_unknowns();
        if equations.is_empty() {
            return initial;
        }
        let rows = |of: fn(&Affine) -> &DVector<f64>| {
            DMatrix::from_columns(&equations.iter().map(|e| of(e).clone()).collect::<Vec<_>>()).transpose()
        };
        let (a, b) = (rows(|e| &e.unknowns), rows(|e| &e.vertices));
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

/// Bézier ordinates of `λ` on each piece, from its value at the vertex.
fn lambda_pieces(first: f64) -> [[f64; 3]; PIECES] {
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
fn bezier_patches(shape: FanShape) -> Vec<Vec<DVector<f64>>> {
    let quads = shape.quads;
    let single = |k: usize| {
        let mut weights = DVector::zeros(shape.vertices());
        weights[k] = 1.0;
        weights
    };
    let vertex = |cell: usize, at: [i8; 2]| single(shape.vertex_at(cell, at));
    // The ordinate inside a quad next to a corner with `n` quads, from its corners in order.
    let inside = |cell: usize, n: f64, corners: [[i8; 2]; 4]| {
        let [c, a, d, b] = corners.map(|at| vertex(cell, at));
        (n * c + 2.0 * (a + b) + d) / (n + 5.0)
    };
    let regular = |cell: usize, corners| inside(cell, 4.0, corners);
    let inner: Vec<[DVector<f64>; 4]> = (0..quads)
        .map(|cell| {
            let n = shape.quads_of_turn();
            [
                inside(cell, n, [[0, 0], [1, 0], [1, 1], [0, 1]]),
                regular(cell, [[1, 0], [1, 1], [0, 1], [0, 0]]),
                regular(cell, [[1, 1], [0, 1], [0, 0], [1, 0]]),
                regular(cell, [[0, 1], [0, 0], [1, 0], [1, 1]]),
            ]
        })
        .collect();
    let middle = match shape.kind {
        FanKind::Smooth | FanKind::Dart => {
            inner.iter().fold(DVector::zeros(shape.vertices()), |sum, own| sum + &own[0]) / quads as f64
        }
        FanKind::Through => {
            let last = shape.vertices() - 1;
            (single(last - 1) + 4.0 * single(0) + single(last)) / 6.0
        }
        FanKind::Convex | FanKind::Concave => single(0),
    };
    let half = |x: &DVector<f64>, y: &DVector<f64>| 0.5 * (x + y);
    // Along a crease: the cubic of its vertices.
    let crease = |edge: usize| {
        let [v, p, q] = [0, 1, 2].map(|s| vertex(edge, [s, 0]));
        // At a dart, both sides meet smoothly.
        let first = match shape.kind {
            FanKind::Dart => half(&inner[0][0], &inner[quads - 1][0]),
            _ => (2.0 * &v + &p) / 3.0,
        };
        [middle.clone(), first, (&v + 2.0 * &p) / 3.0, (v + 4.0 * p + q) / 6.0]
    };
    (0..quads)
        .map(|cell| {
            let [a, b, c, d] = &inner[cell];
            let (before, after) = (&inner[(cell + quads - 1) % quads], &inner[(cell + 1) % quads]);
            // Of the regular quads beyond the far sides.
            let b_right = regular(cell, [[1, 0], [2, 0], [2, 1], [1, 1]]);
            let c_right = regular(cell, [[1, 1], [1, 0], [2, 0], [2, 1]]);
            let d_above = regular(cell, [[0, 1], [1, 1], [1, 2], [0, 2]]);
            let c_above = regular(cell, [[1, 1], [1, 2], [0, 2], [0, 1]]);
            let c_beyond = regular(cell, [[1, 1], [2, 1], [2, 2], [1, 2]]);
            let [first, s1, s2, s3] = if shape.is_crease(cell) {
                crease(cell)
            } else {
                let b_below = regular(cell, [[1, 0], [1, -1], [2, -1], [2, 0]]);
                let end = 0.25 * (b + &b_right + &before[3] + &b_below);
                [middle.clone(), half(a, &before[0]), half(b, &before[3]), end]
            };
            let [_, t1, t2, t3] = if shape.is_crease(cell + 1) {
                crease(cell + 1)
            } else {
                let d_left = regular(cell, [[0, 1], [0, 2], [-1, 2], [-1, 1]]);
                let end = 0.25 * (d + &d_above + &after[1] + &d_left);
                [middle.clone(), half(a, &after[0]), half(d, &after[1]), end]
            };
            let beyond = 0.25 * (c + &c_right + &c_above + &c_beyond);
            let rows = [
                [first, s1, s2, s3],
                [t1, a.clone(), b.clone(), half(b, &b_right)],
                [t2, d.clone(), c.clone(), half(c, &c_right)],
                [t3, half(d, &d_above), half(c, &c_above), beyond],
            ];
            rows.into_iter().flatten().collect()
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
