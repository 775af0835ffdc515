//! The thermal budget of a motor: I²t above what it stands for ever. It knows the current, not the temperature.

/// Time a motor stands its maximum current before the budget trips, s.
pub const PEAK_SECONDS: f32 = 4.0;

/// What heat one motor holds. The default is that of no motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heat {
    /// I²t accumulator, A² s above what the motor stands for ever.
    held: f32,
    /// What rounding has kept out of `held` so far: a step's share can be less than its last digit.
    rest: f32,
    /// The part of `held` that is guessed, and the budget that it is half of; an infinite one where the heat is known.
    guess: f32,
    guessed_from: f32,
    /// i² that the motor stands for ever, A²: as it is allowed, as it counted when the motor was warmed the last time, and
    /// as it counts.
    allowed_squared: f32,
    warmed_squared: f32,
    continuous_squared: f32,
    /// i² at the most that is allowed, A².
    max_squared: f32,
    /// A² s; infinite where the maximum current may flow for ever.
    budget: f32,
}

impl Default for Heat {
    fn default() -> Self {
        Self {
            held: 0.0,
            rest: 0.0,
            guess: 0.0,
            guessed_from: f32::INFINITY,
            allowed_squared: 0.0,
            warmed_squared: 0.0,
            continuous_squared: 0.0,
            max_squared: 0.0,
            budget: f32::INFINITY,
        }
    }
}

impl Heat {
    /// Sets the currents that are allowed, A; where none is, there is no motor, or it stays as it is. No motor cools any
    /// faster because more is allowed than when it was warmed: a larger continuous current counts once it is cold.
    pub fn limit(&mut self, max_current: f32, continuous_current: f32) {
        if max_current <= 0.0 {
            return;
        }
        let continuous = continuous_current.min(max_current).max(0.0);
        self.allowed_squared = continuous * continuous;
        self.max_squared = max_current * max_current;
        self.count();
    }

    /// Sets what counts of what is allowed.
    fn count(&mut self) {
        let warm = self.held > 0.0;
        self.continuous_squared =
            if warm { self.allowed_squared.min(self.warmed_squared) } else { self.allowed_squared };
        let budget = (self.max_squared - self.continuous_squared) * PEAK_SECONDS;
        self.budget = if budget > 0.0 { budget } else { f32::INFINITY };
        self.guess();
        if !warm {
            self.warmed_squared = self.continuous_squared;
        }
    }

    /// Where nothing is known, the guess follows the budget: half of it, less what the motor has cooled since.
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
        let gain = squares - self.continuous_squared * dt;
        let share = gain + self.rest;
        let held = self.held + share;
        if held > 0.0 {
            self.rest = share - (held - self.held);
            self.held = held;
            if gain > 0.0 {
                self.warmed_squared = self.continuous_squared;
            }
            // It cools from what is known.
            if held < self.guess {
                self.guess = held;
            }
        } else {
            (self.held, self.rest, self.guess) = (0.0, 0.0, 0.0);
            if self.continuous_squared != self.allowed_squared {
                self.count();
            }
        }
        self.held > self.budget
    }

    /// Goes on where the motor before stands: loading a scene does not cool it, nor does a device that leaves it out.
    pub fn inherit(&mut self, other: &Self) {
        let own = core::mem::replace(self, *other);
        if own.max_squared > 0.0 {
            (self.allowed_squared, self.max_squared) = (own.allowed_squared, own.max_squared);
            self.count();
        }
    }

    /// A² s above what the motor stands for ever; NaN where nobody knows.
    pub fn held(&self) -> f32 {
        if self.guessed_from == 0.0 { f32::NAN } else { self.held }
    }

    /// Starts from what another run left, or, where nothing is known, half way to the budget.
    pub fn start_from(&mut self, held: Option<f32>) {
        let known = held.filter(|held| held.is_finite() && *held >= 0.0);
        (self.held, self.rest, self.guess) = (known.unwrap_or(0.0), 0.0, 0.0);
        self.guessed_from = if known.is_some() { f32::INFINITY } else { 0.0 };
        self.guess();
    }
}
