//! Animation of a forming model: its snapshots as an animated mesh, or as pictures.
//!
//! Input: a fitted model with its [`Formation`]. Output: a GLB file with a morph target for each snapshot, or
//! a folder of PNG pictures (`frame_0001.png` and so on). Colours show σ along the normal, on one logarithmic
//! scale for all frames, from dark violet (small) to yellow (large). In the pictures, orange dots are the
//! readings used so far.
//!
//! All frames use the same triangles at the same parameters. Pictures are drawn into a temporary folder,
//! which is then renamed, so that the output folder is complete or absent.
//!
//! Not guaranteed: chord errors of snapshots may exceed those of the final model. Many viewers of GLB files
//! do not animate colours.

use crate::view::Camera;
use planish_core::vector3::tangents;
use planish_core::{DVec3, Progress};
use planish_estimate::{Error, Result};
use planish_exchange::glb::{MeshFrame, ramp, write_animation};
use planish_exchange::picture::write_colour_png;
use planish_exchange::{PendingFolder, Unit, extension};
use planish_mesh::{BoundingBox, DepthBuffer, DepthVisibility, Projected};
use planish_report::colour::screen_brightness;
use planish_spline::{Surface, TessellationOptions, tessellate};
use planish_surface::export::affordable_tolerance;
use planish_surface::fit::Formation;
use planish_surface::model::sigmas_along;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Number of frames of an animation. Every frame is a snapshot of the model with its covariance in memory.
pub const FRAMES: usize = 24;
/// Time between frames in the animation.
const SECONDS_PER_FRAME: f64 = 0.25;
/// Approximate maximum number of triangles of a frame. A GLB file stores all frames, so its size is a
/// multiple of this.
const MAX_TRIANGLES: u64 = 16_000;
/// Columns and rows of a picture.
const PICTURE: [usize; 2] = [800, 600];
/// Samples along each side of a pixel.
const SAMPLES: usize = 3;
/// Maximum number of dots in a picture. More would cover the surface.
const MAX_DOTS: usize = 6000;
/// Direction of the camera: elevation above the plane of a sheet, or direction for other shapes.
const SLANT: f64 = 0.75;
const CAMERA_DIRECTION: DVec3 = DVec3::new(0.55, -0.75, 0.5);
/// Minimum length of the sum of normals, relative to the area, of a surface that faces one way (a sheet). For
/// a closed surface the sum is zero.
const MIN_FACING: f64 = 0.5;
/// Minimum size of the last frame relative to the picture. Larger first frames are clipped.
const MIN_LAST_FRAME: f64 = 0.6;
/// Fraction of ambient light.
const AMBIENT: f64 = 0.35;
const DOT: [u8; 3] = [255, 110, 20];
/// Background colour in linear brightness.
const PAPER: DVec3 = DVec3::new(0.956, 0.956, 0.939);

/// Output of an animation.
#[derive(Debug, Clone, PartialEq)]
pub enum AnimationOutput {
    /// An animated mesh (.glb).
    Mesh(PathBuf),
    /// A folder of pictures.
    Pictures(PathBuf),
}

/// The figures of an animation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AnimationReport {
    /// The file or the folder.
    pub file: PathBuf,
    /// Number of readings used in each frame.
    pub readings: Vec<usize>,
    /// Triangles of each frame.
    pub triangles: usize,
}

impl AnimationOutput {
    /// The animation that a path names: a .glb file, or a folder that is new or empty.
    ///
    /// # Errors
    /// `Unsupported` for other files; `Input` for a folder with files in it; `Io` for a folder that cannot be
    /// written.
    pub fn plan(path: &Path) -> Result<Self> {
        match extension(path).as_str() {
            "glb" => Ok(Self::Mesh(path.to_path_buf())),
            "" => {
                PendingFolder::check(path)?;
                Ok(Self::Pictures(path.to_path_buf()))
            }
            other => Err(Error::unsupported(format!(
                "{}: expected a .glb file or a folder of images (a name without extension) for an \
                 animation, found .{other}",
                path.display()
            ))),
        }
    }
}

/// Frames of one mesh.
struct Frames {
    triangles: Vec<[u32; 3]>,
    frames: Vec<MeshFrame>,
    readings: Vec<usize>,
    unit: Unit,
}

/// Writes the animation of a forming model.
///
/// # Errors
/// `Input` for fewer than two snapshots; errors of the writers; `Interrupted` on request, without partial
/// output.
pub fn write_forming(
    forming: &Formation,
    unit: Unit,
    output: &AnimationOutput,
    progress: &dyn Progress,
) -> Result<AnimationReport> {
    let Some(last) = forming.snapshots.last().filter(|_| forming.snapshots.len() > 1) else {
        return Err(Error::input("expected at least two snapshots for an animation, and readings in them"));
    };
    let frames = frames(&last.surface, forming, unit, progress)?;
    let file = match output {
        AnimationOutput::Mesh(path) => {
            write_animation(path, &frames.frames, &frames.triangles, Some(frames.unit), SECONDS_PER_FRAME)?;
            path
        }
        AnimationOutput::Pictures(path) => {
            // An interrupted run leaves no folder with some of the pictures.
            let folder = PendingFolder::create(path)?;
            let [first, last] = [0, frames.frames.len() - 1].map(|k| &frames.frames[k].points[..]);
            let painter = FramePainter::new(first, last, &frames.triangles)?;
            for (k, frame) in frames.frames.iter().enumerate() {
                progress.check("drawing", k as f64 / frames.frames.len() as f64)?;
                progress.items(k, "pictures");
                let places = &forming.places[..frames.readings[k].min(forming.places.len())];
                let pixels = painter.draw(frame, &frames.triangles, places);
                write_colour_png(&folder.path().join(format!("frame_{:04}.png", k + 1)), PICTURE, &pixels)?;
            }
            folder.finish()?;
            path
        }
    };
    Ok(AnimationReport { file: file.clone(), readings: frames.readings, triangles: frames.triangles.len() })
}

/// The snapshots on the triangles of the last one.
fn frames(surface: &Surface, forming: &Formation, unit: Unit, progress: &dyn Progress) -> Result<Frames> {
    // A ten-thousandth of the size is below a pixel. The limit of triangles usually decides.
    let wanted = 1e-4 * planish_surface::observe::surface_extent(surface);
    let options = TessellationOptions {
        tolerance: affordable_tolerance(surface, wanted, MAX_TRIANGLES)?,
        ..TessellationOptions::default()
    };
    // The triangles of the last snapshot, because morph targets need the same triangles in all frames, and
    // the last is the finest.
    let made = tessellate(surface, &options)?;
    let (mut shapes, mut sigmas) = (Vec::new(), Vec::new());
    for (k, snapshot) in forming.snapshots.iter().enumerate() {
        progress.check("animating", k as f64 / forming.snapshots.len() as f64)?;
        progress.items(k, "frames");
        let then = &snapshot.surface;
        let located: Vec<(usize, [f64; 2])> =
            made.parameters.iter().map(|&[u, v]| then.space().locate(u, v)).collect();
        let points: Vec<DVec3> = located.iter().map(|&(leaf, [s, t])| then.leaf_point(leaf, s, t)).collect();
        let normals: Vec<DVec3> = (made.parameters.iter().zip(&made.normals))
            // Early snapshots can be degenerate at a place.
            .map(|(&[u, v], last)| then.normal(u, v).unwrap_or(*last))
            .collect();
        let leaves: Vec<u32> = located.iter().map(|(leaf, _)| *leaf as u32).collect();
        let local: Vec<[f64; 2]> = located.iter().map(|(_, local)| *local).collect();
        sigmas.push(sigmas_along(&snapshot.posterior(), &leaves, &local, &normals)?);
        shapes.push((points, normals, snapshot.readings));
    }
    // One scale for all frames. With a scale per frame, σ would not seem to fall.
    let scale = ColourScale::from_sigmas(&sigmas);
    let frames = (shapes.iter().zip(&sigmas))
        .map(|((points, normals, readings), sigma)| MeshFrame {
            name: format!("{readings} readings"),
            points: points.clone(),
            normals: normals.clone(),
            colours: sigma.iter().map(|s| ramp(scale.place(*s)).to_array()).collect(),
        })
        .collect();
    Ok(Frames {
        triangles: made.triangles,
        frames,
        readings: shapes.iter().map(|shape| shape.2).collect(),
        unit,
    })
}

/// One logarithmic scale for all frames: from the smallest σ of the last frame to the largest of the first,
/// without a few extreme vertices.
struct ColourScale {
    low: f64,
    high: f64,
}

impl ColourScale {
    fn from_sigmas(sigmas: &[Vec<f64>]) -> Self {
        let quantile = |values: Option<&Vec<f64>>, share: f64| {
            let mut sorted: Vec<f64> = values.into_iter().flatten().copied().filter(|s| *s > 0.0).collect();
            sorted.sort_unstable_by(f64::total_cmp);
            sorted.get((share * sorted.len() as f64) as usize).copied().unwrap_or(1.0).ln()
        };
        // Quantiles: an unmeasured corner has a σ that would leave all the rest in one colour.
        Self { low: quantile(sigmas.last(), 0.02), high: quantile(sigmas.first(), 0.9) }
    }

    fn place(&self, sigma: f64) -> f64 {
        // σ may be zero, and constant over all frames.
        (sigma.max(f64::MIN_POSITIVE).ln() - self.low) / (self.high - self.low).max(1e-9)
    }
}

/// Draws frames with a camera at four times the size of the object from its centre: perspective without
/// visible distortion.
struct FramePainter {
    camera: Camera,
}

impl FramePainter {
    fn new(first: &[DVec3], points: &[DVec3], triangles: &[[u32; 3]]) -> Result<Self> {
        let bounds = BoundingBox::from_points(points)
            .ok_or_else(|| Error::input("expected a scene with an extent, found nothing to draw"))?;
        let (mut facing, mut area) = (DVec3::ZERO, 0.0);
        for t in triangles {
            let [a, b, c] = t.map(|k| points[k as usize]);
            let n = (b - a).cross(c - a);
            facing += n;
            area += n.length();
        }
        let towards = match facing.try_normalize().filter(|_| facing.length() > MIN_FACING * area) {
            Some(n) => {
                let (_, side) = tangents(n);
                (n - SLANT * side).try_normalize()
            }
            None => CAMERA_DIRECTION.try_normalize(),
        };
        let from = towards.ok_or_else(|| Error::input("expected a camera with a direction"))?;
        // From four sizes away the projection is nearly parallel, so that nothing is distorted.
        let at = bounds.center() + 4.0 * bounds.diagonal() * from;
        let forward = -from;
        // z cannot be up for a camera that looks along it.
        let up = if from[2].abs() < 0.95 { DVec3::Z } else { DVec3::Y };
        let right = forward.cross(up).try_normalize().unwrap_or(DVec3::X);
        let up = right.cross(forward);
        let diagonal = bounds.diagonal();
        let mut camera = Camera { at, axes: [right, up, from], focal: 1.0, middle: [0.0; 2], diagonal };
        let room = |points: &[DVec3]| {
            let extents = (points.iter()).fold([0.0_f64; 2], |extents, p| {
                let [x, y] = camera.project(*p).at;
                [extents[0].max(x.abs()), extents[1].max(y.abs())]
            });
            // 0.46 instead of 0.5 leaves a border.
            let [x, y] = [0, 1].map(|k| 0.46 * PICTURE[k] as f64 / extents[k].max(f64::MIN_POSITIVE));
            x.min(y)
        };
        // A surface of few readings may be large. It must not make the last frame small.
        let last = room(points);
        camera.focal = last.min(room(first).max(MIN_LAST_FRAME * last));
        camera.middle = PICTURE.map(|n| 0.5 * n as f64);
        Ok(Self { camera })
    }

    /// Draws a frame with its readings: red, green and blue of every pixel, row by row.
    fn draw(&self, frame: &MeshFrame, triangles: &[[u32; 3]], places: &[DVec3]) -> Vec<u8> {
        let [columns, rows] = PICTURE;
        let corners: Vec<Projected> = (frame.points.iter())
            .map(|p| {
                let Projected { at, depth } = self.camera.project(*p);
                Projected { at: at.map(|x| SAMPLES as f64 * x), depth }
            })
            .collect();
        let buffer = DepthBuffer::draw(SAMPLES * columns, SAMPLES * rows, &corners, triangles);
        let mut pixels: Vec<u8> = (0..columns * rows)
            .into_par_iter()
            .flat_map_iter(|pixel| self.colour(frame, triangles, &buffer, [pixel % columns, pixel / columns]))
            .collect();
        let size = BoundingBox::from_points(&frame.points).map_or(0.0, |b| b.diagonal());
        for place in places.iter().step_by(places.len().div_ceil(MAX_DOTS).max(1)) {
            let Projected { at: [x, y], depth } = self.camera.project(*place);
            let inside = (1.0..columns as f64 - 1.0).contains(&x) && (1.0..rows as f64 - 1.0).contains(&y);
            let middle = |x: f64| (SAMPLES as f64 * x) as usize;
            if !inside
                // Readings scatter about the surface. The margin keeps those just below it visible.
                || (buffer.at(middle(x), middle(y))).is_some_and(|seen| seen.depth < depth - 0.03 * size)
            {
                continue;
            }
            // Few readings are large dots, many are single pixels.
            let width = if places.len() < 400 {
                3
            } else if places.len() < 2500 {
                2
            } else {
                1
            };
            for dy in 0..width {
                for dx in 0..width {
                    let at =
                        3 * ((y as usize + dy).min(rows - 1) * columns + (x as usize + dx).min(columns - 1));
                    pixels[at..at + 3].copy_from_slice(&DOT);
                }
            }
        }
        pixels
    }

    /// The colour of a pixel: matt, lit from the camera, the mean brightness of its samples.
    fn colour(
        &self,
        frame: &MeshFrame,
        triangles: &[[u32; 3]],
        buffer: &DepthBuffer,
        pixel: [usize; 2],
    ) -> [u8; 3] {
        let sample = |k: usize| {
            let [column, row] = [0, 1].map(|axis| SAMPLES * pixel[axis] + [k % SAMPLES, k / SAMPLES][axis]);
            match buffer.at(column, row) {
                None => PAPER,
                Some(seen) => self.shade(frame, triangles, &seen),
            }
        };
        let sum = (0..SAMPLES * SAMPLES).map(sample).sum::<DVec3>();
        sum.to_array().map(|c| (255.0 * screen_brightness(c / (SAMPLES * SAMPLES) as f64)).round() as u8)
    }

    fn shade(&self, frame: &MeshFrame, triangles: &[[u32; 3]], seen: &DepthVisibility) -> DVec3 {
        let corners = triangles[seen.triangle as usize].map(|c| c as usize);
        let mix = |value: &dyn Fn(usize) -> DVec3| {
            (corners.iter().zip(seen.barycentric)).fold(DVec3::ZERO, |sum, (&c, w)| sum + w * value(c))
        };
        let direction = mix(&|c| frame.points[c]) - self.camera.at;
        let cosine = mix(&|c| frame.normals[c])
            .try_normalize()
            .map_or(1.0, |normal| normal.dot(direction) / direction.length());
        // Both sides are lit, because an open sheet may be seen from behind.
        let light = AMBIENT + (1.0 - AMBIENT) * cosine.abs();
        light * mix(&|c| frame.colours[c].into())
    }
}
