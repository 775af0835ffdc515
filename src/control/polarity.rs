//! The polarity check: before a real device may be armed, each motor must swing its joint as the device file says.
//!
//! The check believes only what it has measured. A torque that alternates a few times a second grows from a twentieth of a
//! newton at the tip until something moves, and on until the joint swings by a degree. So what moves is never pushed
//! harder than its own inertia and friction need, whatever the file says; a joint that cannot be seen swings about its
//! place instead of running away. If the torque that acted is roughly the file's, a second swing measures it well
//! (docs/safety.md, "What is measured before a board arms").
//!
//! Of angles, currents and voltages only what alternates with the torque is summed up, so that drifts, zeros of sensors
//! and constant loads drop out. The part of the motion that is in phase with the torque is what inertia makes of it:
//! friction moves in the other. So M q̈, with the file's M and the encoders' q, is the torque that really acted; over the
//! one that the measured current and the file's torque constant make, it is 1 where torque constant, gear ratio, current
//! sensor, counts per turn and inertia belong together. The voltage that the current takes shows the winding's
//! resistance, whatever the sensor's scale is.

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

/// Longest time that the check waits for a joint to come to rest before its turn, s. What the joint before has thrown
/// about, or a hand moves, says nothing of this one's motor; a device almost without friction glides for seconds.
pub const POLARITY_PATIENCE: f32 = 5.0;

/// Time between two steps of the check, s, at least: a control step that takes a scene's forces and the check's sums too is
/// long, and what is looked at takes milliseconds.
const CHECK_PERIOD: f32 = 1.0e-4;

/// A joint is at rest for it that stays within so much (rad) for so long (s). A speed would not do: between two counts of
/// a coarse encoder, and where a joint turns back, it is nothing.
const REST_MOTION: f32 = 2.0e-3;
const REST_SECONDS: f32 = 0.2;

/// Least and largest torque that acted over the one of the file: what a sound device of an honest file is measured to
/// within. Friction that sticks makes it less, and a device that is weaker than its file pushes less than it may.
const TORQUE_DOUBT: (f32, f32) = (1.0 / 1.4, 1.2);
/// The same of the first swing, for a second, harder one to follow.
const FIRST_DOUBT: (f32, f32) = (0.5, 1.6);
/// Share of the torque that moves one joint by which another one's may seem to be driven, too.
pub const CROSS_DOUBT: f32 = 0.5;
/// Share of the file's resistance by which the winding's may differ: copper gains 40 % per 100 K.
pub const RESISTANCE_DOUBT: f32 = 0.35;
/// Share of the file's resistance that the dead time may hide where the measured one is believed from then on.
const CLEAR_DOUBT: f32 = 0.1;
/// Share of the voltage that the dead time takes by which that may be off once it has been made up for.
const DEAD_TIME_DOUBT: f32 = 0.5;

/// Forces at the tip by the file, N: that of the first torque, half a newton if every constant is ten times wrong; that
/// which inertia takes in the first swing; and that up to which an unmoved joint is pushed whose friction the file omits.
const LEAST_FORCE: f32 = 0.05;
const FIRST_FORCE: f32 = 0.2;
const UNSEEN_FORCE: f32 = 0.8;
/// By how much the file's Coulomb friction may be exceeded at rest.
const FRICTION_DOUBT: f32 = 3.0;
/// Largest shares of the tip's limit and of the motor's torque that inertia takes in the second swing.
const SECOND_SHARE: f32 = 0.6;
const SECOND_TORQUE: f32 = 0.25;
/// Share of what inertia takes by the file that a swing's torque may exceed what moved the joint by.
const SWING_EXCESS: f32 = 1.2;
/// Ratio of the second swing's torque to the torque that moved the joint.
const FRICTION_EXCESS: f32 = 2.5;
/// Motion that is seen, rad, and at least so many counts.
const SEEN_ANGLE: f32 = 1.5e-3;
const SEEN_COUNTS: f32 = 1.5;
/// By how much a joint is swung to either side, rad, and at least how many counts.
const SWING_ANGLE: f32 = 0.02;
const SWING_COUNTS: f32 = 4.0;
/// Farthest that any joint may be found from where it stood, rad, and at least how many counts.
const STRAY_ANGLE: f32 = 0.1;
/// The same of the other joints in the second swing.
const SWUNG_ANGLE: f32 = 0.14;
const STRAY_COUNTS: f32 = 8.0;
/// Largest error of each joint's home, rad, with which the check still keeps to its forces at the tip; and the least share
/// of what the believed pose allows that this leaves, because near a stretched pose it would be nothing.
const HOME_DOUBT: f32 = 0.15;
const DOUBTED_SHARE: f32 = 0.4;
/// Angular frequencies of a swing, rad/s: above those of a device that hangs from a thread, and a third of that of a soft
/// cable.
const SWING_RATES: (f32, f32) = (8.0, 50.0);
/// The same where friction takes more than inertia.
const FASTEST_SWING: f32 = 200.0;
/// Back-EMF that a motor may make within the first counts of its joint, V: less than what makes an encoder suspicious.
const HIDDEN_VOLTS: f32 = 0.8;
/// Largest share of the speed limit that a swing reaches, and at least how many control steps one takes.
const SWING_SPEED: f32 = 0.5;
const SWING_STEPS: f32 = 16.0;
/// Swings in which the torque grows by a factor of e; those before what they do is summed up, and while it is.
const SWINGS_GROWING: f32 = 1.5;
const SWINGS_BEFORE: f32 = 2.0;
const SWINGS: f32 = 3.0;
/// Those in which the torque fades, so that the joint does not glide on.
const SWINGS_FADING: f32 = 2.0;

/// A quantity that alternates with the torque of a swing: its part in phase, and its part a quarter of a swing later.
type Phasor = [f32; 2];

/// A joint that is swung.
#[derive(Clone, Copy, Debug, Default)]
struct Swing {
    /// True for one that follows a first; and for one that only shows the winding.
    last: bool,
    winding: bool,
    /// Torque now, and the most that it grows to, N m; and angular frequency, rad/s.
    torque: f32,
    most: f32,
    rate: f32,
    /// The torque at which motion was first seen, N m.
    moved_by: Option<f32>,
    /// Angle to either side at which the torque grows no more, rad; and the ends of the joints' motion in this turn, rad.
    angle: f32,
    ends: [(f32, f32); MAX_JOINTS],
    /// True if the torque grows no more.
    full: bool,
    /// Stiffness that draws the joint back to where it stood, N m/rad, and damping that brakes it, N m s/rad.
    stiffness: f32,
    damping: f32,
    /// Work that the torque told has done on the joint, J, and where that was last, rad: a motor that turns the wrong way
    /// does less than none.
    work: f32,
    was: f32,
    /// Time in this turn, s, and whole turns with the same torque.
    seconds: f32,
    turns: f32,
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
    swing: Option<Swing>,
    /// For how long the joint was waited for to come to rest, s.
    waited: f32,
    /// The least and the largest angle that it was at while it rested, rad, and for how long it has, s.
    rests_at: (f32, f32),
    rested: f32,
    /// The angles of all joints where they stood, rad.
    from: Option<[f32; MAX_JOINTS]>,
    /// Number of the poses about it that were looked at, and the most that they make of 1 N m at the tip, N.
    looked: u32,
    worth: f32,
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
        let q = self.now.found.at.q;
        let from = *self.polarity.from.get_or_insert(q);
        let moved: [f32; MAX_JOINTS] = core::array::from_fn(|j| q[j] - from[j]);
        let Some(counts) = self.program.as_ref().map(|program| program.radians_per_count) else { return none };
        let swung = self.polarity.swing.is_some_and(|swing| swing.last);
        let farthest = |j: usize| if swung && j != i { SWUNG_ANGLE } else { STRAY_ANGLE };
        let beyond = |j: &usize| margin_bits(moved[*j], farthest(*j).max(STRAY_COUNTS * counts[*j].abs())) < 0;
        if let Some(j) = (0..self.count().min(MAX_JOINTS)).find(beyond) {
            match self.polarity.swing {
                Some(swing) if j == i && swing.work < 0.0 => {
                    self.trip(Fault::PolarityWrong, Some(j as u8), moved[j] / swing.angle);
                }
                Some(swing) => self.trip(Fault::TorqueMismatch, Some(j as u8), moved[j] / swing.angle),
                None => self.trip(Fault::PolarityUnrest, Some(j as u8), moved[j]),
            }
            return none;
        }
        // Steps at high rates have little time: each of these takes one of its own.
        match (self.polarity.swing, self.polarity.inertia) {
            (Some(swing), _) => return self.swing(i, swing, &moved, &counts),
            (None, Some(inertia)) => self.begin_first(i, inertia[i][i]),
            (None, None) if self.at_rest(i) => {
                if self.polarity.looked < 1 << self.count {
                    self.look_around(i);
                    return none;
                }
                self.polarity.from = Some(q);
                self.polarity.inertia = self.program.as_ref().map(|program| program.mechanism.inertia::<K>(&q));
            }
            (None, None) if self.polarity.waited >= POLARITY_PATIENCE => {
                self.trip(Fault::PolarityUnrest, Some(i as u8), q[i] - self.polarity.rests_at.0);
            }
            (None, None) => {}
        }
        none
    }

    /// Looks at the next of the poses at which the device may stand in truth, for what a torque of joint `i` is worth at the
    /// tip there. Between those corners leverage is less: it grows towards singular poses.
    fn look_around(&mut self, i: usize) {
        let i = i.min(MAX_JOINTS - 1);
        let Some(program) = self.program.as_ref() else { return };
        let corner = self.polarity.looked;
        let mut unit = Torques::default();
        unit[i] = 1.0;
        let off = |j: usize| if corner >> j & 1 == 0 { HOME_DOUBT } else { -HOME_DOUBT };
        let leverage = program.mechanism.leverage::<K>(&core::array::from_fn(|j| self.now.found.at.q[j] + off(j)));
        let [there, here] = [&leverage, &self.leverage].map(|leverage| sqrt(leverage.force_squared(&unit)));
        // `min` also drops NaN, of a pose that there is not.
        self.polarity.worth = self.polarity.worth.max(there.max(here).min(here / DOUBTED_SHARE));
        self.polarity.looked = corner + 1;
    }

    /// A torque (N m) of joint `i` alone, as far as the limit of the force at the tip allows it here and around.
    fn within_tip_force(&self, i: usize, wanted: f32) -> Torques {
        let i = i.min(MAX_JOINTS - 1);
        let tip_force = self.rules.limits.tip_force;
        let most = (tip_force / self.polarity.worth).min(self.joints[i].stage.max_torque());
        let mut torque = Torques::default();
        torque[i] = limited(wanted, most.min(self.max_joint_torque[i]));
        torque[i] *= share_within(self.leverage.force_squared(&torque), tip_force);
        torque
    }

    /// Goes on with the next joint after joint `i`, or ends the check well.
    fn pass_on(&mut self, i: usize) {
        let i = i.min(MAX_JOINTS - 1);
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

    /// Chooses the first swing of joint `i`, whose inertia by the file is `inertia` (kg m²).
    fn begin_first(&mut self, i: usize, inertia: f32) {
        let i = i.min(MAX_JOINTS - 1);
        let Some(program) = self.program.as_ref() else { return };
        let (worth, friction) = (self.polarity.worth, program.coulomb[i].abs());
        let angle = swing_angle(program.radians_per_count[i]);
        let rate = self.swing_rate(i, FIRST_FORCE / worth, inertia * angle, angle, SWING_RATES.1);
        let inert = inertia * angle * rate * rate;
        // An unseen joint of such inertia swings by a few angles at most.
        let unstated = (UNSEEN_FORCE / worth).min(friction + 2.0 * inert);
        let most = (inert + FRICTION_DOUBT * friction).max(unstated);
        let torque = (LEAST_FORCE / worth).min(0.25 * inert);
        let (stiffness, damping) = spring(inertia, 0.4 * rate);
        self.polarity.swing = Some(Swing { torque, most, rate, angle, stiffness, damping, ..Swing::default() });
    }

    /// The swing of joint `i` after one that was about as the file says; `None` if it would not be harder. One that only
    /// shows the winding is faster than what cables allow the others, because that takes more current.
    fn next_swing(&self, i: usize, before: &Swing, winding: bool) -> Option<Swing> {
        let i = i.min(MAX_JOINTS - 1);
        let inertia = self.polarity.inertia.map_or(0.0, |inertia| inertia[i][i]);
        let angle = before.angle;
        let most = (SECOND_SHARE * self.rules.limits.tip_force / self.polarity.worth)
            .min(SECOND_TORQUE * self.joints[i].stage.max_torque());
        let fastest = if winding { FASTEST_SWING } else { SWING_RATES.1 };
        let rate = self.swing_rate(i, most, inertia * angle, angle, fastest);
        let inert = (inertia * angle * rate * rate).min(most);
        // Friction does not hold it at either end.
        let held = FRICTION_EXCESS * before.moved_by.unwrap_or(0.0);
        let most = if winding { inert } else { inert.max(held) };
        let (stiffness, damping) = spring(inertia, 0.25 * rate);
        let torque = 0.25 * before.torque.min(inert);
        let known = Swing { last: true, winding, moved_by: Some(torque), angle, ..Swing::default() };
        (most > 1.2 * before.torque).then_some(Swing { torque, most, rate, stiffness, damping, ..known })
    }

    /// The angular frequency (rad/s) at which a torque (N m), or the friction if that is more, swings joint `i` by an angle
    /// (rad), of so much inertia times that angle, no faster than `most` unless friction asks for it.
    fn swing_rate(&self, i: usize, torque: f32, inertia_angle: f32, angle: f32, most: f32) -> f32 {
        let i = i.min(MAX_JOINTS - 1);
        let Some(program) = self.program.as_ref() else { return SWING_RATES.0 };
        let of = |torque: f32| sqrt(torque / inertia_angle.max(f32::MIN_POSITIVE));
        // Where friction takes more than inertia, it would hide that.
        let wanted = of(torque).min(most).max(of(1.5 * program.coulomb[i].abs()).min(FASTEST_SWING));
        let between_counts = SWING_COUNTS * program.radians_per_count[i].abs();
        let fastest = (SWING_SPEED * self.rules.limits.speed[i] / angle)
            .min(self.joints[i].stage.turning(HIDDEN_VOLTS).abs() / between_counts)
            .min(core::f32::consts::TAU / (SWING_STEPS * self.polarity.pace));
        wanted.min(fastest).max(SWING_RATES.0)
    }

    /// One step of a swing: the torque that swings joint `i`, with what the last step's was worth summed up. `moved`: how
    /// far all joints are from where they stood, rad.
    fn swing(&mut self, i: usize, mut swing: Swing, moved: &[f32; MAX_JOINTS], counts: &[f32; MAX_JOINTS]) -> Torques {
        let i = i.min(MAX_JOINTS - 1);
        let turn = core::f32::consts::TAU / swing.rate;
        if swing.seconds >= turn {
            // Where a turn begins, a joint that swings stands still.
            swing.seconds -= turn;
            swing.turns += if swing.full { 1.0 } else { 0.0 };
            swing.ends = moved.map(|moved| (moved, moved));
        }
        if swing.turns >= SWINGS_BEFORE + SWINGS + SWINGS_FADING {
            self.check_swings(i, &swing);
            return Torques::default();
        }
        let summed = (swing.turns + swing.seconds / turn - SWINGS_BEFORE) / SWINGS;
        let (sine, cosine) = K::sin_cos(swing.rate * swing.seconds);
        if summed > 0.0 && summed < 1.0 {
            // Weighed so that what changes slowly drops out.
            let weight = 1.0 - K::sin_cos(core::f32::consts::TAU * summed).1;
            let stage = &self.joints[i].stage;
            let (current, voltage) = (self.polarity.current, self.polarity.voltage);
            let add = |sum: &mut Phasor, value: f32| {
                sum[0] += weight * cosine * value;
                sum[1] += weight * sine * value;
            };
            for (sum, moved) in swing.angles.iter_mut().zip(moved) {
                add(sum, *moved);
            }
            add(&mut swing.driven, stage.torque_of(current));
            add(&mut swing.current, current);
            add(&mut swing.voltage, voltage);
        }
        swing.seconds += self.polarity.pace;
        if swing.moved_by.is_none() && moved[i].abs() > SEEN_ANGLE.max(SEEN_COUNTS * counts[i].abs()) {
            // From here on nothing needs more than what moved it, and what inertia takes by the file.
            swing.moved_by = Some(swing.torque);
            let inertia = self.polarity.inertia.map_or(0.0, |inertia| inertia[i][i]);
            let inert = inertia * swing.angle * swing.rate * swing.rate;
            swing.most = swing.torque + SWING_EXCESS * inert;
            (swing.full, swing.turns) = (false, 0.0);
        }
        for ((low, high), moved) in swing.ends.iter_mut().zip(moved) {
            (*low, *high) = (low.min(*moved), high.max(*moved));
        }
        let most = |j: usize| if swing.last && j == i { 4.0 } else { 2.0 } * swing.angle;
        let far = |j: usize| swing.ends[j].1 - swing.ends[j].0 >= most(j);
        swing.work += self.polarity.told[i] * (moved[i] - swing.was);
        swing.was = moved[i];
        if !swing.full {
            swing.torque = (swing.torque * (1.0 + self.polarity.pace / (SWINGS_GROWING * turn))).min(swing.most);
            swing.full = swing.torque >= swing.most || (0..self.count().min(MAX_JOINTS)).any(far);
        } else if swing.moved_by.is_none() && swing.turns > 1.0 {
            self.trip(Fault::PolarityNoMotion, Some(i as u8), moved[i]);
            return Torques::default();
        }
        self.polarity.swing = Some(swing);
        let back = -swing.stiffness * moved[i] - swing.damping * self.joints[i].speed();
        let fading = (1.0 - (summed - 1.0) * (SWINGS / SWINGS_FADING)).clamp(0.0, 1.0);
        self.within_tip_force(i, limited(fading * swing.torque * cosine + back, swing.most))
    }

    /// The swings of joint `i` are over: whether they were what the device file says.
    fn check_swings(&mut self, i: usize, swing: &Swing) {
        let i = i.min(MAX_JOINTS - 1);
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
        let found = dot(acted[i], acted[i]) / dot(acted[i], driven);
        let share = |row: &Phasor| dot(*row, driven) / dot(driven, driven).max(f32::MIN_POSITIVE);
        let mut others = acted.iter().map(share).enumerate().take(self.count()).filter(|(row, _)| *row != i);
        // What friction in the other joint takes is no motor's.
        let size = sqrt(dot(driven, driven)) * self.polarity.pace * swing.rate / (core::f32::consts::PI * SWINGS);
        let held = |row: usize| 1.5 * program.coulomb[row].abs() / size.max(f32::MIN_POSITIVE);
        let astray = others.find(|(row, aside)| margin_bits(*aside, CROSS_DOUBT + held(*row)) < 0);
        let (bridge, stage) = (&self.hardware.bridge, &self.joints[i].stage);
        let measured = (bridge.current_sensed && self.hardware.bus_sensed)
            .then(|| stage.resistance_of(swing.voltage, swing.current, swing.angles[i], swing.rate))
            .flatten();
        let dead = DEAD_TIME_DOUBT * 2.0 * bridge.dead_time * program.carrier_hz * self.now.motors.bus_voltage;
        // The first harmonic of what alternates with the current, over the sums' weight of it.
        let amperes = sqrt(dot(swing.current, swing.current)) * self.polarity.pace * swing.rate
            / (core::f32::consts::PI * SWINGS);
        let doubt = 4.0 / core::f32::consts::PI * dead / amperes;
        let strange =
            measured.filter(|(found, expected)| margin_bits(found - expected, RESISTANCE_DOUBT * expected + doubt) < 0);
        let clear = measured.filter(|(_, expected)| doubt < CLEAR_DOUBT * expected);
        let second = if swing.last { None } else { self.next_swing(i, swing, false) };
        let unclear = measured.is_some() && clear.is_none() && !swing.winding;
        let third = if unclear && second.is_none() { self.next_swing(i, swing, true) } else { None };
        let torque_doubt = if second.is_some() { FIRST_DOUBT } else { TORQUE_DOUBT };
        if !swing.winding && found < -FIRST_DOUBT.0 {
            self.trip(Fault::PolarityWrong, Some(i as u8), found);
        } else if !swing.winding && !(torque_doubt.0..=torque_doubt.1).contains(&found) {
            self.trip(Fault::TorqueMismatch, Some(i as u8), found);
        } else if second.is_some() {
            self.polarity.swing = second;
        } else if !swing.winding
            && let Some((row, aside)) = astray
        {
            self.trip(Fault::TorqueMismatch, Some(row as u8), aside);
        } else if let Some((found, _)) = strange {
            self.trip(Fault::ResistanceMismatch, Some(i as u8), found);
        } else if third.is_some() {
            self.polarity.swing = third;
        } else {
            if let Some((found, expected)) = clear {
                self.joints[i].stage.set_measured_resistance(found.max((1.0 - RESISTANCE_DOUBT) * expected));
            }
            self.pass_on(i);
        }
    }

    /// Returns true if joint `i` has come to rest.
    fn at_rest(&mut self, i: usize) -> bool {
        let i = i.min(MAX_JOINTS - 1);
        let (polarity, q) = (&mut self.polarity, self.now.found.at.q[i]);
        polarity.waited += polarity.pace;
        polarity.rested += polarity.pace;
        // Both ends: a joint that comes back while a hand leads it away is no nearer to rest.
        let (low, high) = (polarity.rests_at.0.min(q), polarity.rests_at.1.max(q));
        (polarity.rests_at, polarity.rested) = match high - low <= REST_MOTION {
            true => ((low, high), polarity.rested),
            false => ((q, q), 0.0),
        };
        polarity.rested >= REST_SECONDS
    }
}

/// By how much a joint with this count (rad) is swung to either side, rad.
fn swing_angle(radians_per_count: f32) -> f32 {
    SWING_ANGLE.max(SWING_COUNTS * radians_per_count.abs())
}

/// Stiffness (N m/rad) and damping (N m s/rad) that draw a joint of so much inertia (kg m²) back to where it stood, so
/// fast (rad/s) and hardly ringing.
fn spring(inertia: f32, back: f32) -> (f32, f32) {
    (inertia * back * back, 1.4 * inertia * back)
}

/// The scalar product of two phasors.
fn dot(one: Phasor, other: Phasor) -> f32 {
    one[0] * other[0] + one[1] * other[1]
}
