//! Passivity: bounds within which no passive hand can make a wall oscillate.
//!
//! - J. E. Colgate and G. G. Schenkel, "Passivity of a class of sampled-data systems: application to haptic
//!   interfaces", Journal of Robotic Systems 14 (1997) 37-47. The wall H(z) is passive on a device with physical damping
//!   b if b > T/2 Re((1 - e^-jθ) H)/(1 - cos θ) at every θ. With backward-difference damping this is **b > kp T/2 +
//!   |kd|**.
//! - J. J. Abbott and A. M. Okamura, "Effects of position quantization and sampling rate on virtual-wall passivity",
//!   IEEE Transactions on Robotics 21 (2005) 952-964: **kp ≤ min(2b/T, 2 fc/Δ)** for a pure spring, with Coulomb
//!   friction fc and position quantum Δ.
//!
//! The proof of the first bound uses discs. A passive system in parallel with b moves by f/(b + passive) for a force f,
//! a value in the disc of radius 1/(2b) about 1/(2b). Sampling adds the discs of the hold's aliases ω_k = (θ + 2πk)/T
//! to a disc of radius r about C. The loop avoids -1 if |1 + H C| > |H| r. A delay of whole samples rotates C.
//!
//! A fraction of a sample and a lagging drive L(jω) rotate the aliases unequally. With them C = G/(2b), where G is the
//! sampled motion of an integrator behind hold, delay and lag, and r = T/(2b) |1 - e^-jθ| Σ_k |L(jω_k)|/(θ + 2πk)². The
//! condition is 1 + 2 Re(H C) - |H|² (r² - |C|²) > 0 at every θ, for H = kp + kd V with the velocity estimator V. It is
//! a convex set of (kp, kd). For slow motions it becomes b > kp T (1/2 + delay) + kp · lag.
//!
//! Both bounds hold for one moving mass whose force acts along its motion. On a device with several joints b and fc are
//! the smallest dissipation of any joint motion with unit rendered velocity.
//!
//! The bounds exclude the feed-forward, whose torques do not act along the rendered motion, an encoder behind a spring,
//! a rendered posture, drives with different lags, and a velocity predicted from commands.

use super::control_loop::Loop;
use super::plant::{Drive, Linearised};
use haptic_bridge::model::description::Description;
use nalgebra::{Complex, DVector};

/// Number of logarithmically spaced angles between `SLOWEST_ANGLE_RAD` and `EVEN_FROM_RAD`.
const SLOW_ANGLES: usize = 200;
/// Number of even angles above `EVEN_FROM_RAD` without delay. Each sample of delay adds as many.
const EVEN_ANGLES: usize = 400;
/// Smallest analysed angle, rad. Slower motions follow their limit, `Passivity::mean_delay_s`.
const SLOWEST_ANGLE_RAD: f64 = 1e-3;
/// Angle at which evenly spaced angles begin, rad.
const EVEN_FROM_RAD: f64 = 0.1;
/// Number of aliases on each side with exact lag. The remaining aliases count as without lag, which makes r larger.
const ALIASES: i32 = 60;

/// Dissipation of the device along the rendered direction, and the condition for a passive wall.
#[derive(Clone, Debug, PartialEq)]
pub struct Passivity {
    /// Smallest viscous damping for unit rendered motion, (Jr B⁻¹ Jrᵀ)⁻¹, N s/m; zero if a moving joint has no damping.
    pub damping: f64,
    /// Smallest Coulomb friction, minⱼ Cⱼ/|Jrⱼ|, N.
    pub coulomb: f64,
    /// Largest step of the rendered position if every encoder steps once, Σⱼ |Jrⱼ| Δⱼ, m; `None` without encoders.
    pub quantum: Option<f64>,
    /// Average delay of a force, s.
    mean_delay_s: f64,
    angles: Vec<ConditionTerms>,
}

/// Terms of the passivity condition at one angle θ.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ConditionTerms {
    /// Centre C of the disc, m/N.
    centre: Complex<f64>,
    /// r² - |C|², m²/N².
    spread: f64,
    /// Response V of the velocity estimator, 1/s.
    velocity: Complex<f64>,
}

impl Passivity {
    /// Computes the bounds of a device at a pose in this control loop. Returns `None` if no bound is known.
    pub fn new(device: &Linearised, description: &Description, around: &Loop) -> Option<Self> {
        let flexible = &device.flexible;
        if flexible.is_sensed_behind_a_spring() || flexible.posture.is_some() || around.estimator.uses_commands() {
            return None;
        }
        let joints = description.kind.spec().joints;
        let (lag_s, mut viscous) = (lag_s(&around.drive)?, device.viscous.clone());
        if let (Drive::Voltage(motors), true) = (&around.drive, lag_s == 0.0) {
            for (viscous, motor) in viscous.iter_mut().zip(motors) {
                *viscous += motor.torque_constant * motor.back_emf / motor.resistance;
            }
        }
        let row: &DVector<f64> = &device.row;
        // A joint without motion along the rendered direction has no effect on the bounds.
        let moving = || (0..joints).filter(|&j| row[j].abs() > 1e-9 * row.amax());
        let damping = 1.0 / moving().map(|j| row[j] * row[j] / viscous[j]).sum::<f64>();
        let coulomb = moving().map(|j| description.joints[j].coulomb / row[j].abs()).fold(f64::INFINITY, f64::min);
        let quantum = moving()
            .map(|j| {
                let encoder = description.joints[j].encoder?;
                Some(row[j].abs() * std::f64::consts::TAU / encoder.counts_per_turn.abs())
            })
            .sum();
        let damping = if damping.is_finite() { damping } else { 0.0 };
        Some(Self {
            damping,
            coulomb: if coulomb.is_finite() { coulomb } else { 0.0 },
            quantum,
            mean_delay_s: (0.5 + around.delay_samples) / around.rate_hz + lag_s,
            angles: if damping > 0.0 { angles(damping, lag_s, around) } else { Vec::new() },
        })
    }

    /// Returns the largest passive stiffness at a damping (N s/m), N/m; zero above [`Passivity::largest_damping`].
    pub fn largest_stiffness(&self, kd: f64) -> f64 {
        let allowed = self.angles.iter().map(|angle| {
            let ConditionTerms { centre, spread, velocity } = angle;
            let rest = 1.0 + 2.0 * kd * (velocity * centre).re - spread * kd * kd * velocity.norm_sqr();
            positive_root(*spread, 2.0 * centre.re - 2.0 * spread * kd * velocity.re, rest)
        });
        allowed.reduce(f64::min).map_or(0.0, |least| least.min((self.damping + kd) / self.mean_delay_s))
    }

    /// Returns the largest passive damping, N s/m.
    pub fn largest_damping(&self) -> f64 {
        let allowed = self.angles.iter().map(|angle| {
            let ConditionTerms { centre, spread, velocity } = angle;
            positive_root(spread * velocity.norm_sqr(), 2.0 * (velocity * centre).re, 1.0)
        });
        allowed.reduce(f64::min).unwrap_or(0.0)
    }

    /// Returns the largest passive stiffness of an undamped wall (Abbott and Okamura), N/m.
    pub fn largest_undamped_stiffness(&self) -> Option<f64> {
        let friction = 2.0 * self.coulomb / self.quantum?;
        Some(friction.min(self.largest_stiffness(0.0)))
    }
}

/// Returns the largest x up to which -a x² + b x + c is positive from zero; a must not be negative.
fn positive_root(a: f64, b: f64, c: f64) -> f64 {
    if c > 0.0 { 2.0 * c / ((b * b + 4.0 * a * c).sqrt() - b).max(0.0) } else { 0.0 }
}

/// Returns the common lag of all drives, s, or `None` if the lags differ.
fn lag_s(drive: &Drive) -> Option<f64> {
    match drive {
        Drive::Ideal => Some(0.0),
        Drive::Current { bandwidth_hz } => Some(1.0 / (std::f64::consts::TAU * bandwidth_hz)),
        Drive::Voltage(motors) => {
            let mut lags = motors.iter().map(|motor| motor.inductance / motor.resistance);
            let first = lags.next()?;
            lags.all(|lag| (lag - first).abs() <= 1e-9 * first).then_some(first)
        }
    }
}

/// Computes the condition's terms at all analysed angles, for physical damping `b` (N s/m).
fn angles(b: f64, lag_s: f64, around: &Loop) -> Vec<ConditionTerms> {
    let decades = (EVEN_FROM_RAD / SLOWEST_ANGLE_RAD).powf(1.0 / SLOW_ANGLES as f64);
    let slow = (0..SLOW_ANGLES).map(|i| SLOWEST_ANGLE_RAD * decades.powi(i as i32));
    let count = EVEN_ANGLES * (1 + around.delay_samples.ceil() as usize);
    let step = (std::f64::consts::PI - EVEN_FROM_RAD) / (count - 1) as f64;
    let even = (0..count).map(|i| EVEN_FROM_RAD + step * i as f64);
    let t = 1.0 / around.rate_hz;
    let scale = t / (2.0 * b);
    // The lag rate is per sample.
    let rate = t / lag_s;
    let velocity = around.estimator.response(around.rate_hz);
    let condition_at = |theta: f64| {
        let (turn, centre) =
            (Complex::from_polar(1.0, theta), integrator_response(theta, rate, around.delay_samples) * scale);
        let hold = (1.0 - turn.conj()).norm();
        let lost: f64 = (-ALIASES..=ALIASES)
            .map(|k| {
                let angle = theta + std::f64::consts::TAU * f64::from(k);
                (1.0 - 1.0 / (angle / rate).hypot(1.0)) / (angle * angle)
            })
            .sum();
        let radius = scale * hold * (1.0 / (hold * hold) - lost);
        ConditionTerms { centre, spread: (radius * radius - centre.norm_sqr()).max(0.0), velocity: velocity(theta) / t }
    };
    slow.chain(even).map(condition_at).collect()
}

/// Returns the sampled motion of an integrator for a held, delayed and lagging force; `rate` is per sample.
fn integrator_response(theta: f64, rate: f64, delay_samples: f64) -> Complex<f64> {
    let turn = Complex::from_polar(1.0, theta);
    let (whole, late) = (delay_samples.floor(), delay_samples.fract());
    // Returns the remaining share of the difference between force and command after `part` of a sample, and its motion.
    let over = |part: f64| match part > 0.0 {
        true => ((-rate * part).exp(), -(-rate * part).exp_m1() / rate),
        false => (1.0, 0.0),
    };
    let ((kept, early), (left, rest)) = (over(late), over(1.0 - late));
    // The previous command acts until `late`, then the command of this sample.
    let before = turn.conj();
    let force = (before * (1.0 - kept) * left + (1.0 - left)) / (turn - kept * left);
    let moved = force * (early + kept * rest) + before * (late - early + (1.0 - kept) * rest) + (1.0 - late - rest);
    moved / (turn - 1.0) * Complex::from_polar(1.0, -theta * whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::estimator::LinearEstimator;
    use haptic_host::device_file::DeviceFile;

    fn control_loop(delay_samples: f64, drive: Drive) -> Loop {
        let estimator = LinearEstimator::BackwardDifference;
        Loop { rate_hz: 1e3, delay_samples, estimator, drive, damping_compensation: false }
    }

    fn paddle(around: &Loop) -> Passivity {
        let file = DeviceFile::parse(
            "name = \"p\"\nmechanism = \"paddle\"\ngravity = [0.0]\n[geometry]\nlength = 0.1\n[[joint]]\ninertia = 1e-3\n\
             viscous = 2e-3\ncoulomb = 5e-3\n[joint.encoder]\ncounts_per_turn = 62831.853071795864\n\
             offset = 0.0\ninverted = false\n",
            "p.toml",
        )
        .unwrap();
        let device = Linearised::at(&file.description, &[0.0], &[1.0]).unwrap();
        Passivity::new(&device, &file.description, around).unwrap()
    }

    #[test]
    fn a_paddle_has_the_textbook_bounds() {
        let bounds = paddle(&control_loop(0.0, Drive::Ideal));
        // b = 2e-3/0.1² = 0.2 N s/m, fc = 0.05 N, Δ = 0.1 · 1e-4 m.
        assert!((bounds.largest_stiffness(0.05) - 300.0).abs() < 1e-6);
        assert_eq!(bounds.largest_stiffness(0.3), 0.0);
        assert!((bounds.largest_damping() - 0.2).abs() < 1e-9);
        // 2 fc/Δ = 1e4 N/m is above 2b/T = 400 N/m.
        assert!((bounds.largest_undamped_stiffness().unwrap() - 400.0).abs() < 1e-6);
        // One sample of delay triples T/2.
        assert!((paddle(&control_loop(1.0, Drive::Ideal)).largest_stiffness(0.0) - 400.0 / 3.0).abs() < 1e-5);
    }

    #[test]
    fn lag_and_fractional_delay_cost_more_than_their_time() {
        let limit = |delay: f64, drive: Drive| paddle(&control_loop(delay, drive)).largest_stiffness(0.0);
        // For slow motions the limit is b/(T (1/2 + d) + lag). Aliases reduce it further.
        let slow = |delay: f64, lag_s: f64| 0.2 / (1e-3 * (0.5 + delay) + lag_s);
        let half = limit(0.5, Drive::Ideal) / slow(0.5, 0.0);
        assert!((0.94..0.95).contains(&half), "1 - x - x²/16 = 0 at x = 0.944: {half}");
        for (delay, bandwidth_hz) in [(0.0, 500.0), (0.025, 6400.0), (1.3, 100.0)] {
            let lag_s = 1.0 / (std::f64::consts::TAU * bandwidth_hz);
            let share = limit(delay, Drive::Current { bandwidth_hz }) / slow(delay, lag_s);
            assert!((0.9..1.0 + 1e-6).contains(&share), "{delay} {bandwidth_hz}: {share}");
        }
        let ideal = limit(0.3, Drive::Ideal);
        assert!((limit(0.3, Drive::Current { bandwidth_hz: 1e9 }) / ideal - 1.0).abs() < 1e-3);
    }

    /// Returns true if a wall is passive by Colgate and Schenkel's original condition on a fine grid.
    fn is_passive(b: f64, kp: f64, kd: f64, t: f64, delay: f64) -> bool {
        (1..4000).all(|i| {
            let theta = std::f64::consts::PI * f64::from(i) / 4000.0;
            let turned = |steps: f64| Complex::from_polar(1.0, -steps * theta);
            let back = 1.0 - turned(1.0);
            let real = (back * turned(delay) * (kp + back * kd / t)).re;
            b > t / 2.0 * real / (1.0 - theta.cos())
        })
    }

    #[test]
    fn the_bound_equals_the_full_condition_at_every_delay() {
        let (b, t) = (0.2, 1e-3);
        for delay in [0.0, 1.0, 2.0, 5.0] {
            let bounds = paddle(&control_loop(delay, Drive::Ideal));
            for kd in [0.0, 0.05, 0.1, 0.19] {
                let limit = bounds.largest_stiffness(kd);
                assert!(
                    is_passive(b, 0.999 * limit, kd, t, delay) && !is_passive(b, 1.001 * limit, kd, t, delay),
                    "{delay}"
                );
            }
        }
    }
}
