//! The lines of a drawing that no solid explains, in words.

use super::Unexplained;
use super::sight::{Expected, SightTestPlace};
use crate::drawing::{Drawing, LineStyle};
use std::collections::HashMap;

/// Lists each unexplained line once, with its first position and the number of other positions.
pub(super) fn unexplained(
    drawing: &Drawing,
    found: &[(Expected, SightTestPlace)],
    scale: f64,
) -> Vec<Unexplained> {
    // One line of the drawing may fail hundreds of tests; a list of all would hide the other lines.
    let mut places: Vec<(Expected, &SightTestPlace, usize)> = Vec::new();
    let mut known: HashMap<(Expected, usize, Option<usize>), usize> = HashMap::new();
    for (expected, place) in found {
        let next = places.len();
        match *known.entry((*expected, place.view, place.curve)).or_insert(next) {
            at if at == next => places.push((*expected, place, 0)),
            at => places[at].2 += 1,
        }
    }
    places
        .into_iter()
        .map(|(expected, place, others)| {
            let view = &drawing.views[place.view];
            let what = match expected {
                Expected::Line(LineStyle::Visible) => "no solid shows a visible line",
                Expected::Line(LineStyle::Hidden) => "no solid shows a hidden line",
                Expected::NoEdge | Expected::NoVisibleEdge => {
                    "the drawing lacks a line that every solid shows"
                }
                Expected::Material(true) => "no solid has material where the section is hatched",
                Expected::Material(false) => "every solid has material where the section is not hatched",
            };
            let more = match others {
                0 => String::new(),
                1 => " and at one more place".to_owned(),
                n => format!(" and at {n} more places"),
            };
            Unexplained {
                view: view.kind,
                entity: place.curve.map(|c| view.curves[c].entity.clone()),
                reason: format!(
                    "{what} at {} {}{more}",
                    figure(scale * place.at[0]),
                    figure(scale * place.at[1])
                ),
            }
        })
        .collect()
}

/// Formats a coordinate with four decimals, in scientific notation if it is very small or large.
pub(super) fn figure(value: f64) -> String {
    match value.abs() {
        size if size == 0.0 || (1e-3..1e9).contains(&size) => format!("{value:.4}"),
        _ => format!("{value:.4e}"),
    }
}
