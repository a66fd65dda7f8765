//! What tests of several modules need.

/// Numbers without a pattern.
pub fn noise(x: u32, y: u32, z: u32) -> u32 {
    let mut v = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ z.wrapping_mul(0xC2B2_AE3D);
    v = (v ^ (v >> 15)).wrapping_mul(0x2C1B_3C6D);
    v ^ (v >> 13)
}
