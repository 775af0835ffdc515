//! The plant at the board's connectors: motors that move a device, and encoders.

use std::fmt::Debug;

use haptic_sim::{MotorInput, SimulatedDevice};

/// A device at the board's connectors, with up to three axes.
pub trait Plant: Debug + Send {
    /// Advances by `dt` (s) with these motor inputs.
    fn step(&mut self, drives: &[MotorInput; 3], dt: f64);
    /// Returns the encoder counts (quadrature edges) since power-on.
    fn counts(&self) -> [i32; 3];
    /// Returns true for each axis with an absolute encoder.
    fn absolute_axes(&self) -> [bool; 3] {
        [false; 3]
    }
    /// Returns true for each encoder whose index mark is at the sensor.
    fn index(&self) -> [bool; 3];
    /// Returns the winding currents, A. A positive duty makes a positive current.
    fn currents(&self) -> [f64; 3];
    /// Returns the phase currents of a three-phase motor, A.
    fn phase_currents(&self, _axis: usize) -> Option<[f64; 3]> {
        None
    }
    /// Returns the bus voltage, V.
    fn bus_voltage(&self) -> f64;
    /// Returns the simulated device, if the plant is one.
    fn device(&mut self) -> Option<&mut SimulatedDevice> {
        None
    }
}

impl Plant for SimulatedDevice {
    fn step(&mut self, drives: &[MotorInput; 3], dt: f64) {
        SimulatedDevice::step(self, drives, dt);
    }
    fn counts(&self) -> [i32; 3] {
        SimulatedDevice::counts(self)
    }
    fn absolute_axes(&self) -> [bool; 3] {
        SimulatedDevice::absolute_axes(self)
    }
    fn index(&self) -> [bool; 3] {
        SimulatedDevice::index(self)
    }
    fn currents(&self) -> [f64; 3] {
        SimulatedDevice::currents(self)
    }
    fn phase_currents(&self, axis: usize) -> Option<[f64; 3]> {
        SimulatedDevice::phase_currents(self, axis)
    }
    fn bus_voltage(&self) -> f64 {
        SimulatedDevice::bus_voltage(self)
    }
    fn device(&mut self) -> Option<&mut SimulatedDevice> {
        Some(self)
    }
}

/// A plant that does not move. The encoders keep their counts, and the motor inputs are recorded.
#[derive(Clone, Debug)]
pub struct Dummy {
    /// Counts of the encoders.
    pub counts: [i32; 3],
    /// True for each encoder whose index mark is at the sensor.
    pub index: [bool; 3],
    /// Currents at the sensors, A.
    pub currents: [f64; 3],
    /// Bus voltage, V.
    pub bus_voltage: f64,
    /// Motor inputs of the last step.
    pub drives: [MotorInput; 3],
}

impl Default for Dummy {
    fn default() -> Self {
        Self {
            counts: [0; 3],
            index: [false; 3],
            currents: [0.0; 3],
            bus_voltage: 24.0,
            drives: [MotorInput::Floating; 3],
        }
    }
}

impl Plant for Dummy {
    fn step(&mut self, drives: &[MotorInput; 3], _: f64) {
        self.drives = *drives;
    }
    fn counts(&self) -> [i32; 3] {
        self.counts
    }
    fn index(&self) -> [bool; 3] {
        self.index
    }
    fn currents(&self) -> [f64; 3] {
        self.currents
    }
    fn bus_voltage(&self) -> f64 {
        self.bus_voltage
    }
}

/// Largest values since the last reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Peaks {
    /// Largest current of a winding, A.
    pub current: f64,
    /// Largest speed of a joint, rad/s.
    pub speed: f64,
    /// Largest distance of the tip from its first position, m.
    pub travel: f64,
    /// True if a bridge was on.
    pub bridge_was_on: bool,
    /// True if the chip drove a pin of the power stage or pulled it up.
    pub power_pin_was_driven: bool,
    first_tip: Option<[f64; 3]>,
}

impl Peaks {
    /// Updates the peaks with the present values.
    pub fn update(&mut self, plant: &mut dyn Plant) {
        let currents = plant.currents();
        let Some(device) = plant.device() else { return };
        let largest = |values: [f64; 3]| values.iter().fold(0.0, |max: f64, value| max.max(value.abs()));
        self.current = self.current.max(largest(currents));
        self.speed = self.speed.max(largest(device.qd()));
        let tip = device.tip();
        let first = *self.first_tip.get_or_insert(tip);
        let way = tip.iter().zip(first).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        self.travel = self.travel.max(way);
    }
}
