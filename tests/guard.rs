//! Every fault turns the motors off within one control period, stays latched, and clears.
//!
//! The control step detects faults in its samples (counts, currents, voltages, time), which these tests change. Faults
//! that hardware or other firmware detects reach the control loop through `ControlLoop::trip`. The tests of emulator/
//! provoke those faults on the emulated chip. A fault without an origin does not compile here.

use crate::rig::{self, BoxedProgram, RATE_HZ, Rig, far_wall, five_bar, hardware, paddle, rules, scene, wall};
use haptic_bridge::control::joints::Counts;
use haptic_bridge::control::{Beat, Command, HostAction, Press};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;

/// Place where a fault is detected.
enum Origin {
    /// Detected by the control step. The function returns an armed board just before that step.
    Step(fn() -> Rig),
    /// Detected outside the control step and reported to the control loop.
    Report,
}

/// Runs a polarity check of a motor with `factor` times the torque of its file and a winding of `resistance` ohm.
fn run_polarity_check(factor: f64, resistance: f32) -> Rig {
    let mut rig = Rig::homed_paddle(&far_wall());
    rig.resistance = resistance;
    rig.execute(Command::CheckPolarity).unwrap();
    rig::Body::new(&rig::paddle()).run_check(&mut rig, factor);
    rig
}

fn origin(fault: Fault) -> Origin {
    use Origin::{Report, Step};
    match fault {
        Fault::EncoderJump => Step(|| {
            let mut rig = Rig::armed_paddle();
            rig.samples.counts[0] += 4_000;
            rig
        }),
        Fault::EncoderStall => Step(|| {
            let mut rig = Rig::pressed_paddle(255.0);
            let steps = (5.0 * RATE_HZ) as u32;
            for _ in 0..steps {
                rig.step();
                if rig.state() == State::Fault {
                    break;
                }
            }
            rig
        }),
        Fault::EncoderLoss => Step(|| {
            // A hand turns the motor at 10 rad/s, so the current loop must oppose 1 V of back-EMF.
            let mut rig = Rig::armed_paddle();
            for _ in 0..(0.5 * RATE_HZ) as u32 {
                rig.shown_current = Some(-0.05);
                rig.step();
                if rig.state() == State::Fault {
                    break;
                }
            }
            rig
        }),
        Fault::IndexMismatch => Step(|| {
            let mut rig = Rig::armed_with_rules(|rules| rules.index_period[0] = 60_000);
            rig.marks = Some([Some(1_000), None, None]);
            rig.step();
            assert_eq!(rig.fault(), None, "the first index sets the position");
            rig.marks = Some([Some(1_012), None, None]);
            rig
        }),
        Fault::JointLimit => Step(|| {
            let mut rig = Rig::armed_paddle();
            rig.turn(0, 0.9999, 5.0);
            rig.samples.counts[0] += 3;
            rig
        }),
        Fault::SpeedLimit => Step(|| {
            let mut rig = Rig::armed_paddle();
            rig.turn(0, 0.6, 30.0);
            rig
        }),
        Fault::ForceLimit => Step(|| {
            // The motor has current although no force is commanded.
            let mut rig = Rig::armed_with_rules(|rules| rules.limits.tip_force = 0.02);
            for _ in 0..(0.01 * RATE_HZ) as u32 {
                rig.shown_current = Some(0.2);
                rig.step();
                if rig.state() == State::Fault {
                    break;
                }
            }
            rig
        }),
        Fault::OverCurrent => Step(|| {
            let mut rig = Rig::armed_paddle();
            rig.shown_current = Some(6.0);
            rig
        }),
        Fault::ThermalBudget => Step(|| {
            let mut rig = Rig::pressed_paddle(290.0);
            rig.hold_in_place(10.0);
            rig
        }),
        Fault::BusUnderVoltage => Step(|| {
            let mut rig = Rig::armed_paddle();
            rig.samples.bus_voltage = 9.9;
            rig
        }),
        Fault::BusOverVoltage => Step(|| {
            let mut rig = Rig::armed_paddle();
            rig.samples.bus_voltage = 28.1;
            rig
        }),
        Fault::NotFinite => Step(|| {
            let mut rig = Rig::armed_paddle();
            rig.shown_current = Some(f32::NAN);
            rig
        }),
        Fault::Singularity => Step(|| {
            let description = five_bar();
            let mut rig = Rig::new(&description, &scene(2, &[]), hardware(), rules());
            rig.arm();
            // Both cranks turn outwards until the distal links are in one line.
            let mut angle = 0.0;
            while rig.state() == State::Armed && angle < 1.0 {
                angle += 0.001;
                let counts = (angle / core::f64::consts::TAU * rig::COUNTS_PER_TURN) as i32;
                rig.samples.counts = Counts([counts, -counts, 0]);
                rig.step();
            }
            rig
        }),
        Fault::HostLost => Step(|| {
            let mut rig = Rig::armed_with_rules(|rules| rules.host_action = HostAction::Disarm);
            rig.execute(Command::Beat(Beat::Here)).unwrap();
            rig.run(0.5);
            rig
        }),
        Fault::KeyReleased => Step(|| {
            let mut rig = Rig::armed_paddle();
            let press = Press { holder: 7, seen: rig.control_loop.steps() };
            for _ in 0..5 {
                rig.execute(Command::Beat(Beat::Held(press))).unwrap();
                rig.run(0.1);
            }
            rig
        }),
        Fault::PowerLimit => Step(|| {
            // The wall pushes the paddle out with the full torque at 10 rad/s, which is 3 W of the allowed 2 W.
            let mut rig = Rig::homed_paddle(&scene(1, &[wall(0.09, 100_000.0)]));
            rig.turn(0, 0.95, 5.0);
            rig.settle();
            rig.arm();
            rig.turn(0, -0.8, 5.0);
            rig.turn(0, 0.85, 10.0);
            rig
        }),
        Fault::CurrentSensor => Step(|| {
            let mut rig = Rig::pressed_paddle(250.0);
            rig.imbalance[0] = 1.0;
            rig
        }),
        Fault::MotorModel => Step(|| {
            let mut rig = Rig::pressed_paddle(250.0);
            rig.shown_current = Some(0.0);
            rig.run(0.001);
            rig
        }),
        Fault::PolarityWrong => Step(|| run_polarity_check(-1.0, 2.0)),
        Fault::PolarityNoMotion => Step(|| {
            let mut rig = Rig::homed_paddle(&far_wall());
            rig.execute(Command::CheckPolarity).unwrap();
            rig.run(2.2);
            rig
        }),
        Fault::TorqueMismatch => Step(|| run_polarity_check(1.5, 2.0)),
        Fault::ResistanceMismatch => Step(|| run_polarity_check(1.0, 3.0)),
        Fault::StopMissing => Step(|| {
            let mut rig = Rig::new(&rig::paddle_with_stop(), &far_wall(), hardware(), rules());
            rig.execute(Command::FindStops(rig.press())).unwrap();
            while rig.state() == State::Homing {
                rig.hold_key(1);
            }
            rig
        }),
        Fault::PolarityUnrest => Step(|| {
            let mut rig = Rig::homed_paddle(&far_wall());
            rig.execute(Command::CheckPolarity).unwrap();
            for step in 0..(5.1 * RATE_HZ) as u32 {
                rig.samples.counts[0] += i32::from(step % 4 == 0);
                rig.step();
                if rig.state() == State::Fault {
                    break;
                }
            }
            rig
        }),
        Fault::ControlOverrun
        | Fault::EncoderIllegal
        | Fault::GateDriver
        | Fault::Watchdog
        | Fault::StackOverflow
        | Fault::SettingsDamaged
        | Fault::HardFault
        | Fault::Panic
        | Fault::BreakInput
        | Fault::SensorStale
        | Fault::DriverReset
        | Fault::StrayCurrent
        | Fault::ClockFailure
        | Fault::SupplyDip
        | Fault::ImageDamaged
        | Fault::RamDamaged
        | Fault::WrongBoard
        // A three-phase motor and an absolute encoder, which this rig does not have.
        | Fault::PolePairs
        | Fault::EncoderFrames => Report,
    }
}

/// Returns the time until the bridges are off, as docs/faults.csv describes it.
fn off_time(fault: Fault) -> &'static str {
    match fault {
        Fault::ControlOverrun
        | Fault::EncoderJump
        | Fault::EncoderIllegal
        | Fault::IndexMismatch
        | Fault::JointLimit
        | Fault::OverCurrent
        | Fault::BusUnderVoltage
        | Fault::BusOverVoltage
        | Fault::GateDriver
        | Fault::NotFinite
        | Fault::Singularity
        | Fault::SensorStale
        | Fault::CurrentSensor => "the same period",
        Fault::EncoderStall => "after 5 s of it",
        Fault::EncoderLoss => "as the motor's model shows it, or after 50 ms of it",
        Fault::SpeedLimit => "as a filter of 200 Hz reports it",
        Fault::ForceLimit => "as a mean over 0.5 ms exceeds it",
        Fault::ThermalBudget => "when the budget is spent",
        Fault::HostLost => "after the time in the rules",
        Fault::KeyReleased => "0.5 s after it was seen down, or the time in the rules where that is less",
        Fault::Watchdog => "by the reset",
        Fault::StackOverflow | Fault::HardFault => "by the exception",
        Fault::SettingsDamaged | Fault::StrayCurrent | Fault::ImageDamaged | Fault::RamDamaged | Fault::WrongBoard => {
            "never on: seen before arming"
        }
        Fault::Panic => "by the handler",
        Fault::BreakInput => "by hardware",
        Fault::PowerLimit => "by a mean over 0.1 s",
        Fault::PolarityNoMotion => "when its torque has grown and alternated in vain: some seconds",
        Fault::StopMissing => "when the joint stood still, or moved too far: some seconds",
        Fault::PolarityUnrest => "never on: a joint is waited for without torque",
        Fault::PolarityWrong | Fault::TorqueMismatch | Fault::ResistanceMismatch | Fault::PolePairs => {
            "when the joint was swung: some seconds"
        }
        Fault::EncoderFrames => "in the third carrier period",
        Fault::MotorModel => "as the loop's integrator grows: some 0.2 ms",
        Fault::DriverReset => "at the next look, within 20 ms (0.2 s while a host that stops reading is waited for)",
        Fault::ClockFailure => "by the non-maskable interrupt",
        Fault::SupplyDip => "by the supply monitor's interrupt",
    }
}

fn faults_table() -> String {
    let mut table = String::from("code,fault,what it says,motors off,remedy\n");
    for fault in Fault::ALL {
        let words = [fault.what(), off_time(*fault), fault.remedy()];
        assert!(words.iter().all(|words| !words.contains('"')), "{words:?}");
        let [what, off, remedy] = words;
        table += &format!("{},{},\"{what}\",\"{off}\",\"{remedy}\"\n", fault.code(), fault.name());
    }
    table
}

#[test]
fn an_index_may_lag_by_the_joints_motion_and_is_set_at_rest() {
    let fault = |first: (i32, i32), second: (i32, i32)| {
        let mut rig = Rig::armed_with_rules(|rules| rules.index_period[0] = 60_000);
        let mut counts = 0;
        for (moved, index) in [first, second] {
            for seen in [None, Some(index)] {
                counts += moved;
                rig.samples.counts[0] = counts;
                rig.marks = seen.map(|count| [Some(count), None, None]);
                rig.step();
            }
        }
        rig.fault()
    };
    // Two index positions may differ by the pulse's width of 8 counts, plus the 20 counts that the joint moves.
    assert_eq!(fault((0, 1_000), (0, 1_008)), None);
    assert_eq!(fault((0, 1_000), (0, 1_009)), Some(Fault::IndexMismatch));
    assert_eq!(fault((0, 1_000), (20, 1_028)), None);
    assert_eq!(fault((0, 1_000), (20, 1_029)), Some(Fault::IndexMismatch));
    // A first pulse during fast motion does not set the position.
    assert_eq!(fault((20, 1_000), (0, 1_100)), None);
    // An index one turn of 60,000 counts further is the same position.
    assert_eq!(fault((0, 1_000), (0, 61_003)), None);
}

/// A current sensor's offset with the bridges off remains as an error that no limit on measured currents bounds.
#[test]
fn a_sensor_offset_of_half_the_tip_force_limit_prevents_arming() {
    let result = |current: f32, command: fn() -> Command<BoxedProgram>| {
        let mut rig = Rig::new(&paddle(), &far_wall(), hardware(), rules());
        // Tip force per ampere, N/A.
        let force = paddle().joints[0].motor.unwrap().torque_constant / paddle().geometry[0];
        rig.rules.limits.tip_force = (2.0 * 0.1 * force) as f32;
        let rules = rig.rules;
        rig.execute(Command::Rules(rules)).unwrap();
        rig.shown_current = Some(current);
        rig.settle();
        let reply = rig.execute(command());
        (reply.err(), rig.control_loop.status().fault.map(|record| (record.fault, record.axis)))
    };
    for command in [|| Command::Arm, || Command::CheckPolarity] {
        assert_eq!(result(0.095, command), (None, None));
        let found = (Some(Refusal::Faulted(Fault::StrayCurrent)), Some((Fault::StrayCurrent, Some(0))));
        assert_eq!(result(-0.105, command), found);
    }
}

/// The currents get time to settle after a limit is lowered, but not after every repetition.
#[test]
fn repeated_rules_do_not_suspend_the_force_limit() {
    let mut rig = Rig::armed_with_rules(|rules| rules.limits.tip_force = 0.2);
    rig.rules.limits.tip_force = 0.1;
    let settling = |rig: &Rig| {
        let all = format!("{:?}", rig.control_loop);
        let rest = all.split_once("settling_seconds: ").expect("the settling time").1;
        rest[..rest.find([',', ' ']).expect("its end")].parse::<f32>().expect("a number")
    };
    for step in 0..(0.02 * RATE_HZ) as u32 {
        if step % (0.002 * RATE_HZ) as u32 == 0 {
            let rules = rig.rules;
            rig.execute(Command::Rules(rules)).expect("rules that are not looser");
            assert!(step > 0 || settling(&rig) > 0.0);
        }
        rig.step();
    }
    assert!(settling(&rig) <= 0.0, "{}", settling(&rig));
}

/// `UPDATE_DOCS=1 cargo test guard` rewrites the table.
#[test]
fn the_documented_table_of_faults_agrees_with_the_code() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/faults.csv");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, faults_table()).expect("docs/faults.csv can be written");
    } else {
        let committed = std::fs::read_to_string(&path).expect("docs/faults.csv exists");
        assert_eq!(committed, faults_table(), "run UPDATE_DOCS=1 cargo test guard");
    }
}

/// Returns a board with this fault, a few steps after the cause.
fn rig_with_fault(fault: Fault) -> Rig {
    match origin(fault) {
        Origin::Step(prepare) => {
            let mut rig = prepare();
            // The polarity check acts one crest after its request.
            for _ in 0..3 {
                if rig.state() != State::Fault {
                    rig.step();
                }
            }
            rig
        }
        Origin::Report => {
            let mut rig = Rig::armed_paddle();
            rig.reported_fault = Some((fault, None, 1.0));
            rig.step();
            rig
        }
    }
}

#[test]
fn every_fault_can_be_provoked_and_is_reported_as_itself() {
    for fault in Fault::ALL {
        let rig = rig_with_fault(*fault);
        assert_eq!(rig.fault(), Some(*fault), "{}", fault.name());
    }
}

#[test]
fn motors_are_off_in_the_control_period_of_any_fault() {
    for fault in Fault::ALL {
        let rig = rig_with_fault(*fault);
        assert!(rig.motors_are_off(), "{}: {:?} {:?}", fault.name(), rig.outputs, rig.duties);
    }
}

#[test]
fn a_sudden_cause_turns_the_motors_off_in_one_step() {
    let sudden = [
        Fault::EncoderJump,
        Fault::OverCurrent,
        Fault::BusUnderVoltage,
        Fault::BusOverVoltage,
        Fault::NotFinite,
        Fault::IndexMismatch,
        Fault::JointLimit,
    ];
    for fault in sudden {
        let Origin::Step(prepare) = origin(fault) else { panic!("the step must find {}", fault.name()) };
        let mut rig = prepare();
        assert!(rig.outputs.bridges, "{}: must be armed before", fault.name());
        rig.step();
        assert!(rig.motors_are_off() && rig.state() == State::Fault, "{}", fault.name());
    }
}

#[test]
fn a_fault_outlasts_its_cause_and_the_first_one_is_reported() {
    for fault in Fault::ALL {
        let mut rig = rig_with_fault(*fault);
        let record = rig.control_loop.status().fault;
        rig.shown_current = None;
        rig.samples.bus_voltage = 24.0;
        rig.settle();
        rig.reported_fault = Some((Fault::SensorStale, None, 7.0));
        rig.step();
        assert!(rig.motors_are_off() && rig.state() == State::Fault, "{}", fault.name());
        let reported = rig.control_loop.status().fault;
        assert_eq!(
            reported.map(|r| (r.fault, r.axis, r.step)),
            record.map(|r| (r.fault, r.axis, r.step)),
            "{}",
            fault.name()
        );
        assert!(rig.execute(Command::Arm).is_err(), "{}", fault.name());
    }
}

#[test]
fn clearing_ends_every_fault_and_leaves_the_motors_off() {
    for fault in Fault::ALL {
        let mut rig = rig_with_fault(*fault);
        rig.shown_current = None;
        rig.samples.bus_voltage = 24.0;
        rig.execute(Command::Clear).unwrap();
        rig.settle();
        assert_eq!((rig.state(), rig.fault()), (State::Disarmed, None), "{}", fault.name());
        assert!(rig.motors_are_off(), "{}", fault.name());
    }
}

#[test]
fn faults_that_lose_counts_lose_homing_too() {
    for fault in
        [Fault::EncoderJump, Fault::EncoderLoss, Fault::EncoderIllegal, Fault::EncoderStall, Fault::IndexMismatch]
    {
        assert!(!rig_with_fault(fault).control_loop.status().homed, "{}", fault.name());
    }
    assert!(rig_with_fault(Fault::OverCurrent).control_loop.status().homed);
}

/// `cargo xtask faults` writes the result of each injection into docs/results/faults.csv. A fault without an injector
/// does not compile in emulator/src/inject.rs.
#[test]
fn every_fault_was_injected_or_its_row_has_a_reason() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/results/faults.csv");
    let text = std::fs::read_to_string(&path).expect("docs/results/faults.csv exists");
    for fault in Fault::ALL {
        let begin = format!("{},{},", fault.code(), fault.name());
        let mut rows = text.lines().filter_map(|line| line.strip_prefix(&begin));
        let (Some(row), None) = (rows.next(), rows.next()) else { panic!("{} must have one row", fault.name()) };
        // Only the first of the three cells may contain commas.
        let mut cells = row.rsplitn(3, ',').map(str::trim);
        let [seen, cause, how] = std::array::from_fn(|_| cells.next().unwrap_or_default());
        let complete = match how.strip_prefix("not possible:") {
            Some(why) => !why.trim().is_empty(),
            None => !how.is_empty() && !cause.is_empty() && !seen.is_empty(),
        };
        assert!(complete, "incomplete row: {row}");
    }
    assert_eq!(text.lines().count(), Fault::ALL.len() + 1, "a header and one row per fault");
    assert_eq!(
        text.lines().filter(|line| line.contains("not possible:")).count(),
        1,
        "only EncoderIllegal cannot be injected"
    );
}

#[test]
fn codes_and_names_are_unique_and_every_fault_has_a_remedy() {
    for (i, fault) in Fault::ALL.iter().enumerate() {
        assert!(!fault.what().is_empty() && !fault.remedy().is_empty(), "{}", fault.name());
        for other in &Fault::ALL[..i] {
            assert!(other.code() < fault.code() && other.name() != fault.name());
        }
    }
}
