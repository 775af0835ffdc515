//! The control loop of one device, without hardware. It takes samples, and returns the state of the bridges, the
//! currents and, once per carrier period, the duties.
//!
//! The firmware's interrupt, the simulated board and the tests all run this code. A [`Program`] is built elsewhere and
//! moved in between two steps; small changes are [`Command`]s. No function blocks, allocates or panics.
//!
//! The stages of a carrier period, in order; a crest without a due control step runs stages 2 and 6 only:
//!
//! | | stage | function | file |
//! |--|--|--|--|
//! | 1 | compute the scene's torques | [`ControlLoop::render`] | render/controller.rs |
//! | 2 | check counts, currents and supply | `check_samples` | control/crest.rs |
//! | 3 | check the host, the key and the torques | `watch` | control/watch.rs |
//! | 4 | fade the scene in, or run the polarity check | `fade_in`, `check_polarity` | control/{fade,polarity}.rs |
//! | 5 | limit and command the torques | `granted_torques`, `command` | control/saturation.rs |
//! | 6 | run the current loops | [`Stage::drive`] | drive/brushed.rs |
//! | 7 | at the valley, check force, motor model and heat | [`ControlLoop::check_slow_faults`] | control/budgets.rs |
//! | 8 | at the valley, carry out a request | [`ControlLoop::execute`] | control/requests.rs |
//!
//! `crest_of` in control/crest.rs runs stages 2 to 6 of a usual crest in one pass.

pub mod absolute;
mod budgets;
mod cogging;
pub mod compiled;
mod crest;
mod fade;
pub mod frame;
mod homing;
pub mod host_force;
pub mod joints;
mod period;
mod polarity;
pub mod program;
mod requests;
mod rules;
mod saturation;
mod sensed;
mod watch;

use crate::control::frame::{Now, Outputs, Samples, StepRecord};
use crate::control::joints::{Counts, Currents, Torques};
use crate::control::program::Hardware;
use crate::control::program::Program;
use crate::drive::heat::Heat;
use crate::drive::motor_stage::MotorStage;
use crate::drive::stage::{Stage, Supply};
use crate::math::{Math, clamp};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::Leverage;
use crate::render::scene::DEFAULT_RATE_HZ;
use crate::render::step_result::TorqueDemand;
use crate::safety::fault::{Fault, FaultRecord, State};
use core::ops::DerefMut;
use crest::Joint;
pub use crest::SPEED_FILTER_HZ;
pub use requests::{Beat, Command, Press, REST_SPEED, Reply, Status};
pub use rules::{HostAction, Rules};
pub use watch::{KEY_SECONDS, MIN_PARALLEL_SINE};

/// Time over which torque ramps up after arming, s.
pub const ARM_SECONDS: f32 = 0.5;

/// The board's control loop. The field order keeps all data of a crest within the 1 KB that FPU loads can reach.
#[derive(Debug)]
#[repr(C)]
pub struct ControlLoop<P, S = MotorStage> {
    state: State,
    homed: bool,
    polarity_known: bool,
    /// Number of joints of the loaded device.
    joint_count: u8,
    compensates_weight: bool,
    /// `joint_count` while a crest takes a single pass: the motors are on, and every joint has a range. Otherwise 0.
    /// [`crest::PHASES_PASS`] more if a motor has three phases.
    one_pass_joints: u8,
    /// True if the scene has faded in and no index pulse waits for its check.
    in_force: bool,
    /// True if torques of a host or of the compensation of cogging are added to the scene's.
    adds_torques: bool,
    /// True if the joint angles are known well enough for a polarity check. Equals `homed` unless homed by stops.
    placed: bool,
    /// Zero if the scene is `in_force` and the last step limited no torque; otherwise negative.
    steady: i32,
    program: Option<P>,
    crests: crest::Crests,
    /// Bus voltage of the drives since the last valley, V; 0 if the voltage was not usable.
    drive_voltage: f32,
    /// Last step at which the host may still be silent.
    host_expected: u32,
    /// Joint torques up to which no clamp is needed, N m.
    unclamped_torque: [f32; MAX_JOINTS],
    /// Force limit at the tip, N.
    max_tip_force: f32,
    max_tip_force_squared: f32,
    /// Tip force per joint torque, recomputed at 2 kHz.
    leverage: Leverage,
    flow: budgets::Flow,
    now: Now,
    joints: [Joint<S>; MAX_JOINTS],
    /// Torque limit of each joint, N m.
    max_joint_torque: Torques,
    hardware: Hardware,
    period: f32,
    /// Step from which `period` has applied, or a later step that is before all steps in pending requests.
    rate_since: u32,
    /// Step at which the host last sent a sign of life.
    host_seen_at: u32,
    /// Latest press of the dead man's key that keeps the motors on; `None` without a key.
    key: Option<Press>,
    rules: Rules,
    /// True if telemetry includes the walls' energy.
    shows_energy: bool,
    host: host_force::HostForce,
    cogging: cogging::CoggingCompensation,
    /// Torques of the previous scene, which fade out.
    fade: fade::Fade,
    /// Torques of the last step that commanded less than was requested.
    cut_torques: fade::CommandedTorques,
    /// Number of the last step that commanded less than was requested.
    cut_step: u32,
    /// Number of the joint that the next valley checks.
    next_joint: usize,
    /// Number of joints for which new rules are not in force yet, see [`ControlLoop::settle_next`].
    unsettled_joints: u8,
    /// Heat of the motors, kept when the device changes.
    heat: [Heat; MAX_JOINTS],
    first_index: [Option<i32>; MAX_JOINTS],
    /// Lowest and highest counts since the index marks are searched, with the motors off.
    swept: Option<(Counts, Counts)>,
    /// Index pulses seen since the last step.
    marks: Option<[Option<i32>; MAX_JOINTS]>,
    polarity: polarity::PolarityCheck,
    /// Counts of the home pose at which the polarity was checked, see `polarity_known`.
    checked_zero: Counts,
    fault: Option<FaultRecord>,
    sensed: sensed::SensedEncoders,
    absolute: absolute::AbsoluteEncoders,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Returns a disarmed control loop without a device.
    pub fn new(hardware: Hardware, rules: Rules) -> Self {
        Self {
            hardware,
            rules,
            shows_energy: false,
            program: None,
            state: State::Disarmed,
            homed: false,
            placed: false,
            polarity_known: false,
            joint_count: 0,
            compensates_weight: false,
            one_pass_joints: 0,
            in_force: false,
            adds_torques: false,
            steady: -1,
            marks: None,
            polarity: polarity::PolarityCheck::default(),
            checked_zero: Counts::default(),
            fault: None,
            sensed: sensed::SensedEncoders::default(),
            absolute: absolute::AbsoluteEncoders::default(),
            now: Now::default(),
            joints: [Joint::default(); MAX_JOINTS],
            period: 1.0 / DEFAULT_RATE_HZ as f32,
            rate_since: 0,
            fade: fade::Fade::default(),
            cut_torques: fade::CommandedTorques::default(),
            cut_step: 0,
            max_joint_torque: Torques::default(),
            unclamped_torque: [0.0; MAX_JOINTS],
            max_tip_force: 0.0,
            max_tip_force_squared: 0.0,
            leverage: Leverage::default(),
            flow: budgets::Flow::default(),
            drive_voltage: 0.0,
            host_seen_at: 0,
            host_expected: 0,
            key: None,
            first_index: [None; MAX_JOINTS],
            swept: None,
            crests: crest::Crests::default(),
            host: host_force::HostForce::default(),
            cogging: cogging::CoggingCompensation::default(),
            next_joint: 0,
            unsettled_joints: 0,
            heat: [Heat::default(); MAX_JOINTS],
        }
    }

    /// Sets the heat that an earlier run left in the motors. Call before the first program.
    pub fn start_heat(&mut self, heat: [Heat; MAX_JOINTS]) {
        self.heat = heat;
    }

    /// Returns the motors' heat, for [`ControlLoop::start_heat`] of the next run.
    pub fn heat(&self) -> &[Heat; MAX_JOINTS] {
        &self.heat
    }

    /// Returns the telemetry record of the last step, with the present state.
    #[inline(always)]
    pub fn frame(&self) -> StepRecord {
        StepRecord::of(&self.now, self.state, &self.sensed.angles)
    }

    /// Returns the number of control steps since boot, wrapping.
    #[inline(always)]
    pub fn steps(&self) -> u32 {
        self.now.step
    }

    /// Advances the step count as if control steps had passed, at most 2^30 between real steps. For tests of long runs.
    #[doc(hidden)]
    pub fn skip_steps(&mut self, steps: u32) {
        self.now.step = self.now.step.wrapping_add(steps);
    }

    /// Returns the control rate of the loaded program, Hz.
    pub fn rate_hz(&self) -> Option<f32> {
        self.program.as_ref().map(|program| program.rate_hz)
    }

    /// Computes the scene's joint torques from encoder counts. Does not change the motors' torques or limits.
    #[inline(always)]
    pub fn render(&mut self, counts: &Counts) {
        if self.adds_torques {
            self.render_with_added_torques(counts);
        } else {
            self.render_scene(counts);
        }
    }

    /// Renders the scene without added torques.
    #[inline(always)]
    fn render_scene(&mut self, counts: &Counts) {
        if let Some(program) = self.program.as_mut() {
            program.controller.render(counts, &self.now.motors.torque, &mut self.now.result);
        }
    }

    /// Records index pulses since the last step. `marks` holds the counts of the encoders with a pulse, which are late
    /// by at most the joint's motion in this step. Call before [`ControlLoop::act`] or [`compiled::crest`].
    pub fn mark(&mut self, marks: [Option<i32>; MAX_JOINTS]) {
        self.marks = Some(marks);
        self.in_force = false;
        self.steady = -1;
    }

    /// Returns, for each axis, true if its motor has three phases.
    pub fn three_phase_axes(&self) -> [bool; MAX_JOINTS] {
        self.joints.each_ref().map(|joint| joint.stage.is_three_phase())
    }

    #[inline(always)]
    fn outputs(&self) -> Outputs {
        Outputs { bridges: self.state.drives() }
    }

    /// Returns the number of joints of the loaded program, at most [`MAX_JOINTS`].
    #[inline(always)]
    fn count(&self) -> usize {
        self.joint_count.into()
    }

    /// Writes the next drive of each axis, converted by `into`, to `legs`. Returns false if the motors are off.
    #[inline(never)]
    fn drive<L>(
        &mut self,
        bus_voltage: f32,
        samples: &[S::Sample; MAX_JOINTS],
        late: bool,
        into: &impl Fn(S::Drive) -> L,
        legs: &mut [L; MAX_JOINTS],
    ) -> bool {
        let (supply, active, joints) = (Supply::of(bus_voltage), self.state.drives(), self.count());
        let usable = supply.is_usable();
        self.drive_voltage = if usable { bus_voltage } else { 0.0 };
        let motors = self.joints.iter_mut().zip(self.now.motors.duty.iter_mut()).zip(samples).zip(legs);
        for (i, (((joint, duty), sample), legs)) in motors.enumerate() {
            let drive = match active && i < joints {
                true if usable => crest::drive_one(joint, &supply, *sample, late),
                true => joint.stage.drive(&supply, *sample, joint.speed(), late),
                false => S::Drive::default(),
            };
            (*duty, *legs) = (S::duty(drive), into(drive));
        }
        active
    }

    /// Latches the first fault and turns the motors off.
    #[cold]
    #[inline(never)]
    pub fn trip(&mut self, fault: Fault, axis: Option<u8>, value: f32) {
        // A silent host may be a listed fault while the motors stay on. A fault that turns the motors off replaces it.
        if self.fault.is_none() || self.state != State::Fault {
            self.fault = Some(FaultRecord { fault, axis, value, step: self.now.step });
        }
        if fault.loses_counts() {
            (self.homed, self.placed) = (false, false);
            self.forget_marks();
            self.absolute.restart();
        }
        self.turn_motors_off();
        self.state = State::Fault;
        self.update_fast_path();
    }

    fn turn_motors_off(&mut self) {
        if self.state == State::Homing {
            // The joints' ranges were wider.
            self.state = State::Disarmed;
            self.set_ranges();
        }
        self.clear_host_force();
        self.key = None;
        self.fade = fade::Fade::default();
        self.cut_torques = fade::CommandedTorques::default();
        self.cut_step = self.now.step;
        self.now.motors.torque = Torques::default();
        self.now.motors.current = Currents::default();
        for joint in &mut self.joints {
            joint.stage.rest();
        }
    }

    #[inline(always)]
    fn begin_step(&mut self) {
        self.now.step = self.now.step.wrapping_add(1);
    }

    /// Records the samples of a control step for later readers.
    #[inline(always)]
    fn note(&mut self, seen: &Samples) {
        self.now.recorded_step = self.now.step;
        self.now.motors.bus_voltage = seen.bus_voltage;
        self.now.motors.current = seen.currents;
        self.now.counts = seen.counts;
        if let Some(program) = self.program.as_ref() {
            program.controller.angles(&seen.counts, &mut self.now.result);
        }
    }

    /// Records the samples of the last control step if the fast path left this to the valley.
    #[inline(always)]
    fn note_late(&mut self, seen: &Samples) {
        if self.now.recorded_step != self.now.step {
            self.note(seen);
        }
    }

    /// Runs a control step in any state.
    fn step(&mut self, seen: &Samples) {
        self.begin_step();
        if self.program.is_some() {
            self.slow_step(seen);
        } else {
            self.note(seen);
        }
    }

    /// Runs the rest of a control step that is not on the fast path.
    #[cold]
    #[inline(never)]
    fn slow_step(&mut self, seen: &Samples) {
        let before = self.now.counts;
        self.note(seen);
        // Most steps off the fast path have no fault: the torque only ramps up, or a limit cuts it.
        if self.marks.is_some() || self.watch_all() < 0 {
            self.find_fault(&before);
        }
        match self.state {
            State::Armed if self.fade.ramp < 1.0 => {
                let (faded, wanted) = self.fade_in();
                self.command(&faded, &wanted);
            }
            State::Armed => {
                self.fade.share = 1.0;
                let asked = self.now.result.asked;
                self.command(&asked, &asked.total);
            }
            State::CheckingPolarity | State::Homing => {
                let torque = self.check_polarity();
                if self.state.drives() {
                    self.command_test(&torque);
                }
                self.now.motors.rendered_force = 0.0;
            }
            State::Disarmed | State::Fault => {
                self.command_zero();
                self.sweep();
            }
        }
        self.update_fast_path();
    }

    fn command_zero(&mut self) {
        let motors = &mut self.now.motors;
        (motors.torque, motors.rendered_force, motors.limited) = (Torques::default(), 0.0, 0);
    }

    fn update_fast_path(&mut self) {
        let mut joints = self.joints.iter().take(self.count());
        let phases = if joints.clone().any(|joint| joint.stage.is_three_phase()) { crest::PHASES_PASS } else { 0 };
        let limited = joints.all(|joint| joint.is_limited());
        self.one_pass_joints = if self.state.drives() && limited { self.joint_count + phases } else { 0 };
        let faded_in = self.fade.ramp >= 1.0 && self.fade.share >= 1.0;
        self.in_force = self.state == State::Armed && faded_in && self.marks.is_none();
        self.update_steady();
    }

    /// Updates `steady` after a step that can change only `limited`.
    #[inline(always)]
    fn update_steady(&mut self) {
        self.steady = if self.in_force && self.now.motors.limited == 0 { 0 } else { -1 };
    }

    /// Returns true if the last step commanded other torques than requested.
    fn was_cut(&self) -> bool {
        self.cut_step == self.now.step
    }

    /// Commands the requested torques, which are within the limits.
    #[inline(always)]
    fn command_unlimited<const J: usize>(&mut self) {
        let (motors, found) = (&mut self.now.motors, &self.now.result);
        motors.rendered_force = found.at.walls.wall_force;
        for (i, joint) in self.joints.iter_mut().enumerate().take(J) {
            joint.stage.command_within(found.asked.total[i]);
            motors.torque[i] = found.asked.total[i];
        }
    }

    /// Commands the torques of a polarity check, within the limits.
    fn command_test(&mut self, torque: &Torques) {
        let joints = self.count();
        for (i, joint) in self.joints.iter_mut().enumerate().take(joints) {
            let torque = clamp(torque[i], self.max_joint_torque[i]);
            joint.stage.command(torque);
            self.now.motors.torque[i] = clamp(torque, joint.stage.max_torque());
        }
        self.now.motors.limited = 0;
    }

    /// Commands the torques of a fully faded-in scene on J joints, cut to the limits.
    #[inline(always)]
    fn command_limited<const J: usize>(&mut self) {
        let asked = self.now.result.asked;
        self.command_of::<J>(&asked, &asked.total);
        self.update_steady();
    }

    /// Commands the requested torques within the limits, and records which joints differ from `wanted`.
    fn command(&mut self, asked: &TorqueDemand<f32>, wanted: &[f32; MAX_JOINTS]) {
        match self.count() {
            2 => self.command_of::<2>(asked, wanted),
            3 => self.command_of::<3>(asked, wanted),
            _ => self.command_of::<1>(asked, wanted),
        }
    }

    /// Commands the requested torques of J joints, see [`ControlLoop::command`].
    #[inline(always)]
    fn command_of<const J: usize>(&mut self, asked: &TorqueDemand<f32>, wanted: &[f32; MAX_JOINTS]) {
        let granted = asked.granted_torques::<J>(&self.max_joint_torque, self.max_tip_force, &self.leverage);
        let rendered = Torques(asked.rendered.map(|r| granted.share * r));
        self.cut_torques = fade::CommandedTorques { gravity: granted.gravity, rendered, share: granted.share };
        self.cut_step = self.now.step;
        if self.host.acts {
            self.host.granted_share = granted.share * self.fade.share;
        }
        let motors = &mut self.now.motors;
        motors.limited = 0;
        for (i, joint) in self.joints.iter_mut().enumerate().take(J) {
            joint.stage.command(granted.torque[i]);
            motors.torque[i] = clamp(granted.torque[i], joint.stage.max_torque());
            // True if the torque is as requested up to the rounding of its conversion to a current; false for NaN.
            let is_kept = (wanted[i] - motors.torque[i]).abs() <= 1.0e-5 * wanted[i].abs();
            motors.limited |= u8::from(!is_kept) << i;
        }
        self.now.motors.rendered_force = self.limited_wall_force::<J>();
    }

    /// Returns the force of the walls that remains after limits, N.
    /// If the tip moves by one unit along the deepest wall's normal n only, the joints move by E = J⁻¹ n. By virtual
    /// work, a joint torque τ acts like the force E·τ along n (τ = Jᵀ F gives E·τ = n·F). Limits therefore removed the
    /// force E·(asked - commanded). Weight and springs cancel in the difference.
    #[inline(always)]
    fn limited_wall_force<const J: usize>(&self) -> f32 {
        let Now { motors, result: found, .. } = &self.now;
        let mut force = found.at.walls.wall_force;
        for (i, asked) in found.asked.total.iter().enumerate().take(J) {
            force -= found.motion[i] * (asked - motors.torque[i]);
        }
        force
    }
}
