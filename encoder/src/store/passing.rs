//! Files on their way to their names.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{Error, ErrorKind, Result, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::store::guard::Passing;

/// A file that is not whole yet. Where the system can do that it has no name, so that nothing of it stays whatever ends the
/// program; elsewhere a passing one, which a later write to the same place removes if it was left behind. Dropped, it is gone.
pub struct Unfinished {
    file: File,
    named: Option<Named>,
}

/// A passing name.
struct Named {
    path: PathBuf,
    _passing: Passing,
}

impl Drop for Named {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

impl Unfinished {
    /// For a file `target` in `folder`.
    pub fn new(folder: &Path, target: &Path) -> Result<Unfinished> {
        tidy(target);
        #[cfg(target_os = "linux")]
        {
            use std::os::unix::fs::OpenOptionsExt;
            let unnamed =
                OpenOptions::new().read(true).write(true).custom_flags(libc::O_TMPFILE).mode(0o666).open(folder);
            match unnamed {
                Ok(file) => {
                    let _ = file.try_lock();
                    return Ok(Unfinished { file, named: None });
                }
                Err(e)
                    if matches!(
                        e.kind(),
                        ErrorKind::PermissionDenied | ErrorKind::StorageFull | ErrorKind::ReadOnlyFilesystem
                    ) =>
                {
                    return Err(e);
                }
                // A file system that has none.
                Err(_) => {}
            }
        }
        let _ = folder;
        Unfinished::named(target)
    }

    /// For a file `target` that another program writes, under the name that [`Unfinished::path`] says.
    pub fn named(target: &Path) -> Result<Unfinished> {
        let create = |path: PathBuf| -> Result<Unfinished> {
            // Before there is a file: between its making and a later word an end of the program would leave it.
            let passing = Passing::new(&path);
            let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
            // Says that somebody is at it still. Where there are no locks, none is found either.
            let _ = file.try_lock();
            Ok(Unfinished { file, named: Some(Named { path, _passing: passing }) })
        };
        match create(passing_name(target, None)) {
            Err(e) if e.kind() == ErrorKind::AlreadyExists => create(passing_name(target, Some(std::process::id()))),
            made => made,
        }
    }

    pub fn file(&self) -> &File {
        &self.file
    }

    /// Its passing name, if it has one.
    pub fn path(&self) -> Option<&Path> {
        self.named.as_ref().map(|named| named.path.as_path())
    }

    /// Brings the file to the disk and gives it its name, in place of a file that may have had it.
    pub fn finish(mut self, target: &Path) -> Result<()> {
        self.file.sync_all()?;
        #[cfg(target_os = "linux")]
        if self.named.is_none() {
            // A link replaces nothing: where there is a file already, it takes a passing name first.
            match link(&self.file, target) {
                Ok(()) => return Ok(()),
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {
                    let names = [None, Some(std::process::id())].map(|process| passing_name(target, process));
                    self.named = names.into_iter().find_map(|path| {
                        let passing = Passing::new(&path);
                        link(&self.file, &path).ok().map(|()| Named { path, _passing: passing })
                    });
                }
                Err(_) => {}
            }
        }
        if self.named.is_none() {
            // No way from a file without a name to one (no /proc, say): its bytes go to another.
            let other = Unfinished::named(target)?;
            self.file.seek(SeekFrom::Start(0))?;
            std::io::copy(&mut self.file, &mut &other.file)?;
            other.file.sync_all()?;
            self = other;
        }
        let mut named = self.named.take().ok_or_else(|| Error::other("a file without a name"))?;
        fs::rename(&named.path, target)?;
        // From now on the passing name is anybody's.
        named.path.clear();
        Ok(())
    }
}

/// Gives an open file a name.
#[cfg(target_os = "linux")]
fn link(file: &File, to: &Path) -> Result<()> {
    use std::ffi::CString;
    use std::os::fd::AsRawFd;
    use std::os::unix::ffi::OsStrExt;
    let from = CString::new(format!("/proc/self/fd/{}", file.as_raw_fd()))?;
    let to = CString::new(to.as_os_str().as_bytes())?;
    // SAFETY: two strings that end in 0.
    let done =
        unsafe { libc::linkat(libc::AT_FDCWD, from.as_ptr(), libc::AT_FDCWD, to.as_ptr(), libc::AT_SYMLINK_FOLLOW) };
    if done == 0 { Ok(()) } else { Err(Error::last_os_error()) }
}

/// The name under which a file waits for `target`: always the same, or a process's own.
fn passing_name(target: &Path, process: Option<u32>) -> PathBuf {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    let own = process.map(|id| format!("-{id}")).unwrap_or_default();
    target.with_file_name(format!(".{name}.planecast{own}"))
}

/// Removes what an earlier write to `target` that was killed has left, unless it goes on still.
fn tidy(target: &Path) {
    let path = passing_name(target, None);
    let Ok(file) = File::open(&path) else { return };
    // Where there are no locks at all it cannot be told.
    if !matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
        let _ = fs::remove_file(&path);
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn unfinished_files_of_both_kinds_take_and_replace_a_name() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a");
        for (i, named) in [false, false, true, true].into_iter().enumerate() {
            let file = if named { Unfinished::named(&target) } else { Unfinished::new(dir.path(), &target) }.unwrap();
            file.file().write_all(&[i as u8; 3]).unwrap();
            file.finish(&target).unwrap();
            assert_eq!((fs::read(&target).unwrap(), names(dir.path())), (vec![i as u8; 3], vec!["a".to_owned()]));
        }
        drop(Unfinished::named(&target).unwrap());
        assert_eq!(names(dir.path()), ["a"]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn unfinished_files_have_no_name() {
        let dir = tempfile::tempdir().unwrap();
        let file = Unfinished::new(dir.path(), &dir.path().join("a")).unwrap();
        file.file().write_all(b"half").unwrap();
        assert!(names(dir.path()).is_empty(), "nothing is left whatever happens now");
    }

    #[test]
    fn unfinished_file_that_was_left_is_removed_by_the_next_write_and_one_in_use_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a");
        fs::write(passing_name(&target, None), "left").unwrap();
        drop(Unfinished::new(dir.path(), &target).unwrap());
        assert!(names(dir.path()).is_empty());
        let one = Unfinished::named(&target).unwrap();
        let other = Unfinished::new(dir.path(), &target).unwrap();
        one.file().write_all(b"one").unwrap();
        other.file().write_all(b"other").unwrap();
        one.finish(&target).unwrap();
        other.finish(&target).unwrap();
        assert_eq!((fs::read(&target).unwrap(), names(dir.path())), (b"other".to_vec(), vec!["a".to_owned()]));
    }
}
