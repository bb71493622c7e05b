//! Pixels on which legends are drawn: filled shapes and letters.
//!
//! Letters are those of Inter (`assets/inter-subset.otf`, SIL Open Font License, `assets/inter.LICENSE`), so
//! that pictures are the same on every computer.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use planish_estimate::{Error, Result};
use planish_report::colour::Colour;

const FONT: &[u8] = include_bytes!("../../assets/inter-subset.otf");

/// Alignment of a text relative to its position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Left,
    Middle,
    Right,
}

/// A picture in the colours of a screen.
pub(super) struct Canvas {
    pub columns: usize,
    pub rows: usize,
    pub pixels: Vec<Colour>,
    font: FontRef<'static>,
}

impl Canvas {
    pub(super) fn new(columns: usize, rows: usize, pixels: Vec<Colour>) -> Result<Self> {
        let font =
            FontRef::try_from_slice(FONT).map_err(|e| Error::input("the font of legends").with_source(e))?;
        Ok(Self { columns, rows, pixels, font })
    }

    /// Red, green and blue of every pixel, row by row.
    pub(super) fn bytes(&self) -> Vec<u8> {
        // Rounded, so that a colour that was not mixed keeps its byte.
        let byte = |c: &f64| (255.0 * c).round().clamp(0.0, 255.0) as u8;
        self.pixels.iter().flat_map(|colour| colour.iter().map(byte)).collect()
    }

    fn mix(&mut self, column: i64, row: i64, colour: Colour, share: f64) {
        // Legends of tiny pictures may extend beyond the border.
        let inside = (0..self.columns as i64).contains(&column) && (0..self.rows as i64).contains(&row);
        if inside && share > 0.0 {
            let pixel = &mut self.pixels[row as usize * self.columns + column as usize];
            for (old, new) in pixel.iter_mut().zip(colour) {
                *old += share.min(1.0) * (new - *old);
            }
        }
    }

    /// Fills a shape. `inside` is the signed distance from its border in pixels, positive inside.
    pub(super) fn fill(
        &mut self,
        [low, high]: [[f64; 2]; 2],
        inside: impl Fn([f64; 2]) -> f64,
        colour: impl Fn([f64; 2]) -> Colour,
    ) {
        for row in (low[1] - 1.0).floor() as i64..=(high[1] + 1.0).ceil() as i64 {
            for column in (low[0] - 1.0).floor() as i64..=(high[0] + 1.0).ceil() as i64 {
                let at = [column as f64 + 0.5, row as f64 + 0.5];
                // The distance from the border, clamped to a pixel, approximates the covered area: smooth
                // edges without several samples.
                self.mix(column, row, colour(at), (inside(at) + 0.5).clamp(0.0, 1.0));
            }
        }
    }

    /// A box with round corners.
    pub(super) fn rounded(
        &mut self,
        [low, high]: [[f64; 2]; 2],
        radius: f64,
        colour: impl Fn([f64; 2]) -> Colour,
    ) {
        let inside = move |at: [f64; 2]| {
            let off = [0, 1].map(|k| (low[k] + radius - at[k]).max(at[k] - high[k] + radius).max(0.0));
            let flat = [0, 1]
                .map(|k| (at[k] - low[k]).min(high[k] - at[k]))
                .into_iter()
                .fold(f64::INFINITY, f64::min);
            if off[0] > 0.0 && off[1] > 0.0 { radius - off[0].hypot(off[1]) } else { flat }
        };
        self.fill([low, high], inside, colour);
    }

    /// A straight line with round ends.
    pub(super) fn line(&mut self, from: [f64; 2], to: [f64; 2], width: f64, colour: Colour) {
        let along = [to[0] - from[0], to[1] - from[1]];
        // A line without a length is a dot, not NaN.
        let square = (along[0] * along[0] + along[1] * along[1]).max(f64::MIN_POSITIVE);
        let half = 0.5 * width;
        let low = [0, 1].map(|k| from[k].min(to[k]) - half);
        let high = [0, 1].map(|k| from[k].max(to[k]) + half);
        let inside = |at: [f64; 2]| {
            let off = [at[0] - from[0], at[1] - from[1]];
            let share = ((off[0] * along[0] + off[1] * along[1]) / square).clamp(0.0, 1.0);
            half - (off[0] - share * along[0]).hypot(off[1] - share * along[1])
        };
        self.fill([low, high], inside, |_| colour);
    }

    /// Font scale for an em size in pixels.
    fn scale(&self, size: f64) -> PxScale {
        let em = self.font.units_per_em().unwrap_or(1.0);
        PxScale::from(size as f32 * self.font.height_unscaled() / em)
    }

    /// Width of a text for an em size in pixels.
    pub(super) fn width(&self, text: &str, size: f64) -> f64 {
        let font = self.font.as_scaled(self.scale(size));
        let mut width = 0.0;
        let mut last = None;
        for letter in text.chars() {
            let glyph = font.glyph_id(letter);
            if let Some(last) = last {
                width += font.kern(last, glyph);
            }
            width += font.h_advance(glyph);
            last = Some(glyph);
        }
        f64::from(width)
    }

    /// Writes a text with its baseline on the row of `at`.
    pub(super) fn text(&mut self, at: [f64; 2], text: &str, size: f64, anchor: Anchor, colour: Colour) {
        let shift = match anchor {
            Anchor::Left => 0.0,
            Anchor::Middle => 0.5,
            Anchor::Right => 1.0,
        };
        let mut x = at[0] - shift * self.width(text, size);
        let scale = self.scale(size);
        let mut last = None;
        for letter in text.chars() {
            let (glyph, kern, advance) = {
                let font = self.font.as_scaled(scale);
                let id = font.glyph_id(letter);
                let kern = last.map_or(0.0, |last| font.kern(last, id));
                last = Some(id);
                (id, f64::from(kern), f64::from(font.h_advance(id)))
            };
            x += kern;
            let placed = glyph.with_scale_and_position(scale, point(x as f32, at[1] as f32));
            if let Some(outline) = self.font.outline_glyph(placed) {
                let corner = outline.px_bounds().min;
                // Collected first, because drawing borrows the font of the canvas.
                let mut covered = Vec::new();
                outline.draw(|column, row, share| covered.push((column, row, share)));
                for (column, row, share) in covered {
                    self.mix(
                        i64::from(column) + corner.x as i64,
                        i64::from(row) + corner.y as i64,
                        colour,
                        f64::from(share),
                    );
                }
            }
            x += advance;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blank(columns: usize, rows: usize) -> Canvas {
        Canvas::new(columns, rows, vec![[1.0; 3]; columns * rows]).unwrap()
    }

    fn ink(canvas: &Canvas) -> f64 {
        canvas.pixels.iter().map(|p| 1.0 - p[0]).sum()
    }

    #[test]
    fn every_letter_of_legends_is_in_the_font() {
        let canvas = blank(1, 1);
        for letter in "σ along the normal / mm², κ ·10⁻⁵ − ± ° × – “x” √ Σ 0123456789 µ″ft".chars()
        {
            assert!(canvas.font.glyph_id(letter).0 != 0, "{letter:?} has no glyph");
        }
    }

    #[test]
    fn texts_have_the_stated_width_and_stay_inside() {
        let mut canvas = blank(200, 40);
        canvas.text([100.0, 30.0], "0.015 mm", 20.0, Anchor::Middle, [0.0; 3]);
        let half = 0.5 * canvas.width("0.015 mm", 20.0);
        assert!((30.0..60.0).contains(&half), "{half}");
        let inked = |column: usize| (0..40).any(|row| canvas.pixels[row * 200 + column][0] < 0.9);
        let columns: Vec<usize> = (0..200).filter(|column| inked(*column)).collect();
        assert!((columns[0] as f64 - (100.0 - half)).abs() < 4.0, "{columns:?}");
        assert!((*columns.last().unwrap() as f64 - (100.0 + half)).abs() < 4.0);
        // Text outside the canvas is clipped.
        canvas.text([-500.0, -3.0], "out", 20.0, Anchor::Right, [0.0; 3]);
    }

    #[test]
    fn drawn_shapes_have_the_expected_area() {
        let mut canvas = blank(100, 100);
        canvas.rounded([[10.0, 10.0], [50.0, 30.0]], 5.0, |_| [0.0; 3]);
        let area = 40.0 * 20.0 - (4.0 - std::f64::consts::PI) * 25.0;
        assert!((ink(&canvas) - area).abs() < 0.02 * area, "{}", ink(&canvas));
        let mut canvas = blank(100, 100);
        canvas.line([20.0, 20.0], [80.0, 60.0], 4.0, [0.0; 3]);
        let area = 4.0 * 60.0_f64.hypot(40.0) + std::f64::consts::PI * 4.0;
        assert!((ink(&canvas) - area).abs() < 0.03 * area, "{}", ink(&canvas));
    }
}
