//! Pictures on the triangles of a mesh.

use std::collections::HashMap;
use std::path::Path;

use super::mesh::Mesh;
use crate::model::srgb::{LINEAR, Mean, from_linear};
use crate::{Result, Rgb};

/// What lies beyond a picture's edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Wrap {
    Repeat,
    Clamp,
    Mirror,
}

impl Wrap {
    /// The pixel of `n` at `at`, in widths of the picture.
    fn pixel(self, at: f64, n: usize) -> usize {
        let n = n as i64;
        let i = (at * n as f64).floor() as i64;
        let i = match self {
            Wrap::Repeat => i.rem_euclid(n),
            Wrap::Clamp => i.clamp(0, n - 1),
            Wrap::Mirror => {
                let i = i.rem_euclid(2 * n);
                i.min(2 * n - 1 - i)
            }
        };
        i as usize
    }
}

#[derive(Clone, Debug)]
struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
    /// How opaque each pixel is; empty where all are.
    alphas: Vec<u8>,
}

impl Picture {
    /// Half the size, each pixel the mean of four in linear light; at odd edges of the two or the one that there are.
    fn half(&self) -> Picture {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut pixels = Vec::with_capacity(width * height);
        let mut alphas = Vec::new();
        for (z, x) in (0..height).flat_map(|z| (0..width).map(move |x| (z, x))) {
            let mut mean = Mean::default();
            for row in 2 * z..self.height.min(2 * z + 2) {
                let row = &self.pixels[row * self.width..][..self.width];
                row[2 * x..self.width.min(2 * x + 2)].iter().for_each(|&c| mean.add(c));
            }
            pixels.push(mean.get().expect("at least one pixel"));
            if !self.alphas.is_empty() {
                let rows =
                    (2 * z..self.height.min(2 * z + 2)).map(|row| &self.alphas[row * self.width..][..self.width]);
                let (mut sum, mut n) = (0, 0);
                for &alpha in rows.flat_map(|row| &row[2 * x..self.width.min(2 * x + 2)]) {
                    (sum, n) = (sum + u32::from(alpha), n + 1);
                }
                alphas.push(((sum + n / 2) / n) as u8);
            }
        }
        Picture { width, height, pixels, alphas }
    }
}

/// A picture in all its sizes.
#[derive(Clone, Debug)]
pub(super) struct Texture {
    levels: Vec<Picture>,
    wrap: [Wrap; 2],
}

impl Texture {
    /// From the bytes of a PNG or JPEG; `path` is what errors call it. How opaque pixels are is kept where `holes` says so.
    pub fn read(path: &Path, bytes: &[u8], wrap: [Wrap; 2], holes: bool) -> Result<Texture> {
        let image = super::heightmap::decode(path, bytes)?;
        let alphas = match holes && image.color().has_alpha() {
            true => image.to_rgba8().pixels().map(|p| p.0[3]).collect(),
            false => Vec::new(),
        };
        let image = image.into_rgb8();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut levels = vec![Picture { width, height, pixels: image.pixels().map(|p| p.0).collect(), alphas }];
        while let Some(last) = levels.last().filter(|p| p.width > 1 || p.height > 1) {
            levels.push(last.half());
        }
        Ok(Texture { levels, wrap })
    }

    /// The size to take where so many pixels of the whole picture fall on a voxel: that with one, or nearest to it.
    pub fn level(&self, pixels_a_voxel: f64) -> usize {
        let (mut left, mut level) = (pixels_a_voxel, 0);
        while left > 2.0 && level + 1 < self.levels.len() {
            (left, level) = (left / 4.0, level + 1);
        }
        level
    }

    /// Pixels of the whole picture.
    pub fn pixels(&self) -> f64 {
        self.levels[0].pixels.len() as f64
    }

    fn pixel(&self, picture: &Picture, [u, v]: [f64; 2]) -> usize {
        self.wrap[1].pixel(v, picture.height) * picture.width + self.wrap[0].pixel(u, picture.width)
    }

    /// How opaque the pixel at a place is, 1 where all light is kept.
    pub fn alpha(&self, level: usize, place: [f64; 2]) -> f64 {
        let picture = &self.levels[level];
        match picture.alphas.is_empty() {
            true => 1.0,
            false => f64::from(picture.alphas[self.pixel(picture, place)]) / 255.0,
        }
    }

    /// The pixel at `(u, v)`, v down, times `tint`, in linear light.
    pub fn color(&self, level: usize, [u, v]: [f64; 2], tint: Rgb) -> Rgb {
        let picture = &self.levels[level];
        let pixel = picture.pixels[self.pixel(picture, [u, v])];
        let light = |c: u8| f64::from(LINEAR[c as usize]);
        [0, 1, 2].map(|k| from_linear(light(pixel[k]) * light(tint[k])))
    }
}

/// The pictures of a mesh under construction, by name, each read once.
#[derive(Default)]
pub(super) struct Textures(HashMap<(String, [Wrap; 2], bool), Option<u32>>);

impl Textures {
    /// Number of a picture in `mesh`, read where it is new; None, with a word of it, where it cannot be read.
    pub fn number(
        &mut self,
        mesh: &mut Mesh,
        name: String,
        wrap: [Wrap; 2],
        holes: bool,
        read: impl FnOnce() -> Result<Texture>,
    ) -> Option<u32> {
        *self.0.entry((name, wrap, holes)).or_insert_with(|| match read() {
            Ok(texture) => {
                mesh.textures.push(texture);
                Some(mesh.textures.len() as u32 - 1)
            }
            Err(e) => {
                mesh.about.left_out.push(format!("a texture is left out: {e}"));
                None
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_pixels_repeat_mirror_and_end_at_edges() {
        let at = |wrap: Wrap| [-0.7, -0.2, 0.2, 0.7, 1.2, 1.7].map(|u| wrap.pixel(u, 2));
        assert_eq!(at(Wrap::Repeat), [0, 1, 0, 1, 0, 1]);
        assert_eq!(at(Wrap::Clamp), [0, 0, 0, 1, 1, 1]);
        assert_eq!(at(Wrap::Mirror), [1, 0, 0, 1, 1, 0]);
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for u in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e-300] {
                assert!(wrap.pixel(u, 3) < 3);
            }
        }
    }

    #[test]
    fn texture_sizes_are_means_down_to_one_pixel() {
        let mut png = std::io::Cursor::new(Vec::new());
        let board = image::RgbImage::from_fn(6, 3, |x, z| image::Rgb([255 * ((x + z) % 2) as u8, 7, 0]));
        board.write_to(&mut png, image::ImageFormat::Png).unwrap();
        let texture = Texture::read(Path::new("a.png"), png.get_ref(), [Wrap::Repeat; 2], false).unwrap();
        let sizes: Vec<_> = texture.levels.iter().map(|p| (p.width, p.height)).collect();
        assert_eq!(sizes, [(6, 3), (3, 2), (2, 1), (1, 1)]);
        assert_eq!(texture.levels[1].pixels, [[188, 7, 0]; 6]);
        assert_eq!([0.5, 1.0, 2.0, 3.0, 8.0, 9.0, 1e9].map(|n| texture.level(n)), [0, 0, 0, 1, 1, 2, 3]);
        assert_eq!(texture.color(0, [0.2, 0.1], [255, 0, 255]), [255, 0, 0]);
    }

    #[test]
    fn texture_is_as_opaque_as_its_pixels_where_that_is_asked_for() {
        let mut png = std::io::Cursor::new(Vec::new());
        let board = image::RgbaImage::from_fn(3, 1, |x, _| image::Rgba([9, 9, 9, [0, 100, 51][x as usize]]));
        board.write_to(&mut png, image::ImageFormat::Png).unwrap();
        let read = |holes| Texture::read(Path::new("a.png"), png.get_ref(), [Wrap::Repeat; 2], holes).unwrap();
        let at = |level, u| (read(true).alpha(level, [u, 0.5]) * 255.0).round();
        assert_eq!([0.1, 0.5, 0.9].map(|u| at(0, u)), [0.0, 100.0, 51.0]);
        assert_eq!([0.1, 0.9].map(|u| at(1, u)), [50.0, 51.0]);
        assert_eq!(read(false).alpha(0, [0.1, 0.5]), 1.0);
        assert_eq!(read(false).color(0, [0.1, 0.5], [255; 3]), [9, 9, 9]);
    }
}
