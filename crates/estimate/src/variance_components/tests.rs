use super::*;
use crate::test_support::Gaussian;
use crate::{ErrorKind, Information};
use nalgebra::{DMatrix, DVector};

/// Readings of a few unknowns by two sensors with stated σ = 1.
struct TwoSensors {
    design: DMatrix<f64>,
    reading: DVector<f64>,
    group: Vec<usize>,
}

fn two_sensors(random: &mut Gaussian, counts: [usize; 2], truth: [f64; 2]) -> TwoSensors {
    let n = counts[0] + counts[1];
    let group: Vec<usize> = (0..n).map(|i| usize::from(i >= counts[0])).collect();
    let (design, state) = (random.matrix(n, 6), random.vector(6));
    let reading = DVector::from_fn(n, |i, _| (design.row(i) * &state)[0] + truth[group[i]] * random.number());
    TwoSensors { design, reading, group }
}

impl TwoSensors {
    fn solve(&self, factors: &[f64]) -> Result<VarianceComponents> {
        let weight = DMatrix::from_diagonal(&DVector::from_fn(self.group.len(), |i, _| {
            factors[self.group[i]].powi(-2)
        }));
        let information = Information::from_rows(&self.design, &weight, &self.reading)?;
        let (state, covariance) = (information.mean()?, information.covariance()?);
        let mut sums = VarianceComponents::new(2);
        for (i, &group) in self.group.iter().enumerate() {
            let row = self.design.row(i);
            let residual = (self.reading[i] - (row * &state)[0]) / factors[group];
            let leverage = (row * &covariance * row.transpose())[0] * weight[(i, i)];
            sums.add(group, residual * residual, leverage)?;
        }
        Ok(sums)
    }
}

#[test]
fn an_understated_sigma_is_recovered_and_a_correct_one_is_kept() {
    let mut random = Gaussian::seeded(51);
    let sensors = two_sensors(&mut random, [900, 900], [3.0, 1.0]);
    let found = iterate_variance_components(2, 1e-6, 50, |factors| sensors.solve(factors)).unwrap();
    assert_eq!(found.termination, Termination::Converged);
    let [first, second] = [found.components[0].unwrap(), found.components[1].unwrap()];
    assert!((first.sigma_factor / 3.0 - 1.0).abs() < 0.05, "{first:?}");
    assert!((second.sigma_factor - 1.0).abs() < 0.05, "{second:?}");
    assert!(first.contradicts_stated(0.999).unwrap() && !second.contradicts_stated(0.999).unwrap());
}

#[test]
fn leverages_keep_small_groups_unbiased_and_the_standard_error_correct() {
    // Twelve readings and six unknowns: without the leverages the factor would be √½.
    let mut random = Gaussian::seeded(52);
    let (runs, mut squares, mut contradicted) = (2000, 0.0, 0);
    let mut factors = Vec::new();
    for _ in 0..runs {
        let sensors = two_sensors(&mut random, [12, 0], [1.0, 1.0]);
        let component = sensors.solve(&[1.0, 1.0]).unwrap().component(0).unwrap();
        assert!((component.redundancy - 6.0).abs() < 1e-9);
        squares += component.sigma_factor.powi(2) / f64::from(runs);
        factors.push(component.sigma_factor);
        contradicted += u32::from(component.contradicts_stated(0.95).unwrap());
    }
    assert!((squares - 1.0).abs() < 0.04, "{squares}");
    assert!((f64::from(contradicted) / f64::from(runs) - 0.05).abs() < 0.015, "{contradicted}");
    let mean = factors.iter().sum::<f64>() / f64::from(runs);
    let spread = (factors.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / f64::from(runs)).sqrt();
    assert!((spread * 12.0_f64.sqrt() - 1.0).abs() < 0.1, "{spread}");
}

#[test]
fn gated_readings_give_the_sigma_of_all_readings() {
    let mut random = Gaussian::seeded(53);
    let gate = TruncatedNormal::new(2.0).unwrap();
    let (mut gated, mut naive) = (VarianceComponents::new(1), VarianceComponents::new(1));
    for r in (0..50_000).map(|_| random.number()).filter(|r| r.abs() < 2.0) {
        gated.add_gated(0, r * r, 0.0, &gate).unwrap();
        naive.add(0, r * r, 0.0).unwrap();
    }
    assert!((gated.component(0).unwrap().sigma_factor - 1.0).abs() < 0.01);
    assert!(naive.component(0).unwrap().sigma_factor < 0.9);
}

#[test]
fn merged_sums_equal_the_sums_of_all_readings() {
    let mut random = Gaussian::seeded(54);
    let values: Vec<f64> = (0..100).map(|_| random.number().powi(2)).collect();
    let (mut all, mut a, mut b) =
        (VarianceComponents::new(1), VarianceComponents::new(1), VarianceComponents::new(1));
    for (i, &square) in values.iter().enumerate() {
        all.add(0, square, 0.1).unwrap();
        if i < 50 { &mut a } else { &mut b }.add(0, square, 0.1).unwrap();
    }
    a.merge(&b).unwrap();
    assert!((a.component(0).unwrap().sigma_factor - all.component(0).unwrap().sigma_factor).abs() < 1e-14);
    assert!(a.merge(&VarianceComponents::new(2)).is_err());
}

#[test]
fn groups_without_redundancy_are_undetermined_and_keep_their_sigma() {
    let mut sums = VarianceComponents::new(2);
    sums.add(0, 0.0, 1.0).unwrap();
    assert_eq!(sums.component(0).unwrap_err().kind(), ErrorKind::Undetermined);
    assert_eq!(sums.component(2).unwrap_err().kind(), ErrorKind::Input);
    assert!(
        sums.add(0, -1.0, 0.0).is_err()
            && sums.add(0, f64::NAN, 0.0).is_err()
            && sums.add(2, 1.0, 0.0).is_err()
    );
    let found = iterate_variance_components(2, 1e-6, 5, |factors| {
        assert_eq!(factors, [1.0, 1.0]);
        Ok(sums.clone())
    });
    assert_eq!(found.unwrap().components, [None, None]);
}
