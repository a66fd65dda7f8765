//! The error map: where a frame shows another voxel than the exact reference.

use crate::cpu::traverse::SKY;
use crate::frame::picture::Frame;
use crate::measure::compare::{Agreement, compare};

/// Another voxel, and none within a pixel; another voxel, the reference's within a pixel; sky in one alone.
const WRONG: [u8; 4] = [230, 40, 40, 255];
const NEAR: [u8; 4] = [250, 200, 40, 255];
const SKY_ALONE: [u8; 4] = [220, 60, 220, 255];

/// What the colours mean, for the screen.
pub const LEGEND: &str = "red: another voxel; yellow: the right one within a pixel; violet: sky in one alone; \
                          grey: as exact, or a coarser level that holds it";

/// A picture of where two frames with voxels differ, and how far they agree.
pub fn error_map(frame: &Frame, reference: &Frame) -> (Vec<[u8; 4]>, Agreement) {
    let (w, h) = (frame.width as usize, frame.height as usize);
    let agreement = compare(frame, reference);
    let holds = |v: [i32; 4], r: [i32; 4]| {
        v == r || (v != SKY && r != SKY && v[3] >= r[3] && (0..3).all(|a| v[a] >> v[3] == r[a] >> v[3]))
    };
    let pixel = |i: usize| {
        let (x, y) = (i % w, i / w);
        let v = frame.voxel[i];
        if holds(v, reference.voxel[i]) {
            let [r, g, b, _] = reference.color[i].map(u32::from);
            let grey = ((2 * r + 5 * g + b) / 16) as u8;
            return [grey, grey, grey, 255];
        }
        if (v == SKY) != (reference.voxel[i] == SKY) {
            return SKY_ALONE;
        }
        let around = |v: usize, n: usize| v.saturating_sub(1)..(v + 2).min(n);
        let near = around(y, h).any(|y| around(x, w).any(|x| holds(v, reference.voxel[y * w + x])));
        if near { NEAR } else { WRONG }
    };
    ((0..w * h).map(pixel).collect(), agreement)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::picture::Stats;

    fn frame(voxel: Vec<[i32; 4]>) -> Frame {
        let n = voxel.len();
        let color = vec![[80, 80, 80, 255]; n];
        Frame { width: 4, height: n as u32 / 4, color, depth: vec![1.0; n], voxel, stats: Stats::default() }
    }

    #[test]
    fn error_map_marks_each_kind_of_planted_fault() {
        let right: Vec<[i32; 4]> = (0..16).map(|i| [10 * i, 3, 5, 0]).collect();
        let reference = frame(right.clone());
        let (clean, agreement) = error_map(&reference, &reference);
        assert!(clean.iter().all(|c| *c == [40, 40, 40, 255]) && agreement.same == 16);
        let mut planted = right.clone();
        planted[5] = [999, 0, 0, 0];
        planted[6] = right[7];
        planted[9] = SKY;
        planted[12] = [120, 2, 4, 1]; // the cell of level 1 that holds 120, 3, 5
        let (map, agreement) = error_map(&frame(planted), &reference);
        let expected = |i: usize| match i {
            5 => WRONG,
            6 => NEAR,
            9 => SKY_ALONE,
            _ => [40, 40, 40, 255],
        };
        assert!((0..16).all(|i| map[i] == expected(i)), "{map:?}");
        assert_eq!((agreement.same, agreement.sky), (12, 1));
    }
}
