//! The task that the options of `planish fit` describe.
//!
//! The library's types cannot represent conflicting options, so they are refused here, under the names
//! that the user typed. The argument parser refuses pairs that conflict whatever their values.

use super::args::{Completion, FilterName, FitArgs, MotionName};
use planish::fit::{
    Filter, FitOptions, GlobalOptions, GroundWidth, PatchOptions, Strategy, UpdateOptions,
    max_coefficients_within,
};
use planish::fit_files::{FitTask, MIN_COEFFICIENTS};
use planish::{Error, Result};
use std::path::PathBuf;

/// The task of these arguments.
///
/// # Errors
/// `Unsupported` for options that exclude each other.
pub(super) fn task(args: &FitArgs) -> Result<FitTask> {
    let ground = args.ground.map(|width| width.map_or(GroundWidth::Default, GroundWidth::Widest));
    if let Some(model) = &args.update {
        let options = UpdateOptions {
            filter: args.filter.map(Filter::from),
            ground,
            align: args.align,
            refine_by: args.refine_by.into(),
            max_coefficients: largest(args),
            gate: args.gate,
            estimate_sigma: args.estimate_sigma,
            held_out_share: args.held_out,
            seed: args.common.seed,
            ..UpdateOptions::default()
        };
        return Ok(FitTask::Update { model: model.clone(), options });
    }
    Ok(FitTask::Fit(FitOptions {
        strategy: strategy(args, ground).map_err(|e| e.in_context(names(&args.scans)))?,
        shape: args.shape.map(Into::into),
        max_depth: args.max_depth,
        refine_by: args.refine_by.into(),
        max_coefficients: largest(args),
        gate: args.gate,
        estimate_sigma: args.estimate_sigma,
        held_out_share: args.held_out,
        force: args.force,
        seed: args.common.seed,
        ..FitOptions::default()
    }))
}

/// Largest number of control vertices.
pub(super) fn largest(args: &FitArgs) -> usize {
    let default = FitOptions::default().max_coefficients;
    args.max_coefficients.unwrap_or_else(|| match args.common.max_memory {
        // The readings and the outputs take the other half.
        Some(memory) => default.min(max_coefficients_within(memory / 2)).max(MIN_COEFFICIENTS),
        None => default,
    })
}

/// Strategy of a fit that does not update a saved model.
fn strategy(args: &FitArgs, ground: Option<GroundWidth>) -> Result<Strategy> {
    let is_patch = args.filter == Some(FilterName::Patch);
    let fill_gaps = args.complete == Some(Completion::Smooth);
    if let Some(cells) = args.known_uv {
        // The parser excludes every other strategy and its settings.
        return Ok(Strategy::KnownParameters { cells });
    }
    // These refusals depend on the values of both options, which `conflicts_with` cannot express.
    if args.animate.is_some() && args.motion == Some(MotionName::Bend) {
        return Err(Error::unsupported(
            "--animate cannot be combined with --known-uv or --motion bend, which use all readings of a \
             time together and have no order of readings",
        ));
    }
    // Inferred readings share their error, and the filter would average it away
    // (docs/decisions/0017-sigma-of-inferred-parts.md).
    let inferred = [(args.symmetry.is_some(), "--symmetry"), (fill_gaps, "--complete")];
    if let (true, Some((_, name))) = (is_patch, inferred.iter().find(|(asked, _)| *asked)) {
        return Err(Error::unsupported(format!(
            "{name} infers readings from others, so their errors are correlated, and the patch filter \
             requires independent readings: use --filter global"
        )));
    }
    if is_patch && args.genus.is_some() {
        return Err(Error::unsupported(
            "--genus requires --filter global: patches lie on the grid of a sheet, tube, ball or torus",
        ));
    }
    let global = GlobalOptions {
        ground,
        align: args.align,
        symmetry: args.symmetry,
        fill_gaps,
        genus: args.genus,
        smooth: args.smooth,
        // The job asks for snapshots if it writes an animation.
        snapshots: None,
    };
    match args.motion {
        Some(MotionName::Rigid) if is_patch => Err(Error::unsupported(
            "--motion rigid registers each scan to the surface of the first and requires its full \
             covariance: use --filter global",
        )),
        Some(MotionName::Rigid) => Ok(Strategy::Moving(global)),
        Some(MotionName::Bend) => {
            refuse_with_bending(args, is_patch, fill_gaps)?;
            Ok(Strategy::Bending)
        }
        None if is_patch && args.align => {
            Err(Error::unsupported("--align requires --filter global: the patch filter uses poses as stated"))
        }
        None if is_patch => Ok(Strategy::Patches(PatchOptions { ground, snapshots: None })),
        None => Ok(Strategy::Global(global)),
    }
}

/// Refuses options that need all readings in one state of the object.
fn refuse_with_bending(args: &FitArgs, is_patch: bool, fill_gaps: bool) -> Result<()> {
    let asked = [
        (is_patch, "--filter patch"),
        (args.symmetry.is_some(), "--symmetry"),
        (fill_gaps, "--complete"),
        (args.align, "--align"),
    ];
    match asked.iter().find(|(asked, _)| *asked) {
        None => Ok(()),
        Some((_, name)) => Err(Error::unsupported(format!(
            "--motion bend cannot be combined with {name}: each state of the sheet is fitted separately, \
             starting from the previous one"
        ))),
    }
}

/// The first few of the scans.
fn names(paths: &[PathBuf]) -> String {
    // A fit may have hundreds of scans; the message has to stay one line.
    let first: Vec<String> = paths.iter().take(3).map(|path| path.display().to_string()).collect();
    first.join(", ") + if paths.len() > first.len() { ", …" } else { "" }
}
