//! Colour scales and legends, for pages and images.
//!
//! In: a [`Field`]. Out: its [`Scale`]: a colour for each value, and ticks or category names for the legend.
//! The maps are perceptually uniform and distinguishable with every kind of colour vision: viridis (Smith and
//! van der Walt, 2015), blue to red over grey (ColorBrewer, Harrower and Brewer, 2003), and for categories
//! the colours of Okabe and Ito (2008).
//!
//! # Examples
//! ```
//! use planish_report::colour::{Scale, UNKNOWN, hex};
//! use planish_report::{Field, FieldKind, Values};
//! let field = Field {
//!     key: "deviation".to_owned(),
//!     label: "deviation".to_owned(),
//!     unit: "mm".to_owned(),
//!     shown: None,
//!     kind: FieldKind::Signed(Some(1.0)),
//!     values: Values::Numbers(vec![-1.0, 0.0, 1.0]),
//! };
//! let scale = Scale::from_field(&field);
//! assert_eq!(hex(scale.colour(1.0)), "67001f");
//! assert_eq!(scale.colour(f64::NAN), UNKNOWN);
//! ```

use crate::field::{Field, FieldKind, Values};
use crate::numbers::significant;

/// Red, green and blue from 0 to 1 in sRGB.
pub type Colour = [f64; 3];

/// Colour of values that are not finite or have no category.
pub const UNKNOWN: Colour = [0.6; 3];
/// Fraction of the values at each end that lie beyond the scale, so that outliers do not use up its range.
///
/// A larger fraction shows more contrast in the middle and hides more of the largest values.
const CLIPPED_FRACTION: f64 = 0.01;
/// The same for signed values, whose scale is symmetric: only the end with the larger values is cut.
const BEYOND_SIGNED: f64 = 0.02;
/// Ratio of the ends of a positive range above which the scale is logarithmic.
///
/// σ often varies by powers of ten, where a linear scale shows one colour. Below this ratio, a linear scale
/// is easier to read.
const LOGARITHMIC: f64 = 4.0;
/// Minimum distance of ticks, as a fraction of the legend, so that labels do not overlap.
const MIN_TICK_DISTANCE: f64 = 0.14;

/// A colour map of the interval from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Map {
    /// From dark violet to yellow.
    Viridis,
    /// From blue over grey to red: for signed values.
    RedBlue,
}

impl Map {
    /// Every map.
    pub const ALL: [Self; 2] = [Self::Viridis, Self::RedBlue];

    /// Name in the script of the page.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Viridis => "viridis",
            Self::RedBlue => "redblue",
        }
    }

    /// Seventeen colours at equal steps.
    #[must_use]
    pub fn colours(self) -> [u32; 17] {
        match self {
            Self::Viridis => [
                0x440154, 0x48186a, 0x472d7b, 0x424086, 0x3b528b, 0x33638d, 0x2c728e, 0x26828e, 0x21918c,
                0x1fa088, 0x28ae80, 0x3fbc73, 0x5ec962, 0x84d44b, 0xaddc30, 0xd8e219, 0xfde725,
            ],
            Self::RedBlue => [
                0x053061, 0x175290, 0x2a71b2, 0x3f8ec0, 0x6bacd1, 0x9bc9e0, 0xc2ddec, 0xe0ecf3, 0xf7f6f6,
                0xfbe5d8, 0xfbccb4, 0xf5aa89, 0xe48066, 0xd05548, 0xba2832, 0x930e26, 0x67001f,
            ],
        }
    }

    /// Interpolated colour at a position; positions below 0 and above 1 have the colours of the ends.
    ///
    /// # Examples
    /// ```
    /// use planish_report::colour::{Map, hex};
    /// assert_eq!(hex(Map::Viridis.at(0.0)), "440154");
    /// assert_eq!(Map::Viridis.at(2.0), Map::Viridis.at(1.0));
    /// ```
    #[must_use]
    pub fn at(self, place: f64) -> Colour {
        let at = if place.is_nan() { 0.0 } else { 16.0 * place.clamp(0.0, 1.0) };
        let k = (at as usize).min(15);
        let [from, to] = [k, k + 1].map(|k| from_hex(self.colours()[k]));
        std::array::from_fn(|c| from[c] + (at - k as f64) * (to[c] - from[c]))
    }
}

/// Colours of categories (Okabe and Ito).
const KINDS: [u32; 9] =
    [0x0072b2, 0xe69f00, 0x009e73, 0xcc79a7, 0x56b4e9, 0xd55e00, 0xf0e442, 0x999999, 0x4d4d4d];
/// Colours of the values 0 to 3 of `observed`: inferred from smoothness, measured, completed, and measured
/// but not followed.
pub const KNOWN_BY: [u32; 4] = [0x9e9ea3, KINDS[0], KINDS[1], KINDS[5]];

/// A colour from a hexadecimal number, as in CSS.
fn from_hex(hex: u32) -> Colour {
    [16, 8, 0].map(|shift| f64::from((hex >> shift) & 0xff) / 255.0)
}

/// A colour as six hexadecimal digits, as in CSS without `#`.
#[must_use]
pub fn hex(colour: Colour) -> String {
    colour.map(|c| format!("{:02x}", (255.0 * c).round().clamp(0.0, 255.0) as u8)).concat()
}

/// Converts an sRGB component (IEC 61966-2-1) to linear light.
#[must_use]
pub fn linear_light(screen: f64) -> f64 {
    if screen <= 0.040_45 { screen / 12.92 } else { ((screen + 0.055) / 1.055).powf(2.4) }
}

/// Converts linear light to an sRGB component: the inverse of [`linear_light`] from 0 to 1.
#[must_use]
pub fn screen_brightness(light: f64) -> f64 {
    let c = light.clamp(0.0, 1.0);
    if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// A category with its colour.
#[derive(Debug, Clone, PartialEq)]
pub struct ColourKind {
    /// Number of the category.
    pub value: u16,
    /// Name of the category.
    pub label: String,
    /// Its colour.
    pub colour: Colour,
}

/// A tick of the legend.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Position from 0 to 1.
    pub place: f64,
    /// The value in the displayed unit.
    pub label: String,
}

/// A continuous colour scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Range {
    /// The colour map.
    pub map: Map,
    /// The value of the first colour.
    pub low: f64,
    /// The value of the last colour.
    pub high: f64,
    /// True if equal steps of colour are equal ratios.
    pub logarithmic: bool,
    /// Ticks of the legend.
    pub ticks: Vec<Tick>,
}

impl Range {
    /// The colour of a value; [`UNKNOWN`] where it is not finite, or not positive on a logarithmic scale.
    #[must_use]
    pub fn colour(&self, value: f64) -> Colour {
        let place = if self.logarithmic {
            (value.max(0.0) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        if place.is_finite() { self.map.at(place) } else { UNKNOWN }
    }
}

/// The mapping of a field to colours.
#[derive(Debug, Clone, PartialEq)]
pub enum Scale {
    /// A continuous scale.
    Range(Range),
    /// Categories.
    Kinds(Vec<ColourKind>),
    /// The values are colours ([`FieldKind::Colours`]).
    Own,
}

/// A colour of 8 bits per channel as a value of [`FieldKind::Colours`], and back.
///
/// # Examples
/// ```
/// use planish_report::colour::{colour_of_number, number_of_colour};
/// let orange = number_of_colour([255, 128, 0]);
/// assert_eq!(colour_of_number(orange)[1], 128.0 / 255.0);
/// ```
#[must_use]
pub fn number_of_colour([r, g, b]: [u8; 3]) -> f64 {
    f64::from((u32::from(r) << 16) | (u32::from(g) << 8) | u32::from(b))
}

/// The inverse of [`number_of_colour`]; grey for numbers that are not finite.
#[must_use]
pub fn colour_of_number(number: f64) -> Colour {
    if number.is_finite() { from_hex(number as u32) } else { UNKNOWN }
}

impl Scale {
    /// The scale of a field.
    #[must_use]
    pub fn from_field(field: &Field) -> Self {
        let factor = field.shown.as_ref().map_or(1.0, |(_, factor)| *factor);
        match (&field.kind, &field.values) {
            (FieldKind::Categories(kinds), _) => {
                let colour = |value: u16| match field.key.as_str() {
                    // These values have the same colours on every page and image.
                    "observed" => KNOWN_BY.get(usize::from(value)).copied().unwrap_or(KINDS[7]),
                    _ => KINDS[usize::from(value) % KINDS.len()],
                };
                Self::Kinds(legend_entries(kinds, |value| from_hex(colour(value))))
            }
            (FieldKind::Steps(kinds), _) => {
                // Steps of a colour map instead of separate colours, so that the order shows.
                let top = kinds.iter().map(|(value, _)| *value).max().unwrap_or(0).max(1);
                Self::Kinds(legend_entries(kinds, |value| Map::Viridis.at(f64::from(value) / f64::from(top))))
            }
            (FieldKind::Signed(limit), Values::Numbers(values)) => {
                let [low, high] = quantiles(values, [BEYOND_SIGNED, 1.0 - BEYOND_SIGNED]);
                // Symmetric, so that zero is grey and both signs have equal contrast.
                let reach = limit.unwrap_or(low.abs().max(high.abs()));
                // All values are zero, or there is none: any symmetric scale will do.
                let reach = if reach > 0.0 { reach } else { 1.0 };
                Self::Range(Range {
                    map: Map::RedBlue,
                    low: -reach,
                    high: reach,
                    logarithmic: false,
                    ticks: even_ticks(-reach, reach, factor),
                })
            }
            (FieldKind::Sequential, Values::Numbers(values)) => {
                let [low, high] = quantiles(values, [CLIPPED_FRACTION, 1.0 - CLIPPED_FRACTION]);
                let is_constant = high <= low;
                // A scale needs a positive range, or every value would be 0/0.
                let high =
                    if is_constant { low + 1e-6 * if low == 0.0 { 1.0 } else { low.abs() } } else { high };
                let logarithmic = low > 0.0 && high / low > LOGARITHMIC;
                let ticks = match (is_constant, logarithmic) {
                    (true, _) => vec![Tick { place: 0.0, label: trimmed(factor * low, 3) }],
                    (false, true) => even_ratio_ticks(low, high, factor),
                    (false, false) => even_ticks(low, high, factor),
                };
                Self::Range(Range { map: Map::Viridis, low, high, logarithmic, ticks })
            }
            (FieldKind::Colours, _) => Self::Own,
            (FieldKind::Sequential | FieldKind::Signed(_), Values::Kinds(_)) => Self::Kinds(Vec::new()),
        }
    }

    /// The colour of a value or of the number of a category.
    #[must_use]
    pub fn colour(&self, value: f64) -> Colour {
        match self {
            Self::Range(range) => range.colour(value),
            Self::Kinds(kinds) => {
                (kinds.iter()).find(|kind| f64::from(kind.value) == value).map_or(UNKNOWN, |kind| kind.colour)
            }
            Self::Own => colour_of_number(value),
        }
    }
}

/// The categories with their colours.
fn legend_entries(kinds: &[(u16, String)], colour: impl Fn(u16) -> Colour) -> Vec<ColourKind> {
    let made = kinds.iter().map(|(value, label)| ColourKind {
        value: *value,
        label: label.clone(),
        colour: colour(*value),
    });
    made.collect()
}

/// Quantiles of the finite values; zero without values.
fn quantiles(values: &[f64], shares: [f64; 2]) -> [f64; 2] {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    shares.map(|share| {
        let at = ((share * sorted.len() as f64) as usize).min(last);
        sorted.get(at).copied().unwrap_or(0.0)
    })
}

/// Multiples of 1, 2 or 5 times a power of ten, about four of them, in the displayed unit.
fn even_ticks(low: f64, high: f64, factor: f64) -> Vec<Tick> {
    let [from, to] = [low, high].map(|v| factor * v);
    let rough = (to - from) / 4.0;
    let power = 10_f64.powf(rough.log10().floor());
    let step = power * [1.0, 2.0, 5.0].into_iter().rfind(|m| m * power <= rough * 1.001).unwrap_or(1.0);
    // The tolerances include ticks at the ends, which rounding could place just outside. At most 13 ticks are
    // made, in case a range is degenerate.
    let first = (from / step - 1e-9).ceil() as i64;
    let last = (to / step + 1e-9).floor() as i64;
    let ticks = (first..=last.min(first + 12)).map(|k| {
        // Rounded to the digits of the step: 0.30000000000000004 becomes 0.3.
        let value = k as f64 * step;
        let decimals = (-step.log10().floor()).clamp(0.0, 15.0) as usize;
        let rounded: f64 = format!("{value:.decimals$}").parse().unwrap_or(value);
        Tick { place: (value - from) / (to - from), label: trimmed(rounded, 6) }
    });
    apart(ticks.collect())
}

/// Ticks at 1, 2 and 5 times powers of ten, or fewer on a large range.
fn even_ratio_ticks(low: f64, high: f64, factor: f64) -> Vec<Tick> {
    let [from, to] = [low, high].map(|v| factor * v);
    // Few ticks per decade on long ranges. Thinning 1, 2 and 5 by [`apart`] would leave uneven labels.
    let steps: &[f64] = match to / from {
        ratio if ratio > 100.0 => &[1.0],
        ratio if ratio > 12.0 => &[1.0, 3.0],
        _ => &[1.0, 2.0, 5.0],
    };
    let decades = from.log10().floor() as i32..=to.log10().ceil() as i32;
    let values = decades.flat_map(|e| steps.iter().map(move |m| m * 10_f64.powi(e)));
    let ticks = (values.filter(|v| (from..=to).contains(v)))
        .map(|value| Tick { place: (value / from).ln() / (to / from).ln(), label: trimmed(value, 3) });
    apart(ticks.collect())
}

/// Every n-th tick, so that labels do not overlap.
fn apart(ticks: Vec<Tick>) -> Vec<Tick> {
    // Distances are equal on linear scales only; on logarithmic ones the smallest decides.
    let smallest = ticks.windows(2).map(|pair| pair[1].place - pair[0].place).fold(f64::INFINITY, f64::min);
    let step = if smallest < MIN_TICK_DISTANCE { (MIN_TICK_DISTANCE / smallest).ceil() as usize } else { 1 };
    ticks.into_iter().step_by(step).collect()
}

/// A number without trailing zeros, with a typographic minus and exponent.
fn trimmed(value: f64, digits: usize) -> String {
    let text = significant(value, digits);
    let (mantissa, exponent) = text.split_once('e').map_or((text.as_str(), None), |(m, e)| (m, Some(e)));
    let mantissa =
        if mantissa.contains('.') { mantissa.trim_end_matches('0').trim_end_matches('.') } else { mantissa };
    // Zeros of an exponent count, so only the mantissa is trimmed. Tick labels are plain text without
    // markup, hence the raised digits.
    let raised = |exponent: &str| -> String {
        let digit = |c: char| match c {
            '-' => '⁻',
            c => c.to_digit(10).and_then(|d| "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(d as usize)).unwrap_or(c),
        };
        exponent.chars().map(digit).collect()
    };
    match exponent {
        None => mantissa.replace('-', "−"),
        Some(exponent) => format!("{}·10{}", mantissa.replace('-', "−"), raised(exponent)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(kind: FieldKind, values: Vec<f64>, shown: Option<(String, f64)>) -> Field {
        Field {
            key: "sigma".to_owned(),
            label: "σ".to_owned(),
            unit: "m".to_owned(),
            shown,
            kind,
            values: Values::Numbers(values),
        }
    }

    fn range(field: &Field) -> Range {
        match Scale::from_field(field) {
            Scale::Range(range) => range,
            Scale::Kinds(_) | Scale::Own => panic!("no range"),
        }
    }

    fn labels(range: &Range) -> Vec<&str> {
        range.ticks.iter().map(|tick| tick.label.as_str()).collect()
    }

    #[test]
    fn lightness_is_monotonic_along_sequential_maps_and_peaks_in_the_middle_of_signed_ones() {
        let lightness = |map: Map, place: f64| {
            let [r, g, b] = map.at(place).map(linear_light);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let steps = || (0..100).map(|k| [f64::from(k) / 100.0, f64::from(k + 1) / 100.0]);
        assert!(steps().all(|[a, b]| lightness(Map::Viridis, a) < lightness(Map::Viridis, b)));
        assert!(
            steps().all(|[a, b]| (lightness(Map::RedBlue, a) < lightness(Map::RedBlue, b)) == (b <= 0.5))
        );
        assert_eq!(hex(Map::Viridis.at(2.0)), "fde725");
        assert_eq!(hex(Map::Viridis.at(f64::NAN)), "440154");
    }

    #[test]
    fn light_and_screen_are_inverse() {
        for k in 0..=255 {
            let screen = f64::from(k) / 255.0;
            assert!((screen_brightness(linear_light(screen)) - screen).abs() < 1e-12);
        }
    }

    #[test]
    fn ticks_are_round_in_the_displayed_unit() {
        let values: Vec<f64> = (0..1000).map(|k| 0.001 + 0.001 * f64::from(k) / 1000.0).collect();
        let metres = field(FieldKind::Sequential, values, Some(("mm".to_owned(), 1000.0)));
        let found = range(&metres);
        assert_eq!(labels(&found), ["1.2", "1.4", "1.6", "1.8"]);
        // A fraction of the values lies beyond each end of the scale.
        assert!(found.low > 0.001 && found.high < 0.002);
        let signed = range(&field(FieldKind::Signed(Some(4.0)), vec![0.0], None));
        assert_eq!(labels(&signed), ["−4", "−2", "0", "2", "4"]);
        assert_eq!(hex(signed.colour(0.0)), "f7f6f6");
        let decades = (0..=400).map(|k| 10_f64.powf(-6.0 + f64::from(k) / 100.0)).collect();
        let wide = range(&field(FieldKind::Sequential, decades, None));
        assert!(wide.logarithmic);
        assert_eq!(labels(&wide), ["1·10⁻⁵", "0.0001", "0.001"]);
        assert!((wide.ticks[1].place - 0.5).abs() < 0.02);
    }

    #[test]
    fn constant_and_unknown_values_have_a_colour() {
        let constant = range(&field(FieldKind::Sequential, vec![0.5, 0.5], None));
        assert_eq!(labels(&constant), ["0.5"]);
        assert_eq!(constant.colour(f64::NAN), UNKNOWN);
        let none = Scale::from_field(&field(FieldKind::Signed(None), vec![f64::NAN], None));
        assert_eq!(none.colour(f64::NAN), UNKNOWN);
    }

    #[test]
    fn categories_keep_their_colours() {
        let observed = Field {
            key: "observed".to_owned(),
            kind: FieldKind::Categories(vec![(1, "measured".to_owned()), (0, "no".to_owned())]),
            values: Values::Kinds(vec![0, 1]),
            ..field(FieldKind::Sequential, Vec::new(), None)
        };
        let scale = Scale::from_field(&observed);
        assert_eq!(hex(scale.colour(1.0)), "0072b2");
        assert_eq!(hex(scale.colour(0.0)), "9e9ea3");
        assert_eq!(scale.colour(2.0), UNKNOWN);
    }
}
