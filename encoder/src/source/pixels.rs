//! Colours of a map, kept in a file without a name, so that no map need fit into memory. A PNG is read row by row; a JPEG, and a
//! PNG that is interlaced or has 16 bits, is unpacked whole, 3 to 8 bytes a pixel, and let go.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

use super::geo::{Crs, Length, Place};
use super::{geotiff, heightmap, map};
use crate::store::scratch::{self, File as Unnamed, read_at, write_at};
use crate::{Error, Result, Rgb};

/// Where the bytes of an image come from.
pub(super) trait Stream: BufRead + Seek {}
impl<T: BufRead + Seek> Stream for T {}

/// The bytes of an input: read from its file where it has one, so that they do not count as memory in use.
pub(super) fn stream<'a>(path: &Path, bytes: &'a [u8], in_file: bool) -> Result<Box<dyn Stream + 'a>> {
    if !in_file {
        return Ok(Box::new(Cursor::new(bytes)));
    }
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    Ok(Box::new(BufReader::with_capacity(1 << 18, file)))
}

/// A PNG's size and form, before its rows.
pub(super) struct Png<'a> {
    reader: png::Reader<Box<dyn Stream + 'a>>,
    pub size: [u32; 2],
    pub color: png::ColorType,
    pub depth: png::BitDepth,
}

impl<'a> Png<'a> {
    /// None where it cannot be read row by row.
    pub fn open(path: &Path, bytes: Box<dyn Stream + 'a>, len: usize) -> Result<Option<Png<'a>>> {
        let mut decoder = png::Decoder::new(bytes);
        decoder.set_transformations(png::Transformations::EXPAND);
        let info = decoder.read_header_info().map_err(|e| failed(path, &e))?;
        let size = [info.width, info.height];
        heightmap::plausible(path, size[0], size[1], len)?;
        if info.interlaced {
            return Ok(None);
        }
        let reader = decoder.read_info().map_err(|e| failed(path, &e))?;
        let (color, depth) = reader.output_color_type();
        Ok(Some(Png { reader, size, color, depth }))
    }

    /// Calls `each` with the samples of each row.
    pub fn rows(mut self, path: &Path, mut each: impl FnMut(u32, &[u8]) -> Result<()>) -> Result<()> {
        let mut n = 0;
        while let Some(row) = self.reader.next_row().map_err(|e| failed(path, &e))? {
            each(n, row.data())?;
            n += 1;
        }
        if n == self.size[1] {
            Ok(())
        } else {
            Err(Error::format(path, format!("image: {n} rows of {}", self.size[1])))
        }
    }
}

fn failed(path: &Path, e: &png::DecodingError) -> Error {
    Error::format(path, format!("image: {e}"))
}

/// A picture of 8-bit colours.
pub(super) struct Pixels {
    pub width: u32,
    pub height: u32,
    /// Where it lies.
    pub place: Option<Place>,
    file: Unnamed,
}

fn failing(action: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |e| Error::io(std::env::temp_dir(), action, e)
}

impl Pixels {
    /// From a PNG, JPEG or TIFF file; a world file says where those lie that do not say it themselves.
    pub fn read(path: &Path) -> Result<Pixels> {
        let bytes = map(path)?;
        let file = scratch::file().map_err(failing("create a file in"))?;
        let put = |row: u32, width: u32, pixels: &[u8]| {
            write_at(&file, pixels, 3 * u64::from(row) * u64::from(width)).map_err(failing("write a file in"))
        };
        if bytes.starts_with(b"II") || bytes.starts_with(b"MM") {
            let put = |x: u32, z: u32, width: u32, pixels: &[u8]| {
                let at = u64::from(z) * u64::from(width) + u64::from(x);
                write_at(&file, pixels, 3 * at).map_err(failing("write a file in"))
            };
            let (place, [width, height]) = super::guarded(path, "TIFF", || geotiff::colors(path, &bytes, &put))?;
            return Ok(Pixels { width, height, place, file });
        }
        let affine = geotiff::world_file(path, &["pgw", "pngw", "jgw", "jpgw", "wld"]);
        let place = affine.map(|affine| Place { crs: Crs::lengths(Length::metre()), affine });
        let png = match bytes.starts_with(b"\x89PNG") {
            true => super::guarded(path, "image", || Png::open(path, stream(path, &bytes, true)?, bytes.len()))?,
            false => None,
        };
        // Of the samples of a pixel, those that are its colour.
        let channels = |png: &Png| match png.color {
            png::ColorType::Grayscale => Some((1, [0; 3])),
            png::ColorType::GrayscaleAlpha => Some((2, [0; 3])),
            png::ColorType::Rgb => Some((3, [0, 1, 2])),
            png::ColorType::Rgba => Some((4, [0, 1, 2])),
            png::ColorType::Indexed => None,
        };
        let in_rows = png.filter(|png| png.depth == png::BitDepth::Eight);
        let [width, height] = match in_rows.and_then(|png| channels(&png).map(|channels| (png, channels))) {
            Some((png, (n, of))) => {
                let size = png.size;
                super::guarded(path, "image", || {
                    png.rows(path, |row, samples| {
                        let pixels: Vec<u8> = samples.chunks_exact(n).flat_map(|p| of.map(|k| p[k])).collect();
                        put(row, size[0], &pixels)
                    })
                })?;
                size
            }
            None => {
                let image = heightmap::decode(path, &bytes)?.into_rgb8();
                let row = 3 * image.width() as usize;
                let mut rows = image.as_raw().chunks_exact(row).zip(0..);
                rows.try_for_each(|(pixels, z)| put(z, image.width(), pixels))?;
                [image.width(), image.height()]
            }
        };
        Ok(Pixels { width, height, place, file })
    }

    /// One pixel.
    pub fn pixel(&self, x: u32, z: u32) -> Result<Rgb> {
        let mut pixel = [0; 3];
        let at = 3 * (u64::from(z) * u64::from(self.width) + u64::from(x));
        read_at(&self.file, &mut pixel, at).map_err(failing("read a file in"))?;
        Ok(pixel)
    }

    /// Row `z`, all of it.
    pub fn row(&self, z: u32) -> Result<Vec<Rgb>> {
        let mut row = vec![[0; 3]; self.width as usize];
        let at = 3 * u64::from(z) * u64::from(self.width);
        read_at(&self.file, row.as_flattened_mut(), at).map_err(failing("read a file in"))?;
        Ok(row)
    }
}

#[cfg(test)]
mod tests {
    use image::{DynamicImage, ImageFormat};

    use super::*;

    #[test]
    fn pixels_of_every_form_are_those_of_the_image() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let base = DynamicImage::ImageRgba16(image::ImageBuffer::from_fn(7, 5, |x, z| {
            image::Rgba([x as u16 * 9001, z as u16 * 13_000, (x * z) as u16 * 2000, 65_535 - x as u16])
        }));
        for image in [
            DynamicImage::ImageRgb8(base.to_rgb8()),
            DynamicImage::ImageRgba8(base.to_rgba8()),
            DynamicImage::ImageLuma8(base.to_luma8()),
            DynamicImage::ImageLumaA8(base.to_luma_alpha8()),
            DynamicImage::ImageLuma16(base.to_luma16()),
            base.clone(),
        ] {
            image.save_with_format(&path, ImageFormat::Png).unwrap();
            let pixels = Pixels::read(&path).unwrap();
            let found: Vec<Rgb> = (0..5).flat_map(|z| pixels.row(z).unwrap()).collect();
            assert_eq!(
                (pixels.width, found.as_flattened()),
                (7, &image.to_rgb8().into_raw()[..]),
                "{:?}",
                image.color()
            );
            let good = std::fs::read(&path).unwrap();
            for n in 8..good.len() - 16 {
                std::fs::write(&path, &good[..n]).unwrap();
                assert!(Pixels::read(&path).is_err(), "cut to {n} of {}", good.len());
            }
        }
    }
}
