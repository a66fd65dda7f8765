//! How far two frames agree.

use planecast::Frame;

const SKY: [i32; 4] = [-1; 4];

/// Agreement of a frame with a reference of the same size, both with voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    pub pixels: usize,
    /// Pixels that show the reference's voxel, level included, or sky as it does.
    pub same: usize,
    /// Pixels that show what the reference shows there or in one of the 8 pixels around.
    pub near: usize,
    /// Pixels where one of the two alone shows sky.
    pub sky: usize,
    /// Greatest relative error of depth where both show the same voxel, and at which pixel (column, row).
    pub depth: f64,
    pub depth_at: [usize; 2],
}

impl Agreement {
    /// Shares of pixels, in percent.
    pub fn same_percent(&self) -> f64 {
        100.0 * self.same as f64 / self.pixels as f64
    }

    pub fn near_percent(&self) -> f64 {
        100.0 * self.near as f64 / self.pixels as f64
    }
}

impl std::fmt::Display for Agreement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (same, near) = (self.same_percent(), self.near_percent());
        write!(f, "same {same:7.3} %  near {near:7.3} %  sky {:4}  depth {:.1e}", self.sky, self.depth)
    }
}

/// How far `frame` agrees with `reference`.
pub fn compare(frame: &Frame, reference: &Frame) -> Agreement {
    assert_eq!((frame.width, frame.height), (reference.width, reference.height), "frames differ in size");
    let (w, h) = (frame.width as usize, frame.height as usize);
    let mut agreement = Agreement { pixels: w * h, ..Agreement::default() };
    for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
        let i = y * w + x;
        let voxel = frame.voxel[i];
        agreement.sky += usize::from((voxel == SKY) != (reference.voxel[i] == SKY));
        if voxel == reference.voxel[i] {
            agreement.same += 1;
            let error = depth_error(frame.depth[i], reference.depth[i]);
            if error > agreement.depth {
                (agreement.depth, agreement.depth_at) = (error, [x, y]);
            }
        }
        let around = |v: usize, n: usize| v.saturating_sub(1)..(v + 2).min(n);
        let near = around(y, h).any(|y| around(x, w).any(|x| reference.voxel[y * w + x] == voxel));
        agreement.near += usize::from(near);
    }
    agreement
}

/// Relative to the reference; 0 where both are the same infinity, infinite where only one is or either is not a number.
fn depth_error(depth: f32, reference: f32) -> f64 {
    let (a, b) = (f64::from(depth), f64::from(reference));
    if a == b {
        return 0.0;
    }
    let error = (a - b).abs() / b.abs();
    if error.is_finite() { error } else { f64::INFINITY }
}

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
