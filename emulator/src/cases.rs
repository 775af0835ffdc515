//! Devices in contact whose control interrupt is measured, and put under load.

use crate::boards::BoardKind;
use crate::contact::WallAt;
use crate::rig::Rig;

/// A device in contact on a board, every wall with the feed-forward in full, telemetry of every step streaming.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// The board.
    pub board: BoardKind,
    /// The device file.
    pub device: &'static str,
    /// How many walls.
    pub walls: usize,
    /// Control rate, Hz.
    pub rate_hz: u32,
    /// The most instructions that the product aims at, where it aims at any.
    pub target: Option<u64>,
}

/// What is measured and kept.
pub const CASES: [Case; 5] = [
    Case { board: BoardKind::OdriveV3, device: "pantograph-mk2", walls: 1, rate_hz: 20_000, target: Some(800) },
    Case { board: BoardKind::OdriveV3, device: "pantograph-mk2", walls: 2, rate_hz: 20_000, target: None },
    Case {
        board: BoardKind::HBridgeF405,
        device: "phantom-premium-1.5",
        walls: 1,
        rate_hz: 20_000,
        target: Some(1150),
    },
    Case { board: BoardKind::HBridgeF405, device: "woodenhaptics", walls: 1, rate_hz: 20_000, target: Some(1150) },
    Case {
        board: BoardKind::HBridgeF405,
        device: "fictive-five-bar-turret",
        walls: 1,
        rate_hz: 20_000,
        target: Some(1150),
    },
];

impl Case {
    /// Its name in the table.
    #[must_use]
    pub fn name(&self) -> String {
        let walls = if self.walls == 1 { "a wall" } else { "a corner" };
        format!("{}, {}, {walls}, {} kHz", self.board.name(), self.device, self.rate_hz / 1000)
    }

    /// A rig in contact with the walls of this case at `rate_hz`.
    ///
    /// # Panics
    ///
    /// When the board refuses anything.
    #[must_use]
    pub fn rig(&self, rate_hz: u32) -> Rig {
        let normals = [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]];
        let walls: Vec<WallAt> = normals.into_iter().take(self.walls).map(WallAt::facing).collect();
        let head = format!("rate_hz = {rate_hz}\ngravity_compensation = true\n");
        Rig::in_contact(self.board, self.device, &head, &walls, 0.8)
    }
}
