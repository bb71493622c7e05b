//! `planish simulate`.

use crate::args::{
    BendingArgs, PictureArgs, ScansArgs, Scene, SimulateArgs, Simulated, SphereArgs, TurningArgs, VesselArgs,
};
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Job;
use planish::progress::Progress;
use planish::simulate::{
    BendingOptions, PictureScene, PictureSceneOptions, PictureSceneSummary, PictureTruth, SPHERE_COLUMNS,
    ScanSceneOptions, ScanSceneSummary, SphereJob, SphereOptions, SphereRow, TruthSummary, TurningOptions,
    VesselOptions, write_bending_scene, write_picture_scene, write_scans_scene, write_turning_scene,
    write_vessel_scene,
};
use planish::{Result, Unit};
use serde::Serialize;
use std::path::Path;

/// The keys of `simulate` beside the common ones.
#[derive(Serialize)]
struct Body {
    rows: usize,
    columns: Vec<String>,
    truth: TruthSummary,
    warnings: [String; 0],
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &SimulateArgs) -> u8 {
    match &args.what {
        Simulated::Scene(scene) => match &scene.scene {
            Scene::Scans(args) => {
                report::run("simulate scene scans", &args.common, |progress| scans(args, progress))
            }
            Scene::Stereo(args) => report::run("simulate scene stereo", &args.common, |progress| {
                pictures(PictureScene::Stereo, args, progress)
            }),
            Scene::Grid(args) => report::run("simulate scene grid", &args.common, |progress| {
                pictures(PictureScene::Grid, args, progress)
            }),
            Scene::Turning(args) => {
                report::run("simulate scene turning", &args.common, |progress| turning(args, progress))
            }
            Scene::Bending(args) => {
                report::run("simulate scene bending", &args.common, |progress| bending(args, progress))
            }
            Scene::Readings(args) => crate::contour::run_scene(args),
            Scene::Views(args) => crate::contour::run_views(args),
            Scene::Contours(args) => crate::occluding::run_scene(args),
            Scene::Shell(args) => crate::shell_scene::run(args),
            Scene::Vessel(args) => {
                report::run("simulate scene vessel", &args.common, |progress| vessel(args, progress))
            }
        },
        Simulated::Sphere(args) => {
            report::run("simulate sphere", &args.common, |progress| sphere(args, progress))
        }
    }
}

/// The keys of the scenes of pictures beside the common ones.
#[derive(Serialize)]
struct PictureBody {
    truth: PictureTruth,
    warnings: [String; 0],
    termination: &'static str,
}

fn pictures(
    scene: PictureScene,
    args: &PictureArgs,
    progress: &dyn Progress,
) -> Result<Summary<PictureBody>> {
    let options = PictureSceneOptions {
        mesh: args.mesh.clone(),
        subdivide: args.subdivide,
        up: args.up as usize,
        shape: args.shape.into(),
        views: args.views,
        size: args.size,
        texture: args.texture,
        sigma_brightness: args.sigma_brightness,
        stripe_spacing: args.stripe_spacing,
        seed: args.common.seed,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_picture_scene(scene, &options, &args.out, progress)?;
    Ok(Summary {
        text: picture_text(scene, args, &made),
        unit: made.truth.unit.parse().ok(),
        inputs: args.mesh.iter().cloned().collect(),
        outputs: made.files.clone(),
        warnings: Vec::new(),
        body: PictureBody { truth: made.truth, warnings: [], termination: "converged" },
    })
}

fn picture_text(scene: PictureScene, args: &PictureArgs, made: &PictureSceneSummary) -> String {
    let mut lines = Lines::default();
    let truth = &made.truth;
    lines.line(format!(
        "Took {} pictures of {} ({} long, {} triangles) from {} views.",
        count(2 * truth.poses.len()),
        truth.thing,
        format_args!("{} {}", significant(truth.diagonal, 3), truth.unit),
        count(truth.mesh_triangles),
        count(truth.poses.len())
    ));
    lines.gap();
    lines.line(format!("Wrote {} files to {}. Next, for each view:", made.files.len(), args.out.display()));
    let at = |name: &str| args.out.join(name).display().to_string();
    let [first, second] = scene.pictures(1).map(|name| at(&name));
    let between = if scene == PictureScene::Grid { " --plain " } else { " " };
    // Disparities of neighbours err together: points some pixels apart are nearly independent.
    let apart = if scene == PictureScene::Stereo { " --step 8" } else { "" };
    lines.line(format!(
        "  planish sense {} {first}{between}{second} --calib {}{apart} -o {}",
        scene.name(),
        at(scene.calibration()),
        at(&format!("{}-1.ply", scene.name()))
    ));
    // Stripes give normals and curvatures, which a surface of stereo needs beside its positions.
    let (then, beside) = match scene {
        PictureScene::Stereo => ("and then:", ""),
        PictureScene::Grid => (
            "and then, with the positions that `simulate scene stereo --out stereo` and `sense stereo` make of the same views:",
            "stereo/job.toml ",
        ),
    };
    lines.line(then);
    lines.line(format!("  planish fit {beside}{} -o part.planish", at("job.toml")));
    lines.line(format!("  planish compare part.planish {}", at("truth.ply")));
    lines.into_text()
}

/// The keys of `simulate sphere` beside the common ones.
#[derive(Serialize)]
struct SphereBody {
    rows: Vec<SphereRow>,
    columns: [&'static str; SPHERE_COLUMNS.len()],
    warnings: [String; 0],
    termination: &'static str,
}

fn sphere(args: &SphereArgs, progress: &dyn Progress) -> Result<Summary<SphereBody>> {
    let usual = SphereOptions::default();
    let options = SphereOptions {
        seed: args.common.seed,
        sets: args.sets,
        readings: if args.readings.is_empty() { usual.readings.clone() } else { args.readings.clone() },
        depth: args.depth,
        orientation_deg: args.orientation_deg,
        noise_divides: args.noise_divides,
        ..usual
    };
    let job = SphereJob {
        options: options.clone(),
        outputs: args.out.clone(),
        animation: args.animate.clone(),
        report: args.page.output(&args.common),
    };
    let rows = job.run(progress)?;
    Ok(Summary {
        text: sphere_text(args, &options, &rows),
        unit: None,
        inputs: Vec::new(),
        outputs: (args.out.iter()).chain(&args.animate).chain(&args.page.report).cloned().collect(),
        warnings: Vec::new(),
        body: SphereBody { rows, columns: SPHERE_COLUMNS, warnings: [], termination: "converged" },
    })
}

fn sphere_text(args: &SphereArgs, options: &SphereOptions, rows: &[SphereRow]) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Found a sphere again from {} sets of readings for each point of a curve. Mean errors in % of the radius:",
        count(options.sets)
    ));
    lines.gap();
    let table: Vec<Vec<String>> = rows
        .iter()
        .filter(|row| row.depth == options.depth)
        .map(|row| {
            vec![
                count(row.readings),
                significant(row.noise_percent, 2),
                row.orientation_deg.map_or_else(|| "–".to_owned(), |x| significant(x, 2)),
                significant(row.leaf_patches, 3),
                significant(row.patch_percent, 3),
                significant(row.global_percent, 3),
                significant(row.bound_percent, 3),
            ]
        })
        .collect();
    lines.table(
        &[
            ("readings", Align::Right),
            ("noise / %", Align::Right),
            ("orientations / °", Align::Right),
            ("patches", Align::Right),
            ("patch filter", Align::Right),
            ("global", Align::Right),
            ("bound", Align::Right),
        ],
        &table,
    );
    lines.gap();
    let names: Vec<String> =
        args.out.iter().chain(&args.animate).map(|path| path.display().to_string()).collect();
    lines.line(format!("Wrote {}.", names.join(", ")));
    lines.into_text()
}

fn scans(args: &ScansArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = ScanSceneOptions {
        shape: args.shape.into(),
        seed: args.common.seed,
        readings: args.readings,
        sigma: args.sigma,
        views: args.views,
        old_scanner: !args.no_old_scanner,
        misstated: args.misstated,
        probe_points: args.probe_points,
        outlier_share: args.outliers,
        unevenness: args.unevenness,
        organised: !args.no_grids,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
        truth_triangles: args.truth_triangles,
    };
    let made = write_scans_scene(&options, &args.out, progress)?;
    Ok(summary(&args.out, made, options.unit, ["", ""]))
}

fn vessel(args: &VesselArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = VesselOptions {
        seed: args.common.seed,
        readings: args.readings,
        sigma: args.sigma,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_vessel_scene(&options, &args.out, progress)?;
    let how = [" --symmetry rotation:full", " --part completed"];
    Ok(summary(&args.out, made, options.unit, how))
}

fn turning(args: &TurningArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = TurningOptions {
        seed: args.common.seed,
        readings: args.readings,
        views: args.views,
        rate_deg_per_s: args.rate,
        sigma: args.sigma,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_turning_scene(&options, &args.out, progress)?;
    Ok(summary(&args.out, made, options.unit, [" --motion rigid", ""]))
}

fn bending(args: &BendingArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = BendingOptions {
        seed: args.common.seed,
        readings: args.readings,
        states: args.states,
        stretch: args.stretch,
        sigma: args.sigma,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_bending_scene(&options, &args.out, progress)?;
    Ok(summary(&args.out, made, options.unit, [" --motion bend", ""]))
}

/// `how` are the options of `fit` and of `compare` that suit the scene.
fn summary(out: &Path, made: ScanSceneSummary, unit: Unit, how: [&str; 2]) -> Summary<Body> {
    Summary {
        text: text(out, &made, unit, how),
        unit: Some(unit),
        inputs: Vec::new(),
        outputs: made.files.clone(),
        warnings: Vec::new(),
        body: Body {
            rows: made.rows,
            columns: made.columns,
            truth: made.truth,
            warnings: [],
            termination: "converged",
        },
    }
}

fn text(out: &Path, made: &ScanSceneSummary, unit: Unit, [fit, compare]: [&str; 2]) -> String {
    let mut lines = Lines::default();
    lines.line(format!("Simulated {} readings of a {}.", count(made.rows), made.truth.shape));
    lines.gap();
    let rows: Vec<Vec<String>> = made
        .truth
        .scans
        .iter()
        .map(|scan| vec![scan.file.clone(), scan.sensor.clone(), count(scan.readings), count(scan.outliers)])
        .collect();
    lines.table(
        &[
            ("scan", Align::Left),
            ("sensor", Align::Left),
            ("readings", Align::Right),
            ("outliers", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    let rows: Vec<Vec<String>> = made
        .truth
        .sensors
        .iter()
        .map(|s| {
            vec![
                s.name.clone(),
                significant(s.sigma_along, 3),
                significant(s.sigma_across, 3),
                significant(s.sigma_along / s.misstatement, 3),
            ]
        })
        .collect();
    lines.table(
        &[
            ("sensor", Align::Left),
            (&format!("true σ along / {unit}"), Align::Right),
            ("across", Align::Right),
            ("stated along", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    let job = out.join("job.toml");
    lines.line(format!("Wrote {} files to {}. Next:", made.files.len(), out.display()));
    lines.line(format!("  planish fit {}{fit} -o part.planish", job.display()));
    lines.line(format!("  planish compare part.planish {}{compare}", out.join("truth.ply").display()));
    lines.into_text()
}
