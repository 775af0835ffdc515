//! Demonstrates the benefit of the feed-forward on a simulated board over the real protocol (`haptic demo`).
//!
//! A hand presses onto a wall and slides along it, once without and once with the feed-forward, with the same tremor.
//! Then the stiffness is raised until the loop oscillates, also without and with the feed-forward, and compared with
//! the prediction. The demo uses the board through the link only, as it would use a real board.

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

/// Device of the demo, whose strong coupling makes the benefit of the feed-forward visible.
pub use haptic_bridge::model::shipped::COUPLED_FIVE_BAR as DEVICE;

/// The demonstration.
#[derive(Clone, Debug)]
pub struct Demo {
    /// Device file.
    pub file: DeviceFile,
    /// Pose in which the tip touches the wall, rad.
    pub pose: [f64; 3],
    /// The wall's unit normal, out of the solid.
    pub normal: [f64; 2],
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the velocity filter, Hz.
    pub cutoff_hz: f64,
    /// Stiffness of the pressed wall, N/m.
    pub stiffness: f64,
    /// Damping of the pressed wall, and damping in the search for the stable stiffness, N s/m.
    pub damping: f64,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// Seed of the hand's tremor.
    pub seed: u64,
}

/// Reason why the demo failed.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// The device cannot be simulated.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The board cannot be reached, or refuses a request.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The search for the stable stiffness failed.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// The pose cannot be used.
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

/// Inertia that the wall meets, kg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// Weff: without feed-forward.
    pub effective: f64,
    /// Wrr: with feed-forward.
    pub rendered: f64,
}

impl Demo {
    /// Returns the demo that `haptic demo` runs.
    ///
    /// The pose is a good working pose with a normal of nearly the strongest coupling there (`haptic map`). 1 kHz and
    /// 100 Hz are typical of computer-controlled devices; there the loop limits the stiffness, not the motors.
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

    /// Returns the joint angles of the pose.
    pub fn q(&self) -> &[f64] {
        &self.pose[..self.file.spec().joints]
    }

    /// Computes the inertia that the wall meets.
    pub fn inertia(&self) -> Result<Inertia, DemoError> {
        let linearised = Linearised::at(&self.file.description, self.q(), &self.normal)?;
        let rendered = linearised.w_rr();
        Ok(Inertia { effective: linearised.w_eff().unwrap_or(rendered), rendered })
    }

    /// Returns the command line that prints Weff and Wrr.
    pub fn model_command(&self) -> String {
        format!("haptic model devices/{}.toml {}", self.file.name, self.pose_options())
    }

    /// Returns the command line that prints the predicted highest stiffness without feed-forward and with the washout.
    pub fn range_command(&self, delay_samples: f64) -> String {
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

    /// Returns a scene with the demo's wall through `point`.
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
        // Cannot fail, because a scene has room for eight walls.
        let _ = scene.walls.push(wall);
        scene
    }
}
