//! Constraints and dimensions as text.

use super::*;

#[test]
fn every_constraint_is_parsed_from_its_text() {
    let drawing = general();
    for constraint in every_constraint() {
        let text = constraint.describe(&drawing);
        if matches!(constraint, Constraint::Aligned { .. }) {
            // Only the joint drawing of several views has these; users cannot write them.
            continue;
        }
        let read = Constraint::parse(&text, &drawing).unwrap();
        match (constraint, read) {
            // The side is that of the drawing.
            (Constraint::Tangent { bar, circle, .. }, Constraint::Tangent { bar: b, circle: c, .. }) => {
                assert_eq!((bar, circle), (b, c));
            }
            (Constraint::TangentCircles { a, b, .. }, Constraint::TangentCircles { a: c, b: d, .. }) => {
                assert_eq!((a, b), (c, d));
            }
            (Constraint::Angle { radians, .. }, Constraint::Angle { radians: read, .. }) => {
                assert!((radians - read).abs() < 1e-8);
            }
            (constraint, read) => assert_eq!(constraint, read, "{text}"),
        }
    }
    for (wrong, expected) in [
        ("P1P9 horizontal", "no point `P9`"),
        ("P1P6 horizontal", "no bar `P1P6`"),
        ("P1P2 is wide long", "expected a number, found `wide`"),
        ("circle 7 has radius 2", "no circle `circle 7`"),
        ("x9 = 2", "no coordinate `x9`"),
        ("P1P2 beside P3P4", "expected a sentence such as"),
    ] {
        let message = Constraint::parse(wrong, &drawing).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains(wrong), "{message}");
    }
}

#[test]
fn dimension_schemes_are_complete_and_without_redundancy() {
    // Without relations, with the right angles of a rectangle, and with an anchor or half of one.
    let mut plate = rectangle(40.0, 30.0, 0.2);
    let centre = plate.point([12.0, 9.0]);
    plate.circle(centre, 5.0).unwrap();
    let covariance = DMatrix::identity(plate.parameters(), plate.parameters()) * 0.01;
    let right_angles: Vec<Constraint> =
        (0..3).map(|i| Constraint::Perpendicular { a: BarId(i), b: BarId(i + 1) }).collect();
    let anchor = Constraint::Anchor { point: PointId(0), at: plate.position(PointId(0)) };
    let half =
        Constraint::Coordinate { point: PointId(0), axis: Axis::X, value: plate.position(PointId(0))[0] };
    let mut anchored = right_angles.clone();
    anchored.push(anchor);
    let mut halved = right_angles.clone();
    halved.push(half);
    for known in [vec![], right_angles, anchored, halved] {
        let scheme = dimension_scheme(&plate, &covariance, &known);
        let mut all = known.clone();
        all.extend(scheme.iter().map(|dimension| dimension.constraint));
        let diagnosis = diagnose(&plate, &all).unwrap();
        assert_eq!((diagnosis.freedoms, diagnosis.equations), (0, 11), "{scheme:?}");
        assert!(scheme.iter().all(|dimension| dimension.sigma > 0.0));
        // The radius is one parameter, unrelated to others: it keeps its σ.
        if let Some(length) = scheme.iter().find(|d| matches!(d.constraint, Constraint::Radius { .. })) {
            assert!((length.sigma - 0.1).abs() < 1e-12);
        }
    }
}
