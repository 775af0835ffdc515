//! The polarity check: before a real device may be armed, a small torque must move each joint the right way, and then swing
//! it as its device file says.
//!
//! A joint that moved the right way is swung about the place where it stood, by a torque that alternates a few times a
//! second (docs/safety.md, "What the polarity check measures"). Of angles, currents and voltages only what alternates with
//! it is summed up, so that drifts, zeros of sensors and constant loads drop out. The part of the motion that is in phase
//! with the torque is what inertia makes of it: friction moves in the other. So M q̈, with the file's M and the encoders' q,
//! is the torque that really acted; over the one that the measured current and the file's torque constant make, it is 1
//! where torque constant, gear ratio, current sensor, counts per turn and inertia belong together. What voltage takes the
//! current is the winding's resistance, whatever the sensor's scale is.

use super::ControlLoop;
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::control::saturation::share_within;
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, limited, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::{Fault, State};
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;

/// Largest share of a motor's torque that the polarity check applies.
pub const POLARITY_SHARE: f32 = 0.25;
/// Joint motion that decides the polarity check, rad: backward it is wrong; forward a quarter of it is enough to swing the
/// joint, and at least so many counts, because a joint that is still being pushed gathers speed.
pub const POLARITY_MOTION: f32 = 0.02;
const FORWARD_MOTION: f32 = 0.25 * POLARITY_MOTION;
const FORWARD_COUNTS: f32 = 1.5;
/// Time the polarity check takes to reach its torque, s; it gives up after twice this.
pub const POLARITY_SECONDS: f32 = 1.0;
/// Longest time that the check waits for a joint to come to rest before its turn, s. What the joint before has thrown
/// about, or a hand moves, says nothing of this one's motor; a device almost without friction glides for seconds.
pub const POLARITY_PATIENCE: f32 = 5.0;

/// Time between two steps of the check, s, at least: a control step that takes a scene's forces and the check's sums too is
/// long, and what is looked at takes milliseconds.
const CHECK_PERIOD: f32 = 1.0e-4;

/// A joint is at rest for it that stays within so much (rad) for so long (s). A speed would not do: between two counts of
/// a coarse encoder, and where a joint turns back, it is nothing.
const REST_MOTION: f32 = 0.1 * POLARITY_MOTION;
const REST_SECONDS: f32 = 0.2;

/// By what factor the torque that acted may differ from the one of the file, either way: what a sound device of an honest
/// file is measured to within.
pub const TORQUE_DOUBT: f32 = 1.2;
/// Share of the torque that moves one joint by which another one's may seem to be driven, too.
pub const CROSS_DOUBT: f32 = 0.5;
/// Share of the file's resistance by which the winding's may differ: copper gains 40 % per 100 K.
pub const RESISTANCE_DOUBT: f32 = 0.35;
/// Share of the voltage that the dead time takes by which that may be off once it has been made up for.
const DEAD_TIME_DOUBT: f32 = 0.5;

/// Largest share of a motor's torque that swings a joint.
const SWING_SHARE: f32 = 0.5;
/// Ratio of a swing's torque to the torque that moved the joint: so large that friction does not hold it at either end.
const SWING_EXCESS: f32 = 2.5;
/// By how much a joint is swung to either side, rad, and at least how many counts.
const SWING_ANGLE: f32 = 0.02;
const SWING_COUNTS: f32 = 4.0;
/// By how many times that it may be found away from where it stood: hapkit-paddle glides into its swing and gets to 1.6.
const SWING_TRAVEL: f32 = 4.0;
/// Largest error of each joint's home, rad, with which the check still keeps to the limit of the force at the tip; and
/// the least share of what the believed pose allows that this leaves, because near a stretched pose it would be
/// nothing.
const HOME_DOUBT: f32 = 0.15;
const DOUBTED_SHARE: f32 = 0.3;
/// Angular frequencies of a swing, rad/s: above those of a device that is carried by a spring, and below those of cables.
const SWING_RATES: (f32, f32) = (20.0, 200.0);
/// Largest share of the speed limit that a swing reaches, and at least how many control steps one takes.
const SWING_SPEED: f32 = 0.5;
const SWING_STEPS: f32 = 16.0;
/// Swings before what they do is summed up, and while it is.
const SWINGS_BEFORE: f32 = 1.0;
const SWINGS: f32 = 5.0;

/// A quantity that alternates with the torque of a swing: its part in phase, and its part a quarter of a swing later.
type Phasor = [f32; 2];

/// A joint that is swung.
#[derive(Clone, Copy, Debug, Default)]
struct Swing {
    /// Torque, N m, and angular frequency, rad/s.
    torque: f32,
    rate: f32,
    /// Largest distance from where it stood at which it may be found, rad.
    reach: f32,
    /// Stiffness that draws the joint back to where it stood, N m/rad, and damping that brakes it, N m s/rad.
    stiffness: f32,
    damping: f32,
    /// Since when, s.
    seconds: f32,
    /// The angles about which it swings, rad: all joints.
    about: [f32; MAX_JOINTS],
    /// The sums so far: angles (rad), the torque of the current (N m), the current (A) and the voltage (V).
    angles: [Phasor; MAX_JOINTS],
    driven: Phasor,
    current: Phasor,
    voltage: Phasor,
}

/// Progress of the polarity check.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PolarityCheck {
    pub(super) axis: usize,
    /// Its second part, once the joint has moved the right way.
    swing: Option<Swing>,
    seconds: f32,
    /// For how long the joint was waited for to come to rest, s.
    waited: f32,
    /// The angle at which it rests, rad, and for how long it has, s.
    rests_at: f32,
    rested: f32,
    /// The joint's angle at its first step, rad.
    from: Option<f32>,
    /// Number of the poses about it that were looked at, and the share of the largest torque that they allow.
    looked: u32,
    allowed: f32,
    /// The mass matrix where it swings, kg m², once that is known.
    inertia: Option<[[f32; MAX_JOINTS]; MAX_JOINTS]>,
    /// Time between two steps of the check, s, control steps until the next, and what the motors are told until then.
    pace: f32,
    left: u32,
    /// The next one waits for a crest without a control step.
    due: bool,
    /// The current (A) and the voltage (V) of the joint's motor at the last control step.
    current: f32,
    voltage: f32,
    told: Torques,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    pub(super) fn start_polarity_check(&mut self) -> Result<(), Refusal> {
        self.ready()?;
        self.find_stray()?;
        self.polarity = PolarityCheck::default();
        self.polarity_known = false;
        self.restart_checks();
        self.state = State::CheckingPolarity;
        Ok(())
    }

    /// The motors' torques in a control step of the check, which at high rates is not due in each.
    pub(super) fn check_polarity(&mut self) -> Torques {
        let (motors, i) = (&self.now.motors, self.polarity.axis.min(MAX_JOINTS - 1));
        (self.polarity.current, self.polarity.voltage) = (motors.current[i], motors.duty[i] * motors.bus_voltage);
        match self.polarity.left.checked_sub(1) {
            Some(left) => self.polarity.left = left,
            None if self.has_free_crests() => self.polarity.due = true,
            None => self.go_on_checking(),
        }
        self.polarity.told
    }

    /// Takes the step of the check that waits for a crest like this, without a control step: together they may be too long
    /// for one.
    pub(super) fn check_at_free_crest(&mut self) {
        if self.polarity.due && self.state == State::CheckingPolarity {
            self.go_on_checking();
            if self.state == State::CheckingPolarity {
                let told = self.polarity.told;
                self.command_test(&told);
            }
        }
    }

    /// Returns true if there are crests without a control step.
    fn has_free_crests(&self) -> bool {
        self.crests.period < 0.75 * self.period
    }

    fn go_on_checking(&mut self) {
        let steps = ((CHECK_PERIOD / self.period) as u32).max(1);
        self.polarity.due = false;
        (self.polarity.left, self.polarity.pace) = (steps - 1, steps as f32 * self.period);
        self.polarity.told = self.check_step();
    }

    /// One step of the check: the torques that the motors are told; zero while it waits and when it has ended.
    #[cold]
    #[inline(never)]
    fn check_step(&mut self) -> Torques {
        let none = Torques::default();
        let i = self.polarity.axis.min(MAX_JOINTS - 1);
        if self.polarity.swing.is_some() {
            return self.swing(i);
        }
        if self.polarity.from.is_none() && !(self.at_rest(i) && self.has_looked_around(i)) {
            if self.polarity.waited >= POLARITY_PATIENCE {
                self.trip(Fault::PolarityUnrest, Some(i as u8), self.now.found.at.q[i] - self.polarity.rests_at);
            }
            return none;
        }
        let most = self.joints[i].stage.max_torque();
        let moved = self.now.found.at.q[i] - *self.polarity.from.get_or_insert(self.now.found.at.q[i]);
        let count = self.program.as_ref().map_or(0.0, |program| program.radians_per_count[i].abs());
        if moved > FORWARD_MOTION.max(FORWARD_COUNTS * count) || self.polarity.inertia.is_some() {
            // A step of its own for each of both, because steps at high rates have little time.
            match self.polarity.inertia {
                Some(inertia) => self.begin_swing(i, &inertia),
                None => self.find_inertia(i),
            }
            return none;
        }
        if moved < -POLARITY_MOTION {
            self.trip(Fault::PolarityWrong, Some(i as u8), moved);
            return none;
        }
        self.polarity.seconds += self.polarity.pace;
        if self.polarity.seconds > 2.0 * POLARITY_SECONDS {
            self.trip(Fault::PolarityNoMotion, Some(i as u8), moved);
            return none;
        }
        let share = POLARITY_SHARE * (self.polarity.seconds * (1.0 / POLARITY_SECONDS)).min(1.0);
        self.within_tip_force(i, share * most)
    }

    /// Looks at one of the poses at which the device may stand in truth, for what they allow joint `i` to push with; whether
    /// it has looked at all. Between those corners leverage is less: it grows towards singular poses.
    fn has_looked_around(&mut self, i: usize) -> bool {
        let Some(program) = self.program.as_ref() else { return false };
        let (corner, tip_force) = (self.polarity.looked, self.rules.limits.tip_force);
        let mut largest = Torques::default();
        largest[i] = self.joints[i].stage.max_torque();
        let off = |j: usize| if corner >> j & 1 == 0 { HOME_DOUBT } else { -HOME_DOUBT };
        let leverage = program.mechanism.leverage::<K>(&core::array::from_fn(|j| self.now.found.at.q[j] + off(j)));
        let there = share_within(leverage.force_squared(&largest), tip_force);
        let here = share_within(self.leverage.force_squared(&largest), tip_force);
        let before = if corner == 0 { 1.0 } else { self.polarity.allowed };
        self.polarity.allowed = before.min(there).max(DOUBTED_SHARE * here);
        self.polarity.looked = corner + 1;
        self.polarity.looked >= 1 << self.count
    }

    /// A torque (N m) of joint `i` alone, as far as the limit of the force at the tip allows it here and around.
    fn within_tip_force(&self, i: usize, wanted: f32) -> Torques {
        let most = self.polarity.allowed * self.joints[i].stage.max_torque();
        let mut torque = Torques::default();
        torque[i] = limited(wanted, most.min(self.max_joint_torque[i]));
        torque[i] *= share_within(self.leverage.force_squared(&torque), self.rules.limits.tip_force);
        torque
    }

    /// Goes on with the next joint after joint `i`, or ends the check well.
    fn pass_on(&mut self, i: usize) {
        if i + 1 >= self.count() {
            self.off();
            self.state = State::Disarmed;
            self.know_polarity();
        } else {
            let next = (i + 1).min(MAX_JOINTS - 1);
            self.polarity = PolarityCheck { axis: next, ..PolarityCheck::default() };
        }
    }

    /// The polarity is known, at the present home where there is one.
    pub(super) fn know_polarity(&mut self) {
        self.polarity_known = true;
        if let Some(program) = self.program.as_ref().filter(|_| self.homed) {
            self.checked_zero = program.controller.zero();
        }
    }

    /// The device was homed: what was found stays known where home is still within what the joints were swung by there,
    /// because the mass matrix of that pose made a torque of their motion.
    pub(super) fn keep_polarity_near_its_home(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        let zero = program.controller.zero();
        self.polarity_known &= program.radians_per_count.iter().enumerate().take(program.joints).all(|(i, radians)| {
            let off = zero[i].wrapping_sub(self.checked_zero[i]) as f32 * radians;
            off.abs() <= swing_angle(*radians)
        });
    }

    /// The angles of the joints about which joint `i` swings, rad.
    fn swung_about(&self, i: usize) -> [f32; MAX_JOINTS] {
        let mut about = self.now.found.at.q;
        about[i] = self.polarity.from.unwrap_or(about[i]);
        about
    }

    /// Works out the mass matrix there.
    fn find_inertia(&mut self, i: usize) {
        let about = self.swung_about(i);
        self.polarity.inertia = self.program.as_ref().map(|program| program.mechanism.inertia::<K>(&about));
    }

    /// Joint `i` moved the right way: chooses how to swing it.
    fn begin_swing(&mut self, i: usize, inertia: &[[f32; MAX_JOINTS]; MAX_JOINTS]) {
        let Some(program) = self.program.as_ref() else { return };
        let inertia = inertia[i][i].max(f32::MIN_POSITIVE);
        let angle = swing_angle(program.radians_per_count[i]);
        let largest = self.joints[i].stage.max_torque();
        let moved_it = POLARITY_SHARE * (self.polarity.seconds * (1.0 / POLARITY_SECONDS)).min(1.0) * largest;
        let excess = SWING_EXCESS * moved_it;
        // The faster, the more current: that shows the winding, and friction less.
        let wanted = self.within_tip_force(i, excess.max(POLARITY_SHARE * largest).min(SWING_SHARE * largest))[i];
        let fastest = SWING_RATES
            .1
            .min(SWING_SPEED * self.rules.limits.speed[i] / angle)
            .min(core::f32::consts::TAU / (SWING_STEPS * self.polarity.pace));
        let rate = sqrt(wanted / (inertia * angle)).min(fastest).max(SWING_RATES.0);
        let torque = wanted.min(excess.max(inertia * angle * rate * rate));
        let about = self.swung_about(i);
        // A quarter as fast as it is swung, and hardly ringing.
        let back = 0.25 * rate;
        let (stiffness, damping) = (inertia * back * back, 1.4 * inertia * back);
        let reach = SWING_TRAVEL * angle;
        self.polarity.swing = Some(Swing { torque, rate, reach, stiffness, damping, about, ..Swing::default() });
    }

    /// One step of the second part: the torque that swings joint `i`, with what the last step's was worth summed up.
    fn swing(&mut self, i: usize) -> Torques {
        let Some(mut swing) = self.polarity.swing else { return Torques::default() };
        let strayed = self.now.found.at.q[i] - swing.about[i];
        if margin_bits(strayed, swing.reach) < 0 {
            self.trip(Fault::TorqueMismatch, Some(i as u8), SWING_TRAVEL * strayed / swing.reach);
            return Torques::default();
        }
        let turn = core::f32::consts::TAU / swing.rate;
        let summed = (swing.seconds - SWINGS_BEFORE * turn) / (SWINGS * turn);
        if summed >= 1.0 {
            self.check_swings(i, &swing);
            return Torques::default();
        }
        let (sine, cosine) = K::sin_cos(swing.rate * (swing.seconds % turn));
        if summed > 0.0 {
            // Weighed so that what changes slowly drops out.
            let weight = 1.0 - K::sin_cos(core::f32::consts::TAU * summed).1;
            let (now, stage) = (&self.now, &self.joints[i].stage);
            let (current, voltage) = (self.polarity.current, self.polarity.voltage);
            let add = |sum: &mut Phasor, value: f32| {
                sum[0] += weight * cosine * value;
                sum[1] += weight * sine * value;
            };
            for ((sum, q), about) in swing.angles.iter_mut().zip(now.found.at.q).zip(swing.about) {
                add(sum, q - about);
            }
            add(&mut swing.driven, stage.torque_of(current));
            add(&mut swing.current, current);
            add(&mut swing.voltage, voltage);
        }
        swing.seconds += self.polarity.pace;
        self.polarity.swing = Some(swing);
        let back = -swing.stiffness * strayed - swing.damping * self.joints[i].speed();
        let most = SWING_SHARE * self.joints[i].stage.max_torque();
        self.within_tip_force(i, limited(swing.torque * cosine + back, most))
    }

    /// The swings of joint `i` are over: whether they were what the device file says.
    fn check_swings(&mut self, i: usize, swing: &Swing) {
        let Some(program) = self.program.as_ref() else { return };
        let inertia = self.polarity.inertia.unwrap_or_default();
        let rate = -swing.rate * swing.rate;
        // The torque of the joints' accelerations.
        let acted = inertia.map(|row| {
            let parts = row.iter().zip(&swing.angles);
            parts.fold([0.0; 2], |sum: Phasor, (inertia, angle)| {
                [sum[0] + rate * inertia * angle[0], sum[1] + rate * inertia * angle[1]]
            })
        });
        // A current that is sampled just before it changes is that of the middle of the step before.
        let (sine, cosine) = K::sin_cos(0.5 * self.polarity.pace * swing.rate);
        let [along, across] = swing.driven;
        let driven = [along * cosine + across * sine, across * cosine - along * sine];
        // Of the torque that it made the part in phase with it: friction is in phase with the speed.
        let found = dot(acted[i], acted[i]) / dot(acted[i], driven).max(f32::MIN_POSITIVE);
        let share = |row: &Phasor| dot(*row, driven) / dot(driven, driven).max(f32::MIN_POSITIVE);
        let mut others = acted.iter().map(share).enumerate().take(self.count()).filter(|(row, _)| *row != i);
        let astray = others.find(|(_, aside)| margin_bits(*aside, CROSS_DOUBT) < 0);
        let (bridge, stage) = (&self.hardware.bridge, &self.joints[i].stage);
        let measured = (bridge.current_sensed && self.hardware.bus_sensed)
            .then(|| stage.resistance_of(swing.voltage, swing.current, swing.angles[i], swing.rate))
            .flatten();
        let dead = DEAD_TIME_DOUBT * 2.0 * bridge.dead_time * program.carrier_hz * self.now.motors.bus_voltage;
        // The first harmonic of what alternates with the current, over the sums' weight of it.
        let amperes = sqrt(dot(swing.current, swing.current)) * self.polarity.pace * swing.rate
            / (core::f32::consts::PI * SWINGS);
        let doubt = 4.0 / core::f32::consts::PI * dead / amperes;
        if !(1.0 / TORQUE_DOUBT..=TORQUE_DOUBT).contains(&found) {
            self.trip(Fault::TorqueMismatch, Some(i as u8), found);
        } else if let Some((row, aside)) = astray {
            self.trip(Fault::TorqueMismatch, Some(row as u8), aside);
        } else if let Some((found, expected)) = measured
            && margin_bits(found - expected, RESISTANCE_DOUBT * expected + doubt) < 0
        {
            self.trip(Fault::ResistanceMismatch, Some(i as u8), found);
        } else {
            self.pass_on(i);
        }
    }

    /// Returns true if joint `i` has come to rest.
    fn at_rest(&mut self, i: usize) -> bool {
        let (polarity, q) = (&mut self.polarity, self.now.found.at.q[i]);
        polarity.waited += polarity.pace;
        polarity.rested += polarity.pace;
        if (q - polarity.rests_at).abs() > REST_MOTION {
            (polarity.rests_at, polarity.rested) = (q, 0.0);
        }
        polarity.rested >= REST_SECONDS
    }
}

/// By how much a joint with this count (rad) is swung to either side, rad.
fn swing_angle(radians_per_count: f32) -> f32 {
    SWING_ANGLE.max(SWING_COUNTS * radians_per_count.abs())
}

/// The scalar product of two phasors.
fn dot(one: Phasor, other: Phasor) -> f32 {
    one[0] * other[0] + one[1] * other[1]
}
