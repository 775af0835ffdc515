//! A brushed motor behind an H-bridge, which converts duty to voltage, current and torque. A three-phase motor is in
//! brushless.rs.
//!
//! V = R i + L di/dt + Kₑ ω is solved exactly over a step at constant speed, and the torque is Kₜ i. The bridge is
//! averaged over its carrier period. The dead time of both half bridges reduces the voltage, against the current, by
//! the bus voltage times 2 · dead time · carrier frequency. For a current smaller than its ripple this effect fades to
//! zero, because the current then changes sign in every period.

use haptic_bridge::model::motor::Motor;

/// The drive of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum MotorInput {
    /// The bridge is off, so that the joint turns freely once the current has decayed.
    #[default]
    Floating,
    /// The bridge applies this share of the bus voltage, in [-1, 1].
    Duty(f64),
    /// The legs of a three-phase bridge have these duties, 0 to 1.
    Legs([f64; 3]),
    /// An ideal drive makes this torque, N m, at any speed.
    Torque(f64),
}

/// The supply and the bridge of all axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerStage {
    /// Bus voltage, V.
    pub bus_voltage: f64,
    /// Time between the opening of one switch of a half bridge and the closing of the other switch, s.
    pub dead_time: f64,
    /// Carrier frequency, Hz.
    pub carrier_hz: f64,
}

impl Default for PowerStage {
    /// Returns a stage with 24 V, 20 kHz, and the dead time of 120 ns of the ODrive's gate driver.
    fn default() -> Self {
        Self { bus_voltage: 24.0, dead_time: 120e-9, carrier_hz: 20_000.0 }
    }
}

/// The electrical state of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorModel {
    motor: Motor<f64>,
    current: f64,
}

impl MotorModel {
    /// Creates a motor without current.
    pub fn new(motor: Motor<f64>) -> Self {
        Self { motor, current: 0.0 }
    }
    /// Returns the winding current, A.
    pub fn current(&self) -> f64 {
        self.current
    }
    /// Advances by `h` (s) at the speed `omega` (rad/s). Returns the torque (N m) and a damping (N m s/rad). The
    /// damping is the back-EMF of a winding without inductance, so that the integrator is stable for any step.
    pub fn step(&mut self, drive: MotorInput, omega: f64, bridge: &PowerStage, h: f64) -> (f64, f64) {
        let Motor { torque_constant, inductance, back_emf, .. } = self.motor;
        match drive {
            MotorInput::Floating => {
                // The diodes apply the full bus voltage against the remaining current.
                let fall = if inductance > 0.0 { bridge.bus_voltage / inductance * h } else { f64::INFINITY };
                let before = self.current;
                self.current = before.signum() * (before.abs() - fall).max(0.0);
                (torque_constant * 0.5 * (before + self.current), 0.0)
            }
            MotorInput::Torque(torque) => {
                self.current = torque / torque_constant;
                (torque, 0.0)
            }
            // Only the first two legs of the bridge are wired to a brushed motor.
            MotorInput::Legs([first, second, _]) => self.step(MotorInput::Duty(first - second), omega, bridge, h),
            MotorInput::Duty(duty) => {
                let duty = if duty.is_finite() { duty.clamp(-1.0, 1.0) } else { 0.0 };
                let (voltage, resistance) = self.with_dead_time(duty * bridge.bus_voltage, bridge);
                if inductance > 0.0 {
                    let settled = (voltage - back_emf * omega) / resistance;
                    let x = h * resistance / inductance;
                    let excess = self.current - settled;
                    let mean = settled + excess * (-(-x).exp_m1()) / x;
                    self.current = settled + excess * (-x).exp();
                    (torque_constant * mean, 0.0)
                } else {
                    self.current = (voltage - back_emf * omega) / resistance;
                    (torque_constant * voltage / resistance, torque_constant * back_emf / resistance)
                }
            }
        }
    }

    /// Returns the effective voltage and resistance of the winding. The dead time acts as a voltage against a current
    /// above the ripple, and as a resistance for a smaller current.
    fn with_dead_time(&self, voltage: f64, bridge: &PowerStage) -> (f64, f64) {
        let Motor { resistance, inductance, .. } = self.motor;
        let lost = 2.0 * bridge.dead_time * bridge.carrier_hz * bridge.bus_voltage;
        // Half the peak-to-peak ripple of two-level modulation at zero duty. In a winding without inductance the
        // current follows the carrier completely.
        let ripple = bridge.bus_voltage / (4.0 * inductance * bridge.carrier_hz).max(resistance);
        if self.current.abs() < ripple {
            (voltage, resistance + lost / ripple)
        } else {
            (voltage - lost * self.current.signum(), resistance)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_bridge::model::motor::Winding;

    const MOTOR: Motor<f64> = Motor {
        torque_constant: 0.05,
        resistance: 2.0,
        inductance: 1e-3,
        back_emf: 0.05,
        max_current: 3.0,
        winding: Winding::Brushed,
        verified: false,
    };
    const IDEAL_STAGE: PowerStage = PowerStage { bus_voltage: 24.0, dead_time: 0.0, carrier_hz: 20_000.0 };

    #[test]
    fn the_current_of_a_blocked_motor_rises_with_l_over_r() {
        let mut motor = MotorModel::new(MOTOR);
        for _ in 0..100 {
            motor.step(MotorInput::Duty(0.25), 0.0, &IDEAL_STAGE, 5e-6);
        }
        // After the time constant L/R = 0.5 ms the current is 1 - 1/e of 6 V / 2 ohm.
        assert!((motor.current() - 3.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
    }

    #[test]
    fn without_inductance_the_back_emf_is_damping() {
        let mut motor = MotorModel::new(Motor { inductance: 0.0, ..MOTOR });
        let (torque, damping) = motor.step(MotorInput::Duty(0.25), 10.0, &IDEAL_STAGE, 5e-6);
        assert!((torque - 0.15).abs() < 1e-15 && (damping - 0.00125).abs() < 1e-15);
        assert!((motor.current() - (6.0 - 0.5) / 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_floating_bridge_carries_no_current() {
        let mut motor = MotorModel::new(MOTOR);
        motor.step(MotorInput::Duty(1.0), 0.0, &IDEAL_STAGE, 1e-4);
        assert!(motor.current() > 1.0);
        motor.step(MotorInput::Floating, 0.0, &IDEAL_STAGE, 1e-4);
        assert_eq!(motor.current(), 0.0);
        assert_eq!(motor.step(MotorInput::Floating, 50.0, &IDEAL_STAGE, 1e-4), (0.0, 0.0));
    }

    /// Returns the steady current of a motor at rest, A.
    fn steady_current(duty: f64, bridge: &PowerStage) -> f64 {
        let mut motor = MotorModel::new(MOTOR);
        for _ in 0..1000 {
            motor.step(MotorInput::Duty(duty), 0.0, bridge, 5e-5);
        }
        motor.current()
    }

    #[test]
    fn dead_time_reduces_the_voltage_against_the_current() {
        let bridge = PowerStage { dead_time: 1e-6, ..IDEAL_STAGE };
        // The dead time takes 2 x 1 us x 20 kHz x 24 V = 0.96 V of 6 V.
        assert!((steady_current(0.25, &bridge) - (6.0 - 0.96) / 2.0).abs() < 1e-9);
    }

    #[test]
    fn dead_time_acts_as_a_resistance_within_the_ripple() {
        let bridge = PowerStage { dead_time: 1e-6, ..IDEAL_STAGE };
        // The ripple is 24 V / (4 x 1 mH x 20 kHz) = 0.3 A; the lost 0.96 V act like 0.96 V / 0.3 A = 3.2 ohm.
        assert!((steady_current(0.01, &bridge) - 0.24 / (2.0 + 3.2)).abs() < 1e-9);
        // Without inductance the ripple is 24 V / 2 ohm = 12 A; the lost 0.96 V act like 0.96 V / 12 A = 0.08 ohm.
        let mut motor = MotorModel::new(Motor { inductance: 0.0, ..MOTOR });
        motor.step(MotorInput::Duty(0.25), 0.0, &bridge, 5e-6);
        assert!((motor.current() - 6.0 / 2.08).abs() < 1e-9);
    }

    #[test]
    fn a_nan_duty_applies_no_voltage() {
        let mut motor = MotorModel::new(MOTOR);
        motor.step(MotorInput::Duty(f64::NAN), 0.0, &IDEAL_STAGE, 1e-4);
        assert_eq!(motor.current(), 0.0);
    }
}
