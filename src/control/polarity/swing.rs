//! One swing of the polarity check: its torque, the sums of its samples, and their comparison with the device file.
//!
//! The undriven joints are free, so a light link swings along. The amplitude changes only where the torque is zero,
//! because any other change would leave a free joint drifting at a constant speed.
//!
//! Only the parts of angles, currents and voltages that alternate with the torque are summed up, so drifts, sensor
//! offsets and constant loads cancel. The motion in phase with the torque is due to inertia; the motion due to friction
//! is a quarter period later. M q̈, with the file's M and the encoders' q, is therefore the torque that acted. Its
//! ratio to the torque of the measured current is 1 if torque constant, gear ratio, current sensor, counts per turn and
//! inertia agree. Voltage over current gives the winding's resistance, whatever the sensor's scale is.

use crate::control::ControlLoop;
use crate::control::joints::Torques;
use crate::control::polarity::alignment::MAX_SWING_ELECTRICAL;
use crate::control::program::Program;
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, Real, clamp, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::Fault;
use core::ops::DerefMut;

/// Accepted ratio (lowest, highest) of the torque that acted to the file's torque, as measured on sound devices.
/// Static friction lowers the ratio.
const ACCEPTED_TORQUE_RATIO: (f32, f32) = (1.0 / 1.4, 1.2);
/// Accepted torque ratio (lowest, highest) in the first swing, which a second and harder swing follows.
const FIRST_ACCEPTED_RATIO: (f32, f32) = (0.5, 1.6);
/// Largest torque that may appear in a joint without a command, as a share of the driven joint's torque.
const MAX_CROSS_TORQUE_SHARE: f32 = 0.5;
/// Largest relative error of the winding's resistance: copper gains 40 % per 100 K.
const MAX_RESISTANCE_ERROR: f32 = 0.35;
/// Largest share of the resistance that the dead time may hide if the measured resistance is used.
const MAX_HIDDEN_SHARE: f32 = 0.1;
/// Relative error of the dead time's voltage after compensation.
const DEAD_TIME_ERROR: f32 = 0.5;
/// Tip force that the file predicts for the first torque, N; 0.5 N if the file's constants are ten times wrong.
const INITIAL_TIP_FORCE: f32 = 0.05;
/// Tip force that accelerates the file's inertia in the first swing, N.
const FIRST_SWING_FORCE: f32 = 0.2;
/// Largest predicted tip force before a joint moves, N, if the device file omits the joint's friction.
const MAX_FORCE_WITHOUT_MOTION: f32 = 0.8;
/// Largest ratio of static friction to the file's Coulomb friction.
const MAX_STATIC_FRICTION_RATIO: f32 = 3.0;
/// Largest share of the tip-force limit that may accelerate the inertia in the second swing.
const SECOND_SWING_FORCE_SHARE: f32 = 0.6;
/// Largest share of the motor's torque that may accelerate the inertia in the second swing.
const SECOND_SWING_TORQUE_SHARE: f32 = 0.25;
/// Smallest ratio of the torque that accelerates the inertia to the file's friction.
const FRICTION_RATIO: f32 = 1.5;
/// The same ratio in a standing frame, in which only a part of the current makes torque, and a joint that sticks at both
/// ends of its swing would change the measured cosine.
const ALIGNING_FRICTION_RATIO: f32 = 4.0;
/// Largest excess over the torque that moved the joint, as a share of the torque that accelerates the file's inertia.
const MAX_SWING_TORQUE_RATIO: f32 = 1.2;
/// Ratio of the second swing's torque to the torque that moved the joint.
const SECOND_SWING_FRICTION_RATIO: f32 = 2.5;
/// Smallest effective inertia, as a share of the joint's own inertia.
const MIN_EFFECTIVE_INERTIA_SHARE: f32 = 1.0e-3;
/// Smallest motion that counts as a motion, rad.
const MIN_MOTION_ANGLE: f32 = 1.5e-3;
/// Smallest motion that counts as a motion, counts.
const MIN_MOTION_COUNTS: f32 = 1.5;
/// Smallest swing to either side, rad.
const MIN_SWING_ANGLE: f32 = 0.02;
/// Smallest swing to either side, counts.
const MIN_SWING_COUNTS: f32 = 4.0;
/// Range of a swing's angular frequency, rad/s, between the natural frequencies of a hanging device and a soft cable.
const SWING_RATE_RANGE: (f32, f32) = (8.0, 50.0);
/// Highest angular frequency if friction exceeds the torque that accelerates the inertia, rad/s.
const MAX_SWING_RATE: f32 = 200.0;
/// Largest back-EMF within the first counts of a joint, V. A larger back-EMF would count as a lost encoder.
const MAX_INITIAL_BACK_EMF: f32 = 0.8;
/// Largest share of the speed limit in a swing.
const SWING_SPEED_SHARE: f32 = 0.5;
/// Fewest steps of the check in a turn.
const MIN_SWING_STEPS: f32 = 16.0;
/// Largest factor by which the torque grows from one turn to the next.
const MAX_GROWTH: f32 = 1.95;
/// Factor of growth from one turn to the next below which the torque stops growing.
const MIN_GROWTH: f32 = 1.1;
/// Largest factor by which the angular frequency grows after a turn that swung a joint too far.
const MAX_RATE_FACTOR: f32 = 1.5;
/// Share of the largest swing that the growth of the torque aims at.
const AIMED_SWING_SHARE: f32 = 0.8;
/// Share of the largest swing at which the torque stops growing at once.
const STOPPING_SWING_SHARE: f32 = 1.25;
/// Phase at which the torque is zero and its growth changes, turns.
const ZERO_TORQUE_PHASE: f32 = 0.75;
/// Turns at the full torque before the sums begin.
const TURNS_BEFORE_SUMS: f32 = 2.0;
/// Turns during which the samples are summed up.
const TURNS_SUMMED: f32 = 3.0;
/// Turns during which the torque fades, so that no joint glides on.
const TURNS_FADING: f32 = 2.0;
/// Turns between the sums and the fade, which begins where the torque is zero.
const TURNS_BEFORE_FADING: f32 = 0.25;

/// A quantity that alternates with a swing's torque: the part in phase, and the part a quarter turn later.
type Phasor = [f32; 2];

/// The swing of a joint. A turn is one period of the swing.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Swing {
    /// True for a swing in a standing frame, which measures the cosine of the frame's angle.
    aligning: bool,
    /// True for the second swing.
    last: bool,
    /// True for a swing that measures only the winding.
    winding: bool,
    /// Present amplitude of the torque, N m.
    torque: f32,
    /// Largest allowed amplitude of the torque, N m.
    max_torque: f32,
    /// Growth of the torque, N m/s.
    growth: f32,
    /// Angular frequency, rad/s.
    rate: f32,
    /// Torque of the first detected motion, N m.
    breakaway_torque: Option<f32>,
    /// Swing of a joint to either side that limits the growth of the torque, rad.
    pub(super) angle: f32,
    /// Lowest and highest angle of each joint in this turn, relative to its initial angle, rad.
    motion_range: [(f32, f32); MAX_JOINTS],
    /// True if the torque has stopped growing.
    has_full_torque: bool,
    /// Stiffness that pulls the joint back to its initial angle, N m/rad.
    stiffness: f32,
    /// Damping of the joint's return to its initial angle, N m s/rad.
    damping: f32,
    /// Distance of the joint from its initial angle at the beginning of the swing, rad.
    begin: f32,
    /// Mean distance of the joint from its initial angle over about a sixth of a turn, rad.
    mean: f32,
    /// Work of the commanded torque on the joint, J; negative if the motor turns the wrong way.
    pub(super) work: f32,
    /// Distance of the joint from its initial angle at the last step, rad.
    last_moved: f32,
    /// Time in this turn, s. The first value is a complete turn, so that a turn begins at once.
    seconds: f32,
    /// Number of turns with the full torque.
    turns: f32,
    /// Sums of the joint angles, rad.
    angles: [Phasor; MAX_JOINTS],
    /// Sum of the torque of the measured current, N m.
    driven_torque: Phasor,
    current: Phasor,
    voltage: Phasor,
}

impl Swing {
    /// Returns the largest motion of a joint in this turn, as a share of the motion at which the torque stops growing.
    #[inline(always)]
    fn largest_motion_share(&self, axis: usize, joints: usize, lever: &[f32; MAX_JOINTS]) -> f32 {
        let mut most = 0.0;
        for (j, (low, high)) in self.motion_range.iter().enumerate().take(joints) {
            let limit = if self.last && j == axis { 4.0 } else { 2.0 } * self.angle * lever[j];
            let share = (high - low) * lever[axis] / limit;
            most = share.greater(most);
        }
        most
    }
}

/// Results of a joint's swings.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Results {
    /// Ratio of the torque that acted to the file's torque.
    torque_ratio: f32,
    /// Joint in which too much torque appeared without a command, and that torque as a share of the driven joint's.
    stray_torque: Option<(usize, f32)>,
    /// Measured resistance that differs too much from the file's, Ω.
    wrong_resistance: Option<f32>,
    /// Measured and expected resistance, Ω, if the dead time hides little of the measured resistance.
    resistance: Option<(f32, f32)>,
    /// True if the dead time hides too much of the resistance.
    hidden_by_dead_time: bool,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Chooses the first swing of the joint.
    pub(super) fn begin_first_swing(&mut self) {
        let (i, inertia) = (self.axis(), self.polarity.effective_inertia);
        let Some(program) = self.program.as_ref() else { return };
        let (worth, friction) = (self.polarity.force_per_torque, program.coulomb[i].abs());
        let aligning = self.polarity.alignment.is_under_way(&self.joints[i].stage);
        let mut angle = swing_angle(program.radians_per_count[i], program.lever[i]);
        if aligning {
            angle = angle.min(MAX_SWING_ELECTRICAL / self.joints[i].stage.electrical_ratio());
        }
        let friction_ratio = if aligning { ALIGNING_FRICTION_RATIO } else { FRICTION_RATIO };
        let most = SWING_RATE_RANGE.1;
        let rate = self.swing_rate(FIRST_SWING_FORCE / worth, inertia * angle, angle, most, friction_ratio);
        let inert = inertia * angle * rate * rate;
        // A joint of this inertia with a dead encoder swings by at most a few times the angle.
        let unstated = (MAX_FORCE_WITHOUT_MOTION / worth).min(friction + 2.0 * inert);
        let most = (inert + MAX_STATIC_FRICTION_RATIO * friction).max(unstated);
        let torque = (INITIAL_TIP_FORCE / worth).min(0.25 * inert);
        let (stiffness, damping) = spring_and_damper(inertia, 0.4 * rate);
        let seconds = core::f32::consts::TAU / rate;
        let begin = self.polarity.initial.map_or(0.0, |from| self.polarity.q[i] - from[i]);
        let known = Swing { aligning, begin, mean: begin, last_moved: begin, ..Swing::default() };
        let swing = Swing { torque, max_torque: most, rate, seconds, angle, stiffness, damping, ..known };
        self.polarity.swing = Some(swing);
    }

    /// Returns the swing after a swing that roughly agreed with the file; `None` if the next swing would not be harder.
    /// A swing for the winding may be faster than cables allow, because speed takes more current.
    fn next_swing(&self, before: &Swing, winding: bool) -> Option<Swing> {
        let (i, inertia) = (self.axis(), self.polarity.effective_inertia);
        let angle = before.angle;
        let most = (SECOND_SWING_FORCE_SHARE * self.rules.limits.tip_force / self.polarity.force_per_torque)
            .min(SECOND_SWING_TORQUE_SHARE * self.joints[i].stage.max_torque());
        let fastest = if winding { MAX_SWING_RATE } else { SWING_RATE_RANGE.1 };
        let rate = self.swing_rate(most, inertia * angle, angle, fastest, FRICTION_RATIO);
        let inert = (inertia * angle * rate * rate).min(most);
        // The torque must exceed the static friction, which would otherwise hold the joint at either end.
        let held = SECOND_SWING_FRICTION_RATIO * before.breakaway_torque.unwrap_or(0.0);
        let most = if winding { inert } else { inert.max(held) };
        let (stiffness, damping) = spring_and_damper(inertia, 0.25 * rate);
        let torque = 0.25 * before.torque.min(inert);
        let seconds = core::f32::consts::TAU / rate;
        let known =
            Swing { last: true, winding, breakaway_torque: Some(torque), angle, mean: before.mean, ..Swing::default() };
        (most > 1.2 * before.torque).then_some(Swing {
            torque,
            max_torque: most,
            rate,
            seconds,
            stiffness,
            damping,
            ..known
        })
    }

    /// Returns the angular frequency (rad/s) at which a torque (N m) swings the joint by an angle (rad), given inertia
    /// times angle; at most `most` unless friction needs more. Uses the friction if it exceeds the torque.
    fn swing_rate(&self, torque: f32, inertia_angle: f32, angle: f32, most: f32, friction_ratio: f32) -> f32 {
        let i = self.axis();
        let Some(program) = self.program.as_ref() else { return SWING_RATE_RANGE.0 };
        let of = |torque: f32| sqrt(torque / inertia_angle.max(f32::MIN_POSITIVE));
        // Friction above the torque that accelerates the inertia would hide the inertia.
        let wanted = of(torque).min(most).max(of(friction_ratio * program.coulomb[i].abs()).min(MAX_SWING_RATE));
        let between_counts = MIN_SWING_COUNTS * program.radians_per_count[i].abs();
        let fastest = (SWING_SPEED_SHARE * self.rules.limits.speed[i] * program.lever[i] / angle)
            .min(self.joints[i].stage.speed_of_back_emf(MAX_INITIAL_BACK_EMF).abs() / between_counts)
            .min(core::f32::consts::TAU / (MIN_SWING_STEPS * self.polarity.step_period));
        wanted.min(fastest).max(SWING_RATE_RANGE.0)
    }

    /// Runs a step of a swing: sums up the samples and returns the torques. `moved` is each joint's motion since the
    /// start, rad.
    #[inline(never)]
    pub(super) fn swing(
        &mut self,
        moved: &[f32; MAX_JOINTS],
        counts: &[f32; MAX_JOINTS],
        lever: &[f32; MAX_JOINTS],
    ) -> Torques {
        let (i, joints) = (self.axis(), self.count());
        let stage = &self.joints[i].stage;
        let polarity = &mut self.polarity;
        let (pace, current, voltage) = (polarity.step_period, polarity.current, polarity.voltage);
        let Some(swing) = polarity.swing.as_mut() else { return Torques::default() };
        let turn = core::f32::consts::TAU / swing.rate;
        if swing.seconds >= turn {
            // A swinging joint stands still where a turn begins.
            swing.seconds -= turn;
            let swung = swing.largest_motion_share(i, joints, lever);
            if swing.turns < TURNS_BEFORE_SUMS && swung > STOPPING_SWING_SHARE && swing.rate < SWING_RATE_RANGE.1 {
                // The same torque swings joints less far at a higher frequency.
                (swing.has_full_torque, swing.turns) = (false, 0.0);
                swing.rate =
                    (swing.rate * sqrt(swung / AIMED_SWING_SHARE).lesser(MAX_RATE_FACTOR)).lesser(SWING_RATE_RANGE.1);
            }
            swing.turns += if swing.has_full_torque { 1.0 } else { 0.0 };
            swing.motion_range = moved.map(|moved| (moved, moved));
        }
        let turns = swing.turns + swing.seconds / turn;
        if turns >= TURNS_BEFORE_SUMS + TURNS_SUMMED + TURNS_BEFORE_FADING + TURNS_FADING {
            polarity.part = 1;
            return Torques::default();
        }
        let summed = (turns - TURNS_BEFORE_SUMS) / TURNS_SUMMED;
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
            add(&mut swing.driven_torque, stage.torque_of(current));
            add(&mut swing.current, current);
            add(&mut swing.voltage, voltage);
        }
        let was_at = swing.seconds / turn;
        let now_at = was_at + pace / turn;
        let passes = |phase: f32| was_at <= phase && phase < now_at;
        swing.seconds += pace;
        if swing.breakaway_torque.is_none()
            && (moved[i] - swing.begin).abs()
                > (MIN_MOTION_ANGLE * lever[i]).greater(MIN_MOTION_COUNTS * counts[i].abs())
        {
            // From here on the joint needs at most this torque plus the torque that accelerates the file's inertia.
            swing.breakaway_torque = Some(swing.torque);
            let inert = polarity.effective_inertia * swing.angle * swing.rate * swing.rate;
            swing.max_torque = swing.torque + MAX_SWING_TORQUE_RATIO * inert;
            (swing.has_full_torque, swing.turns) = (false, 0.0);
        }
        for ((low, high), moved) in swing.motion_range.iter_mut().zip(moved) {
            (*low, *high) = (moved.lesser(*low), moved.greater(*high));
        }
        let swung = swing.largest_motion_share(i, joints, lever);
        swing.work += polarity.commanded_torques[i] * (moved[i] - swing.last_moved);
        swing.last_moved = moved[i];
        // A faster filter would turn a single count of a coarse encoder into a blow.
        let speed = swing.rate * (moved[i] - swing.mean);
        swing.mean += (pace * swing.rate).lesser(1.0) * (moved[i] - swing.mean);
        if !swing.has_full_torque {
            if passes(ZERO_TORQUE_PHASE) {
                let ratio =
                    MAX_GROWTH.lesser(swing.max_torque / swing.torque).lesser(AIMED_SWING_SHARE / swung).greater(1.0);
                swing.has_full_torque =
                    ratio < MIN_GROWTH && (swung < STOPPING_SWING_SHARE || swing.rate >= SWING_RATE_RANGE.1);
                swing.growth = (ratio - 1.0) * swing.torque / turn;
            } else if swung >= STOPPING_SWING_SHARE || swung >= 1.0 && passes(ZERO_TORQUE_PHASE - 0.5) {
                swing.growth = 0.0;
            }
            swing.torque = (swing.torque + swing.growth * pace).lesser(swing.max_torque);
        } else if swing.breakaway_torque.is_none() && swing.turns > 1.0 && swing.aligning {
            polarity.part = 1;
            return Torques::default();
        } else if swing.breakaway_torque.is_none() && swing.turns > 1.0 {
            self.trip(Fault::PolarityNoMotion, Some(i as u8), moved[i]);
            return Torques::default();
        }
        let mut back = -swing.stiffness * moved[i] - swing.damping * speed;
        if swing.aligning {
            // Only the work so far shows the sign of the torque in this frame.
            back *= if swing.work > 0.0 { 1.0 } else { -1.0 };
        }
        let fading =
            (1.0 - (turns - TURNS_BEFORE_SUMS - TURNS_SUMMED - TURNS_BEFORE_FADING) / TURNS_FADING).clamp(0.0, 1.0);
        let wanted = clamp(fading * swing.torque * cosine + back, swing.max_torque);
        self.torques_within_tip_force(wanted)
    }

    /// Compares a finished swing with the device file, one part in each step, because steps at high rates have little
    /// time. Then continues with the next swing or joint.
    pub(super) fn check_swings(&mut self, swing: &Swing) {
        let part = self.polarity.part;
        self.polarity.part = part + 1;
        match part {
            1 if swing.aligning => {
                self.compare_torques(swing);
                let cosine = if swing.breakaway_torque.is_some() { self.polarity.results.torque_ratio } else { 0.0 };
                let (i, (low, high)) = (self.axis(), swing.motion_range[self.axis()]);
                let place = self.polarity.initial.map_or(0.0, |from| from[i]) + 0.5 * (low + high);
                self.continue_alignment(cosine, place, swing.breakaway_torque);
            }
            1 => self.compare_torques(swing),
            2 => self.compare_resistance(swing),
            3 => self.judge_torque(swing),
            _ => self.judge_undriven(swing),
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
        // A current sampled just before the torque changes belongs to the middle of the previous step.
        let (sine, cosine) = K::sin_cos(0.5 * self.polarity.step_period * swing.rate);
        let [along, across] = swing.driven_torque;
        let driven = [along * cosine + across * sine, across * cosine - along * sine];
        let lever = |row: usize| program.lever[row] / program.lever[i];
        let share = |(row, torque): (usize, &Phasor)| {
            (row, lever(row) * dot(*torque, driven) / dot(driven, driven).max(f32::MIN_POSITIVE))
        };
        let mut others = acted.iter().enumerate().take(self.count()).filter(|(row, _)| *row != i).map(share);
        // Friction of an undriven joint may take a torque without a motor.
        let size =
            sqrt(dot(driven, driven)) * self.polarity.step_period * swing.rate / (core::f32::consts::PI * TURNS_SUMMED);
        let held = |row: usize| 1.5 * lever(row) * program.coulomb[row].abs() / size.max(f32::MIN_POSITIVE);
        let results = &mut self.polarity.results;
        results.stray_torque = others.find(|(row, aside)| margin_bits(*aside, MAX_CROSS_TORQUE_SHARE + held(*row)) < 0);
        // Uses the part in phase with the acceleration, because friction is in phase with the speed.
        results.torque_ratio = dot(acted[i], acted[i]) / dot(acted[i], driven);
    }

    #[inline(never)]
    fn compare_resistance(&mut self, swing: &Swing) {
        let i = self.axis();
        let Some(program) = self.program.as_ref() else { return };
        let (bridge, stage) = (&self.hardware.bridge, &self.joints[i].stage);
        let measured = (bridge.current_sensed && self.hardware.bus_sensed)
            .then(|| stage.resistance_of(swing.voltage, swing.current, swing.angles[i], swing.rate))
            .flatten();
        let dead = DEAD_TIME_ERROR * 2.0 * bridge.dead_time * program.carrier_hz * self.now.motors.bus_voltage;
        // Amplitude of the current, and the first harmonic of the dead time's voltage divided by this amplitude.
        let amperes = sqrt(dot(swing.current, swing.current)) * self.polarity.step_period * swing.rate
            / (core::f32::consts::PI * TURNS_SUMMED);
        let doubt = 4.0 / core::f32::consts::PI * dead / amperes;
        let strange = measured
            .filter(|(found, expected)| margin_bits(found - expected, MAX_RESISTANCE_ERROR * expected + doubt) < 0);
        let results = &mut self.polarity.results;
        results.wrong_resistance = strange.map(|(found, _)| found);
        results.resistance = measured.filter(|(_, expected)| doubt < MAX_HIDDEN_SHARE * expected);
        results.hidden_by_dead_time = measured.is_some() && results.resistance.is_none() && !swing.winding;
    }

    /// Judges the torque of the driven joint. A second swing follows if the first one roughly agrees.
    #[inline(never)]
    fn judge_torque(&mut self, swing: &Swing) {
        let (axis, found) = (Some(self.axis() as u8), self.polarity.results.torque_ratio);
        let second = if swing.last { None } else { self.next_swing(swing, false) };
        let accepted_ratio = if second.is_some() { FIRST_ACCEPTED_RATIO } else { ACCEPTED_TORQUE_RATIO };
        if !swing.winding && found < -FIRST_ACCEPTED_RATIO.0 {
            self.trip(Fault::PolarityWrong, axis, found);
        } else if !swing.winding && !(accepted_ratio.0..=accepted_ratio.1).contains(&found) {
            self.trip(Fault::TorqueMismatch, axis, found);
        } else if second.is_some() {
            (self.polarity.swing, self.polarity.part) = (second, 0);
        }
    }

    /// Judges the undriven joints and the winding after the last torque swing. A winding swing follows if the dead time
    /// hides the resistance.
    #[inline(never)]
    fn judge_undriven(&mut self, swing: &Swing) {
        let i = self.axis();
        let Results { stray_torque, wrong_resistance, resistance, hidden_by_dead_time, .. } = self.polarity.results;
        if !swing.winding
            && let Some((row, aside)) = stray_torque
        {
            self.trip(Fault::TorqueMismatch, Some(row as u8), aside);
        } else if let Some(found) = wrong_resistance {
            self.trip(Fault::ResistanceMismatch, Some(i as u8), found);
        } else if hidden_by_dead_time && let Some(third) = self.next_swing(swing, true) {
            (self.polarity.swing, self.polarity.part) = (Some(third), 0);
        } else {
            if let Some((found, expected)) = resistance {
                self.joints[i].stage.set_measured_resistance(found.max((1.0 - MAX_RESISTANCE_ERROR) * expected));
            }
            self.continue_with_next_joint();
        }
    }
}

/// Returns the swing to either side (rad) of a joint with this angle per count (rad) and lever.
pub(super) fn swing_angle(radians_per_count: f32, lever: f32) -> f32 {
    (MIN_SWING_ANGLE * lever).max(MIN_SWING_COUNTS * radians_per_count.abs())
}

/// Returns stiffness (N m/rad) and damping (N m s/rad) that pull a joint of this inertia (kg m²) back with the angular
/// frequency `back` (rad/s), almost without ringing.
pub(super) fn spring_and_damper(inertia: f32, back: f32) -> (f32, f32) {
    (inertia * back * back, 1.4 * inertia * back)
}

/// Returns the ratio of the torque of joint `i` to the largest acceleration of any joint, kg m². A light link
/// accelerates more than the driven joint. Accelerations are compared at the joints' levers.
pub(super) fn effective_inertia(
    i: usize,
    mut inertia: [[f32; MAX_JOINTS]; MAX_JOINTS],
    joints: usize,
    lever: &[f32; MAX_JOINTS],
) -> f32 {
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
    let parts = column.iter().zip(lever).map(|(part, other)| part.abs() * lever[i % MAX_JOINTS] / other);
    let effective = determinant / parts.fold(f32::MIN_POSITIVE, f32::max);
    // `max` also drops NaN, and a determinant that consists of rounding errors.
    effective.max(MIN_EFFECTIVE_INERTIA_SHARE * row[i % MAX_JOINTS])
}

/// Returns the scalar product of two phasors.
fn dot(one: Phasor, other: Phasor) -> f32 {
    one[0] * other[0] + one[1] * other[1]
}
