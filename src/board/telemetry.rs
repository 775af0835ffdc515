//! Telemetry: the quantities of a step that can be streamed, and their packing into batches.
//!
//! A batch holds consecutive rows (every `divider`-th step) of the selected fields, each number in as many bytes as it
//! needs. A gap starts a new batch, so a reader knows the step of every row, and counts losses by missing steps and by
//! the board's count of dropped rows. Every batch carries its stream's number, so that a tool can ignore other streams.

use crate::control::frame::StepRecord;
use crate::math::Real;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::MAX_SENSED;
use crate::model::device::Device;
use crate::render::scene::MAX_WALLS;
use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize, Serializer};

/// Maximum length of a batch's rows, bytes: twelve USB packets, 0.6 ms. Longer batches would delay replies.
pub const BATCH_BYTES: usize = 728;

/// Encoding of a number, least significant byte first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A float, 4 bytes.
    Float,
    /// A signed integer, 4 bytes.
    Integer,
    /// A small unsigned integer, 1 byte.
    Byte,
}

impl Kind {
    /// Returns the number of bytes.
    pub const fn bytes(self) -> usize {
        match self {
            Self::Float | Self::Integer => 4,
            Self::Byte => 1,
        }
    }
}

trait Number {
    const KIND: Kind;
}

impl Number for f32 {
    const KIND: Kind = Kind::Float;
}

impl Number for i32 {
    const KIND: Kind = Kind::Integer;
}

impl Number for u8 {
    const KIND: Kind = Kind::Byte;
}

/// Columns of a field in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Columns {
    /// A single number.
    One,
    /// One number per joint or task axis.
    Joints,
    /// One number per encoder without a motor.
    Sensed,
}

/// Numbers of joints and of encoders without motors of a device, which give the columns of its rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RowShape {
    /// Number of joints.
    pub joints: usize,
    /// Number of encoders without motors.
    pub sensed: usize,
}

impl RowShape {
    /// Returns the shape of a board's rows: the device's, or no columns per joint without a device.
    pub fn of<T: Real>(device: Option<&Device<T>>) -> Self {
        device.map_or_else(Self::default, |device| Self { joints: device.axes(), sensed: device.sensed.len() })
    }

    const fn columns(self, columns: Columns) -> usize {
        match columns {
            Columns::One => 1,
            Columns::Joints if self.joints < MAX_JOINTS => self.joints,
            Columns::Joints => MAX_JOINTS,
            Columns::Sensed if self.sensed < MAX_SENSED => self.sensed,
            Columns::Sensed => MAX_SENSED,
        }
    }
}

impl From<usize> for RowShape {
    /// Returns the shape of a device with this number of joints, all with motors.
    fn from(joints: usize) -> Self {
        Self { joints, sensed: 0 }
    }
}

macro_rules! fields {
    ($($Name:ident = $bit:literal, $name:literal, $unit:literal, $columns:ident, |$frame:ident, $i:ident| $value:expr => $Type:ty, $meaning:literal;)*) => {
        /// A quantity of a telemetry row: a number, or one number per axis or encoder.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Field { $(#[doc = $meaning] $Name,)* }

        impl Field {
            /// All fields, in the order of the columns.
            pub const ALL: &'static [Field] = &[$(Field::$Name),*];

            /// Returns the field's bit in [`Fields`].
            pub const fn bit(self) -> u32 {
                match self { $(Field::$Name => 1 << $bit,)* }
            }
            /// Returns the field's name in tables and options.
            pub const fn name(self) -> &'static str {
                match self { $(Field::$Name => $name,)* }
            }
            /// Returns the field's unit.
            pub const fn unit(self) -> &'static str {
                match self { $(Field::$Name => $unit,)* }
            }
            /// Returns a sentence that describes the field, for docs/telemetry.md and `haptic stream --help`.
            pub const fn meaning(self) -> &'static str {
                match self { $(Field::$Name => $meaning,)* }
            }
            /// Returns the columns of the field.
            pub const fn columns(self) -> Columns {
                match self { $(Field::$Name => Columns::$columns,)* }
            }
            /// Returns the number of the field's columns in rows of a shape.
            pub const fn count(self, shape: RowShape) -> usize {
                shape.columns(self.columns())
            }
            /// Returns the encoding of the field's numbers.
            pub const fn kind(self) -> Kind {
                match self { $(Field::$Name => <$Type as Number>::KIND,)* }
            }
            /// Passes the bytes of each number of the `wanted` fields to `number`, in the order of the columns, for rows
            /// of a shape.
            #[inline(always)]
            fn for_each_number(wanted: Fields, shape: RowShape, frame: &StepRecord, mut number: impl FnMut(&[u8])) {
                $(if wanted.0 & Field::$Name.bit() != 0 {
                    for i in 0..Field::$Name.count(shape) {
                        let value: $Type = (|$frame: &StepRecord, $i: usize| $value)(frame, i);
                        number(&value.to_le_bytes());
                    }
                })*
            }
        }
    };
}

fields! {
    Angle = 0, "q", "rad", Joints, |frame, i| frame.at.q[i] => f32,
        "Joint angles";
    Speed = 1, "qd", "rad/s", Joints, |frame, i| frame.at.qd[i] => f32,
        "Joint velocities, filtered by the scene's estimator";
    Tip = 2, "tip", "m", Joints, |frame, i| frame.at.tip[i] => f32,
        "Tip in the task frame; on a redundant arm the last number is the orientation in rad";
    Torque = 3, "torque", "N m", Joints, |frame, i| frame.motors.torque[i] => f32,
        "Commanded joint torques, after all limits; 0 if the motors are off";
    Current = 4, "current", "A", Joints, |frame, i| frame.motors.current[i] => f32,
        "Motor currents: measured, or commanded if the board has no current sensors";
    Duty = 5, "duty", "", Joints, |frame, i| frame.motors.duty[i] => f32,
        "Bridge duties of the carrier period after the step, as a signed share of the bus voltage";
    Distance = 6, "distance", "m", One, |frame, _i| frame.at.walls.distance => f32,
        "Distance of the tip to the deepest wall, negative inside it; 0 without walls";
    NormalVelocity = 7, "velocity", "m/s", One, |frame, _i| frame.at.walls.normal_velocity => f32,
        "Filtered tip velocity along the normal of the deepest wall, positive out of it";
    WallForce = 8, "force", "N", One, |frame, _i| frame.at.walls.wall_force => f32,
        "Force of the walls, summed over the touched walls, before ramp and limits";
    RenderedForce = 15, "rendered", "N", One, |frame, _i| frame.motors.rendered_force => f32,
        "The value of `force` after ramp and limits: less the part along the normal of the deepest wall that the ramp and the limits of tip force, torque and current removed; 0 unless armed";
    Saturated = 16, "saturated", "", Joints, |frame, i| frame.saturation(i) => u8,
        "Saturation of each motor: 0 none, 1 a limit of torque, current or tip force changed the requested torque, 2 the duty is at its maximum, 3 both";
    Shaping = 9, "shaping", "", One, |frame, _i| frame.at.walls.shaping => f32,
        "Active share of the feed-forward; it fades from 1 to 0 near singular poses";
    Energy = 10, "energy", "J", One, |frame, _i| frame.at.walls.energy => f32,
        "Energy that the walls, the feed-forward included, have absorbed since contact or the stream began; negative if they generated energy";
    PassivityDamping = 11, "passivity", "N s/m", One, |frame, _i| frame.at.walls.passivity_damping => f32,
        "Damping that the passivity controller added";
    BusVoltage = 12, "bus", "V", One, |frame, _i| frame.motors.bus_voltage => f32,
        "Bus voltage; 0 if it is not measured";
    Counts = 13, "counts", "", Joints, |frame, i| frame.counts[i] => i32,
        "Encoder counts, 32 bits, wrapping, before homing";
    // Values: 0 disarmed, 1 armed, 2 checking polarity, 3 fault; plus 16 for each touched wall.
    State = 14, "state", "", One, |frame, _i| frame.state as u8 | frame.at.walls.contacts << 4 => u8,
        "The board's state as a word, and the number of touched walls (`contacts`)";
    Sensed = 17, "sensed", "rad", Sensed, |frame, i| frame.sensed[i] => f32,
        "Angles of the encoders without motors: `offset` at the home pose; until `haptic home`, at the start";
}

/// A set of fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Fields(pub u32);

impl Fields {
    /// Fields that are streamed by default.
    pub const USUAL: Fields = Fields(
        Field::Tip.bit()
            | Field::Torque.bit()
            | Field::Duty.bit()
            | Field::Distance.bit()
            | Field::WallForce.bit()
            | Field::RenderedForce.bit()
            | Field::Saturated.bit()
            | Field::State.bit()
            | Field::Sensed.bit(),
    );
    /// All fields.
    pub const ALL: Fields = Fields(all_bits());

    /// Returns true if the set contains a field.
    pub const fn has(self, field: Field) -> bool {
        self.0 & field.bit() != 0
    }

    /// Returns the number of bytes in one row of a shape.
    pub const fn bytes(self, shape: RowShape) -> usize {
        let (mut sum, mut i) = (0, 0);
        while i < Field::ALL.len() {
            let field = Field::ALL[i];
            if self.has(field) {
                sum += field.kind().bytes() * field.count(shape);
            }
            i += 1;
        }
        sum
    }
}

/// Shape of the widest row.
pub const MAX_SHAPE: RowShape = RowShape { joints: MAX_JOINTS, sensed: MAX_SENSED };

const _: () = assert!(
    Fields::ALL.bytes(MAX_SHAPE) <= BATCH_BYTES && MAX_WALLS < 16,
    "a row fits into a batch, and the number of walls into the state's byte"
);

const fn all_bits() -> u32 {
    let (mut bits, mut i) = (0, 0);
    while i < Field::ALL.len() {
        bits |= Field::ALL[i].bit();
        i += 1;
    }
    bits
}

/// A tool's request for a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct StreamRequest {
    /// Fields of a row.
    pub fields: Fields,
    /// Number of control steps between rows; 0 stops the stream.
    pub divider: u32,
    /// Number chosen by the tool and repeated in every batch, so that the tool can ignore other streams.
    pub stream: u32,
}

/// Consecutive rows of telemetry.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Batch {
    /// Number of the [`StreamRequest`].
    pub stream: u32,
    /// Number of this batch since the stream started. A gap means that the link lost batches.
    pub number: u32,
    /// Control step of the first row.
    pub first_step: u32,
    /// Control steps between rows.
    pub divider: u32,
    /// Number of rows that the board dropped since the stream started, because the link was too slow.
    pub dropped: u32,
    /// Number of joints, see [`RowShape`].
    pub axes: u8,
    /// Number of encoders without motors.
    pub sensed: u8,
    /// Bits of [`Fields`].
    pub fields: u32,
    /// Rows in sequence, each in the order of [`Field::ALL`], each number encoded as its [`Field::kind`].
    #[serde(serialize_with = "serialize_bytes")]
    pub rows: Vec<u8, BATCH_BYTES>,
}

impl Batch {
    /// Returns the shape of the rows.
    pub fn shape(&self) -> RowShape {
        RowShape { joints: self.axes.into(), sensed: self.sensed.into() }
    }
}

/// Serializes bytes as postcard does, but in one piece.
fn serialize_bytes<S: Serializer>(bytes: &Vec<u8, BATCH_BYTES>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}

/// Queue of frames to be packed, oldest first.
pub trait Frames {
    /// Returns the oldest frame.
    fn first(&self) -> Option<&StepRecord>;
    /// Drops the oldest frame.
    fn drop_first(&mut self);
}

/// Packs frames into two batches. One batch is filled while the other batch is sent.
#[derive(Clone, Debug, Default)]
pub struct Packer {
    batches: [Batch; 2],
    open_batch: usize,
    finished_batches: u32,
    /// Length of a row, bytes; 0 without a stream.
    width: usize,
}

impl Packer {
    /// Starts a stream of rows of a shape.
    pub fn start(&mut self, request: &StreamRequest, shape: RowShape) {
        let shape = RowShape { joints: shape.joints.min(MAX_JOINTS), sensed: shape.sensed.min(MAX_SENSED) };
        let fields = request.fields.0 & Fields::ALL.0;
        for batch in &mut self.batches {
            batch.stream = request.stream;
            batch.divider = request.divider;
            batch.fields = fields;
            (batch.axes, batch.sensed) = (shape.joints as u8, shape.sensed as u8);
            batch.rows.clear();
        }
        self.finished_batches = 0;
        self.width = Fields(fields).bytes(shape);
    }

    /// Ends the stream.
    pub fn stop(&mut self) {
        self.width = 0;
        self.batches.iter_mut().for_each(|batch| batch.rows.clear());
    }

    /// Returns true if a stream is on and includes this step.
    #[inline(always)]
    pub fn wants(&self, step: u32) -> bool {
        self.width > 0 && step.checked_rem(self.batches[0].divider) == Some(0)
    }

    /// Adds a frame for which [`Packer::wants`] is true. `dropped` is the number of rows lost on the board so far.
    /// Returns a batch if the frame fills it or does not continue it.
    pub fn push(&mut self, frame: &StepRecord, dropped: u32) -> Option<&Batch> {
        let batch = &self.batches[self.open_batch & 1];
        let rows = batch.rows.len().checked_div(self.width).unwrap_or(0) as u32;
        let due = batch.first_step.wrapping_add(rows.wrapping_mul(batch.divider));
        let mut full = None;
        if rows > 0 && frame.step != due {
            full = Some(self.finish_batch());
        }
        let batch = &mut self.batches[self.open_batch & 1];
        if batch.rows.is_empty() {
            batch.first_step = frame.step;
        }
        batch.dropped = dropped;
        let (fields, shape, bytes) = (Fields(batch.fields), batch.shape(), &mut batch.rows);
        Field::for_each_number(fields, shape, frame, |number| {
            let _ = bytes.extend_from_slice(number);
        });
        if full.is_none() && batch.rows.len() + self.width > BATCH_BYTES {
            full = Some(self.finish_batch());
        }
        full.map(|full| &self.batches[full & 1])
    }

    /// Packs the frames of a queue up to the first full batch and returns this batch. Returns the unfinished batch if
    /// no batch is full and `late` is true because rows have waited too long.
    pub fn drain(&mut self, frames: &mut impl Frames, dropped: u32, late: bool) -> Option<&Batch> {
        let mut full = false;
        while !full && let Some(frame) = frames.first() {
            full = self.wants(frame.step) && self.push(frame, dropped).is_some();
            frames.drop_first();
        }
        if late && !full {
            return self.flush();
        }
        full.then(|| &self.batches[!self.open_batch & 1])
    }

    /// Returns the unfinished batch if the batch holds a row. Call on a slow stream, so that rows do not wait.
    pub fn flush(&mut self) -> Option<&Batch> {
        if self.batches[self.open_batch & 1].rows.is_empty() {
            return None;
        }
        let full = self.finish_batch();
        Some(&self.batches[full & 1])
    }

    /// Finishes and numbers the open batch, and opens the other batch. Returns the index of the finished batch.
    fn finish_batch(&mut self) -> usize {
        let full = self.open_batch & 1;
        self.batches[full].number = self.finished_batches;
        self.finished_batches = self.finished_batches.wrapping_add(1);
        self.open_batch = full ^ 1;
        self.batches[full ^ 1].rows.clear();
        full
    }
}

#[cfg(test)]
mod tests {
    use super::{Columns, Fields, Kind, Number, RowShape};
    use crate::control::frame::{Motors, StepRecord};
    use crate::control::joints::Torques;
    use crate::render::step_result::{AtWalls, DeviceState};
    use heapless::Vec;

    fields! {
        Height = 3, "height", "m", One, |frame, _i| frame.at.tip[1] => f32, "How high the tip is";
        Doubled = 5, "doubled", "N m", Joints, |frame, i| (2.0 * frame.motors.torque[i]) as u8 => u8, "Twice the torque";
        Depth = 6, "depth", "mm", One, |frame, _i| (-1000.0 * frame.at.walls.distance) as i32 => i32, "Depth in the deepest wall";
    }

    /// Checks that all properties of a field come from its line in the table.
    #[test]
    fn a_field_needs_only_one_line() {
        let walls = AtWalls { distance: -0.5, ..AtWalls::default() };
        let at = DeviceState { tip: [0.1, 0.2, 0.3], walls, ..DeviceState::default() };
        let motors = Motors { torque: Torques([1.0, 2.0, 3.0]), ..Motors::default() };
        let frame = StepRecord { at, motors, ..StepRecord::default() };
        let described =
            |field: &Field| (field.bit(), field.name(), field.unit(), field.columns(), field.kind(), field.meaning());
        let expected = [
            (8, "height", "m", Columns::One, Kind::Float, "How high the tip is"),
            (32, "doubled", "N m", Columns::Joints, Kind::Byte, "Twice the torque"),
            (64, "depth", "mm", Columns::One, Kind::Integer, "Depth in the deepest wall"),
        ];
        assert!(Field::ALL.iter().map(described).eq(expected));
        let mut row = Vec::<u8, 16>::new();
        Field::for_each_number(Fields(8 | 32 | 64), RowShape::from(2), &frame, |number| {
            row.extend_from_slice(number).unwrap()
        });
        // 0.2 is 0x3E4CCCCD (IEEE 754), 500 is 0x1F4.
        assert_eq!(row[..], [0xCD, 0xCC, 0x4C, 0x3E, 2, 4, 0xF4, 1, 0, 0]);
    }
}
