//! Loops on all threads over parts of work, each of which takes a while.
//!
//! What hands parts out is compiled once. An iterator of rayon's is compiled anew for each closure, and again for each type of a
//! generic function around it: that was a quarter of this crate's code.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

/// Does `work` for each of `0..n`, in any order.
pub fn each(n: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..n).into_par_iter().for_each(work);
}

/// The values of `0..n`, in that order.
pub fn map<T: Send>(n: usize, value: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let places: Vec<Mutex<Option<T>>> = (0..n).map(|_| Mutex::new(None)).collect();
    each(n, &|i| *places[i].lock().expect("nobody panics with it") = Some(value(i)));
    places.into_iter().map(|place| place.into_inner().expect("as above").expect("each was made")).collect()
}

/// The same of values that can fail; after the first error that comes, no more are begun.
///
/// # Errors
/// One of those that came.
pub fn try_map<T: Send, E: Send>(n: usize, value: impl Fn(usize) -> Result<T, E> + Sync) -> Result<Vec<T>, E> {
    let fails = AtomicBool::new(false);
    let value = |i| match fails.load(Ordering::Relaxed) {
        true => None,
        false => Some(value(i).inspect_err(|_| fails.store(true, Ordering::Relaxed))),
    };
    let (mut values, mut error) = (Vec::with_capacity(n), None);
    for value in map(n, value).into_iter().flatten() {
        match value {
            Ok(value) => values.push(value),
            Err(e) => error = Some(e),
        }
    }
    error.map_or(Ok(values), Err)
}

/// As [`each`] of work that can fail.
///
/// # Errors
/// One of those that came.
pub fn try_each<E: Send>(n: usize, work: impl Fn(usize) -> Result<(), E> + Sync) -> Result<(), E> {
    let error = Mutex::new(None);
    let fails = AtomicBool::new(false);
    each(n, &|i| {
        if !fails.load(Ordering::Relaxed)
            && let Err(e) = work(i)
        {
            fails.store(true, Ordering::Relaxed);
            *error.lock().expect("nobody panics with it") = Some(e);
        }
    });
    error.into_inner().expect("as above").map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_in_order_and_errors_come_through() {
        assert_eq!(map(1000, |i| i * i), (0..1000).map(|i| i * i).collect::<Vec<_>>());
        assert_eq!(try_map(300, Ok::<_, usize>), Ok((0..300).collect()));
        let odd = |i: usize| if i % 100 == 7 { Err(i) } else { Ok(i) };
        assert!(try_map(300, odd).is_err_and(|i| i % 100 == 7));
        assert!(try_each(300, |i| odd(i).map(drop)).is_err_and(|i| i % 100 == 7));
        assert_eq!((try_each(300, |_| Ok::<_, usize>(())), try_map(0, odd)), (Ok(()), Ok(Vec::new())));
    }
}
