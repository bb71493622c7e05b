use super::*;
use planish_solid::views::{Curve2, LineStyle};

/// A picture with antialiased lines of 2 pixels, y upwards.
struct Canvas {
    image: Image,
}

impl Canvas {
    fn new() -> Self {
        Self { image: Image { columns: 500, rows: 500, values: vec![255.0; 500 * 500] } }
    }

    /// Darkens pixels by their distance from a curve.
    fn ink(&mut self, off: impl Fn([f64; 2]) -> f64) {
        for (k, value) in self.image.values.iter_mut().enumerate() {
            let p = [(k % 500) as f64, 499.0 - (k / 500) as f64];
            let covered = (1.5 - off(p)).clamp(0.0, 1.0) as f32;
            *value = value.min(255.0 * (1.0 - covered));
        }
    }

    fn line(&mut self, a: [f64; 2], b: [f64; 2]) {
        self.ink(|p| planish_solid::views::distance_to_segment(p, a, b));
    }

    fn dashes(&mut self, a: [f64; 2], b: [f64; 2]) {
        let length = planish_solid::views::distance(a, b);
        let at = |t: f64| [0, 1].map(|k| a[k] + (b[k] - a[k]) * (t / length).min(1.0));
        for k in 0..(length / 13.0).ceil() as usize {
            let from = 13.0 * k as f64;
            self.line(at(from), at(from + 8.0));
        }
    }

    fn circle(&mut self, c: [f64; 2], radius: f64) {
        self.ink(|p| (planish_solid::views::distance(p, c) - radius).abs());
    }

    fn rectangle(&mut self, x: f64, y: f64, width: f64, height: f64) {
        let corners = [[x, y], [x + width, y], [x + width, y + height], [x, y + height]];
        (0..4).for_each(|k| self.line(corners[k], corners[(k + 1) % 4]));
    }
}

/// Views of a plate of 200.4 × 120.2 × 60.6 pixels with a hole of radius 30.3, and a loose line as a letter.
fn plate(top: [f64; 2], side: [f64; 2]) -> Image {
    let mut canvas = Canvas::new();
    let [x, y] = [40.3, 60.7];
    canvas.rectangle(x, y, 200.4, 60.6);
    canvas.rectangle(top[0], top[1], 200.4, 120.2);
    canvas.circle([top[0] + 90.1, top[1] + 60.2], 30.3);
    canvas.rectangle(side[0], side[1], 120.2, 60.6);
    for off in [-30.3, 30.3] {
        canvas.dashes([x + 90.1 + off, y], [x + 90.1 + off, y + 60.6]);
        canvas.dashes([side[0] + 60.2 + off, side[1]], [side[0] + 60.2 + off, side[1] + 60.6]);
    }
    canvas.line([100.0, 30.0], [108.0, 38.0]);
    canvas.image
}

fn segments(drawing: &DxfDrawing, style: LineStyle) -> Vec<[[f64; 2]; 2]> {
    let lines = drawing.curves.iter().filter(|c| c.style == style);
    lines.filter_map(|c| if let Curve2::Segment(a, b) = c.curve { Some([a, b]) } else { None }).collect()
}

#[test]
fn views_of_a_plate_have_exactly_equal_coordinates() {
    let drawing = trace(&plate([40.3, 200.1], [320.6, 60.7])).unwrap();
    assert_eq!(segments(&drawing, LineStyle::Visible).len(), 12, "{:?}", drawing.curves);
    let hidden = segments(&drawing, LineStyle::Hidden);
    assert_eq!(hidden.len(), 4, "{:?}", drawing.curves);
    let circles = drawing.curves.iter().filter_map(|c| match c.curve {
        Curve2::Arc { center, radius, .. } => Some((center, radius)),
        _ => None,
    });
    let [(center, radius)] = circles.collect::<Vec<_>>()[..] else { panic!("{:?}", drawing.curves) };
    assert!((radius - 30.3).abs() < 0.15, "{radius}");
    // Hidden lines of the front view are exactly at the extremes of the circle, and end at the outline.
    let mut xs: Vec<f64> = hidden.iter().map(|s| s[0][0]).filter(|x| *x < 300.0).collect();
    xs.sort_by(f64::total_cmp);
    assert!((xs[0] - center[0] + radius).abs() < 1e-6 && (xs[1] - center[0] - radius).abs() < 1e-6, "{xs:?}");
    for [a, b] in hidden {
        assert!(a[0] == b[0] && ((a[1] - b[1]).abs() - 60.6).abs() < 0.3, "{a:?} {b:?}");
    }
}

#[test]
fn views_that_are_placed_freely_are_aligned() {
    let drawing = trace(&plate([250.2, 310.4], [330.6, 170.9])).unwrap();
    let visible = segments(&drawing, LineStyle::Visible);
    let lowest = |k: usize| {
        let mut all: Vec<f64> = visible.iter().flatten().map(|p| p[k]).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    };
    // Two views in a row and two in a column share their coordinates.
    assert_eq!((lowest(0).len(), lowest(1).len()), (4, 4), "{visible:?}");
}

#[test]
fn white_paper_is_refused() {
    let error = trace(&Canvas::new().image).unwrap_err().to_string();
    assert!(error.contains("found none"), "{error}");
}

/// A line of 1.5 pixels covers one row fully and the next one in part; its middle is the same for a skeleton
/// in either row.
#[test]
fn lines_between_two_rows_have_the_middle_of_their_ink() {
    let mut canvas = Canvas::new();
    let values = &mut canvas.image.values;
    for x in 100..400 {
        for (row, value) in [(249, 14.0), (250, 112.0)] {
            values[row * 500 + x] = value;
        }
        values[100 * 500 + x] = 0.0;
    }
    let ink = ink::Ink::new(&canvas.image, None).unwrap();
    for row in [249, 250] {
        let pixels = (110..390).map(|x| [x, row]).collect();
        let path = skeleton::PixelPath::new(pixels);
        let at = pieces::centred(&path, &ink, 1.5)[140];
        assert!((at[1] - 249.37).abs() < 0.06, "{at:?}");
    }
}

/// A plate of 200 × 120 × 60 pixels as on a scanned sheet: the picture is turned by 1.5° and has noise,
/// visible lines are twice as wide as hidden ones, and there are a frame, a centre line and a dimension line.
#[test]
fn a_scanned_sheet_is_straightened_and_its_annotation_left_out() {
    let (sin, cos) = 1.5_f64.to_radians().sin_cos();
    let turn = |p: [f64; 2]| {
        let [x, y] = [p[0] - 300.0, p[1] - 300.0];
        [300.0 + cos * x - sin * y, 300.0 + sin * x + cos * y]
    };
    let mut values = vec![0.0_f64; 600 * 600];
    let mut line = |a: [f64; 2], b: [f64; 2], width: f64| {
        let [a, b] = [turn(a), turn(b)];
        for (k, value) in values.iter_mut().enumerate() {
            let p = [(k % 600) as f64, 599.0 - (k / 600) as f64];
            let off = planish_solid::views::distance_to_segment(p, a, b);
            *value = value.max((0.5 * width + 0.5 - off).clamp(0.0, 1.0));
        }
    };
    let rectangle = |x: f64, y: f64, wide: f64, high: f64| {
        let c = [[x, y], [x + wide, y], [x + wide, y + high], [x, y + high]];
        [0, 1, 2, 3].map(|k| [c[k], c[(k + 1) % 4]])
    };
    let views = [rectangle(60.0, 80.0, 200.0, 60.0), rectangle(60.0, 220.0, 200.0, 120.0)];
    let wide = [rectangle(20.0, 20.0, 560.0, 560.0), rectangle(340.0, 80.0, 120.0, 60.0), views[0], views[1]];
    wide.into_iter().flatten().for_each(|[a, b]| line(a, b, 4.0));
    for [x, y, top] in [[150.0, 80.0, 140.0], [400.0, 80.0, 140.0]] {
        for k in 0..5 {
            let from = y + 14.0 * f64::from(k);
            line([x, from], [x, (from + 9.0).min(top)], 2.0);
        }
    }
    // Above the top view a dimension line, and through it a centre line.
    line([60.0, 365.0], [260.0, 365.0], 2.0);
    for [from, to] in [[210.0, 250.0], [256.0, 259.0], [265.0, 305.0], [311.0, 314.0], [320.0, 350.0]] {
        line([200.0, from], [200.0, to], 2.0);
    }
    let noise = |k: usize| (k.wrapping_mul(2_654_435_761) >> 7) % 13;
    let values = (0..values.len()).map(|k| (230.0 - 190.0 * values[k]) as f32 + noise(k) as f32 - 6.0);
    let drawing = trace(&Image { columns: 600, rows: 600, values: values.collect() }).unwrap();
    let placement = drawing.placement.unwrap();
    assert!((placement.rotation_rad.to_degrees() + 1.5).abs() < 0.02, "{placement:?}");
    assert_eq!(placement.perspective, "none");
    assert_eq!(segments(&drawing, LineStyle::Visible).len(), 12, "{:?}", drawing.curves);
    assert_eq!(segments(&drawing, LineStyle::Hidden).len(), 2, "{:?}", drawing.curves);
    let codes: Vec<FindingCode> = drawing.findings.iter().map(|f| f.code).collect();
    assert!(codes.contains(&FindingCode::PictureStraightened) && codes.contains(&FindingCode::SheetSetAside));
}
