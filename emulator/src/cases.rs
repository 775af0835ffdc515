//! Devices in scenes whose control interrupt is measured, and put under load.

use crate::boards::BoardKind;
use crate::contact::WallAt;
use crate::rig::Rig;

/// The contacts of a device. A wall has the feed-forward in full unless it says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meets {
    /// Nothing.
    Nothing,
    /// A spring and a damping field.
    Spring,
    /// One flat wall.
    Wall,
    /// The same without the feed-forward.
    WallOff,
    /// The same with a feed-forward that is washed out.
    WallWashed,
    /// One round wall.
    Ball,
    /// A flat wall and a spring.
    WallAndSpring,
    /// Two flat walls.
    Corner,
}

impl Meets {
    /// Its name in a table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Spring => "a spring and a field",
            Self::Wall => "a wall",
            Self::WallOff => "a wall without feed-forward",
            Self::WallWashed => "a wall, washed out",
            Self::Ball => "a round wall",
            Self::WallAndSpring => "a wall and a spring",
            Self::Corner => "a corner",
        }
    }

    /// The walls.
    fn walls(self) -> Vec<WallAt> {
        let one = WallAt::facing([0.0, -1.0, 0.0]);
        match self {
            Self::Nothing | Self::Spring => vec![],
            Self::Wall | Self::WallAndSpring => vec![one],
            Self::WallOff => vec![WallAt { feed_forward: "off", ..one }],
            Self::WallWashed => vec![WallAt { feed_forward: "washout", ..one }],
            Self::Ball => vec![WallAt { radius: Some(0.03), ..one }],
            Self::Corner => {
                let other = WallAt::facing([-1.0, 0.0, 0.0]);
                // If both were as stiff, there would be nothing to shape.
                vec![one, WallAt { stiffness: 0.5 * other.stiffness, ..other }]
            }
        }
    }

    /// Number of walls that it touches.
    #[must_use]
    pub fn contacts(self) -> usize {
        self.walls().len()
    }
}

/// A device in a scene on a board, pushed into what it meets, telemetry of every step streaming.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// The board.
    pub board: BoardKind,
    /// The device file.
    pub device: &'static str,
    /// The scene.
    pub meets: Meets,
    /// Control rate, Hz.
    pub rate_hz: u32,
    /// The most instructions that a step is meant to take on average.
    pub target: u64,
}

const fn case(board: BoardKind, device: &'static str, meets: Meets, target: u64) -> Case {
    Case { board, device, meets, rate_hz: 20_000, target }
}

/// The cases that are measured stage by stage, and kept.
pub const CASES: [Case; 5] = [
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::Wall, 800),
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::Corner, 1200),
    case(BoardKind::HBridgeF405, "phantom-premium-1.5", Meets::Wall, 1150),
    case(BoardKind::HBridgeF405, "woodenhaptics", Meets::Wall, 1150),
    case(BoardKind::HBridgeF405, "fictive-five-bar-turret", Meets::Wall, 1150),
];

/// Every other kind of scene, on a five-bar.
pub const SCENES: [Case; 6] = [
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::Nothing, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::Spring, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::WallOff, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::WallWashed, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::Ball, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", Meets::WallAndSpring, 880),
];

impl Case {
    /// Its name in the table.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}, {}, {}, {} kHz", self.board.name(), self.device, self.meets.name(), self.rate_hz / 1000)
    }

    /// A rig in contact with what this case meets at `rate_hz`.
    ///
    /// # Panics
    ///
    /// When the board refuses anything.
    #[must_use]
    pub fn rig(&self, rate_hz: u32) -> Rig {
        let mut head = format!("rate_hz = {rate_hz}\ngravity_compensation = true\n");
        if matches!(self.meets, Meets::Spring | Meets::WallAndSpring) {
            head += "[[spring]]\npoint = [0.0, 0.1]\nstiffness = 50.0\ndamping = 0.5\n[[field]]\ndamping = 0.5\n";
        }
        Rig::in_contact(self.board, self.device, &head, &self.meets.walls(), 0.8)
    }
}
