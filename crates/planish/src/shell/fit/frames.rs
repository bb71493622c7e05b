//! The frames of a sequence: each is fitted, written and listed, first from the frames up to it and then from
//! all.
//!
//! A single fit is one frame without a name.

use super::input::{Frame, FrameFiles};
use super::{FITTING_PROGRESS, FrameReport, ReadingsReport, Run, Start, inspection, overlap, report};
use nalgebra::DVector;
use planish_core::Progress;
use planish_estimate::{Error, ErrorKind, Result};
use planish_mesh::TriangleMesh;
use planish_shell::{Deformation, ShellFit, ShellProgress, ShellTracker};
use planish_surface::export::KnownMesh;
use planish_surface::model::SigmaSummary;
use std::collections::BTreeMap;

/// Share of the time of a sequence after which its frames have been followed: a frame is fitted twice then,
/// and once when it is smoothed.
const FOLLOWING_SHARE: f64 = 0.67;

/// What is the same for all frames.
pub(super) struct Moving<'a> {
    pub(super) start: &'a Start,
    pub(super) deformation: &'a dyn Deformation,
    /// Bytes of the texture.
    pub(super) picture: Option<&'a [u8]>,
    /// The diagonal of the mesh's bounding box.
    pub(super) size: f64,
}

/// A frame with its fit.
pub(super) struct FittedFrame {
    pub(super) frame: Frame,
    pub(super) fit: ShellFit,
    /// Overlap of silhouettes and masks, by view.
    pub(super) iou: BTreeMap<String, f64>,
    pub(super) sigma: Vec<f64>,
    pub(super) observed: Vec<u8>,
}

/// The place of a frame in the whole job.
pub(super) struct FrameStage<'a> {
    pub(super) number: usize,
    pub(super) count: usize,
    pub(super) pass: Pass,
    pub(super) name: &'a str,
}

/// What is done with the frames.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Pass {
    /// A single fit.
    Fitting,
    /// Each frame from those up to it, before they are smoothed or not.
    Following { smooths: bool },
    /// Each frame from all.
    Smoothing,
}

impl FrameStage<'_> {
    pub(super) fn title(&self) -> &'static str {
        match self.pass {
            Pass::Fitting => "fitting",
            Pass::Following { .. } => "following",
            Pass::Smoothing => "smoothing",
        }
    }

    /// The share of the job that is done after a share of this frame.
    pub(super) fn share(&self, of_frame: f64) -> f64 {
        let of_pass = (self.number as f64 + of_frame) / self.count as f64;
        let done = match self.pass {
            Pass::Following { smooths: true } => FOLLOWING_SHARE * of_pass,
            Pass::Smoothing => FOLLOWING_SHARE + (1.0 - FOLLOWING_SHARE) * of_pass,
            Pass::Fitting | Pass::Following { smooths: false } => of_pass,
        };
        FITTING_PROGRESS.0 + (FITTING_PROGRESS.1 - FITTING_PROGRESS.0) * done
    }

    pub(super) fn report(&self, progress: &dyn Progress, at: &ShellProgress) -> Result<()> {
        if let Some(rms) = at.rms_points {
            progress.rms(rms);
        }
        match self.pass {
            Pass::Fitting => progress.items(at.iteration, "iterations"),
            _ => progress.items(self.number, "frames"),
        }
        progress.check(self.title(), self.share(at.share))
    }

    pub(super) fn in_frame(&self, e: Error) -> Error {
        if self.name.is_empty() {
            e
        } else if e.kind() == ErrorKind::Interrupted {
            // An interruption is no failure of this frame. The user needs to know how many meshes are
            // complete.
            let (name, done) = (self.name, self.number);
            let text = match self.pass {
                Pass::Smoothing => format!(
                    "interrupted while smoothing: all frames are written, those from {name} on without what \
                     later frames tell of them"
                ),
                _ => format!("interrupted in frame {name}: {done} frames are done"),
            };
            Error::new(e.kind(), text)
        } else {
            e.in_context(format!("frame {}", self.name))
        }
    }
}

impl Run<'_> {
    /// Inspects, writes and lists the fit of a frame. Each is written when it is done, so that an interrupted
    /// sequence keeps the frames before.
    pub(super) fn take(
        &mut self,
        stage: &FrameStage<'_>,
        of_mesh: &Moving<'_>,
        frame: Frame,
        fit: ShellFit,
        predicted: Option<DVector<f64>>,
    ) -> Result<FittedFrame> {
        let Moving { start, deformation, picture, size } = *of_mesh;
        let k = stage.number;
        let of_size = (&start.mesh, size);
        self.unfollowed[k] = inspection::unfollowed(&fit, &frame, of_size, stage.name, self.job.force)?;
        // The fit moves vertices and keeps triangles.
        let found =
            TriangleMesh { positions: fit.positions.clone(), triangles: start.mesh.triangles.clone() };
        let (normals, sigma, observed) = report::known(&found, &fit, deformation, &start.sigma);
        let known = KnownMesh {
            mesh: &found,
            normals: &normals,
            sigma: &sigma,
            observed: &observed,
            curvature: None,
            unit: self.units.unit(),
        };
        self.write(k, start, &known, picture)?;
        // With the estimated poses, so that errors of the cameras do not count as errors of the mesh.
        let iou = overlap(&frame, &found, &fit.cameras);
        // A single fit is its own report; frames are listed for sequences only.
        match stage.pass {
            Pass::Fitting => {}
            Pass::Following { .. } => {
                // In σ of all parameters together, so that the figure does not depend on the unit.
                let error = predicted.map(|q| (&fit.parameters - q).norm() / fit.covariance.trace().sqrt());
                self.of_frames.push(frame_report(stage.name, &fit, error, &iou, &sigma));
            }
            // The prediction was that of the frames before.
            Pass::Smoothing => {
                let error = self.of_frames[k].prediction_error;
                self.of_frames[k] = frame_report(stage.name, &fit, error, &iou, &sigma);
            }
        }
        Ok(FittedFrame { frame, fit, iou, sigma, observed })
    }

    /// Fits all frames but the last again, with what later ones tell of them.
    pub(super) fn smooth(
        &mut self,
        frames: &[FrameFiles],
        of_mesh: &Moving<'_>,
        tracker: &ShellTracker<'_>,
    ) -> Result<()> {
        let progress = self.progress;
        let smoothed = tracker.smoothed()?;
        let Some((_, earlier)) = frames.split_last() else { return Ok(()) };
        for (number, files) in earlier.iter().enumerate() {
            let stage = FrameStage { number, count: earlier.len(), pass: Pass::Smoothing, name: &files.name };
            progress.check(stage.title(), stage.share(0.0)).map_err(|e| stage.in_frame(e))?;
            // The findings about its files are known from the first time.
            let frame = Frame::read(self.job, files, &of_mesh.start.mesh, &mut self.units, &mut Vec::new())?;
            let fitted = smoothed.fit(number, &frame.readings(), &mut |at| stage.report(progress, &at));
            if let Some(fit) = fitted.map_err(|e| stage.in_frame(e))? {
                self.take(&stage, of_mesh, frame, fit, None)?;
            }
        }
        Ok(())
    }
}

/// The figures of one frame of a sequence.
fn frame_report(
    name: &str,
    fit: &ShellFit,
    prediction_error: Option<f64>,
    iou: &BTreeMap<String, f64>,
    sigma: &[f64],
) -> FrameReport {
    FrameReport {
        frame: name.to_owned(),
        rms_points: ReadingsReport::from_source(&fit.points).map(|r| r.rms),
        rms_silhouettes_px: ReadingsReport::from_source(&fit.outlines).map(|r| r.rms),
        iou: (!iou.is_empty()).then(|| iou.values().sum::<f64>() / iou.len() as f64),
        prediction_error,
        sigma: SigmaSummary::from_values(sigma.to_vec()).median,
    }
}
