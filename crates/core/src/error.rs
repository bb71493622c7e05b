//! The error type of all crates.
//!
//! In: a kind, and a message that says what was expected, what was found and where. Out: an [`Error`]. Its
//! [`ErrorKind`] decides the exit code of the command and the exception in other languages.
//!
//! A fit that does not converge is not an error: its result says so. Panics are for bugs of Planish.

use crate::setting::Setting;
use std::fmt;
use std::path::PathBuf;

/// Category of an [`Error`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The input or its use is wrong: an invalid value, a malformed file, conflicting options.
    Input,
    /// The data do not determine the answer: too few points, collinear points, no overlap.
    Undetermined,
    /// The input is valid, but this version does not support it.
    Unsupported,
    /// A file could not be opened, read or written.
    Io,
    /// The caller stopped the work.
    Interrupted,
}

impl ErrorKind {
    /// The exit code of the `planish` command.
    ///
    /// # Examples
    /// ```
    /// use planish_core::ErrorKind;
    /// assert_eq!(ErrorKind::Undetermined.exit_code(), 1);
    /// assert_eq!(ErrorKind::Input.exit_code(), 2);
    /// assert_eq!(ErrorKind::Unsupported.exit_code(), 2);
    /// assert_eq!(ErrorKind::Io.exit_code(), 3);
    /// assert_eq!(ErrorKind::Interrupted.exit_code(), 130);
    /// ```
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            // Rust exits with 101 after a panic; shells expect 130 after Ctrl-C (128 + SIGINT).
            Self::Undetermined => 1,
            Self::Input | Self::Unsupported => 2,
            Self::Io => 3,
            Self::Interrupted => 130,
        }
    }
}

/// An error: its kind, a message, and the cause if there is one.
///
/// Callers add context while the error travels upwards, so that the message names the file and the line.
///
/// # Examples
/// ```
/// use planish_core::{Error, ErrorKind, Result};
///
/// fn parse_sigma(text: &str) -> Result<f64> {
///     text.parse().map_err(|e| Error::input(format!("expected σ, found `{text}`")).with_source(e))
/// }
///
/// let error = parse_sigma("0,1").map_err(|e| e.in_context("scan.xyz, line 7")).unwrap_err();
/// assert_eq!(error.kind(), ErrorKind::Input);
/// assert_eq!(error.to_string(), "scan.xyz, line 7: expected σ, found `0,1` (invalid float literal)");
/// ```
#[derive(Debug)]
pub struct Error {
    kind: ErrorKind,
    message: String,
    // Apart from the message: a caller once had to search the text for the name of a file.
    place: Option<String>,
    // Settings, not options: the library is also used without the command, which adds the names of its
    // options.
    settings: Vec<Setting>,
    // Only a set of files whose renames failed halfway has some.
    outputs: Vec<PathBuf>,
    // `Send + Sync`, because parallel work returns errors from other threads.
    source: Option<Box<dyn std::error::Error + Send + Sync + 'static>>,
}

/// A result with Planish's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An error of a given kind.
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
            place: None,
            settings: Vec::new(),
            outputs: Vec::new(),
            source: None,
        }
    }

    /// An [`ErrorKind::Input`] error: wrong input or wrong use.
    pub fn input(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Input, message)
    }

    /// An [`ErrorKind::Undetermined`] error: the data do not determine the answer.
    pub fn undetermined(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Undetermined, message)
    }

    /// An [`ErrorKind::Unsupported`] error: valid input that this version does not support.
    pub fn unsupported(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Unsupported, message)
    }

    /// An [`ErrorKind::Io`] error: a file cannot be opened, read or written.
    pub fn io(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Io, message)
    }

    /// The [`ErrorKind::Interrupted`] error: the caller stopped the work.
    #[must_use]
    pub fn interrupted() -> Self {
        Self::new(ErrorKind::Interrupted, "interrupted: nothing was written")
    }

    /// This error with its cause, which the message then ends with.
    #[must_use]
    pub fn with_source(
        mut self,
        source: impl Into<Box<dyn std::error::Error + Send + Sync + 'static>>,
    ) -> Self {
        self.source = Some(source.into());
        self
    }

    /// This error with a context in front of its message: `context: message`.
    #[must_use]
    pub fn in_context(mut self, context: impl fmt::Display) -> Self {
        self.message = format!("{context}: {}", self.message);
        self
    }

    /// The same error with the name of the scan that it is about in front. [`Error::place`] returns that
    /// name, so that a caller who knows files can decide whether the message names the file already.
    #[must_use]
    pub fn at(mut self, place: impl Into<String>) -> Self {
        let place = place.into();
        self = self.in_context(&place);
        self.place = Some(place);
        self
    }

    /// The same error with a setting that the message is about.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{Error, Setting};
    /// let error = Error::input("expected a sheet, found a ball").with_setting(Setting::Shape);
    /// assert_eq!(error.settings(), [Setting::Shape]);
    /// ```
    #[must_use]
    pub fn with_setting(mut self, setting: Setting) -> Self {
        self.settings.push(setting);
        self
    }

    /// The same error with files that were written nevertheless.
    #[must_use]
    pub fn with_outputs(mut self, outputs: Vec<PathBuf>) -> Self {
        self.outputs = outputs;
        self
    }

    /// Files that were written before the error; mostly none, because outputs appear together.
    #[must_use]
    pub fn outputs(&self) -> &[PathBuf] {
        &self.outputs
    }

    /// The name of the scan that the message begins with, if it is about one.
    #[must_use]
    pub fn place(&self) -> Option<&str> {
        self.place.as_deref()
    }

    /// The settings that the message is about. The command prints the names of their options.
    #[must_use]
    pub fn settings(&self) -> &[Setting] {
        &self.settings
    }

    /// The kind.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)?;
        // The cause is part of the message, because callers print errors without following their sources.
        if let Some(source) = &self.source {
            write!(f, " ({source})")?;
        }
        Ok(())
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.source.as_deref().map(|source| source as &(dyn std::error::Error + 'static))
    }
}
