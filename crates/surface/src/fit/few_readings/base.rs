//! The base shape of few readings, by the scatter of the readings about each kind.
//!
//! Normals from neighbours are not used: the neighbours of one of twenty readings are readings on the other
//! side of the object.

use nalgebra::{DMatrix, DVector};
use planish_core::{DVec3, Setting};
use planish_estimate::{Error, Result};
use planish_sense::Neighbourhoods;
use planish_spline::{BaseShape, Shape, choose_base_shape, fit_base_shape, principal_axes, scatter_about};

/// Up to this number of readings without known normals, readings that are near no sphere or cylinder are
/// refused. Beyond it, normals from neighbours are near those of the surface, and any body can be fitted.
const MAX_BY_SCATTER: usize = 80;
/// Largest variance about a quadratic height field, as a share of that along its normal, for a sheet.
///
/// Readings all around a body leave more than 0.6; of 12 readings on a ball, with six degrees of freedom
/// left, fewer than 1 in 10,000 leave less than 0.1.
const MAX_SHEET_SHARE: f64 = 0.1;
/// Largest scatter about a sphere or a cylinder, as a share of its radius, for a body of that kind. An
/// ellipsoid with axes 2 : 1 : 1 has 0.2, a torus of radii 3 : 1 has 0.24 about a sphere.
const MAX_BODY_SCATTER: f64 = 0.22;
/// Scatter of a part of a body over that about a quadratic height field, below which it is one.
const MAX_SHARE_OF_QUADRATIC: f64 = 0.5;
/// Cosine of the slope of a flank, and the share of readings on flanks above which a part of a body is no
/// sheet.
const STEEP_COSINE: f64 = 0.707;
const MAX_STEEP: f64 = 0.1;
/// Nearest neighbours whose heights are compared, at least one less than the readings of any shape.
const NEIGHBOURS: usize = 4;
/// Geary's contrast ratio of heights over a plane, below which readings are a height field: the mean square
/// difference of neighbours over that of any two readings. Bodies have 0.8 to 1.4 along each axis; waves of
/// four readings a period have 0.5 to 0.9.
const MAX_CONTRAST: f64 = 0.6;
/// Neighbours in the plane farther apart in space than this many times the mean distance of neighbours in
/// space, and the share of them below which readings are a height field. Steep and wavy sheets have at most
/// 0.04, 70 % of a ball has 0.06 to 0.24.
const APART: f64 = 2.5;
const MAX_APART: f64 = 0.05;
/// A body was seen from all sides if there is a reading within the cone of this cosine about each axis and
/// diagonal of its frame. Of 12 readings all around, 1 in 100 clouds fails.
const MIN_COSINE: f64 = 0.1;

/// The base of readings; `normals` are zero where they are not known, `estimated` are those of neighbours.
/// None if the choice needs these.
pub(super) fn base_of_few(
    points: &[DVec3],
    normals: &[DVec3],
    estimated: &[DVec3],
    wanted: Option<Shape>,
) -> Result<Option<BaseShape>> {
    let known = normals.iter().filter(|n| n.length_squared() > 0.5).count();
    // Collinear points and the like have no shape at all.
    let sheet = upwards(choose_base_shape(points, normals, Some(Shape::Sheet))?, known == 0);
    let shape = match wanted {
        Some(shape) => shape,
        None if 2 * known > points.len() => choose_base_shape(points, normals, None)?.shape,
        None if is_height_field(points) => match steep_part(points) {
            Some(body) => return Ok(Some(body)),
            None => Shape::Sheet,
        },
        None => match direction_of_heights(points) {
            Some(up) => {
                if let Some(body) = steep_part(points) {
                    return Ok(Some(body));
                }
                let along = vec![up; points.len()];
                return Ok(Some(upwards(choose_base_shape(points, &along, Some(Shape::Sheet))?, true)));
            }
            None => match body(points) {
                Ok(base) => return Ok(Some(base)),
                Err(error) if points.len() <= MAX_BY_SCATTER => return Err(error),
                Err(_) if choose_base_shape(points, estimated, None)?.shape == Shape::Sheet => {
                    return Err(no_shape(
                        points,
                        "their normals are those of a sheet, but neighbours in a plane differ in height as \
                         two sides of a body do; specify the shape, add normals or add readings",
                    ));
                }
                Err(_) => return Ok(None),
            },
        },
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

/// The cylinder or sphere of which readings are a part with steep flanks, which is no height field that a
/// few readings determine; none if they are no such part.
fn steep_part(points: &[DVec3]) -> Option<BaseShape> {
    let quadratic = variance_about_quadratic(points)?;
    let bodies = [Shape::Tube, Shape::Ball].map(|shape| fitted(points, &[], shape).ok());
    let body = (bodies.into_iter().flatten())
        .min_by(|a, b| scatter_about(a, points).total_cmp(&scatter_about(b, points)))?;
    let outwards = |p: &DVec3| away_from(&body, *p).normalize_or_zero();
    let up = points.iter().map(outwards).sum::<DVec3>().normalize_or_zero();
    let steep = points.iter().filter(|p| outwards(p).dot(up) < STEEP_COSINE).count() as f64;
    let is_better = scatter_about(&body, points) < MAX_SHARE_OF_QUADRATIC * quadratic.sqrt();
    (is_better && steep > MAX_STEEP * points.len() as f64).then_some(body)
}

/// A point from the centre of a sphere, or from the axis of a cylinder.
fn away_from(body: &BaseShape, p: DVec3) -> DVec3 {
    let away = p - body.centre;
    if body.shape == Shape::Tube { away - away.dot(body.frame[2]) * body.frame[2] } else { away }
}

/// True if a quadratic height field over the plane of the readings describes them.
fn is_height_field(points: &[DVec3]) -> bool {
    let (_, _, variances) = principal_axes(points);
    // A flat cloud is a sheet, however rough.
    variances[2] < 0.02 * variances[1]
        || variance_about_quadratic(points).is_some_and(|variance| variance < MAX_SHEET_SHARE * variances[2])
}

/// Variance about the best quadratic height field over the plane of the readings; none of too few.
fn variance_about_quadratic(points: &[DVec3]) -> Option<f64> {
    let (mean, axes, variances) = principal_axes(points);
    let size = variances[0].sqrt();
    let rows = DMatrix::from_fn(points.len(), 6, |i, j| {
        let [x, y] = [0, 1].map(|k| axes[k].dot(points[i] - mean) / size);
        [1.0, x, y, x * x, x * y, y * y][j]
    });
    let heights = DVector::from_fn(points.len(), |i, _| axes[2].dot(points[i] - mean));
    let freedom = points.len() as f64 - 6.0;
    let found = rows.clone().svd(true, true).solve(&heights, 1e-12).ok()?;
    (freedom >= 4.0).then(|| (heights - rows * found).norm_squared() / freedom)
}

/// The principal axis along which readings are a height field; none if they are none along any.
///
/// On a height field neighbours in the plane are neighbours in space. On a body half of them lie on the other
/// side, and their heights differ as those of any two readings.
fn direction_of_heights(points: &[DVec3]) -> Option<DVec3> {
    let (mean, axes, _) = principal_axes(points);
    let local: Vec<DVec3> =
        points.iter().map(|p| DVec3::from_array(axes.map(|axis| axis.dot(*p - mean)))).collect();
    let distance = |(i, j): (usize, usize)| local[i].distance(local[j]);
    let in_space = Neighbourhoods::new(&local, NEIGHBOURS).ok()?;
    let count = pairs(&in_space, local.len()).count() as f64;
    let spacing = pairs(&in_space, local.len()).map(distance).sum::<f64>() / count;
    let contrasts = [0, 1, 2].map(|axis| {
        let mut flat = local.clone();
        flat.iter_mut().for_each(|p| p[axis] = 0.0);
        // Too many at one position, as along an extrusion, have no heights over it.
        let Ok(in_plane) = Neighbourhoods::new(&flat, NEIGHBOURS) else {
            return (f64::INFINITY, 1.0);
        };
        let in_plane = || pairs(&in_plane, local.len());
        let square = in_plane().map(|(i, j)| (local[i][axis] - local[j][axis]).powi(2)).sum::<f64>();
        let variance = local.iter().map(|p| p[axis] * p[axis]).sum::<f64>() / local.len() as f64;
        let apart = in_plane().filter(|pair| distance(*pair) > APART * spacing).count();
        (square / (2.0 * variance * count), apart as f64 / count)
    });
    let best = (0..3).min_by(|&a, &b| contrasts[a].0.total_cmp(&contrasts[b].0)).unwrap_or(2);
    let (contrast, apart) = contrasts[best];
    (contrast < MAX_CONTRAST && apart < MAX_APART).then_some(axes[best])
}

/// Each of `count` points with each of its neighbours.
fn pairs(near: &Neighbourhoods, count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count).flat_map(|i| near.neighbours(i).iter().map(move |&j| (i, j as usize)))
}

/// A ball or a tube that was seen from all sides.
fn body(points: &[DVec3]) -> Result<BaseShape> {
    let ball = fitted(points, &[], Shape::Ball)?;
    let tube = fitted(points, &[], Shape::Tube)?;
    let scatter = |base: &BaseShape| scatter_about(base, points) / base.size[0];
    let is_around = |base: &BaseShape, directions: &[DVec3]| {
        directions.iter().all(|direction| {
            points.iter().any(|p| {
                let away = away_from(base, *p);
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
    let found = format!(
        "no height field describes them, they scatter by {:.0} % of the radius about a sphere and {:.0} % \
         about a cylinder; specify the shape, add normals or add readings (more than {MAX_BY_SCATTER})",
        100.0 * scatter(&ball),
        100.0 * scatter(&tube)
    );
    Err(no_shape(points, &found))
}

/// Refuses readings that no shape describes, with what was found.
fn no_shape(points: &[DVec3], found: &str) -> Error {
    Error::undetermined(format!(
        "expected {} readings to be near a smooth sheet, a ball or a tube, found none of these: {found}",
        points.len()
    ))
    .with_setting(Setting::Shape)
}
