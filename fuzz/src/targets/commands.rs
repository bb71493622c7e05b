//! Whole commands: a damaged file is read, something is computed from it, and outputs are written.
//!
//! A command that succeeds must have written whole files, which `verify` checks. One that fails must not have
//! written any.

use planish::compare::CompareJob;
use planish::contour::ContourJob;
use planish::fit::{FitOptions, UpdateOptions};
use planish::fit_files::{FitJob, FitTask};
use planish::info::info;
use planish::merge::MergeJob;
use planish::next::{NextJob, NextOptions};
use planish::progress::Silent;
use planish::report::ReportOutput;
use planish::shell::pose::ShellPoseJob;
use planish::solid::SolidJob;
use planish::verify::VerifyJob;
use planish::{Job, Unit};
use planish_estimate::Result;
use planish_exchange::contours::SigmaDefaults;
use std::path::{Path, PathBuf};

/// Maximum number of control vertices of a fit: few, so that many cases run in a minute.
const MAX_COEFFICIENTS: usize = 64;

/// Runs a job, and checks which of its outputs exist afterwards.
fn run<J: Job>(job: &J) -> Result<()> {
    let outputs = job.outputs()?;
    for path in &outputs {
        // Those of the case before this one; there are none before the first.
        let _ = std::fs::remove_file(path);
    }
    let done = job.run(&Silent);
    match done {
        Ok(_) => {
            // Pages and drawings are of no kind that is read as data.
            let is_data = |path: &&PathBuf| !path.extension().is_some_and(|e| e == "html" || e == "svg");
            let files: Vec<PathBuf> = outputs.iter().filter(is_data).cloned().collect();
            let verified = VerifyJob { files, ..VerifyJob::default() }.run(&Silent)?;
            for file in verified.files {
                assert!(file.whole, "{}: {}", file.file.display(), file.text);
            }
            Ok(())
        }
        Err(e) => {
            for path in &outputs {
                assert!(!path.exists(), "{} exists after the error: {e}", path.display());
            }
            Err(e)
        }
    }
}

/// Files in the folder of the damaged file.
fn beside<const N: usize>(path: &Path, names: [&str; N]) -> Vec<PathBuf> {
    names.map(|name| path.with_file_name(name)).into()
}

/// A page in the same folder.
fn page(path: &Path) -> Option<ReportOutput> {
    Some(ReportOutput { path: path.with_file_name("out.html"), command: "planish".to_owned(), seed: 0 })
}

/// `planish fit FILE -o out.step -o out.ply -o out.planish --report out.html`.
pub(super) fn fit(path: &Path) -> Result<()> {
    let options = FitOptions { max_coefficients: MAX_COEFFICIENTS, ..FitOptions::default() };
    run(&FitJob {
        inputs: vec![path.to_path_buf()],
        outputs: beside(path, ["out.step", "out.ply", "out.planish"]),
        task: FitTask::Fit(options),
        report: page(path),
        ..FitJob::default()
    })
}

/// `planish fit good.xyz --update FILE -o out.planish -o out.stl`.
pub(super) fn update(path: &Path) -> Result<()> {
    run(&FitJob {
        inputs: beside(path, ["wavy.xyz"]),
        outputs: beside(path, ["out.planish", "out.stl"]),
        task: FitTask::Update { model: path.to_path_buf(), options: UpdateOptions::default() },
        ..FitJob::default()
    })
}

/// `planish compare FILE wavy.xyz` and the reverse.
pub(super) fn compare(path: &Path) -> Result<()> {
    let other = path.with_file_name("wavy.xyz");
    let reverse = CompareJob { model: other.clone(), reference: path.to_path_buf(), ..CompareJob::default() };
    let reversed = run(&reverse);
    let job = CompareJob {
        model: path.to_path_buf(),
        reference: other,
        report: page(path),
        ..CompareJob::default()
    };
    run(&job).and(reversed)
}

/// `planish merge FILE patch.ply -o out.ply -o out.obj`.
pub(super) fn merge(path: &Path) -> Result<()> {
    run(&MergeJob {
        patches: vec![path.to_path_buf(), path.with_file_name("patch.ply")],
        outputs: beside(path, ["out.ply", "out.obj"]),
        report: page(path),
        ..MergeJob::default()
    })
}

/// `planish next FILE --count 3 -o out.csv`.
pub(super) fn next(path: &Path) -> Result<()> {
    run(&NextJob {
        model: path.to_path_buf(),
        options: NextOptions { count: 3, ..NextOptions::default() },
        outputs: beside(path, ["out.csv"]),
        report: page(path),
        ..NextJob::default()
    })
}

/// `planish solid FILE top.dxf side.dxf -o out.step -o out.stl`.
pub(super) fn solid(path: &Path) -> Result<()> {
    run(&SolidJob {
        views: [vec![path.to_path_buf()], beside(path, ["top.dxf", "side.dxf"])].concat(),
        outputs: beside(path, ["out.step", "out.stl"]),
        unit: Some(Unit::Millimetre),
        report: page(path),
        ..SolidJob::default()
    })
}

/// `planish contour FILE -o out.json -o out.dxf -o out.svg`.
pub(super) fn contour(path: &Path) -> Result<()> {
    let sigma = SigmaDefaults { position: None, heading_deg: None, range: None, point: Some(0.1) };
    run(&ContourJob {
        input: path.to_path_buf(),
        sigma,
        outputs: beside(path, ["out.json", "out.dxf", "out.svg"]),
        report: page(path),
        ..ContourJob::default()
    })
}

/// `planish shell pose patch.ply FILE -o out.ply`.
pub(super) fn pose(path: &Path) -> Result<()> {
    run(&ShellPoseJob {
        mesh: path.with_file_name("patch.ply"),
        poses: path.to_path_buf(),
        outputs: beside(path, ["out.ply"]),
        ..ShellPoseJob::default()
    })
}

/// `planish verify FILE` and `planish info FILE`: what one reads, the other finds whole.
pub(super) fn verify(path: &Path) -> Result<()> {
    let verified = VerifyJob { files: vec![path.to_path_buf()], ..VerifyJob::default() }.run(&Silent)?;
    let described = info(path, None);
    if let Err(e) = &described {
        assert!(verified.defective > 0, "`verify` finds no defect, but `info` fails: {e}");
    }
    described.map(drop)
}
