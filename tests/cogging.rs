//! The compensation of cogging: acts within the limits, and only at the home at which it was learnt.

use crate::rig::{Rig, device, far_wall, hardware, paddle, rules};
use haptic_bridge::control::{Command, HostAction};
use haptic_bridge::model::cogging::{Compensation, Harmonic, Potential};
use haptic_bridge::model::description::{Description, Homing};

/// Returns a compensation of the paddle with this amplitude, N m.
fn compensation(torque: f32) -> Compensation {
    let harmonic = Harmonic { order: 84, energy: torque / 84.0, phase: 0.5 };
    Compensation::new(&device(&paddle()).joints[0], &[harmonic].into_iter().collect::<Potential>())
}

fn armed_rig(torque: f32, tip_force: f32) -> Rig {
    let mut rules = rules();
    (rules.limits.tip_force, rules.host_action) = (tip_force, HostAction::Ignore);
    let mut rig = Rig::new(&paddle(), &far_wall(), hardware(), rules);
    rig.execute(Command::Rules(rules)).expect("rules");
    rig.execute(Command::Cogging(0, compensation(torque), true)).expect("never refused");
    rig.arm();
    rig
}

#[test]
fn the_compensation_is_added_within_the_limits() {
    let mut rig = armed_rig(0.02, 5.0);
    for angle in [0.01, 0.05, -0.1, 0.3] {
        rig.turn(0, angle, 1.0);
        rig.step();
        let expected = compensation(0.02).torque(rig.samples.counts[0]);
        assert!((rig.torques()[0] - expected).abs() < 1e-6, "{angle}: {} N m, not {expected}", rig.torques()[0]);
    }
    // The paddle is 0.1 m long, so its tip force is at most 0.1 N with 0.01 N m.
    let mut limited = armed_rig(0.02, 0.1);
    let mut most = 0.0_f32;
    for step in 0..100 {
        limited.turn(0, 1e-3 * f64::from(step), 1.0);
        most = most.max(limited.torques()[0].abs());
    }
    assert!((0.0099..=0.01001).contains(&most), "{most} N m");
}

#[test]
fn a_compensation_ends_with_a_home_that_a_person_declares_again() {
    for (homing, stays) in [(Homing::Hand, false), (Homing::Index, true)] {
        let mut rules = rules();
        rules.index_period[0] = 60_000;
        let mut rig = Rig::without_device(hardware(), rules);
        let device = Description { homing, ..paddle() };
        rig.execute(Command::Rules(rules)).expect("rules");
        rig.load(&device, &far_wall(), false).expect("a program that fits");
        rig.settle();
        let home = |rig: &mut Rig, count: i32| {
            rig.samples.counts[0] = count;
            rig.settle();
            rig.marks = Some([Some(count), None, None]);
            rig.step();
            rig.execute(Command::Home).expect("homed");
            rig.settle();
        };
        let acts = |rig: &mut Rig| {
            rig.execute(Command::PolarityKnown).expect("never refused");
            rig.arm();
            let torque = rig.torques()[0];
            rig.execute(Command::Disarm).expect("never refused");
            rig.settle();
            torque != 0.0
        };
        home(&mut rig, 0);
        rig.execute(Command::Cogging(0, compensation(0.02), true)).expect("never refused");
        assert!(acts(&mut rig));
        home(&mut rig, 3);
        assert_eq!(acts(&mut rig), stays, "{homing:?}");
        rig.load(&device, &far_wall(), false).expect("a program that fits");
        rig.settle();
        home(&mut rig, 3);
        assert!(!acts(&mut rig), "another device has other motors");
    }
}
