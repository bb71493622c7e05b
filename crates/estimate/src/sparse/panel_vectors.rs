//! Products of a supernode panel with a few vectors, using the widest SIMD instructions of the machine.
//!
//! Input: a column-major panel `L_CC` over `L_RC`, and contiguous vectors. Output: the vectors, changed in
//! place. General matrix products are slow for so few vectors.
//!
//! Not guaranteed: the same last digit on machines with other SIMD instructions.

use pulp::{Simd, WithSimd};

/// Columns of a panel applied together, so that the vector is read and written once for all of them.
const BLOCK_COLUMNS: usize = 4;

/// `own ← L_CC⁻¹ own`, then `below ← below − L_RC own`.
pub(super) struct Elimination<'a> {
    pub panel: &'a [f64],
    /// Length of a column of the panel.
    pub stride: usize,
    pub vectors: usize,
    pub own: &'a mut [f64],
    pub below: &'a mut [f64],
}

impl WithSimd for Elimination<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { panel, stride, vectors, own, below } = self;
        let columns = own.len() / vectors.max(1);
        let height = stride - columns;
        for k in (0..columns).step_by(BLOCK_COLUMNS) {
            let width = BLOCK_COLUMNS.min(columns - k);
            let panel = &panel[k * stride..(k + width) * stride];
            for v in 0..vectors {
                let (done, rest) = own[v * columns..(v + 1) * columns].split_at_mut(k + width);
                // Solve the small triangle first. Its values then leave the rest of the panel in one pass
                // over memory, which is what limits the speed.
                let x = &mut done[k..];
                for j in 0..width {
                    let column = &panel[j * stride + k..(j + 1) * stride];
                    x[j] /= column[j];
                    for i in j + 1..width {
                        x[i] -= column[i] * x[j];
                    }
                }
                subtract_product(simd, panel, stride, k + width, x, rest);
                subtract_product(simd, panel, stride, columns, x, &mut below[v * height..(v + 1) * height]);
            }
        }
    }
}

/// `own ← L_CC⁻ᵀ (own − L_RCᵀ known)`.
pub(super) struct BackSubstitution<'a> {
    pub panel: &'a [f64],
    /// Length of a column of the panel.
    pub stride: usize,
    pub vectors: usize,
    pub own: &'a mut [f64],
    pub known: &'a [f64],
}

impl WithSimd for BackSubstitution<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { panel, stride, vectors, own, known } = self;
        let columns = own.len() / vectors.max(1);
        let height = stride - columns;
        for k in (0..columns).step_by(BLOCK_COLUMNS).rev() {
            let width = BLOCK_COLUMNS.min(columns - k);
            let panel = &panel[k * stride..(k + width) * stride];
            for v in 0..vectors {
                let (before, rest) = own[v * columns..(v + 1) * columns].split_at_mut(k + width);
                let x = &mut before[k..];
                subtract_products(simd, panel, stride, k + width, rest, x);
                subtract_products(simd, panel, stride, columns, &known[v * height..(v + 1) * height], x);
                // Rows below are known, so the triangle is solved upwards.
                for j in (0..width).rev() {
                    let column = &panel[j * stride + k..(j + 1) * stride];
                    for i in j + 1..width {
                        x[j] -= column[i] * x[i];
                    }
                    x[j] /= column[j];
                }
            }
        }
    }
}

/// `y ← y − A x` for the rows from `first` on of at most [`BLOCK_COLUMNS`] columns.
#[inline(always)]
fn subtract_product<S: Simd>(
    simd: S,
    columns: &[f64],
    stride: usize,
    first: usize,
    x: &[f64],
    y: &mut [f64],
) {
    let n = y.len();
    let part = |j: usize| S::as_simd_f64s(&columns[j * stride + first..][..n]);
    let (y, y_rest) = S::as_mut_simd_f64s(y);
    if let &[x0, x1, x2, x3] = x {
        let [(a0, r0), (a1, r1), (a2, r2), (a3, r3)] = [part(0), part(1), part(2), part(3)];
        let [s0, s1, s2, s3] = [x0, x1, x2, x3].map(|x| simd.splat_f64s(-x));
        for ((((y, &a0), &a1), &a2), &a3) in y.iter_mut().zip(a0).zip(a1).zip(a2).zip(a3) {
            let low = simd.mul_add_f64s(a1, s1, simd.mul_add_f64s(a0, s0, *y));
            *y = simd.mul_add_f64s(a3, s3, simd.mul_add_f64s(a2, s2, low));
        }
        for ((((y, a0), a1), a2), a3) in y_rest.iter_mut().zip(r0).zip(r1).zip(r2).zip(r3) {
            *y -= (a0 * x0 + a1 * x1) + (a2 * x2 + a3 * x3);
        }
        return;
    }
    for (j, &x) in x.iter().enumerate() {
        let (a, rest) = part(j);
        let s = simd.splat_f64s(-x);
        for (y, &a) in y.iter_mut().zip(a) {
            *y = simd.mul_add_f64s(a, s, *y);
        }
        for (y, a) in y_rest.iter_mut().zip(rest) {
            *y -= a * x;
        }
    }
}

/// `x ← x − Aᵀ y` for the rows from `first` on of at most [`BLOCK_COLUMNS`] columns.
#[inline(always)]
fn subtract_products<S: Simd>(
    simd: S,
    columns: &[f64],
    stride: usize,
    first: usize,
    y: &[f64],
    x: &mut [f64],
) {
    let n = y.len();
    let part = |j: usize| S::as_simd_f64s(&columns[j * stride + first..][..n]);
    let (y, y_rest) = S::as_simd_f64s(y);
    // The few rows that do not fill a SIMD register.
    let rest = |a: &[f64]| a.iter().zip(y_rest).map(|(a, y)| a * y).sum::<f64>();
    let zero = simd.splat_f64s(0.0);
    if let [x0, x1, x2, x3] = x {
        let [(a0, r0), (a1, r1), (a2, r2), (a3, r3)] = [part(0), part(1), part(2), part(3)];
        // Independent sums: a single one would wait for the latency of each addition.
        let (mut s0, mut s1, mut s2, mut s3) = (zero, zero, zero, zero);
        for ((((&y, &a0), &a1), &a2), &a3) in y.iter().zip(a0).zip(a1).zip(a2).zip(a3) {
            s0 = simd.mul_add_f64s(a0, y, s0);
            s1 = simd.mul_add_f64s(a1, y, s1);
            s2 = simd.mul_add_f64s(a2, y, s2);
            s3 = simd.mul_add_f64s(a3, y, s3);
        }
        *x0 -= simd.reduce_sum_f64s(s0) + rest(r0);
        *x1 -= simd.reduce_sum_f64s(s1) + rest(r1);
        *x2 -= simd.reduce_sum_f64s(s2) + rest(r2);
        *x3 -= simd.reduce_sum_f64s(s3) + rest(r3);
        return;
    }
    for (j, x) in x.iter_mut().enumerate() {
        let (a, a_rest) = part(j);
        let mut sum = zero;
        for (&y, &a) in y.iter().zip(a) {
            sum = simd.mul_add_f64s(a, y, sum);
        }
        *x -= simd.reduce_sum_f64s(sum) + rest(a_rest);
    }
}
