//! A simulated device: linkage, motors, encoders and a hand. Drive goes in; counts, currents and index marks come out.

use super::encoder::EncoderModel;
use super::hand::Hand;
use super::motor::{MotorInput, MotorModel, PowerStage};
use super::plant::{Load, Plant};
use haptic_bridge::model::description::{Description, DescriptionError};

/// The aspects of a device that are simulated, and how finely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Viscous and Coulomb friction of the joints act.
    pub friction: bool,
    /// The supply and the bridges.
    pub bridge: PowerStage,
    /// The joint angles at power-on, rad; the description's home when `None`.
    pub start: Option<[f64; 3]>,
    /// The encoders know their angle at power-on, as if homed; otherwise they start at zero wherever the device stands.
    pub absolute_encoders: bool,
    /// Longest integration step, s. At 5 µs a five-bar's energy drifts by less than 1e-9 in a second
    /// (tool/tests/quick/simulated_device.rs).
    pub substep: f64,
    /// The distance beyond its limits at which each joint hits a stop, rad; joints without limits have none.
    pub stop_margin: f64,
    /// The linkage has a soft stop short of every singularity, as a device in somebody's hand has: where its file gives
    /// its joints no limits, a simulated hand would fold it.
    pub stops_short: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            friction: true,
            bridge: PowerStage::default(),
            start: None,
            absolute_encoders: false,
            substep: 5e-6,
            stop_margin: 0.02,
            stops_short: false,
        }
    }
}

impl Options {
    /// A device without friction, for comparison with linear theory.
    pub fn frictionless() -> Self {
        Self { friction: false, ..Self::default() }
    }
}

/// The help that somebody gives a device that its motors do not hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Support {
    /// Nothing: what has weight falls.
    #[default]
    None,
    /// Carries its weight and lets it move.
    Carried,
    /// Holds it still.
    Held,
}

/// Why a description cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// The description itself is wrong.
    #[error(transparent)]
    Description(#[from] DescriptionError),
    /// No encoder on this joint.
    #[error("joint {0} has no [joint.encoder]: a board cannot see it move; add one to the device file")]
    NoEncoder(usize),
    /// No motor on this joint.
    #[error("joint {0} has no [joint.motor]: a board cannot drive it; add one to the device file")]
    NoMotor(usize),
    /// Nowhere to start.
    #[error(
        "the device has no [home]: the simulation does not know in which pose it starts; add one to the device file"
    )]
    NoStart,
    /// The integration step is not a positive number.
    #[error("the integration step must be a positive number of seconds")]
    Substep,
}

/// A simulated device.
#[derive(Clone, Debug)]
pub struct SimulatedDevice {
    plant: Plant,
    motors: Vec<MotorModel>,
    encoders: Vec<EncoderModel>,
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
    /// A device at rest, its bridges floating, no hand on it.
    pub fn new(description: &Description, options: &Options) -> Result<Self, DeviceError> {
        if !(options.substep > 0.0 && options.substep.is_finite()) {
            return Err(DeviceError::Substep);
        }
        let joints = description.kind.spec().joints;
        let start = options.start.or(description.home).ok_or(DeviceError::NoStart)?;
        let stops = description.joints.map(|joint| {
            joint.limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |(low, high)| {
                (low - options.stop_margin, high + options.stop_margin)
            })
        });
        let mut plant = Plant::new(description, start, options.friction, stops)?;
        if options.stops_short {
            plant.stop_short();
        }
        let mut motors = Vec::with_capacity(joints);
        let mut encoders = Vec::with_capacity(joints);
        for (index, joint) in description.joints[..joints].iter().enumerate() {
            motors.push(MotorModel::new(joint.motor.ok_or(DeviceError::NoMotor(index))?));
            let encoder = joint.encoder.ok_or(DeviceError::NoEncoder(index))?;
            let zero = if options.absolute_encoders { encoder.offset } else { start[index] };
            encoders.push(EncoderModel::new(&encoder, zero));
        }
        Ok(Self {
            plant,
            motors,
            encoders,
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

    /// Lets `dt` seconds pass with each axis driven as `drive` says.
    pub fn step(&mut self, drive: &[MotorInput; 3], dt: f64) {
        let pieces = (dt / self.substep).ceil().max(1.0);
        let h = dt / pieces;
        for _ in 0..pieces as u64 {
            let qd = self.plant.motor_velocity();
            let mut load = Load::default();
            for (axis, motor) in self.motors.iter_mut().enumerate() {
                (load.torque[axis], load.damping[axis]) = motor.step(drive[axis], qd[axis], &self.bridge, h);
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
                // A linkage that falls onto a singularity jams there: its equations have nothing to say beyond.
                if !self.plant.q().iter().chain(&self.plant.qd()).all(|number| number.is_finite()) {
                    self.plant.place(q, [0.0; 3]);
                }
            }
            self.time += h;
        }
    }

    /// The user's help for the device.
    pub fn support(&self) -> Support {
        self.support
    }

    /// Supports the device from now on, at rest where it is held.
    pub fn set_support(&mut self, support: Support) {
        if support == Support::Held {
            self.place(self.plant.q());
        }
        self.support = support;
    }

    /// Puts a hand on the tip, or takes it off.
    pub fn set_hand(&mut self, hand: Hand) {
        self.hand = hand;
    }
    /// The hand on the tip.
    pub fn hand(&self) -> &Hand {
        &self.hand
    }
    /// The hand on the tip, to lead it.
    pub fn hand_mut(&mut self) -> &mut Hand {
        &mut self.hand
    }
    /// Puts the device at rest at `q` (rad); its encoders see it move there.
    pub fn place(&mut self, q: [f64; 3]) {
        self.plant.place(q, [0.0; 3]);
    }
    /// Gives the tip a velocity, m/s.
    pub fn push(&mut self, velocity: [f64; 3]) {
        self.plant.push(velocity);
    }
    /// Changes the bus voltage, V.
    pub fn set_bus_voltage(&mut self, volts: f64) {
        self.bridge.bus_voltage = volts;
    }

    /// The joint angles at power-on, rad.
    pub fn start(&self) -> [f64; 3] {
        self.start
    }

    /// Number of joints N.
    pub fn joints(&self) -> usize {
        self.plant.joints()
    }
    /// Seconds since power-on.
    pub fn time(&self) -> f64 {
        self.time
    }
    /// Encoder counts since power-on; axes without a joint stay at 0.
    pub fn counts(&self) -> [i32; 3] {
        let q = self.plant.measured();
        core::array::from_fn(|i| self.encoders.get(i).map_or(0, |encoder| encoder.counts(q[i])))
    }
    /// Returns, for each encoder, true if its index mark is under the sensor.
    pub fn index(&self) -> [bool; 3] {
        let q = self.plant.measured();
        core::array::from_fn(|i| self.encoders.get(i).is_some_and(|encoder| encoder.at_index(q[i])))
    }
    /// Winding currents, A.
    pub fn currents(&self) -> [f64; 3] {
        core::array::from_fn(|i| self.motors.get(i).map_or(0.0, MotorModel::current))
    }
    /// Bus voltage, V.
    pub fn bus_voltage(&self) -> f64 {
        self.bridge.bus_voltage
    }
    /// Torques of the motors in the last step, N m.
    pub fn torque(&self) -> [f64; 3] {
        self.torque
    }
    /// Force of the hand on the tip in the last step, N.
    pub fn hand_force(&self) -> [f64; 3] {
        self.hand_force
    }
    /// Tip, m.
    pub fn tip(&self) -> [f64; 3] {
        self.plant.tip()
    }
    /// Tip velocity, m/s.
    pub fn tip_velocity(&self) -> [f64; 3] {
        self.plant.tip_velocity()
    }
    /// Joint angles of the links, rad.
    pub fn q(&self) -> [f64; 3] {
        self.plant.q()
    }
    /// Joint velocities, rad/s.
    pub fn qd(&self) -> [f64; 3] {
        self.plant.qd()
    }
    /// The linkage itself.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }
}
