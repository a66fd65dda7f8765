//! The clock that stages are timed with.

#[cfg(not(target_arch = "wasm32"))]
pub use std::time::Instant;

/// std has no clock in a browser, and says so by a panic.
#[cfg(target_arch = "wasm32")]
pub use web_time::Instant;
