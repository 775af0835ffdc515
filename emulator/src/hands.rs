//! Actions of hands on a simulated device.

use haptic_sim::{Hand, HandSettings, Intent, SimulatedDevice, Support, Waypoint};

/// Returns the settings of a very stiff hand.
#[must_use]
pub fn firm_settings() -> HandSettings {
    HandSettings {
        grip_stiffness: 50_000.0,
        grip_damping: 100.0,
        arm_stiffness: 50_000.0,
        arm_damping: 100.0,
        ..HandSettings::default()
    }
}

/// Makes a firm hand hold the tip, as a person does while homing a device that would fall.
pub fn hold(device: &mut SimulatedDevice) {
    let path = vec![Waypoint { time: 0.0, value: device.tip() }];
    device.set_hand(Hand::new(firm_settings(), Intent::Follow(path), device.tip(), device.time()));
}

/// Suspends a device for the polarity check. Its weight is carried without inertia. A rubber band holds it lightly,
/// because a free device drifts if a sensor has a zero offset.
pub fn suspend_device(device: &mut SimulatedDevice) {
    let band = HandSettings { grip_stiffness: 5.0, grip_damping: 0.5, ..firm_settings() };
    let path = vec![Waypoint { time: 0.0, value: device.tip() }];
    device.set_support(Support::Carried);
    device.set_hand(Hand::new(band, Intent::Follow(path), device.tip(), device.time()));
}

/// Makes a firm hand move the tip to and fro by `distance` (m) for `seconds`.
pub fn move_to_and_fro(device: &mut SimulatedDevice, distance: f64, seconds: f64) {
    let tip = device.tip();
    let place = |k: u32| tip.map(|x| if k % 2 == 1 { x + distance } else { x });
    let path = (0..=(10.0 * seconds) as u32).map(|k| Waypoint { time: 0.1 * f64::from(k), value: place(k) }).collect();
    device.set_hand(Hand::new(firm_settings(), Intent::Follow(path), tip, device.time()));
}

/// Makes a trembling hand push the tip with a force that rises to `force` (N) within `seconds`.
pub fn push(device: &mut SimulatedDevice, force: [f64; 3], seconds: f64) {
    let path = vec![Waypoint::default(), Waypoint { time: seconds, value: force }];
    let settings = HandSettings { tremor: 2e-4, ..HandSettings::default() };
    device.set_hand(Hand::new(settings, Intent::Push(path), device.tip(), device.time()));
}
