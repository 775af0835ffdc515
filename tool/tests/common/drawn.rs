//! Random devices, similar to the shipped ones: some correct, some with a wrong file, wrong wires or wrong sensors.

use super::forces::pick_one;
use super::injected::{CheckMotion, measure_any_check, scale_motor_constants};
use super::shipped_device;
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::{
    Cogging, CoggingHarmonic, Description, Stribeck, StructuralMode, Transmission,
};
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::safety::fault::FaultRecord;
use haptic_sim::{BoardFaults, Random};
use std::f64::consts::TAU;

/// Returns a random number between two limits, log-uniformly distributed.
fn log_uniform(draw: &mut Random, low: f64, high: f64) -> f64 {
    (draw.between(low.ln(), high.ln())).exp()
}

/// Shipped devices of which others are drawn. The figures of docs/safety.md depend on this list.
const DRAWN_DEVICES: [&str; 10] = [
    "cable-five-bar",
    "capstan-pantograph",
    "coupled-five-bar",
    "fictive-five-bar-turret",
    "hapkit-paddle",
    "haply-2diy",
    "pantograph-mk2",
    "phantom-premium-1.5",
    "serial-3r",
    "woodenhaptics",
];

/// Returns a shipped device with random size, motors, encoders, friction, gears, cables and modes.
pub fn correct_device(draw: &mut Random) -> (String, Description) {
    let file = shipped_device(DRAWN_DEVICES[(draw.uniform() * DRAWN_DEVICES.len() as f64) as usize]);
    let (mut device, joints) = (file.description, file.spec().joints);
    let (size, weight) = (draw.between(0.7, 1.5), log_uniform(draw, 0.5, 2.0));
    // The last entry is not a length but the sign of the assembly.
    device.geometry.iter_mut().filter(|length| length.abs() < 1.0).for_each(|length| *length *= size);
    for link in &mut device.links {
        link.com *= size;
        link.mass *= weight;
        for inertia in [&mut link.inertia, &mut link.inertia_axial, &mut link.inertia_transverse] {
            *inertia *= weight * size * size;
        }
    }
    device.handle_mass *= weight;
    let (geared, cabled) = (draw.uniform() < 0.4, draw.uniform() < 0.4);
    let (sticky, cogs, swings) = (draw.uniform() < 0.3, draw.uniform() < 0.2, draw.uniform() < 0.2);
    for joint in device.joints.iter_mut().take(joints) {
        joint.transmission = None;
        // The gear is limited so that the torque constant is at most 2 N m/A.
        let max_gear = 2.0 / joint.motor.map_or(2.0, |motor| motor.torque_constant);
        let gear = if geared { draw.between(2.0, 8.0).min(max_gear) } else { 1.0 };
        joint.inertia *= log_uniform(draw, 1.0, gear * gear);
        joint.coulomb *= log_uniform(draw, 0.4, 2.5) * gear.sqrt();
        joint.viscous *= log_uniform(draw, 0.4, 2.5) * gear;
        joint.encoder.as_mut().unwrap().counts_per_turn = log_uniform(draw, 500.0, 1.0e5).round();
        let motor = joint.motor.as_mut().unwrap();
        motor.torque_constant *= gear;
        motor.back_emf *= gear;
        motor.resistance *= log_uniform(draw, 0.5, 4.0);
        motor.inductance = motor.resistance * log_uniform(draw, 0.2e-3, 1.0e-3);
        motor.max_current *= draw.between(0.5, 1.0);
        joint.friction = sticky.then(|| Stribeck {
            rest: joint.coulomb * draw.between(1.0, 1.8),
            stribeck_speed: log_uniform(draw, 0.02, 0.2),
        });
        joint.cogging = cogs.then(|| {
            let amplitude = joint.coulomb * draw.between(0.1, 0.6);
            let per_turn = gear.round() * pick_one(draw, &[14.0, 24.0, 48.0]);
            let mut cogging = Cogging::default();
            cogging.harmonics[0] = CoggingHarmonic { amplitude, per_turn, phase: 0.0 };
            cogging
        });
    }
    let home = device.home.unwrap().map(|angle| angle as f32);
    let inertia = AnyMechanism::<f32>::new(&device).unwrap().inertia::<Libm>(&home);
    for (i, joint) in device.joints.iter_mut().enumerate().take(joints) {
        let about = f64::from(inertia[i][i]);
        if cabled {
            let motor_inertia = joint.inertia * draw.between(0.4, 0.9);
            let link = about - motor_inertia;
            let rate = TAU * log_uniform(draw, 25.0, 500.0);
            joint.transmission = Some(Transmission {
                stiffness: link * rate * rate,
                damping: 2.0 * draw.between(0.02, 0.1) * link * rate,
                motor_inertia,
                encoder_at: Default::default(),
            });
        }
        if swings {
            joint.modes[0] = Some(StructuralMode {
                frequency: log_uniform(draw, 30.0, 300.0),
                damping: draw.between(0.01, 0.1),
                inertia: about * draw.between(0.02, 0.2),
            });
        }
    }
    (file.name.clone(), device)
}

/// Difference of a random device from its file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mismatch {
    Nothing,
    /// Ratio of the true torque constant and back-EMF to the file's, for the first joint.
    Constant(f64),
    /// Ratio of the true torque constants and back-EMFs to the file's, for all joints.
    Constants(f64),
    /// Ratio of a gear that the file omits in torque constants, back-EMFs and inertias.
    Gear(f64),
    /// Share of the true current that the first current sensor measures.
    Sensor(f64),
    /// Share of the true currents that all current sensors measure.
    Sensors(f64),
    /// Offset of the first current sensor, A.
    Zero(f64),
    EncoderDead,
    EncodersSwapped,
    MotorsSwapped,
}

impl Mismatch {
    pub fn random(draw: &mut Random) -> Self {
        let factor = log_uniform(draw, 1.25, 12.0);
        match (draw.uniform() * 10.0) as u32 {
            0 | 1 => Self::Constant(factor),
            2 => Self::Constants(factor),
            3 => Self::Gear(draw.between(2.0, 7.8)),
            4 => Self::Sensor(1.0 / draw.between(1.25, 4.0)),
            5 => Self::Sensors(1.0 / draw.between(1.25, 4.0)),
            6 => Self::Zero(draw.between(-0.8, 0.8)),
            7 => Self::EncoderDead,
            8 => Self::EncodersSwapped,
            _ => Self::MotorsSwapped,
        }
    }

    fn inject(self, wired: &mut Description, broken: &mut BoardFaults) {
        match self {
            Self::Nothing => {}
            Self::Constant(factor) => scale_motor_constants(&mut wired.joints[..1], factor),
            Self::Constants(factor) => scale_motor_constants(&mut wired.joints, factor),
            Self::Gear(gear) => {
                scale_motor_constants(&mut wired.joints, gear);
                for joint in &mut wired.joints {
                    joint.inertia *= gear * gear;
                    joint.transmission.iter_mut().for_each(|it| it.motor_inertia *= gear * gear);
                }
            }
            Self::Sensor(gain) => broken.sensor_gain[0] = gain,
            Self::Sensors(gain) => broken.sensor_gain = [gain; 4],
            Self::Zero(amperes) => broken.sensor_offset[0] = amperes,
            Self::EncoderDead => broken.share[0] = Some((0, 0.0)),
            Self::EncodersSwapped => broken.swapped_at = Some([0; 2]),
            Self::MotorsSwapped => broken.motors.swap(0, 1),
        }
    }
}

/// Result of one polarity check of a random device.
#[derive(Debug)]
pub struct CheckResult {
    pub seed: u64,
    pub device: String,
    pub mismatch: Mismatch,
    pub result: Result<(), FaultRecord>,
    pub motion: CheckMotion,
}

impl std::fmt::Display for CheckResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { seed, device, mismatch, result, motion } = self;
        let result = result.map_err(|record| (record.fault, record.axis, record.value));
        write!(f, "{seed} {device} {mismatch:?}: {:.2} N, {:.3} rad, {result:?}", motion.push, motion.travel)
    }
}

/// Checks the polarity of a random device whose file is correct.
pub fn check_correct_device(seed: u64) -> CheckResult {
    let mut draw = Random::new(seed);
    let (device, description) = correct_device(&mut draw);
    check(seed, device, &description, Mismatch::Nothing)
}

/// Checks the polarity of a device that differs from its file. Half of the seeds have a shipped device.
pub fn check_mismatched_device(seed: u64) -> CheckResult {
    let mut draw = Random::new(seed);
    let mismatch = Mismatch::random(&mut draw);
    let (mut device, mut description) = correct_device(&mut draw);
    if draw.uniform() < 0.5 {
        description = shipped_device(&device).description;
    }
    // A paddle has only one motor, so nothing can be swapped.
    if matches!(mismatch, Mismatch::EncodersSwapped | Mismatch::MotorsSwapped) && description.kind.spec().joints < 2 {
        (device, description) = ("pantograph-mk2".into(), shipped_device("pantograph-mk2").description);
    }
    check(seed, device, &description, mismatch)
}

fn check(seed: u64, device: String, description: &Description, mismatch: Mismatch) -> CheckResult {
    let (result, motion) = measure_any_check(&device, description, |wired, broken| mismatch.inject(wired, broken));
    CheckResult { seed, device, mismatch, result, motion }
}
