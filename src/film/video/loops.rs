//! Short films as pictures that move, for pages that show no video: animated PNG and GIF, played over and over.

use std::io::{self, Write};

use image::codecs::gif::{GifEncoder, Repeat};

use super::Rate;
use crate::Frame;
use crate::output::rgb;

fn other(e: impl std::error::Error + Send + Sync + 'static) -> io::Error {
    io::Error::other(e)
}

/// An animated PNG on its way: exact colours.
pub struct Apng<W: Write>(png::Writer<W>);

impl<W: Write> Apng<W> {
    /// For so many frames, no more and no less.
    pub fn new(out: W, [width, height]: [u32; 2], rate: Rate, frames: u32) -> io::Result<Apng<W>> {
        let mut encoder = png::Encoder::new(out, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Balanced);
        encoder.set_animated(frames, 0).map_err(other)?;
        // A fraction of 16 bits.
        let (frame, ticks) = match (u16::try_from(rate.frame), u16::try_from(rate.ticks)) {
            (Ok(frame), Ok(ticks)) => (frame, ticks),
            _ => (100, (100.0 * rate.fps()).round() as u16),
        };
        encoder.set_frame_delay(frame, ticks).map_err(other)?;
        Ok(Apng(encoder.write_header().map_err(other)?))
    }

    pub fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        self.0.write_image_data(&rgb(frame)).map_err(other)
    }

    pub fn finish(self) -> io::Result<()> {
        self.0.finish().map_err(other)
    }
}

/// A GIF on its way: 256 colours a frame, times in hundredths of a second.
pub struct Gif<W: Write> {
    encoder: GifEncoder<W>,
    rate: Rate,
    frames: u64,
}

/// Frames a second at most: programs show those that last less than two hundredths of a second much longer.
pub const GIF_FPS: f64 = 50.0;

impl<W: Write> Gif<W> {
    pub fn new(out: W, rate: Rate) -> io::Result<Gif<W>> {
        // Of 30, the fastest; 10 is usual.
        let mut encoder = GifEncoder::new_with_speed(out, 10);
        encoder.set_repeat(Repeat::Infinite).map_err(other)?;
        Ok(Gif { encoder, rate, frames: 0 })
    }

    pub fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        // Rounded so that the film as a whole keeps its pace.
        let until = |n: u64| (n as f64 * 100.0 / self.rate.fps()).round() as u32;
        let delay = until(self.frames + 1) - until(self.frames);
        self.frames += 1;
        let bytes = bytemuck::cast_slice(&frame.color).to_vec();
        let picture = image::RgbaImage::from_raw(frame.width, frame.height, bytes).expect("a frame is whole");
        let delay = image::Delay::from_numer_denom_ms(10 * delay, 1);
        self.encoder.encode_frame(image::Frame::from_parts(picture, 0, 0, delay)).map_err(other)
    }
}

#[cfg(test)]
mod tests {
    use image::AnimationDecoder;

    use super::*;

    fn frame(shade: u8) -> Frame {
        let color = (0..12).map(|i| [shade, i, 7, 255]).collect();
        Frame { width: 4, height: 3, color, depth: Vec::new(), voxel: Vec::new(), stats: crate::Stats::default() }
    }

    #[test]
    fn apng_keeps_every_pixel_and_its_pace() {
        let mut bytes = Vec::new();
        let mut film = Apng::new(&mut bytes, [4, 3], Rate::new(29.97), 3).unwrap();
        (0..3).for_each(|i| film.frame(&frame(i * 80)).unwrap());
        film.finish().unwrap();
        let decoder = image::codecs::png::PngDecoder::new(io::Cursor::new(&bytes)).unwrap();
        let frames = decoder.apng().unwrap().into_frames().collect_frames().unwrap();
        assert_eq!(frames.len(), 3);
        for (i, got) in frames.iter().enumerate() {
            assert_eq!(got.buffer().as_raw()[..], bytemuck::cast_slice::<_, u8>(&frame(i as u8 * 80).color)[..]);
            let (n, d) = got.delay().numer_denom_ms();
            assert!((f64::from(n) / f64::from(d) - 1001.0 / 30.0).abs() < 0.1, "{n}/{d} ms");
        }
    }

    #[test]
    fn gif_keeps_the_films_length() {
        let mut bytes = Vec::new();
        let mut film = Gif::new(&mut bytes, Rate::new(30.0)).unwrap();
        (0..30).for_each(|i| film.frame(&frame(i * 8)).unwrap());
        drop(film);
        let decoder = image::codecs::gif::GifDecoder::new(io::Cursor::new(&bytes)).unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        let ms: u32 = frames.iter().map(|f| f.delay().numer_denom_ms()).map(|(n, d)| n / d).sum();
        assert_eq!((frames.len(), ms), (30, 1000));
        assert_eq!(frames[2].buffer().get_pixel(3, 2).0, [16, 11, 7, 255], "few colours are kept as they are");
    }
}
