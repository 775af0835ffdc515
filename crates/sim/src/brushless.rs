//! A three-phase motor with surface magnets behind three half bridges.
//!
//! The model is in the stator's frame, where it needs no rotating coordinates: each phase is a resistance, an inductance
//! and a sinusoidal back-EMF between its leg and the neutral point. The field of phase k is the cosine of the rotor's
//! electrical angle less 2πk/3, and its back-EMF is the derivative of the field. The phases' power Σ eₖ iₖ is the
//! mechanical power, so the torque is Σ eₖ iₖ/ω. The equation is solved exactly over a step at constant back-EMF. The
//! dead time of each leg acts against its current, as in motor.rs.

use super::motor::{MotorInput, PowerStage};
use haptic_bridge::model::motor::Motor;
use std::f64::consts::TAU;

/// A broken phase, 0 to 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BrokenPhase {
    /// The phase carries no current.
    Open(usize),
    /// The winding of the phase is short-circuited, so that its terminal is the neutral point.
    Shorted(usize),
}

/// The electrical state of one three-phase motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrushlessModel {
    motor: Motor<f64>,
    /// Electrical turns per turn of the joint; negative if two phases are exchanged.
    electrical_ratio: f64,
    /// Electrical angle of the rotor at joint angle zero, rad.
    electrical_zero: f64,
    /// Winding currents, A.
    currents: [f64; 3],
    broken: Option<BrokenPhase>,
}

impl BrushlessModel {
    /// Creates a motor without current; `None` for a brushed motor.
    pub fn new(motor: Motor<f64>, electrical_zero: f64) -> Option<Self> {
        let electrical_ratio = motor.electrical_ratio()?;
        Some(Self { motor, electrical_ratio, electrical_zero, currents: [0.0; 3], broken: None })
    }

    /// Turns the rotor on its shaft by an electrical angle, rad.
    pub fn slip(&mut self, angle: f64) {
        self.electrical_zero += angle;
    }

    /// Breaks a phase.
    pub fn break_phase(&mut self, broken: BrokenPhase) {
        if let BrokenPhase::Open(phase) = broken {
            // The other two phases carry the same current from here on.
            let half = 0.5 * self.currents[phase];
            self.currents = self.currents.map(|current| current + half);
            self.currents[phase] = 0.0;
        }
        self.broken = Some(broken);
    }

    /// Returns the currents of the three terminals, A.
    pub fn currents(&self) -> [f64; 3] {
        let mut currents = self.currents;
        if let Some(BrokenPhase::Shorted(phase)) = self.broken {
            currents[phase] -= currents.iter().sum::<f64>();
        }
        currents
    }

    /// Returns the back-EMF of each phase at a joint angle of `q` (rad) and a speed of 1 rad/s, V s/rad.
    fn fields(&self, q: f64) -> [f64; 3] {
        let angle = self.electrical_ratio * q + self.electrical_zero;
        let size = self.motor.back_emf * self.electrical_ratio.signum();
        core::array::from_fn(|phase| -size * (angle - TAU / 3.0 * phase as f64).sin())
    }

    /// Returns the quadrature current at a joint angle of `q` (rad), A.
    pub fn quadrature_current(&self, q: f64) -> f64 {
        let fields = self.fields(q);
        let sum: f64 = fields.iter().zip(self.currents).map(|(field, current)| field * current).sum();
        sum / (1.5 * self.motor.back_emf)
    }

    /// Advances by `h` (s) at the joint angle `q` (rad) and the speed `omega` (rad/s). Returns the torque, N m.
    pub fn step(&mut self, drive: MotorInput, q: f64, omega: f64, bridge: &PowerStage, h: f64) -> f64 {
        let Motor { torque_constant, resistance, inductance, .. } = self.motor;
        let fields = self.fields(q + 0.5 * h * omega);
        let legs = match drive {
            MotorInput::Torque(torque) => {
                let current = torque / torque_constant;
                self.currents = fields.map(|field| current * field / self.motor.back_emf);
                return torque;
            }
            MotorInput::Floating => {
                // The diodes apply the bus voltage against the remaining currents.
                let fall = bridge.bus_voltage / (1.5 * inductance) * h;
                let before = self.currents;
                self.currents = before.map(|current| current.signum() * (current.abs() - fall).max(0.0));
                let mean = self.currents.iter().sum::<f64>() / 3.0;
                self.currents = self.currents.map(|current| current - mean);
                return self.torque(&fields, core::array::from_fn(|i| 0.5 * (before[i] + self.currents[i])));
            }
            MotorInput::Duty(duty) => [0.5 + 0.5 * duty, 0.5 - 0.5 * duty, 0.5],
            MotorInput::Legs(legs) => legs,
        };
        let lost = bridge.dead_time * bridge.carrier_hz * bridge.bus_voltage;
        let ripple = bridge.bus_voltage / (8.0 * inductance * bridge.carrier_hz);
        let volts: [f64; 3] = core::array::from_fn(|i| {
            let duty = if legs[i].is_finite() { legs[i].clamp(0.0, 1.0) } else { 0.0 };
            duty * bridge.bus_voltage - lost * (self.currents[i] / ripple).clamp(-1.0, 1.0)
        });
        let inner: [f64; 3] = core::array::from_fn(|i| volts[i] - fields[i] * omega);
        let neutral = match self.broken {
            None => inner.iter().sum::<f64>() / 3.0,
            Some(BrokenPhase::Open(phase)) => 0.5 * (inner.iter().sum::<f64>() - inner[phase]),
            Some(BrokenPhase::Shorted(phase)) => volts[phase],
        };
        let x = h * resistance / inductance;
        let mut mean = [0.0; 3];
        for i in 0..3 {
            if self.broken == Some(BrokenPhase::Open(i)) {
                self.currents[i] = 0.0;
                continue;
            }
            let settled = (inner[i] - neutral) / resistance;
            let excess = self.currents[i] - settled;
            mean[i] = settled + excess * (-(-x).exp_m1()) / x;
            self.currents[i] = settled + excess * (-x).exp();
        }
        self.torque(&fields, mean)
    }

    /// Returns the torque of these currents (A), N m.
    fn torque(&self, fields: &[f64; 3], currents: [f64; 3]) -> f64 {
        let product: f64 = fields.iter().zip(currents).map(|(field, current)| field * current).sum();
        product * self.motor.torque_constant / (1.5 * self.motor.back_emf)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_bridge::model::motor::Winding;

    const MOTOR: Motor<f64> = Motor {
        torque_constant: 0.09,
        resistance: 2.5,
        inductance: 1e-3,
        back_emf: 0.06,
        max_current: 3.0,
        winding: Winding::ThreePhase { pole_pairs: 7, ratio: 1.0 },
        verified: false,
    };

    #[test]
    fn electrical_energy_is_mechanical_work_and_heat_and_field_energy() {
        let bridge = PowerStage { dead_time: 0.0, ..PowerStage::default() };
        let mut motor = BrushlessModel::new(MOTOR, 0.4).unwrap();
        let (h, inertia) = (1e-6, 2e-5);
        let (mut q, mut omega, mut supplied, mut work, mut heat) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for step in 0..200_000 {
            // A voltage vector that turns at 40 Hz drags the rotor along and past it.
            let angle = TAU * 40.0 * f64::from(step) * h;
            let legs = core::array::from_fn(|i| 0.5 + 0.2 * (angle - TAU / 3.0 * i as f64).cos());
            let before = motor.currents();
            let torque = motor.step(MotorInput::Legs(legs), q, omega, &bridge, h);
            for (i, leg) in legs.iter().enumerate() {
                let mean = 0.5 * (before[i] + motor.currents()[i]);
                supplied += leg * bridge.bus_voltage * mean * h;
                heat += MOTOR.resistance * mean * mean * h;
            }
            let turned = h * (omega + 0.5 * h * torque / inertia);
            work += torque * turned;
            q += turned;
            omega += h * torque / inertia;
        }
        let stored: f64 = motor.currents().iter().map(|current| 0.5 * MOTOR.inductance * current * current).sum();
        let kinetic = 0.5 * inertia * omega * omega;
        assert!(heat > 0.05 && (work / kinetic - 1.0).abs() < 1e-3, "{heat} J, {work} J, {kinetic} J");
        assert!((supplied / (work + heat + stored) - 1.0).abs() < 1e-3, "{supplied} J, {work} J, {heat} J, {stored} J");
    }

    #[test]
    fn the_torque_of_a_blocked_rotor_is_the_sine_of_the_angle_from_the_field() {
        let bridge = PowerStage { dead_time: 0.0, ..PowerStage::default() };
        for angle in [0.0, 0.5, 2.0, -1.0] {
            let mut motor = BrushlessModel::new(MOTOR, angle).unwrap();
            let mut torque = 0.0;
            for _ in 0..10_000 {
                torque = motor.step(MotorInput::Legs([0.6, 0.5, 0.5]), 0.0, 0.0, &bridge, 5e-6);
            }
            // Leg 0 is a tenth of 24 V above the other two, and phase 0 takes two thirds of these 2.4 V.
            let peak = 2.4 * 2.0 / 3.0 / 2.5 * MOTOR.torque_constant;
            assert!((torque + peak * angle.sin()).abs() < 1e-9, "{angle}: {torque} N m of {peak} N m");
        }
    }

    #[test]
    fn a_floating_bridge_carries_no_current() {
        let mut motor = BrushlessModel::new(MOTOR, 0.0).unwrap();
        motor.step(MotorInput::Legs([0.9, 0.1, 0.5]), 0.0, 0.0, &PowerStage::default(), 1e-4);
        assert!(motor.currents()[0] > 0.5);
        motor.step(MotorInput::Floating, 0.0, 0.0, &PowerStage::default(), 1e-3);
        assert_eq!(
            (motor.currents(), motor.step(MotorInput::Floating, 0.0, 50.0, &PowerStage::default(), 1e-4)),
            ([0.0; 3], 0.0)
        );
    }
}
