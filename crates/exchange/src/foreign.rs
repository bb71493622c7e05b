//! Calls decoders of other crates, which may panic on damaged files.
//!
//! **Input.** A call of such a decoder.
//!
//! **Output.** Its result, or an error that names the file as the cause.
//!
//! **Limits.** A decoder that requests too much memory aborts the program, so sizes are checked before it is
//! called.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

use planish_estimate::{Error, Result};

thread_local! {
    /// Whether a decoder is at work on this thread.
    static DECODING: Cell<bool> = const { Cell::new(false) };
}

/// Calls a decoder; nothing is printed where it panics.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) where it panicked. What it worked on is then in no known
/// state: drop it.
pub(crate) fn guarded<T>(decode: impl FnOnce() -> T) -> Result<T> {
    static SILENT: Once = Once::new();
    SILENT.call_once(|| {
        let usual = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !DECODING.try_with(Cell::get).unwrap_or(false) {
                usual(info);
            }
        }));
    });
    DECODING.set(true);
    let decoded = panic::catch_unwind(AssertUnwindSafe(decode));
    DECODING.set(false);
    decoded.map_err(|panic| {
        let error = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied());
        let error = error.and_then(|text| text.lines().next()).unwrap_or("no words");
        Error::input(format!("the file is damaged: its decoder gave up ({error})"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decoder_that_panics_is_an_error_of_the_file() {
        assert_eq!(guarded(|| 7).unwrap(), 7);
        let e = guarded(|| panic!("no table of chunks")).unwrap_err();
        assert_eq!(e.kind(), planish_estimate::ErrorKind::Input);
        assert!(e.to_string().contains("gave up (no table of chunks)"), "{e}");
    }
}
