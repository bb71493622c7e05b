//! Shading of pictures: diffuse surfaces lit from the upper left, with darkened folds and depth cues for
//! dots.
//!
//! Input: [`Shape`]s with a colour at each place. Output: linear colour and coverage of each pixel.
//!
//! Folds are darkened by *ambient obscurance* (McGuire, Osman, Bukowski and Hennessy, “The Alchemy
//! screen-space ambient obscurance algorithm”, 2011, equation 10). Dots are separated by *eye-dome lighting*
//! (Boucheny, 2009).
//!
//! There are no shadows and no materials.

use super::camera::Camera;
use planish_core::{DVec3, Vec3};
use planish_mesh::{DepthBuffer, DepthVisibility, Projected};
use planish_report::colour::{Colour, linear_light};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Samples along each side of a pixel, and the same for pictures larger than [`LARGE_PICTURE`]. Large
/// pictures have finer pixels, so their edges need fewer samples.
const SAMPLES: [usize; 2] = [3, 2];
const LARGE_PICTURE: usize = 8_000_000;
/// Approximate maximum number of samples in the depth buffer. Larger pictures are drawn in strips.
const MAX_SAMPLES: usize = 16_000_000;
/// Faces that meet at more than this angle, in degrees, have an edge between them.
const SMOOTH_DEG: f64 = 40.0;
/// Over the left shoulder: to the right, up, and towards the camera.
const LAMP: DVec3 = DVec3::new(-0.42, 0.58, 0.70);
/// Fractions of the light from the sky, the ground and the lamp.
const SKY: f64 = 0.44;
const GROUND: f64 = 0.24;
const DIRECT: f64 = 0.72;
/// How far the lamp reaches around an object, as a cosine. It makes the edge of the light soft.
const LAMP_WRAP: f64 = 0.4;
/// Reach of obscurance relative to the diagonal of the object, its strength, and the number of sampled
/// positions. A larger reach also darkens wide hollows; more samples reduce noise at proportional cost.
const REACH: f64 = 0.035;
const OBSCURANCE: f64 = 1.5;
const OBSCURANCE_SAMPLES: usize = 48;
/// Golden angle in radians: samples on a spiral with this step never line up.
const GOLDEN: f64 = 2.399_963_229_728_653;
/// Darkening of dots behind others per unit of slope, and the largest slope that counts. Without the limit,
/// all dots at a depth edge would be black.
const DOT_DARKENING: f64 = 0.14;
const MAX_SLOPE: f64 = 4.0;

/// A drawn object.
pub(super) enum Shape<'a> {
    /// Triangles; colours of a place by its triangle and weights of its corners, or of the normal (in the
    /// picture's axes) if none is given.
    Surface { positions: &'a [DVec3], triangles: &'a [[u32; 3]], colour: Option<&'a PlaceColour<'a>> },
    /// Dots with a colour and an optional normal each, and their width in pixels.
    Dots {
        positions: &'a [DVec3],
        normals: Option<&'a [DVec3]>,
        colour: Option<&'a DotColour<'a>>,
        width: f64,
    },
}

/// The colour of a place on a triangle: its index, and weights of its corners.
pub(super) type PlaceColour<'a> = dyn Fn(usize, [f64; 3]) -> Colour + Sync + 'a;
/// The colour of a dot.
pub(super) type DotColour<'a> = dyn Fn(usize) -> Colour + Sync + 'a;

/// A direction as a colour: to the right is red, up is green, towards the camera is blue.
pub(super) fn normal_colour(normal: DVec3) -> Colour {
    normal.map(|c| 0.5 + 0.5 * c).to_array()
}

/// Surface data of a pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pixel {
    /// Linear light, of the part that is covered.
    pub light: DVec3,
    /// Share that is covered.
    pub covered: f64,
    /// Mean distance along the camera's axis.
    depth: f64,
    /// Mean normal, in the picture's axes.
    normal: DVec3,
    is_dot: bool,
    /// Whether its colour represents a value. Such pixels are not darkened.
    is_value: bool,
}

/// A shape, prepared for shading.
struct Prepared<'a> {
    shape: &'a Shape<'a>,
    /// The first of its triangles, in the depth buffer.
    first: usize,
    /// Normals of the corners of its triangles, in the picture's axes.
    normals: Vec<[Vec3; 3]>,
}

/// Corners of a dot's outline.
const OUTLINE: usize = 6;

/// Draws shapes: every pixel, row by row.
pub(super) fn draw(shapes: &[Shape<'_>], camera: &Camera, [columns, rows]: [usize; 2]) -> Vec<Pixel> {
    let samples = SAMPLES[usize::from(columns * rows > LARGE_PICTURE)];
    let fine = |p: Projected| Projected { at: p.at.map(|x| samples as f64 * x), ..p };
    let (mut corners, mut triangles) = (Vec::new(), Vec::new());
    let mut prepared = Vec::with_capacity(shapes.len());
    for shape in shapes {
        // All shapes share one depth buffer, so that they hide each other.
        let (first, base) = (triangles.len(), corners.len() as u32);
        let mut normals = Vec::new();
        match shape {
            Shape::Surface { positions, triangles: own, .. } => {
                corners.extend(positions.iter().map(|p| fine(camera.project(*p))));
                triangles.extend(own.iter().map(|t| t.map(|k| base + k)));
                normals = corner_normals(positions, own, camera);
            }
            Shape::Dots { positions, width, .. } => {
                for (k, p) in positions.iter().enumerate() {
                    let middle = fine(camera.project(*p));
                    let radius = 0.5 * width * samples as f64;
                    corners.extend((0..OUTLINE).map(|c| {
                        let angle = std::f64::consts::TAU * c as f64 / OUTLINE as f64;
                        Projected {
                            at: [middle.at[0] + radius * angle.cos(), middle.at[1] + radius * angle.sin()],
                            ..middle
                        }
                    }));
                    let corner = base + (OUTLINE * k) as u32;
                    triangles.extend((1..OUTLINE as u32 - 1).map(|c| [corner, corner + c, corner + c + 1]));
                }
            }
        }
        prepared.push(Prepared { shape, first, normals });
    }
    // Strips bound the memory. Each pixel is computed alone, so their height does not change the result.
    let strip = (MAX_SAMPLES / (samples * samples * columns).max(1)).clamp(1, rows.max(1));
    let mut pixels = Vec::with_capacity(columns * rows);
    for first in (0..rows).step_by(strip) {
        let last = (first + strip).min(rows);
        let buffer =
            DepthBuffer::draw_rows(samples * columns, samples * first..samples * last, &corners, &triangles);
        let places = first * columns..last * columns;
        let drawn = places.into_par_iter().with_min_len(64);
        pixels.par_extend(drawn.map(|place| {
            let [column, row] = [place % columns, place / columns];
            let seen = (0..samples * samples)
                .map(|k| buffer.at(samples * column + k % samples, samples * row + k / samples));
            pixel(&prepared, camera, seen, (samples * samples) as f64)
        }));
    }
    obscured(&pixels, camera, [columns, rows])
}

/// The mean of a pixel's samples.
fn pixel(
    prepared: &[Prepared<'_>],
    camera: &Camera,
    samples: impl Iterator<Item = Option<DepthVisibility>>,
    all: f64,
) -> Pixel {
    let mut mean = Pixel::default();
    let mut n = 0.0;
    for seen in samples.flatten() {
        // Shapes are in the order of their first triangle.
        let which = prepared.partition_point(|p| p.first <= seen.triangle as usize) - 1;
        let (light, normal) = illumination(&prepared[which], camera, &seen);
        mean.light += light;
        mean.normal += normal;
        mean.depth += seen.depth;
        match prepared[which].shape {
            Shape::Surface { colour, .. } => mean.is_value |= colour.is_none(),
            Shape::Dots { colour, .. } => {
                mean.is_dot = true;
                mean.is_value |= colour.is_none();
            }
        }
        n += 1.0;
    }
    if n > 0.0 {
        mean.light *= 1.0 / n;
        mean.normal = mean.normal.try_normalize().unwrap_or(DVec3::Z);
        mean.depth /= n;
        mean.covered = n / all;
    }
    mean
}

/// Linear light of a sample, and its normal towards the camera.
fn illumination(prepared: &Prepared<'_>, camera: &Camera, seen: &DepthVisibility) -> (DVec3, DVec3) {
    let index = seen.triangle as usize - prepared.first;
    match prepared.shape {
        Shape::Surface { colour, .. } => {
            let corners = &prepared.normals[index];
            let mixed = (corners.iter().zip(seen.barycentric))
                .fold(DVec3::ZERO, |sum, (n, w)| sum + w * n.as_dvec3());
            let normal = towards_camera(mixed.try_normalize().unwrap_or(DVec3::Z));
            match colour {
                Some(colour) => {
                    let light = brightness(normal);
                    (light * linear(colour(index, seen.barycentric)), normal)
                }
                None => (linear(normal_colour(normal)), normal),
            }
        }
        Shape::Dots { normals, colour, .. } => {
            let dot_index = index / (OUTLINE - 2);
            let known = normals.and_then(|n| camera.turned(n[dot_index]).try_normalize());
            let normal = towards_camera(known.unwrap_or(DVec3::Z));
            let light = known.map_or(0.95, |_| brightness(normal));
            match colour {
                Some(colour) => (light * linear(colour(dot_index)), normal),
                None => (linear(normal_colour(normal)), normal),
            }
        }
    }
}

/// A colour as linear light.
fn linear(colour: Colour) -> DVec3 {
    DVec3::from(colour.map(linear_light))
}

fn towards_camera(normal: DVec3) -> DVec3 {
    // Both sides of a surface are lit alike, because the orientation in files is unreliable.
    if normal[2] < 0.0 { -normal } else { normal }
}

/// Light on a matt surface of this normal.
fn brightness(normal: DVec3) -> f64 {
    let sky = 0.5 + 0.5 * normal[1];
    let lamp = normal.dot(LAMP) / LAMP.length();
    let reached = ((lamp + LAMP_WRAP) / (1.0 + LAMP_WRAP)).max(0.0);
    GROUND + (SKY - GROUND) * sky + DIRECT * reached.powf(1.5)
}

/// Normals at the corners of triangles, in the picture's axes: means over the faces around a place that meet
/// smoothly.
fn corner_normals(positions: &[DVec3], triangles: &[[u32; 3]], camera: &Camera) -> Vec<[Vec3; 3]> {
    // Files may contain a vertex several times, once for each adjacent face.
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    // Adding 0 turns −0 into 0, so that both compare equal.
    let bits = |k: u32| positions[k as usize].to_array().map(|c| (c + 0.0).to_bits());
    order.par_sort_unstable_by_key(|&k| bits(k));
    let mut place_of = vec![0_u32; positions.len()];
    let mut places = 0_u32;
    for (n, &k) in order.iter().enumerate() {
        if n > 0 && bits(order[n - 1]) != bits(k) {
            places += 1;
        }
        place_of[k as usize] = places;
    }
    let face: Vec<DVec3> = (triangles.par_iter())
        .map(|t| {
            let [a, b, c] = t.map(|k| positions[k as usize]);
            camera.turned((b - a).cross(c - a))
        })
        .collect();
    // Faces around every place, one list after the other.
    // Counting sort of triangles by place. It keeps their order, so sums do not depend on threads.
    let mut starts = vec![0_u32; places as usize + 2];
    for k in triangles.as_flattened() {
        starts[place_of[*k as usize] as usize + 1] += 1;
    }
    for k in 1..starts.len() {
        starts[k] += starts[k - 1];
    }
    let mut next = starts.clone();
    let mut around = vec![0_u32; 3 * triangles.len()];
    for (t, corners) in triangles.iter().enumerate() {
        for k in corners {
            let at = &mut next[place_of[*k as usize] as usize];
            around[*at as usize] = t as u32;
            *at += 1;
        }
    }
    let smooth = SMOOTH_DEG.to_radians().cos();
    let of_place = |place: usize| &around[starts[place] as usize..starts[place + 1] as usize];
    let crowded: BTreeMap<usize, Vec<DVec3>> = (0..=places as usize)
        .filter(|place| place + 1 < starts.len() && of_place(*place).len() > CROWDED)
        .map(|place| (place, by_direction(of_place(place).iter().map(|t| face[*t as usize]))))
        .collect();
    (triangles.par_iter().enumerate())
        .map(|(t, corners)| {
            let own = face[t].try_normalize();
            corners.map(|k| {
                let place = place_of[k as usize] as usize;
                let all = of_place(place);
                let faces: &mut dyn Iterator<Item = DVec3> = match crowded.get(&place) {
                    Some(sums) => &mut sums.iter().copied(),
                    None => &mut all.iter().map(|other| face[*other as usize]),
                };
                let sum = faces.fold(DVec3::ZERO, |sum, other| {
                    // Faces are not normalised here: the mean is weighted by area.
                    let meets = own.is_none_or(|own| own.dot(other) >= smooth * other.length());
                    if meets { sum + other } else { sum }
                });
                sum.try_normalize().or(own).unwrap_or(DVec3::Z).as_vec3()
            })
        })
        .collect()
}

/// Number of faces around a place above which they are grouped by direction. Each corner visits all faces
/// around its place, so the time is quadratic in their number; a fan of 200 000 triangles would take minutes.
/// Meshes of measurements stay below.
const CROWDED: usize = 128;

/// Sums of area vectors of nearly equal direction. Their number is bounded by that of the directions.
fn by_direction(faces: impl Iterator<Item = DVec3>) -> Vec<DVec3> {
    // Steps of about 4°, a tenth of the angle that decides.
    const STEPS: f64 = 16.0;
    let mut sums: BTreeMap<[i32; 3], DVec3> = BTreeMap::new();
    for face in faces {
        let direction = face.normalize_or_zero().to_array().map(|x| (STEPS * x).round() as i32);
        *sums.entry(direction).or_default() += face;
    }
    sums.into_values().collect()
}

/// Darkens folds, and dots behind others.
fn obscured(pixels: &[Pixel], camera: &Camera, size: [usize; 2]) -> Vec<Pixel> {
    let [columns, _] = size;
    // Places over a disc, evenly.
    let spiral: Vec<[f64; 2]> = (0..OBSCURANCE_SAMPLES)
        .map(|k| {
            let radius = ((k as f64 + 0.5) / OBSCURANCE_SAMPLES as f64).sqrt();
            let (sine, cosine) = (GOLDEN * k as f64).sin_cos();
            [radius * cosine, radius * sine]
        })
        .collect();
    (0..pixels.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|k| {
            let mut pixel = pixels[k];
            // Pixels that encode a normal must keep their exact colour.
            if pixel.covered > 0.0 && !pixel.is_value {
                let at = [k % columns, k / columns];
                let share = if pixel.is_dot {
                    dots_apart(pixels, camera, size, at)
                } else {
                    obscurance(pixels, camera, size, at, &spiral)
                };
                pixel.light *= share;
            }
            pixel
        })
        .collect()
}

/// The pixel at a position, if it shows an object.
fn covered(pixels: &[Pixel], [columns, rows]: [usize; 2], [column, row]: [f64; 2]) -> Option<&Pixel> {
    let inside = column >= 0.0 && row >= 0.0 && column < columns as f64 && row < rows as f64;
    let pixel = inside.then(|| &pixels[row as usize * columns + column as usize])?;
    (pixel.covered > 0.0).then_some(pixel)
}

/// The share of the light that reaches a place of a surface.
fn obscurance(
    pixels: &[Pixel],
    camera: &Camera,
    size: [usize; 2],
    at: [usize; 2],
    spiral: &[[f64; 2]],
) -> f64 {
    let pixel = &pixels[at[1] * size[0] + at[0]];
    let middle = at.map(|k| k as f64 + 0.5);
    let place = camera.place(middle, pixel.depth);
    let reach = REACH * camera.diagonal;
    let on_screen = reach * camera.focal / pixel.depth;
    let mut sum = 0.0;
    for off in spiral {
        let sample = [middle[0] + on_screen * off[0], middle[1] + on_screen * off[1]];
        let Some(other) = covered(pixels, size, sample) else {
            continue;
        };
        let off = camera.place(sample.map(|x| x.floor() + 0.5), other.depth) - place;
        let square = off.length_squared();
        // Only nearby surface obscures. The offset keeps a place from obscuring itself.
        let above = off.dot(pixel.normal) - 0.002 * camera.diagonal;
        if above > 0.0 && square < 4.0 * reach * reach {
            sum += above * reach / (square + 0.01 * reach * reach) * (1.0 - square / (4.0 * reach * reach));
        }
    }
    // The lower limit keeps colours readable as values in deep folds.
    (1.0 - OBSCURANCE * sum / OBSCURANCE_SAMPLES as f64).max(0.25)
}

/// The brightness of a dot, reduced by steep depth differences to dots in front of it.
fn dots_apart(pixels: &[Pixel], camera: &Camera, size: [usize; 2], at: [usize; 2]) -> f64 {
    let pixel = &pixels[at[1] * size[0] + at[0]];
    let middle = at.map(|k| k as f64 + 0.5);
    let footprint = pixel.depth / camera.focal;
    let mut sum = 0.0;
    for k in 0..16 {
        // Two rings: the inner one separates neighbouring dots, the outer one layers of dots.
        let radius = if k < 8 { 1.5 } else { 4.0 };
        let (sine, cosine) = (std::f64::consts::TAU * f64::from(k) / 8.0).sin_cos();
        if let Some(other) = covered(pixels, size, [middle[0] + radius * cosine, middle[1] + radius * sine]) {
            sum += ((pixel.depth - other.depth) / (radius * footprint)).clamp(0.0, MAX_SLOPE);
        }
    }
    (-DOT_DARKENING * sum / 2.0).exp().max(0.12)
}
