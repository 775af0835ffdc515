//! The devices whose instructions are counted are those that ship: emulator/counting/devices.rs has their numbers once more,
//! because the image on the chip reads no TOML.

use crate::common::device_file;
use haptic_bridge::model::description::{Description, Joint};

#[path = "../emulator/counting/devices.rs"]
mod devices;

/// The parameters of a joint's step: inertia, viscous and dry friction, counts a turn.
fn stepped(joint: &Joint) -> [f64; 4] {
    [joint.inertia, joint.viscous, joint.coulomb, joint.encoder.map_or(0.0, |encoder| encoder.counts_per_turn)]
}

/// Returns true if two numbers are the same but for the last places of a decimal.
fn same(counted: &[f64], shipped: &[f64]) -> bool {
    counted.len() == shipped.len()
        && counted.iter().zip(shipped).all(|(a, b)| (a - b).abs() <= 8.0 * f64::EPSILON * a.abs().max(b.abs()))
}

#[test]
fn the_devices_that_are_counted_are_those_that_ship() {
    let counted: [(&str, Description); 5] = [
        ("hapkit-paddle", devices::PADDLE),
        ("haply-2diy", devices::FIVE_BAR),
        ("fictive-five-bar-turret", devices::FIVE_BAR_TURRET),
        ("phantom-premium-1.5", devices::PARALLELOGRAM),
        ("serial-3r", devices::SERIAL_3R),
    ];
    for (name, counted) in counted {
        let shipped = device_file::shipped(name);
        let numbers = |of: &Description| {
            let links = of
                .links
                .iter()
                .flat_map(|link| [link.mass, link.com, link.inertia, link.inertia_axial, link.inertia_transverse]);
            let joints = of.joints.iter().flat_map(stepped);
            let rest = of.gravity.iter().chain(&of.geometry).chain(of.home.iter().flatten()).copied();
            links.chain(joints).chain(rest).chain([of.handle_mass]).collect::<Vec<f64>>()
        };
        assert_eq!(counted.kind, shipped.kind, "{name}");
        assert!(
            same(&numbers(&counted), &numbers(&shipped)),
            "{name}: {:?}\n{:?}",
            numbers(&counted),
            numbers(&shipped)
        );
    }
}
