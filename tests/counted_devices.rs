//! The devices whose instructions are counted equal the shipped devices. emulator/counting/devices.rs repeats their
//! numbers because the image on the chip cannot read TOML.

use crate::common::device_file;
use haptic_bridge::model::description::{Description, Joint};

#[path = "../emulator/counting/devices.rs"]
mod devices;

/// Returns place, axis, inertia, viscous friction, dry friction and counts per turn, which are all that the control step
/// uses.
fn joint_parameters(joint: &Joint) -> [f64; 13] {
    let ([x, y, z], [roll, pitch, yaw], [a, b, c]) = (joint.frame.origin, joint.frame.rpy, joint.frame.axis);
    let counts = joint.encoder.map_or(0.0, |encoder| encoder.counts_per_turn);
    [x, y, z, roll, pitch, yaw, a, b, c, joint.inertia, joint.viscous, joint.coulomb, counts]
}

/// Returns true if all numbers are equal within 8 rounding errors.
fn nearly_equal(counted: &[f64], shipped: &[f64]) -> bool {
    counted.len() == shipped.len()
        && counted.iter().zip(shipped).all(|(a, b)| (a - b).abs() <= 8.0 * f64::EPSILON * a.abs().max(b.abs()))
}

#[test]
fn the_counted_devices_are_the_shipped_devices() {
    let counted: [(&str, Description); 10] = [
        ("hapkit-paddle", devices::PADDLE),
        ("haply-2diy", devices::FIVE_BAR),
        ("fictive-five-bar-turret", devices::FIVE_BAR_TURRET),
        ("phantom-premium-1.5", devices::PARALLELOGRAM),
        ("serial-3r", devices::SERIAL_3R),
        ("falcon-like", devices::DELTA),
        ("two-paddles", devices::PADDLES_2),
        ("fader", devices::CHAIN_1),
        ("planar-arm", devices::CHAIN_2),
        ("touch", devices::CHAIN_3),
    ];
    for (name, counted) in counted {
        let shipped = device_file::shipped_device(name);
        let numbers = |of: &Description| {
            let links = of
                .links
                .iter()
                .flat_map(|link| [link.mass, link.com, link.inertia, link.inertia_axial, link.inertia_transverse]);
            let joints = of.joints.iter().flat_map(joint_parameters);
            let rest = of.gravity.iter().chain(&of.geometry).chain(of.home.iter().flatten()).copied();
            links.chain(joints).chain(rest).chain([of.handle_mass]).collect::<Vec<f64>>()
        };
        assert_eq!(counted.kind, shipped.kind, "{name}");
        assert!(
            nearly_equal(&numbers(&counted), &numbers(&shipped)),
            "{name}: {:?}\n{:?}",
            numbers(&counted),
            numbers(&shipped)
        );
    }
    assert_eq!(devices::PADDLES_3.joints, [devices::PADDLES_2.joints[0]; 3]);
}
