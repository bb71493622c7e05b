use super::*;
use crate::ErrorKind;
use crate::test_support::{Gaussian, dmatrix};
use crate::{Belief, Linear, MeasurementEquation};

#[test]
fn bands_are_the_published_quantiles() {
    // χ² tables: 0.025 and 0.975 points.
    for (degrees, lower, upper) in
        [(1.0, 0.000_982, 5.0239), (10.0, 3.2470, 20.4832), (100.0, 74.2219, 129.5612)]
    {
        let band = ChiSquareBand::of_sum(degrees, 0.95).unwrap();
        assert!(
            (band.lower / lower - 1.0).abs() < 1e-3 && (band.upper / upper - 1.0).abs() < 1e-4,
            "{band:?}"
        );
    }
    // Many degrees of freedom: 1 ± 1.96 √(2/f).
    let band = ChiSquareBand::reduced(1e6, 0.95).unwrap();
    assert!((band.upper - 1.0 - 1.96 * 2e-6_f64.sqrt()).abs() < 1e-5, "{band:?}");
    assert!(ChiSquareBand::of_sum(0.0, 0.95).is_err() && ChiSquareBand::of_sum(3.0, 1.0).is_err());
    assert!(ChiSquareBand::of_mean(0, 3.0, 0.95).is_err());
}

#[test]
fn nees_of_simulated_linear_problems_lies_in_its_band_and_detects_overconfidence() {
    let mut random = Gaussian::seeded(61);
    let n = 4;
    let (mut calibrated, mut overconfident) =
        (ChiSquareMean::new(4.0).unwrap(), ChiSquareMean::new(4.0).unwrap());
    for _ in 0..300 {
        let prior = random.covariance(n);
        let truth = random.draw(&prior);
        let mut belief = Belief::from_covariance(DVector::zeros(n), prior).unwrap();
        for _ in 0..6 {
            let (design, noise) = (random.matrix(2, n), random.covariance(2));
            let reading = &design * &truth + random.draw(&noise);
            let at = Linear::new(design, reading)
                .unwrap()
                .linearized(&DVector::zeros(n), &DVector::zeros(2))
                .unwrap();
            belief.update(&at, &noise).unwrap();
        }
        let (deviation, covariance) = (belief.mean().unwrap() - truth, belief.covariance().unwrap());
        calibrated.add(normalized_squared(&deviation, &covariance).unwrap()).unwrap();
        overconfident.add(normalized_squared(&deviation, &(covariance * 0.8)).unwrap()).unwrap();
    }
    assert!(calibrated.is_consistent(0.99).unwrap(), "{} {:?}", calibrated.mean(), calibrated.band(0.99));
    assert!(!overconfident.is_consistent(0.99).unwrap());
    assert!((calibrated.reduced() - 1.0).abs() < 0.15);
}

#[test]
fn a_singular_covariance_is_undetermined_and_an_indefinite_one_is_an_input_error() {
    let deviation = DVector::from_element(2, 1.0);
    let singular = normalized_squared(&deviation, &dmatrix![1.0, 1.0; 1.0, 1.0]);
    assert_eq!(singular.unwrap_err().kind(), ErrorKind::Undetermined);
    let indefinite = normalized_squared(&deviation, &dmatrix![1.0, 2.0; 2.0, 1.0]);
    assert_eq!(indefinite.unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn coverage_of_correct_sigmas_lies_in_its_band_and_of_wrong_ones_does_not() {
    let mut random = Gaussian::seeded(62);
    let mut right = Coverage::of_interval(0.95).unwrap();
    let mut understated = Coverage::of_interval(0.95).unwrap();
    for _ in 0..20_000 {
        let sigma = 0.1 + random.number().abs();
        let deviation = sigma * random.number();
        right.add(deviation, sigma).unwrap();
        understated.add(deviation, 0.9 * sigma).unwrap();
    }
    let (lower, upper) = right.band(0.99).unwrap();
    assert!(lower < 0.95 && 0.95 < upper && upper - lower < 0.009);
    assert!((lower..=upper).contains(&right.share()), "{} {lower} {upper}", right.share());
    assert!(understated.share() < lower);
}

#[test]
fn binomial_band_is_the_published_one() {
    // Binomial(20, 0.5): the 2.5 % and 97.5 % points are 6 and 14.
    let mut coverage = Coverage::of_interval(0.5).unwrap();
    for _ in 0..20 {
        coverage.add(0.0, 1.0).unwrap();
    }
    assert_eq!(coverage.band(0.95).unwrap(), (0.3, 0.7));
    // Ten cases of equal weight count as ten; additional cases of small weight hardly count (Kish 1965).
    let mut weighted = Coverage::of_interval(0.5).unwrap();
    for _ in 0..10 {
        weighted.add_weighted(0.0, 1.0, 2.0).unwrap();
        weighted.add_weighted(0.0, 1.0, 1e-6).unwrap();
    }
    assert_eq!(weighted.band(0.95).unwrap(), (0.2, 0.8));
}

#[test]
fn coverage_is_weighted_by_area_and_adds_up() {
    let mut coverage = Coverage::of_interval(0.95).unwrap();
    coverage.add_weighted(0.0, 1.0, 3.0).unwrap();
    let mut other = Coverage::of_interval(0.95).unwrap();
    other.add_weighted(5.0, 1.0, 1.0).unwrap();
    coverage.merge(&other).unwrap();
    assert_eq!((coverage.share(), coverage.count()), (0.75, 2));
    assert!(coverage.merge(&Coverage::of_interval(0.9).unwrap()).is_err());
    assert!(coverage.add(f64::NAN, 1.0).is_err() && coverage.add(0.0, -1.0).is_err());
    assert_eq!(Coverage::of_interval(0.95).unwrap().band(0.95).unwrap_err().kind(), ErrorKind::Undetermined);
}

#[test]
fn whiteness_passes_white_sequences_and_fails_drifting_ones() {
    let mut random = Gaussian::seeded(63);
    let mut rejected = 0;
    for _ in 0..400 {
        let white: Vec<f64> = (0..200).map(|_| random.number()).collect();
        rejected += u32::from(whiteness(&white, 8).unwrap().p_value < 0.05);
    }
    assert!((8..=34).contains(&rejected), "{rejected}");
    let mut state = 0.0;
    let coloured: Vec<f64> = (0..200)
        .map(|_| {
            state = 0.5 * state + random.number();
            state
        })
        .collect();
    assert!(whiteness(&coloured, 8).unwrap().p_value < 1e-4);
    assert!(whiteness(&[1.0, 2.0], 2).is_err());
    assert_eq!(whiteness(&[1.0; 10], 2).unwrap_err().kind(), ErrorKind::Undetermined);
}
