//! The requests of the protocol as plain functions, without link and hardware.
//!
//! Firmware and simulated board connect the same [`Service`] to their own input and output through [`Machine`]. The
//! service repeats all checks of the tool, so that no request over the link can bring the control loop into a forbidden
//! state. Checks that depend on the present state are the control loop's.

mod backup;

use crate::board::configuration::{Configuration, empty_scene, task};
use crate::board::flash::commit_configuration;
use crate::board::machine::{Machine, Measurements, check_motors_off};
use crate::board::protocol::{Beat, Details, FaultList, GainsRequest, KeyList, Name, Press, Step};
use crate::board::settings::{self, BoardName, Damage, Key, Setting};
use crate::control::program::{Hardware, Program};
use crate::control::{Command, HostAction, Rules};
use crate::math::Math;
use crate::model::cogging::{Compensation, Potentials};
use crate::model::description::Homing;
use crate::model::device::Device;
use crate::render::scene::{DEFAULT_RATE_HZ, FeedForward, Scene, SceneError};
use crate::render::velocity::{Coefficients, Washout};
use crate::safety::fault::FaultRecord;
use crate::safety::limits::{BadLimit, GENTLE_FORCE, Limit, Limits};
use crate::safety::refusal::Refusal;
use heapless::Vec;

/// The service of a board: its configuration, and the requests that change it.
#[derive(Debug)]
pub struct Service {
    hardware: Hardware,
    max_limits: Limits,
    configuration: Configuration,
    name: Name,
    /// Device whose polarity check succeeded since the board started. The entire device is stored, because checksums
    /// may coincide.
    checked_device: Option<Device<f32>>,
    damage: Vec<(Key, Damage), { Key::ALL.len() }>,
    faults: FaultList,
    last_fault: Option<FaultRecord>,
    /// Last session that staged entries, with the keys of these entries.
    staged_entries: (u32, KeyList),
}

impl Service {
    /// Returns a board without a device. `max_limits` are the highest and the default limits, except for the default
    /// force at the tip of real motors, [`GENTLE_FORCE`].
    pub fn new(hardware: Hardware, max_limits: Limits) -> Self {
        // Simulated motors cannot hurt anyone, so the force limit is the board's and a silent host is ignored.
        let (tip_force, host_action) = match hardware.real {
            true => (GENTLE_FORCE, HostAction::Disarm),
            false => (max_limits.tip_force, HostAction::Ignore),
        };
        Self {
            hardware,
            max_limits,
            configuration: Configuration {
                device: None,
                scene: None,
                rules: Rules { limits: Limits { tip_force, ..max_limits }, host_action, ..Rules::default() },
                cogging: Potentials::default(),
            },
            name: Name::new(),
            checked_device: None,
            damage: Vec::new(),
            faults: FaultList::new(),
            last_fault: None,
            staged_entries: (0, KeyList::new()),
        }
    }

    /// Reads and applies the settings. A damaged setting stays at its default and is reported in [`Details::damage`].
    pub fn boot(&mut self, machine: &mut impl Machine) {
        // These rules apply until the stored rules are read.
        let _ = self.set_rules(machine, self.configuration.rules);
        if let Some(BoardName(name)) = self.read(machine) {
            self.name = name;
        }
        if let Some(rules) = self.read::<Rules>(machine)
            && self.set_rules(machine, rules).is_err()
        {
            let _ = self.damage.push((Key::Rules, Damage::Corrupt));
        }
        let scene = self.read::<Scene<f32>>(machine);
        if let Some(device) = self.read::<Device<f32>>(machine)
            && self.set_device(machine, device).is_err()
        {
            let _ = self.damage.push((Key::Device, Damage::Corrupt));
        }
        if let (Some(scene), true) = (scene, self.configuration.device.is_some())
            && self.set_scene(machine, scene).is_err()
        {
            let _ = self.damage.push((Key::Scene, Damage::Corrupt));
        }
        if let (Some(cogging), true) = (self.read::<Potentials>(machine), self.configuration.device.is_some())
            && self.set_cogging(machine, cogging).is_err()
        {
            let _ = self.damage.push((Key::Cogging, Damage::Corrupt));
        }
        if !self.damage.is_empty() {
            let value = self.damage.len() as f32;
            let _ = machine.execute(Command::Fault(FaultRecord {
                fault: crate::safety::fault::Fault::SettingsDamaged,
                axis: None,
                value,
                step: 0,
            }));
        }
    }

    fn read<S: Setting>(&mut self, machine: &mut impl Machine) -> Option<S> {
        let entry = machine.load(S::KEY).filter(|entry| !settings::is_former(entry))?;
        settings::decode(&entry).map_err(|damage| self.damage.push((S::KEY, damage))).ok()
    }

    /// Returns the board's description.
    pub fn details(&self, measurements: Measurements) -> Details {
        let Configuration { device, scene, .. } = &self.configuration;
        let Measurements { carrier_hz, delay_samples, unsensed, overruns, longest_cycles, stack_free } = measurements;
        let age = device.as_ref().map_or(0.0, |device| device.angle_age(carrier_hz.into())) as f32;
        let rate_hz = scene.as_ref().map_or(DEFAULT_RATE_HZ as f32, |scene| scene.rate_hz);
        Details {
            name: self.name.clone(),
            axes: self.hardware.axes as u8,
            encoders: self.hardware.encoders,
            real: self.hardware.real,
            carrier_hz,
            // An absolute encoder's angle is older than the counts of a timer.
            delay_samples: delay_samples + age * rate_hz,
            device: device.as_ref().map(|device| device.name.clone()),
            rate_hz,
            walls: scene.as_ref().map_or(0, |scene| scene.walls.len() as u8),
            unsensed,
            damage: self.damage.clone(),
            overruns,
            longest_cycles,
            stack_free,
        }
    }

    /// Returns the loaded device.
    pub fn device(&self) -> Option<&Device<f32>> {
        self.configuration.device.as_ref()
    }

    /// Returns the loaded scene.
    pub fn scene(&self) -> Option<&Scene<f32>> {
        self.configuration.scene.as_ref()
    }

    /// Returns the present rules.
    pub fn rules(&self) -> &Rules {
        &self.configuration.rules
    }

    /// Loads a device. The motors must be off. Drops homing and a scene that does not fit.
    pub fn set_device<Mc: Machine>(&mut self, machine: &mut Mc, device: Device<f32>) -> Result<(), Refusal> {
        check_motors_off(machine)?;
        check_device::<Mc::Math>(&device)?;
        let scene = self.configuration.scene.as_ref().filter(|scene| scene_fits_device(scene, &device)).cloned();
        // The same device keeps the potentials of its motors.
        let same = self.configuration.device.as_ref() == Some(&device);
        let cogging = if same { self.configuration.cogging.clone() } else { Potentials::default() };
        let mut next = Configuration { device: Some(device), scene, rules: self.configuration.rules, cogging };
        self.install(machine, &mut next, false, None)?;
        self.finish_device_change(machine)
    }

    /// Informs the control loop if this device passed the polarity check before. A device with a NaN equals no device,
    /// so it counts as unchecked.
    fn finish_device_change(&mut self, machine: &mut impl Machine) -> Result<(), Refusal> {
        self.send_cogging(machine, false)?;
        match &self.checked_device {
            Some(_) if self.checked_device == self.configuration.device => machine.execute(Command::PolarityKnown).0,
            _ => Ok(()),
        }
    }

    /// Loads a scene for the device. While the motors are on, the scene must have the present control rate, and the tip
    /// must not touch a wall of the scene.
    pub fn set_scene(&mut self, machine: &mut impl Machine, scene: Scene<f32>) -> Result<(), Refusal> {
        let device = self.configuration.device.as_ref().ok_or(Refusal::NoDevice)?;
        scene.check(task(device)).map_err(Refusal::Scene)?;
        let (device, rules) = (Some(device.clone()), self.configuration.rules);
        let cogging = self.configuration.cogging.clone();
        self.install(machine, &mut Configuration { device, scene: Some(scene), rules, cogging }, true, None)
    }

    /// Applies `next` and swaps the previous configuration into its place. A refusal changes nothing. The settings
    /// staged under `keys` are written to flash after the last check that can refuse.
    fn install<Mc: Machine>(
        &mut self,
        machine: &mut Mc,
        next: &mut Configuration,
        same_device: bool,
        keys: Option<&KeyList>,
    ) -> Result<(), Refusal> {
        let placed = self.place_program(machine, next, same_device)?;
        if let Some(Err(refusal)) = keys.map(|keys| commit_configuration(machine, next, keys)) {
            if let Some((held, _)) = placed {
                machine.release(held);
            }
            return Err(refusal);
        }
        let rate_hz = placed.as_ref().map(|(_, rate_hz)| *rate_hz);
        if let Some((held, _)) = placed {
            let (result, returned) = machine.execute(Command::Program(held));
            if let Some(held) = returned {
                machine.release(held);
            }
            result?;
        }
        if keys.is_some() {
            machine.execute(Command::Rules(next.rules)).0?;
        }
        // A scene that is loaded while the motors are on keeps the rate. Checked here, because a fault may have turned
        // the motors off.
        if let Some(rate_hz) = rate_hz.filter(|_| check_motors_off(machine).is_ok()) {
            machine.retime(rate_hz);
        }
        core::mem::swap(&mut self.configuration, next);
        Ok(())
    }

    /// Places a configuration's program where the control loop can use it, and returns it with its control rate (Hz);
    /// `None` without a device. A separate function, so that no other large value shares the stack with a program.
    #[inline(never)]
    fn place_program<Mc: Machine>(
        &self,
        machine: &mut Mc,
        next: &Configuration,
        same_device: bool,
    ) -> Result<Option<(Mc::StoredProgram, f32)>, Refusal> {
        let Configuration { device, scene, rules, .. } = next;
        let Some(device) = device else { return Ok(None) };
        let empty = empty_scene(device);
        let scene = scene.as_ref().unwrap_or(&empty);
        let program = Program::<Mc::Math>::new(&self.hardware, &rules.limits, device, scene, same_device)?;
        Ok(Some((machine.place(program)?, scene.rate_hz)))
    }

    /// Changes gains while the scene runs. Refuses the entire request if any part is invalid.
    pub fn set_gains<Mc: Machine>(&mut self, machine: &mut Mc, request: &GainsRequest) -> Result<(), Refusal> {
        let Configuration { device, scene, .. } = &mut self.configuration;
        let device = device.as_ref().ok_or(Refusal::NoDevice)?;
        let scene = scene.as_mut().ok_or(Refusal::NoScene)?;
        let mut changed = scene.clone();
        if let Some(gains) = &request.wall {
            let wall = changed
                .walls
                .get_mut(usize::from(gains.wall))
                .ok_or(Refusal::Scene(SceneError::WallGains(gains.wall)))?;
            wall.stiffness = gains.stiffness;
            wall.damping = gains.damping;
            wall.feed_forward = gains.feed_forward;
            wall.washout_hz = gains.washout_hz;
        }
        if let Some((estimator, cutoff_hz)) = request.estimator {
            changed.estimator = estimator;
            changed.cutoff_hz = cutoff_hz;
        }
        changed.check(task(device)).map_err(Refusal::Scene)?;
        let rate = changed.rate_hz;
        // All checks that can refuse come before the first change.
        let coefficients = match request.estimator {
            Some((estimator, cutoff_hz)) => {
                let designed = Coefficients::of_device::<Mc::Math>((estimator, rate, cutoff_hz), device);
                Some(designed.map_err(|_| Refusal::Scene(SceneError::Cutoff))?)
            }
            None => None,
        };
        if let Some(gains) = request.wall {
            let washout = match gains.feed_forward {
                FeedForward::Washout => {
                    Washout::new(gains.washout_hz, rate).map_err(|_| Refusal::Scene(SceneError::Washout(gains.wall)))?
                }
                _ => Washout::default(),
            };
            machine.execute(Command::Gains(gains, washout)).0?;
        }
        if let Some(coefficients) = coefficients {
            machine.execute(Command::Coefficients(coefficients)).0?;
        }
        *scene = changed;
        Ok(())
    }

    /// Sets limits and rules. Limits cannot exceed the board's maxima, and cannot be raised while the motors are on.
    pub fn set_rules(&mut self, machine: &mut impl Machine, rules: Rules) -> Result<(), Refusal> {
        self.check_rules(&rules)?;
        machine.execute(Command::Rules(rules)).0?;
        self.configuration.rules = rules;
        Ok(())
    }

    fn check_rules(&self, rules: &Rules) -> Result<(), Refusal> {
        let (least, most) = Rules::HOST_SECONDS;
        let silence = BadLimit { limit: Limit::HostSeconds, joint: None, value: rules.host_seconds, least, most };
        let period = (0..).zip(&rules.index_period).find(|(_, period)| **period < 0).map(|(joint, period)| BadLimit {
            limit: Limit::IndexPeriod,
            joint: Some(joint),
            value: *period as f32,
            least: 0.0,
            most: f32::INFINITY,
        });
        let silence = (!(least..=most).contains(&rules.host_seconds)).then_some(silence);
        match rules.limits.first_wrong_limit(&self.max_limits).or(silence).or(period) {
            Some(bad) => Err(Refusal::BadLimit(bad)),
            None => Ok(()),
        }
    }

    /// Takes the present pose as the device's home pose, or homes by index marks that the joints have passed.
    pub fn home(&mut self, machine: &mut impl Machine) -> Result<(), Refusal> {
        machine.execute(Command::Home).0
    }

    /// Starts the polarity check and drops earlier results. [`Service::poll`] records success.
    pub fn check_polarity(&mut self, machine: &mut impl Machine) -> Result<(), Refusal> {
        machine.execute(Command::CheckPolarity).0?;
        self.checked_device = None;
        Ok(())
    }

    /// Pushes each joint to its stop while `key` is held, and homes the device.
    pub fn find_stops(&mut self, machine: &mut impl Machine, key: Press) -> Result<(), Refusal> {
        machine.execute(Command::FindStops(key)).0
    }

    /// Returns the potentials of the motors.
    pub fn cogging(&self) -> &Potentials {
        &self.configuration.cogging
    }

    /// Sets the potentials of the motors, whose cogging the control loop then compensates. The motors must be off.
    pub fn set_cogging(&mut self, machine: &mut impl Machine, cogging: Potentials) -> Result<(), Refusal> {
        check_motors_off(machine)?;
        check_cogging(self.device().ok_or(Refusal::NoDevice)?, &cogging)?;
        self.configuration.cogging = cogging;
        self.send_cogging(machine, true)
    }

    /// Compiles the potentials for the control loop. `learnt_here` is true if they were learnt at the present home.
    fn send_cogging(&self, machine: &mut impl Machine, learnt_here: bool) -> Result<(), Refusal> {
        let Configuration { device: Some(device), cogging, .. } = &self.configuration else { return Ok(()) };
        for (i, (joint, potential)) in device.joints.iter().zip(&cogging.0).enumerate().take(device.axes()) {
            machine.execute(Command::Cogging(i as u8, Compensation::new(joint, potential), learnt_here)).0?;
        }
        Ok(())
    }

    /// Turns the motors on. With a `key`, the motors stay on only while the key is held.
    pub fn arm(&mut self, machine: &mut impl Machine, key: Option<Press>) -> Result<(), Refusal> {
        if self.configuration.device.is_none() {
            return Err(Refusal::NoDevice);
        }
        if self.configuration.scene.is_none() {
            return Err(Refusal::NoScene);
        }
        machine.execute(key.map_or(Command::Arm, Command::ArmHeld)).0
    }

    /// Turns the motors off.
    pub fn disarm(&mut self, machine: &mut impl Machine) -> Result<(), Refusal> {
        machine.execute(Command::Disarm).0
    }

    /// Clears the latched fault.
    pub fn clear(&mut self, machine: &mut impl Machine) -> Result<(), Refusal> {
        self.last_fault = None;
        machine.execute(Command::Clear).0
    }

    /// Receives the host's sign of life with the state of its user's key. Returns the control step, which the host
    /// sends with the next press of the key.
    pub fn heartbeat(&mut self, machine: &mut impl Machine, beat: Beat) -> Step {
        let _ = machine.execute(Command::Beat(beat));
        machine.status().step
    }

    /// Returns the last faults since the board started, oldest first.
    pub fn faults(&self) -> &FaultList {
        &self.faults
    }

    /// Polls the control loop and returns a new fault. Call a few times a second.
    pub fn poll(&mut self, machine: &mut impl Machine) -> Option<FaultRecord> {
        let status = machine.status();
        // A device that is already recorded is not copied again.
        if status.polarity && self.checked_device != self.configuration.device {
            self.checked_device.clone_from(&self.configuration.device);
        }
        let fault = status.fault?;
        // Values are not compared, because NaN differs from itself and its fault would be reported repeatedly.
        if self.last_fault.is_some_and(|last| (last.fault, last.step) == (fault.fault, fault.step)) {
            return None;
        }
        self.record_fault(fault);
        Some(fault)
    }

    /// Adds a fault to the history. A fault may also be from before a reset.
    pub fn record_fault(&mut self, fault: FaultRecord) {
        self.last_fault = Some(fault);
        if self.faults.is_full() {
            self.faults.remove(0);
        }
        let _ = self.faults.push(fault);
    }

    /// Sets the board's name, which the next save writes to flash.
    pub fn set_name(&mut self, name: Name) {
        self.name = name;
    }
}

fn scene_fits_device(scene: &Scene<f32>, device: &Device<f32>) -> bool {
    usize::from(scene.task) == task(device) && (scene.posture.is_none() || device.axes() > task(device))
}

pub(super) fn check_cogging(device: &Device<f32>, cogging: &Potentials) -> Result<(), Refusal> {
    cogging.first_unusable_joint(device).map_or(Ok(()), |joint| Err(Refusal::BadCogging(joint)))
}

/// Checks that every number that the control step uses is valid.
fn check_device<K: Math<f32>>(device: &Device<f32>) -> Result<(), Refusal> {
    let usable = device.joints.iter().take(device.axes()).all(|joint| {
        let limits = joint.limits.is_none_or(|(low, high)| low < high);
        let motor = joint.motor.is_none_or(|motor| {
            let signed = motor.torque_constant.is_finite() && motor.back_emf.is_finite();
            let positive = [motor.resistance, motor.inductance, motor.max_current];
            // The winding of a brushed motor has no ratio.
            let ratio = motor.electrical_ratio().is_none_or(|ratio| ratio.is_finite() && ratio > 0.0);
            signed && ratio && positive.iter().all(|value| value.is_finite() && *value >= 0.0)
        });
        joint.offset.is_finite() && joint.viscous.is_finite() && joint.counts_per_turn >= 0 && limits && motor
    });
    let stops = match device.homing {
        Homing::Stop(stops) => device.joints.iter().take(device.axes()).zip(stops).all(|(joint, stop)| {
            stop.is_finite() && joint.limits.is_some_and(|(low, high)| stop <= low || stop >= high)
        }),
        Homing::Index => device.joints.iter().all(|joint| joint.absolute.is_none()),
        Homing::Hand => true,
    };
    let sensed = (device.sensed.iter())
        .all(|joint| joint.radians_per_count.is_finite() && joint.radians_per_count != 0.0 && joint.offset.is_finite());
    let pose = device.home.unwrap_or_default();
    let mechanism = device.mechanism.is_finite_at::<K>(&pose);
    if usable && stops && sensed && mechanism { Ok(()) } else { Err(Refusal::BadDevice) }
}
