//! Every message between board and host, with its version.
//!
//! postcard-rpc frames (header with key and sequence number, then postcard), COBS-encoded over a byte stream: a USB
//! CDC-ACM serial port, a pseudo-terminal or TCP. A message's key is a hash of its path and of its types: a
//! board that has another form of a message does not know its key, and answers that instead of misreading it. Whether
//! tool and board speak the same protocol is asked first: [`GetInfo`], whose shape never changes, answers with
//! [`PROTOCOL`]. The request of [`Disarm`] never changes either, nor does the single zero in the body of its answer once
//! the motors are off: any tool stops any board.

use crate::board::settings::{Damage, Entry, Key};
use crate::board::telemetry::{Batch, StreamRequest};
pub use crate::control::host_force::{BadForce, ForceAnswer, ForceDone, ForceRequest, HostContact};
pub use crate::control::{Beat, Press};
use crate::control::{Rules, Status};
use crate::model::device::Device;
use crate::model::precomputed::MassModelData;
pub use crate::model::precomputed::TableChunk;
use crate::render::controller::Gains;
use crate::render::scene::Scene;
use crate::render::velocity::Estimator;
use crate::safety::fault::FaultRecord;
use crate::safety::refusal::Refusal;
use heapless::{String, Vec};
use postcard_rpc::{TopicDirection, endpoints, topics};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Version of this table. Raised by any change to it.
pub const PROTOCOL: u16 = 11;

/// Longest frame on the link, bytes, before what COBS adds.
pub const MAX_FRAME: usize = 1536;

/// Most faults the board remembers since it started.
pub const FAULT_HISTORY: usize = 16;

/// The answer to what changes something.
pub type Outcome = Result<(), Refusal>;

/// A board's description of itself. Fields are only ever added behind a new [`PROTOCOL`] and another path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Info {
    /// [`PROTOCOL`] of the firmware.
    pub protocol: u16,
    /// Firmware version.
    pub firmware: String<16>,
    /// Kind of board: what the firmware is for, or `simulated`.
    pub board: String<24>,
    /// Serial number.
    pub serial: String<24>,
}

/// The rest of what a board says of itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Details {
    /// The name that its owner gave it.
    pub name: String<32>,
    /// Motor axes.
    pub axes: u8,
    /// True if there are real motors.
    pub real: bool,
    /// Carrier frequency at the present control rate, Hz.
    pub carrier_hz: f32,
    /// Computation delay from sampling to duty, in control samples.
    pub delay_samples: f32,
    /// The loaded device's name.
    pub device: Option<String<32>>,
    /// Control rate, Hz; 20 kHz until a scene says otherwise.
    pub rate_hz: f32,
    /// Walls in the scene.
    pub walls: u8,
    /// Faults (their codes) that this board cannot sense as it is wired.
    pub unsensed: Vec<u8, 16>,
    /// Damage found in the settings at boot.
    pub damage: Vec<(Key, Damage), { Key::ALL.len() }>,
    /// Runs of the control interrupt that reached past the next crest since boot.
    pub overruns: u32,
    /// Longest control interrupt seen, in core cycles; 0 where it is not measured.
    pub longest_cycles: u32,
    /// Stack never used so far, bytes; 0 where it is not measured.
    pub stack_free: u32,
}

/// Gains for a wall, and for the estimators of all walls.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct GainsRequest {
    /// Of one wall.
    pub wall: Option<Gains<f32>>,
    /// Kind and cutoff (Hz) of the velocity estimators.
    pub estimator: Option<(Estimator, f32)>,
}

/// A setting's bytes, to put aside until [`CommitEntries`] names its key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct WriteEntry {
    /// Whose it is: a number that the tool draws for each change. What another one has put aside is forgotten.
    pub session: u32,
    /// Under which key.
    pub key: Key,
    /// As [`crate::board::settings::encode`] made it.
    pub entry: Entry,
}

/// Which of the settings that were put aside are to count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Commit {
    /// As in [`WriteEntry`]: what another session has put aside is refused as [`Refusal::BadEntry`].
    pub session: u32,
    /// Their keys.
    pub keys: KeyList,
}

/// A device as it is sent.
pub type DeviceData = Device<f32>;
/// A scene as it is sent.
pub type SceneData = Scene<f32>;
/// The loaded device, if any.
pub type MaybeDevice = Option<DeviceData>;
/// The loaded scene, if any.
pub type MaybeScene = Option<SceneData>;
/// The faults seen since the board started, oldest first.
pub type FaultList = Vec<FaultRecord, FAULT_HISTORY>;
/// A setting's bytes, if it is set.
pub type MaybeEntry = Option<Entry>;
/// Settings by their keys.
pub type KeyList = Vec<Key, { Key::ALL.len() }>;
/// The control step at which a request was heard, counted since boot, wrapping.
pub type Step = u32;
/// A board's name, as people call it.
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
    | SetMassModel  | MassModelData | Outcome     | "haptic/mass"      |
    | SendTable     | TableChunk    | Outcome     | "haptic/table"     |
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
