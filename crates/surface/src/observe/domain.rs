//! The range of numbers that a fit accepts.
//!
//! Input: scans as read. Output: findings, or an error that names the first number out of range. Inside the
//! range no square overflows and positions keep enough digits. Numbers outside usually come from a wrong unit
//! or a faulty export.

use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_exchange::{PosedScan, ScanSet};
use planish_mesh::BoundingBox;

/// Largest length whose fourth power is finite; the fourth power of its inverse is not zero.
const MAX_LENGTH: f64 = 1e70;
/// Largest ratio of σ and the object's size, or the inverse.
const SIGMA_RANGE: f64 = 1e12;
/// Largest distance of an object from the origin, in sizes. Of sixteen digits, squares and their sums leave
/// about half.
const MAX_DISTANCE: f64 = 1e7;
/// Distance from the origin, in sizes, at which the last digits of a good scanner are lost.
const FAR_DISTANCE: f64 = 1e6;

/// Checks coordinates and stated σ; returns findings. `inputs` is the name of all scans together in messages.
///
/// # Errors
/// `Input` for numbers out of range, with scan and point.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::{PosedScan, ScanSet};
/// use planish_sense::{Scan, Sensor};
/// use planish_surface::observe::check_domain;
/// let points = vec![DVec3::ZERO, DVec3::new(3e9, 4e9, 0.0), DVec3::new(3e99, 0.0, 0.0)];
/// let scan = Scan { name: "a.ply".to_owned(), points, ..Scan::default() };
/// let set = ScanSet {
///     sensors: vec![Sensor::default()],
///     scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
///     ..ScanSet::default()
/// };
/// let error = check_domain(&set, "job.toml").unwrap_err();
/// assert!(error.to_string().starts_with("a.ply: point 2: expected coordinates within"));
/// ```
pub fn check_domain(set: &ScanSet, inputs: &str) -> Result<Vec<Finding>> {
    let mut corners = Vec::new();
    let mut boxes = Vec::new();
    for posed in &set.scans {
        if let Some(at) =
            // Before the pose is applied, because the message names a number of the file.
            posed.scan.points.iter().position(|p| p.to_array().iter().any(|c| c.abs() > MAX_LENGTH))
        {
            let point = posed.scan.points[at].to_array();
            return Err(wrong(
                posed,
                at,
                format!("expected coordinates within ±{MAX_LENGTH:e}, found {point:?}"),
            ));
        }
        let pose = &posed.scan.world_from_scanner;
        let bounds = BoundingBox::around(posed.scan.points.iter().map(|p| pose.apply(*p)));
        corners.extend(bounds.iter().flat_map(|b| [b.min, b.max]));
        boxes.extend(bounds.map(|b| (b, posed.scan.name.as_str())));
    }
    let Some(bounds) = BoundingBox::from_points(&corners) else {
        return Ok(Vec::new());
    };
    let size = bounds.diagonal();
    if size == 0.0 {
        // All points coincide: the fit reports that.
        return Ok(Vec::new());
    }
    if size < 1.0 / MAX_LENGTH {
        return Err(Error::input(format!(
            "{inputs}: expected a cloud larger than {:e}, found {size:e}",
            1.0 / MAX_LENGTH
        )));
    }
    for posed in &set.scans {
        // The size of the cloud is the only scale by which a σ can be judged.
        check_sigma(posed, set, size, inputs)?;
    }
    let away = bounds.min.abs().max(bounds.max.abs()).max_element();
    if away > MAX_DISTANCE * size {
        return Err(Error::input(format!(
            "{inputs}: a cloud of size {size:.3e} lies {away:.3e} from the origin, where too few digits are \
             left: subtract an offset from its coordinates first"
        )));
    }
    let mut findings: Vec<Finding> = apart(boxes).into_iter().collect();
    if away > FAR_DISTANCE * size {
        findings.push(Finding::new(
            FindingCode::FarFromOrigin,
            format!(
                "a cloud of size {size:.3e} lies {away:.3e} from the origin, where digits are lost: \
                 subtract an offset from its coordinates first"
            ),
        ));
    }
    Ok(findings)
}

/// A finding about scans that are farther apart than their sizes: they are in another frame or unit, or of
/// another object.
fn apart(mut boxes: Vec<(BoundingBox, &str)>) -> Option<Finding> {
    if boxes.is_empty() {
        return None;
    }
    let (mut gathered, first) = boxes.remove(0);
    // Scans near the gathered ones join them, until none is near.
    loop {
        // The gathered box grows, so a scan that was far from it may be near now.
        let before = boxes.len();
        boxes.retain(|(next, _)| {
            let gap = (0..3)
                .map(|d| (next.min[d] - gathered.max[d]).max(gathered.min[d] - next.max[d]).max(0.0))
                .fold(0.0, f64::hypot);
            let near = gap <= gathered.diagonal().max(next.diagonal());
            if near {
                let corners = [gathered.min, gathered.max, next.min, next.max];
                gathered = BoundingBox::from_points(&corners).unwrap_or(gathered);
            }
            !near
        });
        if boxes.len() == before {
            break;
        }
    }
    let (_, distant) = boxes.first()?;
    let text = format!(
        "the distance between the scans {first} and {distant} exceeds their sizes: check that they have \
         one frame and unit"
    );
    Some(Finding::new(FindingCode::ScansApart, text))
}

fn wrong(posed: &PosedScan, point: usize, message: String) -> Error {
    Error::input(format!("{}: point {point}: {message}", posed.scan.name))
}

fn check_sigma(posed: &PosedScan, set: &ScanSet, size: f64, inputs: &str) -> Result<()> {
    let out_of_range = |sigma: f64| !(size / SIGMA_RANGE..=size * SIGMA_RANGE).contains(&sigma);
    let message = |sigma: f64| {
        format!(
            "expected a ratio of at most {SIGMA_RANGE:e} between σ and the size of the cloud, found \
             {sigma:e} and {size:.3e}: check the unit of σ"
        )
    };
    let scan = &posed.scan;
    for (at, &sigma) in scan.sigma.iter().flatten().enumerate() {
        if out_of_range(sigma) {
            return Err(wrong(posed, at, message(sigma)));
        }
    }
    for (at, c) in scan.covariance.iter().flatten().enumerate() {
        for variance in [c.xx, c.yy, c.zz] {
            if out_of_range(variance.sqrt()) {
                return Err(wrong(posed, at, message(variance.sqrt())));
            }
        }
    }
    let sensor = &set.sensors[posed.sensor];
    // The σ of a sensor is not used for a scan that states its own.
    match sensor.noise.map(|noise| noise.sigma()) {
        Some(sigma) if scan.sigma.is_none() && scan.covariance.is_none() && out_of_range(sigma) => {
            Err(Error::input(format!("{inputs}: sensor \"{}\": {}", sensor.name, message(sigma))))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::{DVec3, SymmetricMatrix3};
    use planish_estimate::ErrorKind;
    use planish_sense::{Noise, Scan, Sensor, SensorKind};

    fn set(change: impl FnOnce(&mut Scan, &mut Sensor)) -> ScanSet {
        let mut scan = Scan {
            name: "a.ply".to_owned(),
            points: vec![DVec3::ZERO, DVec3::new(3.0, 4.0, 0.0)],
            ..Scan::default()
        };
        let mut sensor = Sensor {
            name: "laser".to_owned(),
            kind: SensorKind::Range,
            noise: None,
            ..planish_sense::Sensor::default()
        };
        change(&mut scan, &mut sensor);
        ScanSet {
            sensors: vec![sensor],
            scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
            ..ScanSet::default()
        }
    }

    #[test]
    fn numbers_out_of_range_are_rejected_with_their_place() {
        type Change = fn(&mut Scan, &mut Sensor);
        let cases: [(Change, &str); 6] = [
            (|scan, _| scan.points[1][2] = 1e71, "a.ply: point 1: expected coordinates"),
            (|scan, _| scan.points[1] = DVec3::new(1e-80, 0.0, 0.0), "larger than"),
            (|scan, _| scan.sigma = Some(vec![0.1, 1e-13]), "a.ply: point 1: expected a ratio"),
            (
                |scan, _| {
                    scan.covariance =
                        Some(vec![SymmetricMatrix3 { xx: 1e40, ..SymmetricMatrix3::isotropic(1.0) }; 2])
                },
                "point 0: expected a ratio",
            ),
            (
                |_, sensor| sensor.noise = Some(Noise::Isotropic { sigma: 1e30 }),
                "sensor \"laser\": expected a ratio",
            ),
            (|scan, _| scan.points.iter_mut().for_each(|p| p[0] += 1e9), "subtract an offset"),
        ];
        for (change, words) in cases {
            let e = check_domain(&set(change), "job.toml").unwrap_err();
            assert!(e.kind() == ErrorKind::Input && e.to_string().contains(words), "{e}");
        }
    }

    #[test]
    fn scans_far_from_each_other_give_a_warning() {
        let mut three = set(|_, _| {});
        for (k, along) in [(1, 6.0), (2, 20.0)] {
            let mut next = three.scans[0].clone();
            next.scan.name = format!("{k}.ply");
            next.scan.points.iter_mut().for_each(|p| p[0] += along);
            three.scans.push(next);
        }
        let findings = check_domain(&three, "job.toml").unwrap();
        assert!(
            findings.len() == 1 && findings[0].text.contains("between the scans a.ply and 2.ply"),
            "{findings:?}"
        );
        // A scan between them connects them.
        let mut between = three.scans[0].clone();
        between.scan.points.iter_mut().for_each(|p| p[0] += 12.0);
        three.scans.push(between);
        assert!(check_domain(&three, "job.toml").unwrap().is_empty());
    }

    #[test]
    fn typical_numbers_pass_and_distant_clouds_give_a_warning() {
        assert!(check_domain(&set(|_, _| {}), "job.toml").unwrap().is_empty());
        assert!(
            check_domain(&set(|scan, _| scan.sigma = Some(vec![1e-6, 1e6])), "job.toml").unwrap().is_empty()
        );
        // A survey in a national grid: kilometres of size, thousands of kilometres from its origin.
        let survey = |scan: &mut Scan, _: &mut Sensor| {
            scan.points = vec![DVec3::new(3e6, 5e6, 0.0), DVec3::new(3.001e6, 5.001e6, 90.0)]
        };
        assert!(check_domain(&set(survey), "job.toml").unwrap().is_empty());
        let far = |scan: &mut Scan, _: &mut Sensor| scan.points.iter_mut().for_each(|p| p[0] += 1e7);
        assert!(check_domain(&set(far), "job.toml").unwrap()[0].text.contains("digits are lost"));
    }
}
