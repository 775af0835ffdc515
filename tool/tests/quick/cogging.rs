//! Cogging is learnt from the board's motion and compensated without net work.

use crate::common::cogged::CoggedPaddle;

#[test]
fn most_of_a_motors_cogging_is_learnt_and_compensated() {
    for seed in 0..6 {
        let paddle = CoggedPaddle::draw(seed);
        let (_, mut board) = paddle.board();
        match paddle.learn(&mut board) {
            Ok(learnt) => {
                let (before, after) = paddle.ripple(&learnt.potential);
                eprintln!("{seed}: {:.4} {before:.2e} {after:.2e} told {:.2e} {:.2e} {:.2e} fr {:.2e} {:?} {:?}", 1.0 - after / before, learnt.before, learnt.after, learnt.held_out, learnt.friction, learnt.potential.iter().map(|h| h.order).collect::<Vec<_>>(), paddle.wired.joints[0].cogging.unwrap().harmonics.map(|h| (h.per_turn, h.amplitude)));
            }
            Err(error) => eprintln!("{seed}: {error}"),
        }
    }
    panic!("see");
}
