//! Has the watchdog fed, and only when everything that has to move has moved: the control interrupt since the last
//! feeding, no more often than its rate says and, while the motors are on, no less often, and every task within its own
//! time.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_time::{Duration, Instant, Ticker};
use haptic_bridge::drive::carrier::CARRIER_MIN_HZ;
use haptic_bridge::safety::pace::{Pace, Verdict};

use crate::servo;
use crate::watchdog::{self, Watchdog};

/// Time between looks; one is worth 100 ms to the watchdog.
const PERIOD: Duration = Duration::from_millis(20);

/// Longest time between two signs of life of a task, ms.
const SILENCE_MAX_MS: u32 = 1000;

/// A task that the supervisor watches.
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
pub enum Task {
    /// The one that answers the host.
    Link = 0,
}

const TASKS: [Task; 1] = [Task::Link];

/// When each task was last heard, ms since the start.
static LAST_HEARD_MS: [AtomicU32; TASKS.len()] = [const { AtomicU32::new(0) }; TASKS.len()];

/// Control steps a second that were asked for last.
static RATE_HZ: AtomicU32 = AtomicU32::new(CARRIER_MIN_HZ);

/// The control rate is this from now on, Hz.
pub fn expect(rate_hz: f32) {
    RATE_HZ.store(rate_hz as u32 + 1, Ordering::Relaxed);
}

/// The share of control steps whose duties applied half a carrier period later than usual, as bits of an `f32`.
static LATE_SHARE: AtomicU32 = AtomicU32::new(0);

/// Steps over which that share is taken: a fifth of a second at 20 kHz.
const LATE_WINDOW: f32 = 4096.0;

/// That share, of late.
pub fn late_share() -> f32 {
    f32::from_bits(LATE_SHARE.load(Ordering::Relaxed))
}

/// Takes so many `steps` into it, of which so many were `late`.
fn note_late(late: u32, steps: u32) {
    let weight = (steps as f32 / LATE_WINDOW).min(1.0);
    let share = if steps > 0 { late as f32 / steps as f32 } else { 0.0 };
    LATE_SHARE.store((late_share() + (share - late_share()) * weight).to_bits(), Ordering::Relaxed);
}

/// A task's sign of life, to be given at least every second.
pub fn alive(task: Task) {
    LAST_HEARD_MS[task as usize].store(now_ms(), Ordering::Relaxed);
}

fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}

/// Has the watchdog fed for as long as all is well.
#[embassy_executor::task]
pub async fn supervise(mut watchdog: Watchdog) -> ! {
    let mut ticker = Ticker::every(PERIOD);
    let mut steps = servo::shared().steps.load(Ordering::Relaxed);
    let mut late_steps = servo::shared().late_steps.load(Ordering::Relaxed);
    let mut pace = Pace::new(RATE_HZ.load(Ordering::Relaxed));
    let mut looked = Instant::now();
    let mut stalls = watchdog::stalls();
    let mut up = false;
    for task in TASKS {
        alive(task);
    }
    loop {
        ticker.next().await;
        let before = core::mem::replace(&mut steps, servo::shared().steps.load(Ordering::Relaxed));
        let late_before = core::mem::replace(&mut late_steps, servo::shared().late_steps.load(Ordering::Relaxed));
        note_late(late_steps.wrapping_sub(late_before), steps.wrapping_sub(before));
        let elapsed = core::mem::replace(&mut looked, Instant::now()).elapsed().as_micros();
        // While flash is written no step is taken. With the motors off, a scene that the chip cannot keep up with is no
        // reason to restart with the same scene; a power stage that has only just come up is checked at the next look.
        let stalled = core::mem::replace(&mut stalls, watchdog::stalls()) != stalls;
        let up_before = core::mem::replace(&mut up, servo::shared().gate_ready.load(Ordering::Relaxed));
        let excused = stalled || !(up && up_before);
        let verdict = pace.look(steps.wrapping_sub(before), elapsed, RATE_HZ.load(Ordering::Relaxed), excused);
        let now = now_ms();
        let silent = TASKS
            .into_iter()
            .find(|task| now.wrapping_sub(LAST_HEARD_MS[*task as usize].load(Ordering::Relaxed)) > SILENCE_MAX_MS);
        match (steps != before, verdict, silent) {
            (true, Verdict::Kept, None) => watchdog.feed(),
            (false, ..) => defmt::error!("the control step stands still"),
            (true, Verdict::TooOften, _) => defmt::error!("the control step runs too often"),
            (true, Verdict::TooSeldom, _) => defmt::error!("the control step runs too seldom"),
            (true, Verdict::Kept, Some(task)) => defmt::error!("task {} is silent", task),
        }
    }
}
