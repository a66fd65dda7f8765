//! The two-level run list of one column, as bytes.
//!
//! After Forstmann & Ohya 2009, §3.1: `start = hi·256 + lo`, the position of a run's first colour is
//! `word + coff`, and **a run's length is the next run's colour position minus its own**, so it costs no bytes.
//! All numbers are little-endian.
//!
//! ```text
//! narrow (levels at most 256 high)            wide (higher levels)
//!   n × { lo u8, coff u8 }                      m u16                   buckets of 256 voxels in which a run starts
//!   total u8       voxels mod 256, 0 is 256     m × { hi u8             the bucket, ascending
//!                                                     runs u8           1 to 128 runs start in it
//!                                                     word u16          voxels in runs before its first
//!                                                     first u16 }       runs before its first
//!                                               total u16               voxels mod 65,536, 0 is 65,536
//!                                               n × { lo u8, coff u8 }
//! ```
//!
//! ```text
//! flat (tiles of higher levels, where shorter)
//!   n × { start u16, color u16 }            color: voxels in runs before
//!   total u16      voxels mod 65,536, 0 is 65,536
//!
//! packed (tiles where shorter, of whose columns no colour asks for a voxel's number)
//!   n × { start, end }                      of so many bits each as the tile says, 4 to 17, lowest first; end exclusive
//!   zero bits to a byte                     fewer than a run takes, so that n follows from the bytes
//! ```
//!
//! A column without runs has no bytes. Deviates: `first` is not in the paper; with it a point query is two binary
//! searches and no sum. The narrow form leaves the first level away: there is one bucket, and `word` is 0. The flat form
//! has none either: it is the shorter one where buckets hold few runs. Deviates: the packed form holds the ends of runs, and no
//! colour positions; a point query is one binary search.

use crate::Run;

/// Bytes of a first-level entry.
const BUCKET: usize = 6;
/// Bytes of the wide form beside buckets and runs: `m` and `total`.
const WIDE_FIXED: usize = 4;

/// Bytes of a run of the flat form.
const FLAT_RUN: usize = 4;

/// Bits that a packed column may have for a boundary: fewer padding bits than a run takes, and 65,536 fits.
pub const PACKED_BITS: std::ops::RangeInclusive<u32> = 4..=17;

/// Which form the columns of a tile have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    Narrow,
    Wide,
    Flat,
    /// With so many bits for a boundary, one of [`PACKED_BITS`].
    Packed(u32),
}

impl Form {
    /// The form of columns `ny` high, unless a tile says otherwise.
    pub fn of(ny: u32) -> Form {
        if ny <= 256 { Form::Narrow } else { Form::Wide }
    }

    /// Bytes that [`encode`] takes for a column.
    pub fn len(self, runs: &[Run]) -> usize {
        match self {
            _ if runs.is_empty() => 0,
            Form::Narrow => 2 * runs.len() + 1,
            Form::Wide => {
                let buckets = runs.chunk_by(|a, b| a.first() >> 8 == b.first() >> 8).count();
                WIDE_FIXED + BUCKET * buckets + 2 * runs.len()
            }
            Form::Flat => FLAT_RUN * runs.len() + 2,
            Form::Packed(bits) => packed_len(runs.len(), bits),
        }
    }
}

fn packed_len(n_runs: usize, bits: u32) -> usize {
    (2 * n_runs * bits as usize).div_ceil(8)
}

/// Runs of a packed column, whether or not its bytes are a whole number of them.
fn packed_runs(bytes: &[u8], bits: u32) -> usize {
    8 * bytes.len() / (2 * bits as usize)
}

/// The bits from number `at` on, 57 of them at least; zero past the bytes.
#[inline]
pub(crate) fn bits_from(bytes: &[u8], at: usize) -> u64 {
    let bytes = bytes.get(at / 8..).unwrap_or_default();
    let word = bytes.first_chunk().copied().unwrap_or_else(|| {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        word
    });
    u64::from_le_bytes(word) >> (at % 8)
}

/// Start and end of run number `i` of a packed column; zero past the bytes.
#[inline]
fn packed_run(bytes: &[u8], bits: u32, i: usize) -> [u32; 2] {
    let run = bits_from(bytes, 2 * i * bits as usize);
    [run, run >> bits].map(|boundary| boundary as u32 & ((1 << bits) - 1))
}

/// What is wrong with a column's bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Byte offset in the column.
    pub at: usize,
    pub what: String,
}

/// One run, as a point query finds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Number of the run in its column.
    pub run: usize,
    /// Lowest voxel.
    pub start: u32,
    /// Voxels, at least 1 in valid columns.
    pub len: u32,
    /// Voxels in the runs before; 0 in packed columns, which do not say.
    pub color: u32,
}

/// Appends the bytes of one column. `runs` ascend and do not touch; those of a narrow column end at 256 or below, those of a
/// packed one where their bits reach.
pub fn encode(runs: &[Run], form: Form, out: &mut Vec<u8>) {
    if runs.is_empty() {
        return;
    }
    let total: u32 = runs.iter().map(|r| r.len()).sum();
    let mut before = 0;
    match form {
        Form::Narrow => {
            for run in runs {
                out.extend([run.first() as u8, before as u8]);
                before += run.len();
            }
            out.push(total as u8);
        }
        Form::Wide => {
            let buckets = runs.chunk_by(|a, b| a.first() >> 8 == b.first() >> 8);
            out.extend((buckets.clone().count() as u16).to_le_bytes());
            let mut first = 0;
            for bucket in buckets.clone() {
                out.extend([(bucket[0].first() >> 8) as u8, bucket.len() as u8]);
                out.extend((before as u16).to_le_bytes());
                out.extend((first as u16).to_le_bytes());
                before += bucket.iter().map(|r| r.len()).sum::<u32>();
                first += bucket.len();
            }
            out.extend((total as u16).to_le_bytes());
            for bucket in buckets {
                let mut coff = 0;
                for run in bucket {
                    out.extend([run.first() as u8, coff as u8]);
                    coff += run.len();
                }
            }
        }
        Form::Flat => {
            for run in runs {
                out.extend(run.first().to_le_bytes());
                out.extend((before as u16).to_le_bytes());
                before += run.len();
            }
            out.extend((total as u16).to_le_bytes());
        }
        Form::Packed(bits) => {
            let (mut held, mut n_held) = (0u64, 0);
            for run in runs {
                held |= (u64::from(run.first()) | u64::from(run.end()) << bits) << n_held;
                n_held += 2 * bits;
                let whole = n_held / 8;
                out.extend_from_slice(&held.to_le_bytes()[..whole as usize]);
                (held, n_held) = (held >> (8 * whole), n_held % 8);
            }
            out.extend((n_held > 0).then_some(held as u8));
        }
    }
}

/// Appends the runs of one column `ny` high, after checking every byte of it.
pub fn decode(bytes: &[u8], form: Form, ny: u32, out: &mut Vec<Run>) -> Result<(), Fault> {
    decode_first(bytes, bytes.len(), form, ny, out)
}

/// The same of the column in the first `len` bytes: faster where more follow.
pub(crate) fn decode_first(rest: &[u8], len: usize, form: Form, ny: u32, out: &mut Vec<Run>) -> Result<(), Fault> {
    let bytes = &rest[..len];
    if bytes.is_empty() {
        return Ok(());
    }
    let first_run = out.len();
    let mut list = Checker { ny, end: None, out };
    match form {
        Form::Narrow => {
            let n = (bytes.len() - 1) / 2;
            if n == 0 || bytes.len().is_multiple_of(2) {
                return fault(0, format!("{} bytes; a narrow column has 2 a run and 1", bytes.len()));
            }
            let total = wrap(u32::from(bytes[2 * n]), 256);
            list.bucket(0, 0, 0, &bytes[..2 * n], total)
        }
        Form::Wide => {
            let m = get_u16(bytes, 0).unwrap_or(0) as usize;
            let runs_at = WIDE_FIXED + BUCKET * m;
            if m == 0 || runs_at > bytes.len() || !(bytes.len() - runs_at).is_multiple_of(2) {
                return fault(
                    0,
                    format!("{m} buckets in {} bytes; a wide column has 4, 6 a bucket, 2 a run", bytes.len()),
                );
            }
            let n = (bytes.len() - runs_at) / 2;
            let total = wrap(get_u16(bytes, runs_at - 2).expect("in bounds"), 65_536);
            let mut hi_before = None;
            for i in 0..m {
                let at = 2 + BUCKET * i;
                let bucket = Bucket::get(bytes, i).expect("in bounds");
                let Bucket { hi, runs, word, first } = bucket;
                if hi_before.is_some_and(|before| hi <= before) {
                    return fault(at, format!("bucket {hi} after bucket {}; buckets ascend", hi_before.unwrap_or(0)));
                }
                hi_before = Some(hi);
                let known = list.out.len() - first_run;
                if first as usize != known {
                    return fault(at + 4, format!("{first} runs before bucket {hi}, {known} were expected"));
                }
                let end = first as usize + runs as usize;
                if runs == 0 || end > n || (i == m - 1 && end != n) {
                    return fault(at + 1, format!("bucket {hi} has runs {first} to {end} of a column with {n}"));
                }
                let next_word = Bucket::get(bytes, i + 1).filter(|_| i + 1 < m).map_or(total, |b| b.word);
                list.bucket(
                    hi * 256,
                    word,
                    runs_at + 2 * first as usize,
                    &bytes[runs_at..][2 * first as usize..2 * end],
                    next_word,
                )?;
            }
            Ok(())
        }
        Form::Flat => {
            if bytes.len() < FLAT_RUN + 2 || bytes.len() % FLAT_RUN != 2 {
                return fault(0, format!("{} bytes; a flat column has 4 a run and 2", bytes.len()));
            }
            let n = bytes.len() / FLAT_RUN;
            let at = |i: usize| get_u16(bytes, FLAT_RUN * i).expect("in bounds");
            let color = |i: usize| get_u16(bytes, FLAT_RUN * i + 2).expect("in bounds");
            if color(0) != 0 {
                return fault(2, format!("first colour offset {}, 0 was expected", color(0)));
            }
            for i in 0..n {
                let next = if i + 1 < n { color(i + 1) } else { wrap(at(n), 65_536) };
                list.run(FLAT_RUN * i, FLAT_RUN * i + 2, at(i), color(i), next)?;
            }
            Ok(())
        }
        Form::Packed(bits) => {
            let n = packed_runs(bytes, bits);
            if n == 0 || packed_len(n, bits) != bytes.len() {
                return fault(0, format!("{} bytes; a packed column has {} bits a run", bytes.len(), 2 * bits));
            }
            let used = 2 * n * bits as usize % 8;
            if used > 0 && bytes[bytes.len() - 1] >> used != 0 {
                return fault(bytes.len() - 1, "bits behind the last run, zero was expected".into());
            }
            for i in 0..n {
                let at = 2 * i * bits as usize / 8;
                let [start, end] = packed_run(rest, bits, i);
                if end <= start {
                    return fault(at, format!("run from {start} to {end}; a run ends above its start"));
                }
                list.push(at, start, end)?;
            }
            Ok(())
        }
    }
}

/// Runs and voxels of a column. On bytes that [`decode`] would refuse the answer is arbitrary, but there is no panic.
pub fn count(bytes: &[u8], form: Form) -> [usize; 2] {
    if bytes.is_empty() {
        return [0; 2];
    }
    let runs = count_runs(bytes, form);
    let total = match form {
        Form::Narrow => wrap(u32::from(bytes[bytes.len() - 1]), 256),
        Form::Wide => {
            let lists = WIDE_FIXED + BUCKET * get_u16(bytes, 0).unwrap_or(0) as usize;
            wrap(get_u16(bytes, lists - 2).unwrap_or(0), 65_536)
        }
        Form::Flat => wrap(get_u16(bytes, bytes.len().saturating_sub(2)).unwrap_or(0), 65_536),
        Form::Packed(bits) => {
            let len = |[start, end]: [u32; 2]| end.saturating_sub(start);
            (0..runs).map(|i| len(packed_run(bytes, bits, i))).sum()
        }
    };
    [runs, total as usize]
}

/// The first of [`count`].
#[inline]
pub fn count_runs(bytes: &[u8], form: Form) -> usize {
    match form {
        _ if bytes.is_empty() => 0,
        Form::Narrow => bytes.len() / 2,
        Form::Wide => {
            let lists = WIDE_FIXED + BUCKET * get_u16(bytes, 0).unwrap_or(0) as usize;
            bytes.len().saturating_sub(lists) / 2
        }
        Form::Flat => bytes.len() / FLAT_RUN,
        Form::Packed(bits) => packed_runs(bytes, bits),
    }
}

/// The run that holds voxel `y`: its number in the column and the voxel's own colour position.
///
/// Two binary searches; in packed columns, which have no colour positions, the voxel's position in its run. On bytes that
/// [`decode`] would refuse the answer is arbitrary, but there is no panic.
pub fn find(bytes: &[u8], form: Form, y: u32) -> Option<(usize, u32)> {
    let place = at_or_below(bytes, form, y)?;
    (y - place.start < place.len).then(|| (place.run, place.color + (y - place.start)))
}

/// The last run that starts at or below `y`, whether or not it reaches `y`.
pub fn at_or_below(bytes: &[u8], form: Form, y: u32) -> Option<Place> {
    match form {
        Form::Narrow => {
            let n = bytes.len().saturating_sub(1) / 2;
            let run = after(n, |i| u32::from(bytes[2 * i]) <= y).checked_sub(1)?;
            let color = u32::from(bytes[2 * run + 1]);
            let end = if run + 1 < n { u32::from(bytes[2 * run + 3]) } else { wrap(u32::from(bytes[2 * n]), 256) };
            Some(Place { run, start: u32::from(bytes[2 * run]), len: end.saturating_sub(color), color })
        }
        Form::Wide => {
            let m = get_u16(bytes, 0)? as usize;
            let entry = |run: u32| bytes.get(WIDE_FIXED + BUCKET * m + 2 * run as usize..)?.get(..2);
            let mut bucket_ix = after(m, |i| Bucket::get(bytes, i).is_some_and(|b| b.hi <= y >> 8)).checked_sub(1)?;
            let mut bucket = Bucket::get(bytes, bucket_ix)?;
            let in_bucket = after(bucket.runs as usize, |i| {
                entry(bucket.first + i as u32).is_some_and(|r| bucket.hi * 256 + u32::from(r[0]) <= y)
            });
            let i = match in_bucket.checked_sub(1) {
                Some(i) => i as u32,
                // All runs of this bucket start above.
                None => {
                    bucket_ix = bucket_ix.checked_sub(1)?;
                    bucket = Bucket::get(bytes, bucket_ix)?;
                    bucket.runs.checked_sub(1)?
                }
            };
            let [lo, coff] = entry(bucket.first + i)?.try_into().expect("two bytes");
            let color = bucket.word + u32::from(coff);
            let end = if i + 1 < bucket.runs {
                bucket.word + u32::from(entry(bucket.first + i + 1)?[1])
            } else if bucket_ix + 1 < m {
                Bucket::get(bytes, bucket_ix + 1)?.word
            } else {
                wrap(get_u16(bytes, 2 + BUCKET * m)?, 65_536)
            };
            let start = bucket.hi * 256 + u32::from(lo);
            let run = (bucket.first + i) as usize;
            Some(Place { run, start, len: end.saturating_sub(color), color })
        }
        Form::Flat => {
            let n = bytes.len() / FLAT_RUN;
            let run = after(n, |i| get_u16(bytes, FLAT_RUN * i).is_some_and(|start| start <= y)).checked_sub(1)?;
            let (start, color) = (get_u16(bytes, FLAT_RUN * run)?, get_u16(bytes, FLAT_RUN * run + 2)?);
            let end = match run + 1 < n {
                true => get_u16(bytes, FLAT_RUN * run + 6)?,
                false => wrap(get_u16(bytes, FLAT_RUN * n)?, 65_536),
            };
            Some(Place { run, start, len: end.saturating_sub(color), color })
        }
        Form::Packed(bits) => {
            let n = packed_runs(bytes, bits);
            let run = after(n, |i| packed_run(bytes, bits, i)[0] <= y).checked_sub(1)?;
            let [start, end] = packed_run(bytes, bits, run);
            Some(Place { run, start, len: end.saturating_sub(start), color: 0 })
        }
    }
}

/// First `i` of `0..n` for which `holds` no longer holds.
fn after(n: usize, holds: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, n);
    while low < high {
        let mid = low + (high - low) / 2;
        if holds(mid) {
            low = mid + 1;
        } else {
            high = mid;
        }
    }
    low
}

struct Bucket {
    hi: u32,
    runs: u32,
    word: u32,
    first: u32,
}

impl Bucket {
    fn get(bytes: &[u8], i: usize) -> Option<Bucket> {
        let entry = bytes.get(2 + BUCKET * i..)?.get(..BUCKET)?;
        let [hi, runs] = [entry[0], entry[1]].map(u32::from);
        Some(Bucket { hi, runs, word: get_u16(entry, 2)?, first: get_u16(entry, 4)? })
    }
}

fn get_u16(bytes: &[u8], at: usize) -> Option<u32> {
    let bytes = bytes.get(at..at + 2)?;
    Some(u32::from(u16::from_le_bytes([bytes[0], bytes[1]])))
}

/// A total of 0 stands for all voxels of the tallest column of the form: only that one's does not fit.
fn wrap(total: u32, full: u32) -> u32 {
    if total == 0 { full } else { total }
}

fn fault<T>(at: usize, what: String) -> Result<T, Fault> {
    Err(Fault { at, what })
}

/// Checks and collects the runs of one column.
struct Checker<'a> {
    ny: u32,
    /// End of the run before.
    end: Option<u32>,
    out: &'a mut Vec<Run>,
}

impl Checker<'_> {
    /// Adds the runs of one bucket from its second-level entries, which stand `at` bytes into the column. `word` and
    /// `next_word` are the voxels before the bucket and before the next.
    fn bucket(&mut self, base: u32, word: u32, at: usize, entries: &[u8], next_word: u32) -> Result<(), Fault> {
        if entries[1] != 0 {
            return fault(at + 1, format!("first colour offset {}, 0 was expected", entries[1]));
        }
        let n = entries.len() / 2;
        for i in 0..n {
            let at = at + 2 * i;
            let (start, color) = (base + u32::from(entries[2 * i]), word + u32::from(entries[2 * i + 1]));
            let next = if i + 1 < n { word + u32::from(entries[2 * i + 3]) } else { next_word };
            self.run(at, at + 1, start, color, next)?;
        }
        Ok(())
    }

    /// Adds the run that starts at `start`, with `color` voxels in runs before it and `next` before the one after. The two
    /// numbers stand `at` and `color_at` bytes into the column.
    #[inline]
    fn run(&mut self, at: usize, color_at: usize, start: u32, color: u32, next: u32) -> Result<(), Fault> {
        if next <= color {
            return fault(color_at, format!("colour offset {color} before {next}; colour offsets ascend"));
        }
        self.push(at, start, start + (next - color))
    }

    /// Adds the run from `start` to before `end`, which is above.
    #[inline]
    fn push(&mut self, at: usize, start: u32, end: u32) -> Result<(), Fault> {
        if end > self.ny {
            return fault(at, format!("run from {start} to {end}, the column is {} high", self.ny));
        }
        if self.end.is_some_and(|before| start <= before) {
            let before = self.end.unwrap_or(0);
            return fault(at, format!("run at {start} touches the one before, which ends at {before}"));
        }
        self.end = Some(end);
        self.out.push(Run::new(start as u16, (end - 1) as u16));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Columns, testing};

    fn encoded(runs: &[Run], form: Form) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode(runs, form, &mut bytes);
        bytes
    }

    fn decoded(bytes: &[u8], form: Form, ny: u32) -> Result<Vec<Run>, Fault> {
        let mut runs = Vec::new();
        decode(bytes, form, ny, &mut runs).map(|()| runs)
    }

    /// Round trip, and `find` against the runs at every height.
    fn check(runs: &[Run], ny: u32) {
        let least = u32::BITS - runs.last().map_or(0, |r| r.end()).leading_zeros();
        let packed = [least.max(*PACKED_BITS.start()), *PACKED_BITS.end()].map(Form::Packed);
        for form in [Form::of(ny), Form::Flat].into_iter().chain(packed) {
            check_form(runs, form, ny);
        }
    }

    fn check_form(runs: &[Run], form: Form, ny: u32) {
        let bytes = encoded(runs, form);
        assert_eq!(decoded(&bytes, form, ny).as_deref(), Ok(runs));
        assert_eq!(form.len(runs), bytes.len());
        assert_eq!(count(&bytes, form), [runs.len(), runs.iter().map(|r| r.len() as usize).sum()]);
        let mut expected = vec![None; ny as usize + 300];
        let mut color = 0;
        for (i, run) in runs.iter().enumerate() {
            if let Form::Packed(_) = form {
                color = 0;
            }
            for y in u32::from(run.first())..run.end() {
                expected[y as usize] = Some((i, color));
                color += 1;
            }
        }
        for (y, &expected) in expected.iter().enumerate() {
            assert_eq!(find(&bytes, form, y as u32), expected, "y {y}");
        }
    }

    fn check_columns(columns: &Columns) {
        for ix in 0..columns.offsets().len() - 1 {
            check(&columns.runs()[columns.range(ix)], columns.ny());
        }
    }

    proptest! {
        #[test]
        fn column_rle_inverts_small_columns(columns in testing::small_world()) {
            check_columns(&columns);
        }

        #[test]
        fn column_rle_inverts_columns_of_any_height(columns in (200u32..4000).prop_flat_map(testing::tall_world)) {
            check_columns(&columns);
        }

        #[test]
        fn column_rle_never_panics_on_noise(bytes in prop::collection::vec(any::<u8>(), 0..40), m in 0u8..4, y in 0u32..70_000) {
            let mut bytes = bytes;
            for form in [Form::Narrow, Form::Wide, Form::Flat].into_iter().chain(PACKED_BITS.map(Form::Packed)) {
                let _ = (decoded(&bytes, form, 65_536), find(&bytes, form, y), count(&bytes, form));
            }
            // A likely number of buckets gets further.
            if bytes.len() >= 2 {
                bytes[..2].copy_from_slice(&[m, 0]);
            }
            let _ = (decoded(&bytes, Form::Wide, 65_536), find(&bytes, Form::Wide, y));
        }

        #[test]
        fn column_rle_accepts_only_what_it_would_write(bytes in prop::collection::vec(0u8..6, 0..24)) {
            let packed = PACKED_BITS.map(|bits| (Form::Packed(bits), 65_536));
            for (form, ny) in [(Form::Narrow, 256), (Form::Wide, 65_536), (Form::Flat, 65_536)].into_iter().chain(packed) {
                if let Ok(runs) = decoded(&bytes, form, ny) {
                    prop_assert_eq!(encoded(&runs, form), &bytes[..]);
                }
            }
        }
    }

    #[test]
    fn column_rle_holds_the_extreme_columns() {
        let every_second = |ny: u32, odd: u32| -> Vec<Run> {
            (0..ny / 2).map(|i| (2 * i + odd) as u16).map(|y| Run::new(y, y)).collect()
        };
        for ny in [1, 2, 255, 256, 257, 512, 65_535, 65_536] {
            check(&[], ny);
            check(&[Run::new(0, (ny - 1) as u16)], ny);
            check(&[Run::new((ny - 1) as u16, (ny - 1) as u16)], ny);
            check(&every_second(ny, 0), ny);
            check(&every_second(ny, 1), ny);
            if ny > 2 {
                check(&[Run::new(0, 0), Run::new(2, (ny - 1) as u16)], ny);
                check(&[Run::new(0, (ny - 3) as u16), Run::new((ny - 1) as u16, (ny - 1) as u16)], ny);
            }
        }
    }

    #[test]
    fn column_rle_bytes_are_as_documented() {
        let runs = [Run::new(3, 4), Run::new(9, 9)];
        assert_eq!(encoded(&runs, Form::Narrow), [3, 0, 9, 2, 3]);
        assert_eq!(encoded(&[Run::new(0, 255)], Form::Narrow), [0, 0, 0]);
        let runs = [Run::new(3, 4), Run::new(9, 0x0201), Run::new(0x0203, 0x0203), Run::new(0x0210, 0x0211)];
        #[rustfmt::skip]
        assert_eq!(encoded(&runs, Form::Wide), [
            2, 0,
            0, 2, 0, 0, 0, 0,
            2, 2, 0xFB, 1, 2, 0,
            0xFE, 1,
            3, 0, 9, 2, 3, 0, 0x10, 1,
        ]);
        assert_eq!(encoded(&[Run::new(0, 65_535)], Form::Wide), [1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(encoded(&[Run::new(3, 4), Run::new(9, 0x0201)], Form::Flat), [3, 0, 0, 0, 9, 0, 2, 0, 0xFB, 1]);
        assert_eq!(encoded(&[Run::new(0, 65_535)], Form::Flat), [0; 6]);
        // 3, 5, 9, 10 of 4 bits each; then of 9 bits: 000000011, 100000101 from the right.
        let runs = [Run::new(3, 4), Run::new(9, 9)];
        assert_eq!(encoded(&runs, Form::Packed(4)), [0x53, 0xA9]);
        assert_eq!(encoded(&[Run::new(3, 0x104)], Form::Packed(9)), [0b0000_0011, 0b0000_1010, 0b10]);
        assert_eq!(encoded(&[Run::new(0, 65_535)], Form::Packed(17)), [0, 0, 0, 0, 0b10]);
    }

    #[test]
    fn column_rle_names_what_is_wrong_and_where() {
        let narrow = |bytes: &[u8]| decoded(bytes, Form::Narrow, 200).map_err(|f| (f.at, f.what)).unwrap_err();
        assert_eq!(narrow(&[1, 0]), (0, "2 bytes; a narrow column has 2 a run and 1".into()));
        assert_eq!(narrow(&[1, 1, 9]), (1, "first colour offset 1, 0 was expected".into()));
        assert_eq!(narrow(&[1, 0, 9, 2, 2]), (3, "colour offset 2 before 2; colour offsets ascend".into()));
        assert_eq!(narrow(&[190, 0, 11]), (0, "run from 190 to 201, the column is 200 high".into()));
        assert_eq!(narrow(&[1, 0, 3, 2, 4]), (2, "run at 3 touches the one before, which ends at 3".into()));
        assert_eq!(narrow(&[0, 0, 0]), (0, "run from 0 to 256, the column is 200 high".into()));

        let wide = |bytes: &[u8]| decoded(bytes, Form::Wide, 1000).map_err(|f| (f.at, f.what)).unwrap_err();
        assert_eq!(wide(&[0]).0, 0);
        assert_eq!(wide(&[1, 0, 0, 1, 0, 0, 0, 0]).1, "1 buckets in 8 bytes; a wide column has 4, 6 a bucket, 2 a run");
        let good = encoded(&[Run::new(3, 4), Run::new(600, 700)], Form::Wide);
        let planted = |at: usize, value: u8| {
            let mut bytes = good.clone();
            bytes[at] = value;
            wide(&bytes)
        };
        assert_eq!(planted(8, 0), (8, "bucket 0 after bucket 0; buckets ascend".into()));
        assert_eq!(planted(12, 0), (12, "0 runs before bucket 2, 1 were expected".into()));
        assert_eq!(planted(9, 2), (9, "bucket 2 has runs 1 to 3 of a column with 2".into()));
        assert_eq!(planted(4, 5).1, "colour offset 5 before 2; colour offsets ascend");

        let flat = |bytes: &[u8]| decoded(bytes, Form::Flat, 200).map_err(|f| (f.at, f.what)).unwrap_err();
        assert_eq!(flat(&[1, 0]), (0, "2 bytes; a flat column has 4 a run and 2".into()));
        assert_eq!(flat(&[1, 0, 1, 0, 9, 0]), (2, "first colour offset 1, 0 was expected".into()));
        assert_eq!(
            flat(&[1, 0, 0, 0, 9, 0, 2, 0, 2, 0]),
            (6, "colour offset 2 before 2; colour offsets ascend".into())
        );
        assert_eq!(flat(&[190, 0, 0, 0, 11, 0]), (0, "run from 190 to 201, the column is 200 high".into()));
        assert_eq!(
            flat(&[1, 0, 0, 0, 3, 0, 2, 0, 4, 0]),
            (4, "run at 3 touches the one before, which ends at 3".into())
        );

        let packed = |bytes: &[u8]| decoded(bytes, Form::Packed(9), 200).map_err(|f| (f.at, f.what)).unwrap_err();
        let of = |ends: [u32; 4]| {
            let bits = ends.iter().rev().fold(0u64, |bits, &end| bits << 9 | u64::from(end));
            bits.to_le_bytes()[..5].to_vec()
        };
        assert_eq!(packed(&[1, 0]), (0, "2 bytes; a packed column has 18 bits a run".into()));
        assert_eq!(packed(&[1, 4, 4]), (2, "bits behind the last run, zero was expected".into()));
        assert_eq!(packed(&of([3, 4, 9, 9])), (2, "run from 9 to 9; a run ends above its start".into()));
        assert_eq!(packed(&of([3, 4, 9, 201])), (2, "run from 9 to 201, the column is 200 high".into()));
        assert_eq!(packed(&of([3, 4, 4, 6])), (2, "run at 4 touches the one before, which ends at 4".into()));
    }
}
