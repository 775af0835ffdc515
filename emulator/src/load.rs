//! A board under full load: in contact, telemetry streaming, settings changing. What must not happen is a
//! period that is missed.

use std::time::Duration;

use haptic::link::Losses;
use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::safety::fault::{FaultRecord, State};

use crate::cases::Case;
use crate::rig::Rig;
use crate::run::MILLISECOND;

/// What came of a stretch under load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Control steps that ran.
    pub steps: u32,
    /// Control periods that passed.
    pub periods: u32,
    /// Steps that reached past the next crest.
    pub overruns: u32,
    /// The part of the telemetry that arrived.
    pub losses: Losses,
    /// Rows of telemetry that were due.
    pub due: u64,
    /// Whether the walls were still rendered at the end, and the fault if not.
    pub armed: bool,
    /// The fault that is latched.
    pub fault: Option<FaultRecord>,
    /// Bytes of stack that were never used since boot.
    pub stack_free: u32,
}

impl Load {
    /// Whether every period had its step.
    #[must_use]
    pub fn in_time(&self) -> bool {
        self.armed && self.overruns == 0 && self.steps.abs_diff(self.periods) <= 1
    }
}

/// Changes the gains of the first wall from one value to another and back: the nth of such changes.
fn gains(nth: u64) -> Gains<f32> {
    let stiffness = if nth.is_multiple_of(2) { 450.0 } else { 550.0 };
    Gains { wall: 0, stiffness, damping: 1.0, feed_forward: FeedForward::Full, washout_hz: 2.0 }
}

/// The nth change of a setting: gains, the rules, the filters of the velocity, in turn.
fn change(rig: &mut Rig, nth: u64) {
    let odd = !(nth / 3).is_multiple_of(2);
    match nth % 3 {
        0 => rig.tool.set_wall_gains(gains(nth / 3)).expect("gains change in contact"),
        1 => {
            // Only tightened: what protects is not loosened while the motors are on.
            let mut rules = rig.tool.rules().expect("the board answers");
            rules.passivity = true;
            rules.limits.power *= 0.999;
            rig.tool.set_rules(&rules).expect("rules are tightened in contact");
        }
        _ => {
            let cutoff_hz = if odd { 400.0 } else { 500.0 };
            rig.tool.set_estimator(Estimator::Butterworth, cutoff_hz).expect("filters change in contact");
        }
    }
}

/// Runs a rig that stands in contact for `milliseconds` with every `divider`th step's `fields` streaming and a setting
/// changed ten times a second.
///
/// # Panics
///
/// When the link breaks.
pub fn run(rig: &mut Rig, (fields, divider): (Fields, u32), rate_hz: u32, milliseconds: u64) -> Load {
    rig.tool.start_stream(fields, divider).expect("a stream starts");
    rig.run(5 * MILLISECOND);
    let before = rig.steps();
    let began = rig.now();
    let first = rig.tool.rows(Duration::from_millis(50)).expect("rows come")[0].step;
    let end = began + milliseconds * MILLISECOND;
    let mut changes = 0;
    let mut last = first;
    while rig.now() < end {
        let now = rig.now();
        if now >= began + changes * 100 * MILLISECOND {
            change(rig, changes);
            changes += 1;
        }
        let rows = rig.tool.rows(Duration::from_millis(10)).expect("rows come");
        last = rows.last().map_or(last, |row| row.step);
    }
    let after = rig.steps();
    let ended = rig.now();
    let losses = rig.tool.losses();
    rig.tool.stop_stream().expect("the stream stops");
    let details = rig.tool.details().expect("the board answers");
    let status = rig.tool.status().expect("the board answers");
    Load {
        steps: after.wrapping_sub(before),
        periods: ((ended - began) * u64::from(rate_hz) / 1_000_000_000) as u32,
        overruns: details.overruns,
        losses,
        due: u64::from(last.wrapping_sub(first) / divider) + 1,
        armed: status.state == State::Armed,
        fault: status.fault,
        stack_free: details.stack_free,
    }
}

/// The rates that are tried, Hz, highest first.
const RATES: [u32; 9] = [50_000, 45_000, 40_000, 35_000, 30_000, 25_000, 20_000, 15_000, 10_000];
/// The dividers of a stream that are tried.
const DIVIDERS: [u32; 7] = [1, 2, 3, 4, 5, 10, 20];

/// Runs `case` on a thread of its own: a board that is asked too much may not even answer, and that ends only this
/// attempt.
fn attempt(case: &Case, rate_hz: u32, divider: u32) -> Option<Load> {
    let case = *case;
    let ran = std::thread::spawn(move || run(&mut case.rig(rate_hz), (Fields::USUAL, divider), rate_hz, 200));
    ran.join().ok().filter(Load::in_time)
}

/// The highest of a few rates, Hz, at which `case` misses no period for 200 ms with every step's usual telemetry asked
/// for.
#[must_use]
pub fn highest_rate(case: &Case) -> Option<u32> {
    RATES.into_iter().find(|rate_hz| attempt(case, *rate_hz, 1).is_some())
}

/// Rows of usual telemetry a second that come without a loss while `case` runs at its rate.
#[must_use]
pub fn rows_without_loss(case: &Case) -> Option<u32> {
    let whole = |divider| attempt(case, case.rate_hz, divider).is_some_and(|load| load.losses.missing == 0);
    DIVIDERS.into_iter().find(|divider| whole(*divider)).map(|divider| case.rate_hz / divider)
}
