//! Injects errors of sensors and motors at three control rates and at ten instants of the control period. Measures the
//! time until the bridges float, and the motion that a hand would feel until then.

use std::collections::BTreeSet;

use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::output::csv_line;
use haptic_sim::BoardFaults;
use rigless::device::Level;

use crate::boards::BoardKind;
use crate::contact::{NearWall, scene};
use crate::hands::{hold, push};
use crate::hardware::Hardware;
use crate::inject::bridges_are_off;
use crate::plant::Peaks;
use crate::rig::Rig;
use crate::run::{MICROSECOND, MILLISECOND};

/// Control rates, Hz: the slowest rate, the default of the paper's comparison, and the rate of the carrier.
pub const RATES_HZ: [u32; 3] = [200, 1_000, 20_000];
/// Number of instants within a control period.
pub const PHASES: u64 = 10;
/// Longest time to wait until the bridges float, ns.
const MAX_WAIT_NS: u64 = 300 * MILLISECOND;
/// Force of the hand against the wall, N.
const PUSH_N: f64 = 0.8;

/// An injected error.
pub struct Case {
    /// Description of the error.
    pub name: &'static str,
    /// Injects the error while the tip is in a wall.
    pub cause: fn(&mut Hardware),
    /// True if the board must detect the error. For other errors the table shows the effect.
    pub must_detect: bool,
}

/// All injected errors, which are injected one at a time.
pub const CASES: &[Case] = &[
    Case { name: "current sensors 8 A too high", cause: |board| add_to_shunts(board, 2, 8.0), must_detect: true },
    Case { name: "current sensors 4 A too low", cause: |board| add_to_shunts(board, 2, -4.0), must_detect: true },
    Case { name: "current sensors stuck at 0 A", cause: |board| scale_shunts(board, 2, 0.0), must_detect: true },
    Case { name: "current sensors show a quarter", cause: |board| scale_shunts(board, 2, 0.25), must_detect: true },
    // At rest a frozen reading equals the requested current, so the board cannot detect the error.
    Case { name: "current sensors frozen, hand at rest", cause: freeze_current_sensor, must_detect: false },
    Case {
        name: "current sensors frozen, hand moves",
        cause: |board| {
            freeze_current_sensor(board);
            move_along_wall(board);
        },
        must_detect: false,
    },
    Case { name: "one of two shunts 4 A too high", cause: |board| add_to_shunts(board, 1, 4.0), must_detect: true },
    // The current of this contact is 0.4 A. The loop doubles the current because the sensors report half. The
    // difference between the two sensors stays within the tolerance for correct sensors. In a contact of 2.5 N the
    // board detects the error (src/inject.rs, CurrentSensor).
    Case { name: "one of two shunts shows nothing", cause: |board| scale_shunts(board, 1, 0.0), must_detect: false },
    Case { name: "a winding open", cause: |board| board.faults.open[0] = true, must_detect: true },
    Case { name: "a bridge stuck at 40 %", cause: |board| board.faults.stuck_on[0] = Some(0.4), must_detect: true },
    Case {
        name: "a gate driver forgets its registers",
        cause: |board| board.driver(0).reset_control_registers(),
        must_detect: true,
    },
    Case {
        name: "an encoder unplugged, hand at rest",
        cause: |board| board.encoders_unplugged[0] = true,
        must_detect: false,
    },
    Case {
        name: "an encoder unplugged, hand moves",
        cause: |board| {
            board.encoders_unplugged[0] = true;
            move_along_wall(board);
        },
        must_detect: false,
    },
    Case { name: "an encoder shakes by 8 counts", cause: |board| board.faults.shake[0] = 8, must_detect: false },
    Case { name: "an encoder counts backward, hand at rest", cause: reverse_encoder, must_detect: false },
    Case {
        name: "an encoder counts backward, hand moves",
        cause: |board| {
            reverse_encoder(board);
            move_along_wall(board);
        },
        must_detect: false,
    },
    Case { name: "two encoders change places, hand at rest", cause: swap_encoders, must_detect: false },
    Case {
        name: "two encoders change places, hand moves",
        cause: |board| {
            swap_encoders(board);
            move_along_wall(board);
        },
        must_detect: false,
    },
    Case {
        name: "the bus sensor shows 12 V of 24 V",
        cause: |board| board.faults.bus_reading = Some(12.0),
        must_detect: false,
    },
    Case {
        name: "58 V on the bus, whose sensor shows 24 V",
        cause: |board| {
            board.faults.bus_reading = Some(24.0);
            if let Some(device) = board.plant.device() {
                device.set_bus_voltage(58.0);
            }
        },
        must_detect: false,
    },
];

/// Makes the first `count` shunts of the first motor report `gain` times the motor's current.
fn scale_shunts(board: &mut Hardware, count: usize, gain: f64) {
    board.faults.sensor_gain[..count].fill(gain);
}

/// Adds `current` (A) to the readings of the first `count` shunts of the first motor.
fn add_to_shunts(board: &mut Hardware, count: usize, current: f64) {
    board.faults.sensor_offset[..count].fill(current);
}

fn freeze_current_sensor(board: &mut Hardware) {
    board.faults.sensor_frozen[0] = Some(board.plant.currents()[0]);
}

fn reverse_encoder(board: &mut Hardware) {
    board.faults.share[0] = Some((board.plant.counts()[0], -1.0));
}

fn swap_encoders(board: &mut Hardware) {
    let [first, second, _] = board.plant.counts();
    board.faults.swapped_at = Some([first, second]);
}

/// Makes the hand also move the tip along the wall while it pushes.
fn move_along_wall(board: &mut Hardware) {
    if let Some(device) = board.plant.device() {
        push(device, [PUSH_N, PUSH_N, 0.0], 0.02);
    }
}

/// Result of one injected error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The fault, if the error was detected.
    pub fault: Option<Fault>,
    /// Time from the cause until the bridges float, ns. The full waiting time if they do not float.
    pub off_after_ns: u64,
    /// Peaks until the bridges float.
    pub peaks: Peaks,
}

/// A board whose device is placed at the wall again for each error.
pub struct Campaign {
    rig: Rig,
    home: [f64; 3],
    scene: String,
    rate: u32,
}

impl Campaign {
    /// Returns a board with the control rate `rate`, Hz.
    #[must_use]
    pub fn new(rate: u32) -> Self {
        let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
        let (home, tip) = rig.with_simulated(|device| (device.q(), device.tip()));
        let head = format!("rate_hz = {rate}.0\ncutoff_hz = {:?}\n", f64::from(rate) * 0.025);
        rig.prepare(&head);
        let soft = NearWall { stiffness: 100.0, feed_forward: "off", ..NearWall::with_normal([0.0, -1.0, 0.0]) };
        let scene = scene(&head, tip, 2, &[soft]);
        Self { rig, home, scene, rate }
    }

    /// Places the device at the wall, without injected errors.
    fn prepare(&mut self) {
        let (rig, home) = (&mut self.rig, self.home);
        rig.tool.disarm().expect("the board disarms");
        rig.while_stopped(move |stopped| {
            let board = stopped.hardware();
            board.faults = BoardFaults::default();
            board.encoders_unplugged = [false; 3];
            let device = board.plant.device().expect("a simulated device");
            device.set_bus_voltage(24.0);
            device.place(home);
            hold(device);
        });
        rig.run(50 * MILLISECOND);
        rig.tool.clear().expect("no injected error is left");
        rig.tool.home().expect("the device is at rest");
        if !rig.tool.status().expect("the board replies").polarity {
            // Counts were lost, so the home pose has other counts now.
            rig.check_polarity_suspended();
            rig.with_simulated(move |device| {
                device.place(home);
                hold(device);
            });
            rig.run(50 * MILLISECOND);
        }
        rig.set_scene(&self.scene);
        rig.tool.arm().expect("the board arms");
        rig.with_simulated(|device| push(device, [0.0, PUSH_N, 0.0], 0.3));
        // The torque rises for 0.5 s after arming.
        rig.run(700 * MILLISECOND);
        let status = rig.tool.status().expect("the board replies");
        assert_eq!(status.state, State::Armed, "{status:?}");
    }

    /// Injects an error at the `phase`th tenth of a control period and observes the effect.
    pub fn run(&mut self, case: &Case, phase: u64) -> Outcome {
        self.prepare();
        let rig = &mut self.rig;
        // Wait for a step, because control periods are counted from the first step and not from time 0.
        let period = 1_000_000_000 / u64::from(self.rate);
        let steps = rig.steps();
        while rig.steps() == steps {
            rig.run(10 * MICROSECOND);
        }
        rig.run(phase * period / PHASES);
        let cause = case.cause;
        let began = rig.now();
        rig.while_stopped(move |stopped| {
            stopped.hardware().peaks = Peaks::default();
            cause(stopped.hardware());
        });
        let floats = rig.shared.board().run_until(MAX_WAIT_NS, 25 * MICROSECOND, is_power_disabled);
        let off_after_ns = rig.now() - began;
        let peaks = rig.while_stopped(|stopped| stopped.hardware().peaks);
        let status = rig.tool.status().expect("the board replies");
        assert_eq!(floats, status.state == State::Fault, "{}: {status:?}", case.name);
        assert!(!floats || rig.while_stopped(bridges_are_off), "{}: the bridges drive: {status:?}", case.name);
        Outcome { fault: status.fault.map(|record| record.fault), off_after_ns, peaks }
    }
}

/// Returns true if the power stages are disabled. A stuck bridge is ignored.
fn is_power_disabled(stopped: &mut crate::run::StoppedBoard<'_>) -> bool {
    let board = stopped.hardware();
    board.wiring.is_some_and(|wiring| board.level(wiring.enable) == Level::Low)
}

/// Returns the table's row for an error at a rate (Hz), with the worst value of each column over the phases.
#[must_use]
pub fn row(case: &Case, rate: u32, outcomes: &[Outcome]) -> String {
    let names: BTreeSet<&str> = outcomes.iter().map(|outcome| outcome.fault.map_or("nobody", Fault::name)).collect();
    let names: Vec<&str> = names.into_iter().collect();
    let worst = |number: fn(&Outcome) -> f64| outcomes.iter().map(number).fold(0.0, f64::max);
    let is_missed = outcomes.iter().any(|outcome| outcome.fault.is_none());
    let after = match is_missed {
        true => "not in 300 ms".to_owned(),
        false => format!("{:.2}", worst(|outcome| outcome.off_after_ns as f64 * 1e-6)),
    };
    csv_line([
        case.name,
        &rate.to_string(),
        &names.join(", "),
        &after,
        &format!("{:.2}", worst(|outcome| outcome.peaks.current)),
        &format!("{:.1}", worst(|outcome| outcome.peaks.speed)),
        &format!("{:.2}", worst(|outcome| outcome.peaks.travel * 1e3)),
    ])
}

/// Runs the complete campaign and returns docs/results/broken.csv. The rates run in parallel.
#[must_use]
pub fn table() -> String {
    let at_rate = |rate| {
        let mut campaign = Campaign::new(rate);
        let rows = CASES.iter().map(|case| {
            let outcomes: Vec<_> = (0..PHASES).map(|phase| campaign.run(case, phase)).collect();
            let row = row(case, rate, &outcomes);
            print!("{row}");
            row
        });
        rows.collect::<Vec<_>>()
    };
    let columns = std::thread::scope(|scope| {
        RATES_HZ.map(|rate| scope.spawn(move || at_rate(rate))).map(|run| run.join().expect("a board that behaves"))
    });
    let mut text = csv_line([
        "broken",
        "control rate (Hz)",
        "seen by",
        "off after (ms)",
        "current (A)",
        "speed (rad/s)",
        "way (mm)",
    ]);
    for case in 0..CASES.len() {
        columns.iter().for_each(|column| text += &column[case]);
    }
    text
}
