//! Labels with dimensions and σ next to the lines of a contour's drawing.
//!
//! Input: drawn contours and their reported dimensions. Output: a label for each reported length of a
//! straight line and each radius of an arc.
//!
//! Not guaranteed: labels of close lines may overlap.

use super::page::with_sigma;
use crate::contour::ContourReport;
use planish_contour::planar::ContourKind;
use planish_exchange::contours::{DrawnContour, SizeLabel};

/// Maximum relative difference between a drawn line and a reported size that still are the same. Both come
/// from the same parameters and differ by rounding only.
const LENGTH_TOLERANCE: f64 = 1e-6;

/// A reported size.
struct Size {
    name: String,
    value: f64,
    sigma: f64,
    is_radius: bool,
}

/// The sizes of a contour: those of its bars and circles where relations were imposed, else its parameters.
fn sizes_of(report: &ContourReport, contour: usize) -> Vec<Size> {
    if let Some(found) = &report.constrained {
        let sizes_of = |sizes: &[crate::contour::ReportedSize], is_radius: bool| -> Vec<Size> {
            let own = sizes.iter().filter(|size| size.contour == contour);
            own.map(|size| Size { name: size.name.clone(), value: size.value, sigma: size.sigma, is_radius })
                .collect()
        };
        let mut sizes = sizes_of(&found.bars, false);
        sizes.extend(sizes_of(&found.circles, true));
        return sizes;
    }
    let part = report.contours.get(contour);
    (part.into_iter().flat_map(|part| part.parameters.iter().chain(&part.sides)))
        .map(|(name, value)| Size {
            name: name.clone(),
            value: value.value,
            sigma: value.sigma,
            is_radius: name.contains("radius"),
        })
        .collect()
}

/// Labels for the lines of all contours.
pub(crate) fn size_labels(report: &ContourReport, drawn: &[DrawnContour]) -> Vec<SizeLabel> {
    let mut labels = Vec::new();
    for (k, contour) in drawn.iter().enumerate() {
        let Some(outline) = contour.kind.outline(&contour.theta) else {
            continue;
        };
        let mut sizes = sizes_of(report, k);
        if matches!(contour.kind, ContourKind::Circle | ContourKind::Ellipse) {
            labels.extend(round_labels(&contour.kind, &outline.vertices, &sizes));
            continue;
        }
        let n = outline.vertices.len();
        let middle = [0, 1].map(|d| outline.vertices.iter().map(|v| v[d]).sum::<f64>() / n.max(1) as f64);
        for i in 0..if outline.closed { n } else { n.saturating_sub(1) } {
            let (a, b) = (outline.vertices[i], outline.vertices[(i + 1) % n]);
            let bulge = outline.bulges.get(i).copied().unwrap_or(0.0);
            let chord = [b[0] - a[0], b[1] - a[1]];
            let length = chord[0].hypot(chord[1]);
            let is_radius = bulge != 0.0;
            // The bulge is the tangent of a quarter of the arc's angle, as in DXF.
            let value = if is_radius { length * (1.0 + bulge * bulge) / (4.0 * bulge.abs()) } else { length };
            let same = |size: &Size| {
                size.is_radius == is_radius && (size.value - value).abs() <= LENGTH_TOLERANCE * value
            };
            // Each size is written once: the corners of a rounded rectangle share one.
            let Some(found) = sizes.iter().position(same) else {
                continue;
            };
            let size = sizes.swap_remove(found);
            // The apex of an arc is to the right of its chord, at a distance of the bulge times half the
            // chord.
            let at = [0.5 * (a[0] + b[0] + bulge * chord[1]), 0.5 * (a[1] + b[1] - bulge * chord[0])];
            labels.push(SizeLabel {
                at,
                outwards: outwards(at, middle, chord),
                text: format!("{}{}", if is_radius { "R " } else { "" }, with_sigma(size.value, size.sigma)),
            });
        }
    }
    labels
}

/// Labels of a circle or an ellipse, which are drawn as many short lines that begin at the end of the first
/// half axis.
fn round_labels(kind: &ContourKind, vertices: &[[f64; 2]], sizes: &[Size]) -> Vec<SizeLabel> {
    let n = vertices.len();
    // The labels are at vertices n/8 and n/4, which must differ.
    if n < 8 {
        return Vec::new();
    }
    let middle = [0, 1].map(|d| vertices.iter().map(|v| v[d]).sum::<f64>() / n as f64);
    let wanted: &[(&str, &str, usize)] = match kind {
        ContourKind::Circle => &[("radius", "R ", n / 8)],
        _ => &[("semi_major", "a ", 0), ("semi_minor", "b ", n / 4)],
    };
    let label = |&(name, sign, vertex): &(&str, &str, usize)| {
        let size = sizes.iter().find(|size| size.name == name || sizes.len() == 1)?;
        let at = vertices[vertex];
        let off = [at[0] - middle[0], at[1] - middle[1]];
        let length = off[0].hypot(off[1]).max(f64::MIN_POSITIVE);
        Some(SizeLabel {
            at,
            outwards: off.map(|c| c / length),
            text: format!("{sign}{}", with_sigma(size.value, size.sigma)),
        })
    };
    wanted.iter().filter_map(label).collect()
}

/// The normal of a line that leads away from the middle.
fn outwards(at: [f64; 2], middle: [f64; 2], along: [f64; 2]) -> [f64; 2] {
    let length = along[0].hypot(along[1]).max(f64::MIN_POSITIVE);
    let normal = [along[1] / length, -along[0] / length];
    let side = normal[0] * (at[0] - middle[0]) + normal[1] * (at[1] - middle[1]);
    if side < 0.0 { normal.map(|c| -c) } else { normal }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(name: &str, value: f64) -> Size {
        Size { name: name.to_owned(), value, sigma: 0.01, is_radius: name == "radius" }
    }

    #[test]
    fn round_contours_have_their_radii_at_their_ends() {
        let outline = ContourKind::Ellipse.outline(&[1.0, 2.0, 5.0, 3.0, 0.0]).unwrap();
        let labels = round_labels(
            &ContourKind::Ellipse,
            &outline.vertices,
            &[size("semi_major", 5.0), size("semi_minor", 3.0)],
        );
        assert_eq!(labels.len(), 2);
        assert_eq!(labels[0].text, "a 5.000 ± 0.010");
        // Labels are at the ends of the half axes; the larger one is along x here.
        let off = |label: &SizeLabel| (label.at[0] - 1.0).hypot(label.at[1] - 2.0);
        assert!((off(&labels[0]) - 5.0).abs() < 1e-6 && (off(&labels[1]) - 3.0).abs() < 1e-6);
        assert!(labels[0].outwards[0] > 0.99 && labels[1].outwards[1].abs() > 0.99);
    }

    #[test]
    fn labels_are_outside() {
        assert_eq!(outwards([0.0, 1.0], [0.0; 2], [3.0, 0.0]), [0.0, 1.0]);
        assert_eq!(outwards([0.0, -1.0], [0.0; 2], [3.0, 0.0]), [0.0, -1.0]);
    }
}
