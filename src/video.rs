//! Films: AV1 in MP4, without a program outside.
//!
//! A film is encoded in *segments* of [`segment_frames`] frames, each with a key frame at its start and nothing that
//! refers to another. So they are encoded side by side, one a core, and a film that was stopped goes on with the
//! segments it has.
//!
//! Colour is BT.709, limited range, 4:2:0 with the mean of 2 × 2 pixels. Frames have an even number of columns and
//! rows, at least 16 each: a picture is padded at the right and the bottom by its last column and row.

use std::io::{self, Read, Write};

use planecast_encoder::{Error, Result};

use crate::Frame;

/// Frames of a segment: small enough to keep all cores busy, large enough that key frames are few. Larger pictures
/// take smaller segments, as whole segments wait in memory.
pub fn segment_frames(width: u32, height: u32) -> usize {
    if u64::from(width) * u64::from(height) <= 1280 * 720 { 24 } else { 12 }
}

/// A picture in 4:2:0.
#[derive(Clone, Debug, PartialEq)]
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
        let (w, h) = (frame.width as usize, frame.height as usize);
        let (width, height) = (padded(frame.width), padded(frame.height));
        let pixel = |x: usize, y: usize| frame.color[y.min(h - 1) * w + x.min(w - 1)].map(i32::from);
        // Weights of BT.709 in 1/65536, scaled to 219 (luma) and 224 (chroma) steps of 255.
        let luma = |[r, g, b, _]: [i32; 4]| (16 + ((11_966 * r + 40_254 * g + 4_064 * b + 32_768) >> 16)) as u8;
        let mut yuv = Yuv { width, height, y: Vec::with_capacity(width * height), u: Vec::new(), v: Vec::new() };
        for y in 0..height {
            yuv.y.extend((0..width).map(|x| luma(pixel(x, y))));
        }
        for y in (0..height).step_by(2) {
            for x in (0..width).step_by(2) {
                let four = [pixel(x, y), pixel(x + 1, y), pixel(x, y + 1), pixel(x + 1, y + 1)];
                let [r, g, b] = std::array::from_fn(|i| four.iter().map(|p| p[i]).sum::<i32>());
                let chroma = |r_weight: i32, g_weight: i32, b_weight: i32| {
                    (128 + ((r_weight * r + g_weight * g + b_weight * b + 131_072) >> 18)) as u8
                };
                yuv.u.push(chroma(-6_596, -22_189, 28_785));
                yuv.v.push(chroma(28_785, -26_145, -2_640));
            }
        }
        yuv
    }
}

/// One encoded frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Packet {
    pub key: bool,
    /// AV1 open bitstream units of one shown frame, without the temporal delimiter (MP4 has none).
    pub data: Vec<u8>,
}

const MAGIC: &[u8; 8] = b"PCSEG1\r\n";

/// Stores a segment: a magic number, the count of packets, then each as length · 2 + key flag (u32, little-endian)
/// and its bytes.
pub fn write_segment(out: &mut impl Write, packets: &[Packet]) -> io::Result<()> {
    out.write_all(MAGIC)?;
    out.write_all(&(packets.len() as u32).to_le_bytes())?;
    for p in packets {
        out.write_all(&((p.data.len() as u32) << 1 | u32::from(p.key)).to_le_bytes())?;
        out.write_all(&p.data)?;
    }
    Ok(())
}

/// Reads what [`write_segment`] wrote; `None` for anything else.
pub fn read_segment(mut bytes: &[u8]) -> Option<Vec<Packet>> {
    fn word(bytes: &mut &[u8]) -> Option<u32> {
        let mut word = [0; 4];
        bytes.read_exact(&mut word).ok()?;
        Some(u32::from_le_bytes(word))
    }
    bytes = bytes.strip_prefix(MAGIC)?;
    let count = word(&mut bytes)?;
    let mut packets = Vec::new();
    for _ in 0..count {
        let head = word(&mut bytes)?;
        let (data, rest) = bytes.split_at_checked((head >> 1) as usize)?;
        packets.push(Packet { key: head & 1 == 1, data: data.to_vec() });
        bytes = rest;
    }
    bytes.is_empty().then_some(packets)
}

/// Encodes a segment on one core; `on_frame` is called for every frame that is done.
///
/// Settings were chosen by measuring, on the 96 frames of the demo's film (640 × 360, 12 a second); CPU time without
/// SIMD assembly, 5 s of it for the drawing:
///
/// | tuned for | frames in | CDEF | speed | quantizer | s | MB | PSNR, dB, mean (least) |
/// | --- | --- | --- | --- | --- | --- | --- | --- |
/// | PSNR | order | off | 10 | 80 | 19 | 3.5 | 35.4 (35.0) |
/// | PSNR | order | off | 10 | 100 | 18 | 2.7 | 34.1 (33.6) |
/// | PSNR | order | on | 10 | 100 | 23 | 2.7 | 34.2 (33.7) |
/// | PSNR | order | on | 10 | 80 | 25 | 3.5 | 35.4 (35.0) |
/// | the eye | a pyramid | on | 10 | 50 | 44 | 3.7 | 35.7 (34.2) |
/// | the eye | a pyramid | on | 9 | 50 | 67 | 3.5 | 35.8 (34.3) |
#[cfg(feature = "av1")]
pub fn encode(frames: &[Yuv], fps: f64, on_frame: &mut dyn FnMut()) -> Result<Vec<Packet>> {
    /// Of 10, the fastest.
    const SPEED: u8 = 10;
    /// Of 255, the coarsest.
    const QUANTIZER: usize = 80;
    use rav1e::prelude::{
        ColorDescription, ColorPrimaries, Config, Context, EncoderConfig, EncoderStatus, FrameType, MatrixCoefficients,
        Rational, SceneDetectionSpeed, TransferCharacteristics, Tune,
    };

    let Some(first) = frames.first() else { return Ok(Vec::new()) };
    let fault = |what: String| Error::Limit(format!("the AV1 encoder cannot go on: {what}"));
    let mut config = EncoderConfig::with_speed_preset(SPEED);
    config.width = first.width;
    config.height = first.height;
    config.time_base = Rational { num: 1000, den: (fps * 1000.0).round() as u64 };
    config.color_description = Some(ColorDescription {
        color_primaries: ColorPrimaries::BT709,
        transfer_characteristics: TransferCharacteristics::BT709,
        matrix_coefficients: MatrixCoefficients::BT709,
    });
    config.quantizer = QUANTIZER;
    config.tune = Tune::Psnr;
    config.low_latency = true; // frames in order, none that waits for a later one
    config.speed_settings.cdef = false;
    // One key frame a segment: neither a scene change nor a full interval makes another.
    config.min_key_frame_interval = frames.len() as u64;
    config.max_key_frame_interval = frames.len() as u64;
    config.speed_settings.scene_detection_mode = SceneDetectionSpeed::None;
    let mut context: Context<u8> =
        Config::new().with_encoder_config(config).with_threads(1).new_context().map_err(|e| fault(e.to_string()))?;

    let mut packets = Vec::with_capacity(frames.len());
    let mut drain = |context: &mut Context<u8>| loop {
        match context.receive_packet() {
            Ok(packet) => {
                const TEMPORAL_DELIMITER: &[u8] = &[0x12, 0x00];
                let data = packet.data.strip_prefix(TEMPORAL_DELIMITER).unwrap_or(&packet.data).to_vec();
                packets.push(Packet { key: packet.frame_type == FrameType::KEY, data });
                on_frame();
            }
            Err(EncoderStatus::Encoded) => {}
            Err(EncoderStatus::NeedMoreData | EncoderStatus::LimitReached) => return Ok(()),
            Err(e) => return Err(fault(e.to_string())),
        }
    };
    for yuv in frames {
        let mut frame = context.new_frame();
        frame.planes[0].copy_from_raw_u8(&yuv.y, yuv.width, 1);
        frame.planes[1].copy_from_raw_u8(&yuv.u, yuv.width / 2, 1);
        frame.planes[2].copy_from_raw_u8(&yuv.v, yuv.width / 2, 1);
        context.send_frame(frame).map_err(|e| fault(e.to_string()))?;
        drain(&mut context)?;
    }
    context.flush();
    drain(&mut context)?;
    if packets.len() != frames.len() {
        return Err(fault(format!("it gave {} frames for {}", packets.len(), frames.len())));
    }
    Ok(packets)
}

/// Puts encoded frames into an MP4 file, its index before its data.
#[cfg(feature = "av1")]
pub fn mux(out: &mut impl Write, packets: &[Packet], width: u32, height: u32, fps: f64) -> io::Result<()> {
    use muxide::api::{MuxerBuilder, MuxerError, VideoCodec};

    let fault = |e: MuxerError| match e {
        MuxerError::Io(e) => e,
        e => io::Error::other(e.to_string()),
    };
    let (width, height) = (padded(width) as u32, padded(height) as u32);
    let mut muxer = MuxerBuilder::new(out).video(VideoCodec::Av1, width, height, fps).build().map_err(fault)?;
    for (i, packet) in packets.iter().enumerate() {
        muxer.write_video(i as f64 / fps, &packet.data, packet.key).map_err(fault)?;
    }
    muxer.finish().map_err(fault)
}

#[cfg(not(feature = "av1"))]
fn no_av1() -> Error {
    Error::Argument("this planecast was built without its feature av1; name a folder for PNG frames instead".into())
}

/// This build has no AV1 encoder.
#[cfg(not(feature = "av1"))]
pub fn encode(_: &[Yuv], _: f64, _: &mut dyn FnMut()) -> Result<Vec<Packet>> {
    Err(no_av1())
}

/// This build has no AV1 encoder.
#[cfg(not(feature = "av1"))]
pub fn mux(_: &mut impl Write, _: &[Packet], _: u32, _: u32, _: f64) -> io::Result<()> {
    Err(io::Error::other(no_av1().to_string()))
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

    #[test]
    fn yuv_pads_to_even_sizes_of_at_least_sixteen() {
        let yuv = Yuv::new(&frame(17, 3, |x, y| [(x * 10) as u8, (y * 80) as u8, 0, 255]));
        assert_eq!((yuv.width, yuv.height, yuv.y.len(), yuv.u.len()), (18, 16, 18 * 16, 9 * 8));
        assert_eq!(yuv.y[17], yuv.y[16], "the last column is repeated");
        assert_eq!(yuv.y[15 * 18..], yuv.y[2 * 18..3 * 18], "the last row is repeated");
    }

    #[test]
    fn segment_survives_a_round_trip_and_no_damage() {
        let packets = vec![
            Packet { key: true, data: vec![1, 2, 3] },
            Packet { key: false, data: vec![] },
            Packet { key: false, data: vec![9; 300] },
        ];
        let mut bytes = Vec::new();
        write_segment(&mut bytes, &packets).unwrap();
        assert_eq!(read_segment(&bytes), Some(packets));
        assert!((0..bytes.len()).all(|n| read_segment(&bytes[..n]).is_none()), "a cut segment is not one");
        bytes.push(0);
        assert_eq!(read_segment(&bytes), None, "nor is one with something behind it");
    }

    #[cfg(feature = "av1")]
    #[test]
    fn film_has_a_packet_a_frame_and_one_key_a_segment() {
        let frames: Vec<Yuv> =
            (0..5).map(|i| Yuv::new(&frame(33, 20, |x, y| [(x * 7 + i * 9) as u8, (y * 12) as u8, 90, 255]))).collect();
        let mut done = 0;
        let mut packets = encode(&frames[..3], 30.0, &mut || done += 1).unwrap();
        packets.extend(encode(&frames[3..], 30.0, &mut || done += 1).unwrap());
        assert_eq!(
            (done, packets.iter().map(|p| p.key).collect::<Vec<_>>()),
            (5, vec![true, false, false, true, false])
        );
        let mut file = Vec::new();
        mux(&mut file, &packets, 33, 20, 29.97).unwrap();
        assert_eq!(&file[4..8], b"ftyp");
        let find = |name: &[u8]| file.windows(4).position(|w| w == name).unwrap();
        assert!(find(b"moov") < find(b"mdat"), "the index comes first");
        let stsz = find(b"stsz");
        assert_eq!(file[stsz + 12..stsz + 16], 5u32.to_be_bytes(), "five samples");
    }
}
