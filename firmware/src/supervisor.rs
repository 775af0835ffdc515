//! Feeds the watchdog while all checks pass. The control interrupt must have run since the last check, must not run
//! too often and, while the motors are on, not too rarely. Every task must have reported in time.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_time::{Duration, Instant, Ticker};
use haptic_bridge::drive::carrier::CARRIER_MIN_HZ;
use haptic_bridge::safety::pace::{Pace, Verdict};

use crate::interrupt;
use crate::watchdog::{self, Watchdog};

/// Time between checks. One passed check lets the watchdog run for 100 ms.
const CHECK_PERIOD: Duration = Duration::from_millis(20);
/// Longest time between two reports of a task, ms.
const MAX_SILENCE_MS: u32 = 1000;

/// A task that the supervisor watches.
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
pub enum Task {
    /// The task that replies to the host.
    Link = 0,
}

const TASKS: [Task; 1] = [Task::Link];

/// Time of each task's last report, ms since the start.
static LAST_REPORT_MS: [AtomicU32; TASKS.len()] = [const { AtomicU32::new(0) }; TASKS.len()];
/// Expected control steps per second.
static RATE_HZ: AtomicU32 = AtomicU32::new(CARRIER_MIN_HZ);

/// Sets the expected control rate, Hz.
pub fn expect_rate(rate_hz: f32) {
    RATE_HZ.store(rate_hz as u32 + 1, Ordering::Relaxed);
}

/// Share of control steps whose duties applied half a carrier period late, as bits of an `f32`.
static LATE_SHARE: AtomicU32 = AtomicU32::new(0);
/// Averaging window of the share of late steps, steps: a fifth of a second at 20 kHz.
const LATE_WINDOW: f32 = 4096.0;

/// Returns the share of late steps, averaged over [`LATE_WINDOW`].
pub fn late_share() -> f32 {
    f32::from_bits(LATE_SHARE.load(Ordering::Relaxed))
}

/// Updates the share of late steps with `steps` control steps, of which `late` were late.
fn add_late(late: u32, steps: u32) {
    let weight = (steps as f32 / LATE_WINDOW).min(1.0);
    let share = if steps > 0 { late as f32 / steps as f32 } else { 0.0 };
    LATE_SHARE.store((late_share() + (share - late_share()) * weight).to_bits(), Ordering::Relaxed);
}

/// Reports that a task runs. Every task calls this at least once a second.
pub fn report_alive(task: Task) {
    LAST_REPORT_MS[task as usize].store(now_ms(), Ordering::Relaxed);
}

fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}

/// Feeds the watchdog as long as all checks pass.
#[embassy_executor::task]
pub async fn supervise(mut watchdog: Watchdog) -> ! {
    let mut ticker = Ticker::every(CHECK_PERIOD);
    let mut steps = interrupt::shared().steps.load(Ordering::Relaxed);
    let mut late_steps = interrupt::shared().late_steps.load(Ordering::Relaxed);
    let mut pace = Pace::new(RATE_HZ.load(Ordering::Relaxed));
    let mut checked = Instant::now();
    let mut stalls = watchdog::longest_time_calls();
    let mut up = false;
    for task in TASKS {
        report_alive(task);
    }
    loop {
        ticker.next().await;
        let before = core::mem::replace(&mut steps, interrupt::shared().steps.load(Ordering::Relaxed));
        let late_before = core::mem::replace(&mut late_steps, interrupt::shared().late_steps.load(Ordering::Relaxed));
        add_late(late_steps.wrapping_sub(late_before), steps.wrapping_sub(before));
        let elapsed = core::mem::replace(&mut checked, Instant::now()).elapsed().as_micros();
        // No steps run while flash is written. With the motors off, a scene that is too slow for the chip must not
        // restart the board, because the board would load the same scene again.
        let stalled = core::mem::replace(&mut stalls, watchdog::longest_time_calls()) != stalls;
        let up_before = core::mem::replace(&mut up, interrupt::shared().gate_ready.load(Ordering::Relaxed));
        let excused = stalled || !(up && up_before);
        let verdict = pace.check_rate(steps.wrapping_sub(before), elapsed, RATE_HZ.load(Ordering::Relaxed), excused);
        let now = now_ms();
        let silent = TASKS
            .into_iter()
            .find(|task| now.wrapping_sub(LAST_REPORT_MS[*task as usize].load(Ordering::Relaxed)) > MAX_SILENCE_MS);
        match (steps != before, verdict, silent) {
            (true, Verdict::RightRate, None) => watchdog.feed(),
            (false, ..) => defmt::error!("the control step has stopped"),
            (true, Verdict::TooFast, _) => defmt::error!("the control step runs too often"),
            (true, Verdict::TooSlow, _) => defmt::error!("the control step runs too rarely"),
            (true, Verdict::RightRate, Some(task)) => defmt::error!("task {} is silent", task),
        }
    }
}
