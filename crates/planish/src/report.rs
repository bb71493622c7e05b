//! Reports: one page of HTML for each job, which opens without a network.
//!
//! Input: the model and the figures of a finished job. Output: a [`planish_report::Page`] and its file. The
//! figures of the summary are not computed again. Reports contain no time of day, so the same input gives the
//! same bytes.

pub(crate) mod scenes;
pub(crate) mod words;

use planish_estimate::{Error, Result};
use planish_exchange::{extension, sha256_of, write_atomically};
use planish_report::{Block, Page, Section, Table};
use std::io::Write;
use std::path::{Path, PathBuf};

/// File of a report, and its statements about the run.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ReportOutput {
    /// An `.html` file.
    pub path: PathBuf,
    /// The command as it was given, for the reader to repeat.
    pub command: String,
    /// The seed of random choices.
    pub seed: u64,
}

impl ReportOutput {
    /// The file of the page, as one of a job's outputs.
    ///
    /// # Errors
    /// `Unsupported` for other extensions than `.html`.
    pub fn file(&self) -> Result<PathBuf> {
        if !matches!(extension(&self.path).as_str(), "html" | "htm") {
            return Err(Error::unsupported(format!(
                "{}: expected a name that ends in .html, because a report is an HTML page",
                self.path.display()
            )));
        }
        Ok(self.path.clone())
    }

    /// Writes a page with its provenance at the end.
    pub(crate) fn write(&self, mut page: Page, inputs: &[(PathBuf, String)]) -> Result<()> {
        // Checksums are computed at the end of the job, from the files as they are then.
        page.sections.push(self.provenance(inputs)?);
        let html = page.html().map_err(|e| {
            Error::io(format!("{}: the report could not be rendered", self.path.display())).with_source(e)
        })?;
        self.write_text(&html)
    }

    /// Writes a page that has been made.
    ///
    /// # Errors
    /// `Io` if the file cannot be written.
    pub fn write_text(&self, html: &str) -> Result<()> {
        write_atomically(&self.path, |writer| writer.write_all(html.as_bytes()))
    }

    /// The command, the version, the seed, and for every file that was read its contribution and a checksum.
    pub(crate) fn provenance(&self, inputs: &[(PathBuf, String)]) -> Result<Section> {
        let mut files = Table::new(["file", "content", "SHA-256"]);
        for (path, description) in inputs {
            files.row([file_name(path), description.clone(), sha256_of(path)?], false);
        }
        let mut blocks = vec![
            Block::Lines(self.command.clone()),
            Block::Text(format!(
                "Planish {}; seed {}. The same files and command give the same bytes.",
                env!("CARGO_PKG_VERSION"),
                self.seed
            )),
        ];
        // Simulations have no inputs.
        if !inputs.is_empty() {
            blocks.push(Block::Table(files));
        }
        Ok(Section::new("Provenance", blocks))
    }
}

/// The last part of a path, as text.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Title of a report: the first file and the number of others.
pub(crate) fn title_of(paths: &[PathBuf]) -> String {
    match paths {
        [] => "nothing".to_owned(),
        [one] => {
            let name = file_name(one);
            let folder = one.parent().map(file_name).unwrap_or_default();
            // `job.toml` says less than where it lies.
            match name.as_str() {
                "job.toml" if !folder.is_empty() => format!("{folder}/{name}"),
                _ => name,
            }
        }
        [first, others @ ..] => format!("{} and {} more", file_name(first), others.len()),
    }
}

/// The outputs of a job including its page, if requested.
pub(crate) fn with_page(mut outputs: Vec<PathBuf>, page: Option<&ReportOutput>) -> Result<Vec<PathBuf>> {
    if let Some(page) = page {
        outputs.push(page.file()?);
    }
    Ok(outputs)
}
