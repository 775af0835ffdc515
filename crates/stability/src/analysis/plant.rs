//! The device linearised at a pose, in continuous time: M q̈ + B q̇ = τ with its drives, reduced to what the wall can
//! see.
//!
//! A wall feeds back the rendered position alone. Joint positions therefore never enter, and a joint without damping is
//! an integrator that nothing reads: all of them together are seen only through their share of the rendered velocity.
//! That share is kept as one state, and leaving the rest out changes nothing. So the analysis never has to tell a mode
//! that rests on the unit circle by construction from one that moves out of it.
//!
//! Units here are those of one sample: time in samples `T`, velocities in metres (radians) per sample, forces in units
//! of `m/T²` with `m` a reference mass. Stiffness is then `kp T²/m` and damping `kd T/m`.

use nalgebra::{DMatrix, DVector};

use super::flexible::Flexible;

/// The device at rest at one pose, seen along one rendered direction. `N` joints; gravity is balanced.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Mass matrix M of the rigid device, N x N, kg m²: what the controller knows.
    pub mass: DMatrix<f64>,
    /// Viscous damping B of each joint, N m s/rad, not negative.
    pub viscous: DVector<f64>,
    /// Rendered Jacobian row Jr = nᵀ J, m/rad: rendered velocity of unit joint velocities.
    pub row: DVector<f64>,
    /// E = T⁻¹ e₁, rad/m: joint motion of unit rendered motion with no admissible motion.
    pub unit_motion: DVector<f64>,
    /// α: how much of (4)'s feed-forward there is where there is any.
    pub gain: f64,
    /// Its flexible parts, and the hand that holds it.
    pub flexible: Flexible,
}

impl Linearised {
    /// Effective inertia Weff = (Jr M⁻¹ Jrᵀ)⁻¹, kg. `None` where M is not positive definite or Jr is zero.
    pub fn w_eff(&self) -> Option<f64> {
        let mobility = self.row.dot(&self.mass.clone().cholesky()?.solve(&self.row));
        (mobility > 0.0 && mobility.is_finite()).then(|| 1.0 / mobility)
    }

    /// Inertia of the rendered direction with the admissible ones held by the feed-forward, Wrr = Eᵀ M E, kg.
    pub fn w_rr(&self) -> f64 {
        self.unit_motion.dot(&(&self.mass * &self.unit_motion))
    }

    /// The inertia that the wall meets with α times the feed-forward, Weff/(1 - α (1 - Weff/Wrr)), kg: Wrr for α = 1.
    /// `None` at and beyond the pole.
    pub fn inertia_met(&self) -> Option<f64> {
        if self.gain == 1.0 {
            return Some(self.w_rr());
        }
        let w_eff = self.w_eff()?;
        let met = w_eff / (1.0 - self.gain * (1.0 - w_eff / self.w_rr()));
        (met > 0.0 && met.is_finite()).then_some(met)
    }

    /// The gain that a board gives at most here: half way from (4)'s to the pole of the inertia, where it is twice Wrr.
    pub fn most_gain(&self) -> Option<f64> {
        Some(0.5 * (1.0 + 1.0 / (1.0 - self.w_eff()? / self.w_rr()).max(f64::EPSILON)))
    }

    /// Joint torque per newton of wall with the feed-forward on, m: M E / Wrr, and for α other than 1 that much more or
    /// less beside Jr.
    pub fn shaped_torque(&self) -> DVector<f64> {
        let shaped = &self.mass * &self.unit_motion / self.w_rr();
        if self.gain == 1.0 { shaped } else { &self.row + (shaped - &self.row) * self.gain }
    }
}

/// A DC motor behind a voltage-driven joint, all seen from the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorElectrics {
    /// N m/A.
    pub torque_constant: f64,
    /// V s/rad.
    pub back_emf: f64,
    /// Ω.
    pub resistance: f64,
    /// H.
    pub inductance: f64,
}

/// The lag between commanded torque and torque.
#[derive(Clone, Debug, PartialEq)]
pub enum Drive {
    /// At once: what the golden values assume.
    Ideal,
    /// A voltage R τ/Kt on each motor, back-EMF not compensated: L di/dt = u - R i - Ke q̇, τ = Kt i.
    Voltage(Vec<MotorElectrics>),
    /// A current loop that behaves as a first-order lag of this bandwidth (Hz) and rejects the back-EMF.
    Current {
        /// -3 dB bandwidth of the current loop, Hz.
        bandwidth_hz: f64,
    },
}

/// The lag and the damping of all joints' drives.
#[derive(Clone, Debug, PartialEq)]
pub struct Lags {
    /// Lag rate per sample, where there is a lag.
    pub rate: Vec<Option<f64>>,
    /// Damping by the back-EMF, N m s/rad.
    pub emf: Vec<f64>,
}

impl Lags {
    /// Those of `drive` on `joints` joints, in samples of `t` seconds.
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
                    // A lag of less than a millionth of a sample is no lag.
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
/// States of a rigid device, in this order: velocities of the damped joints, torques of the joints whose drive lags,
/// the rendered velocity of all undamped joints together (when there are any), the rendered position, then the
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
    /// Index of the rendered position, the last state but those in `sensed`.
    pub position: usize,
    /// The rendered position, as a row over the states without those in `sensed`.
    pub seen: DVector<f64>,
    /// Joints whose position follows the rendered position.
    pub sensed: Vec<usize>,
    /// True if the drives themselves damp a joint (uncompensated back-EMF).
    pub electrically_damped: bool,
}

impl ContinuousPlant {
    /// A flexible device's, whose states have no meaning one by one.
    pub fn of_a_flexible_device(a: DMatrix<f64>, b: DMatrix<f64>, seen: DVector<f64>) -> Self {
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

    /// States without those in `sensed`.
    pub fn states(&self) -> usize {
        self.seen.len()
    }
}
