//! The checksum of stored and transmitted data: CRC-32.

/// Returns the CRC-32 (IEEE 802.3, reflected) of `bytes`.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = Crc32::new();
    crc.take(bytes);
    crc.sum()
}

/// Remainder of each four-bit value after division by the polynomial.
const NIBBLES: [u32; 16] = {
    let mut table = [0; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let mut crc = nibble as u32;
        let mut bit = 0;
        while bit < 4 {
            crc = (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 };
            bit += 1;
        }
        table[nibble] = crc;
        nibble += 1;
    }
    table
};

/// A CRC-32 that is computed piece by piece, four bits at a time from a 64-byte table.
#[derive(Clone, Copy, Debug)]
pub struct Crc32(u32);

impl Crc32 {
    /// Starts a checksum without any bytes.
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    /// Adds `bytes` to the checksum.
    pub fn take(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 ^= u32::from(*byte);
            for _ in 0..2 {
                self.0 = (self.0 >> 4) ^ NIBBLES[(self.0 & 15) as usize];
            }
        }
    }

    /// Returns the checksum of all bytes so far.
    pub const fn sum(&self) -> u32 {
        !self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}
