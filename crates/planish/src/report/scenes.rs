//! A surface model as a scene, coloured by σ, `observed`, level, curvature or number of scans.

use super::words::SmallUnit;
use planish_estimate::Result;
use planish_report::{Cloud, Field, FieldKind, LineSet, Scene, SeenBy, SurfaceShown, Values};
use planish_spline::Surface;
use planish_surface::export::{PlacedMesh, placed_mesh};
use planish_surface::fit::ResidualSample;
use planish_surface::model::{Observed, Posterior, SurfaceModel};
use std::collections::BTreeMap;

/// Maximum number of triangles of a model in a report: finer than a screen shows, and few enough to turn
/// without a graphics card.
pub(crate) const MAX_TRIANGLES: u64 = 45_000;
/// Maximum number of line segments of all cell borders.
const MAX_LINES: usize = 60_000;

/// A smaller unit in which most of the lengths are readable, if there is one.
fn small_unit<'a>(unit: &'a str, lengths: &[f64]) -> Option<SmallUnit<'a>> {
    let largest = lengths.iter().filter(|l| l.is_finite()).fold(0.0, |a: f64, b| a.max(b.abs()));
    // A factor of 1 would only repeat the unit of the model.
    Some(SmallUnit::for_length(unit, largest)).filter(|small| small.factor != 1.0)
}

/// A field of numbers.
pub(crate) fn numbers(key: &str, label: &str, unit: &str, kind: FieldKind, values: Vec<f64>) -> Field {
    Field {
        key: key.to_owned(),
        label: label.to_owned(),
        unit: unit.to_owned(),
        shown: small_unit(unit, &values).map(|small| (small.name.to_owned(), small.factor)),
        kind,
        values: Values::Numbers(values),
    }
}

/// A field of kinds.
pub(crate) fn kinds(key: &str, label: &str, kind: FieldKind, values: Vec<u16>) -> Field {
    Field {
        key: key.to_owned(),
        label: label.to_owned(),
        unit: String::new(),
        shown: None,
        kind,
        values: Values::Kinds(values),
    }
}

/// Label of a value of `observed`.
fn known_by(mark: u8) -> &'static str {
    match Observed::from_mark(mark) {
        Some(Observed::Measured) => "measured",
        Some(Observed::Inferred) => "completed",
        Some(Observed::NotFollowed) => "measured, not followed",
        _ => "smoothness alone",
    }
}

/// The field that states how each part is known. Only categories that occur are listed.
pub(crate) fn observed_field(observed: &[u8]) -> Field {
    // The best known first.
    let categories = [1, 3, 2, 0].into_iter().filter(|mark| observed.contains(mark));
    kinds(
        "observed",
        "source",
        FieldKind::Categories(categories.map(|m| (u16::from(m), known_by(m).to_owned())).collect()),
        observed.iter().map(|m| u16::from(*m)).collect(),
    )
}

/// A model as a scene, with its readings if they are available, and the chord error of its triangles.
pub(crate) fn model_scene(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    tolerance: Option<f64>,
    readings: Option<&ResidualSample>,
) -> Result<(Scene, f64)> {
    model_scene_of(model, posterior, tolerance, readings, MAX_TRIANGLES)
}

/// [`model_scene`] with a maximum number of triangles.
pub(crate) fn model_scene_of(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    tolerance: Option<f64>,
    readings: Option<&ResidualSample>,
    max_triangles: u64,
) -> Result<(Scene, f64)> {
    let placed = placed_mesh(model, posterior, tolerance, max_triangles)?;
    let unit = model.unit.name();
    let tolerance = placed.mesh.tolerance;
    let mut scene = Scene {
        unit: unit.to_owned(),
        surfaces: vec![surface_shown(model, placed, readings)],
        clouds: readings.map(|r| reading_cloud(r, unit)).into_iter().collect(),
        lines: vec![cell_lines(&model.surface)],
        ..Scene::default()
    };
    scene.clouds.push(Cloud {
        // Hidden at first: control vertices do not lie on a curved surface.
        name: "control vertices".to_owned(),
        positions: model.surface.vertices().to_vec(),
        hidden: true,
        width: 4,
        ..Cloud::default()
    });
    Ok((scene, tolerance))
}

fn surface_shown(
    model: &SurfaceModel,
    placed: PlacedMesh,
    readings: Option<&ResidualSample>,
) -> SurfaceShown {
    let PlacedMesh { mesh, leaf, local } = placed;
    let unit = model.unit.name();
    let surface = &model.surface;
    let mut fields = vec![
        numbers("sigma", "σ along the normal", unit, FieldKind::Sequential, mesh.sigma),
        observed_field(&mesh.observed),
    ];
    let level = |leaf: u32| u16::from(surface.space().leaves()[leaf as usize].level);
    let levels: Vec<u16> = leaf.iter().map(|&l| level(l)).collect();
    let deepest = levels.iter().copied().max().unwrap_or(0);
    fields.push(kinds(
        "level",
        "subdivision level",
        FieldKind::Steps((0..=deepest).map(|l| (l, format!("level {l}"))).collect()),
        levels,
    ));
    let principal: Vec<[f64; 2]> = (leaf.iter().zip(&local))
        .map(|(&leaf, &[s, t])| {
            let curvature = surface.leaf_jet(leaf as usize, s, t).curvature();
            // NaN is drawn as unknown. Zero would look like a plane.
            curvature.map_or([f64::NAN; 2], |c| c.principal)
        })
        .collect();
    let mean = principal.iter().map(|k| 0.5 * (k[0] + k[1])).collect();
    let gaussian = principal.iter().map(|k| k[0] * k[1]).collect();
    fields.extend(curvature_fields([Some(mean), Some(gaussian)], unit));
    let seen_by = readings.map(|readings| {
        // Few combinations of scans occur, so vertices store the number of a combination. Numbers follow the
        // order of leaves and are the same in every run.
        let mut sets: BTreeMap<&[u32], u32> = BTreeMap::new();
        let of_leaf: Vec<u32> = (readings.seen_by.iter())
            .map(|seen| {
                let next = sets.len() as u32;
                *sets.entry(seen).or_insert(next)
            })
            .collect();
        let mut ordered = vec![Vec::new(); sets.len()];
        for (set, k) in sets {
            ordered[k as usize] = set.to_vec();
        }
        SeenBy {
            names: readings.scans.iter().map(|scan| scan.name.clone()).collect(),
            sets: ordered,
            of_vertex: leaf.iter().map(|&leaf| of_leaf[leaf as usize]).collect(),
        }
    });
    // With a single scan, this field would repeat `observed`.
    if let Some(readings) = readings.filter(|r| r.scans.len() > 1) {
        let number: Vec<u16> = (leaf.iter())
            .map(|&leaf| readings.seen_by[leaf as usize].len().min(usize::from(u16::MAX)) as u16)
            .collect();
        let max_scans = number.iter().copied().max().unwrap_or(0);
        let name = |n: u16| match n {
            1 => "1 scan".to_owned(),
            n => format!("{n} scans"),
        };
        fields.push(kinds(
            "scans",
            "number of scans",
            FieldKind::Steps((0..=max_scans).map(|n| (n, name(n))).collect()),
            number,
        ));
        fields.extend(sensor_field(&leaf, readings));
    }
    SurfaceShown {
        name: "surface".to_owned(),
        positions: mesh.mesh.positions,
        triangles: mesh.mesh.triangles,
        fields,
        seen_by,
        ..SurfaceShown::default()
    }
}

/// The field of the sensors that measured each part. Absent for a single sensor.
fn sensor_field(leaf: &[u32], readings: &ResidualSample) -> Option<Field> {
    let mut sensors: Vec<&str> = readings.scans.iter().map(|scan| &scan.sensor[..]).collect();
    sensors.sort_unstable();
    sensors.dedup();
    if sensors.len() < 2 {
        return None;
    }
    let mut sets: BTreeMap<Vec<&str>, u16> = BTreeMap::new();
    let of_leaf: Vec<u16> = (readings.seen_by.iter())
        .map(|seen| {
            let mut set: Vec<&str> = seen.iter().map(|&s| &readings.scans[s as usize].sensor[..]).collect();
            set.sort_unstable();
            set.dedup();
            let next = sets.len() as u16;
            *sets.entry(set).or_insert(next)
        })
        .collect();
    // Pages number the entries of a legend by 16 bits.
    if sets.len() > usize::from(u16::MAX) {
        return None;
    }
    let mut categories: Vec<(u16, String)> = (sets.into_iter())
        .map(|(set, k)| (k, if set.is_empty() { "none".to_owned() } else { set.join(" + ") }))
        .collect();
    // Back in the order of first occurrence, so that colours do not depend on names.
    categories.sort_unstable();
    Some(kinds(
        "sensors",
        "sensors",
        FieldKind::Categories(categories),
        leaf.iter().map(|&leaf| of_leaf[leaf as usize]).collect(),
    ))
}

fn reading_cloud(readings: &ResidualSample, unit: &str) -> Cloud {
    let mut fields = vec![
        numbers(
            "normalised",
            "normalised residual",
            "",
            // Colours saturate where readings are rejected. An infinite gate rejects none.
            FieldKind::Signed(Some(readings.gate).filter(|gate| gate.is_finite())),
            readings.normalised.clone(),
        ),
        numbers("residual", "residual", unit, FieldKind::Signed(None), readings.residuals.clone()),
    ];
    // Pages number the entries of a legend by 16 bits. Nobody reads a legend of more scans.
    if readings.scans.len() <= 1 << 16 {
        let names = (0..=u16::MAX).zip(&readings.scans);
        let scans = readings.scan.iter().map(|k| *k as u16).collect();
        let names = names.map(|(k, scan)| (k, scan.name.clone())).collect();
        fields.push(kinds("scan", "scan", FieldKind::Categories(names), scans));
    }
    fields.push(kinds(
        "used",
        "used",
        FieldKind::Categories(vec![(1, "yes".to_owned()), (0, "no (rejected)".to_owned())]),
        readings.used.iter().map(|u| u16::from(*u)).collect(),
    ));
    Cloud {
        name: "readings, coloured by residual".to_owned(),
        positions: readings.places.clone(),
        fields,
        hidden: true,
        width: 3,
    }
}

/// The borders of all leaves: the quadtree on the surface.
fn cell_lines(surface: &Surface) -> LineSet {
    let leaves = surface.space().leaves().len();
    // Curved borders need several pieces. Models of many cells have short borders, for which one is enough.
    let pieces = (MAX_LINES / (2 * leaves.max(1))).clamp(1, 8);
    let mut segments = Vec::with_capacity(2 * leaves * pieces);
    for leaf in 0..leaves {
        // The other two sides belong to neighbours, so each line is drawn once.
        for side in [|x: f64| [x, 0.0], |x: f64| [0.0, x]] {
            let at = |k: usize| {
                let [s, t] = side(k as f64 / pieces as f64);
                surface.leaf_point(leaf, s, t)
            };
            segments.extend((0..pieces).map(|k| [at(k), at(k + 1)]));
        }
    }
    LineSet { name: "cells".to_owned(), segments, colour: "#1b1b1f".to_owned(), hidden: true }
}

/// The fields of mean and Gaussian curvature, as far as they are known.
pub(crate) fn curvature_fields(curvature: [Option<Vec<f64>>; 2], unit: &str) -> Vec<Field> {
    // Without a unit, "1/" would stand alone.
    let per = |power: &str| if unit.is_empty() { String::new() } else { format!("1/{unit}{power}") };
    let names = [
        ("mean_curvature", "mean curvature", per("")),
        ("gaussian_curvature", "Gaussian curvature", per("²")),
    ];
    (names.into_iter().zip(curvature))
        .filter_map(|((name, label, unit), values)| {
            Some(numbers(name, label, &unit, FieldKind::Signed(None), values?))
        })
        .collect()
}
