use super::*;
use crate::drawing::{Curve2, LineStyle};
use crate::views::solve;
use planish_estimate::Result;
use std::f64::consts::TAU;

fn segment(a: [f64; 2], b: [f64; 2], style: LineStyle) -> DrawnCurve {
    let entity = format!("line from {a:?} to {b:?}");
    DrawnCurve { curve: Curve2::Segment(a, b), style, entity }
}

fn circle(center: [f64; 2], radius: f64) -> DrawnCurve {
    let curve = Curve2::Arc { center, radius, start: 0.0, sweep: TAU };
    DrawnCurve { curve, style: LineStyle::Visible, entity: format!("circle at {center:?} of {radius}") }
}

fn outline(points: &[[f64; 2]], at: &dyn Fn([f64; 2]) -> [f64; 2]) -> Vec<DrawnCurve> {
    (0..points.len())
        .map(|k| segment(at(points[k]), at(points[(k + 1) % points.len()]), LineStyle::Visible))
        .collect()
}

fn corners([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Vec<[f64; 2]> {
    vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
}

fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Vec<DrawnCurve> {
    outline(&[[x0, y0], [x1, y0], [x1, y1], [x0, y1]], &|p| p)
}

/// A base of 40 × 30 × 10 with a block of 15 × 10 × 10 on its corner at the origin, on a sheet of either
/// convention.
fn step_on_a_sheet(projection: Projection) -> Vec<DrawnCurve> {
    let front = |p: [f64; 2]| [p[0] + 100.0, p[1] + 100.0];
    let l_shape = |long: f64, short: f64| {
        [[0.0, 0.0], [long, 0.0], [long, 10.0], [short, 10.0], [short, 20.0], [0.0, 20.0]]
    };
    let mut curves = outline(&l_shape(40.0, 15.0), &front);
    // The base's edge behind the block.
    curves.push(segment(front([0.0, 10.0]), front([15.0, 10.0]), LineStyle::Hidden));
    let first = projection == Projection::FirstAngle;
    let top = |p: [f64; 2]| [p[0] + 100.0, p[1] + if first { 50.0 } else { 150.0 }];
    curves.extend(outline(&[[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]], &top));
    curves.push(segment(top([15.0, 0.0]), top([15.0, 10.0]), LineStyle::Visible));
    curves.push(segment(top([0.0, 10.0]), top([15.0, 10.0]), LineStyle::Visible));
    // From the left, y runs to the left, and the edge of the base lies behind the block.
    let side = |p: [f64; 2]| [if first { 190.0 - p[0] } else { 160.0 + p[0] }, p[1] + 100.0];
    curves.extend(outline(&l_shape(30.0, 10.0), &side));
    let style = if first { LineStyle::Hidden } else { LineStyle::Visible };
    curves.push(segment(side([0.0, 10.0]), side([10.0, 10.0]), style));
    curves
}

/// Border, frame with zones, and a title block with the symbol of third-angle projection.
fn frame() -> Vec<DrawnCurve> {
    let mut curves = rectangle([0.0, 0.0], [420.0, 297.0]);
    curves.extend(rectangle([20.0, 10.0], [410.0, 287.0]));
    curves.extend(
        (1..8)
            .map(|k| [20.0 + 48.75 * f64::from(k), 5.0])
            .map(|p| segment(p, [p[0], 10.0], LineStyle::Visible)),
    );
    curves.push(segment([230.0, 10.0], [230.0, 66.0], LineStyle::Visible));
    curves.extend([66.0, 38.0].map(|y| segment([230.0, y], [410.0, y], LineStyle::Visible)));
    curves.extend(outline(&[[304.0, 21.5], [316.0, 19.0], [316.0, 29.0], [304.0, 26.5]], &|p| p));
    curves.extend([5.0, 2.5].map(|r| circle([290.0, 24.0], r)));
    curves
}

fn read(curves: &[DrawnCurve], annotations: &Annotations) -> Result<Vec<SheetReading>> {
    read_sheet(curves, annotations, &SheetOptions { unit_mm: 1.0, ..SheetOptions::default() })
}

fn volume(reading: &SheetReading) -> f64 {
    let found = solve(&reading.drawing).unwrap();
    assert!(found.unexplained.is_empty(), "{:?}", found.unexplained);
    found.solutions[0].measures.volume
}

#[test]
fn a_sheet_of_either_convention_gives_the_same_part() {
    for projection in [Projection::FirstAngle, Projection::ThirdAngle] {
        for options in
            [None, Some(projection)].map(|projection| SheetOptions { projection, ..SheetOptions::default() })
        {
            let readings =
                read_sheet(&step_on_a_sheet(projection), &Annotations::default(), &options).unwrap();
            assert_eq!((readings.len(), readings[0].projection), (1, projection));
            let found = solve(&readings[0].drawing).unwrap();
            assert_eq!(found.solutions.len(), 1);
            let measures = &found.solutions[0].measures;
            assert!((measures.volume - 13_500.0).abs() < 1e-9);
            let truth =
                [(12_000.0 * 20.0 + 1500.0 * 7.5) / 13_500.0, (12_000.0 * 15.0 + 1500.0 * 5.0) / 13_500.0];
            assert!((0..2).all(|k| (measures.centroid[k] - truth[k]).abs() < 1e-9));
        }
    }
}

#[test]
fn views_of_the_wrong_convention_are_rejected_by_name() {
    let first = SheetOptions { projection: Some(Projection::FirstAngle), ..SheetOptions::default() };
    let sheet = step_on_a_sheet(Projection::ThirdAngle);
    let e = read_sheet(&sheet, &Annotations::default(), &first).unwrap_err();
    assert!(e.to_string().contains("first-angle"), "{e}");
    let e = read_sheet(&rectangle([0.0, 0.0], [4.0, 3.0]), &Annotations::default(), &first).unwrap_err();
    assert!(e.to_string().contains("found 1"), "{e}");
}

#[test]
fn frame_title_block_and_symbol_are_set_aside() {
    for projection in [Projection::FirstAngle, Projection::ThirdAngle] {
        let mut curves = frame();
        let lines = curves.len();
        curves.extend(step_on_a_sheet(projection));
        let readings = read(&curves, &Annotations::default()).unwrap();
        assert_eq!(readings[0].set_aside.len(), lines);
        let count = |reason| readings[0].set_aside.iter().filter(|(_, own)| *own == reason).count();
        assert_eq!((count(SetAsideReason::Frame), count(SetAsideReason::TitleBlock)), (15, 9));
        assert!((volume(&readings[0]) - 13_500.0).abs() < 1e-9);
    }
}

#[test]
fn the_symbol_decides_the_convention_of_two_views() {
    let plate = |x: f64| {
        let mut view = rectangle([x, 100.0], [x + 40.0, 120.0]);
        view.push(segment([x, 110.0], [x + 40.0, 110.0], LineStyle::Visible));
        view
    };
    let mut curves = frame();
    curves.extend(plate(50.0).into_iter().chain(plate(120.0)));
    let readings = read(&curves, &Annotations::default()).unwrap();
    let kinds: Vec<ViewKind> = readings[0].views.iter().map(|v| v.kind).collect();
    assert_eq!(
        (readings[0].projection, &kinds[..]),
        (Projection::ThirdAngle, &[ViewKind::Front, ViewKind::Side][..])
    );
    // The other convention is tried, too.
    assert!(
        readings.iter().any(|r| r.projection == Projection::FirstAngle && r.views[1].kind == ViewKind::Left)
    );
}

/// A dimension of the base's length: two extension lines, the line between its arrowheads, and a leader.
fn dimension() -> (Vec<DrawnCurve>, Vec<[[f64; 2]; 3]>) {
    let line = |a, b| segment(a, b, LineStyle::Visible);
    let curves = vec![
        line([100.0, 99.0], [100.0, 88.0]),
        line([140.0, 99.0], [140.0, 88.0]),
        line([100.0, 90.0], [140.0, 90.0]),
        line([110.0, 115.0], [125.0, 133.0]),
        line([125.0, 133.0], [135.0, 133.0]),
    ];
    let along = [15.0 / 549.0_f64.sqrt(), 18.0 / 549.0_f64.sqrt()];
    let foot = [110.0 + 3.0 * along[0], 115.0 + 3.0 * along[1]];
    let across = [-0.5 * along[1], 0.5 * along[0]];
    let arrows = vec![
        [[100.0, 90.0], [103.0, 90.5], [103.0, 89.5]],
        [[140.0, 90.0], [137.0, 90.5], [137.0, 89.5]],
        [
            [110.0, 115.0],
            [foot[0] + across[0], foot[1] + across[1]],
            [foot[0] - across[0], foot[1] - across[1]],
        ],
    ];
    (curves, arrows)
}

#[test]
fn dimensions_are_set_aside_by_their_arrowheads_or_their_pen() {
    let (lines, arrowheads) = dimension();
    let part = step_on_a_sheet(Projection::ThirdAngle);
    let curves: Vec<DrawnCurve> = part.iter().chain(&lines).cloned().collect();
    let pens = (0..curves.len()).map(|k| u32::from(k >= part.len())).collect();
    let by_pen = Annotations { pens, ..Annotations::default() };
    let by_arrows = Annotations { arrowheads, ..Annotations::default() };
    // Where the dimension line ends at the feet of its arrowheads, it does not touch the extension lines.
    let mut to_feet = curves.clone();
    to_feet[part.len() + 2] = segment([103.0, 90.0], [137.0, 90.0], LineStyle::Visible);
    for (curves, annotations) in [(&curves, by_pen), (&curves, by_arrows.clone()), (&to_feet, by_arrows)] {
        let readings = read(curves, &annotations).unwrap();
        assert_eq!(readings[0].set_aside.len(), lines.len(), "{:?}", readings[0].set_aside);
        assert!((volume(&readings[0]) - 13_500.0).abs() < 1e-9);
    }
}

#[test]
fn a_detail_is_set_aside_and_a_hatched_section_is_a_view() {
    let mut curves = step_on_a_sheet(Projection::ThirdAngle);
    curves.extend(outline(
        &[[0.0, 0.0], [30.0, 0.0], [30.0, 10.0], [10.0, 10.0], [10.0, 20.0], [0.0, 20.0]],
        &|p| [p[0] + 230.0, p[1] + 100.0],
    ));
    curves.push(segment([230.0, 110.0], [240.0, 110.0], LineStyle::Visible));
    curves.push(circle([250.0, 200.0], 12.0));
    // The plane is that of the middle, because no mark shows another one.
    let hatches = vec![corners([230.0, 100.0], [260.0, 110.0])];
    let annotations = Annotations { hatches, ..Annotations::default() };
    let readings = read(&curves, &annotations).unwrap();
    assert_eq!(readings[0].set_aside.len(), 1);
    assert_eq!(readings[0].set_aside[0].1, SetAsideReason::OtherView);
    assert_eq!(readings[0].views[3].section_at, Some(20.0));
    assert!((volume(&readings[0]) - 13_500.0).abs() < 1e-9);
}

#[test]
fn a_section_instead_of_a_view_shows_what_is_cut() {
    // The side view is a section at x = 12, through the block. Its material is the whole outline.
    let mut curves = step_on_a_sheet(Projection::ThirdAngle);
    curves.retain(|c| !(c.entity.contains("160.0, 110.0") && c.entity.contains("170.0, 110.0")));
    let hatches = vec![
        [[0.0, 0.0], [30.0, 0.0], [30.0, 10.0], [10.0, 10.0], [10.0, 20.0], [0.0, 20.0]]
            .map(|p| [p[0] + 160.0, p[1] + 100.0])
            .to_vec(),
    ];
    let text = |at| SheetText { at, text: "A".to_owned() };
    let marked = |x: f64| Annotations {
        hatches: hatches.clone(),
        texts: vec![text([x, 96.0]), text([x, 124.0])],
        centre_lines: vec![[[x, 95.0], [x, 125.0]]],
        ..Annotations::default()
    };
    let reading = read(&curves, &marked(112.0)).unwrap().remove(0);
    assert_eq!(reading.views[2].section_at, Some(12.0));
    assert!((volume(&reading) - 13_500.0).abs() < 1e-9);
    // At x = 20, the block is cut away: the drawing shows no solid.
    let reading = read(&curves, &marked(120.0)).unwrap().remove(0);
    assert!(!solve(&reading.drawing).unwrap().unexplained.is_empty());
}

#[test]
fn the_scale_is_that_of_dimensions_or_of_paper() {
    let with = |curves: &[DrawnCurve], annotations: &Annotations| {
        let reading = read(curves, annotations).unwrap().remove(0);
        (reading.scale, reading.scale_source, volume(&reading))
    };
    let part = step_on_a_sheet(Projection::ThirdAngle);
    let dimension = |drawn, stated| SheetDimension { drawn, stated, rounding: 0.005 };
    let dimensions = vec![dimension(40.0, 80.0), dimension(20.0, 40.0), dimension(10.0, 25.0)];
    let (scale, source, volume) = with(&part, &Annotations { dimensions, ..Annotations::default() });
    assert_eq!((scale, source), (2.0, ScaleSource::Dimensions));
    assert!((volume - 108_000.0).abs() < 1e-6);
    let text = |text: &str| SheetText { at: [300.0, 50.0], text: text.to_owned() };
    let stated = Annotations { texts: vec![text("Z 5:1"), text("1:2")], ..Annotations::default() };
    let sheet: Vec<DrawnCurve> = frame().into_iter().chain(part.clone()).collect();
    assert_eq!(with(&sheet, &stated).0, 2.0);
    // A frame of twice the size of a paper around a part in its true size.
    let large: Vec<DrawnCurve> = Drawing { views: vec![View::new(ViewKind::Front, frame())] }
        .scaled(2.0)
        .views
        .remove(0)
        .curves
        .into_iter()
        .chain(part.clone())
        .collect();
    assert_eq!(with(&large, &stated).0, 1.0);
    assert_eq!(with(&part, &stated).1, ScaleSource::Unknown);
    let factor = |factor| Annotations { length_factor: Some(factor), ..stated.clone() };
    assert_eq!(with(&part, &factor(2.0)).0, 2.0);
    assert_eq!(with(&part, &factor(5.0)).1, ScaleSource::Unknown);
}

#[test]
fn given_places_select_the_views() {
    let mut curves = step_on_a_sheet(Projection::ThirdAngle);
    curves.push(circle([120.0, 140.0], 3.0));
    let views = vec![
        (ViewKind::Front, [[99.0, 141.0], [99.0, 121.0]]),
        (ViewKind::Top, [[99.0, 141.0], [149.0, 181.0]]),
        (ViewKind::Side, [[159.0, 191.0], [99.0, 121.0]]),
    ];
    let options = SheetOptions { views: views.clone(), ..SheetOptions::default() };
    let readings = read_sheet(&curves, &Annotations::default(), &options).unwrap();
    assert_eq!(
        readings[0].set_aside,
        [("circle at [120.0, 140.0] of 3".to_owned(), SetAsideReason::Outside)]
    );
    assert!((volume(&readings[0]) - 13_500.0).abs() < 1e-9);
    let options = SheetOptions { views: vec![(ViewKind::Front, [[0.0, 1.0], [0.0, 1.0]])], ..options };
    let e = read_sheet(&curves, &Annotations::default(), &options).unwrap_err();
    assert!(e.to_string().contains("front view from (0, 0) to (1, 1)"), "{e}");
}

/// Front and side view of a plate of 30 × 30 × 8 with a hole of 10 through it, in the third-angle convention.
fn plate_in_two_views() -> Vec<DrawnCurve> {
    let mut curves = Vec::new();
    for x in [100.0, 160.0] {
        curves.extend(outline(&corners([0.0, 0.0], [30.0, 8.0]), &|p| [p[0] + x, p[1] + 100.0]));
        curves.extend([10.0, 20.0].map(|u| segment([x + u, 100.0], [x + u, 108.0], LineStyle::Hidden)));
    }
    curves
}

fn read_third(curves: &[DrawnCurve], annotations: &Annotations) -> SheetReading {
    let options = SheetOptions { projection: Some(Projection::ThirdAngle), ..SheetOptions::default() };
    read_sheet(curves, annotations, &options).unwrap().remove(0)
}

#[test]
fn equal_hidden_lines_in_two_views_are_a_hole_and_equal_outlines_stay_open() {
    let open = read_third(&plate_in_two_views(), &Annotations::default());
    assert!(open.open_widths);
    assert!((volume(&open) - 8.0 * (900.0 - 25.0 * std::f64::consts::PI)).abs() < 1e-8, "{}", volume(&open));
    // With a centre line of the hole, the sheet draws centre lines of what is round: the plate is flat.
    let centre_lines = vec![[[115.0, 95.0], [115.0, 113.0]]];
    let with_line = Annotations { centre_lines, ..Annotations::default() };
    assert!(!read_third(&plate_in_two_views(), &with_line).open_widths);
}

#[test]
fn a_diameter_states_that_an_outline_is_round() {
    // Measured between extension lines below the front view.
    let diameters = vec![[[100.0, 92.0], [130.0, 92.0]], [[100.0, 100.0], [130.0, 100.0]]];
    for (diameter, is_round) in diameters.into_iter().zip([false, true]) {
        let annotations = Annotations { diameters: vec![diameter], ..Annotations::default() };
        let reading = read_third(&plate_in_two_views(), &annotations);
        let round = 8.0 * std::f64::consts::PI * (225.0 - 25.0);
        assert_eq!((volume(&reading) - round).abs() < 1e-8, is_round, "{}", volume(&reading));
        // A diameter beside the view measures nothing of it.
        assert_eq!(reading.open_widths, !is_round);
    }
}
