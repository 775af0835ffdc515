//! One control period of the board, without the board: samples in, bridge state and currents out; then, once per
//! carrier period, duties.
//!
//! The firmware's interrupt, the simulated board and the tests all run this very code. Configuration reaches it whole,
//! between two steps: a [`Program`] is built elsewhere and handed over by ownership, small changes are [`Command`]s.
//! Nothing here blocks, allocates or panics.

mod budgets;
pub mod compiled;
mod crest;
mod fade;
pub mod frame;
pub mod host_force;
pub mod joints;
mod polarity;
pub mod program;
mod requests;
mod rules;
mod saturation;
mod watch;

use crate::drive::heat::Heat;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::render::found::Asked;
use crate::render::scene::DEFAULT_RATE_HZ;
use crate::safety::fault::{Fault, FaultRecord, State};
use crate::servo::frame::{Now, Outputs, Samples, StepRecord};
use crate::servo::joints::{Counts, Currents, Duties, Torques};
use crate::servo::program::Hardware;
use crate::servo::program::Program;
use core::ops::DerefMut;
pub use crest::SPEED_HZ;
pub use requests::{Command, REST_SPEED, Reply, Status};
pub use rules::{HostAction, Rules};

/// Seconds over which torque ramps up after arming.
pub const ARM_SECONDS: f32 = 0.5;

/// `$body` compiled for each number of joints that a device may have, with J for that number: it has neither loops nor
/// indices to check.
macro_rules! for_joints {
    ($joints:expr, $J:ident => $body:expr) => {
        match $joints {
            0 => for_joints!(@ 0, $J => $body),
            1 => for_joints!(@ 1, $J => $body),
            2 => for_joints!(@ 2, $J => $body),
            _ => for_joints!(@ MAX_JOINTS, $J => $body),
        }
    };
    (@ $joints:expr, $J:ident => $body:expr) => {{
        const $J: usize = $joints;
        $body
    }};
}
use for_joints;

/// The board's control loop. In this order in memory: what every step needs lies within the 1 KB that the FPU's loads reach.
#[derive(Debug)]
#[repr(C)]
pub struct Servo<P> {
    state: State,
    homed: bool,
    polarity_known: bool,
    program: Option<P>,
    now: Now,
    hardware: Hardware,
    crests: crest::Crests,
    /// What each joint may be asked for, N m, and the square of what all of it may be at the tip, N².
    most_torque: Torques,
    most_force_squared: f32,
    period: f32,
    /// The step since which that is the period.
    rate_since: u32,
    host_silent: f32,
    /// For how long it may be, s: without end where nobody minds.
    host_patience: f32,
    rules: Rules,
    host: host_force::HostForce,
    /// What acted before the present scene, while it fades out.
    fade: fade::Fade,
    /// What the last step commanded, where that is not all of what was asked.
    cut: Option<fade::Acted>,
    budgets: budgets::Budgets,
    /// What heat the motors hold, whatever device is loaded.
    heat: [Heat; MAX_JOINTS],
    first_index: [Option<i32>; MAX_JOINTS],
    polarity: polarity::PolarityCheck,
    fault: Option<FaultRecord>,
}

impl<P, K, S> Servo<P>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// A disarmed servo without a device.
    pub fn new(hardware: Hardware, rules: Rules) -> Self {
        Self {
            hardware,
            rules,
            program: None,
            state: State::Disarmed,
            homed: false,
            polarity_known: false,
            polarity: polarity::PolarityCheck::default(),
            fault: None,
            now: Now::default(),
            period: 1.0 / DEFAULT_RATE_HZ as f32,
            rate_since: 0,
            fade: fade::Fade::default(),
            cut: Some(fade::Acted::default()),
            most_torque: Torques::default(),
            most_force_squared: 0.0,
            host_silent: 0.0,
            host_patience: 0.0,
            first_index: [None; MAX_JOINTS],
            crests: crest::Crests::default(),
            host: host_force::HostForce::default(),
            budgets: budgets::Budgets::default(),
            heat: [Heat::default(); MAX_JOINTS],
        }
    }

    /// Goes on with the heat that an earlier run left in the motors. Call before the first program.
    pub fn start_heat(&mut self, heat: [Heat; MAX_JOINTS]) {
        self.heat = heat;
    }

    /// The motors' heat, to be handed to [`Servo::start_heat`] of the run after this.
    pub fn heat(&self) -> &[Heat; MAX_JOINTS] {
        &self.heat
    }

    /// What telemetry records of the last step, with the present state.
    #[inline(always)]
    pub fn frame(&self) -> StepRecord {
        StepRecord::of(&self.now, self.state)
    }

    /// Control steps since boot, wrapping.
    #[inline(always)]
    pub fn steps(&self) -> u32 {
        self.now.step
    }

    /// For how long no heartbeat has come, s, counted from the start, a change of rules or arming.
    pub fn host_silent(&self) -> f32 {
        self.host_silent
    }

    /// Control rate of the loaded program, Hz.
    pub fn rate_hz(&self) -> Option<f32> {
        self.program.as_ref().map(|program| program.rate_hz)
    }

    /// One control period: [`Servo::render`], then [`Servo::act`].
    #[inline(always)]
    pub fn control(&mut self, samples: &Samples) -> Outputs {
        self.render(&samples.counts);
        self.act(samples)
    }

    /// The part of a control period that needs no more than encoder counts: what the scene asks of the joints. The motors
    /// go on as they are, and so does what they are held to.
    #[inline(always)]
    pub fn render(&mut self, counts: &Counts) {
        self.push();
        let Some(program) = self.program.as_mut() else { return };
        program.controller.step(counts, &self.now.motors.torque, &mut self.now.found);
        self.pull();
    }

    /// The rest of it: watches, and sets what each motor shall do of what was rendered for the same counts.
    #[inline(always)]
    pub fn act(&mut self, samples: &Samples) -> Outputs {
        for_joints!(self.joints(), J => self.act_of::<J>(samples))
    }

    /// [`Servo::act`] of J joints.
    #[inline(always)]
    fn act_of<const J: usize>(&mut self, samples: &Samples) -> Outputs {
        self.now.step = self.now.step.wrapping_add(1);
        self.now.motors.bus_voltage = if self.hardware.bus_sensed { samples.bus_voltage } else { 0.0 };
        if let Some((fault, axis, value)) = samples.fault {
            self.trip(fault, axis, value);
        }
        self.host_silent += self.period;
        if self.program.is_some() {
            self.watch::<J>(samples);
            self.drive::<J>();
        }
        self.now.counts = samples.counts;
        self.outputs()
    }

    /// What the bridges may do.
    #[inline(always)]
    fn outputs(&self) -> Outputs {
        Outputs { bridges: self.state.drives() }
    }

    /// Joints of the loaded program, at most [`MAX_JOINTS`].
    #[inline(always)]
    fn joints(&self) -> usize {
        self.program.as_ref().map_or(0, |program| program.joints.min(MAX_JOINTS))
    }

    /// What each motor's legs do over the next carrier period, from the bus voltage (V) and what was sampled of each motor:
    /// for brushed motors currents (A) to duties, signed, ±[`MAX_DUTY`](crate::drive::stage::MAX_DUTY). No voltage unless
    /// armed. `late` is whether they apply from the next crest on instead of the next valley, see [`Stage::drive`].
    #[inline(always)]
    pub fn duties(
        &mut self,
        bus_voltage: f32,
        samples: &[S::Sample; MAX_JOINTS],
        late: bool,
    ) -> [S::Drive; MAX_JOINTS] {
        for_joints!(self.joints(), J => self.duties_of::<J>(bus_voltage, samples, late))
    }

    /// [`Servo::duties`] of J joints.
    #[inline(always)]
    fn duties_of<const J: usize>(
        &mut self,
        bus_voltage: f32,
        samples: &[S::Sample; MAX_JOINTS],
        late: bool,
    ) -> [S::Drive; MAX_JOINTS] {
        let mut drives = [S::Drive::default(); MAX_JOINTS];
        if self.state.drives()
            && let Some(program) = self.program.as_mut()
        {
            for ((drive, axis), sample) in drives.iter_mut().zip(&mut program.axes).zip(samples).take(J) {
                *drive = axis.drive(bus_voltage, *sample, late);
            }
        }
        self.now.motors.duty = Duties(drives.map(S::duty));
        drives
    }

    /// Latches the first fault and turns the motors off.
    #[cold]
    #[inline(never)]
    pub fn trip(&mut self, fault: Fault, axis: Option<u8>, value: f32) {
        // A silent host may be listed while the motors stay on; the fault that turns them off replaces it.
        if self.fault.is_none() || self.state != State::Fault {
            self.fault = Some(FaultRecord { fault, axis, value, step: self.now.step });
        }
        if fault.loses_counts() {
            self.homed = false;
        }
        self.off();
        self.state = State::Fault;
    }

    fn off(&mut self) {
        self.let_go();
        self.fade = fade::Fade::default();
        self.cut = Some(fade::Acted::default());
        self.now.motors.torque = Torques::default();
        self.now.motors.current = Currents::default();
        if let Some(program) = self.program.as_mut() {
            program.axes.iter_mut().for_each(S::rest);
        }
    }

    /// Sets each motor's current from the step's torques.
    #[inline(always)]
    fn drive<const J: usize>(&mut self) {
        match self.state {
            State::Armed if self.fade.ramp < 1.0 => {
                let (faded, wanted) = self.fade_in();
                self.command(&faded, &wanted);
            }
            State::Armed => {
                self.fade.share = 1.0;
                if self.fits::<J>() {
                    self.command_all::<J>();
                } else {
                    let asked = self.now.found.asked;
                    self.command(&asked, &asked.total);
                }
            }
            State::CheckingPolarity => {
                self.check_polarity();
                if self.state == State::CheckingPolarity {
                    let torque = *self.now.motors.torque;
                    self.command(&Asked { total: torque, gravity: torque, ..Asked::default() }, &torque);
                }
                self.now.motors.rendered_force = 0.0;
            }
            State::Disarmed | State::Fault => {
                self.now.motors.torque = Torques::default();
                self.now.motors.rendered_force = 0.0;
                self.now.motors.limited = 0;
            }
        }
    }

    /// Commands all that is asked, which fits.
    #[inline(always)]
    fn command_all<const J: usize>(&mut self) {
        self.cut = None;
        if self.host.acts {
            self.host.left = 1.0;
        }
        let Some(program) = self.program.as_mut() else { return };
        let (motors, found) = (&mut self.now.motors, &self.now.found);
        motors.rendered_force = found.at.walls.wall_force;
        motors.limited = 0;
        for (i, axis) in program.axes.iter_mut().enumerate().take(J) {
            let current = axis.command(found.asked.total[i]);
            motors.torque[i] = axis.torque_of(current);
            if !self.hardware.bridge.current_sensed {
                motors.current[i] = current;
            }
        }
    }

    /// Commands the torques asked for within limits, and records which are not what was `wanted`.
    #[inline(never)]
    fn command(&mut self, asked: &Asked<f32>, wanted: &[f32; MAX_JOINTS]) {
        let joints = self.joints();
        let left = asked.within(&self.most_torque, self.rules.limits.tip_force, joints);
        let rendered = Torques(asked.rendered.map(|r| left.share * r));
        self.cut = Some(fade::Acted { gravity: left.gravity, rendered, share: left.share });
        if self.host.acts {
            self.host.left = left.share * self.fade.share;
        }
        let Some(program) = self.program.as_mut() else { return };
        let motors = &mut self.now.motors;
        motors.limited = 0;
        for (i, axis) in program.axes.iter_mut().enumerate().take(joints) {
            let current = axis.command(left.torque[i]);
            motors.torque[i] = axis.torque_of(current);
            // Another torque than was asked, by more than its way through a current rounds; also where that is no number.
            let kept = (wanted[i] - motors.torque[i]).abs() <= 1.0e-5 * wanted[i].abs();
            motors.limited |= u8::from(!kept) << i;
            if !self.hardware.bridge.current_sensed {
                motors.current[i] = current;
            }
        }
        self.now.motors.rendered_force = self.rendered();
    }

    /// The force (N) that the torques commanded leave of what the walls asked for.
    ///
    /// A tip that only moves along the deepest wall's normal n, by one unit, moves the joints by E = J⁻¹ n. By virtual
    /// work a joint torque τ therefore is worth E·τ along n (τ = Jᵀ F gives E·τ = n·F), and so the torque that limits
    /// took off is worth E·(asked - left). Weight and springs drop out of the difference.
    fn rendered(&self) -> f32 {
        let Now { motors, found, .. } = &self.now;
        let mut force = found.at.walls.wall_force;
        for (i, asked) in found.asked.total.iter().enumerate().take(self.joints()) {
            force -= found.motion[i] * (asked - motors.torque[i]);
        }
        force
    }
}
