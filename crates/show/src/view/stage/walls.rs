//! Walls as pages change them: gains, places; and the scene as the board has it afterwards.

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
use haptic_predict::plausible::scene::most_gains;
use serde_json::json;

/// The scene that a board tells of, unless no board could render it: numbers that are none are not drawn.
pub(super) fn fit(scene: &Scene<f32>, device: &Device<f64>) -> Result<Scene<f64>, Failure> {
    match scene.check(device.mechanism.kind().spec().task) {
        Ok(()) => Ok(scene.cast()),
        Err(why) => Err(Failure::impossible(format!("the scene of the board cannot be shown: {why}"))),
    }
}

/// Gains of a link are rounded to six digits: so much more is no other gain.
const SAME: f64 = 1.000_01;

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
        let Some(now) = self.scene.walls.get(usize::from(wall)) else {
            self.refuse(id, &format!("there is no wall {wall}"));
            return Ok(());
        };
        let asked = format!("{} with {}", with_unit(stiffness.into(), "N/m"), with_unit(damping.into(), "N s/m"));
        let q = Newest::of(&self.ring, &self.columns).q(self.device.axes());
        if let Some(most) = most_gains(&self.device, &now.surface, &q, &self.rules.limits)
            && (f64::from(stiffness) > most.stiffness.max(SAME * now.stiffness)
                || f64::from(damping) > most.damping.max(SAME * now.damping))
        {
            let why = format!(
                "wall {wall} cannot have {asked}: beyond {} one encoder count, and beyond {} a creeping hand, asks for all of the \
                 {} that motors and rules allow here",
                with_unit(most.stiffness, "N/m"),
                with_unit(most.damping, "N s/m"),
                with_unit(most.force, "N")
            );
            self.say(id, &json!({"is": "refused", "of": "gains", "why": why}));
            return Ok(());
        }
        if let Some(plane) = self.plane.as_ref().filter(|plane| plane.wall == usize::from(wall) && !beyond) {
            let most = plane.stiffness_to(feed_forward, f64::from(damping));
            let most_now = plane.stiffness_to(now.feed_forward, now.damping);
            // Who is outside already is not asked again, but for a feed-forward that lets even less be stable.
            let less_stable = feed_forward != now.feed_forward && most < most_now;
            if f64::from(stiffness) > most && (now.stiffness <= most_now || less_stable) {
                let why = format!(
                    "{asked} and feed-forward {} is predicted to be unstable here: stable up to {}",
                    feed_forward.name(),
                    with_unit(most, "N/m")
                );
                let again = FromPage::Gains { wall, stiffness, damping, feed_forward, beyond: true };
                self.say(id, &json!({"is": "refused", "of": "gains", "why": why, "again": again}));
                return Ok(());
            }
        }
        let washout_hz = now.washout_hz as f32;
        self.board().set_wall_gains(Gains { wall, stiffness, damping, feed_forward, washout_hz })?;
        self.reread()
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
                self.refuse(id, "a normal points somewhere");
                return Ok(());
            };
            plane.normal = padded(&unit).map(|entry| entry as f32);
        }
        self.board().set_scene(&scene)?;
        self.asked = None;
        self.reread()
    }

    /// Reads what the board has now, and tells.
    pub(super) fn reread(&mut self) -> Result<(), BoardError> {
        if let Some(scene) = self.board().scene()? {
            match fit(&scene, &self.device) {
                Ok(scene) => self.scene = scene,
                Err(why) => self.refuse_all(None, &why.to_string()),
            }
        }
        self.buzz = self.predicted_buzz();
        self.say_to_all(&self.walls());
        let walls = self.scene.walls.iter().enumerate();
        let words: Vec<String> =
            walls.map(|(index, wall)| format!("wall {index}: {}", wall_in_words(&wall.cast()))).collect();
        self.note(&words.join("; "));
        Ok(())
    }
}
