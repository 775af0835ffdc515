//! Telemetry: which numbers of a step travel, and how they are packed into batches.
//!
//! A batch holds consecutive kept steps (every `divider`-th) of the chosen fields as `f32`; a gap starts a new batch,
//! so a reader knows the step of every row and counts losses exactly: missing steps, and the board's own count of what
//! it had to drop. Every batch carries the number that the tool gave its stream: what a killed tool left on the link is
//! told from what the next one asked for.

use crate::model::catalogue::MAX_JOINTS;
use crate::servo::frame::StepRecord;
use heapless::Vec;
use heapless::spsc::Consumer;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Most numbers in a batch.
pub const BATCH_VALUES: usize = 220;

macro_rules! fields {
    ($($Name:ident = $bit:literal, $name:literal, $unit:literal, $vector:literal, |$frame:ident, $i:ident| $value:expr, $meaning:literal;)*) => {
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
            /// What it is, for people: docs/telemetry.md and `haptic stream --help` hold these sentences.
            pub const fn meaning(self) -> &'static str {
                match self { $(Field::$Name => $meaning,)* }
            }
            /// Whether there is one number for every axis.
            pub const fn is_vector(self) -> bool {
                match self { $(Field::$Name => $vector,)* }
            }
            /// Hands on the numbers of the `wanted` fields of a device of `axes` joints, in their order.
            #[inline(always)]
            fn each(wanted: Fields, axes: usize, frame: &StepRecord, mut number: impl FnMut(f32)) {
                $(if wanted.0 & Field::$Name.bit() != 0 {
                    for i in 0..if $vector { axes.min($crate::model::catalogue::MAX_JOINTS) } else { 1 } {
                        number((|$frame: &StepRecord, $i: usize| -> f32 { $value })(frame, i));
                    }
                })*
            }
        }
    };
}

fields! {
    Angle = 0, "q", "rad", true, |frame, i| frame.at.q[i],
        "Joint angles";
    Speed = 1, "qd", "rad/s", true, |frame, i| frame.at.qd[i],
        "Joint velocities, filtered as the scene says";
    Tip = 2, "tip", "m", true, |frame, i| frame.at.tip[i],
        "Tip in the task frame; on a redundant arm the last is its orientation in rad";
    Torque = 3, "torque", "N m", true, |frame, i| frame.motors.torque[i],
        "Joint torques commanded, after all limits; 0 with the motors off";
    Current = 4, "current", "A", true, |frame, i| frame.motors.current[i],
        "Motor currents: measured, or those commanded where the board senses none";
    Duty = 5, "duty", "", true, |frame, i| frame.motors.duty[i],
        "Bridge duties of the carrier period after the step, as a signed share of the bus voltage";
    Distance = 6, "distance", "m", false, |frame, _i| frame.at.walls.distance,
        "Distance of the tip to the deepest wall, negative inside it; 0 without walls";
    NormalVelocity = 7, "velocity", "m/s", false, |frame, _i| frame.at.walls.normal_velocity,
        "Filtered tip velocity along the normal of the deepest wall, positive out of it";
    WallForce = 8, "force", "N", false, |frame, _i| frame.at.walls.wall_force,
        "Force that the walls ask for, summed over the walls touched: no motor has been asked yet";
    RenderedForce = 15, "rendered", "N", false, |frame, _i| frame.motors.rendered_force,
        "What the limits leave of that force: force less what ramp and the limits of tip force, torque and current took off along the normal of the deepest wall; 0 unless armed";
    Saturated = 16, "saturated", "", true, |frame, i| frame.saturation(i),
        "Which motors could not do what was asked: 0 none, 1 a limit of torque, current or tip force left another torque than was asked, 2 its duty is at the end of what the bus gives, 3 both";
    Shaping = 9, "shaping", "", false, |frame, _i| frame.at.walls.shaping,
        "Share of the feed-forward that acts, 1 away from singular poses";
    Energy = 10, "energy", "J", false, |frame, _i| frame.at.walls.energy,
        "Energy that the touched walls have taken up since contact began; negative: given out";
    PassivityDamping = 11, "passivity", "N s/m", false, |frame, _i| frame.at.walls.passivity_damping,
        "Damping that the passivity controller added";
    BusVoltage = 12, "bus", "V", false, |frame, _i| frame.motors.bus_voltage,
        "Bus voltage; 0 where it is not sensed";
    // The bits of a 32-bit integer in the place of a float, so that none is lost.
    Counts = 13, "counts", "", true, |frame, i| f32::from_bits(frame.counts[i] as u32),
        "Encoder counts, 32 bits, wrapping, before homing";
    // 0 disarmed, 1 armed, 2 checking polarity, 3 fault; plus 16 for every wall touched.
    State = 14, "state", "", false, |frame, _i| f32::from(frame.state as u8) + 16.0 * f32::from(frame.at.walls.contacts),
        "The board's state as a word, and beside it (`contacts`) how many walls are touched";
}

/// A set of fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Fields(pub u32);

impl Fields {
    /// What a person usually wants to see.
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

    /// Whether a field is in the set.
    pub const fn has(self, field: Field) -> bool {
        self.0 & field.bit() != 0
    }

    /// Numbers in one row for a device of `axes` joints.
    pub fn width(self, axes: usize) -> usize {
        let numbers = |field: &Field| if field.is_vector() { axes } else { 1 };
        Field::ALL.iter().filter(|field| self.has(**field)).map(numbers).sum()
    }
}

/// The bits of all fields.
const fn every_bit() -> u32 {
    let (mut bits, mut i) = (0, 0);
    while i < Field::ALL.len() {
        bits |= Field::ALL[i].bit();
        i += 1;
    }
    bits
}

/// What a tool asks to be sent.
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
    /// The rows, one after another, each in the order of [`Field::ALL`].
    pub values: Vec<f32, BATCH_VALUES>,
}

/// Packs frames into batches: one is filled while the other is on its way.
#[derive(Clone, Debug, Default)]
pub struct Packer {
    batches: [Batch; 2],
    filling: usize,
    sent: u32,
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
            batch.values.clear();
        }
        self.sent = 0;
        self.width = Fields(fields).width(axes);
    }

    /// Ends it.
    pub fn stop(&mut self) {
        self.width = 0;
        self.batches.iter_mut().for_each(|batch| batch.values.clear());
    }

    /// Whether a stream is on and wants this step.
    #[inline(always)]
    pub fn wants(&self, step: u32) -> bool {
        self.width > 0 && step.checked_rem(self.batches[0].divider) == Some(0)
    }

    /// Adds a frame that [`Packer::wants`]. `dropped` counts rows lost on the board so far. Returns a batch when this
    /// frame does not continue the one under way, or fills it.
    pub fn push(&mut self, frame: &StepRecord, dropped: u32) -> Option<&Batch> {
        let batch = &self.batches[self.filling & 1];
        let rows = batch.values.len().checked_div(self.width).unwrap_or(0) as u32;
        let due = batch.first_step.wrapping_add(rows.wrapping_mul(batch.divider));
        let mut full = None;
        if rows > 0 && frame.step != due {
            full = Some(self.turn());
        }
        let batch = &mut self.batches[self.filling & 1];
        if batch.values.is_empty() {
            batch.first_step = frame.step;
        }
        batch.dropped = dropped;
        let (fields, values) = (Fields(batch.fields), &mut batch.values);
        Field::each(fields, batch.axes.into(), frame, |number| {
            let _ = values.push(number);
        });
        if full.is_none() && batch.values.len() + self.width > BATCH_VALUES {
            full = Some(self.turn());
        }
        full.map(|full| &self.batches[full & 1])
    }

    /// Packs what frames wait in a queue, up to the first full batch, which is returned; the batch under way instead,
    /// if none is full and rows have waited too long (`late`).
    pub fn drain(&mut self, frames: &mut Consumer<'_, StepRecord>, dropped: u32, late: bool) -> Option<&Batch> {
        let mut full = false;
        while !full && let Some(frame) = frames.peek() {
            full = self.wants(frame.step) && self.push(frame, dropped).is_some();
            let _ = frames.dequeue();
        }
        if late && !full {
            return self.flush();
        }
        full.then(|| &self.batches[!self.filling & 1])
    }

    /// The batch under way, if it holds any row: call when the stream is slow, so that rows do not wait.
    pub fn flush(&mut self) -> Option<&Batch> {
        if self.batches[self.filling & 1].values.is_empty() {
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
        self.batches[full ^ 1].values.clear();
        full
    }
}

#[cfg(test)]
mod tests {
    use super::Fields;
    use crate::render::found::{At, AtWalls};
    use crate::servo::frame::{Motors, StepRecord};
    use crate::servo::joints::Torques;
    use heapless::Vec;

    fields! {
        Height = 3, "height", "m", false, |frame, _i| frame.at.tip[1], "How high the tip is";
        Doubled = 5, "doubled", "N m", true, |frame, i| 2.0 * frame.motors.torque[i], "Twice the torque";
        Depth = 6, "depth", "m", false, |frame, _i| -frame.at.walls.distance, "Depth in the deepest wall";
    }

    /// Everything that is told of a signal follows from its line.
    #[test]
    fn a_toy_signal_is_one_line() {
        let walls = AtWalls { distance: -0.5, ..AtWalls::default() };
        let at = At { tip: [0.1, 0.2, 0.3], walls, ..At::default() };
        let motors = Motors { torque: Torques([1.0, 2.0, 3.0]), ..Motors::default() };
        let frame = StepRecord { at, motors, ..StepRecord::default() };
        let told = |field: &Field| (field.bit(), field.name(), field.unit(), field.is_vector(), field.meaning());
        let told_of_all = [
            (8, "height", "m", false, "How high the tip is"),
            (32, "doubled", "N m", true, "Twice the torque"),
            (64, "depth", "m", false, "Depth in the deepest wall"),
        ];
        assert!(Field::ALL.iter().map(told).eq(told_of_all));
        let mut row = Vec::<f32, 8>::new();
        Field::each(Fields(8 | 32 | 64), 2, &frame, |number| row.push(number).unwrap());
        assert_eq!(row[..], [0.2, 2.0, 4.0, 0.5]);
    }
}
