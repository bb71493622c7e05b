//! `planish shell texture`: the colours of a mesh, from calibrated pictures of the thing.
//!
//! Comes in: a mesh, maybe a fitted one with σ, and `views.toml` with pictures. Goes out: colours of vertices (PLY, GLB), or a texture on the mesh's own coordinates or on an atlas of its triangles (OBJ with MTL and PNG, GLB); how many views each vertex has its colour from, and how far the colours are from the pictures, in views held out as well.
//!
//! Each view is asked what it sees of a place (`view`), what they say becomes one colour (`blend`), and what none of them sees is filled (`fill`) and counted.
//!
//! Not guaranteed: that lights do not move: colours are those of the pictures, highlights and shadows among them. A vertex has the colour of one pixel's width about it, however far the next vertex is.

mod atlas;
mod blend;
mod fill;
mod view;

use super::fit::input::read_mask;
use super::looks::{Known, normals_of, write_glb, write_obj};
use super::surface::check_outputs;
use crate::progress::{Progress, WRITING_STAGE};
use atlas::{Chart, at_place};
use blend::{Blended, Saying};
use planish_estimate::{Error, Result};
use planish_exchange::glb::{PosedMesh, write_posed};
use planish_exchange::mesh::{Column, MeshColumns, write_mesh};
use planish_exchange::picture::{colour_png, read_picture};
use planish_exchange::textured::{TexturedMesh, read_textured};
use planish_exchange::views::{ViewFile, read_views};
use planish_exchange::{Unit, extension};
use planish_mesh::{BoundingBox, TriangleMesh};
use planish_report::colour::linear_light;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use view::ColourView;

/// A texture has at least so many pixels along a side, and at most, where nothing is said.
const USUAL_SIDES: [usize; 2] = [256, 4096];
/// The largest side of a texture.
pub const LARGEST_TEXTURE: usize = 8192;
/// A view that differs at more than this share of what others see as well is left out.
const ODD_VIEW: f64 = 0.5;

/// Where colours go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ColourPlace {
    /// Onto a texture where the mesh has texture coordinates, to the vertices where it has none.
    #[default]
    Auto,
    /// To the vertices.
    Vertices,
    /// Onto a texture, on an atlas of the triangles where the mesh has no texture coordinates.
    Texture,
}

/// What to do.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellTextureJob {
    /// The mesh.
    pub mesh: PathBuf,
    /// Cameras and pictures.
    pub views: PathBuf,
    /// Where colours go.
    pub place: ColourPlace,
    /// Pixels along a side of the texture; about as fine as the pictures where none are given.
    pub texture_size: Option<usize>,
    /// Files to write.
    pub outputs: Vec<PathBuf>,
    /// The unit where no file names it.
    pub unit: Option<Unit>,
}

/// What a view gave.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ColourViewReport {
    /// Its name.
    pub view: String,
    /// Whether it only judges.
    pub held_out: bool,
    /// Vertices that it sees.
    pub seen: usize,
    /// Those where it differs too much from other views to take part.
    pub odd: usize,
    /// Whether it differs so often that it took no part at all.
    pub left_out: bool,
    /// Root mean square difference of its picture from the colours that were made, from 0 to 255, over the pixels of the mesh away from its outlines.
    pub rms: Option<f64>,
}

/// A texture that was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TextureReport {
    /// Pixels in a row, and rows.
    pub size: usize,
    /// Pixels that lie on the mesh.
    pub texels: usize,
    /// Those of them whose colour a view saw; all others were filled.
    pub seen: usize,
    /// Whether an atlas of the triangles was made for it.
    pub atlas: bool,
}

/// What came of it.
#[derive(Debug, Clone, Serialize)]
pub struct ShellTextureReport {
    /// Unit of lengths.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Vertices of the mesh.
    pub vertices: usize,
    /// Vertices that a view sees.
    pub seen: usize,
    /// Vertices that none sees, whose colours were filled.
    pub filled: usize,
    /// σ of a colour as views state it, from 0 to 255: by how much they differ where three or more see a vertex.
    pub colour_sigma: f64,
    /// The texture, where one was made.
    pub texture: Option<TextureReport>,
    /// The views.
    pub views: Vec<ColourViewReport>,
    /// Files read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Files written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
    /// What a user should know.
    pub warnings: Vec<String>,
    /// `converged`.
    pub termination: &'static str,
}

/// Colours of the vertices.
struct Coloured {
    colours: Vec<[f64; 3]>,
    /// From how many views; zero where they were filled.
    views: Vec<u8>,
}

/// A texture.
struct Texture {
    chart: Chart,
    size: usize,
    pixels: Vec<[f32; 3]>,
    report: TextureReport,
}

/// Colours a mesh, and writes what was asked for.
///
/// Cost: for each vertex or pixel of the texture a look into each view's depth; a depth buffer of each view.
///
/// # Errors
/// `Io` where a file cannot be read or written; `Input` for meshes without faces, views without pictures, masks of another size than their picture, a texture too small for an atlas; `Undetermined` where no view sees any vertex. Outputs are checked before the work.
pub fn shell_texture_files(job: &ShellTextureJob, progress: &dyn Progress) -> Result<ShellTextureReport> {
    let inputs = [job.mesh.clone(), job.views.clone()];
    let good = |path: &Path| match extension(path).as_str() {
        "ply" => true,
        "glb" | "obj" => job.place != ColourPlace::Vertices || extension(path) == "glb",
        _ => false,
    };
    let needed = match job.place {
        ColourPlace::Vertices => ".ply or .glb for colours of vertices",
        _ => ".ply, .glb, or .obj (with a texture)",
    };
    check_outputs(&job.outputs, &inputs, good, needed)?;
    progress.check("reading", 0.0)?;
    let mut warnings = Vec::new();
    let (file, scene) = read(job, progress, &mut warnings)?;
    progress.check("blending", 0.5)?;
    let Answers {
        asked,
        said,
        coloured,
        seen,
    } = ask(job, &scene)?;
    let wanted = match job.place {
        ColourPlace::Texture => true,
        ColourPlace::Vertices => false,
        ColourPlace::Auto => !file.uv_triangles.is_empty() || job.outputs.iter().any(|path| extension(path) == "obj"),
    };
    let texture = if wanted {
        progress.check("painting", 0.6)?;
        let of = |at, normal| blend::blend(&scene.look(&asked, at, normal), said.sigma).map(|b| b.colour);
        let chosen: Vec<&ColourView> = asked.iter().map(|k| &scene.views[*k]).collect();
        Some(paint(job, &file, &scene, &coloured, &chosen, &of, &mut warnings)?)
    } else {
        None
    };
    progress.check("judging", 0.8)?;
    let reports = judge(&scene, &said, &coloured, texture.as_ref());
    for view in reports.iter().filter(|view| view.left_out) {
        warnings.push(format!(
            "view `{}` differs from the others at {} of the {} vertices that it sees, and was left out: its picture or its camera may be another's",
            view.view, view.odd, view.seen
        ));
    }
    progress.check(WRITING_STAGE, 0.9)?;
    let mut written = Vec::new();
    for path in &job.outputs {
        written.extend(write(path, &file, &coloured, texture.as_ref())?);
    }
    let mut all = inputs.to_vec();
    all.extend(scene.files);
    all.dedup();
    Ok(ShellTextureReport {
        unit: scene.unit,
        vertices: scene.mesh.positions.len(),
        seen,
        filled: scene.mesh.positions.len() - seen,
        colour_sigma: said.sigma,
        texture: texture.map(|texture| texture.report),
        views: reports,
        inputs: all,
        written,
        warnings,
        termination: "converged",
    })
}

/// The mesh as the cameras measure it, and what they see.
struct Scene {
    mesh: TriangleMesh,
    normals: Vec<[f64; 3]>,
    /// Whether its facets are turned both ways.
    two_sided: bool,
    /// The unit of the cameras.
    unit: Option<Unit>,
    /// Views with a picture, and what they see.
    pictured: Vec<ViewFile>,
    views: Vec<ColourView>,
    /// Further files that were read.
    files: Vec<PathBuf>,
}

impl Scene {
    /// What some views say of a place.
    fn look(&self, asked: &[usize], at: [f64; 3], normal: [f64; 3]) -> Vec<Saying> {
        let say = |k: &usize| {
            self.views[*k].glimpse(at, normal, self.two_sided).map(|found| Saying {
                view: *k,
                colour: found.colour,
                weight: found.weight,
            })
        };
        asked.iter().filter_map(say).collect()
    }
}

/// Reads the mesh and the views, and draws the mesh as each of them sees it.
fn read(job: &ShellTextureJob, progress: &dyn Progress, warnings: &mut Vec<String>) -> Result<(TexturedMesh, Scene)> {
    let mut file = read_textured(&job.mesh)?;
    warnings.append(&mut file.warnings);
    if file.triangles.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: has no faces: only a surface hides what lies behind it",
            job.mesh.display()
        )));
    }
    let read = read_views(&job.views)?;
    file.unit = file.unit.or(job.unit);
    let by = match (file.unit, read.unit) {
        (Some(own), Some(theirs)) => own.millimetres() / theirs.millimetres(),
        _ => 1.0,
    };
    let points = file.points.iter().map(|p| p.map(|x| by * x)).collect();
    let mesh = TriangleMesh::try_new(points, file.triangles.clone()).map_err(|e| e.in_context(job.mesh.display()))?;
    let two_sided = !mesh.check().oriented;
    if two_sided {
        warnings.push(format!(
            "{}: its facets are not all turned the same way: what is thin may take colours from its other side",
            job.mesh.display()
        ));
    }
    let count = read.views.len();
    let pictured: Vec<ViewFile> = (read.views.into_iter()).filter(|view| view.image.is_some()).collect();
    if !pictured.iter().any(|view| !view.held_out) {
        return Err(Error::input(format!(
            "{}: needed a view with `image = \"...\"` that is not held out, found none of {count}",
            job.views.display()
        )));
    }
    progress.check("looking", 0.1)?;
    let size = BoundingBox::of(&mesh.positions).map_or(0.0, |bounds| bounds.diagonal());
    let views = (pictured.par_iter())
        .map(|view| colour_view(view, &mesh, size))
        .collect::<Result<_>>()?;
    let mut files = std::mem::take(&mut file.files);
    files.extend(read.files);
    files.extend(
        pictured
            .iter()
            .flat_map(|view| view.image.iter().chain(&view.mask).cloned()),
    );
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

/// What all views said of the vertices, before any was left out.
struct Said {
    /// σ of a colour, by those that were asked in the end.
    sigma: f64,
    /// For each view the vertices that it sees, and those where it is odd.
    counted: Vec<[usize; 2]>,
    /// The share of what others see as well at which each is odd.
    odd: Vec<f64>,
}

/// Colours of the vertices, and whose they are.
struct Answers {
    /// Views that take part.
    asked: Vec<usize>,
    said: Said,
    coloured: Coloured,
    /// Vertices that a view sees.
    seen: usize,
}

/// Asks the views that are not held out for the colours of the vertices, and again without those that are odd too often.
fn ask(job: &ShellTextureJob, scene: &Scene) -> Result<Answers> {
    let (mesh, count) = (&scene.mesh, scene.views.len());
    let ask = |asked: &[usize]| {
        let said: Vec<Vec<Saying>> = (mesh.positions.par_iter().zip(&scene.normals))
            .map(|(at, normal)| scene.look(asked, *at, *normal))
            .collect();
        let sigma = blend::scale(said.iter().map(|s| &s[..]));
        let blended: Vec<Option<Blended>> = said.par_iter().map(|s| blend::blend(s, sigma)).collect();
        (said, sigma, blended)
    };
    let mut asked: Vec<usize> = (0..count).filter(|k| !scene.pictured[*k].held_out).collect();
    let (said, mut sigma, mut blended) = ask(&asked);
    let counted = (0..count)
        .map(|k| {
            let seen = said.iter().filter(|s| s.iter().any(|one| one.view == k)).count();
            [seen, blended.iter().flatten().filter(|b| b.odd.contains(&k)).count()]
        })
        .collect();
    let odd = blend::odd_shares(count, &said, &blended);
    drop(said);
    let all_asked = asked.len();
    asked.retain(|k| odd[*k] <= ODD_VIEW);
    if asked.len() < all_asked {
        (_, sigma, blended) = ask(&asked);
    }
    let seen = blended.iter().flatten().count();
    if seen == 0 {
        return Err(Error::undetermined(format!(
            "{}: no view sees any of the {} vertices: needed cameras that look at the mesh, in its unit and frame",
            job.views.display(),
            mesh.positions.len()
        )));
    }
    let known: Vec<Option<[f64; 3]>> = blended.iter().map(|b| b.as_ref().map(|b| b.colour)).collect();
    let coloured = Coloured {
        colours: fill::on_mesh(mesh, &known),
        views: (blended.iter())
            .map(|b| b.as_ref().map_or(0, |b| b.views.clamp(1, 255) as u8))
            .collect(),
    };
    Ok(Answers {
        asked,
        said: Said { sigma, counted, odd },
        coloured,
        seen,
    })
}

/// How far the pictures of all views are from the colours that were made.
fn judge(scene: &Scene, said: &Said, coloured: &Coloured, texture: Option<&Texture>) -> Vec<ColourViewReport> {
    let mesh = &scene.mesh;
    (scene.views.iter().zip(&scene.pictured).enumerate())
        .map(|(k, (view, file))| ColourViewReport {
            view: file.name.clone(),
            held_out: file.held_out,
            seen: if file.held_out {
                (mesh.positions.par_iter().zip(&scene.normals))
                    .filter(|(at, normal)| view.glimpse(**at, **normal, scene.two_sided).is_some())
                    .count()
            } else {
                said.counted[k][0]
            },
            odd: said.counted[k][1],
            left_out: said.odd[k] > ODD_VIEW,
            rms: view.difference(mesh, |triangle, weights| match texture {
                Some(texture) => texture.at(triangle, weights),
                None => at_place(mesh, &coloured.colours, triangle, weights),
            }),
        })
        .collect()
}

/// Reads a view's picture and mask, and draws the mesh as it sees it.
fn colour_view(view: &ViewFile, mesh: &TriangleMesh, size: f64) -> Result<ColourView> {
    let path = view.image.as_deref().unwrap_or(Path::new(""));
    let picture = read_picture(path)?;
    // Places on the border are not asked for.
    let mask = read_mask(view, 10.0)?;
    if let Some(mask) = &mask
        && (mask.columns, mask.rows) != (picture.columns, picture.rows)
    {
        return Err(Error::input(format!(
            "view `{}`: its picture {} has {} × {} pixels, and its mask {} × {}: needed the same",
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

/// The side of a texture with as many pixels on the mesh as the finest view of each triangle has.
fn usual_size(mesh: &TriangleMesh, views: &[&ColourView], share: f64) -> usize {
    let pixels: f64 = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let corners = mesh.corners(t);
            views.iter().map(|view| view.pixels_on(corners)).fold(0.0, f64::max)
        })
        .collect::<Vec<f64>>()
        .iter()
        .sum();
    let side = (pixels / share.max(1e-3)).sqrt().min(LARGEST_TEXTURE as f64) as usize;
    side.next_power_of_two().clamp(USUAL_SIDES[0], USUAL_SIDES[1])
}

/// Paints a texture: each of its pixels by what views see of its place on the mesh.
fn paint(
    job: &ShellTextureJob,
    file: &TexturedMesh,
    scene: &Scene,
    coloured: &Coloured,
    views: &[&ColourView],
    seen: &(dyn Fn([f64; 3], [f64; 3]) -> Option<[f64; 3]> + Sync),
    warnings: &mut Vec<String>,
) -> Result<Texture> {
    let (mesh, normals) = (&scene.mesh, &scene.normals[..]);
    let own = Chart::of(file);
    let count = mesh.triangles.len();
    let share = own.as_ref().map_or_else(|| atlas::atlas_share(count), Chart::covered);
    let atlas = own.is_none();
    let least = if atlas {
        atlas::LEAST_SQUARE * atlas::squares_along(count)
    } else {
        1
    };
    let usual = || usual_size(mesh, views, share).max(least.next_power_of_two());
    let size = job.texture_size.unwrap_or_else(usual);
    if size < least || size > LARGEST_TEXTURE {
        return Err(Error::input(format!(
            "a texture of {count} triangles takes {least} pixels along a side or more, and {LARGEST_TEXTURE} are the most, found {size}: needed another size, a coarser mesh, or colours of vertices"
        )));
    }
    let chart = own.unwrap_or_else(|| Chart::atlas(count, size));
    match chart.outside() {
        0 => {}
        n => warnings.push(format!(
            "{}: {n} of {count} triangles have no texture coordinates or reach out of the picture: they get no colours of their own",
            job.mesh.display()
        )),
    }
    let drawn = chart.drawn(size, size);
    // Colour, and whether a view saw it.
    let found: Vec<Option<([f64; 3], bool)>> = (0..size * size)
        .into_par_iter()
        .map(|k| {
            let on = drawn.at(k % size, k / size)?;
            let place = |values: &[[f64; 3]]| at_place(mesh, values, on.triangle, on.barycentric);
            let normal = planish_estimate::vector3::unit(place(normals)).unwrap_or([0.0; 3]);
            Some(match seen(place(&mesh.positions), normal) {
                Some(colour) => (colour, true),
                None => (place(&coloured.colours), false),
            })
        })
        .collect();
    let texels = found.iter().flatten().count();
    let covered = chart.covered() * (size * size) as f64;
    if covered > 1.1 * texels as f64 + 1000.0 {
        warnings.push(format!(
            "{}: parts of the mesh share the same place of the texture, and show the colours of one of them",
            job.mesh.display()
        ));
    }
    let report = TextureReport {
        size,
        texels,
        seen: found.iter().flatten().filter(|(_, seen)| *seen).count(),
        atlas,
    };
    let mut pixels: Vec<Option<[f32; 3]>> = (found.into_iter())
        .map(|found| found.map(|(colour, _)| colour.map(|c| c as f32)))
        .collect();
    fill::in_picture(size, size, &mut pixels);
    Ok(Texture {
        chart,
        size,
        pixels: pixels.into_iter().map(Option::unwrap_or_default).collect(),
        report,
    })
}

impl Texture {
    /// The colour at a place of a triangle, between the middles of pixels.
    fn at(&self, triangle: u32, weights: [f64; 3]) -> [f64; 3] {
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

    fn png(&self) -> Result<Vec<u8>> {
        let bytes: Vec<u8> = self.pixels.iter().flatten().map(|v| v.round() as u8).collect();
        colour_png([self.size; 2], &bytes)
    }
}

/// Writes one file, and what belongs to it.
fn write(path: &Path, file: &TexturedMesh, coloured: &Coloured, texture: Option<&Texture>) -> Result<Vec<PathBuf>> {
    let stated = |name: &str| file.columns.iter().find(|(n, _)| n == name).map(|(_, c)| &c[..]);
    let sigma = stated("sigma").unwrap_or_default();
    let observed: Vec<u8> = (stated("observed").unwrap_or_default().iter())
        .map(|mark| mark.clamp(0.0, 255.0) as u8)
        .collect();
    let known = Known {
        sigma,
        observed: &observed,
    };
    let normals = normals_of(&file.points, &file.triangles);
    match (extension(path).as_str(), texture) {
        ("ply", _) => {
            let channel = |c: usize| -> Vec<u8> { coloured.colours.iter().map(|v| v[c].round() as u8).collect() };
            let [red, green, blue] = [0, 1, 2].map(channel);
            let mut columns = Vec::new();
            if !sigma.is_empty() {
                columns.push(("sigma", Column::F64(sigma)));
            }
            if !observed.is_empty() {
                columns.push(("observed", Column::U8(&observed)));
            }
            columns.extend([("red", &red), ("green", &green), ("blue", &blue)].map(|(n, c)| (n, Column::U8(c))));
            columns.push(("views", Column::U8(&coloured.views)));
            write_mesh(
                path,
                &MeshColumns {
                    points: &file.points,
                    normals: Some(&normals),
                    columns,
                    triangles: &file.triangles,
                    unit: file.unit,
                },
            )?;
        }
        (_, None) => {
            // glTF has linear light from 0 to 1.
            let linear = |value: f64| linear_light((value / 255.0).clamp(0.0, 1.0));
            let colours: Vec<[f64; 3]> = coloured.colours.iter().map(|c| c.map(linear)).collect();
            write_posed(
                path,
                &PosedMesh {
                    points: &file.points,
                    normals: &normals,
                    triangles: &file.triangles,
                    colours: &colours,
                    sigma,
                    observed: &observed,
                    unit: file.unit,
                    ..PosedMesh::default()
                },
            )?;
        }
        (ending, Some(texture)) => {
            let painted = TexturedMesh {
                uv: texture.chart.uv.clone(),
                uv_triangles: texture.chart.triangles.clone(),
                ..file.clone()
            };
            let png = texture.png()?;
            if ending == "obj" {
                return write_obj(path, &painted, &file.points, Some(&png));
            }
            write_glb(path, &painted, &file.points, &[], &[], known, Some(&png))?;
        }
    }
    Ok(vec![path.to_owned()])
}
