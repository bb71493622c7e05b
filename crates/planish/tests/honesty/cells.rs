//! The cells of the table: a topology and a condition each, and what counts as an honest outcome.

use crate::measure::{Measures, Outcome, Reference, TrueError, run};
use crate::readings::{Condition, SimulatedReadings, simulate};
use crate::settings::{TableSettings, write_readings};
use crate::truth::{Distances, Topology, TrueSurface, rng_of};
use planish::{DVec3, Shape};

/// A topology and a condition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    pub topology: Topology,
    pub condition: Condition,
}

impl Cell {
    /// All cells, by condition within topology.
    pub fn all() -> impl Iterator<Item = Self> {
        (Topology::ALL.into_iter())
            .flat_map(|topology| Condition::ALL.map(|condition| Self { topology, condition }))
    }

    pub fn name(&self) -> String {
        format!("{} {}", self.topology.name(), self.condition.name())
    }

    /// Number of readings of the cell.
    pub fn readings(&self, default: usize) -> usize {
        if let Condition::Readings(count) = self.condition { count } else { default }
    }

    /// The shape that the user states: a torus is not recognised without.
    fn stated_shape(&self) -> Option<Shape> {
        (self.topology == Topology::Torus).then_some(Shape::Torus)
    }

    /// Simulates, fits and measures one seed.
    pub fn run(&self, seed: u64, settings: &TableSettings) -> Outcome {
        let readings = simulate(self.topology, self.condition, seed, settings.readings);
        if let Some(folder) = &settings.readings_folder {
            write_readings(folder, &format!("{} {seed}", self.name()), &readings.set);
        }
        let mut rng = rng_of(&self.name(), !seed);
        let SimulatedReadings { object, placement, spacing, sigma, .. } = &readings;
        let distances = Distances::new(object, &mut rng);
        let scale = placement.scale;
        let error_of = |p: DVec3| {
            let (distance, foot) = distances.of(placement.back(p));
            // Both layers are surfaces that readings are of.
            let second = readings.second_layer.map_or(f64::INFINITY, |height| (distance - height).abs());
            let distance = distance.abs().min(second);
            TrueError { distance: scale * distance, beyond_rim: scale * object.beyond_rim(foot) }
        };
        let reference = Reference {
            error_of: &error_of,
            seen: readings.seen.iter().map(|p| placement.place(*p)).collect(),
            spacing: scale * spacing,
            sigma: scale * sigma,
        };
        let mut outcome = run(&readings.set, self.stated_shape(), settings.time_limit, &reference, &mut rng);
        if let Outcome::Fitted(found) = &mut outcome {
            // A sensor is blamed wrongly only if it states its true σ.
            found.blames_sensor &= readings.true_sigma_stated && !self.has_shared_errors();
        }
        outcome
    }

    fn has_shared_errors(&self) -> bool {
        matches!(self.condition, Condition::Correlated(_))
    }

    /// Words of which a refusal names at least one. Empty where the readings determine the surface, so that
    /// a refusal is wrong.
    pub fn reasons(&self) -> &'static [&'static str] {
        match self.condition {
            Condition::UniformOutliers(30..) | Condition::OneSidedOutliers(_) => {
                &["outlier", "gross error", "rejected", "far from", "agree"]
            }
            Condition::HalfFlippedNormals | Condition::RandomNormals => &["normal"],
            Condition::NineDecades => &["decades"],
            Condition::TwoLayers => &["layer", "surfaces", "rejected", "outlier", "agree"],
            // A curved object has more shape than a sheet: it may need more readings.
            Condition::Readings(12) => &["few", "at least", "add readings"],
            Condition::Readings(20 | 50) if self.topology != Topology::Sheet => {
                &["few", "at least", "add readings"]
            }
            // From one side, a closed object may lack what decides its shape.
            Condition::OneSide if self.topology != Topology::Sheet => {
                &["side", "part", "seen", "measured", "closed"]
            }
            _ => &[],
        }
    }

    /// The band of the coverage of measured surface.
    ///
    /// A σ that is stated too large is kept unless the user asks for less, and covers too much.
    pub fn coverage_band(&self) -> [f64; 2] {
        match self.condition {
            Condition::MisstatedSigma(factor) if factor > 1.0 => [0.93, 1.0],
            _ => [0.93, 0.97],
        }
    }

    /// Smallest share of a model's area that is marked as measured, so that flags do not excuse everything.
    fn min_measured_share(&self) -> f64 {
        match self.condition {
            Condition::Readings(12..=100) | Condition::OneSide | Condition::TwoLayers => 0.0,
            Condition::RandomNormals | Condition::HalfFlippedNormals => 0.0,
            _ => 0.5,
        }
    }

    /// What is wrong with one outcome; none if it is honest.
    ///
    /// The coverage of one seed varies by chance, as errors of a smooth surface are correlated: it is judged
    /// by the mean of the cell. An error of four σ in the mean is no chance.
    pub fn defect(&self, outcome: &Outcome) -> Option<String> {
        match outcome {
            Outcome::Failed(text) => Some(format!("failed: {text}")),
            Outcome::Refused(text) => {
                let text_lower = text.to_lowercase();
                let is_right = self.reasons().iter().any(|word| text_lower.contains(word));
                (!is_right).then(|| format!("refused without a right reason: {text}"))
            }
            Outcome::Fitted(found) => self.defect_of_fit(found),
        }
    }

    fn defect_of_fit(&self, found: &Measures) -> Option<String> {
        if found.rms_normalised > 4.0 {
            return Some(format!("errors of {:.1} σ in the mean", found.rms_normalised));
        }
        if found.overhang > 0.05 {
            return Some(format!("{:.0} % of the measured area is off the object", 100.0 * found.overhang));
        }
        if found.missed > 0.1 {
            return Some(format!("the model misses {:.0} % of the object", 100.0 * found.missed));
        }
        if found.shares[1] < self.min_measured_share() {
            return Some(format!("only {:.0} % of the area is measured", 100.0 * found.shares[1]));
        }
        found.blames_sensor.then(|| format!("blames a true σ: {}", found.findings.join(" ")))
    }
}
