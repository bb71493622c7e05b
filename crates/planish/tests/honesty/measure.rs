//! One fit, and the comparison of its σ with the true errors.
//!
//! Input: readings and a function that gives the true distance. Output: an [`Outcome`]. Errors are taken at
//! vertices of the mesh that a user gets, drawn by area: vertices lie on the surface, points of triangles
//! only within the chord error.

use planish::export::mesh_from_model;
use planish::fit::{FitOptions, fit};
use planish::progress::Progress;
use planish::{DVec3, FindingCode, Shape};
use planish_exchange::ScanSet;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

/// Number of vertices that are compared with the true surface.
const COMPARED: usize = 3000;
/// Number of seen points whose distance from the model is measured.
const SEEN: usize = 400;

/// Stops a fit after a time limit.
struct Deadline(Instant);

impl Progress for Deadline {
    fn advance(&self, _: &str, _: f64) {}

    fn interrupted(&self) -> bool {
        Instant::now() > self.0
    }
}

/// True error of a point, and how far it lies beyond the rim of the true surface (negative inside).
pub struct TrueError {
    pub distance: f64,
    pub beyond_rim: f64,
}

/// What a fit is compared with.
pub struct Reference<'a> {
    /// The error of a point of the model.
    pub error_of: &'a dyn Fn(DVec3) -> TrueError,
    /// Points of the true surface that readings are of.
    pub seen: Vec<DVec3>,
    /// Mean distance of neighbouring readings.
    pub spacing: f64,
    /// Standard deviation of the errors of the readings.
    pub sigma: f64,
}

/// Figures of a model. Shares and means are by area.
#[derive(Debug, Clone, Default)]
pub struct Measures {
    /// Topology of the model.
    pub shape: String,
    /// Shares of the area that are marked 0, 1, 2 and 3 in `observed`.
    pub shares: [f64; 4],
    /// Share of the area marked 1 with an error of at most 1.96 σ; NaN without such area.
    pub coverage_measured: f64,
    /// The same of the area marked 0 or 2.
    pub coverage_unmeasured: f64,
    /// Root mean square of error over σ where marked 1. It is 1 if σ is true.
    pub rms_normalised: f64,
    /// Root mean square error where marked 1, over the σ of the readings.
    pub rms: f64,
    /// Share of the area marked 1 that lies more than two spacings beyond the rim of the true surface.
    pub overhang: f64,
    /// Share of the points that were seen of which the model is more than three spacings away.
    pub missed: f64,
    /// Codes of the findings that are not of level info.
    pub findings: Vec<&'static str>,
    /// The texts of the findings.
    pub texts: Vec<String>,
    /// True if the report blames a sensor for errors: its σ was raised, or shared errors were found.
    pub blames_sensor: bool,
}

/// How a fit ended.
#[derive(Debug, Clone)]
pub enum Outcome {
    Fitted(Measures),
    /// Refused because of the data (exit code 1), with the message.
    Refused(String),
    /// Anything else: another error, a panic, the time limit.
    Failed(String),
}

/// Fits readings and compares the model with the true surface.
pub fn run(
    set: &ScanSet,
    shape: Option<Shape>,
    limit: Duration,
    reference: &Reference<'_>,
    rng: &mut ChaCha8Rng,
) -> Outcome {
    let options = FitOptions { shape, ..FitOptions::default() };
    let deadline = Deadline(Instant::now() + limit);
    // A panic is one more kind of failure in the table, and must not end the run.
    let fitted = catch_unwind(AssertUnwindSafe(|| -> planish::Result<_> {
        let fitted = fit(set, &options, &deadline)?;
        let mesh = mesh_from_model(&fitted.model, &fitted.posterior(), None)?;
        Ok((fitted.report, mesh))
    }));
    match fitted {
        Err(panic) => {
            let text = panic.downcast_ref::<String>().cloned();
            let text = text.or_else(|| panic.downcast_ref::<&str>().map(|s| (*s).to_owned()));
            Outcome::Failed(format!("panic: {}", text.unwrap_or_default()))
        }
        Ok(Err(e)) if e.kind().exit_code() == 1 => Outcome::Refused(e.to_string()),
        Ok(Err(e)) => Outcome::Failed(format!("exit code {}: {e}", e.kind().exit_code())),
        Ok(Ok((report, mesh))) => {
            let mut found = compare(&mesh, reference, rng);
            found.shape = report.topology.shape.clone();
            let serious = report.findings.iter().filter(|f| f.level != planish::FindingLevel::Info);
            found.findings = serious.clone().map(|f| f.code.as_str()).collect();
            found.texts = serious.map(ToString::to_string).collect();
            let blames = [FindingCode::SensorSigmaMisstated, FindingCode::SharedErrors];
            found.blames_sensor = report.findings.iter().any(|f| blames.contains(&f.code));
            Outcome::Fitted(found)
        }
    }
}

/// Compares the vertices of a mesh with the true surface.
fn compare(mesh: &planish::export::ModelMesh, reference: &Reference<'_>, rng: &mut ChaCha8Rng) -> Measures {
    let positions = &mesh.mesh.positions;
    let corners = |t: &[u32; 3]| t.map(|i| positions[i as usize]);
    let areas: Vec<f64> = (mesh.mesh.triangles.iter())
        .map(|t| {
            let [a, b, c] = corners(t);
            0.5 * (b - a).cross(c - a).length()
        })
        .collect();
    let mut cumulative = areas.clone();
    for i in 1..cumulative.len() {
        cumulative[i] += cumulative[i - 1];
    }
    let total = cumulative.last().copied().unwrap_or(0.0);
    let draw_triangle = |rng: &mut ChaCha8Rng| {
        let at = rng.random::<f64>() * total;
        cumulative.partition_point(|c| *c < at).min(areas.len() - 1)
    };
    let mut marks = [0_usize; 4];
    let (mut measured, mut unmeasured, mut overhang) = (Vec::new(), Vec::new(), 0);
    let mut on_model = Vec::with_capacity(COMPARED);
    for _ in 0..COMPARED {
        // A random corner of a triangle drawn by area is a vertex drawn by the area about it.
        let t = &mesh.mesh.triangles[draw_triangle(rng)];
        let vertex = t[rng.random_range(0..3)] as usize;
        let (p, sigma) = (positions[vertex], mesh.sigma[vertex]);
        let [a, b, c] = corners(t);
        let (mut u, mut v): (f64, f64) = (rng.random(), rng.random());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        on_model.push(a + u * (b - a) + v * (c - a));
        let error = (reference.error_of)(p);
        let mark = usize::from(mesh.observed[vertex]).min(3);
        let beyond = error.beyond_rim > 2.0 * reference.spacing;
        match mark {
            1 if beyond => {
                overhang += 1;
                marks[1] += 1;
            }
            1 => {
                marks[1] += 1;
                measured.push((error.distance, sigma));
            }
            // Beyond the rim there is no true surface that a prediction could be compared with.
            0 | 2 if error.beyond_rim > 0.0 => {}
            0 | 2 => {
                marks[mark] += 1;
                unmeasured.push((error.distance, sigma));
            }
            _ => marks[mark] += 1,
        }
    }
    let compared = marks.iter().sum::<usize>().max(1) as f64;
    let mean = |values: &mut dyn Iterator<Item = f64>, count: usize| values.sum::<f64>() / count as f64;
    let covered = |errors: &[(f64, f64)]| {
        mean(&mut errors.iter().map(|(d, s)| f64::from(d.abs() <= 1.96 * s)), errors.len())
    };
    let count = measured.len();
    let (on_model, spacing) = (&on_model, reference.spacing);
    let model_spacing = (total / COMPARED as f64).sqrt();
    let step = reference.seen.len().div_ceil(SEEN);
    let seen: Vec<DVec3> = reference.seen.iter().copied().step_by(step).collect();
    let reach = 3.0 * spacing.max(model_spacing);
    let missed = seen.iter().filter(|p| on_model.iter().all(|q| (*q - **p).length() > reach)).count();
    Measures {
        shares: marks.map(|n| n as f64 / compared),
        coverage_measured: covered(&measured),
        coverage_unmeasured: covered(&unmeasured),
        rms_normalised: mean(&mut measured.iter().map(|(d, s)| (d / s).powi(2)), count).sqrt(),
        rms: mean(&mut measured.iter().map(|(d, _)| d * d), count).sqrt() / reference.sigma,
        overhang: overhang as f64 / marks[1].max(1) as f64,
        missed: missed as f64 / seen.len().max(1) as f64,
        ..Measures::default()
    }
}
