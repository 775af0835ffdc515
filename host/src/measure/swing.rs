//! Whether a motion grows or decays, judged from sampled positions alone.
//!
//! Turning points of the *velocity* are followed, because a slow return to the wall would hide a small fast oscillation
//! in the position. The swing between successive turning points then grows or shrinks by a constant factor for every
//! half cycle of the dominant mode; the sign of a straight line through its logarithm is the verdict.

/// Turning points left out at the start, while faster modes die out.
const SETTLING: usize = 8;
/// Turning points after which the trend is judged.
const ENOUGH: usize = 30;
/// Growth over the first swings at which nobody waits for the trend.
const RUNAWAY: f64 = 4.0;
/// Share of the largest swing below which a motion has died out.
const GONE: f64 = 0.02;
/// Rows without a verdict after which the motion is taken at its present trend.
const LONGEST: usize = 6000;

/// What a motion does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It dies out.
    Decays,
    /// It builds up: the loop oscillates.
    Grows,
}

/// A motion being followed.
#[derive(Clone, Debug)]
pub struct Swing {
    row_seconds: f64,
    /// Changes of velocity smaller than this are quantisation, m/s.
    noise: f64,
    /// Farthest distance from the wall that is still a trial, m.
    farthest: f64,
    last: Option<f64>,
    /// The extreme since the last turning point, and whether the velocity rises.
    extreme: Option<(f64, bool)>,
    turned: Option<f64>,
    swings: Vec<f64>,
    rows: usize,
    since_turn: usize,
}

impl Swing {
    /// Follows rows `row_seconds` apart of positions with steps of `quantum` (m), pulled aside by `pull` (m) at first.
    pub fn new(row_seconds: f64, quantum: f64, pull: f64) -> Self {
        Self {
            row_seconds,
            noise: 3.0 * quantum / row_seconds,
            farthest: 12.0 * pull,
            last: None,
            extreme: None,
            turned: None,
            swings: Vec::new(),
            rows: 0,
            since_turn: 0,
        }
    }

    /// Takes the next position (m); says the verdict once there is one.
    pub fn take(&mut self, place: f64) -> Option<Verdict> {
        self.rows += 1;
        self.since_turn += 1;
        if place.abs() > self.farthest {
            return Some(Verdict::Grows);
        }
        if let Some(last) = self.last.replace(place) {
            self.velocity((place - last) / self.row_seconds);
        }
        self.verdict()
    }

    /// Notes a turning point when the velocity has come back from its extreme by more than noise.
    fn velocity(&mut self, v: f64) {
        let Some((extreme, rising)) = self.extreme else {
            self.extreme = Some((v, true));
            return;
        };
        let further = if rising { v > extreme } else { v < extreme };
        if further {
            self.extreme = Some((v, rising));
        } else if (v - extreme).abs() > self.noise.max(self.floor()) {
            if let Some(before) = self.turned.replace(extreme) {
                self.swings.push((extreme - before).abs());
            }
            self.extreme = Some((v, !rising));
            self.since_turn = 0;
        }
    }

    /// Swings smaller than this are not followed.
    fn floor(&self) -> f64 {
        0.2 * GONE * self.largest()
    }

    fn largest(&self) -> f64 {
        self.swings.iter().copied().fold(0.0, f64::max)
    }

    fn verdict(&self) -> Option<Verdict> {
        let count = self.swings.len();
        if count >= 4 {
            let latest = self.swings[count - 1];
            let early = self.swings[1..4.min(count)].iter().copied().fold(0.0, f64::max);
            if latest > RUNAWAY * early {
                return Some(Verdict::Grows);
            }
            if latest < GONE * self.largest() {
                return Some(Verdict::Decays);
            }
        }
        if count >= ENOUGH {
            return Some(self.trend());
        }
        // No turning point for much longer than the ones before took: it has died out into the noise.
        let silent = self.since_turn > 400.max(6 * self.rows / (count + 1));
        if silent || self.rows >= LONGEST {
            return Some(if count > SETTLING + 4 && !silent { self.trend() } else { Verdict::Decays });
        }
        None
    }

    /// The sign of the slope of ln(swing) after the settling.
    fn trend(&self) -> Verdict {
        let kept: Vec<f64> = self.swings.iter().skip(SETTLING).filter(|s| **s > 0.0).map(|s| s.ln()).collect();
        let n = kept.len() as f64;
        let mean = kept.iter().sum::<f64>() / n;
        let slope: f64 = kept.iter().enumerate().map(|(i, s)| (i as f64 - (n - 1.0) / 2.0) * (s - mean)).sum();
        if slope > 0.0 { Verdict::Grows } else { Verdict::Decays }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(growth_per_second: f64, drift: f64, quantum: f64) -> Verdict {
        let dt = 1e-3;
        let mut swing = Swing::new(dt, quantum, 1e-3);
        for k in 0..20_000 {
            let t = f64::from(k) * dt;
            let x = 1e-3 * (growth_per_second * t).exp() * (40.0 * t).sin() + drift * (-2.0 * t).exp();
            let x = if quantum > 0.0 { (x / quantum).round() * quantum } else { x };
            if let Some(verdict) = swing.take(x) {
                return verdict;
            }
        }
        panic!("no verdict");
    }

    #[test]
    fn slow_growth_is_told_from_slow_decay() {
        for drift in [0.0, 2e-3] {
            assert_eq!(judged(0.1, drift, 0.0), Verdict::Grows);
            assert_eq!(judged(-0.1, drift, 0.0), Verdict::Decays);
        }
    }

    #[test]
    fn quantisation_does_not_change_the_verdict() {
        assert_eq!(judged(0.5, 0.0, 1e-6), Verdict::Grows);
        assert_eq!(judged(-0.5, 0.0, 1e-6), Verdict::Decays);
        assert_eq!(judged(-40.0, 0.0, 1e-5), Verdict::Decays);
    }
}
