//! Feeds the watchdog, and only when everything that has to move has moved: the control interrupt since the last
//! feeding, and every task within its own time.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_time::{Duration, Instant, Ticker};

use crate::servo;
use crate::watchdog::Watchdog;

/// Time between feedings; the watchdog bites after 68 ms at the earliest.
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

/// A task's sign of life, to be given at least every second.
pub fn alive(task: Task) {
    LAST_HEARD_MS[task as usize].store(now_ms(), Ordering::Relaxed);
}

fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}

/// Feeds the watchdog for as long as all is well.
#[embassy_executor::task]
pub async fn supervise(mut watchdog: Watchdog) -> ! {
    let mut ticker = Ticker::every(PERIOD);
    let mut steps = servo::STEPS.load(Ordering::Relaxed);
    for task in TASKS {
        alive(task);
    }
    loop {
        ticker.next().await;
        let before = core::mem::replace(&mut steps, servo::STEPS.load(Ordering::Relaxed));
        let now = now_ms();
        let silent = TASKS
            .into_iter()
            .find(|task| now.wrapping_sub(LAST_HEARD_MS[*task as usize].load(Ordering::Relaxed)) > SILENCE_MAX_MS);
        match (steps != before, silent) {
            (true, None) => watchdog.feed(),
            (false, _) => defmt::error!("the control step stands still"),
            (true, Some(task)) => defmt::error!("task {} is silent", task),
        }
    }
}
