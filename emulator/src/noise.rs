//! Bytes that no tool sends, for any length of time: random bytes, random frames, and requests that are changed,
//! truncated and concatenated. A disarmed board must do nothing with them, and the session after them must work.

use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::Fault;
use haptic_host::link::{Board, Wire};
use haptic_sim::MotorInput;

use crate::boards::BoardKind;
use crate::rig::Rig;
use crate::run::{MILLISECOND, SECOND};

/// A wall beyond the home pose of the pantograph.
const SCENE: &str = "[[wall]]\npoint = [0.0, 0.13]\nnormal = [0.0, -1.0]\nstiffness = 2000.0\ndamping = 4.0\n";
/// Time between two bursts, ns, and maximum length of a burst, bytes: more than the port transfers in that time.
const BURST: u64 = 10 * MILLISECOND;
const LONGEST: usize = 3000;

/// Result of a run of noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Noise {
    /// Number of bursts written.
    pub bursts: u64,
    /// Number of bytes written.
    pub bytes: u64,
    /// Number of bytes received.
    pub received: u64,
    /// Number of bursts after which a bridge did not float.
    pub driven: u64,
    /// Number of restarts of the chip.
    pub restarts: usize,
    /// Number of bursts without a control step.
    pub stalled: u64,
    /// Number of faults, except those of a changed scene with numbers too large to compute with.
    pub faults: usize,
}

impl Noise {
    /// Returns true if no motor moved, nothing stopped and no fault occurred.
    #[must_use]
    pub fn harmless(&self) -> bool {
        (self.driven, self.restarts, self.stalled, self.faults) == (0, 0, 0, 0)
    }
}

/// A wire that records the sent bytes.
struct RecordingWire {
    wire: Box<dyn Wire>,
    sent: Arc<Mutex<Vec<u8>>>,
}

impl Wire for RecordingWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sent.lock().expect("no thread panicked").extend(bytes);
        self.wire.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.wire.receive(buffer, timeout)
    }

    fn now(&self) -> Duration {
        self.wire.now()
    }
}

/// Returns frames of requests from a tool to a disarmed board. None of them moves a motor or writes flash.
fn requests(rig: &mut Rig) -> Vec<Vec<u8>> {
    recorded(rig, make_requests)
}

/// Returns the frames that a tool sends to the board while it connects and during `work`.
///
/// # Panics
///
/// If the board does not reply.
pub fn recorded(rig: &mut Rig, work: impl FnOnce(&mut Rig)) -> Vec<Vec<u8>> {
    let sent = Arc::new(Mutex::new(Vec::new()));
    let tapped = RecordingWire { wire: rig.shared.wire(), sent: sent.clone() };
    rig.tool = Board::over(Box::new(tapped), "tapped").expect("the board replies");
    work(rig);
    let sent = sent.lock().expect("no thread panicked");
    sent.split_inclusive(|byte| *byte == 0).filter(|frame| frame.len() > 1).map(<[u8]>::to_vec).collect()
}

fn make_requests(rig: &mut Rig) {
    rig.load(SCENE);
    rig.tool.details().expect("the board replies");
    rig.tool.status().expect("the board replies");
    let gains = Gains { wall: 0, stiffness: 500.0, damping: 1.0, feed_forward: FeedForward::Full, washout_hz: 2.0 };
    rig.tool.set_wall_gains(gains).expect("gains change");
    let rules = rig.tool.rules().expect("the board replies");
    rig.tool.set_rules(&rules).expect("rules change");
    rig.tool.faults().expect("the board replies");
    rig.tool.start_stream(Fields::USUAL, 20).expect("a stream starts");
    rig.tool.stop_stream().expect("the stream stops");
}

/// Pseudorandom numbers (Marsaglia's xorshift).
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    fn below(&mut self, end: usize) -> usize {
        self.next() as usize % end.max(1)
    }

    /// Returns a burst: a fifth each of silence, noise, random frames, changed requests, and requests in noise.
    fn burst(&mut self, requests: &[Vec<u8>]) -> Vec<u8> {
        let length = self.below(LONGEST);
        let mut bytes = Vec::new();
        match self.below(5) {
            0 => {}
            1 => bytes.extend((0..length).map(|_| (self.next() >> 24) as u8)),
            2 => bytes.extend((0..length).map(|_| if self.below(24) == 0 { 0 } else { (self.next() >> 24) as u8 })),
            kind => {
                while bytes.len() < length {
                    let mut frame = requests[self.below(requests.len())].clone();
                    if kind == 3 || self.below(2) == 0 {
                        // The key at the front is not changed every time, because then no request would get past it.
                        for _ in 0..1 + self.below(4) {
                            let at = self.below(frame.len());
                            frame[at] ^= 1 << self.below(8);
                        }
                        frame.truncate(1 + self.below(2 * frame.len()));
                    }
                    bytes.extend(frame);
                }
            }
        }
        bytes
    }
}

/// Writes bursts made from `seed` to a board with a device for `seconds` of virtual time, and checks the board after
/// each. Calls `report_minute` every minute.
///
/// # Panics
///
/// If the board does not boot, or does not reply afterwards.
pub fn run(seed: u32, seconds: u64, mut report_minute: impl FnMut(u64)) -> (Rig, Noise) {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |options| options.substep = 25e-6);
    let rules = rig.tool.rules().expect("the board replies");
    let requests = requests(&mut rig);
    let mut numbers = Numbers(seed);
    let mut noise = Noise::default();
    let mut steps = rig.steps();
    let began = rig.now();
    while rig.now() < began + seconds * SECOND {
        let burst = numbers.burst(&requests);
        noise.bursts += 1;
        noise.bytes += burst.len() as u64;
        rig.with(move |stopped| {
            // Drop bytes of the last burst that the port has not sent: the next burst may begin in the middle of a
            // frame.
            stopped.usb().discard();
            stopped.usb().write(&burst);
        });
        rig.run(BURST);
        let (received, drives) = rig.with(|stopped| (stopped.usb().take().len(), stopped.hardware().drives()));
        noise.received += received as u64;
        noise.driven += u64::from(drives != [MotorInput::Floating; 3]);
        // At the lowest rate, which a changed scene may have, a burst lasts two steps.
        let now = rig.steps();
        noise.stalled += u64::from(now == std::mem::replace(&mut steps, now));
        if noise.bursts.is_multiple_of(60 * SECOND / BURST) {
            report_minute(noise.bursts * BURST / (60 * SECOND));
        }
    }
    rig.with(|stopped| stopped.usb().discard());
    rig.run(200 * MILLISECOND);
    noise.restarts = rig.with(|stopped| {
        stopped.usb().take();
        stopped.resets().len()
    });
    rig.tool = Board::over(rig.shared.wire(), "after the noise").expect("the board replies after the noise");
    let faults = rig.tool.faults().expect("the board replies");
    noise.faults = faults.iter().filter(|record| record.fault != Fault::NotFinite).count();
    let state = rig.tool.status().expect("the board replies").state;
    noise.driven += u64::from(state.drives());
    // A request with a changed byte may have been valid and have lowered a limit.
    rig.tool.set_rules(&rules).expect("rules change");
    (rig, noise)
}

/// Runs a complete session after the noise, including arming and disarming.
///
/// # Panics
///
/// If the board refuses a request.
pub fn session_after(rig: &mut Rig) {
    rig.load(SCENE);
    rig.tool.clear().expect("a latched fault can be cleared");
    rig.ready();
    rig.tool.disarm().expect("the board disarms");
}
