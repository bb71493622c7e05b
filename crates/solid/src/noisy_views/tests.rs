use super::*;
use crate::views::solve;
use planish_contour::constraint::constrain;
use planish_contour::planar::ContourKind;
use planish_contour::sketch::EstimatedContour;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Width, depth and height of the prism.
const SIZE: [f64; 3] = [40.0, 70.0, 30.0];

/// Each run makes some dozens of tests, and none of them may reject a true relation.
const LEVEL: f64 = 1e-3;

fn noisy(kind: ContourKind, truth: &[f64], sigma: f64, random: &mut ChaCha8Rng) -> EstimatedContour {
    let n = truth.len();
    // Errors of neighbouring parameters are correlated, as those of a fit are.
    let root = DMatrix::from_fn(n, n, |i, j| sigma * [1.0, 0.4].get(i.abs_diff(j)).copied().unwrap_or(0.0));
    let draws = nalgebra::DVector::from_fn(n, |_, _| StandardNormal.sample(random));
    let off: nalgebra::DVector<f64> = &root * draws;
    EstimatedContour {
        kind,
        theta: truth.iter().zip(off.iter()).map(|(t, o)| t + o).collect(),
        covariance: &root * root.transpose(),
        observed_ends: None,
    }
}

fn view(kind: ViewKind, contours: &[EstimatedContour]) -> NoisyView {
    let sketch = Sketch::new(contours).unwrap();
    let options =
        ConstrainOptions { given: sketch.given.clone(), level: LEVEL, ..ConstrainOptions::default() };
    let found = constrain(&sketch.drawing, &sketch.covariance, &options).unwrap();
    let constraints = found.accepted().map(|proposal| proposal.constraint).collect();
    NoisyView { kind, sketch, constraints }
}

fn box_of(a: f64, b: f64) -> Vec<f64> {
    vec![0.0, 0.0, a, 0.0, a, b, 0.0, b]
}

fn prism(sigma: f64, seed: u64) -> Vec<NoisyView> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let [x, y, z] = SIZE;
    vec![
        view(
            ViewKind::Front,
            &[noisy(ContourKind::Polygon(3), &[0.0, 0.0, x, 0.0, 0.0, z], sigma, &mut random)],
        ),
        view(ViewKind::Top, &[noisy(ContourKind::Polygon(4), &box_of(x, y), sigma, &mut random)]),
        view(ViewKind::Side, &[noisy(ContourKind::Polygon(4), &box_of(y, z), sigma, &mut random)]),
    ]
}

#[test]
fn dimensions_of_a_noisy_prism_cover_the_truth() {
    let runs = 150;
    let (mut inside, mut sizes) = (0, 0);
    let (mut squares, mut lost) = (0.0, 0);
    for seed in 0..runs {
        let views = prism(0.1, seed);
        let options = MatchOptions { level: LEVEL, ..MatchOptions::default() };
        let found = match_views(&views, &options).unwrap();
        let solved = solve(&found.exact_views().unwrap()).map(|found| found.solutions);
        let Some(best) = solved.iter().flatten().next() else {
            lost += 1;
            continue;
        };
        assert_eq!(best.solid.faces_by_kind()[..2], [5, 0], "seed {seed}");
        let dimensions = found.dimensions(&best.solid);
        assert_eq!(dimensions.len(), 3 + 9);
        let hypotenuse = SIZE[0].hypot(SIZE[2]);
        for dimension in &dimensions {
            let candidates = [SIZE[0], SIZE[1], SIZE[2], hypotenuse];
            let truth = candidates
                .iter()
                .min_by(|a, b| (*a - dimension.value).abs().total_cmp(&(*b - dimension.value).abs()))
                .unwrap();
            let sigma = dimension.sigma.unwrap();
            assert!(sigma > 0.0 && sigma < 0.15);
            let off = (dimension.value - truth) / sigma;
            inside += u32::from(off.abs() < 1.96);
            sizes += 1;
        }
        let extents: Vec<f64> =
            dimensions[..3].iter().zip(SIZE).map(|(d, t)| (d.value - t) / d.sigma.unwrap()).collect();
        squares += extents.iter().map(|e| e * e).sum::<f64>();
        assert!(found.vertices(&best.solid).iter().all(|v| v.sigma.iter().all(Option::is_some)));
    }
    let coverage = f64::from(inside) / f64::from(sizes);
    let mean = squares / (3.0 * (runs - lost) as f64);
    assert!(lost <= 2, "{lost} runs lost a relation");
    println!("coverage {coverage:.3} of {sizes} sizes, mean square of extents over σ² {mean:.3}");
    // σ of a share of 450 independent extents is 0.01, of their mean square 0.067.
    assert!((0.91..0.985).contains(&coverage), "{coverage}");
    assert!((0.75..1.25).contains(&mean), "{mean}");
}

#[test]
fn views_share_their_information() {
    // A side view ten times worse than the others: its height is that of the front view.
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let [x, y, z] = SIZE;
    let good = view(ViewKind::Front, &[noisy(ContourKind::Polygon(4), &box_of(x, z), 0.02, &mut random)]);
    let noisy_side = view(ViewKind::Side, &[noisy(ContourKind::Polygon(4), &box_of(y, z), 0.2, &mut random)]);
    let found = match_views(&[good.clone(), noisy_side], &MatchOptions::default()).unwrap();
    let solid = solve(&found.exact_views().unwrap()).unwrap().solutions.remove(0).solid;
    let height = &found.dimensions(&solid)[2];
    assert_eq!(height.name, "z");
    let alone = good.sketch.covariance[(5, 5)].sqrt();
    assert!(height.sigma.unwrap() < 2.0 * alone && (height.value - z).abs() < 4.0 * alone);
    assert_eq!(found.matches.iter().filter(|m| m.outcome == "end").count(), 2);
    assert!(found.p_value > 0.001 && found.degrees == 2);
}

#[test]
fn a_cylinder_is_seen_as_a_circle_and_two_rectangles() {
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let views = [
        view(
            ViewKind::Front,
            &[noisy(
                ContourKind::Polygon(4),
                &[-20.0, 0.0, 20.0, 0.0, 20.0, 50.0, -20.0, 50.0],
                0.05,
                &mut random,
            )],
        ),
        view(ViewKind::Top, &[noisy(ContourKind::Circle, &[0.0, 0.0, 20.0], 0.05, &mut random)]),
    ];
    let found = match_views(&views, &MatchOptions::default()).unwrap();
    let solid = solve(&found.exact_views().unwrap()).unwrap().solutions.remove(0).solid;
    assert_eq!(solid.faces_by_kind()[..2], [2, 1]);
    let dimensions = found.dimensions(&solid);
    let diameter = dimensions.iter().find(|d| d.kind == DimensionKind::Diameter).unwrap();
    assert!((diameter.value - 40.0).abs() < 4.0 * diameter.sigma.unwrap());
    assert!(diameter.sigma.unwrap() < 0.1, "{diameter:?}");
}

#[test]
fn inconsistent_views_are_rejected_by_name() {
    let message = |views: &[NoisyView]| match_views(views, &MatchOptions::default()).unwrap_err().to_string();
    let views = prism(0.05, 1);
    assert!(message(&views[..1]).contains("expected two or three views"));
    assert!(message(&[views[0].clone(), views[0].clone()]).contains("two front views"));
    // The top view at a scale of 1.1.
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let large =
        view(ViewKind::Top, &[noisy(ContourKind::Polygon(4), &box_of(44.0, 77.0), 0.05, &mut random)]);
    let refused = message(&[views[0].clone(), large]);
    assert!(
        refused.contains("the front view ends at x = ")
            && refused.contains("the top view ends at x = 4")
            && refused.contains("χ²"),
        "{refused}"
    );
    let ellipse = noisy(ContourKind::Ellipse, &[0.0, 0.0, 20.0, 10.0, 0.0], 0.01, &mut random);
    let round =
        NoisyView { kind: ViewKind::Top, sketch: Sketch::new(&[ellipse]).unwrap(), constraints: Vec::new() };
    assert!(message(&[views[0].clone(), round]).contains("the top view: expected corners or circles"));
}
