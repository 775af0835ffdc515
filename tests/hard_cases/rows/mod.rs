//! The rows that bounds.rs asserts and docs/hard-cases/ lists. Results in the board's f32 and in f64 are compared with
//! a reference, which is the library's own code in the `Exact` numbers of the including module.
#![allow(dead_code, reason = "only the tables use all of them")]

use super::{Exact, ExactMath, shipped_device};
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{Description, Joint, JointFrame};
use std::sync::LazyLock;

/// Evaluates an expression with the mechanism of a device in f64, in f32 and in the reference's numbers.
macro_rules! in_three_precisions {
    ($description:expr, ($double:ident, $board:ident, $reference:ident) => $result:expr) => {{
        let exact = haptic_bridge::model::mechanism::AnyMechanism::<super::Exact>::new($description);
        haptic_bridge::with_mechanism!(exact.expect("a sound device"), $reference => {
            let ($double, $board) = ($reference.cast::<f64>(), $reference.cast::<f32>());
            $result
        })
    }};
}
pub mod double;
pub mod extremes;
pub mod filters;
pub mod routes;
pub mod several;
pub mod singular;
pub mod steps;
pub mod turns;

/// Returns the devices of the tables with their names there, one or two per mechanism.
pub fn devices() -> Vec<(&'static str, Description)> {
    let shipped = [
        ("paddle", "hapkit-paddle"),
        ("paddle with weight", "upright-hapkit"),
        ("five-bar", "haply-2diy"),
        ("five-bar-turret", "fictive-five-bar-turret"),
        ("parallelogram", "phantom-premium-1.5"),
        ("serial-3r", "serial-3r"),
        ("chain-2", "planar-arm"),
        ("chain-3", "touch"),
        ("delta", "falcon-like"),
    ];
    let made = [
        ("paddles-2", unequal_paddles(Kind::Paddles2)),
        ("paddles-3", unequal_paddles(Kind::Paddles3)),
        ("chain-1", single_arm()),
        ("chain-2 (slide)", polar_arm()),
    ];
    shipped.map(|(name, file)| (name, shipped_device(file))).into_iter().chain(made).collect()
}

/// Returns two or three paddles with weight and unequal lengths and inertias.
fn unequal_paddles(kind: Kind) -> Description {
    let mut device = Description { kind, ..shipped_device("upright-hapkit") };
    for (i, factor) in [1.0, 0.5, 1.5].into_iter().enumerate().take(kind.spec().joints) {
        device.geometry[i] = factor * 0.07;
        device.links[i] = device.links[0];
        device.joints[i] = Joint { inertia: factor * 1.7e-4, ..device.joints[0] };
    }
    device
}

/// Returns a chain of one joint, the forearm of the planar arm. Its task is the tip's x.
pub fn single_arm() -> Description {
    let mut device = shipped_device("planar-arm");
    device.kind = Kind::Chain1;
    device.links[0] = device.links[1];
    device.gravity = [0.0, -9.81, 0.0];
    device
}

/// Returns a chain of a revolute and a prismatic joint. It is singular inside the slide's limits.
pub fn polar_arm() -> Description {
    let mut device = shipped_device("planar-arm");
    device.gravity = [0.0, -9.81, 0.0];
    let slide = &mut device.joints[1];
    (slide.prismatic, slide.inertia, slide.limits) = (true, 0.02, Some((-0.2, 0.2)));
    slide.frame = JointFrame { origin: [0.02, 0.01, 0.0], rpy: [0.0, 0.0, 0.4], axis: [1.0, 0.0, 0.0] };
    device
}

/// Returns the mean length of a device's first links, m.
pub fn mean_length(device: &Description) -> f64 {
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let [a, b, c, ..] = device.geometry;
    match device.kind {
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => {
            let arms = device.joints.iter().map(|joint| norm(joint.frame.origin));
            (norm([a, b, c]) + arms.sum::<f64>()) / device.kind.spec().joints as f64
        }
        _ => (a + b + c) / 3.0,
    }
}

pub static SINGULAR_ROWS: LazyLock<Vec<singular::Row>> = LazyLock::new(singular::all_rows);
pub static EXTREME_ROWS: LazyLock<Vec<extremes::Row>> = LazyLock::new(extremes::all_rows);
pub static FILTER_ROWS: LazyLock<Vec<filters::Row>> = LazyLock::new(filters::all_rows);
pub static STEP_ROWS: LazyLock<Vec<steps::Row>> = LazyLock::new(steps::all_rows);
pub static TWO_WALL_ROWS: LazyLock<Vec<several::Row>> = LazyLock::new(several::all_rows);
pub static TURN_ROWS: LazyLock<Vec<turns::Row>> = LazyLock::new(turns::all_rows);
pub static DOUBLE_ROWS: LazyLock<Vec<double::Row>> = LazyLock::new(double::all_rows);
