//! A board under full load: in contact, telemetry streaming, settings changing. What must not happen is a
//! period that is missed.

use std::time::Duration;

use haptic_bridge::board::protocol::HostContact;
use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::safety::fault::{FaultRecord, State};
use haptic_host::link::Losses;
use haptic_sim::TIMER_HZ;

use crate::cases::Case;
use crate::contact::{WallAt, scene};
use crate::exchange;
use crate::rig::Rig;
use crate::run::MILLISECOND;

/// The result of a stretch under load.
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
    /// True if the walls were still rendered at the end.
    pub armed: bool,
    /// The fault that is latched.
    pub fault: Option<FaultRecord>,
    /// Bytes of stack that were never used since boot.
    pub stack_free: u32,
}

impl Load {
    /// Returns true if every period had its step.
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
    let overruns = rig.tool.details().expect("the board answers").overruns;
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
        // The timer divides its clock by whole numbers: 45 kHz are some 2 in 10,000 slower than that.
        periods: ((ended - began) as f64 * 1.0e-9 * true_rate(rate_hz)) as u32,
        overruns: details.overruns.wrapping_sub(overruns),
        losses,
        due: u64::from(last.wrapping_sub(first) / divider) + 1,
        armed: status.state == State::Armed,
        fault: status.fault,
        stack_free: details.stack_free,
    }
}

/// The rate that a board makes of one that is asked for, Hz.
fn true_rate(rate_hz: u32) -> f64 {
    f64::from(Carrier::for_rate(TIMER_HZ, rate_hz as f32).rate_hz())
}

/// Takes the scene of an armed `rig` for one whose walls, one or two by the `nth`, are far from the tip.
///
/// # Panics
///
/// When the board refuses it.
pub fn set_free_scene(rig: &mut Rig, rate_hz: u32, nth: usize) {
    let task = rig.file.as_ref().map_or(2, |file| file.spec().task);
    let tip = rig.with_simulated(|device| device.tip());
    let walls = [([0.0, -1.0, 0.0], 0.02), ([-1.0, 0.0, 0.0], 0.05)]
        .map(|(normal, gap)| WallAt { gap, ..WallAt::facing(normal) });
    let head = format!("rate_hz = {rate_hz}\ngravity_compensation = true\n");
    rig.set_scene(&scene(&head, tip, task, &walls[..1 + nth % 2]));
}

/// Returns true if `case` takes new scenes at a rate with the motors on, and every period has its step all the while.
///
/// # Panics
///
/// When the board refuses anything.
#[must_use]
pub fn takes_scenes(case: &Case, rate_hz: u32) -> bool {
    let mut rig = case.rig(rate_hz);
    let overruns = |rig: &mut Rig| rig.tool.details().expect("the board answers").overruns;
    let before = overruns(&mut rig);
    let all = (0..4).all(|nth| {
        let (began, steps) = (rig.now(), rig.steps());
        set_free_scene(&mut rig, rate_hz, nth);
        rig.run(20 * MILLISECOND);
        // Asking takes time: what passed is read first.
        let (steps, passed) = (rig.steps().wrapping_sub(steps), rig.now() - began);
        let periods = passed as f64 * 1.0e-9 * true_rate(rate_hz);
        let armed = rig.tool.status().expect("the board answers").state == State::Armed;
        armed && (f64::from(steps) - periods).abs() < 1.5
    });
    all && overruns(&mut rig) == before
}

/// Returns true if `case` renders a host's plane beside its own walls at a rate, and every period has its step:
/// requests as fast as they are answered, and a row of telemetry each millisecond.
///
/// # Panics
///
/// When the link breaks.
#[must_use]
pub fn takes_a_plane(case: &Case, rate_hz: u32) -> bool {
    let plane = HostContact { point: [0.0; 3], normal: [0.0, 1.0, 0.0], stiffness: 300.0, damping: 1.0 };
    let mut rig = case.rig(rate_hz);
    let before = rig.tool.details().expect("the board answers").overruns;
    let done = exchange::run(&mut rig, (Fields::USUAL, rate_hz / 1000), rate_hz, 200, Some(plane), 1);
    done.armed && done.not_taken == 0 && done.overruns == before
}

/// Returns true if `case` sustains a rate while the limit of the force at the tip, a quarter of what the hand pushes
/// with, cuts in every step.
///
/// # Panics
///
/// When the link breaks.
#[must_use]
pub fn takes_cuts(case: &Case, rate_hz: u32) -> bool {
    let mut rig = case.rig(rate_hz);
    let mut rules = rig.tool.rules().expect("the board answers");
    rules.limits.tip_force = 0.2;
    rig.tool.set_rules(&rules).expect("rules are tightened in contact");
    let before = rig.tool.details().expect("the board answers").overruns;
    rig.run(200 * MILLISECOND);
    let armed = rig.tool.status().expect("the board answers").state == State::Armed;
    armed && rig.tool.details().expect("the board answers").overruns == before
}

/// The highest rate at which a board `sustains` what `case` is put to.
#[must_use]
pub fn highest_for(case: &Case, sustains: fn(&Case, u32) -> bool) -> Option<u32> {
    RATES.into_iter().find(|&rate_hz| {
        let case = *case;
        std::thread::spawn(move || sustains(&case, rate_hz)).join().unwrap_or(false)
    })
}

/// The rates that are tried, Hz, highest first.
const RATES: [u32; 9] = [50_000, 45_000, 40_000, 35_000, 30_000, 25_000, 20_000, 15_000, 10_000];
/// The dividers of a stream that are tried.
const DIVIDERS: [u32; 7] = [1, 2, 3, 4, 5, 10, 20];

/// Runs `case` on a thread of its own: a board that is asked too much may not even answer, and that ends only this
/// attempt.
fn attempt(case: &Case, rate_hz: u32, divider: u32, milliseconds: u64) -> Option<Load> {
    let case = *case;
    let ran = std::thread::spawn(move || run(&mut case.rig(rate_hz), (Fields::USUAL, divider), rate_hz, milliseconds));
    ran.join().ok().filter(Load::in_time)
}

/// The highest of a few rates, Hz, at which `case` misses no period for 200 ms with every step's usual telemetry asked
/// for.
#[must_use]
pub fn highest_rate(case: &Case) -> Option<u32> {
    RATES.into_iter().find(|rate_hz| attempt(case, *rate_hz, 1, 200).is_some())
}

/// Rows of usual telemetry a second that come without a loss while `case` runs at its rate for a second: queues are full
/// by then.
#[must_use]
pub fn rows_without_loss(case: &Case) -> Option<u32> {
    let whole = |divider| attempt(case, case.rate_hz, divider, 1_000).is_some_and(|load| load.losses.missing == 0);
    DIVIDERS.into_iter().find(|divider| whole(*divider)).map(|divider| case.rate_hz / divider)
}
