//! Films: H.264 or AV1 in MP4 without a program outside, Y4M, and pictures that move.
//!
//! A film is encoded in *segments* of [`segment_frames`] frames, each with a key frame at its start and nothing that
//! refers to another. So they are encoded side by side, one a core, joined without being encoded again, and a film that
//! was stopped goes on with the segments it has.
//!
//! Colour is BT.709, limited range, 4:2:0 with the mean of 2 × 2 pixels. Frames have an even number of columns and
//! rows, at least 16 each: a picture is padded at the right and the bottom by its last column and row.

#[cfg(feature = "av1")]
mod av1;
#[cfg(feature = "h264")]
mod h264;
pub mod loops;
pub mod mp4;
pub mod pipe;

use std::io::{self, Read, Write};
use std::str::FromStr;

use planecast_encoder::{Error, Result};

use crate::Frame;

/// Frames of a segment: small enough to keep all cores busy, large enough that key frames are few. Larger pictures
/// take smaller segments, as whole segments wait in memory.
pub fn segment_frames(width: u32, height: u32) -> usize {
    if u64::from(width) * u64::from(height) <= 1280 * 720 { 24 } else { 12 }
}

/// What a segment's bytes are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    H264,
    Av1,
}

/// What encodes a film.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Encoder {
    Built(Codec),
    /// The program ffmpeg, with these arguments for its output.
    Ffmpeg(Vec<String>),
}

impl Encoder {
    /// H.264 where it was built in, else AV1.
    pub fn usual() -> Encoder {
        Encoder::Built(if cfg!(feature = "h264") || !cfg!(feature = "av1") { Codec::H264 } else { Codec::Av1 })
    }

    /// Whether it can encode frames of this size here; the error says what to do instead.
    pub fn check(&self, [width, height]: [u32; 2]) -> Result<()> {
        let lacks = |name: &str| {
            let else_ = "name a folder for PNG frames, a .y4m file, or --encoder ffmpeg";
            Err(Error::Argument(format!("this planecast was built without its feature {name}; {else_}")))
        };
        match self {
            Encoder::Built(Codec::H264) if !cfg!(feature = "h264") => lacks("h264"),
            Encoder::Built(Codec::Av1) if !cfg!(feature = "av1") => lacks("av1"),
            Encoder::Built(Codec::H264) if width.max(height) > 3840 || width.min(height) > 2160 => {
                Err(Error::Limit(format!(
                    "film of {width} x {height} pixels: the H.264 encoder takes at most 3840 x 2160; try --encoder ffmpeg, \
                     --encoder av1, or a folder for PNG frames"
                )))
            }
            Encoder::Built(_) => Ok(()),
            Encoder::Ffmpeg(_) => pipe::check(),
        }
    }
}

impl FromStr for Encoder {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Encoder, String> {
        match text.split_once(':').unwrap_or((text, "")) {
            ("h264", "") => Ok(Encoder::Built(Codec::H264)),
            ("av1", "") => Ok(Encoder::Built(Codec::Av1)),
            ("ffmpeg", arguments) => Ok(Encoder::Ffmpeg(arguments.split_whitespace().map(str::to_owned).collect())),
            _ => Err(
                "expected h264, av1, or ffmpeg with arguments for its output, as in \"ffmpeg:-c:v libx265 -crf 20\""
                    .into(),
            ),
        }
    }
}

impl std::fmt::Display for Encoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Encoder::Built(Codec::H264) => f.write_str("h264"),
            Encoder::Built(Codec::Av1) => f.write_str("av1"),
            Encoder::Ffmpeg(arguments) => write!(f, "ffmpeg:{}", arguments.join(" ")),
        }
    }
}

/// Frames a second as a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate {
    /// Ticks a second.
    pub ticks: u32,
    /// Ticks that a frame lasts.
    pub frame: u32,
}

impl Rate {
    /// The usual fraction near `fps`: a whole number, or one over 1.001 as television has it; else thousandths.
    pub fn new(fps: f64) -> Rate {
        let near = |v: f64| (v - fps).abs() < 0.002;
        let whole = fps.round() as u32;
        let above = (fps * 1.001).round();
        if (f64::from(whole) - fps).abs() < 1e-9 {
            Rate { ticks: whole, frame: 1 }
        } else if near(above / 1.001) {
            Rate { ticks: above as u32 * 1000, frame: 1001 }
        } else {
            Rate { ticks: (fps * 1000.0).round() as u32, frame: 1000 }
        }
    }

    pub fn fps(self) -> f64 {
        f64::from(self.ticks) / f64::from(self.frame)
    }
}

/// A picture in 4:2:0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Yuv {
    /// Pixels, even.
    pub width: usize,
    /// Pixels, even.
    pub height: usize,
    pub y: Vec<u8>,
    pub u: Vec<u8>,
    pub v: Vec<u8>,
}

/// The size of a film's frames for a picture of `size` pixels.
pub fn padded(size: u32) -> usize {
    (size as usize).max(16).next_multiple_of(2)
}

impl Yuv {
    pub fn new(frame: &Frame) -> Yuv {
        let mut yuv = Yuv::default();
        yuv.fill(frame);
        yuv
    }

    /// Takes another frame's picture.
    pub fn fill(&mut self, frame: &Frame) {
        let (w, h) = (frame.width as usize, frame.height as usize);
        (self.width, self.height) = (padded(frame.width), padded(frame.height));
        let half = self.width / 2;
        self.y.resize(self.width * self.height, 0);
        self.u.resize(half * self.height / 2, 0);
        self.v.resize(half * self.height / 2, 0);
        let mut wide = [vec![[0; 4]; 0], vec![[0; 4]; 0]];
        let rows = self.y.chunks_exact_mut(2 * self.width);
        for (i, ((y, u), v)) in rows.zip(self.u.chunks_exact_mut(half)).zip(self.v.chunks_exact_mut(half)).enumerate() {
            let row = |k: usize| &frame.color[(2 * i + k).min(h - 1) * w..][..w];
            let (y0, y1) = y.split_at_mut(self.width);
            if w == self.width {
                two_rows([row(0), row(1)], [y0, y1], u, v);
                continue;
            }
            for (k, wide) in wide.iter_mut().enumerate() {
                wide.clear();
                wide.extend_from_slice(row(k));
                wide.resize(self.width, row(k)[w - 1]);
            }
            two_rows([&wide[0], &wide[1]], [y0, y1], u, v);
        }
    }
}

/// Two rows of pixels to two of luma and one of chroma each; of even length.
fn two_rows(rgb: [&[[u8; 4]]; 2], y: [&mut [u8]; 2], u: &mut [u8], v: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    {
        /// The same, compiled for wider registers: whole numbers, so the same bytes.
        #[target_feature(enable = "avx2")]
        fn wide(rgb: [&[[u8; 4]]; 2], y: [&mut [u8]; 2], u: &mut [u8], v: &mut [u8]) {
            two_rows_of(rgb, y, u, v);
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { wide(rgb, y, u, v) };
        }
    }
    two_rows_of(rgb, y, u, v);
}

#[inline(always)]
fn two_rows_of(rgb: [&[[u8; 4]]; 2], y: [&mut [u8]; 2], u: &mut [u8], v: &mut [u8]) {
    // Weights of BT.709 in 1/65536, scaled to 219 (luma) and 224 (chroma) steps of 255.
    for (rgb, y) in rgb.iter().zip(y) {
        for (c, y) in rgb.iter().zip(y.iter_mut()) {
            let [r, g, b, _] = c.map(i32::from);
            *y = (16 + ((11_966 * r + 40_254 * g + 4_064 * b + 32_768) >> 16)) as u8;
        }
    }
    let pairs = |row: usize| rgb[row].as_chunks::<2>().0.iter();
    for (((above, below), u), v) in pairs(0).zip(pairs(1)).zip(u.iter_mut()).zip(v.iter_mut()) {
        let sum = |i: usize| {
            i32::from(above[0][i]) + i32::from(above[1][i]) + i32::from(below[0][i]) + i32::from(below[1][i])
        };
        let (r, g, b) = (sum(0), sum(1), sum(2));
        *u = (128 + ((-6_596 * r - 22_189 * g + 28_785 * b + 131_072) >> 18)) as u8;
        *v = (128 + ((28_785 * r - 26_145 * g - 2_640 * b + 131_072) >> 18)) as u8;
    }
}

/// The head of a Y4M stream. Chroma lies between the pixels, as the mean of 2 × 2 does.
pub fn y4m_head(out: &mut impl Write, width: usize, height: usize, rate: Rate) -> io::Result<()> {
    let Rate { ticks, frame } = rate;
    writeln!(out, "YUV4MPEG2 W{width} H{height} F{ticks}:{frame} Ip A1:1 C420jpeg XCOLORRANGE=LIMITED")
}

/// A frame of a Y4M stream.
pub fn y4m_frame(out: &mut impl Write, yuv: &Yuv) -> io::Result<()> {
    out.write_all(b"FRAME\n")?;
    [&yuv.y, &yuv.u, &yuv.v].into_iter().try_for_each(|plane| out.write_all(plane))
}

/// Encoded frames, the first of which alone is a key frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// What decoders are set up by: the body of MP4's `avcC` or `av1C`.
    pub config: Vec<u8>,
    /// Bytes of each frame.
    pub sizes: Vec<u32>,
    /// The frames as MP4 holds them, one behind the other.
    pub data: Vec<u8>,
}

impl Segment {
    #[cfg(any(feature = "h264", feature = "av1"))]
    fn push(&mut self, bytes: &[u8]) {
        self.sizes.push(bytes.len() as u32);
        self.data.extend_from_slice(bytes);
    }
}

const MAGIC: &[u8; 8] = b"PCSEG2\r\n";

/// Stores a segment: a magic number, lengths of what follows (u32, little-endian: bytes of the setup, frames), the setup,
/// bytes of each frame (u32), the frames.
pub fn write_segment(out: &mut impl Write, segment: &Segment) -> io::Result<()> {
    out.write_all(MAGIC)?;
    out.write_all(&(segment.config.len() as u32).to_le_bytes())?;
    out.write_all(&(segment.sizes.len() as u32).to_le_bytes())?;
    out.write_all(&segment.config)?;
    segment.sizes.iter().try_for_each(|size| out.write_all(&size.to_le_bytes()))?;
    out.write_all(&segment.data)
}

/// Reads what [`write_segment`] wrote, all but the frames themselves; `None` for anything else. `length` is that of the
/// whole. The frames are its last bytes.
pub fn read_segment_head(mut file: impl Read, length: u64) -> Option<Segment> {
    let mut take = |n: u64| {
        let mut bytes = Vec::new();
        let got = file.by_ref().take(n).read_to_end(&mut bytes).ok()?;
        (got as u64 == n).then_some(bytes)
    };
    let head = take(16)?;
    let words = head.strip_prefix(MAGIC)?.as_chunks::<4>().0;
    let [config, frames] = [words[0], words[1]].map(u32::from_le_bytes);
    let config = take(config.into())?;
    let sizes = take(4 * u64::from(frames))?;
    let sizes: Vec<u32> = sizes.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
    let data: u64 = sizes.iter().map(|&s| u64::from(s)).sum();
    let whole = 16 + config.len() as u64 + 4 * sizes.len() as u64 + data;
    (whole == length).then_some(Segment { config, sizes, data: Vec::new() })
}

/// Encodes a segment on one core: up to `most` frames of `width` × `height` pixels. `done` gets each picture back.
pub fn encode(
    codec: Codec,
    [width, height]: [usize; 2],
    rate: Rate,
    most: usize,
    frames: &mut dyn Iterator<Item = Yuv>,
    done: &mut dyn FnMut(Yuv),
) -> Result<Segment> {
    _ = (width, height, rate, most, &frames, &done);
    match codec {
        #[cfg(feature = "h264")]
        Codec::H264 => h264::encode(rate, frames, done),
        #[cfg(feature = "av1")]
        Codec::Av1 => av1::encode([width, height], rate, most, frames, done),
        #[cfg(not(all(feature = "h264", feature = "av1")))]
        codec => Err(Error::Argument(format!("this planecast was built without the encoder {codec:?}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(width: u32, height: u32, color: impl Fn(u32, u32) -> [u8; 4]) -> Frame {
        let color: Vec<[u8; 4]> = (0..width * height).map(|i| color(i % width, i / width)).collect();
        let depth = vec![0.0; color.len()];
        Frame { width, height, color, depth, voxel: Vec::new(), stats: crate::Stats::default() }
    }

    #[test]
    fn yuv_of_the_primaries_is_that_of_bt709() {
        for (rgb, [y, u, v]) in [
            ([0, 0, 0, 255], [16, 128, 128]),
            ([255, 255, 255, 255], [235, 128, 128]),
            ([255, 0, 0, 255], [63, 102, 240]),
            ([0, 255, 0, 255], [173, 42, 26]),
            ([0, 0, 255, 255], [32, 240, 118]),
        ] {
            let yuv = Yuv::new(&frame(16, 16, |_, _| rgb));
            assert_eq!([yuv.y[0], yuv.u[0], yuv.v[0]], [y, u, v], "{rgb:?}");
        }
    }

    /// Against the weights of BT.709 themselves, in f64.
    #[test]
    fn yuv_is_within_a_step_of_bt709_and_the_same_without_wide_registers() {
        let mut seed = 1u32;
        let mut random = move || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 24) as u8
        };
        let noise: Vec<[u8; 4]> = (0..70 * 38).map(|_| [random(), random(), random(), 255]).collect();
        let picture = frame(70, 38, |x, y| noise[(y * 70 + x) as usize]);
        let yuv = Yuv::new(&picture);
        for y in (0..38).step_by(2) {
            for x in (0..70).step_by(2) {
                let at = |x: usize, y: usize| noise[y * 70 + x].map(f64::from);
                let luma = |[r, g, b, _]: [f64; 4]| 0.2126 * r + 0.7152 * g + 0.0722 * b;
                let own = at(x, y);
                let near = |got: u8, right: f64| assert!((f64::from(got) - right).abs() < 0.51, "{got} for {right}");
                near(yuv.y[y * 70 + x], 16.0 + luma(own) * 219.0 / 255.0);
                let four = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
                let mean: [f64; 4] = std::array::from_fn(|i| four.iter().map(|p| p[i]).sum::<f64>() / 4.0);
                let i = y / 2 * 35 + x / 2;
                near(yuv.u[i], 128.0 + (mean[2] - luma(mean)) / 1.8556 * 224.0 / 255.0);
                near(yuv.v[i], 128.0 + (mean[0] - luma(mean)) / 1.5748 * 224.0 / 255.0);
            }
        }
        let mut plain = Yuv { y: vec![0; 140], u: vec![0; 35], v: vec![0; 35], ..yuv.clone() };
        let (y0, y1) = plain.y.split_at_mut(70);
        two_rows_of([&noise[..70], &noise[70..140]], [y0, y1], &mut plain.u, &mut plain.v);
        assert_eq!((&plain.y[..], &plain.u[..], &plain.v[..]), (&yuv.y[..140], &yuv.u[..35], &yuv.v[..35]));
    }

    #[test]
    fn yuv_pads_to_even_sizes_of_at_least_sixteen() {
        let yuv = Yuv::new(&frame(17, 3, |x, y| [(x * 10) as u8, (y * 80) as u8, 0, 255]));
        assert_eq!((yuv.width, yuv.height, yuv.y.len(), yuv.u.len()), (18, 16, 18 * 16, 9 * 8));
        assert_eq!(yuv.y[17], yuv.y[16], "the last column is repeated");
        assert_eq!(yuv.y[15 * 18..], yuv.y[2 * 18..3 * 18], "the last row is repeated");
    }

    #[test]
    fn rate_is_the_usual_fraction() {
        let rate = |fps| {
            let Rate { ticks, frame } = Rate::new(fps);
            (ticks, frame)
        };
        assert_eq!((rate(30.0), rate(12.0), rate(240.0)), ((30, 1), (12, 1), (240, 1)));
        assert_eq!((rate(29.97), rate(23.976), rate(59.94)), ((30_000, 1001), (24_000, 1001), (60_000, 1001)));
        assert_eq!((rate(12.5), rate(1.5)), ((12_500, 1000), (1500, 1000)));
    }

    #[test]
    fn encoder_is_read_from_a_word() {
        let read = |text: &str| text.parse::<Encoder>().map(|e| e.to_string());
        for text in ["h264", "av1", "ffmpeg:", "ffmpeg:-c:v libx265 -crf 20"] {
            assert_eq!(read(text).as_deref(), Ok(text));
        }
        assert_eq!(read("ffmpeg").as_deref(), Ok("ffmpeg:"));
        assert!(read("h264:3").is_err() && read("x264").unwrap_err().starts_with("expected h264, av1, or ffmpeg"));
    }

    #[test]
    fn segment_survives_a_round_trip_and_no_damage() {
        let segment = Segment { config: vec![7; 9], sizes: vec![3, 0, 300], data: vec![5; 303] };
        let mut bytes = Vec::new();
        write_segment(&mut bytes, &segment).unwrap();
        let head = |bytes: &[u8]| read_segment_head(bytes, bytes.len() as u64);
        assert_eq!(head(&bytes), Some(Segment { data: Vec::new(), ..segment }));
        assert!((0..bytes.len()).all(|n| head(&bytes[..n]).is_none()), "a cut segment is not one");
        bytes.push(0);
        assert_eq!(head(&bytes), None, "nor is one with something behind it");
    }

    #[cfg(any(feature = "h264", feature = "av1"))]
    #[test]
    fn film_has_a_frame_a_picture_and_one_key_a_segment() {
        let frames: Vec<Yuv> =
            (0..5).map(|i| Yuv::new(&frame(33, 20, |x, y| [(x * 7 + i * 9) as u8, (y * 12) as u8, 90, 255]))).collect();
        let rate = Rate::new(29.97);
        for codec in [Codec::H264, Codec::Av1] {
            if Encoder::Built(codec).check([33, 20]).is_err() {
                continue; // built without it
            }
            let mut back = 0;
            let mut segment = |frames: &[Yuv]| {
                let mut frames = frames.iter().cloned();
                encode(codec, [34, 20], rate, frames.len(), &mut frames, &mut |_| back += 1).unwrap()
            };
            let segments = [segment(&frames[..3]), segment(&frames[3..])];
            assert_eq!((back, segments[0].sizes.len(), segments[1].sizes.len()), (5, 3, 2));
            assert_eq!(segments[0].config, segments[1].config, "one setup for all");
            for segment in &segments {
                let whole = segment.sizes.iter().sum::<u32>() as usize;
                assert!(segment.data.len() == whole && segment.sizes.iter().all(|&s| s > 0), "{:?}", segment.sizes);
            }
        }
    }
}
