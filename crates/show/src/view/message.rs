//! Messages of a page, as JSON: `{"do": "gains", "wall": 0, …}`. Unknown words and keys are errors.

use haptic_bridge::render::scene::FeedForward;
use serde::{Deserialize, Serialize};

/// A message from a page. Messages without content have braces, so that unknown keys in them are refused.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum FromPage {
    /// A sign that the page is still open.
    Here {},
    /// Request for command, granted if no page has it.
    Take {},
    /// The page gives up command.
    Give {},
    /// The dead man's key was pressed: motors on.
    Arm {
        /// Control step of the newest received picture, as in [`FromPage::Hold`].
        seen: u32,
    },
    /// The key is still down; sent several times a second. It never turns the motors on, because only a press arms.
    Hold {
        /// Control step of the newest picture when the page last detected the pressed key. It shows the message's age.
        seen: u32,
    },
    /// The key was released: motors off.
    Release {},
    /// A request of any page to turn the motors off.
    Disarm {},
    /// A request to clear a fault.
    Clear {},
    /// New gains of a wall.
    Gains {
        /// Index of the wall, from 0.
        wall: u8,
        /// Stiffness, N/m.
        stiffness: f32,
        /// Damping, N s/m.
        damping: f32,
        /// Feed-forward of the wall's force.
        feed_forward: FeedForward,
        /// True to set gains that are predicted to be unstable.
        #[serde(default)]
        beyond: bool,
    },
    /// New position of a wall. Without a new normal a plane keeps its direction.
    Wall {
        /// Index of the wall, from 0.
        wall: u8,
        /// Point of the wall (the centre of a round wall) in the drawn plane, m.
        point: [f32; 2],
        /// New normal of the plane, of any length.
        #[serde(default)]
        normal: Option<[f32; 2]>,
    },
    /// New position of the simulated hand; without a position it releases the tip.
    Hand {
        /// Position in the drawn plane, m.
        at: Option<[f64; 2]>,
    },
    /// A request to reset a simulated device and its scene to the start, with the motors off.
    StartOver {
        /// Pose to use instead of the initial pose, rad.
        #[serde(default)]
        pose: Option<Vec<f64>>,
    },
    /// A request to replace a simulated device by a shipped device.
    World {
        /// Number of the device in [`super::World::names`], from 0.
        world: usize,
    },
    /// A request to change the control rate of a simulated board.
    Rate {
        /// Rate, Hz.
        hz: f32,
    },
    /// A request for the limiting effects of the nearest wall, which are sent with the next boundary.
    Explain {},
    /// Settings of this page's oscilloscope.
    Scope(ScopeRequest),
    /// A request to start or stop a recording, in the folder of the tool.
    Record {
        /// True to start, false to stop.
        on: bool,
    },
    /// A request to turn the sound of the motors on or off for this page.
    Sound {
        /// True to turn the sound on.
        on: bool,
    },
}

/// An oscilloscope's settings.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ScopeRequest {
    /// Labels of the telemetry columns, up to four.
    pub channels: Vec<String>,
    /// Duration of the window, s.
    pub seconds: f64,
    /// Trigger of a sweep; `None` for a rolling sweep.
    #[serde(default)]
    pub trigger: Option<Trigger>,
}

/// Condition that starts a sweep.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Trigger {
    /// Label of the trigger's column.
    pub channel: String,
    /// Level, in the column's unit.
    pub level: f64,
    /// True for upward crossings.
    pub rising: bool,
    /// Share of the window before the crossing, 0 to 1.
    pub before: f64,
    /// True to stop after one sweep.
    #[serde(default)]
    pub once: bool,
}

impl FromPage {
    /// Parses a message. The error describes the mistake.
    pub fn parse(text: &str) -> Result<Self, String> {
        serde_json::from_str(text).map_err(|error| format!("not a message of this page: {error}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_messages_are_refused() {
        assert_eq!(FromPage::parse(r#"{"do":"arm","seen":1}"#), Ok(FromPage::Arm { seen: 1 }));
        assert_eq!(FromPage::parse(r#"{"do":"hand","at":null}"#), Ok(FromPage::Hand { at: None }));
        assert_eq!(FromPage::parse(r#"{"do":"start-over"}"#), Ok(FromPage::StartOver { pose: None }));
        for bad in [
            r#"{"do":"jump"}"#,
            r#"{"do":"hold"}"#,
            r#"{"do":"hold","seen":-1}"#,
            r#"{"do":"hold","seen":1,"x":1}"#,
            r#"{"do":"explain","wall":0}"#,
            r#"{"do":"sound","on":true,"and":1}"#,
            r#"{"do":"hand","at":[1]}"#,
            r#"{"do":"start-over","pose":1}"#,
            r#"{"do":"gains","wall":-1,"stiffness":1,"damping":1,"feed_forward":"off"}"#,
            r#"{"do":"gains","wall":0,"stiffness":1,"damping":1,"feed_forward":"some"}"#,
        ] {
            let refused = FromPage::parse(bad).unwrap_err();
            assert!(refused.starts_with("not a message of this page"), "{bad}: {refused}");
        }
    }
}
