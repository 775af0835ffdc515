//! An oscilloscope on the telemetry: every row is kept for a while, a trigger looks at every row.

use super::message::{ScopeRequest, Trigger};
use std::collections::VecDeque;

/// Columns of a sweep on the screen at most; where there are more rows, each shows their smallest and largest value.
pub const SCREEN: usize = 800;
/// Longest window, s.
pub const LONGEST: f64 = 2.0;
/// Most channels.
pub const CHANNELS: usize = 4;

/// The rows of the last seconds. Rows that were lost are there as NaN, so that time stays even.
#[derive(Clone, Debug)]
pub struct Ring {
    columns: usize,
    values: VecDeque<f32>,
    room: usize,
    /// Number of the row after the newest.
    end: u64,
}

impl Ring {
    /// Room for `rows` rows of `columns` numbers.
    pub fn new(columns: usize, rows: usize) -> Self {
        Self { columns, values: VecDeque::with_capacity(columns * rows), room: rows, end: 0 }
    }

    /// Adds a row of as many numbers as there are columns.
    pub fn push(&mut self, row: impl IntoIterator<Item = f32>) {
        if self.len() == self.room {
            self.values.drain(..self.columns);
        }
        let before = self.values.len();
        self.values.extend(row.into_iter().take(self.columns));
        self.values.resize(before + self.columns, f32::NAN);
        self.end += 1;
    }

    /// Adds rows that were lost.
    pub fn lose(&mut self, rows: u64) {
        for _ in 0..rows.min(self.room as u64) {
            self.push([]);
        }
    }

    fn len(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }

    /// Number of the oldest row that is kept.
    pub fn begin(&self) -> u64 {
        self.end - self.len() as u64
    }

    /// Number of the row after the newest.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// A number by its row and column.
    pub fn at(&self, row: u64, column: usize) -> Option<f32> {
        let index = usize::try_from(row.checked_sub(self.begin())?).ok()?;
        (column < self.columns).then(|| self.values.get(index * self.columns + column).copied()).flatten()
    }

    /// The last `rows` numbers of a column that came, oldest first.
    pub fn last(&self, column: usize, rows: u64) -> impl Iterator<Item = f32> {
        (self.end.saturating_sub(rows).max(self.begin())..self.end)
            .filter_map(move |row| self.at(row, column))
            .filter(|value| value.is_finite())
    }
}

/// The kind of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The newest rows, without a trigger.
    Rolling = 0,
    /// Around a crossing of the trigger's level.
    Triggered = 1,
    /// The newest rows, because nothing has crossed the level for a while.
    Waiting = 2,
    /// The one sweep that was asked for.
    Stopped = 3,
}

/// A picture of a window of rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Its kind.
    pub phase: Phase,
    /// Smallest and largest value of each column on the screen, for each channel.
    pub channels: Vec<Vec<(f32, f32)>>,
}

#[derive(Clone, Debug)]
struct Armed {
    trigger: Trigger,
    column: usize,
    /// Rows of the window before the crossing.
    before: u64,
    /// Number of the first row not looked at yet.
    looked: u64,
    /// A crossing whose window is not full yet.
    caught: Option<u64>,
    /// Number of the row where the last sweep ended.
    swept: u64,
    done: bool,
}

/// One page's oscilloscope.
#[derive(Clone, Debug)]
pub struct Scope {
    columns: Vec<usize>,
    rows: u64,
    seconds: f64,
    armed: Option<Armed>,
}

impl Scope {
    /// An oscilloscope on a stream with these labels and this many rows a second, starting at row `now`. Errors say
    /// what is wrong with the request.
    pub fn new(request: ScopeRequest, labels: &[String], rows_hz: f64, now: u64) -> Result<Self, String> {
        let column = |name: &String| {
            let found = labels.iter().position(|label| label == name);
            found.ok_or_else(|| format!("`{name}` is no signal of this stream"))
        };
        if request.channels.is_empty() || request.channels.len() > CHANNELS {
            return Err(format!("an oscilloscope has 1 to {CHANNELS} channels"));
        }
        if !(request.seconds > 0.0 && request.seconds <= LONGEST) {
            return Err(format!("a sweep takes more than 0 and at most {LONGEST} s"));
        }
        let columns = request.channels.iter().map(column).collect::<Result<Vec<usize>, String>>()?;
        let rows = ((request.seconds * rows_hz).round() as u64).max(2);
        let armed = match request.trigger {
            None => None,
            Some(trigger) if trigger.level.is_finite() && (0.0..=1.0).contains(&trigger.before) => Some(Armed {
                column: column(&trigger.channel)?,
                before: ((rows - 1) as f64 * trigger.before).round() as u64,
                trigger,
                looked: now,
                caught: None,
                swept: now,
                done: false,
            }),
            Some(_) => return Err("a trigger's level is a number, and the share before it lies from 0 to 1".into()),
        };
        Ok(Self { columns, rows, seconds: request.seconds, armed })
    }

    /// The newest sweep, if there is a new one.
    pub fn sweep(&mut self, ring: &Ring) -> Option<Sweep> {
        let Some(armed) = &mut self.armed else { return Some(self.window(ring, ring.end(), Phase::Rolling)) };
        if armed.done {
            return None;
        }
        let after = self.rows - armed.before;
        armed.looked = armed.looked.max(ring.begin() + 1);
        while armed.caught.is_none() && armed.looked < ring.end() {
            let row = armed.looked;
            armed.looked += 1;
            let (Some(before), Some(here)) = (ring.at(row - 1, armed.column), ring.at(row, armed.column)) else {
                continue;
            };
            let level = armed.trigger.level as f32;
            let crossed =
                if armed.trigger.rising { before < level && here >= level } else { before > level && here <= level };
            if crossed {
                armed.caught = Some(row);
            }
        }
        match armed.caught {
            Some(row) if row + after <= ring.end() => {
                let end = row + after;
                (armed.caught, armed.looked, armed.swept, armed.done) =
                    (None, end.max(armed.looked), end, armed.trigger.once);
                let phase = if armed.done { Phase::Stopped } else { Phase::Triggered };
                Some(self.window(ring, end, phase))
            }
            Some(_) => None,
            // No trigger for two windows: show the signal anyway, so that a level can be chosen by eye.
            None if !armed.trigger.once && ring.end() > armed.swept + 2 * self.rows => {
                Some(self.window(ring, ring.end(), Phase::Waiting))
            }
            None => None,
        }
    }

    fn window(&self, ring: &Ring, end: u64, phase: Phase) -> Sweep {
        let screen = self.rows.min(SCREEN as u64);
        // Rows before the beginning are empty, not moved.
        let at = |row: u64, column| (row + end).checked_sub(self.rows).and_then(|row| ring.at(row, column));
        let channels = self.columns.iter().map(|column| {
            (0..screen)
                .map(|i| {
                    let rows = i * self.rows / screen..(i + 1) * self.rows / screen;
                    let values = rows.filter_map(|row| at(row, *column));
                    values.fold((f32::NAN, f32::NAN), |(low, high), value| (low.min(value), high.max(value)))
                })
                .collect()
        });
        Sweep { phase, channels: channels.collect() }
    }

    /// A sweep as the page reads it, 32-bit floats, little-endian: 1, the phase, the window in seconds, the crossing's
    /// place in it in seconds, channels, columns; then for each channel and column the smallest and the largest value.
    pub fn bytes(&self, sweep: &Sweep) -> Vec<u8> {
        let crossing =
            self.armed.as_ref().map_or(0.0, |armed| self.seconds * armed.before as f64 / (self.rows - 1) as f64);
        let columns = sweep.channels.first().map_or(0, Vec::len);
        let head = [
            1.0,
            f32::from(sweep.phase as u8),
            self.seconds as f32,
            crossing as f32,
            sweep.channels.len() as f32,
            columns as f32,
        ];
        let values = sweep.channels.iter().flatten().flat_map(|(low, high)| [*low, *high]);
        head.into_iter().chain(values).flat_map(f32::to_le_bytes).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> Vec<String> {
        vec!["force_n".into(), "distance_m".into()]
    }

    fn request(trigger: Option<Trigger>) -> ScopeRequest {
        ScopeRequest { channels: vec!["force_n".into()], seconds: 0.1, trigger }
    }

    fn rising(once: bool) -> Option<Trigger> {
        Some(Trigger { channel: "force_n".into(), level: 1.5, rising: true, before: 0.25, once })
    }

    /// A force that is 0, and 2 from each hundredth row on for ten rows.
    fn feed(ring: &mut Ring, rows: std::ops::Range<u64>) {
        for row in rows {
            ring.push([if row % 100 < 10 && row >= 100 { 2.0 } else { 0.0 }, row as f32]);
        }
    }

    #[test]
    fn every_row_is_looked_at_and_the_crossing_stands_where_it_was_asked_for() {
        let mut ring = Ring::new(2, 1000);
        let mut scope = Scope::new(request(rising(false)), &labels(), 400.0, 0).unwrap();
        // 40 rows, of which round(39 · 0.25) = 10 come before the crossing.
        feed(&mut ring, 0..129);
        assert_eq!(scope.sweep(&ring), None, "the window is not full yet");
        feed(&mut ring, 129..130);
        let sweep = scope.sweep(&ring).unwrap();
        assert_eq!(sweep.phase, Phase::Triggered);
        let expected: Vec<(f32, f32)> =
            (90..130).map(|row| if (100..110).contains(&row) { (2.0, 2.0) } else { (0.0, 0.0) }).collect();
        assert_eq!(sweep.channels, [expected]);
        assert_eq!(scope.sweep(&ring), None, "one crossing makes one sweep");
        feed(&mut ring, 130..235);
        assert_eq!(scope.sweep(&ring).unwrap().channels[0][10], (2.0, 2.0));
    }

    #[test]
    fn one_sweep_is_one_sweep() {
        let mut ring = Ring::new(2, 1000);
        let mut scope = Scope::new(request(rising(true)), &labels(), 400.0, 0).unwrap();
        feed(&mut ring, 0..150);
        assert_eq!(scope.sweep(&ring).unwrap().phase, Phase::Stopped);
        feed(&mut ring, 150..500);
        assert_eq!(scope.sweep(&ring), None);
    }

    #[test]
    fn a_trigger_that_nothing_crosses_shows_what_is_there() {
        let mut ring = Ring::new(2, 1000);
        let mut scope = Scope::new(request(rising(false)), &labels(), 400.0, 0).unwrap();
        feed(&mut ring, 0..90);
        let sweep = scope.sweep(&ring).unwrap();
        assert_eq!((sweep.phase, sweep.channels[0].len()), (Phase::Waiting, 40));
    }

    #[test]
    fn more_rows_than_columns_keep_their_extremes_and_lost_rows_are_a_gap() {
        let mut ring = Ring::new(1, 5000);
        for row in 0..3999_u32 {
            ring.push([if row == 1234 { 9.0 } else { 0.0 }]);
        }
        ring.lose(1);
        let asked = ScopeRequest { channels: vec!["force_n".into()], seconds: 2.0, trigger: None };
        let mut scope = Scope::new(asked, &labels()[..1], 2000.0, 0).unwrap();
        let sweep = scope.sweep(&ring).unwrap();
        let channel = &sweep.channels[0];
        assert_eq!((channel.len(), channel.iter().filter(|(_, high)| *high == 9.0).count()), (800, 1));
        assert_eq!(channel[1234 / 5], (0.0, 9.0));
        assert_eq!(ring.last(0, 3).count(), 2, "what was lost is no number");
        let bytes = scope.bytes(&sweep);
        assert_eq!(bytes.len(), 4 * (6 + 2 * 800));
        assert_eq!(bytes[..4], 1.0_f32.to_le_bytes());
    }

    #[test]
    fn the_ring_keeps_the_newest_rows_by_their_numbers() {
        let mut ring = Ring::new(2, 10);
        feed(&mut ring, 0..25);
        assert_eq!((ring.begin(), ring.end()), (15, 25));
        assert_eq!(
            (ring.at(14, 1), ring.at(15, 1), ring.at(24, 1), ring.at(25, 1)),
            (None, Some(15.0), Some(24.0), None)
        );
    }

    #[test]
    fn what_cannot_be_shown_is_refused_in_words() {
        let refused = |request: ScopeRequest| Scope::new(request, &labels(), 1000.0, 0).unwrap_err();
        assert!(refused(ScopeRequest { channels: vec!["x".into()], ..request(None) }).contains("`x` is no signal"));
        assert!(refused(ScopeRequest { channels: vec![], ..request(None) }).contains("1 to 4 channels"));
        for seconds in [0.0, -1.0, 3.0, f64::NAN] {
            assert!(refused(ScopeRequest { seconds, ..request(None) }).contains("at most 2 s"));
        }
        let trigger = Trigger { level: f64::NAN, ..rising(false).unwrap() };
        assert!(refused(request(Some(trigger))).contains("level"));
    }
}
