//! The one error type of Planish.
//!
//! Comes in: what was needed, what was found, where. Goes out: an [`Error`] whose [`ErrorKind`] decides the
//! exit code of the command and the exception of other languages. Not converging is data, not an error.

use crate::setting::Setting;
use std::fmt;

/// What sort of trouble an [`Error`] reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The input or its use is wrong: a bad value, a malformed file, options that contradict each other.
    Input,
    /// The data do not determine the answer: too few points, all of them on a line, an empty overlap.
    Undetermined,
    /// The input is right, but this version cannot do what it asks for.
    Unsupported,
    /// A file could not be opened, read or written.
    Io,
    /// The caller asked for the work to be stopped.
    Interrupted,
}

impl ErrorKind {
    /// The exit code of the `planish` command: 1 undetermined, 2 bad input or use, 3 file trouble, 130
    /// interrupted.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Undetermined => 1,
            Self::Input | Self::Unsupported => 2,
            Self::Io => 3,
            Self::Interrupted => 130,
        }
    }
}

/// An error: its kind, a message that says what to do, and the cause beneath it where there is one.
#[derive(Debug)]
pub struct Error {
    kind: ErrorKind,
    message: String,
    place: Option<String>,
    settings: Vec<Setting>,
    source: Option<Box<dyn std::error::Error + Send + Sync + 'static>>,
}

/// A result with Planish's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An error of the given kind.
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), place: None, settings: Vec::new(), source: None }
    }

    /// Wrong input or wrong use.
    pub fn input(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Input, message)
    }

    /// The data do not determine the answer.
    pub fn undetermined(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Undetermined, message)
    }

    /// Right input that this version cannot serve.
    pub fn unsupported(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Unsupported, message)
    }

    /// File trouble.
    pub fn io(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Io, message)
    }

    /// The work was stopped on request.
    #[must_use]
    pub fn interrupted() -> Self {
        Self::new(ErrorKind::Interrupted, "interrupted: nothing was written")
    }

    /// The same error with its cause attached.
    #[must_use]
    pub fn with_source(
        mut self,
        source: impl Into<Box<dyn std::error::Error + Send + Sync + 'static>>,
    ) -> Self {
        self.source = Some(source.into());
        self
    }

    /// The same error with words in front: `context: message`.
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
    /// let error = Error::input("needed a sheet, found a ball").with_setting(Setting::Shape);
    /// assert_eq!(error.settings(), [Setting::Shape]);
    /// ```
    #[must_use]
    pub fn with_setting(mut self, setting: Setting) -> Self {
        self.settings.push(setting);
        self
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

    /// What sort of trouble this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)?;
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
