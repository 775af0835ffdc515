//! Devices and scenes with which the control interrupt is measured and tested under load.

use crate::boards::BoardKind;
use crate::contact::NearWall;
use crate::rig::Rig;

/// Contents of a scene. Walls have the full feed-forward unless the variant names another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneKind {
    /// No walls, springs or fields.
    Nothing,
    /// A spring and a damping field.
    Spring,
    /// One flat wall.
    Wall,
    /// One flat wall without feed-forward.
    WallWithoutFeedForward,
    /// One flat wall with a washed-out feed-forward.
    WallWithWashout,
    /// One round wall.
    Ball,
    /// A flat wall and a spring.
    WallAndSpring,
    /// Two flat walls.
    Corner,
}

impl SceneKind {
    /// Returns the scene's name in a table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Spring => "a spring and a field",
            Self::Wall => "a wall",
            Self::WallWithoutFeedForward => "a wall without feed-forward",
            Self::WallWithWashout => "a wall, washed out",
            Self::Ball => "a round wall",
            Self::WallAndSpring => "a wall and a spring",
            Self::Corner => "a corner",
        }
    }

    fn walls(self) -> Vec<NearWall> {
        let one = NearWall::with_normal([0.0, -1.0, 0.0]);
        match self {
            Self::Nothing | Self::Spring => vec![],
            Self::Wall | Self::WallAndSpring => vec![one],
            Self::WallWithoutFeedForward => vec![NearWall { feed_forward: "off", ..one }],
            Self::WallWithWashout => vec![NearWall { feed_forward: "washout", ..one }],
            Self::Ball => vec![NearWall { radius: Some(0.03), ..one }],
            Self::Corner => {
                let other = NearWall::with_normal([-1.0, 0.0, 0.0]);
                // Walls of equal stiffness need no shaping, so the stiffness differs.
                vec![one, NearWall { stiffness: 0.5 * other.stiffness, ..other }]
            }
        }
    }

    /// Returns the number of walls that the tip touches.
    #[must_use]
    pub fn contacts(self) -> usize {
        self.walls().len()
    }
}

/// A device in a scene on a board. The tip is pushed into the walls, and telemetry of every step is streamed.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// The board.
    pub board: BoardKind,
    /// Name of the device file.
    pub device: &'static str,
    /// The scene.
    pub scene_kind: SceneKind,
    /// Control rate, Hz.
    pub rate_hz: u32,
    /// Target for the mean number of instructions of a step.
    pub target: u64,
}

const fn case(board: BoardKind, device: &'static str, scene_kind: SceneKind, target: u64) -> Case {
    Case { board, device, scene_kind, rate_hz: 20_000, target }
}

/// Cases that are measured stage by stage, with recorded results.
pub const CASES: [Case; 6] = [
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::Wall, 800),
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::Corner, 1200),
    case(BoardKind::HBridgeF405, "phantom-premium-1.5", SceneKind::Wall, 1150),
    case(BoardKind::HBridgeF405, "woodenhaptics", SceneKind::Wall, 1150),
    case(BoardKind::HBridgeF405, "fictive-five-bar-turret", SceneKind::Wall, 1150),
    case(BoardKind::OdriveV3, "gimbal-five-bar", SceneKind::Wall, 1800),
];

/// All other kinds of scenes, on a five-bar.
pub const SCENES: [Case; 6] = [
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::Nothing, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::Spring, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::WallWithoutFeedForward, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::WallWithWashout, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::Ball, 880),
    case(BoardKind::OdriveV3, "pantograph-mk2", SceneKind::WallAndSpring, 880),
];

impl Case {
    /// Returns the case's name in the table.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}, {}, {}, {} kHz", self.board.name(), self.device, self.scene_kind.name(), self.rate_hz / 1000)
    }

    /// Returns a rig at `rate_hz` whose tip touches the walls of this case.
    #[must_use]
    pub fn rig(&self, rate_hz: u32) -> Rig {
        let mut head = format!("rate_hz = {rate_hz}\ngravity_compensation = true\n");
        if matches!(self.scene_kind, SceneKind::Spring | SceneKind::WallAndSpring) {
            head += "[[spring]]\npoint = [0.0, 0.1]\nstiffness = 50.0\ndamping = 0.5\n[[field]]\ndamping = 0.5\n";
        }
        Rig::in_contact(self.board, self.device, &head, &self.scene_kind.walls(), 0.8)
    }
}
