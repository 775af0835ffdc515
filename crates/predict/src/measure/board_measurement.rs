//! A complete measurement of a board, with progress in a file and the board's settings restored afterwards.

use super::campaign::{self, BOTH_SIDES, Plan};
use super::earlier_settings::EarlierSettings;
use super::progress::{Progress, ProgressError};
use super::simulated::{Friction, World};
use super::{MeasureError, MeasurementSetup, PreparedBoard, rules_for};
use crate::boards::torque_path;
use haptic_bridge::board::protocol::{Details, Info};
use haptic_bridge::model::device::Device;
use haptic_host::device_file::DeviceFile;
use haptic_host::link::{Board, BoardError, LinkError};
use haptic_host::words::joint_units;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop};
use std::path::Path;

/// Largest difference of a joint angle at which two poses count as equal, rad (of a slide times its lever).
const SAME_POSE_RAD: f64 = 0.02;

/// A measurement of a board with its device file, its results so far and the file that keeps them.
pub struct BoardMeasurement<'a> {
    /// The board, on which the device is loaded.
    pub board: &'a mut Board,
    /// The device file.
    pub file: &'a DeviceFile,
    /// The board's settings, which are restored afterwards.
    pub before: EarlierSettings,
    /// The results so far.
    pub progress: &'a mut Progress,
    /// The file that keeps the results.
    pub path: Option<&'a Path>,
    /// True if the file also keeps the board's settings, for the case that this measurement is killed.
    pub keeps_settings: bool,
}

impl BoardMeasurement<'_> {
    /// Measures the repeats of `plan` that `progress` lacks. Calls `begun` before the first repeat, and `done` with the
    /// number of finished repeats after each. Ends if `stop`, which is polled often, returns true.
    pub fn measure(
        &mut self,
        setup: MeasurementSetup,
        plan: &Plan,
        stop: &dyn Fn() -> bool,
        begun: impl FnOnce(&mut PreparedBoard<'_>, &[f64]) -> Result<(), MeasureError>,
        mut done: impl FnMut(usize),
    ) -> Result<(), MeasureError> {
        if self.keeps_settings {
            let rules = rules_for(self.before.rules(), setup.torque_limit);
            self.progress.before = self.before.restore_point(&self.board.info().serial, &rules);
            save(self.progress, self.path)?;
        }
        let mut prepared = PreparedBoard::new(self.board, self.file, setup, stop)?;
        // Rounds as in the printed output, so that the theory uses the printed pose.
        let q: Vec<f64> = prepared.pose().iter().map(|angle| (angle * 1e6).round() / 1e6).collect();
        if self.progress.q.is_empty() {
            self.progress.q.clone_from(&q);
        }
        let apart = self.progress.q.iter().zip(&q).map(|(then, now)| (then - now).abs());
        let units = self.file.description.units();
        if apart.zip(&units).any(|(apart, units)| apart > SAME_POSE_RAD * f64::from(units.lever)) {
            return Err(MeasureError::Moved);
        }
        begun(&mut prepared, &q)?;
        let path = self.path;
        campaign::run(&mut prepared, plan, self.progress, |progress, repeats| {
            done(repeats);
            Ok(save(progress, path)?)
        })?;
        prepared.finish()
    }

    /// Restores the board's settings, and prints on standard error the names of settings that cannot be restored.
    pub fn restore(self) -> Result<(), ProgressError> {
        let back = self.before.restore(self.board);
        let missing = self.before.differing_settings(self.board).unwrap_or_else(|_| vec!["device", "scene", "rules"]);
        if back.is_err() || !missing.is_empty() {
            haptic_host::tell!(
                "these settings could not be restored on the board, so load them again: {}",
                missing.join(", ")
            );
            return Ok(());
        }
        match (self.progress.before.take(), self.path) {
            (None, _) | (_, None) => Ok(()),
            (Some(_), Some(path)) if !self.progress.is_empty() => self.progress.save(path),
            // Removes a file without results.
            (Some(_), Some(path)) => std::fs::remove_file(path)
                .map_err(|error| ProgressError::Unwritten(haptic_host::output::write_failure(path, &error))),
        }
    }
}

fn save(progress: &Progress, path: Option<&Path>) -> Result<(), ProgressError> {
    path.map_or(Ok(()), |path| progress.save(path))
}

/// Returns the settings to restore after a measurement: the present settings or, if an earlier measurement was killed,
/// the settings from before that. In the second case prints on standard error which settings are restored.
pub fn settings_to_restore(board: &mut Board, progress: &Progress) -> Result<EarlierSettings, BoardError> {
    let now = EarlierSettings::of(board)?;
    let serial = board.info().serial.clone();
    let kept = progress.before.as_ref().filter(|kept| kept.serial == serial.as_str());
    if !now.is_of_interrupted_measurement() {
        // A measurement that ended before setting its scene leaves only its rules on the board.
        let Some(Ok(Some(before))) = kept.map(|kept| now.with_earlier_rules(kept)) else { return Ok(now) };
        haptic_host::tell!(
            "the rules on the board were left by an interrupted measurement: the earlier rules are restored"
        );
        board.disarm()?;
        board.set_rules(before.rules())?;
        return Ok(before);
    }
    let Some(Ok((before, as_before))) = kept.map(|kept| now.restored_from(kept)) else {
        haptic_host::tell!(
            "the scene on the board was left by an interrupted measurement: load your scene again with `haptic scene`, \
             and check `haptic rules`"
        );
        return Ok(now);
    };
    haptic_host::tell!("the scene on the board was left by an interrupted measurement: the earlier scene is restored");
    if !as_before {
        haptic_host::tell!("the rules were changed after that measurement and are not restored: check `haptic rules`");
    } else if before.rules() != now.rules() {
        board.disarm()?;
        board.set_rules(before.rules())?;
    }
    Ok(before)
}

/// Returns a description of the loaded device if it is not `device`.
pub fn other_loaded_device(board: &mut Board, device: &Device<f32>) -> Result<Option<String>, LinkError> {
    let held = board.device()?;
    Ok((held.as_ref() != Some(device)).then(|| match held {
        None => "no device".into(),
        Some(held) if held.name == device.name => format!("another version of {}", held.name),
        Some(held) => held.name.to_string(),
    }))
}

/// Returns the control loop of `setup` for the theory, with the delay and the drive of the board.
#[must_use]
pub fn control_loop(setup: &MeasurementSetup, info: &Info, details: &Details) -> Loop {
    Loop::with_torque_path(&torque_path(info, details), setup.rate_hz, LinearEstimator::Butterworth(setup.cutoff_hz))
}

/// Returns a description of the measurement. Only a measurement with the same description continues a progress file.
#[must_use]
pub fn description(file: &DeviceFile, setup: &MeasurementSetup, pulls: &[f64], world: &World) -> String {
    let listed = |values: &[f64]| {
        // Removes the rounding error of the unit vector.
        let rounded = values.iter().map(|value| ((value * 1e9).round() / 1e9 + 0.0).to_string());
        format!("({})", rounded.collect::<Vec<_>>().join(", "))
    };
    let each: Vec<String> = setup
        .walls
        .iter()
        .map(|wall| match setup.walls.len() {
            1 => listed(&wall.normal),
            _ => format!("{} with share {}", listed(&wall.normal), wall.share),
        })
        .collect();
    let along = each.join(" and ");
    // Removes the rounding error of the multiplication.
    let mm = |pull: &f64| ((setup.largest_pull * pull * 1e9).round() / 1e6).to_string();
    let mut pull_mm = match pulls == BOTH_SIDES {
        true => mm(&1.0),
        false => pulls.iter().map(mm).collect::<Vec<_>>().join(" and "),
    };
    if setup.law.may_lengthen_pull {
        pull_mm = format!("of at least {pull_mm}");
    }
    let mut what = format!(
        "{} along {along} at {} Hz, cutoff {} Hz, washout {} Hz, pull {pull_mm} mm, {} N m",
        file.name, setup.rate_hz, setup.cutoff_hz, setup.washout_hz, setup.torque_limit
    );
    let without: Vec<usize> = (0..setup.walls.len()).filter(|wall| !setup.walls[*wall].feed_forward).collect();
    if !without.is_empty() {
        what.push_str(&format!(", without the feed-forward of {without:?}"));
    }
    if let Some(held) = setup.law.posture {
        what.push_str(&format!(", posture {},{}", held.stiffness, held.damping));
    }
    let World { q, friction, ideal_drive, counts, grip } = *world;
    if let Some(q) = q {
        let unit = joint_units(&file.description.units(), |joint| joint.travel);
        what.push_str(&format!(", at q = {} {unit}", listed(&q)));
    }
    if friction != Friction::All {
        what.push_str(&format!(", friction: {}", format!("{friction:?}").to_lowercase()));
    }
    if ideal_drive {
        what.push_str(", ideal drive");
    }
    if let Some(counts) = counts {
        what.push_str(&format!(", {counts} counts a turn"));
    }
    if grip {
        what.push_str(", held by a hand");
    }
    what
}
