//! Injects every fault into the unmodified image on the emulated chip. provoke.rs checks the board's reaction, and
//! report.rs writes the table of the results.
//!
//! The match over all faults is exhaustive, so a fault without an injection does not compile.

use std::f64::consts::PI;

use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::model::description::Homing;
use haptic_bridge::model::motor::{Motor, Winding};
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::Fault;
use haptic_sim::{Hand, Intent, SimulatedDevice, Waypoint};
use rigless::time::VirtualNanos;

use crate::boards::BoardKind;
use crate::contact::NearWall;
use crate::hands::{firm_settings, hold, move_to_and_fro, push};
use crate::image::{CODE_RANGE, SETTINGS_RANGE};
use crate::rig::{Rig, device_file, firmware};
use crate::run::{MICROSECOND, MILLISECOND, SECOND, StoppedBoard};

mod provoke;
mod report;
mod stub;

pub use provoke::{Outcome, bridges_are_off, provoke};
pub use report::{describe, row, table};
pub use stub::replace_task;
use stub::{NMI_FLAG, SUPERVISOR, wire_to_nmi};

/// The way to cause a fault.
pub enum Injection {
    /// The fault is caused on the emulated chip.
    Chip {
        /// Description of the cause.
        description: &'static str,
        /// Creates a board just before the fault.
        create: fn() -> Rig,
        /// Causes the fault.
        cause: fn(&mut Rig),
        /// Longest time until the fault is detected, ms.
        within_ms: u64,
    },
    /// The boards cannot detect the fault, for this reason.
    Undetectable(&'static str),
}

const FIVE_BAR: &str = "pantograph-mk2";
/// Stiffness whose bit pattern no other word in RAM has, N/m.
const MARKER_STIFFNESS: f32 = 517.25;
/// Address of a word on the stack.
const STACK_WORD: u64 = 0x2000_4000;

fn rig_in_contact() -> Rig {
    pressed_rig(0.8)
}

/// Returns a rig whose tip a hand presses into a wall with `newtons`.
fn pressed_rig(newtons: f64) -> Rig {
    Rig::in_contact(BoardKind::OdriveV3, FIVE_BAR, "", &[NearWall::with_normal([0.0, -1.0, 0.0])], newtons)
}

fn free_rig_on(kind: BoardKind) -> Rig {
    let mut rig = Rig::with_device(kind, FIVE_BAR, |_| ());
    rig.arm_near_walls("", &[NearWall { gap: 0.2, ..NearWall::with_normal([0.0, -1.0, 0.0]) }]);
    rig.with_simulated(|device| device.set_hand(Hand::none()));
    rig
}

fn free_rig() -> Rig {
    free_rig_on(BoardKind::OdriveV3)
}

fn disarmed_rig() -> Rig {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, FIVE_BAR, |_| ());
    rig.load("");
    rig.tool.home().expect("homed");
    rig
}

fn change_rules(rig: &mut Rig, change: impl FnOnce(&mut Rules)) {
    let mut rules = rig.tool.rules().expect("the board replies");
    change(&mut rules);
    rig.tool.set_rules(&rules).expect("limits are lowered");
}

fn push_tip(rig: &Rig, force: [f64; 3]) {
    rig.with_simulated(move |device| push(device, force, 0.05));
}

/// Returns an armed rig in contact whose clock security system is connected to the core's non-maskable interrupt.
fn rig_with_nmi_wire() -> Rig {
    let rig = rig_in_contact();
    wire_to_nmi(&rig);
    rig
}

fn change_and_reset(rig: &mut Rig, cause: impl FnOnce(&mut StoppedBoard<'_>) + Send + 'static) {
    rig.while_stopped(cause);
    rig.run(MICROSECOND);
    rig.while_stopped(|stopped| stopped.reset());
}

/// Returns the way to cause `fault`.
#[must_use]
pub fn injection(fault: Fault) -> Injection {
    use Injection::{Chip, Undetectable};
    let chip = |description, create, cause, within_ms| Chip { description, create, cause, within_ms };
    match fault {
        Fault::ControlOverrun => chip(
            "the core held for 55 µs within a control step",
            rig_in_contact,
            |rig| {
                after_crest(rig, 5);
                rig.while_stopped(|stopped| stopped.hold_core(true));
                rig.run(55 * MICROSECOND);
                rig.while_stopped(|stopped| stopped.hold_core(false));
            },
            5,
        ),
        Fault::EncoderJump => chip(
            "0.4 rad of encoder edges, four a microsecond",
            || {
                let mut rig = rig_in_contact();
                change_rules(&mut rig, |rules| rules.limits.speed = [20.0; 3]);
                after_crest(&rig, 10);
                rig
            },
            |rig| {
                rig.with_simulated(|device| {
                    let [a, b, c] = device.q();
                    device.place([a + 0.4, b, c]);
                });
            },
            5,
        ),
        Fault::EncoderStall => chip(
            "encoders unplugged while a motor pushes at its limit",
            rig_in_contact,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().encoders_unplugged = [true; 3]);
                change_rules(rig, |rules| rules.limits.current = [0.15; 3]);
            },
            6_000,
        ),
        Fault::EncoderLoss => chip(
            "encoders unplugged while a hand moves the device",
            free_rig,
            |rig| {
                change_rules(rig, |rules| rules.limits.speed = [4.0; 3]);
                rig.while_stopped(|stopped| stopped.hardware().encoders_unplugged = [true; 3]);
                push_tip(rig, [3.0, 3.0, 0.0]);
            },
            2_000,
        ),
        Fault::EncoderIllegal => Undetectable("the timers' encoder inputs do not report it"),
        Fault::IndexMismatch => chip(
            "20 encoder edges lost between two passes of the index mark",
            rig_with_index,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().edges_lost[0] = 20);
                rig.with_simulated(|device| sweep(device, -HALF_SWEEP_METRES, HALF_SWEEP_METRES));
            },
            2_000,
        ),
        Fault::JointLimit => chip(
            "a hand turns a joint past its limit",
            rig_with_narrow_limits,
            |rig| push_tip(rig, [3.0, 0.0, 0.0]),
            2_000,
        ),
        Fault::SpeedLimit => chip(
            "a hand moves the device faster than 0.5 rad/s",
            free_rig,
            |rig| {
                change_rules(rig, |rules| rules.limits.speed = [0.5; 3]);
                push_tip(rig, [3.0, 0.0, 0.0]);
            },
            2_000,
        ),
        Fault::OverCurrent => chip(
            "a current sensor shows 8 A too much",
            rig_in_contact,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().faults.sensor_offset[..2].fill(8.0));
            },
            5,
        ),
        Fault::ThermalBudget => chip(
            "a wall that keeps a motor at 95 % of its current",
            rig_in_contact,
            |rig| {
                let currents = rig.with_simulated(|device| device.currents());
                change_rules(rig, |rules| {
                    for (limit, current) in rules.limits.current.iter_mut().zip(currents) {
                        *limit = (current.abs() as f32 / 0.95).max(0.05);
                    }
                    rules.limits.continuous_current = [0.02; 3];
                });
            },
            8_000,
        ),
        Fault::BusUnderVoltage => chip(
            "the supply falls to 7 V",
            rig_in_contact,
            |rig| {
                rig.with_simulated(|device| device.set_bus_voltage(7.0));
            },
            5,
        ),
        Fault::BusOverVoltage => chip(
            "the supply rises to 58 V",
            rig_in_contact,
            |rig| {
                rig.with_simulated(|device| device.set_bus_voltage(58.0));
            },
            5,
        ),
        Fault::GateDriver => chip(
            "a gate driver pulls its fault line",
            rig_in_contact,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().driver(1).latch_fault(1 << 2));
            },
            5,
        ),
        Fault::NotFinite => chip(
            "a stiffness in RAM overwritten with NaN",
            || {
                let mut rig = rig_in_contact();
                let feed_forward = FeedForward::Full;
                let gains = Gains { wall: 0, stiffness: MARKER_STIFFNESS, damping: 1.0, feed_forward, washout_hz: 2.0 };
                rig.tool.set_wall_gains(gains).expect("gains change");
                rig
            },
            |rig| {
                rig.while_stopped(|stopped| {
                    for at in (0x2000_0000..0x2002_0000).step_by(4) {
                        if stopped.word(at) == Some(MARKER_STIFFNESS.to_bits()) {
                            stopped.poke(at, f32::NAN.to_bits());
                        }
                    }
                });
            },
            5,
        ),
        Fault::Singularity => {
            chip("a hand pulls the linkage straight", rig_without_limits, |rig| push_tip(rig, [0.0, -3.0, 0.0]), 4_000)
        }
        Fault::HostLost => chip(
            "no message from the host for the 0.1 s that the rules allow",
            rig_in_contact,
            |rig| {
                change_rules(rig, |rules| {
                    rules.host_action = HostAction::Disarm;
                    rules.host_seconds = 0.1;
                })
            },
            500,
        ),
        Fault::Watchdog => chip(
            "a task that never returns",
            rig_in_contact,
            |rig| replace_task(rig, SUPERVISOR, |_| vec![0xE7FE_E7FE]),
            500,
        ),
        Fault::StackOverflow => chip(
            "a task that pushes registers in an infinite loop",
            rig_in_contact,
            |rig| replace_task(rig, SUPERVISOR, |_| vec![0xE7FD_B4FF]),
            500,
        ),
        Fault::HardFault => chip(
            "a task that runs into an undefined instruction",
            rig_in_contact,
            |rig| replace_task(rig, SUPERVISOR, |_| vec![0xDE00_DE00]),
            500,
        ),
        Fault::Panic => chip(
            "a task that jumps into the panic handler",
            rig_in_contact,
            |rig| {
                let handler =
                    firmware(rig.kind).find_ending("5reset12record_panic").expect("the panic handler").address as u32;
                // The code is `ldr.w pc, [pc, #0]`, then the address.
                replace_task(rig, SUPERVISOR, |_| vec![0xF000_F8DF, handler | 1]);
            },
            500,
        ),
        Fault::SettingsDamaged => chip(
            "one bit of a saved setting in flash flipped, then a reset",
            || {
                let mut rig = Rig::with_device(BoardKind::OdriveV3, FIVE_BAR, |_| ());
                rig.load("");
                for name in ["first name", "second name"] {
                    rig.tool.set_name(&name.try_into().expect("a short name")).expect("the board takes a name");
                    rig.tool.save().expect("the settings are written");
                }
                rig.home_and_arm();
                rig
            },
            |rig| {
                change_and_reset(rig, |stopped| stopped.flip_in_flash(SETTINGS_RANGE, b"second name"));
            },
            500,
        ),
        Fault::BreakInput => chip(
            "the break line pulled down",
            || free_rig_on(BoardKind::HBridgeF405),
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().fault_line_shorted = true);
            },
            5,
        ),
        Fault::PowerLimit => chip(
            "a hand that releases a wall while 1 mW is allowed",
            rig_in_contact,
            |rig| {
                change_rules(rig, |rules| rules.limits.power = 0.001);
                rig.with_simulated(|device| device.set_hand(Hand::none()));
            },
            500,
        ),
        Fault::KeyReleased => chip(
            "a key that is not reported as held again",
            rig_in_contact,
            |rig| {
                change_rules(rig, |rules| rules.host_seconds = 0.1);
                let known_step = rig.tool.status().expect("the board replies").step;
                rig.tool.hold_key(known_step).expect("a beat is never refused");
                rig.run(60 * MILLISECOND);
                // The host is alive, but reports an old state of the key.
                rig.tool.hold_key(known_step).expect("a beat is never refused");
            },
            500,
        ),
        Fault::PolarityWrong => chip(
            "a motor's two wires swapped",
            rig_with_swapped_motor,
            |rig| {
                rig.tool.check_polarity().expect("the check starts");
                rig.run(MILLISECOND);
            },
            10_000,
        ),
        Fault::PolarityNoMotion => chip(
            "a device that a firm hand holds",
            disarmed_rig,
            |rig| {
                rig.with_simulated(hold);
                rig.tool.check_polarity().expect("the check starts");
                rig.run(MILLISECOND);
            },
            10_000,
        ),
        Fault::TorqueMismatch => chip(
            "current sensors that show two thirds of the current, in the polarity check",
            disarmed_rig,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().faults.sensor_gain[..2].fill(0.67));
                rig.tool.check_polarity().expect("the check starts");
            },
            30_000,
        ),
        Fault::PolePairs => chip(
            "a three-phase motor with two pole pairs more than in the file",
            || {
                rig_with_other_motor("gimbal-paddle", |motor| {
                    motor.winding = Winding::ThreePhase { pole_pairs: 13, ratio: 1.0 };
                })
            },
            |rig| rig.tool.check_polarity().expect("the check starts"),
            20_000,
        ),
        Fault::ResistanceMismatch => chip(
            "a winding with twice the resistance in the file, in the polarity check",
            || rig_with_other_motor(FIVE_BAR, |motor| motor.resistance *= 2.0),
            |rig| rig.tool.check_polarity().expect("the check starts"),
            30_000,
        ),
        Fault::PolarityUnrest => chip(
            "a hand that moves the tip to and fro",
            disarmed_rig,
            |rig| {
                rig.with_simulated(|device| move_to_and_fro(device, 0.004, 6.0));
                rig.tool.check_polarity().expect("the check starts");
                rig.run(MILLISECOND);
            },
            6_000,
        ),
        Fault::StopMissing => chip(
            "a hand that moves the tip while a joint is pushed to its stop",
            rig_pushing_to_stop,
            |rig| push_tip(rig, [3.0, 3.0, 0.0]),
            400,
        ),
        Fault::SensorStale => chip(
            "a converter that is no longer triggered",
            rig_in_contact,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().chip.converters[0].hook.ignores_triggers = true);
            },
            5,
        ),
        Fault::ForceLimit => chip(
            "current sensors show 0.5 A too much while 0.1 N is allowed at the tip",
            || {
                let mut rig = free_rig();
                change_rules(&mut rig, |rules| rules.limits.tip_force = 0.1);
                rig.run(20 * MILLISECOND);
                rig
            },
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().faults.sensor_offset[..2].fill(0.5));
            },
            5,
        ),
        Fault::CurrentSensor => chip(
            "one of a motor's two shunts shows nothing while a hand pushes with 2.5 N",
            || pressed_rig(2.5),
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().faults.sensor_gain[0] = 0.0);
            },
            5,
        ),
        Fault::MotorModel => chip(
            "both current sensors of a motor show nothing",
            rig_in_contact,
            |rig| {
                rig.while_stopped(|stopped| {
                    stopped.hardware().faults.sensor_gain[0] = 0.0;
                    stopped.hardware().faults.sensor_gain[1] = 0.0;
                });
            },
            50,
        ),
        Fault::DriverReset => chip(
            "a gate driver that loses its settings while nothing pushes",
            free_rig,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().driver(0).reset_control_registers());
            },
            50,
        ),
        Fault::StrayCurrent => chip(
            "a bridge stuck at a duty of 20 % before arming",
            disarmed_rig,
            |rig| {
                rig.while_stopped(|stopped| stopped.hardware().faults.stuck_on[0] = Some(0.2));
                let _ = rig.tool.check_polarity();
            },
            500,
        ),
        Fault::ClockFailure => chip(
            "the crystal stops",
            rig_with_nmi_wire,
            |rig| {
                rig.while_stopped(|stopped| {
                    let at = VirtualNanos(stopped.at);
                    if stopped.hardware().chip.stop_crystal(at) {
                        stopped.poke(NMI_FLAG, 1 << 31);
                    }
                });
            },
            5,
        ),
        Fault::SupplyDip => chip(
            "the chip's 3.3 V fall to 2.7 V for 100 µs",
            rig_in_contact,
            |rig| {
                rig.while_stopped(|stopped| stopped.set_supply(2700));
                rig.run(100 * MICROSECOND);
                rig.while_stopped(|stopped| stopped.set_supply(3300));
            },
            5,
        ),
        Fault::ImageDamaged => chip(
            "one bit of the image in flash flipped, then a reset",
            disarmed_rig,
            |rig| change_and_reset(rig, |stopped| stopped.flip_in_flash(CODE_RANGE, b"odrive-v3")),
            500,
        ),
        Fault::WrongBoard => chip(
            "the wire from the bus divider to the chip's pin cut, then a reset",
            disarmed_rig,
            |rig| change_and_reset(rig, |stopped| stopped.hardware().is_bus_cut = true),
            500,
        ),
        Fault::RamDamaged => chip(
            "one bit of the stack flipped during the RAM test at a start",
            disarmed_rig,
            |rig| {
                change_and_reset(rig, |_| ());
                rig.run(MILLISECOND);
                rig.while_stopped(|stopped| {
                    let word = stopped.word(STACK_WORD).expect("there is RAM");
                    stopped.poke(STACK_WORD, word ^ 1 << 7);
                });
            },
            500,
        ),
    }
}

fn rig_with_narrow_limits() -> Rig {
    free_rig_within(0.1)
}

/// Returns a rig whose linkage becomes straight before a joint reaches its limit.
fn rig_without_limits() -> Rig {
    free_rig_within(PI)
}

/// Returns an armed rig without a hand, whose joints may turn by `angle` (rad) in each direction.
fn free_rig_within(angle: f64) -> Rig {
    let mut file = device_file(FIVE_BAR);
    let home = file.description.home.expect("a home pose");
    for (joint, home) in file.description.joints.iter_mut().zip(home) {
        joint.limits = Some((home - angle, home + angle));
    }
    let mut rig = Rig::with_file(BoardKind::OdriveV3, file, |_| ());
    rig.arm_near_walls("", &[NearWall { gap: 0.2, ..NearWall::with_normal([0.0, -1.0, 0.0]) }]);
    rig.with_simulated(|device| device.set_hand(Hand::none()));
    rig
}

/// Half the distance by which a hand moves the tip to turn a joint past its index mark, m.
const HALF_SWEEP_METRES: f64 = 0.015;

/// Starts a firm hand that moves the tip sideways, from `from` to `to` (m) relative to their midpoint.
fn sweep(device: &mut SimulatedDevice, from: f64, to: f64) {
    let [x, y, z] = device.tip();
    let path = [(0.0, x), (0.5, x + to - from)].map(|(time, x)| Waypoint { time, value: [x, y, z] });
    device.set_hand(Hand::new(firm_settings(), Intent::Follow(path.to_vec()), device.tip(), device.time()));
}

/// Returns an armed rig whose first joint was turned past its index mark once.
fn rig_with_index() -> Rig {
    let mut file = device_file(FIVE_BAR);
    let home = file.description.home.expect("a home pose");
    let mut period = 0;
    for (joint, home) in file.description.joints.iter_mut().zip(home) {
        if let Some(encoder) = &mut joint.encoder {
            encoder.offset = home;
            period = encoder.counts_per_turn as i32;
        }
    }
    let mut rig = Rig::with_file(BoardKind::OdriveV3, file, |_| ());
    rig.arm_near_walls("", &[NearWall { gap: 0.2, ..NearWall::with_normal([0.0, -1.0, 0.0]) }]);
    change_rules(&mut rig, |rules| rules.index_period = [period, period, 0]);
    rig.with_simulated(|device| sweep(device, 0.0, HALF_SWEEP_METRES));
    rig.run(SECOND);
    rig.with_simulated(|device| sweep(device, HALF_SWEEP_METRES, -HALF_SWEEP_METRES));
    rig.run(SECOND);
    rig
}

/// Returns a rig that pushes its first joint to a stop 0.4 rad from home, half a second after it began.
fn rig_pushing_to_stop() -> Rig {
    let mut file = device_file(FIVE_BAR);
    let home = file.description.home.expect("a home pose");
    for (joint, home) in file.description.joints.iter_mut().zip(home) {
        joint.limits = Some((home - 0.4, home + 0.4));
    }
    file.description.homing = Homing::Stop(home.map(|home| home + 0.4));
    let mut rig = Rig::with_file(BoardKind::OdriveV3, file, |_| ());
    rig.load("");
    rig.tool.home().expect("roughly at home");
    rig.check_polarity();
    rig.run(SECOND);
    // The first report of the key reads the present step.
    rig.tool.hold_key(0).expect("the board replies");
    let seen = rig.tool.step();
    rig.tool.find_stops(seen).expect("homing starts");
    for _ in 0..5 {
        rig.run(100 * MILLISECOND);
        let seen = rig.tool.step();
        rig.tool.hold_key(seen).expect("the board replies");
    }
    rig
}

/// Returns a rig whose first motor turns against the direction in the device file.
fn rig_with_swapped_motor() -> Rig {
    rig_with_other_motor(FIVE_BAR, |motor| {
        motor.torque_constant = -motor.torque_constant;
        motor.back_emf = -motor.back_emf;
    })
}

/// Returns a homed board whose first motor is not the one in the file of `device`.
fn rig_with_other_motor(device: &str, change: impl FnOnce(&mut Motor<f64>)) -> Rig {
    let file = device_file(device);
    let mut wired = file.clone();
    wired.description.joints[0].motor.as_mut().map(change);
    let mut rig = Rig::with_file(BoardKind::OdriveV3, wired, |_| ());
    rig.file = Some(file);
    rig.load("");
    rig.tool.home().expect("homed");
    rig
}

/// Runs until `microseconds` after a crest.
pub fn after_crest(rig: &Rig, microseconds: u64) {
    let now = rig.now();
    let crest =
        rig.while_stopped(|stopped| stopped.hardware().chip.advanced[0].hook.crest()).expect("the carrier runs");
    let period = 50 * MICROSECOND;
    let next = crest + ((now - crest) / period + 1) * period + microseconds * MICROSECOND;
    rig.run(next - now);
}
