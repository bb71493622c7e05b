use super::*;
use crate::constraint::{BarId, ConstrainOptions, ProposalOutcome, constrain, diagnose, impose};

/// A contour of every kind except the line, with a covariance of full rank.
fn every_kind() -> Vec<EstimatedContour> {
    let chain = ContourKind::Chain { arcs: vec![false, true, false, true], closed: true };
    let kinds = [
        (ContourKind::Circle, vec![3.0, -2.0, 7.0]),
        (ContourKind::Ellipse, vec![3.0, -2.0, 9.0, 5.0, 0.4]),
        (ContourKind::Rectangle, vec![3.0, -2.0, 9.0, 5.0, 0.4]),
        (ContourKind::RoundedRectangle, vec![3.0, -2.0, 9.0, 5.0, 0.4, 1.2]),
        (ContourKind::Slot, vec![3.0, -2.0, 9.0, 4.0, 0.4]),
        (ContourKind::RegularPolygon(3), vec![3.0, -2.0, 9.0, 0.4]),
        (ContourKind::RegularPolygon(6), vec![3.0, -2.0, 9.0, 0.4]),
        (ContourKind::Polygon(3), vec![0.0, 0.0, 9.0, 1.0, 2.0, 6.0]),
        // One arc of more than half a circle, and one that curves inwards.
        (chain, vec![0.0, 0.0, 9.0, 0.0, 9.0, 6.0, 0.0, 6.0, 1.3, -0.2]),
    ];
    kinds.map(|(kind, theta)| with_covariance(kind, theta)).to_vec()
}

fn with_covariance(kind: ContourKind, theta: Vec<f64>) -> EstimatedContour {
    let n = theta.len();
    let root = DMatrix::from_fn(n, n, |i, j| {
        0.01 * (if i == j { 2.0 } else { 0.3 * ((3 * i + 5 * j) as f64).sin() })
    });
    EstimatedContour { kind, theta, covariance: &root * root.transpose(), observed_ends: None }
}

#[test]
fn contours_of_every_kind_survive_the_round_trip_with_their_covariance() {
    for contour in every_kind() {
        let sketch = Sketch::new(std::slice::from_ref(&contour)).unwrap();
        let held = impose(&sketch.drawing, &sketch.covariance, &sketch.given, 0.0).unwrap();
        assert!(held.chi_square < 1e-12, "{}: {}", contour.kind, held.chi_square);
        assert_eq!(sketch.drawing.parameters() - held.degrees, contour.kind.parameters(), "{}", contour.kind);
        let (theta, covariance) = sketch.contour(0, &held.drawing, &held.covariance).unwrap();
        for (a, b) in theta.iter().zip(&contour.theta) {
            assert!((a - b).abs() < 1e-9, "{}: {theta:?}", contour.kind);
        }
        let off = (&covariance - &contour.covariance).amax() / contour.covariance.amax();
        assert!(off < 1e-5, "{}: covariance off by {off:.1e}", contour.kind);
        let free = diagnose(&sketch.drawing, &sketch.given).unwrap();
        assert_eq!((free.redundant.len(), free.conflicting.len()), (0, 0), "{}", contour.kind);
    }
}

#[test]
fn lines_need_their_ends_and_keep_them() {
    let mut line = with_covariance(ContourKind::Line, vec![0.3, 2.0]);
    let refused = Sketch::new(std::slice::from_ref(&line)).unwrap_err().to_string();
    assert!(refused.contains("contour 1 (line)") && refused.contains("ends"), "{refused}");
    line.observed_ends = Some([[0.0, 2.1], [10.0, 5.2]]);
    let sketch = Sketch::new(std::slice::from_ref(&line)).unwrap();
    let (theta, covariance) = sketch.contour(0, &sketch.drawing, &sketch.covariance).unwrap();
    assert!((theta[0] - 0.3).abs() < 1e-12 && (theta[1] - 2.0).abs() < 1e-12);
    assert!((&covariance - &line.covariance).amax() < 1e-5 * line.covariance.amax());
}

#[test]
fn errors_name_the_invalid_contour() {
    let good = with_covariance(ContourKind::Circle, vec![0.0, 0.0, 1.0]);
    let flat = with_covariance(ContourKind::Rectangle, vec![0.0, 0.0, 1.0, -1.0, 0.0]);
    let message = |contours: &[EstimatedContour]| Sketch::new(contours).unwrap_err().to_string();
    assert!(message(&[good.clone(), flat]).contains("contour 2 (rectangle)"));
    let mut short = good.clone();
    short.theta.pop();
    assert!(message(&[short]).contains("expected 3 parameters"));
    let mut infinite = good;
    infinite.covariance[(1, 1)] = f64::NAN;
    assert!(message(&[infinite]).contains("not finite"));
}

#[test]
fn an_upright_rectangle_with_a_hole_is_found_by_one_relation() {
    let plate = EstimatedContour {
        covariance: DMatrix::from_diagonal(&DVector::from_vec(vec![4e-4, 4e-4, 4e-4, 4e-4, 1e-6])),
        ..with_covariance(ContourKind::Rectangle, vec![0.01, -0.02, 40.0, 30.01, 0.0009])
    };
    let hole = EstimatedContour {
        covariance: DMatrix::identity(3, 3) * 1e-4,
        ..with_covariance(ContourKind::Circle, vec![0.3, 0.1, 6.0])
    };
    let sketch = Sketch::new(&[plate, hole]).unwrap();
    let options = ConstrainOptions { given: sketch.given.clone(), ..ConstrainOptions::default() };
    let found = constrain(&sketch.drawing, &sketch.covariance, &options).unwrap();
    let upright = found
        .proposals
        .iter()
        .filter(|p| p.outcome == ProposalOutcome::Imposed)
        .map(|p| p.text.as_str())
        .collect::<Vec<_>>();
    assert_eq!(upright.len(), 1, "{upright:?}");
    assert!(upright[0].ends_with("horizontal") || upright[0].ends_with("vertical"), "{upright:?}");
    // χ² of the angle alone, 0.9², for whichever bar is tested.
    let chi_square = found.accepted().next().unwrap().chi_square;
    assert!((chi_square - 0.81).abs() < 1e-3, "{chi_square}");
    assert_eq!(found.freedoms, 4 + 3);
    assert!((found.drawing.length(BarId(0)) - 40.0).abs() < 1e-3);
}
