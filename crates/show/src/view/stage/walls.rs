//! Changes that pages make to walls (gains, positions).

use super::Stage;
use crate::view::hub::PageId;
use crate::view::message::FromPage;
use crate::view::picture::Newest;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::shape::Meaning;
use haptic_bridge::render::scene::{FeedForward, Scene, Surface};
use haptic_host::error::Failure;
use haptic_host::link::BoardError;
use haptic_host::scene_file::place_of;
use haptic_host::vectors::{padded, unit};
use haptic_host::words::{wall_in_words, with_unit};
use haptic_predict::plausible::scene::largest_gains;
use serde_json::json;

/// Checks the scene that a board reports and returns it in f64; NaN and other invalid scenes cannot be drawn.
pub(super) fn check_scene(scene: &Scene<f32>, device: &Device<f64>) -> Result<Scene<f64>, Failure> {
    match scene.check(device.mechanism.kind().spec().task) {
        Ok(()) => Ok(scene.cast()),
        Err(why) => Err(Failure::impossible(format!("the scene of the board cannot be shown: {why}"))),
    }
}

/// Factor by which a gain may exceed a limit, because links to the page round gains to six digits.
const GAIN_TOLERANCE: f64 = 1.000_01;

impl Stage {
    pub(super) fn change_gains(
        &mut self,
        id: PageId,
        wall: u8,
        stiffness: f32,
        damping: f32,
        feed_forward: FeedForward,
        beyond: bool,
    ) -> Result<(), BoardError> {
        let Some(present) = self.scene.walls.get(usize::from(wall)) else {
            self.refuse(id, &format!("there is no wall {wall}"));
            return Ok(());
        };
        let requested = format!("{} with {}", with_unit(stiffness.into(), "N/m"), with_unit(damping.into(), "N s/m"));
        let q = Newest::of(&self.ring, &self.columns).q(self.device.axes());
        if let Some(max) = largest_gains(&self.device, &present.surface, &q, &self.rules.limits)
            && (f64::from(stiffness) > max.stiffness.max(GAIN_TOLERANCE * present.stiffness)
                || f64::from(damping) > max.damping.max(GAIN_TOLERANCE * present.damping))
        {
            let why = format!(
                "wall {wall} cannot have {requested}: above {} one encoder count, and above {} a slow hand, needs the full \
                 {} that motors and rules allow here",
                with_unit(max.stiffness, "N/m"),
                with_unit(max.damping, "N s/m"),
                with_unit(max.force, "N")
            );
            self.send(id, &json!({"is": "refused", "of": "gains", "why": why}));
            return Ok(());
        }
        if let Some(plane) = self.plane.as_ref().filter(|plane| plane.wall == usize::from(wall) && !beyond) {
            let max = plane.max_stiffness(feed_forward, f64::from(damping));
            let max_now = plane.max_stiffness(present.feed_forward, present.damping);
            // With gains already outside the boundary, only a feed-forward with a smaller range needs a confirmation.
            let less_stable = feed_forward != present.feed_forward && max < max_now;
            if f64::from(stiffness) > max && (present.stiffness <= max_now || less_stable) {
                let why = format!(
                    "{requested} and feed-forward {} is predicted to be unstable here: stable up to {}",
                    feed_forward.name(),
                    with_unit(max, "N/m")
                );
                let again = FromPage::Gains { wall, stiffness, damping, feed_forward, beyond: true };
                self.send(id, &json!({"is": "refused", "of": "gains", "why": why, "again": again}));
                return Ok(());
            }
        }
        let washout_hz = present.washout_hz as f32;
        self.board().set_wall_gains(Gains { wall, stiffness, damping, feed_forward, washout_hz })?;
        self.reread_scene()
    }

    pub(super) fn move_wall(
        &mut self,
        id: PageId,
        index: usize,
        point: [f32; 2],
        normal: Option<[f32; 2]>,
    ) -> Result<(), BoardError> {
        let Some(mut scene) = self.board().scene()? else { return Ok(()) };
        let task = usize::from(scene.task);
        let Some(wall) = scene.walls.get_mut(index) else {
            self.refuse(id, &format!("there is no wall {index}"));
            return Ok(());
        };
        let (shape, mut values) = (wall.surface.spec(), wall.surface.values());
        if let Some((_, at)) = place_of(&shape, Meaning::Point) {
            values.iter_mut().skip(at).zip(point).take(task).for_each(|(to, from)| *to = from);
        }
        wall.surface = Surface::from_values(shape.name, &values).unwrap_or(wall.surface);
        if let (Surface::Plane(plane), Some(normal)) = (&mut wall.surface, normal.filter(|_| task > 1)) {
            let Some(unit) = unit(&normal.map(f64::from)) else {
                self.refuse(id, "a normal must not be zero");
                return Ok(());
            };
            plane.normal = padded(&unit).map(|entry| entry as f32);
        }
        self.board().set_scene(&scene)?;
        self.requested = None;
        self.reread_scene()
    }

    /// Reads the scene that the board has now, and reports it.
    pub(super) fn reread_scene(&mut self) -> Result<(), BoardError> {
        if let Some(scene) = self.board().scene()? {
            match check_scene(&scene, &self.device) {
                Ok(scene) => self.scene = scene,
                Err(why) => self.refuse_all(None, &why.to_string()),
            }
        }
        self.buzz = self.predicted_buzz();
        self.send_to_all(&self.walls_message());
        let walls = self.scene.walls.iter().enumerate();
        let words: Vec<String> =
            walls.map(|(index, wall)| format!("wall {index}: {}", wall_in_words(&wall.cast()))).collect();
        self.record_event(&words.join("; "));
        Ok(())
    }
}
