use super::*;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use planish_solid::views::{Curve2, LineStyle};
use std::f64::consts::TAU;
use std::io::Write as _;

/// Entries of the page, further objects and content, as a file of 100 mm × 200 mm.
fn file(page: &str, objects: &str, content: &str) -> Vec<u8> {
    format!(
        "%PDF-1.4\n1 0 obj <</Type /Catalog /Pages 2 0 R /OCProperties <</D <</OFF [9 0 R]>>>>>> endobj\n\
         2 0 obj <</Kids [3 0 R] /MediaBox [0 0 283.4645669 566.9291339]>> endobj\n\
         3 0 obj <</Parent 2 0 R /Contents 4 0 R {page}>> endobj\n{objects}\n\
         4 0 obj <</Length {}>> stream\n{content}\nendstream endobj\ntrailer <</Root 1 0 R>>\n",
        content.len()
    )
    .into_bytes()
}

/// Content in millimetres.
fn drawn(content: &str) -> DxfDrawing {
    read(&file("", "", &format!("2.834645669 0 0 2.834645669 0 0 cm {content}"))).unwrap()
}

fn assert_near(found: [f64; 2], wanted: [f64; 2]) {
    assert!((0..2).all(|k| (found[k] - wanted[k]).abs() < 1e-5), "{found:?} {wanted:?}");
}

fn refusal(bytes: &[u8]) -> String {
    read(bytes).unwrap_err().to_string()
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn lengths_are_millimetres_as_a_viewer_shows_the_page() {
    let drawing = drawn("q 2 0 0 2 10 10 cm 0 0 m 10 5 l S Q 0 0 m 1 0 l 1 2 l s");
    let Curve2::Segment(a, b) = drawing.curves[0].curve else { panic!() };
    assert_near(a, [10.0, 10.0]);
    assert_near(b, [30.0, 20.0]);
    // `s` closes the path.
    assert_eq!((drawing.curves.len(), drawing.unit), (4, Some(Unit::Millimetre)));
    // Turned by a quarter clockwise, the lower left corner is at the upper left.
    let turned = read(&file("/Rotate 90", "", "0 0 m 28.34645669 0 l S")).unwrap();
    let Curve2::Segment(a, b) = turned.curves[0].curve else { panic!() };
    assert_near(a, [0.0, 100.0]);
    assert_near(b, [0.0, 90.0]);
}

#[test]
fn quarters_of_a_circle_become_one_circle() {
    let k = 5.522847498;
    let circle = format!(
        "30 20 m 30 {} {} 30 20 30 c {} 30 10 {} 10 20 c 10 {} {} 10 20 10 c {} 10 30 {} 30 20 c h S",
        20.0 + k,
        20.0 + k,
        20.0 - k,
        20.0 + k,
        20.0 - k,
        20.0 - k,
        20.0 + k,
        20.0 - k
    );
    let drawing = drawn(&circle);
    let [one] = &drawing.curves[..] else { panic!("{drawing:?}") };
    let Curve2::Arc { center, radius, sweep, .. } = one.curve else { panic!() };
    assert_near(center, [20.0, 20.0]);
    assert!((radius - 10.0).abs() < 1e-4 && sweep == TAU);
}

#[test]
fn short_lines_along_a_circle_become_an_arc_and_those_of_a_prism_stay() {
    let polygon = |n: usize| {
        let at = |k: usize| (std::f64::consts::PI * k as f64 / n as f64).sin_cos();
        let points = (1..=n).map(|k| format!("{:.6} {:.6} l ", 20.0 + 9.0 * at(k).1, 20.0 + 9.0 * at(k).0));
        drawn(&format!("29 20 m {} S", points.collect::<String>()))
    };
    let half = polygon(24);
    let [one] = &half.curves[..] else { panic!("{half:?}") };
    let Curve2::Arc { center, radius, sweep, .. } = one.curve else { panic!() };
    assert_near(center, [20.0, 20.0]);
    assert!((radius - 9.0).abs() < 1e-5 && (sweep - 0.5 * TAU).abs() < 1e-5);
    assert_eq!(polygon(6).curves.len(), 6);
}

#[test]
fn dash_patterns_and_single_dashes_are_hidden_lines() {
    let drawing = drawn("[3 1.5] 0 d 0 0 m 20 0 l S [9 1 1 1] 0 d 0 5 m 20 5 l S [] 0 d 0 9 m 20 9 l S");
    let styles: Vec<_> = drawing.curves.iter().map(|c| c.style).collect();
    assert_eq!(styles, [LineStyle::Hidden, LineStyle::Visible]);
    // Dashes of 3 mm; the line ends in a gap, 20.5 mm from its begin, where another line is.
    let dashes: String =
        (0..5).map(|k| format!("{} 0 m {} 0 l ", 4.5 * k as f64, 4.5 * k as f64 + 3.0)).collect();
    let drawing = drawn(&format!("{dashes} S 22 -5 m 22 5 l S"));
    assert_eq!(drawing.curves.len(), 2, "{drawing:?}");
    assert_eq!(drawing.curves[0].style, LineStyle::Hidden);
    let Curve2::Segment(a, b) = drawing.curves[0].curve else { panic!() };
    assert_near(a, [0.0, 0.0]);
    assert_near(b, [22.0, 0.0]);
    // Long and short dashes in turn.
    let centre = drawn("0 0 m 8 0 l 9 0 m 10 0 l 11 0 m 19 0 l 20 0 m 21 0 l 22 0 m 27 0 l S 0 9 m 1 9 l S");
    assert_eq!(centre.curves.len(), 1, "{centre:?}");
    assert_eq!(centre.ignored["centre line of single dashes"], 1);
}

#[test]
fn teeth_of_a_comb_are_no_dashes() {
    let tooth = |k: usize| {
        let x = 5.0 * k as f64;
        format!("{x} 0 m {x} 4 l {} 4 l {} 0 l {} 0 l ", x + 3.0, x + 3.0, x + 5.0)
    };
    let comb = drawn(&format!("{} S", (0..6).map(tooth).collect::<String>()));
    assert_eq!(comb.curves.len(), 24);
    assert!(comb.curves.iter().all(|c| c.style == LineStyle::Visible));
}

#[test]
fn arrowheads_with_a_number_are_dimensions_and_hatches_are_boxes() {
    let font = "/Resources <</Font <</F1 <</Type /Font>>>>>>";
    let mm = "2.834645669 0 0 2.834645669 0 0 cm";
    let arrows = "10 10 m 13 10.5 l 13 9.5 l f 50 10 m 47 10.5 l 47 9.5 l h f 10 10 m 50 10 l S";
    let text = "BT /F1 3.5 Tf 1 0 0 1 27 11 Tm (8) Tj [(0) -20 (.0)] TJ ET";
    let drawing = read(&file(font, "", &format!("{mm} {arrows} {text}"))).unwrap();
    assert_eq!(drawing.annotations.texts[0].text, "80.0");
    assert_eq!(drawing.annotations.arrowheads.len(), 2);
    let [dimension] = drawing.annotations.dimensions[..] else { panic!("{drawing:?}") };
    assert!((dimension.drawn - 40.0).abs() < 1e-5 && dimension.stated == 80.0);
    let lines: String = (0..9).map(|k| format!("{} 20 m {} 30 l S ", 10 + 2 * k, 20 + 2 * k)).collect();
    let hatched = drawn(&format!("0 0 m 5 0 l S {lines}"));
    assert_eq!(hatched.curves.len(), 1);
    let [hatch] = &hatched.annotations.hatches[..] else { panic!("{hatched:?}") };
    assert_near(hatch[0], [10.0, 36.0]);
    assert_near(hatch[2], [20.0, 30.0]);
}

#[test]
fn forms_are_drawn_and_hidden_layers_are_not() {
    let resources = "/Resources <</XObject <</A 5 0 R>> /Properties <</L 9 0 R /M 8 0 R>>>>";
    let form = "5 0 obj <</Subtype /Form /Matrix [1 0 0 1 28.34645669 0] /Length 15>> stream\n\
                0 0 m 9 0 l S  \n\
                endstream endobj 8 0 obj <</Name (on)>> endobj 9 0 obj <</Name (off)>> endobj";
    let content = "/A Do /OC /L BDC 0 5 m 9 5 l S EMC /OC /M BDC 0 7 m 9 7 l S EMC";
    let drawing = read(&file(resources, form, content)).unwrap();
    assert_eq!(drawing.curves.len(), 2);
    let Curve2::Segment(a, _) = drawing.curves[0].curve else { panic!() };
    assert_near(a, [10.0, 0.0]);
    // A form that draws itself ends with an error.
    let endless = form.replace("0 0 m 9 0 l S  ", "/A Do /A Do    ");
    assert!(refusal(&file(resources, &endless, "/A Do")).contains("does `A` contain itself?"));
}

#[test]
fn objects_in_streams_are_found() {
    let content = packed(b"0 0 m 72 0 l S");
    let objects = b"1 0 2 23 3 44 <</Pages 2 0 R      >> <</Kids [3 0 R]   >> \
        <</MediaBox [0 0 72 72] /Contents 4 0 R>>";
    // First: where the objects begin; offsets are relative to it.
    let objects = packed(objects);
    let mut bytes = b"%PDF-1.5\n".to_vec();
    bytes.extend(
        format!(
            "5 0 obj <</Type/ObjStm/N 3/First 14/Filter/FlateDecode/Length {}>> stream\r\n",
            objects.len()
        )
        .bytes(),
    );
    bytes.extend(&objects);
    bytes.extend(b"\nendstream endobj 6 0 obj ");
    bytes.extend(
        format!("{} endobj 4 0 obj <</Filter/FlateDecode/Length 6 0 R>> stream\n", content.len()).bytes(),
    );
    bytes.extend(&content);
    bytes.extend(b"\nendstream endobj 7 0 obj <</Type/XRef/Root 1 0 R/Length 0>> stream\n\nendstream endobj");
    let drawing = read(&bytes).unwrap();
    assert!((drawing.curves[0].curve.length() - 25.4).abs() < 1e-9);
}

#[test]
fn what_is_not_understood_is_refused() {
    assert!(refusal(b"0 SECTION").contains("expected a PDF file"));
    assert!(refusal(&file("", "", "")).contains("expected a page with lines, found none"));
    let mut encrypted = file("", "", "0 0 m 9 9 l S");
    encrypted.extend(b"trailer <</Encrypt <<>>>>");
    assert!(refusal(&encrypted).contains("found an encrypted one"));
    let picture = "5 0 obj <</Subtype /Image /Length 1>> stream\n0\nendstream endobj";
    let scanned = file("/Resources <</XObject <</A 5 0 R>>>>", picture, "/A Do");
    assert!(refusal(&scanned).contains("found a picture only"));
    let several = file("", "2 0 obj <</Kids [3 0 R 3 0 R] /MediaBox [0 0 9 9]>> endobj", "0 0 m 9 9 l S");
    assert!(refusal(&several).contains("found several"));
    // A small stream that unpacks to a gigabyte.
    let bomb = packed(&vec![b' '; 100 << 20]);
    let mut bytes =
        b"%PDF-1.4 1 0 obj <</Pages 2 0 R>> endobj 2 0 obj <</MediaBox [0 0 9 9] /Contents 4 0 R>> \
        endobj trailer <</Root 1 0 R>> 4 0 obj <</Filter /FlateDecode>> stream\n"
            .to_vec();
    bytes.extend(&bomb);
    assert!(refusal(&bytes).contains("out of proportion"));
}
