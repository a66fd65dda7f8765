//! Files are written whole or not at all.
//!
//! A file is written under a passing name in the folder it is for, brought to the disk, and only then given its
//! name. Several files of one command are all written before the first is named, so that a full disk leaves none.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use planecast_encoder::guard::Passing;
use planecast_encoder::{Error, Result};
use tempfile::NamedTempFile;

use crate::Frame;

/// A file written in full that does not have its name yet. Dropped, it is gone.
#[must_use = "a file gets its name by finish()"]
pub struct Pending {
    temp: NamedTempFile,
    _passing: Passing,
    path: PathBuf,
}

impl Pending {
    /// Gives the file its name, in place of a file that may have had it.
    pub fn finish(self) -> Result<()> {
        self.temp.persist(&self.path).map_err(|e| Error::io(&self.path, "write", e.error))?;
        Ok(())
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

fn temp_in(path: &Path) -> Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        // What the umask leaves, as for any other file; the default is for the owner's eyes alone.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.prefix(".planecast-").tempfile_in(folder(path)).map_err(|e| Error::io(path, "write", e))
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
    temp_in(path).map(drop)
}

/// Writes a file in full, without its name.
pub fn write(path: &Path, content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>) -> Result<Pending> {
    check(path)?;
    let path = resolve(path)?;
    let temp = temp_in(&path)?;
    let passing = Passing::new(temp.path());
    let mut out = BufWriter::with_capacity(1 << 20, temp.as_file());
    content(&mut out)
        .and_then(|()| out.flush())
        .and_then(|()| temp.as_file().sync_all())
        .map_err(|e| Error::io(&path, "write", e))?;
    drop(out);
    Ok(Pending { temp, _passing: passing, path })
}

/// A frame's colours as PNG, 8-bit sRGB; with alpha where some are transparent.
pub fn png(out: &mut impl Write, frame: &Frame) -> io::Result<()> {
    use image::ImageEncoder;
    let opaque = frame.color.iter().all(|c| c[3] == 255);
    let (bytes, kind): (Vec<u8>, _) = match opaque {
        true => (frame.color.iter().flat_map(|c| [c[0], c[1], c[2]]).collect(), image::ExtendedColorType::Rgb8),
        false => (frame.color.as_flattened().to_vec(), image::ExtendedColorType::Rgba8),
    };
    let encoder = image::codecs::png::PngEncoder::new(out);
    encoder.write_image(&bytes, frame.width, frame.height, kind).map_err(|e| match e {
        image::ImageError::IoError(e) => e,
        e => io::Error::other(e),
    })
}

/// NPY 1.0 header, C order, padded so that the data starts at a multiple of 64 bytes.
fn npy_header(out: &mut impl Write, descr: &str, shape: &str) -> io::Result<()> {
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
