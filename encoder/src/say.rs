//! What commands tell a person, on standard error. Nobody may be listening, and the disk behind it may be full: what cannot
//! be written is lost, and no work with it.

use std::fmt;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};

static QUIET: AtomicBool = AtomicBool::new(false);

/// From now on [`note!`](crate::note) says nothing, and there are no bars: what is wrong is all that is told.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// One line, in one piece where the system takes it so.
pub fn line(text: fmt::Arguments<'_>) {
    let _ = std::io::stderr().write_all(format!("{text}\n").as_bytes());
}

/// Says a line that a person must know.
#[macro_export]
macro_rules! say {
    ($($text:tt)*) => {
        $crate::say::line(format_args!($($text)*))
    };
}

/// Says a line that is good to know, unless it is to be quiet.
#[macro_export]
macro_rules! note {
    ($($text:tt)*) => {
        if !$crate::say::is_quiet() {
            $crate::say::line(format_args!($($text)*))
        }
    };
}
