//! `planish shell texture`.

use crate::common::{CommonArgs, short_help};
use crate::lines::{Align, Lines};
use crate::numbers::{count, significant};
use crate::summary::{self, Summary};
use clap::{Args, ValueEnum, ValueHint};
use planish::progress::Progress;
use planish::shell::texture::{ColourPlace, MAX_TEXTURE_SIZE, ShellTextureJob, ShellTextureReport};
use planish::{Job, Result};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish shell texture fitted.ply --views views.toml -o coloured.ply -o coloured.glb
  planish shell texture fitted.obj --views views.toml -o textured.obj -o textured.glb
  planish shell texture fitted.ply --views v.toml --colours texture -o t.glb

views.toml is that of `planish shell fit`: a table [[view]] for each image with K, R and t or P, and image = \
\"a.png\". A mask excludes the background. A view with held_out = true is used only for validation.

A view has more weight if it is perpendicular and has a high resolution. Hidden points and points at an \
outline get no colour from a view. A view that differs from the others is rejected. Points that no view sees \
are filled smoothly from their surroundings. The JSON object counts them. In PLY, `views` is the number of \
views of each vertex, 0 if it was filled.

PLY has red green blue from 0 to 255 as in the images; GLB has vertex colours in linear light. A texture \
uses the texture coordinates of the mesh, or an atlas of its triangles. sigma and observed are kept.";

/// Arguments of `planish shell texture`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish shell texture fitted.ply --views views.toml -o coloured.ply"),
          after_long_help = EXAMPLES)]
pub struct ShellTextureArgs {
    /// Mesh: .ply, .obj, .stl, .off or .glb
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    mesh: PathBuf,
    /// Cameras and their images (views.toml)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    views: PathBuf,
    /// Where colours are stored
    #[arg(long, value_enum, default_value_t = ColourPlaceName::Auto)]
    colours: ColourPlaceName,
    /// Width and height of the texture, in pixels [default: resolution of the images, at most 4096]
    #[arg(long, value_name = "PIXELS",
          value_parser = clap::value_parser!(u64).range(1..=MAX_TEXTURE_SIZE as u64))]
    texture_size: Option<u64>,
    /// Output file: .ply (vertices), .glb, .obj (texture); repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    output: Vec<PathBuf>,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Value of `--colours`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ColourPlaceName {
    /// Texture for .obj and for meshes with texture coordinates, else vertices
    Auto,
    /// Vertex colours
    Vertices,
    /// An image on the mesh
    Texture,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellTextureArgs) -> u8 {
    summary::run("shell texture", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellTextureArgs, progress: &dyn Progress) -> Result<Summary<ShellTextureReport>> {
    let job = ShellTextureJob {
        mesh: args.mesh.clone(),
        views: args.views.clone(),
        place: match args.colours {
            ColourPlaceName::Auto => ColourPlace::Auto,
            ColourPlaceName::Vertices => ColourPlace::Vertices,
            ColourPlaceName::Texture => ColourPlace::Texture,
        },
        texture_size: args.texture_size.map(|size| size as usize),
        outputs: args.output.clone(),
        unit: args.common.unit.map(Into::into),
    };
    let report = job.run(progress)?;
    Ok(Summary {
        text: text(&report),
        unit: report.unit,
        inputs: report.inputs.clone(),
        outputs: report.written.clone(),
        findings: report.findings.clone(),
        body: report,
    })
}

fn text(report: &ShellTextureReport) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Coloured {} vertices: {} from views, {} filled.",
        count(report.vertices),
        count(report.seen),
        count(report.filled)
    ));
    if let Some(texture) = &report.texture {
        lines.line(format!(
            "Texture of {0} × {0} pixels{1}: {2} lie on the mesh, {3} of them filled.",
            texture.size,
            if texture.atlas { " on an atlas of the triangles" } else { "" },
            count(texture.texels),
            // The report counts seen pixels; filled ones interest the user, because no image shows them.
            count(texture.texels - texture.seen)
        ));
    }
    lines.line(format!(
        "Colours of the same vertex differ between views by {} of 255 (σ).",
        significant(report.colour_sigma, 2)
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = (report.views.iter())
        .map(|view| {
            vec![
                match (view.held_out, view.is_rejected) {
                    // A held-out view takes no part, so it can be neither rejected nor counted as different.
                    (true, _) => format!("{} (held out)", view.view),
                    (_, true) => format!("{} (rejected)", view.view),
                    _ => view.view.clone(),
                },
                count(view.seen),
                match view.held_out {
                    true => String::new(),
                    false => count(view.outlier_vertices),
                },
                view.rms.map_or("–".to_owned(), |rms| significant(rms, 3)),
            ]
        })
        .collect();
    lines.table(
        &[
            ("view", Align::Left),
            ("vertices seen", Align::Right),
            ("differ", Align::Right),
            ("rms of 255", Align::Right),
        ],
        &rows,
    );
    lines.into_text()
}
