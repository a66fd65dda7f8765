//! How far two frames agree.

use planecast::Frame;
#[allow(unused_imports, reason = "each test binary uses a part")]
pub use planecast::measure::compare::{Agreement, compare};

const SKY: [i32; 4] = [-1; 4];

/// Whether two frames are the same bit for bit; if not, what differs, the first five pixels in full.
pub fn identical(a: &Frame, b: &Frame) -> Result<(), String> {
    if (a.width, a.height, a.voxel.len()) != (b.width, b.height, b.voxel.len()) {
        return Err(format!(
            "sizes: {} × {} with {} voxels, {} × {} with {} voxels",
            a.width,
            a.height,
            a.voxel.len(),
            b.width,
            b.height,
            b.voxel.len()
        ));
    }
    let mut text = String::new();
    let mut n = 0;
    for i in 0..a.color.len() {
        let mut fields = Vec::new();
        if a.color[i] != b.color[i] {
            fields.push(format!("color {:?} / {:?}", a.color[i], b.color[i]));
        }
        if a.depth[i].to_bits() != b.depth[i].to_bits() {
            fields.push(format!("depth {:?} / {:?}", a.depth[i], b.depth[i]));
        }
        if let (Some(a), Some(b)) = (a.voxel.get(i), b.voxel.get(i))
            && a != b
        {
            fields.push(format!("voxel {a:?} / {b:?}"));
        }
        if !fields.is_empty() {
            n += 1;
            if n <= 5 {
                let (x, y) = (i % a.width as usize, i / a.width as usize);
                text += &format!("\n  pixel ({x}, {y}): {}", fields.join(", "));
            }
        }
    }
    if n == 0 { Ok(()) } else { Err(format!("{n} of {} pixels differ{text}", a.color.len())) }
}

/// Whether each pixel of a frame holds something a frame may hold: depth 0 or more and not NaN, alpha 255, and voxel
/// and depth agreeing on sky. If not, the first pixel that does not.
pub fn sane(frame: &Frame) -> Result<(), String> {
    let w = frame.width as usize;
    for (i, (&depth, color)) in frame.depth.iter().zip(&frame.color).enumerate() {
        let (x, y) = (i % w, i / w);
        if depth.is_nan() || depth < 0.0 {
            return Err(format!("pixel ({x}, {y}): depth {depth}"));
        }
        if color[3] != 255 {
            return Err(format!("pixel ({x}, {y}): alpha {}", color[3]));
        }
        if let Some(&voxel) = frame.voxel.get(i)
            && (voxel == SKY) != (depth == f32::INFINITY)
        {
            return Err(format!("pixel ({x}, {y}): voxel {voxel:?} at depth {depth}"));
        }
    }
    Ok(())
}

/// A frame with its columns in reverse order.
pub fn mirrored(frame: &Frame) -> Frame {
    let w = frame.width as usize;
    let mut out = frame.clone();
    out.color.chunks_mut(w).for_each(<[_]>::reverse);
    out.depth.chunks_mut(w).for_each(<[_]>::reverse);
    out.voxel.chunks_mut(w).for_each(<[_]>::reverse);
    out
}

/// A frame with each voxel that is not sky put through `map`.
pub fn with_voxels(frame: &Frame, map: impl Fn([i32; 4]) -> [i32; 4]) -> Frame {
    let mut out = frame.clone();
    out.voxel.iter_mut().filter(|v| **v != SKY).for_each(|v| *v = map(*v));
    out
}
