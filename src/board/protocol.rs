//! The messages between board and host, and their version.
//!
//! Messages are postcard-rpc frames (header with key and sequence number, then postcard), COBS-encoded over a byte
//! stream: a USB CDC-ACM serial port, a pseudo-terminal or TCP. A message's key is a hash of its path and types, so a
//! board with another form of a message replies with an error instead of misreading it. A tool first compares
//! [`PROTOCOL`] by [`GetInfo`], whose form never changes. The request of [`Disarm`] and the single zero in the body of
//! its reply never change either, so that any tool can stop any board.

use crate::board::settings::{Damage, Entry, Key};
use crate::board::telemetry::{Batch, StreamRequest};
pub use crate::control::host_force::{BadForce, ForceAnswer, ForceDone, ForceRequest, HostContact};
pub use crate::control::{Beat, Press};
use crate::control::{Rules, Status};
use crate::model::cogging::Potentials;
use crate::model::device::Device;
use crate::render::controller::Gains;
use crate::render::scene::Scene;
use crate::render::velocity::Estimator;
use crate::safety::fault::FaultRecord;
use crate::safety::refusal::Refusal;
use heapless::{String, Vec};
use postcard_rpc::{TopicDirection, endpoints, topics};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Version of the protocol, increased with every change of a message.
pub const PROTOCOL: u16 = 14;
/// Longest frame on the link before COBS encoding, bytes.
pub const MAX_FRAME: usize = 1536;
/// Maximum number of faults in the board's history.
pub const FAULT_HISTORY: usize = 16;
/// Reply to a request that changes something.
pub type Outcome = Result<(), Refusal>;

/// Identity of a board. A new field needs a new [`PROTOCOL`] and another path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Info {
    /// [`PROTOCOL`] of the firmware.
    pub protocol: u16,
    /// Firmware version.
    pub firmware: String<16>,
    /// Kind of board: the firmware's target, or `simulated`.
    pub board: String<24>,
    /// Serial number.
    pub serial: String<24>,
}

/// Further properties of a board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Details {
    /// Name given by the owner.
    pub name: String<32>,
    /// Number of motor axes.
    pub axes: u8,
    /// Number of encoder inputs, those of the motor axes included.
    pub encoders: u8,
    /// True if the motors are real.
    pub real: bool,
    /// Carrier frequency at the present control rate, Hz.
    pub carrier_hz: f32,
    /// Computation delay from sampling to duty, in control periods.
    pub delay_samples: f32,
    /// Name of the loaded device.
    pub device: Option<String<32>>,
    /// Control rate, Hz; 20 kHz until a scene is loaded.
    pub rate_hz: f32,
    /// Number of walls in the scene.
    pub walls: u8,
    /// Codes of the faults that this board cannot detect with its wiring.
    pub unsensed: Vec<u8, 16>,
    /// Damage of the settings at boot.
    pub damage: Vec<(Key, Damage), { Key::ALL.len() }>,
    /// Number of control interrupts since boot that lasted past the next crest.
    pub overruns: u32,
    /// Longest control interrupt, core cycles; 0 if it is not measured.
    pub longest_cycles: u32,
    /// Stack that was never used so far, bytes; 0 if it is not measured.
    pub stack_free: u32,
}

/// Gains of a wall, and velocity estimators of all walls.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct GainsRequest {
    /// Gains of one wall.
    pub wall: Option<Gains<f32>>,
    /// Kind and cutoff (Hz) of the velocity estimators.
    pub estimator: Option<(Estimator, f32)>,
}

/// Bytes of a setting, staged until a [`CommitEntries`] that contains the setting's key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct WriteEntry {
    /// Number that the tool draws for each change. Entries that another session has staged are dropped.
    pub session: u32,
    /// Key of the setting.
    pub key: Key,
    /// Bytes from [`crate::board::settings::encode`].
    pub entry: Entry,
}

/// Staged settings that become valid together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Commit {
    /// Session of [`WriteEntry`]. Entries staged in another session are refused with [`Refusal::BadEntry`].
    pub session: u32,
    /// Keys of the settings.
    pub keys: KeyList,
}

/// A device in a message.
pub type DeviceData = Device<f32>;
/// A scene in a message.
pub type SceneData = Scene<f32>;
/// The loaded device; `None` without a device.
pub type MaybeDevice = Option<DeviceData>;
/// The loaded scene; `None` without a scene.
pub type MaybeScene = Option<SceneData>;
/// Faults since the board started, oldest first.
pub type FaultList = Vec<FaultRecord, FAULT_HISTORY>;
/// Bytes of a setting; `None` if it is not set.
pub type MaybeEntry = Option<Entry>;
/// Keys of settings.
pub type KeyList = Vec<Key, { Key::ALL.len() }>;
/// Control step at which a request arrived, counted since boot, wrapping.
pub type Step = u32;
/// Name of a board.
pub type Name = String<32>;

endpoints! {
    list = ENDPOINTS;
    | EndpointTy    | RequestTy     | ResponseTy  | Path               |
    | ----------    | ---------     | ----------  | ----               |
    | GetInfo       | ()            | Info        | "haptic/info"      |
    | GetDetails    | ()            | Details     | "haptic/details"   |
    | GetStatus     | ()            | Status      | "haptic/status"    |
    | SetDevice     | DeviceData    | Outcome     | "haptic/device"    |
    | GetDevice     | ()            | MaybeDevice | "haptic/device?"   |
    | SetScene      | SceneData     | Outcome     | "haptic/scene"     |
    | GetScene      | ()            | MaybeScene  | "haptic/scene?"    |
    | SetGains      | GainsRequest  | Outcome     | "haptic/gains"     |
    | SetRules      | Rules         | Outcome     | "haptic/rules"     |
    | GetRules      | ()            | Rules       | "haptic/rules?"    |
    | Home          | ()            | Outcome     | "haptic/home"      |
    | CheckPolarity | ()            | Outcome     | "haptic/polarity"  |
    | Arm           | ()            | Outcome     | "haptic/arm"       |
    | ArmHeld       | Press         | Outcome     | "haptic/arm-held"  |
    | Disarm        | ()            | Outcome     | "haptic/disarm"    |
    | Clear         | ()            | Outcome     | "haptic/clear"     |
    | GetFaults     | ()            | FaultList   | "haptic/faults"    |
    | Heartbeat     | Beat          | Step        | "haptic/heartbeat" |
    | Force         | ForceRequest  | ForceAnswer | "haptic/force"     |
    | Stream        | StreamRequest | Outcome     | "haptic/stream"    |
    | Save          | ()            | Outcome     | "haptic/save"      |
    | ReadEntry     | Key           | MaybeEntry  | "haptic/entry?"    |
    | StageEntry    | WriteEntry    | Outcome     | "haptic/entry"     |
    | CommitEntries | Commit        | Outcome     | "haptic/entries"   |
    | SetName       | Name          | Outcome     | "haptic/name"      |
    | EnterDfu      | ()            | Outcome     | "haptic/dfu"       |
    | Restart       | ()            | Outcome     | "haptic/restart"   |
    | FindStops     | Press         | Outcome     | "haptic/stops"     |
    | SetCogging    | Potentials    | Outcome     | "haptic/cogging"   |
    | GetCogging    | ()            | Potentials  | "haptic/cogging?"  |
}

topics! {
    list = TOPICS_IN;
    direction = TopicDirection::ToServer;
    | TopicTy | MessageTy | Path |
    | ------- | --------- | ---- |
}

topics! {
    list = TOPICS_OUT;
    direction = TopicDirection::ToClient;
    | TopicTy   | MessageTy   | Path               |
    | -------   | ---------   | ----               |
    | Telemetry | Batch       | "haptic/telemetry" |
    | FaultSeen | FaultRecord | "haptic/fault"     |
}
