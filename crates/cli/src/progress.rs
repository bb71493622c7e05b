//! Progress reports on stderr, and the handling of Ctrl-C.
//!
//! In: stages, shares, counts and residuals of a job. Out: a progress bar if stderr is a terminal; or, with
//! `--progress json`, one JSON object per line. Pipes and files get nothing unless it was requested.

use crate::numbers::significant;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use planish::ErrorKind;
use planish::progress::{Progress, SHOWING_STAGE, WRITING_STAGE};
use serde::Serialize;
use std::cell::RefCell;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The bar appears after this time; shorter jobs show none.
const BAR_DELAY: Duration = Duration::from_secs(1);
/// Minimum time between two events of one stage.
const EVENT_INTERVAL: Duration = Duration::from_millis(200);
/// Minimum share before the remaining time is extrapolated; earlier estimates fluctuate.
const MIN_SHARE_FOR_ESTIMATE: f64 = 0.05;
/// Number of steps of the bar.
const STEPS: u64 = 1000;

// Relaxed ordering is enough for these flags, because no other memory is read depending on them.
/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);
/// Set while files are written. Then Ctrl-C does not end the process, so that no file is incomplete.
static WRITING: AtomicBool = AtomicBool::new(false);
/// Set while a result is shown. Then Ctrl-C is the normal way to stop, without a message.
static SHOWING: AtomicBool = AtomicBool::new(false);

/// Makes Ctrl-C a request to stop, which jobs check between their steps; no file is left half-written. The
/// signals SIGTERM and SIGHUP count as Ctrl-C, so that time limits and closed terminals leave no files
/// either.
///
/// A second Ctrl-C ends the process at once.
fn listen_for_ctrl_c() {
    // If a handler exists already, or the system has no signals, the default remains: the process
    // ends at once.
    let _ = ctrlc::set_handler(|| {
        // The first Ctrl-C leaves time for the job to stop between two steps; a second one means that this
        // takes too long.
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

/// The reader of progress reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Audience {
    /// A person at a terminal.
    People,
    /// A program that reads stderr.
    Program,
    /// Nobody.
    None,
}

/// The progress of a job.
#[derive(Debug, Clone, PartialEq, Default)]
struct State {
    stage: String,
    share: f64,
    /// Start of the stage, measured from the start of the job.
    stage_begun: Duration,
    /// Number of items that are done, and their name.
    items: Option<(usize, &'static str)>,
    rms: Option<f64>,
}

impl State {
    /// Items per second in this stage.
    fn rate(&self, elapsed: Duration) -> Option<f64> {
        let (done, _) = self.items?;
        let seconds = elapsed.saturating_sub(self.stage_begun).as_secs_f64();
        (done > 0 && seconds > 0.0).then(|| done as f64 / seconds)
    }

    /// Remaining time in seconds, extrapolated from the elapsed time.
    fn seconds_left(&self, elapsed: Duration) -> Option<f64> {
        (self.share >= MIN_SHARE_FOR_ESTIMATE)
            .then(|| elapsed.as_secs_f64() * (1.0 - self.share.min(1.0)) / self.share)
    }

    /// The text after the bar.
    fn text(&self, elapsed: Duration) -> String {
        let mut parts = vec![self.stage.clone()];
        if let (Some(rate), Some((_, what))) = (self.rate(elapsed), self.items) {
            parts.push(format!("{} {what}/s", significant(rate, 2)));
        }
        if let Some(seconds) = self.seconds_left(elapsed) {
            parts.push(format!("{} left", clock(seconds)));
        }
        if let Some(rms) = self.rms {
            parts.push(format!("rms {}", significant(rms, 3)));
        }
        parts.join(" · ")
    }
}

/// Seconds as `12 s`, `3:05 min` or `1:02 h`.
fn clock(seconds: f64) -> String {
    let total = seconds.max(0.0).round() as u64;
    match total {
        0..60 => format!("{total} s"),
        60..3600 => format!("{}:{:02} min", total / 60, total % 60),
        _ => format!("{}:{:02} h", total / 3600, total % 3600 / 60),
    }
}

/// A line of `--progress json`.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Event<'a> {
    Progress {
        seconds: f64,
        stage: &'a str,
        share: f64,
        rate: Option<f64>,
        rate_of: Option<&'a str>,
        seconds_left: Option<f64>,
        rms: Option<f64>,
    },
    Finished {
        seconds: f64,
        exit_code: u8,
    },
}

impl Event<'_> {
    fn print(&self) {
        if let Ok(mut line) = serde_json::to_string(self) {
            line.push('\n');
            // If stderr is closed, there is nowhere to report that. One write per line keeps the lines of
            // several processes apart.
            let _ = std::io::stderr().lock().write_all(line.as_bytes());
        }
    }
}

/// Rounds to milliseconds.
fn rounded(seconds: f64) -> f64 {
    (1000.0 * seconds).round() / 1000.0
}

/// Reports the progress of a job to the terminal.
pub struct Terminal {
    begun: Instant,
    audience: Audience,
    // `Progress` takes `&self`. Jobs report from one thread, so cells need no lock.
    state: RefCell<State>,
    bar: RefCell<Option<ProgressBar>>,
    /// Time of the last event, measured from the start of the job.
    last_event: RefCell<Option<Duration>>,
}

impl Terminal {
    /// Starts the clock and handles Ctrl-C. `People` get reports only if stderr is a terminal.
    pub fn new(audience: Audience) -> Self {
        listen_for_ctrl_c();
        Self {
            begun: Instant::now(),
            audience: match audience {
                Audience::People if !std::io::stderr().is_terminal() => Audience::None,
                audience => audience,
            },
            state: RefCell::default(),
            bar: RefCell::new(None),
            last_event: RefCell::new(None),
        }
    }

    /// Prints the event `finished` for programs.
    pub fn finished(&self, exit_code: u8) {
        self.clear();
        if self.audience == Audience::Program {
            let seconds = rounded(self.begun.elapsed().as_secs_f64());
            Event::Finished { seconds, exit_code }.print();
        }
    }

    /// Removes the bar, so that other text can be printed.
    pub fn clear(&self) {
        if let Some(bar) = self.bar.borrow_mut().take() {
            bar.finish_and_clear();
        }
    }

    fn show(&self, state: &State, elapsed: Duration) {
        let mut bar = self.bar.borrow_mut();
        // Made on first use: a job that ends before the delay never draws.
        let bar = bar.get_or_insert_with(|| {
            let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("{bar:32.cyan} {percent:>3} %  {wide_msg}") {
                bar.set_style(style);
            }
            bar
        });
        bar.set_message(state.text(elapsed));
        bar.set_position((state.share * STEPS as f64) as u64);
    }

    fn print(&self, state: &State, elapsed: Duration) {
        *self.last_event.borrow_mut() = Some(elapsed);
        Event::Progress {
            seconds: rounded(elapsed.as_secs_f64()),
            stage: &state.stage,
            share: rounded(state.share),
            rate: state.rate(elapsed).map(rounded),
            rate_of: state.items.map(|(_, what)| what),
            seconds_left: state.seconds_left(elapsed).map(rounded),
            rms: state.rms,
        }
        .print();
    }
}

impl Progress for Terminal {
    fn advance(&self, stage: &str, share: f64) {
        WRITING.store(stage == WRITING_STAGE, Ordering::Relaxed);
        SHOWING.store(stage == SHOWING_STAGE, Ordering::Relaxed);
        let elapsed = self.begun.elapsed();
        let mut state = self.state.borrow_mut();
        let is_new = state.stage != stage;
        // The rate of a stage must not contain the items of the stage before.
        if is_new {
            stage.clone_into(&mut state.stage);
            state.stage_begun = elapsed;
            state.items = None;
        }
        state.share = share.clamp(0.0, 1.0);
        match self.audience {
            Audience::None => {}
            // A served page has no end to wait for, so the bar is removed.
            _ if stage == SHOWING_STAGE => self.clear(),
            Audience::People if elapsed < BAR_DELAY => {}
            Audience::People => self.show(&state, elapsed),
            Audience::Program => {
                let waited = self.last_event.borrow().is_none_or(|last| elapsed >= last + EVENT_INTERVAL);
                if is_new || waited {
                    self.print(&state, elapsed);
                }
            }
        }
    }

    fn rms(&self, rms: f64) {
        self.state.borrow_mut().rms = Some(rms).filter(|rms| rms.is_finite());
    }

    fn items(&self, done: usize, what: &'static str) {
        self.state.borrow_mut().items = Some((done, what));
    }

    fn interrupted(&self) -> bool {
        INTERRUPTED.load(Ordering::Relaxed)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_has_stage_rate_remaining_time_and_rms() {
        let state = State {
            stage: "streaming".to_owned(),
            share: 0.25,
            stage_begun: Duration::from_secs(10),
            items: Some((4000, "readings")),
            rms: Some(0.15678),
        };
        let at = Duration::from_secs(30);
        assert_eq!(state.text(at), "streaming · 200 readings/s · 1:30 min left · rms 0.157");
        assert_eq!(state.seconds_left(at), Some(90.0));
        // Unknown values are left out.
        let first = State { stage: "reading".to_owned(), share: 0.01, ..State::default() };
        assert_eq!(first.text(at), "reading");
        assert_eq!([clock(59.4), clock(60.0), clock(7260.0)], ["59 s", "1:00 min", "2:01 h"]);
    }
}
