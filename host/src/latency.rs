//! The round-trip time to a board, which limits a wall that a program on the computer renders.

use crate::link::{Board, LinkError};
use haptic_bridge::board::protocol::ForceRequest;
use serde::Serialize;

/// Edges of a histogram's bins go 1, 2, 5 in every decade, from here on, s.
const FIRST_EDGE: f64 = 1.0e-5;

/// Whole control periods fall on edges, and a board tells its period in single precision.
const EDGE_TOLERANCE: f64 = 1.0e-6;

/// Times of many exchanges.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Exchanges in a second of the wire's clock.
    pub per_second: f64,
    /// From a request's first byte to its answer's last, on the computer's clock (on a simulated board's in this
    /// process).
    pub round_trip: Spread,
    /// From the state that an answer tells to the board taking the request that follows on it, on the board's clock:
    /// how old what a program computes is when it begins to act.
    pub age: Spread,
}

/// The distribution of a set of times, s.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Number of times.
    pub count: usize,
    /// The shortest.
    pub min: f64,
    /// Half are no longer.
    pub median: f64,
    /// 99 of 100 are no longer.
    pub p99: f64,
    /// 999 of 1000 are no longer.
    pub p999: f64,
    /// The longest.
    pub max: f64,
    /// Bins without gaps, from the first to the last that holds any.
    pub histogram: Vec<Bin>,
}

/// A bin of a histogram: times t with from < t ≤ to, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bin {
    /// s
    pub from: f64,
    /// s
    pub to: f64,
    /// Number of occurrences.
    pub count: usize,
}

/// Exchanges so many requests (at least 2) that ask nothing of the motors, as fast as the board answers; `stop` is
/// asked before each.
pub fn measure(board: &mut Board, exchanges: usize, stop: impl Fn() -> bool) -> Result<Latency, LinkError> {
    let (mut round_trips, mut ages) = (Vec::new(), Vec::new());
    let began = board.now();
    let mut last: Option<u32> = None;
    while round_trips.len() < exchanges.max(2) && !(stop() && round_trips.len() > 1) {
        let asked = board.now();
        let answer = board.force(&ForceRequest::default())?;
        round_trips.push((board.now() - asked).as_secs_f64());
        if let Some(last) = last.replace(answer.step) {
            ages.push(f64::from(answer.step.wrapping_sub(last)) * f64::from(answer.period));
        }
    }
    let seconds = (board.now() - began).as_secs_f64();
    Ok(Latency {
        per_second: round_trips.len() as f64 / seconds,
        round_trip: Spread::of(round_trips),
        age: Spread::of(ages),
    })
}

impl Spread {
    /// Of times (s), at least one.
    fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let share = |share: f64| times[((times.len() as f64 * share).ceil() as usize).clamp(1, times.len()) - 1];
        Self {
            count: times.len(),
            min: times[0],
            median: share(0.5),
            p99: share(0.99),
            p999: share(0.999),
            max: share(1.0),
            histogram: histogram(&times),
        }
    }
}

/// Bins for sorted times.
fn histogram(times: &[f64]) -> Vec<Bin> {
    let mut bins = Vec::new();
    let mut from = 0.0;
    let mut left = times;
    for edge in (0..).flat_map(|decade| [1.0, 2.0, 5.0].map(|step| step * FIRST_EDGE * 10.0_f64.powi(decade))) {
        let count = left.partition_point(|time| *time <= edge * (1.0 + EDGE_TOLERANCE));
        if count > 0 || !bins.is_empty() {
            bins.push(Bin { from, to: edge, count });
        }
        left = &left[count..];
        if left.is_empty() {
            break;
        }
        from = edge;
    }
    bins
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_put_into_bins_of_1_2_5() {
        let spread = Spread::of(vec![3e-5, 1.5e-4, 6e-5, 1.7e-4]);
        assert_eq!((spread.min, spread.median, spread.p99, spread.max), (3e-5, 6e-5, 1.7e-4, 1.7e-4));
        let counts: Vec<usize> = spread.histogram.iter().map(|bin| bin.count).collect();
        assert_eq!(counts, [1, 1, 2]);
        let edges: Vec<f64> = spread.histogram.iter().map(|bin| (bin.from * 1e6).round()).collect();
        assert_eq!(edges, [20.0, 50.0, 100.0]);
        // Two periods of 50 us on either clock.
        let twice = |seconds: f64| Spread::of(vec![seconds]).histogram[0].to;
        assert_eq!(twice(2.0 * f64::from(5.0e-5_f32)), twice(std::time::Duration::from_micros(100).as_secs_f64()));
        assert!(spread.histogram.windows(2).all(|pair| pair[0].to == pair[1].from));
    }
}
