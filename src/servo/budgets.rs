//! What builds up over many carrier periods and then must turn the motors off: heat, stalls, lost encoders. It is looked
//! at at the carrier's valley, of one joint at a time in turn: all of it takes milliseconds at least, and the crest has
//! more urgent things to do.

use super::Servo;
use crate::drive::stage::Stage;
use crate::math::{Math, limited};
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::Fault;
use crate::servo::frame::{Outputs, Samples};
use crate::servo::joints::Counts;
use crate::servo::program::Program;
use core::ops::DerefMut;

/// How long torque near its limit without any encoder motion is believed, s.
pub const STALL_SECONDS: f32 = 5.0;
/// How long an encoder may stand still while the back-EMF says the joint turns, s.
pub const LOSS_SECONDS: f32 = 0.05;

/// The sums.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Budgets {
    /// The joint whose turn it is.
    joint: usize,
    /// Each encoder's count at its joint's last turn.
    counts: Counts,
    /// Time without a count in spite of torque, s.
    still: [f32; MAX_JOINTS],
    /// Time without a count in spite of back-EMF, s.
    lost: [f32; MAX_JOINTS],
    /// Torque that moves a joint unless it is blocked, N m.
    stall: [f32; MAX_JOINTS],
}

impl Budgets {
    /// Forgets what was summed up while the motors were on the last time; what heated them stays.
    pub(super) fn anew(&mut self) {
        self.still = [0.0; MAX_JOINTS];
        self.lost = [0.0; MAX_JOINTS];
    }

    /// Takes the largest torques of the motors, N m.
    pub(super) fn set_torques(&mut self, largest: [f32; MAX_JOINTS]) {
        self.stall = largest.map(|torque| if torque > 0.0 { 0.8 * torque } else { f32::INFINITY });
    }
}

impl<P, K, S> Servo<P>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Sums up what the crest before showed (`seen`), and says whether the bridges may go on driving. Call at every
    /// valley, after [`Servo::duties`].
    #[inline(always)]
    pub fn sum_up(&mut self, seen: &Samples) -> Outputs {
        let active = self.state.drives();
        if let Some((fault, axis, value)) = self.spent(seen, active)
            && active
        {
            self.trip(fault, Some(axis as u8), value);
        }
        self.outputs()
    }

    /// Sums up for the joint whose turn it is; what of it is spent, the joint and its number.
    #[inline(always)]
    fn spent(&mut self, seen: &Samples, active: bool) -> Option<(Fault, usize, f32)> {
        let joints = self.joints();
        let elapsed = self.crests.period() * joints as f32;
        let program = &mut **self.program.as_mut()?;
        let budgets = &mut self.budgets;
        let i = if budgets.joint < joints { budgets.joint } else { 0 };
        budgets.joint = i + 1;
        let (axis, motor) = (program.axes.get(i)?, self.heat.get_mut(i)?);
        let motors = &self.now.motors;
        let sensed = self.hardware.bridge.current_sensed;
        let current = if sensed { seen.currents[i] } else { motors.current[i] };
        let mut found = None;
        let count = seen.counts[i];
        let moved = core::mem::replace(&mut budgets.counts[i], count) != count;
        let heat = limited(self.crests.take_heat(i), f32::MAX);
        // The motor model goes on while the motors are off: that is when they cool.
        if motor.warm(heat, elapsed) {
            found = Some((Fault::ThermalBudget, i, current));
        }
        if moved {
            budgets.still[i] = 0.0;
            budgets.lost[i] = 0.0;
        } else if active {
            if motors.torque[i].abs() > budgets.stall[i] {
                budgets.still[i] += elapsed;
                if budgets.still[i] > STALL_SECONDS {
                    found = Some((Fault::EncoderStall, i, budgets.still[i]));
                }
            }
            // Voltage across the motor less R i is its back-EMF: when that says several rad/s, counts must move.
            if sensed && self.hardware.bus_sensed {
                let turning = axis.speed_of(motors.duty[i], seen.bus_voltage, current);
                let suspicious = turning.abs() > 0.25 * self.rules.limits.speed[i];
                budgets.lost[i] = if suspicious { budgets.lost[i] + elapsed } else { 0.0 };
                if budgets.lost[i] > LOSS_SECONDS {
                    found = Some((Fault::EncoderLoss, i, turning));
                }
            }
        }
        found
    }
}
