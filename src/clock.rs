//! The clock that stages are timed with, and one that says when to ask again.

#[cfg(test)]
use std::sync::Arc;
#[cfg(test)]
use std::sync::atomic::{AtomicU64, Ordering};

#[cfg(not(target_arch = "wasm32"))]
pub use std::time::Instant;

/// std has no clock in a browser, and says so by a panic.
#[cfg(target_arch = "wasm32")]
pub use web_time::Instant;

/// Milliseconds that have passed. A test's stands still until it is told to go on, so that no verdict hangs on how fast a
/// machine is.
#[derive(Clone)]
pub(crate) enum Clock {
    Real(Instant),
    #[cfg(test)]
    Told(Arc<AtomicU64>),
}

impl Clock {
    pub fn start() -> Clock {
        Clock::Real(Instant::now())
    }

    pub fn ms(&self) -> f64 {
        match self {
            Clock::Real(since) => since.elapsed().as_secs_f64() * 1e3,
            #[cfg(test)]
            Clock::Told(ms) => ms.load(Ordering::Relaxed) as f64,
        }
    }

    #[cfg(test)]
    pub fn told() -> Clock {
        Clock::Told(Arc::default())
    }

    #[cfg(test)]
    pub fn advance(&self, by_ms: u64) {
        match self {
            Clock::Real(_) => unreachable!("nobody tells a real clock"),
            Clock::Told(ms) => _ = ms.fetch_add(by_ms, Ordering::Relaxed),
        }
    }
}
