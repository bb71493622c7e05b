use super::*;
use crate::test_support::{Gaussian, dmatrix, dvector, relative_difference, scalar};
use crate::{ErrorKind, Linear, MeasurementEquation};

type Session = Vec<(Linearization, DMatrix<f64>)>;

fn sessions(seed: u64, n: usize, count: usize) -> (Belief, Vec<Session>) {
    let mut random = Gaussian::seeded(seed);
    let prior = Belief::from_covariance(random.vector(n), random.covariance(n)).unwrap();
    let readings = (0..count)
        .map(|_| {
            (0..4)
                .map(|_| {
                    let equation = Linear::new(random.matrix(2, n), random.vector(2)).unwrap();
                    let at = equation.linearized(&random.vector(n), &random.vector(2)).unwrap();
                    (at, random.covariance(2))
                })
                .collect()
        })
        .collect();
    (prior, readings)
}

fn updated(start: &Belief, session: &[(Linearization, DMatrix<f64>)]) -> Belief {
    let mut belief = start.clone();
    for (at, covariance) in session {
        belief.update(at, covariance).unwrap();
    }
    belief
}

fn assert_same(a: &Belief, b: &Belief, tolerance: f64) {
    let (a, b) = (a.information(), b.information());
    assert!(relative_difference(&a.matrix, &b.matrix) < tolerance);
    assert!((&a.vector - &b.vector).amax() <= tolerance * a.vector.amax());
}

#[test]
fn merge_is_commutative_associative_equals_the_batch_and_counts_the_prior_once() {
    let (prior, readings) = sessions(1, 5, 3);
    let parts: Vec<Belief> = readings.iter().map(|session| updated(&prior, session)).collect();
    let [a, b, c] = [&parts[0], &parts[1], &parts[2]];
    assert_same(&a.merge(b).unwrap(), &b.merge(a).unwrap(), 1e-15);
    let left = a.merge(b).unwrap().merge(c).unwrap();
    assert_same(&left, &a.merge(&b.merge(c).unwrap()).unwrap(), 1e-14);
    assert_same(&left, &updated(&prior, &readings.concat()), 1e-13);
    // Merging a belief without data changes nothing.
    assert_same(&a.merge(&prior).unwrap(), a, 1e-15);
    assert!(
        relative_difference(
            &prior.merge(&prior).unwrap().covariance().unwrap(),
            &prior.covariance().unwrap()
        ) < 1e-15
    );
}

#[test]
fn beliefs_with_different_priors_are_rejected() {
    let a = Belief::from_covariance(dvector![0.0], scalar(1.0)).unwrap();
    let b = Belief::from_covariance(dvector![0.0], scalar(1.1)).unwrap();
    assert_eq!(a.merge(&b).unwrap_err().kind(), ErrorKind::Input);
    let c = Belief::from_covariance(dvector![0.0, 0.0], DMatrix::identity(2, 2)).unwrap();
    assert_eq!(a.merge(&c).unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn linearising_a_linear_equation_elsewhere_gives_the_same_information() {
    let mut random = Gaussian::seeded(2);
    let (design, reading, covariance) = (random.matrix(3, 4), random.vector(3), random.covariance(3));
    let weight = covariance.clone().try_inverse().unwrap();
    let expected = Information::from_rows(&design, &symmetric_part(&weight), &reading).unwrap();
    let equation = Linear::new(design, reading).unwrap();
    for _ in 0..3 {
        let at = equation.linearized(&random.vector(4), &random.vector(3)).unwrap();
        let found = at.information(&covariance).unwrap();
        assert!(relative_difference(&found.matrix, &expected.matrix) < 1e-13);
        assert!((&found.vector - &expected.vector).amax() < 1e-13 * expected.vector.amax());
    }
}

#[test]
fn a_null_direction_is_reported_with_its_largest_component() {
    // Only x0 + x1 is read: the null direction is (1, −1, 0), and in units a thousand times finer x1 is its
    // largest component.
    let data = Information::from_rows(
        &dmatrix![1.0, 1e-3, 0.0; 0.0, 0.0, 1.0],
        &DMatrix::identity(2, 2),
        &dvector![1.0, 2.0],
    );
    let belief = Belief::from_information(Information::zero(3), data.unwrap()).unwrap();
    let error = belief.mean().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Undetermined);
    assert!(error.to_string().contains("component 1"), "{error}");
    assert!(error.to_string().contains("1 of 3 directions"), "{error}");

    let never_read = Belief::from_information(Information::zero(2), Information::zero(2)).unwrap();
    assert!(never_read.covariance().unwrap_err().to_string().contains("2 of 2 directions"));
}

#[test]
fn rank_does_not_depend_on_units() {
    let covariance = dmatrix![1e-14, 0.0; 0.0, 1e14];
    let belief = Belief::from_covariance(dvector![1e-7, 1e7], covariance.clone()).unwrap();
    assert!(
        (belief.covariance().unwrap() - &covariance).component_div(&covariance.map(|c| c.max(1.0))).amax()
            < 1e-12
    );
    assert!((belief.mean().unwrap()[0] - 1e-7).abs() < 1e-19);
}

#[test]
fn invalid_covariances_are_rejected() {
    for covariance in [
        dmatrix![1.0, 2.0; 2.0, 1.0],
        dmatrix![1.0, 0.5; 0.1, 1.0],
        dmatrix![1.0, 0.0; 0.0, f64::NAN],
        dmatrix![1.0, 0.0; 0.0, -1.0],
        dmatrix![1.0, 1.0; 1.0, 1.0],
    ] {
        let refused = Belief::from_covariance(dvector![0.0, 0.0], covariance.clone());
        assert_eq!(refused.unwrap_err().kind(), ErrorKind::Input, "{covariance}");
    }
}

#[test]
fn a_marginal_has_the_rows_of_the_covariance_and_keeps_the_prior_apart() {
    let (prior, readings) = sessions(3, 5, 1);
    let belief = updated(&prior, &readings[0]);
    let kept = [3, 0];
    let marginal = belief.marginal(&kept).unwrap();
    let (covariance, mean) = (belief.covariance().unwrap(), belief.mean().unwrap());
    let expected = DMatrix::from_fn(2, 2, |i, j| covariance[(kept[i], kept[j])]);
    assert!(relative_difference(&marginal.covariance().unwrap(), &expected) < 1e-12);
    assert!((marginal.mean().unwrap() - dvector![mean[3], mean[0]]).amax() < 1e-12);
    let of_prior = prior.marginal(&kept).unwrap();
    assert!(marginal.has_same_prior(&of_prior));
    assert!(
        smallest_scaled_eigenvalue(&marginal.data().matrix, &marginal.information().matrix).unwrap() > -1e-12
    );
}

#[test]
fn a_marginal_over_unmeasured_unknowns_does_not_change_the_others() {
    // x1 is never measured, so its information is zero. Dropping it must not affect x0.
    let data = Information::from_rows(&dmatrix![2.0, 0.0], &scalar(1.0), &dvector![6.0]).unwrap();
    let belief = Belief::from_information(Information::zero(2), data).unwrap();
    let marginal = belief.marginal(&[0]).unwrap();
    assert_eq!(marginal.mean().unwrap()[0], 3.0);
    assert_eq!(marginal.covariance().unwrap()[(0, 0)], 0.25);
    assert!(belief.marginal(&[0, 0]).is_err() && belief.marginal(&[2]).is_err());
}

#[test]
fn conditioning_is_the_limit_of_an_exact_reading() {
    let (prior, readings) = sessions(4, 4, 1);
    let mut belief = updated(&prior, &readings[0]);
    let conditioned = belief.condition(&[2, 0], &dvector![0.7, -0.2]).unwrap();
    let exact = Linear::new(dmatrix![0.0, 0.0, 1.0, 0.0; 1.0, 0.0, 0.0, 0.0], dvector![0.7, -0.2]).unwrap();
    let at = exact.linearized(&DVector::zeros(4), &DVector::zeros(2)).unwrap();
    belief.update(&at, &(DMatrix::identity(2, 2) * 1e-10)).unwrap();
    let limit = belief.marginal(&[1, 3]).unwrap();
    assert!(relative_difference(&conditioned.covariance().unwrap(), &limit.covariance().unwrap()) < 1e-6);
    assert!((conditioned.mean().unwrap() - limit.mean().unwrap()).amax() < 1e-6);
}

#[test]
fn children_of_one_parent_count_the_parents_data_once() {
    let (prior, readings) = sessions(5, 4, 3);
    let parent = updated(&prior, &readings[0]);
    let (first, second) = (updated(&parent, &readings[1]), updated(&parent, &readings[2]));
    let fused = first.merge(&second.subtract_common(parent.data()).unwrap()).unwrap();
    assert_same(&fused, &updated(&prior, &readings.concat()), 1e-12);
    assert_eq!(prior.subtract_common(parent.data()).unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn covariance_intersection_is_never_overconfident() {
    // Two beliefs share a fraction of their data. The merged covariance must bound the true mean square.
    let (a, b) = (dmatrix![1.0, 0.2; 0.2, 4.0], dmatrix![3.0, -0.4; -0.4, 0.8]);
    let beliefs =
        [&a, &b].map(|covariance| Belief::from_covariance(dvector![0.0, 0.0], covariance.clone()).unwrap());
    let (fused, weight) = beliefs[0].covariance_intersection(&beliefs[1]).unwrap();
    let stated = fused.covariance().unwrap();
    let (ia, ib) =
        (a.clone().try_inverse().unwrap() * weight, b.clone().try_inverse().unwrap() * (1.0 - weight));
    let (ga, gb) = (&stated * ia, &stated * ib);
    let (la, lb) = (a.clone().cholesky().unwrap().l(), b.clone().cholesky().unwrap().l());
    for angle in 0..12 {
        let turn = nalgebra::Rotation2::new(f64::from(angle) * 0.5).into_inner();
        let shared = &la * DMatrix::from_fn(2, 2, |i, j| turn[(i, j)]) * lb.transpose();
        let half = &ga * shared * gb.transpose();
        let actual = &ga * &a * ga.transpose() + &gb * &b * gb.transpose() + &half + half.transpose();
        assert!((&stated - actual).symmetric_eigenvalues().min() > -1e-9);
    }
    // The weight is optimal, and merging a belief with itself adds no information.
    let det = |w: f64| {
        (a.clone().try_inverse().unwrap() * w + b.clone().try_inverse().unwrap() * (1.0 - w)).determinant()
    };
    assert!(det(weight) >= det(weight + 1e-3) && det(weight) >= det(weight - 1e-3));
    let (same, _) = beliefs[0].covariance_intersection(&beliefs[0]).unwrap();
    assert_same(&same, &beliefs[0], 1e-14);
}

#[test]
fn covariance_intersection_combines_partial_beliefs() {
    let row = |design| Information::from_rows(&design, &scalar(1.0), &dvector![1.0]).unwrap();
    let belief_from = |data| Belief::from_information(Information::zero(2), data).unwrap();
    let (first, second) = (belief_from(row(dmatrix![1.0, 0.0])), belief_from(row(dmatrix![0.0, 1.0])));
    let (fused, weight) = first.covariance_intersection(&second).unwrap();
    assert!((weight - 0.5).abs() < 1e-4);
    assert!((fused.covariance().unwrap()[(0, 0)] - 2.0).abs() < 1e-3);
    let error = first.covariance_intersection(&first).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Undetermined);
}
