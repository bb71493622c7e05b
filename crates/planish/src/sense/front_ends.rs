//! The sensors: raw data and calibration to points, normals and images of numbers.

use super::*;
use planish_core::{Finding, FindingCode, Setting};

/// Maximum σ of normals, in degrees. A direction with a larger σ is unknown.
const MAX_SIGMA_DEG: f64 = 90.0;
/// Minimum fraction of matched pixels without a warning. Correct pairs have 1/3 to 9/10; exchanged pictures a
/// few percent.
const MIN_MATCHED: f64 = 0.1;

pub(super) fn stereo(
    [left, right]: [&Path; 2],
    calibration: Option<&Path>,
    options: &StereoOptions,
    points: &StereoPoints,
    progress: &dyn Progress,
) -> Result<Sensed> {
    let known = calibration.map(read_stereo_calibration).transpose()?;
    let mut images = [read_brightness(left)?, read_brightness(right)?];
    let sources = || format!("{}, {}", left.display(), right.display());
    let rectification = match &known {
        Some(StereoCalibration { cameras: StereoCameras::Views(rig), .. }) => {
            progress.check("rectifying", 0.0)?;
            let made = Rectification::new(rig, [0, 1].map(|k| [images[k].columns, images[k].rows]));
            let made = made.map_err(|e| e.in_context(calibration.unwrap_or(left).display()))?;
            // Matching runs along rows, so pictures with poses are rectified first.
            images = [made.picture(0, &images[0])?, made.picture(1, &images[1])?];
            Some(made)
        }
        _ => None,
    };
    let mut map =
        match_stereo(&images[0], &images[1], options, &mut |share| progress.check("matching", share))
            .map_err(|e| in_context(e, sources()))?;
    // Rectified pictures have empty corners, in which anything matches.
    let outside = rectification.as_ref().map_or(0, |r| r.without_outside(&mut map));
    let scan = match (&rectification, &known) {
        (Some(rectification), _) => Some(rectification.scan(&map, points, "stereo")),
        (None, Some(StereoCalibration { cameras: StereoCameras::Rectified(camera), .. })) => {
            Some(camera.scan(&map, points, "stereo"))
        }
        _ => None,
    };
    let scan = scan.transpose().map_err(|e| e.in_context(sources()))?;
    let known_unit = known.and_then(|c| c.unit);
    let known: Vec<f64> = map.sigma.iter().filter(|s| s.is_finite()).map(|s| f64::from(*s)).collect();
    // An error: an empty scan would be fitted to nothing later, far from the cause.
    if known.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: found no reliable disparity: check that the images are rectified (or the calibration has \
             the poses of both cameras), that the left image comes first, and that the search range of \
             disparities is wide enough, also below 0",
            sources()
        )));
    }
    let StereoRejected { ambiguous, left_right, speckle, range } = map.rejected;
    let causes = [
        ("ambiguous", ambiguous),
        ("left_right", left_right),
        ("speckle", speckle),
        ("range", range),
        ("outside", outside),
    ];
    let mut findings = Vec::new();
    // A warning, because a small object in front of a plain background also has few matches.
    if (known.len() as f64) < MIN_MATCHED * map.disparity.len() as f64 {
        let text = format!(
            "only {:.1} % of the pixels have a match, and many of these may be chance: check that the left \
             image comes first, that the images are rectified, and that the range of disparities is wide \
             enough",
            100.0 * known.len() as f64 / map.disparity.len() as f64
        );
        findings.push(Finding::new(FindingCode::FewMatches, text).with_setting(Setting::Disparities));
    }
    Ok(Sensed {
        findings,
        pixels: map.disparity.len(),
        observations: known.len(),
        rejected: causes.into_iter().filter(|(_, n)| *n > 0).collect(),
        sigma_px: summary(known),
        raster: Some((map.columns, map.rows, vec![("disparity", map.disparity), ("sigma", map.sigma)])),
        unit: known_unit,
        scan,
        ..Sensed::default()
    })
}

/// Adds context to an error. An interruption is not an error of a file and gets none.
fn in_context(e: Error, context: String) -> Error {
    match e.kind() {
        planish_estimate::ErrorKind::Interrupted => e,
        _ => e.in_context(context),
    }
}

pub(super) fn grid(
    image: &Path,
    plain: Option<&Path>,
    calibration: &Path,
    options: &GridOptions,
) -> Result<Sensed> {
    let known = read_grid_calibration(calibration)?;
    let picture = read_brightness(image)?;
    let without = plain.map(read_brightness).transpose()?;
    let found = read_grid(&picture, without.as_ref(), &known.grid, options)
        .map_err(|e| e.in_context(image.display()))?;
    let GridRejected { no_crossing, no_index, off_line, undetermined } = found.rejected;
    let bent: Vec<f64> = (found.readings.iter()).filter_map(|r| r.curvature).map(|c| c.sigma).collect();
    let causes = [
        ("no_crossing", no_crossing),
        ("no_index", no_index),
        ("off_line", off_line),
        ("undetermined", undetermined),
        // These crossings remain observations; only their curvature is missing.
        ("no_curvature", found.readings.len() - bent.len()),
    ];
    Ok(Sensed {
        pixels: picture.values.len(),
        observations: found.readings.len(),
        rejected: causes.into_iter().filter(|(_, n)| *n > 0).collect(),
        sigma_n_deg: summary(found.readings.iter().map(|r| r.orientation.sigma_normal_deg).collect()),
        sigma_k: summary(bent),
        sigma_px: summary(found.sigma_px.clone()),
        enlarged: found.enlarged,
        unit: known.unit,
        scan: Some(found.scan("grid")),
        ..Sensed::default()
    })
}

pub(super) fn normal_map(image: &Path, sigma_deg: f64) -> Result<Sensed> {
    if !(sigma_deg > 0.0 && sigma_deg < MAX_SIGMA_DEG) {
        return Err(Error::input(format!(
            "expected σ of the normals above 0 and below {MAX_SIGMA_DEG} degrees, found {sigma_deg}"
        )));
    }
    let picture = read_picture(image)?;
    let map = normals_from_colours(picture.columns, picture.rows, &picture.values, picture.white, sigma_deg);
    // A normal map states no pixel size, so positions are in pixels.
    map.and_then(|map| of_normals(&map, 1.0)).map_err(|e| e.in_context(image.display()))
}

pub(super) fn of_normals(map: &planish_sense::NormalMap, pixel_size: f64) -> Result<Sensed> {
    let scan = map.scan(pixel_size, "normals")?;
    let band =
        // NaN marks pixels without a normal: any number would be taken for a direction.
        |k: usize| map.normals.iter().map(|n| n.map_or(f32::NAN, |n| n[k] as f32)).collect::<Vec<f32>>();
    let sigma = map.sigma_deg.iter().map(|s| *s as f32).collect();
    let bands = vec![("nx", band(0)), ("ny", band(1)), ("nz", band(2)), ("sigma_n_deg", sigma)];
    Ok(Sensed {
        pixels: map.normals.len(),
        observations: scan.points.len(),
        rejected: [("undetermined", map.undetermined), ("dark", map.dark), ("saturated", map.saturated)]
            .into_iter()
            .filter(|(_, n)| *n > 0)
            .collect(),
        sigma_n_deg: summary(map.sigma_deg.iter().copied().filter(|s| s.is_finite()).collect()),
        raster: Some((map.columns, map.rows, bands)),
        scan: Some(scan),
        ..Sensed::default()
    })
}

pub(super) fn depth(image: &Path, calibration: Option<&Path>) -> Result<Sensed> {
    let calibration = find_calibration(image, calibration)?;
    let (scan, unit) = read_depth(image, &calibration)?;
    if scan.points.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: expected pixels with a depth, found none",
            image.display()
        )));
    }
    let mut findings = Vec::new();
    // A warning: 8 bits can be a coarse depth image, but usually are a coloured preview.
    if extension(image) == "png" && read_picture(image)?.white <= 255.0 {
        findings.push(Finding::new(
            FindingCode::DepthCoarse,
            format!(
                "{}: has 8 bits, so at most 256 depths: check that it is a depth image and not a \
                 visualisation of one",
                image.display()
            ),
        ));
    }
    Ok(Sensed {
        findings,
        // The scan keeps only pixels with a depth, and counts the others.
        pixels: scan.points.len() + scan.dropped_not_finite,
        observations: scan.points.len(),
        rejected: [("no_reading", scan.dropped_not_finite)].into_iter().filter(|(_, n)| *n > 0).collect(),
        unit,
        more_inputs: vec![calibration],
        scan: Some(scan),
        ..Sensed::default()
    })
}
