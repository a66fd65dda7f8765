//! AV1 by rav1e, at its fastest.

use planecast_encoder::{Error, Result};
use rav1e::prelude::{
    ColorDescription, ColorPrimaries, Config, Context, EncoderConfig, EncoderStatus, FrameType, MatrixCoefficients,
    Rational, SceneDetectionSpeed, TransferCharacteristics, Tune,
};

use super::{Rate, Segment, Yuv};

/// Of 10, the fastest.
const SPEED: u8 = 10;
/// Of 255, the coarsest.
const QUANTIZER: usize = 80;

fn fault(what: impl std::fmt::Display) -> Error {
    Error::Limit(format!("the AV1 encoder cannot go on: {what}"))
}

/// Encodes a segment on one core.
///
/// Settings were chosen by measuring, on 96 frames of 640 × 360, 12 a second, of the demo's flight; CPU time without SIMD
/// assembly, 5 s of it for the drawing:
///
/// | tuned for | frames in | CDEF | speed | quantizer | s | MB | PSNR, dB, mean (least) |
/// | --- | --- | --- | --- | --- | --- | --- | --- |
/// | PSNR | order | off | 10 | 80 | 19 | 3.5 | 35.4 (35.0) |
/// | PSNR | order | off | 10 | 100 | 18 | 2.7 | 34.1 (33.6) |
/// | PSNR | order | on | 10 | 100 | 23 | 2.7 | 34.2 (33.7) |
/// | PSNR | order | on | 10 | 80 | 25 | 3.5 | 35.4 (35.0) |
/// | the eye | a pyramid | on | 10 | 50 | 44 | 3.7 | 35.7 (34.2) |
/// | the eye | a pyramid | on | 9 | 50 | 67 | 3.5 | 35.8 (34.3) |
pub fn encode(
    [width, height]: [usize; 2],
    rate: Rate,
    most: usize,
    frames: &mut dyn Iterator<Item = Yuv>,
    done: &mut dyn FnMut(Yuv),
) -> Result<Segment> {
    let mut config = EncoderConfig::with_speed_preset(SPEED);
    (config.width, config.height) = (width, height);
    config.time_base = Rational { num: rate.frame.into(), den: rate.ticks.into() };
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
    config.min_key_frame_interval = most as u64;
    config.max_key_frame_interval = most as u64;
    config.speed_settings.scene_detection_mode = SceneDetectionSpeed::None;
    let mut context: Context<u8> =
        Config::new().with_encoder_config(config).with_threads(1).new_context().map_err(fault)?;

    let mut segment = Segment { config: context.container_sequence_header(), sizes: Vec::new(), data: Vec::new() };
    let mut drain = |context: &mut Context<u8>| loop {
        match context.receive_packet() {
            Ok(packet) => {
                // MP4 has none.
                const TEMPORAL_DELIMITER: &[u8] = &[0x12, 0x00];
                if (packet.frame_type == FrameType::KEY) != segment.sizes.is_empty() {
                    return Err(fault("key frames are not where they were asked for"));
                }
                segment.push(packet.data.strip_prefix(TEMPORAL_DELIMITER).unwrap_or(&packet.data));
            }
            Err(EncoderStatus::Encoded) => {}
            Err(EncoderStatus::NeedMoreData | EncoderStatus::LimitReached) => return Ok(()),
            Err(e) => return Err(fault(e)),
        }
    };
    let mut sent = 0;
    for yuv in frames {
        let mut frame = context.new_frame();
        frame.planes[0].copy_from_raw_u8(&yuv.y, yuv.width, 1);
        frame.planes[1].copy_from_raw_u8(&yuv.u, yuv.width / 2, 1);
        frame.planes[2].copy_from_raw_u8(&yuv.v, yuv.width / 2, 1);
        context.send_frame(frame).map_err(fault)?;
        sent += 1;
        drain(&mut context)?;
        done(yuv);
    }
    context.flush();
    drain(&mut context)?;
    match segment.sizes.len() {
        n if n == sent => Ok(segment),
        n => Err(fault(format!("it gave {n} frames for {sent}"))),
    }
}
