use super::*;
use planish_solid::views::LineStyle;
use std::f64::consts::{PI, TAU};

const EXACT: Accuracy = Accuracy { rounding: 2e-5, position: 1e-3, longest_gap: 13.0 };

fn stroke(curve: Curve2, pen: u32) -> Stroke {
    Stroke { drawn: DrawnCurve { curve, style: LineStyle::Visible, entity: "path".to_owned() }, pen }
}

fn arc(start: f64, sweep: f64) -> Curve2 {
    Curve2::Arc { center: [5.0, 7.0], radius: 10.0, start, sweep }
}

#[test]
fn dashes_of_a_circle_become_a_circle() {
    let step = TAU / 20.0;
    let dashes: Vec<Stroke> = (0..20).map(|k| stroke(arc(step * k as f64, 0.7 * step), 0)).collect();
    let (joined, _) = join_dashes(dashes, &EXACT);
    assert_eq!(joined.len(), 1, "{joined:?}");
    assert_eq!(joined[0].drawn.curve, arc(0.0, TAU));
    assert_eq!(joined[0].drawn.style, LineStyle::Hidden);
}

#[test]
fn dashes_of_an_arc_are_extended_to_the_line_at_its_end() {
    // The last dash ends 0.05 rad before the end of the arc.
    let dashes = (0..6).map(|k| stroke(arc(0.3 * k as f64, 0.2), 0));
    let end = 1.75_f64;
    let at = |r: f64| [5.0 + r * end.cos(), 7.0 + r * end.sin()];
    let strokes: Vec<Stroke> = dashes.chain([stroke(Curve2::Segment(at(10.0), at(20.0)), 0)]).collect();
    let (joined, _) = join_dashes(strokes, &EXACT);
    let Curve2::Arc { start, sweep, .. } = joined[0].drawn.curve else { panic!() };
    assert!((start % TAU).abs() < 1e-9 && (sweep - end).abs() < 1e-9, "{start} {sweep}");
}

#[test]
fn two_dashes_are_a_line_only_with_the_gap_of_their_pen() {
    let dash = |x: f64, y: f64, length: f64, pen| stroke(Curve2::Segment([x, y], [x + length, y]), pen);
    let long = (0..5).map(|k| dash(4.0 * k as f64, 0.0, 3.0, 1));
    let rows =
        [dash(0.0, 5.0, 3.0, 1), dash(4.0, 5.0, 1.0, 1), dash(0.0, 9.0, 3.0, 2), dash(4.0, 9.0, 1.0, 2)];
    let (joined, _) = join_dashes(long.chain(rows).collect(), &EXACT);
    let styles: Vec<_> = joined.iter().map(|s| s.drawn.style).collect();
    assert_eq!(styles, [LineStyle::Hidden, LineStyle::Hidden, LineStyle::Visible, LineStyle::Visible]);
}

#[test]
fn a_pen_of_dashes_draws_short_hidden_lines() {
    let dash = |x: f64, y: f64, length: f64| stroke(Curve2::Segment([x, y], [x + length, y]), 1);
    let row = || (0..5).map(|k| dash(4.0 * k as f64, 0.0, 3.0));
    let (joined, _) = join_dashes(row().chain([dash(0.0, 5.0, 2.0)]).collect(), &EXACT);
    assert!(joined.iter().all(|s| s.drawn.style == LineStyle::Hidden));
    // A pen that also draws a long line draws visible lines.
    let (joined, _) = join_dashes(row().chain([dash(0.0, 5.0, 2.0), dash(0.0, 9.0, 8.0)]).collect(), &EXACT);
    assert_eq!(joined.iter().filter(|s| s.drawn.style == LineStyle::Hidden).count(), 1);
}

#[test]
fn short_lines_along_an_ellipse_become_a_chain() {
    let at = |k: usize| {
        let (sin, cos) = (PI * k as f64 / 80.0).sin_cos();
        [20.0 * cos, 5.0 * sin]
    };
    let lines: Vec<Stroke> = (0..80).map(|k| stroke(Curve2::Segment(at(k), at(k + 1)), 0)).collect();
    let joined = smoothed(lines, &EXACT);
    let [one] = &joined[..] else { panic!("{joined:?}") };
    assert!(matches!(&one.drawn.curve, Curve2::Chain(points) if points.len() == 81), "{one:?}");
}

#[test]
fn lines_that_touch_an_arc_of_short_lines_stay_lines() {
    let at = |k: usize| {
        let (sin, cos) = (PI * k as f64 / 40.0).sin_cos();
        [10.0 * cos, 10.0 * sin]
    };
    let arc = (0..20).map(|k| (at(k), at(k + 1)));
    let lines = [([10.0, -30.0], at(0))].into_iter().chain(arc).chain([(at(20), [-30.0, 10.0])]);
    let joined = smoothed(lines.map(|(a, b)| stroke(Curve2::Segment(a, b), 0)).collect(), &EXACT);
    let [first, arc, last] = &joined[..] else { panic!("{joined:?}") };
    assert!(
        matches!(first.drawn.curve, Curve2::Segment(..)) && matches!(last.drawn.curve, Curve2::Segment(..))
    );
    let Curve2::Arc { radius, sweep, .. } = arc.drawn.curve else { panic!("{arc:?}") };
    assert!((radius - 10.0).abs() < 1e-9 && (sweep - 0.5 * PI).abs() < 1e-9);
}

#[test]
fn a_short_arc_takes_the_centre_of_a_circle_around_which_it_runs() {
    let circle = Curve2::Arc { center: [5.0, 7.0], radius: 4.0, start: 0.0, sweep: TAU };
    // An arc of radius 10 around the same centre, known only through its rounded points.
    let at = |angle: f64| [5.0 + 10.0 * angle.cos(), 7.0 + 10.0 * angle.sin()];
    let rounded = |p: [f64; 2]| p.map(|c| (c / 4e-5).round() * 4e-5);
    let [a, b, c] = [0.3, 0.4, 0.5].map(|angle| rounded(at(angle)));
    let (center, radius) = smoothing::circle_through(a, b, c).unwrap();
    assert!((radius - 10.0).abs() > 2e-4, "{radius}");
    let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
    let short = Curve2::Arc { center, radius, start: angle(a), sweep: angle(c) - angle(a) };
    let elsewhere = Curve2::Arc { center: [5.0, 7.5], radius: 2.0, start: 0.0, sweep: 1.0 };
    let mut strokes = [short, circle, elsewhere.clone()].map(|c| stroke(c, 0));
    share_centres(&mut strokes, &EXACT);
    let Curve2::Arc { center, radius, .. } = strokes[0].drawn.curve else { panic!() };
    assert!(center == [5.0, 7.0] && (radius - 10.0).abs() < 1e-4, "{center:?} {radius}");
    assert_eq!(strokes[2].drawn.curve, elsewhere);
}

#[test]
fn rows_of_oblique_edges_with_corners_are_no_hatch() {
    // A saw: parallel flanks at one distance, each with corners.
    let mut saw = Vec::new();
    for k in 0..8 {
        let x = 3.0 * k as f64;
        saw.push(stroke(Curve2::Segment([x, 0.0], [x + 3.0, 3.0]), 0));
        saw.push(stroke(Curve2::Segment([x + 3.0, 3.0], [x + 3.0, 0.0]), 0));
    }
    let (left, count, boxes) = take_hatching(saw, &EXACT);
    assert_eq!((left.len(), count, boxes.len()), (16, 0, 0));
}
