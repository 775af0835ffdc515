//! The thermal budget of a motor: I²t above the motor's continuous current. Temperature is not measured.

use crate::model::catalogue::MAX_JOINTS;
use core::sync::atomic::{AtomicU32, Ordering};

/// Time for which a motor tolerates its maximum current before the budget trips, s.
pub const PEAK_SECONDS: f32 = 4.0;
/// Time after which a raised continuous limit applies to a motor that is still warm, s.
pub const WAIT_SECONDS: f32 = 60.0;
/// Number of words of a stored [`Heat`].
pub const WORDS: usize = 7;
/// Number of words of the stored heat of all motors, with their checksum.
pub const STORED_WORDS: usize = WORDS * MAX_JOINTS + 1;
/// Initial value of the checksum, which distinguishes stored heat from arbitrary memory contents.
const CHECKSUM_SEED: u32 = 0x4845_4154;

fn add_to_sum(sum: u32, word: u32) -> u32 {
    (sum ^ word).wrapping_mul(0x0100_0193)
}

/// Writes the heat of all motors to memory that is preserved across a restart.
#[inline(never)]
pub fn store_heat(heat: &[Heat; MAX_JOINTS], memory: &[AtomicU32; STORED_WORDS]) {
    let mut sum = CHECKSUM_SEED;
    for (heat, memory) in heat.iter().zip(memory.chunks_exact(WORDS)) {
        for (word, place) in heat.words().into_iter().zip(memory) {
            place.store(word, Ordering::Relaxed);
            sum = add_to_sum(sum, word);
        }
    }
    memory[STORED_WORDS - 1].store(sum, Ordering::Relaxed);
}

/// Returns the heat that [`store_heat`] wrote. The heat is unknown after a loss of power or a restart during the write.
pub fn stored_heat(memory: &[AtomicU32; STORED_WORDS]) -> [Heat; MAX_JOINTS] {
    let word = |i: usize| memory[i.min(STORED_WORDS - 1)].load(Ordering::Relaxed);
    let words: [[u32; WORDS]; MAX_JOINTS] =
        core::array::from_fn(|motor| core::array::from_fn(|i| word(WORDS * motor + i)));
    let whole =
        word(STORED_WORDS - 1) == words.iter().flatten().fold(CHECKSUM_SEED, |sum, word| add_to_sum(sum, *word));
    if whole { words.map(Heat::from_words) } else { [Heat::UNKNOWN; MAX_JOINTS] }
}

/// The heat of one motor, kept across devices, rules and restarts. The default is a cold motor without allowed current.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heat {
    /// I²t accumulator above the continuous current, A² s.
    held: f32,
    /// Rounding error of `held`, because the change in one step can be less than the last digit of `held`.
    rounding: f32,
    /// Guessed part of `held`, A² s.
    guess: f32,
    /// Budget that the guess is based on, A² s; infinite if the heat is known.
    guess_budget: f32,
    /// Square of the allowed continuous current, A².
    allowed_squared: f32,
    /// Value of `allowed_squared` when the motor was last cold, A².
    warmed_squared: f32,
    /// The smaller of `allowed_squared` and `warmed_squared`, A².
    continuous_squared: f32,
    /// Factor of i² above `continuous_squared` in the accumulator.
    weight: f32,
    /// Time until a raised limit applies while the motor is warm, s.
    wait: f32,
    /// Square of the largest allowed current, A²; 0 before a motor is known.
    max_squared: f32,
    /// Budget, A² s; infinite if the maximum current is allowed continuously.
    budget: f32,
}

impl Default for Heat {
    fn default() -> Self {
        Self { guess_budget: f32::INFINITY, ..Self::UNKNOWN }
    }
}

impl Heat {
    /// Unknown heat: half of the budget, as soon as a budget is known.
    pub const UNKNOWN: Self = Self {
        held: 0.0,
        rounding: 0.0,
        guess: 0.0,
        guess_budget: 0.0,
        allowed_squared: 0.0,
        warmed_squared: 0.0,
        continuous_squared: 0.0,
        weight: 1.0,
        wait: WAIT_SECONDS,
        max_squared: 0.0,
        budget: f32::INFINITY,
    };

    /// Sets the allowed currents, A. Without an allowed current there is no motor, and the heat stays unchanged. A
    /// larger continuous current applies once the motor is cold or after [`WAIT_SECONDS`], because a higher limit does
    /// not make a motor cool faster. A lower limit does not extend the remaining time at the maximum current.
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
        self.update_budget();
    }

    fn update_budget(&mut self) {
        if self.held <= 0.0 || self.max_squared <= self.warmed_squared {
            self.warmed_squared = self.allowed_squared;
        }
        self.continuous_squared = self.allowed_squared.min(self.warmed_squared);
        let (above, all) = (self.max_squared - self.warmed_squared, self.max_squared - self.continuous_squared);
        (self.weight, self.budget) =
            if above > 0.0 { (above / all, above * PEAK_SECONDS) } else { (1.0, f32::INFINITY) };
        self.update_guess();
    }

    /// Updates the guess while the heat is unknown: half of the budget, less the cooling since the start.
    fn update_guess(&mut self) {
        if !self.budget.is_finite() || self.guess_budget == f32::INFINITY {
            return;
        }
        let half = 0.5 * self.budget;
        let guessed = (self.guess + (half - 0.5 * self.guess_budget).max(0.0)).min(half);
        self.held += guessed - self.guess;
        (self.guess, self.guess_budget) = (guessed, self.budget);
    }

    /// Warms the motor by `squares`, the integral of i² (A² s) over the last `dt` (s). Returns true if the heat above
    /// the continuous current exceeds the heat of [`PEAK_SECONDS`] at the maximum current.
    #[inline(always)]
    pub fn warm(&mut self, squares: f32, dt: f32) -> bool {
        let share = (squares - self.continuous_squared * dt) * self.weight + self.rounding;
        let held = self.held + share;
        if held > 0.0 && self.max_squared > 0.0 {
            self.rounding = share - (held - self.held);
            self.held = held;
            // Cooling below the guess reduces the guess.
            if held < self.guess {
                self.guess = held;
            }
        } else {
            (self.held, self.rounding, self.guess) = (0.0, 0.0, 0.0);
        }
        if self.warmed_squared != self.allowed_squared {
            self.apply_raised_limit(dt);
        }
        self.held > self.budget
    }

    /// Applies the present limits if the motor is cold or a raised limit has waited for long enough.
    #[cold]
    fn apply_raised_limit(&mut self, dt: f32) {
        self.wait -= dt;
        if self.held <= 0.0 {
            self.update_budget();
        } else if self.wait <= 0.0 && self.allowed_squared > self.warmed_squared {
            self.warmed_squared = self.allowed_squared;
            self.update_budget();
        }
    }

    /// Returns the heat above the continuous level, A² s; NaN if unknown.
    pub fn held(&self) -> f32 {
        if self.guess_budget == 0.0 { f32::NAN } else { self.held }
    }

    /// Returns the complete state as words, for storage across a restart.
    pub fn words(&self) -> [u32; WORDS] {
        [
            self.held,
            self.rounding,
            self.guess,
            self.guess_budget,
            self.allowed_squared,
            self.warmed_squared,
            self.max_squared,
        ]
        .map(f32::to_bits)
    }

    /// Returns the state from stored [`Heat::words`]; unknown heat if the words are not valid.
    pub fn from_words(words: [u32; WORDS]) -> Self {
        let values = words.map(f32::from_bits);
        let [held, rounding, guess, guess_budget, allowed_squared, warmed_squared, max_squared] = values;
        let finite = [held, guess, allowed_squared, warmed_squared, max_squared];
        let is_valid = finite.iter().all(|value| value.is_finite() && *value >= 0.0);
        if !is_valid || !rounding.is_finite() || guess_budget.is_nan() {
            return Self::UNKNOWN;
        }
        let mut heat =
            Self { held, rounding, guess, guess_budget, allowed_squared, warmed_squared, max_squared, ..Self::UNKNOWN };
        heat.update_budget();
        heat
    }
}
