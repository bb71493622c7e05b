//! How far the work is, for people who wait and for programs; and Ctrl-C for those who do not.
//!
//! Comes in: stages, shares, counts and residuals of a job. Goes out, on stderr: one bar that all jobs share,
//! where that is a terminal; or, with `--progress json`, an object a line. Into pipes and files nothing is
//! written unless it was asked for.

use crate::numbers::significant;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use planish::ErrorKind;
use planish::progress::{Progress, SHOWING_STAGE, WRITING_STAGE};
use serde::Serialize;
use std::cell::RefCell;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Work that is over sooner shows no bar.
const PATIENCE: Duration = Duration::from_secs(1);
/// Events of one stage are no closer than this.
const PAUSE: Duration = Duration::from_millis(200);
/// Before this share is done nobody knows how long the rest takes.
const LEAST_SHARE: f64 = 0.05;
/// Steps of the bar.
const STEPS: u64 = 1000;

/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);
/// Set while files are written: it takes a moment, and they are to be whole.
static WRITING: AtomicBool = AtomicBool::new(false);
/// Set while a result is shown: there is no step to wait for.
static SHOWING: AtomicBool = AtomicBool::new(false);

/// Turns Ctrl-C into a request that the work looks at between its steps, so that no file is left
/// half-written. Who presses it again does not wait for the step.
fn listen_for_ctrl_c() {
    // A second handler in one process, or a system without signals, leaves the default: the process ends at
    // once.
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

/// Who is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Audience {
    /// Who looks at a terminal.
    People,
    /// A program that reads stderr.
    Program,
    /// Nobody.
    Nobody,
}

/// Where a job stands.
#[derive(Debug, Clone, PartialEq, Default)]
struct State {
    stage: String,
    share: f64,
    /// When the stage began, after the job did.
    stage_begun: Duration,
    /// What the stage works through: how many are done, and what they are.
    items: Option<(usize, &'static str)>,
    rms: Option<f64>,
}

impl State {
    /// Things done a second in this stage.
    fn rate(&self, elapsed: Duration) -> Option<f64> {
        let (done, _) = self.items?;
        let seconds = elapsed.saturating_sub(self.stage_begun).as_secs_f64();
        (done > 0 && seconds > 0.0).then(|| done as f64 / seconds)
    }

    /// Seconds that the rest takes if it goes on as so far.
    fn seconds_left(&self, elapsed: Duration) -> Option<f64> {
        (self.share >= LEAST_SHARE).then(|| elapsed.as_secs_f64() * (1.0 - self.share.min(1.0)) / self.share)
    }

    /// What stands beside the bar.
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
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{}:{:02} min", whole / 60, whole % 60),
        _ => format!("{}:{:02} h", whole / 3600, whole % 3600 / 60),
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
            // Where stderr is closed nobody wants to know. One write a line: lines of several processes do
            // not mix.
            let _ = std::io::stderr().lock().write_all(line.as_bytes());
        }
    }
}

/// Milliseconds are exact enough.
fn rounded(seconds: f64) -> f64 {
    (1000.0 * seconds).round() / 1000.0
}

/// Listens to long work.
pub struct Terminal {
    begun: Instant,
    audience: Audience,
    state: RefCell<State>,
    bar: RefCell<Option<ProgressBar>>,
    /// When the last event was printed, after the job began.
    told: RefCell<Option<Duration>>,
}

impl Terminal {
    /// A listener; people are told where stderr is a terminal only.
    pub fn new(audience: Audience) -> Self {
        listen_for_ctrl_c();
        Self {
            begun: Instant::now(),
            audience: match audience {
                Audience::People if !std::io::stderr().is_terminal() => Audience::Nobody,
                audience => audience,
            },
            state: RefCell::default(),
            bar: RefCell::new(None),
            told: RefCell::new(None),
        }
    }

    /// Tells programs how it ended.
    pub fn finished(&self, exit_code: u8) {
        self.clear();
        if self.audience == Audience::Program {
            let seconds = rounded(self.begun.elapsed().as_secs_f64());
            Event::Finished { seconds, exit_code }.print();
        }
    }

    /// Takes the bar away, so that something else can be printed.
    pub fn clear(&self) {
        if let Some(bar) = self.bar.borrow_mut().take() {
            bar.finish_and_clear();
        }
    }

    fn show(&self, state: &State, elapsed: Duration) {
        let mut bar = self.bar.borrow_mut();
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
        *self.told.borrow_mut() = Some(elapsed);
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
        if is_new {
            stage.clone_into(&mut state.stage);
            state.stage_begun = elapsed;
            state.items = None;
        }
        state.share = share.clamp(0.0, 1.0);
        match self.audience {
            Audience::Nobody => {}
            _ if stage == SHOWING_STAGE => self.clear(),
            Audience::People if elapsed < PATIENCE => {}
            Audience::People => self.show(&state, elapsed),
            Audience::Program => {
                let waited = self.told.borrow().is_none_or(|told| elapsed >= told + PAUSE);
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
    fn a_line_says_stage_rate_time_left_and_rms() {
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
        // What is not known is not said.
        let first = State { stage: "reading".to_owned(), share: 0.01, ..State::default() };
        assert_eq!(first.text(at), "reading");
        assert_eq!([clock(59.4), clock(60.0), clock(7260.0)], ["59 s", "1:00 min", "2:01 h"]);
    }
}
