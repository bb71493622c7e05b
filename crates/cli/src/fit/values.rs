//! Parsers of option values of `planish fit`.

use crate::values::within;
use planish::complete::SymmetryChoice;
use planish::{DVec3, SymmetryKind};

/// Largest subdivision depth that is accepted. At depth 7 a cell is 1/128 of a base cell, smaller than the
/// spacing of readings in practice.
const MAX_DEPTH: u8 = 7;

/// `auto`, `rotation:ORDER[:DIRECTION]` or `mirror[:DIRECTION]`; a direction is an axis or three numbers.
pub fn symmetry(text: &str) -> Result<SymmetryChoice, String> {
    const NEEDED: &str = "expected auto, rotation:full, rotation:N (N from 2) or mirror, optionally with a \
                          direction after it (rotation:full:z, mirror:0,1,0.2)";
    let mut parts = text.split(':');
    let kind = parts.next().unwrap_or_default();
    let order = match kind {
        "rotation" => Some(match parts.next().ok_or(NEEDED)? {
            "full" => None,
            number => match number.parse::<u32>() {
                // Order 1 is no symmetry. Above 1000, `full` is meant.
                Ok(order) if (2..=1000).contains(&order) => Some(order),
                _ => return Err(format!("{NEEDED}; found the order {number:?}")),
            },
        }),
        _ => None,
    };
    let towards = parts.next().map(direction).transpose()?;
    match (kind, order, parts.next()) {
        ("rotation", Some(order), None) => Ok(SymmetryChoice::Of(SymmetryKind::Rotation { order, towards })),
        ("mirror", None, None) => Ok(SymmetryChoice::Of(SymmetryKind::Mirror { towards })),
        // A direction is a hint for one axis or plane, but `auto` also chooses between the kinds.
        ("auto", None, None) if towards.is_none() => Ok(SymmetryChoice::Auto),
        _ => Err(NEEDED.to_owned()),
    }
}

/// `x`, `y`, `z`, or three numbers separated by commas.
fn direction(text: &str) -> Result<DVec3, String> {
    let needed = || format!("expected a direction: x, y, z or three numbers like 0,0.1,1; found {text:?}");
    match text {
        "x" => return Ok(DVec3::X),
        "y" => return Ok(DVec3::Y),
        "z" => return Ok(DVec3::Z),
        _ => {}
    }
    let numbers: Vec<f64> =
        (text.split(',').map(|n| n.trim().parse().map_err(|_| needed()))).collect::<Result<_, _>>()?;
    let all: [f64; 3] = numbers.try_into().map_err(|_| needed())?;
    // The length is free, because only the direction counts; zero has none.
    let direction = DVec3::from(all);
    if direction.is_finite() && direction != DVec3::ZERO { Ok(direction) } else { Err(needed()) }
}

/// A number of handles.
pub fn genus(text: &str) -> Result<usize, String> {
    const MAX: usize = 1000;
    (text.parse().ok().filter(|n| *n <= MAX))
        .ok_or_else(|| format!("expected a number of handles from 0 to {MAX}, found {text:?}"))
}

/// The share of held-out readings.
pub fn held_out(text: &str) -> Result<f64, String> {
    // With a larger share, too few readings would remain for the fit that they validate.
    within(text, "a share from 0 to below 0.9", |v| (0.0..0.9).contains(&v))
}

/// A gate in multiples of σ.
pub fn gate(text: &str) -> Result<f64, String> {
    // A gate below 1 σ would reject a third of the correct readings.
    within(text, "at least 1 σ (4 is usual)", |v| v >= 1.0)
}

/// A subdivision depth.
pub fn depth(text: &str) -> Result<u8, String> {
    match text.parse() {
        Ok(depth) if depth <= MAX_DEPTH => Ok(depth),
        _ => Err(format!("expected a whole number of levels from 0 to {MAX_DEPTH}")),
    }
}

/// A maximum number of control vertices.
pub fn max_coefficients(text: &str) -> Result<usize, String> {
    let min = planish::fit_files::MIN_COEFFICIENTS;
    match text.parse() {
        Ok(n) if n >= min => Ok(n),
        _ => Err(format!("expected a whole number of at least {min}")),
    }
}
