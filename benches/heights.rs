//! Writes a height map for encoding to be measured with: `cargo bench --bench heights -- OUT.npy SIZE`, a fractal of `SIZE × SIZE`
//! u16 values below 1,024, the same on every machine.

use std::io::{BufWriter, Write};

use rayon::prelude::*;

/// 0 to 1,023 at a corner of a lattice.
fn corner(x: u32, z: u32, octave: u32) -> i64 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ z.wrapping_mul(0x85EB_CA77) ^ octave.wrapping_mul(0xC2B2_AE3D);
    for k in [0x7FEB_352Du32, 0x846C_A68B] {
        h = (h ^ h >> 16).wrapping_mul(k);
    }
    i64::from((h ^ h >> 16) & 1023)
}

/// Lattices of 2¹¹ to 2 columns, each half as high as the one before, between corners linear.
fn height(x: u32, z: u32) -> u16 {
    let sum: i64 = (0..11)
        .map(|octave| {
            let shift = 11 - octave;
            let (cx, cz, n) = (x >> shift, z >> shift, 1 << shift);
            let (fx, fz) = (i64::from(x) & (n - 1), i64::from(z) & (n - 1));
            let row = |cz| corner(cx, cz, octave) * (n - fx) + corner(cx + 1, cz, octave) * fx;
            (row(cz) * (n - fz) + row(cz + 1) * fz) >> (2 * shift + octave + 1)
        })
        .sum();
    sum as u16
}

fn main() -> std::io::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let [path, size] = &args[..] else {
        println!("nothing to write: -- OUT.npy SIZE");
        return Ok(());
    };
    let size: u32 = size.parse().map_err(std::io::Error::other)?;
    let mut out = BufWriter::with_capacity(1 << 20, std::fs::File::create(path)?);
    let text = format!("{{'descr': '<u2', 'fortran_order': False, 'shape': ({size}, {size}), }}");
    out.write_all(b"\x93NUMPY\x01\0")?;
    out.write_all(&(text.len() as u16).to_le_bytes())?;
    out.write_all(text.as_bytes())?;
    for z in (0..size).step_by(64) {
        let rows = z..size.min(z + 64);
        let values: Vec<u16> = rows.into_par_iter().flat_map_iter(|z| (0..size).map(move |x| height(x, z))).collect();
        out.write_all(bytemuck::cast_slice(&values))?;
    }
    out.flush()
}
