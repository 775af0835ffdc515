//! Hours of contact with telemetry on the unmodified image: no control period is missed, no row is lost, and no touch
//! of the wall differs from the first touches. `cargo xtask soak --chip` runs it; tool/tests/deep/soak.rs does the same
//! on the simulated board.

use std::fmt::Write as _;
use std::time::Duration;

use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Losses, columns};
use haptic_sim::{Hand, HandSettings, Intent, Waypoint};

use crate::boards::BoardKind;
use crate::contact::WallAt;
use crate::rig::{Rig, device_file};
use crate::run::SECOND;

/// Control rate, Hz: the lowest rate at which this wall is still firm. The current loops always run at 20 kHz.
const RATE: u32 = 1_000;
/// Duration of one touch of the wall, out and back, s.
const CYCLE: u32 = 2;
/// Number of touches that are skipped at the start, and number of touches that then define the usual range.
const SKIPPED: usize = 5;
const REFERENCE: usize = 20;
/// Largest deviation of a later touch from the usual range, as a share: a fifth of what a hand can feel (a tenth).
const DRIFT: f64 = 0.02;
/// Virtual seconds per row of the report.
const ROW: u32 = 600;

/// Largest force (N) and impulse (N s) of a touch.
type Touch = [f64; 2];

/// Runs for `seconds` of virtual time and returns a report. Calls `report_minute` every minute.
///
/// # Panics
///
/// If anything is lost, missed, or different from the start.
#[must_use]
pub fn contact(seconds: u64, mut report_minute: impl FnMut(u64)) -> String {
    let mut rig = Rig::with_file(BoardKind::OdriveV3, device_file("pantograph-mk2"), |options| options.substep = 25e-6);
    let normal = [0.0, -1.0, 0.0];
    let wall = WallAt { gap: 0.005, stiffness: 800.0, damping: 4.0, feed_forward: "washout", ..WallAt::facing(normal) };
    rig.arm_before(&format!("rate_hz = {RATE}\ncutoff_hz = 100\n"), &[wall]);
    let half = f64::from(CYCLE) / 2.0;
    let turns = 2 * (seconds / u64::from(CYCLE) + 4);
    rig.with_simulated(move |device| {
        let tip = device.tip();
        let deep = |turn: u64| if turn.is_multiple_of(2) { 0.0 } else { 0.015 };
        let path =
            (0..=turns).map(|turn| Waypoint { time: half * turn as f64, value: [tip[0], tip[1] + deep(turn), 0.0] });
        device.set_hand(Hand::new(HandSettings::default(), Intent::Follow(path.collect()), tip, device.time()));
    });
    let fields = Fields(Field::WallForce.bit() | Field::Distance.bit() | Field::Torque.bit() | Field::State.bit());
    let axes = columns(fields, 2);
    let place = |field| axes.iter().position(|column| column.field == field).expect("the column was asked for");
    let (force, state) = (place(Field::WallForce), place(Field::State));
    rig.tool.keep_alive();
    rig.tool.start_stream(fields, 1).expect("a stream starts");
    let began = rig.now();
    let (mut first, mut next, mut rows, mut minute) = (None, None, 0_u64, 0);
    let mut touches: Vec<Touch> = Vec::new();
    let stack = rig.tool.details().expect("the board replies").stack_free;
    let steps_before = rig.steps();
    let measured_from = rig.now();
    while rig.now() < began + seconds * SECOND {
        let received_rows = rig.tool.rows(Duration::from_millis(500));
        let received_rows = received_rows.unwrap_or_else(|error| panic!("{error}\n{}", rig.post_mortem()));
        for row in received_rows {
            assert_eq!(*next.get_or_insert(row.step), row.step, "a row is missing or duplicated");
            next = Some(row.step.wrapping_add(1));
            assert_eq!(row.values[state], f64::from(State::Armed as u8), "step {}", row.step);
            let touch = row.step.wrapping_sub(*first.get_or_insert(row.step)) / (RATE * CYCLE);
            touches.resize(touch as usize + 1, Touch::default());
            let [peak, impulse] = &mut touches[touch as usize];
            *peak = peak.max(row.values[force]);
            *impulse += row.values[force] / f64::from(RATE);
            rows += 1;
        }
        let now = (rig.now() - began) / (60 * SECOND);
        if now > minute {
            minute = now;
            report_minute(minute);
        }
    }
    let steps = u64::from(rig.steps().wrapping_sub(steps_before));
    let passed = (rig.now() - measured_from) * u64::from(RATE) / SECOND;
    assert!(steps.abs_diff(passed) <= 1, "{steps} steps in {passed} periods");
    rig.tool.stop_stream().expect("the stream stops");
    rows += rig.tool.rows(Duration::ZERO).expect("rows come").len() as u64;
    assert_eq!(rig.tool.losses(), Losses { received: rows, ..Losses::default() });
    let details = rig.tool.details().expect("the board replies");
    assert_eq!((details.overruns, rig.with(|stopped| stopped.resets().len())), (0, 0));
    assert!(rig.tool.faults().expect("the board replies").is_empty());
    assert_eq!(rig.tool.status().expect("the board replies").state, State::Armed);
    // The last touch is incomplete.
    touches.pop();
    let usual = span(&touches[SKIPPED..SKIPPED + REFERENCE]);
    assert!(usual[0].0 > 0.5, "the wall is touched every time: {} N", usual[0].0);
    for (nth, touch) in touches.iter().enumerate().skip(SKIPPED) {
        let is_similar = usual
            .iter()
            .zip(touch)
            .all(|((low, high), value)| (low * (1.0 - DRIFT)..=high * (1.0 + DRIFT)).contains(value));
        assert!(is_similar, "touch {nth}: {touch:?}, usual {usual:?}");
    }
    report(seconds, rows, &touches, (stack, details.stack_free))
}

/// Returns smallest and largest of each number.
fn span(touches: &[Touch]) -> [(f64, f64); 2] {
    std::array::from_fn(|i| {
        let values = || touches.iter().map(|touch| touch[i]);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    })
}

fn report(seconds: u64, rows: u64, touches: &[Touch], (before, after): (u32, u32)) -> String {
    let mut text = format!(
        "{:.2} virtual hours of contact at {RATE} Hz, current loops at 20 kHz: {} touches of the wall, {rows} rows of \
         telemetry, one for every step, none missing, none twice; no period missed, no fault, no restart. Stack never used: \
         {before} bytes at the beginning, {after} at the end.\n\n\
         | ten minutes | largest force, N | impulse of a touch, N s |\n|--:|--:|--:|\n",
        seconds as f64 / 3600.0,
        touches.len(),
    );
    let settled = &touches[SKIPPED..];
    let parts: Vec<&[Touch]> = settled.chunks((ROW / CYCLE) as usize).collect();
    for (part, touches) in [("the first", parts[0]), ("the last", parts[parts.len() - 1]), ("all", settled)] {
        let [peak, impulse] = span(touches);
        let _ = writeln!(text, "| {part} | {:.3} to {:.3} | {:.4} to {:.4} |", peak.0, peak.1, impulse.0, impulse.1);
    }
    text
}
