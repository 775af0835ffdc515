//! The benefit of the feed-forward, shown on a simulated board over the real protocol (`haptic demo`).
//!
//! Twice the same: a hand presses onto a wall and slides along it, once without and once with the feed-forward, with
//! the same tremor. And twice: the stiffness is raised until the loop oscillates, beside what theory predicts. Only
//! the simulated device's truth is hidden from the board; everything else goes through the link.

pub mod comparison;
pub mod crossing;
pub mod picture;
pub mod stiffness;

use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::{BoardError, LinkError};
use haptic_predict::measure::MeasureError;
use haptic_sim::DeviceError;
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::PoseError;

/// The device of the demo: strongly coupled, so the feed-forward matters.
pub use haptic_bridge::model::shipped::COUPLED_FIVE_BAR as DEVICE;

/// The demonstration.
#[derive(Clone, Debug)]
pub struct Demo {
    /// The device.
    pub file: DeviceFile,
    /// The pose in which the tip touches the wall, rad.
    pub pose: [f64; 3],
    /// The wall's unit normal, out of the solid.
    pub normal: [f64; 2],
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the velocity filter, Hz.
    pub cutoff_hz: f64,
    /// Stiffness of the wall that is pressed, N/m.
    pub stiffness: f64,
    /// Its damping, and that at which the stable stiffness is sought, N s/m.
    pub damping: f64,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// Seed of the hand's tremor.
    pub seed: u64,
}

/// Why the demo did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// The device cannot be simulated.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The board could not be asked, or refused.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The search for the stable stiffness failed.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// The pose is no good.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The prediction failed.
    #[error(transparent)]
    Theory(#[from] haptic_stability::analysis::sampled::AnalysisError),
}

impl From<LinkError> for DemoError {
    fn from(error: LinkError) -> Self {
        Self::Board(error.into())
    }
}

impl From<DemoError> for Failure {
    fn from(error: DemoError) -> Self {
        Self::impossible(error)
    }
}

/// The inertia that the wall meets, kg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// Weff: without feed-forward.
    pub effective: f64,
    /// Wrr: with it.
    pub rendered: f64,
}

impl Demo {
    /// The demo that ships.
    ///
    /// The pose is the device's good working pose and the normal one of its worst (`haptic map`). 1 kHz and 100 Hz are
    /// what a computer-controlled device usually has; there the loop, not the motors, limits how hard a wall can be.
    pub fn shipped(seed: u64) -> Result<Self, Failure> {
        let (sine, cosine) = 75.0_f64.to_radians().sin_cos();
        Ok(Self {
            file: DeviceFile::parse(DEVICE, "coupled-five-bar.toml")?,
            pose: [2.6, 1.75, 0.0],
            normal: [cosine, sine],
            rate_hz: 1000.0,
            cutoff_hz: 100.0,
            stiffness: 22_000.0,
            damping: 40.0,
            washout_hz: 2.0,
            seed,
        })
    }

    /// Joint angles of the pose, as many as there are.
    pub fn q(&self) -> &[f64] {
        &self.pose[..self.file.spec().joints]
    }

    /// The inertia that the wall meets.
    pub fn inertia(&self) -> Result<Inertia, DemoError> {
        let seen = Linearised::at(&self.file.description, self.q(), &self.normal)?;
        let rendered = seen.w_rr();
        Ok(Inertia { effective: seen.w_eff().unwrap_or(rendered), rendered })
    }

    /// The command line that prints what the wall meets, Weff and Wrr.
    pub fn model_line(&self) -> String {
        format!("haptic model devices/{}.toml {}", self.file.name, self.pose_options())
    }

    /// The command line that prints the predicted stiffness: its highest kp without feed-forward and with the washout.
    pub fn range_line(&self, delay_samples: f64) -> String {
        format!(
            "haptic range devices/{}.toml {} --rate {} --cutoff {} --delay {delay_samples:.6} --undamped --kd {} --washout {}",
            self.file.name,
            self.pose_options(),
            self.rate_hz,
            self.cutoff_hz,
            self.damping,
            self.washout_hz
        )
    }

    fn pose_options(&self) -> String {
        let q: Vec<String> = self.q().iter().map(ToString::to_string).collect();
        let [nx, ny] = self.normal;
        format!("--q {} --normal {nx:.6},{ny:.6}", q.join(","))
    }

    /// A scene with the demo's wall through `point`.
    pub fn scene(&self, point: [f64; 2], feed_forward: FeedForward) -> Scene<f32> {
        let flat = |v: [f64; 2]| [v[0] as f32, v[1] as f32, 0.0];
        let wall = Wall {
            surface: Surface::Plane(Plane { point: flat(point), normal: flat(self.normal) }),
            stiffness: self.stiffness as f32,
            damping: self.damping as f32,
            feed_forward,
            washout_hz: self.washout_hz as f32,
            damping_compensation: false,
            bilateral: false,
        };
        let mut scene =
            Scene { task: 2, rate_hz: self.rate_hz as f32, cutoff_hz: self.cutoff_hz as f32, ..Scene::default() };
        // A scene holds eight walls.
        let _ = scene.walls.push(wall);
        scene
    }
}
