//! The motor stage of one three-phase motor with surface magnets: two current loops in the rotor's frame.
//!
//! The direct axis d points along the rotor's field, and the quadrature axis q is a quarter electrical turn ahead. Each
//! axis obeys the equation of a brushed motor with the voltage that the other axis induces, v_d = R i_d + L di_d/dt -
//! ω L i_q and v_q = R i_q + L di_q/dt + ω (L i_d + K), where ω is the electrical speed (Krause, Wasynczuk and Sudhoff,
//! *Analysis of Electric Machinery*, chapter 3). Each loop is therefore a brushed [`Axis`]. Torque needs i_q only, so
//! i_d is held at zero.
//!
//! Space-vector modulation centres the three legs' duties between the supply's rails, so that the voltage between two
//! phases reaches the bus voltage. The voltage of a phase is at most bus/√3; the direct axis has the first claim on it.

use super::brushed::Axis;
use super::stage::{Bridge, Frame, MAX_DUTY, Stage, Supply};
use crate::math::{BinaryAngle, Real, clamp, sqrt, table_sin_cos};
use crate::model::motor::{Motor, Winding};

/// Voltage of a phase over the voltage between two phases, 1/√3.
const PHASE_SHARE: f32 = 0.577_350_26;
/// Largest share of the phase voltage that the direct axis may use.
const DIRECT_SHARE: f32 = 0.8;
/// Phase current below which dead-time compensation fades, A, because near zero the sign of the current is noise.
const DEAD_TIME_KNEE: f32 = 0.1;
/// Fewest encoder counts per electrical turn: the field is then off by at most 3 degrees.
const MIN_COUNTS_PER_TURN: f32 = 60.0;
/// Units of a binary angle in a turn.
const TURN: f32 = 4_294_967_296.0;

/// Returns true if a count that turns the field by this electrical angle (rad) is fine enough for commutation.
pub(crate) fn resolves(angle_per_count: f32) -> bool {
    angle_per_count.abs() * MIN_COUNTS_PER_TURN <= core::f32::consts::TAU && angle_per_count != 0.0
}

/// The frame of a three-phase motor and its direct axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ThreePhase {
    direct: Axis,
    frame: Frame,
    /// Electrical angle per encoder count, in units of a binary angle.
    angle_per_count: i32,
    /// Sine and cosine of the frame's electrical angle at the last sample.
    direction: (f32, f32),
    /// Measured current of the direct axis, A.
    direct_current: f32,
    /// Electrical turns per turn of the joint, positive.
    electrical_ratio: f32,
    /// -1 if two phases are exchanged, so that the second coordinate of the stator's vectors is mirrored; otherwise 1.
    mirror: f32,
    pole_pairs: f32,
    inductance: f32,
    /// Carrier period, s.
    period: f32,
    /// Share of the bus voltage that the dead time takes from a leg.
    dead_time_share: f32,
}

/// Returns a vector after a rotation by an angle with this sine and cosine.
#[inline(always)]
fn rotated([x, y]: [f32; 2], (sin, cos): (f32, f32)) -> [f32; 2] {
    [cos * x - sin * y, sin * x + cos * y]
}

/// Returns sine and cosine of an angle after a rotation by a small angle, rad. The error is at most 3e-4 at 0.3 rad.
#[inline(always)]
fn turned_by((sin, cos): (f32, f32), angle: f32) -> (f32, f32) {
    let half = 0.5 * angle * angle;
    let small_sine = angle - angle * half * (1.0 / 3.0);
    (sin + (cos * small_sine - sin * half), cos - (sin * small_sine + cos * half))
}

/// Returns the phases of a vector of the stator, amplitude-invariant.
#[inline(always)]
fn phases([alpha, beta]: [f32; 2]) -> [f32; 3] {
    let (half, side) = (-0.5 * alpha, 1.5 * PHASE_SHARE * beta);
    [alpha, half + side, half - side]
}

/// Returns the legs' duties (0 to 1) for phase voltages as shares of the bus voltage.
fn space_vector_legs([u, v, w]: [f32; 3]) -> [f32; 3] {
    let middle = 0.5 * (u.greater(v).greater(w) + u.lesser(v).lesser(w));
    [u, v, w].map(|phase| 0.5 + clamp(phase - middle, 0.5 * MAX_DUTY))
}

impl ThreePhase {
    /// Makes the direct axis of a motor, `None` for a brushed motor.
    pub(super) fn new(motor: &Motor<f32>, bridge: &Bridge, max_current: f32) -> Option<Self> {
        let electrical_ratio = motor.electrical_ratio()?;
        let Winding::ThreePhase { pole_pairs, .. } = motor.winding else { return None };
        let axis = Motor { back_emf: 0.0, ..*motor };
        Some(Self {
            direct: Axis::new(&axis, bridge, max_current).without_dead_time(),
            electrical_ratio,
            mirror: 1.0,
            pole_pairs: pole_pairs.into(),
            inductance: motor.inductance,
            period: 1.0 / bridge.carrier_hz.max(1.0),
            dead_time_share: bridge.dead_time * bridge.carrier_hz,
            ..Self::default()
        })
    }

    /// Sets the joint's angle per encoder count, rad. An encoder that is too coarse for the motor leaves it without
    /// current.
    pub(super) fn set_encoder(&mut self, radians_per_count: f32) {
        let angle = self.electrical_ratio * radians_per_count;
        self.angle_per_count = if resolves(angle) { (angle * (TURN / core::f32::consts::TAU)) as i32 } else { 0 };
    }

    /// Returns the electrical turns per turn of the joint, positive.
    pub(super) fn electrical_ratio(&self) -> f32 {
        self.electrical_ratio
    }

    pub(super) fn pole_pairs(&self) -> f32 {
        self.pole_pairs
    }

    /// Implements [`Stage::align`]. If the phases are exchanged, the vectors of the stator are mirrored, so that the motor
    /// turns forward in all other equations.
    pub(super) fn align(&mut self, BinaryAngle(electrical): BinaryAngle, count: i32, reversed: bool) {
        self.mirror = if reversed { -1.0 } else { 1.0 };
        let forward = if reversed { electrical.wrapping_neg() } else { electrical };
        let turned = count.wrapping_mul(self.angle_per_count) as u32;
        self.frame = Frame::Rotor(BinaryAngle(forward.wrapping_sub(turned)));
    }

    pub(super) fn assume_alignment(&mut self, offset: f32) {
        self.frame = Frame::Rotor(BinaryAngle::from_radians((self.electrical_ratio * offset).into()));
    }

    /// Returns true if the encoder resolves the motor's electrical angle.
    fn is_usable(&self) -> bool {
        self.angle_per_count != 0
    }

    /// Returns true if the frame may carry current.
    pub(super) fn has_frame(&self) -> bool {
        self.is_usable() && self.frame != Frame::Unknown
    }

    pub(super) fn is_aligned(&self) -> bool {
        self.is_usable() && matches!(self.frame, Frame::Rotor(_))
    }

    /// Sets the frame of both loops.
    pub(super) fn set_frame(&mut self, frame: Frame) {
        (self.frame, self.mirror) = (frame, 1.0);
    }

    /// Returns the frame of both loops.
    pub(super) fn frame(&self) -> Frame {
        self.frame
    }

    /// Returns the quadrature current and the error of the direct current, A, from half the difference and the sum of
    /// the currents of legs 0 and 1 at an encoder count.
    pub(super) fn read(&mut self, half_difference: f32, sum: f32, count: i32) -> (f32, f32) {
        let electrical = count.wrapping_mul(self.angle_per_count) as u32;
        let angle = match self.frame {
            Frame::Unknown => BinaryAngle(0),
            Frame::Fixed(angle) => angle,
            Frame::Rotor(BinaryAngle(offset)) => BinaryAngle(electrical.wrapping_add(offset)),
        };
        // u = sum/2 + half_difference, v = sum/2 - half_difference, and the three currents add up to zero.
        let stator = [0.5 * sum + half_difference, self.mirror * PHASE_SHARE * (1.5 * sum - half_difference)];
        self.direction = table_sin_cos(angle);
        let (sin, cos) = self.direction;
        let [direct, quadrature] = rotated(stator, (-sin, cos));
        self.direct_current = direct;
        (quadrature, direct - self.direct.expected_current())
    }

    /// Returns the legs' duties, and the quadrature voltage as a share of the bus voltage. The arguments are those of
    /// [`Stage::drive`]; `quadrature` is the axis that makes the torque.
    pub(super) fn drive(
        &mut self,
        quadrature: &mut Axis,
        supply: &Supply,
        current: f32,
        speed: f32,
        late: bool,
    ) -> ([f32; 3], f32) {
        let speed = if let Frame::Rotor(_) = self.frame { speed } else { 0.0 };
        let electrical_speed = self.electrical_ratio * speed;
        let reactance = self.inductance * electrical_speed;
        let phase_voltage = PHASE_SHARE * supply.volts;
        let induced = -reactance * quadrature.expected_current();
        let usable = Supply::of(DIRECT_SHARE * phase_voltage);
        let duty = self.direct.drive_coupled(&usable, self.direct_current, 0.0, induced, late);
        let direct = DIRECT_SHARE * f32::from(duty);
        // The circle of phase voltages leaves this share to the quadrature axis, at least 0.6.
        let left = sqrt(1.0 - direct * direct / (MAX_DUTY * MAX_DUTY));
        let induced = reactance * self.direct_current;
        let duty = quadrature.drive_coupled(&Supply::of(left * phase_voltage), current, speed, induced, late);
        let across = left * f32::from(duty);
        // The drive lasts a carrier period, and its middle is a period after the sample.
        let periods = if late { 1.5 } else { 1.0 };
        let turned = turned_by(self.direction, electrical_speed * self.period * periods);
        let phases = |vector: [f32; 2]| {
            let [alpha, beta] = rotated(vector, turned);
            phases([alpha, self.mirror * beta])
        };
        let voltages = phases([PHASE_SHARE * direct, PHASE_SHARE * across]);
        let currents = phases([0.0, quadrature.target_current()]);
        let compensated: [f32; 3] = core::array::from_fn(|leg| {
            voltages[leg] + self.dead_time_share * (currents[leg] / (currents[leg].abs() + DEAD_TIME_KNEE))
        });
        (space_vector_legs(compensated), PHASE_SHARE * across)
    }

    /// Calls the method of the same name of [`Stage`] on the direct axis.
    pub(super) fn limit(&mut self, max_current: f32) {
        self.direct.limit(max_current);
    }

    pub(super) fn settle(&mut self, bus_voltage: f32) {
        self.direct.settle(PHASE_SHARE * bus_voltage, 0.0, 0.0, 0.0);
    }

    /// Returns the difference of the direct axis's voltage from the model, and the largest difference of a sound motor,
    /// V. A rotor that turns at another angle than the frame induces a voltage here; `emf_tolerance` (V) is the part
    /// that the error of a sound alignment may explain.
    pub(super) fn direct_strain(&self, emf_tolerance: f32) -> (f32, f32) {
        let (strain, _, most) = self.direct.strain();
        (strain, most + emf_tolerance)
    }

    pub(super) fn rest(&mut self) {
        self.direct.rest();
    }

    pub(super) fn inherit(&mut self, other: &Self) {
        self.direct.inherit(&other.direct);
        if self.angle_per_count == other.angle_per_count {
            (self.frame, self.mirror) = (other.frame, other.mirror);
        }
    }

    pub(super) fn set_measured_resistance(&mut self, ohms: f32) {
        self.direct.set_measured_resistance(ohms);
    }
}
