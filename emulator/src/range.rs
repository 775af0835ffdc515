//! The paper's experiment on the emulated chip. `haptic_predict::measure` measures the range of stable walls of the
//! unmodified image through the protocol. The result is compared with the sampled-data theory of `haptic range` for the
//! delay that the board reports.
//!
//! The rigid device is the shipped coupled-five-bar without friction and with fine encoders, at the pose and normal
//! with the worst coupling, without a hand. Motors, current sensors and the board's current loops are simulated.

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::motor::{Motor, Winding};
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

/// Pose in which the wall is touched, as in the figures of docs/results.md, rad.
pub const POSE: [f64; 3] = [2.6, 1.75, 0.0];
/// Encoder counts per turn, so many that quantization does not affect the measurement.
const COUNTS_PER_TURN: f64 = (1 << 20) as f64;
/// Motor of a direct drive, instead of the placeholder in the shipped file. One step of the board's current sensors (7
/// mA) is 0.2 mN m with this motor. With the placeholder it is 4 mN m, which would keep the softly held tip moving.
const MOTOR: Motor<f64> = Motor {
    torque_constant: 0.033,
    resistance: 0.5,
    inductance: 1e-4,
    back_emf: 0.033,
    max_current: 12.0,
    winding: Winding::Brushed,
    verified: true,
};
/// Torque at 12 A, N m.
const TORQUE_LIMIT_NM: f64 = 0.4;
/// A board without dead time, because dead time acts like friction on a small swing.
pub const BOARD: BoardKind = BoardKind::HBridgeF405;

/// A device to be measured, and its wall.
#[derive(Clone, Debug)]
pub struct TestDevice {
    /// The device.
    pub file: DeviceFile,
    /// The wall's unit normal.
    pub normal: Vec<f64>,
}

/// Control rate and cutoff of the velocity filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the Butterworth filter of the velocity, Hz.
    pub cutoff_hz: f64,
}

/// Measured rates: the rate of the tests, and a rate at which the drive's lag is an eighth of a sample.
pub const RATES: [Rate; 2] = [Rate { rate_hz: 1000.0, cutoff_hz: 20.0 }, Rate { rate_hz: 5000.0, cutoff_hz: 100.0 }];
/// Bandwidth of a current loop that lags like the board's loop (which reaches its current within a carrier period), Hz.
/// It is the default of `haptic range --drive current`.
const CURRENT_BANDWIDTH_HZ: f64 = 6400.0;

/// Returns the coupled-five-bar as a rigid device, and its wall.
#[must_use]
pub fn rigid_device() -> TestDevice {
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
    // The normal has the largest Wrr/Weff at the pose.
    let any = unit_normal(&[1.0, 0.0], 2, 2).expect("a unit vector");
    let point = map::map_point_at(&file.description, &POSE[..2], &any, Admissible::default());
    let normal = point.expect("a sound device").expect("a regular pose").worst_ratio.normal;
    TestDevice { file, normal }
}

/// Returns the board with the device at the pose, homed, with checked polarity, and with a hand that holds the device.
#[must_use]
pub fn rig(test_device: &TestDevice) -> Rig {
    let mut rig = Rig::with_file(BOARD, test_device.file.clone(), |options| {
        options.substep = 25e-6;
        options.start = test_device.file.description.home;
    });
    rig.prepare("");
    // The polarity check has moved the device, so place it at the pose again.
    rig.with_simulated(|device| {
        device.place(POSE);
        hold(device);
    });
    rig.run(300 * MILLISECOND);
    let mut rules = rig.tool.rules().expect("the board replies");
    rules.limits.current = [12.0; 3];
    rig.tool.set_rules(&rules).expect("limits are raised while disarmed");
    rig
}

/// Measures on `rig`, which has the device of `test_device`. `job` receives the prepared board. No hand holds the
/// device, so only the wall's motor torques move it.
/// Returns the error that ends a measurement early.
pub fn measure_on<T>(
    rig: &mut Rig,
    test_device: &TestDevice,
    rate: Rate,
    job: impl FnOnce(&mut PreparedBoard<'_>) -> Result<T, MeasureError>,
) -> Result<T, MeasureError> {
    let setup = MeasurementSetup {
        walls: vec![Member::new(test_device.normal.clone(), 1.0)],
        rate_hz: rate.rate_hz,
        cutoff_hz: rate.cutoff_hz,
        washout_hz: 2.0,
        torque_limit: TORQUE_LIMIT_NM,
        largest_pull: 1e-3,
        law: Law::default(),
    };
    let shared = rig.shared.clone();
    let mut prepared = PreparedBoard::new(&mut rig.tool, &test_device.file, setup, &|| false)?;
    shared.board().while_stopped(|stopped| {
        stopped.hardware().plant.device().expect("a simulated device").set_hand(Hand::none());
    });
    let outcome = job(&mut prepared)?;
    prepared.finish()?;
    Ok(outcome)
}

/// Returns the boundary that theory predicts for the same loop at the dampings `kd` (N s/m), or the entire boundary
/// without `kd`. `delay_samples` is the delay that the board reports.
#[must_use]
pub fn predicted_range(test_device: &TestDevice, rate: Rate, delay_samples: f64, kd: Option<&[f64]>) -> Range {
    let control_loop = Loop {
        rate_hz: rate.rate_hz,
        delay_samples,
        estimator: LinearEstimator::Butterworth(rate.cutoff_hz),
        drive: Drive::Current { bandwidth_hz: CURRENT_BANDWIDTH_HZ },
        damping_compensation: false,
    };
    let linear =
        Linearised::at(&test_device.file.description, &POSE[..2], &test_device.normal).expect("a regular pose");
    predict(&linear, &control_loop, kd, None).expect("the loop can be analysed")
}

/// Number of dampings in a complete measurement.
pub const DAMPING_COUNT: usize = 12;
/// Pulls at each damping, as multiples of the largest pull.
pub const RELATIVE_PULLS: [f64; 5] = [1.0, -1.0, 0.7, -0.7, 0.85];

/// Returns the delay that the board reports at `rate`, in samples.
#[must_use]
pub fn delay_samples(rig: &mut Rig, rate: Rate) -> f64 {
    rig.set_scene(&format!("rate_hz = {}\n", rate.rate_hz));
    f64::from(rig.tool.details().expect("the board replies").delay_samples)
}

/// Measures the complete range at `rate` with the feed-forward `mode`: [`DAMPING_COUNT`] dampings up to the end of the
/// range, with all [`RELATIVE_PULLS`]. Returns the result and the delay that the board reports. Calls `report` with the
/// number of finished boundaries. Returns the error that ends a measurement early.
pub fn measure_range(
    rate: Rate,
    mode: FeedForward,
    mut report: impl FnMut(usize),
) -> Result<(Progress, f64), MeasureError> {
    let test_device = rigid_device();
    let mut rig = rig(&test_device);
    let delay = delay_samples(&mut rig, rate);
    let plan = Plan { modes: vec![mode], kd: None, points: DAMPING_COUNT, repeats: 1, pulls: RELATIVE_PULLS.to_vec() };
    let mut progress = Progress::new("the emulated chip");
    measure_on(&mut rig, &test_device, rate, |prepared| {
        campaign::run(prepared, &plan, &mut progress, |_, done| {
            report(done);
            Ok(())
        })
    })?;
    Ok((progress, delay))
}

/// Returns ∫ kp dkd of the medians at the centres of equal cells, N² s/m².
fn area(progress: &Progress, mode: FeedForward) -> f64 {
    let cell = progress.end(mode).unwrap_or(0.0) / DAMPING_COUNT as f64;
    progress.of(mode).iter().map(|point| point.median() * cell).sum()
}

/// Column names of docs/results/range-chip.csv.
pub const COLUMN_NAMES: [&str; 9] = [
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

/// Returns the rows of a complete measurement at `rate`, the summary for docs/results.md, and the picture.
#[must_use]
pub fn section(rate: Rate, progress: &Progress, delay: f64) -> (String, String, Picture) {
    let test_device = rigid_device();
    let Rate { rate_hz, cutoff_hz } = rate;
    let range = predicted_range(&test_device, rate, delay, None);
    let mut rows = String::new();
    let mut furthest: f64 = 0.0;
    for mode in [FeedForward::Off, FeedForward::Full] {
        let points = progress.of(mode);
        let kd: Vec<f64> = points.iter().map(|point| point.kd).collect();
        let at = predicted_range(&test_device, rate, delay, Some(&kd));
        let top = range.of(mode).boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
        for (point, theory) in points.iter().zip(&at.of(mode).boundary) {
            let (low, high) = point.bounds();
            let difference = 100.0 * (point.median() - theory.kp) / top;
            furthest = furthest.max(difference.abs());
            rows += &csv_line([
                &rate_hz.to_string(),
                &cutoff_hz.to_string(),
                mode.name(),
                &format!("{:.2}", point.kd),
                &format!("{:.1}", point.median()),
                &format!("{low:.1}"),
                &format!("{high:.1}"),
                &format!("{:.1}", theory.kp),
                &format!("{difference:+.1}"),
            ]);
        }
    }
    let measured = area(progress, FeedForward::Full) / area(progress, FeedForward::Off);
    let inertias = (range.w_rr / range.w_eff).powi(2);
    let summary = format!(
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
    (rows, summary, picture)
}
