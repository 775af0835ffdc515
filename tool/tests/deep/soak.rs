//! Hours of contact with telemetry on the simulated board, through the tool's own link: ten minutes by default, a day
//! with `cargo xtask soak`. No control step is missed, no row is lost or repeated, and force and memory do not drift.
//! The file has only one test, because the test measures the memory of its process.

use crate::common::prelude::*;
use crate::common::{board, plane_wall, shipped_device};
use haptic_bridge::model::units::JointUnits;
use haptic_host::link::{Losses, Row, columns};
use haptic_sim::Hand;
use std::fmt::Write as _;
use std::time::Duration;

/// Control rate, Hz: the lowest at which this wall is still firm, so that a day is simulated quickly.
const RATE_HZ: u32 = 1_000;
/// Duration of one cycle, which touches the wall and leaves it again, s.
const CYCLE_SECONDS: u32 = 2;
/// Simulated time in `cargo test`, s.
const DEFAULT_SECONDS: u64 = 600;
/// Number of cycles until friction and filters have settled.
const SETTLING_CYCLES: usize = 5;
/// Number of reference cycles, which follow the settling cycles.
const REFERENCE_CYCLES: usize = 20;
/// Largest relative deviation of a later cycle from the reference: a hundredth of the 10 % that a hand can feel.
const MAX_DRIFT: f64 = 1e-3;
/// Largest growth of memory from the first minute to the end, bytes.
const MAX_GROWTH_BYTES: u64 = 1 << 20;

/// Returns a board with a wall 5 mm below the tip and a hand that moves 15 mm down and up again, over and over.
fn board_and_tool(seconds: u64) -> (SharedBoard, Board) {
    let mut options = BoardOptions::default();
    // Half a carrier period, the coarsest step that still resolves the current loop's own time step.
    options.device.substep = 25e-6;
    let (shared, mut board) = board(&shipped_device("coupled-five-bar"), options);
    let tip = shared.lock().device().tip();
    let point = [tip[0] as f32, (tip[1] - 0.005) as f32, 0.0];
    let wall = Wall { feed_forward: FeedForward::Washout, ..plane_wall(point, [0.0, 1.0, 0.0], 800.0, 4.0) };
    let mut scene = Scene { task: 2, rate_hz: RATE_HZ as f32, cutoff_hz: 100.0, ..Scene::default() };
    scene.walls.push(wall).unwrap();
    board.set_scene(&scene).unwrap();
    board.set_rules(&Rules { host_action: HostAction::Disarm, host_seconds: 0.5, ..Rules::default() }).unwrap();
    board.arm().unwrap();
    let half = f64::from(CYCLE_SECONDS) / 2.0;
    let path = (0..=2 * (seconds / u64::from(CYCLE_SECONDS) + 2)).map(|turn| Waypoint {
        time: half * turn as f64,
        value: [tip[0], tip[1] - if turn % 2 == 0 { 0.0 } else { 0.015 }, 0.0],
    });
    let now = shared.lock().time();
    let hand = Hand::new(HandSettings::default(), Intent::Follow(path.collect()), tip, now);
    shared.lock().device_mut().set_hand(hand);
    (shared, board)
}

/// Measured values of one cycle: largest force (N), impulse (N s), and integral of each motor's torque (N m s).
#[derive(Clone, Copy, Debug, Default)]
struct Cycle {
    peak: f64,
    impulse: f64,
    torque: [f64; 2],
}

impl Cycle {
    fn values(&self) -> [f64; 4] {
        [self.peak, self.impulse, self.torque[0], self.torque[1]]
    }
}

/// Smallest and largest of each value of several cycles.
#[derive(Clone, Copy)]
struct Span([(f64, f64); 4]);

impl Span {
    fn new(cycles: &[Cycle]) -> Self {
        let mut span = [(f64::INFINITY, f64::NEG_INFINITY); 4];
        for cycle in cycles {
            for (range, value) in span.iter_mut().zip(cycle.values()) {
                *range = (range.0.min(value), range.1.max(value));
            }
        }
        Self(span)
    }

    fn contains(&self, cycle: &Cycle) -> bool {
        self.0.iter().zip(cycle.values()).all(|((low, high), value)| {
            let slack = MAX_DRIFT * low.abs().max(high.abs());
            value >= low - slack && value <= high + slack
        })
    }
}

/// Positions of the evaluated columns in a row.
struct Columns {
    force: usize,
    torque: [usize; 2],
    state: usize,
}

impl Columns {
    fn new() -> Self {
        let labels: Vec<String> = columns(fields("all").unwrap(), &[&JointUnits::REVOLUTE; 2], 0)
            .into_iter()
            .map(|column| column.label)
            .collect();
        let at = |name: &str| labels.iter().position(|label| label == name).expect(name);
        Self { force: at("force_n"), torque: [at("torque0_n_m"), at("torque1_n_m")], state: at("state") }
    }

    fn add(&self, row: &Row, cycle: &mut Cycle) {
        let second = 1.0 / f64::from(RATE_HZ);
        assert_eq!(row.values[self.state], f64::from(State::Armed as u8), "step {}", row.step);
        cycle.peak = cycle.peak.max(row.values[self.force]);
        cycle.impulse += second * row.values[self.force];
        for (sum, place) in cycle.torque.iter_mut().zip(self.torque) {
            *sum += second * row.values[place];
        }
    }
}

/// Returns the resident memory of this process, bytes; `None` if the system has no such information.
fn resident_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(1024 * line.trim().trim_end_matches(" kB").parse::<u64>().ok()?)
}

#[test]
fn long_contact_loses_no_rows_and_does_not_drift() {
    let seconds: u64 = std::env::var("HAPTIC_SOAK_SECONDS").map_or(DEFAULT_SECONDS, |text| text.parse().unwrap());
    let (shared, mut board) = board_and_tool(seconds);
    let places = Columns::new();
    board.keep_alive();
    board.start_stream(fields("all").unwrap(), 1).unwrap();
    let start_s = shared.lock().time();
    let (mut first, mut next, mut rows) = (None, None, 0_u64);
    // Fill the memory now, so that it counts as used from the beginning.
    let unused = Cycle { peak: f64::NAN, ..Cycle::default() };
    let mut cycles = vec![unused; (seconds / u64::from(CYCLE_SECONDS)) as usize + 2];
    cycles.clear();
    let (mut memory, mut most, mut minute) = (None, None, 0);
    while shared.lock().time() < start_s + seconds as f64 {
        for row in board.rows(Duration::from_secs(1)).unwrap() {
            assert_eq!(*next.get_or_insert(row.step), row.step, "a row is missing or came twice");
            next = Some(row.step.wrapping_add(1));
            let cycle = row.step.wrapping_sub(*first.get_or_insert(row.step)) / (RATE_HZ * CYCLE_SECONDS);
            cycles.resize(cycle as usize + 1, Cycle::default());
            places.add(&row, &mut cycles[cycle as usize]);
            rows += 1;
        }
        let minutes = ((shared.lock().time() - start_s) / 60.0) as u64;
        if minutes > minute {
            minute = minutes;
            let bytes = resident_bytes();
            memory = memory.or(bytes);
            most = most.max(bytes);
        }
    }
    board.stop_stream().unwrap();
    rows += board.rows(Duration::ZERO).unwrap().len() as u64;
    // No control step was missed: there are as many steps as milliseconds, and as many rows as steps.
    let losses = board.losses();
    assert_eq!(losses, Losses { received: rows, ..Losses::default() });
    let steps = u64::from(board.status().unwrap().step.wrapping_sub(first.unwrap()));
    let passed = ((shared.lock().time() - start_s) * f64::from(RATE_HZ)).round() as u64;
    assert!(steps.abs_diff(passed) <= 5, "{steps} steps in {passed} ms");
    assert!(rows.abs_diff(steps) <= 5, "{rows} rows of {steps} steps");
    assert!(board.faults().unwrap().is_empty());
    // Every cycle agrees with the reference cycles. The last cycle is incomplete.
    cycles.pop();
    let usual = Span::new(&cycles[SETTLING_CYCLES..SETTLING_CYCLES + REFERENCE_CYCLES]);
    assert!(usual.0[0].0 > 1.0, "a cycle does not touch the wall: {} N", usual.0[0].0);
    let strange = cycles[SETTLING_CYCLES..].iter().position(|cycle| !usual.contains(cycle));
    assert_eq!(strange, None, "{:?}; usual {:?}", strange.map(|at| cycles[SETTLING_CYCLES + at]), usual.0);
    if let (Some(memory), Some(most)) = (memory, most) {
        assert!(most <= memory + MAX_GROWTH_BYTES, "{} KiB more", (most - memory) / 1024);
    }
    if let Ok(path) = std::env::var("HAPTIC_SOAK_REPORT") {
        let kib = |(memory, most): (u64, u64)| format!("{} KiB", (most - memory) / 1024);
        let grown = memory.zip(most).map_or("not known".into(), kib);
        std::fs::write(path, report(seconds, rows, &cycles, &grown)).unwrap();
    }
}

/// Returns a report with the figures of the first hour, the last hour, and all cycles.
fn report(seconds: u64, rows: u64, cycles: &[Cycle], grown: &str) -> String {
    let mut text = format!(
        "{:.2} simulated hours of contact at {RATE_HZ} Hz: {} touches of the wall, {rows} control steps, as many rows of \
         telemetry with every field, none missing, none twice. Memory of the process after the first minute: + {grown}.\n\n\
         | hour | largest force, N | impulse of a touch, N s |\n|--:|--:|--:|\n",
        seconds as f64 / 3600.0,
        cycles.len(),
    );
    let settled = &cycles[SETTLING_CYCLES..];
    let hours: Vec<&[Cycle]> = settled.chunks((3600 / CYCLE_SECONDS) as usize).collect();
    for (hour, touches) in [("1", hours[0]), (&hours.len().to_string(), hours[hours.len() - 1]), ("all", settled)] {
        let [peak, impulse, ..] = Span::new(touches).0;
        let _ = writeln!(text, "| {hour} | {:.5} to {:.5} | {:.6} to {:.6} |", peak.0, peak.1, impulse.0, impulse.1);
    }
    text
}
