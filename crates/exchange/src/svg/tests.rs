use super::*;

fn drawn(body: &str) -> DxfDrawing {
    let text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"200mm\" viewBox=\"0 0 100 100\">\n{body}\n</svg>"
    );
    read(&text).unwrap()
}

fn assert_near(found: [f64; 2], wanted: [f64; 2]) {
    assert!(
        (found[0] - wanted[0]).abs() < 1e-9 && (found[1] - wanted[1]).abs() < 1e-9,
        "{found:?} {wanted:?}"
    );
}

fn one(body: &str) -> Curve2 {
    let drawing = drawn(body);
    assert_eq!(drawing.curves.len(), 1, "{drawing:?}");
    drawing.curves[0].curve.clone()
}

#[test]
fn lengths_are_millimetres_and_y_points_up() {
    let drawing = drawn("<line x1='1' y1='2' x2='3' y2='5'/>");
    assert_eq!(drawing.unit, Some(Unit::Millimetre));
    let Curve2::Segment(a, b) = drawing.curves[0].curve else { panic!() };
    assert_near(a, [2.0, -4.0]);
    assert_near(b, [6.0, -10.0]);
    assert_eq!(drawing.curves[0].entity, "line (line 2)");
}

#[test]
fn circles_stay_arcs_when_rotated_and_become_chains_when_stretched() {
    let circle = one("<g transform='translate(10 20) rotate(30)'><circle cx='5' r='4'/></g>");
    let Curve2::Arc { center, radius, sweep, .. } = circle else { panic!() };
    let (sin, cos) = 30_f64.to_radians().sin_cos();
    assert_near(center, [2.0 * (10.0 + 5.0 * cos), -2.0 * (20.0 + 5.0 * sin)]);
    assert!((radius - 8.0).abs() < 1e-12 && (sweep - TAU).abs() < 1e-12);
    assert!(matches!(one("<circle r='4' transform='scale(2 1)'/>"), Curve2::Chain(_)));
}

#[test]
fn flags_select_the_arc() {
    // From (0, 0) to (2, 0) with radius 2: the middle of each of the four arcs.
    let h = 3_f64.sqrt();
    for (flags, middle) in
        [("0 1", [1.0, h - 2.0]), ("0 0", [1.0, 2.0 - h]), ("1 1", [1.0, -h - 2.0]), ("1 0", [1.0, h + 2.0])]
    {
        let Curve2::Arc { center, radius, start, sweep } =
            one(&format!("<path d='M0 0A2 2 0 {flags} 2 0'/>"))
        else {
            panic!()
        };
        let angle = start + sweep / 2.0;
        assert_near(
            [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()],
            [2.0 * middle[0], -2.0 * middle[1]],
        );
    }
}

#[test]
fn paths_have_relative_and_absolute_lines_and_close() {
    let drawing = drawn("<path d='m1,1 2 0v2H1z M10-5l.5.5'/>");
    let ends: Vec<[[f64; 2]; 2]> = drawing
        .curves
        .iter()
        .map(|c| match c.curve {
            Curve2::Segment(a, b) => [a, b].map(|p| [p[0] / 2.0, -p[1] / 2.0]),
            _ => panic!(),
        })
        .collect();
    let wanted = [
        [[1.0, 1.0], [3.0, 1.0]],
        [[3.0, 1.0], [3.0, 3.0]],
        [[3.0, 3.0], [1.0, 3.0]],
        [[1.0, 3.0], [1.0, 1.0]],
        [[10.0, -5.0], [10.5, -4.5]],
    ];
    assert_eq!(ends, wanted);
}

#[test]
fn a_cubic_along_a_circle_becomes_an_arc() {
    let k = 4.0 / 3.0 * (2_f64.sqrt() - 1.0);
    let Curve2::Arc { center, radius, sweep, .. } =
        one(&format!("<path d='M5 0C5 {} {} 5 0 5'/>", 5.0 * k, 5.0 * k))
    else {
        panic!()
    };
    assert!(
        center[0].abs() < 1e-3 && center[1].abs() < 1e-3 && (radius - 10.0).abs() < 1e-2,
        "{center:?} {radius}"
    );
    assert!((sweep - PI / 2.0).abs() < 1e-3);
    assert!(matches!(one("<path d='M0 0C1 2 3-2 4 0'/>"), Curve2::Chain(_)));
    assert!(matches!(one("<path d='M0 0C1 1 2 2 3 3'/>"), Curve2::Segment(..)));
}

#[test]
fn dashes_are_hidden_lines_and_dash_dots_centre_lines() {
    let drawing = drawn(
        "<style>.d { stroke-dasharray: 4 2 } </style>\
         <line x2='1'/><line x2='2' class='d'/><line x2='3' style='stroke-dasharray:4,2,1,2'/>\
         <g id='HIDDEN'><line x2='4'/><line x2='5' stroke-dasharray='none'/></g><line x2='6' \
         display='none'/>",
    );
    let styles: Vec<LineStyle> = drawing.curves.iter().map(|c| c.style).collect();
    use LineStyle::{Hidden, Visible};
    assert_eq!(styles, [Visible, Hidden, Hidden, Visible]);
    assert_eq!(drawing.ignored["centre line"], 1);
}

#[test]
fn a_visible_child_of_a_hidden_group_is_drawn_but_not_one_of_a_group_without_display() {
    let drawing = drawn(
        "<g visibility='hidden'><line x2='1'/><line x2='2' visibility='visible'/>\
         <g><line x2='3'/><line x2='4' style='visibility:visible'/></g></g>\
         <g display='none'><line x2='5' visibility='visible'/><line x2='6' display='inline'/></g>\
         <line x2='7'/>",
    );
    let lengths: Vec<f64> = drawing.curves.iter().map(|c| c.curve.length()).collect();
    assert_eq!(lengths, [4.0, 8.0, 14.0]);
}

#[test]
fn arcs_between_close_points_are_short_or_nearly_whole_turns() {
    // The ends are closer than the rounding of the angles, then a little farther apart.
    for gap in [1e-17, 1e-14, 1e-9, 1e-5] {
        for (large, wanted) in [(0, gap), (1, 2.0 * PI * 10.0 - gap)] {
            for sweep in [0, 1] {
                let curve = one(&format!("<path d='M0 0A10 10 0 {large} {sweep} {gap} 0'/>"));
                // One user unit is 2 mm.
                let length = curve.length() / 2.0;
                // Lengths of ellipses are those of chords.
                assert!((length - wanted).abs() <= 1e-3 * wanted, "{large} {sweep} {gap}: {length}");
            }
        }
    }
}

#[test]
fn texts_and_lines_without_length_are_ignored_with_a_warning() {
    let drawing = drawn("<text id='t7'>40</text><line id='dot' x1='3' x2='3'/><line x2='1'/>");
    assert_eq!(drawing.curves.len(), 1);
    let all = drawing.findings.iter().map(|f| f.text.as_str()).collect::<Vec<_>>().join("\n");
    assert!(all.contains("line dot (line 2) has no length"), "{all}");
    assert!(all.contains("ignored 1 × text, which draws no edges; the first is text t7 (line 2)"), "{all}");
}

#[test]
fn a_rounded_rectangle_has_four_lines_and_four_arcs() {
    let drawing = drawn("<rect width='20' height='10' rx='2'/>");
    let arcs = drawing.curves.iter().filter(|c| matches!(c.curve, Curve2::Arc { .. })).count();
    assert_eq!((drawing.curves.len(), arcs), (8, 4));
    let length: f64 = drawing.curves.iter().map(|c| c.curve.length()).sum();
    let exact = 2.0 * (2.0 * 16.0 + 2.0 * 6.0 + 4.0 * PI);
    assert!((length - exact).abs() < 1e-2, "{length} {exact}");
}

#[test]
fn errors_name_element_and_line() {
    for (body, wanted) in [
        ("<path id='p' d='M0 0 L1'/>", "path p (line 2): expected a number in the path"),
        ("<path d='L0 0'/>", "expected a path that begins with M"),
        ("<circle r='-1'/>", "circle (line 2): expected radii of at least 0"),
        ("<line x1='1e300'/>", "line (line 2): x1: expected a number"),
        ("<g transform='turn(3)'/>", "expected a list of transforms"),
        ("<line x1='50%'/>", "x1: expected a number"),
    ] {
        let text = format!("<svg>\n{body}</svg>");
        let e = read(&text).unwrap_err().to_string();
        assert!(e.contains(wanted), "{e}");
    }
    assert!(
        read("<html/>").unwrap_err().to_string().contains("expected an SVG file, found the element `html`")
    );
    let deep = format!("<svg>{}{}</svg>", "<g>".repeat(500), "</g>".repeat(500));
    assert!(read(&deep).unwrap_err().to_string().contains("nested groups"));
}
