//! The device linearised at a pose in continuous time, reduced to the motions that affect the wall.
//!
//! A wall feeds back only the rendered position, so joint positions do not matter. Joints without damping are
//! integrators without feedback; their common share of the rendered velocity is one state, and their other states have
//! no effect. So the analysis need not separate modes that rest on the unit circle by construction from modes that
//! leave it.
//!
//! Units are those of one sample: time in samples `T`, velocities in metres (or radians) per sample, and forces in
//! `m/T²` with a reference mass `m`. Stiffness is then `kp T²/m`, and damping `kd T/m`.

use super::flexible::Flexible;
use nalgebra::{DMatrix, DVector};

/// The device at rest at one pose along one rendered direction, with N joints and balanced gravity.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Mass matrix M of the rigid device as the controller models it, N x N, kg m².
    pub mass: DMatrix<f64>,
    /// Viscous damping B of each joint, N m s/rad, not negative.
    pub viscous: DVector<f64>,
    /// Rendered Jacobian row Jr = nᵀ J, m/rad.
    pub row: DVector<f64>,
    /// E = T⁻¹ e₁, rad/m: joint motion for unit rendered motion without admissible motion.
    pub unit_motion: DVector<f64>,
    /// Gain α of the feed-forward in equation (4).
    pub gain: f64,
    /// Compliant parts of the device, and the hand that holds it.
    pub flexible: Flexible,
}

impl Linearised {
    /// Returns the effective inertia Weff = (Jr M⁻¹ Jrᵀ)⁻¹, kg, or `None` if M is not positive definite or Jr is zero.
    pub fn w_eff(&self) -> Option<f64> {
        let mobility = self.row.dot(&self.mass.clone().cholesky()?.solve(&self.row));
        (mobility > 0.0 && mobility.is_finite()).then(|| 1.0 / mobility)
    }

    /// Returns the rendered inertia Wrr = Eᵀ M E while the feed-forward holds the admissible motions, kg.
    pub fn w_rr(&self) -> f64 {
        self.unit_motion.dot(&(&self.mass * &self.unit_motion))
    }

    /// Returns the effective inertia with α times the feed-forward, Weff/(1 - α (1 - Weff/Wrr)), kg. It is Wrr for α =
    /// 1. Returns `None` at and beyond the pole.
    pub fn inertia_met(&self) -> Option<f64> {
        if self.gain == 1.0 {
            return Some(self.w_rr());
        }
        let w_eff = self.w_eff()?;
        let met = w_eff / (1.0 - self.gain * (1.0 - w_eff / self.w_rr()));
        (met > 0.0 && met.is_finite()).then_some(met)
    }

    /// Returns the largest gain α that a board allows: half way from 1 to the pole, where the inertia is 2 Wrr.
    pub fn largest_gain(&self) -> Option<f64> {
        Some(0.5 * (1.0 + 1.0 / (1.0 - self.w_eff()? / self.w_rr()).max(f64::EPSILON)))
    }

    /// Returns the joint torque per newton of wall force with the feed-forward, m. It is M E / Wrr for α = 1; otherwise
    /// its difference to Jr is scaled by α.
    pub fn shaped_torque(&self) -> DVector<f64> {
        let shaped = &self.mass * &self.unit_motion / self.w_rr();
        if self.gain == 1.0 { shaped } else { &self.row + (shaped - &self.row) * self.gain }
    }
}

/// A DC motor of a voltage-driven joint, with all values referred to the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorElectrics {
    /// Torque constant, N m/A.
    pub torque_constant: f64,
    /// Back-EMF constant, V s/rad.
    pub back_emf: f64,
    /// Resistance, Ω.
    pub resistance: f64,
    /// Inductance, H.
    pub inductance: f64,
}

/// Lag from commanded to actual torque.
#[derive(Clone, Debug, PartialEq)]
pub enum Drive {
    /// No lag, as in the golden values.
    Ideal,
    /// Voltage R τ/Kt on each motor without compensation of the back-EMF: L di/dt = u - R i - Ke q̇, τ = Kt i.
    Voltage(Vec<MotorElectrics>),
    /// First-order lag of a current loop that rejects the back-EMF.
    Current {
        /// -3 dB bandwidth of the current loop, Hz.
        bandwidth_hz: f64,
    },
}

/// Lag and damping of all joints' drives.
#[derive(Clone, Debug, PartialEq)]
pub struct Lags {
    /// Lag rate per sample; `None` without a lag.
    pub rate: Vec<Option<f64>>,
    /// Damping by the back-EMF, N m s/rad.
    pub emf: Vec<f64>,
}

impl Lags {
    /// Returns the lags of `drive` on `joints` joints, with the sample period `t` (s).
    pub fn new(drive: &Drive, joints: usize, t: f64) -> Self {
        let (rate, emf) = match drive {
            Drive::Ideal => (vec![None; joints], vec![0.0; joints]),
            Drive::Current { bandwidth_hz } => {
                (vec![Some(std::f64::consts::TAU * bandwidth_hz * t); joints], vec![0.0; joints])
            }
            Drive::Voltage(motors) => motors
                .iter()
                .map(|motor| {
                    let rate = motor.resistance * t / motor.inductance;
                    // A lag below a millionth of a sample counts as no lag.
                    let rate = (rate.is_finite() && rate < 1e6).then_some(rate);
                    (rate, motor.torque_constant * motor.back_emf / motor.resistance)
                })
                .unzip(),
        };
        Self { rate, emf }
    }
}

/// The reduced continuous plant ẋ = a x + b u in sample units, for given torque inputs.
///
/// A rigid device has these states, in this order: velocities of damped joints, torques of joints with a lagging drive,
/// the common rendered velocity of all undamped joints (if any), the rendered position, and the positions of the joints
/// in `sensed`, whose change over a sample is needed.
pub(crate) struct ContinuousPlant {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    /// Joints with a velocity state, in order.
    pub damped: Vec<usize>,
    /// Joints with a torque state, in order.
    pub lagging: Vec<usize>,
    /// True if the undamped joints' share of the rendered velocity is one of the states.
    pub has_share: bool,
    /// Index of the rendered position, the last state before the positions of `sensed`.
    pub position: usize,
    /// The rendered position as a row over the states without the positions of `sensed`.
    pub rendered_rows: DVector<f64>,
    /// Joints whose positions are the last states.
    pub sensed: Vec<usize>,
    /// True if uncompensated back-EMF damps a joint.
    pub electrically_damped: bool,
}

impl ContinuousPlant {
    /// Creates the plant of a compliant device. Its single states have no physical meaning.
    pub fn of_flexible_device(a: DMatrix<f64>, b: DMatrix<f64>, rendered_rows: DVector<f64>) -> Self {
        Self {
            position: a.nrows() - 1,
            a,
            b,
            damped: Vec::new(),
            lagging: Vec::new(),
            has_share: false,
            rendered_rows,
            sensed: Vec::new(),
            electrically_damped: false,
        }
    }

    /// Returns the number of states without the positions of `sensed`.
    pub fn states(&self) -> usize {
        self.rendered_rows.len()
    }
}
