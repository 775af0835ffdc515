//! The limits and the polarity check of a slide are those of a joint that turns, at a lever of 0.08 m.

use crate::rig::{Body, Rig, hardware, limits, paddle, rules, scene};
use haptic_bridge::control::Command;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{Description, Joint, JointFrame, Link};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;

/// Travel of a slide for each radian of a limit, m.
const LEVER: f64 = 0.08;

const X: JointFrame = JointFrame { axis: [1.0, 0.0, 0.0], ..JointFrame::SAME };

fn sliding_joint() -> Joint {
    Joint { prismatic: true, frame: X, inertia: 0.003, ..paddle().joints[0] }
}

/// Returns a slide of 23 g along x.
fn slide() -> Description {
    let mut description = Description { kind: Kind::Chain1, geometry: [0.0; 8], ..paddle() };
    description.joints[0] = sliding_joint();
    description.links[0] = Link { mass: 0.02, ..Link::default() };
    description
}

/// Returns a slide on a joint that turns, 0.1 m from its axis at home.
fn turning_slide() -> Description {
    let mut description = Description { kind: Kind::Chain2, home: Some([0.0, 0.1, 0.0]), ..slide() };
    description.geometry[3..5].copy_from_slice(&[0.0, 1.0]);
    description.joints[..2].copy_from_slice(&[Joint { inertia: 2.0e-4, ..paddle().joints[0] }, sliding_joint()]);
    description.links[1] = Link { mass: 0.02, inertia: 1.0e-5, ..Link::default() };
    description
}

#[test]
fn a_slide_faster_than_its_limit_is_turned_off() {
    let limit = LEVER * f64::from(limits().speed[0]);
    for (share, fault) in [(0.95, None), (1.5, Some(Fault::SpeedLimit))] {
        let mut rig = Rig::new(&slide(), &scene(1, &[]), hardware(), rules());
        rig.arm();
        rig.turn(0, 0.3, share * limit);
        assert_eq!(rig.fault(), fault, "at {} m/s", share * limit);
        assert_eq!(rig.motors_are_off(), fault.is_some());
    }
}

#[test]
fn a_slide_that_creeps_cannot_be_homed() {
    let mut rig = Rig::new(&slide(), &scene(1, &[]), hardware(), rules());
    for step in 0..400 {
        // 0.03 m/s, which would be at rest as 0.03 rad/s.
        rig.samples.counts[0] = (f64::from(step) * 0.03 / 2_000.0 / std::f64::consts::TAU * 60_000.0) as i32;
        rig.step();
    }
    assert_eq!(rig.execute(Command::Home), Err(Refusal::Moving));
}

/// Runs the polarity check with motors that make `factor` times the torque of the file. Returns its fault, and the
/// largest motion of any joint at its lever, rad.
fn check(description: &Description, factor: f64) -> (Option<Fault>, f64) {
    let mut rig = Rig::new(description, &scene(description.kind.spec().task as u8, &[]), hardware(), rules());
    let levers = description.joints.map(|joint| if joint.prismatic { LEVER } else { 1.0 });
    let mut body = Body::new(description);
    let mut farthest = 0.0_f64;
    rig.execute(Command::CheckPolarity).expect("ready");
    while rig.state() == State::CheckingPolarity {
        body.step(&mut rig, factor);
        for (lever, count) in levers.iter().zip(rig.samples.counts.iter()) {
            farthest = farthest.max((f64::from(*count) / 60_000.0 * std::f64::consts::TAU / lever).abs());
        }
    }
    (rig.fault(), farthest)
}

#[test]
fn the_polarity_check_swings_a_slide_by_millimetres() {
    for description in [slide(), turning_slide()] {
        for (factor, expected) in [(1.0, None), (-1.0, Some(Fault::PolarityWrong)), (1.5, Some(Fault::TorqueMismatch))]
        {
            let (fault, farthest) = check(&description, factor);
            assert_eq!(fault, expected, "{:?} with {factor} times the torque", description.kind);
            assert!((0.015..0.14).contains(&farthest), "{:?}, {factor}: {farthest} rad at the lever", description.kind);
        }
    }
}
