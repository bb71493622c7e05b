//! Calls decoders of other crates, which may panic on damaged files.
//!
//! **Input.** A call of such a decoder.
//!
//! **Output.** Its result, or an error that names the file as the cause.
//!
//! **Limits.** A decoder that requests too much memory aborts the program, which cannot be caught. Sizes are
//! therefore checked before it is called (see `las::limits` and `depth::tags`).

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

use planish_estimate::{Error, Result};

thread_local! {
    /// True while a decoder runs on this thread.
    static DECODING: Cell<bool> = const { Cell::new(false) };
}

/// Calls a decoder and turns a panic into an error, without the message of the panic hook.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) if it panicked. The state of its arguments is then unknown,
/// and they must be dropped.
pub(crate) fn guarded<T>(decode: impl FnOnce() -> T) -> Result<T> {
    // The hook is global and stays installed; the flag of the thread decides, so that panics of other threads
    // are still printed.
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let default_hook = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !DECODING.try_with(Cell::get).unwrap_or(false) {
                default_hook(info);
            }
        }));
    });
    // No guard object resets the flag, because `catch_unwind` always returns here.
    DECODING.set(true);
    let decoded = panic::catch_unwind(AssertUnwindSafe(decode));
    DECODING.set(false);
    decoded.map_err(|panic| {
        // The payload is a `String` if the message has arguments, else a literal.
        let message = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied());
        let message = message.and_then(|text| text.lines().next()).unwrap_or("no message");
        Error::input(format!("the file is damaged: its decoder failed ({message})"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_a_decoder_becomes_an_input_error() {
        assert_eq!(guarded(|| 7).unwrap(), 7);
        let e = guarded(|| panic!("no table of chunks")).unwrap_err();
        assert_eq!(e.kind(), planish_estimate::ErrorKind::Input);
        assert!(e.to_string().contains("failed (no table of chunks)"), "{e}");
    }
}
