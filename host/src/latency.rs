//! The round-trip time to a board, which limits the walls that a program on the computer can render.

use crate::link::{Board, LinkError};
use haptic_bridge::board::protocol::ForceRequest;
use serde::Serialize;

/// Lowest bin edge, s. The edges follow a 1-2-5 series.
const FIRST_EDGE_S: f64 = 1.0e-5;

/// Relative tolerance of an edge, because whole control periods fall on edges and the board's period is an `f32`.
const EDGE_TOLERANCE: f64 = 1.0e-6;

/// Statistics of many requests and their replies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Number of exchanges per second of the wire's clock.
    pub per_second: f64,
    /// Time from the first byte of a request to the last byte of its reply, on the computer's clock; for a board
    /// simulated in this process, on the clock of the board.
    pub round_trip: Spread,
    /// Age of a state when the board receives the request computed from this state, on the board's clock. The age is
    /// the time between two states.
    pub age: Spread,
}

/// The distribution of a set of times, s.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Number of times.
    pub count: usize,
    /// The shortest time.
    pub min: f64,
    /// The median of the times.
    pub median: f64,
    /// The 99 % quantile.
    pub p99: f64,
    /// The 99.9 % quantile.
    pub p999: f64,
    /// The longest time.
    pub max: f64,
    /// Adjacent bins, from the first to the last that is not empty.
    pub histogram: Vec<Bin>,
}

/// A bin of a histogram: times t with from < t ≤ to, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bin {
    /// Lower edge, s.
    pub from: f64,
    /// Upper edge, s.
    pub to: f64,
    /// Number of times in the bin.
    pub count: usize,
}

/// Exchanges `exchanges` requests (at least 2) without a force, as fast as the board replies. Ends early if `stop`,
/// which is called before each request, returns true.
pub fn measure(board: &mut Board, exchanges: usize, stop: impl Fn() -> bool) -> Result<Latency, LinkError> {
    let (mut round_trips, mut ages) = (Vec::new(), Vec::new());
    let began = board.now();
    let mut last: Option<u32> = None;
    while round_trips.len() < exchanges.max(2) && !(stop() && round_trips.len() > 1) {
        let sent = board.now();
        let reply = board.force(&ForceRequest::default())?;
        round_trips.push((board.now() - sent).as_secs_f64());
        if let Some(last) = last.replace(reply.step) {
            ages.push(f64::from(reply.step.wrapping_sub(last)) * f64::from(reply.period));
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
    /// Computes the distribution of `times` (s, not empty).
    fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let quantile =
            |quantile: f64| times[((times.len() as f64 * quantile).ceil() as usize).clamp(1, times.len()) - 1];
        Self {
            count: times.len(),
            min: times[0],
            median: quantile(0.5),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max: quantile(1.0),
            histogram: histogram(&times),
        }
    }
}

fn histogram(times: &[f64]) -> Vec<Bin> {
    let mut bins = Vec::new();
    let mut from = 0.0;
    let mut left = times;
    for edge in (0..).flat_map(|decade| [1.0, 2.0, 5.0].map(|step| step * FIRST_EDGE_S * 10.0_f64.powi(decade))) {
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
    fn bins_follow_a_1_2_5_series() {
        let spread = Spread::of(vec![3e-5, 1.5e-4, 6e-5, 1.7e-4]);
        assert_eq!((spread.min, spread.median, spread.p99, spread.max), (3e-5, 6e-5, 1.7e-4, 1.7e-4));
        let counts: Vec<usize> = spread.histogram.iter().map(|bin| bin.count).collect();
        assert_eq!(counts, [1, 1, 2]);
        let edges: Vec<f64> = spread.histogram.iter().map(|bin| (bin.from * 1e6).round()).collect();
        assert_eq!(edges, [20.0, 50.0, 100.0]);
        // Two control periods of 50 us fall into the same bin on the board's clock and on the computer's.
        let twice = |seconds: f64| Spread::of(vec![seconds]).histogram[0].to;
        assert_eq!(twice(2.0 * f64::from(5.0e-5_f32)), twice(std::time::Duration::from_micros(100).as_secs_f64()));
        assert!(spread.histogram.windows(2).all(|pair| pair[0].to == pair[1].from));
    }
}
