//! The carrier period of all callers except the chip's interrupt: [`ControlLoop::crest`] at the crest, then
//! [`ControlLoop::check_slow_faults`] at the valley. The interrupt calls the functions of [`super::compiled`] instead,
//! because the converters work between the parts of its crest. Each part of a crest can also be called separately.

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
    /// Runs one crest and returns the drives of all motors for the next carrier period. With a control step `due`, also
    /// renders the scene and commands torques. `samples` are the samples of each motor, see [`ControlLoop::duties`]. If
    /// motors have three phases, call [`ControlLoop::read_phases`] first.
    /// Call [`ControlLoop::mark`] before if index pulses arrived, and [`ControlLoop::check_slow_faults`] after.
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

    /// Checks the counts, currents and supply of this crest, and returns the state of the bridges. Call at every crest,
    /// before [`ControlLoop::act`] (if a step is due) and before [`ControlLoop::duties`].
    pub fn guard(&mut self, seen: &Samples) -> Outputs {
        self.check_samples(&self.complete_samples(seen));
        self.outputs()
    }

    /// Runs the checks of the control step, and commands the torques that [`ControlLoop::render`] computed.
    pub fn act(&mut self, samples: &Samples) -> Outputs {
        self.step(&self.complete_samples(samples));
        if !self.hardware.bridge.current_sensed {
            self.now.motors.current = Currents(self.joints.each_ref().map(|joint| joint.stage.target_current()));
        }
        self.outputs()
    }

    /// Returns the drive of each motor's legs for the next carrier period, from the bus voltage (V) and each motor's
    /// sample. For brushed motors the samples are currents (A), and the drives are signed duties within
    /// ±[`MAX_DUTY`](crate::drive::stage::MAX_DUTY). The drives are zero unless armed. Late drives apply from the next
    /// crest instead of the next valley, see [`Stage::drive`].
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

    /// Completes the samples of a board that lacks sensors: commanded currents, and a bus voltage of 0, which has no
    /// limit.
    pub(super) fn complete_samples(&self, seen: &Samples) -> Samples {
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
