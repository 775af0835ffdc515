//! Deviations of a device from its file: loops that must be stable, and devices on which the ripple limit must hold.
//!
//! A torque constant that is larger than in the file acts like a device that is lighter by the same factor and a
//! controller that does not know it. Smaller masses act the same way. Errors of the mass distribution, with some links
//! and rotors too heavy and others too light, change Weff and spoil the feed-forward, which uses the file. Each such
//! error is applied in the direction that reduces the effective inertia. All margins act together at both ends: light
//! and strong, heavy and weak.
//!
//! A hand stabilises a wall whose controller does not use the device's inertia. For a controller with feed-forward the
//! hand's mass is a model error, so the device of the file must also be stable in hands ([`HANDS`]).

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_host::error::Failure;
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::analysis::sampled::{CARRIER_HZ, Loop};
use serde::Serialize;

/// Hands in which a wall must be stable: two fingers and a firm grip.
pub const HANDS: [Hand; 2] =
    [Hand { mass: 0.05, damping: 3.0, stiffness: 200.0 }, Hand { mass: 0.3, damping: 10.0, stiffness: 1000.0 }];

/// Deviations of the device from its file that a wall must tolerate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Margins {
    /// Factor by which the motors may be stronger or weaker; 1 is no margin.
    pub gain: f64,
    /// Delay in addition to the board's own delay, s.
    pub delay_s: f64,
    /// Relative error of the complete device's mass, in both directions.
    pub mass: f64,
    /// Relative error of each link and rotor, in the less favourable direction.
    pub inertia: f64,
    /// Relative error of viscous and dry friction, in both directions.
    pub friction: f64,
    /// Relative error of the encoder counts per turn, in both directions.
    pub counts: f64,
    /// True if the wall must also be stable in `HANDS`.
    pub hand: bool,
}

impl Default for Margins {
    /// Returns margins for a torque constant from a data sheet (±10 %) that varies with the magnet's temperature
    /// (another ±10 %), half a carrier period of delay, computed instead of weighed masses, friction that varies with
    /// temperature and grease, and a cable radius measured at the pulley.
    fn default() -> Self {
        Self { gain: 1.25, delay_s: 25.0e-6, mass: 0.1, inertia: 0.1, friction: 0.25, counts: 0.03, hand: true }
    }
}

/// A device, the controller's model of the device, and an additional delay of the torque.
#[derive(Clone, Debug)]
pub(super) struct Corner {
    pub device: Linearised,
    pub model: Linearised,
    delay_s: f64,
}

impl Corner {
    /// Returns the loop with this corner's delay. In a hand damping compensation is negligible and left out.
    pub fn adjusted_loop(&self, around: &Loop) -> Loop {
        Loop {
            delay_samples: around.delay_samples + self.delay_s * around.rate_hz,
            damping_compensation: around.damping_compensation && !self.device.flexible.hand.is_there(),
            ..around.clone()
        }
    }
}

/// Returns the effective inertia along the device's direction for joint torques in proportion to `torque` (m), kg.
fn inertia_along(device: &Linearised, torque: &nalgebra::DVector<f64>) -> f64 {
    let per_newton = device.mass.clone().cholesky().map(|mass| device.row.dot(&mass.solve(torque)));
    per_newton.map_or(f64::INFINITY, |per_newton| 1.0 / per_newton)
}

/// Scales the mass of one part of a description. The parts are the links, the rotors and the handle, in this order.
fn scale_part(description: &Description, part: usize, factor: f64) -> Description {
    let spec = description.kind.spec();
    let mut other = *description;
    let links = spec.links.len();
    if part < links {
        let link = &mut other.links[part];
        link.mass *= factor;
        link.inertia *= factor;
        link.inertia_axial *= factor;
        link.inertia_transverse *= factor;
    } else if part < links + spec.joints {
        let joint = &mut other.joints[part - links];
        joint.inertia *= factor;
        if let Some(transmission) = &mut joint.transmission {
            transmission.motor_inertia *= factor;
        }
    } else {
        other.handle_mass *= factor;
    }
    other
}

/// Returns the description with each link, each rotor and the handle changed by `share`. Each change reduces (or, if
/// `heavier`, increases) the effective inertia of a wall along `normal` with a controller that uses the file.
pub fn extreme_device(
    description: &Description,
    q: &[f64],
    normal: &[f64],
    admissible: Admissible,
    shaped: bool,
    share: f64,
    heavier: bool,
) -> Result<Description, PoseError> {
    let model = Linearised::holding(description, q, normal, admissible)?;
    let torque = if shaped { model.shaped_torque() } else { model.row.clone() };
    let nominal = inertia_along(&model, &torque);
    let spec = description.kind.spec();
    let mut result = *description;
    for part in 0..spec.links.len() + spec.joints + 1 {
        let more = inertia_along(
            &Linearised::holding(&scale_part(description, part, 1.0 + 1e-4), q, normal, admissible)?,
            &torque,
        );
        let grows = (more > nominal) == heavier;
        result = scale_part(&result, part, if grows { 1.0 + share } else { 1.0 - share });
    }
    Ok(result)
}

impl Margins {
    /// Margins for a device that equals its file.
    pub const NONE: Self =
        Self { gain: 1.0, delay_s: 0.0, mass: 0.0, inertia: 0.0, friction: 0.0, counts: 0.0, hand: false };

    /// Rejects values out of range.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let share = |share: f64| (0.0..0.9).contains(&share);
        let is_valid = (1.0..=10.0).contains(&self.gain) && (0.0..=0.01).contains(&self.delay_s);
        if is_valid && [self.mass, self.inertia, self.friction, self.counts].into_iter().all(share) {
            return Ok(());
        }
        Err(Failure::wrong(format!("margins out of range: {self:?}"))
            .remedy("write a gain from 1 to 10, a delay up to 0.01 s, and errors from 0 to 0.9"))
    }

    /// Returns the devices on which a wall must meet its ripple limit: a light device with little friction and coarse
    /// counts, on which most walls ripple most; the device of the file; and the opposite of the light device. Each is a
    /// pair of the board's model, which knows the counts but not mass and friction, and the real device.
    pub(super) fn deviations(self, description: &Description) -> Vec<(Description, Description)> {
        let Self { mass, friction, counts, .. } = self;
        let deviation = |sign: f64| {
            let mut model = *description;
            let incremental = model.joints.iter_mut().filter(|joint| joint.absolute.is_none());
            for encoder in incremental.filter_map(|joint| joint.encoder.as_mut()) {
                encoder.counts_per_turn *= 1.0 + sign * counts;
            }
            let parts = description.kind.spec().links.len() + description.kind.spec().joints + 1;
            let mut moving = (0..parts).fold(model, |moving, part| scale_part(&moving, part, 1.0 + sign * mass));
            for joint in &mut moving.joints {
                joint.viscous *= 1.0 + sign * friction;
                joint.coulomb *= 1.0 + sign * friction;
                if let Some(rest) = joint.friction.as_mut() {
                    rest.rest *= 1.0 + sign * friction;
                }
            }
            (model, moving)
        };
        let signs: &[f64] = if [mass, friction, counts] == [0.0; 3] { &[0.0] } else { &[-1.0, 0.0, 1.0] };
        signs.iter().map(|sign| deviation(*sign)).collect()
    }

    /// Returns named margins: none, each margin without the others, and all together.
    pub(super) fn named_margins(self) -> [(&'static str, Self); 7] {
        let Self { gain, delay_s, mass, inertia, hand, .. } = self;
        [
            ("stability, no margin", Self::NONE),
            ("gain margin", Self { gain, ..Self::NONE }),
            ("delay margin", Self { delay_s, ..Self::NONE }),
            ("mass error", Self { mass, ..Self::NONE }),
            ("inertia errors", Self { inertia, ..Self::NONE }),
            ("in a hand", Self { hand, ..Self::NONE }),
            ("all margins together", self),
        ]
    }

    /// Returns the devices on which a wall must be stable: light and strong, then heavy and weak, then in hands.
    pub(super) fn corners(
        self,
        description: &Description,
        q: &[f64],
        normal: &[f64],
        admissible: Admissible,
        shaped: bool,
    ) -> Result<Vec<Corner>, Failure> {
        let model = Linearised::holding(description, q, normal, admissible)?;
        let ages = description.joints.iter().filter_map(|joint| joint.absolute).map(|sensor| sensor.age(CARRIER_HZ));
        let delay_s = self.delay_s + ages.fold(0.0, f64::max);
        let corner = |heavier: bool| -> Result<Corner, Failure> {
            let other = extreme_device(description, q, normal, admissible, shaped, self.inertia, heavier)?;
            let mut device = Linearised::holding(&other, q, normal, admissible)?;
            let gain = if heavier { self.gain } else { 1.0 / self.gain };
            let mass = if heavier { 1.0 + self.mass } else { 1.0 - self.mass };
            device.mass *= gain * mass;
            device.viscous *= gain;
            for transmission in device.flexible.transmissions.iter_mut().flatten() {
                transmission.stiffness *= gain;
                transmission.damping *= gain;
                transmission.motor_inertia *= gain * mass;
            }
            let mut model = model.clone();
            // Damping has no margin because no wall tolerates compensation that exceeds the real damping.
            model.viscous.clone_from(&device.viscous);
            Ok(Corner { device, model, delay_s })
        };
        let mut corners = vec![corner(false)?];
        if (Self { delay_s: 0.0, friction: 0.0, counts: 0.0, hand: false, ..self }) != Self::NONE {
            corners.push(corner(true)?);
        }
        let hands = if self.hand { HANDS.as_slice() } else { &[] };
        corners.extend(hands.iter().map(|hand| Corner {
            device: model.clone().with_hand(*hand),
            model: model.clone(),
            delay_s,
        }));
        Ok(corners)
    }
}
