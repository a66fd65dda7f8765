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
pub mod usage;

use rayon::iter::plumbing::{Consumer, Producer, ProducerCallback, UnindexedConsumer, bridge};
use rayon::prelude::*;

/// `slice.par_chunks_mut(n)`; of an empty slice `count` empty ones.
///
/// One type for both: of two, each loop over several such would be compiled for every combination, traversal of its four fans 256
/// times.
pub(crate) fn chunks_mut<T: Send>(slice: &mut [T], n: usize, count: usize) -> ChunksMut<'_, T> {
    let count = if slice.is_empty() { count } else { slice.len().div_ceil(n) };
    ChunksMut { slice, n, count }
}

/// As [`chunks_mut`] makes it.
pub(crate) struct ChunksMut<'a, T> {
    slice: &'a mut [T],
    n: usize,
    count: usize,
}

impl<'a, T> ChunksMut<'a, T> {
    /// Cuts off the first `count` chunks.
    fn cut(&mut self, count: usize) -> ChunksMut<'a, T> {
        let at = count.saturating_mul(self.n).min(self.slice.len());
        let slice = self.slice.split_off_mut(..at).expect("within the slice");
        self.count -= count;
        ChunksMut { slice, n: self.n, count }
    }
}

impl<'a, T: Send> ParallelIterator for ChunksMut<'a, T> {
    type Item = &'a mut [T];

    fn drive_unindexed<C: UnindexedConsumer<Self::Item>>(self, consumer: C) -> C::Result {
        bridge(self, consumer)
    }

    fn opt_len(&self) -> Option<usize> {
        Some(self.count)
    }
}

impl<T: Send> IndexedParallelIterator for ChunksMut<'_, T> {
    fn len(&self) -> usize {
        self.count
    }

    fn drive<C: Consumer<Self::Item>>(self, consumer: C) -> C::Result {
        bridge(self, consumer)
    }

    fn with_producer<CB: ProducerCallback<Self::Item>>(self, callback: CB) -> CB::Output {
        callback.callback(Part(self))
    }
}

/// What one thread goes through.
struct Part<'a, T>(ChunksMut<'a, T>);

impl<'a, T: Send> Producer for Part<'a, T> {
    type Item = &'a mut [T];
    type IntoIter = Self;

    fn into_iter(self) -> Self {
        self
    }

    fn split_at(mut self, index: usize) -> (Self, Self) {
        (Part(self.0.cut(index)), self)
    }
}

impl<'a, T> Iterator for Part<'a, T> {
    type Item = &'a mut [T];

    fn next(&mut self) -> Option<&'a mut [T]> {
        (self.0.count > 0).then(|| self.0.cut(1).slice)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.0.count, Some(self.0.count))
    }
}

impl<T> DoubleEndedIterator for Part<'_, T> {
    fn next_back(&mut self) -> Option<Self::Item> {
        let before = self.0.count.checked_sub(1)?;
        let front = self.0.cut(before);
        Some(std::mem::replace(&mut self.0, front).slice)
    }
}

impl<T> ExactSizeIterator for Part<'_, T> {}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_are_those_of_the_slice_or_empty_ones() {
        let whole: Vec<u32> = (0..1003).collect();
        for n in [1, 7, 1003, 2000] {
            let (mut ours, mut rayons) = (whole.clone(), whole.clone());
            let chunks = chunks_mut(&mut ours, n, 0);
            assert_eq!(chunks.len(), rayons.par_chunks_mut(n).len());
            chunks.zip(rayons.par_chunks_mut(n)).enumerate().for_each(|(i, (a, b))| {
                assert_eq!(a, b);
                a.fill(i as u32);
            });
            assert!(ours.iter().enumerate().all(|(at, &i)| i as usize == at / n), "each is met once");
            let back: Vec<usize> = chunks_mut(&mut ours, n, 0).rev().map(|chunk| chunk.len()).collect();
            assert_eq!(back, rayons.par_chunks_mut(n).rev().map(|chunk| chunk.len()).collect::<Vec<_>>());
        }
        let lens: Vec<usize> = chunks_mut::<u32>(&mut [], 5, 300).map(|chunk| chunk.len()).collect();
        assert_eq!(lens, [0; 300]);
    }
}
