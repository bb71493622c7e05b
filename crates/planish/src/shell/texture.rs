//! `planish shell texture`: colours of a mesh from calibrated pictures.
//!
//! Input: a mesh (optionally fitted, with σ) and `views.toml` with pictures. Output: colours of vertices
//! (PLY, GLB), or a texture on the mesh's own coordinates or on an atlas of its triangles (OBJ with MTL and
//! PNG, GLB). The report contains the number of views of each vertex, and the colour differences from the
//! pictures, including held-out views.
//!
//! Each view is sampled at a place (`view`), the samples are blended to one colour (`blend`), and places that
//! no view sees are filled (`fill`) and counted.
//!
//! Not guaranteed: colours contain the highlights and shadows of the pictures. The colour of a vertex comes
//! from an area of one pixel, even if the next vertex is far away.

mod atlas;
mod blend;
mod fill;
mod output;
mod painted;
mod view;

use super::fit::input::read_mask;
use super::surface::mesh_outputs;
use crate::job::Job;
use atlas::at_place;
use blend::{Blended, ViewColour};
use output::write;
use painted::{Painting, Texture, paint};
use planish_core::finding::with_warnings;
use planish_core::{DVec3, Finding, FindingCode};
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::picture::read_picture;
use planish_exchange::textured::{TexturedMesh, read_textured};
use planish_exchange::views::{ViewFile, read_views};
use planish_exchange::{Unit, extension};
use planish_mesh::TriangleMesh;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use view::ColourView;

/// Minimum and maximum default side of a texture, in pixels. Smaller textures blur even small meshes; larger
/// ones take long to load.
const DEFAULT_SIDES: [usize; 2] = [256, 4096];
/// Maximum side of a texture, in pixels. It bounds memory, which grows with the square of the side.
pub const MAX_TEXTURE_SIZE: usize = 8192;
/// Maximum fraction of jointly seen places at which a view may be an outlier. Beyond it, the view is
/// rejected. A picture of another object is an outlier nearly everywhere (test `texture`).
const MAX_OUTLIER_FRACTION: f64 = 0.5;

/// Target of the colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ColourPlace {
    /// To a texture if the mesh has texture coordinates, otherwise to the vertices.
    #[default]
    Auto,
    /// To the vertices.
    Vertices,
    /// To a texture. Without texture coordinates, an atlas of the triangles is made.
    Texture,
}

/// Settings of the job.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShellTextureJob {
    /// The mesh.
    pub mesh: PathBuf,
    /// Cameras and pictures.
    pub views: PathBuf,
    /// Target of the colours.
    pub place: ColourPlace,
    /// Side of the texture in pixels (default: about the resolution of the images).
    pub texture_size: Option<usize>,
    /// Files to write.
    pub outputs: Vec<PathBuf>,
    /// Unit if no file states one.
    pub unit: Option<Unit>,
}

/// Result of one view.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ColourViewReport {
    /// Its name.
    pub view: String,
    /// Whether the view was held out.
    pub held_out: bool,
    /// Number of vertices that the view sees.
    pub seen: usize,
    /// Number of vertices at which it is an outlier.
    #[serde(rename = "odd")]
    pub outlier_vertices: usize,
    /// Whether the view was rejected because it differs at too many places.
    #[serde(rename = "left_out")]
    pub is_rejected: bool,
    /// Root mean square difference of its image from the resulting colours, from 0 to 255, over the pixels
    /// of the mesh away from its outlines.
    pub rms: Option<f64>,
}

/// A texture that was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TextureReport {
    /// Pixels in a row, and rows.
    pub size: usize,
    /// Number of texture pixels on the mesh.
    pub texels: usize,
    /// Those of them whose colour a view saw; all others were filled.
    pub seen: usize,
    /// Whether an atlas of the triangles was made for it.
    pub atlas: bool,
}

/// Result of the job.
#[derive(Debug, Clone, Serialize)]
pub struct ShellTextureReport {
    /// Unit of lengths.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Vertices of the mesh.
    pub vertices: usize,
    /// Vertices that a view sees.
    pub seen: usize,
    /// Number of vertices that no view sees; their colours were filled.
    pub filled: usize,
    /// σ of a colour, from 0 to 255, estimated from the differences between views at vertices that three or
    /// more views see.
    pub colour_sigma: f64,
    /// The texture, if one was made.
    pub texture: Option<TextureReport>,
    /// The views.
    pub views: Vec<ColourViewReport>,
    /// Files read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Files written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
    /// `converged`.
    pub termination: &'static str,
}

/// Colours of the vertices.
struct Coloured {
    colours: Vec<[f64; 3]>,
    /// Number of views that contributed to each vertex; zero if its colour was filled.
    views: Vec<u8>,
}

impl Job for ShellTextureJob {
    type Report = ShellTextureReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.mesh.clone(), self.views.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        let good = |path: &Path| match extension(path).as_str() {
            "ply" => true,
            // OBJ has no standard for colours of vertices.
            "glb" | "obj" => self.place != ColourPlace::Vertices || extension(path) == "glb",
            _ => false,
        };
        // The message lists only what the chosen place allows.
        let needed = match self.place {
            ColourPlace::Vertices => ".ply or .glb for colours of vertices",
            _ => ".ply, .glb, or .obj (with a texture)",
        };
        mesh_outputs(&self.outputs, good, needed)
    }

    fn execute(&self, progress: &dyn Progress) -> Result<ShellTextureReport> {
        texture_mesh(self, progress)
    }
}

/// Colours a mesh and writes its outputs.
///
/// Cost: one depth buffer per view, and one look-up per view for each vertex or texture pixel.
fn texture_mesh(job: &ShellTextureJob, progress: &dyn Progress) -> Result<ShellTextureReport> {
    progress.check("reading", 0.0)?;
    let mut findings = Vec::new();
    let (file, scene) = read(job, progress, &mut findings)?;
    progress.check("blending", 0.5)?;
    // Vertices first, also for a texture: they decide which views are used, and colour its unseen pixels.
    let BlendedViews { used, statistics, coloured, seen } = blend_vertices(job, &scene)?;
    let wanted = match job.place {
        ColourPlace::Texture => true,
        ColourPlace::Vertices => false,
        ColourPlace::Auto => {
            // OBJ files have colours only as a texture.
            !file.uv_triangles.is_empty() || job.outputs.iter().any(|path| extension(path) == "obj")
        }
    };
    let texture = if wanted {
        progress.check("painting", 0.6)?;
        let colour_at = |at, normal| {
            blend::blend(&scene.colours_at(&used, at, normal), statistics.sigma).map(|b| b.colour)
        };
        // The texture is as fine as the views that colour it.
        let chosen: Vec<&ColourView> = used.iter().map(|k| &scene.views[*k]).collect();
        let painting = Painting { job, file: &file, scene: &scene, coloured: &coloured, views: &chosen };
        Some(paint(&painting, &colour_at, &mut findings)?)
    } else {
        None
    };
    progress.check("judging", 0.8)?;
    // Judged by what is written: the texture if there is one, otherwise the vertices.
    let reports = judge(&scene, &statistics, &coloured, texture.as_ref());
    for view in reports.iter().filter(|view| view.is_rejected) {
        let text = format!(
            "view `{}` differs from the others at {} of the {} vertices that it sees, and is not used: its \
             image or camera may belong to another view",
            view.view, view.outlier_vertices, view.seen
        );
        findings.push(Finding::new(FindingCode::ViewInconsistent, text));
    }
    progress.check(WRITING_STAGE, 0.9)?;
    let mut written = Vec::new();
    for path in &job.outputs {
        written.extend(write(path, &file, &coloured, texture.as_ref())?);
    }
    let mut all = vec![job.mesh.clone(), job.views.clone()];
    all.extend(scene.files);
    all.dedup();
    Ok(ShellTextureReport {
        unit: scene.unit,
        vertices: scene.mesh.positions.len(),
        seen,
        filled: scene.mesh.positions.len() - seen,
        colour_sigma: statistics.sigma,
        texture: texture.map(|texture| texture.report),
        views: reports,
        inputs: all,
        written,
        findings,
        termination: "converged",
    })
}

/// The mesh in the unit of the cameras, and the views.
struct Scene {
    mesh: TriangleMesh,
    normals: Vec<DVec3>,
    /// Whether facets are oriented inconsistently. Then both sides count as visible.
    two_sided: bool,
    /// The unit of the cameras.
    unit: Option<Unit>,
    /// Views with a picture, and their visibility.
    pictured: Vec<ViewFile>,
    views: Vec<ColourView>,
    /// Further files that were read.
    files: Vec<PathBuf>,
}

impl Scene {
    /// Colours of a place in the given views; views that do not see it are skipped.
    fn colours_at(&self, used: &[usize], at: DVec3, normal: DVec3) -> Vec<ViewColour> {
        let colour_in = |k: &usize| {
            self.views[*k].sample(at, normal, self.two_sided).map(|found| ViewColour {
                view: *k,
                colour: found.colour,
                weight: found.weight,
            })
        };
        used.iter().filter_map(colour_in).collect()
    }
}

/// Reads the mesh and the views, and draws the mesh as each of them sees it.
fn read(
    job: &ShellTextureJob,
    progress: &dyn Progress,
    findings: &mut Vec<Finding>,
) -> Result<(TexturedMesh, Scene)> {
    let mut file = read_textured(&job.mesh)?;
    findings.append(&mut file.findings);
    if file.triangles.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: expected a mesh with faces, found none",
            job.mesh.display()
        )));
    }
    let read = read_views(&job.views)?;
    file.unit = file.unit.or(job.unit);
    // If either states no unit, both are assumed to share one.
    let by = match (file.unit, read.unit) {
        (Some(own), Some(target)) => own.millimetres() / target.millimetres(),
        _ => 1.0,
    };
    // Only this copy for the views is scaled; outputs keep the unit of the mesh.
    let points = file.points.iter().map(|p| p.map(|x| by * x)).collect();
    let mesh = TriangleMesh::try_new(points, file.triangles.clone())
        .map_err(|e| e.in_context(job.mesh.display()))?;
    let two_sided = !mesh.check().oriented;
    // A warning: most meshes of this kind are closed bodies, for which the far side is hidden anyway.
    if two_sided {
        let text = format!(
            "{}: the facets are not oriented consistently: thin parts may get colours of their other side",
            job.mesh.display()
        );
        findings.push(Finding::new(FindingCode::FacetsInconsistent, text));
    }
    let count = read.views.len();
    let pictured: Vec<ViewFile> = (read.views.into_iter()).filter(|view| view.image.is_some()).collect();
    // An error, because otherwise every colour would be a fill.
    if !pictured.iter().any(|view| !view.held_out) {
        return Err(Error::input(format!(
            "{}: expected a view with `image = \"...\"` that is not held out, found none of {count}",
            job.views.display()
        )));
    }
    progress.check("looking", 0.1)?;
    let size = mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal());
    let views = (pictured.par_iter()).map(|view| colour_view(view, &mesh, size)).collect::<Result<_>>()?;
    let mut files = std::mem::take(&mut file.files);
    files.extend(read.files);
    files.extend(pictured.iter().flat_map(|view| view.image.iter().chain(&view.mask).cloned()));
    let scene = Scene {
        normals: mesh.vertex_normals(),
        mesh,
        two_sided,
        unit: read.unit.or(file.unit),
        pictured,
        views,
        files,
    };
    Ok((file, scene))
}

/// Statistics of all views at the vertices, before any view is rejected.
struct ViewStatistics {
    /// σ of a colour, estimated from the views that are used.
    sigma: f64,
    /// For each view, the number of vertices that it sees, and at how many of them it is an outlier.
    counted: Vec<[usize; 2]>,
    /// Share of the vertices seen by three or more views at which each view is an outlier.
    outlier_shares: Vec<f64>,
}

/// Blended colours of the vertices, and the views that they come from.
struct BlendedViews {
    /// Views that are used.
    used: Vec<usize>,
    statistics: ViewStatistics,
    coloured: Coloured,
    /// Vertices that a view sees.
    seen: usize,
}

/// Blends the vertex colours of all views that are not held out, then again without views that are outliers
/// too often.
fn blend_vertices(job: &ShellTextureJob, scene: &Scene) -> Result<BlendedViews> {
    let (mesh, count) = (&scene.mesh, scene.views.len());
    let blend_from = |used: &[usize]| {
        let colours: Vec<Vec<ViewColour>> = (mesh.positions.par_iter().zip(&scene.normals))
            .map(|(at, normal)| scene.colours_at(used, *at, *normal))
            .collect();
        // One σ for all places: a single place has too few views for an estimate of its own.
        let sigma = blend::scale(colours.iter().map(|s| &s[..]));
        let blended: Vec<Option<Blended>> = colours.par_iter().map(|s| blend::blend(s, sigma)).collect();
        (colours, sigma, blended)
    };
    let mut used: Vec<usize> = (0..count).filter(|k| !scene.pictured[*k].held_out).collect();
    let (colours, mut sigma, mut blended) = blend_from(&used);
    let counted = (0..count)
        .map(|k| {
            let seen = colours.iter().filter(|s| s.iter().any(|one| one.view == k)).count();
            [seen, blended.iter().flatten().filter(|b| b.outliers.contains(&k)).count()]
        })
        .collect();
    let outlier_shares = blend::outlier_shares(count, &colours, &blended);
    // Frees the samples of all views before they are made again.
    drop(colours);
    let all_used = used.len();
    used.retain(|k| outlier_shares[*k] <= MAX_OUTLIER_FRACTION);
    if used.len() < all_used {
        // The statistics stay those of the first pass, because rejected views have none in the second.
        (_, sigma, blended) = blend_from(&used);
    }
    let seen = blended.iter().flatten().count();
    if seen == 0 {
        return Err(Error::undetermined(format!(
            "{}: expected cameras that see the mesh, in its unit and frame, found none that sees any of \
             the {} vertices",
            job.views.display(),
            mesh.positions.len()
        )));
    }
    let known: Vec<Option<[f64; 3]>> = blended.iter().map(|b| b.as_ref().map(|b| b.colour)).collect();
    let coloured = Coloured {
        // Filled from the used views only, so that a rejected picture colours nothing.
        colours: fill::on_mesh(mesh, &known),
        // The file has one byte per vertex for the number of views.
        views: (blended.iter()).map(|b| b.as_ref().map_or(0, |b| b.views.clamp(1, 255) as u8)).collect(),
    };
    Ok(BlendedViews { used, statistics: ViewStatistics { sigma, counted, outlier_shares }, coloured, seen })
}

/// Differences between the pictures of all views and the resulting colours.
fn judge(
    scene: &Scene,
    statistics: &ViewStatistics,
    coloured: &Coloured,
    texture: Option<&Texture>,
) -> Vec<ColourViewReport> {
    let mesh = &scene.mesh;
    (scene.views.iter().zip(&scene.pictured).enumerate())
        .map(|(k, (view, file))| ColourViewReport {
            view: file.name.clone(),
            held_out: file.held_out,
            // Held-out views were not sampled for the blend.
            seen: if file.held_out {
                (mesh.positions.par_iter().zip(&scene.normals))
                    .filter(|(at, normal)| view.sample(**at, **normal, scene.two_sided).is_some())
                    .count()
            } else {
                statistics.counted[k][0]
            },
            outlier_vertices: statistics.counted[k][1],
            is_rejected: statistics.outlier_shares[k] > MAX_OUTLIER_FRACTION,
            // Also for held-out views: theirs is the only independent difference.
            rms: view.difference(mesh, |triangle, weights| match texture {
                Some(texture) => texture.at(triangle, weights),
                None => at_place(mesh, &coloured.colours, triangle, weights),
            }),
        })
        .collect()
}

/// Reads a view's picture and mask, and draws the mesh as it sees it.
fn colour_view(view: &ViewFile, mesh: &TriangleMesh, size: f64) -> Result<ColourView> {
    // Views without an image were filtered out before, so the path is never empty.
    let path = view.image.as_deref().unwrap_or(Path::new(""));
    let picture = read_picture(path)?;
    // The positions on the border are not used, so few of them are made.
    let mask = read_mask(view, 10.0)?;
    if let Some(mask) = &mask
        && (mask.columns, mask.rows) != (picture.columns, picture.rows)
    {
        return Err(Error::input(format!(
            "view `{}`: expected an image and a mask of the same size, found {} with {} × {} pixels and a \
             mask with {} × {}",
            view.name,
            path.display(),
            picture.columns,
            picture.rows,
            mask.columns,
            mask.rows
        )));
    }
    let mask = mask.as_ref().map(|mask| &mask.mask[..]);
    Ok(ColourView::new(view.camera, &picture, mask, mesh, size))
}
