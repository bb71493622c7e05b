//! The results of the sphere experiment as CSV and SVG.

use super::{COMPARED_NOISE, SPHERE_COLUMNS, SphereOptions, SphereRow};
use crate::figure::{Curve, Panel, draw};
use std::fmt::Write as _;

/// Draws the results as one SVG figure: a column of panels for each number of readings.
///
/// # Examples
/// ```
/// use planish_simulate::{SphereOptions, sphere_figure};
/// let svg = sphere_figure(&SphereOptions::default(), &[]);
/// assert!(svg.starts_with("<svg") && svg.contains("150 readings"));
/// ```
#[must_use]
pub fn sphere_figure(options: &SphereOptions, rows: &[SphereRow]) -> String {
    draw(
        "Mean error of a sphere in % of its radius. Solid: patch filter; dashed: global filter; dotted: \
         posterior bound",
        &panels(options, rows),
    )
}

/// The rows as CSV text with a header; an orientation of `None` is an empty field.
#[must_use]
pub fn sphere_csv(rows: &[SphereRow]) -> String {
    let mut text = SPHERE_COLUMNS.join(",") + "\n";
    for row in rows {
        let tilt = row.orientation_deg.map_or_else(String::new, |x| x.to_string());
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{},{},{tilt},{},{},{},{},{}",
            row.readings,
            row.noise_percent,
            row.depth,
            row.leaf_patches,
            row.patch_percent,
            row.global_percent,
            row.bound_percent
        );
    }
    text
}

/// One row of panels: the rows of the table that it shows, and the quantity on its x axis.
struct PanelRow<'a> {
    title: String,
    axis: &'static str,
    wanted: &'a dyn Fn(&SphereRow) -> bool,
    x: &'a dyn Fn(&SphereRow) -> f64,
}

/// One row of panels for each comparison, with one panel for each number of readings.
fn panels(options: &SphereOptions, rows: &[SphereRow]) -> Vec<Vec<Panel>> {
    let tilt = options.orientation_deg;
    let compared = &options.compared_orientations_deg;
    let panel_rows = [
        PanelRow {
            title: "positions alone".to_owned(),
            axis: "maximum position noise / % of the radius",
            wanted: &|r| r.orientation_deg.is_none(),
            x: &|r| r.noise_percent,
        },
        PanelRow {
            title: format!("and orientations to {tilt}°"),
            axis: "maximum position noise / % of the radius",
            wanted: &|r| r.orientation_deg == Some(tilt),
            x: &|r| r.noise_percent,
        },
        PanelRow {
            title: format!("position noise {COMPARED_NOISE} %"),
            axis: "maximum orientation error / °",
            wanted: &|r| {
                r.noise_percent == COMPARED_NOISE && r.orientation_deg.is_some_and(|t| compared.contains(&t))
            },
            x: &|r| r.orientation_deg.unwrap_or(0.0),
        },
    ];
    panel_rows
        .iter()
        .map(|PanelRow { title, axis, wanted, x }| {
            options
                .readings
                .iter()
                .map(|&readings| {
                    let mut curves = Vec::new();
                    for depth in 0..=options.depth {
                        // Rows are in the order of the noise already, and of the orientation within it; a
                        // line needs no sort.
                        let points: Vec<&SphereRow> = rows
                            .iter()
                            .filter(|r| r.readings == readings && r.depth == depth && wanted(r))
                            .collect();
                        let leaves =
                            points.iter().map(|r| r.leaf_patches).sum::<f64>() / points.len().max(1) as f64;
                        let curve =
                            |y: &dyn Fn(&SphereRow) -> f64| points.iter().map(|r| [x(r), y(r)]).collect();
                        // Lines of smaller depths are wider and drawn first: a line that coincides with a
                        // later one stays visible around it.
                        curves.push(Curve::patch(
                            usize::from(depth),
                            usize::from(options.depth - depth),
                            format!("depth {depth}: {leaves:.1} patches"),
                            curve(&|r| r.patch_percent),
                        ));
                        // At other depths, the global filter and the bound nearly coincide with these.
                        if depth == options.depth {
                            curves.push(Curve::global(
                                format!("global, depth {depth}"),
                                curve(&|r| r.global_percent),
                            ));
                            curves.push(Curve::bound(
                                "posterior bound".to_owned(),
                                curve(&|r| r.bound_percent),
                            ));
                        }
                    }
                    Panel {
                        title: format!("{readings} readings, {title}"),
                        x_label: (*axis).to_owned(),
                        y_label: "mean error / % of the radius".to_owned(),
                        curves,
                    }
                })
                .collect()
        })
        .collect()
}
