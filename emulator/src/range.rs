//! The paper's experiment on the emulated chip: which walls stay stable on the unmodified image, by
//! `haptic_predict::measure` through the protocol, beside what the sampled-data theory of `haptic range` says with the
//! delay that the board reports.
//!
//! The rigid device is the shipped coupled-five-bar without friction and with fine encoders, at a pose and along the
//! normal where its coupling is worst, no hand on it. Other shipped devices stand at their homes with a cable at every
//! joint. Motors, current sensors and the board's current loops are there.

use std::f64::consts::TAU;

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::{EncoderAt, Transmission};
use haptic_bridge::model::motor::Motor;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::device_file::DeviceFile;
use haptic_host::output::csv_line;
use haptic_predict::measure::campaign::{self, Plan};
use haptic_predict::measure::progress::Progress;
use haptic_predict::measure::{Law, MeasureError, MeasurementSetup, PreparedBoard};
use haptic_show::plot::Picture;
use haptic_show::plot::paper::Paper;
use haptic_show::plot::range::{Contents, MeasuredPoint, draw};
use haptic_sim::Hand;
use haptic_stability::analysis::map;
use haptic_stability::analysis::plant::{Drive, Linearised};
use haptic_stability::analysis::pose::unit_normal;
use haptic_stability::analysis::range::{Range, predict};
use haptic_stability::analysis::sampled::{LinearEstimator, Loop};
use haptic_stability::analysis::several::Member;

use crate::boards::BoardKind;
use crate::hands::hold;
use crate::rig::{Rig, device_file};
use crate::run::MILLISECOND;

/// The pose in which the wall is touched, rad: that of the figures in docs/results.md.
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
/// The torque of 12 A, N m.
const TORQUE_LIMIT: f64 = 0.4;
/// The torque of 10 A, N m, a current that the board lets flow for ever. Held too quickly, a tip on cables buzzes until
/// it is held more softly; with more torque its motors would spend their thermal budget before, which is not what is
/// measured.
const LASTING_TORQUE: f64 = 0.33;
/// Most current of motors on the odrive-v3, A. Its shunts show steps of 10 mA and zeros as much off, which on motors of
/// 2 or 3 A push a device without friction away.
const SHUNT_CURRENT: f64 = 10.0;
/// Its half bridges cost no dead time, which acts on a small swing as friction does.
const BOARD: BoardKind = BoardKind::HBridgeF405;

/// Frequency of each joint's cable against its motor, Hz, and its share of critical damping: docs/results/complete.md.
const CABLE: (f64, f64) = (400.0, 0.05);
/// A turret's own body is on the link's side: the motor has this share of its inertia.
const TURRET_MOTOR: f64 = 0.3;
/// Of the spatial devices with cables: their longer arms make more of a step, and slower swings, whose edges come in
/// time. The emulated encoders show one edge every 250 ns.
const SPATIAL_COUNTS_PER_TURN: f64 = (1 << 22) as f64;
/// The damping at which the walls with cables are measured, as a share of that at which the range ends.
const CABLE_SHARE: f64 = 0.35;
/// Of the washout, Hz.
const WASHOUT_HZ: f64 = 2.0;

/// A device on the bench, and the wall before it.
#[derive(Clone, Debug)]
pub struct Bench {
    /// The board that drives it.
    pub board: BoardKind,
    /// The device.
    pub file: DeviceFile,
    /// The wall's unit normal.
    pub normal: Vec<f64>,
    /// The most torque that the measurement asks for, N m.
    torque_limit: f64,
}

impl Bench {
    /// Returns the pose in which the wall is touched, rad.
    fn pose(&self) -> [f64; 3] {
        self.file.description.home.expect("a device with a home")
    }

    /// Returns true if cables give at its joints.
    fn gives(&self) -> bool {
        self.file.description.joints.iter().any(|joint| joint.transmission.is_some())
    }
}

/// The boards and shipped devices that are measured with cables.
pub const CABLED: [(&str, BoardKind); 5] = [
    ("coupled-five-bar", BOARD),
    ("capstan-pantograph", BOARD),
    ("capstan-pantograph", BoardKind::OdriveV3),
    ("phantom-premium-1.5", BOARD),
    ("woodenhaptics", BOARD),
];

/// Control rate and the cutoff of the velocity filter, Hz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the Butterworth filter of the velocity, Hz.
    pub cutoff_hz: f64,
}

/// The rates that are measured: the tests' rate first, then one at which the drive's lag is an eighth of a sample.
pub const RATES: [Rate; 2] = [Rate { rate_hz: 1000.0, cutoff_hz: 20.0 }, Rate { rate_hz: 5000.0, cutoff_hz: 100.0 }];
/// The rates at which walls are measured with cables.
pub const CABLE_RATES: [Rate; 3] = [
    Rate { rate_hz: 1000.0, cutoff_hz: 100.0 },
    Rate { rate_hz: 5000.0, cutoff_hz: 200.0 },
    Rate { rate_hz: 20_000.0, cutoff_hz: 500.0 },
];
/// A current loop that lags as the board's, which makes a current within a carrier period: the default of `haptic range
/// --drive current`, Hz.
const CURRENT_BANDWIDTH: f64 = 6400.0;

/// The coupled-five-bar, rigid.
///
/// # Panics
///
/// When the shipped file is gone.
#[must_use]
pub fn rigid() -> Bench {
    let mut file = device_file("coupled-five-bar");
    file.description.home = Some(POSE);
    for joint in &mut file.description.joints[..2] {
        joint.viscous = 0.0;
        joint.coulomb = 0.0;
        if let Some(encoder) = &mut joint.encoder {
            encoder.counts_per_turn = COUNTS_PER_TURN;
        }
        joint.motor = Some(MOTOR);
    }
    // The unit normal of the largest Wrr/Weff at the pose.
    let any = unit_normal(&[1.0, 0.0], 2, 2).expect("a unit vector");
    let point = map::at_holding(&file.description, &POSE[..2], &any, Admissible::default());
    let normal = point.expect("a sound device").expect("a regular pose").worst_ratio.normal;
    Bench { board: BOARD, file, normal, torque_limit: TORQUE_LIMIT }
}

/// A motor that makes the same torque at the same voltage of [`SHUNT_CURRENT`].
fn larger(motor: &Motor<f64>) -> Motor<f64> {
    let share = motor.max_current / SHUNT_CURRENT;
    Motor {
        torque_constant: share * motor.torque_constant,
        back_emf: share * motor.back_emf,
        resistance: share * motor.resistance,
        inductance: share * motor.inductance,
        max_current: SHUNT_CURRENT,
        ..*motor
    }
}

/// A device of [`CABLED`] with a cable at every joint and without dry friction, as in docs/results/complete.md; its
/// motors have a back-EMF or next to none.
///
/// # Panics
///
/// When the shipped file is gone.
#[must_use]
pub fn cabled((name, board): (&str, BoardKind), back_emf: bool) -> Bench {
    let mut bench = if name == "coupled-five-bar" {
        Bench { torque_limit: LASTING_TORQUE, ..rigid() }
    } else {
        let mut file = device_file(name);
        let normal = [0.6, 0.8, 0.0][..file.spec().task].to_vec();
        // On either board the same motors.
        let planar = normal.len() == 2;
        for joint in &mut file.description.joints {
            joint.coulomb = 0.0;
            if let Some(motor) = joint.motor.as_mut().filter(|_| planar) {
                *motor = larger(motor);
            }
            if let Some(encoder) = &mut joint.encoder {
                encoder.counts_per_turn = if planar { COUNTS_PER_TURN } else { SPATIAL_COUNTS_PER_TURN };
            }
        }
        Bench { board, file, normal, torque_limit: 1.0 }
    };
    let (hz, damped) = CABLE;
    let joints = bench.file.spec().joints;
    for (index, joint) in bench.file.description.joints[..joints].iter_mut().enumerate() {
        let motor_inertia = if joints == 3 && index == 0 { TURRET_MOTOR * joint.inertia } else { joint.inertia };
        let stiffness = motor_inertia * (TAU * hz).powi(2);
        let damping = 2.0 * damped * (stiffness * motor_inertia).sqrt();
        joint.transmission = Some(Transmission { stiffness, damping, motor_inertia, encoder_at: EncoderAt::Motor });
        if let Some(motor) = joint.motor.as_mut().filter(|_| !back_emf) {
            motor.back_emf = 1e-6;
        }
    }
    bench
}

/// The board with the device at its connectors, homed at the pose, its polarity checked, and a hand that holds it
/// there.
///
/// # Panics
///
/// When the board refuses anything.
#[must_use]
pub fn rig(bench: &Bench) -> Rig {
    let mut rig = Rig::with_file(bench.board, bench.file.clone(), |options| {
        options.substep = if bench.gives() { 5e-6 } else { 25e-6 };
        options.start = bench.file.description.home;
    });
    rig.prepare("");
    // Back to where the polarity check began.
    let pose = bench.pose();
    rig.with_simulated(move |device| {
        device.place(pose);
        hold(device);
    });
    rig.run(300 * MILLISECOND);
    let mut rules = rig.tool.rules().expect("the board answers");
    rules.limits.current = [12.0; 3];
    rig.tool.set_rules(&rules).expect("limits are raised while disarmed");
    rig
}

/// Measures on `rig`, which has the device of `bench`: `job` is handed a bench whose device is free, the wall's motors
/// alone holding it.
///
/// # Errors
///
/// The error that ends a measurement early.
pub fn on<T>(
    rig: &mut Rig,
    bench: &Bench,
    rate: Rate,
    job: impl FnOnce(&mut PreparedBoard<'_>) -> Result<T, MeasureError>,
) -> Result<T, MeasureError> {
    let setup = MeasurementSetup {
        walls: vec![Member::new(bench.normal.clone(), 1.0)],
        rate_hz: rate.rate_hz,
        cutoff_hz: rate.cutoff_hz,
        washout_hz: WASHOUT_HZ,
        torque_limit: bench.torque_limit,
        largest_pull: 1e-3,
        law: Law::default(),
    };
    let shared = rig.shared.clone();
    let mut prepared = PreparedBoard::new(&mut rig.tool, &bench.file, setup, &|| false)?;
    shared.board().with(|stopped| {
        stopped.hardware().plant.device().expect("a simulated device").set_hand(Hand::none());
    });
    let outcome = job(&mut prepared)?;
    prepared.finish()?;
    Ok(outcome)
}

/// Returns the theory's boundary of the same loop at the dampings `kd` (N s/m), or the whole of it; `delay_samples` is
/// the board's own.
///
/// # Panics
///
/// When the theory refuses the loop.
#[must_use]
pub fn predicted(bench: &Bench, rate: Rate, delay_samples: f64, kd: Option<&[f64]>) -> Range {
    let around = Loop {
        rate_hz: rate.rate_hz,
        delay_samples,
        estimator: LinearEstimator::Butterworth(rate.cutoff_hz),
        drive: Drive::Current { bandwidth_hz: CURRENT_BANDWIDTH },
        damping_compensation: false,
    };
    let linear = Linearised::at(&bench.file.description, &bench.pose()[..bench.file.spec().joints], &bench.normal)
        .expect("a regular pose");
    let washout = bench.gives().then_some(WASHOUT_HZ);
    predict(&linear, &around, kd, washout).expect("the loop can be analysed")
}

/// Dampings of the whole measurement, and the pulls at each.
pub const POINTS: usize = 12;
/// See [`POINTS`].
pub const PULLS: [f64; 5] = [1.0, -1.0, 0.7, -0.7, 0.85];

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

/// The whole range at `rate` with this feed-forward, [`POINTS`] dampings up to where it ends, each pull of [`PULLS`],
/// and the delay that the board reports. `told` hears how many boundaries are done.
///
/// # Errors
///
/// The error that ends a measurement early.
pub fn whole(rate: Rate, mode: FeedForward, mut told: impl FnMut(usize)) -> Result<(Progress, f64), MeasureError> {
    let bench = rigid();
    let mut rig = rig(&bench);
    let delay = delay_samples(&mut rig, rate);
    let plan = Plan { modes: vec![mode], kd: None, points: POINTS, repeats: 1, pulls: PULLS.to_vec() };
    let mut progress = Progress::new("the emulated chip");
    on(&mut rig, &bench, rate, |prepared| {
        campaign::run(prepared, &plan, &mut progress, |_, done| {
            told(done);
            Ok(())
        })
    })?;
    Ok((progress, delay))
}

/// Shares of the predicted stiffness at which a wall must be stable before the boundary is looked for beside the
/// prediction.
const BELOW: [f64; 2] = [0.4, 0.7];

/// The head of docs/results/complete-chip.csv, which [`with_cables`] fills.
pub const CABLE_HEAD: [&str; 11] = [
    "device",
    "board",
    "rate (Hz)",
    "cutoff (Hz)",
    "drive",
    "delay (samples)",
    "kd (N s/m)",
    "feed-forward",
    "measured (N/m)",
    "predicted (N/m)",
    "off by (%)",
];

/// The largest stable stiffness of walls before a device of [`CABLED`] at `rate`, for one damping and each
/// feed-forward. `told` hears every row of the table.
///
/// # Errors
///
/// The error that ends a measurement early.
pub fn with_cables(
    device: (&str, BoardKind),
    rate: Rate,
    back_emf: bool,
    mut told: impl FnMut(&str),
) -> Result<(), MeasureError> {
    let bench = cabled(device, back_emf);
    let mut rig = rig(&bench);
    let delay = delay_samples(&mut rig, rate);
    let range = predicted(&bench, rate, delay, None);
    // In three digits, as the tables have it.
    let kd = format!("{:.2e}", CABLE_SHARE * range.off.kd_max.min(range.full.kd_max));
    let kd: f64 = kd.parse().expect("a number");
    on(&mut rig, &bench, rate, |prepared| {
        for mode in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
            let expected = predicted(&bench, rate, delay, Some(&[kd])).of(mode).boundary[0].kp;
            // A search from far below takes three times as long.
            let mut guess = Some(expected);
            for share in BELOW {
                if prepared.oscillates(mode, share * expected, kd, 1.0)? {
                    guess = None;
                }
            }
            let found = prepared.boundary(mode, kd, 1.0, guess)?.gain;
            // The walls that hold the tip make the step longer, and its duties may be late for it.
            let delay = f64::from(prepared.board().details()?.delay_samples);
            let expected = predicted(&bench, rate, delay, Some(&[kd])).of(mode).boundary[0].kp;
            let (name, board) = device;
            let Rate { rate_hz, cutoff_hz } = rate;
            let apart = 100.0 * (found / expected - 1.0);
            told(&csv_line([
                name,
                board.name(),
                &rate_hz.to_string(),
                &cutoff_hz.to_string(),
                if back_emf { "" } else { "no back-EMF" },
                &format!("{delay:.3}"),
                &kd.to_string(),
                mode.name(),
                &format!("{found:.0}"),
                &format!("{expected:.0}"),
                &format!("{apart:+.1}"),
            ]));
        }
        Ok(())
    })
}

/// ∫ kp dkd of medians at the middles of even cells, N² s/m².
fn area(progress: &Progress, mode: FeedForward) -> f64 {
    let cell = progress.end(mode).unwrap_or(0.0) / POINTS as f64;
    progress.of(mode).iter().map(|point| point.median() * cell).sum()
}

/// The head of docs/results/range-chip.csv, which [`section`] fills.
pub const HEAD: [&str; 9] = [
    "rate (Hz)",
    "cutoff (Hz)",
    "feed-forward",
    "kd (N s/m)",
    "median kp (N/m)",
    "lowest",
    "highest",
    "theory",
    "apart (%)",
];

/// The rows for a whole measurement at `rate`, what docs/results.md says of them, and its picture.
#[must_use]
pub fn section(rate: Rate, progress: &Progress, delay: f64) -> (String, String, Picture) {
    let bench = rigid();
    let Rate { rate_hz, cutoff_hz } = rate;
    let range = predicted(&bench, rate, delay, None);
    let mut rows = String::new();
    let mut furthest: f64 = 0.0;
    for mode in [FeedForward::Off, FeedForward::Full] {
        let points = progress.of(mode);
        let kd: Vec<f64> = points.iter().map(|point| point.kd).collect();
        let at = predicted(&bench, rate, delay, Some(&kd));
        let top = range.of(mode).boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
        for (point, theory) in points.iter().zip(&at.of(mode).boundary) {
            let (low, high) = point.bounds();
            let apart = 100.0 * (point.median() - theory.kp) / top;
            furthest = furthest.max(apart.abs());
            rows += &csv_line([
                &rate_hz.to_string(),
                &cutoff_hz.to_string(),
                mode.name(),
                &format!("{:.2}", point.kd),
                &format!("{:.1}", point.median()),
                &format!("{low:.1}"),
                &format!("{high:.1}"),
                &format!("{:.1}", theory.kp),
                &format!("{apart:+.1}"),
            ]);
        }
    }
    let measured = area(progress, FeedForward::Full) / area(progress, FeedForward::Off);
    let inertias = (range.w_rr / range.w_eff).powi(2);
    let told = format!(
        "{rate_hz} Hz: area with the feed-forward over without {measured:.3}, {:.3} predicted, (Wrr/Weff)² = \
         {inertias:.3}; furthest apart {furthest:.1} %",
        range.area_ratio,
    );
    let dots = |mode| -> Vec<MeasuredPoint> {
        let dot = |point: &haptic_predict::measure::progress::Point| {
            let (low, high) = point.bounds();
            MeasuredPoint { kd: point.kd, kp: point.median(), low, high, beside: 0.0 }
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
        measured: "measured: median, all pulls".into(),
        measured_off: &dots(FeedForward::Off),
        measured_full: &dots(FeedForward::Full),
        note: None,
        paper: Paper::default(),
    });
    (rows, told, picture)
}
