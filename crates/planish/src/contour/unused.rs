//! Refuses options that the readings cannot use. A silently ignored option would look as if it had an effect.

use super::ContourJob;
use planish_estimate::{Error, Result};
use planish_exchange::contours::{CarmenOptions, SigmaDefaults};

/// Kind of readings in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Readings {
    /// Ranges from poses in a plane, of a table.
    Ranges,
    /// Points in a plane, of a table.
    Points,
    /// Scans of a log.
    Log,
    /// Edges of a picture.
    Picture,
    /// Rays or points in space.
    Space,
}

/// Refuses options that do not apply to this kind of readings.
///
/// # Errors
/// `Input`, naming the option and the file.
pub(super) fn refuse_unused(job: &ContourJob, readings: Readings) -> Result<()> {
    let usual = CarmenOptions::default();
    let SigmaDefaults { position, heading_deg, range, point } = job.sigma;
    let (is_log, is_picture) = (readings == Readings::Log, readings == Readings::Picture);
    let has_poses = !matches!(readings, Readings::Points | Readings::Picture);
    let has_points = matches!(readings, Readings::Points | Readings::Space);
    // The option, whether it is given, whether it applies, and what it applies to.
    let options = [
        ("--region", job.carmen.region.is_some(), is_log, "logs of scans"),
        ("--scan", job.carmen.first != usual.first, is_log, "logs of scans"),
        ("--scans", job.carmen.count != usual.count, is_log, "logs of scans"),
        ("--range-gate", job.carmen.range != usual.range, is_log, "logs of scans"),
        ("--pixel-size", job.pixel.is_some(), is_picture, "pictures"),
        ("--sigma-point", point.is_some(), has_points, "readings that are points"),
        ("--sigma-position", position.is_some(), has_poses, "readings from poses"),
        ("--sigma-heading-deg", heading_deg.is_some(), has_poses, "readings from poses"),
        ("--sigma-range", range.is_some(), has_poses, "readings from poses"),
    ];
    let held = match readings {
        Readings::Ranges => "a table of ranges from poses",
        Readings::Points => "a table of points",
        Readings::Log => "a log of scans",
        Readings::Picture => "a picture",
        Readings::Space => "readings in space",
    };
    match options.iter().find(|(_, given, used, _)| *given && !used) {
        Some((option, _, _, purpose)) => Err(Error::input(format!(
            "{}: {option} is for {purpose}, and this is {held}: leave it out",
            job.input.display()
        ))),
        None => Ok(()),
    }
}
