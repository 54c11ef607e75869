//! What the user sees while something runs: a bar on a terminal, plain lines elsewhere, nothing with `--quiet`.

use crate::error::{Error, Result};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two plain lines.
const PLAIN_INTERVAL: Duration = Duration::from_secs(10);

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Where messages go.
pub struct Console {
    quiet: bool,
}

/// Progress of one piece of long work.
pub struct Meter {
    label: String,
    unit: &'static str,
    total: u64,
    begun: Instant,
    first: Option<u64>,
    bar: Option<ProgressBar>,
    last_line: Instant,
    quiet: bool,
}

impl Console {
    /// A console; the first Ctrl-C from now on asks for a clean stop, the second one stops at once.
    pub fn new(quiet: bool) -> Self {
        // A second console in one process finds the handler set, which is as good.
        let _ = ctrlc::set_handler(|| {
            if INTERRUPTED.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
        });
        Self { quiet }
    }

    /// One line of information. The work goes on where nobody reads it any more.
    pub fn say(&self, line: impl AsRef<str>) {
        if !self.quiet {
            let _ = print(line.as_ref());
        }
    }

    /// Prints what the command was asked for.
    ///
    /// # Errors
    /// `File` if it cannot be written; a reader that has read enough is no error.
    pub fn answer(&self, text: impl AsRef<str>) -> Result<()> {
        if self.quiet {
            return Ok(());
        }
        match print(text.as_ref()) {
            Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
                Err(Error::file("standard output", format!("cannot be written: {e}")))
            }
            _ => Ok(()),
        }
    }

    /// A progress meter in `total` units.
    pub fn meter(&self, label: impl Into<String>, total: u64, unit: &'static str) -> Meter {
        let label = label.into();
        let terminal = !self.quiet && std::io::stderr().is_terminal();
        let bar = terminal.then(|| {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(5));
            let template = "{prefix} [{bar:30}] {percent:>3} %  {msg}  {eta} left";
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.set_prefix(label.clone());
            bar
        });
        let now = Instant::now();
        Meter { label, unit, total, begun: now, first: None, bar, last_line: now, quiet: self.quiet }
    }

    /// `Break` once Ctrl-C was pressed.
    pub fn flow(&self) -> ControlFlow<()> {
        if INTERRUPTED.load(Ordering::SeqCst) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// An error once Ctrl-C was pressed.
    ///
    /// # Errors
    /// `Interrupted`, saying what is kept.
    pub fn check(&self, kept: &str) -> Result<()> {
        match self.flow() {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Error::Interrupted(kept.into())),
        }
    }
}

impl Meter {
    /// Shows that `done` units are done at which rate; `note` is shown beside.
    pub fn update(&mut self, done: u64, note: &str) {
        let message = format!("{}/s  {note}", short(self.rate(done), self.unit));
        self.show(done, &message);
    }

    /// Units a second since the first that was shown.
    fn rate(&mut self, done: u64) -> f64 {
        let first = *self.first.get_or_insert(done);
        (done - first.min(done)) as f64 / self.begun.elapsed().as_secs_f64().max(1e-9)
    }

    /// Shows that `done` units are done, with a message of the caller's own.
    pub fn show(&mut self, done: u64, message: &str) {
        let rate = self.rate(done);
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            bar.set_message(message.to_string());
        } else if !self.quiet && self.last_line.elapsed() >= PLAIN_INTERVAL {
            self.last_line = Instant::now();
            let left = (self.total.saturating_sub(done)) as f64 / rate.max(1e-9);
            let percent = 100.0 * done as f64 / self.total.max(1) as f64;
            let _ = print(&format!("{}: {percent:.0} %, {message}, {left:.0} s left", self.label));
        }
    }

    /// Ends the meter; returns units a second since it began.
    pub fn finish(mut self, done: u64) -> f64 {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        self.rate(done)
    }
}

/// Prints a line; `println!` would panic where the reader of a pipe has gone.
fn print(line: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{line}")?;
    out.flush()
}

/// A rate with its unit: `2.31 M samples`.
pub fn short(value: f64, unit: &str) -> String {
    match value {
        v if v >= 1e6 => format!("{:.2} M {unit}", v / 1e6),
        v if v >= 1e3 => format!("{:.0} k {unit}", v / 1e3),
        v => format!("{v:.1} {unit}"),
    }
}
