//! How far a picture is from the truth: voxels, depth, and the shaded colour by PSNR, SSIM and FLIP.

use crate::frame::picture::Frame;
use crate::measure::compare::compare;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How far one picture is from the truth. Shares are percent of all pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Pixels that show neither the truth's voxel nor a coarser one that holds it.
    pub other: f64,
    /// The same after looking for it in the 3 × 3 pixels of the truth around.
    pub other_near: f64,
    /// Pixels that do not show the truth's voxel at level 0, and the same in 3 × 3 pixels.
    pub other_level0: f64,
    pub other_level0_near: f64,
    /// Pixels that show a coarser level than 0.
    pub coarser: f64,
    /// Pixels where one of the two alone shows sky.
    pub sky: f64,
    /// Error of depth where neither shows sky, voxels: median, 99th percentile, greatest.
    pub depth: [f64; 3],
    /// The same, relative to the truth's depth.
    pub depth_relative: [f64; 3],
    /// Mean squared error of the sRGB channels, 0 to 1.
    pub mse: f64,
    /// Of luma, 1 for equal pictures (Wang et al. 2004: Gaussian window, σ 1.5 pixels, 11 × 11).
    pub ssim: f64,
    /// Mean of FLIP, 0 for equal pictures to 1 (Andersson et al. 2020).
    pub flip: f64,
    /// The same against the truth with one ray a pixel: without the error of aliasing.
    pub flip_exact: f64,
}

impl Errors {
    /// Peak signal to noise, decibels; infinite for equal pictures.
    pub fn psnr(&self) -> f64 {
        -10.0 * self.mse.log10()
    }
}

/// What pictures of one camera are compared with.
pub struct Truth {
    /// One ray a pixel: voxels and depths.
    pub frame: Frame,
    /// Several rays a pixel, averaged in linear light.
    pub color: Vec<[u8; 4]>,
    flip: FlipImage,
    flip_exact: FlipImage,
}

impl Truth {
    /// From one f64 ray a pixel, with voxels, and a picture `n` times as wide and high.
    pub fn new(frame: Frame, supersampled: &Frame) -> Truth {
        let n = (supersampled.width / frame.width) as usize;
        let (w, wide) = (frame.width as usize, supersampled.width as usize);
        let mut color = vec![[0; 4]; frame.color.len()];
        for (i, color) in color.iter_mut().enumerate() {
            let (x, y) = (i % w * n, i / w * n);
            let part = (0..n * n).map(|k| linear(supersampled.color[(y + k / n) * wide + x + k % n]));
            *color = srgb(part.sum::<Vec3>() / (n * n) as f32);
        }
        let [flip, flip_exact] = [&color, &frame.color].map(|c| FlipImage::new(c, w));
        Truth { frame, color, flip, flip_exact }
    }

    /// Compares a frame of the same size, with voxels.
    pub fn errors(&self, frame: &Frame) -> Errors {
        let agreement = compare(frame, &self.frame);
        let n = agreement.pixels as f64;
        let image = FlipImage::new(&frame.color, frame.width as usize);
        let missing = |agreeing: usize| 100.0 * (n - agreeing as f64) / n;
        let (mut depth, mut relative): (Vec<f64>, Vec<f64>) = (frame.depth.iter().zip(&self.frame.depth))
            .filter(|(d, t)| d.is_finite() && t.is_finite())
            .map(|(d, t)| {
                let error = f64::from((d - t).abs());
                (error, error / f64::from(t.max(1e-3)))
            })
            .unzip();
        Errors {
            other: missing(agreement.held),
            other_near: missing(agreement.held_near),
            other_level0: missing(agreement.same),
            other_level0_near: missing(agreement.near),
            coarser: 100.0 * agreement.coarser as f64 / n,
            sky: 100.0 * agreement.sky as f64 / n,
            depth: spread(&mut depth),
            depth_relative: spread(&mut relative),
            mse: mse(&frame.color, &self.color),
            ssim: ssim(&frame.color, &self.color, frame.width as usize),
            flip: image.mean(&self.flip),
            flip_exact: image.mean(&self.flip_exact),
        }
    }

    /// FLIP of each pixel, 0 to 1.
    pub fn flip(&self, color: &[[u8; 4]]) -> Vec<f32> {
        flip(&FlipImage::new(color, self.frame.width as usize), &self.flip)
    }
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64
}

/// Median, 99th percentile and greatest; 0 of nothing.
pub(crate) fn spread(values: &mut [f64]) -> [f64; 3] {
    values.sort_unstable_by(f64::total_cmp);
    [0.5, 0.99, 1.0].map(|q| match values.len() {
        0 => 0.0,
        n => values[((n - 1) as f64 * q).round() as usize],
    })
}

fn linear(c: [u8; 4]) -> Vec3 {
    Vec3::from([c[0], c[1], c[2]].map(|v| {
        let v = f32::from(v) / 255.0;
        if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    }))
}

fn srgb(c: Vec3) -> [u8; 4] {
    let [r, g, b] = c.to_array().map(|v| {
        let v = if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
    });
    [r, g, b, 255]
}

fn mse(a: &[[u8; 4]], b: &[[u8; 4]]) -> f64 {
    let square = |(a, b): (&[u8; 4], &[u8; 4])| {
        (0..3).map(|i| ((f64::from(a[i]) - f64::from(b[i])) / 255.0).powi(2)).sum::<f64>()
    };
    a.iter().zip(b).map(square).sum::<f64>() / (3 * a.len()) as f64
}

/// A filter along one axis: weights at −r ..= r.
struct Kernel(Vec<f32>);

impl Kernel {
    fn new(radius: i32, weight: impl Fn(f32) -> f32) -> Kernel {
        Kernel((-radius..=radius).map(|x| weight(x as f32)).collect())
    }

    fn gaussian(radius: i32, sigma: f32) -> Kernel {
        let mut k = Kernel::new(radius, |x| (-x * x / (2.0 * sigma * sigma)).exp());
        let sum: f32 = k.0.iter().sum();
        k.0.iter_mut().for_each(|w| *w /= sum);
        k
    }

    /// Positive weights that sum to 1 and negative ones that sum to −1.
    fn balanced(mut self) -> Kernel {
        let sum = |sign: f32| self.0.iter().map(|w| (w * sign).max(0.0)).sum::<f32>();
        let (positive, negative) = (sum(1.0), sum(-1.0));
        self.0.iter_mut().for_each(|w| *w /= if *w > 0.0 { positive } else { negative });
        self
    }
}

/// Filters rows with `x`, then columns with `y`; beyond the border the border's pixels stand again.
fn filter(image: &[f32], width: usize, x: &Kernel, y: &Kernel) -> Vec<f32> {
    let height = image.len() / width;
    let mut rows = vec![0.0; image.len()];
    rows.par_chunks_mut(width).zip(image.par_chunks(width)).for_each(|(out, row)| {
        let r = x.0.len() / 2;
        for (at, out) in out.iter_mut().enumerate() {
            let place = |k: usize| (at + k).saturating_sub(r).min(width - 1);
            *out = x.0.iter().enumerate().map(|(k, w)| w * row[place(k)]).sum();
        }
    });
    let mut done = vec![0.0; image.len()];
    done.par_chunks_mut(width).enumerate().for_each(|(at, out)| {
        let r = y.0.len() / 2;
        for (k, w) in y.0.iter().enumerate() {
            let row = (at + k).saturating_sub(r).min(height - 1);
            for (out, v) in out.iter_mut().zip(&rows[row * width..]) {
                *out += w * v;
            }
        }
    });
    done
}

/// Mean structural similarity of luma. Wang et al., *Image Quality Assessment: From Error Visibility to Structural
/// Similarity*, 2004.
fn ssim(a: &[[u8; 4]], b: &[[u8; 4]], width: usize) -> f64 {
    let luma = |image: &[[u8; 4]]| -> Vec<f32> {
        image
            .iter()
            .map(|c| (0.299 * f32::from(c[0]) + 0.587 * f32::from(c[1]) + 0.114 * f32::from(c[2])) / 255.0)
            .collect()
    };
    let (a, b) = (luma(a), luma(b));
    let window = Kernel::gaussian(5, 1.5);
    let blur = |v: &[f32]| filter(v, width, &window, &window);
    let product = |a: &[f32], b: &[f32]| blur(&a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>());
    let (mean_a, mean_b) = (blur(&a), blur(&b));
    let (aa, bb, ab) = (product(&a, &a), product(&b, &b), product(&a, &b));
    let (c1, c2) = (0.01f32.powi(2), 0.03f32.powi(2));
    let sum: f64 = (0..a.len())
        .map(|i| {
            let (ma, mb) = (mean_a[i], mean_b[i]);
            let (va, vb, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
            f64::from((2.0 * ma * mb + c1) * (2.0 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2)))
        })
        .sum();
    sum / a.len() as f64
}

/// Pixels that a degree of sight covers, as FLIP takes them: a monitor 0.7 m wide with 3840 pixels seen from 0.7 m.
const PIXELS_PER_DEGREE: f32 = 67.020_65;

/// A picture as FLIP compares it.
pub(crate) struct FlipImage {
    width: usize,
    /// L*a*b* of what the eye resolves, a* and b* scaled by lightness (Hunt).
    lab: Vec<Vec3>,
    /// Edge and point strength.
    features: Vec<[f32; 2]>,
}

/// D65, as the sum of the rows of [`xyz`].
const WHITE: Vec3 = Vec3::new(0.950_428_5, 1.0, 1.088_900_4);

fn xyz(c: Vec3) -> Vec3 {
    Vec3::new(
        Vec3::new(0.412_390_8, 0.357_584_35, 0.180_480_8).dot(c),
        Vec3::new(0.212_639, 0.715_168_7, 0.072_192_32).dot(c),
        Vec3::new(0.019_330_818, 0.119_194_78, 0.950_532_15).dot(c),
    )
}

fn rgb(c: Vec3) -> Vec3 {
    Vec3::new(
        Vec3::new(3.240_97, -1.537_383_2, -0.498_610_76).dot(c),
        Vec3::new(-0.969_243_64, 1.875_967_5, 0.041_555_06).dot(c),
        Vec3::new(0.055_630_08, -0.203_976_96, 1.056_971_5).dot(c),
    )
}

/// Linear RGB to YCxCz, linear opponent colours.
fn opponents(c: Vec3) -> Vec3 {
    let c = xyz(c) / WHITE;
    Vec3::new(116.0 * c.y - 16.0, 500.0 * (c.x - c.y), 200.0 * (c.y - c.z))
}

fn from_opponents(c: Vec3) -> Vec3 {
    let y = (c.x + 16.0) / 116.0;
    rgb(Vec3::new(y + c.y / 500.0, y, y - c.z / 200.0) * WHITE)
}

/// Linear RGB to L*a*b* with a* and b* scaled by lightness.
fn hunt_lab(c: Vec3) -> Vec3 {
    let f = |v: f32| if v > 0.008_856_452 { v.cbrt() } else { v / 0.128_418_55 + 4.0 / 29.0 };
    let [x, y, z] = (xyz(c) / WHITE).to_array().map(f);
    let l = 116.0 * y - 16.0;
    Vec3::new(l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z))
}

fn hyab(a: Vec3, b: Vec3) -> f32 {
    let d = a - b;
    d.x.abs() + d.y.hypot(d.z)
}

impl FlipImage {
    pub(crate) fn new(color: &[[u8; 4]], width: usize) -> FlipImage {
        let ppd = PIXELS_PER_DEGREE;
        let pi2 = std::f32::consts::PI.powi(2);
        let image: Vec<Vec3> = color.par_iter().map(|&c| opponents(linear(c))).collect();
        let channel = |i: usize| image.iter().map(|c| c[i]).collect::<Vec<f32>>();
        // Contrast sensitivity: sums of a · √(π/b) · exp(−π²d²/b) with d in degrees, all cut at the widest one's 3 σ.
        let radius = (3.0 * (0.04f32 / (2.0 * pi2)).sqrt() * ppd).ceil() as i32;
        let gaussian = |b: f32| Kernel::new(radius, |x| (-pi2 * (x / ppd).powi(2) / b).exp());
        let blur = |channel: &[f32], parts: &[[f32; 2]]| {
            let mut out = vec![0.0; channel.len()];
            let mut total = 0.0;
            for &[a, b] in parts {
                let kernel = gaussian(b);
                let weight = a * (std::f32::consts::PI / b).sqrt();
                total += weight * kernel.0.iter().sum::<f32>().powi(2);
                let part = filter(channel, width, &kernel, &kernel);
                out.iter_mut().zip(part).for_each(|(o, v)| *o += weight * v);
            }
            out.iter_mut().for_each(|o| *o /= total);
            out
        };
        let y = channel(0);
        let seen = [
            blur(&y, &[[1.0, 0.0047]]),
            blur(&channel(1), &[[1.0, 0.0053]]),
            blur(&channel(2), &[[34.1, 0.04], [13.5, 0.025]]),
        ];
        let lab = (0..color.len())
            .into_par_iter()
            .map(|i| {
                let c = from_opponents(Vec3::new(seen[0][i], seen[1][i], seen[2][i]));
                hunt_lab(c.clamp(Vec3::ZERO, Vec3::ONE))
            })
            .collect();

        let gray: Vec<f32> = y.iter().map(|y| (y + 16.0) / 116.0).collect();
        let sigma = 0.5 * 0.082 * ppd;
        let radius = (3.0 * sigma).ceil() as i32;
        let bell = move |x: f32| (-x * x / (2.0 * sigma * sigma)).exp();
        let across = Kernel::gaussian(radius, sigma);
        let edge = Kernel::new(radius, move |x| -x * bell(x)).balanced();
        let point = Kernel::new(radius, move |x| (x * x / (sigma * sigma) - 1.0) * bell(x)).balanced();
        let strength = |along: &Kernel| {
            let (x, y) = (filter(&gray, width, along, &across), filter(&gray, width, &across, along));
            x.into_iter().zip(y).map(|(x, y)| x.hypot(y)).collect::<Vec<f32>>()
        };
        let features = strength(&edge).into_iter().zip(strength(&point)).map(|(e, p)| [e, p]).collect();
        FlipImage { width, lab, features }
    }

    /// Mean FLIP between two pictures of one size, 0 to 1.
    pub(crate) fn mean(&self, other: &FlipImage) -> f64 {
        mean(&flip(self, other))
    }
}

/// FLIP of each pixel. Andersson et al., *FLIP: A Difference Evaluator for Alternating Images*, 2020.
fn flip(a: &FlipImage, b: &FlipImage) -> Vec<f32> {
    assert_eq!((a.width, a.lab.len()), (b.width, b.lab.len()), "pictures differ in size");
    const POWER: f32 = 0.7;
    const CUT: f32 = 0.4;
    const CUT_TO: f32 = 0.95;
    let most = hyab(hunt_lab(Vec3::Y), hunt_lab(Vec3::Z)).powf(POWER);
    (0..a.lab.len())
        .into_par_iter()
        .map(|i| {
            let d = hyab(a.lab[i], b.lab[i]).powf(POWER);
            let cut = CUT * most;
            let color = if d < cut { CUT_TO / cut * d } else { CUT_TO + (d - cut) / (most - cut) * (1.0 - CUT_TO) };
            let feature = (0..2).map(|k| (a.features[i][k] - b.features[i][k]).abs()).fold(0.0, f32::max);
            let feature = (feature / std::f32::consts::SQRT_2).sqrt();
            color.powf(1.0 - feature).clamp(0.0, 1.0)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seeded blocks of colour, 64 × 48.
    fn picture(seed: u32) -> Vec<[u8; 4]> {
        let hash = |x: u32, y: u32| (x * 0x9E37 + y * 0x85EB + seed * 0xC2B2).wrapping_mul(0x27D4_EB2F) >> 8;
        (0..64 * 48).map(|i| hash(i % 64 / 5, i / 64 / 4).to_le_bytes()).map(|[r, g, b, _]| [r, g, b, 255]).collect()
    }

    fn flip_of(a: &[[u8; 4]], b: &[[u8; 4]]) -> f64 {
        FlipImage::new(a, 64).mean(&FlipImage::new(b, 64))
    }

    #[test]
    fn metrics_of_equal_pictures_are_perfect() {
        let a = picture(1);
        assert_eq!((mse(&a, &a), flip_of(&a, &a)), (0.0, 0.0));
        assert!((ssim(&a, &a, 64) - 1.0).abs() < 1e-5);
        assert_eq!(Errors::default().psnr(), f64::INFINITY);
    }

    #[test]
    fn metrics_grow_worse_with_the_fault() {
        let a = picture(1);
        let dimmed = |by: u8| -> Vec<[u8; 4]> { a.iter().map(|c| c.map(|v| v - v / by)).collect() };
        let figures = |b: &[[u8; 4]]| [mse(&a, b), 1.0 - ssim(&a, b, 64), flip_of(&a, b)];
        let order = [figures(&dimmed(50)), figures(&dimmed(10)), figures(&dimmed(3)), figures(&picture(2))];
        for pair in order.windows(2) {
            assert!((0..3).all(|i| pair[0][i] < pair[1][i]), "{order:?}");
        }
        let mut shifted = a.clone();
        shifted.rotate_right(1);
        assert!(figures(&shifted)[2] > 0.05 && figures(&shifted)[1] > 0.05, "{:?}", figures(&shifted));
    }

    /// nv-flip 0.1.2, the authors' code, gives 0.788052 at 67 pixels a degree.
    #[test]
    fn flip_is_that_of_its_authors() {
        let flip = flip_of(&picture(1), &picture(2));
        assert!((flip - 0.788_05).abs() < 1e-4, "{flip}");
    }

    #[test]
    fn ssim_and_mse_have_their_closed_values_on_flat_pictures() {
        let (a, b) = (vec![[100, 100, 100, 255]; 400], vec![[151, 151, 151, 255]; 400]);
        let (x, y) = (100.0 / 255.0, 151.0 / 255.0);
        let expected = (2.0 * x * y + 1e-4) / (x * x + y * y + 1e-4);
        assert!((ssim(&a, &b, 20) - expected).abs() < 1e-4);
        assert!((mse(&a, &b) - 0.04).abs() < 1e-12);
    }

    #[test]
    fn depth_spread_is_median_p99_and_greatest() {
        let mut values: Vec<f64> = (0..=100).rev().map(f64::from).collect();
        assert_eq!(spread(&mut values), [50.0, 99.0, 100.0]);
        assert_eq!(spread(&mut []), [0.0; 3]);
    }

    #[test]
    fn truth_averages_in_linear_light() {
        let frame = |n: u32, color: Vec<[u8; 4]>| Frame {
            width: n,
            height: n,
            depth: vec![1.0; color.len()],
            voxel: vec![[0; 4]; color.len()],
            color,
            stats: crate::Stats::default(),
        };
        let four = [[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 255], [0, 0, 0, 255]];
        let truth = Truth::new(frame(1, vec![[9, 9, 9, 255]]), &frame(2, four.to_vec()));
        assert_eq!(truth.color, [[188, 188, 188, 255]]);
    }
}
