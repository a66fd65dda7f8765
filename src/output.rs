//! Files are written whole or not at all.
//!
//! A file is written without a name in the folder it is for, brought to the disk, and only then given its name. Several files of one command are all written before the first is named, so that a full disk leaves none.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use planecast_encoder::store::passing::Unfinished;
use planecast_encoder::{Error, Result};

use crate::Frame;

/// A file written in full that does not have its name yet. Dropped, it is gone.
#[must_use = "a file gets its name by finish()"]
pub struct Pending {
    file: Unfinished,
    path: PathBuf,
}

impl Pending {
    /// Gives the file its name, in place of a file that may have had it.
    pub fn finish(self) -> Result<()> {
        self.file.finish(&self.path).map_err(|e| Error::io(&self.path, "write", e))
    }
}

/// The folder that a file lies in.
fn folder(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Follows a symbolic link, so that the file it names is written and not the link replaced.
fn resolve(path: &Path) -> Result<PathBuf> {
    match fs::symlink_metadata(path) {
        Ok(m) if m.is_symlink() => fs::canonicalize(path).map_err(|e| Error::io(path, "follow the link", e)),
        _ => Ok(path.to_path_buf()),
    }
}

fn unfinished(path: &Path) -> Result<Unfinished> {
    Unfinished::new(folder(path), path).map_err(|e| Error::io(path, "write", e))
}

/// Whether `path` can be written, as far as it can be known before: its folder is there and takes files, and no
/// folder or device has its name.
pub fn check(path: &Path) -> Result<()> {
    let path = &resolve(path)?;
    if path.file_name().is_none() {
        return Err(Error::format(path, "is not the name of a file to write"));
    }
    match fs::metadata(path) {
        Ok(m) if m.is_dir() => return Err(Error::format(path, "is a folder; name a file to write")),
        Ok(m) if !m.is_file() => return Err(Error::format(path, "is not a plain file; name a file to write")),
        _ => {}
    }
    match fs::metadata(folder(path)) {
        Ok(m) if !m.is_dir() => {
            return Err(Error::format(path, format!("{} is not a folder", folder(path).display())));
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            let missing = folder(path).display();
            return Err(Error::format(path, format!("the folder {missing} does not exist; create it first")));
        }
        Err(e) => return Err(Error::io(folder(path), "look into", e)),
        Ok(_) => {}
    }
    unfinished(path).map(drop)
}

/// Writes a file in full, without its name.
pub fn write(path: &Path, content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>) -> Result<Pending> {
    write_as(path, true, content)
}

/// As [`write()`], one of many: not waited for until it is on the disk. After a loss of power, look at its end.
pub fn write_one_of_many(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>,
) -> Result<Pending> {
    write_as(path, false, content)
}

fn write_as(path: &Path, sync: bool, content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>) -> Result<Pending> {
    check(path)?;
    let path = resolve(path)?;
    let file = unfinished(&path)?;
    let mut out = BufWriter::with_capacity(1 << 20, file.file());
    content(&mut out)
        .and_then(|()| out.flush())
        .and_then(|()| if sync { file.file().sync_all() } else { Ok(()) })
        .map_err(|e| Error::io(&path, "write", e))?;
    drop(out);
    Ok(Pending { file, path })
}

/// As [`write()`], for what writes the file at the path that it is given.
pub fn write_by(path: &Path, content: impl FnOnce(&Path) -> Result<()>) -> Result<Pending> {
    check(path)?;
    let path = resolve(path)?;
    let file = Unfinished::named(&path).map_err(|e| Error::io(&path, "write", e))?;
    content(file.path().expect("it was made with a name"))?;
    file.file().sync_all().map_err(|e| Error::io(&path, "write", e))?;
    Ok(Pending { file, path })
}

/// A frame's colours, three bytes each.
pub fn rgb(frame: &Frame) -> Vec<u8> {
    let mut rgb = vec![0; 3 * frame.color.len()];
    for (rgb, color) in rgb.as_chunks_mut::<3>().0.iter_mut().zip(&frame.color) {
        *rgb = [color[0], color[1], color[2]];
    }
    rgb
}

/// A frame's colours as PNG, 8-bit sRGB; with alpha where some are transparent.
pub fn png(out: &mut impl Write, frame: &Frame) -> io::Result<()> {
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    // One filter for all rows: to try each on each row takes twice the time for 1 to 3 % of bytes.
    let encoder = PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Up);
    match frame.color.iter().all(|c| c[3] == 255) {
        true => write_image(encoder, frame, &rgb(frame), image::ExtendedColorType::Rgb8),
        false => write_image(encoder, frame, frame.color.as_flattened(), image::ExtendedColorType::Rgba8),
    }
}

/// What a picture is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Picture {
    Png,
    Jpeg,
}

/// JPEG's quality, of 100: artefacts at edges of voxels are not seen.
const JPEG_QUALITY: u8 = 95;

/// Pixels a side that a JPEG can have at most.
const JPEG_SIDE: u32 = 65_535;

/// The name that stands for standard output.
pub const STDOUT: &str = "-";

impl Picture {
    /// By the name's ending; standard output is PNG. An error says which there are.
    pub fn of(path: &Path) -> crate::Result<Picture> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            Some("png") => Ok(Picture::Png),
            None if path == Path::new(STDOUT) => Ok(Picture::Png),
            // Refused as a folder, by who looks at what is there.
            None if path.is_dir() => Ok(Picture::Png),
            Some("jpg" | "jpeg") => Ok(Picture::Jpeg),
            other => {
                let what = other.map_or("a picture without an ending".to_owned(), |ending| format!(".{ending}"));
                let path = path.display();
                Err(crate::Error::Argument(format!(
                    "-o {path}: cannot write {what}; name a .png or .jpg file, or - for PNG on standard output"
                )))
            }
        }
    }

    pub fn write(self, out: &mut impl Write, frame: &Frame) -> io::Result<()> {
        match self {
            Picture::Png => png(out, frame),
            Picture::Jpeg => jpeg(out, frame),
        }
    }
}

fn write_image(
    encoder: impl image::ImageEncoder,
    frame: &Frame,
    pixels: &[u8],
    kind: image::ExtendedColorType,
) -> io::Result<()> {
    encoder.write_image(pixels, frame.width, frame.height, kind).map_err(|e| match e {
        image::ImageError::IoError(e) => e,
        e => io::Error::other(e),
    })
}

/// A frame's colours as JPEG.
pub fn jpeg(out: &mut impl Write, frame: &Frame) -> io::Result<()> {
    debug_assert!(frame.width <= JPEG_SIDE && frame.height <= JPEG_SIDE, "--size allows less");
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(out, JPEG_QUALITY);
    write_image(encoder, frame, &rgb(frame), image::ExtendedColorType::Rgb8)
}

/// NPY 1.0 header, C order, padded so that the data starts at a multiple of 64 bytes.
pub(crate) fn npy_header(out: &mut impl Write, descr: &str, shape: &str) -> io::Result<()> {
    let mut dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    const PREFIX: usize = 10; // magic 6, version 2, length 2
    let padding = 63 - (PREFIX + dict.len()) % 64;
    dict.extend(std::iter::repeat_n(' ', padding));
    dict.push('\n');
    out.write_all(b"\x93NUMPY\x01\x00")?;
    out.write_all(&(dict.len() as u16).to_le_bytes())?;
    out.write_all(dict.as_bytes())
}

/// A frame's depth as NPY `<f4` of shape (H, W).
pub fn npy_depth(out: &mut impl Write, frame: &Frame) -> io::Result<()> {
    npy_header(out, "<f4", &format!("({}, {})", frame.height, frame.width))?;
    frame.depth.iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))
}

/// A frame's voxels as NPY `<i4` of shape (H, W, 4).
pub fn npy_voxel(out: &mut impl Write, frame: &Frame) -> io::Result<()> {
    npy_header(out, "<i4", &format!("({}, {}, 4)", frame.height, frame.width))?;
    frame.voxel.iter().flatten().try_for_each(|v| out.write_all(&v.to_le_bytes()))
}

/// Any value as JSON, with a line break at the end.
pub fn json(out: &mut impl Write, value: &impl serde::Serialize) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *out, value)?;
    out.write_all(b"\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Frame {
        Frame {
            width: 3,
            height: 2,
            color: (0..6).map(|i| [i, 10, 20, 255]).collect(),
            depth: vec![0.0, 1.5, f32::INFINITY, 3.0, 4.0, 5.0],
            voxel: (0..6).map(|i| [i, -1, 2, 0]).collect(),
            stats: crate::Stats::default(),
        }
    }

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn npy_has_the_documented_bytes() {
        let mut depth = Vec::new();
        npy_depth(&mut depth, &frame()).unwrap();
        let data = u16::from_le_bytes([depth[8], depth[9]]) as usize + 10;
        assert_eq!((&depth[..8], data % 64, depth[data - 1]), (&b"\x93NUMPY\x01\x00"[..], 0, b'\n'));
        let header = std::str::from_utf8(&depth[10..data]).unwrap().trim_end();
        assert_eq!(header, "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }");
        assert_eq!(depth[data + 8..data + 12], f32::INFINITY.to_le_bytes());
        assert_eq!(depth.len(), data + 6 * 4);

        let mut voxel = Vec::new();
        npy_voxel(&mut voxel, &frame()).unwrap();
        let data = u16::from_le_bytes([voxel[8], voxel[9]]) as usize + 10;
        assert!(
            std::str::from_utf8(&voxel[10..data])
                .unwrap()
                .contains("'<i4', 'fortran_order': False, 'shape': (2, 3, 4)")
        );
        assert_eq!(voxel[data + 16..data + 24], [1, 0, 0, 0, 255, 255, 255, 255]);
        assert_eq!(voxel.len(), data + 6 * 16);
    }

    #[test]
    fn png_keeps_every_pixel() {
        let mut bytes = Vec::new();
        png(&mut bytes, &frame()).unwrap();
        let back = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!((back.dimensions(), back.get_pixel(2, 1).0), ((3, 2), [5, 10, 20]));
    }

    #[test]
    fn png_keeps_what_is_transparent() {
        let mut frame = frame();
        frame.color[1] = [0; 4];
        let mut bytes = Vec::new();
        png(&mut bytes, &frame).unwrap();
        let back = image::load_from_memory(&bytes).unwrap();
        assert_eq!(back.color(), image::ColorType::Rgba8);
        let back = back.into_rgba8();
        assert_eq!([back.get_pixel(1, 0).0, back.get_pixel(2, 1).0], [[0; 4], [5, 10, 20, 255]]);
    }

    #[test]
    fn write_leaves_nothing_when_the_content_fails() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        fs::write(&path, b"old").unwrap();
        let failed = write(&path, |out| {
            out.write_all(b"new")?;
            Err(io::Error::from(io::ErrorKind::StorageFull))
        });
        assert!(matches!(failed, Err(Error::Io { action: "write", .. })));
        assert_eq!((fs::read(&path).unwrap(), names(dir.path())), (b"old".to_vec(), vec!["a.bin".to_string()]));
    }

    #[test]
    fn write_gives_the_name_only_at_the_end() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        let pending = write(&path, |out| out.write_all(b"new")).unwrap();
        assert!(!path.exists());
        drop(pending);
        assert!(names(dir.path()).is_empty(), "a dropped file is gone");
        write(&path, |out| out.write_all(b"new")).unwrap().finish().unwrap();
        assert_eq!((fs::read(&path).unwrap(), names(dir.path())), (b"new".to_vec(), vec!["a.bin".to_string()]));
    }

    #[cfg(unix)]
    #[test]
    fn write_follows_links_and_honours_the_umask() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("file"), dir.path().join("link"));
        File::create(&file).unwrap();
        let usual = fs::metadata(&file).unwrap().permissions().mode();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write(&link, |out| out.write_all(b"x")).unwrap().finish().unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(
            (fs::read(&file).unwrap(), fs::metadata(&file).unwrap().permissions().mode()),
            (b"x".to_vec(), usual)
        );
    }

    #[test]
    fn check_says_what_stands_in_the_way() {
        let dir = tempfile::tempdir().unwrap();
        let text = |path: &Path| check(path).unwrap_err().to_string();
        assert!(text(dir.path()).ends_with("is a folder; name a file to write"));
        let missing = dir.path().join("no").join("a.png");
        assert!(
            text(&missing)
                .ends_with(&format!("the folder {} does not exist; create it first", dir.path().join("no").display()))
        );
        let file = dir.path().join("file");
        fs::write(&file, b"").unwrap();
        assert!(text(&file.join("a.png")).contains("is not a folder"), "{}", text(&file.join("a.png")));
        assert!(check(&dir.path().join("a.png")).is_ok() && names(dir.path()) == ["file"]);
        #[cfg(unix)]
        assert!(text(Path::new("/dev/null")).contains("is not a plain file"));
    }
}
