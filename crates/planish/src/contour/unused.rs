//! Settings that the readings cannot use are errors: a user would take an ignored setting for an applied one.

use super::ContourJob;
use planish_core::Setting;
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
    // Settings with a default cannot be absent. Stating the default explicitly is not noticed, and harmless.
    let defaults = CarmenOptions::default();
    let SigmaDefaults { position, heading_deg, range, point } = job.sigma;
    let (is_log, is_picture) = (readings == Readings::Log, readings == Readings::Picture);
    let has_poses = !matches!(readings, Readings::Points | Readings::Picture);
    let has_points = matches!(readings, Readings::Points | Readings::Space);
    // Setting, name, whether it is given, whether the readings can use it, and its purpose.
    let options = [
        (Setting::Region, "a region", job.carmen.region.is_some(), is_log, "logs of scans"),
        (Setting::Scan, "the first scan", job.carmen.first != defaults.first, is_log, "logs of scans"),
        (Setting::Scans, "the number of scans", job.carmen.count != defaults.count, is_log, "logs of scans"),
        (Setting::RangeGate, "a gate of ranges", job.carmen.range != defaults.range, is_log, "logs of scans"),
        (Setting::PixelSize, "the size of a pixel", job.pixel.is_some(), is_picture, "pictures"),
        (Setting::SigmaPoint, "σ of points", point.is_some(), has_points, "readings that are points"),
        (Setting::SigmaPosition, "σ of positions", position.is_some(), has_poses, "readings from poses"),
        (Setting::SigmaHeading, "σ of headings", heading_deg.is_some(), has_poses, "readings from poses"),
        (Setting::SigmaRange, "σ of ranges", range.is_some(), has_poses, "readings from poses"),
    ];
    let held = match readings {
        Readings::Ranges => "a table of ranges from poses",
        Readings::Points => "a table of points",
        Readings::Log => "a log of scans",
        Readings::Picture => "a picture",
        Readings::Space => "readings in space",
    };
    match options.iter().find(|(_, _, given, used, _)| *given && !used) {
        Some((setting, name, _, _, purpose)) => Err(Error::input(format!(
            "{}: {name} is for {purpose}, and this is {held}: omit it",
            job.input.display()
        ))
        .with_setting(*setting)),
        None => Ok(()),
    }
}
