//! The paper's experiment on the release image. The range of stable walls must agree with the theory, and the
//! feed-forward must enlarge it. docs/results.md has the complete measurement of `cargo xtask range`.

use haptic_bridge::render::scene::FeedForward;
use haptic_emulator::range::{RATES, delay_samples, measure_on, predicted_range, rig, rigid_device};

/// Largest deviation of the boundary from the theory, as a share. It depends on the interrupt's phase in the carrier
/// period, which differs between images. With the feed-forward, one point of one image was 5 to 7 % below the theory.
const MAX_DEVIATION: f64 = 0.07;
/// Dampings of the measured points, as shares of the largest damping of the range.
const DAMPING_SHARES: [f64; 3] = [0.2, 0.4, 0.6];

fn boundary_agrees_with_theory(feed_forward: FeedForward) {
    let test_device = rigid_device();
    let mut rig = rig(&test_device);
    let delay = delay_samples(&mut rig, RATES[0]);
    let end = predicted_range(&test_device, RATES[0], delay, None).of(feed_forward).kd_max;
    let kd = DAMPING_SHARES.map(|share| share * end);
    let theory = predicted_range(&test_device, RATES[0], delay, Some(&kd));
    measure_on(&mut rig, &test_device, RATES[0], |prepared| {
        for point in &theory.of(feed_forward).boundary {
            for strength in [1.0, 0.7] {
                let below = prepared.oscillates(feed_forward, point.kp * (1.0 - MAX_DEVIATION), point.kd, strength)?;
                let above = prepared.oscillates(feed_forward, point.kp * (1.0 + MAX_DEVIATION), point.kd, strength)?;
                assert_eq!((below, above), (false, true), "{feed_forward:?}, {point:?}");
            }
        }
        Ok(())
    })
    .expect("measured");
}

#[test]
fn the_range_without_feed_forward_agrees_with_theory() {
    boundary_agrees_with_theory(FeedForward::Off);
}

#[test]
fn the_range_with_feed_forward_agrees_with_theory() {
    boundary_agrees_with_theory(FeedForward::Full);
}
