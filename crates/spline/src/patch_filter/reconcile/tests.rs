//! Eq. 20–22 of the paper, as printed and corrected, on two segments that share vertices.

use super::*;

/// Two beliefs with a common prior and different readings. Each has five unknowns; the last two of one are
/// the first two of the other. Also returns the belief of all eight.
fn two_segments() -> (PatchBelief, [PatchBelief; 2], DMatrix<f64>) {
    let n = 8;
    // A chain with small differences between neighbours, so the two sides are independent given the shared
    // two.
    let mut precision = DMatrix::<f64>::identity(n, n) * 0.01;
    for i in 0..n - 2 {
        let second = [1.0, -2.0, 1.0];
        for a in 0..3 {
            for b in 0..3 {
                precision[(i + a, i + b)] += second[a] * second[b];
            }
        }
    }
    let prior = precision.clone().try_inverse().unwrap();
    let part = |m: &DMatrix<f64>, from: usize| m.view((from, from), (5, 5)).into_owned();
    let before = PatchBelief::from_matrices(&DMatrix::zeros(5, 1), &part(&prior, 0));
    let mut after = [0, 3].map(|from| PatchBelief::from_matrices(&DMatrix::zeros(5, 1), &part(&prior, from)));
    let mut workspace = Workspace::default();
    let readings: [&[(u16, f64, f64)]; 2] =
        [&[(0, 1.0, 0.1), (4, 1.3, 0.2), (2, 0.7, 0.05)], &[(1, 1.8, 0.1), (4, 2.0, 0.3)]];
    for (belief, own) in after.iter_mut().zip(readings) {
        for &(at, z, r) in own {
            belief.update(&[(at, 1.0)], [z, 0.0, 0.0], r, &mut workspace).unwrap();
        }
    }
    for (side, own) in readings.iter().enumerate() {
        for &(at, _, r) in *own {
            let k = usize::from(at) + 3 * side;
            precision[(k, k)] += 1.0 / r;
        }
    }
    (before, after, precision.try_inverse().unwrap())
}

fn rows(from: u16) -> Vec<SparseRow> {
    (from..from + 2).map(|k| vec![(k, 1.0)]).collect()
}

#[test]
fn a_message_gives_the_neighbour_the_joint_estimate() {
    let (before, [first, second], joint) = two_segments();
    let message = Message::between(&before, &first, &rows(3), 1e-12);
    let mut receiver = second.clone();
    message.apply(&mut receiver, &rows(0), &mut Workspace::default()).unwrap();
    let expected = joint.view((3, 3), (5, 5));
    let difference = (receiver.covariance_matrix() - expected).amax();
    assert!(difference < 1e-9 * expected.amax(), "interior and cross terms too: {difference:e}");
    assert!(Message::between(&first, &first, &rows(3), 1e-12).is_empty(), "no new readings, no message");
}

/// With the cross term as printed and an unchanged interior, the assembled covariance is indefinite.
#[test]
fn the_printed_cross_term_makes_covariances_indefinite() {
    let (_, [first, second], _) = two_segments();
    let (sigma, other) = (first.covariance_matrix(), second.covariance_matrix());
    let shared_i = sigma.view((3, 3), (2, 2)).into_owned();
    let shared_j = other.view((0, 0), (2, 2)).into_owned();
    let inverse_sum = (&shared_i + &shared_j).try_inverse().unwrap();
    let cross = sigma.view((0, 3), (3, 2)).into_owned();
    let fused = &shared_i * &inverse_sum * &shared_j;
    let assemble = |interior: DMatrix<f64>, cross: &DMatrix<f64>| {
        let mut m = DMatrix::zeros(5, 5);
        m.view_mut((0, 0), (3, 3)).copy_from(&interior);
        m.view_mut((0, 3), (3, 2)).copy_from(cross);
        m.view_mut((3, 0), (2, 3)).copy_from(&cross.transpose());
        m.view_mut((3, 3), (2, 2)).copy_from(&fused);
        0.5 * (&m + m.transpose())
    };
    let smallest = |m: &DMatrix<f64>| m.clone().symmetric_eigen().eigenvalues.min();
    let interior = sigma.view((0, 0), (3, 3)).into_owned();
    // Eq. 22: Σ_ii,ij Σ_j (Σ_i + Σ_j)⁻¹, and Σ_ii,ii "need not be updated".
    let printed = assemble(interior.clone(), &(&cross * &shared_j * &inverse_sum));
    // Corrected: Σ_ii,ij (Σ_i + Σ_j)⁻¹ Σ_j, and the interior follows.
    let regression = &cross * shared_i.clone().try_inverse().unwrap();
    let moved = interior + &regression * (&fused - &shared_i) * regression.transpose();
    let right = assemble(moved, &(&cross * &inverse_sum * &shared_j));
    assert!(smallest(&right) > 0.0, "corrected, it is a covariance: {}", smallest(&right));
    // It equals an update with the estimate of the neighbour for the shared vertices.
    let mut by_update = first.clone();
    let eigen = shared_j.clone().symmetric_eigen();
    for k in 0..2 {
        let q = eigen.eigenvectors.column(k);
        let row = vec![(3, q[0]), (4, q[1])];
        by_update.update(&row, [0.0; 3], eigen.eigenvalues[k], &mut Workspace::default()).unwrap();
    }
    assert!((by_update.covariance_matrix() - &right).amax() < 1e-9 * right.amax());
    let worse = (0..200).any(|k| {
        // The printed term commutes only by coincidence: with a rotated covariance of the neighbour it is
        // indefinite.
        let angle = f64::from(k) * 0.0157;
        let (s, c) = angle.sin_cos();
        let turn = DMatrix::from_row_slice(2, 2, &[c, -s, s, c]);
        let shared_j =
            &turn * DMatrix::from_diagonal(&nalgebra::DVector::from_vec(vec![1e-4, 10.0])) * turn.transpose();
        let inverse_sum = (&shared_i + &shared_j).try_inverse().unwrap();
        let fused = &shared_i * &inverse_sum * &shared_j;
        let cross = &cross * &shared_j * &inverse_sum;
        let mut m = printed.clone();
        m.view_mut((0, 3), (3, 2)).copy_from(&cross);
        m.view_mut((3, 0), (2, 3)).copy_from(&cross.transpose());
        m.view_mut((3, 3), (2, 2)).copy_from(&(0.5 * (&fused + fused.transpose())));
        smallest(&m) < -1e-3 * m.amax()
    });
    assert!(worse, "eq. 22 as printed was never indefinite");
}
