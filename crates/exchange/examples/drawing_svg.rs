//! Writes the curves of a drawing as SVG, to look at how a picture was traced: hidden lines are red dashes.
//!
//! ```text
//! cargo run --example drawing_svg -- picture.png traced.svg
//! ```

use planish_solid::views::{Curve2, LineStyle};
use std::fmt::Write;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(input), Some(output)) = (arguments.next(), arguments.next()) else {
        return Err("expected a drawing and the SVG file to write".into());
    };
    let drawing = planish_exchange::read_drawing(Path::new(&input))?;
    let all = drawing.curves.iter().map(|c| c.curve.bounds());
    let [[left, right], [bottom, top]] = all.fold([[f64::MAX, f64::MIN]; 2], |all, own| {
        [0, 1].map(|k| [all[k][0].min(own[k][0]), all[k][1].max(own[k][1])])
    });
    let (width, height) = (right - left + 20.0, top - bottom + 20.0);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" \
         viewBox=\"0 0 {width} {height}\" fill=\"none\" stroke-width=\"0.6\">\n"
    );
    let at = |p: [f64; 2]| format!("{} {}", p[0] - left + 10.0, top - p[1] + 10.0);
    for drawn in &drawing.curves {
        let path = match &drawn.curve {
            Curve2::Arc { center, radius, start, sweep } => {
                let on = |angle: f64| [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()];
                let piece = |from: f64, to: f64| {
                    let half = 0.5 * (from + to);
                    let [a, b, c] = [from, half, to].map(|t| at(on(t)));
                    format!("M {a} A {radius} {radius} 0 0 0 {b} A {radius} {radius} 0 0 0 {c}")
                };
                piece(*start, start + sweep)
            }
            curve => format!("M {}", curve.points().iter().map(|p| at(*p)).collect::<Vec<_>>().join(" L ")),
        };
        let style = match drawn.style {
            LineStyle::Hidden => "stroke=\"red\" stroke-dasharray=\"4 2\"",
            LineStyle::Visible => "stroke=\"black\"",
        };
        writeln!(text, "<path d=\"{path}\" {style}><title>{}</title></path>", drawn.entity)?;
    }
    std::fs::write(output, text + "</svg>\n")?;
    Ok(())
}
