//! Ranges of the numbers of a file.
//!
//! In: numbers of a tensor or of the metadata. Out: nothing, or an error with the name, the index of the
//! first number out of range, what was expected and what was found.

use super::Metadata;
use crate::model::{ScanPoseReport, SensorReport};
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use std::fmt::Display;

/// Largest share by which `|a_ij|` may exceed `√(a_ii a_jj)` in a positive semidefinite matrix.
///
/// The exact bound is 0. Covariances of a patch filter are differences of numbers up to ten orders larger, so
/// rounding leaves 1e-6 in strongly correlated entries. The check is for changed numbers, which differ by
/// more.
const MINOR_TOLERANCE: f64 = 1e-3;

/// Largest deviation of the length of a quaternion from 1; a file with seven digits has 1e-7.
const UNIT_TOLERANCE: f64 = 1e-6;

/// Numbers as a message shows them.
fn listed<T: Display>(values: &[T]) -> String {
    match values {
        [one] => one.to_string(),
        _ => format!("({})", values.iter().map(T::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// Requires every row of a tensor to be valid.
pub(super) fn check_rows<T: Display>(
    name: &str,
    values: &[T],
    width: usize,
    expected: &str,
    valid: impl Fn(&[T]) -> bool,
) -> Result<()> {
    match values.chunks(width).enumerate().find(|(_, row)| !valid(row)) {
        None => Ok(()),
        Some((index, row)) => Err(Error::input(format!(
            "tensor `{name}`, row {index}: expected {expected}, found {}",
            listed(row)
        ))),
    }
}

/// Requires a number of the metadata to be valid; `valid` says whether it is `expected`.
fn check_number(field: impl Display, value: f64, expected: &str, valid: impl Fn(f64) -> bool) -> Result<()> {
    if value.is_finite() && valid(value) {
        return Ok(());
    }
    Err(Error::input(format!("metadata `{field}`: expected a number {expected}, found {value}")))
}

fn positive(field: impl Display, value: f64) -> Result<()> {
    check_number(field, value, "> 0", |x| x > 0.0)
}

fn not_negative(field: impl Display, value: f64) -> Result<()> {
    check_number(field, value, "≥ 0", |x| x >= 0.0)
}

/// Checks every number of the metadata.
///
/// # Errors
/// `Input` that names the field.
pub(super) fn check_metadata(metadata: &Metadata) -> Result<()> {
    not_negative("smoothness_weight", metadata.smoothness_weight)?;
    for (k, sensor) in metadata.sensors.iter().enumerate() {
        let SensorReport { sigma_stated, sigma_estimated, rms, .. } = *sensor;
        if let Some(sigma) = sigma_stated {
            positive(format_args!("sensors[{k}].sigma_stated"), sigma)?;
        }
        // Exact readings have an estimate of zero.
        not_negative(format_args!("sensors[{k}].sigma_estimated"), sigma_estimated)?;
        not_negative(format_args!("sensors[{k}].rms"), rms)?;
    }
    if metadata.measured_coordinates == Some([false; 3]) {
        return Err(Error::input("metadata `measured_coordinates`: expected at least one true, found none"));
    }
    if let Some(residual) = metadata.mean_residual {
        not_negative("mean_residual", residual)?;
    }
    Ok(())
}

/// Checks the numbers of a pose: those of the tensor and those of the metadata.
///
/// # Errors
/// `Input` that names the field.
pub(super) fn check_pose(k: usize, pose: &ScanPoseReport) -> Result<()> {
    let length = pose.quaternion_xyzw.iter().map(|q| q * q).sum::<f64>().sqrt();
    // False for NaN, too.
    let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
    if !is_unit {
        return Err(Error::input(format!(
            "tensor `poses`, row {k}: expected a quaternion x y z w of length 1 in columns 3 to 6, found \
             {} of length {length}",
            listed(&pose.quaternion_xyzw)
        )));
    }
    for (field, value) in [
        ("sigma_translation", pose.sigma_translation),
        ("sigma_rotation_deg", pose.sigma_rotation_deg),
        ("moved", pose.moved),
        ("turned_deg", pose.turned_deg),
        ("sigma_bias", pose.sigma_bias),
    ] {
        // σ is 0 for a pose that is taken as exact.
        value.map_or(Ok(()), |value| not_negative(format_args!("poses[{k}].{field}"), value))?;
    }
    if let Some(covariance) = &pose.covariance {
        check_semidefinite(format_args!("metadata `poses[{k}].covariance`"), covariance.as_flattened(), 6)?;
    }
    Ok(())
}

/// Requires the diagonal and the 2 × 2 minors of a matrix of that size to be those of a symmetric, positive
/// semidefinite one. Cost: one look at each number; a factorisation would be exact but cubic.
///
/// # Errors
/// `Input` with row and column.
pub(super) fn check_semidefinite(what: impl Display, matrix: &[f64], size: usize) -> Result<()> {
    let at = |i: usize, j: usize| matrix[i * size + j];
    for i in 0..size {
        if at(i, i) < 0.0 {
            return Err(Error::input(format!(
                "{what}, row {i}, column {i}: expected a number ≥ 0 on the diagonal, found {}",
                at(i, i)
            )));
        }
    }
    for i in 0..size {
        for j in 0..i {
            let scale = (at(i, i) * at(j, j)).sqrt();
            if at(i, j).abs() > (1.0 + MINOR_TOLERANCE) * scale {
                return Err(Error::input(format!(
                    "{what}, row {i}, column {j}: expected at most {scale} (the root of the product of both \
                     diagonal numbers), found {}",
                    at(i, j)
                )));
            }
            if (at(i, j) - at(j, i)).abs() > MINOR_TOLERANCE * scale {
                return Err(Error::input(format!(
                    "{what}, row {i}, column {j}: expected {}, as in row {j}, column {i}, found {}",
                    at(j, i),
                    at(i, j)
                )));
            }
        }
    }
    Ok(())
}

/// Requires the diagonal and the 2 × 2 minors of information with blocks of three to be those of a positive
/// semidefinite matrix, and with `proper` every diagonal block to be positive.
///
/// # Errors
/// `Input` with the block and its vertex.
pub(super) fn check_information(name: &str, information: &BlockInformation, proper: bool) -> Result<()> {
    let (pattern, values) = (information.pattern(), information.values());
    let diagonal = information.diagonal();
    let fail = |block: usize, vertex: usize, expected: &str, found: f64| {
        Err(Error::input(format!(
            "tensor `{name}_values`, block {block} (vertex {vertex}): expected {expected}, found {found}"
        )))
    };
    for (vertex, own) in diagonal.as_chunks::<3>().0.iter().enumerate() {
        // The diagonal block is the first of its column.
        let block = pattern.column_range(vertex).start;
        if let Some(&negative) = own.iter().find(|&&d| d < 0.0) {
            return fail(block, vertex, "numbers ≥ 0 on the diagonal", negative);
        }
        let trace = own.iter().sum::<f64>();
        if proper && trace <= 0.0 {
            return fail(block, vertex, "information > 0, because the smoothness weight is positive", trace);
        }
    }
    for column in 0..pattern.nodes() {
        for (block, &row) in pattern.column_range(column).zip(pattern.column(column)) {
            for k in 0..9 {
                let (a, b) = (diagonal[3 * row as usize + k / 3], diagonal[3 * column + k % 3]);
                let (bound, value) = ((a * b).sqrt(), values[9 * block + k]);
                if value.abs() > (1.0 + MINOR_TOLERANCE) * bound {
                    let expected =
                        format!("at most {bound} (from the diagonal of vertices {row} and {column})");
                    return fail(block, column, &expected, value);
                }
            }
        }
    }
    Ok(())
}
