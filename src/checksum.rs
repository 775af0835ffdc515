//! The checksum of what is kept and sent: CRC-32.

/// CRC-32 (IEEE 802.3, reflected) of these bytes.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = Crc32::new();
    crc.take(bytes);
    crc.sum()
}

/// A CRC-32 that grows, bit by bit: what is summed is small and comes rarely.
#[derive(Clone, Copy, Debug)]
pub struct Crc32(u32);

impl Crc32 {
    /// Of nothing.
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    /// Adds bytes.
    pub fn take(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 ^= u32::from(*byte);
            for _ in 0..8 {
                let carry = if self.0 & 1 == 1 { 0xEDB8_8320 } else { 0 };
                self.0 = (self.0 >> 1) ^ carry;
            }
        }
    }

    /// The checksum of what has come so far.
    pub const fn sum(&self) -> u32 {
        !self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}
