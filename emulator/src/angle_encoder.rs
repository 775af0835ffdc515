//! An AS5047 or AS5048 on its SPI bus (ams data sheets AS5047D v1-00 and AS5048 v1-06). A frame carries the reply to
//! the frame before it. The encoder latches its angle at the end of the command that reads it.

use rigless::chip::Timeline;
use rigless::chip::spi::Peer;
use rigless::snapshot::Store;

const READ: u16 = 1 << 14;
const ANGLE_ADDRESS: u16 = 0x3FFF;
const ERROR_ADDRESS: u16 = 0x0001;
/// Flag of a reply after an invalid command.
const ERROR_FLAG: u16 = 1 << 14;
const PARITY: u16 = 1 << 15;

/// One absolute encoder.
#[derive(Debug)]
pub struct AngleEncoder {
    /// Angle in counts of 2⁻¹⁴ turns, or `None` if no encoder is connected.
    angle: Option<i32>,
    next_reply: u16,
    has_error: bool,
    /// Number of replies that are still to be disturbed.
    disturbed: u32,
}

/// Not stored in snapshots, because a run starts at power-on.
impl Store for AngleEncoder {}

impl Default for AngleEncoder {
    fn default() -> Self {
        // A starting encoder has seen no valid command.
        Self { angle: None, next_reply: 0, has_error: true, disturbed: 0 }
    }
}

impl AngleEncoder {
    /// Turns the magnet to an angle, counts.
    pub fn turn_to(&mut self, counts: i32) {
        self.angle = Some(counts);
    }

    /// Disturbs one bit of each of the next replies.
    pub fn disturb(&mut self, replies: u32) {
        self.disturbed = replies;
    }

    fn reply_to(&mut self, command: u16) -> u16 {
        let is_even = command.count_ones().is_multiple_of(2);
        let data = match (is_even && command & READ != 0, command & ANGLE_ADDRESS) {
            (true, ANGLE_ADDRESS) => self.angle.unwrap_or(0) as u16 & ANGLE_ADDRESS,
            (true, ERROR_ADDRESS) => {
                self.has_error = false;
                0
            }
            _ => {
                self.has_error = true;
                0
            }
        };
        let reply = data | if self.has_error { ERROR_FLAG } else { 0 };
        if reply.count_ones() % 2 == 0 { reply } else { reply | PARITY }
    }
}

impl Peer for AngleEncoder {
    fn transfer(&mut self, mosi: u32, bits: u8, _: &mut Timeline<'_, '_>) -> u32 {
        if self.angle.is_none() || bits != 16 {
            return (1 << bits) - 1;
        }
        let next = self.reply_to(mosi as u16);
        let reply = std::mem::replace(&mut self.next_reply, next);
        let noise = if self.disturbed > 0 { 1 << (self.disturbed % 14) } else { 0 };
        self.disturbed = self.disturbed.saturating_sub(1);
        u32::from(reply ^ noise)
    }
}
