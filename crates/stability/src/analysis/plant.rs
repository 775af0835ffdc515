//! The device linearised at a pose, in continuous time: M q̈ + B q̇ = τ with its drives, reduced to the part that
//! affects the wall.
//!
//! A wall feeds back only the rendered position. So joint positions do not matter, and a joint without damping is an
//! integrator without feedback: all such joints together appear only as their share of the rendered velocity. That
//! share is one state; the other states have no effect and are left out. So the analysis never has to distinguish a mode that rests
//! on the unit circle by construction from one that leaves it.
//!
//! Units are those of one sample: time in samples `T`, velocities in metres (radians) per sample, forces in units of
//! `m/T²` with a reference mass `m`. Stiffness is then `kp T²/m` and damping `kd T/m`.

use nalgebra::{DMatrix, DVector};

use super::flexible::Flexible;

/// The device at rest at one pose, along one rendered direction. `N` joints; gravity is balanced.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Mass matrix M of the rigid device, N x N, kg m²: the controller's model.
    pub mass: DMatrix<f64>,
    /// Viscous damping B of each joint, N m s/rad, not negative.
    pub viscous: DVector<f64>,
    /// Rendered Jacobian row Jr = nᵀ J, m/rad: rendered velocity of unit joint velocities.
    pub row: DVector<f64>,
    /// E = T⁻¹ e₁, rad/m: joint motion of unit rendered motion with no admissible motion.
    pub unit_motion: DVector<f64>,
    /// α: gain of the feed-forward of (4).
    pub gain: f64,
    /// Compliant parts, and the hand that holds the device.
    pub flexible: Flexible,
}

impl Linearised {
    /// Returns the effective inertia Weff = (Jr M⁻¹ Jrᵀ)⁻¹, kg. `None` if M is not positive definite or Jr is zero.
    pub fn w_eff(&self) -> Option<f64> {
        let mobility = self.row.dot(&self.mass.clone().cholesky()?.solve(&self.row));
        (mobility > 0.0 && mobility.is_finite()).then(|| 1.0 / mobility)
    }

    /// Returns the inertia of the rendered direction while the feed-forward holds the admissible ones, Wrr = Eᵀ M E,
    /// kg.
    pub fn w_rr(&self) -> f64 {
        self.unit_motion.dot(&(&self.mass * &self.unit_motion))
    }

    /// Returns the effective inertia with α times the feed-forward, Weff/(1 - α (1 - Weff/Wrr)), kg: Wrr for α = 1.
    /// `None` at and beyond the pole.
    pub fn inertia_met(&self) -> Option<f64> {
        if self.gain == 1.0 {
            return Some(self.w_rr());
        }
        let w_eff = self.w_eff()?;
        let met = w_eff / (1.0 - self.gain * (1.0 - w_eff / self.w_rr()));
        (met > 0.0 && met.is_finite()).then_some(met)
    }

    /// Returns the largest gain that a board allows here: half way from 1 to the pole of the inertia, where the inertia
    /// is twice Wrr.
    pub fn largest_gain(&self) -> Option<f64> {
        Some(0.5 * (1.0 + 1.0 / (1.0 - self.w_eff()? / self.w_rr()).max(f64::EPSILON)))
    }

    /// Returns the joint torque per newton of wall with the feed-forward, m: M E / Wrr. For α other than 1 the
    /// difference to Jr is scaled by α.
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

/// Lag between commanded torque and torque.
#[derive(Clone, Debug, PartialEq)]
pub enum Drive {
    /// No lag: the assumption of the golden values.
    Ideal,
    /// A voltage R τ/Kt on each motor, back-EMF not compensated: L di/dt = u - R i - Ke q̇, τ = Kt i.
    Voltage(Vec<MotorElectrics>),
    /// A current loop that behaves as a first-order lag of this bandwidth (Hz) and rejects the back-EMF.
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
    /// Returns the lags of `drive` on `joints` joints, in samples of `t` seconds.
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
                    // A lag below a millionth of a sample counts as none.
                    let rate = (rate.is_finite() && rate < 1e6).then_some(rate);
                    (rate, motor.torque_constant * motor.back_emf / motor.resistance)
                })
                .unzip(),
        };
        Self { rate, emf }
    }
}

/// The reduced continuous plant ẋ = a x + b u in sample units, for the given torque inputs.
///
/// States of a rigid device, in this order: velocities of the damped joints, torques of the joints with a lagging
/// drive, the common rendered velocity of all undamped joints (if there are any), the rendered position, then the
/// positions of the joints in `sensed` (needed only for their change over a sample).
pub(crate) struct ContinuousPlant {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    /// Joints with a velocity state, in order.
    pub damped: Vec<usize>,
    /// Joints with a torque state, in order.
    pub lagging: Vec<usize>,
    /// True if the undamped joints' share of the rendered velocity is a state.
    pub has_share: bool,
    /// Index of the rendered position, the last state before those in `sensed`.
    pub position: usize,
    /// The rendered position, as a row over the states without those in `sensed`.
    pub seen: DVector<f64>,
    /// Joints whose position follows the rendered position.
    pub sensed: Vec<usize>,
    /// True if the drives themselves damp a joint (uncompensated back-EMF).
    pub electrically_damped: bool,
}

impl ContinuousPlant {
    /// Creates the plant of a compliant device, whose states have no individual meaning.
    pub fn of_flexible_device(a: DMatrix<f64>, b: DMatrix<f64>, seen: DVector<f64>) -> Self {
        Self {
            position: a.nrows() - 1,
            a,
            b,
            damped: Vec::new(),
            lagging: Vec::new(),
            has_share: false,
            seen,
            sensed: Vec::new(),
            electrically_damped: false,
        }
    }

    /// Returns the number of states without those in `sensed`.
    pub fn states(&self) -> usize {
        self.seen.len()
    }
}
