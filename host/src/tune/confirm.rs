//! Walls that were found, pressed once more on the simulated board: by another hand, through bridges and windings.

use super::{Found, STIFFNESS_RATIO, SearchContext, Settings, by_stiffness};
use crate::error::Failure;
use crate::sweep::Sweep;
use std::collections::BTreeSet;

/// From one press to the next softer one, and to which ratio the stiffness is found.
const SOFTER_ON_BOARD: f64 = 1.4;
const CLOSE: f64 = 1.06;
/// No softer than this share of what was found is looked for.
const LEAST: f64 = 0.05;
/// How many are pressed at once, and at most.
const PRESSED_AT_ONCE: usize = 4;
const MOST_PRESSED: usize = 12;

impl SearchContext<'_> {
    /// A wall that keeps both ripples.
    pub(super) fn pressed_on_board(&self, settings: &Settings, stiffness: f64) -> Result<Option<Found>, Failure> {
        self.kept_on_board(self.tried(settings, stiffness, settings.damping)?)
    }

    /// As stiff as the board lets a wall be that was found, and stiffer than `floor`, N/m.
    fn confirm(&self, found: &Found, floor: f64) -> Result<Option<Found>, Failure> {
        let top = found.settings.stiffness;
        let least = floor.max(LEAST * top);
        let (mut high, mut low) = (top, top);
        let mut best = loop {
            if low < least {
                return Ok(None);
            }
            if let Some(found) = self.pressed_on_board(&found.settings, low)? {
                break found;
            }
            (high, low) = (low, low / SOFTER_ON_BOARD);
        };
        while high / low > CLOSE {
            let middle = (low * high).sqrt();
            match self.pressed_on_board(&found.settings, middle)? {
                Some(found) => (low, best) = (middle, found),
                None => high = middle,
            }
        }
        Ok(Some(best))
    }
}

/// Of what was found the best of each estimator and feed-forward, as stiff as both presses let them be, the stiffest
/// first.
pub(super) fn confirmed(
    context: &SearchContext<'_>,
    mut all: Vec<Found>,
    sweep: &Sweep,
) -> Result<Vec<Found>, Failure> {
    by_stiffness(&mut all);
    if context.question.board_ripple_n.is_none() {
        return Ok(all);
    }
    let (mut done, mut waiting): (Vec<Found>, Vec<Found>) =
        all.into_iter().partition(|found| found.board_ripple_n.is_some());
    let mut seen = BTreeSet::new();
    waiting.retain(|found| seen.insert((found.settings.estimator, found.settings.feed_forward.name())));
    waiting.truncate(MOST_PRESSED);
    for (round, some) in waiting.chunks(PRESSED_AT_ONCE).enumerate() {
        // What no estimator's best comes near need not be known exactly.
        let floor = super::COMPARED_SHARE * super::stiffest(&done).map_or(0.0, |found| found.settings.stiffness);
        let results = sweep.map(&format!("on the board, round {}", round + 1), some, |found| {
            let confirmed = context.confirm(found, floor * STIFFNESS_RATIO)?;
            Ok(confirmed.map(|found| (found.settings.stiffness, found.ripple_n, found.board_ripple_n)))
        })?;
        done.extend(some.iter().zip(results).filter_map(|(found, result)| {
            let (stiffness, ripple_n, board_ripple_n) = result?;
            Some(Found { settings: Settings { stiffness, ..found.settings }, ripple_n, board_ripple_n })
        }));
    }
    by_stiffness(&mut done);
    Ok(done)
}
