//! Line charts as SVG: panels of curves with axes, units and legends.
//!
//! Input: rows of [`Panel`]s. Output: one SVG document. Axes start at zero, and all panels of a row have the
//! same scale so that they can be compared. The same curves give the same bytes.
//!
//! Not guaranteed: that a legend never covers a curve. It lies in the corner with the fewest points.

use std::fmt::Write as _;

const WIDTH: f64 = 400.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 48.0;
/// Height of the headline.
const HEAD: f64 = 40.0;
/// Colours that most colour-blind readers can distinguish (Okabe and Ito).
const COLOURS: [&str; 5] = ["#d55e00", "#e69f00", "#009e73", "#0072b2", "#cc79a7"];

/// A line with its name in the legend.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Curve {
    name: String,
    colour: &'static str,
    dash: &'static str,
    marked: bool,
    width: f64,
    points: Vec<[f64; 2]>,
}

impl Curve {
    /// A solid line with markers, with a colour by number.
    ///
    /// It is wider the more lines are drawn `after` it: lines that coincide then remain visible as bands.
    pub fn patch(number: usize, after: usize, name: String, points: Vec<[f64; 2]>) -> Self {
        Self {
            width: 1.8 + 2.4 * after as f64,
            name,
            colour: COLOURS[number % COLOURS.len()],
            dash: "",
            marked: true,
            points,
        }
    }

    /// A dashed black line.
    pub fn global(name: String, points: Vec<[f64; 2]>) -> Self {
        Self { width: 1.3, name, colour: "#000000", dash: "7 4", marked: false, points }
    }

    /// A dotted grey line.
    pub fn bound(name: String, points: Vec<[f64; 2]>) -> Self {
        Self { width: 1.8, name, colour: "#707070", dash: "1.5 4", marked: false, points }
    }
}

/// One chart.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Panel {
    pub title: String,
    pub x_label: String,
    pub y_label: String,
    pub curves: Vec<Curve>,
}

/// Draws rows of panels under a headline and returns the SVG document.
pub(super) fn draw(headline: &str, rows: &[Vec<Panel>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let (width, height) = (WIDTH * columns as f64, HEAD + HEIGHT * rows.len() as f64);
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 \
         {width} {height}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\" fill=\"#202020\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>"
    );
    text(&mut out, [width / 2.0, 25.0], "middle", "font-size=\"15\"", headline);
    for (r, row) in rows.iter().enumerate() {
        // One scale for the whole row, from all its panels: their curves can then be compared by eye.
        let largest = |d: usize| {
            row.iter()
                .flat_map(|p| &p.curves)
                .flat_map(|c| &c.points)
                .map(|p| p[d])
                .filter(|x| x.is_finite())
                .fold(0.0_f64, f64::max)
        };
        // A little room above the highest point; the x axis ends at the last value by itself.
        let scale = [Axis::to(largest(0), 6), Axis::to(1.05 * largest(1), 5)];
        for (c, panel) in row.iter().enumerate() {
            draw_panel(&mut out, panel, [WIDTH * c as f64, HEAD + HEIGHT * r as f64], &scale);
        }
    }
    out.push_str("</svg>\n");
    out
}

/// An axis from zero to `end` with round steps.
struct Axis {
    end: f64,
    step: f64,
}

impl Axis {
    /// An axis up to at least `largest` with about `steps` steps.
    fn to(largest: f64, steps: usize) -> Self {
        if largest <= 0.0 {
            return Self { end: 1.0, step: 0.5 };
        }
        // Round steps only, so that labels have few digits.
        let rough = largest / steps as f64;
        // The tolerances keep a value that is round up to rounding from starting another step.
        let decade = 10.0_f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 2.5, 5.0, 10.0]
            .map(|m| m * decade)
            .into_iter()
            .find(|step| *step >= rough * (1.0 - 1e-9))
            .unwrap_or(10.0 * decade);
        Self { end: step * (largest / step - 1e-9).ceil(), step }
    }

    fn ticks(&self) -> impl Iterator<Item = f64> + '_ {
        (0..=(self.end / self.step).round() as usize).map(|k| k as f64 * self.step)
    }
}

fn draw_panel(out: &mut String, panel: &Panel, [x0, y0]: [f64; 2], scale: &[Axis; 2]) {
    let (left, right) = (x0 + LEFT, x0 + WIDTH - RIGHT);
    let (top, bottom) = (y0 + TOP, y0 + HEIGHT - BOTTOM);
    // SVG counts y downwards.
    let place = |p: [f64; 2]| {
        [left + (right - left) * p[0] / scale[0].end, bottom - (bottom - top) * p[1] / scale[1].end]
    };
    text(out, [(left + right) / 2.0, y0 + 22.0], "middle", "font-weight=\"bold\"", &panel.title);
    // The grid first: SVG paints in order, so curves lie over it.
    for y in scale[1].ticks() {
        let [_, at] = place([0.0, y]);
        line(out, [left, at], [right, at], "#e2e2e2");
        text(out, [left - 6.0, at + 4.0], "end", "", &number(y));
    }
    for x in scale[0].ticks() {
        let [at, _] = place([x, 0.0]);
        line(out, [at, bottom], [at, bottom + 4.0], "#404040");
        text(out, [at, bottom + 17.0], "middle", "", &number(x));
    }
    line(out, [left, bottom], [right, bottom], "#404040");
    line(out, [left, top], [left, bottom], "#404040");
    text(out, [(left + right) / 2.0, bottom + 36.0], "middle", "", &panel.x_label);
    let turned = format!("transform=\"rotate(-90 {:.1} {:.1})\"", x0 + 16.0, (top + bottom) / 2.0);
    text(out, [x0 + 16.0, (top + bottom) / 2.0], "middle", &turned, &panel.y_label);
    for curve in &panel.curves {
        let points: Vec<[f64; 2]> = curve.points.iter().map(|&p| place(p)).collect();
        let joined: Vec<String> = points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        let _ = writeln!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" \
             stroke-linecap=\"round\" stroke-dasharray=\"{}\"/>",
            joined.join(" "),
            curve.colour,
            curve.width,
            curve.dash
        );
        for [x, y] in points.iter().filter(|_| curve.marked) {
            let _ = writeln!(
                out,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\" fill=\"{}\"/>",
                0.8 + curve.width,
                curve.colour
            );
        }
    }
    draw_legend(out, panel, [left, right, top, bottom], &place);
}

/// Draws the names of the curves in the corner of the panel that covers the fewest points.
fn draw_legend(
    out: &mut String,
    panel: &Panel,
    [left, right, top, bottom]: [f64; 4],
    place: &dyn Fn([f64; 2]) -> [f64; 2],
) {
    let (width, height) = (158.0, 15.0 * panel.curves.len() as f64 + 6.0);
    // In order of preference: of equally free corners, the first is taken. Sizes are estimated, because
    // SVG cannot measure text.
    let corners = [
        [left + 8.0, top + 4.0],
        [right - width - 4.0, bottom - height - 6.0],
        [right - width - 4.0, top + 4.0],
        [left + 8.0, bottom - height - 6.0],
    ];
    let covered = |corner: &[f64; 2]| {
        panel
            .curves
            .iter()
            .flat_map(|c| &c.points)
            .filter(|p| {
                let [x, y] = place(**p);
                (corner[0] - 8.0..corner[0] + width + 8.0).contains(&x)
                    && (corner[1] - 8.0..corner[1] + height + 8.0).contains(&y)
            })
            .count()
    };
    let [x, y] = corners.into_iter().min_by_key(covered).unwrap_or(corners[0]);
    let _ = writeln!(
        out,
        "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width}\" height=\"{height}\" fill=\"#ffffff\" \
         fill-opacity=\"0.85\" stroke=\"#d0d0d0\"/>"
    );
    for (k, curve) in panel.curves.iter().enumerate() {
        let at = y + 14.0 + 15.0 * k as f64;
        let _ = writeln!(
            out,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{}\" stroke-width=\"1.8\" \
             stroke-linecap=\"round\" \
             stroke-dasharray=\"{}\"/>",
            x + 6.0,
            at - 4.0,
            x + 28.0,
            at - 4.0,
            curve.colour,
            curve.dash
        );
        text(out, [x + 34.0, at], "start", "font-size=\"11\"", &curve.name);
    }
}

fn line(out: &mut String, a: [f64; 2], b: [f64; 2], colour: &str) {
    let _ = writeln!(
        out,
        "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{colour}\"/>",
        a[0], a[1], b[0], b[1]
    );
}

fn text(out: &mut String, [x, y]: [f64; 2], anchor: &str, attributes: &str, content: &str) {
    // Titles come from the program, but may contain these characters.
    let safe = content.replace('&', "&amp;").replace('<', "&lt;");
    let _ =
        writeln!(out, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {attributes}>{safe}</text>");
}

/// The label of a tick, without trailing zeros.
fn number(x: f64) -> String {
    let text = format!("{x:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
