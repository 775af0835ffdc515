//! The predicted boundary of a wall's gains where the device is now, worked out beside the stage on a thread of its
//! own; in a browser, which has none, when it is asked for (some milliseconds).

use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_host::words::{counted, digits, listed, with_unit};
use haptic_predict::plausible::scene::count_along;
use haptic_stability::analysis::control_loop::{Mode, TorquePath};
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::oscillation::Oscillation;
use haptic_stability::analysis::plant::{Drive, Linearised};
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::{BoundaryPoint, domain};
use haptic_stability::analysis::several::Member;
use haptic_stability::analysis::why::limits_without;
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
    /// The hand that a page leads, where the device is simulated: the boundary is without it.
    pub hand: Option<Hand>,
    /// Also say what limits the wall's stiffness, which takes several times as long.
    pub explain: bool,
}

/// The boundary for each kind of feed-forward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plane {
    /// Which wall.
    pub wall: usize,
    /// Joint angles of the prediction, rad.
    #[serde(default)]
    pub q: Vec<f64>,
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
    /// The device and the loop that were predicted, and what no prediction here knows of: a sentence each.
    #[serde(default)]
    pub assumes: Vec<String>,
    /// What limits the stiffness, if that was asked.
    pub limits: Option<Explained>,
}

/// What limits the stiffness of a wall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Explained {
    /// For this kind of feed-forward.
    pub feed_forward: FeedForward,
    /// The largest stiffness of all dampings, N/m; none where nothing limits it.
    pub stiffness: Option<f64>,
    /// The damping that it needs, N s/m.
    pub damping: Option<f64>,
    /// One effect less, each in turn.
    pub without: Vec<Without>,
    /// The motion of the tip along the normal in one encoder count, m.
    pub count: f64,
}

/// The limit without one effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Without {
    /// The effect.
    pub effect: String,
    /// The condition that replaces it.
    pub instead: String,
    /// The largest stiffness then, N/m; none where nothing limits it.
    pub stiffness: Option<f64>,
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

impl Question {
    /// The prediction, and the device as the wall sees it.
    fn predicted(&self) -> Option<(Prediction, Linearised)> {
        let wall = self.scene.walls.get(self.wall)?;
        let prediction = Prediction::in_scene(&self.subject, &self.scene, Some(wall), &self.path)?;
        let seen = prediction.seen(&self.q, &self.normal).ok()?;
        Some((prediction, seen))
    }

    fn mode(&self) -> Option<Mode> {
        let wall = self.scene.walls.get(self.wall)?;
        Some(Mode::of(wall.feed_forward, wall.washout_hz))
    }
}

/// Answers a question; `None` where the pose is singular or the loop cannot be analysed.
pub fn answer(question: &Question) -> Option<Plane> {
    let Question { scene, wall: index, q, normal, .. } = question;
    let wall = scene.walls.get(*index)?;
    let (prediction, seen) = question.predicted()?;
    let range = prediction.range(q, &[Member::new(normal.clone(), 1.0)], None, Some(wall.washout_hz)).ok()?;
    let washout = range.washout.map_or_else(Vec::new, |domain| domain.boundary);
    let limits = if question.explain { explained(question, &prediction, &seen) } else { None };
    Some(Plane {
        wall: *index,
        q: q.clone(),
        w_eff: range.w_eff,
        w_rr: range.w_rr,
        off: range.off.boundary,
        full: range.full.boundary,
        washout,
        assumes: assumptions(question, &prediction, &seen),
        limits,
    })
}

/// The swing of the wall as it is: beyond the boundary its buzz.
pub fn buzz(question: &Question) -> Option<Oscillation> {
    let wall = question.scene.walls.get(question.wall)?;
    let (prediction, _) = question.predicted()?;
    let members = [Member::new(question.normal.clone(), 1.0)];
    prediction.buzz(&question.q, &members, question.mode()?, wall.stiffness, wall.damping).ok()?
}

fn explained(question: &Question, prediction: &Prediction, seen: &Linearised) -> Option<Explained> {
    let (mode, around) = (question.mode()?, &prediction.around);
    let (all, without) = limits_without(seen, around, mode).ok()?;
    let mut without: Vec<Without> = without
        .into_iter()
        .map(|(effect, instead, limits)| Without {
            effect: effect.into(),
            instead: instead.into(),
            stiffness: limits.map(|limits| limits.kp_max),
        })
        .collect();
    if let Some(hand) = question.hand {
        without.push(Without {
            effect: "empty hand".into(),
            instead: format!(
                "held by {} and {}, as this page's hand does",
                with_unit(hand.stiffness, "N/m"),
                with_unit(hand.damping, "N s/m")
            ),
            stiffness: domain(&seen.clone().held(hand), around, mode, None).ok().map(|domain| domain.top.kp),
        });
    }
    let device = &question.subject.device;
    let pose = TaskPose::of(&device.mechanism, &question.q).ok()?;
    Some(Explained {
        feed_forward: question.scene.walls.get(question.wall)?.feed_forward,
        stiffness: all.map(|limits| limits.kp_max),
        damping: all.map(|limits| limits.kd),
        without,
        count: count_along(device, &pose, &question.normal),
    })
}

/// What the prediction is of, and what it leaves out.
fn assumptions(question: &Question, prediction: &Prediction, seen: &Linearised) -> Vec<String> {
    let (around, subject, scene) = (&prediction.around, &prediction.subject, &question.scene);
    let joints = |which: Vec<usize>| {
        let names: Vec<String> = which.iter().map(usize::to_string).collect();
        format!("joint{} {}", if names.len() == 1 { "" } else { "s" }, listed(&names))
    };
    let (estimator, samples) = around.estimator.name_and_window();
    let over = if samples > 1 { format!(" over {}", counted(samples, "sample")) } else { String::new() };
    let filter =
        around.estimator.cutoff_hz().map_or(", no filter".into(), |hz| format!(", cut-off {}", with_unit(hz, "Hz")));
    let mut told = vec![
        format!(
            "Control at {}; torque follows the encoders by {} samples.",
            with_unit(around.rate_hz, "Hz"),
            digits(around.delay_samples)
        ),
        format!("Velocity: {estimator}{over}{filter}."),
        match &around.drive {
            Drive::Ideal => "Drive: torque at once.".into(),
            Drive::Current { bandwidth_hz } => {
                format!("Drive: a current loop that lags as {} does.", with_unit(*bandwidth_hz, "Hz"))
            }
            Drive::Voltage(_) => "Drive: by voltage, with the motors' resistance, inductance and back-EMF.".into(),
        },
    ];
    let gives: Vec<usize> =
        seen.flexible.transmissions.iter().enumerate().filter(|(_, one)| one.is_some()).map(|(at, _)| at).collect();
    let at_tip = seen
        .compliance(Mode::Off)
        .map(|compliance| 1.0 / compliance)
        .map(|at_tip| format!(", which leaves {} at the tip along this wall", with_unit(at_tip, "N/m")));
    told.push(match (subject.joints, gives.is_empty()) {
        (None, _) => "Transmissions: taken for rigid, for no file of this device is known here.".into(),
        (_, true) => "Transmissions: rigid, as in the device file.".into(),
        (_, false) => format!(
            "Transmissions: {} give{} as in the device file{}.",
            joints(gives.clone()),
            if gives.len() == 1 { "s" } else { "" },
            at_tip.unwrap_or_default()
        ),
    });
    let mut bending: Vec<usize> = seen.flexible.modes.iter().map(|(joint, _)| *joint).collect();
    bending.dedup();
    if !bending.is_empty() {
        told.push(format!("Links: structural modes at {}, as in the device file.", joints(bending)));
    }
    told.push(match seen.viscous.iter().any(|viscous| *viscous > 0.0) {
        true => "Friction: viscous, as in the device file.".into(),
        false => "Friction: none; the device file gives no viscous damping.".into(),
    });
    if let Some((posture, _)) = &seen.flexible.posture {
        let stiffness = with_unit(posture.stiffness, "N m/rad");
        told.push(format!("Posture: the last link is held by {stiffness}, as in the scene."));
    }
    if seen.gain != 1.0 {
        told.push(format!("Feed-forward: {} of equation (4)'s, as in the scene.", digits(seen.gain)));
    }
    told.push(match prediction.hand.is_there() {
        true => "Hand: as given.".into(),
        false => {
            "Hand: none, for neither device file nor scene has one. A light grip mostly quiets a wall.".to_string()
        }
    });
    let list = |values: &[f64]| values.iter().map(|value| format!("{value:.2}")).collect::<Vec<_>>().join(", ");
    told.push(format!("Pose: joints at {} rad, this wall along ({}).", list(&question.q), list(&question.normal)));
    let mut left_out = vec!["that a wall only pushes", "dry friction", "encoder steps", "the motors' limits"];
    if scene.walls.len() > 1 {
        left_out.push("the scene's other walls");
    }
    if !scene.springs.is_empty() {
        left_out.push("its springs");
    }
    if scene.field_damping > 0.0 {
        left_out.push("its damping everywhere");
    }
    told.push(format!("Left out: {}.", listed(&left_out.into_iter().map(String::from).collect::<Vec<_>>())));
    told
}

/// Answers the newest question and leaves out those that it is too late for.
#[derive(Debug)]
pub struct Oracle {
    /// The way to a thread that takes questions; `None` without threads, where each is answered when it is asked.
    questions: Option<Sender<Question>>,
    answer_to: Sender<Option<Plane>>,
    answers: Receiver<Option<Plane>>,
    busy: bool,
    /// Somebody wants to know what limits the stiffness.
    explain: bool,
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
        Self { questions: thread.is_ok().then_some(questions), answer_to, answers, busy: false, explain: false }
    }
}

impl Oracle {
    /// Returns true while a question is being answered.
    pub fn is_busy(&self) -> bool {
        self.busy
    }

    /// Somebody wants to know what limits the stiffness.
    pub fn explain(&mut self) {
        self.explain = true;
    }

    /// Returns true if that is to be asked now, with the motors on or off. Without a thread it would keep the stage from
    /// hearing of the key for some tenths of a second, so it waits until they are off.
    pub fn is_to_explain(&self, motors_on: bool) -> bool {
        self.explain && !(motors_on && self.questions.is_none())
    }

    /// Asks.
    pub fn ask(&mut self, question: Question) {
        self.explain &= !question.explain;
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
            hand: None,
            explain: false,
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
        // What takes long waits for the motors to be off where no thread takes it.
        oracle.explain();
        assert!(oracle.is_to_explain(true) && oracle.is_to_explain(false));
        oracle.questions = None;
        assert!(!oracle.is_to_explain(true) && oracle.is_to_explain(false));
    }
}
