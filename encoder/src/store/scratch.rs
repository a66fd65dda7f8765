//! Files without a name, for what need not fit into memory; in a page, where there are no files, memory after all.

#[cfg(not(target_arch = "wasm32"))]
use std::io::Result;

#[cfg(not(target_arch = "wasm32"))]
pub use std::fs::File;

#[cfg(not(target_arch = "wasm32"))]
pub fn file() -> Result<File> {
    tempfile::tempfile()
}

/// Fills `buffer` with the bytes of `file` from `at` on.
#[cfg(not(target_arch = "wasm32"))]
pub fn read_at(file: &File, buffer: &mut [u8], at: u64) -> Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, buffer, at);
    #[cfg(windows)]
    {
        let (mut buffer, mut at) = (buffer, at);
        while !buffer.is_empty() {
            let n = std::os::windows::fs::FileExt::seek_read(file, buffer, at)?;
            if n == 0 {
                return Err(std::io::ErrorKind::UnexpectedEof.into());
            }
            (buffer, at) = (&mut buffer[n..], at + n as u64);
        }
        Ok(())
    }
}

/// Writes all of `bytes` to `file` from `at` on.
#[cfg(not(target_arch = "wasm32"))]
pub fn write_at(file: &File, bytes: &[u8], at: u64) -> Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::write_all_at(file, bytes, at);
    #[cfg(windows)]
    {
        let (mut bytes, mut at) = (bytes, at);
        while !bytes.is_empty() {
            let n = std::os::windows::fs::FileExt::seek_write(file, bytes, at)?;
            (bytes, at) = (&bytes[n..], at + n as u64);
        }
        Ok(())
    }
}

#[cfg(target_arch = "wasm32")]
pub use memory::{File, file, read_at, write_at};

#[cfg(target_arch = "wasm32")]
mod memory {
    use std::io::{Cursor, Error, ErrorKind, Result, Seek, SeekFrom, Write};
    use std::path::Path;
    use std::sync::{Mutex, MutexGuard};

    /// A file in memory. A whole one's bytes are at hand already where a page reads it: there is none to open by name.
    pub struct File(Mutex<Cursor<Vec<u8>>>);

    pub fn file() -> Result<File> {
        Ok(File(Mutex::default()))
    }

    fn too_large() -> Error {
        Error::new(ErrorKind::OutOfMemory, "the page has no memory left for it")
    }

    impl File {
        pub fn open(_: impl AsRef<Path>) -> Result<File> {
            Err(Error::new(ErrorKind::Unsupported, "a page opens no files by name"))
        }

        fn bytes(&self) -> MutexGuard<'_, Cursor<Vec<u8>>> {
            self.0.lock().unwrap_or_else(|e| e.into_inner())
        }
    }

    impl Write for File {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            let mut file = self.bytes();
            file.get_mut().try_reserve(bytes.len()).map_err(|_| too_large())?;
            file.write(bytes)
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    impl Seek for File {
        fn seek(&mut self, to: SeekFrom) -> Result<u64> {
            self.bytes().seek(to)
        }
    }

    pub fn read_at(file: &File, buffer: &mut [u8], at: u64) -> Result<()> {
        let file = file.bytes();
        let from = usize::try_from(at).ok().and_then(|at| file.get_ref().get(at..)).unwrap_or_default();
        buffer.copy_from_slice(from.get(..buffer.len()).ok_or(ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    pub fn write_at(file: &File, bytes: &[u8], at: u64) -> Result<()> {
        let mut file = file.bytes();
        let end = usize::try_from(at).ok().and_then(|at| at.checked_add(bytes.len())).ok_or_else(too_large)?;
        let file = file.get_mut();
        if file.len() < end {
            file.try_reserve(end - file.len()).map_err(|_| too_large())?;
            file.resize(end, 0);
        }
        file[end - bytes.len()..end].copy_from_slice(bytes);
        Ok(())
    }
}
