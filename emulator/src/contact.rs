//! A device whose tip a hand pushes into walls.

use std::time::Duration;

use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::model::motor::Winding;
use haptic_host::device_file::DeviceFile;
use haptic_sim::Support;

use crate::boards::Wiring;
use crate::hands::{hold, push, suspend_device};
use crate::rig::Rig;
use crate::run::{MILLISECOND, SECOND};

/// A wall relative to the tip's initial position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearWall {
    /// Unit normal towards the free side.
    pub normal: [f64; 3],
    /// Radius of a sphere, m, or `None` for a plane.
    pub radius: Option<f64>,
    /// Distance from the tip to the wall at the start, m.
    pub gap: f64,
    /// Stiffness, N/m.
    pub stiffness: f64,
    /// Damping, N s/m.
    pub damping: f64,
    /// Feed-forward: `off`, `full` or `washout`.
    pub feed_forward: &'static str,
}

impl NearWall {
    /// Returns a wall of 500 N/m with the full feed-forward, 3 mm from the tip.
    #[must_use]
    pub fn with_normal(normal: [f64; 3]) -> Self {
        Self { normal, radius: None, gap: 0.003, stiffness: 500.0, damping: 1.0, feed_forward: "full" }
    }
}

/// Returns the text of a scene file with `head` and with `walls` in front of `tip` (m), in `task` dimensions.
#[must_use]
pub fn scene(head: &str, tip: [f64; 3], task: usize, walls: &[NearWall]) -> String {
    let list = |values: [f64; 3]| values.iter().take(task).map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ");
    let mut text = head.to_owned();
    for wall in walls {
        let behind = wall.gap + wall.radius.unwrap_or(0.0);
        let point = list(std::array::from_fn(|i| tip[i] - behind * wall.normal[i]));
        text += &match wall.radius {
            Some(radius) => format!("[[wall]]\nshape = \"sphere\"\npoint = [{point}]\nradius = {radius:?}\n"),
            None => format!("[[wall]]\npoint = [{point}]\nnormal = [{}]\n", list(wall.normal)),
        };
        let NearWall { stiffness, damping, feed_forward, .. } = wall;
        text += &format!("stiffness = {stiffness:?}\ndamping = {damping:?}\nfeed_forward = \"{feed_forward}\"\n");
    }
    text
}

impl Rig {
    /// Returns an armed board whose device is homed in front of `walls`. A hand has pushed the tip into the walls for
    /// 0.5 s, with `newtons` along each normal.
    #[must_use]
    pub fn in_contact(
        kind: impl Into<&'static Wiring>,
        name: &str,
        head: &str,
        walls: &[NearWall],
        newtons: f64,
    ) -> Self {
        let mut rig = Self::with_device(kind, name, |_| ());
        rig.arm_near_walls(head, walls);
        let force = std::array::from_fn(|i| walls.iter().map(|wall| -newtons * wall.normal[i]).sum());
        rig.with_simulated(move |device| push(device, force, 0.3));
        rig.run(SECOND / 2);
        rig
    }

    /// Loads the device with a scene without walls, homes the device at rest and checks its polarity. Afterwards a firm
    /// hand holds the device. Returns the counts at homing.
    pub fn prepare(&mut self, head: &str) -> [i32; 3] {
        self.load(head);
        self.with_simulated(|device| device.set_support(Support::Held));
        let home = self.counts();
        self.tool.home().expect("the device can be homed");
        self.check_polarity_suspended();
        self.with_simulated(hold);
        self.run(300 * MILLISECOND);
        home
    }

    /// Checks the polarity while a rubber band carries the device. A device with three-phase motors lies free, because
    /// the band would shift the alignment of its motors.
    pub fn check_polarity_suspended(&mut self) {
        let mut joints = self.file.iter().flat_map(|file| &file.description.joints);
        match joints.any(|joint| joint.motor.is_some_and(|motor| motor.winding != Winding::Brushed)) {
            true => self.with_simulated(|device| device.set_support(Support::None)),
            false => self.with_simulated(suspend_device),
        }
        self.check_polarity();
        self.with_simulated(|device| device.set_support(Support::None));
    }

    /// Returns the board's encoder counts, which are 0 at the board's start.
    fn counts(&mut self) -> [i32; 3] {
        self.tool.start_stream(Fields(Field::Counts.bit()), 1).expect("a stream starts");
        let mut rows = Vec::new();
        while rows.is_empty() {
            rows = self.tool.rows(Duration::from_millis(100)).expect("rows come");
        }
        self.tool.stop_stream().expect("the stream stops");
        let counts = rows.last().map(|row| row.get(Field::Counts).to_vec()).unwrap_or_default();
        std::array::from_fn(|i| counts.get(i).map_or(0, |count| *count as i32))
    }

    /// Prepares the device, loads `walls` in front of the tip, and arms. Returns the text of the scene.
    pub fn arm_near_walls(&mut self, head: &str, walls: &[NearWall]) -> String {
        self.prepare(head);
        let tip = self.with_simulated(|device| device.tip());
        let task = self.file.as_ref().map_or(2, |file: &DeviceFile| file.spec().task);
        let scene = scene(head, tip, task, walls);
        self.set_scene(&scene);
        self.arm();
        scene
    }
}
