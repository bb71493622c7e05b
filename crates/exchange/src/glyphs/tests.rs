//! Texts of a small font of strokes, drawn here.

use super::*;

/// A picture that strokes are drawn on: ink from 0 to 1.
struct Sheet {
    columns: usize,
    rows: usize,
    ink: Vec<f64>,
}

impl Sheet {
    fn new(columns: usize, rows: usize) -> Self {
        Self { columns, rows, ink: vec![0.0; columns * rows] }
    }

    /// Draws a line with round ends; pixels at its rim are grey.
    fn line(&mut self, a: [f64; 2], b: [f64; 2], width: f64) {
        let d = [b[0] - a[0], b[1] - a[1]];
        let square = (d[0] * d[0] + d[1] * d[1]).max(1e-12);
        self.fill([a, b], width, |p| {
            let share = (((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1]) / square).clamp(0.0, 1.0);
            0.5 * width - (p[0] - a[0] - share * d[0]).hypot(p[1] - a[1] - share * d[1])
        });
    }

    fn circle(&mut self, centre: [f64; 2], radius: f64, width: f64) {
        let corners = [[centre[0] - radius, centre[1] - radius], [centre[0] + radius, centre[1] + radius]];
        self.fill(corners, width, |p| {
            0.5 * width - ((p[0] - centre[0]).hypot(p[1] - centre[1]) - radius).abs()
        });
    }

    /// A filled triangle three times as long as wide, with its tip at a place.
    fn arrow(&mut self, tip: [f64; 2], towards: [f64; 2], length: f64) {
        let far = [tip[0] - length * towards[0], tip[1] - length * towards[1]];
        self.fill([tip, far], length, |p| {
            let off = [p[0] - tip[0], p[1] - tip[1]];
            let back = -(off[0] * towards[0] + off[1] * towards[1]);
            let side = (off[0] * towards[1] - off[1] * towards[0]).abs();
            (back / 6.0 - side).min(length - back)
        });
    }

    /// Draws what has a positive depth, in the box of two points and a margin.
    fn fill(&mut self, ends: [[f64; 2]; 2], margin: f64, depth: impl Fn([f64; 2]) -> f64) {
        let range = |k: usize, limit: usize| {
            let low = ends[0][k].min(ends[1][k]) - margin - 1.0;
            let high = ends[0][k].max(ends[1][k]) + margin + 2.0;
            (low.max(0.0) as usize)..(high.max(0.0) as usize).min(limit)
        };
        for y in range(1, self.rows) {
            for x in range(0, self.columns) {
                let own = (depth([x as f64, y as f64]) + 0.5).clamp(0.0, 1.0);
                let pixel = &mut self.ink[y * self.columns + x];
                *pixel = pixel.max(own);
            }
        }
    }

    /// Writes a text with the middle of its capitals at a place. Upwards: it is read from bottom to top.
    fn text(&mut self, text: &str, middle: [f64; 2], height: f64, width: f64, is_upwards: bool) {
        let advance = |c: char| if ".,:".contains(c) { 0.45 } else { 0.85 };
        let length: f64 = text.chars().map(advance).sum();
        let mut at = -0.5 * length;
        for c in text.chars() {
            let place = |p: &[f64; 2]| {
                let [along, up] = [height * (at + 0.1 + p[0]), height * (p[1] - 0.5)];
                if is_upwards {
                    [middle[0] - up, middle[1] - along]
                } else {
                    [middle[0] + along, middle[1] - up]
                }
            };
            for line in strokes(c) {
                line.windows(2).for_each(|pair| self.line(place(&pair[0]), place(&pair[1]), width));
            }
            at += advance(c);
        }
    }

    fn image(&self) -> Image {
        Image::try_new(self.columns, self.rows, self.ink.iter().map(|v| (250.0 - 230.0 * v) as f32).collect())
            .unwrap()
    }

    /// A dimension line with arrowheads, its extension lines, and its number above it.
    fn dimension(&mut self, text: &str, [left, right]: [f64; 2], y: f64, height: f64) {
        self.line([left + 2.0, y], [right - 2.0, y], 2.0);
        for (tip, towards) in [(left, -1.0), (right, 1.0)] {
            self.arrow([tip, y], [towards, 0.0], 24.0);
            self.line([tip, y - 12.0], [tip, y + 60.0], 2.0);
        }
        self.text(text, [0.5 * (left + right), y - 0.9 * height], height, 2.5, false);
    }
}

/// Part of an ellipse in quarter turns, anticlockwise from the right.
fn bow(centre: [f64; 2], radii: [f64; 2], from: f64, to: f64) -> Vec<[f64; 2]> {
    let angle = |k: u32| (from + (to - from) * f64::from(k) / 16.0) * std::f64::consts::FRAC_PI_2;
    let at = |a: f64| [centre[0] + radii[0] * a.cos(), centre[1] + radii[1] * a.sin()];
    (0..=16).map(|k| at(angle(k))).collect()
}

/// Lines of a character; capitals are 1 high.
fn strokes(c: char) -> Vec<Vec<[f64; 2]>> {
    let oval = || bow([0.3, 0.5], [0.3, 0.5], 0.0, 4.0);
    match c {
        '0' => vec![oval()],
        '1' => vec![vec![[0.1, 0.75], [0.35, 1.0], [0.35, 0.0]]],
        '2' => vec![[bow([0.3, 0.7], [0.28, 0.3], 2.0, -0.4), vec![[0.0, 0.0], [0.6, 0.0]]].concat()],
        '3' => vec![bow([0.28, 0.74], [0.27, 0.26], 1.8, -1.0), bow([0.28, 0.25], [0.3, 0.25], 1.0, -1.8)],
        '4' => vec![vec![[0.62, 0.28], [0.0, 0.28], [0.45, 1.0], [0.45, 0.0]]],
        '5' => vec![
            [vec![[0.55, 1.0], [0.1, 1.0], [0.05, 0.52]], bow([0.27, 0.32], [0.31, 0.32], 1.6, -1.8)]
                .concat(),
        ],
        '6' => vec![[vec![[0.45, 1.0]], bow([0.3, 0.3], [0.29, 0.3], 1.7, 5.7)].concat()],
        '7' => vec![vec![[0.0, 1.0], [0.58, 1.0], [0.2, 0.0]]],
        '8' => vec![bow([0.3, 0.76], [0.25, 0.24], 0.0, 4.0), bow([0.3, 0.26], [0.3, 0.26], 0.0, 4.0)],
        '9' => vec![[vec![[0.15, 0.0]], bow([0.3, 0.7], [0.29, 0.3], -0.3, 3.7)].concat()],
        '.' => vec![vec![[0.12, 0.02], [0.13, 0.02]]],
        'R' => vec![
            [
                vec![[0.0, 0.0], [0.0, 1.0], [0.3, 1.0]],
                bow([0.3, 0.75], [0.28, 0.25], 1.0, -1.0),
                vec![[0.0, 0.5]],
            ]
            .concat(),
            vec![[0.3, 0.5], [0.6, 0.0]],
        ],
        'Ø' => vec![bow([0.3, 0.5], [0.33, 0.42], 0.0, 4.0), vec![[0.0, -0.05], [0.6, 1.05]]],
        'A' => vec![vec![[0.0, 0.0], [0.32, 1.0], [0.64, 0.0]], vec![[0.12, 0.35], [0.52, 0.35]]],
        'F' => vec![vec![[0.0, 0.0], [0.0, 1.0], [0.55, 1.0]], vec![[0.0, 0.52], [0.45, 0.52]]],
        'N' => vec![vec![[0.0, 0.0], [0.0, 1.0], [0.6, 0.0], [0.6, 1.0]]],
        'O' => vec![bow([0.33, 0.5], [0.36, 0.5], 0.0, 4.0)],
        'T' => vec![vec![[0.0, 1.0], [0.62, 1.0]], vec![[0.31, 1.0], [0.31, 0.0]]],
        '-' => vec![vec![[0.1, 0.45], [0.5, 0.45]]],
        _ => panic!("no strokes for {c}"),
    }
}

fn found(words: &PictureText, text: &str) -> Word {
    let own = words.words.iter().find(|w| w.text == text);
    own.unwrap_or_else(|| panic!("{text} is not among {:?}", texts(words))).clone()
}

fn texts(words: &PictureText) -> Vec<(&str, f64)> {
    words.words.iter().map(|w| (w.text.as_str(), w.confidence)).collect()
}

#[test]
fn numbers_of_any_size_are_read_in_both_directions() {
    for (height, width) in [(14.0, 1.5), (20.0, 2.0), (30.0, 4.0), (48.0, 3.0)] {
        for is_upwards in [false, true] {
            for text in ["23.58", "Ø46", "R7", "190"] {
                let mut sheet = Sheet::new(320, 320);
                sheet.text(text, [160.0, 150.0], height, width, is_upwards);
                let words = read_words(&sheet.image());
                assert!(words.arrowheads.is_empty(), "{text} {height} {is_upwards}: {:?}", words.arrowheads);
                let word = found(&words, text);
                assert!(word.confidence > 0.5, "{text} {height} {is_upwards}: {}", word.confidence);
                assert_eq!(words.words.len(), 1, "{:?}", texts(&words));
                let expected = if is_upwards { -std::f64::consts::FRAC_PI_2 } else { 0.0 };
                assert!((word.angle_rad - expected).abs() < 0.05);
                let [x, y] = word.middle();
                assert!((x - 160.0).hypot(y - 150.0) < 0.5 * height, "{x} {y}");
                assert!((word.height / height - 1.0).abs() < 0.35, "{} {height}", word.height);
            }
        }
    }
}

#[test]
fn titles_and_marks_are_read() {
    for text in ["FRONT", "A-A"] {
        let mut sheet = Sheet::new(300, 120);
        sheet.text(text, [150.0, 60.0], 24.0, 3.0, false);
        let words = read_words(&sheet.image());
        assert!(!found(&words, text).is_dimension());
    }
}

#[test]
fn the_mask_has_all_ink_of_words_and_no_line() {
    let mut sheet = Sheet::new(300, 160);
    sheet.text("258", [150.0, 60.0], 30.0, 3.0, false);
    let text = sheet.ink.clone();
    sheet.line([20.0, 130.0], [280.0, 130.0], 2.0);
    sheet.line([20.0, 20.0], [20.0, 140.0], 2.0);
    let words = read_words(&sheet.image());
    for (k, marked) in words.mask.iter().enumerate() {
        assert!(*marked || text[k] < 0.1, "ink of the text at {}", k % 300);
        assert!(!*marked || (k % 300 > 30 && k / 300 < 120), "a line at {} {}", k % 300, k / 300);
    }
}

#[test]
fn light_that_is_uneven_or_inverted_does_not_matter() {
    let mut sheet = Sheet::new(400, 120);
    sheet.text("36.4", [200.0, 60.0], 28.0, 3.0, false);
    let mut image = sheet.image();
    for (k, value) in image.values.iter_mut().enumerate() {
        *value *= 1.0 - 0.5 * (k % 400) as f32 / 400.0;
    }
    found(&read_words(&image), "36.4");
    let inverted = sheet.image().values.iter().map(|v| 255.0 - v).collect();
    found(&read_words(&Image::try_new(400, 120, inverted).unwrap()), "36.4");
}

#[test]
fn line_work_is_no_text() {
    let mut sheet = Sheet::new(500, 400);
    let corners = [[40.0, 40.0], [300.0, 40.0], [300.0, 250.0], [40.0, 250.0], [40.0, 40.0]];
    corners.windows(2).for_each(|pair| sheet.line(pair[0], pair[1], 3.0));
    for k in 0..14 {
        let x = 45.0 + 18.0 * f64::from(k);
        sheet.line([x, 120.0], [x + 11.0, 120.0], 2.0);
        sheet.line([350.0, 40.0 + x], [350.0, 40.0 + x + 11.0], 2.0);
        sheet.line([60.0 + 6.0 * f64::from(k), 240.0], [90.0 + 6.0 * f64::from(k), 200.0], 1.5);
    }
    sheet.circle([200.0, 180.0], 14.0, 2.0);
    sheet.circle([420.0, 180.0], 9.0, 2.0);
    sheet.arrow([420.0, 300.0], [1.0, 0.0], 24.0);
    sheet.line([400.0, 350.0], [450.0, 390.0], 2.0);
    let words = read_words(&sheet.image());
    assert!(words.words.iter().all(|w| w.confidence < 0.6), "{:?}", texts(&words));
    assert!(words.words.iter().all(|w| w.text.len() == 1), "{:?}", texts(&words));
}

#[test]
fn dimensions_are_arrowheads_with_a_number() {
    let mut sheet = Sheet::new(600, 400);
    sheet.dimension("84.5", [60.0, 310.0], 80.0, 22.0);
    // In a row: the arrowheads between them face each other, and are nearer than their partners.
    sheet.dimension("30", [350.0, 540.0], 80.0, 22.0);
    let words = read_words(&sheet.image());
    let mut dimensions = words.dimensions(400, 0.5);
    dimensions.sort_by(|a, b| a.stated.total_cmp(&b.stated));
    assert_eq!(dimensions.len(), 2, "{dimensions:?} {:?} {:?}", texts(&words), words.arrowheads);
    for (dimension, (drawn, stated)) in dimensions.iter().zip([(190.0, 30.0), (250.0, 84.5)]) {
        assert!((dimension.drawn - drawn).abs() < 1.0, "{dimension:?}");
        assert!((dimension.stated - stated).abs() < 1e-9);
    }
    // A number without arrowheads is none.
    let mut plain = Sheet::new(300, 200);
    plain.text("84.5", [150.0, 80.0], 22.0, 2.5, false);
    plain.line([50.0, 100.0], [250.0, 100.0], 2.0);
    assert!(read_words(&plain.image()).dimensions(200, 0.0).is_empty());
}

#[test]
fn a_point_that_is_hardly_visible_is_not_lost_with_confidence() {
    for strength in [0.15, 0.25, 0.4, 0.7] {
        let mut sheet = Sheet::new(240, 100);
        sheet.text("62", [80.0, 50.0], 20.0, 2.0, false);
        sheet.text("48", [122.0, 50.0], 20.0, 2.0, false);
        sheet.fill([[101.0, 58.0]; 2], 3.0, |p| {
            strength - 0.5 - if (p[0] - 101.0).hypot(p[1] - 58.0) < 1.6 { 0.0 } else { 1.0 }
        });
        let words = read_words(&sheet.image());
        let lost = words.words.iter().find(|w| w.text == "6248" && w.confidence > 0.9);
        assert!(lost.is_none() || strength < 0.2, "{strength}: {:?}", texts(&words));
    }
}

#[test]
fn a_line_that_touches_digits_gives_no_wrong_number() {
    for offset in [-12.0, 0.0, 11.0, 13.0] {
        let mut sheet = Sheet::new(300, 120);
        sheet.text("473", [150.0, 60.0], 24.0, 2.5, false);
        sheet.line([20.0, 60.0 + offset], [280.0, 60.0 + offset], 2.0);
        let words = read_words(&sheet.image());
        assert!(
            words.words.iter().all(|w| w.text == "473" || w.confidence < 0.9),
            "{offset}: {:?}",
            texts(&words)
        );
    }
}

#[test]
fn noise_and_tiny_pictures_are_read_in_time() {
    let mut state = 7_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as f32
    };
    for (columns, rows) in [(1, 1), (1, 300), (300, 1), (2, 3), (900, 800)] {
        let values = (0..columns * rows).map(|_| noise()).collect();
        let words = read_words(&Image::try_new(columns, rows, values).unwrap());
        assert_eq!(words.mask.len(), columns * rows);
        assert!(words.words.iter().all(|w| w.confidence < 0.9), "{:?}", texts(&words));
    }
    let nothing = vec![f32::NAN; 600];
    assert!(read_words(&Image::try_new(30, 20, nothing).unwrap()).words.is_empty());
}
