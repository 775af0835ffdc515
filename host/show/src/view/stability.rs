//! The predicted boundary of a wall's gains where the device is now, worked out beside the stage on a thread of its
//! own; in a browser, which has none, when it is asked for (some milliseconds).

use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::BoundaryPoint;
use haptic_stability::analysis::several::Member;
use serde::{Deserialize, Serialize};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

/// A question to the [`Oracle`].
#[derive(Clone, Debug)]
pub struct Question {
    /// The device as the board has it, with what the file says that gives in it.
    pub subject: Subject,
    /// The scene.
    pub scene: Scene<f64>,
    /// Which wall, from 0.
    pub wall: usize,
    /// Joint angles, rad.
    pub q: Vec<f64>,
    /// The wall's normal there.
    pub normal: Vec<f64>,
    /// The board's delay and drives.
    pub path: TorquePath,
}

/// The boundary for each kind of feed-forward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plane {
    /// Which wall.
    pub wall: usize,
    /// Weff, kg: what the wall meets without feed-forward.
    pub w_eff: f64,
    /// Wrr, kg: what it meets with it.
    pub w_rr: f64,
    /// kp_max (N/m) over damping (N s/m), without feed-forward.
    pub off: Vec<BoundaryPoint>,
    /// With it.
    pub full: Vec<BoundaryPoint>,
    /// With it behind the wall's washout.
    pub washout: Vec<BoundaryPoint>,
}

impl Plane {
    /// The boundary for one kind of feed-forward.
    pub fn boundary(&self, mode: FeedForward) -> &[BoundaryPoint] {
        match mode {
            FeedForward::Off => &self.off,
            FeedForward::Full => &self.full,
            FeedForward::Washout => &self.washout,
        }
    }

    /// The largest stiffness (N/m) predicted to be stable with this damping (N s/m).
    pub fn stiffness_to(&self, mode: FeedForward, damping: f64) -> f64 {
        let boundary = self.boundary(mode);
        let next = boundary.partition_point(|point| point.kd < damping);
        match (next.checked_sub(1).and_then(|i| boundary.get(i)), boundary.get(next)) {
            (Some(low), Some(high)) => low.kp + (high.kp - low.kp) * (damping - low.kd) / (high.kd - low.kd),
            (None, Some(first)) if first.kd == damping => first.kp,
            _ => 0.0,
        }
    }
}

/// Answers a question; `None` where the pose is singular or the loop cannot be analysed.
pub fn answer(question: &Question) -> Option<Plane> {
    let Question { subject, scene, wall: index, q, normal, path } = question;
    let wall = scene.walls.get(*index)?;
    let prediction = Prediction::in_scene(subject, scene, Some(wall), path)?;
    let range = prediction.range(q, &[Member::new(normal.clone(), 1.0)], None, Some(wall.washout_hz)).ok()?;
    let washout = range.washout.map_or_else(Vec::new, |domain| domain.boundary);
    Some(Plane {
        wall: *index,
        w_eff: range.w_eff,
        w_rr: range.w_rr,
        off: range.off.boundary,
        full: range.full.boundary,
        washout,
    })
}

/// Answers the newest question and leaves out those that it is too late for.
#[derive(Debug)]
pub struct Oracle {
    /// The way to a thread that takes questions; `None` without threads, where each is answered when it is asked.
    questions: Option<Sender<Question>>,
    answer_to: Sender<Option<Plane>>,
    answers: Receiver<Option<Plane>>,
    busy: bool,
}

impl Default for Oracle {
    fn default() -> Self {
        let (questions, asked) = channel::<Question>();
        let (answer_to, answers) = channel();
        let to = answer_to.clone();
        let thread = thread::Builder::new().spawn(move || {
            while let Ok(first) = asked.recv() {
                let newest = asked.try_iter().last().unwrap_or(first);
                if to.send(answer(&newest)).is_err() {
                    return;
                }
            }
        });
        Self { questions: thread.is_ok().then_some(questions), answer_to, answers, busy: false }
    }
}

impl Oracle {
    /// Returns true while a question is being answered.
    pub fn is_busy(&self) -> bool {
        self.busy
    }

    /// Asks.
    pub fn ask(&mut self, question: Question) {
        self.busy = match &self.questions {
            Some(questions) => questions.send(question).is_ok(),
            None => self.answer_to.send(answer(&question)).is_ok(),
        };
    }

    /// The answer, once it is there.
    pub fn answered(&mut self) -> Option<Option<Plane>> {
        let answer = self.answers.try_iter().last();
        self.busy &= answer.is_none();
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::Demo;
    use haptic_stability::analysis::plant::Drive;

    #[test]
    fn the_wall_of_the_demo_is_stable_with_the_feed_forward_alone() {
        let demo = Demo::shipped(1).unwrap();
        let scene = demo.scene([0.0, 0.0], FeedForward::Washout).cast::<f64>();
        let question = Question {
            subject: Subject::new(&demo.file.description).unwrap(),
            scene,
            wall: 0,
            q: demo.q().to_vec(),
            normal: demo.normal.to_vec(),
            path: TorquePath { delay_samples: 0.025, drive: Drive::Ideal },
        };
        let mut oracle = Oracle::default();
        oracle.ask(question);
        assert!(oracle.is_busy());
        let plane = loop {
            if let Some(answer) = oracle.answered() {
                break answer.unwrap();
            }
            thread::yield_now();
        };
        assert!(!oracle.is_busy());
        let to = |mode| plane.stiffness_to(mode, demo.damping);
        assert!(to(FeedForward::Off) < demo.stiffness && demo.stiffness < to(FeedForward::Washout));
        assert!(to(FeedForward::Washout) < to(FeedForward::Full));
        assert_eq!(plane.stiffness_to(FeedForward::Off, 1e6), 0.0, "no damping beyond the boundary is stable");
    }
}
