//! The stages on the CPU, with rayon over planes or rows. Each has its GPU twin in `shaders/` under the same name.

pub mod exact;
pub mod exact_matter;
pub mod gap_fill;
pub mod matter;
pub mod normal;
pub mod pick;
pub mod raycast;
pub mod refine;
pub mod remap;
pub mod renderer;
pub mod shade;
pub mod shade_rays;
pub mod shadow;
pub mod smooth;
pub mod sphere;
pub mod traverse;

use rayon::iter::Either;
use rayon::prelude::*;

/// `slice.par_chunks_mut(n)`; of an empty slice as many empty ones.
pub(crate) fn chunks_mut<T: Send>(
    slice: &mut [T],
    n: usize,
    count: usize,
) -> impl IndexedParallelIterator<Item = &mut [T]> {
    match slice.is_empty() {
        true => Either::Left((0..count).into_par_iter().map(|_| <&mut [T]>::default())),
        false => Either::Right(slice.par_chunks_mut(n)),
    }
}

/// `vec.resize(n, value)` for values that are all written before they are read: those that are there need not stay. Memory
/// that is new comes in large pages where the system has them: to touch it takes less time then.
pub(crate) fn resize<T: Copy>(vec: &mut Vec<T>, n: usize, value: T) {
    if n > vec.capacity() {
        *vec = Vec::with_capacity(n);
        advise(vec.as_ptr() as usize, n * size_of::<T>());
    }
    vec.resize(n, value);
}

/// Bytes of a large page.
#[cfg(target_os = "linux")]
const LARGE_PAGE: usize = 2 << 20;

/// Asks for large pages for what is to be written from `at` on.
#[cfg(target_os = "linux")]
fn advise(at: usize, len: usize) {
    let (from, to) = (at.next_multiple_of(LARGE_PAGE), (at + len) / LARGE_PAGE * LARGE_PAGE);
    if from < to {
        // SAFETY: whole pages of an allocation, which keep what they hold. Where the system refuses, they are small ones.
        unsafe { libc::madvise(from as *mut libc::c_void, to - from, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise(_: usize, _: usize) {}
