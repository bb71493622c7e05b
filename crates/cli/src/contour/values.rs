//! Parsers of option values of `planish contour`.

use crate::values::numbers;
use planish::contour::{ContourKind, PrimitiveKind};

/// Maximum number of corners of a polygon.
const MAX_CORNERS: usize = 40;

/// Value of `--kind`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KindChoice {
    /// The kind with the best BIC.
    Auto,
    /// One kind of contour in the plane.
    Plane(ContourKind),
    /// A chain of lines and arcs, closed or open.
    Chain,
    /// Straight walls with gaps.
    Walls,
    /// One kind of shape in space.
    Space(PrimitiveKind),
}

/// Parses a value of `--kind`.
pub fn kind(text: &str) -> Result<KindChoice, String> {
    if text == "auto" {
        return Ok(KindChoice::Auto);
    }
    if text == "chain" {
        return Ok(KindChoice::Chain);
    }
    if text == "walls" {
        return Ok(KindChoice::Walls);
    }
    // The names come from the library, so that a new kind is accepted here without a change.
    if let Some(shape) = PrimitiveKind::ALL.into_iter().find(|shape| shape.to_string() == text) {
        return Ok(KindChoice::Space(shape));
    }
    ContourKind::from_name(text, MAX_CORNERS).map(KindChoice::Plane).ok_or_else(|| {
        format!(
            "expected auto, line, circle, ellipse, rectangle, rounded-rectangle, slot, chain, \
             walls, regular-polygon-N or polygon-N with N from 3 to {MAX_CORNERS}; or in space plane3, \
             sphere, cylinder, box"
        )
    })
}

/// Parses two numbers, such as `0.05,20`.
pub fn pair(text: &str) -> Result<[f64; 2], String> {
    numbers(text, "0.05,20")
}

/// Two opposite corners of a rectangle, returned as minimum and maximum: x0, y0, x1, y1.
pub fn rectangle(text: &str) -> Result<[f64; 4], String> {
    let [a, b, c, d] = numbers(text, "0,0,4,3")?;
    Ok([f64::min(a, c), f64::min(b, d), f64::max(a, c), f64::max(b, d)])
}
