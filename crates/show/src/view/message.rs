//! Messages of a page, as JSON: `{"do": "gains", "wall": 0, …}`. Unknown words and keys are errors.

use haptic_bridge::render::scene::FeedForward;
use serde::{Deserialize, Serialize};

/// A message from a page. Those without content are written with braces, so that unknown keys in them are refused.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum FromPage {
    /// The page is still there.
    Here {},
    /// Take command, if no page has it.
    Take {},
    /// Give it back.
    Give {},
    /// The dead man's key was pressed: motors on.
    Arm {
        /// As in [`FromPage::Hold`].
        seen: u32,
    },
    /// It is still down; said several times a second. Where it is not known to be, nothing happens: only a press arms.
    Hold {
        /// The control step of the newest picture that whatever sees the key had before it saw it down: by this the board
        /// knows how long ago that was.
        seen: u32,
    },
    /// It was let go: motors off.
    Release {},
    /// Motors off. Any page may.
    Disarm {},
    /// Clear a fault.
    Clear {},
    /// New gains of a wall.
    Gains {
        /// Which, from 0.
        wall: u8,
        /// N/m
        stiffness: f32,
        /// N s/m
        damping: f32,
        /// The kind of feed-forward of its force.
        feed_forward: FeedForward,
        /// Also where they are predicted to be unstable.
        #[serde(default)]
        beyond: bool,
    },
    /// Move a wall: its point (a round wall's centre), m. A plane keeps its direction unless a new normal is given.
    Wall {
        /// Which, from 0.
        wall: u8,
        /// The new place, in the plane that is drawn.
        point: [f32; 2],
        /// The plane's new normal, of any length.
        #[serde(default)]
        normal: Option<[f32; 2]>,
    },
    /// The place to which the hand goes, m; without one it lets go. On a simulated device.
    Hand {
        /// In the plane that is drawn.
        at: Option<[f64; 2]>,
    },
    /// Put a simulated device and its scene back to how they were in the beginning, with the motors off.
    StartOver {
        /// In another pose than the first, rad.
        #[serde(default)]
        pose: Option<Vec<f64>>,
    },
    /// Say what limits the stiffness of the nearest wall: with the next boundary.
    Explain {},
    /// Settings of this page's oscilloscope.
    Scope(ScopeRequest),
    /// Begin or end a recording, in the folder of the tool.
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
    /// Columns of telemetry by their labels, up to four.
    pub channels: Vec<String>,
    /// The time that is shown, s.
    pub seconds: f64,
    /// The trigger of a sweep; without one it rolls.
    #[serde(default)]
    pub trigger: Option<Trigger>,
}

/// The condition that starts a sweep.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Trigger {
    /// The column that is watched.
    pub channel: String,
    /// The level that it crosses, in the column's unit.
    pub level: f64,
    /// Upwards or downwards.
    pub rising: bool,
    /// Share of the window that is shown from before the crossing, 0 to 1.
    pub before: f64,
    /// Stop after one sweep.
    #[serde(default)]
    pub once: bool,
}

impl FromPage {
    /// Reads a message. The error says what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        serde_json::from_str(text).map_err(|error| format!("not a message of this page: {error}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_read_and_what_is_none_is_refused() {
        assert_eq!(FromPage::parse(r#"{"do":"arm","seen":1}"#), Ok(FromPage::Arm { seen: 1 }));
        assert_eq!(FromPage::parse(r#"{"do":"hand","at":null}"#), Ok(FromPage::Hand { at: None }));
        assert_eq!(FromPage::parse(r#"{"do":"start-over"}"#), Ok(FromPage::StartOver { pose: None }));
        for bad in [
            "",
            "hold",
            "[]",
            r#"{"do":"jump"}"#,
            r#"{"do":"hold"}"#,
            r#"{"do":"hold","seen":-1}"#,
            r#"{"do":"hold","seen":1,"x":1}"#,
            r#"{"do":"explain","wall":0}"#,
            r#"{"do":"sound"}"#,
            r#"{"do":"sound","on":1}"#,
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
