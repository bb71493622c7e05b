//! `planish shell texture`.

use crate::args::CommonArgs;
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use clap::{Args, ValueEnum, ValueHint};
use planish::Job;
use planish::Result;
use planish::progress::Progress;
use planish::shell::texture::{ColourPlace, LARGEST_TEXTURE, ShellTextureJob, ShellTextureReport};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish shell texture fitted.ply --views views.toml -o coloured.ply -o coloured.glb
  planish shell texture fitted.obj --views views.toml -o textured.obj -o textured.glb
  planish shell texture fitted.ply --views v.toml --colours texture -o t.glb

views.toml is that of `planish shell fit`: a table [[view]] for each picture with K, R and t or P, and image = \"a.png\"; a mask leaves out what is not the thing, and a view with held_out = true only judges.
A view counts for a place as it sees it straight on and finely; what is hidden by the mesh itself, and what lies at an outline, gets no colour from it, and a view that differs from the others is left out. What no view sees is filled smoothly from what is around: \
the JSON counts it, and in PLY views says from how many views each vertex has its colour, 0 where it was filled. PLY holds red green blue from 0 to 255 as the pictures have them, and GLB colours of vertices in linear light. \
A texture is painted on the mesh's own texture coordinates, or on an atlas of its triangles where it has none; sigma and observed of a fitted mesh are kept.";

/// Arguments of `planish shell texture`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ShellTextureArgs {
    /// The mesh: .ply, .obj, .stl, .off or .glb
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    pub mesh: PathBuf,
    /// Cameras and their pictures: views.toml, see below
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub views: PathBuf,
    /// Where colours go; auto is a texture for .obj and for meshes with texture coordinates, else the
    /// vertices
    #[arg(long, value_enum, default_value_t = ColourName::Auto)]
    pub colours: ColourName,
    /// Pixels along a side of the texture [default: as fine as the pictures, at most 4096]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u64).range(1..=LARGEST_TEXTURE as u64))]
    pub texture_size: Option<u64>,
    /// File to write; may be repeated: .ply (vertices), .glb, .obj (texture)
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Where colours go, on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are the places")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ColourName {
    Auto,
    Vertices,
    Texture,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellTextureArgs) -> u8 {
    report::run("shell texture", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellTextureArgs, progress: &dyn Progress) -> Result<Summary<ShellTextureReport>> {
    let job = ShellTextureJob {
        mesh: args.mesh.clone(),
        views: args.views.clone(),
        place: match args.colours {
            ColourName::Auto => ColourPlace::Auto,
            ColourName::Vertices => ColourPlace::Vertices,
            ColourName::Texture => ColourPlace::Texture,
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
        warnings: report.warnings.clone(),
        body: report,
    })
}

fn text(report: &ShellTextureReport) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Coloured {} vertices: {} as views see them, {} filled.",
        count(report.vertices),
        count(report.seen),
        count(report.filled)
    ));
    if let Some(texture) = &report.texture {
        lines.line(format!(
            "Painted a texture of {0} × {0} pixels{1}: {2} lie on the mesh, {3} of them are filled.",
            texture.size,
            if texture.atlas { " on an atlas of the triangles" } else { "" },
            count(texture.texels),
            count(texture.texels - texture.seen)
        ));
    }
    lines.line(format!(
        "Where several views see a vertex, they differ by {} of 255 (σ).",
        significant(report.colour_sigma, 2)
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = (report.views.iter())
        .map(|view| {
            vec![
                match (view.held_out, view.left_out) {
                    (true, _) => format!("{} (held out)", view.view),
                    (_, true) => format!("{} (left out)", view.view),
                    _ => view.view.clone(),
                },
                count(view.seen),
                match view.held_out {
                    true => String::new(),
                    false => count(view.odd),
                },
                view.rms.map_or("–".to_owned(), |rms| significant(rms, 3)),
            ]
        })
        .collect();
    lines.table(
        &[
            ("view", Align::Left),
            ("vertices seen", Align::Right),
            ("differs", Align::Right),
            ("rms of 255", Align::Right),
        ],
        &rows,
    );
    lines.into_text()
}
