//! Rules of the two formats that the independent cases do not contain.

use haptic_import::{Chain, Motion, Selection, Step, read};
use nalgebra::{Point3, Vector3};

fn chain(text: &str) -> Chain {
    let origin = "model".as_ref();
    read(text, origin).and_then(|tree| tree.chain(&Selection::default(), origin)).unwrap_or_else(|e| panic!("{e}"))
}

/// Returns a model with one joint and one body beyond the joint.
fn one_joint(settings: &str, joint: &str, end: &str) -> Chain {
    let inertial = r#"<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>"#;
    chain(&format!(
        "<mujoco>{settings}<worldbody><body name='a' pos='0 0 1'>{inertial}<joint name='j' {joint}/>
         <body name='b' {end}>{inertial}</body></body></worldbody></mujoco>"
    ))
}

fn assert_near(found: &[f64], expected: &[f64]) {
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}, not {expected:?}");
}

#[test]
fn ranges_limit_joints_in_their_units() {
    let limits = |settings: &str, joint: &str| one_joint(settings, joint, "pos='0.1 0 0'").links[0].joint.limits;
    assert_near(&limits("", "range='-90 180'").unwrap(), &[-90f64.to_radians(), core::f64::consts::PI]);
    assert_near(&limits("<compiler angle='radian'/>", "range='-1 2'").unwrap(), &[-1.0, 2.0]);
    assert_near(&limits("", "type='slide' axis='1 0 0' range='-1 2'").unwrap(), &[-1.0, 2.0]);
    assert_eq!(limits("", "range='-90 90' limited='false'"), None);
    assert_eq!(limits("<compiler autolimits='false'/>", "range='-90 90'"), None);
    assert!(limits("<compiler autolimits='false'/>", "range='-90 90' limited='true'").is_some());
    assert_eq!(limits("", ""), None);
}

#[test]
fn a_joint_takes_the_defaults_of_the_closest_class() {
    let defaults = "<default><joint damping='1' armature='2' axis='0 1 0'/><default class='c'><joint damping='3'/>
                    <default class='d'><joint frictionloss='4'/></default></default></default>";
    let joint = one_joint(defaults, "class='d' armature='5'", "pos='0.1 0 0'").links[0].joint.clone();
    assert_eq!((joint.viscous, joint.coulomb, joint.inertia, joint.motion), (3.0, 4.0, 5.0, Motion::Revolute));
    assert_near(joint.axis.as_slice(), &[0.0, 1.0, 0.0]);
}

/// The file shows a body at the position `ref` of its joint, and the zero of the chain is the zero of the file.
#[test]
fn a_body_is_shown_at_the_reference_of_its_joint() {
    let link = &one_joint("", "ref='90'", "pos='0.1 0 0'").links[0];
    let start = link.origin * Point3::new(0.1, 0.0, 0.0);
    assert_near(start.coords.as_slice(), &[0.0, -0.1, 1.0]);
    let slide = &one_joint("", "type='slide' ref='0.2'", "").links[0];
    assert_near(slide.origin.translation.vector.as_slice(), &[0.0, 0.0, 0.8]);
}

#[test]
fn every_orientation_of_mjcf_is_read() {
    for (settings, orientation, turned_x) in [
        ("", "euler='90 0 90'", [0.0, 0.0, 1.0]),
        ("<compiler eulerseq='XYZ'/>", "euler='90 0 90'", [0.0, 1.0, 0.0]),
        ("<compiler angle='radian' eulerseq='zxy'/>", "euler='1.5707963267948966 0 0'", [0.0, 1.0, 0.0]),
        ("", "axisangle='0 0 2 90'", [0.0, 1.0, 0.0]),
        ("", "quat='2 0 0 2'", [0.0, 1.0, 0.0]),
        ("", "xyaxes='0 3 0 -1 1 0'", [0.0, 1.0, 0.0]),
        ("", "zaxis='2 0 0'", [0.0, 0.0, -1.0]),
    ] {
        let inertial = "<inertial mass='1' diaginertia='1 1 1'/>";
        let body = format!("<frame pos='0 0 1' {orientation}><body pos='1 0 0'>{inertial}</body></frame>");
        let text = format!("<mujoco>{settings}<worldbody>{body}</worldbody></mujoco>");
        let Step::Fixed(pose) = &read(&text, "m".as_ref()).unwrap().bodies[1].steps[0] else { panic!("{text}") };
        assert_near((pose * Vector3::x()).as_slice(), &turned_x);
        assert_near((pose.translation.vector - Vector3::z()).as_slice(), &turned_x);
    }
}

#[test]
fn everything_left_out_is_said() {
    let text = one_joint("<equality><joint/></equality>", "stiffness='2'", "pos='0.1 0 0' gravcomp='1'").device_file();
    for words in [
        "Tip: origin of b",
        "At rest with the base: world",
        "spring (stiffness) of joint j",
        "gravcomp of b",
        "<equality>",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let name = one_joint("", "", "pos='0.1 0 0'").device_file();
    assert!(name.contains("name = \"my-device\"") && name.contains("verified = false"), "{name}");
}
