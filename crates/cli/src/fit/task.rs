//! The task that the options of `planish fit` describe.
//!
//! The library has no value for options that exclude each other, so they are refused here, under the names
//! that the user typed. The argument parser refuses pairs that conflict whatever their values.

use super::args::{Completion, FilterName, FitArgs, MotionName};
use planish::fit::{Filter, FitOptions, GlobalOptions, GroundWidth, PatchOptions, Strategy, UpdateOptions};
use planish::fit_files::FitTask;
use planish::{Error, Result};
use std::path::PathBuf;

/// The task of these arguments.
///
/// # Errors
/// `Unsupported` for options that exclude each other.
pub(super) fn task(args: &FitArgs) -> Result<FitTask> {
    let ground = args.ground.map(|width| width.map_or(GroundWidth::Usual, GroundWidth::Widest));
    if let Some(model) = &args.update {
        let options = UpdateOptions {
            filter: args.filter.map(Filter::from),
            ground,
            align: args.align,
            refine_by: args.refine_by.into(),
            max_coefficients: args.max_coefficients,
            gate: args.gate,
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
        max_coefficients: args.max_coefficients,
        gate: args.gate,
        held_out_share: args.held_out,
        seed: args.common.seed,
        ..FitOptions::default()
    }))
}

/// The strategy of these arguments, which update no model.
fn strategy(args: &FitArgs, ground: Option<GroundWidth>) -> Result<Strategy> {
    let is_patch = args.filter == Some(FilterName::Patch);
    let fill_gaps = args.complete == Some(Completion::Smooth);
    if let Some(cells) = args.known_uv {
        // The parser excludes every other strategy and its settings.
        return Ok(Strategy::KnownParameters { cells });
    }
    if args.animate.is_some() && args.motion == Some(MotionName::Bend) {
        return Err(Error::unsupported(
            "--animate shows readings that come one after the other: needed a fit without --known-uv and \
             --motion bend, which take all of a time at once",
        ));
    }
    let inferred = [(args.symmetry.is_some(), "--symmetry"), (fill_gaps, "--complete")];
    if let (true, Some((_, name))) = (is_patch, inferred.iter().find(|(asked, _)| *asked)) {
        return Err(Error::unsupported(format!(
            "{name} concludes readings from others, which err together, and the patch filter takes every \
             reading as independent: needed --filter global"
        )));
    }
    let global =
        GlobalOptions { ground, align: args.align, symmetry: args.symmetry, fill_gaps, snapshots: None };
    match args.motion {
        Some(MotionName::Rigid) if is_patch => Err(Error::unsupported(
            "--motion rigid lays scans on the surface of the first, and needs the covariance of the whole of \
             it: needed --filter global",
        )),
        Some(MotionName::Rigid) => Ok(Strategy::Moving(global)),
        Some(MotionName::Bend) => {
            refuse_with_bending(args, is_patch, fill_gaps)?;
            Ok(Strategy::Bending)
        }
        None if is_patch && args.align => Err(Error::unsupported(
            "the patch filter takes poses as they are stated: needed the global filter to align scans",
        )),
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
            "--motion bend does not go together with {name}: every state of the sheet is fitted for itself, \
             to the one before"
        ))),
    }
}

/// The first few of the scans.
fn names(paths: &[PathBuf]) -> String {
    let first: Vec<String> = paths.iter().take(3).map(|path| path.display().to_string()).collect();
    first.join(", ") + if paths.len() > first.len() { ", …" } else { "" }
}
