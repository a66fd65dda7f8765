//! Counts differences between two pictures of one view, by kind, and says where the first ones are.

use planecast::Frame;
use std::fmt;

/// Differences between two frames, in pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Difference {
    pub pixels: usize,
    /// Another voxel (or level, or sky instead of one).
    pub voxel: usize,
    /// Another voxel than any within one pixel in the other frame.
    pub voxel_far: usize,
    /// The same voxel at a depth more than 10⁻⁴ apart, relative.
    pub depth: usize,
    /// The same voxel, a channel of its colour more than 2 apart.
    pub color: usize,
    /// The first few, in words.
    pub first: Vec<String>,
}

impl Difference {
    /// Share of pixels that show the same voxel.
    pub fn same(&self) -> f64 {
        1.0 - self.voxel as f64 / self.pixels as f64
    }

    /// Share of pixels that show a voxel which the other frame has within one pixel.
    pub fn near(&self) -> f64 {
        1.0 - self.voxel_far as f64 / self.pixels as f64
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Difference { pixels, voxel, voxel_far, depth, color, first } = self;
        write!(f, "of {pixels} pixels {voxel} voxels ({voxel_far} far), {depth} depths, {color} colours differ")?;
        first.iter().try_for_each(|line| write!(f, "\n  {line}"))
    }
}

/// Compares voxel, depth and colour of each pixel; both frames must have voxels.
pub fn compare(a: &Frame, b: &Frame) -> Difference {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let n = a.width as usize * a.height as usize;
    for frame in [a, b] {
        assert_eq!([frame.color.len(), frame.depth.len(), frame.voxel.len()], [n; 3], "a frame is whole");
    }
    let mut out = Difference { pixels: n, ..Difference::default() };
    let (w, h) = (a.width as i64, a.height as i64);
    for i in 0..n {
        let (x, y) = (i as i64 % w, i as i64 / w);
        let mut note = |kind: &str, what: String| {
            if out.first.len() < 5 {
                out.first.push(format!("({x}, {y}) {kind}: {what}"));
            }
        };
        if a.voxel[i] != b.voxel[i] {
            note("voxel", format!("{:?} at {} against {:?} at {}", a.voxel[i], a.depth[i], b.voxel[i], b.depth[i]));
            out.voxel += 1;
            let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            let found = around
                .filter(|&(x, y)| (0..w).contains(&x) && (0..h).contains(&y))
                .any(|(x, y)| b.voxel[(y * w + x) as usize] == a.voxel[i]);
            out.voxel_far += usize::from(!found);
            continue;
        }
        let (za, zb) = (a.depth[i], b.depth[i]);
        let close = (za - zb).abs() <= 1e-4 * zb.abs().max(1e-3);
        if za != zb && !close {
            note("depth", format!("{za} against {zb}"));
            out.depth += 1;
        }
        let (ca, cb) = (a.color[i], b.color[i]);
        if (0..4).any(|c| ca[c].abs_diff(cb[c]) > 2) {
            note("colour", format!("{ca:?} against {cb:?}"));
            out.color += 1;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use planecast::Stats;

    fn frame() -> Frame {
        let n = 12;
        Frame {
            width: 4,
            height: 3,
            color: vec![[9, 8, 7, 255]; n],
            depth: vec![2.0; n],
            voxel: (0..n as i32).map(|i| [i, 1, 2, 0]).collect(),
            stats: Stats::default(),
        }
    }

    #[test]
    fn compare_finds_nothing_in_equal_frames() {
        let d = compare(&frame(), &frame());
        assert_eq!((d.voxel, d.voxel_far, d.depth, d.color), (0, 0, 0, 0));
    }

    #[test]
    fn compare_finds_each_planted_fault() {
        let plant = |fault: fn(&mut Frame)| {
            let mut planted = frame();
            fault(&mut planted);
            let d = compare(&planted, &frame());
            assert_eq!(d.first.len(), 1, "{d}");
            (d.voxel, d.voxel_far, d.depth, d.color)
        };
        assert_eq!(plant(|f| f.voxel[5][3] = 1), (1, 1, 0, 0));
        assert_eq!(plant(|f| f.voxel[5] = [6, 1, 2, 0]), (1, 0, 0, 0));
        assert_eq!(plant(|f| f.voxel[5] = [11, 1, 2, 0]), (1, 1, 0, 0), "two pixels away");
        assert_eq!(plant(|f| f.depth[5] = 2.001), (0, 0, 1, 0));
        assert_eq!(plant(|f| f.depth[5] = f32::INFINITY), (0, 0, 1, 0));
        assert_eq!(plant(|f| f.depth[5] = f32::NAN), (0, 0, 1, 0));
        assert_eq!(plant(|f| f.color[5][3] = 0), (0, 0, 0, 1));
    }

    #[test]
    #[should_panic(expected = "a frame is whole")]
    fn compare_refuses_frames_without_voxels() {
        let mut planted = frame();
        planted.voxel.clear();
        compare(&planted, &frame());
    }
}
