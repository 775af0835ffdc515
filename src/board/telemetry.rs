//! Telemetry: which numbers of a step travel, and how they are packed into batches.
//!
//! A batch holds consecutive kept steps (every `divider`-th) of the chosen fields, each number in as many bytes as it
//! needs; a gap starts a new batch, so a reader knows the step of every row and counts losses exactly: missing steps, and
//! the board's own count of what it had to drop. Every batch carries the number that the tool gave its stream: what a
//! killed tool left on the link is told from what the next one asked for.

use crate::control::frame::StepRecord;
use crate::model::catalogue::MAX_JOINTS;
use crate::render::scene::MAX_WALLS;
use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize, Serializer};

/// Most bytes of rows in a batch. Shorter batches cost bytes, longer ones keep answers waiting: twelve packets of USB,
/// 0.6 ms.
pub const BATCH_BYTES: usize = 728;

/// The encoding of a number: so many bytes, the least significant first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A float, 4.
    Float,
    /// A signed integer, 4.
    Integer,
    /// A small whole number, 1.
    Byte,
}

impl Kind {
    /// Number of bytes.
    pub const fn bytes(self) -> usize {
        match self {
            Self::Float | Self::Integer => 4,
            Self::Byte => 1,
        }
    }
}

/// A type of numbers that can travel.
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

macro_rules! fields {
    ($($Name:ident = $bit:literal, $name:literal, $unit:literal, $vector:literal, |$frame:ident, $i:ident| $value:expr => $Type:ty, $meaning:literal;)*) => {
        /// A number, or one number an axis, of a telemetry row.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Field { $(#[doc = $meaning] $Name,)* }

        impl Field {
            /// Every field, in the order of the columns.
            pub const ALL: &'static [Field] = &[$(Field::$Name),*];

            /// Its bit in [`Fields`].
            pub const fn bit(self) -> u32 {
                match self { $(Field::$Name => 1 << $bit,)* }
            }
            /// Its name in tables and options.
            pub const fn name(self) -> &'static str {
                match self { $(Field::$Name => $name,)* }
            }
            /// Its unit.
            pub const fn unit(self) -> &'static str {
                match self { $(Field::$Name => $unit,)* }
            }
            /// Its meaning in plain words: docs/telemetry.md and `haptic stream --help` hold these sentences.
            pub const fn meaning(self) -> &'static str {
                match self { $(Field::$Name => $meaning,)* }
            }
            /// Returns true if there is one number for every axis.
            pub const fn is_vector(self) -> bool {
                match self { $(Field::$Name => $vector,)* }
            }
            /// The encoding of its numbers.
            pub const fn kind(self) -> Kind {
                match self { $(Field::$Name => <$Type as Number>::KIND,)* }
            }
            /// Hands on the bytes of the `wanted` fields' numbers of a device of `axes` joints, in their order.
            #[inline(always)]
            fn each(wanted: Fields, axes: usize, frame: &StepRecord, mut number: impl FnMut(&[u8])) {
                $(if wanted.0 & Field::$Name.bit() != 0 {
                    for i in 0..if $vector { axes.min($crate::model::catalogue::MAX_JOINTS) } else { 1 } {
                        let value: $Type = (|$frame: &StepRecord, $i: usize| $value)(frame, i);
                        number(&value.to_le_bytes());
                    }
                })*
            }
        }
    };
}

fields! {
    Angle = 0, "q", "rad", true, |frame, i| frame.at.q[i] => f32,
        "Joint angles";
    Speed = 1, "qd", "rad/s", true, |frame, i| frame.at.qd[i] => f32,
        "Joint velocities, filtered as the scene says";
    Tip = 2, "tip", "m", true, |frame, i| frame.at.tip[i] => f32,
        "Tip in the task frame; on a redundant arm the last is its orientation in rad";
    Torque = 3, "torque", "N m", true, |frame, i| frame.motors.torque[i] => f32,
        "Joint torques commanded, after all limits; 0 with the motors off";
    Current = 4, "current", "A", true, |frame, i| frame.motors.current[i] => f32,
        "Motor currents: measured, or those commanded where the board senses none";
    Duty = 5, "duty", "", true, |frame, i| frame.motors.duty[i] => f32,
        "Bridge duties of the carrier period after the step, as a signed share of the bus voltage";
    Distance = 6, "distance", "m", false, |frame, _i| frame.at.walls.distance => f32,
        "Distance of the tip to the deepest wall, negative inside it; 0 without walls";
    NormalVelocity = 7, "velocity", "m/s", false, |frame, _i| frame.at.walls.normal_velocity => f32,
        "Filtered tip velocity along the normal of the deepest wall, positive out of it";
    WallForce = 8, "force", "N", false, |frame, _i| frame.at.walls.wall_force => f32,
        "Force that the walls ask for, summed over the walls touched: no motor has been asked yet";
    RenderedForce = 15, "rendered", "N", false, |frame, _i| frame.motors.rendered_force => f32,
        "What the limits leave of that force: force less what ramp and the limits of tip force, torque and current took off along the normal of the deepest wall; 0 unless armed";
    Saturated = 16, "saturated", "", true, |frame, i| frame.saturation(i) => u8,
        "Which motors could not do what was asked: 0 none, 1 a limit of torque, current or tip force left another torque than was asked, 2 its duty is at the end of what the bus gives, 3 both";
    Shaping = 9, "shaping", "", false, |frame, _i| frame.at.walls.shaping => f32,
        "Share of the feed-forward that acts, 1 away from singular poses";
    Energy = 10, "energy", "J", false, |frame, _i| frame.at.walls.energy => f32,
        "Energy that the walls, the feed-forward included, have taken up since contact or the stream began; negative: given out";
    PassivityDamping = 11, "passivity", "N s/m", false, |frame, _i| frame.at.walls.passivity_damping => f32,
        "Damping that the passivity controller added";
    BusVoltage = 12, "bus", "V", false, |frame, _i| frame.motors.bus_voltage => f32,
        "Bus voltage; 0 where it is not sensed";
    Counts = 13, "counts", "", true, |frame, i| frame.counts[i] => i32,
        "Encoder counts, 32 bits, wrapping, before homing";
    // 0 disarmed, 1 armed, 2 checking polarity, 3 fault; plus 16 for every wall touched.
    State = 14, "state", "", false, |frame, _i| frame.state as u8 | frame.at.walls.contacts << 4 => u8,
        "The board's state as a word, and beside it (`contacts`) how many walls are touched";
}

/// A set of fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Fields(pub u32);

impl Fields {
    /// The fields that people usually want to see.
    pub const USUAL: Fields = Fields(
        Field::Tip.bit()
            | Field::Torque.bit()
            | Field::Duty.bit()
            | Field::Distance.bit()
            | Field::WallForce.bit()
            | Field::RenderedForce.bit()
            | Field::Saturated.bit()
            | Field::State.bit(),
    );
    /// Everything.
    pub const ALL: Fields = Fields(every_bit());

    /// Returns true if a field is in the set.
    pub const fn has(self, field: Field) -> bool {
        self.0 & field.bit() != 0
    }

    /// Bytes in one row for a device of `axes` joints.
    pub const fn bytes(self, axes: usize) -> usize {
        let (mut sum, mut i) = (0, 0);
        while i < Field::ALL.len() {
            let field = Field::ALL[i];
            if self.has(field) {
                sum += field.kind().bytes() * if field.is_vector() { axes } else { 1 };
            }
            i += 1;
        }
        sum
    }
}

const _: () =
    assert!(Fields::ALL.bytes(MAX_JOINTS) <= BATCH_BYTES && MAX_WALLS < 16, "a row fits, and its byte of state");

/// The bits of all fields.
const fn every_bit() -> u32 {
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
    /// Which fields.
    pub fields: Fields,
    /// Every how many control steps; 0 stops the stream.
    pub divider: u32,
    /// A number of the tool's choice that comes back with every batch: what it did not ask for it throws away.
    pub stream: u32,
}

/// Consecutive rows of telemetry.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Batch {
    /// The [`StreamRequest`]'s own number.
    pub stream: u32,
    /// Number of this batch since the stream started: a gap means the link lost some.
    pub number: u32,
    /// Control step of the first row.
    pub first_step: u32,
    /// Control steps between rows.
    pub divider: u32,
    /// Rows that the board had to drop since the stream started, because the link was too slow.
    pub dropped: u32,
    /// Axes a vector field has.
    pub axes: u8,
    /// Bits of [`Fields`].
    pub fields: u32,
    /// The rows, one after another, each in the order of [`Field::ALL`], each number as its [`Field::kind`] says.
    #[serde(serialize_with = "at_once")]
    pub rows: Vec<u8, BATCH_BYTES>,
}

/// Writes bytes as postcard writes a sequence of them, but not one by one.
fn at_once<S: Serializer>(bytes: &Vec<u8, BATCH_BYTES>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}

/// A queue of frames that wait to be packed, the oldest first.
pub trait Frames {
    /// The oldest.
    fn first(&self) -> Option<&StepRecord>;
    /// Drops it.
    fn drop_first(&mut self);
}

/// Packs frames into batches: one is filled while the other is on its way.
#[derive(Clone, Debug, Default)]
pub struct Packer {
    batches: [Batch; 2],
    filling: usize,
    sent: u32,
    /// Bytes of a row.
    width: usize,
}

impl Packer {
    /// Starts a stream for a device of `axes` joints.
    pub fn start(&mut self, request: &StreamRequest, axes: usize) {
        let axes = axes.min(MAX_JOINTS);
        let fields = request.fields.0 & Fields::ALL.0;
        for batch in &mut self.batches {
            batch.stream = request.stream;
            batch.divider = request.divider;
            batch.fields = fields;
            batch.axes = axes as u8;
            batch.rows.clear();
        }
        self.sent = 0;
        self.width = Fields(fields).bytes(axes);
    }

    /// Ends it.
    pub fn stop(&mut self) {
        self.width = 0;
        self.batches.iter_mut().for_each(|batch| batch.rows.clear());
    }

    /// Returns true if a stream is on and wants this step.
    #[inline(always)]
    pub fn wants(&self, step: u32) -> bool {
        self.width > 0 && step.checked_rem(self.batches[0].divider) == Some(0)
    }

    /// Adds a frame that [`Packer::wants`]. `dropped` counts rows lost on the board so far. Returns a batch when this
    /// frame does not continue the one under way, or fills it.
    pub fn push(&mut self, frame: &StepRecord, dropped: u32) -> Option<&Batch> {
        let batch = &self.batches[self.filling & 1];
        let rows = batch.rows.len().checked_div(self.width).unwrap_or(0) as u32;
        let due = batch.first_step.wrapping_add(rows.wrapping_mul(batch.divider));
        let mut full = None;
        if rows > 0 && frame.step != due {
            full = Some(self.turn());
        }
        let batch = &mut self.batches[self.filling & 1];
        if batch.rows.is_empty() {
            batch.first_step = frame.step;
        }
        batch.dropped = dropped;
        let (fields, bytes) = (Fields(batch.fields), &mut batch.rows);
        Field::each(fields, batch.axes.into(), frame, |number| {
            let _ = bytes.extend_from_slice(number);
        });
        if full.is_none() && batch.rows.len() + self.width > BATCH_BYTES {
            full = Some(self.turn());
        }
        full.map(|full| &self.batches[full & 1])
    }

    /// Packs what frames wait in a queue, up to the first full batch, which is returned; the batch under way instead,
    /// if none is full and rows have waited too long (`late`).
    pub fn drain(&mut self, frames: &mut impl Frames, dropped: u32, late: bool) -> Option<&Batch> {
        let mut full = false;
        while !full && let Some(frame) = frames.first() {
            full = self.wants(frame.step) && self.push(frame, dropped).is_some();
            frames.drop_first();
        }
        if late && !full {
            return self.flush();
        }
        full.then(|| &self.batches[!self.filling & 1])
    }

    /// The batch under way, if it holds any row: call when the stream is slow, so that rows do not wait.
    pub fn flush(&mut self) -> Option<&Batch> {
        if self.batches[self.filling & 1].rows.is_empty() {
            return None;
        }
        let full = self.turn();
        Some(&self.batches[full & 1])
    }

    /// Ends the batch under way, numbers it, and goes on with the other one; which one was ended.
    fn turn(&mut self) -> usize {
        let full = self.filling & 1;
        self.batches[full].number = self.sent;
        self.sent = self.sent.wrapping_add(1);
        self.filling = full ^ 1;
        self.batches[full ^ 1].rows.clear();
        full
    }
}

#[cfg(test)]
mod tests {
    use super::{Fields, Kind, Number};
    use crate::control::frame::{Motors, StepRecord};
    use crate::control::joints::Torques;
    use crate::render::step_result::{AtWalls, DeviceState};
    use heapless::Vec;

    fields! {
        Height = 3, "height", "m", false, |frame, _i| frame.at.tip[1] => f32, "How high the tip is";
        Doubled = 5, "doubled", "N m", true, |frame, i| (2.0 * frame.motors.torque[i]) as u8 => u8, "Twice the torque";
        Depth = 6, "depth", "mm", false, |frame, _i| (-1000.0 * frame.at.walls.distance) as i32 => i32, "Depth in the deepest wall";
    }

    /// Everything that is told of a signal follows from its line.
    #[test]
    fn a_toy_signal_is_one_line() {
        let walls = AtWalls { distance: -0.5, ..AtWalls::default() };
        let at = DeviceState { tip: [0.1, 0.2, 0.3], walls, ..DeviceState::default() };
        let motors = Motors { torque: Torques([1.0, 2.0, 3.0]), ..Motors::default() };
        let frame = StepRecord { at, motors, ..StepRecord::default() };
        let told =
            |field: &Field| (field.bit(), field.name(), field.unit(), field.is_vector(), field.kind(), field.meaning());
        let told_of_all = [
            (8, "height", "m", false, Kind::Float, "How high the tip is"),
            (32, "doubled", "N m", true, Kind::Byte, "Twice the torque"),
            (64, "depth", "mm", false, Kind::Integer, "Depth in the deepest wall"),
        ];
        assert!(Field::ALL.iter().map(told).eq(told_of_all));
        let mut row = Vec::<u8, 16>::new();
        Field::each(Fields(8 | 32 | 64), 2, &frame, |number| row.extend_from_slice(number).unwrap());
        // 0.2 is 0x3E4CCCCD (IEEE 754), 500 is 0x1F4.
        assert_eq!(row[..], [0xCD, 0xCC, 0x4C, 0x3E, 2, 4, 0xF4, 1, 0, 0]);
    }
}
