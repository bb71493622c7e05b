use super::*;
use planish_solid::views::{Curve2, LineStyle};
use std::f64::consts::{PI, TAU};

/// Reads a DXF file with blocks and entities, given as codes and values separated by blanks.
fn drawn(blocks: &str, entities: &str) -> Result<DxfDrawing> {
    let lines = |text: &str| text.split_whitespace().collect::<Vec<_>>().join("\n");
    let text = format!(
        "0\nSECTION\n2\nBLOCKS\n{}\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n{}\n0\nENDSEC\n0\nEOF\n",
        lines(blocks),
        lines(entities)
    );
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.dxf");
    std::fs::write(&path, text.replace("\n\n", "\n")).expect("a file");
    read_dxf(&path)
}

const LINE_BLOCK: &str = "0 BLOCK 2 part 10 1 20 0 0 LINE 8 0 10 1 20 0 11 3 21 0 0 ARC 8 HIDDEN 10 1 20 0 \
    40 2 50 0 51 90 0 ENDBLK";

#[test]
fn a_block_is_drawn_at_its_insert() {
    let found = drawn(LINE_BLOCK, "0 INSERT 5 2A 8 DASHED 2 PART 10 10 20 20 41 2 42 2 50 90").unwrap();
    let Curve2::Segment(a, b) = found.curves[0].curve else { panic!() };
    // The base point is (1, 0); the insert scales by 2 and rotates by 90°.
    for (found, wanted) in [(a, [10.0, 20.0]), (b, [10.0, 24.0])] {
        assert!((found[0] - wanted[0]).abs() < 1e-12 && (found[1] - wanted[1]).abs() < 1e-12, "{found:?}");
    }
    // Entities on layer 0 take the layer of the insert.
    assert!(found.curves.iter().all(|c| c.style == LineStyle::Hidden));
    assert_eq!(found.curves[0].entity, "LINE (line 14) in block PART by INSERT 2A (line 48)");
    let Curve2::Arc { radius, start, sweep, .. } = found.curves[1].curve else { panic!() };
    assert!(
        (radius - 4.0).abs() < 1e-12 && (start - PI / 2.0).abs() < 1e-12 && (sweep - PI / 2.0).abs() < 1e-12
    );
}

#[test]
fn a_mirrored_insert_reverses_arcs_and_an_uneven_one_gives_ellipses() {
    let mirrored = drawn(LINE_BLOCK, "0 INSERT 2 part 10 0 20 0 41 -1").unwrap();
    let Curve2::Arc { start, sweep, .. } = mirrored.curves[1].curve else { panic!() };
    assert!((start.rem_euclid(TAU) - PI / 2.0).abs() < 1e-12 && (sweep - PI / 2.0).abs() < 1e-12);
    let uneven = drawn(LINE_BLOCK, "0 INSERT 2 part 10 0 20 0 41 2 42 1").unwrap();
    assert!(matches!(uneven.curves[1].curve, Curve2::Chain(_)));
}

#[test]
fn rows_and_columns_of_an_insert_are_drawn() {
    let found = drawn(LINE_BLOCK, "0 INSERT 2 part 10 0 20 0 70 3 71 2 44 10 45 20").unwrap();
    assert_eq!(found.curves.len(), 12);
    let Curve2::Segment(a, _) = found.curves[10].curve else { panic!() };
    assert_eq!(a, [20.0, 20.0]);
}

#[test]
fn a_missing_or_recursive_block_is_named() {
    let e = drawn("", "0 INSERT 5 7 2 gone 10 0 20 0").unwrap_err().to_string();
    assert!(e.contains("INSERT 7 (line 12): expected the block `gone`"), "{e}");
    let itself = "0 BLOCK 2 a 10 0 20 0 0 INSERT 2 a 10 0 20 0 0 ENDBLK";
    let e = drawn(itself, "0 INSERT 2 a 10 0 20 0").unwrap_err().to_string();
    assert!(e.contains("does `a` contain itself?"), "{e}");
    // Ten blocks that each insert the next one ten times: 10⁹ lines.
    let mut bomb = "0 BLOCK 2 b0 10 0 20 0 0 LINE 10 0 20 0 11 1 21 1 0 ENDBLK ".to_owned();
    for k in 1..10 {
        bomb += &format!(
            "0 BLOCK 2 b{k} 10 0 20 0 {} 0 ENDBLK ",
            format!("0 INSERT 2 b{} 10 0 20 0 ", k - 1).repeat(10)
        );
    }
    let e = drawn(&bomb, "0 INSERT 2 b9 10 0 20 0").unwrap_err().to_string();
    assert!(e.contains("expected at most 200000 entities"), "{e}");
}

#[test]
fn an_old_polyline_has_lines_and_arcs() {
    let found = drawn(
        "",
        "0 POLYLINE 70 1 0 VERTEX 10 0 20 0 0 VERTEX 10 4 20 0 42 1 0 VERTEX 10 4 20 2 0 VERTEX 10 0 20 2 0 \
         SEQEND 0 LINE 10 0 20 5 11 1 21 5",
    )
    .unwrap();
    assert_eq!(found.curves.len(), 5);
    let Curve2::Arc { center, radius, sweep, .. } = found.curves[1].curve else { panic!() };
    assert_eq!((center, radius), ([4.0, 1.0], 1.0));
    assert!((sweep - PI).abs() < 1e-12);
    assert!(found.findings.is_empty(), "{:?}", found.findings);
}

#[test]
fn a_spline_ends_where_its_knots_end() {
    // A quadratic with uniform knots: it begins and ends midway between two poles.
    let poles = "10 0 20 0 10 2 20 0 10 2 20 4 10 0 20 4";
    let knots = |all: &str| all.split(' ').map(|k| format!("40 {k} ")).collect::<String>();
    let ends = |all: &str| {
        let found = drawn("", &format!("0 SPLINE 71 2 {}{poles}", knots(all))).unwrap();
        let Curve2::Chain(chain) = &found.curves[0].curve else { panic!() };
        [chain[0], chain[chain.len() - 1]]
    };
    assert_eq!(ends("0 1 2 3 4 5 6"), [[1.0, 0.0], [1.0, 4.0]]);
    assert_eq!(ends("0 0 0 1 2 2 2"), [[0.0, 0.0], [0.0, 4.0]]);
    // Clamped at the start only.
    assert_eq!(ends("0 0 0 1 2 3 4"), [[0.0, 0.0], [1.0, 4.0]]);
    let e = drawn("", &format!("0 SPLINE 71 2 {}{poles}", knots("1 1 1 1 1 1 1"))).unwrap_err().to_string();
    assert!(e.contains("expected ascending knots"), "{e}");
}

#[test]
fn ignored_entities_are_counted_and_the_first_is_named() {
    let found = drawn(
        "",
        "0 TEXT 5 A1 1 hello 0 HATCH 5 A2 0 HATCH 5 A3 0 POLYLINE 5 A4 70 64 0 VERTEX 10 0 20 0 0 SEQEND 0 \
         LINE 10 0 20 0 11 1 21 0",
    )
    .unwrap();
    assert_eq!(found.curves.len(), 1);
    let all = found.findings.iter().map(|f| f.text.as_str()).collect::<Vec<_>>().join("\n");
    for wanted in [
        "1 × TEXT, which draws no edges; the first is TEXT A1 (line",
        "2 × HATCH, which draws no edges; the first is HATCH A2 (line",
        "1 × POLYLINE, which draws no edges; the first is POLYLINE A4",
    ] {
        assert!(all.contains(wanted), "{all}");
    }
}

#[test]
fn conflicting_dimensions_are_named() {
    let line = "0 LINE 10 0 20 0 11 40 21 0 0 CIRCLE 10 20 20 10 40 6";
    let warnings = |dimension: &str| {
        drawn("", &format!("{line} {dimension}"))
            .unwrap()
            .findings
            .iter()
            .map(|f| f.text.as_str())
            .collect::<Vec<_>>()
            .join("\n")
    };
    // Linear along x, between the ends of the line.
    let linear = |text: &str| warnings(&format!("0 DIMENSION 5 D1 70 32 13 0 23 0 14 40 24 0 {text}"));
    assert_eq!(linear("1 40"), "");
    assert_eq!(linear("1 40.0±0.1"), "");
    assert_eq!(linear("1 <>"), "");
    assert_eq!(linear("42 40.0"), "");
    let found = linear("1 45");
    assert!(
        found.contains("DIMENSION D1 (line")
            && found.contains("states 45, but the distance of its points is 40"),
        "{found}"
    );
    assert!(linear("42 38.5").contains("states 38.5"));
    assert!(linear("1 \\A1;\\fArial|b0;41").contains("states 41"));
    let diameter = |text: &str| warnings(&format!("0 DIMENSION 5 D2 70 35 10 14 20 10 15 26 25 10 {text}"));
    assert_eq!(diameter("1 %%c12"), "");
    assert!(diameter("1 Ø13").contains("states 13, but the distance of its points on the circle is 12"));
    assert_eq!(diameter("1 4x12"), "");
    let radius = warnings("0 DIMENSION 5 D3 70 36 10 20 20 10 15 26 25 10 1 R6.5");
    assert!(radius.contains("D3") && radius.contains("states 6.5"), "{radius}");
    let loose = warnings("0 DIMENSION 5 D4 70 33 13 0 23 0 14 45 24 0");
    assert!(
        loose.contains("DIMENSION D4")
            && loose.contains("measures from (45.0000, 0.0000), where the drawing has no line"),
        "{loose}"
    );
}

#[test]
fn dimensions_with_the_sign_of_a_diameter_state_their_ends() {
    let dimension = |text: &str| {
        format!(
            "0 LINE 10 0 20 0 11 20 21 0 0 DIMENSION 70 0 1 {text} 3 ISO 50 0 10 0 20 9 13 0 23 0 14 20 24 3"
        )
    };
    for (text, count) in [("%%c20", 1), ("Ø<>", 1), ("20", 0), ("<>", 0)] {
        let found = drawn("", &dimension(text)).unwrap().annotations.diameters;
        assert_eq!(found.len(), count, "{text}");
        // Measured along x: the second point is moved to the level of the first.
        assert!(found.iter().all(|ends| *ends == [[0.0, 0.0], [20.0, 0.0]]), "{found:?}");
    }
}

#[test]
fn dimensions_drawn_as_lines_arrowheads_and_a_text_count() {
    let drawing = drawn(
        "",
        "0 LINE 10 0 20 0 11 20 21 0 0 LINE 10 0 20 9 11 20 21 9 \
         0 SOLID 10 0 20 9 11 3 21 9.5 12 3 22 8.5 13 3 23 8.5 \
         0 SOLID 10 20 20 9 11 17 21 9.5 12 17 22 8.5 13 17 23 8.5 \
         0 TEXT 10 9 20 10 40 3 1 %%c40.0",
    )
    .unwrap();
    let [dimension] = drawing.annotations.dimensions[..] else { panic!("{:?}", drawing.annotations) };
    assert!((dimension.drawn - 20.0).abs() < 1e-12 && dimension.stated == 40.0, "{dimension:?}");
    assert_eq!(drawing.annotations.diameters, [[[0.0, 9.0], [20.0, 9.0]]]);
}
