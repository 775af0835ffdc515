//! A device whose tip stands before walls, pushed into them by a hand.

use std::time::Duration;

use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_host::device_file::DeviceFile;
use haptic_sim::Support;

use crate::boards::Wiring;
use crate::hands::{hang, hold, push};
use crate::rig::Rig;
use crate::run::{MILLISECOND, SECOND};

/// A wall before the tip, by where the tip starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallAt {
    /// Unit normal, pointing to the free side.
    pub normal: [f64; 3],
    /// Radius of a ball, m; a plane without.
    pub radius: Option<f64>,
    /// From the tip to the wall at the start, m.
    pub gap: f64,
    /// N/m
    pub stiffness: f64,
    /// N s/m
    pub damping: f64,
    /// `off`, `full` or `washout`.
    pub feed_forward: &'static str,
}

impl WallAt {
    /// A wall of 500 N/m with the feed-forward in full, 3 mm from the tip.
    #[must_use]
    pub fn facing(normal: [f64; 3]) -> Self {
        Self { normal, radius: None, gap: 0.003, stiffness: 500.0, damping: 1.0, feed_forward: "full" }
    }
}

/// The scene file with `walls` before a tip at `tip` of a task of `task` dimensions; `head` comes first.
#[must_use]
pub fn scene(head: &str, tip: [f64; 3], task: usize, walls: &[WallAt]) -> String {
    let list = |values: [f64; 3]| values.iter().take(task).map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ");
    let mut text = head.to_owned();
    for wall in walls {
        let behind = wall.gap + wall.radius.unwrap_or(0.0);
        let point = list(std::array::from_fn(|i| tip[i] - behind * wall.normal[i]));
        text += &match wall.radius {
            Some(radius) => format!("[[wall]]\nshape = \"sphere\"\npoint = [{point}]\nradius = {radius:?}\n"),
            None => format!("[[wall]]\npoint = [{point}]\nnormal = [{}]\n", list(wall.normal)),
        };
        let WallAt { stiffness, damping, feed_forward, .. } = wall;
        text += &format!("stiffness = {stiffness:?}\ndamping = {damping:?}\nfeed_forward = \"{feed_forward}\"\n");
    }
    text
}

impl Rig {
    /// A board with a device that was homed, held, armed before `walls`, and is pushed into them by `newtons` along
    /// each of their normals for half a second.
    ///
    /// # Panics
    ///
    /// When the board refuses anything.
    #[must_use]
    pub fn in_contact(
        kind: impl Into<&'static Wiring>,
        name: &str,
        head: &str,
        walls: &[WallAt],
        newtons: f64,
    ) -> Self {
        let mut rig = Self::with_device(kind, name, |_| ());
        rig.arm_before(head, walls);
        let force = std::array::from_fn(|i| walls.iter().map(|wall| -newtons * wall.normal[i]).sum());
        rig.with_simulated(move |device| push(device, force, 0.3));
        rig.run(SECOND / 2);
        rig
    }

    /// Loads the device with a scene without walls, homes it while somebody holds it still, and has its polarity
    /// checked; a firm hand holds it after that. The counts at which it was homed.
    ///
    /// # Panics
    ///
    /// When the board refuses anything.
    pub fn prepare(&mut self, head: &str) -> [i32; 3] {
        self.load(head);
        self.with_simulated(|device| device.set_support(Support::Held));
        let home = self.counts();
        self.tool.home().expect("the device can be homed");
        self.check_hanging();
        self.with_simulated(hold);
        self.run(300 * MILLISECOND);
        home
    }

    /// Has the polarity checked of a device that hangs meanwhile.
    ///
    /// # Panics
    ///
    /// When the board refuses, or the check fails.
    pub fn check_hanging(&mut self) {
        self.with_simulated(hang);
        self.check_polarity();
        self.with_simulated(|device| device.set_support(Support::None));
    }

    /// The encoders' counts as the board has them: what turned before it started is not in them.
    fn counts(&mut self) -> [i32; 3] {
        self.tool.start_stream(Fields(Field::Counts.bit()), 1).expect("a stream starts");
        let mut rows = Vec::new();
        while rows.is_empty() {
            rows = self.tool.rows(Duration::from_millis(100)).expect("rows come");
        }
        self.tool.stop_stream().expect("the stream stops");
        let told = rows.last().map(|row| row.get(Field::Counts).to_vec()).unwrap_or_default();
        std::array::from_fn(|i| told.get(i).map_or(0, |count| *count as i32))
    }

    /// Prepares the device, loads `walls` before the tip, wherever the polarity check took it, and arms. The scene's
    /// text.
    ///
    /// # Panics
    ///
    /// When the board refuses anything.
    pub fn arm_before(&mut self, head: &str, walls: &[WallAt]) -> String {
        self.prepare(head);
        let tip = self.with_simulated(|device| device.tip());
        let task = self.file.as_ref().map_or(2, |file: &DeviceFile| file.spec().task);
        let scene = scene(head, tip, task, walls);
        self.set_scene(&scene);
        self.arm();
        scene
    }
}
