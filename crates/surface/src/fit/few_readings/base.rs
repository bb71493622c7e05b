//! The base shape of few readings, by the scatter of the readings about each kind.
//!
//! Normals from neighbours are not used: the neighbours of one of twenty readings are readings on the other
//! side of the object.

use nalgebra::{DMatrix, DVector};
use planish_core::{DVec3, Setting};
use planish_estimate::{Error, Result};
use planish_spline::{BaseShape, Shape, choose_base_shape, fit_base_shape, principal_axes, scatter_about};

/// Up to this number of readings without known normals, the shape is chosen here. Beyond it, normals from
/// neighbours are near those of the surface.
const MAX_BY_SCATTER: usize = 80;
/// Largest variance about a quadratic height field, as a share of that along its normal, for a sheet.
///
/// Readings all around a body leave more than 0.6; of 12 readings on a ball, with six degrees of freedom
/// left, fewer than 1 in 10,000 leave less than 0.1.
const MAX_SHEET_SHARE: f64 = 0.1;
/// Largest scatter about a sphere or a cylinder, as a share of its radius, for a body of that kind. An
/// ellipsoid with axes 2 : 1 : 1 has 0.2, a torus of radii 3 : 1 has 0.24 about a sphere.
const MAX_BODY_SCATTER: f64 = 0.22;
/// A body was seen from all sides if there is a reading within the cone of this cosine about each axis and
/// diagonal of its frame. Of 12 readings all around, 1 in 100 clouds fails.
const MIN_COSINE: f64 = 0.1;

/// The base of readings; `normals` are zero where they are not known. None if the choice needs normals.
pub(super) fn base_of_few(
    points: &[DVec3],
    normals: &[DVec3],
    wanted: Option<Shape>,
) -> Result<Option<BaseShape>> {
    let known = normals.iter().filter(|n| n.length_squared() > 0.5).count();
    // Collinear points and the like have no shape at all.
    let sheet = upwards(choose_base_shape(points, normals, Some(Shape::Sheet))?, known == 0);
    let shape = match wanted {
        Some(shape) => shape,
        None if 2 * known > points.len() => choose_base_shape(points, normals, None)?.shape,
        None if is_height_field(points) => Shape::Sheet,
        None if points.len() > MAX_BY_SCATTER => return Ok(None),
        None => return body(points).map(Some),
    };
    if shape == Shape::Sheet {
        return Ok(Some(sheet));
    }
    fitted(points, normals, shape).map(Some)
}

/// A sheet whose upper side is up: the side of readings without normals is a guess.
fn upwards(sheet: BaseShape, is_guess: bool) -> BaseShape {
    let [u, v, normal] = sheet.frame;
    let largest = normal.to_array().into_iter().fold(0.0_f64, |a, b| if b.abs() > a.abs() { b } else { a });
    if is_guess && largest < 0.0 {
        BaseShape::plane(sheet.centre, [v, u], [sheet.size[1], sheet.size[0]])
    } else {
        sheet
    }
}

/// The best shape of a kind. Principal axes of few readings may be in any order, so each is tried as the
/// axis.
fn fitted(points: &[DVec3], normals: &[DVec3], shape: Shape) -> Result<BaseShape> {
    let start = choose_base_shape(points, normals, Some(shape))?;
    let (_, axes, _) = principal_axes(points);
    let starts = axes.map(|axis| match shape {
        Shape::Tube => BaseShape::cylinder(start.centre, axis, start.size[0], start.size[2]),
        Shape::Torus => BaseShape::torus(start.centre, axis, start.size[0], start.size[2]),
        Shape::Ball | Shape::Sheet => start,
    });
    let best = (std::iter::once(start).chain(starts))
        .map(|start| fit_base_shape(&start, points))
        .min_by(|a, b| scatter_about(a, points).total_cmp(&scatter_about(b, points)));
    Ok(best.unwrap_or(start))
}

/// True if a quadratic height field over the plane of the readings describes them.
fn is_height_field(points: &[DVec3]) -> bool {
    let (mean, axes, variances) = principal_axes(points);
    let size = variances[0].sqrt();
    let rows = DMatrix::from_fn(points.len(), 6, |i, j| {
        let [x, y] = [0, 1].map(|k| axes[k].dot(points[i] - mean) / size);
        [1.0, x, y, x * x, x * y, y * y][j]
    });
    let heights = DVector::from_fn(points.len(), |i, _| axes[2].dot(points[i] - mean));
    // A flat cloud is a sheet, however rough.
    if variances[2] < 0.02 * variances[1] {
        return true;
    }
    let freedom = points.len() as f64 - 6.0;
    let Some(found) = rows.clone().svd(true, true).solve(&heights, 1e-12).ok() else {
        return false;
    };
    freedom >= 4.0 && (heights - rows * found).norm_squared() / freedom < MAX_SHEET_SHARE * variances[2]
}

/// A ball or a tube that was seen from all sides.
fn body(points: &[DVec3]) -> Result<BaseShape> {
    let ball = fitted(points, &[], Shape::Ball)?;
    let tube = fitted(points, &[], Shape::Tube)?;
    let scatter = |base: &BaseShape| scatter_about(base, points) / base.size[0];
    let is_around = |base: &BaseShape, directions: &[DVec3]| {
        directions.iter().all(|direction| {
            points.iter().any(|p| {
                let away = *p - base.centre;
                let away = if base.shape == Shape::Tube {
                    away - away.dot(base.frame[2]) * base.frame[2]
                } else {
                    away
                };
                away.dot(*direction) > MIN_COSINE * away.length()
            })
        })
    };
    let [e1, e2, e3] = tube.frame;
    let about = [e1, e2, -e1, -e2, e1 + e2, e1 - e2, -e1 - e2, e2 - e1].map(DVec3::normalize);
    let corners = (0..8).map(|k| {
        let sign = |bit: usize| if k >> bit & 1 == 1 { 1.0 } else { -1.0 };
        DVec3::new(sign(0), sign(1), sign(2)).normalize()
    });
    let all: Vec<DVec3> = corners.chain([e1, e2, e3, -e1, -e2, -e3]).collect();
    // A cylinder has one parameter more, and a long ball is near one: it must be clearly better.
    let is_tube = scatter(&tube) < 0.5 * scatter(&ball)
        && scatter(&tube) < MAX_BODY_SCATTER
        && is_around(&tube, &about);
    if is_tube {
        return Ok(tube);
    }
    if scatter(&ball) < MAX_BODY_SCATTER && is_around(&ball, &all) {
        return Ok(ball);
    }
    Err(Error::undetermined(format!(
        "expected {} readings to be near a smooth sheet, a ball or a tube, found none of these: a quadratic \
         surface leaves them, they scatter by {:.0} % of the radius about a sphere and {:.0} % about a \
         cylinder; specify the shape, add normals or add readings (more than {MAX_BY_SCATTER})",
        points.len(),
        100.0 * scatter(&ball),
        100.0 * scatter(&tube)
    ))
    .with_setting(Setting::Shape))
}
