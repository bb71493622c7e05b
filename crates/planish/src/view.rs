//! Shows a file as an image, without a window or a graphics card, or as a page for a browser.
//!
//! Input: a model, a mesh, points or scans, and a camera. Output: a PNG with a legend ([`PictureJob`]), or
//! HTML ([`view_page`]). The bytes do not depend on the number of threads.
//!
//! Not guaranteed: images of different versions may differ in the last bit.

mod camera;
mod canvas;
mod legend;
mod own_colours;
mod shading;
mod viewed_content;

pub(crate) use camera::Camera;
pub use camera::{CameraAngles, Up};
use planish_core::finding::with_warnings;
use planish_core::{DVec3, Finding, FindingCode, Setting};
pub use viewed_content::ViewedFile;

use crate::job::Job;
use crate::report::ReportOutput;
use crate::report::words::head;
use camera::{Frame, axes_at, axes_from};
use canvas::Canvas;
use legend::Legend;
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::picture::write_colour_png;
use planish_exchange::{Unit, extension};
use planish_report::colour::{Colour, Scale, UNKNOWN, colour_of_number, screen_brightness};
use planish_report::{Block, Field, Figure, Page, Section, Values};
use serde::Serialize;
use shading::{Pixel, Shape, draw};
use std::path::{Path, PathBuf};
use viewed_content::ViewedContent;

/// Maximum number of triangles of a model in a picture.
const PICTURE_TRIANGLES: u64 = 600_000;
/// Maximum number of triangles of a model on a page, which must still load quickly when it is mailed.
const PAGE_TRIANGLES: u64 = 45_000;
/// Maximum number of points on a page. They are part of the one file that a page is.
const PAGE_POINTS: usize = 400_000;
/// Maximum number of pixels of a picture: about 26 GB of memory at 400 bytes each.
const MAX_PIXELS: usize = 64_000_000;
/// Free border of a picture, as a fraction of its shorter side.
const BORDER: f64 = 0.05;
/// Width of dots relative to their mean distance in the picture. Smaller dots show the background between
/// them; larger ones hide detail. The width in pixels stays within [`DOT_WIDTHS`].
const DOT_WIDTH: f64 = 1.5;
const DOT_WIDTHS: [f64; 2] = [1.4, 9.0];
/// Colour of an object without values.
const CLAY: Colour = [0.84, 0.83, 0.80];
/// Background colours at the top and at the bottom.
const PAPER: [Colour; 2] = [[0.976, 0.978, 0.974], [0.918, 0.924, 0.922]];
/// Default camera angles if `up` is given. Reports use the same.
const DEFAULT_ANGLES: CameraAngles = CameraAngles { azimuth_deg: 36.25, elevation_deg: 28.27, zoom: 1.0 };

/// The quantity that colours a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourBy {
    /// A field of the scene, by its key.
    Field(&'static str),
    /// The direction of the normal, as the camera sees it.
    Normal,
    /// One colour.
    Plain,
}

/// How a picture is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureOptions {
    /// View direction and zoom (default: the view of reports).
    pub camera: Option<CameraAngles>,
    /// Up axis (default: z).
    pub up: Option<Up>,
    /// Coloured quantity. Default: the deviation if there is one, otherwise σ, otherwise the kind of each
    /// part.
    pub colour: Option<ColourBy>,
    /// Columns and rows.
    pub size: [usize; 2],
}

impl Default for PictureOptions {
    fn default() -> Self {
        Self { camera: None, up: None, colour: None, size: [1280, 960] }
    }
}

/// The figures of a picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureReport {
    /// Unit of every length, if known.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Files that were read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// One sentence about the contents of the file.
    pub what: String,
    /// Coloured quantity: the key of a field, `normal` or `plain`.
    pub color: String,
    /// Values of the first and of the last colour, in the unit of the file; none for categories.
    pub color_range: Option<[f64; 2]>,
    /// Unit of the values, such as `mm` or `1/mm²`; empty if unknown.
    pub color_unit: String,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Share of the picture that the object covers.
    pub covered: f64,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

/// A file drawn as a PNG.
///
/// Cost: nine samples and 48 neighbours per pixel; 1.6 s of processor time for 1280 × 960 pixels and 86 000
/// triangles. Memory: about 400 bytes per pixel.
///
/// # Examples
/// ```no_run
/// use planish::Job;
/// use planish::view::{PictureJob, PictureOptions, ViewedFile};
/// let job = PictureJob {
///     viewed: ViewedFile { file: "part.ply".into(), ..ViewedFile::default() },
///     options: PictureOptions { camera: Some("iso".parse()?), ..PictureOptions::default() },
///     output: "part.png".into(),
/// };
/// job.run(&planish::progress::Silent)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct PictureJob {
    /// The file and its reading options.
    pub viewed: ViewedFile,
    /// How the picture is made.
    pub options: PictureOptions,
    /// The `.png` file.
    pub output: PathBuf,
}

impl Job for PictureJob {
    type Report = PictureReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok([&self.viewed.file].into_iter().chain(&self.viewed.reference).cloned().collect())
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        if extension(&self.output) != "png" {
            return Err(Error::unsupported(format!(
                "{}: cannot write this format: expected .png (an image) or .html (a page)",
                self.output.display()
            )));
        }
        Ok(vec![self.output.clone()])
    }

    fn execute(&self, progress: &dyn Progress) -> Result<PictureReport> {
        draw_picture(&self.viewed, &self.options, &self.output, progress)
    }
}

fn draw_picture(
    viewed: &ViewedFile,
    options: &PictureOptions,
    path: &Path,
    progress: &dyn Progress,
) -> Result<PictureReport> {
    let [columns, rows] = options.size;
    // Checked before reading: a typing error in the size must not exhaust the memory.
    if columns.saturating_mul(rows) > MAX_PIXELS || columns == 0 || rows == 0 {
        return Err(Error::input(format!(
            "expected an image of 1 to {} million pixels, found {columns} × {rows}",
            MAX_PIXELS / 1_000_000
        )));
    }
    // A picture keeps its points: their number does not change the size of the file.
    let content = ViewedContent::read(viewed, PICTURE_TRIANGLES, usize::MAX, progress)?;
    progress.check("drawing", 0.5)?;
    let drawn = drawn(&content, options).map_err(|e| e.in_context(viewed.file.display()))?;
    progress.check(WRITING_STAGE, 0.9)?;
    write_colour_png(path, options.size, &drawn.canvas.bytes())?;
    let mut findings = content.findings;
    // A warning, because the file itself may be correct.
    if drawn.covered <= 0.0 {
        findings.push(Finding::new(
            FindingCode::PictureEmpty,
            "the image is empty: the object has no extent, or is seen edge-on",
        ));
    }
    Ok(PictureReport {
        unit: content.unit,
        inputs: content.inputs.into_iter().map(|(path, _)| path).collect(),
        what: content.headline,
        color: drawn.key,
        color_range: drawn.range,
        color_unit: drawn.unit,
        size: options.size,
        covered: drawn.covered,
        findings,
    })
}

/// A page that shows a file; [`ReportOutput::write_text`] writes it.
///
/// # Errors
/// As [`PictureJob`].
pub fn view_page(viewed: &ViewedFile, output: &ReportOutput, progress: &dyn Progress) -> Result<ViewedPage> {
    let content = ViewedContent::read(viewed, PAGE_TRIANGLES, PAGE_POINTS, progress)?;
    progress.check("drawing", 0.5)?;
    let mut page = Page {
        job: "view".to_owned(),
        title: crate::report::file_name(&viewed.file),
        headline: content.headline.clone(),
        figures: vec![Figure::new("size", content.size(), "of its box")],
        ..Page::default()
    };
    if !content.findings.is_empty() {
        let blocks = content.findings.iter().map(|f| Block::Text(f.text.clone())).collect();
        page.sections.push(Section::new("Findings", blocks));
    }
    page.scene = Some(content.scene);
    page.sections.push(output.provenance(&content.inputs)?);
    Ok(ViewedPage {
        html: page.html().map_err(|e| Error::input("the page could not be rendered").with_source(e))?,
        what: content.headline,
        unit: content.unit,
        inputs: content.inputs.into_iter().map(|(path, _)| path).collect(),
        findings: content.findings,
    })
}

/// A page of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewedPage {
    /// The page.
    pub html: String,
    /// One sentence about the contents of the file.
    pub what: String,
    /// Unit of every length, if known.
    pub unit: Option<Unit>,
    /// Files that were read.
    pub inputs: Vec<PathBuf>,
    /// Findings for the user.
    pub findings: Vec<Finding>,
}

/// A finished picture.
struct Drawn {
    canvas: Canvas,
    key: String,
    range: Option<[f64; 2]>,
    unit: String,
    covered: f64,
}

fn drawn(content: &ViewedContent, options: &PictureOptions) -> Result<Drawn> {
    let [columns, rows] = options.size;
    let field = chosen_field(content, options.colour)?;
    // One scale for all objects of the picture, as the legend shows one only.
    let scale = field.map(Scale::from_field);
    let places = content.places();
    let border = BORDER * rows.min(columns) as f64;
    let frame = Frame {
        low: [border; 2],
        // The legend lies below the object, never over it.
        high: [columns as f64 - border, rows as f64 - border.max(legend::height(options.size))],
    };
    let axes = match (options.camera, options.up) {
        // Without a request, the view is that of the report, so that both show the same side.
        (None, None) => {
            let (from, up) = content.scene.view();
            axes_from(from, up)?
        }
        (camera, up) => axes_at(&camera.unwrap_or(DEFAULT_ANGLES), up.unwrap_or_default()),
    };
    let zoom = options.camera.map_or(1.0, |camera| camera.zoom);
    let camera = Camera::from_points(&places, axes, frame, zoom)?;
    let by_normal = options.colour == Some(ColourBy::Normal);
    let pixels = pixels(content, field, scale.as_ref(), by_normal, &camera, options.size);
    let covered = pixels.iter().map(|p| p.covered).sum::<f64>() / pixels.len().max(1) as f64;
    let mut canvas = Canvas::new(columns, rows, on_paper(&pixels, columns))?;
    let title = match field {
        Some(field) => with_unit(field),
        None if by_normal => "normals: red is right, green is up, blue is towards the camera".to_owned(),
        None => String::new(),
    };
    let legend = Legend { title, size: content.size(), scale };
    legend::draw(&mut canvas, &legend, &camera);
    Ok(Drawn {
        canvas,
        key: field.map_or(if by_normal { "normal" } else { "plain" }.to_owned(), |f| f.key.clone()),
        range: match &legend.scale {
            Some(Scale::Range(range)) => Some([range.low, range.high]),
            _ => None,
        },
        unit: field.map_or(String::new(), |f| f.unit.clone()),
        covered,
    })
}

fn with_unit(field: &Field) -> String {
    let unit = field.shown.as_ref().map_or(&field.unit, |(unit, _)| unit);
    head(&field.label, unit)
}

/// Fields of the first surface, or of the first point cloud if there is none, followed by those of a
/// reference's points.
fn fields(content: &ViewedContent) -> impl Iterator<Item = &Field> {
    // Hidden objects are not drawn, so their fields cannot colour the picture.
    let surfaces = content.scene.surfaces.iter().filter(|s| !s.hidden).flat_map(|s| &s.fields);
    let clouds = content.scene.clouds.iter().filter(|c| !c.hidden).flat_map(|c| &c.fields);
    surfaces.chain(clouds)
}

/// The field that colours a picture; none for normals and for one colour.
fn chosen_field(content: &ViewedContent, colour: Option<ColourBy>) -> Result<Option<&Field>> {
    let find = |key: &str| fields(content).find(|field| field.key == key);
    match colour {
        // The most specific field first: deviations exist only if a reference was given.
        None => Ok((find("deviation").or_else(|| find("sigma")).or_else(|| find("rgb")))
            .or_else(|| fields(content).next())),
        Some(ColourBy::Plain) => Ok(None),
        Some(ColourBy::Normal) => {
            let has_surface = content.scene.surfaces.iter().any(|s| !s.hidden);
            if has_surface || content.normals.is_some() {
                Ok(None)
            } else {
                Err(Error::input("expected points with normals to colour by, found none"))
            }
        }
        Some(ColourBy::Field(key)) => match find(key) {
            Some(field) => Ok(Some(field)),
            None => {
                // The usual reason: the user forgot the reference.
                let needs_reference = key == "deviation";
                let way_out = if needs_reference { "; specify a reference" } else { "" };
                let mut known: Vec<String> = fields(content).map(|f| f.key.replace('_', "-")).collect();
                known.push("plain".to_owned());
                let error = Error::input(format!(
                    "expected the field {} to colour by, found {}{way_out}",
                    key.replace('_', " "),
                    known.join(", ")
                ));
                Err(if needs_reference { error.with_setting(Setting::Reference) } else { error })
            }
        },
    }
}

/// Draws the initial view of an object. Objects without the field are drawn in clay colour.
fn pixels(
    content: &ViewedContent,
    field: Option<&Field>,
    scale: Option<&Scale>,
    by_normal: bool,
    camera: &Camera,
    size: [usize; 2],
) -> Vec<Pixel> {
    let values_of = |fields: &[Field]| -> Option<Vec<f64>> {
        let values = &fields.iter().find(|f| field.is_some_and(|wanted| wanted.key == f.key))?.values;
        Some(match values {
            Values::Numbers(numbers) => numbers.clone(),
            Values::Kinds(kinds) => kinds.iter().map(|k| f64::from(*k)).collect(),
        })
    };
    let are_kinds = matches!(scale, Some(Scale::Kinds(_)));
    let surfaces: Vec<_> = content.scene.surfaces.iter().filter(|s| !s.hidden).collect();
    let clouds: Vec<_> = content.scene.clouds.iter().filter(|c| !c.hidden).collect();
    let surface_values: Vec<Option<Vec<f64>>> = surfaces.iter().map(|s| values_of(&s.fields)).collect();
    let cloud_values: Vec<Option<Vec<f64>>> = clouds.iter().map(|c| values_of(&c.fields)).collect();
    let of_surface: Vec<_> = (surfaces.iter().zip(&surface_values))
        .map(|(surface, values)| {
            move |triangle: usize, weights: [f64; 3]| match (values, scale) {
                (Some(_), Some(Scale::Own)) if content.texture.is_some() => {
                    let texture = content.texture.as_ref();
                    texture.and_then(|texture| texture.colour(triangle, weights)).unwrap_or(CLAY)
                }
                (Some(values), Some(Scale::Own)) => {
                    let corners = surface.triangles[triangle].map(|k| colour_of_number(values[k as usize]));
                    std::array::from_fn(|c| (0..3).map(|k| weights[k] * corners[k][c]).sum())
                }
                (Some(values), Some(scale)) => {
                    let corners = surface.triangles[triangle].map(|k| values[k as usize]);
                    // Kinds are not interpolated: between kinds 1 and 3 there is no kind 2.
                    scale.colour(if are_kinds {
                        let nearest = (0..3)
                            .fold(0, |nearest, k| if weights[k] > weights[nearest] { k } else { nearest });
                        corners[nearest]
                    } else {
                        (0..3).map(|k| weights[k] * corners[k]).sum()
                    })
                }
                _ => CLAY,
            }
        })
        .collect();
    let of_cloud: Vec<_> = (cloud_values.iter())
        .map(|values| {
            move |dot: usize| match (values, scale) {
                (Some(values), Some(scale)) => scale.colour(values[dot]),
                // A cloud without the field is drawn as unknown beside those that have it.
                (None, Some(_)) => UNKNOWN,
                _ => CLAY,
            }
        })
        .collect();
    let mut shapes: Vec<Shape<'_>> = (surfaces.iter().zip(&of_surface))
        .map(|(surface, colour)| Shape::Surface {
            positions: &surface.positions,
            triangles: &surface.triangles,
            colour: (!by_normal).then_some(colour as _),
        })
        .collect();
    for (k, cloud) in clouds.iter().enumerate() {
        let colour = &of_cloud[k];
        shapes.push(Shape::Dots {
            positions: &cloud.positions,
            // Only the first cloud has normals; others are lit evenly.
            normals: content.normals.as_deref().filter(|_| k == 0),
            colour: (!by_normal).then_some(colour as _),
            width: dot_width(&cloud.positions, camera, size),
        });
    }
    draw(&shapes, camera, size)
}

/// Width of dots so that dots of a surface seen from the front nearly touch.
fn dot_width(positions: &[DVec3], camera: &Camera, [columns, rows]: [usize; 2]) -> f64 {
    // The fraction of occupied cells of a coarse grid estimates the area covered by dots.
    const CELLS: usize = 96;
    let cell = [columns, rows].map(|n| n as f64 / CELLS as f64);
    let mut filled = vec![false; CELLS * CELLS];
    let mut inside = 0_usize;
    for p in positions {
        let at = camera.project(*p).at;
        let [x, y] = [0, 1].map(|k| at[k] / cell[k]);
        if (0.0..CELLS as f64).contains(&x) && (0.0..CELLS as f64).contains(&y) {
            filled[y as usize * CELLS + x as usize] = true;
            inside += 1;
        }
    }
    let area = filled.iter().filter(|f| **f).count() as f64 * cell[0] * cell[1];
    // The limits are those of 960 rows and shrink with the picture, but not below half, where dots would
    // vanish.
    let [min, max] = DOT_WIDTHS.map(|w| w * rows.max(480) as f64 / 960.0);
    (DOT_WIDTH * (area / inside.max(1) as f64).sqrt()).clamp(min, max)
}

/// Pixels over the background, in screen colours.
fn on_paper(pixels: &[Pixel], columns: usize) -> Vec<Colour> {
    use planish_report::colour::linear_light;
    let rows = pixels.len() / columns.max(1);
    let paper = |row: usize| -> Colour {
        // Colours are stated as screen values; mixing needs linear light.
        let share = row as f64 / rows.max(1) as f64;
        std::array::from_fn(|c| linear_light(PAPER[0][c] + share * (PAPER[1][c] - PAPER[0][c])))
    };
    (pixels.iter().enumerate())
        .map(|(k, pixel)| {
            let behind = paper(k / columns);
            std::array::from_fn(|c| {
                // Coverage mixes light, not screen values. Otherwise outlines would be too dark.
                let light = pixel.covered * pixel.light[c] + (1.0 - pixel.covered) * behind[c];
                screen_brightness(light)
            })
        })
        .collect()
}
