//! The predicted boundary of a wall's gains at the present pose. A separate thread computes it; without threads, as in
//! a browser, it is computed at once on request, in some milliseconds.

use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_host::words::{counted, digits, joint_units, listed, with_unit};
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

/// A request to the [`Predictor`].
#[derive(Clone, Debug)]
pub struct PredictionRequest {
    /// The board's device, with the transmissions of the device file.
    pub subject: Subject,
    /// The scene.
    pub scene: Scene<f64>,
    /// Index of the wall, from 0.
    pub wall: usize,
    /// Joint angles, rad.
    pub q: Vec<f64>,
    /// Normal of the wall at this pose.
    pub normal: Vec<f64>,
    /// The board's delay and drives.
    pub path: TorquePath,
    /// The hand that a page moves, if the device is simulated; the boundary is computed without it.
    pub hand: Option<Hand>,
    /// True to also compute the limiting effects, which takes several times as long.
    pub explain: bool,
}

/// The boundary for each kind of feed-forward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plane {
    /// Index of the wall.
    pub wall: usize,
    /// Joint angles of the prediction, rad.
    #[serde(default)]
    pub q: Vec<f64>,
    /// Weff: inertia that the wall meets without feed-forward, kg.
    pub w_eff: f64,
    /// Wrr: inertia that the wall meets with feed-forward, kg.
    pub w_rr: f64,
    /// kp_max (N/m) over damping (N s/m), without feed-forward.
    pub off: Vec<BoundaryPoint>,
    /// kp_max over damping, with feed-forward.
    pub full: Vec<BoundaryPoint>,
    /// kp_max over damping, with the feed-forward behind the wall's washout.
    pub washout: Vec<BoundaryPoint>,
    /// Assumptions of the prediction, and effects that it leaves out: one sentence each.
    #[serde(default)]
    pub assumes: Vec<String>,
    /// Limiting effects, if they were requested.
    pub limits: Option<LimitingEffects>,
}

/// The limiting effects of a wall's stiffness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LimitingEffects {
    /// Feed-forward of the wall.
    pub feed_forward: FeedForward,
    /// Largest stable stiffness over all dampings, N/m; `None` if it is unlimited.
    pub stiffness: Option<f64>,
    /// Damping at that stiffness, N s/m.
    pub damping: Option<f64>,
    /// Limits with each effect removed in turn.
    pub without: Vec<LimitWithout>,
    /// Motion of the tip along the normal for one encoder count, m.
    pub count: f64,
}

/// The limit without one effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LimitWithout {
    /// The effect.
    pub effect: String,
    /// The condition that replaces the effect.
    pub instead: String,
    /// Largest stable stiffness without the effect, N/m; `None` if it is unlimited.
    pub stiffness: Option<f64>,
}

impl Plane {
    /// Returns the boundary for one kind of feed-forward.
    pub fn boundary(&self, mode: FeedForward) -> &[BoundaryPoint] {
        match mode {
            FeedForward::Off => &self.off,
            FeedForward::Full => &self.full,
            FeedForward::Washout => &self.washout,
        }
    }

    /// Returns the largest stiffness (N/m) that is predicted to be stable with this damping (N s/m).
    pub fn max_stiffness(&self, mode: FeedForward, damping: f64) -> f64 {
        let boundary = self.boundary(mode);
        let next = boundary.partition_point(|point| point.kd < damping);
        match (next.checked_sub(1).and_then(|i| boundary.get(i)), boundary.get(next)) {
            (Some(low), Some(high)) => low.kp + (high.kp - low.kp) * (damping - low.kd) / (high.kd - low.kd),
            (None, Some(first)) if first.kd == damping => first.kp,
            _ => 0.0,
        }
    }
}

impl PredictionRequest {
    /// Returns the prediction, and the device model along the wall's normal.
    fn prediction(&self) -> Option<(Prediction, Linearised)> {
        let wall = self.scene.walls.get(self.wall)?;
        let prediction = Prediction::in_scene(&self.subject, &self.scene, Some(wall), &self.path)?;
        let model = prediction.linearise(&self.q, &self.normal).ok()?;
        Some((prediction, model))
    }

    fn mode(&self) -> Option<Mode> {
        let wall = self.scene.walls.get(self.wall)?;
        Some(Mode::of(wall.feed_forward, wall.washout_hz))
    }
}

/// Computes the boundary; `None` if the pose is singular or the loop cannot be analysed.
pub fn predict_plane(request: &PredictionRequest) -> Option<Plane> {
    let PredictionRequest { scene, wall: index, q, normal, .. } = request;
    let wall = scene.walls.get(*index)?;
    let (prediction, model) = request.prediction()?;
    let range = prediction.range(q, &[Member::new(normal.clone(), 1.0)], None, Some(wall.washout_hz)).ok()?;
    let washout = range.washout.map_or_else(Vec::new, |domain| domain.boundary);
    let limits = if request.explain { limiting_effects(request, &prediction, &model) } else { None };
    Some(Plane {
        wall: *index,
        q: q.clone(),
        w_eff: range.w_eff,
        w_rr: range.w_rr,
        off: range.off.boundary,
        full: range.full.boundary,
        washout,
        assumes: assumptions(request, &prediction, &model),
        limits,
    })
}

/// Returns the oscillation of the wall with its present gains and the hand in contact: outside the boundary, its buzz.
pub fn predict_buzz(request: &PredictionRequest) -> Option<Oscillation> {
    let wall = request.scene.walls.get(request.wall)?;
    let (mut prediction, _) = request.prediction()?;
    prediction.hand = request.hand.unwrap_or(prediction.hand);
    let members = [Member::new(request.normal.clone(), 1.0)];
    prediction.buzz(&request.q, &members, request.mode()?, wall.stiffness, wall.damping).ok()?
}

fn limiting_effects(
    request: &PredictionRequest,
    prediction: &Prediction,
    model: &Linearised,
) -> Option<LimitingEffects> {
    let (mode, control) = (request.mode()?, &prediction.around);
    let (all, without) = limits_without(model, control, mode).ok()?;
    let mut without: Vec<LimitWithout> = without
        .into_iter()
        .map(|(effect, instead, limits)| LimitWithout {
            effect: effect.into(),
            instead: instead.into(),
            stiffness: limits.map(|limits| limits.kp_max),
        })
        .collect();
    if let Some(hand) = request.hand {
        without.push(LimitWithout {
            effect: "empty hand".into(),
            instead: format!(
                "held by {} and {}, as this page's hand does",
                with_unit(hand.stiffness, "N/m"),
                with_unit(hand.damping, "N s/m")
            ),
            stiffness: domain(&model.clone().with_hand(hand), control, mode, None).ok().map(|domain| domain.top.kp),
        });
    }
    let device = &request.subject.device;
    let pose = TaskPose::of(&device.mechanism, &request.q).ok()?;
    Some(LimitingEffects {
        feed_forward: request.scene.walls.get(request.wall)?.feed_forward,
        stiffness: all.map(|limits| limits.kp_max),
        damping: all.map(|limits| limits.kd),
        without,
        count: count_along(device, &pose, &request.normal),
    })
}

/// Describes the assumptions of the prediction, and the effects that it leaves out.
fn assumptions(request: &PredictionRequest, prediction: &Prediction, model: &Linearised) -> Vec<String> {
    let (control, subject, scene) = (&prediction.around, &prediction.subject, &request.scene);
    let joints = |which: Vec<usize>| {
        let names: Vec<String> = which.iter().map(usize::to_string).collect();
        format!("joint{} {}", if names.len() == 1 { "" } else { "s" }, listed(&names))
    };
    let (estimator, samples) = control.estimator.name_and_window();
    let over = if samples > 1 { format!(" over {}", counted(samples, "sample")) } else { String::new() };
    let filter =
        control.estimator.cutoff_hz().map_or(", no filter".into(), |hz| format!(", cut-off {}", with_unit(hz, "Hz")));
    let mut sentences = vec![
        format!(
            "Control at {}; torque follows the encoders by {} samples.",
            with_unit(control.rate_hz, "Hz"),
            digits(control.delay_samples)
        ),
        format!("Velocity: {estimator}{over}{filter}."),
        match &control.drive {
            Drive::Ideal => "Drive: ideal, torque acts at once.".into(),
            Drive::Current { bandwidth_hz } => {
                format!("Drive: a current loop that lags as {} does.", with_unit(*bandwidth_hz, "Hz"))
            }
            Drive::Voltage(_) => "Drive: by voltage, with the motors' resistance, inductance and back-EMF.".into(),
        },
    ];
    let compliant: Vec<usize> = model
        .flexible
        .transmissions
        .iter()
        .enumerate()
        .filter(|(_, transmission)| transmission.is_some())
        .map(|(at, _)| at)
        .collect();
    let at_tip = model
        .compliance(Mode::Off)
        .map(|compliance| 1.0 / compliance)
        .map(|at_tip| format!(", which leaves {} at the tip along this wall", with_unit(at_tip, "N/m")));
    sentences.push(match (subject.joints, compliant.is_empty()) {
        (None, _) => "Transmissions: assumed to be rigid, because no file of this device is known here.".into(),
        (_, true) => "Transmissions: rigid, as in the device file.".into(),
        (_, false) => format!(
            "Transmissions: {} {} compliant as in the device file{}.",
            joints(compliant.clone()),
            if compliant.len() == 1 { "is" } else { "are" },
            at_tip.unwrap_or_default()
        ),
    });
    let mut bending: Vec<usize> = model.flexible.modes.iter().map(|(joint, _)| *joint).collect();
    bending.dedup();
    if !bending.is_empty() {
        sentences.push(format!("Links: structural modes at {}, as in the device file.", joints(bending)));
    }
    sentences.push(match model.viscous.iter().any(|viscous| *viscous > 0.0) {
        true => "Friction: viscous, as in the device file.".into(),
        false => "Friction: none; the device file gives no viscous damping.".into(),
    });
    if let Some((posture, _)) = &model.flexible.posture {
        let stiffness = with_unit(posture.stiffness, "N m/rad");
        sentences.push(format!("Posture: the last link is held by {stiffness}, as in the scene."));
    }
    if model.gain != 1.0 {
        sentences.push(format!("Feed-forward: {} times equation (4), as in the scene.", digits(model.gain)));
    }
    sentences.push(match prediction.hand.is_there() {
        true => "Hand: as in the device file or the scene.".into(),
        false => {
            "Hand: none, because neither device file nor scene has one. A light grip mostly quiets a wall.".to_string()
        }
    });
    let list = |values: &[f64]| values.iter().map(|value| format!("{value:.2}")).collect::<Vec<_>>().join(", ");
    let unit = joint_units(&subject.device.mechanism.units(), |joint| joint.travel);
    sentences.push(format!(
        "Pose: joints at {} {unit}, this wall along ({}).",
        list(&request.q),
        list(&request.normal)
    ));
    let mut left_out = vec!["one-sided contact", "dry friction", "encoder steps", "the motors' limits"];
    if scene.walls.len() > 1 {
        left_out.push("the scene's other walls");
    }
    if !scene.springs.is_empty() {
        left_out.push("its springs");
    }
    if scene.field_damping > 0.0 {
        left_out.push("its damping everywhere");
    }
    sentences.push(format!("Left out: {}.", listed(&left_out.into_iter().map(String::from).collect::<Vec<_>>())));
    sentences
}

/// Computes predictions; skips all waiting requests except the newest.
#[derive(Debug)]
pub struct Predictor {
    /// Channel to the computing thread; `None` without threads, where each request is computed at once.
    requests: Option<Sender<PredictionRequest>>,
    result_sender: Sender<Option<Plane>>,
    results: Receiver<Option<Plane>>,
    is_busy: bool,
    /// True if a page requested the limiting effects.
    explain: bool,
}

impl Default for Predictor {
    fn default() -> Self {
        let (requests, received) = channel::<PredictionRequest>();
        let (result_sender, results) = channel();
        let sender = result_sender.clone();
        let thread = thread::Builder::new().spawn(move || {
            while let Ok(first) = received.recv() {
                let newest = received.try_iter().last().unwrap_or(first);
                if sender.send(predict_plane(&newest)).is_err() {
                    return;
                }
            }
        });
        Self { requests: thread.is_ok().then_some(requests), result_sender, results, is_busy: false, explain: false }
    }
}

impl Predictor {
    /// Returns true while a request is being computed.
    pub fn is_busy(&self) -> bool {
        self.is_busy
    }

    /// Requests the limiting effects with the next prediction.
    pub fn explain(&mut self) {
        self.explain = true;
    }

    /// Returns true if the limiting effects should be requested now. Without a thread their computation would delay
    /// messages about the key by some tenths of a second, so it waits until the motors are off.
    pub fn should_explain(&self, motors_on: bool) -> bool {
        self.explain && !(motors_on && self.requests.is_none())
    }

    /// Sends a request.
    pub fn request(&mut self, request: PredictionRequest) {
        self.explain &= !request.explain;
        self.is_busy = match &self.requests {
            Some(requests) => requests.send(request).is_ok(),
            None => self.result_sender.send(predict_plane(&request)).is_ok(),
        };
    }

    /// Returns the newest result if a request was completed.
    pub fn take_result(&mut self) -> Option<Option<Plane>> {
        let result = self.results.try_iter().last();
        self.is_busy &= result.is_none();
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_threads_limits_are_explained_with_the_motors_off() {
        let mut predictor = Predictor::default();
        predictor.explain();
        assert!(predictor.should_explain(true) && predictor.should_explain(false));
        predictor.requests = None;
        assert!(!predictor.should_explain(true) && predictor.should_explain(false));
    }
}
