//! The columns of [`Observations`](super::Observations), grouped by what they have one entry for.

use super::InferredVariance;
use super::consensus::UnreliableNormals;
use crate::observe::RejectionCause;
use planish_core::{DVec3, SymmetricMatrix3, Vec3};
use planish_sense::{Noise, Viewing};
use std::collections::{BTreeMap, BTreeSet};

/// What every reading has: one entry for each, in the same order in all columns.
#[derive(Debug, Clone, Default)]
pub struct ReadingColumns {
    /// Positions in the world frame.
    pub points: Vec<DVec3>,
    /// Unit normals of the scans, in the world frame; zero if unknown. They select a side, for which single
    /// precision is enough. Normals that were measured are kept with the noise of their scan, in double
    /// precision.
    pub normals: Vec<Vec3>,
    /// Index of the scan of each reading.
    pub scan: Vec<u32>,
    /// True if the reading is held out of the fit to judge it.
    pub held_out: Vec<bool>,
    /// False for a reading that lies on no surface with its neighbours: probably a gross error. It takes no
    /// part in the search for the shape, but in the last round like any other.
    pub on_surface: Vec<bool>,
    /// Index of the reading among the scan's kept readings.
    pub(super) index: Vec<u32>,
    /// True if the sign of the normal is known, from the scan or its viewpoint.
    pub(crate) oriented: Vec<bool>,
    /// Index of each reading in its scan's file, until normals and curvatures are added.
    pub(super) source: Vec<u32>,
}

/// One row of [`ReadingColumns`].
#[derive(Clone, Copy)]
pub(super) struct ReadingRow {
    pub point: DVec3,
    pub normal: Vec3,
    pub scan: u32,
    pub held_out: bool,
    pub index: u32,
    pub oriented: bool,
    pub on_surface: bool,
}

impl ReadingColumns {
    /// Number of readings.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True if there is no reading.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The normal of a reading; zero if unknown.
    #[inline]
    #[must_use]
    pub fn normal(&self, i: usize) -> DVec3 {
        self.normals[i].as_dvec3()
    }

    pub(super) fn row(&self, i: usize) -> ReadingRow {
        ReadingRow {
            point: self.points[i],
            normal: self.normals[i],
            scan: self.scan[i],
            held_out: self.held_out[i],
            index: self.index[i],
            oriented: self.oriented[i],
            on_surface: self.on_surface[i],
        }
    }

    pub(super) fn push(&mut self, row: ReadingRow) {
        self.points.push(row.point);
        self.normals.push(row.normal);
        self.scan.push(row.scan);
        self.held_out.push(row.held_out);
        self.index.push(row.index);
        self.oriented.push(row.oriented);
        self.on_surface.push(row.on_surface);
    }

    /// Removes the marked readings.
    pub(super) fn drop_marked(&mut self, dropped: &[bool]) {
        fn keep<T>(values: &mut Vec<T>, dropped: &[bool]) {
            let mut marks = dropped.iter();
            values.retain(|_| !marks.next().is_some_and(|&g| g));
        }
        keep(&mut self.points, dropped);
        keep(&mut self.normals, dropped);
        keep(&mut self.scan, dropped);
        keep(&mut self.index, dropped);
        keep(&mut self.held_out, dropped);
        keep(&mut self.oriented, dropped);
        keep(&mut self.on_surface, dropped);
        // Sources are kept only if some scan measures normals or curvatures.
        if !self.source.is_empty() {
            keep(&mut self.source, dropped);
        }
    }
}

/// What every scan has. Normals and curvatures of a scan form further scans, after all others.
#[derive(Debug, Clone, Default)]
pub struct ScanColumns {
    /// The channel of each scan.
    pub(crate) channel: Vec<usize>,
    /// The source of its covariances.
    pub(super) noise: Vec<ScanNoise>,
    /// For each scan of normals, curvatures or inferred readings, the scan that it belongs to.
    pub(super) base: Vec<u32>,
}

/// The source of the covariances of one scan's points.
#[derive(Debug, Clone)]
pub(super) enum ScanNoise {
    /// The sensor's noise model, with rays in the world frame.
    Model { noise: Noise, viewing: Viewing },
    /// One σ for each point.
    Sigma(Vec<f64>),
    /// One covariance for each point, in the world frame.
    Covariance(Vec<SymmetricMatrix3>),
    /// Normals, each with its variance about each axis in the tangent plane, in radians squared.
    Normals(Vec<(DVec3, f64)>),
    /// Curvature tensors, each with the variance of its components.
    Curvatures(Vec<(SymmetricMatrix3, f64)>),
    /// Readings inferred from others.
    Inferred(Vec<InferredVariance>),
}

/// What the intake of scans found, for reports and warnings.
#[derive(Debug, Clone, Default)]
pub struct IntakeFigures {
    /// Number of readings before any rejection.
    pub total: usize,
    /// Number of batches of the same cloud that are added to the fit of these readings.
    pub(crate) later_batches: usize,
    /// Rejected readings, by cause.
    pub rejected: BTreeMap<RejectionCause, usize>,
    /// True if objects on the ground were removed; some of their points may remain.
    pub ground: bool,
    /// Pairs of scans of which the second repeats readings of the first.
    pub(super) copies: BTreeSet<(u32, u32)>,
    /// Noise along the normal, if a scan shows two parallel layers farther apart than that.
    pub layers: Option<f64>,
    /// True if all normals were turned around.
    pub(super) are_normals_turned: bool,
    /// Scans whose stated normals contradict their neighbours.
    pub(super) unreliable_normals: Vec<(u32, UnreliableNormals)>,
}
