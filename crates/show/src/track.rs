//! Drawn places of task coordinates that have no plane: the arc of a paddle, the rail of a slide.

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{ARC, Description};
use haptic_bridge::model::device::Device;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::skeleton::skeleton;
use serde::Serialize;

/// Change of a joint coordinate over which the direction of a slide is computed, rad or m.
const STEP: f64 = 1e-3;
/// Distance between devices whose file is not known, m.
const APART: f64 = 0.1;

/// A line whose points have one task coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Track {
    /// An arc; the coordinate is the length along it.
    Arc {
        /// Pivot, m.
        centre: [f64; 2],
        /// Radius, m.
        radius: f64,
        /// Direction of coordinate zero, rad from +x.
        zero: f64,
        /// 1 if the coordinate grows counter-clockwise, -1 if clockwise.
        sense: f64,
    },
    /// A straight line.
    Line {
        /// Place of coordinate zero, m.
        at: [f64; 2],
        /// Displacement per unit of the coordinate.
        along: [f64; 2],
    },
}

impl Track {
    /// Returns a track for each task coordinate of a device of one joint or of several paddles; none for other devices.
    /// Without `links` the tracks are straight.
    pub fn of(device: &Device<f64>, links: Option<&Description>) -> Vec<Self> {
        let kind = device.mechanism.kind();
        let joints = kind.spec().joints;
        if joints > 1 && !matches!(kind, Kind::Paddles2 | Kind::Paddles3) {
            return Vec::new();
        }
        let Some(links) = links else {
            return (0..joints).map(|i| Self::Line { at: [0.0, -APART * i as f64], along: [1.0, 0.0] }).collect();
        };
        if kind == Kind::Chain1 && links.geometry[3] != ARC {
            return Self::straight(links).into_iter().collect();
        }
        let arcs = skeleton(links, &vec![0.0; joints]).map(|drawn| drawn.angles).unwrap_or_default();
        arcs.iter()
            .map(|arc| Self::Arc { centre: arc.at.into(), radius: arc.arm, zero: arc.zero, sense: arc.sense })
            .collect()
    }

    fn straight(links: &Description) -> Option<Self> {
        let home = links.home.unwrap_or_default()[0];
        let place = |q: f64| Some((TaskPose::at(links, &[q]).ok()?.position[0], skeleton(links, &[q])?.tip));
        let ((before, from), (after, to)) = (place(home)?, place(home + STEP)?);
        let along = [(to.0 - from.0) / (after - before), (to.1 - from.1) / (after - before)];
        Some(Self::Line { at: [from.0 - before * along[0], from.1 - before * along[1]], along })
    }

    /// Returns the place of a coordinate (m).
    pub fn place(&self, coordinate: f64) -> [f64; 2] {
        match *self {
            Self::Arc { centre, radius, zero, sense } => {
                let (sin, cos) = (zero + sense * coordinate / radius).sin_cos();
                [centre[0] + radius * cos, centre[1] + radius * sin]
            }
            Self::Line { at, along } => [at[0] + coordinate * along[0], at[1] + coordinate * along[1]],
        }
    }

    /// Returns the unit vector in which a coordinate (m) grows.
    pub fn direction(&self, coordinate: f64) -> [f64; 2] {
        match *self {
            Self::Arc { radius, zero, sense, .. } => {
                let (sin, cos) = (zero + sense * coordinate / radius).sin_cos();
                [-sense * sin, sense * cos]
            }
            Self::Line { along: [x, y], .. } => {
                let length = x.hypot(y).max(1e-9);
                [x / length, y / length]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_bridge::model::shipped::HAPKIT_PADDLE;
    use haptic_host::device_file::DeviceFile;

    /// Compares the tracks with the drawn tips of a paddle, two paddles, a slide, and a chain that turns clockwise.
    #[test]
    fn every_coordinate_is_drawn_at_its_tip() {
        let clockwise = include_str!("../../../devices/yoke.toml");
        let text = |file: &str| DeviceFile::parse(file, "device").unwrap();
        assert!(Track::of(&text(clockwise).device().unwrap(), Some(&text(clockwise).description)).is_empty());
        let mut pendulum = text(&haptic_predict::template::device_file(Kind::Chain1, "pendulum"));
        pendulum.description.joints[0].frame.axis = [0.0, 0.0, -1.0];
        let files = [
            text(HAPKIT_PADDLE),
            text(include_str!("../../../devices/two-paddles.toml")),
            text(include_str!("../../../devices/fader.toml")),
            pendulum,
        ];
        for DeviceFile { name, description, .. } in files {
            let device = Device::new("", &description).unwrap();
            let (tracks, q) = (Track::of(&device, Some(&description)), [0.07, -0.2]);
            let joints = description.kind.spec().joints;
            let position = TaskPose::at(&description, &q[..joints]).unwrap().position;
            let drawn = skeleton(&description, &q[..joints]).unwrap();
            let tips: Vec<_> = [drawn.tip].into_iter().chain(drawn.more_tips).collect();
            assert_eq!((tracks.len(), tips.len()), (joints, joints), "{name}");
            for ((track, tip), coordinate) in tracks.iter().zip(tips).zip(position) {
                let [x, y] = track.place(coordinate);
                assert!((x - tip.0).hypot(y - tip.1) < 1e-9, "{name}: {track:?}, tip {tip:?}");
                let [along, across] = track.direction(coordinate);
                let [after, above] = track.place(coordinate + 1e-6);
                assert!((after - x - 1e-6 * along).hypot(above - y - 1e-6 * across) < 1e-10, "{name}");
            }
        }
    }
}
