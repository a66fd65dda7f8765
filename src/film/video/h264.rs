//! H.264 by OpenH264: Constrained Baseline, which every player knows.

use mp4_atom::{Atom, Avcc};
use openh264::OpenH264API;
use openh264::encoder::{
    BitRate, Complexity, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange, RateControlMode,
    UsageType, VuiConfig,
};
use openh264::formats::YUVSource;
use openh264_sys2::{ENCODER_OPTION_TRACE_LEVEL, WELS_LOG_QUIET};
use planecast_encoder::{Error, Result};

use super::{Rate, Segment, Yuv};

/// Of 51, the coarsest.
const QUANTIZER: u8 = 21;

fn fault(what: impl std::fmt::Display) -> Error {
    Error::Limit(format!("the H.264 encoder cannot go on: {what}"))
}

impl YUVSource for &Yuv {
    fn dimensions(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn strides(&self) -> (usize, usize, usize) {
        (self.width, self.width / 2, self.width / 2)
    }

    fn y(&self) -> &[u8] {
        &self.y
    }

    fn u(&self) -> &[u8] {
        &self.u
    }

    fn v(&self) -> &[u8] {
        &self.v
    }
}

/// Encodes a segment on one core.
pub fn encode(rate: Rate, frames: &mut dyn Iterator<Item = Yuv>, done: &mut dyn FnMut(Yuv)) -> Result<Segment> {
    let config = EncoderConfig::new()
        // One quantizer for all: with rate control off, OpenH264 ignores it and takes 26; here the range leaves it no choice.
        .rate_control_mode(RateControlMode::Bitrate)
        // The rate says no more than the level that the film claims: 4.1 for all but large or fast ones.
        .bitrate(BitRate::from_bps(50_000_000))
        .qp(QpRange::new(QUANTIZER, QUANTIZER))
        .max_frame_rate(FrameRate::from_hz(rate.fps() as f32))
        // The only other kind for cameras is refused; screens' takes blocks that flights have not got.
        .usage_type(UsageType::CameraVideoRealTime)
        .complexity(Complexity::Low)
        // One key frame a segment, and every frame is there.
        .intra_frame_period(IntraFramePeriod::from_num_frames(0))
        .scene_change_detect(false)
        .skip_frames(false)
        .background_detection(false)
        .adaptive_quantization(false)
        .num_threads(1)
        .vui(VuiConfig::bt709());
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config).map_err(fault)?;
    let mut quiet = WELS_LOG_QUIET;
    // SAFETY: the option takes a number of this type, and copies it.
    let set = unsafe { encoder.raw_api().set_option(ENCODER_OPTION_TRACE_LEVEL, (&raw mut quiet).cast()) };
    if set != 0 {
        return Err(fault("it cannot be kept from talking"));
    }
    let mut segment = Segment { config: Vec::new(), sizes: Vec::new(), data: Vec::new() };
    let mut bytes = Vec::new();
    for yuv in frames {
        let stream = encoder.encode(&&yuv).map_err(fault)?;
        if (stream.frame_type() == FrameType::IDR) != segment.sizes.is_empty() {
            return Err(fault("key frames are not where they were asked for"));
        }
        bytes.clear();
        let [mut sps, mut pps] = [None, None];
        let nals = (0..stream.num_layers()).filter_map(|l| stream.layer(l));
        for nal in
            nals.flat_map(|layer| (0..layer.nal_count()).filter_map(move |n| layer.nal_unit(n).map(<[u8]>::to_vec)))
        {
            // MP4 has lengths where the stream has start codes, and parameter sets beside the frames.
            let zeros = nal.iter().take_while(|b| **b == 0).count();
            let nal = nal.get(zeros + 1..).filter(|n| !n.is_empty()).ok_or_else(|| fault("an empty unit"))?;
            match nal[0] & 31 {
                7 => sps = Some(nal.to_vec()),
                8 => pps = Some(nal.to_vec()),
                _ => {
                    bytes.extend_from_slice(&(nal.len() as u32).to_be_bytes());
                    bytes.extend_from_slice(nal);
                }
            }
        }
        if segment.sizes.is_empty() {
            let (Some(sps), Some(pps)) = (sps, pps) else { return Err(fault("it gave no parameter sets")) };
            let avcc = Avcc::new(&sps, &pps).map_err(fault)?;
            avcc.encode_body(&mut segment.config).map_err(fault)?;
        }
        if bytes.is_empty() {
            return Err(fault("it left a frame out"));
        }
        segment.push(&bytes);
        done(yuv);
    }
    Ok(segment)
}

#[cfg(test)]
mod tests {
    use openh264::decoder::Decoder;

    use super::*;

    /// Hills and grain, moving.
    fn picture(at: usize) -> Yuv {
        let (width, height) = (160, 96);
        let mut yuv = Yuv { width, height, y: Vec::new(), u: vec![100; 80 * 48], v: vec![150; 80 * 48] };
        let grain = |x: usize, y: usize| ((x * 7919) ^ (y * 104_729)) % 13;
        for y in 0..height {
            yuv.y.extend((0..width).map(|x| {
                let hill = ((x + 3 * at) as f64 / 9.0).sin() * 20.0 + (y as f64 / 7.0).cos() * 30.0;
                (110.0 + hill) as u8 + grain(x + 3 * at, y) as u8
            }));
        }
        yuv
    }

    #[test]
    fn film_decodes_to_its_pictures_at_40_db() {
        let frames: Vec<Yuv> = (0..6).map(picture).collect();
        let segment = encode(Rate::new(30.0), &mut frames.iter().cloned(), &mut |_| ()).unwrap();
        let avcc = Avcc::decode_body(&mut &segment.config[..]).unwrap();
        assert_eq!((avcc.avc_profile_indication, avcc.length_size), (66, 4), "Baseline");
        let mut decoder = Decoder::new().unwrap();
        let mut stream: Vec<u8> = Vec::new();
        for set in avcc.sequence_parameter_sets.iter().chain(&avcc.picture_parameter_sets) {
            stream.extend([0, 0, 0, 1]);
            stream.extend(set);
        }
        let mut left = &segment.data[..];
        for (frame, &size) in frames.iter().zip(&segment.sizes) {
            let (mut packet, rest) = left.split_at(size as usize);
            left = rest;
            while !packet.is_empty() {
                let (length, nal) = packet.split_at(4);
                let length = u32::from_be_bytes(length.try_into().unwrap()) as usize;
                stream.extend([0, 0, 0, 1]);
                stream.extend(&nal[..length]);
                packet = &nal[length..];
            }
            let picture = decoder.decode(&stream).unwrap().expect("a frame comes with each packet");
            stream.clear();
            assert_eq!(picture.dimensions(), (160, 96));
            let stride = picture.strides().0;
            let rows = picture.y().chunks(stride).zip(frame.y.chunks(160));
            let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
            let error: f64 = rows.map(|(a, b)| a.iter().zip(b).map(square).sum::<f64>()).sum();
            let psnr = 10.0 * (255.0f64.powi(2) * 160.0 * 96.0 / error).log10();
            assert!(psnr >= 40.0, "{psnr} dB");
        }
    }
}
