//! The solid that contours of several levels form.

use super::Part;
use super::report::canonical;
use nalgebra::{DMatrix, DVector};
use planish_contour::planar::ContourKind;
use planish_estimate::ChiSquareBand;
use serde::Serialize;

/// Confidence of the test that compares levels. Levels that pass are treated as equal. A higher value merges
/// levels that differ; a lower one separates equal levels by chance. Guarded by the test
/// `equal_levels_form_a_prism_and_coaxial_circles_a_revolution`.
const CONFIDENCE: f64 = 0.99;

/// How the main contours of the levels are related.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Relation {
    /// All are the same: a prism (a cylinder if they are circles).
    Prism,
    /// Circles about one axis, of different radii.
    Revolution,
    /// Neither.
    None,
}

/// Levels compared.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LevelRelation {
    /// The kind of solid that the levels form.
    pub relation: Relation,
    /// The levels whose contours were compared.
    pub levels: Vec<f64>,
    /// `Σ (x − x̄)ᵀ P⁻¹ (x − x̄)` over the levels.
    pub chi_square: f64,
    /// Its degrees of freedom.
    pub degrees: usize,
    /// Its limit at 99 %.
    pub limit: f64,
    /// Mean of the agreeing parameters, weighted by information: names, values, σ.
    pub mean: Vec<(String, f64, f64)>,
}

/// Compares the largest contour of each level; `None` with fewer than two levels.
pub(super) fn relation(parts: &[Part]) -> Option<LevelRelation> {
    let mut main: Vec<&Part> = Vec::new();
    // Parts are sorted by size, so the first of each level is its largest.
    for part in parts.iter().filter(|p| p.level.is_some()) {
        if !main.iter().any(|m| m.level == part.level) {
            main.push(part);
        }
    }
    main.sort_by(|a, b| a.level.partial_cmp(&b.level).unwrap_or(std::cmp::Ordering::Equal));
    if main.len() < 2 {
        return None;
    }
    let levels: Vec<f64> = main.iter().filter_map(|p| p.level).collect();
    let no_relation = LevelRelation {
        relation: Relation::None,
        levels: levels.clone(),
        chi_square: f64::NAN,
        degrees: 0,
        limit: f64::NAN,
        mean: Vec::new(),
    };
    let kind = &main[0].choice.fit.kind;
    // Different kinds have no parameters in common that could be compared.
    if main.iter().any(|p| p.choice.fit.kind != *kind) {
        return Some(no_relation);
    }
    let all = kind.parameters();
    let compared = compare(&main, all, levels.clone());
    let Some(prism) = compared else {
        return Some(no_relation);
    };
    // The stricter relation first: a prism of circles is also a solid of revolution.
    if prism.chi_square <= prism.limit {
        return Some(LevelRelation { relation: Relation::Prism, ..prism });
    }
    if *kind == ContourKind::Circle
        && let Some(axis) = compare(&main, 2, levels)
        && axis.chi_square <= axis.limit
    {
        return Some(LevelRelation { relation: Relation::Revolution, ..axis });
    }
    Some(prism)
}

/// The first `count` parameters of all levels against their mean.
fn compare(main: &[&Part], count: usize, levels: Vec<f64>) -> Option<LevelRelation> {
    let mut information = DMatrix::zeros(count, count);
    let mut vector = DVector::zeros(count);
    let mut each = Vec::new();
    let mut names = Vec::new();
    for part in main {
        let (order, values, covariance) = canonical(&part.choice.fit);
        let mut x = DVector::from_column_slice(&values[..count]);
        if let Some((first, _)) = each.first() {
            let first: &DVector<f64> = first;
            for k in 0..count {
                // Angles just below the period and just above zero are close.
                if order[k].ends_with("_deg") {
                    let period = period_deg(&part.choice.fit.kind);
                    x[k] -= period * ((x[k] - first[k]) / period).round();
                }
            }
        }
        // The block of the covariance before inversion: this leaves the other parameters free. A block of the
        // information would hold them fixed.
        let weight = covariance.view((0, 0), (count, count)).into_owned().try_inverse()?;
        information += &weight;
        vector += &weight * &x;
        names = order;
        each.push((x, weight));
    }
    let covariance = information.try_inverse()?;
    let mean = &covariance * vector;
    let chi_square = each
        .iter()
        .map(|(x, weight)| {
            let off = x - &mean;
            off.dot(&(weight * &off))
        })
        .sum();
    let degrees = count * (main.len() - 1);
    // One-sided test by the upper limit of a two-sided band.
    let limit = ChiSquareBand::of_sum(degrees as f64, 2.0 * CONFIDENCE - 1.0).ok()?.upper;
    Some(LevelRelation {
        relation: Relation::None,
        levels,
        chi_square,
        degrees,
        limit,
        mean: (0..count).map(|k| (names[k].clone(), mean[k], covariance[(k, k)].sqrt())).collect(),
    })
}

fn period_deg(kind: &ContourKind) -> f64 {
    match kind {
        ContourKind::RegularPolygon(sides) => 360.0 / *sides as f64,
        _ => 180.0,
    }
}
