//! A progress bar for people who wait, and Ctrl-C for those who do not.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use planish::ErrorKind;
use planish::progress::{Progress, SHOWING_STAGE, WRITING_STAGE};
use std::cell::RefCell;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Work that is over sooner shows no bar.
const PATIENCE: Duration = Duration::from_secs(1);
/// Steps of the bar.
const STEPS: u64 = 1000;

/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);
/// Set while files are written: it takes a moment, and they are to be whole.
static WRITING: AtomicBool = AtomicBool::new(false);
/// Set while a result is shown: there is no step to wait for.
static SHOWING: AtomicBool = AtomicBool::new(false);

/// Turns Ctrl-C into a request that the work looks at between its steps, so that no file is left half-written. Who presses it again
/// does not wait for the step.
fn listen_for_ctrl_c() {
    // A second handler in one process, or a system without signals, leaves the default: the process ends at once.
    let _ = ctrlc::set_handler(|| {
        if !INTERRUPTED.swap(true, Ordering::Relaxed) {
            if !SHOWING.load(Ordering::Relaxed) {
                let _ = writeln!(
                    std::io::stderr(),
                    "\nplanish: stopping after this step; press Ctrl-C again to stop at once"
                );
            }
        } else if !WRITING.load(Ordering::Relaxed) {
            std::process::exit(i32::from(ErrorKind::Interrupted.exit_code()));
        }
    });
}

/// Listens to long work.
pub struct Terminal {
    begun: Instant,
    visible: bool,
    bar: RefCell<Option<ProgressBar>>,
}

impl Terminal {
    /// A listener that shows a bar on stderr, where that is a terminal and `quiet` is not set.
    pub fn new(quiet: bool) -> Self {
        listen_for_ctrl_c();
        Self {
            begun: Instant::now(),
            visible: !quiet && std::io::stderr().is_terminal(),
            bar: RefCell::new(None),
        }
    }
}

impl Progress for Terminal {
    fn advance(&self, stage: &str, share: f64) {
        WRITING.store(stage == WRITING_STAGE, Ordering::Relaxed);
        SHOWING.store(stage == SHOWING_STAGE, Ordering::Relaxed);
        if stage == SHOWING_STAGE {
            if let Some(bar) = self.bar.borrow_mut().take() {
                bar.finish_and_clear();
            }
            return;
        }
        if !self.visible || self.begun.elapsed() < PATIENCE {
            return;
        }
        let mut bar = self.bar.borrow_mut();
        let bar = bar.get_or_insert_with(|| {
            let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("{bar:40.cyan} {percent:>3} %  {elapsed}  {msg}") {
                bar.set_style(style);
            }
            bar
        });
        bar.set_message(stage.to_owned());
        bar.set_position((share.clamp(0.0, 1.0) * STEPS as f64) as u64);
    }

    fn interrupted(&self) -> bool {
        INTERRUPTED.load(Ordering::Relaxed)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.borrow_mut().take() {
            bar.finish_and_clear();
        }
    }
}
