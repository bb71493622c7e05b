//! Exact views from adjusted contours.

use super::ConsistentViews;
use crate::views::{Curve2, Drawing, DrawnCurve, LineStyle, View};
use planish_contour::planar::{ContourKind, arc_circle};
use planish_estimate::{Error, Result};
use std::f64::consts::TAU;

impl ConsistentViews {
    /// The adjusted views as a drawing without errors. All lines are visible, since sensors see no hidden
    /// ones.
    ///
    /// # Errors
    /// `Unsupported` for an ellipse or an infinite line, which no solid of planes and cylinders shows;
    /// `Input` if the imposed constraints leave no contour of its kind.
    pub fn exact_views(&self) -> Result<Drawing> {
        let mut drawing = Drawing::default();
        for (i, kind) in self.kinds.iter().enumerate() {
            let (own, covariance) = self.view(i)?;
            let mut curves = Vec::new();
            for (k, part) in self.sketches[i].parts.iter().enumerate() {
                let name = |what: &str| format!("{what} of contour {} ({})", k + 1, part.kind);
                let (theta, _) = self.sketches[i]
                    .contour(k, &own, &covariance)
                    .map_err(|e| e.in_context(format!("the {} view", kind.name())))?;
                for (curve, what) in outline(&part.kind, &theta).map_err(|e| {
                    e.in_context(format!("the {} view, contour {} ({})", kind.name(), k + 1, part.kind))
                })? {
                    curves.push(DrawnCurve { curve, style: LineStyle::Visible, entity: name(&what) });
                }
            }
            drawing.views.push(View::new(*kind, curves));
        }
        Ok(drawing)
    }
}

/// The curves of a contour, each with its name.
fn outline(kind: &ContourKind, theta: &[f64]) -> Result<Vec<(Curve2, String)>> {
    if let ContourKind::Circle = kind {
        let circle = Curve2::Arc { center: [theta[0], theta[1]], radius: theta[2], start: 0.0, sweep: TAU };
        return Ok(vec![(circle, "the whole".to_owned())]);
    }
    if matches!(kind, ContourKind::Ellipse | ContourKind::Line) {
        return Err(Error::unsupported(
            "expected circles, or outlines of lines and arcs: only these are views of planes and cylinders",
        ));
    }
    let Some(outline) = kind.outline(theta) else {
        return Ok(Vec::new());
    };
    // The bulge of a side is tan(θ/4) for the sweep θ of its arc; 0 is a straight side.
    let count = outline.vertices.len();
    let curves = outline.bulges.iter().enumerate().map(|(i, &bulge)| {
        let (a, b) = (outline.vertices[i], outline.vertices[(i + 1) % count]);
        let name = format!("side {}", i + 1);
        if bulge == 0.0 {
            return (Curve2::Segment(a, b), name);
        }
        let (center, radius) = arc_circle(a, b, bulge);
        // A negative bulge is a clockwise arc; arcs of a view are counter-clockwise, so it starts at its end.
        let from = if bulge > 0.0 { a } else { b };
        let arc = Curve2::Arc {
            center,
            radius,
            start: (from[1] - center[1]).atan2(from[0] - center[0]),
            sweep: 4.0 * bulge.abs().atan(),
        };
        (arc, name)
    });
    Ok(curves.collect())
}
