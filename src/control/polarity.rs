//! The polarity check: before a real device may be armed, each motor must swing its joint as the device file says.
//!
//! The check uses only measured quantities. A torque that alternates a few times a second grows from a twentieth of a
//! newton at the tip until something moves, and further until the joint swings by a degree. So no joint is pushed
//! harder than its inertia and friction need, whatever the file says, and a joint with a dead encoder swings about its
//! place instead of running away. If the torque that acted is roughly the file's, a second swing measures it well
//! (docs/safety.md, "What is measured before a board arms").
//!
//! The other joints are free, so a light link swings along. The torque's growth changes only where the torque is zero:
//! anywhere else the change would leave a free joint with a constant speed, and it would drift away.
//!
//! Only the parts of angles, currents and voltages that alternate with the torque are summed up, so drifts, sensor
//! offsets and constant loads cancel. The motion in phase with the torque is due to inertia; friction moves a quarter
//! period later. So M q̈, with the file's M and the encoders' q, is the torque that acted. Its ratio to the torque of
//! the measured current and the file's torque constant is 1 if torque constant, gear ratio, current sensor, counts per
//! turn and inertia agree. The voltage of the current shows the winding's resistance, whatever the sensor's scale is.

use super::ControlLoop;
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::control::saturation::share_within;
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, Real, limited, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::{Fault, State};
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;

/// Longest time that the check waits for a joint to come to rest before its turn, s: motion left by the previous joint,
/// or caused by a hand, says nothing about this motor. A device almost without friction glides for seconds.
pub const POLARITY_PATIENCE: f32 = 5.0;

/// Shortest time between two steps of the check, s: a control step that computes a scene's forces and the check's sums
/// is long, and the motion takes milliseconds.
const CHECK_PERIOD: f32 = 1.0e-4;

/// A joint is at rest if it stays within this angle (rad) for this time (s). A speed is no measure of rest: it is zero
/// between two counts of a coarse encoder, and where a joint turns back.
const REST_MOTION: f32 = 2.0e-3;
const REST_SECONDS: f32 = 0.2;

/// Lowest and highest accepted ratio of the torque that acted to the file's: the range measured on sound devices.
/// Friction that sticks lowers it, and a device weaker than its file pushes less than it may.
const TORQUE_DOUBT: (f32, f32) = (1.0 / 1.4, 1.2);
/// The same range of the first swing; within it, a second and harder swing follows.
const FIRST_DOUBT: (f32, f32) = (0.5, 1.6);
/// Largest torque that may appear in a joint without a command, as a share of the driven joint's torque.
pub const CROSS_DOUBT: f32 = 0.5;
/// Largest difference of the winding's resistance, as a share of the file's: copper gains 40 % per 100 K.
pub const RESISTANCE_DOUBT: f32 = 0.35;
/// Largest share of the file's resistance that the dead time may hide if the measured resistance is to be used.
const CLEAR_DOUBT: f32 = 0.1;
/// Error of the voltage that the dead time takes, after compensation, as a share of that voltage.
const DEAD_TIME_DOUBT: f32 = 0.5;

/// Forces at the tip by the file, N: of the first torque, half a newton if every constant is ten times wrong; of
/// inertia in the first swing; and the largest on an unmoved joint whose friction the file omits.
const LEAST_FORCE: f32 = 0.05;
const FIRST_FORCE: f32 = 0.2;
const UNSEEN_FORCE: f32 = 0.8;
/// Largest ratio of the friction at rest to the file's Coulomb friction.
const FRICTION_DOUBT: f32 = 3.0;
/// Largest shares of the tip's limit and of the motor's torque for inertia in the second swing.
const SECOND_SHARE: f32 = 0.6;
const SECOND_TORQUE: f32 = 0.25;
/// Largest torque beyond the one that moved the joint, as a ratio to the file's torque for inertia.
const SWING_EXCESS: f32 = 1.2;
/// Ratio of the second swing's torque to the torque that moved the joint.
const FRICTION_EXCESS: f32 = 2.5;
/// Smallest effective inertia, as a share of the joint's own inertia.
const LEAST_EFFECTIVE: f32 = 1.0e-3;
/// Smallest motion that is seen, rad and counts.
const SEEN_ANGLE: f32 = 1.5e-3;
const SEEN_COUNTS: f32 = 1.5;
/// Smallest swing to either side, rad and counts.
const SWING_ANGLE: f32 = 0.02;
const SWING_COUNTS: f32 = 4.0;
/// Largest distance of any joint from where it stood, rad, and at least this many counts.
const STRAY_ANGLE: f32 = 0.1;
const STRAY_COUNTS: f32 = 8.0;
/// Largest distance of the other joints during a swing, rad.
const SWUNG_ANGLE: f32 = 0.14;
/// Largest error of each joint's home, rad, at which the check still keeps its forces at the tip; and the smallest
/// share of the torque allowed at the assumed pose that remains, because near a stretched pose none would.
const HOME_DOUBT: f32 = 0.15;
const DOUBTED_SHARE: f32 = 0.4;
/// Angular frequencies of a swing, rad/s: above that of a device that hangs from a thread, up to a third of a soft
/// cable's.
const SWING_RATES: (f32, f32) = (8.0, 50.0);
/// Highest angular frequency if friction takes more than inertia, rad/s.
const FASTEST_SWING: f32 = 200.0;
/// Largest back-EMF within the first counts of a joint, V: less than the one that makes an encoder suspicious.
const HIDDEN_VOLTS: f32 = 0.8;
/// Largest share of the speed limit in a swing, and fewest control steps of a swing.
const SWING_SPEED: f32 = 0.5;
const SWING_STEPS: f32 = 16.0;
/// Largest ratio by which the torque grows in a turn, and the ratio below which it stops growing.
const GROWTH: f32 = 1.95;
const LEAST_GROWTH: f32 = 1.1;
/// Largest ratio by which a swing becomes faster after a turn that swung a joint too far.
const FASTER: f32 = 1.5;
/// Shares of the largest swing: the growth's aim, and the one at which the growth stops at once.
const AIM: f32 = 0.8;
const FAR: f32 = 1.25;
/// Phase of zero torque at which the growth changes, turns.
const ZERO_TORQUE: f32 = 0.75;
/// Turns at the full torque before the sums, during the sums, and while the torque fades so that no joint glides on. It
/// fades a quarter turn after the sums, where the torque is zero.
const SWINGS_BEFORE: f32 = 2.0;
const SWINGS: f32 = 3.0;
const SWINGS_FADING: f32 = 2.0;
const BEFORE_FADING: f32 = 0.25;

/// A quantity that alternates with the torque of a swing: its part in phase, and its part a quarter turn later.
type Phasor = [f32; 2];

/// The swing of a joint. A turn is one period of it.
#[derive(Clone, Copy, Debug, Default)]
struct Swing {
    /// True for a swing that follows a first one.
    last: bool,
    /// True for a swing that only measures the winding.
    winding: bool,
    /// Present amplitude of the torque and its largest value, N m.
    torque: f32,
    most: f32,
    /// Growth of the torque, N m/s.
    growth: f32,
    /// Angular frequency, rad/s.
    rate: f32,
    /// Torque at which motion was first seen, N m.
    moved_by: Option<f32>,
    /// Angle to either side at which the torque stops growing, rad; and the ends of the joints' motion in this turn,
    /// rad.
    angle: f32,
    ends: [(f32, f32); MAX_JOINTS],
    /// True if the torque has stopped growing.
    full: bool,
    /// Stiffness that pulls the joint back to where it stood, N m/rad, and damping, N m s/rad.
    stiffness: f32,
    damping: f32,
    /// Mean of the joint's distance from where it stood over about a sixth of a turn, rad.
    mean: f32,
    /// Work of the commanded torque on the joint, J, negative if the motor turns the wrong way; and the joint's last
    /// distance from where it stood, rad.
    work: f32,
    was: f32,
    /// Time in this turn, s, at first of a complete turn; and number of turns with the full torque.
    seconds: f32,
    turns: f32,
    /// Sums of angles (rad), torque of the current (N m), current (A) and voltage (V).
    angles: [Phasor; MAX_JOINTS],
    driven: Phasor,
    current: Phasor,
    voltage: Phasor,
}

impl Swing {
    /// Returns the largest motion of one of the `joints` in this turn, as a share of the motion at which the torque of
    /// joint `axis` stops growing.
    #[inline(always)]
    fn swung(&self, axis: usize, joints: usize) -> f32 {
        let mut most = 0.0;
        for (j, (low, high)) in self.ends.iter().enumerate().take(joints) {
            let share = (high - low) / (if self.last && j == axis { 4.0 } else { 2.0 } * self.angle);
            most = share.greater(most);
        }
        most
    }
}

/// Results of a finished swing.
#[derive(Clone, Copy, Debug, Default)]
struct Results {
    /// Ratio of the torque that acted to the file's.
    found: f32,
    /// Joint in which too much torque appeared without a command, and that torque as a share of the driven joint's.
    astray: Option<(usize, f32)>,
    /// Measured resistance that differs too much from the file's, Ω.
    strange: Option<f32>,
    /// Measured and expected resistance (Ω) if the dead time hides little of it; and true if it hides much.
    clear: Option<(f32, f32)>,
    unclear: bool,
}

/// Progress of the polarity check.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PolarityCheck {
    /// Number of the joint under test.
    axis: usize,
    swing: Option<Swing>,
    /// Time spent waiting for the joint to come to rest, s.
    waited: f32,
    /// Lowest and highest angle of the joint at rest, rad, and its time at rest, s.
    rests_at: (f32, f32),
    rested: f32,
    /// Angles of all joints where they stood, rad.
    from: Option<[f32; MAX_JOINTS]>,
    /// Number of neighbouring poses that were checked, and their largest tip force for 1 N m of the joint, N.
    poses: u32,
    worth: f32,
    /// Mass matrix where the joint swings, kg m², once it is known; and the ratio of the joint's torque to the largest
    /// acceleration that it makes in any joint, kg m².
    inertia: Option<[[f32; MAX_JOINTS]; MAX_JOINTS]>,
    effective: f32,
    /// Time between two steps of the check, s, and control steps until the next one.
    pace: f32,
    left: u32,
    /// True if the next step waits for the valley.
    due: bool,
    /// Number of the part of the comparison that the next step takes; 0 while the joint swings.
    part: u8,
    results: Results,
    /// Angles of all joints (rad), and current (A) and voltage (V) of the joint's motor, at the control step before.
    q: [f32; MAX_JOINTS],
    current: f32,
    voltage: f32,
    /// Torques that the motors are commanded until the next step.
    commanded: Torques,
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

    /// Samples the joints if a step of the check is due, and returns the motors' torques. The rest of that step follows
    /// at the valley, because a crest has no time for it at high rates.
    pub(super) fn check_polarity(&mut self) -> Torques {
        if let Some(left) = self.polarity.left.checked_sub(1) {
            self.polarity.left = left;
            return self.polarity.commanded;
        }
        let steps = ((CHECK_PERIOD / self.period + 0.5) as u32).max(1);
        let (motors, i) = (&self.now.motors, self.axis());
        let polarity = &mut self.polarity;
        (polarity.left, polarity.pace) = (steps - 1, steps as f32 * self.period);
        (polarity.current, polarity.voltage) = (motors.current[i], motors.duty[i] * motors.bus_voltage);
        polarity.q = self.now.found.at.q;
        polarity.due = true;
        polarity.commanded
    }

    /// Takes the rest of a due step of the check. Returns false if none is due.
    #[inline(always)]
    pub(super) fn check_at_valley(&mut self) -> bool {
        let due = self.state == State::CheckingPolarity && self.polarity.due;
        if due {
            self.go_on_checking();
        }
        due
    }

    /// The joint under test, always a valid index.
    fn axis(&self) -> usize {
        self.polarity.axis.min(MAX_JOINTS - 1)
    }

    #[cold]
    #[inline(never)]
    fn go_on_checking(&mut self) {
        self.polarity.due = false;
        let torque = self.check_step();
        self.polarity.commanded = torque;
        if self.state == State::CheckingPolarity {
            self.command_test(&torque);
        }
    }

    /// Takes a step of the check and returns the motors' torques: zero while it waits and when it has ended.
    fn check_step(&mut self) -> Torques {
        let none = Torques::default();
        let i = self.axis();
        let q = self.polarity.q;
        let from = *self.polarity.from.get_or_insert(q);
        let moved: [f32; MAX_JOINTS] = core::array::from_fn(|j| q[j] - from[j]);
        let Some(counts) = self.program.as_ref().map(|program| program.radians_per_count) else { return none };
        let swung = self.polarity.swing.is_some();
        let farthest = |j: usize| if swung && j != i { SWUNG_ANGLE } else { STRAY_ANGLE };
        let beyond = |j: &usize| margin_bits(moved[*j], farthest(*j).greater(STRAY_COUNTS * counts[*j].abs())) < 0;
        if let Some(j) = (0..self.count().min(MAX_JOINTS)).find(beyond) {
            match &self.polarity.swing {
                Some(Swing { angle, work, .. }) if j == i && *work < 0.0 => {
                    self.trip(Fault::PolarityWrong, Some(j as u8), moved[j] / angle);
                }
                Some(Swing { angle, .. }) => self.trip(Fault::TorqueMismatch, Some(j as u8), moved[j] / angle),
                None => self.trip(Fault::PolarityUnrest, Some(j as u8), moved[j]),
            }
            return none;
        }
        // Each of these takes a step of its own, because steps at high rates have little time.
        if swung && self.polarity.part == 0 {
            return self.swing(&moved, &counts);
        }
        match (self.polarity.swing, self.polarity.inertia) {
            (Some(swing), _) => self.check_swings(&swing),
            (None, Some(inertia)) => {
                self.polarity.effective = effective_inertia(i, inertia, self.count());
                self.begin_first();
            }
            (None, None) if self.at_rest() => {
                if self.polarity.poses < 1 << self.count {
                    self.check_next_pose();
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

    /// Computes the joint's leverage at the next pose in which the device may really stand: a corner of the range of
    /// home errors. Between corners leverage is lower, because it grows towards singular poses.
    fn check_next_pose(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        let corner = self.polarity.poses;
        let mut unit = Torques::default();
        unit[self.axis()] = 1.0;
        let off = |j: usize| if corner >> j & 1 == 0 { HOME_DOUBT } else { -HOME_DOUBT };
        let leverage = program.mechanism.leverage::<K>(&core::array::from_fn(|j| self.polarity.q[j] + off(j)));
        let [there, here] = [&leverage, &self.leverage].map(|leverage| sqrt(leverage.force_squared(&unit)));
        // `min` also drops NaN, which an impossible pose gives.
        self.polarity.worth = self.polarity.worth.max(there.max(here).min(here / DOUBTED_SHARE));
        self.polarity.poses = corner + 1;
    }

    /// Returns a torque (N m) of the joint under test, reduced to the limit of the tip force here and at the poses
    /// around.
    fn within_tip_force(&self, wanted: f32) -> Torques {
        let i = self.axis();
        let tip_force = self.rules.limits.tip_force;
        let most = (tip_force / self.polarity.worth).lesser(self.joints[i].stage.max_torque());
        let mut torque = Torques::default();
        torque[i] = limited(wanted, most.lesser(self.max_joint_torque[i]));
        torque[i] *= share_within(self.leverage.force_squared(&torque), tip_force);
        torque
    }

    /// Continues with the next joint, or ends the check with success.
    fn pass_on(&mut self) {
        let next = self.axis() + 1;
        if next >= self.count() {
            self.off();
            self.state = State::Disarmed;
            self.know_polarity();
        } else {
            self.polarity = PolarityCheck { axis: next, ..PolarityCheck::default() };
        }
    }

    /// Records that the polarity is known, for the present home if there is one.
    pub(super) fn know_polarity(&mut self) {
        self.polarity_known = true;
        if let Some(program) = self.program.as_ref().filter(|_| self.homed) {
            self.checked_zero = program.controller.zero();
        }
    }

    /// Keeps the result after homing if the new home is within one swing of the checked one, because the torques were
    /// computed with the mass matrix of that pose.
    pub(super) fn keep_polarity_near_its_home(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        let zero = program.controller.zero();
        self.polarity_known &= program.radians_per_count.iter().enumerate().take(program.joints).all(|(i, radians)| {
            let off = zero[i].wrapping_sub(self.checked_zero[i]) as f32 * radians;
            off.abs() <= swing_angle(*radians)
        });
    }

    /// Chooses the first swing of the joint.
    fn begin_first(&mut self) {
        let (i, inertia) = (self.axis(), self.polarity.effective);
        let Some(program) = self.program.as_ref() else { return };
        let (worth, friction) = (self.polarity.worth, program.coulomb[i].abs());
        let angle = swing_angle(program.radians_per_count[i]);
        let rate = self.swing_rate(FIRST_FORCE / worth, inertia * angle, angle, SWING_RATES.1);
        let inert = inertia * angle * rate * rate;
        // A joint of this inertia with a dead encoder swings by at most a few times the angle.
        let unstated = (UNSEEN_FORCE / worth).min(friction + 2.0 * inert);
        let most = (inert + FRICTION_DOUBT * friction).max(unstated);
        let torque = (LEAST_FORCE / worth).min(0.25 * inert);
        let (stiffness, damping) = spring(inertia, 0.4 * rate);
        let seconds = core::f32::consts::TAU / rate;
        let swing = Swing { torque, most, rate, seconds, angle, stiffness, damping, ..Swing::default() };
        self.polarity.swing = Some(swing);
    }

    /// Returns the swing after one that roughly agreed with the file; `None` if it would not be harder. A swing for the
    /// winding is faster than cables allow the others to be, because that takes more current.
    fn next_swing(&self, before: &Swing, winding: bool) -> Option<Swing> {
        let (i, inertia) = (self.axis(), self.polarity.effective);
        let angle = before.angle;
        let most = (SECOND_SHARE * self.rules.limits.tip_force / self.polarity.worth)
            .min(SECOND_TORQUE * self.joints[i].stage.max_torque());
        let fastest = if winding { FASTEST_SWING } else { SWING_RATES.1 };
        let rate = self.swing_rate(most, inertia * angle, angle, fastest);
        let inert = (inertia * angle * rate * rate).min(most);
        // More than friction, which would otherwise hold the joint at either end.
        let held = FRICTION_EXCESS * before.moved_by.unwrap_or(0.0);
        let most = if winding { inert } else { inert.max(held) };
        let (stiffness, damping) = spring(inertia, 0.25 * rate);
        let torque = 0.25 * before.torque.min(inert);
        let seconds = core::f32::consts::TAU / rate;
        let known = Swing { last: true, winding, moved_by: Some(torque), angle, mean: before.mean, ..Swing::default() };
        (most > 1.2 * before.torque).then_some(Swing { torque, most, rate, seconds, stiffness, damping, ..known })
    }

    /// Returns the angular frequency (rad/s) at which a torque (N m), or the friction if that is more, swings the joint
    /// by an angle (rad), given its inertia times that angle; at most `most` unless friction needs more.
    fn swing_rate(&self, torque: f32, inertia_angle: f32, angle: f32, most: f32) -> f32 {
        let i = self.axis();
        let Some(program) = self.program.as_ref() else { return SWING_RATES.0 };
        let of = |torque: f32| sqrt(torque / inertia_angle.max(f32::MIN_POSITIVE));
        // Friction that takes more than inertia would hide it.
        let wanted = of(torque).min(most).max(of(1.5 * program.coulomb[i].abs()).min(FASTEST_SWING));
        let between_counts = SWING_COUNTS * program.radians_per_count[i].abs();
        let fastest = (SWING_SPEED * self.rules.limits.speed[i] / angle)
            .min(self.joints[i].stage.turning(HIDDEN_VOLTS).abs() / between_counts)
            .min(core::f32::consts::TAU / (SWING_STEPS * self.polarity.pace));
        wanted.min(fastest).max(SWING_RATES.0)
    }

    /// Takes a step of a swing: sums up the samples, and returns the torques. `moved`: distance of each joint from
    /// where it stood, rad.
    #[inline(never)]
    fn swing(&mut self, moved: &[f32; MAX_JOINTS], counts: &[f32; MAX_JOINTS]) -> Torques {
        let (i, joints) = (self.axis(), self.count());
        let stage = &self.joints[i].stage;
        let polarity = &mut self.polarity;
        let (pace, current, voltage) = (polarity.pace, polarity.current, polarity.voltage);
        let Some(swing) = polarity.swing.as_mut() else { return Torques::default() };
        let turn = core::f32::consts::TAU / swing.rate;
        if swing.seconds >= turn {
            // A swinging joint stands still where a turn begins.
            swing.seconds -= turn;
            let swung = swing.swung(i, joints);
            if swing.turns < SWINGS_BEFORE && swung > FAR && swing.rate < SWING_RATES.1 {
                // The same torque swings joints less far if it alternates faster.
                (swing.full, swing.turns) = (false, 0.0);
                swing.rate = (swing.rate * sqrt(swung / AIM).lesser(FASTER)).lesser(SWING_RATES.1);
            }
            swing.turns += if swing.full { 1.0 } else { 0.0 };
            swing.ends = moved.map(|moved| (moved, moved));
        }
        let turns = swing.turns + swing.seconds / turn;
        if turns >= SWINGS_BEFORE + SWINGS + BEFORE_FADING + SWINGS_FADING {
            polarity.part = 1;
            return Torques::default();
        }
        let summed = (turns - SWINGS_BEFORE) / SWINGS;
        let (sine, cosine) = K::sin_cos(swing.rate * swing.seconds);
        if summed > 0.0 && summed < 1.0 {
            // The weight suppresses slow changes.
            let weight = 1.0 - K::sin_cos(core::f32::consts::TAU * summed).1;
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
        let was_at = swing.seconds / turn;
        let now_at = was_at + pace / turn;
        let passes = |phase: f32| was_at <= phase && phase < now_at;
        swing.seconds += pace;
        if swing.moved_by.is_none() && moved[i].abs() > SEEN_ANGLE.greater(SEEN_COUNTS * counts[i].abs()) {
            // From here on the joint needs at most this torque and the file's torque for inertia.
            swing.moved_by = Some(swing.torque);
            let inert = polarity.effective * swing.angle * swing.rate * swing.rate;
            swing.most = swing.torque + SWING_EXCESS * inert;
            (swing.full, swing.turns) = (false, 0.0);
        }
        for ((low, high), moved) in swing.ends.iter_mut().zip(moved) {
            (*low, *high) = (moved.lesser(*low), moved.greater(*high));
        }
        let swung = swing.swung(i, joints);
        swing.work += polarity.commanded[i] * (moved[i] - swing.was);
        swing.was = moved[i];
        // A faster filter would turn a single count of a coarse encoder into a blow.
        let speed = swing.rate * (moved[i] - swing.mean);
        swing.mean += (pace * swing.rate).lesser(1.0) * (moved[i] - swing.mean);
        if !swing.full {
            if passes(ZERO_TORQUE) {
                let ratio = GROWTH.lesser(swing.most / swing.torque).lesser(AIM / swung).greater(1.0);
                swing.full = ratio < LEAST_GROWTH && (swung < FAR || swing.rate >= SWING_RATES.1);
                swing.growth = (ratio - 1.0) * swing.torque / turn;
            } else if swung >= FAR || swung >= 1.0 && passes(ZERO_TORQUE - 0.5) {
                swing.growth = 0.0;
            }
            swing.torque = (swing.torque + swing.growth * pace).lesser(swing.most);
        } else if swing.moved_by.is_none() && swing.turns > 1.0 {
            self.trip(Fault::PolarityNoMotion, Some(i as u8), moved[i]);
            return Torques::default();
        }
        let back = -swing.stiffness * moved[i] - swing.damping * speed;
        let fading = (1.0 - (turns - SWINGS_BEFORE - SWINGS - BEFORE_FADING) / SWINGS_FADING).clamp(0.0, 1.0);
        let wanted = limited(fading * swing.torque * cosine + back, swing.most);
        self.within_tip_force(wanted)
    }

    /// Compares a finished swing with the device file, a part in each step, because steps at high rates have little
    /// time; then continues with the next swing or joint.
    fn check_swings(&mut self, swing: &Swing) {
        let part = self.polarity.part;
        self.polarity.part = part + 1;
        match part {
            1 => self.compare_torques(swing),
            2 => self.compare_resistance(swing),
            3 => self.judge_torque(swing),
            _ => self.judge_rest(swing),
        }
    }

    /// Compares the torques that acted with the torque of the measured current.
    #[inline(never)]
    fn compare_torques(&mut self, swing: &Swing) {
        let i = self.axis();
        let Some(program) = self.program.as_ref() else { return };
        let inertia = self.polarity.inertia.unwrap_or_default();
        let rate = -swing.rate * swing.rate;
        // Torques of the joints' accelerations.
        let acted = inertia.map(|row| {
            let parts = row.iter().zip(&swing.angles);
            parts.fold([0.0; 2], |sum: Phasor, (inertia, angle)| {
                [sum[0] + rate * inertia * angle[0], sum[1] + rate * inertia * angle[1]]
            })
        });
        // A current sampled just before it changes belongs to the middle of the step before.
        let (sine, cosine) = K::sin_cos(0.5 * self.polarity.pace * swing.rate);
        let [along, across] = swing.driven;
        let driven = [along * cosine + across * sine, across * cosine - along * sine];
        let share = |row: &Phasor| dot(*row, driven) / dot(driven, driven).max(f32::MIN_POSITIVE);
        let mut others = acted.iter().map(share).enumerate().take(self.count()).filter(|(row, _)| *row != i);
        // Friction of the other joint may take a torque without a motor.
        let size = sqrt(dot(driven, driven)) * self.polarity.pace * swing.rate / (core::f32::consts::PI * SWINGS);
        let held = |row: usize| 1.5 * program.coulomb[row].abs() / size.max(f32::MIN_POSITIVE);
        let results = &mut self.polarity.results;
        results.astray = others.find(|(row, aside)| margin_bits(*aside, CROSS_DOUBT + held(*row)) < 0);
        // The part in phase with the acceleration, because friction is in phase with the speed.
        results.found = dot(acted[i], acted[i]) / dot(acted[i], driven);
    }

    /// Compares the winding's resistance with the file's.
    #[inline(never)]
    fn compare_resistance(&mut self, swing: &Swing) {
        let i = self.axis();
        let Some(program) = self.program.as_ref() else { return };
        let (bridge, stage) = (&self.hardware.bridge, &self.joints[i].stage);
        let measured = (bridge.current_sensed && self.hardware.bus_sensed)
            .then(|| stage.resistance_of(swing.voltage, swing.current, swing.angles[i], swing.rate))
            .flatten();
        let dead = DEAD_TIME_DOUBT * 2.0 * bridge.dead_time * program.carrier_hz * self.now.motors.bus_voltage;
        // Amplitude of the current, and of the first harmonic of the dead time's voltage over it.
        let amperes = sqrt(dot(swing.current, swing.current)) * self.polarity.pace * swing.rate
            / (core::f32::consts::PI * SWINGS);
        let doubt = 4.0 / core::f32::consts::PI * dead / amperes;
        let strange =
            measured.filter(|(found, expected)| margin_bits(found - expected, RESISTANCE_DOUBT * expected + doubt) < 0);
        let results = &mut self.polarity.results;
        results.strange = strange.map(|(found, _)| found);
        results.clear = measured.filter(|(_, expected)| doubt < CLEAR_DOUBT * expected);
        results.unclear = measured.is_some() && results.clear.is_none() && !swing.winding;
    }

    /// Judges the torque of the driven joint. The second swing follows if the first one roughly agrees.
    #[inline(never)]
    fn judge_torque(&mut self, swing: &Swing) {
        let (axis, found) = (Some(self.axis() as u8), self.polarity.results.found);
        let second = if swing.last { None } else { self.next_swing(swing, false) };
        let torque_doubt = if second.is_some() { FIRST_DOUBT } else { TORQUE_DOUBT };
        if !swing.winding && found < -FIRST_DOUBT.0 {
            self.trip(Fault::PolarityWrong, axis, found);
        } else if !swing.winding && !(torque_doubt.0..=torque_doubt.1).contains(&found) {
            self.trip(Fault::TorqueMismatch, axis, found);
        } else if second.is_some() {
            (self.polarity.swing, self.polarity.part) = (second, 0);
        }
    }

    /// Judges the other joints and the winding after the last swing for torque. A swing for the winding alone follows if
    /// the dead time hides the resistance.
    #[inline(never)]
    fn judge_rest(&mut self, swing: &Swing) {
        let i = self.axis();
        let Results { astray, strange, clear, unclear, .. } = self.polarity.results;
        if !swing.winding
            && let Some((row, aside)) = astray
        {
            self.trip(Fault::TorqueMismatch, Some(row as u8), aside);
        } else if let Some(found) = strange {
            self.trip(Fault::ResistanceMismatch, Some(i as u8), found);
        } else if unclear && let Some(third) = self.next_swing(swing, true) {
            (self.polarity.swing, self.polarity.part) = (Some(third), 0);
        } else {
            if let Some((found, expected)) = clear {
                self.joints[i].stage.set_measured_resistance(found.max((1.0 - RESISTANCE_DOUBT) * expected));
            }
            self.pass_on();
        }
    }

    /// Returns true if the joint has come to rest.
    fn at_rest(&mut self) -> bool {
        let q = self.polarity.q[self.axis()];
        let polarity = &mut self.polarity;
        polarity.waited += polarity.pace;
        polarity.rested += polarity.pace;
        // Both ends count, so a joint that a hand leads to and fro is not at rest.
        let (low, high) = (polarity.rests_at.0.min(q), polarity.rests_at.1.max(q));
        (polarity.rests_at, polarity.rested) = match high - low <= REST_MOTION {
            true => ((low, high), polarity.rested),
            false => ((q, q), 0.0),
        };
        polarity.rested >= REST_SECONDS
    }
}

/// Returns the swing to either side (rad) of a joint with this angle of a count (rad).
fn swing_angle(radians_per_count: f32) -> f32 {
    SWING_ANGLE.max(SWING_COUNTS * radians_per_count.abs())
}

/// Returns stiffness (N m/rad) and damping (N m s/rad) that pull a joint of this inertia (kg m²) back at this angular
/// frequency (rad/s), almost without ringing.
fn spring(inertia: f32, back: f32) -> (f32, f32) {
    (inertia * back * back, 1.4 * inertia * back)
}

/// Returns the ratio of a torque of joint `i` to the largest acceleration that it makes in any joint, kg m²: light
/// links are flung along.
fn effective_inertia(i: usize, mut inertia: [[f32; MAX_JOINTS]; MAX_JOINTS], joints: usize) -> f32 {
    for (j, row) in inertia.iter_mut().enumerate().skip(joints) {
        row.iter_mut().skip(j).take(1).for_each(|diagonal| *diagonal = 1.0);
    }
    let [one, other] = [inertia[(i + 1) % MAX_JOINTS], inertia[(i + 2) % MAX_JOINTS]];
    // Column `i` of the inverse of the mass matrix, times its determinant.
    let column: [f32; MAX_JOINTS] = core::array::from_fn(|j| {
        let (k, l) = ((j + 1) % MAX_JOINTS, (j + 2) % MAX_JOINTS);
        one[k] * other[l] - one[l] * other[k]
    });
    let row = inertia[i % MAX_JOINTS];
    let determinant: f32 = column.iter().zip(&row).map(|(part, inertia)| part * inertia).sum();
    let effective = determinant / column.iter().fold(f32::MIN_POSITIVE, |most, part| most.max(part.abs()));
    // `max` also drops NaN, and a determinant that is all rounding.
    effective.max(LEAST_EFFECTIVE * row[i % MAX_JOINTS])
}

/// Returns the scalar product of two phasors.
fn dot(one: Phasor, other: Phasor) -> f32 {
    one[0] * other[0] + one[1] * other[1]
}
