//! The thermal budget of a motor: I²t above what it stands for ever. It knows the current, not the temperature.

use crate::model::catalogue::MAX_JOINTS;
use core::sync::atomic::{AtomicU32, Ordering};

/// Time a motor stands its maximum current before the budget trips, s.
pub const PEAK_SECONDS: f32 = 4.0;

/// Time after which more that is allowed counts for a motor that is still warm, s.
pub const WAIT_SECONDS: f32 = 60.0;

/// Words that a [`Heat`] is kept in.
pub const WORDS: usize = 7;

/// Words that the heat of all motors is kept in, with their checksum.
pub const KEPT: usize = WORDS * MAX_JOINTS + 1;

/// Starts the checksum: says that heats were written and not that memory happens to hold something.
const MARK: u32 = 0x4845_4154;

fn with(sum: u32, word: u32) -> u32 {
    (sum ^ word).wrapping_mul(0x0100_0193)
}

/// Writes the heat of all motors to memory that a restart leaves alone.
#[inline(never)]
pub fn keep(heat: &[Heat; MAX_JOINTS], memory: &[AtomicU32; KEPT]) {
    let mut sum = MARK;
    for (heat, memory) in heat.iter().zip(memory.chunks_exact(WORDS)) {
        for (word, place) in heat.words().into_iter().zip(memory) {
            place.store(word, Ordering::Relaxed);
            sum = with(sum, word);
        }
    }
    memory[KEPT - 1].store(sum, Ordering::Relaxed);
}

/// The heat that [`keep`] wrote, if it is whole: after a restart in the middle of it, or a time without power, nothing
/// is known.
pub fn kept(memory: &[AtomicU32; KEPT]) -> [Heat; MAX_JOINTS] {
    let word = |i: usize| memory[i.min(KEPT - 1)].load(Ordering::Relaxed);
    let words: [[u32; WORDS]; MAX_JOINTS] =
        core::array::from_fn(|motor| core::array::from_fn(|i| word(WORDS * motor + i)));
    let whole = word(KEPT - 1) == words.iter().flatten().fold(MARK, |sum, word| with(sum, *word));
    if whole { words.map(Heat::from_words) } else { [Heat::UNKNOWN; MAX_JOINTS] }
}

/// The heat that one motor holds. It belongs to the motor and outlasts devices, rules and restarts. The default is a
/// cold motor that is not allowed any current yet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heat {
    /// I²t accumulator, A² s above what the motor stands for ever.
    held: f32,
    /// The part that rounding has kept out of `held` so far: a step's share can be less than its last digit.
    rest: f32,
    /// The part of `held` that is guessed, and the budget that it is half of; an infinite one where the heat is known.
    guess: f32,
    guessed_from: f32,
    /// i² that the motor stands for ever, A²: as it is allowed, and as it counted when the motor was cold the last time.
    allowed_squared: f32,
    warmed_squared: f32,
    /// The smaller of both, and what i² beyond it is worth of what `warmed_squared` counts.
    continuous_squared: f32,
    weight: f32,
    /// Time until more may be allowed while the motor is warm, s.
    wait: f32,
    /// i² at the most that is allowed, A²; 0 before the first motor.
    max_squared: f32,
    /// A² s; infinite where the maximum current may flow for ever.
    budget: f32,
}

impl Default for Heat {
    fn default() -> Self {
        Self { guessed_from: f32::INFINITY, ..Self::UNKNOWN }
    }
}

impl Heat {
    /// Unknown heat: assume half of the budget, as soon as there is a budget.
    pub const UNKNOWN: Self = Self {
        held: 0.0,
        rest: 0.0,
        guess: 0.0,
        guessed_from: 0.0,
        allowed_squared: 0.0,
        warmed_squared: 0.0,
        continuous_squared: 0.0,
        weight: 1.0,
        wait: WAIT_SECONDS,
        max_squared: 0.0,
        budget: f32::INFINITY,
    };

    /// Sets the currents that are allowed, A; where none is, there is no motor now, and it stays as it is. No motor cools any
    /// faster because more is allowed: a larger continuous current counts once it is cold, or after [`WAIT_SECONDS`].
    /// Nor does it stand its peak any longer because less is: what is left of the budget lasts as long at the maximum.
    pub fn limit(&mut self, max_current: f32, continuous_current: f32) {
        if max_current <= 0.0 {
            return;
        }
        let continuous = continuous_current.min(max_current).max(0.0);
        if continuous * continuous > self.allowed_squared {
            self.wait = WAIT_SECONDS;
        }
        self.allowed_squared = continuous * continuous;
        self.max_squared = max_current * max_current;
        self.count();
    }

    /// Sets what counts of what is allowed.
    fn count(&mut self) {
        if self.held <= 0.0 || self.max_squared <= self.warmed_squared {
            self.warmed_squared = self.allowed_squared;
        }
        self.continuous_squared = self.allowed_squared.min(self.warmed_squared);
        let (above, all) = (self.max_squared - self.warmed_squared, self.max_squared - self.continuous_squared);
        (self.weight, self.budget) =
            if above > 0.0 { (above / all, above * PEAK_SECONDS) } else { (1.0, f32::INFINITY) };
        self.guess();
    }

    /// While the heat is unknown, the guess follows the budget: half of it, less the cooling since.
    fn guess(&mut self) {
        if !self.budget.is_finite() || self.guessed_from == f32::INFINITY {
            return;
        }
        let half = 0.5 * self.budget;
        let guess = (self.guess + (half - 0.5 * self.guessed_from).max(0.0)).min(half);
        self.held += guess - self.guess;
        (self.guess, self.guessed_from) = (guess, self.budget);
    }

    /// Warms the motor by `squares`, the integral of i² (A² s) over the last `dt` (s); true when its budget is spent: what
    /// is above what it stands for ever has passed what [`PEAK_SECONDS`] at the maximum current put there.
    #[inline(always)]
    pub fn warm(&mut self, squares: f32, dt: f32) -> bool {
        let share = (squares - self.continuous_squared * dt) * self.weight + self.rest;
        let held = self.held + share;
        if held > 0.0 && self.max_squared > 0.0 {
            self.rest = share - (held - self.held);
            self.held = held;
            // It cools from what is known.
            if held < self.guess {
                self.guess = held;
            }
        } else {
            (self.held, self.rest, self.guess) = (0.0, 0.0, 0.0);
        }
        if self.warmed_squared != self.allowed_squared {
            self.catch_up(dt);
        }
        self.held > self.budget
    }

    /// Counts with what is allowed now, if the motor is cold or more has waited for long enough.
    #[cold]
    fn catch_up(&mut self, dt: f32) {
        self.wait -= dt;
        if self.held <= 0.0 {
            self.count();
        } else if self.wait <= 0.0 && self.allowed_squared > self.warmed_squared {
            self.warmed_squared = self.allowed_squared;
            self.count();
        }
    }

    /// A² s above the level that the motor stands for ever; NaN if unknown.
    pub fn held(&self) -> f32 {
        if self.guessed_from == 0.0 { f32::NAN } else { self.held }
    }

    /// The whole state in words, to be kept while the board restarts.
    pub fn words(&self) -> [u32; WORDS] {
        [
            self.held,
            self.rest,
            self.guess,
            self.guessed_from,
            self.allowed_squared,
            self.warmed_squared,
            self.max_squared,
        ]
        .map(f32::to_bits)
    }

    /// The state that [`Heat::words`] kept; unknown if the words cannot be one.
    pub fn from_words(words: [u32; WORDS]) -> Self {
        let values = words.map(f32::from_bits);
        let [held, rest, guess, guessed_from, allowed_squared, warmed_squared, max_squared] = values;
        let finite = [held, guess, allowed_squared, warmed_squared, max_squared];
        let sound = finite.iter().all(|value| value.is_finite() && *value >= 0.0);
        if !sound || !rest.is_finite() || guessed_from.is_nan() {
            return Self::UNKNOWN;
        }
        let mut heat =
            Self { held, rest, guess, guessed_from, allowed_squared, warmed_squared, max_squared, ..Self::UNKNOWN };
        heat.count();
        heat
    }
}
