//! What must be said and tidied away where something outside stops the program: a file that is cut short while it is mapped
//! into memory, and Ctrl-C. A library does nothing of it by itself: a command asks with [`explain_lost_files`].

use std::alloc::{GlobalAlloc, Layout, System};
use std::ffi::{CString, c_char};
use std::fs::File;
use std::ops::Deref;
use std::path::Path;
use std::sync::atomic::{AtomicPtr, AtomicUsize, Ordering};

/// Files mapped, or being written, at once that are known by name. Of more the name is not told, or they are left.
const SLOTS: usize = 64;

/// A name that stands for a range of memory, or for itself. Read by a signal's handler, so without locks.
struct Slot {
    from: AtomicUsize,
    to: AtomicUsize,
    /// A string that ends in 0, its owner the slot's.
    name: AtomicPtr<c_char>,
}

/// `from` of a slot that is free, and of one whose range is not known yet.
const FREE: usize = 0;
const TAKEN: usize = usize::MAX;

static MAPPED: [Slot; SLOTS] = [const { Slot::new() }; SLOTS];
static PASSING: [Slot; SLOTS] = [const { Slot::new() }; SLOTS];

impl Slot {
    const fn new() -> Slot {
        Slot { from: AtomicUsize::new(FREE), to: AtomicUsize::new(0), name: AtomicPtr::new(std::ptr::null_mut()) }
    }
}

/// A slot taken until it is dropped.
struct Taken(&'static Slot);

impl Taken {
    fn new(slots: &'static [Slot], name: &Path, from: usize, to: usize) -> Option<Taken> {
        let name = CString::new(name.as_os_str().as_encoded_bytes()).ok()?;
        let free = |s: &&Slot| s.from.compare_exchange(FREE, TAKEN, Ordering::AcqRel, Ordering::Relaxed).is_ok();
        let slot = slots.iter().find(free)?;
        slot.name.store(name.into_raw(), Ordering::Release);
        slot.to.store(to, Ordering::Release);
        slot.from.store(from, Ordering::Release);
        Some(Taken(slot))
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        self.0.from.store(TAKEN, Ordering::Release);
        let name = self.0.name.swap(std::ptr::null_mut(), Ordering::AcqRel);
        // SAFETY: it came from `CString::into_raw` and is nobody else's now. A handler that reads it ends the program.
        drop(unsafe { CString::from_raw(name) });
        self.0.from.store(FREE, Ordering::Release);
    }
}

/// A file in memory, mapped.
pub struct Map {
    map: memmap2::Mmap,
    _name: Option<Taken>,
}

impl Map {
    /// Maps a whole file, to be read alone.
    pub fn new(path: &Path, file: &File) -> std::io::Result<Map> {
        // SAFETY: the map is read-only. Who cuts the file short meanwhile ends the program by SIGBUS, which commands explain;
        // what reads the bytes must not rely on reading the same twice.
        let map = unsafe { memmap2::Mmap::map(file) }?;
        let from = map.as_ptr() as usize;
        let name = Taken::new(&MAPPED, path, from, from + map.len());
        Ok(Map { map, _name: name })
    }
}

impl Deref for Map {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.map
    }
}

/// The name of a file that is not whole yet, removed by [`tidy`]. Dropped, it is kept or somebody else's to remove.
pub struct Passing {
    _name: Option<Taken>,
}

impl Passing {
    pub fn new(path: &Path) -> Passing {
        // As the program may go to another folder.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        Passing { _name: Taken::new(&PASSING, &path, 1, 1) }
    }
}

/// Removes files that are not whole, for a program that is about to end. Safe in a signal's handler.
#[cfg(not(target_arch = "wasm32"))]
pub fn tidy() {
    for slot in &PASSING {
        let name = slot.name.swap(std::ptr::null_mut(), Ordering::AcqRel);
        if !name.is_null() {
            // SAFETY: a string that ends in 0, from now on nobody's.
            unsafe { libc::unlink(name) };
        }
    }
}

/// Ends the program at once, whatever other threads do, without files that are not whole.
#[cfg(not(target_arch = "wasm32"))]
pub fn leave(status: i32) -> ! {
    tidy();
    // What runs at a usual exit may wait for those threads.
    // SAFETY: ends the program.
    unsafe { libc::_exit(status) }
}

/// Gives the calling thread the program's last word, for what is said before a fault ends it: several threads may meet the
/// same fault, and it is to be told once. Whoever comes later waits here for the end that the first one brings, or ten
/// seconds, should it not come. Safe in a signal's handler.
pub fn last_word() {
    static SPEAKER: AtomicUsize = AtomicUsize::new(0);
    thread_local!(static HERE: u8 = const { 0 });
    // The place of a thread's own byte tells threads apart, and is never 0.
    let me = HERE.with(|here| std::ptr::from_ref(here) as usize);
    if let Err(speaker) = SPEAKER.compare_exchange(0, me, Ordering::AcqRel, Ordering::Acquire)
        && speaker != me
    {
        std::thread::sleep(std::time::Duration::from_secs(10));
    }
}

/// Bytes of the last request for memory that the system refused; 0: there was none.
static REFUSED: AtomicUsize = AtomicUsize::new(0);

/// The system's memory, for a program that is to say in plain words that there is none left: Rust ends it by an abort then, and
/// [`explain_lost_files`] turns that into a line and status 1. Who asks by `try_reserve` is told as ever.
pub struct Allocator;

/// Bytes that are never asked for by who can do without: where they are missing the program ends at once, as it would else on
/// the way to saying so.
#[cfg(unix)]
const NEEDED: usize = 64 << 10;

fn noted(at: *mut u8, bytes: usize) -> *mut u8 {
    if at.is_null() {
        REFUSED.store(bytes, Ordering::Release);
        #[cfg(unix)]
        if bytes < NEEDED {
            handler::out_of_memory(bytes);
        }
    }
    at
}

// SAFETY: all of it is the system's.
unsafe impl GlobalAlloc for Allocator {
    #[inline]
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        noted(unsafe { System.alloc(layout) }, layout.size())
    }

    #[inline]
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        noted(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    #[inline]
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        // SAFETY: as the caller promises.
        noted(unsafe { System.realloc(at, layout, bytes) }, bytes)
    }

    #[inline]
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(at, layout) }
    }
}

/// Whether a fault is one of memory: the system has refused some, or leaves little.
#[cfg(not(target_arch = "wasm32"))]
pub fn is_short_of_memory() -> bool {
    REFUSED.load(Ordering::Acquire) > 0 || crate::encode::memory::left_of_limits().is_some_and(|left| left < 64 << 20)
}

/// From now on running out of memory, and a mapped file that is cut short, end the program with one plain line and status 1. To be called once, by a
/// command; elsewhere than on Unix a file that is mapped cannot be cut short.
pub fn explain_lost_files() {
    #[cfg(unix)]
    handler::set();
}

#[cfg(unix)]
mod handler {
    use super::{FREE, MAPPED, REFUSED, Slot, TAKEN, last_word, leave};
    use std::sync::atomic::{AtomicPtr, Ordering};

    static BEFORE: AtomicPtr<libc::sigaction> = AtomicPtr::new(std::ptr::null_mut());

    pub fn set() {
        // SAFETY: all fields that are not set below may be 0; the handler keeps to what handlers may do.
        unsafe {
            let mut before: libc::sigaction = std::mem::zeroed();
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = lost as *const () as usize;
            action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
            libc::sigemptyset(&mut action.sa_mask);
            if libc::sigaction(libc::SIGBUS, &action, &mut before) == 0 {
                BEFORE.store(Box::into_raw(Box::new(before)), Ordering::Release);
            }
            action.sa_sigaction = aborted as *const () as usize;
            libc::sigaction(libc::SIGABRT, &action, std::ptr::null_mut());
        }
    }

    /// Nothing in it but atomics, `write`, `nanosleep`, `unlink` and `_exit`: another thread may hold any lock.
    extern "C" fn lost(_: libc::c_int, info: *mut libc::siginfo_t, _: *mut libc::c_void) {
        // SAFETY: the system gives a handler of this kind where memory was missed.
        let at = unsafe { (*info).si_addr() } as usize;
        let holds = |slot: &&Slot| {
            let from = slot.from.load(Ordering::Acquire);
            from != FREE && from != TAKEN && (from..slot.to.load(Ordering::Acquire)).contains(&at)
        };
        let Some(slot) = MAPPED.iter().find(holds) else {
            // Not ours: as it would have gone.
            let before = BEFORE.load(Ordering::Acquire);
            // SAFETY: what `sigaction` gave; where it did not yet, the default ends the program, as it must.
            unsafe {
                match before.is_null() {
                    true => drop(libc::signal(libc::SIGBUS, libc::SIG_DFL)),
                    false => drop(libc::sigaction(libc::SIGBUS, before, std::ptr::null_mut())),
                }
            }
            return;
        };
        last_word();
        let name = slot.name.load(Ordering::Acquire);
        say(b"planecast: ");
        if !name.is_null() {
            // SAFETY: a string that ends in 0, of the map that is being read.
            say(unsafe { std::ffi::CStr::from_ptr(name) }.to_bytes());
        }
        say(b": byte ");
        let mut digits = [0; 20];
        say(decimal((at - slot.from.load(Ordering::Acquire)) as u64, &mut digits));
        say(b": the file was cut short while it was read; run the command again when nothing writes to it\n");
        leave(1);
    }

    /// Rust's last step where memory that must be had is not. An abort for another reason goes on as it would have gone.
    extern "C" fn aborted(_: libc::c_int, _: *mut libc::siginfo_t, _: *mut libc::c_void) {
        let bytes = REFUSED.load(Ordering::Acquire);
        if bytes == 0 {
            // SAFETY: the default for this signal.
            unsafe { libc::signal(libc::SIGABRT, libc::SIG_DFL) };
            return;
        }
        out_of_memory(bytes);
    }

    pub fn out_of_memory(bytes: usize) -> ! {
        last_word();
        let mut digits = [0; 20];
        say(b"planecast: out of memory: the system refuses ");
        say(decimal(bytes as u64, &mut digits));
        say(b" bytes more; raise its limit (ulimit -v), or ask for less (--memory, --size)\n");
        leave(1);
    }

    fn say(text: &[u8]) {
        // SAFETY: as many bytes as there are. What is not written was not to be read.
        let _ = unsafe { libc::write(2, text.as_ptr().cast(), text.len()) };
    }

    fn decimal(mut n: u64, digits: &mut [u8; 20]) -> &[u8] {
        let mut at = digits.len();
        loop {
            at -= 1;
            digits[at] = b'0' + (n % 10) as u8;
            n /= 10;
            if n == 0 {
                return &digits[at..];
            }
        }
    }

    #[cfg(test)]
    mod tests {
        #[test]
        fn decimal_writes_all_digits() {
            for n in [0, 7, 10, 4096, u64::MAX] {
                assert_eq!(super::decimal(n, &mut [0; 20]), n.to_string().as_bytes());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_are_given_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, [7; 100]).unwrap();
        let file = File::open(&path).unwrap();
        for _ in 0..3 {
            let maps: Vec<Map> = (0..2 * SLOTS).map(|_| Map::new(&path, &file).unwrap()).collect();
            assert!(maps.iter().all(|map| **map == [7; 100]));
            assert!(maps.iter().filter(|map| map._name.is_some()).count() > SLOTS / 2, "names are kept");
        }
    }
}
