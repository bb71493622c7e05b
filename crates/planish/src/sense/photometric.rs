//! Normals from pictures under several lights.

use super::front_ends::of_normals;
use super::{
    Error, Finding, FindingCode, LightSource, Path, PathBuf, PhotometricOptions, Progress, Result, Sensed,
    lights_from_ball, photometric_normals, read_brightness, read_lights, read_picture,
};
use planish_core::vector3::from_arrays;
use planish_exchange::picture::{Picture, saturation_of};
use planish_sense::{Image, NormalMap};

/// Maximum ratio of brightness residuals to the stated σ without a warning. Real surfaces are never quite
/// matte, so some excess is normal.
const MAX_MISFIT: f64 = 3.0;
/// Maximum brightness residual relative to the brightest pixel without a warning. Matte objects under far
/// lights stay below a few percent.
const MAX_MISFIT_SHARE: f64 = 0.1;
/// Maximum share of the readings of one light that are rejected, without a warning. Highlights and cast
/// shadows cover less.
const MAX_REJECTED: f64 = 0.5;
/// Maximum share of the object's pixels without a normal, and of saturated readings, without a warning.
const MAX_WITHOUT_NORMAL: f64 = 0.1;
const MAX_SATURATED: f64 = 0.01;

pub(super) fn photometric(
    images: &[PathBuf],
    mask: Option<&Path>,
    calibration: &Path,
    progress: &dyn Progress,
) -> Result<Sensed> {
    let known = read_lights(calibration)?;
    let pictures = images.iter().map(|p| read_picture(p)).collect::<Result<Vec<Picture>>>()?;
    let mask_file = mask;
    let mask = mask.map(read_brightness).transpose()?;
    let first = (pictures.first()).map_or((0, 0), |p| (p.columns, p.rows));
    let sizes = pictures.iter().map(|p| (p.columns, p.rows)).chain(mask.iter().map(|m| (m.columns, m.rows)));
    for (file, size) in images.iter().map(PathBuf::as_path).chain(mask_file).zip(sizes) {
        // Checked here, where the name of the file is known.
        if size != first {
            return Err(Error::input(format!(
                "{}: expected {} × {} pixels like {}, found {} × {}",
                file.display(),
                first.0,
                first.1,
                images[0].display(),
                size.0,
                size.1
            )));
        }
    }
    progress.check("lights", 0.1)?;
    let with_calibration = |e: Error| e.in_context(calibration.display());
    let mut more_inputs = Vec::new();
    let lights = match &known.source {
        LightSource::Directions(lights) => from_arrays(lights).to_vec(),
        // A mirror ball shows the lights. Its pictures are inputs that only the calibration names.
        LightSource::Ball { images, mask } => {
            more_inputs.extend(images.iter().chain([mask]).cloned());
            let of_ball = images.iter().map(|p| read_brightness(p)).collect::<Result<Vec<Image>>>()?;
            lights_from_ball(&of_ball, &read_brightness(mask)?).map_err(with_calibration)?
        }
    };
    let saturation = known.saturation.map_or_else(|| saturation_of(&pictures), |level| level as f32);
    let images: Vec<Image> = (pictures.iter().enumerate())
        .map(|(k, picture)| {
            let intensity = known.intensities.get(k).copied().unwrap_or([1.0; 3]);
            picture.brightness_under(intensity, saturation)
        })
        .collect::<Result<_>>()?;
    let options = PhotometricOptions {
        sigma_brightness: known.sigma_brightness,
        sigma_light_deg: known.sigma_light_deg,
        ..PhotometricOptions::default()
    };
    progress.check("normals", 0.2)?;
    let map = photometric_normals(&images, &lights, mask.as_ref(), &options).map_err(with_calibration)?;
    let mut sensed = of_normals(&map, known.pixel_size)?;
    sensed.ambient = Some(map.ambient);
    sensed.sigma_brightness = Some(map.sigma_brightness);
    sensed.model_error = map.sigma_of_residuals.map(|_| map.model_error);
    let counts = map.readings;
    sensed.readings = [
        ("used", counts.used),
        ("saturated", counts.saturated),
        ("shadowed", counts.shadowed),
        ("outliers", counts.outliers),
    ]
    .into();
    sensed.unit = known.unit;
    sensed.more_inputs = more_inputs;
    sensed.findings = brightness_findings(&map, known.sigma_brightness);
    sensed.findings.extend(missing_normals(&map));
    Ok(sensed)
}

/// Residuals that the stated σ of brightness, or any matte surface, does not explain.
fn brightness_findings(map: &NormalMap, stated: Option<f64>) -> Vec<Finding> {
    // Three lights determine the normal exactly and leave no residual.
    let Some(found) = map.sigma_of_residuals else {
        return Vec::new();
    };
    let mut findings = Vec::new();
    if let Some(stated) = stated.filter(|stated| found > MAX_MISFIT * stated) {
        let text = format!(
            "the brightness of a typical pixel differs from that of a matte surface by {found:.3}, {:.0} \
             times the stated sigma_brightness: the excess was added to σ of the normals as a model error; \
             check the order of the images, or omit sigma_brightness",
            found / stated
        );
        findings.push(Finding::new(FindingCode::BrightnessInconsistent, text));
    }
    if found > MAX_MISFIT_SHARE * map.brightest {
        findings.push(Finding::new(
            FindingCode::BrightnessInconsistent,
            format!(
                "the brightness of a typical pixel differs from that of a matte surface by {:.0} % of the \
                 brightest: check that the images are in the order of the lights and show one view",
                100.0 * found / map.brightest
            ),
        ));
    }
    for (k, share) in map.rejected_by_light.iter().enumerate().filter(|(_, share)| **share > MAX_REJECTED) {
        let text = format!(
            "image {}: {:.0} % of the readings disagree with its light and were rejected: check the \
             direction of light {k}, its intensity, and the order of the images",
            k + 1,
            100.0 * share
        );
        findings.push(Finding::new(FindingCode::BrightnessInconsistent, text));
    }
    findings
}

/// Names pixels without a normal, and saturated readings, if there are many.
fn missing_normals(map: &NormalMap) -> Vec<Finding> {
    let mut findings = Vec::new();
    let known = map.normals.iter().filter(|n| n.is_some()).count();
    let missing = map.dark + map.saturated + map.undetermined;
    if missing as f64 > MAX_WITHOUT_NORMAL * (known + missing) as f64 {
        let text = format!(
            "{missing} of {} pixels of the object have no normal: {} are dark, {} are saturated, and the \
             readings of {} are too few or inconsistent",
            known + missing,
            map.dark,
            map.saturated,
            map.undetermined
        );
        findings.push(Finding::new(FindingCode::NormalsMissing, text));
    }
    let counts = map.readings;
    let all = counts.used + counts.saturated + counts.shadowed + counts.outliers;
    if counts.saturated as f64 > MAX_SATURATED * all as f64 {
        let text = format!(
            "{} of {all} readings are saturated and were not used: expose the images for less time",
            counts.saturated
        );
        findings.push(Finding::new(FindingCode::ImagesSaturated, text));
    }
    findings
}
