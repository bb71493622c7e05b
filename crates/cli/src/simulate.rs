//! `planish simulate`: measurements with known ground truth.

mod bending;
mod contours;
mod objects;
mod pictures;
mod readings;
mod scans;
mod shell;
mod sphere;
mod text;
mod turning;
mod vessel;
mod views;

use crate::summary;
use clap::{Args, Subcommand, ValueEnum};
use planish::Shape;
use planish::simulate::PictureScene;

/// Arguments of `planish simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// What to simulate.
    #[command(subcommand)]
    command: SimulateCommand,
}

/// What can be simulated.
#[derive(Debug, Subcommand)]
enum SimulateCommand {
    /// A scene: readings for a job, and their ground truth
    Scene(SceneArgs),
    /// How accurately a sphere is reconstructed: error against noise, for the patch and the global filter
    Sphere(sphere::SphereArgs),
}

/// Arguments of `planish simulate scene`.
#[derive(Debug, Args)]
struct SceneArgs {
    /// The scene.
    #[command(subcommand)]
    scene: SceneCommand,
}

/// The scenes.
#[derive(Debug, Subcommand)]
enum SceneCommand {
    /// A freeform object of 100 mm, scanned by several sensors; one of them understates its σ
    Scans(scans::ScansArgs),
    /// Stereo images of a textured object from several views, for `sense stereo`
    // Stereo and stripes share options: both render the same object from the same views.
    Stereo(pictures::PictureArgs),
    /// Images of an object under crossed stripes from the same views, for `sense grid`
    Grid(pictures::PictureArgs),
    /// A vessel of revolution, 100 mm high, scanned from one side; its symmetry completes it
    Vessel(vessel::VesselArgs),
    /// A closed surface of any genus: a row of joined rings, scanned from all around
    Handles(objects::HandlesArgs),
    /// A plate with round through holes and sharp edges, scanned from all around
    Plate(objects::PlateArgs),
    /// A cup with a thin wall, a rounded rim and a handle, scanned from all around
    Cup(objects::CupArgs),
    /// An angle bracket with holes, a fillet and sharp edges, scanned from all around
    Bracket(objects::BracketArgs),
    /// Range readings of a contour of 100 mm from uncertain poses, for `contour`
    Readings(readings::ReadingsArgs),
    /// Range readings of a triangular prism in three views, for `contour` and `solid`
    Views(views::ViewsArgs),
    /// A mesh deformed by known controls, as points and masks, for `shell`
    Shell(shell::ShellSceneArgs),
    /// Occluding contours of a hyperboloid or a carafe from two camera motions, for `sense contours`
    Contours(contours::ContoursSceneArgs),
    /// An object of 100 mm on a turntable, scanned by a laser at known times
    Turning(turning::TurningArgs),
    /// A sheet of 100 mm x 70 mm that bends without stretching; the last scan has a hole
    Bending(bending::BendingArgs),
}

/// Value of `--shape` of simulated objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
// Not all shapes of `planish`: scenes refuse a torus.
enum SceneShape {
    /// One boundary
    Sheet,
    /// Open at both ends
    Tube,
    /// Closed
    Ball,
}

impl From<SceneShape> for Shape {
    fn from(name: SceneShape) -> Self {
        match name {
            SceneShape::Sheet => Self::Sheet,
            SceneShape::Tube => Self::Tube,
            SceneShape::Ball => Self::Ball,
        }
    }
}

/// Runs the command; returns the exit code.
pub fn run(args: &SimulateArgs) -> u8 {
    match &args.command {
        SimulateCommand::Scene(args) => run_scene(&args.scene),
        SimulateCommand::Sphere(args) => {
            // The name includes the subcommand, so that `planish NAME --help` in a hint is a valid command.
            summary::run("simulate sphere", &args.common, |progress| sphere::work(args, progress))
        }
    }
}

fn run_scene(scene: &SceneCommand) -> u8 {
    match scene {
        SceneCommand::Scans(args) => {
            summary::run("simulate scene scans", &args.common, |progress| scans::work(args, progress))
        }
        SceneCommand::Stereo(args) => summary::run("simulate scene stereo", &args.common, |progress| {
            pictures::work(PictureScene::Stereo, args, progress)
        }),
        SceneCommand::Grid(args) => summary::run("simulate scene grid", &args.common, |progress| {
            pictures::work(PictureScene::Grid, args, progress)
        }),
        SceneCommand::Vessel(args) => {
            summary::run("simulate scene vessel", &args.common, |progress| vessel::work(args, progress))
        }
        SceneCommand::Handles(args) => args.run(),
        SceneCommand::Plate(args) => args.run(),
        SceneCommand::Cup(args) => args.run(),
        SceneCommand::Bracket(args) => args.run(),
        // Scenes with keys of their own run their summary themselves.
        SceneCommand::Readings(args) => readings::run(args),
        SceneCommand::Views(args) => views::run(args),
        SceneCommand::Shell(args) => shell::run(args),
        SceneCommand::Contours(args) => contours::run(args),
        SceneCommand::Turning(args) => {
            summary::run("simulate scene turning", &args.common, |progress| turning::work(args, progress))
        }
        SceneCommand::Bending(args) => {
            summary::run("simulate scene bending", &args.common, |progress| bending::work(args, progress))
        }
    }
}
