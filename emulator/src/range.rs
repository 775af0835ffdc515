//! The paper's experiment on the emulated chip: which walls stay stable on the unmodified image, by `haptic::measure`
//! through the protocol, beside what the sampled-data theory of `haptic range` says with the delay that the board
//! reports.
//!
//! The device is the shipped coupled-five-bar without friction and with fine encoders, at a pose and along the normal
//! where its coupling is worst, no hand on it. Motors, current sensors and the board's current loops are there.

use std::fmt::Write as _;

use haptic::analysis::map;
use haptic::analysis::plant::{Drive, Linearised};
use haptic::analysis::pose::unit_normal;
use haptic::analysis::range::{Range, predict};
use haptic::analysis::sampled::{LinearEstimator, Loop};
use haptic::analysis::several::Member;
use haptic::device_file::DeviceFile;
use haptic::measure::campaign::{self, Plan};
use haptic::measure::progress::Progress;
use haptic::measure::{Law, MeasureError, MeasurementSetup, PreparedBoard};
use haptic::plot::Picture;
use haptic::plot::range::{Contents, MeasuredPoint, draw};
use haptic::sim::Hand;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::{EncoderAt, Transmission};
use haptic_bridge::model::motor::Motor;
use haptic_bridge::render::scene::FeedForward;

use crate::boards::BoardKind;
use crate::hands::carry;
use crate::rig::{Rig, device_file};

/// Where the wall is touched, rad: the pose of the figures in docs/results.md.
pub const POSE: [f64; 3] = [2.6, 1.75, 0.0];
/// Edges of an encoder in a turn: so many that their steps are no part of what is measured.
const COUNTS_PER_TURN: f64 = (1 << 20) as f64;
/// A direct drive in place of the shipped file's placeholder. A step of the board's current sensors, 7 mA, is then 0.2
/// mN m and not 4, which would keep the softly held tip moving.
const MOTOR: Motor<f64> = Motor {
    torque_constant: 0.033,
    resistance: 0.5,
    inductance: 1e-4,
    back_emf: 0.033,
    max_current: 12.0,
    verified: true,
};
/// What 12 A make, N m.
const TORQUE_LIMIT: f64 = 0.4;
/// Its half bridges cost no dead time, which acts on a small swing as friction does.
const BOARD: BoardKind = BoardKind::HBridgeF405;

/// A cable at each joint, against whose motor it is this stiff (Hz) and so much damped (share of the critical).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cable {
    /// Frequency of the motor on the cable, Hz.
    pub hz: f64,
    /// Share of critical damping.
    pub damped: f64,
}

/// The cables of docs/results/complete.md.
pub const CABLE: Cable = Cable { hz: 400.0, damped: 0.05 };
/// Where the walls with cables are measured: this share of the way to where the range ends.
const CABLE_SHARE: f64 = 0.35;
/// Of the washout, Hz.
const WASHOUT_HZ: f64 = 2.0;

/// Control rate and the cutoff of the velocity filter, Hz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the Butterworth filter of the velocity, Hz.
    pub cutoff_hz: f64,
}

/// What is measured at: the tests' rate first, then one at which the drive's lag is an eighth of a sample.
pub const RATES: [Rate; 2] = [Rate { rate_hz: 1000.0, cutoff_hz: 20.0 }, Rate { rate_hz: 5000.0, cutoff_hz: 100.0 }];
/// At what walls are measured with cables.
pub const CABLE_RATES: [Rate; 3] = [
    Rate { rate_hz: 1000.0, cutoff_hz: 100.0 },
    Rate { rate_hz: 5000.0, cutoff_hz: 200.0 },
    Rate { rate_hz: 20_000.0, cutoff_hz: 500.0 },
];
/// A current loop that lags as the board's, which makes a current within a carrier period: the default of `haptic range
/// --drive current`, Hz.
const CURRENT_BANDWIDTH: f64 = 6400.0;

/// The device on the bench, rigid or with cables.
///
/// # Panics
///
/// When the shipped file is gone.
#[must_use]
pub fn device(cable: Option<Cable>) -> DeviceFile {
    let mut file = device_file("coupled-five-bar");
    file.description.home = Some(POSE);
    for joint in &mut file.description.joints[..2] {
        joint.viscous = 0.0;
        joint.coulomb = 0.0;
        if let Some(encoder) = &mut joint.encoder {
            encoder.counts_per_turn = COUNTS_PER_TURN;
        }
        joint.motor = Some(MOTOR);
        joint.transmission = cable.map(|Cable { hz, damped }| {
            let stiffness = joint.inertia * (core::f64::consts::TAU * hz).powi(2);
            let damping = 2.0 * damped * (stiffness * joint.inertia).sqrt();
            Transmission { stiffness, damping, motor_inertia: joint.inertia, encoder_at: EncoderAt::Motor }
        });
    }
    file
}

/// The unit normal of the largest Wrr/Weff at the pose.
///
/// # Panics
///
/// When the pose is singular.
#[must_use]
pub fn normal() -> Vec<f64> {
    let any = unit_normal(&[1.0, 0.0], 2, 2).expect("a unit vector");
    let point = map::at_holding(&device(None).description, &POSE[..2], &any, Admissible::default());
    point.expect("a sound device").expect("a regular pose").worst_ratio.normal
}

/// The board with the device at its connectors, homed at the pose, its polarity checked, and a hand that holds it
/// there.
///
/// # Panics
///
/// When the board refuses anything.
#[must_use]
pub fn bench(cable: Option<Cable>) -> Rig {
    let mut rig = Rig::with_file(BOARD, device(cable), |options| {
        options.friction = false;
        options.substep = 25e-6;
        options.start = Some(POSE);
    });
    // A loose hand on it for the polarity check: what nothing brakes never comes to rest between two joints.
    rig.with_simulated(carry);
    rig.prepare("");
    let mut rules = rig.tool.rules().expect("the board answers");
    rules.limits.current = [12.0; 3];
    rig.tool.set_rules(&rules).expect("limits are raised while disarmed");
    rig
}

/// Measures on `rig`, whose device has these cables: `job` is handed a bench whose device is free, the wall's motors alone
/// holding it.
///
/// # Errors
///
/// What ends a measurement early.
pub fn on<T>(
    rig: &mut Rig,
    cable: Option<Cable>,
    rate: Rate,
    job: impl FnOnce(&mut PreparedBoard<'_>) -> Result<T, MeasureError>,
) -> Result<T, MeasureError> {
    let setup = MeasurementSetup {
        walls: vec![Member::new(normal(), 1.0)],
        rate_hz: rate.rate_hz,
        cutoff_hz: rate.cutoff_hz,
        washout_hz: WASHOUT_HZ,
        torque_limit: TORQUE_LIMIT,
        largest_pull: 1e-3,
        law: Law::default(),
    };
    let (file, shared) = (device(cable), rig.shared.clone());
    let mut bench = PreparedBoard::new(&mut rig.tool, &file, setup, &|| false)?;
    shared.board().with(|bench| {
        bench.hardware().plant.device().expect("a simulated device").set_hand(Hand::none());
    });
    let outcome = job(&mut bench)?;
    bench.finish()?;
    Ok(outcome)
}

/// What the theory says of the same loop at the dampings `kd` (N s/m), or of all of it; `delay_samples` is the board's
/// own.
///
/// # Panics
///
/// When the theory refuses the loop.
#[must_use]
pub fn predicted(cable: Option<Cable>, rate: Rate, delay_samples: f64, kd: Option<&[f64]>) -> Range {
    let around = Loop {
        rate_hz: rate.rate_hz,
        delay_samples,
        estimator: LinearEstimator::Butterworth(rate.cutoff_hz),
        drive: Drive::Current { bandwidth_hz: CURRENT_BANDWIDTH },
        damping_compensation: false,
    };
    let linear = Linearised::at(&device(cable).description, &POSE[..2], &normal()).expect("a regular pose");
    let washout = cable.map(|_| WASHOUT_HZ);
    predict(&linear, &around, kd, washout).expect("the loop can be analysed")
}

/// Dampings and repeats of the whole measurement.
pub const POINTS: usize = 12;
/// See [`POINTS`].
pub const REPEATS: usize = 5;

/// Delay in samples that the board reports at `rate`.
///
/// # Panics
///
/// When the board does not answer.
#[must_use]
pub fn delay_samples(rig: &mut Rig, rate: Rate) -> f64 {
    rig.set_scene(&format!("rate_hz = {}\n", rate.rate_hz));
    f64::from(rig.tool.details().expect("the board answers").delay_samples)
}

/// The whole range at `rate` with this feed-forward, [`POINTS`] dampings up to where it ends, [`REPEATS`] times each,
/// and the delay that the board reports. `told` hears how many boundaries are done.
///
/// # Errors
///
/// What ends a measurement early.
pub fn whole(rate: Rate, mode: FeedForward, mut told: impl FnMut(usize)) -> Result<(Progress, f64), MeasureError> {
    let mut rig = bench(None);
    let delay = delay_samples(&mut rig, rate);
    let plan = Plan { modes: vec![mode], kd: None, points: POINTS, repeats: REPEATS };
    let mut progress = Progress::new("the emulated chip");
    on(&mut rig, None, rate, |bench| {
        campaign::run(bench, &plan, &mut progress, |_, done| {
            told(done);
            Ok(())
        })
    })?;
    Ok((progress, delay))
}

/// A wall's largest stable stiffness with cables at `rate`, for one damping and each feed-forward: rows of the table in
/// docs/results/complete.md.
///
/// # Errors
///
/// What ends a measurement early.
pub fn with_cables(rate: Rate) -> Result<String, MeasureError> {
    let cable = Some(CABLE);
    let mut rig = bench(cable);
    let delay = delay_samples(&mut rig, rate);
    let range = predicted(cable, rate, delay, None);
    let kd = CABLE_SHARE * range.off.kd_max.min(range.full.kd_max);
    let theory = predicted(cable, rate, delay, Some(&[kd]));
    let modes = vec![FeedForward::Off, FeedForward::Full, FeedForward::Washout];
    let plan = Plan { modes: modes.clone(), kd: Some(vec![kd]), points: 1, repeats: 1 };
    let mut progress = Progress::new("the emulated chip, with cables");
    on(&mut rig, cable, rate, |bench| campaign::run(bench, &plan, &mut progress, |_, _| Ok(())))?;
    let mut rows = String::new();
    for mode in modes {
        let predicted = theory.of(mode).boundary.first().map_or(f64::NAN, |point| point.kp);
        let found = progress.of(mode).first().map_or(f64::NAN, |point| point.median());
        let Rate { rate_hz, cutoff_hz } = rate;
        let apart = 100.0 * (found / predicted - 1.0);
        let _ = writeln!(
            rows,
            "| {rate_hz}, {cutoff_hz} Hz | {kd:.3} | {} | {found:.0} | {predicted:.0} | {apart:+.1} % |",
            mode.name()
        );
    }
    Ok(rows)
}

/// ∫ kp dkd of medians at the middles of even cells, N² s/m².
fn area(progress: &Progress, mode: FeedForward) -> f64 {
    let cell = progress.end(mode).unwrap_or(0.0) / POINTS as f64;
    progress.of(mode).iter().map(|point| point.median() * cell).sum()
}

/// What the section of docs/results.md begins with.
#[must_use]
pub fn introduction(occasion: &str) -> String {
    format!(
        "{occasion}. `cargo xtask range`: the unmodified release image of `{}` on the emulated chip, the shipped\n\
         coupled-five-bar with direct drives of {} ohm and {} mH at q = (2.6, 1.75), along the normal of the largest Wrr/Weff,\n\
         no friction, no hand, 2^20 edges a turn; `haptic::measure` through the board's own protocol, the median of {REPEATS}\n\
         repeats. The theory is that of `haptic range --drive current` with the delay that the board reports. Apart: median less\n\
         theory, in percent of the theory's highest stiffness. A test asks in every run whether walls at 95 % of the theory are\n\
         stable and at 105 % are not.\n",
        BOARD.name(),
        MOTOR.resistance,
        MOTOR.inductance * 1e3,
    )
}

/// The part of docs/results.md for a whole measurement at `rate`, and its picture.
#[must_use]
pub fn section(rate: Rate, progress: &Progress, delay: f64) -> (String, Picture) {
    let range = predicted(None, rate, delay, None);
    let mut rows = String::new();
    let mut furthest: f64 = 0.0;
    for mode in [FeedForward::Off, FeedForward::Full] {
        let points = progress.of(mode);
        let kd: Vec<f64> = points.iter().map(|point| point.kd).collect();
        let at = predicted(None, rate, delay, Some(&kd));
        let top = range.of(mode).boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
        for (point, theory) in points.iter().zip(&at.of(mode).boundary) {
            let (low, high) = point.bounds();
            let apart = 100.0 * (point.median() - theory.kp) / top;
            furthest = furthest.max(apart.abs());
            let _ = writeln!(
                rows,
                "| {} | {:.2} | {:.1} | {low:.1} | {high:.1} | {:.1} | {apart:+.1} % |",
                mode.name(),
                point.kd,
                point.median(),
                theory.kp
            );
        }
    }
    let measured = area(progress, FeedForward::Full) / area(progress, FeedForward::Off);
    let inertias = (range.w_rr / range.w_eff).powi(2);
    let Rate { rate_hz, cutoff_hz } = rate;
    let text = format!(
        "\n### At {rate_hz} Hz, cutoff {cutoff_hz} Hz\n\n\
         Area with the feed-forward over without: **{measured:.3}** measured, {:.3} predicted, (Wrr/Weff)² = {inertias:.3}.\n\
         Furthest apart: {furthest:.1} %.\n\n\
         | feed-forward | kd (N s/m) | median kp (N/m) | lowest | highest | theory | apart |\n|---|--:|--:|--:|--:|--:|--:|\n{rows}",
        range.area_ratio,
    );
    let dots = |mode| -> Vec<MeasuredPoint> {
        let dot = |point: &haptic::measure::progress::Point| {
            let (low, high) = point.bounds();
            MeasuredPoint { kd: point.kd, kp: point.median(), low, high }
        };
        progress.of(mode).into_iter().map(dot).collect()
    };
    let picture = draw(&Contents {
        title: format!("coupled-five-bar on the emulated chip at {rate_hz} Hz, cutoff {cutoff_hz} Hz"),
        subtitle: [
            "lines: linear theory; dots: measured through the protocol".into(),
            "the release image; no friction, no hand".into(),
        ],
        range: &range,
        passivity: None,
        washout_hz: None,
        measured_off: &dots(FeedForward::Off),
        measured_full: &dots(FeedForward::Full),
    });
    (text, picture)
}
