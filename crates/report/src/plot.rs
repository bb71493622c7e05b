//! Small plots as SVG; texts and axes use the colours of the page.

use crate::numbers::significant;
use std::fmt::Write;

/// Width of all plots, in units of the drawing; the page scales them.
const WIDTH: f64 = 560.0;
/// Blue and orange: distinguishable with every kind of colour vision (Okabe and Ito, 2008), readable on white
/// and on black.
const FIRST: &str = "#2a7fb8";
/// See [`FIRST`].
const SECOND: &str = "#d9822b";

/// Escapes the characters of a text that SVG would interpret as markup.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Ticks of a logarithmic axis: 1, 2 and 5 times powers of ten, or powers of ten on long axes.
fn logarithmic_ticks(low: f64, high: f64) -> Vec<f64> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    // Three labels per decade fit on two and a half decades.
    let steps: &[f64] = if high / low > 300.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    decades
        .flat_map(|e| steps.iter().map(move |s| s * 10_f64.powi(e)))
        .filter(|t| (low..=high).contains(t))
        .collect()
}

/// Plots stated and estimated σ of each sensor on a logarithmic axis. A long line is a wrong σ.
///
/// Rows are name, stated σ (if any) and estimated σ. Values that are not positive are omitted; without any
/// value, the result is empty.
///
/// # Examples
/// ```
/// use planish_report::plot::stated_and_found;
/// let svg = stated_and_found(&[("laser".to_owned(), Some(0.1), 0.3)], "mm");
/// assert!(svg.starts_with("<svg") && svg.contains("laser"));
/// assert_eq!(stated_and_found(&[], "mm"), "");
/// ```
#[must_use]
pub fn stated_and_found(rows: &[(String, Option<f64>, f64)], unit: &str) -> String {
    let positive = |v: f64| (v > 0.0 && v.is_finite()).then_some(v);
    let values: Vec<f64> = (rows.iter())
        .flat_map(|(_, stated, found)| [stated.and_then(positive), positive(*found)])
        .flatten()
        .collect();
    let (Some(low), Some(high)) =
        (values.iter().copied().reduce(f64::min), values.iter().copied().reduce(f64::max))
    else {
        return String::new();
    };
    // Room beside the extreme values, whose symbols have a width. It also gives a range to a single value.
    let (low, high) = (low / 1.6, high * 1.6);
    let (left, right, line) = (120.0, WIDTH - 16.0, 30.0);
    let bottom = 12.0 + line * rows.len() as f64;
    // Logarithmic: equal ratios of σ then have lines of equal length.
    let x = |v: f64| left + (right - left) * (v / low).ln() / (high / low).ln();
    let height = bottom + 56.0;
    let mut svg = format!(r#"<svg viewBox="0 0 {WIDTH} {height}" role="img" font-size="12.5">"#);
    for tick in logarithmic_ticks(low, high) {
        let at = x(tick);
        let _ = write!(
            svg,
            "<line class=\"axis-line\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"6\" y2=\"{bottom:.1}\"/><text \
             class=\"plot-text\" x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            bottom + 16.0,
            trimmed(tick),
        );
    }
    for (k, (name, stated, found)) in rows.iter().enumerate() {
        let y = 6.0 + line * (k as f64 + 0.5);
        // Names are limited by the margin on the left.
        let short: String = if name.chars().count() > 17 {
            name.chars().take(16).chain(['…']).collect()
        } else {
            name.clone()
        };
        let _ =
            write!(svg, r#"<text class="plot-strong" x="0" y="{:.1}">{}</text>"#, y + 4.0, escaped(&short));
        let (stated, found) = (stated.and_then(positive), positive(*found));
        if let (Some(s), Some(f)) = (stated, found) {
            let _ = write!(
                svg,
                "<line x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{y}\" y2=\"{y}\" stroke=\"{SECOND}\" \
                 stroke-width=\"3\" opacity=\".55\"/>",
                x(s),
                x(f)
            );
        }
        if let Some(f) = found {
            let _ = write!(svg, r#"<circle cx="{:.1}" cy="{y}" r="5.5" fill="{SECOND}"/>"#, x(f));
        }
        if let Some(s) = stated {
            let _ = write!(
                svg,
                r#"<rect x="{:.1}" y="{:.1}" width="4" height="18" fill="{FIRST}"/>"#,
                x(s) - 2.0,
                y - 9.0
            );
        }
    }
    let y = bottom + 38.0;
    let _ = write!(
        svg,
        "<rect x=\"{left}\" y=\"{:.1}\" width=\"4\" height=\"14\" fill=\"{FIRST}\"/><text \
         class=\"plot-text\" x=\"{}\" y=\"{y}\">stated σ</text><circle cx=\"{}\" cy=\"{:.1}\" r=\"5.5\" \
         fill=\"{SECOND}\"/><text class=\"plot-text\" x=\"{}\" y=\"{y}\">estimated σ / {}</text></svg>",
        y - 11.0,
        left + 10.0,
        left + 112.0,
        y - 4.0,
        left + 123.0,
        escaped(unit),
    );
    svg
}

/// Histogram of normalised residuals with the standard normal distribution for comparison.
///
/// Values beyond ±5 are counted in the outermost bars. Empty without values.
///
/// # Examples
/// ```
/// use planish_report::plot::normalised_residuals;
/// assert!(normalised_residuals(&[-0.5, 0.2, 1.1]).starts_with("<svg"));
/// assert_eq!(normalised_residuals(&[]), "");
/// ```
#[must_use]
pub fn normalised_residuals(values: &[f64]) -> String {
    const BINS: usize = 50;
    const REACH: f64 = 5.0;
    let mut counts = [0_usize; BINS];
    let mut n = 0_usize;
    for v in values.iter().filter(|v| v.is_finite()) {
        // Far outliers stay in the outermost bars: leaving them out would make a poor fit look good.
        let bin = ((v + REACH) / (2.0 * REACH) * BINS as f64).clamp(0.0, BINS as f64 - 1.0) as usize;
        counts[bin] += 1;
        n += 1;
    }
    if n == 0 {
        return String::new();
    }
    let step = 2.0 * REACH / BINS as f64;
    // The reference curve is fixed and not fitted: a wrong σ shows as a difference in width.
    let normal = |z: f64| (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
    // Density, not counts: only so can the normal distribution be drawn at the same scale.
    let density = |k: usize| counts[k] as f64 / (n as f64 * step);
    let highest = (0..BINS).map(density).fold(normal(0.0), f64::max) * 1.08;
    let (left, right, top, bottom) = (8.0, WIDTH - 8.0, 8.0, 150.0);
    let x = |z: f64| left + (right - left) * (z + REACH) / (2.0 * REACH);
    let y = |d: f64| bottom - (bottom - top) * d / highest;
    let mut svg = format!(r#"<svg viewBox="0 0 {WIDTH} 190" role="img" font-size="12.5">"#);
    for k in (0..BINS).filter(|k| counts[*k] > 0) {
        let (from, to) = (x(-REACH + k as f64 * step) + 0.5, x(-REACH + (k + 1) as f64 * step) - 0.5);
        // At least a hair line: a single outlier must remain visible among many readings.
        let up = y(density(k)).min(bottom - 0.6);
        let _ = write!(
            svg,
            r#"<rect x="{from:.1}" y="{up:.1}" width="{:.1}" height="{:.1}" fill="{FIRST}" opacity=".75"/>"#,
            to - from,
            bottom - up
        );
    }
    let path: Vec<String> = (0..=100)
        .map(|k| {
            let z = -REACH + 2.0 * REACH * f64::from(k) / 100.0;
            format!("{:.1},{:.1}", x(z), y(normal(z)))
        })
        .collect();
    let _ = write!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{SECOND}\" stroke-width=\"2\"/><line \
         class=\"axis-line\" x1=\"{left}\" x2=\"{right}\" y1=\"{bottom}\" y2=\"{bottom}\"/>",
        path.join(" ")
    );
    for tick in [-4, -2, 0, 2, 4] {
        let _ = write!(
            svg,
            r#"<text class="plot-text" x="{:.1}" y="{:.1}" text-anchor="middle">{tick}</text>"#,
            x(f64::from(tick)),
            bottom + 16.0
        );
    }
    let _ = write!(
        svg,
        "<text class=\"plot-text\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">normalised residual \
         (residual / σ)</text></svg>",
        0.5 * (left + right),
        bottom + 33.0
    );
    svg
}

/// Polylines in a plane, y upwards, scaled to fit; hidden ones (`true`) are dashed. Empty without points.
#[must_use]
pub fn lines(lines: &[(Vec<[f64; 2]>, bool)]) -> String {
    const ROOM: [f64; 2] = [560.0, 320.0];
    const MARGIN: f64 = 12.0;
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in lines.iter().flat_map(|(points, _)| points) {
        for k in 0..2 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    if !(low[0] <= high[0] && low[1] <= high[1]) {
        return String::new();
    }
    // A line along one axis has no extent along the other.
    let size = [0, 1].map(|k| (high[k] - low[k]).max(f64::MIN_POSITIVE));
    // One scale for both axes keeps the proportions.
    let scale = [0, 1].map(|k| (ROOM[k] - 2.0 * MARGIN) / size[k]).into_iter().fold(f64::INFINITY, f64::min);
    let height = (scale * (high[1] - low[1])).max(1.0) + 2.0 * MARGIN;
    let left = 0.5 * (ROOM[0] - scale * (high[0] - low[0]));
    let mut svg = format!(
        "<svg viewBox=\"0 0 {} {height:.1}\" role=\"img\" fill=\"none\" stroke=\"currentColor\" \
         stroke-width=\"1.4\" stroke-linecap=\"round\">",
        ROOM[0]
    );
    for (points, is_hidden) in lines {
        let places: Vec<String> = (points.iter())
            .map(|p| {
                let x = left + scale * (p[0] - low[0]);
                let y = height - MARGIN - scale * (p[1] - low[1]);
                format!("{x:.2},{y:.2}")
            })
            .collect();
        let dashes = if *is_hidden { r#" stroke-dasharray="5 4" opacity=".7""# } else { "" };
        let _ = write!(svg, r#"<polyline points="{}"{dashes}/>"#, places.join(" "));
    }
    svg + "</svg>"
}

/// A bar of shares of a whole: names, shares and CSS colours.
///
/// Shares need not add up to one. Empty if their sum is not positive.
#[must_use]
pub fn shares(parts: &[(&str, f64, String)]) -> String {
    let total: f64 = parts.iter().map(|p| p.1).sum();
    if total <= 0.0 || !total.is_finite() {
        return String::new();
    }
    let mut svg = format!(r#"<svg viewBox="0 0 {WIDTH} 46" role="img" font-size="12.5">"#);
    let (mut at, mut text) = (0.0, 0.0);
    for (name, share, colour) in parts.iter().filter(|p| p.1 > 0.0) {
        let width = WIDTH * share / total;
        let _ = write!(
            svg,
            "<rect x=\"{at:.1}\" y=\"0\" width=\"{width:.1}\" height=\"14\" fill=\"{colour}\"/><rect \
             x=\"{text:.1}\" y=\"27\" width=\"11\" height=\"11\" rx=\"3\" fill=\"{colour}\"/><text \
             class=\"plot-text\" x=\"{:.1}\" y=\"37\">{} {} %</text>",
            text + 16.0,
            escaped(name),
            significant(100.0 * share / total, 3)
        );
        at += width;
        // The width of text is estimated: fonts are unknown until the page is displayed.
        text += 28.0 + 7.2 * (name.chars().count() + 8) as f64;
    }
    svg + "</svg>"
}

/// A tick label without trailing zeros.
fn trimmed(value: f64) -> String {
    let text = significant(value, 2);
    if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_sigma_is_a_long_line() {
        let rows = [("old <1>".to_owned(), Some(0.1), 0.3), ("laser".to_owned(), Some(0.1), 0.1)];
        let svg = stated_and_found(&rows, "mm");
        let lengths: Vec<f64> = svg
            .split("<line x1=\"")
            .skip(1)
            .map(|part| {
                let x1: f64 = part.split('"').next().unwrap().parse().unwrap();
                let x2: f64 = part.split("x2=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap();
                (x2 - x1).abs()
            })
            .collect();
        assert_eq!(lengths.len(), 2);
        assert!(lengths[0] > 100.0 && lengths[1] < 0.1, "{lengths:?}");
        assert!(svg.contains("old &lt;1&gt;"));
        assert_eq!(stated_and_found(&[("a".to_owned(), None, 0.0)], "mm"), "");
    }

    #[test]
    fn every_residual_is_in_a_bar() {
        let svg = normalised_residuals(&[0.1, 0.1, 40.0, f64::NAN]);
        assert_eq!(svg.matches("<rect").count(), 2);
        assert_eq!(normalised_residuals(&[]), "");
    }

    #[test]
    fn views_keep_their_proportions() {
        let svg = lines(&[(vec![[0.0, 0.0], [10.0, 0.0]], false), (vec![[10.0, 0.0], [10.0, 5.0]], true)]);
        // 536 of 560 pixels for ten, 268 for five; y points down on a screen.
        assert!(
            svg.contains("12.00,280.00 548.00,280.00") && svg.contains("548.00,280.00 548.00,12.00"),
            "{svg}"
        );
        assert_eq!(svg.matches("stroke-dasharray").count(), 1);
        assert_eq!(lines(&[]), "");
    }

    #[test]
    fn shares_fill_the_bar() {
        let svg = shares(&[("a", 3.0, "#000".into()), ("b", 1.0, "#111".into()), ("c", 0.0, "#222".into())]);
        assert!(svg.contains("width=\"420.0\"") && svg.contains("width=\"140.0\"") && !svg.contains("#222"));
    }
}
