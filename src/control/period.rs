//! The order of a carrier period for all callers except the chip's interrupt: [`ControlLoop::crest`] at the crest, then
//! [`ControlLoop::check_slow_faults`] at the valley. The interrupt does the same with the functions of
//! [`super::compiled`], in parts between which the converters work. The parts of a crest can also be called separately.

use super::ControlLoop;
use crate::control::frame::{Outputs, Samples};
use crate::control::joints::Currents;
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use core::ops::DerefMut;

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Runs one crest, with a control step if `due`: renders the scene, checks the samples, commands torques and
    /// returns the drives of all motors for the next carrier period. If index pulses were seen, call
    /// [`ControlLoop::mark`] before. Call [`ControlLoop::check_slow_faults`] after. `samples` are the samples of each
    /// motor, see [`ControlLoop::duties`].
    pub fn crest(
        &mut self,
        seen: &Samples,
        samples: &[S::Sample; MAX_JOINTS],
        due: bool,
    ) -> (Outputs, [S::Drive; MAX_JOINTS]) {
        if due {
            self.render(&seen.counts);
        }
        let mut outputs = self.guard(seen);
        if due {
            outputs = self.act(seen);
        }
        (outputs, self.duties(seen.bus_voltage, samples, seen.late))
    }

    /// Runs one control period: [`ControlLoop::render`], then [`ControlLoop::act`].
    pub fn control(&mut self, samples: &Samples) -> Outputs {
        self.render(&samples.counts);
        self.act(samples)
    }

    /// Checks the counts, currents and supply of this crest. `bridges` of the result is true if the bridges may drive.
    /// Call at every crest, before [`ControlLoop::act`] (if a step is due) and before [`ControlLoop::duties`].
    pub fn guard(&mut self, seen: &Samples) -> Outputs {
        self.look(&self.known(seen));
        self.outputs()
    }

    /// Finishes the control step: runs the checks and commands the torques that [`ControlLoop::render`] computed for
    /// the same counts.
    pub fn act(&mut self, samples: &Samples) -> Outputs {
        self.step(&self.known(samples));
        if !self.hardware.bridge.current_sensed {
            self.now.motors.current = Currents(self.joints.each_ref().map(|joint| joint.stage.asked()));
        }
        self.outputs()
    }

    /// Returns the drive of each motor's legs for the next carrier period, from the bus voltage (V) and each motor's
    /// sample. For brushed motors the samples are currents (A) and the drives signed duties within
    /// ±[`MAX_DUTY`](crate::drive::stage::MAX_DUTY). The drives are zero unless armed. `late` is true if they apply
    /// from the next crest instead of the next valley, see [`Stage::drive`].
    pub fn duties(
        &mut self,
        bus_voltage: f32,
        samples: &[S::Sample; MAX_JOINTS],
        late: bool,
    ) -> [S::Drive; MAX_JOINTS] {
        let mut drives = [S::Drive::default(); MAX_JOINTS];
        self.drive(bus_voltage, samples, late, &|drive| drive, &mut drives);
        drives
    }

    /// Completes the samples of a board that lacks sensors: uses the commanded currents, and a bus voltage of 0, for
    /// which no limit applies.
    pub(super) fn known(&self, seen: &Samples) -> Samples {
        let mut seen = *seen;
        if !self.hardware.bridge.current_sensed {
            (seen.currents, seen.imbalance) = (self.now.motors.current, Currents::default());
        }
        if !self.hardware.bus_sensed {
            seen.bus_voltage = 0.0;
        }
        seen
    }
}
