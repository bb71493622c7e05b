//! Normals and curvatures of scans as readings of their own.

use super::Observations;
use super::columns::{ReadingRow, ScanNoise};
use crate::observe::{Channel, Quantity, RejectionCause};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_sense::{Scan, Sensor, SensorKind};
use planish_spline::curvature_tensor;

/// Smallest sine of the angle between a normal and the direction of a curvature, which should be a right
/// angle. Below it only rounding decides the direction.
const MIN_ACROSS: f64 = 1e-6;

/// The quantities besides positions that a scan measures: those with a σ from the scan or its sensor, or
/// those that the sensor's kind names.
#[derive(Clone, Copy)]
pub(super) struct Directions {
    normals: bool,
    curvatures: bool,
}

impl Directions {
    pub(super) fn requested(scan: &Scan, sensor: &Sensor) -> Self {
        let (normals, curvatures) = (scan.normals.is_some(), scan.curvatures.is_some());
        Self {
            // A normal without σ only selects the side of a position; it is no reading of its own (decision
            // 0013).
            normals: sensor.kind == SensorKind::Normal
                || normals && (scan.sigma_normal_deg.is_some() || sensor.sigma_normal_deg.is_some()),
            curvatures: sensor.kind == SensorKind::Curvature
                || curvatures && (scan.sigma_curvature.is_some() || sensor.sigma_curvature.is_some()),
        }
    }

    pub(super) fn any(self) -> bool {
        self.normals || self.curvatures
    }

    fn check(self, scan: &Scan, sensor: &Sensor) -> Result<()> {
        let needed = |columns: &str| {
            Error::input(format!(
                "expected the columns {columns} of the sensor \"{}\" of the kind \"{}\", found none",
                sensor.name,
                sensor.kind.name()
            ))
            .at(&scan.name)
        };
        if self.curvatures && scan.curvatures.is_none() {
            return Err(needed("k1 k2 d1x d1y d1z"));
        }
        if self.any() && scan.normals.is_none() {
            return Err(needed("nx ny nz"));
        }
        Ok(())
    }
}

impl Observations {
    /// Adds each normal and each curvature as an observation of its own, at the same place. Sensors that
    /// measure no positions lose theirs.
    pub(super) fn add_directions(
        &mut self,
        scans: &[&Scan],
        sensor_of_scan: &[usize],
        sensors: &[Sensor],
    ) -> Result<()> {
        // The loop adds readings behind these, which must not be taken for positions.
        let placed = self.len();
        for (s, scan) in scans.iter().enumerate() {
            let sensor = &sensors[sensor_of_scan[s]];
            let wanted = Directions::requested(scan, sensor);
            wanted.check(scan, sensor)?;
            if !wanted.any() {
                continue;
            }
            let turn = &scan.world_from_scanner;
            // For each reading: its index, its point in the scan, its normal, and −1 if that points away from
            // the side that was found for it.
            let known: Vec<(usize, usize, DVec3, f64)> = (0..placed)
                .filter(|&k| self.readings.scan[k] as usize == s)
                .filter_map(|k| {
                    let i = self.readings.source[k] as usize;
                    let normal = turn
                        .rotate(scan.normals.as_ref().map_or(DVec3::ZERO, |all| all[i]))
                        .try_normalize()?;
                    let side = normal.dot(self.readings.normals[k].as_dvec3());
                    Some((k, i, normal, if side < 0.0 { -1.0 } else { 1.0 }))
                })
                .collect();
            if wanted.normals {
                let deg = |i: usize| {
                    let own = scan.sigma_normal_deg.as_ref().map(|all| all[i]);
                    own.or(sensor.sigma_normal_deg).map(f64::to_radians)
                };
                let stated = scan.sigma_normal_deg.is_some() || sensor.sigma_normal_deg.is_some();
                let at: Vec<usize> = known.iter().map(|(k, ..)| *k).collect();
                let readings = known.iter().map(|&(_, i, normal, side)| {
                    // One radian stands for an unknown σ until it is estimated; the channel is then not
                    // `stated`.
                    let variance = deg(i).unwrap_or(1.0).powi(2);
                    (side * normal, variance)
                });
                let noise = ScanNoise::Normals(readings.collect());
                self.add_scan(sensor_of_scan[s], Quantity::Normal, stated, &at, noise);
            }
            if let (true, Some(curvatures)) = (wanted.curvatures, &scan.curvatures) {
                let mut along_normal = 0;
                let readings = known.iter().filter_map(|&(k, i, normal, side)| {
                    let direction = turn.rotate(curvatures[i].direction);
                    // A direction of zero means that nothing is known.
                    if direction.cross(normal).length() <= MIN_ACROSS * direction.length() {
                        along_normal += usize::from(direction.length() > 0.0);
                        return None;
                    }
                    // Curvatures change their sign with the normal.
                    let tensor = curvature_tensor(curvatures[i].values, direction, normal)?.scaled(side);
                    let own = scan.sigma_curvature.as_ref().map(|all| all[i]);
                    Some((k, (tensor, own.or(sensor.sigma_curvature).unwrap_or(1.0).powi(2))))
                });
                let (at, readings): (Vec<usize>, Vec<_>) = readings.unzip();
                if along_normal > 0 {
                    *self.intake.rejected.entry(RejectionCause::DirectionAlongNormal).or_insert(0) +=
                        along_normal;
                    self.intake.total += along_normal;
                }
                let stated = scan.sigma_curvature.is_some() || sensor.sigma_curvature.is_some();
                let noise = ScanNoise::Curvatures(readings);
                self.add_scan(sensor_of_scan[s], Quantity::Curvature, stated, &at, noise);
            }
            let silent = (0..placed).filter(|&k| self.readings.scan[k] as usize == s).count() - known.len();
            if silent > 0 && !sensor.kind.measures_positions() {
                *self.intake.rejected.entry(RejectionCause::NoDirection).or_insert(0) += silent;
            }
        }
        // Only this function needs the source, which takes four bytes for each reading.
        self.readings.source = Vec::new();
        // Sensors of normals or curvatures have positions only as places of these.
        let dropped: Vec<bool> = (0..self.len())
            .map(|k| {
                k < placed
                    && !sensors[sensor_of_scan[self.readings.scan[k] as usize]].kind.measures_positions()
            })
            .collect();
        self.intake.total -= dropped.iter().filter(|&&g| g).count();
        self.readings.drop_marked(&dropped);
        Ok(())
    }

    /// Adds a scan of another quantity at the places `at` of existing readings.
    fn add_scan(&mut self, sensor: usize, quantity: Quantity, stated: bool, at: &[usize], noise: ScanNoise) {
        let number = self.channels.iter().position(|c| c.measures(sensor, quantity)).unwrap_or_else(|| {
            // The first channels are the positions of the sensors, in their order.
            let correlated_errors = self.channels[sensor].correlated_errors;
            self.channels.push(Channel { correlated_errors, ..Channel::new(sensor, quantity) });
            self.channels.len() - 1
        });
        self.channels[number].stated &= stated;
        let scan = self.scans.channel.len() as u32;
        self.scans.channel.push(number);
        self.scans.base.push(at.first().map_or(0, |&k| self.readings.scan[k]));
        self.scans.noise.push(noise);
        for (index, &k) in (0..).zip(at) {
            let place = self.readings.row(k);
            self.readings.push(ReadingRow { scan, index, ..place });
        }
        self.intake.total += at.len();
    }
}
