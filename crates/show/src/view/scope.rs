//! An oscilloscope for telemetry, which keeps the rows of the last seconds and checks its trigger at every row.

use super::message::{ScopeRequest, Trigger};
use std::collections::VecDeque;

/// Maximum number of columns of a sweep; each column has the smallest and the largest value of its rows.
pub const MAX_COLUMNS: usize = 800;
/// Longest window, s.
pub const MAX_WINDOW_SECONDS: f64 = 2.0;
/// Maximum number of channels.
pub const MAX_CHANNELS: usize = 4;

/// The rows of the last seconds. Lost rows are NaN, so that time stays uniform.
#[derive(Clone, Debug)]
pub struct Ring {
    columns: usize,
    values: VecDeque<f32>,
    capacity: usize,
    /// Number of the row after the newest.
    end: u64,
}

impl Ring {
    /// Creates a ring with room for `rows` rows of `columns` numbers.
    pub fn new(columns: usize, rows: usize) -> Self {
        Self { columns, values: VecDeque::with_capacity(columns * rows), capacity: rows, end: 0 }
    }

    /// Adds a row with one number per column.
    pub fn push(&mut self, row: impl IntoIterator<Item = f32>) {
        if self.len() == self.capacity {
            self.values.drain(..self.columns);
        }
        let before = self.values.len();
        self.values.extend(row.into_iter().take(self.columns));
        self.values.resize(before + self.columns, f32::NAN);
        self.end += 1;
    }

    /// Adds lost rows.
    pub fn push_lost(&mut self, rows: u64) {
        for _ in 0..rows.min(self.capacity as u64) {
            self.push([]);
        }
    }

    fn len(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }

    /// Returns the number of the oldest row.
    pub fn begin(&self) -> u64 {
        self.end - self.len() as u64
    }

    /// Returns the number of the row after the newest.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Returns the value in a row and a column.
    pub fn value(&self, row: u64, column: usize) -> Option<f32> {
        let index = usize::try_from(row.checked_sub(self.begin())?).ok()?;
        (column < self.columns).then(|| self.values.get(index * self.columns + column).copied()).flatten()
    }

    /// Returns the values that arrived among the last `rows` rows of a column, oldest first.
    pub fn last_values(&self, column: usize, rows: u64) -> impl Iterator<Item = f32> {
        (self.end.saturating_sub(rows).max(self.begin())..self.end)
            .filter_map(move |row| self.value(row, column))
            .filter(|value| value.is_finite())
    }
}

/// Kind of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The newest rows, without a trigger.
    Rolling = 0,
    /// The rows around a crossing of the trigger's level.
    Triggered = 1,
    /// The newest rows, because the level was not crossed for a while.
    Waiting = 2,
    /// The requested single sweep.
    Stopped = 3,
}

/// A window of rows for the screen.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Kind of the sweep.
    pub phase: Phase,
    /// Smallest and largest value of each column, for each channel.
    pub channels: Vec<Vec<(f32, f32)>>,
}

#[derive(Clone, Debug)]
struct ActiveTrigger {
    trigger: Trigger,
    column: usize,
    /// Rows of the window before the crossing.
    before: u64,
    /// Number of the first row that the trigger has not checked.
    next: u64,
    /// Row of a crossing whose window is not complete yet.
    crossing: Option<u64>,
    /// End of the last sweep, as a row number.
    sweep_end: u64,
    is_done: bool,
}

/// The oscilloscope of one page.
#[derive(Clone, Debug)]
pub struct Scope {
    columns: Vec<usize>,
    rows: u64,
    seconds: f64,
    trigger: Option<ActiveTrigger>,
}

impl Scope {
    /// Creates an oscilloscope on a stream, from row `now` on. The error describes a mistake in the request.
    pub fn new(request: ScopeRequest, labels: &[String], rows_hz: f64, now: u64) -> Result<Self, String> {
        let column = |name: &String| {
            let index = labels.iter().position(|label| label == name);
            index.ok_or_else(|| format!("`{name}` is not a signal of this stream"))
        };
        if request.channels.is_empty() || request.channels.len() > MAX_CHANNELS {
            return Err(format!("an oscilloscope has 1 to {MAX_CHANNELS} channels"));
        }
        if !(request.seconds > 0.0 && request.seconds <= MAX_WINDOW_SECONDS) {
            return Err(format!("a sweep takes more than 0 and at most {MAX_WINDOW_SECONDS} s"));
        }
        let columns = request.channels.iter().map(column).collect::<Result<Vec<usize>, String>>()?;
        let rows = ((request.seconds * rows_hz).round() as u64).max(2);
        let active = match request.trigger {
            None => None,
            Some(trigger) if trigger.level.is_finite() && (0.0..=1.0).contains(&trigger.before) => {
                Some(ActiveTrigger {
                    column: column(&trigger.channel)?,
                    before: ((rows - 1) as f64 * trigger.before).round() as u64,
                    trigger,
                    next: now,
                    crossing: None,
                    sweep_end: now,
                    is_done: false,
                })
            }
            Some(_) => return Err("a trigger needs a finite level, and a share before the crossing from 0 to 1".into()),
        };
        Ok(Self { columns, rows, seconds: request.seconds, trigger: active })
    }

    /// Returns a sweep if a new one is complete.
    pub fn sweep(&mut self, ring: &Ring) -> Option<Sweep> {
        let Some(active) = &mut self.trigger else { return Some(self.window(ring, ring.end(), Phase::Rolling)) };
        if active.is_done {
            return None;
        }
        let after = self.rows - active.before;
        active.next = active.next.max(ring.begin() + 1);
        while active.crossing.is_none() && active.next < ring.end() {
            let row = active.next;
            active.next += 1;
            let (Some(before), Some(value)) = (ring.value(row - 1, active.column), ring.value(row, active.column))
            else {
                continue;
            };
            let level = active.trigger.level as f32;
            let has_crossed =
                if active.trigger.rising { before < level && value >= level } else { before > level && value <= level };
            if has_crossed {
                active.crossing = Some(row);
            }
        }
        match active.crossing {
            Some(row) if row + after <= ring.end() => {
                let end = row + after;
                (active.crossing, active.next, active.sweep_end, active.is_done) =
                    (None, end.max(active.next), end, active.trigger.once);
                let phase = if active.is_done { Phase::Stopped } else { Phase::Triggered };
                Some(self.window(ring, end, phase))
            }
            Some(_) => None,
            // Shows the newest rows after two windows without a crossing, so that a level can be chosen.
            None if !active.trigger.once && ring.end() > active.sweep_end + 2 * self.rows => {
                Some(self.window(ring, ring.end(), Phase::Waiting))
            }
            None => None,
        }
    }

    fn window(&self, ring: &Ring, end: u64, phase: Phase) -> Sweep {
        let columns = self.rows.min(MAX_COLUMNS as u64);
        // Rows before the start are empty.
        let at = |row: u64, column| (row + end).checked_sub(self.rows).and_then(|row| ring.value(row, column));
        let channels = self.columns.iter().map(|column| {
            (0..columns)
                .map(|i| {
                    let rows = i * self.rows / columns..(i + 1) * self.rows / columns;
                    let values = rows.filter_map(|row| at(row, *column));
                    values.fold((f32::NAN, f32::NAN), |(low, high), value| (low.min(value), high.max(value)))
                })
                .collect()
        });
        Sweep { phase, channels: channels.collect() }
    }

    /// Encodes a sweep as little-endian `f32`: 1, phase, window (s), time of the crossing (s), number of channels and
    /// of columns; then for each channel and column the smallest and the largest value.
    pub fn encode(&self, sweep: &Sweep) -> Vec<u8> {
        let crossing =
            self.trigger.as_ref().map_or(0.0, |active| self.seconds * active.before as f64 / (self.rows - 1) as f64);
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

    fn scope_request(trigger: Option<Trigger>) -> ScopeRequest {
        ScopeRequest { channels: vec!["force_n".into()], seconds: 0.1, trigger }
    }

    fn rising_trigger(once: bool) -> Option<Trigger> {
        Some(Trigger { channel: "force_n".into(), level: 1.5, rising: true, before: 0.25, once })
    }

    /// Adds rows of a force that is 2 in the first ten of every hundred rows, and otherwise 0.
    fn push_force_rows(ring: &mut Ring, rows: std::ops::Range<u64>) {
        for row in rows {
            ring.push([if row % 100 < 10 && row >= 100 { 2.0 } else { 0.0 }, row as f32]);
        }
    }

    #[test]
    fn every_row_is_checked_and_the_crossing_is_at_its_share() {
        let mut ring = Ring::new(2, 1000);
        let mut scope = Scope::new(scope_request(rising_trigger(false)), &labels(), 400.0, 0).unwrap();
        // 40 rows, of which round(39 · 0.25) = 10 come before the crossing.
        push_force_rows(&mut ring, 0..129);
        assert_eq!(scope.sweep(&ring), None, "the window is not full yet");
        push_force_rows(&mut ring, 129..130);
        let sweep = scope.sweep(&ring).unwrap();
        assert_eq!(sweep.phase, Phase::Triggered);
        let expected: Vec<(f32, f32)> =
            (90..130).map(|row| if (100..110).contains(&row) { (2.0, 2.0) } else { (0.0, 0.0) }).collect();
        assert_eq!(sweep.channels, [expected]);
        assert_eq!(scope.sweep(&ring), None, "one crossing makes one sweep");
        push_force_rows(&mut ring, 130..235);
        assert_eq!(scope.sweep(&ring).unwrap().channels[0][10], (2.0, 2.0));
    }

    #[test]
    fn a_trigger_without_a_crossing_shows_the_newest_rows() {
        let mut ring = Ring::new(2, 1000);
        let mut scope = Scope::new(scope_request(rising_trigger(false)), &labels(), 400.0, 0).unwrap();
        push_force_rows(&mut ring, 0..90);
        let sweep = scope.sweep(&ring).unwrap();
        assert_eq!((sweep.phase, sweep.channels[0].len()), (Phase::Waiting, 40));
    }

    #[test]
    fn columns_keep_extremes_and_lost_rows_are_a_gap() {
        let mut ring = Ring::new(1, 5000);
        for row in 0..3999_u32 {
            ring.push([if row == 1234 { 9.0 } else { 0.0 }]);
        }
        ring.push_lost(1);
        let request = ScopeRequest { channels: vec!["force_n".into()], seconds: 2.0, trigger: None };
        let mut scope = Scope::new(request, &labels()[..1], 2000.0, 0).unwrap();
        let sweep = scope.sweep(&ring).unwrap();
        let channel = &sweep.channels[0];
        assert_eq!((channel.len(), channel.iter().filter(|(_, high)| *high == 9.0).count()), (800, 1));
        assert_eq!(channel[1234 / 5], (0.0, 9.0));
        assert_eq!(ring.last_values(0, 3).count(), 2, "a lost row is not a number");
        let bytes = scope.encode(&sweep);
        assert_eq!(bytes.len(), 4 * (6 + 2 * 800));
        assert_eq!(bytes[..4], 1.0_f32.to_le_bytes());
    }

    #[test]
    fn the_ring_keeps_the_newest_rows_by_their_numbers() {
        let mut ring = Ring::new(2, 10);
        push_force_rows(&mut ring, 0..25);
        assert_eq!((ring.begin(), ring.end()), (15, 25));
        assert_eq!(
            (ring.value(14, 1), ring.value(15, 1), ring.value(24, 1), ring.value(25, 1)),
            (None, Some(15.0), Some(24.0), None)
        );
    }

    #[test]
    fn invalid_requests_are_refused_with_a_reason() {
        let refused = |request: ScopeRequest| Scope::new(request, &labels(), 1000.0, 0).unwrap_err();
        assert!(
            refused(ScopeRequest { channels: vec!["x".into()], ..scope_request(None) }).contains("`x` is not a signal")
        );
        assert!(refused(ScopeRequest { channels: vec![], ..scope_request(None) }).contains("1 to 4 channels"));
        for seconds in [0.0, -1.0, 3.0, f64::NAN] {
            assert!(refused(ScopeRequest { seconds, ..scope_request(None) }).contains("at most 2 s"));
        }
        let trigger = Trigger { level: f64::NAN, ..rising_trigger(false).unwrap() };
        assert!(refused(scope_request(Some(trigger))).contains("level"));
    }
}
