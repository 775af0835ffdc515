//! A simulated device: linkage, motors, encoders and a hand. Converts drive inputs to counts, currents and index marks.

use super::brushless::BrushlessModel;
use super::encoder::EncoderModel;
use super::hand::Hand;
use super::motor::{MotorInput, MotorModel, PowerStage};
use super::plant::{Load, Plant};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::{Description, DescriptionError, Homing, MAX_SENSED};

/// Options of the simulation of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// True if viscous and Coulomb friction of the joints act.
    pub friction: bool,
    /// The supply and the bridges.
    pub bridge: PowerStage,
    /// Electrical angle of each three-phase motor at joint angle zero, rad.
    pub electrical_zero: [f64; 3],
    /// Joint angles at power-on, rad; `None` for the home of the description.
    pub start: Option<[f64; 3]>,
    /// True if the encoders show the joint angles at power-on, as if homed; otherwise they start at zero in any pose.
    pub absolute_encoders: bool,
    /// Longest integration step, s. At 5 µs a five-bar's energy drifts by less than 1e-9 in a second
    /// (tool/tests/quick/simulated_device.rs).
    pub substep: f64,
    /// Distance of a joint's mechanical stop beyond its limits, rad, unless the description names the stop; joints
    /// without limits have no stop.
    pub stop_margin: f64,
    /// True if the linkage has a soft stop before every singularity, because a simulated hand would fold a device
    /// without joint limits.
    pub soft_stop: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            friction: true,
            bridge: PowerStage::default(),
            electrical_zero: [0.0; 3],
            start: None,
            absolute_encoders: false,
            substep: 5e-6,
            stop_margin: 0.02,
            soft_stop: false,
        }
    }
}

impl Options {
    /// Returns the options of a device without friction, for comparison with linear theory.
    pub fn frictionless() -> Self {
        Self { friction: false, ..Self::default() }
    }
}

/// The way in which a user supports a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Support {
    /// No support, so that a device with weight falls.
    #[default]
    None,
    /// The user carries the weight, and the device can move.
    Carried,
    /// The user holds the device still.
    Held,
}

/// A description that cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum DeviceError {
    #[error(transparent)]
    Description(#[from] DescriptionError),
    #[error("joint {0} has no [joint.encoder]: a board cannot measure its motion; add one to the device file")]
    NoEncoder(usize),
    #[error("joint {0} has no [joint.motor]: a board cannot drive it; add one to the device file")]
    NoMotor(usize),
    #[error(
        "the device has no [home]: the simulation does not know in which pose it starts; add one to the device file"
    )]
    NoStart,
    #[error("the integration step must be a positive number of seconds")]
    Substep,
}

/// The electrical state of a motor of either kind.
#[derive(Clone, Debug)]
enum AnyMotor {
    Brushed(MotorModel),
    ThreePhase(BrushlessModel),
}

/// A simulated device.
#[derive(Clone, Debug)]
pub struct SimulatedDevice {
    plant: Plant,
    motors: Vec<AnyMotor>,
    encoders: Vec<EncoderModel>,
    sensed: [i32; MAX_SENSED],
    hand: Hand,
    support: Support,
    start: [f64; 3],
    bridge: PowerStage,
    substep: f64,
    time: f64,
    hand_force: [f64; 3],
    torque: [f64; 3],
}

impl SimulatedDevice {
    /// Creates a device at rest with floating bridges and without a hand.
    pub fn new(description: &Description, options: &Options) -> Result<Self, DeviceError> {
        if !(options.substep > 0.0 && options.substep.is_finite()) {
            return Err(DeviceError::Substep);
        }
        let joints = description.kind.spec().joints;
        let start = options.start.or(description.home).ok_or(DeviceError::NoStart)?;
        let stops = core::array::from_fn(|index| {
            let Some((low, high)) = description.joints[index].limits else {
                return (f64::NEG_INFINITY, f64::INFINITY);
            };
            let (first, last) = (low - options.stop_margin, high + options.stop_margin);
            match description.homing {
                Homing::Stop(stops) if stops[index] <= low => (stops[index], last),
                Homing::Stop(stops) => (first, stops[index]),
                Homing::Hand | Homing::Index => (first, last),
            }
        });
        let mut plant = Plant::new(description, start, options.friction, stops)?;
        if options.soft_stop {
            plant.add_soft_stop();
        }
        let mut motors = Vec::with_capacity(joints);
        let mut encoders = Vec::with_capacity(joints);
        for (index, joint) in description.joints[..joints].iter().enumerate() {
            let motor = joint.motor.ok_or(DeviceError::NoMotor(index))?;
            motors.push(match BrushlessModel::new(motor, options.electrical_zero[index]) {
                Some(motor) => AnyMotor::ThreePhase(motor),
                None => AnyMotor::Brushed(MotorModel::new(motor)),
            });
            let encoder = joint.encoder.ok_or(DeviceError::NoEncoder(index))?;
            let zero = if options.absolute_encoders { encoder.offset } else { start[index] };
            encoders.push(EncoderModel::new(&encoder, zero));
        }
        Ok(Self {
            plant,
            motors,
            encoders,
            sensed: [0; MAX_SENSED],
            hand: Hand::none(),
            support: Support::None,
            start,
            bridge: options.bridge,
            substep: options.substep,
            time: 0.0,
            hand_force: [0.0; 3],
            torque: [0.0; 3],
        })
    }

    /// Advances by `dt` seconds with each axis driven by `drive`.
    pub fn step(&mut self, drive: &[MotorInput; 3], dt: f64) {
        let substeps = (dt / self.substep).ceil().max(1.0);
        let h = dt / substeps;
        for _ in 0..substeps as u64 {
            let qd = self.plant.motor_velocity();
            let mut load = Load::default();
            let at = self.plant.motor_angle();
            for (axis, motor) in self.motors.iter_mut().enumerate() {
                (load.torque[axis], load.damping[axis]) = match motor {
                    AnyMotor::Brushed(motor) => motor.step(drive[axis], qd[axis], &self.bridge, h),
                    AnyMotor::ThreePhase(motor) => (motor.step(drive[axis], at[axis], qd[axis], &self.bridge, h), 0.0),
                };
            }
            let (tip, tip_velocity) = (self.plant.tip(), self.plant.tip_velocity());
            load.force = self.hand.step(&tip, &tip_velocity, self.plant.task(), self.time, h);
            self.hand_force = load.force;
            self.torque = core::array::from_fn(|i| load.torque[i] - load.damping[i] * qd[i]);
            if self.support == Support::Carried {
                let weight = self.plant.gravity();
                load.torque.iter_mut().zip(weight).for_each(|(torque, weight)| *torque += weight);
            }
            if self.support != Support::Held {
                let q = self.plant.q();
                self.plant.step(&load, h);
                // Stops a linkage at a singularity, because the equations of motion have no solution beyond.
                if !self.plant.q().iter().chain(&self.plant.qd()).all(|number| number.is_finite()) {
                    self.plant.place(q, [0.0; 3]);
                }
            }
            self.time += h;
        }
    }

    /// Returns the user's support of the device.
    pub fn support(&self) -> Support {
        self.support
    }
    /// Changes the support. A held device stops at once.
    pub fn set_support(&mut self, support: Support) {
        if support == Support::Held {
            self.place(self.plant.q());
        }
        self.support = support;
    }

    /// Puts a hand on the tip, or removes it.
    pub fn set_hand(&mut self, hand: Hand) {
        self.hand = hand;
    }
    /// Returns the hand on the tip.
    pub fn hand(&self) -> &Hand {
        &self.hand
    }
    /// Returns the hand on the tip, to change its motion.
    pub fn hand_mut(&mut self) -> &mut Hand {
        &mut self.hand
    }
    /// Moves the device and its encoders to `q` (rad), at rest.
    pub fn place(&mut self, q: [f64; 3]) {
        self.plant.place(q, [0.0; 3]);
    }
    /// Sets the tip's velocity, m/s.
    pub fn push(&mut self, velocity: [f64; 3]) {
        self.plant.push(velocity);
    }
    /// Changes the bus voltage, V.
    pub fn set_bus_voltage(&mut self, volts: f64) {
        self.bridge.bus_voltage = volts;
    }
    /// Returns the joint angles at power-on, rad.
    pub fn start(&self) -> [f64; 3] {
        self.start
    }
    /// Returns the number of joints N.
    pub fn joints(&self) -> usize {
        self.plant.joints()
    }
    /// Returns the time since power-on, s.
    pub fn time(&self) -> f64 {
        self.time
    }
    /// Sets the counts of the encoders without motors, which otherwise stand still.
    pub fn set_sensed_counts(&mut self, counts: [i32; MAX_SENSED]) {
        self.sensed = counts;
    }
    /// Returns the counts since power-on at the inputs of a board: of the joints' encoders, then of the encoders without
    /// motors.
    pub fn inputs(&self) -> [i32; MAX_JOINTS + MAX_SENSED] {
        let q = self.plant.measured();
        let joints = self.encoders.iter().zip(q).map(|(encoder, q)| encoder.counts(q));
        let mut inputs = [0; MAX_JOINTS + MAX_SENSED];
        inputs.iter_mut().zip(joints.chain(self.sensed)).for_each(|(input, count)| *input = count);
        inputs
    }
    /// Returns the counts at a board's first three inputs.
    pub fn counts(&self) -> [i32; 3] {
        let [first, second, third, ..] = self.inputs();
        [first, second, third]
    }
    /// Returns, for each encoder, true if its index mark is under the sensor.
    pub fn index(&self) -> [bool; 3] {
        let q = self.plant.measured();
        core::array::from_fn(|i| self.encoders.get(i).is_some_and(|encoder| encoder.at_index(q[i])))
    }
    /// Returns the currents that make torque, A: of a brushed motor its winding's, else the quadrature current.
    pub fn currents(&self) -> [f64; 3] {
        let at = self.plant.motor_angle();
        core::array::from_fn(|i| match self.motors.get(i) {
            None => 0.0,
            Some(AnyMotor::Brushed(motor)) => motor.current(),
            Some(AnyMotor::ThreePhase(motor)) => motor.quadrature_current(at[i]),
        })
    }
    /// Returns the phase currents of a three-phase motor, A.
    pub fn phase_currents(&self, axis: usize) -> Option<[f64; 3]> {
        match self.motors.get(axis) {
            Some(AnyMotor::ThreePhase(motor)) => Some(motor.currents()),
            _ => None,
        }
    }
    /// Returns the model of a three-phase motor, `None` for a brushed motor.
    pub fn three_phase_mut(&mut self, axis: usize) -> Option<&mut BrushlessModel> {
        match self.motors.get_mut(axis) {
            Some(AnyMotor::ThreePhase(motor)) => Some(motor),
            _ => None,
        }
    }
    /// Returns the bus voltage, V.
    pub fn bus_voltage(&self) -> f64 {
        self.bridge.bus_voltage
    }
    /// Returns the motors' torques in the last step, N m.
    pub fn torque(&self) -> [f64; 3] {
        self.torque
    }
    /// Returns the hand's force on the tip in the last step, N.
    pub fn hand_force(&self) -> [f64; 3] {
        self.hand_force
    }
    /// Returns the position of the tip, m.
    pub fn tip(&self) -> [f64; 3] {
        self.plant.tip()
    }
    /// Returns the tip velocity, m/s.
    pub fn tip_velocity(&self) -> [f64; 3] {
        self.plant.tip_velocity()
    }
    /// Returns the joint angles of the links, rad.
    pub fn q(&self) -> [f64; 3] {
        self.plant.q()
    }
    /// Returns the joint velocities, rad/s.
    pub fn qd(&self) -> [f64; 3] {
        self.plant.qd()
    }
    /// Returns the linkage.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }
}
