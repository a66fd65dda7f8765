//! Bytes that are read by ranges, from several threads.

use std::ops::Range;
use std::path::Path;

use crate::Result;
#[cfg(not(target_arch = "wasm32"))]
pub use here::Here;

/// Bytes from the start of a file that are worth asking for before anything of it is known: they tell what it is, and hold a
/// scene's header and, but for worlds of more than 300,000 columns a side, its directory.
pub const HEAD: u64 = 64 << 10;

/// A file of which ranges can be read, here or elsewhere.
pub trait Ranges: Send + Sync {
    /// What errors call it.
    fn name(&self) -> &Path;

    /// Bytes of all of it.
    fn size(&self) -> u64;

    /// Whether a request costs next to nothing, so that no more need be read than is wanted.
    fn near(&self) -> bool;

    /// The bytes of a range that lies in it, all of them.
    ///
    /// # Errors
    /// After a while at most, and after it was tried again where that may help.
    fn read(&self, range: Range<u64>) -> Result<Vec<u8>>;
}

#[cfg(not(target_arch = "wasm32"))]
mod here {
    use std::fs::File;
    use std::path::PathBuf;

    use super::*;
    use crate::Error;
    use crate::store::scratch::read_at;

    /// A file here, read at its places: memory holds what was read last, and no map of it.
    pub struct Here {
        path: PathBuf,
        file: File,
        len: u64,
    }

    impl Here {
        pub fn open(path: &Path) -> Result<Here> {
            let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
            let meta = file.metadata().map_err(|e| Error::io(path, "read", e))?;
            if !meta.is_file() {
                return Err(Error::format(path, "not a regular file, a .pcast scene was expected"));
            }
            Ok(Here { path: path.into(), file, len: meta.len() })
        }
    }

    impl Ranges for Here {
        fn name(&self) -> &Path {
            &self.path
        }

        fn size(&self) -> u64 {
            self.len
        }

        fn near(&self) -> bool {
            true
        }

        fn read(&self, range: Range<u64>) -> Result<Vec<u8>> {
            let mut bytes = vec![0; (range.end - range.start) as usize];
            read_at(&self.file, &mut bytes, range.start).map_err(|e| Error::io(&self.path, "read", e))?;
            Ok(bytes)
        }
    }
}
