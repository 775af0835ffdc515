//! Received telemetry: rows of each control step, columns with name and unit, and counts of losses.

use crate::words::counted;
use haptic_bridge::board::telemetry::{BATCH_BYTES, Batch, Columns, Field, Fields, Kind, RowShape};
use haptic_bridge::model::units::JointUnits;

/// The telemetry of one control step.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Number of control steps since the board started.
    pub step: u32,
    /// One number for each column of [`columns`].
    pub values: Vec<f64>,
    /// The fields of the stream.
    pub fields: Fields,
    /// Numbers of joints and of encoders without motors.
    pub shape: RowShape,
}

impl Row {
    /// Returns the numbers of one field, one for each column of the field. Empty if the stream lacks the field.
    pub fn get(&self, wanted: Field) -> &[f64] {
        let columns = |field: Field| if field == Field::State { 2 } else { field.count(self.shape) };
        let before = Field::ALL.iter().copied().take_while(|field| *field != wanted);
        let start: usize = before.filter(|field| self.fields.has(*field)).map(columns).sum();
        let count = if self.fields.has(wanted) { columns(wanted) } else { 0 };
        self.values.get(start..start + count).unwrap_or_default()
    }
}

/// A column of telemetry.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// The field of the column.
    pub field: Field,
    /// Index of the column in its field.
    pub axis: usize,
    /// Name with unit, as in a CSV header: `tip_x_m`, `torque1_n_m`.
    pub label: String,
}

/// Returns the unit of a field's number for a joint with these units.
pub fn unit_of(field: Field, units: &JointUnits) -> &'static str {
    match field {
        Field::Angle => units.travel,
        Field::Speed => units.speed,
        Field::Torque => units.torque,
        other => other.unit(),
    }
}

/// Returns the columns of a stream of `fields` from a device whose joints have these units, and which has a number of
/// `sensed` encoders without motors, in the order of [`Row::values`]. The state has two columns: the state and the
/// number of touched walls.
pub fn columns(fields: Fields, units: &[&JointUnits], sensed: usize) -> Vec<Column> {
    let (mut columns, shape) = (Vec::new(), RowShape { joints: units.len(), sensed });
    for field in Field::ALL.iter().copied().filter(|field| fields.has(*field)) {
        let suffix = |units: &JointUnits| match unit_of(field, units) {
            "" => String::new(),
            unit => format!("_{}", unit.to_lowercase().replace([' ', '/'], "_")),
        };
        if field == Field::State {
            columns.push(Column { field, axis: 0, label: "state".into() });
            columns.push(Column { field, axis: 1, label: "contacts".into() });
        } else if field.columns() != Columns::One {
            for axis in 0..field.count(shape) {
                let units = units.get(axis).copied().unwrap_or(&JointUnits::REVOLUTE);
                let place = match field {
                    Field::Tip => ["_x", "_y", "_z"].get(axis).copied().unwrap_or_default().to_string(),
                    _ => axis.to_string(),
                };
                columns.push(Column { field, axis, label: format!("{}{place}{}", field.name(), suffix(units)) });
            }
        } else {
            columns.push(Column {
                field,
                axis: 0,
                label: format!("{}{}", field.name(), suffix(&JointUnits::REVOLUTE)),
            });
        }
    }
    columns
}

/// Telemetry that a full-speed USB serial port carries with a margin, bytes/s.
const USB_BYTES_PER_SECOND: f64 = 600e3;

/// Returns the number of rows of `fields` per second that the link to a board carries with a margin, at most one per
/// control step. The link to a simulated board carries a row of every step, because the link is this computer's memory.
pub fn max_rows_per_second(board: &str, fields: Fields, shape: RowShape, rate_hz: f64) -> f64 {
    let most =
        if board.starts_with("simulated") { rate_hz } else { USB_BYTES_PER_SECOND / fields.bytes(shape).max(1) as f64 };
    rate_hz / (rate_hz / most).ceil().max(1.0)
}

/// Parses a comma-separated list of fields, in which `all` and `usual` are predefined sets.
pub fn fields(names: &str) -> Result<Fields, String> {
    let mut set = 0;
    for name in names.split(',').map(str::trim) {
        set |= match name {
            "all" => Fields::ALL.0,
            "usual" => Fields::USUAL.0,
            _ => match Field::ALL.iter().find(|field| field.name() == name) {
                Some(field) => field.bit(),
                None => {
                    let known: Vec<&str> = Field::ALL.iter().map(|field| field.name()).collect();
                    return Err(format!("`{name}` is no field; choose from usual, all, {}", known.join(", ")));
                }
            },
        };
    }
    Ok(Fields(set))
}

/// The losses of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Received rows.
    pub received: u64,
    /// Rows that did not arrive, counted from the missing steps.
    pub missing: u64,
    /// Missing rows that the board dropped because the link was too slow.
    pub dropped_by_board: u64,
    /// Batches that were sent but did not arrive.
    pub batches_lost: u64,
    /// Byte sequences between delimiters that were not valid frames.
    pub garbled: u64,
}

impl std::fmt::Display for Losses {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&counted(self.received, "row"))?;
        if self.missing == 0 && self.garbled == 0 {
            return f.write_str(", none lost");
        }
        write!(f, ", {} lost ({} dropped by the board", self.missing, self.dropped_by_board)?;
        write!(f, ", {} batches lost on the link, {} frames garbled)", self.batches_lost, self.garbled)
    }
}

/// Unpacks batches and counts losses.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    /// Number of the stream. Batches of an earlier tool's stream have another number.
    stream: u32,
    fields: Fields,
    /// Number of steps between rows.
    divider: u32,
    losses: Losses,
    /// Expected first step and number of the next batch.
    next_batch: Option<(u32, u32)>,
    /// Number of corrupted batches since the last valid batch.
    corrupted_batches: u32,
}

/// Number of consecutive rejected batches after which the next batch is accepted, because the batch before the rejected
/// batches was corrupted.
const ACCEPT_AFTER_BATCHES: u32 = 3;

impl Rows {
    /// Creates the unpacker of a stream of `fields` at every `divider`-th step.
    pub(super) fn of(stream: u32, fields: Fields, divider: u32) -> Self {
        Self { stream, fields, divider, losses: Losses::default(), next_batch: None, corrupted_batches: 0 }
    }
    /// Counts a corrupted batch and returns the number of consecutive corrupted batches.
    pub(super) fn count_corrupted(&mut self) -> u32 {
        self.losses.garbled += 1;
        self.corrupted_batches += 1;
        self.corrupted_batches
    }

    pub(super) fn losses(&self) -> Losses {
        self.losses
    }
    /// Appends the rows of a batch. Rejects a batch whose step and number contradict the previous batches, because the
    /// batch was corrupted. Gaps are accepted if the board dropped the rows or if batches of at least one row each were
    /// lost.
    pub(super) fn take(&mut self, batch: &Batch, rows: &mut Vec<Row>) {
        let fields = Fields(batch.fields);
        let width = fields.bytes(batch.shape());
        let requested = (self.stream, self.fields, self.divider);
        if width == 0 || batch.axes == 0 || batch.divider == 0 || (batch.stream, fields, batch.divider) != requested {
            return;
        }
        let mut fits = batch.rows.len().is_multiple_of(width);
        if let Some((step, number)) = self.next_batch {
            let behind = batch.first_step.wrapping_sub(step);
            let ahead = u64::from(behind / batch.divider);
            let lost = u64::from(batch.number.wrapping_sub(number));
            let most = u64::from(batch.dropped) + lost * (BATCH_BYTES / width) as u64;
            let restarted = batch.number == 0 || self.corrupted_batches >= ACCEPT_AFTER_BATCHES;
            fits &= restarted || (behind.is_multiple_of(batch.divider) && (lost..=most).contains(&ahead));
            // If the step counter went back, the board has restarted, and the losses in between are unknown.
            if fits && behind < u32::MAX / 2 {
                self.losses.missing += ahead;
            }
        }
        if !fits {
            self.count_corrupted();
            return;
        }
        self.corrupted_batches = 0;
        let number = self.next_batch.map_or(0, |(_, number)| number);
        self.losses.batches_lost += u64::from(batch.number.saturating_sub(number));
        self.losses.dropped_by_board = u64::from(batch.dropped);
        let mut step = batch.first_step;
        for packed in batch.rows.chunks_exact(width) {
            let shape = batch.shape();
            rows.push(Row { step, values: unpack(fields, shape, packed), fields, shape });
            self.losses.received += 1;
            step = step.wrapping_add(batch.divider);
        }
        self.next_batch = Some((step, batch.number.wrapping_add(1)));
    }
}

fn unpack(fields: Fields, shape: RowShape, mut packed: &[u8]) -> Vec<f64> {
    let mut values = Vec::new();
    for field in Field::ALL.iter().copied().filter(|field| fields.has(*field)) {
        for _ in 0..field.count(shape) {
            let Some((bytes, rest)) = packed.split_at_checked(field.kind().bytes()) else { return values };
            packed = rest;
            match (field, bytes) {
                (Field::State, &[both]) => values.extend([f64::from(both & 15), f64::from(both >> 4)]),
                _ => values.push(number(field.kind(), bytes)),
            }
        }
    }
    values
}

fn number(kind: Kind, bytes: &[u8]) -> f64 {
    let mut four = [0; 4];
    four.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    match kind {
        Kind::Float => f64::from(f32::from_le_bytes(four)),
        Kind::Integer => f64::from(i32::from_le_bytes(four)),
        Kind::Byte => f64::from(four[0]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WALL: Fields = Fields(Field::WallForce.bit());

    fn batch(number: u32, first_step: u32, rows: usize, dropped: u32) -> Batch {
        let rows = (0..rows).flat_map(|row| (row as f32).to_le_bytes()).collect();
        let fields = Field::WallForce.bit();
        Batch { stream: 0, number, first_step, divider: 4, dropped, axes: 2, sensed: 0, fields, rows }
    }

    #[test]
    fn every_missing_row_is_counted_once_with_its_cause() {
        let (mut stream, mut rows) = (Rows::of(0, WALL, 4), Vec::new());
        stream.take(&batch(0, 100, 3, 0), &mut rows);
        stream.take(&batch(1, 112, 2, 0), &mut rows);
        assert_eq!(stream.losses(), Losses { received: 5, ..Losses::default() });
        // The board dropped 5 rows (steps 120 to 136), then the link lost batch 3 with two rows.
        stream.take(&batch(2, 140, 1, 5), &mut rows);
        stream.take(&batch(4, 152, 1, 5), &mut rows);
        let expected = Losses { received: 7, missing: 7, dropped_by_board: 5, batches_lost: 1, garbled: 0 };
        assert_eq!(stream.losses(), expected);
        let steps: Vec<u32> = rows.iter().map(|row| row.step).collect();
        assert_eq!(steps, [100, 104, 108, 112, 116, 140, 152]);
        assert!(stream.losses().to_string().contains("7 lost (5 dropped by the board"));
    }

    #[test]
    fn batches_of_another_stream_are_ignored() {
        let (mut stream, mut rows) = (Rows::of(7, WALL, 4), Vec::new());
        stream.take(&Batch { stream: 6, ..batch(9, 100, 3, 5) }, &mut rows);
        stream.take(&Batch { stream: 7, ..batch(0, 40, 2, 0) }, &mut rows);
        // A batch number that went back must not count as a loss of 4e9 batches.
        stream.take(&Batch { stream: 7, ..batch(0, 48, 1, 0) }, &mut rows);
        assert_eq!(stream.losses(), Losses { received: 3, ..Losses::default() });
    }

    #[test]
    fn the_step_counter_may_wrap() {
        let (mut stream, mut rows) = (Rows::of(0, WALL, 4), Vec::new());
        stream.take(&batch(0, u32::MAX - 7, 2, 0), &mut rows);
        stream.take(&batch(1, 0, 2, 0), &mut rows);
        assert_eq!(stream.losses().missing, 0);
    }

    #[test]
    fn counts_keep_all_bits_and_the_state_is_split() {
        let fields = fields("counts,state").unwrap();
        // -123456789 is 0xF8A4_32EB in two's complement; 0x21: armed, two walls.
        let packed = [0xEB, 0x32, 0xA4, 0xF8, 7, 0, 0, 0, 0x21];
        assert_eq!(unpack(fields, 2.into(), &packed), [-123_456_789.0, 7.0, 1.0, 2.0]);
        let labels: Vec<String> =
            columns(fields, &[&JointUnits::REVOLUTE; 2], 0).into_iter().map(|column| column.label).collect();
        assert_eq!(labels, ["counts0", "counts1", "state", "contacts"]);
    }

    #[test]
    fn a_row_returns_the_numbers_of_one_field() {
        let (values, fields) = (vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], fields("tip,force,state,sensed").unwrap());
        let row = Row { step: 0, values, fields, shape: RowShape { joints: 2, sensed: 1 } };
        assert_eq!(row.get(Field::Tip), [1.0, 2.0]);
        assert_eq!(row.get(Field::WallForce), [3.0]);
        assert_eq!(row.get(Field::State), [4.0, 5.0]);
        assert_eq!(row.get(Field::Sensed), [6.0]);
        assert_eq!(row.get(Field::Torque), [0.0; 0]);
    }

    #[test]
    fn columns_carry_their_units() {
        let units = [&JointUnits::REVOLUTE, &JointUnits::PRISMATIC];
        let labels: Vec<String> = columns(fields("q,tip,torque,force,sensed").unwrap(), &units, 1)
            .into_iter()
            .map(|column| column.label)
            .collect();
        let joints = ["q0_rad", "q1_m", "tip_x_m", "tip_y_m", "torque0_n_m", "torque1_n", "force_n", "sensed0_rad"];
        assert_eq!(labels, joints);
        assert!(fields("tip,forse").unwrap_err().contains("`forse` is no field"));
    }
}
