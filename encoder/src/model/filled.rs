//! Large tables, written by all threads.

use std::sync::Mutex;

use bytemuck::Zeroable;

use crate::{Error, Result, parallel};

/// A table of parts of these lengths, each written by one call of `fill(part, out)`, in parallel. Memory is touched first by
/// the thread that writes it; what `fill` leaves alone is zero.
///
/// # Errors
/// [`Error::Limit`] where there is no memory for so many values of `what`.
pub fn filled<T: Zeroable + Send>(lens: &[usize], what: &str, fill: impl Fn(usize, &mut [T]) + Sync) -> Result<Vec<T>> {
    let n = lens.iter().sum();
    let none = |()| Error::Limit(format!("no memory for {n} {what}"));
    let mut values = bytemuck::allocation::try_zeroed_slice_box(n).map_err(none)?.into_vec();
    let mut rest = &mut values[..];
    let mut parts = Vec::with_capacity(lens.len());
    for &len in lens {
        let (part, after) = rest.split_at_mut(len);
        parts.push(Mutex::new(part));
        rest = after;
    }
    parallel::each(parts.len(), &|i| fill(i, &mut parts[i].lock().expect("one call has it")));
    drop(parts);
    Ok(values)
}

/// The sum of all lengths before each, and of all.
pub fn starts(lens: &[usize]) -> Vec<usize> {
    let mut sum = 0;
    let before = lens.iter().map(|len| {
        let start = sum;
        sum += len;
        start
    });
    let mut starts: Vec<usize> = before.collect();
    starts.push(sum);
    starts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filled_writes_each_part_at_its_place() {
        let lens = [1, 0, 3, 2];
        let values: Vec<u32> = filled(&lens, "values", |i, out| out.fill(10 + i as u32)).unwrap();
        assert_eq!(values, [10, 12, 12, 12, 13, 13]);
        assert_eq!(starts(&lens), [0, 1, 1, 4, 6]);
        let none = filled::<u64>(&[usize::MAX / 16], "runs", |_, _| {}).unwrap_err();
        assert!(none.to_string().contains("no memory for"), "{none}");
    }
}
