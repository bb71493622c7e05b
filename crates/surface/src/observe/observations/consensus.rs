//! Readings that lie on a surface with their neighbours, and stated normals that contradict it.
//!
//! Marks are found before any shape is chosen. Readings without a mark take no part in the choice of shape
//! and in the rounds that look for it; the last round uses every reading within the gate. See decision 0100.

use super::{IntakeFigures, Observations};
use planish_core::{DVec3, Finding, FindingCode, Vec3};
use planish_estimate::Result;
use planish_exchange::ScanSet;
use planish_sense::{MIN_FOR_CONSENSUS, Neighbourhoods, Scan, Sensor, SurfaceConsensus, surface_consensus};

/// A scan is judged on its own as well if more than this share of it is off the surface of all scans: the
/// scans may be displaced against each other.
const MAX_OFF_SURFACE: f64 = 0.05;
/// Share of a scan near which another surface runs parallel, from which the scan has two layers.
const MAX_LAYERED: f64 = 0.3;
/// Cosine between a stated normal and the plane of the neighbours below which they contradict each other.
const MIN_COSINE: f64 = 0.5;
/// Share of contradictions above which the normals of a scan are not used.
const MAX_CONTRADICTIONS: f64 = 0.25;
/// Neighbours whose sides are compared, and the share on the same side below which a normal faces the wrong
/// one, or the normals of a whole scan are of unknown side.
const SIDE_NEIGHBOURS: usize = 8;
const MIN_EQUAL_SIDES: f64 = 0.5;
const MIN_EQUAL_SIDES_OF_SCAN: f64 = 0.8;

/// Why the normals of a scan are not used as they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum UnreliableNormals {
    /// This share of them is not perpendicular to the surface that the neighbours show.
    Directions(f64),
    /// Neighbours face opposite sides; this share of neighbours faces the same.
    Sides(f64),
}

impl Observations {
    /// Marks the readings that lie on a surface with their neighbours, gives those without a normal that of
    /// the surface, and checks stated normals against it.
    pub(super) fn find_surface(&mut self, scans: &[&Scan], sensors: &[Sensor]) -> Result<()> {
        // Sensors of normals and curvatures state a place, but do not measure it.
        let positions: Vec<usize> =
            (0..self.len()).filter(|&i| self.measures_positions(i, sensors)).collect();
        let Some(found) = surface_consensus(&self.points_of(&positions))? else {
            return Ok(());
        };
        // The normal of the surface that the neighbours of each reading show.
        let mut planes = vec![Vec3::ZERO; self.len()];
        for (&i, (&on, normal)) in positions.iter().zip(found.on_surface.iter().zip(&found.normals)) {
            self.readings.on_surface[i] = on;
            planes[i] = normal.as_vec3();
        }
        let mut by_scan = vec![Vec::new(); scans.len()];
        for &i in &positions {
            by_scan[self.readings.scan[i] as usize].push(i);
        }
        for (s, own) in by_scan.iter().enumerate() {
            let off = own.iter().filter(|&&i| !self.readings.on_surface[i]).count();
            if own.len() < MIN_FOR_CONSENSUS {
                // A few touches are placed on purpose, and no cloud of their own shows a surface.
                own.iter().for_each(|&i| self.readings.on_surface[i] = true);
            } else if own.len() < positions.len()
                && (off as f64 > MAX_OFF_SURFACE * own.len() as f64 || found.layered_share > MAX_LAYERED)
            {
                let again: Vec<usize> =
                    own.iter().copied().filter(|&i| !self.readings.on_surface[i]).collect();
                if let Some(alone) = surface_consensus(&self.points_of(own))? {
                    self.note_layers(&alone);
                    let of_scan = own.iter().zip(alone.on_surface.iter().zip(&alone.normals));
                    for (&i, (&on, normal)) in of_scan.filter(|(i, _)| again.binary_search(i).is_ok()) {
                        self.readings.on_surface[i] = on;
                        planes[i] = normal.as_vec3();
                    }
                }
            } else if own.len() == positions.len() {
                self.note_layers(&found);
            }
            if scans[s].normals.is_some() {
                self.check_normals(s, own, &planes)?;
            }
        }
        for i in positions {
            self.complete_normal(i, planes[i]);
        }
        Ok(())
    }

    /// Layers within one scan are no error of a pose between scans.
    fn note_layers(&mut self, of_scan: &SurfaceConsensus) {
        if of_scan.layered_share > MAX_LAYERED {
            self.intake.layers = Some(of_scan.scatter);
        }
    }

    fn measures_positions(&self, i: usize, sensors: &[Sensor]) -> bool {
        sensors[self.channels[self.channel(i)].sensor].kind.measures_positions()
    }

    fn points_of(&self, readings: &[usize]) -> Vec<DVec3> {
        readings.iter().map(|&i| self.readings.points[i]).collect()
    }

    /// Gives a reading of unknown side without a normal that of the surface. In a grid with a viewpoint, few
    /// readings lack one, and normals of unknown side would have all others oriented anew.
    fn complete_normal(&mut self, i: usize, normal: Vec3) {
        if self.readings.normals[i] == Vec3::ZERO && !self.readings.oriented[i] {
            self.readings.normals[i] = normal;
        }
    }

    /// Forgets stated normals of a scan that contradict the surface, and sides that contradict each other.
    fn check_normals(&mut self, scan: usize, own: &[usize], planes: &[Vec3]) -> Result<()> {
        let known: Vec<usize> = own
            .iter()
            .copied()
            .filter(|&i| self.readings.on_surface[i] && self.readings.normals[i] != Vec3::ZERO)
            .collect();
        if known.len() < MIN_FOR_CONSENSUS {
            return Ok(());
        }
        let with_plane = known.iter().filter(|&&i| planes[i] != Vec3::ZERO);
        let (count, contradictions) = with_plane.fold((0_usize, 0_usize), |(count, found), &i| {
            let cosine = self.normal(i).dot(planes[i].as_dvec3());
            (count + 1, found + usize::from(cosine.abs() < MIN_COSINE))
        });
        let share = contradictions as f64 / count.max(1) as f64;
        if share > MAX_CONTRADICTIONS {
            for &i in own {
                self.readings.normals[i] = Vec3::ZERO;
                self.readings.oriented[i] = false;
            }
            self.intake.unreliable_normals.push((scan as u32, UnreliableNormals::Directions(share)));
            return Ok(());
        }
        let normals: Vec<DVec3> = known.iter().map(|&i| self.normal(i)).collect();
        let near = Neighbourhoods::new(&self.points_of(&known), SIDE_NEIGHBOURS)?;
        // Neighbours across an edge face neither side.
        let same_side = |i: usize, j: usize| {
            let cosine = normals[i].dot(normals[j]);
            (cosine.abs() > MIN_COSINE).then_some(cosine > 0.0)
        };
        let equal: Vec<f64> =
            (0..known.len()).map(|i| near.share(i, |j| same_side(i, j)).unwrap_or(1.0)).collect();
        let mean = equal.iter().sum::<f64>() / equal.len() as f64;
        let all = mean < MIN_EQUAL_SIDES_OF_SCAN;
        for (&i, &equal) in known.iter().zip(&equal) {
            if all || equal < MIN_EQUAL_SIDES {
                self.readings.oriented[i] = false;
            }
        }
        if all {
            // Those off the surface share the doubt.
            own.iter().for_each(|&i| self.readings.oriented[i] = false);
            self.intake.unreliable_normals.push((scan as u32, UnreliableNormals::Sides(mean)));
        }
        Ok(())
    }

    /// Findings about scans whose normals were not used as stated.
    pub(crate) fn normal_findings(&self, set: &ScanSet) -> Vec<Finding> {
        let name = |scan: u32| set.scans.get(scan as usize).map_or("", |posed| posed.scan.name.as_str());
        let text = |&(scan, why): &(u32, UnreliableNormals)| {
            Finding::new(
                FindingCode::NormalsUnreliable,
                match why {
                    UnreliableNormals::Directions(share) => format!(
                        "{}: {:.0} % of the stated normals are not perpendicular to the surface that \
                         neighbouring readings show: normals were estimated from neighbours instead",
                        name(scan),
                        100.0 * share
                    ),
                    UnreliableNormals::Sides(share) => format!(
                        "{}: only {:.0} % of neighbouring readings have normals that face the same side: \
                         outside was found from the cloud as a whole instead",
                        name(scan),
                        100.0 * share
                    ),
                },
            )
        };
        let turned = self.intake.are_normals_turned.then(|| {
            Finding::new(
                FindingCode::NormalsUnreliable,
                "the normals face into the volume that the readings enclose, as those of a cavity or with \
                 the wrong sign: they were turned, so that the surface encloses this volume",
            )
        });
        self.intake.unreliable_normals.iter().map(text).chain(turned).collect()
    }
}

impl IntakeFigures {
    /// True if the normals of some scan were not used as stated.
    #[must_use]
    pub fn has_unreliable_normals(&self) -> bool {
        !self.unreliable_normals.is_empty()
    }
}
