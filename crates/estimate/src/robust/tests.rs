use super::*;
use crate::ErrorKind;
use crate::test_support::Gaussian;

fn losses() -> [Loss; 6] {
    [
        Loss::Gaussian,
        Loss::huber(),
        Loss::cauchy(),
        Loss::tukey(),
        Loss::StudentT { degrees: 3.0 },
        Loss::StudentT { degrees: 30.0 },
    ]
}

#[test]
fn influence_is_the_slope_of_the_loss_and_weight_its_quotient_for_every_loss() {
    let step = 1e-4;
    for loss in losses() {
        assert_eq!(loss.rho(0.0), 0.0);
        for i in -60..=60 {
            let r = 0.1003 * f64::from(i); // no kink on the grid
            let slope = (loss.rho(r + step) - loss.rho(r - step)) / (2.0 * step);
            assert!((loss.psi(r) - slope).abs() < 1e-6, "{loss:?} at {r}");
            let bend = (loss.psi(r + step) - loss.psi(r - step)) / (2.0 * step);
            assert!((loss.psi_slope(r) - bend).abs() < 1e-6, "{loss:?} at {r}");
            if r != 0.0 {
                assert!((loss.weight(r) - loss.psi(r) / r).abs() < 1e-12);
            }
            assert_eq!(loss.psi(-r), -loss.psi(r));
            assert_eq!(loss.rho(-r), loss.rho(r));
        }
    }
}

#[test]
fn losses_take_distances_and_not_their_squares() {
    // The Gaussian loss of a residual of 3 is 4.5. If 3 were interpreted as a square, it would be 1.5.
    assert_eq!(Loss::Gaussian.rho(3.0), 4.5);
    assert_eq!(Loss::Huber { threshold: 2.0 }.rho(3.0), 4.0);
    assert_eq!(Loss::Tukey { threshold: 3.0 }.rho(5.0), 1.5);
    assert!((Loss::Cauchy { scale: 1.0 }.rho(3.0) - 0.5 * 10.0_f64.ln()).abs() < 1e-15);
    assert!((Loss::StudentT { degrees: 1.0 }.rho(3.0) - 10.0_f64.ln()).abs() < 1e-15);
}

#[test]
fn tuning_constants_have_their_published_efficiency() {
    // Holland, Welsch 1977: 95 % at 1.345, 2.385, 4.685. The median has 2/π, the limit of a narrow Huber
    // loss.
    for loss in [Loss::huber(), Loss::cauchy(), Loss::tukey()] {
        assert!((loss.efficiency().unwrap() - 0.95).abs() < 5e-4, "{loss:?}");
    }
    let narrow = Loss::Huber { threshold: 1e-3 }.efficiency().unwrap();
    assert!((narrow - 2.0 / std::f64::consts::PI).abs() < 1e-3, "{narrow}");
    assert!((Loss::Gaussian.efficiency().unwrap() - 1.0).abs() < 1e-9);
    for equations in [1, 2, 3, 7] {
        let moments = Loss::Gaussian.moments(equations).unwrap();
        for moment in [moments.influence_squared, moments.slope, moments.weight] {
            assert!((moment - 1.0).abs() < 1e-9, "{equations}");
        }
    }
}

#[test]
fn losses_without_a_positive_constant_are_rejected() {
    for loss in
        [Loss::Huber { threshold: 0.0 }, Loss::Cauchy { scale: f64::NAN }, Loss::StudentT { degrees: -1.0 }]
    {
        assert_eq!(loss.moments(1).unwrap_err().kind(), ErrorKind::Input);
    }
    assert!(Loss::Gaussian.moments(0).is_err());
}

#[test]
fn sandwich_of_gaussian_residuals_is_the_inverse_efficiency() {
    let mut random = Gaussian::seeded(41);
    let residuals: Vec<f64> = (0..100_000).map(|_| random.number()).collect();
    for loss in losses() {
        let factor = sandwich_factor(&loss, &residuals).unwrap();
        assert!((factor * loss.efficiency().unwrap() - 1.0).abs() < 0.02, "{loss:?} {factor}");
    }
    assert_eq!(sandwich_factor(&Loss::huber(), &[]).unwrap_err().kind(), ErrorKind::Undetermined);
}

#[test]
fn gated_variance_is_unbiased_after_the_correction() {
    let sigma = 0.7;
    for (gate, seed) in [(1.0, 42), (2.0, 43), (2.5, 44), (3.0, 45)] {
        let mut random = Gaussian::seeded(seed);
        let truncated = TruncatedNormal::new(gate).unwrap();
        let kept: Vec<f64> =
            (0..400_000).map(|_| sigma * random.number()).filter(|r| r.abs() <= gate * sigma).collect();
        let sample = (kept.iter().map(|r| r * r).sum::<f64>() / kept.len() as f64).sqrt();
        assert!((truncated.corrected_sigma(sample) / sigma - 1.0).abs() < 0.005, "{gate}");
        assert!((kept.len() as f64 / 400_000.0 - truncated.share_kept()).abs() < 0.003);
    }
}

#[test]
fn truncation_has_the_correct_limits() {
    // A wide gate changes nothing. A narrow one gives a uniform distribution of variance k²/3. Series and
    // closed form agree where they meet.
    assert_eq!(TruncatedNormal::new(f64::INFINITY).unwrap().variance_ratio(), 1.0);
    let ratio = |gate| TruncatedNormal::new(gate).unwrap().variance_ratio();
    assert!((ratio(1e-3) / (1e-6 / 3.0) - 1.0).abs() < 1e-6);
    assert!((ratio(1.0001e-2) / ratio(0.9999e-2) - (1.0001_f64 / 0.9999).powi(2)).abs() < 1e-6);
    assert!(TruncatedNormal::new(0.0).is_err() && TruncatedNormal::new(f64::NAN).is_err());
}

#[test]
fn gated_scale_recovers_sigma_with_and_without_outliers() {
    let mut random = Gaussian::seeded(46);
    let clean: Vec<f64> = (0..100_000).map(|_| 0.3 * random.number()).collect();
    for gate in [2.0, 2.5, 3.0] {
        let found = gated_scale(&clean, gate).unwrap();
        assert_eq!(found.termination, Termination::Converged);
        assert!((found.sigma / 0.3 - 1.0).abs() < 0.015, "{gate} {found:?}");
    }
    let mut dirty = clean.clone();
    for (i, r) in dirty.iter_mut().enumerate().filter(|(i, _)| i % 20 == 0) {
        *r = 5.0 + (i % 7) as f64;
    }
    assert!((gated_scale(&dirty, 3.0).unwrap().sigma / 0.3 - 1.0).abs() < 0.015);
    assert!((median_magnitude_scale(&dirty).unwrap() / 0.3 - 1.0).abs() < 0.1);
    assert!(gated_scale(&clean, 0.5).is_err());
    assert_eq!(gated_scale(&[], 3.0).unwrap_err().kind(), ErrorKind::Undetermined);
    assert_eq!(gated_scale(&[1.0, f64::NAN], 3.0).unwrap_err().kind(), ErrorKind::Input);
    assert_eq!(gated_scale(&[0.0, 0.0, 0.0], 3.0).unwrap().sigma, 0.0);
}

#[test]
fn median_scale_of_small_samples_is_exact() {
    let unit = 1.482_602_218_505_602;
    assert_eq!(median_absolute_deviation(&[1.0, 2.0, 4.0]).unwrap(), unit);
    assert_eq!(median_absolute_deviation(&[1.0, 2.0, 4.0, 9.0]).unwrap(), 1.5 * unit);
    assert_eq!(median_magnitude_scale(&[-3.0]).unwrap(), 3.0 * unit);
}

#[test]
fn student_t_scale_and_degrees_are_recovered() {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StudentT};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(47);
    let law = StudentT::new(4.0).unwrap();
    let residuals: Vec<f64> = (0..40_000).map(|_| 0.2 * law.sample(&mut random)).collect();
    let fit = StudentTScale::fit(&residuals, None).unwrap();
    assert_eq!(fit.termination, Termination::Converged);
    assert!((fit.sigma / 0.2 - 1.0).abs() < 0.02 && (fit.degrees - 4.0).abs() < 0.3, "{fit:?}");
    let given = StudentTScale::fit(&residuals, Some(4.0)).unwrap();
    assert!((given.sigma / 0.2 - 1.0).abs() < 0.015 && given.degrees == 4.0);
    assert!((given.weight(0.0) - 1.25).abs() < 1e-12);
    // Gaussian data have no heavy tails.
    let mut gaussian = Gaussian::seeded(48);
    let plain: Vec<f64> = (0..20_000).map(|_| gaussian.number()).collect();
    let fit = StudentTScale::fit(&plain, None).unwrap();
    assert!(fit.degrees > 30.0 && (fit.sigma - 1.0).abs() < 0.04, "{fit:?}");
    assert_eq!(StudentTScale::fit(&[0.0, 0.0, 1.0], None).unwrap_err().kind(), ErrorKind::Undetermined);
}

#[test]
fn an_even_background_is_subtracted_from_the_scale() {
    use rand::{RngExt, SeedableRng};
    for (seed, share) in (0..12).zip([0.0, 0.05, 0.15, 0.3].into_iter().cycle()) {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut gaussian = Gaussian::seeded(seed);
        let residuals: Vec<f64> = (0..3000)
            .map(|k| match f64::from(k) < 3000.0 * share {
                true => random.random_range(-20.0..20.0),
                false => gaussian.number(),
            })
            .collect();
        let plain = gated_scale(&residuals, 4.0).unwrap().sigma;
        let found = gated_scale_over_background(&residuals, 4.0).unwrap().sigma;
        assert!((found - 1.0).abs() < 0.06, "{share}: {found}");
        assert!(share < 0.3 || plain > 1.3, "{share}: {plain}");
    }
    let even: Vec<f64> = (0..1000).map(|k| 0.01 * f64::from(k) - 5.0).collect();
    let (plain, found) = (gated_scale(&even, 4.0).unwrap(), gated_scale_over_background(&even, 4.0).unwrap());
    assert!(found.sigma <= plain.sigma && found.sigma > 0.5 * plain.sigma, "{found:?} {plain:?}");
}
