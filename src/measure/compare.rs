//! How far a frame agrees with a reference, voxel by voxel.

use crate::cpu::traverse::SKY;
use crate::frame::picture::Frame;

/// Agreement of a frame with a reference of the same size, both with voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    pub pixels: usize,
    /// Pixels that show the reference's voxel, level included, or sky as it does.
    pub same: usize,
    /// Pixels that show what the reference shows there or in one of the 8 pixels around.
    pub near: usize,
    /// As `same` and `near`, but a voxel of a coarser level also agrees with each voxel of the reference that it holds.
    pub held: usize,
    pub held_near: usize,
    /// Pixels that show a voxel of a coarser level than 0.
    pub coarser: usize,
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

/// How far two pictures differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Difference {
    /// Pixels that are not the same.
    pub pixels: usize,
    /// Greatest difference of one channel.
    pub greatest: u8,
    /// The first such pixel, as its place in the picture.
    pub first: Option<usize>,
}

/// How far two pictures of the same size differ, byte by byte.
pub fn pictures(a: &[[u8; 4]], b: &[[u8; 4]]) -> Difference {
    assert_eq!(a.len(), b.len(), "pictures differ in size");
    let mut difference = Difference::default();
    for (i, (a, b)) in a.iter().zip(b).enumerate().filter(|(_, (a, b))| a != b) {
        difference.pixels += 1;
        difference.first.get_or_insert(i);
        let channels = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0);
        difference.greatest = difference.greatest.max(channels);
    }
    difference
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
        let anywhere = |agrees: &dyn Fn([i32; 4]) -> bool| {
            around(y, h).any(|y| around(x, w).any(|x| agrees(reference.voxel[y * w + x])))
        };
        let near = voxel == reference.voxel[i] || anywhere(&|v| v == voxel);
        agreement.near += usize::from(near);
        agreement.held += usize::from(holds(voxel, reference.voxel[i]));
        agreement.held_near += usize::from(near || anywhere(&|v| holds(voxel, v)));
        agreement.coarser += usize::from(voxel[3] > 0);
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

/// Whether `voxel`, of any level, is `other` or has it inside.
fn holds(voxel: [i32; 4], other: [i32; 4]) -> bool {
    if voxel == SKY || other == SKY || other[3] > voxel[3] {
        return voxel == other;
    }
    let size = 1i64 << voxel[3];
    (0..3).all(|i| (0..size).contains(&(i64::from(other[i]) - i64::from(voxel[i]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_knows_levels_and_sky() {
        assert!(holds([4, 8, -4, 2], [7, 8, -1, 0]) && holds([4, 8, -4, 2], [4, 8, -4, 2]) && holds(SKY, SKY));
        for other in [[8, 8, -4, 0], [3, 8, -4, 0], [4, 12, -4, 0], [4, 8, 0, 0], [0, 8, -4, 3], SKY] {
            assert!(!holds([4, 8, -4, 2], other), "{other:?}");
        }
        assert!(!holds(SKY, [0, 0, 0, 0]) && !holds([-1, -1, -1, 0], SKY));
    }
}
