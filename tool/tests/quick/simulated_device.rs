//! The simulated device agrees with closed forms and does not gain energy from integration errors.

use crate::common::shipped_device;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{
    Cogging, CoggingHarmonic, Description, Encoder, EncoderAt, Homing, Joint, Link, Stribeck, StructuralMode,
    Transmission,
};
use haptic_bridge::model::motor::{Motor, Winding};
use haptic_sim::{Hand, HandSettings, Intent, MotorInput, Options, PowerStage, SimulatedDevice, Waypoint};

const MOTOR: Motor<f64> = Motor {
    torque_constant: 0.5,
    resistance: 2.0,
    inductance: 0.0,
    back_emf: 0.5,
    max_current: 3.0,
    winding: Winding::Brushed,
    verified: false,
};

fn joint(inertia: f64, viscous: f64, coulomb: f64) -> Joint {
    Joint {
        inertia,
        viscous,
        coulomb,
        encoder: Some(Encoder { counts_per_turn: 20_000.0, offset: 0.0, inverted: false }),
        motor: Some(MOTOR),
        ..Joint::default()
    }
}

fn paddle(viscous: f64, coulomb: f64) -> Description {
    Description {
        kind: Kind::Paddle,
        gravity: [0.0; 3],
        geometry: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        links: [Link::default(); 4],
        joints: [joint(1e-3, viscous, coulomb), Joint::default(), Joint::default()],
        handle_mass: 0.0,
        sensed: [None; 3],
        home: Some([0.0; 3]),
        homing: Homing::Hand,
    }
}

fn five_bar() -> Description {
    let arm = Link { mass: 0.06, com: 0.045, inertia: 6e-5, ..Link::default() };
    let rod = Link { mass: 0.04, com: 0.065, inertia: 6e-5, ..Link::default() };
    Description {
        kind: Kind::FiveBar,
        gravity: [0.0; 3],
        geometry: [0.02, 0.1, 0.1, 0.13, 0.13, 1.0, 0.0, 0.0],
        links: [arm, arm, rod, rod],
        joints: [joint(8e-4, 0.0, 0.0), joint(3e-4, 0.0, 0.0), Joint::default()],
        handle_mass: 0.05,
        sensed: [None; 3],
        home: Some([2.3, 0.84, 0.0]),
        homing: Homing::Hand,
    }
}

fn device(description: &Description) -> SimulatedDevice {
    SimulatedDevice::new(description, &Options::default()).unwrap()
}

fn coast(device: &mut SimulatedDevice, seconds: f64) {
    device.step(&[MotorInput::Floating; 3], seconds);
}

fn assert_same_pose(left: [f64; 3], right: [f64; 3]) {
    assert!(left.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-12), "{left:?} {right:?}");
}

#[test]
fn a_free_linkage_keeps_its_energy() {
    let mut device = device(&five_bar());
    device.push([0.15, -0.1, 0.0]);
    let before = device.plant().energy();
    let start = device.tip();
    let mut worst: f64 = 0.0;
    for _ in 0..50 {
        coast(&mut device, 0.01);
        worst = worst.max((device.plant().energy() / before - 1.0).abs());
    }
    let tip_path = (device.tip()[0] - start[0]).hypot(device.tip()[1] - start[1]);
    assert!(tip_path > 0.03, "the linkage moves too little: {tip_path} m");
    assert!(worst < 1e-9, "relative energy drift {worst:e}");
}

/// Returns the paddle of 1e-3 kg m². Its rotor has 3e-4 kg m² and drives the link through a compliant transmission.
fn soft_paddle(stiffness: f64, damping: f64, encoder_at: EncoderAt) -> Description {
    let mut paddle = paddle(0.0, 0.0);
    paddle.joints[0].transmission = Some(Transmission { stiffness, damping, motor_inertia: 3e-4, encoder_at });
    paddle
}

#[test]
fn a_soft_transmission_has_its_frequency_and_keeps_energy() {
    // Both ends are free, so ω = √(k (1/Jm + 1/Jl)) = 1095 rad/s, and the common motion is a parabola.
    let mut device = device(&soft_paddle(252.0, 0.0, EncoderAt::Motor));
    let omega = (252.0 * (1.0 / 3e-4 + 1.0 / 7e-4_f64)).sqrt();
    device.step(&[MotorInput::Torque(2e-3), MotorInput::Floating, MotorInput::Floating], 0.05);
    // Motor: τ/J t²/2 + (Jl/J) twist. Link: τ/J t²/2 - (Jm/J) twist. Twist: (τ/Jm) (1 - cos ωt)/ω².
    let common = 0.5 * 2.0 * 0.05_f64.powi(2);
    let twist = 2e-3 / 3e-4 * (1.0 - (omega * 0.05).cos()) / (omega * omega);
    assert!((device.plant().measured()[0] - (common + 0.7 * twist)).abs() < 1e-4 * twist.abs() + 1e-9);
    assert!((device.q()[0] - (common - 0.3 * twist)).abs() < 1e-4 * twist.abs() + 1e-9);
    // The rest of the motor current decays within the first step.
    coast(&mut device, 1e-5);
    let before = device.plant().energy();
    coast(&mut device, 0.5);
    assert!((device.plant().energy() / before - 1.0).abs() < 1e-9, "{} {before}", device.plant().energy());
}

#[test]
fn encoders_measure_their_side_of_a_transmission() {
    for (stiffness, apart) in [(1e12, 1e-9), (10.0, 1.0)] {
        let angles = [EncoderAt::Motor, EncoderAt::Joint].map(|side| {
            let mut device = device(&soft_paddle(stiffness, 0.0, side));
            device.step(&[MotorInput::Torque(0.02), MotorInput::Floating, MotorInput::Floating], 0.1);
            (device.plant().measured()[0], device.q()[0])
        });
        let [(motor, _), (joint, link)] = angles;
        assert_eq!(joint, link);
        // Rigid: 0.1 rad after 0.1 s at 20 rad/s². Soft: a twist of about 1.4e-3 rad, which accelerates the link.
        assert!((motor - 0.1).abs() < apart && (link - 0.1).abs() < apart);
        assert_eq!((motor - link).abs() > 1e-4, stiffness == 10.0, "{motor} {link}");
    }
}

#[test]
fn dry_friction_holds_the_motor_and_lets_the_link_swing() {
    let mut described = soft_paddle(252.0, 0.0, EncoderAt::Motor);
    described.joints[0].coulomb = 1.0;
    let mut device = device(&described);
    device.push([1e-3, 0.0, 0.0]);
    let omega = (252.0 / 7e-4_f64).sqrt();
    let quarter = std::f64::consts::FRAC_PI_2 / omega;
    coast(&mut device, 1e-4);
    let motor = device.plant().measured()[0];
    coast(&mut device, 4.0 * quarter);
    assert_eq!(device.plant().measured()[0], motor);
    assert!(device.qd()[0].abs() > 5e-3, "{}", device.qd()[0]);
}

#[test]
fn viscous_friction_decays_exponentially() {
    let mut device = device(&paddle(5e-3, 0.0));
    device.push([0.1, 0.0, 0.0]);
    coast(&mut device, 0.2);
    assert!((device.qd()[0] - (-1.0_f64).exp()).abs() < 1e-9, "{}", device.qd()[0]);
}

#[test]
fn a_motor_without_inductance_brakes_like_its_closed_form() {
    // A shorted motor has a damping of torque constant x back-EMF / resistance = 0.125 N m s/rad.
    let options = Options { bridge: PowerStage { dead_time: 0.0, ..PowerStage::default() }, ..Options::default() };
    let mut device = SimulatedDevice::new(&paddle(0.0, 0.0), &options).unwrap();
    device.push([0.1, 0.0, 0.0]);
    device.step(&[MotorInput::Duty(0.0); 3], 0.008);
    assert!((device.qd()[0] - (-1.0_f64).exp()).abs() < 1e-7, "{}", device.qd()[0]);
}

#[test]
fn coulomb_friction_stops_a_joint_and_then_holds_it() {
    let mut device = device(&paddle(0.0, 0.01));
    device.push([0.1, 0.0, 0.0]);
    // From 1 rad/s, 0.01 N m stop 1e-3 kg m² after 0.1 s and 0.05 rad.
    coast(&mut device, 0.11);
    assert_eq!(device.qd()[0], 0.0);
    assert!((device.q()[0] - 0.05).abs() < 1e-6, "{}", device.q()[0]);
    let stuck = device.q()[0];
    device.step(&[MotorInput::Torque(0.009); 3], 1.0);
    assert_eq!(device.q()[0], stuck, "friction must hold without creep");
    device.step(&[MotorInput::Torque(0.011); 3], 0.1);
    assert!((device.qd()[0] - 0.1).abs() < 1e-9, "friction must release the joint beyond its limit");
}

#[test]
fn friction_holds_every_joint_of_a_coupled_linkage() {
    let mut description = five_bar();
    for joint in &mut description.joints[..2] {
        joint.coulomb = 0.005;
    }
    let mut device = device(&description);
    let before = device.q();
    device.step(&[MotorInput::Torque(0.0049), MotorInput::Torque(-0.0049), MotorInput::Floating], 1.0);
    assert_same_pose(device.q(), before);
}

#[test]
fn a_joint_stops_just_beyond_its_limits() {
    let mut description = paddle(0.0, 0.0);
    description.joints[0].limits = Some((-0.5, 0.5));
    let mut device = device(&description);
    device.step(&[MotorInput::Torque(0.05); 3], 1.0);
    assert!((device.q()[0] - 0.52).abs() < 1e-3, "{}", device.q()[0]);
    assert!(device.qd()[0].abs() < 1e-9);
}

/// At the end of its reach a closed loop has a parallel singularity, where its inertia is unbounded.
#[test]
fn a_linkage_pulled_beyond_its_reach_gains_no_energy() {
    for name in ["fictive-five-bar-turret", "pantograph-mk2", "haply-2diy"] {
        let description = Description { gravity: [0.0; 3], ..shipped_device(name).description };
        for to in [[0.0, 0.3, 0.0], [0.0, -0.3, 0.2]] {
            let mut device = SimulatedDevice::new(&description, &Options::frictionless()).unwrap();
            let start = device.q();
            let pull = Intent::Follow(vec![Waypoint { time: 0.3, value: to }]);
            device.set_hand(Hand::new(HandSettings::default(), pull, device.tip(), 0.0));
            coast(&mut device, 0.2);
            device.set_hand(Hand::none());
            let before = device.plant().energy();
            for _ in 0..600 {
                coast(&mut device, 1e-3);
                let largest_turn = (0..3).map(|i| (device.q()[i] - start[i]).abs()).fold(0.0, f64::max);
                assert!(largest_turn < 2.0 * std::f64::consts::TAU, "{name} to {to:?}: {:?} rad", device.q());
                // The integration error near the singularity is up to 4e-4.
                let energy = device.plant().energy();
                assert!(energy <= 1.001 * before, "{name} to {to:?}: {before} J, then {energy} J");
            }
        }
    }
}

#[test]
fn gravity_and_a_holding_torque_balance() {
    let mut description = five_bar();
    description.gravity = [0.0, -9.81, 0.0];
    let mut device = device(&description);
    let before = device.q();
    let g = device.plant().gravity();
    assert!(g[0].abs() > 1e-3, "gravity does not load the joints: {g:?}");
    device.step(&[MotorInput::Torque(g[0]), MotorInput::Torque(g[1]), MotorInput::Floating], 0.01);
    assert_same_pose(device.q(), before);
    coast(&mut device, 0.01);
    assert!(device.tip_velocity()[1] < -0.01, "the linkage does not fall without torque");
}

#[test]
fn a_step_of_any_length_is_the_same_motion() {
    let run = |pieces: u32| {
        let mut device = device(&five_bar());
        for _ in 0..pieces {
            let torques = [MotorInput::Torque(0.01), MotorInput::Torque(-0.02), MotorInput::Floating];
            device.step(&torques, 0.02 / f64::from(pieces));
        }
        device.q()
    };
    assert_same_pose(run(1), run(400));
}

fn swinging_paddle(frequency: f64, damping: f64) -> Description {
    let mut description = paddle(0.0, 0.0);
    description.joints[0].modes[0] = Some(StructuralMode { frequency, damping, inertia: 3e-4 });
    description
}

#[test]
fn a_mode_equals_a_link_behind_a_transmission() {
    // The mode's 3e-4 kg m² equal the link of a soft paddle whose motor has the other 7e-4.
    let mode = StructuralMode { frequency: 80.0, damping: 0.02, inertia: 3e-4 };
    let mut soft_device = soft_paddle(mode.stiffness(), mode.viscous(), EncoderAt::Motor);
    soft_device.joints[0].transmission.as_mut().unwrap().motor_inertia = 7e-4;
    let (mut left, mut right) = (device(&swinging_paddle(80.0, 0.02)), device(&soft_device));
    for _ in 0..50 {
        for device in [&mut left, &mut right] {
            device.step(&[MotorInput::Torque(0.01); 3], 1e-3);
        }
        let (a, b) = (left.q()[0], right.plant().measured()[0]);
        assert!((a - b).abs() < 1e-12 * (1.0 + b.abs()), "{a} {b}");
    }
    assert!(left.q()[0] > 0.01);
}

#[test]
fn modes_keep_their_energy_and_stiff_modes_are_rigid() {
    let mut both = soft_paddle(40.0, 0.0, EncoderAt::Motor);
    both.joints[0].modes[0] = Some(StructuralMode { frequency: 150.0, damping: 0.0, inertia: 1e-4 });
    both.joints[0].modes[1] = Some(StructuralMode { frequency: 400.0, damping: 0.0, inertia: 1e-4 });
    let mut soft_device = device(&both);
    soft_device.step(&[MotorInput::Torque(0.05); 3], 3e-3);
    // The rest of the motor current decays within a step.
    coast(&mut soft_device, 1e-3);
    let before = soft_device.plant().energy();
    coast(&mut soft_device, 0.2);
    assert!((soft_device.plant().energy() / before - 1.0).abs() < 1e-9, "{} {before}", soft_device.plant().energy());
    let (mut stiff, mut rigid) = (device(&swinging_paddle(1e7, 0.0)), device(&paddle(0.0, 0.0)));
    for device in [&mut stiff, &mut rigid] {
        device.step(&[MotorInput::Torque(0.01); 3], 0.05);
    }
    assert!((stiff.q()[0] / rigid.q()[0] - 1.0).abs() < 1e-9, "{} {}", stiff.q()[0], rigid.q()[0]);
}

#[test]
fn stribeck_friction_holds_more_than_it_brakes() {
    let mut description = paddle(0.0, 0.01);
    description.joints[0].friction = Some(Stribeck { rest: 0.02, stribeck_speed: 0.5 });
    let mut paddle_device = device(&description);
    paddle_device.step(&[MotorInput::Torque(0.0199); 3], 0.1);
    assert_eq!(paddle_device.q()[0], 0.0);
    // In fast motion only Coulomb friction is left, so 0.01 N m of the torque accelerate 1e-3 kg m².
    paddle_device.step(&[MotorInput::Torque(0.0201); 3], 1.0);
    let before = paddle_device.qd()[0];
    assert!(before > 2.0, "{before}");
    paddle_device.step(&[MotorInput::Torque(0.0201); 3], 0.1);
    assert!((paddle_device.qd()[0] - before - 0.1 * 10.1).abs() < 1e-6, "{}", paddle_device.qd()[0] - before);
    // `Options::frictionless` removes all friction.
    let mut frictionless_device = SimulatedDevice::new(&description, &Options::frictionless()).unwrap();
    frictionless_device.step(&[MotorInput::Torque(0.001); 3], 0.1);
    assert!(frictionless_device.q()[0] > 0.0);
}

#[test]
fn cogging_holds_a_motor_in_its_wells_without_energy_loss() {
    let mut description = paddle(0.0, 0.0);
    let mut torque = Cogging::default();
    torque.harmonics[0] = CoggingHarmonic { amplitude: 0.005, per_turn: 24.0, phase: 0.0 };
    description.joints[0].cogging = Some(torque);
    let mut cogging = device(&description);
    let well = std::f64::consts::TAU / 24.0;
    // Placed next to a maximum, the motor falls into the well and rises to the same height on the other side.
    cogging.place([0.1 * well, 0.0, 0.0]);
    let before = cogging.plant().energy();
    let mut largest_distance: f64 = 0.0;
    for _ in 0..500 {
        coast(&mut cogging, 1e-3);
        largest_distance = largest_distance.max(cogging.q()[0]);
        // With the midpoint rule the energy oscillates a little but does not drift.
        assert!((cogging.plant().energy() / before - 1.0).abs() < 1e-6, "{} {before}", cogging.plant().energy());
    }
    assert!((largest_distance - 0.9 * well).abs() < 1e-3 * well, "{largest_distance} {well}");
    // Cogging holds torques up to its amplitude.
    for (torque, leaves) in [(0.0049, false), (0.0056, true)] {
        let mut damped = description;
        damped.joints[0].viscous = 0.02;
        let mut damped_device = device(&damped);
        damped_device.place([0.5 * well, 0.0, 0.0]);
        damped_device.step(&[MotorInput::Torque(torque); 3], 3.0);
        assert_eq!(damped_device.q()[0] > 1.5 * well, leaves, "{torque}: {}", damped_device.q()[0] / well);
    }
}
