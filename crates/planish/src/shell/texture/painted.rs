//! Paints a texture from views.
//!
//! Input: a mesh, colours of its vertices, and a function that returns the colour at a place with a normal.
//! Output: a picture, and the texture coordinates of each triangle.

use super::atlas::{self, Chart, at_place};
use super::view::ColourView;
use super::{Coloured, DEFAULT_SIDES, MAX_TEXTURE_SIZE, Scene, ShellTextureJob, TextureReport, fill};
use planish_core::vector3::as_arrays;
use planish_core::{DVec3, Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_exchange::picture::colour_png;
use planish_exchange::textured::TexturedMesh;
use planish_mesh::TriangleMesh;
use rayon::prelude::*;

/// A texture.
pub(super) struct Texture {
    pub chart: Chart,
    size: usize,
    pixels: Vec<[f32; 3]>,
    pub report: TextureReport,
}

/// The side of a texture with as many pixels on the mesh as the finest view of each triangle has.
fn size_from_views(mesh: &TriangleMesh, views: &[&ColourView], share: f64) -> usize {
    let pixels: f64 = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let corners = mesh.corners(t);
            views.iter().map(|view| view.pixels_on(corners)).fold(0.0, f64::max)
        })
        // Collected before the sum, so that its order does not depend on threads.
        .collect::<Vec<f64>>()
        .iter()
        .sum();
    let side = (pixels / share.max(1e-3)).sqrt().min(MAX_TEXTURE_SIZE as f64) as usize;
    // A power of two: older viewers scale other sizes, which blurs them.
    side.next_power_of_two().clamp(DEFAULT_SIDES[0], DEFAULT_SIDES[1])
}

/// The mesh that is painted, and the views that colour it.
pub(super) struct Painting<'a> {
    pub job: &'a ShellTextureJob,
    pub file: &'a TexturedMesh,
    pub scene: &'a Scene,
    /// Colours of the vertices, for places that no view sees.
    pub coloured: &'a Coloured,
    pub views: &'a [&'a ColourView],
}

/// Paints a texture: each of its pixels by what views see of its place on the mesh.
pub(super) fn paint(
    Painting { job, file, scene, coloured, views }: &Painting<'_>,
    seen: &(dyn Fn(DVec3, DVec3) -> Option<[f64; 3]> + Sync),
    findings: &mut Vec<Finding>,
) -> Result<Texture> {
    let (mesh, normals) = (&scene.mesh, &scene.normals[..]);
    let own = Chart::from_mesh(file);
    let count = mesh.triangles.len();
    let share = own.as_ref().map_or_else(|| atlas::atlas_share(count), Chart::covered);
    let atlas = own.is_none();
    // The size of an own chart is free: the user made its layout.
    let min_size = if atlas { atlas::MIN_SQUARE * atlas::squares_along(count) } else { 1 };
    let default_size = || size_from_views(mesh, views, share).max(min_size.next_power_of_two());
    let size = job.texture_size.unwrap_or_else(default_size);
    if size < min_size || size > MAX_TEXTURE_SIZE {
        return Err(Error::input(format!(
            "expected a texture of {min_size} to {MAX_TEXTURE_SIZE} pixels along a side for {count} \
             triangles, found {size}: choose another size, a coarser mesh, or colours of vertices"
        )));
    }
    let chart = own.unwrap_or_else(|| Chart::atlas(count, size));
    match chart.outside() {
        0 => {}
        n => findings.push(Finding::new(FindingCode::TextureIncomplete, format!(
            "{}: {n} of {count} triangles have no texture coordinates or extend beyond the image: they get \
             no colours",
            job.mesh.display()
        ))),
    }
    let drawn = chart.drawn(size, size);
    // Colour, and whether a view saw it.
    let found: Vec<Option<([f64; 3], bool)>> = (0..size * size)
        .into_par_iter()
        .map(|k| {
            let on = drawn.at(k % size, k / size)?;
            let place = |values: &[[f64; 3]]| at_place(mesh, values, on.triangle, on.barycentric);
            let normal = DVec3::from(place(as_arrays(normals))).normalize_or_zero();
            Some(match seen(place(as_arrays(&mesh.positions)).into(), normal) {
                Some(colour) => (colour, true),
                // The filled colours of vertices continue smoothly from those that views see.
                None => (place(&coloured.colours), false),
            })
        })
        .collect();
    let texels = found.iter().flatten().count();
    let covered = chart.covered() * (size * size) as f64;
    // Some difference is normal, because pixels are counted by their centres.
    if covered > 1.1 * texels as f64 + 1000.0 {
        let text = format!(
            "{}: parts of the mesh share a region of the texture and show the colours of only one of them",
            job.mesh.display()
        );
        findings.push(Finding::new(FindingCode::TextureShared, text));
    }
    let report =
        TextureReport { size, texels, seen: found.iter().flatten().filter(|(_, seen)| *seen).count(), atlas };
    let mut pixels: Vec<Option<[f32; 3]>> =
        (found.into_iter()).map(|found| found.map(|(colour, _)| colour.map(|c| c as f32))).collect();
    // Viewers average pixels across the border of a chart.
    fill::in_picture(size, size, &mut pixels);
    Ok(Texture { chart, size, pixels: pixels.into_iter().map(Option::unwrap_or_default).collect(), report })
}

impl Texture {
    /// The colour at a place of a triangle, between the middles of pixels.
    pub fn at(&self, triangle: u32, weights: [f64; 3]) -> [f64; 3] {
        let Some([u, v]) = self.chart.place(triangle, weights) else {
            return [0.0; 3];
        };
        let last = (self.size - 1) as f64;
        let [x, y] = [u, 1.0 - v].map(|x| (x * self.size as f64 - 0.5).clamp(0.0, last));
        let [column, row] = [x, y].map(|x| (x as usize).min(self.size.saturating_sub(2)));
        let (x, y) = (x - column as f64, y - row as f64);
        let pixel = |dx: usize, dy: usize| {
            let (column, row) = ((column + dx).min(self.size - 1), (row + dy).min(self.size - 1));
            self.pixels[row * self.size + column].map(f64::from)
        };
        let [a, b, c, d] = [pixel(0, 0), pixel(1, 0), pixel(0, 1), pixel(1, 1)];
        [0, 1, 2].map(|k| (1.0 - y) * ((1.0 - x) * a[k] + x * b[k]) + y * ((1.0 - x) * c[k] + x * d[k]))
    }

    pub fn png(&self) -> Result<Vec<u8>> {
        let bytes: Vec<u8> = self.pixels.iter().flatten().map(|v| v.round() as u8).collect();
        colour_png([self.size; 2], &bytes)
    }
}
