//! The protocol of all jobs: files in, a result, files out.

use crate::output::check_outputs;
use planish_core::{Progress, Result};
use planish_exchange::{recover_outputs_in_folder_of, write_as_set};
use std::path::PathBuf;

/// Work that reads files, computes a result and writes files.
///
/// A job is a plain struct with public fields and, where it has sensible ones, defaults. [`Job::run`] checks
/// every output before any work, so that a run of an hour does not end with a file that cannot be written.
///
/// # Examples
/// ```no_run
/// use planish::Job;
/// use planish::compare::CompareJob;
/// use planish::progress::Silent;
/// let job = CompareJob {
///     model: "part.planish".into(),
///     reference: "truth.ply".into(),
///     ..CompareJob::default()
/// };
/// println!("{:?}", job.run(&Silent)?.coverage95);
/// # Ok::<(), planish::Error>(())
/// ```
pub trait Job {
    /// The figures of a finished job.
    type Report;

    /// Files that the job reads, as far as they are known before any of them is read.
    ///
    /// # Errors
    /// `Io` for a folder whose files cannot be listed; `Input` for inputs that do not go together.
    fn inputs(&self) -> Result<Vec<PathBuf>>;

    /// Files that the job writes, a page included.
    ///
    /// # Errors
    /// `Unsupported` for a file whose extension names no format of this job.
    fn outputs(&self) -> Result<Vec<PathBuf>>;

    /// Reads, computes and writes. Call [`Job::run`] instead, which checks the outputs first.
    ///
    /// # Errors
    /// Errors of the readers, the computation and the writers; `Interrupted` on request.
    fn execute(&self, progress: &dyn Progress) -> Result<Self::Report>;

    /// Checks the outputs, then reads, computes and writes. All files appear together at the end, or none
    /// ([`write_as_set`]).
    ///
    /// # Errors
    /// As [`Job::outputs`] and [`Job::execute`]; before any work `Input` for an output that is named twice or
    /// is also an input, and `Io` for one that cannot be written.
    fn run(&self, progress: &dyn Progress) -> Result<Self::Report> {
        let (outputs, inputs) = (self.outputs()?, self.inputs()?);
        // An input may be an output of a killed run, whose renames are completed before anything is checked
        // or read.
        inputs.iter().for_each(|path| recover_outputs_in_folder_of(path));
        check_outputs(&outputs, &inputs)?;
        write_as_set(|| self.execute(progress))
    }
}
