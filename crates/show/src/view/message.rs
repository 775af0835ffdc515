//! Messages of a page, as JSON: `{"do": "gains", "wall": 0, …}`. Unknown words and keys are errors.

use haptic_bridge::render::scene::FeedForward;
use serde::{Deserialize, Serialize};

/// A message from a page. Messages without content have braces, so that unknown keys in them are refused.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum FromPage {
    /// Report that the page is open.
    Here {},
    /// Take command, if no page has it.
    Take {},
    /// Give up command.
    Give {},
    /// The dead man's key was pressed: motors on.
    Arm {
        /// As in [`FromPage::Hold`].
        seen: u32,
    },
    /// The key is still down; sent several times a second. It never turns the motors on, because only a press arms.
    Hold {
        /// Control step of the newest picture that the page had received before it saw the key down. It tells the board
        /// the age of the key press.
        seen: u32,
    },
    /// The key was released: motors off.
    Release {},
    /// Motors off, from any page.
    Disarm {},
    /// Clear a fault.
    Clear {},
    /// Set the gains of a wall.
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
    /// Move a wall: its point (the centre of a round wall), m. A plane keeps its direction unless a new normal is
    /// given.
    Wall {
        /// Index of the wall, from 0.
        wall: u8,
        /// New position, in the drawn plane, m.
        point: [f32; 2],
        /// New normal of the plane, of any length.
        #[serde(default)]
        normal: Option<[f32; 2]>,
    },
    /// Move the simulated hand to a position, m; without a position the hand releases the tip.
    Hand {
        /// Position in the drawn plane.
        at: Option<[f64; 2]>,
    },
    /// Reset a simulated device and its scene to the start, with the motors off.
    StartOver {
        /// Pose to use instead of the initial pose, rad.
        #[serde(default)]
        pose: Option<Vec<f64>>,
    },
    /// Replace a simulated device by a shipped one, by its number in [`super::World::names`].
    World {
        /// Number, from 0.
        world: usize,
    },
    /// Change the control rate of a simulated board.
    Rate {
        /// Rate, Hz.
        hz: f32,
    },
    /// Send the limiting effects of the nearest wall with the next boundary.
    Explain {},
    /// Settings of this page's oscilloscope.
    Scope(ScopeRequest),
    /// Start or stop a recording, in the folder of the tool.
    Record {
        /// On or off.
        on: bool,
    },
    /// Turn the sound of the motors on or off for this page.
    Sound {
        /// On or off.
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
