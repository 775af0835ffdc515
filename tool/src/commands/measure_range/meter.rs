//! Progress and remaining time of a measurement: a bar on a terminal, or else a line every few seconds.

use indicatif::{ProgressBar, ProgressStyle};
use std::cell::{Cell, RefCell};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Interval between lines without a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

pub struct ProgressMeter {
    total: usize,
    /// Repeats at each damping.
    repeats: usize,
    /// Number of repeats of an earlier run that `done` has not counted yet.
    earlier: Cell<usize>,
    done: Cell<usize>,
    began: Instant,
    last_done: Cell<Instant>,
    last_line: Cell<Instant>,
    /// Number and total time (s) of the searches without a guess, and of those with a guess from an earlier repeat. The
    /// first search at a damping has no guess and takes about twice as long.
    took: RefCell<[(f64, f64); 2]>,
    bar: Option<ProgressBar>,
}

impl ProgressMeter {
    /// Starts a meter of `total` repeats, `repeats` at each damping, of which an earlier run has measured `earlier`.
    pub fn new(total: usize, repeats: usize, earlier: usize) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| ProgressBar::new(total as u64));
        if let (Some(bar), Ok(style)) = (&bar, ProgressStyle::with_template("{bar:32} {pos} of {len} repeats{msg}")) {
            bar.set_style(style);
            bar.enable_steady_tick(Duration::from_secs(1));
        }
        let now = Instant::now();
        Self {
            total,
            repeats,
            earlier: Cell::new(earlier),
            done: Cell::new(0),
            began: now,
            last_done: Cell::new(now),
            last_line: Cell::new(now),
            took: RefCell::default(),
            bar,
        }
    }

    /// Sets the number of repeats that are done.
    pub fn set_done(&self, done: usize) {
        let now = Instant::now();
        let seconds = (now - self.last_done.replace(now)).as_secs_f64();
        if done > self.done.replace(done) {
            match self.earlier.get().checked_sub(1) {
                Some(left) if seconds < 0.05 => self.earlier.set(left),
                _ => {
                    let took = &mut self.took.borrow_mut()[usize::from(!(done - 1).is_multiple_of(self.repeats))];
                    *took = (took.0 + 1.0, took.1 + seconds);
                }
            }
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
            bar.set_message(
                self.time_left(0.0).map_or(String::new(), |left| format!(", about {} left", format_time(left))),
            );
        }
        self.tick();
    }

    /// Prints a line if the interval is over; callers call this often.
    pub fn tick(&self) {
        if self.bar.is_some() || self.last_line.get().elapsed() < LINE_INTERVAL {
            return;
        }
        self.last_line.set(Instant::now());
        let since = self.last_done.get().elapsed().as_secs_f64();
        let left = self.time_left(since).map_or(String::new(), |left| format!(", about {} left", format_time(left)));
        let (done, total) = (self.done.get(), self.total);
        haptic_host::tell!("{done} of {total} repeats after {}{left}", format_time(self.began.elapsed().as_secs_f64()));
    }

    /// Returns the remaining time (s) `since` seconds after the last repeat; `None` before the first repeat.
    fn time_left(&self, since: f64) -> Option<f64> {
        let [first, later] = *self.took.borrow();
        let mean = |(count, seconds): (f64, f64)| (count > 0.0).then(|| seconds / count);
        let first_mean = mean(first).or_else(|| mean(later).map(|seconds| 2.0 * seconds))?;
        let later_mean = mean(later).unwrap_or(0.5 * first_mean);
        let done = self.done.get();
        let firsts = (done..self.total).filter(|repeat| repeat.is_multiple_of(self.repeats)).count();
        let whole = firsts as f64 * first_mean + (self.total - done - firsts) as f64 * later_mean;
        // Subtracts the time of the present search, at most the mean time of a search.
        let under_way = if done.is_multiple_of(self.repeats) { first_mean } else { later_mean };
        Some(whole - since.min(under_way).min(whole))
    }

    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn format_time(seconds: f64) -> String {
    match seconds {
        seconds if seconds < 99.5 => format!("{seconds:.0} s"),
        seconds if seconds < 5940.0 => format!("{:.0} min", seconds / 60.0),
        seconds => format!("{:.1} h", seconds / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_and_later_searches_are_estimated_separately() {
        let meter = ProgressMeter::new(6, 3, 0);
        assert_eq!(meter.time_left(0.0), None);
        *meter.took.borrow_mut() = [(1.0, 10.0), (0.0, 0.0)];
        meter.done.set(1);
        // Two later searches take 5 s each (half of the first), then come 10 + 5 + 5 s.
        assert_eq!([0.0, 4.0, 40.0].map(|since| meter.time_left(since)), [Some(30.0), Some(26.0), Some(25.0)]);
        *meter.took.borrow_mut() = [(1.0, 10.0), (2.0, 6.0)];
        meter.done.set(3);
        assert_eq!(meter.time_left(0.0), Some(16.0));
        assert_eq!([format_time(42.4), format_time(130.0), format_time(7200.0)], ["42 s", "2 min", "2.0 h"]);
    }
}
