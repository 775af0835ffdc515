//! A board under full load, in contact, with streaming telemetry and changing settings, must not miss a control period.

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
use crate::contact::{NearWall, scene};
use crate::exchange;
use crate::rig::Rig;
use crate::run::MILLISECOND;

/// Result of a run under load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Number of control steps.
    pub steps: u32,
    /// Number of control periods.
    pub periods: u32,
    /// Number of steps that lasted past the next crest.
    pub overruns: u32,
    /// Losses of telemetry.
    pub losses: Losses,
    /// Number of telemetry rows that were due.
    pub due_rows: u64,
    /// True if the walls were still rendered at the end.
    pub is_armed: bool,
    /// The latched fault.
    pub fault: Option<FaultRecord>,
    /// Stack that was never used since the start, bytes.
    pub stack_free: u32,
}

impl Load {
    /// Returns true if every period had its step.
    #[must_use]
    pub fn is_in_time(&self) -> bool {
        self.is_armed && self.overruns == 0 && self.steps.abs_diff(self.periods) <= 1
    }
}

/// Returns gains of the first wall, which alternate between two values with `nth`.
fn alternating_gains(nth: u64) -> Gains<f32> {
    let stiffness = if nth.is_multiple_of(2) { 450.0 } else { 550.0 };
    Gains { wall: 0, stiffness, damping: 1.0, feed_forward: FeedForward::Full, washout_hz: 2.0 }
}

/// Makes the nth change of a setting, which is in turn a change of gains, rules or the velocity filter.
fn change_setting(rig: &mut Rig, nth: u64) {
    let odd = !(nth / 3).is_multiple_of(2);
    match nth % 3 {
        0 => rig.tool.set_wall_gains(alternating_gains(nth / 3)).expect("gains change in contact"),
        1 => {
            // Rules are only tightened, because protective rules cannot be loosened while the motors are on.
            let mut rules = rig.tool.rules().expect("the board replies");
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

/// Runs a rig that is in contact for `milliseconds`. Meanwhile `fields` of every `divider`th step are streamed, and a
/// setting changes ten times per second.
pub fn run(rig: &mut Rig, (fields, divider): (Fields, u32), rate_hz: u32, milliseconds: u64) -> Load {
    rig.tool.start_stream(fields, divider).expect("a stream starts");
    rig.run(5 * MILLISECOND);
    let overruns = rig.tool.details().expect("the board replies").overruns;
    let before = rig.steps();
    let began = rig.now();
    let first = rig.tool.rows(Duration::from_millis(50)).expect("rows come")[0].step;
    let end = began + milliseconds * MILLISECOND;
    let mut changes = 0;
    let mut last = first;
    while rig.now() < end {
        let now = rig.now();
        if now >= began + changes * 100 * MILLISECOND {
            change_setting(rig, changes);
            changes += 1;
        }
        let rows = rig.tool.rows(Duration::from_millis(10)).expect("rows come");
        last = rows.last().map_or(last, |row| row.step);
    }
    let after = rig.steps();
    let ended = rig.now();
    let losses = rig.tool.losses();
    rig.tool.stop_stream().expect("the stream stops");
    let details = rig.tool.details().expect("the board replies");
    let status = rig.tool.status().expect("the board replies");
    Load {
        steps: after.wrapping_sub(before),
        // The timer divides its clock by integers, so the true rate for 45 kHz is about 0.02 % lower.
        periods: ((ended - began) as f64 * 1.0e-9 * true_rate(rate_hz)) as u32,
        overruns: details.overruns.wrapping_sub(overruns),
        losses,
        due_rows: u64::from(last.wrapping_sub(first) / divider) + 1,
        is_armed: status.state == State::Armed,
        fault: status.fault,
        stack_free: details.stack_free,
    }
}

/// Returns the true control rate of a board for a requested rate, Hz.
fn true_rate(rate_hz: u32) -> f64 {
    f64::from(Carrier::for_rate(TIMER_HZ, rate_hz as f32).rate_hz())
}

/// Replaces the scene of an armed rig with a scene of one or two walls, depending on `nth`, far from the tip.
pub fn set_free_scene(rig: &mut Rig, rate_hz: u32, nth: usize) {
    let task = rig.file.as_ref().map_or(2, |file| file.spec().task);
    let tip = rig.with_simulated(|device| device.tip());
    let walls = [([0.0, -1.0, 0.0], 0.02), ([-1.0, 0.0, 0.0], 0.05)]
        .map(|(normal, gap)| NearWall { gap, ..NearWall::with_normal(normal) });
    let head = format!("rate_hz = {rate_hz}\ngravity_compensation = true\n");
    rig.set_scene(&scene(&head, tip, task, &walls[..1 + nth % 2]));
}

/// Returns true if `case` accepts new scenes at a rate (Hz) while the motors are on, without missing a period.
#[must_use]
pub fn sustains_scenes(case: &Case, rate_hz: u32) -> bool {
    let mut rig = case.rig(rate_hz);
    let overruns = |rig: &mut Rig| rig.tool.details().expect("the board replies").overruns;
    let before = overruns(&mut rig);
    let all = (0..4).all(|nth| {
        let (began, steps) = (rig.now(), rig.steps());
        set_free_scene(&mut rig, rate_hz, nth);
        rig.run(20 * MILLISECOND);
        // The status request takes virtual time, so the elapsed time is computed before it.
        let (steps, elapsed_ns) = (rig.steps().wrapping_sub(steps), rig.now() - began);
        let periods = elapsed_ns as f64 * 1.0e-9 * true_rate(rate_hz);
        let is_armed = rig.tool.status().expect("the board replies").state == State::Armed;
        is_armed && (f64::from(steps) - periods).abs() < 1.5
    });
    all && overruns(&mut rig) == before
}

/// Returns true if `case` renders a host's plane in addition to its own walls at a rate (Hz) without missing a period.
/// The host sends requests as fast as the board replies, and streams a row per millisecond.
#[must_use]
pub fn sustains_plane(case: &Case, rate_hz: u32) -> bool {
    let plane = HostContact { point: [0.0; 3], normal: [0.0, 1.0, 0.0], stiffness: 300.0, damping: 1.0 };
    let mut rig = case.rig(rate_hz);
    let before = rig.tool.details().expect("the board replies").overruns;
    let exchanges = exchange::run(&mut rig, (Fields::USUAL, rate_hz / 1000), rate_hz, 200, Some(plane), 1);
    exchanges.is_armed && exchanges.rejected == 0 && exchanges.overruns == before
}

/// Returns true if `case` sustains a rate (Hz) while a low tip-force limit reduces the force in every step.
#[must_use]
pub fn sustains_force_limit(case: &Case, rate_hz: u32) -> bool {
    let mut rig = case.rig(rate_hz);
    let mut rules = rig.tool.rules().expect("the board replies");
    rules.limits.tip_force = 0.2;
    rig.tool.set_rules(&rules).expect("rules are tightened in contact");
    let before = rig.tool.details().expect("the board replies").overruns;
    rig.run(200 * MILLISECOND);
    let is_armed = rig.tool.status().expect("the board replies").state == State::Armed;
    is_armed && rig.tool.details().expect("the board replies").overruns == before
}

/// Returns the highest rate (Hz) at which `case` passes the test `sustains`.
#[must_use]
pub fn highest_sustained_rate(case: &Case, sustains: fn(&Case, u32) -> bool) -> Option<u32> {
    RATES_HZ.into_iter().find(|&rate_hz| {
        let case = *case;
        std::thread::spawn(move || sustains(&case, rate_hz)).join().unwrap_or(false)
    })
}

/// Tested rates, Hz, highest first.
const RATES_HZ: [u32; 9] = [50_000, 45_000, 40_000, 35_000, 30_000, 25_000, 20_000, 15_000, 10_000];
/// Tested dividers of a stream, lowest first.
const DIVIDERS: [u32; 7] = [1, 2, 3, 4, 5, 10, 20];

/// Runs `case` on its own thread, because an overloaded board may stop replying and then only this attempt panics.
fn attempt(case: &Case, rate_hz: u32, divider: u32, milliseconds: u64) -> Option<Load> {
    let case = *case;
    let ran = std::thread::spawn(move || run(&mut case.rig(rate_hz), (Fields::USUAL, divider), rate_hz, milliseconds));
    ran.join().ok().filter(Load::is_in_time)
}

/// Returns the highest tested rate (Hz) at which `case` misses no period in 200 ms with default telemetry.
#[must_use]
pub fn highest_rate(case: &Case) -> Option<u32> {
    RATES_HZ.into_iter().find(|rate_hz| attempt(case, *rate_hz, 1, 200).is_some())
}

/// Returns the rows of default telemetry per second that arrive without a loss while `case` runs at its rate. The run
/// of 1 s is long enough to fill all queues.
#[must_use]
pub fn rows_without_loss(case: &Case) -> Option<u32> {
    let clean = |divider| attempt(case, case.rate_hz, divider, 1_000).is_some_and(|load| load.losses.missing == 0);
    DIVIDERS.into_iter().find(|divider| clean(*divider)).map(|divider| case.rate_hz / divider)
}
