//! Small models for tests of this crate and of those above it.

#![allow(clippy::unwrap_used, missing_docs, clippy::missing_panics_doc, reason = "only tests call it")]

use crate::model::{
    Knowledge, Observed, ScanErrorInformation, ScanPoseReport, SensorReport, Support, SurfaceModel,
    VertexInformation,
};
use planish_core::DVec3;
use planish_exchange::Unit;
use planish_spline::{BaseShape, Shape, Surface, SurfaceSystem, leaf_weights};

/// σ of every reading of [`model_of`].
pub const SIGMA: f64 = 0.01;

/// A base shape of size one over a hierarchy with one refined corner.
pub fn refined_surface(shape: Shape) -> Surface {
    let axis = DVec3::Z;
    let (base, grid) = match shape {
        Shape::Sheet => (BaseShape::plane(DVec3::ZERO, [DVec3::X, DVec3::Y], [1.0, 0.8]), [6, 5]),
        Shape::Tube => (BaseShape::cylinder(DVec3::ZERO, axis, 0.5, 1.0), [12, 6]),
        Shape::Ball => (BaseShape::sphere(DVec3::ZERO, 1.0, axis), [16, 8]),
        Shape::Torus => (BaseShape::torus(DVec3::ZERO, axis, 1.0, 0.4), [16, 8]),
    };
    let surface = base.surface(grid).unwrap();
    let corner = [(3.5, 2.5), (4.5, 2.5), (3.5, 3.5), (4.5, 3.5)];
    let marked: Vec<usize> = corner.map(|(u, v)| surface.space().locate(u, v).0).to_vec();
    surface.refined(surface.space().refine(&marked).into()).unwrap()
}

/// A model of a surface with 16 exact readings in every leaf that `observed` selects.
pub fn model_of(surface: Surface, observed: impl Fn(usize) -> bool) -> SurfaceModel {
    let system = SurfaceSystem::new(surface.space()).unwrap();
    let mut prior = system.tangential_hold(&surface, 0.5).unwrap();
    prior.add_scaled(&system.thin_plate(&surface).unwrap().expanded(3).unwrap(), 1.0).unwrap();
    let observed: Vec<bool> = (0..surface.space().leaves().len()).map(observed).collect();
    let w = SIGMA.powi(-2);
    let data = system
        .accumulate(|leaf, cell| {
            for n in 0..16 {
                let local = [n % 4, n / 4].map(|k| (f64::from(k) + 0.5) / 4.0);
                let point = surface.leaf_point(leaf, local[0], local[1]);
                cell.add_vector(&leaf_weights(local[0], local[1]), point, &[w, 0.0, 0.0, w, 0.0, w]);
            }
            observed[leaf]
        })
        .unwrap();
    SurfaceModel {
        known: Knowledge::AlongNormals { information: VertexInformation { prior, data }, scan_errors: None },
        excess_variance: Vec::new(),
        support: Support::default(),
        predictive: None,
        unit: Unit::Millimetre,
        unit_assumed: false,
        observations: 16 * observed.iter().filter(|&&o| o).count(),
        surface,
        observed: observed.into_iter().map(Observed::from_measured).collect(),
        sensors: vec![SensorReport {
            quantity: "position".to_owned(),
            name: "laser".to_owned(),
            observations: 100,
            sigma_stated: None,
            sigma_estimated: 0.1 + 0.2,
            rms: 1.0 / 3.0,
            sigma_shared: None,
            sigma_used_is_estimated: true,
        }],
        poses: vec![ScanPoseReport {
            scan: "top.ply".to_owned(),
            translation: [0.1, -0.2, 1e-17],
            quaternion_xyzw: [0.0, 0.0, 0.6, 0.8],
            sigma_translation: Some(1.0 / 7.0),
            sigma_rotation_deg: None,
            covariance: Some(std::array::from_fn(|a| {
                std::array::from_fn(|b| if a == b { 1.0 / 3.0 } else { 0.1 })
            })),
            ..ScanPoseReport::default()
        }],
        smoothness_weight: 2.0 / 3.0,
    }
}

/// A model of any shape, with every fifth leaf unobserved.
pub fn small_model(shape: Shape) -> SurfaceModel {
    let mut model = model_of(refined_surface(shape), |leaf| leaf % 5 != 0);
    // The pose of its scan is uncertain.
    *model.known.scan_errors_mut().unwrap() = Some(ScanErrorInformation {
        coupling: (0..2 * model.surface.space().node_count()).map(|k| 1e-3 * (k as f64).sin()).collect(),
        corner: vec![1.0 / 3.0, 0.1, 0.1, 0.7],
    });
    model
}

/// Asserts that two models are equal, bit by bit.
pub fn assert_same_model(a: &SurfaceModel, b: &SurfaceModel) {
    assert_eq!(a.unit, b.unit);
    assert_eq!(a.surface.space().shape(), b.surface.space().shape());
    assert_eq!(a.surface.space().base(), b.surface.space().base());
    assert_eq!(a.surface.space().leaves(), b.surface.space().leaves());
    assert_eq!(a.surface.vertices(), b.surface.vertices());
    let [of_a, of_b] = [a, b].map(|model| model.known.information().unwrap());
    for (x, y) in [(&of_a.data, &of_b.data), (&of_a.prior, &of_b.prior)] {
        assert_eq!(x.pattern(), y.pattern());
        assert_eq!((x.values(), x.vector()), (y.values(), y.vector()));
    }
    assert_eq!(
        (&a.observed, &a.support, &a.predictive, a.observations, a.smoothness_weight),
        (&b.observed, &b.support, &b.predictive, b.observations, b.smoothness_weight)
    );
    assert_eq!((&a.sensors, &a.poses, a.known.scan_errors()), (&b.sensors, &b.poses, b.known.scan_errors()));
}
