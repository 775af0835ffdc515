//! Cogging learnt on random paddles, as listed in docs/results/cogging.csv.

use crate::common::cogged::CoggedPaddle;
use crate::common::{Folder, csv, document, output};

/// Number of motors.
const MOTORS: u64 = 50;

/// Returns the removed share of a motor's ripple, and its row of the table.
fn removed_share(seed: u64) -> (f64, String) {
    let paddle = CoggedPaddle::draw(seed);
    let (_, mut board) = paddle.board();
    let learnt = paddle.learn(&mut board).unwrap_or_else(|error| panic!("{seed}: {error}"));
    let (before, after) = paddle.ripple(&learnt.potential);
    let orders: Vec<_> = learnt.potential.iter().map(|harmonic| harmonic.order.to_string()).collect();
    let (arc, friction) = (paddle.arc(), 1e3 * paddle.wired.joints[0].coulomb);
    let [before_mnm, after_mnm, told_mnm] =
        [before, after, learnt.held_out.hypot(learnt.after)].map(|torque| 1e3 * torque);
    let removed = 1.0 - after / before;
    let row = format!(
        "{seed} | {arc:.2} | {friction:.2} | {before_mnm:.2} | {after_mnm:.3} | {told_mnm:.3} | {:.0} | {}",
        100.0 * removed,
        orders.join(" ")
    );
    (removed, row)
}

/// `UPDATE_DOCS=1 cargo xtask test --deep cogging` updates the table.
#[test]
fn most_of_the_ripple_of_50_motors_is_removed() {
    // Two threads halve the time.
    let of_parity = |parity: u64| (parity..MOTORS).step_by(2).map(removed_share).collect::<Vec<_>>();
    let (even, odd) = std::thread::scope(|scope| {
        let odd = scope.spawn(|| of_parity(1));
        (of_parity(0), odd.join().unwrap())
    });
    let (mut removed, rows): (Vec<f64>, Vec<String>) = even.into_iter().zip(odd).flat_map(|(a, b)| [a, b]).unzip();
    removed.sort_by(f64::total_cmp);
    let (mean, median) = (removed.iter().sum::<f64>() / MOTORS as f64, removed[removed.len() / 2]);
    println!("removed: {mean:.3} on average, {median:.3} median, {:.3} least", removed[0]);
    let header =
        "seed | arc, rad | friction, mN m | ripple, mN m rms | after, mN m rms | told, mN m rms | removed, % | orders";
    let made = csv(std::iter::once(header.into()).chain(rows));
    assert!(mean >= 0.85 && median >= 0.85 && removed[0] > 0.0, "{mean}, {median}\n{made}");
    assert_eq!(document("docs/results/cogging.csv", &made), made, "run UPDATE_DOCS=1 cargo xtask test --deep cogging");
}

#[test]
fn the_command_learns_and_draws() {
    let (folder, paddle) = (Folder::new(), CoggedPaddle::with_arc(2, 0.5));
    let harmonic = paddle.wired.joints[0].cogging.unwrap().harmonics[0];
    let cogging = format!("[joint.cogging]\namplitude = {}\nper_turn = {}\n", harmonic.amplitude, harmonic.per_turn);
    let file = folder.write("cogged.toml", paddle.text.replace("[home]", &(cogging + "[home]")));
    let svg = folder.path("cogging.svg");
    let printed = output(&["cogging", &file, "--port", &format!("sim:{file}"), "--svg", &svg]);
    let expected = format!("periods per turn of the shaft: {}", harmonic.per_turn);
    assert!(printed.starts_with("joint 0: ripple ") && printed.contains(&expected), "{printed}");
    assert!(std::fs::read_to_string(svg).unwrap().contains("after compensation"));
}
