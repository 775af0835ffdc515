//! What is looked at at the carrier's valley, right after the drives of the crest before it: whether each motor is as its
//! device file says; and, of one joint at a time in turn, what builds up over many carrier periods (heat, stalls, lost
//! encoders), all of which takes milliseconds at least.

use super::Servo;
use crate::drive::bits::left;
use crate::drive::stage::Stage;
use crate::math::{Math, limited};
use crate::safety::fault::Fault;
use crate::servo::frame::{Outputs, Samples};
use crate::servo::program::Program;
use core::ops::DerefMut;

/// How long torque near its limit without any encoder motion is believed, s.
pub const STALL_SECONDS: f32 = 5.0;
/// How long an encoder may stand still while the back-EMF says the joint turns, s.
pub const LOSS_SECONDS: f32 = 0.05;

/// What is summed up of one joint.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    /// Its encoder's count at its last turn.
    count: i32,
    /// Squares of its motor's current since then, A².
    squares: f32,
    /// Time without a count in spite of torque, s, and torque that moves a joint unless it is blocked, N m.
    still: f32,
    stall: f32,
    /// Time without a count in spite of back-EMF, s, and a speed that cannot go without any, rad/s.
    lost: f32,
    suspicious: f32,
}

impl Sums {
    /// Forgets what was summed up while the motors were on the last time; what heated them stays.
    pub(super) fn anew(&mut self) {
        (self.still, self.lost) = (0.0, 0.0);
    }

    /// Takes the motor's largest torque (N m) and the joint's speed limit (rad/s).
    pub(super) fn set_limits(&mut self, torque: f32, speed: f32) {
        self.stall = if torque > 0.0 { 0.8 * torque } else { f32::INFINITY };
        self.suspicious = 0.25 * speed;
    }
}

impl<P, K, S> Servo<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Sums up what the crest before showed (`seen`), and says whether the bridges may go on driving. Call at every
    /// valley, after [`Servo::duties`].
    pub fn sum_up(&mut self, seen: &Samples) -> Outputs {
        let seen = &self.known(seen);
        let supplied = core::mem::take(&mut self.supplied);
        let sensed = self.hardware.bridge.current_sensed && self.hardware.bus_sensed;
        self.sum_up_of(seen, (supplied > 0.0).then_some(supplied), sensed);
        self.outputs()
    }

    /// [`Servo::sum_up`], where the drives since the last valley were `supplied` with so many volts, if there were any, and
    /// all that is seen is `sensed` or not.
    #[inline(always)]
    pub(super) fn sum_up_of(&mut self, seen: &Samples, supplied: Option<f32>, sensed: bool) {
        let active = self.state.drives();
        if active {
            match self.count() {
                2 => self.doubt::<2>(seen, supplied),
                3 => self.doubt::<3>(seen, supplied),
                _ => self.doubt::<1>(seen, supplied),
            }
        }
        let joints = self.count();
        let i = if self.turn < joints { self.turn } else { 0 };
        self.turn = i + 1;
        if joints > 0
            && let Some((fault, value)) = self.spent(i, seen, sensed, active)
            && active
        {
            self.trip(fault, Some(i as u8), value);
        }
    }

    /// Holds what the drives of J joints have left to what a sound motor leaves.
    #[inline(always)]
    fn doubt<const J: usize>(&mut self, seen: &Samples, supplied: Option<f32>) {
        let mut least = 0;
        for (joint, current) in self.joints.iter_mut().zip(seen.currents.iter()).take(J) {
            joint.sums.squares += current * current;
            if let Some(bus_voltage) = supplied {
                let (strain, doubt) = joint.settle(bus_voltage);
                least |= left(strain, doubt);
            }
        }
        if least < 0 {
            self.find_strained();
        }
    }

    /// A motor is not as its device file says: finds out which, and turns the motors off.
    #[cold]
    #[inline(never)]
    fn find_strained(&mut self) {
        let joints = self.count();
        let strained = self.joints.iter().enumerate().take(joints).find_map(|(i, joint)| {
            let (strain, doubt) = joint.stage.strain();
            (left(strain, doubt) < 0).then_some((i, joint, strain))
        });
        let Some((i, joint, strain)) = strained else { return };
        // A current as it should be and a voltage that only motion explains: the encoder is what stands still.
        let (fault, value) = if joint.stage.flows_as_expected() && joint.stands_still() {
            (Fault::EncoderLoss, joint.stage.turning(strain))
        } else {
            (Fault::MotorModel, strain)
        };
        self.trip(fault, Some(i as u8), value);
    }

    /// Sums up for joint `i`, whose turn it is; what of it is spent, and its number.
    #[inline(always)]
    fn spent(&mut self, i: usize, seen: &Samples, sensed: bool, active: bool) -> Option<(Fault, f32)> {
        let period = self.crests.period;
        let elapsed = period * self.count() as f32;
        let (joint, motor) = (self.joints.get_mut(i)?, self.heat.get_mut(i)?);
        let (motors, sums) = (&self.now.motors, &mut joint.sums);
        let (count, current) = (seen.counts[i], seen.currents[i]);
        let mut found = None;
        let moved = core::mem::replace(&mut sums.count, count) != count;
        let heat = limited(core::mem::take(&mut sums.squares) * period, f32::MAX);
        // The motor model goes on while the motors are off: that is when they cool.
        if motor.warm(heat, elapsed) {
            found = Some((Fault::ThermalBudget, current));
        }
        if moved {
            sums.anew();
        } else if active {
            if motors.torque[i].abs() > sums.stall {
                sums.still += elapsed;
                if sums.still > STALL_SECONDS {
                    found = Some((Fault::EncoderStall, sums.still));
                }
            }
            // Voltage across the motor less R i is its back-EMF: when that says several rad/s, counts must move.
            if sensed {
                let turning = joint.stage.speed_of(motors.duty[i], seen.bus_voltage, current);
                sums.lost = if turning.abs() > sums.suspicious { sums.lost + elapsed } else { 0.0 };
                if sums.lost > LOSS_SECONDS {
                    found = Some((Fault::EncoderLoss, turning));
                }
            }
        }
        found
    }
}
