//! Every fault turns the motors off within one control period, stays latched, and clears.
//!
//! Faults that the control step finds are provoked by what it is shown (counts, currents, voltages, time); those that
//! hardware or another part of the firmware finds reach the step as [`Samples::fault`] and are provoked on the emulated
//! chip by the tests of emulator/. A fault that is neither does not compile here.

mod rig;

use haptic_bridge::drive::heat::Heat;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::joints::{Counts, Currents};
use haptic_bridge::servo::{Command, HostAction, Rules};
use rig::{RATE, Rig, five_bar, hardware, limits, paddle, rules, scene, wall};

/// How a fault is provoked.
enum Origin {
    /// The step sees it; the function arms a board and brings it to the step before.
    Step(fn() -> Rig),
    /// Found outside the step, which is told.
    Told,
}

fn quiet() -> Scene<f32> {
    scene(1, &[wall(-0.05, 1_000.0)])
}

fn with_rules(change: impl Fn(&mut Rules)) -> Rig {
    let mut rules = rules();
    change(&mut rules);
    let mut rig = Rig::with(&paddle(), &quiet(), hardware(), rules);
    rig.arm();
    rig
}

/// Rests 1 cm deep in a wall: 255 N/m there take 85 % of the motor's torque.
fn pressing(stiffness: f32) -> Rig {
    let mut rig = Rig::ready(&scene(1, &[wall(-0.005, stiffness)]));
    rig.arm();
    rig.turn(0, -0.15, 1.0);
    rig
}

fn origin(fault: Fault) -> Origin {
    use Origin::{Step, Told};
    match fault {
        Fault::EncoderJump => Step(|| {
            let mut rig = Rig::armed();
            rig.samples.counts[0] += 4_000;
            rig
        }),
        Fault::EncoderStall => Step(|| {
            let mut rig = pressing(255.0);
            let steps = (5.0 * RATE) as u32;
            for _ in 0..steps {
                rig.step();
                if rig.state() == State::Fault {
                    break;
                }
            }
            rig
        }),
        Fault::EncoderLoss => Step(|| {
            // A hand turns the motor at 10 rad/s: the current loop has to hold 1 V of back-EMF against it.
            let mut rig = Rig::armed();
            for _ in 0..(0.5 * RATE) as u32 {
                rig.shown_current = Some(-0.05);
                rig.step();
                if rig.state() == State::Fault {
                    break;
                }
            }
            rig
        }),
        Fault::IndexMismatch => Step(|| {
            let mut rig = with_rules(|rules| rules.index_period[0] = 60_000);
            rig.samples.index[0] = Some(1_000);
            rig.step();
            assert_eq!(rig.fault(), None, "the first index is where it is");
            rig.samples.index[0] = Some(1_012);
            rig
        }),
        Fault::JointLimit => Step(|| {
            let mut rig = Rig::armed();
            rig.turn(0, 0.9999, 5.0);
            rig.samples.counts[0] += 3;
            rig
        }),
        Fault::SpeedLimit => Step(|| {
            let mut rig = Rig::armed();
            rig.turn(0, 0.6, 30.0);
            rig
        }),
        Fault::OverCurrent => Step(|| {
            let mut rig = Rig::armed();
            rig.shown_current = Some(6.0);
            rig
        }),
        Fault::ThermalBudget => Step(|| {
            let mut rig = pressing(290.0);
            rig.tremble(10.0);
            rig
        }),
        Fault::BusUnderVoltage => Step(|| {
            let mut rig = Rig::armed();
            rig.samples.bus_voltage = 9.9;
            rig
        }),
        Fault::BusOverVoltage => Step(|| {
            let mut rig = Rig::armed();
            rig.samples.bus_voltage = 28.1;
            rig
        }),
        Fault::NotFinite => Step(|| {
            let mut rig = Rig::armed();
            rig.shown_current = Some(f32::NAN);
            rig
        }),
        Fault::Singularity => Step(|| {
            let description = five_bar();
            let mut rig = Rig::with(&description, &scene(2, &[]), hardware(), rules());
            rig.arm();
            // Both cranks outward: the elbows drift apart until the distal links lie in one line.
            let mut angle = 0.0;
            while rig.state() == State::Armed && angle < 1.0 {
                angle += 0.001;
                let counts = (angle / core::f64::consts::TAU * rig::COUNTS) as i32;
                rig.samples.counts = Counts([counts, -counts, 0]);
                rig.step();
            }
            rig
        }),
        Fault::HostLost => Step(|| {
            let mut rig = with_rules(|rules| rules.host_action = HostAction::Disarm);
            rig.execute(Command::HostAlive).unwrap();
            rig.run(0.5);
            rig
        }),
        Fault::PowerLimit => Step(|| {
            // Pushes out of the wall at full torque with 10 rad/s: 3 W, 2 W allowed.
            let mut rig = Rig::ready(&scene(1, &[wall(0.09, 100_000.0)]));
            rig.turn(0, 0.95, 5.0);
            rig.settle();
            rig.arm();
            rig.turn(0, -0.8, 5.0);
            rig.turn(0, 0.85, 10.0);
            rig
        }),
        Fault::CurrentSensor => Step(|| {
            let mut rig = pressing(250.0);
            rig.imbalance[0] = 1.0;
            rig
        }),
        Fault::MotorModel => Step(|| {
            let mut rig = pressing(250.0);
            rig.shown_current = Some(0.0);
            rig.run(0.001);
            rig
        }),
        Fault::PolarityWrong => Step(|| {
            let mut rig = Rig::ready(&quiet());
            rig.execute(Command::CheckPolarity).unwrap();
            rig.run(0.3);
            rig.turn(0, -0.025, 1.0);
            rig
        }),
        Fault::PolarityNoMotion => Step(|| {
            let mut rig = Rig::ready(&quiet());
            rig.execute(Command::CheckPolarity).unwrap();
            rig.run(2.2);
            rig
        }),
        Fault::PolarityUnrest => Step(|| {
            let mut rig = Rig::ready(&quiet());
            rig.execute(Command::CheckPolarity).unwrap();
            for step in 0..(5.1 * RATE) as u32 {
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
        | Fault::RamDamaged => Told,
    }
}

/// How it is provoked and how soon the bridges are off, in words, for docs/safety.md.
fn injection(fault: Fault) -> (&'static str, &'static str) {
    let at_once = "the same period";
    match fault {
        Fault::ControlOverrun => ("a step made longer than its period", at_once),
        Fault::EncoderJump => ("4000 counts between two samples", at_once),
        Fault::EncoderStall => ("85 % of the motor's torque and not one count", "after 5 s of it"),
        Fault::EncoderLoss => ("back-EMF without counts", "as the motor's model shows it, or after 50 ms of it"),
        Fault::EncoderIllegal => ("both lines change at once", at_once),
        Fault::IndexMismatch => ("an index 12 counts beside the first", at_once),
        Fault::JointLimit => ("a joint turned past its limit", at_once),
        Fault::SpeedLimit => ("30 rad/s where 20 are allowed", "as a filter of 200 Hz reports it"),
        Fault::OverCurrent => ("6 A measured where 3 are allowed", at_once),
        Fault::ThermalBudget => ("2.9 A where 1 A may flow for ever", "when the budget is spent"),
        Fault::BusUnderVoltage => ("9.9 V where 10 are needed", at_once),
        Fault::BusOverVoltage => ("28.1 V where 28 are allowed", at_once),
        Fault::GateDriver => ("the driver's fault pin", at_once),
        Fault::NotFinite => ("a current that is not a number", at_once),
        Fault::Singularity => ("elbows turned until the distal links are in line", at_once),
        Fault::HostLost => ("no heartbeat", "after the time in the rules"),
        Fault::Watchdog => ("a task that stops", "by the reset"),
        Fault::StackOverflow => ("a stack that reaches its guard", "by the exception"),
        Fault::SettingsDamaged => ("entries with a wrong checksum at boot", "never on: seen before arming"),
        Fault::HardFault => ("an access to nowhere", "by the exception"),
        Fault::Panic => ("a panic in a task", "by the handler"),
        Fault::BreakInput => ("the break pin", "by hardware"),
        Fault::PowerLimit => ("3 W into the hand where 2 are allowed", "by a mean over 0.1 s"),
        Fault::PolarityWrong => ("a joint that turns backward", at_once),
        Fault::PolarityNoMotion => ("a joint that does not turn", "after 2 s of it"),
        Fault::PolarityUnrest => ("a joint that a hand turns evenly", "never on: a joint is waited for without torque"),
        Fault::SensorStale => ("a converter that stops", at_once),
        Fault::CurrentSensor => ("1 A between two sensors of a motor of 3 A", at_once),
        Fault::MotorModel => ("a current sensor that shows none", "as the loop's integrator grows: some 0.2 ms"),
        Fault::DriverReset => (
            "a driver's register that reads other than it was written",
            "at the next look, within 20 ms (0.2 s while a host that stops reading is waited for)",
        ),
        Fault::StrayCurrent => ("more than 0.5 A with the bridges off", "never on: seen before arming"),
        Fault::ClockFailure => ("a crystal that stops", "by the non-maskable interrupt"),
        Fault::SupplyDip => ("3.3 V that fall below 2.9 V", "by the supply monitor's interrupt"),
        Fault::ImageDamaged => ("a bit of flash that changed", "never on: seen before arming"),
        Fault::RamDamaged => ("a word of RAM that changed", "never on: seen before arming"),
    }
}

/// The table of docs/safety.md.
fn table() -> String {
    let mut table = String::from(
        "| code | fault | what it says | provoked by | found by | motors off | remedy |\n|--:|---|---|---|---|---|---|\n",
    );
    for fault in Fault::ALL {
        let by = match origin(*fault) {
            Origin::Step(_) => "the control step",
            Origin::Told => "the firmware",
        };
        let (cause, off) = injection(*fault);
        table += &format!(
            "| {} | {} | {} | {cause} | {by} | {off} | {} |\n",
            fault.code(),
            fault.name(),
            fault.what(),
            fault.remedy()
        );
    }
    table
}

/// `UPDATE_DOCS=1 cargo test --test guard` writes it anew.
#[test]
fn an_index_may_come_late_by_what_the_joint_moved_and_is_learned_only_at_rest() {
    let shown = |first: (i32, i32), second: (i32, i32)| {
        let mut rig = with_rules(|rules| rules.index_period[0] = 60_000);
        let mut counts = 0;
        for (moved, index) in [first, second] {
            for seen in [None, Some(index)] {
                counts += moved;
                rig.samples.counts[0] = counts;
                rig.samples.index[0] = seen;
                rig.step();
            }
        }
        rig.fault()
    };
    // 8 counts beside the first are the width of two pulses, 20 more are what the joint moved since the pulse.
    assert_eq!(shown((0, 1_000), (0, 1_008)), None);
    assert_eq!(shown((0, 1_000), (0, 1_009)), Some(Fault::IndexMismatch));
    assert_eq!(shown((0, 1_000), (20, 1_028)), None);
    assert_eq!(shown((0, 1_000), (20, 1_029)), Some(Fault::IndexMismatch));
    // A first pulse that was passed fast may itself be wrong by as much.
    assert_eq!(shown((20, 1_000), (0, 1_100)), None);
    // A whole turn further is the same place.
    assert_eq!(shown((0, 1_000), (0, 61_003)), None);
}

#[test]
fn the_table_in_the_documentation_is_the_table_of_the_code() {
    const BEGIN: &str = "<!-- faults: written by tests/guard.rs -->\n";
    const END: &str = "<!-- end of faults -->\n";
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/safety.md");
    let text = std::fs::read_to_string(&path).expect("docs/safety.md is there");
    let (head, rest) = text.split_once(BEGIN).expect("the table's begin");
    let (committed, tail) = rest.split_once(END).expect("the table's end");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, format!("{head}{BEGIN}{}{END}{tail}", table())).expect("docs/safety.md can be written");
    } else {
        assert_eq!(committed, table(), "run UPDATE_DOCS=1 cargo test --test guard");
    }
}

/// A board with this fault, one step after its cause.
fn provoked(fault: Fault) -> Rig {
    match origin(fault) {
        Origin::Step(prepare) => {
            let mut rig = prepare();
            if rig.state() != State::Fault {
                rig.step();
            }
            if rig.state() != State::Fault {
                rig.step();
            }
            rig
        }
        Origin::Told => {
            let mut rig = Rig::armed();
            rig.samples.fault = Some((fault, None, 1.0));
            rig.step();
            rig
        }
    }
}

#[test]
fn every_fault_can_be_provoked_and_is_named_as_itself() {
    for fault in Fault::ALL {
        let rig = provoked(*fault);
        assert_eq!(rig.fault(), Some(*fault), "{}", fault.name());
    }
}

#[test]
fn motors_are_off_in_the_very_period_of_any_fault() {
    for fault in Fault::ALL {
        let rig = provoked(*fault);
        assert!(rig.motors_off(), "{}: {:?} {:?}", fault.name(), rig.outputs, rig.duties);
    }
}

#[test]
fn a_sudden_cause_needs_one_step_and_no_more() {
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
        let Origin::Step(prepare) = origin(fault) else { panic!("{} is found by the step", fault.name()) };
        let mut rig = prepare();
        assert!(rig.outputs.bridges, "{}: armed before", fault.name());
        rig.step();
        assert!(rig.motors_off() && rig.state() == State::Fault, "{}", fault.name());
    }
}

#[test]
fn a_fault_stays_when_its_cause_is_gone_and_the_first_one_is_told() {
    for fault in Fault::ALL {
        let mut rig = provoked(*fault);
        let record = rig.servo.status().fault;
        rig.shown_current = None;
        rig.samples.bus_voltage = 24.0;
        rig.settle();
        rig.samples.fault = Some((Fault::SensorStale, None, 7.0));
        rig.step();
        assert!(rig.motors_off() && rig.state() == State::Fault, "{}", fault.name());
        let told = rig.servo.status().fault;
        assert_eq!(
            told.map(|r| (r.fault, r.axis, r.step)),
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
        let mut rig = provoked(*fault);
        rig.shown_current = None;
        rig.samples.bus_voltage = 24.0;
        rig.samples.fault = None;
        rig.execute(Command::Clear).unwrap();
        rig.settle();
        assert_eq!((rig.state(), rig.fault()), (State::Disarmed, None), "{}", fault.name());
        assert!(rig.motors_off(), "{}", fault.name());
    }
}

#[test]
fn what_loses_counts_loses_homing_too() {
    for fault in
        [Fault::EncoderJump, Fault::EncoderLoss, Fault::EncoderIllegal, Fault::EncoderStall, Fault::IndexMismatch]
    {
        assert!(!provoked(fault).servo.status().homed, "{}", fault.name());
    }
    assert!(provoked(Fault::OverCurrent).servo.status().homed);
}

/// What brings each about in the image is written by `cargo xtask faults`, where a fault without an injector does not
/// build (emulator/src/inject.rs).
#[test]
fn every_fault_was_brought_about_in_the_image_or_it_says_why_it_cannot_be() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/results/faults.md");
    let text = std::fs::read_to_string(&path).expect("docs/results/faults.md is there");
    for fault in Fault::ALL {
        let begin = format!("| {} | {} |", fault.code(), fault.name());
        let mut rows = text.lines().filter(|line| line.starts_with(&begin));
        let (Some(row), None) = (rows.next(), rows.next()) else { panic!("not one row of {}", fault.name()) };
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let [_, _, _, how, cause, seen, remedy, _] = cells[..] else { panic!("{row}") };
        let told = match how.strip_prefix("not possible:") {
            Some(why) => !why.trim().is_empty(),
            None => !how.is_empty() && !cause.is_empty() && !seen.is_empty(),
        };
        assert!(told && remedy == fault.remedy(), "{row}");
    }
    assert_eq!(text.lines().filter(|line| line.contains("not possible:")).count(), 1, "one more than EncoderIllegal");
}

#[test]
fn codes_and_names_are_unique_and_every_remedy_says_something() {
    for (i, fault) in Fault::ALL.iter().enumerate() {
        assert!(!fault.what().is_empty() && !fault.remedy().is_empty(), "{}", fault.name());
        for other in &Fault::ALL[..i] {
            assert!(other.code() < fault.code() && other.name() != fault.name());
        }
    }
}

#[test]
fn a_fault_while_the_host_is_only_listed_as_silent_is_told_as_itself() {
    let mut rig = with_rules(|rules| rules.host_action = HostAction::Hold);
    rig.run(0.6);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, Some(Fault::HostLost)));
    rig.shown_current = Some(9.0);
    rig.step();
    assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::OverCurrent)));
}

#[test]
fn a_silent_host_does_nothing_unless_the_rules_say_so() {
    let mut rig = Rig::armed();
    rig.run(5.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_heartbeat_keeps_the_motors_on() {
    let mut rig = with_rules(|rules| rules.host_action = HostAction::Disarm);
    for _ in 0..20 {
        rig.execute(Command::HostAlive).unwrap();
        rig.run(0.4);
    }
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_silent_host_held_over_clears_and_comes_again_only_after_its_time() {
    let mut rig = with_rules(|rules| rules.host_action = HostAction::Hold);
    rig.run(0.6);
    rig.execute(Command::Clear).unwrap();
    rig.run(0.3);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None), "clearing is a sign of life");
    rig.run(0.3);
    assert_eq!(rig.fault(), Some(Fault::HostLost));
    rig.execute(Command::Disarm).unwrap();
    assert!(rig.execute(Command::Arm).is_err(), "arming waits until it is cleared");
}

#[test]
fn clearing_over_and_over_does_not_lift_a_limit() {
    let mut rig = Rig::ready(&scene(1, &[wall(0.09, 100_000.0)]));
    rig.turn(0, 0.95, 5.0);
    rig.settle();
    rig.arm();
    rig.turn(0, -0.8, 5.0);
    let mut steps = 0;
    while rig.state() == State::Armed && steps < (0.16 * RATE) as u32 {
        rig.execute(Command::Clear).unwrap();
        rig.samples.counts[0] += (10.0 / f64::from(RATE) / core::f64::consts::TAU * rig::COUNTS) as i32;
        rig.step();
        steps += 1;
    }
    assert_eq!(rig.fault(), Some(Fault::PowerLimit));
}

#[test]
fn power_is_what_the_motors_give_not_what_the_scene_asks_for() {
    // The wall asks for a thousand times the torque limit; at 3 rad/s the motor gives 0.9 W of the 2 W allowed.
    let mut rig = Rig::ready(&scene(1, &[wall(0.09, 100_000.0)]));
    rig.turn(0, 0.95, 5.0);
    rig.settle();
    rig.arm();
    rig.turn(0, -0.8, 3.0);
    rig.turn(0, 0.85, 3.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_stall_is_judged_by_the_torque_that_acts() {
    // A torque limit of a tenth of the motor's: pressing against it for long is no sign of a dead encoder.
    let mut rules = rules();
    rules.limits.torque = [0.03; 3];
    let mut rig = Rig::with(&paddle(), &scene(1, &[wall(-0.005, 10_000.0)]), hardware(), rules);
    rig.arm();
    rig.turn(0, -0.15, 1.0);
    rig.run(6.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_warm_winding_pressed_against_a_wall_is_no_lost_encoder() {
    // Copper at 100 °C has a third more resistance than the 2 ohm of the data sheet.
    let mut rig = Rig::ready(&scene(1, &[wall(-0.005, 250.0)]));
    rig.resistance = 2.7;
    rig.arm();
    rig.turn(0, -0.15, 1.0);
    rig.run(1.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
    assert!((rig.currents[0] - 2.5).abs() < 0.05, "the loop makes 2.5 A all the same: {:?}", rig.currents);
}

#[test]
fn voltages_and_currents_that_a_board_does_not_sense_are_ignored() {
    let mut board = hardware();
    board.bus_sensed = false;
    board.bridge.current_sensed = false;
    let mut rig = Rig::with(&paddle(), &quiet(), board, rules());
    rig.samples.bus_voltage = f32::NAN;
    rig.shown_current = Some(f32::NAN);
    rig.arm();
    rig.run(0.2);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_board_without_bus_voltage_does_not_mistake_that_for_a_lost_encoder() {
    let mut board = hardware();
    board.bus_sensed = false;
    let mut rig = Rig::with(&paddle(), &quiet(), board, rules());
    rig.samples.bus_voltage = 0.0;
    rig.shown_current = Some(2.0);
    rig.execute(Command::Arm).unwrap();
    rig.run(0.5);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_hot_motor_cools_while_it_is_off_and_stays_hot_when_a_device_is_loaded_anew() {
    let mut rig = provoked(Fault::ThermalBudget);
    rig.execute(Command::Clear).unwrap();
    rig.turn(0, 0.0, 1.0);
    rig.load(&paddle(), &scene(1, &[wall(-0.005, 290.0)]), false).unwrap();
    rig.settle();
    rig.execute(Command::Home).unwrap();
    rig.settle();
    rig.execute(Command::PolarityKnown).unwrap();
    let press = |rig: &mut Rig, seconds: f32| {
        rig.arm();
        rig.turn(0, -0.15, 1.0);
        rig.tremble(seconds);
    };
    press(&mut rig, 0.5);
    assert_eq!(rig.fault(), Some(Fault::ThermalBudget), "it had no time to cool");

    // The budget is (3² - 1²) A² for 4 s; at rest it gains 1 A² every second.
    rig.execute(Command::Clear).unwrap();
    rig.turn(0, 0.0, 1.0);
    rig.run(33.0);
    press(&mut rig, 2.0);
    assert_eq!(rig.fault(), None, "it has cooled");
}

/// Seconds for which a paddle at 2.9 A of 3 A goes on, on a board that starts with this heat in its motors; 1 A may
/// flow for ever.
fn lasts(heat: Heat) -> f32 {
    let mut rig = Rig::bare(hardware(), rules());
    rig.servo.start_heat([heat; 3]);
    rig.load(&paddle(), &scene(1, &[wall(-0.005, 290.0)]), false).unwrap();
    rig.settle();
    rig.execute(Command::Home).unwrap();
    rig.settle();
    rig.execute(Command::PolarityKnown).unwrap();
    rig.arm();
    rig.turn(0, -0.15, 1.0);
    let began = rig.servo.frame().step;
    rig.tremble(10.0);
    assert_eq!(rig.fault(), Some(Fault::ThermalBudget));
    (rig.servo.frame().step - began) as f32 / RATE
}

#[test]
fn a_motor_is_as_hot_after_a_reset_as_before_and_warm_where_nobody_knows() {
    // (2.9² - 1) A² fill the budget of (3² - 1) A² times 4 s in 4.3 s.
    let cold = lasts(Heat::default());
    assert!((4.2..4.5).contains(&cold), "{cold} s");
    let hot = provoked(Fault::ThermalBudget).servo.heat()[0];
    // A second of homing and arming cools by 1 A² s, which 0.14 s at 2.9 A make up for.
    let after = lasts(hot);
    assert!(after < 0.3, "{after} s");
    let warm = lasts(Heat::UNKNOWN);
    assert!((0.45 * cold..0.65 * cold).contains(&warm), "{warm} s of {cold} s");
}

#[test]
fn limits_hold_whatever_the_step_is_asked_for() {
    let mut rig = Rig::ready(&scene(1, &[wall(-0.005, 1.0e9)]));
    rig.arm();
    let bound = limits().torque[0] * 1.000_01;
    for angle in [-0.1, -0.5, -0.9, 0.2] {
        rig.turn(0, angle, 4.0);
        assert!(rig.servo.frame().torque[0].abs() <= bound, "{:?}", rig.servo.frame());
        assert!(rig.duties.iter().all(|duty| duty.abs() <= 0.92));
    }
}

/// Control rates, Hz, that limits have to hold at alike.
const RATES: [f32; 3] = [200.0, 1_000.0, 20_000.0];

/// An armed paddle at a control rate.
fn armed_at(rate: f32) -> Rig {
    let mut scene = quiet();
    (scene.rate_hz, scene.cutoff_hz) = (rate, 0.2 * rate);
    let mut rig = Rig::ready(&scene);
    rig.arm();
    rig
}

/// Turns joint 0 at `speed` (rad/s), one carrier period after another, until the bridges float or `most` periods are
/// over; the periods that took.
fn crests_until_off(rig: &mut Rig, speed: f64, most: u32, shown: [f32; 3]) -> Option<u32> {
    let start = rig.samples.counts[0];
    (1..=most).find(|nth| {
        let moved = f64::from(*nth) * speed / 20_000.0 / core::f64::consts::TAU * rig::COUNTS;
        let counts = Counts([start + moved as i32, 0, 0]);
        !rig.servo
            .guard(&Samples { counts, bus_voltage: 24.0, currents: Currents(shown), ..Samples::default() })
            .bridges
    })
}

#[test]
fn a_current_above_its_limit_is_seen_at_the_next_crest_at_every_rate() {
    for rate in RATES {
        let mut rig = armed_at(rate);
        assert_eq!(crests_until_off(&mut rig, 0.0, 10, [6.0, 0.0, 0.0]), Some(1), "{rate} Hz");
        assert_eq!(rig.fault(), Some(Fault::OverCurrent));
        assert_eq!(rig.servo.duties(24.0, &[0.0; 3], false), [0.0; 3]);
    }
}

#[test]
fn speed_and_joint_limits_act_within_a_control_period_at_every_rate() {
    for rate in RATES {
        // Twice the 20 rad/s allowed: a first-order filter of 200 Hz is there after ln 2 of its 0.8 ms, 11 periods.
        let mut rig = armed_at(rate);
        let seen = crests_until_off(&mut rig, 40.0, 100, [0.0; 3]);
        assert!(seen.is_some_and(|seen| (10..=14).contains(&seen)), "{rate} Hz: {seen:?}");
        assert_eq!(rig.fault(), Some(Fault::SpeedLimit));
        // 19 rad/s are allowed; the limit of 1 rad is 1053 periods away.
        let mut rig = armed_at(rate);
        let seen = crests_until_off(&mut rig, 19.0, 2_000, [0.0; 3]);
        assert!(seen.is_some_and(|seen| (1_052..=1_056).contains(&seen)), "{rate} Hz: {seen:?}");
        assert_eq!(rig.fault(), Some(Fault::JointLimit));
    }
}

#[test]
fn no_scene_filter_slows_or_blinds_the_speed_limit() {
    use haptic_bridge::render::velocity::{Coefficients, Estimator};
    for (kind, cutoff) in
        [(Estimator::Butterworth, 1.0e-6), (Estimator::FirstOrder, 1.0), (Estimator::Butterworth, 900.0)]
    {
        let mut rig = Rig::armed();
        let coefficients = Coefficients::new(kind, RATE, cutoff).unwrap();
        rig.execute(Command::Coefficients(coefficients)).unwrap();
        rig.turn(0, 0.5, 30.0);
        assert_eq!(rig.fault(), Some(Fault::SpeedLimit), "{kind:?} {cutoff} Hz");
        let travel = rig.servo.status().q[0];
        assert!(travel < 0.1, "{kind:?} {cutoff} Hz: {travel} rad");
    }
}

#[test]
fn a_coarse_encoder_is_given_a_few_counts_before_it_is_called_fast() {
    // 400 counts a turn: one count in a carrier period is 314 rad/s. At 15 rad/s of 20 allowed one comes every 1 ms.
    let mut coarse = paddle();
    coarse.joints[0].encoder.as_mut().unwrap().counts_per_turn = 400.0;
    let run = |speed: f64| {
        let mut rig = Rig::with(&coarse, &quiet(), hardware(), rules());
        rig.arm();
        let counts =
            |nth: u32| Counts([(f64::from(nth) * speed / 20_000.0 / core::f64::consts::TAU * 400.0) as i32, 0, 0]);
        let off = (1..=1_200).find(|nth| {
            !rig.servo.guard(&Samples { counts: counts(*nth), bus_voltage: 24.0, ..Samples::default() }).bridges
        });
        (off.map(|nth| counts(nth)[0]), rig.fault())
    };
    assert_eq!(run(15.0), (None, None));
    let (travel, fault) = run(40.0);
    assert_eq!(fault, Some(Fault::SpeedLimit));
    assert!(travel.is_some_and(|counts| counts <= 6), "{travel:?} counts");
}

/// The largest current of motor 0 from here until the bridges float, A, and the fault; `None` where they do not within
/// 50 ms.
fn worst_current(rig: &mut Rig) -> (f32, Option<Fault>) {
    let mut most = 0.0_f32;
    for _ in 0..(0.05 * rig.rate) as u32 {
        rig.step();
        most = most.max(rig.peak);
        if rig.state() == State::Fault {
            break;
        }
    }
    (most, rig.fault())
}

#[test]
fn a_current_sensor_that_lies_does_not_let_the_motor_run_beyond_its_limit() {
    for rate in RATES {
        for shown in [0.0_f32, 1.0, -2.0] {
            let mut scene = scene(1, &[wall(-0.005, 250.0)]);
            (scene.rate_hz, scene.cutoff_hz) = (rate, 0.2 * rate);
            let mut rig = Rig::ready(&scene);
            rig.arm();
            rig.turn(0, -0.15, 1.0);
            rig.shown_current = Some(shown);
            let (most, fault) = worst_current(&mut rig);
            assert_eq!(fault, Some(Fault::MotorModel), "{shown} A at {rate} Hz");
            // Half again the limit of 3 A and an ampere: what a current that is seen may reach.
            assert!(most < 5.5, "{shown} A at {rate} Hz: {most} A");
        }
    }
}

#[test]
fn an_open_winding_is_seen_as_soon_as_it_should_carry_current() {
    for rate in RATES {
        let mut scene = scene(1, &[wall(-0.005, 250.0)]);
        (scene.rate_hz, scene.cutoff_hz) = (rate, 0.2 * rate);
        let mut rig = Rig::ready(&scene);
        rig.arm();
        rig.turn(0, -0.15, 1.0);
        rig.resistance = f32::INFINITY;
        let (_, fault) = worst_current(&mut rig);
        assert_eq!(fault, Some(Fault::MotorModel), "{rate} Hz");
    }
}

#[test]
fn a_sound_motor_is_never_called_strange() {
    // Hot and cold windings, walls hit and left at speed, at every rate.
    for rate in RATES {
        for resistance in [1.7, 2.0, 2.8] {
            let mut scene = scene(1, &[wall(-0.005, 250.0)]);
            (scene.rate_hz, scene.cutoff_hz) = (rate, 0.2 * rate);
            let mut rig = Rig::ready(&scene);
            rig.resistance = resistance;
            rig.arm();
            for (angle, speed) in [(-0.15, 8.0), (0.5, 8.0), (-0.12, 15.0), (-0.14, 0.5), (0.2, 15.0)] {
                rig.turn(0, angle, speed);
            }
            assert_eq!(rig.fault(), None, "{resistance} ohm at {rate} Hz");
        }
    }
}

#[test]
fn a_joint_limit_holds_however_far_away_the_other_one_is() {
    for low in [-1.0, -5.0e4, -1.0e6, -1.0e30, f64::NEG_INFINITY] {
        let mut device = paddle();
        device.joints[0].limits = Some((low, 0.1));
        let mut rig = Rig::with(&device, &scene(1, &[]), hardware(), rules());
        rig.arm();
        rig.turn(0, 0.5, 1.0);
        assert_eq!(rig.fault(), Some(Fault::JointLimit), "{low}");
    }
}

#[test]
fn the_polarity_check_asks_no_more_force_than_the_tip_may_make_and_looks_at_no_angle_of_before() {
    let gentle = Rules { limits: haptic_bridge::safety::limits::Limits { tip_force: 0.2, ..limits() }, ..rules() };
    let mut rig = Rig::with(&paddle(), &scene(1, &[]), hardware(), gentle);
    rig.turn(0, 0.5, 1.0);
    rig.settle();
    // Homing moves what is read by half a radian, before the next step.
    rig.execute(Command::Home).expect("at rest");
    rig.execute(Command::CheckPolarity).expect("ready");
    for step in 0..1_800 {
        rig.step();
        assert_eq!(rig.state(), State::CheckingPolarity, "step {step}");
        let force = rig.servo.frame().torque[0] / 0.1;
        assert!(force <= 0.2 * 1.001, "{force} N");
    }
}
