//! The description of a recording, read from the board once and written at the head of every file.

use haptic_bridge::control::Rules;
use haptic_host::backup::SavedSetting;
use haptic_host::error::{Failure, on_one_line};
use haptic_host::link::Board;
use haptic_host::output;
use haptic_host::words::{nth_step, wall_in_words};
use serde::Serialize;
use std::collections::BTreeMap;

/// Date, versions, board, device, scene, gains and rules of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct About {
    /// The lines at the head of a CSV file.
    text: String,
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Control steps between rows.
    pub divider: u32,
    delay_samples: f32,
}

impl About {
    /// Reads the description from the board.
    pub fn read(board: &mut Board, divider: u32) -> Result<Self, Failure> {
        let details = board.details()?;
        let info = board.info().clone();
        let (device, scene, rules) = (board.device()?, board.scene()?, board.rules()?);
        let name = if details.name.is_empty() { String::new() } else { format!(" \"{}\"", on_one_line(&details.name)) };
        let mut text = format!(
            "haptic-bridge recording, fields in docs/telemetry.md\n\
             date {}\n\
             tool {}, firmware {}, protocol {}\n\
             board {} {}{name}\n\
             device {}\n\
             control rate {} Hz, every {}, delay {} samples\n",
            output::date(),
            env!("CARGO_PKG_VERSION"),
            on_one_line(&info.firmware),
            info.protocol,
            on_one_line(&info.board),
            on_one_line(&info.serial),
            on_one_line(details.device.as_deref().unwrap_or("none")),
            details.rate_hz,
            nth_step(divider),
            details.delay_samples,
        );
        for (index, wall) in scene.iter().flat_map(|scene| scene.walls.iter().enumerate()) {
            text.push_str(&format!("wall {index}: {}\n", wall_in_words(wall)));
        }
        // Writes the complete scene and rules at the start of the recording, for programs.
        text.push_str(&format!("scene {}\n", json(&scene)?));
        let units = device.as_ref().map(|device| device.mechanism.units()).unwrap_or_default();
        let joints = if units.is_empty() { details.axes.into() } else { units.len() };
        let shown = Rules { limits: rules.limits.in_units(&units), ..rules };
        text.push_str(&format!("rules {}\n", json(&limit_to_joints(&shown, joints)?)?));
        // Writes the settings also in the bit-exact form of a backup, because `haptic replay` computes with them.
        let mut settings = BTreeMap::new();
        settings.extend(device.and_then(|device| Some(("device", without_value(SavedSetting::of(&device)?)))));
        settings.extend(scene.and_then(|scene| Some(("scene", without_value(SavedSetting::of(&scene)?)))));
        settings.extend(SavedSetting::of(&rules).map(|rules| ("rules", without_value(rules))));
        text.push_str(&format!("settings {}\n", json(&settings)?));
        Ok(Self { text, rate_hz: details.rate_hz.into(), divider, delay_samples: details.delay_samples })
    }

    /// Leaves the lines out: a CSV file then has no comments, and its states are numbers.
    pub fn without_comments(self) -> Self {
        Self { text: String::new(), ..self }
    }

    /// Returns the lines.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns the description as entries for programs: all lines together, and each line by its first word.
    pub fn entries(&self) -> BTreeMap<String, String> {
        let lines = self.text.lines().skip(1).filter(|line| !line.starts_with("control rate"));
        // Splits the line of versions: "tool 0.1.0, firmware 0.1.0, protocol 6".
        let parts =
            lines.flat_map(|line| if line.starts_with("tool ") { line.split(", ").collect() } else { vec![line] });
        let lines = parts.filter_map(|line| match line.strip_prefix("wall ") {
            Some(wall) => wall.split_once(": ").map(|(index, text)| (format!("wall {index}"), text.into())),
            None => line.split_once(' ').map(|(word, rest)| (word.into(), rest.into())),
        });
        let entries = [
            ("about".to_string(), self.text.clone()),
            ("divider".into(), self.divider.to_string()),
            ("rate_hz".into(), self.rate_hz.to_string()),
            ("delay_samples".into(), self.delay_samples.to_string()),
            (
                "time_base".into(),
                "log times begin with this computer's clock at the first row and then count the board's control steps"
                    .into(),
            ),
        ];
        lines.chain(entries).collect()
    }
}

/// Removes the value of a setting, because other lines of the description have it.
fn without_value(setting: SavedSetting) -> SavedSetting {
    SavedSetting { value: None, ..setting }
}

/// Returns the rules with one number per joint of the device, because a board has room for more joints.
fn limit_to_joints(rules: &Rules, joints: usize) -> Result<serde_json::Value, Failure> {
    let mut rules = serde_json::to_value(rules).map_err(Failure::impossible)?;
    for list in rules["limits"].as_object_mut().into_iter().flatten().filter_map(|(_, limit)| limit.as_array_mut()) {
        list.truncate(joints);
    }
    if let Some(list) = rules["index_period"].as_array_mut() {
        list.truncate(joints);
    }
    Ok(rules)
}

fn json(value: &impl Serialize) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(Failure::impossible)
}
