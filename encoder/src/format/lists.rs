//! Whether all run lists of a section are right, and how much they hold: several times faster than by [`column_rle::decode`],
//! which says what is wrong where.
//!
//! A run is a *slot* of `2·BITS` bits: its start, and above that its end (packed) or the number of voxels in the runs before it
//! (narrow and flat, here *counted*; behind the last is the total). A column of at most 16 bytes, as nearly all are, is one word
//! of 64 or 128 bits, and its slots are subtracted from each other all at once: what is subtracted from has the highest bit of each
//! slot set, so that nothing is borrowed from the next; the bit is still set where the difference is at least 1. Nothing
//! branches on what such a column holds.
//!
//! ```text
//! packed   start | end | start | end …        ends lie above starts, starts above the end before
//! counted  start | before | start | before …  voxels before and air before, which is start - before, ascend
//! ```

use std::ops::{Add, BitAnd, BitOr, BitOrAssign, BitXor, Not, Shl, Shr, Sub};

use crate::Run;
use crate::format::column_rle::{self, Form};

/// The lists of a section.
#[derive(Clone, Copy)]
pub struct Lists<'a> {
    /// The blob.
    pub bytes: &'a [u8],
    /// Where the section starts in it, behind the blob's header.
    pub at: usize,
    /// Where each column starts in the section, and where the last ends: ascending, inside the section.
    pub starts: &'a [u32],
    pub form: Form,
    /// No run may end above.
    pub highest: u32,
    /// Of surface tiles the fill bits, and what follows them.
    pub fill: Option<&'a [u8]>,
}

/// What lists hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Held {
    pub runs: u64,
    pub voxels: u64,
    /// Voxels of the gaps whose fill bit is set.
    pub filled: u64,
    /// Start of the lowest run, [`u32::MAX`] where there is none, and end of the highest.
    pub lowest: u32,
    pub end: u32,
}

impl Held {
    pub const NOTHING: Held = Held { runs: 0, voxels: 0, filled: 0, lowest: u32::MAX, end: 0 };

    fn add(&mut self, other: &Held) {
        self.runs += other.runs;
        self.voxels += other.voxels;
        self.filled += other.filled;
        self.lowest = self.lowest.min(other.lowest);
        self.end = self.end.max(other.end);
    }
}

/// What is read in front of a word: a column's last bytes.
const TAIL: usize = 8;
/// Columns whose differences are added up slot by slot, at most; and columns that are looked at as words of one length.
const TOGETHER: usize = 1 << 12;
const ALIKE: usize = 1 << 6;

/// Unsigned integers that hold columns.
trait Word:
    Copy
    + PartialEq
    + From<u64>
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
    + BitXor<Output = Self>
    + Not<Output = Self>
    + BitOrAssign
    + Add<Output = Self>
    + Sub<Output = Self>
    + Shl<u32, Output = Self>
    + Shr<u32, Output = Self>
{
    const BYTES: usize;

    fn from_bytes(bytes: &[u8]) -> Self;
    fn wrapping_add(self, other: Self) -> Self;
    fn low_u64(self) -> u64;

    fn low_bits(n: u32) -> Self {
        if n == 0 { Self::from(0) } else { !Self::from(0) >> (8 * Self::BYTES as u32 - n) }
    }
}

macro_rules! word {
    ($($t:ty)+) => {$(
        impl Word for $t {
            const BYTES: usize = size_of::<$t>();

            fn from_bytes(bytes: &[u8]) -> $t {
                <$t>::from_le_bytes(bytes.try_into().expect("of that length"))
            }

            fn wrapping_add(self, other: $t) -> $t {
                <$t>::wrapping_add(self, other)
            }

            fn low_u64(self) -> u64 {
                self as u64
            }
        }
    )+};
}

word!(u64 u128);

/// Calls `check_words::<BITS, PACKED, FILL>`.
macro_rules! check {
    ($lists:ident, $packed:literal, $bits:expr, $($n:literal)+) => {
        match ($bits, $lists.fill.is_some()) {
            $(
                ($n, false) => $lists.check_words::<$n, $packed, false>(),
                ($n, true) => $lists.check_words::<$n, $packed, true>(),
            )+
            (bits, _) => unreachable!("columns with {bits} bits a boundary were refused"),
        }
    };
}

/// What columns of one length are looked at with.
#[derive(Clone, Copy)]
struct Shape<W> {
    /// The lower half of each slot.
    low: W,
    /// What is added before something is subtracted: the slots' highest bits less 1 in each.
    add: W,
    /// The highest bit of each slot, and of each but the last.
    tops: W,
    inner_tops: W,
    /// `1 << BITS` in each slot, which keeps differences of its halves above 0.
    lift: W,
    /// Bits behind the last run.
    padding: W,
    /// The same, counted.
    n_padding: u32,
    runs: u32,
    /// All bits where there is no run.
    none: u32,
    /// The runs' fill bits, and the last of them.
    fill: u16,
    last_fill: u16,
    /// 1 where no column has this length.
    wrong: u32,
}

impl<W: Word> Shape<W> {
    fn new<const BITS: u32, const PACKED: bool>(len: usize) -> Shape<W> {
        let (slot, n_bits) = (2 * BITS, 8 * len as u32);
        let runs = if PACKED { n_bits / slot } else { n_bits.saturating_sub(BITS) / slot };
        let used = if PACKED { (slot * runs).next_multiple_of(8) } else { slot * runs + BITS };
        let every = |n: u32, bit: u32| (0..n).fold(W::from(0), |word, i| word | W::from(1) << (i * slot + bit));
        let lows = (0..BITS).fold(W::from(0), |word, bit| word | every(runs, bit));
        Shape {
            low: lows,
            add: every(runs, slot - 1) - every(runs, 0),
            tops: every(runs, slot - 1),
            inner_tops: every(runs.saturating_sub(1), slot - 1),
            lift: every(runs, BITS),
            padding: if PACKED { W::low_bits(n_bits) & !W::low_bits(slot * runs) } else { W::from(0) },
            n_padding: if PACKED { n_bits - slot * runs } else { 0 },
            runs,
            none: if runs > 0 { 0 } else { u32::MAX },
            // Sixteen runs are only where there is no fill.
            fill: ((1u32 << runs) - 1) as u16,
            last_fill: ((1u32 << runs) >> 1) as u16,
            wrong: u32::from(len > 0 && (runs == 0 || used != n_bits)),
        }
    }
}

/// What was found in columns of a word each.
struct Words<W, const BITS: u32, const PACKED: bool, const FILL: bool> {
    shapes: [Shape<W>; 17],
    /// The slots that fill bits stand for, eight at most.
    filled: [W; 256],
    found: Found<W>,
    /// Lengths of runs, and gaps with fill, added up.
    lens: u64,
    gaps: u64,
}

#[derive(Clone, Copy)]
struct Found<W> {
    held: Held,
    /// Of lengths of runs, and of gaps with fill, one less than they are, the sum in each slot.
    lens: W,
    gaps: W,
    /// What should be 0; of slots only the highest bits matter.
    wrong: u32,
    wrong_slots: W,
    stray: W,
}

impl<W: Word, const BITS: u32, const PACKED: bool, const FILL: bool> Words<W, BITS, PACKED, FILL> {
    const SLOT: u32 = 2 * BITS;

    fn new() -> Self {
        let zero = W::from(0);
        let slots = |fill: usize| {
            let set = (0..8 * W::BYTES as u32 / Self::SLOT).take(8).filter(|i| fill >> i & 1 == 1);
            set.fold(zero, |word, i| word | W::low_bits(Self::SLOT) << (i * Self::SLOT))
        };
        Words {
            shapes: std::array::from_fn(|len| Shape::new::<BITS, PACKED>(len.min(W::BYTES))),
            filled: if FILL { std::array::from_fn(slots) } else { [zero; 256] },
            found: Found { held: Held::NOTHING, lens: zero, gaps: zero, wrong: 0, wrong_slots: zero, stray: zero },
            lens: 0,
            gaps: 0,
        }
    }

    /// Looks at the columns between `starts`; at those longer than a word, of which `longer` tells, run by run.
    #[inline(never)]
    fn look(&mut self, lists: &Lists, starts: &[u32], longer: &mut Held) -> Option<()> {
        let fill = lists.fill.unwrap_or_default();
        // In registers until all were looked at.
        let mut found = self.found;
        for pair in starts.windows(2) {
            let (start, len) = (pair[0] as usize, (pair[1] - pair[0]) as usize);
            let around = lists.bytes.get(lists.at + start - TAIL..lists.at + start + W::BYTES);
            let set = if FILL { fill.get(start / 16..start / 16 + 2) } else { Some(&[0, 0][..]) };
            match (around, set) {
                (Some(around), Some(set)) if len <= W::BYTES => {
                    let set = u16::from_le_bytes([set[0], set[1]]) >> (start / 2 % 8);
                    found.look::<BITS, PACKED, FILL>(&self.shapes[len], around, len, set, &self.filled);
                }
                _ => longer.add(&lists.check_long::<BITS, PACKED, FILL>(start, len)?),
            }
        }
        self.found = found;
        Some(())
    }

    /// To be called before a slot overflows.
    fn flush(&mut self) {
        let sum = |slots: &mut W| {
            let (mut rest, mut sum) = (std::mem::replace(slots, W::from(0)), 0);
            while rest != W::from(0) {
                sum += (rest & W::low_bits(Self::SLOT)).low_u64();
                rest = rest >> Self::SLOT;
            }
            sum
        };
        self.lens += sum(&mut self.found.lens);
        self.gaps += sum(&mut self.found.gaps);
    }

    /// What the columns hold, None where one is not right.
    fn finish(self) -> Option<Held> {
        let every = (1..=8 * W::BYTES as u32 / Self::SLOT).map(|i| W::from(1) << (i * Self::SLOT - 1));
        let tops = every.fold(W::from(0), |tops, top| tops | top);
        let zero = W::from(0);
        let Found { held, wrong, wrong_slots, stray, .. } = self.found;
        let right = wrong == 0 && wrong_slots & tops == zero && stray == zero;
        let voxels = if PACKED { self.lens + held.runs } else { held.voxels };
        right.then_some(Held { voxels, filled: held.filled + self.gaps, ..held })
    }
}

impl<W: Word> Found<W> {
    /// Looks at a column of `len` bytes, at most a word, which stand behind [`TAIL`] others; its first fill bits are in `set`.
    #[inline(always)]
    fn look<const BITS: u32, const PACKED: bool, const FILL: bool>(
        &mut self,
        shape: &Shape<W>,
        around: &[u8],
        len: usize,
        set: u16,
        filled: &[W; 256],
    ) {
        let (slot, mask) = (2 * BITS, (1u64 << BITS) - 1);
        let word = W::from_bytes(&around[TAIL..TAIL + W::BYTES]);
        // The column's last bit is the highest.
        let tail = u64::from_bytes(&around[len..len + TAIL]) << shape.n_padding;
        let from_end = |i: u32| (tail >> (u64::BITS - i * BITS) & mask) as u32;
        let (low, high) = (word & shape.low, word >> BITS & shape.low);
        self.wrong |= shape.wrong;
        // Runs are apart by the difference of these, in all slots but the last.
        let (next, here);
        let end;
        if PACKED {
            let above = (high + shape.add - low) ^ shape.tops;
            self.wrong_slots |= above;
            self.stray |= word & shape.padding;
            self.lens = self.lens.wrapping_add(above);
            (next, here) = (low >> slot, high);
            end = from_end(1);
        } else {
            let air = low + shape.lift - high;
            (next, here) = (air >> slot, air);
            self.wrong_slots |= ((high >> slot) + shape.add - high) ^ shape.inner_tops;
            self.stray |= high & W::from(mask);
            // As `column_rle` says, a total of 0 stands for what does not fit.
            let (total, before) = (from_end(1), from_end(2));
            let voxels = if total == 0 { 1 << BITS } else { total };
            self.wrong |= u32::from(voxels <= before) & !shape.none;
            self.held.voxels += u64::from(voxels & !shape.none);
            end = (from_end(3) + voxels).wrapping_sub(before);
        }
        let apart = (next + shape.add - here) ^ shape.inner_tops;
        self.wrong_slots |= apart;
        if FILL {
            let set = set & shape.fill;
            self.wrong |= u32::from(set & shape.last_fill);
            self.gaps = self.gaps.wrapping_add(apart & filled[usize::from(set as u8)]);
            self.held.filled += u64::from(set.count_ones());
        }
        self.held.runs += u64::from(shape.runs);
        self.held.lowest = self.held.lowest.min((low.low_u64() & mask) as u32 | shape.none);
        self.held.end = self.held.end.max(end & !shape.none);
    }
}

impl Lists<'_> {
    /// What the lists hold; None where [`column_rle::decode`] refuses a column, or where the fill bit of a column's last run is
    /// set.
    pub fn check(&self) -> Option<Held> {
        match self.form {
            Form::Narrow => check!(self, false, 8, 8),
            Form::Flat => check!(self, false, 16, 16),
            Form::Packed(bits) => check!(self, true, bits, 4 5 6 7 8 9 10 11 12 13 14 15 16 17),
            Form::Wide => self.check_decoded(),
        }
    }

    fn check_words<const BITS: u32, const PACKED: bool, const FILL: bool>(&self) -> Option<Held> {
        let mut short = Words::<u64, BITS, PACKED, FILL>::new();
        let mut long = Words::<u128, BITS, PACKED, FILL>::new();
        let mut held = Held::NOTHING;
        let n = self.starts.len() - 1;
        let together = TOGETHER.min(1 << BITS);
        for from in (0..n).step_by(together) {
            let to = n.min(from + together);
            for from in (from..to).step_by(ALIKE) {
                let starts = &self.starts[from..=to.min(from + ALIKE)];
                let longest = starts.windows(2).fold(0, |longest, pair| longest.max(pair[1] - pair[0]));
                match longest <= 8 {
                    true => short.look(self, starts, &mut held)?,
                    false => long.look(self, starts, &mut held)?,
                }
            }
            short.flush();
            long.flush();
        }
        held.add(&short.finish()?);
        held.add(&long.finish()?);
        (held.end <= self.highest).then_some(held)
    }

    /// One column, run by run.
    fn check_long<const BITS: u32, const PACKED: bool, const FILL: bool>(
        &self,
        start: usize,
        len: usize,
    ) -> Option<Held> {
        let (slot, mask) = (2 * BITS as usize, (1 << BITS) - 1);
        let n_bits = 8 * len;
        let runs = if PACKED { n_bits / slot } else { n_bits.saturating_sub(BITS as usize) / slot };
        let used = if PACKED { (slot * runs).next_multiple_of(8) } else { slot * runs + BITS as usize };
        if runs == 0 || used != n_bits {
            return (len == 0).then_some(Held::NOTHING);
        }
        let bytes = &self.bytes[self.at + start..];
        let bits = |at: usize| column_rle::bits_from(bytes, at);
        let is_set =
            |i: usize| self.fill.is_some_and(|fill| fill[(start / 2 + i) / 8] >> ((start / 2 + i) % 8) & 1 == 1);
        let total = match bits(slot * runs) & mask {
            0 => mask + 1,
            total => total,
        };
        let mut held = Held { runs: runs as u64, lowest: (bits(0) & mask) as u32, ..Held::NOTHING };
        let mut right = PACKED || bits(BITS as usize) & mask == 0;
        let mut end_before = 0;
        for i in 0..runs {
            let run = bits(slot * i);
            let (first, second) = (run & mask, run >> BITS & mask);
            let next = if i + 1 < runs { bits(slot * (i + 1) + BITS as usize) & mask } else { total };
            let end = if PACKED { second } else { (first + next).wrapping_sub(second) };
            right &= end > first && (PACKED || next > second) && (i == 0 || first > end_before);
            held.voxels = held.voxels.wrapping_add(end.wrapping_sub(first));
            if FILL && i > 0 && is_set(i - 1) {
                held.filled = held.filled.wrapping_add(first.wrapping_sub(end_before));
            }
            end_before = end;
        }
        held.end = u32::try_from(end_before).ok()?;
        right &= !PACKED || bits(slot * runs) & ((1 << (used - slot * runs)) - 1) == 0;
        (right && !(FILL && is_set(runs - 1))).then_some(held)
    }

    fn check_decoded(&self) -> Option<Held> {
        let mut held = Held::NOTHING;
        let mut runs: Vec<Run> = Vec::new();
        for pair in self.starts.windows(2) {
            let (start, end) = (pair[0] as usize, pair[1] as usize);
            runs.clear();
            column_rle::decode(&self.bytes[self.at + start..self.at + end], self.form, self.highest, &mut runs).ok()?;
            let (Some(first), Some(last)) = (runs.first(), runs.last()) else { continue };
            let mut filled = 0;
            if let Some(fill) = self.fill {
                let is_set = |i: usize| fill[(start / 2 + i) / 8] >> ((start / 2 + i) % 8) & 1 == 1;
                for (i, pair) in runs.windows(2).enumerate() {
                    filled += if is_set(i) { u64::from(u32::from(pair[1].first()) - pair[0].end()) } else { 0 };
                }
                if is_set(runs.len() - 1) {
                    return None;
                }
            }
            let voxels = runs.iter().map(|r| u64::from(r.len())).sum();
            let n = runs.len() as u64;
            held.add(&Held { runs: n, voxels, filled, lowest: first.first().into(), end: last.end() });
        }
        Some(held)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A blob whose section starts behind 64 bytes, and where its columns start.
    fn blob(columns: &[Vec<Run>], form: Form) -> (Vec<u8>, Vec<u32>) {
        let (mut bytes, mut starts) = (vec![0xA5; 64], vec![0]);
        for runs in columns {
            column_rle::encode(runs, form, &mut bytes);
            starts.push(bytes.len() as u32 - 64);
        }
        (bytes, starts)
    }

    /// Runs from gaps and lengths, below `ny`.
    fn runs(steps: &[(u32, u32)], ny: u32) -> Vec<Run> {
        let (mut runs, mut y) = (Vec::new(), 0);
        for &(gap, len) in steps {
            let first = y + gap;
            y = first + len;
            if y > ny {
                break;
            }
            runs.push(Run::new(first as u16, (y - 1) as u16));
            y += 1;
        }
        runs
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]

        #[test]
        fn lists_are_right_just_where_they_are_decoded_and_hold_the_same(
            form in prop_oneof![Just(Form::Narrow), Just(Form::Flat), (4..=17u32).prop_map(Form::Packed)],
            steps in prop::collection::vec(prop::collection::vec((0..9u32, prop_oneof![1..9u32, 1..70_000u32]), 0..12), 0..150),
            fill in prop::option::of(any::<u64>()),
            keep_last in 0..9u8,
            damage in prop::collection::vec((any::<prop::sample::Index>(), 0..8u32), 0..3),
            lower in 0..9u32,
            behind in 0..40usize,
        ) {
            let ny = match form {
                Form::Narrow => 256,
                Form::Packed(bits) => (1 << bits.min(16)) - u32::from(bits < 17),
                _ => 65_536,
            };
            let columns: Vec<Vec<Run>> = steps.iter().map(|steps| runs(steps, ny)).collect();
            let (mut bytes, starts) = blob(&columns, form);
            // Few bits a boundary are only where there is no fill.
            let fill = fill.filter(|_| !matches!(form, Form::Packed(..8))).map(|seed| {
                let mut bits: Vec<u8> = (0..(bytes.len() - 64).div_ceil(16) + behind)
                    .map(|i| (seed.rotate_left(i as u32 * 7) >> 3) as u8)
                    .collect();
                for (runs, &start) in columns.iter().zip(&starts).filter(|(runs, _)| !runs.is_empty()) {
                    let last = start as usize / 2 + runs.len() - 1;
                    // One in nine cases keeps a bit that is wrong where it is set.
                    bits[last / 8] &= if keep_last == 0 { 0xFF } else { !(1 << (last % 8)) };
                }
                bits
            });
            let len = bytes.len() - 64;
            for (at, bit) in damage.iter().filter(|_| len > 0) {
                bytes[64 + at.index(len)] ^= 1 << bit;
            }
            bytes.resize(bytes.len() + behind, 0x5A);
            // A bound that the highest run may or may not keep.
            let highest = if lower == 0 { columns.iter().flatten().map(|r| r.end()).max().unwrap_or(1) - 1 } else { ny };
            let lists = Lists { bytes: &bytes, at: 64, starts: &starts, form, highest, fill: fill.as_deref() };
            let expected = lists.check_decoded();
            prop_assert_eq!(lists.check(), expected);
            if damage.is_empty() && lower > 0 && (fill.is_none() || keep_last > 0) {
                prop_assert!(expected.is_some());
                prop_assert_eq!(expected.map(|held| held.runs), Some(columns.iter().flatten().count() as u64));
            }
        }
    }

    #[test]
    fn lists_of_each_kind_of_fault_are_refused() {
        let good = [(0, 4), (7, 9), (12, 13), (20, 30)].map(|(a, b)| Run::new(a, b));
        let check = |form, highest, fill: &[u8], edit: &dyn Fn(&mut Vec<u8>)| {
            let (mut bytes, starts) = blob(&[good.to_vec(), good[..1].to_vec()], form);
            bytes.resize(bytes.len() + 32, 0);
            edit(&mut bytes);
            let lists = Lists { bytes: &bytes, at: 64, starts: &starts, form, highest, fill: Some(fill) };
            lists.check()
        };
        let fine = Held { runs: 5, voxels: 5 + 3 + 2 + 11 + 5, filled: 2 + 6, lowest: 0, end: 31 };
        // The gaps above the first and the third run; bit 4 is the second column's.
        let fill = [0b0101, 0, 0, 0];
        for form in [Form::Narrow, Form::Flat, Form::Packed(8), Form::Packed(17)] {
            // A run of more bytes than two has its bit farther on.
            let second = match form {
                Form::Narrow => 9 / 2,
                Form::Flat => 18 / 2,
                Form::Packed(bits) => (8 * bits as usize).div_ceil(8) / 2,
                Form::Wide => unreachable!(),
            };
            let good = |highest, fill: &[u8]| check(form, highest, fill, &|_| {});
            assert_eq!(good(31, &fill), Some(fine), "{form:?}");
            assert_eq!(good(30, &fill), None, "{form:?}: too high");
            for last in [3, second] {
                let mut fill = fill;
                fill[last / 8] |= 1 << (last % 8);
                assert_eq!(good(31, &fill), None, "{form:?}: filled above bit {last}");
            }
        }
        // Colour offsets: the first is 0, they ascend, the total is more; starts ascend past the end before.
        for (at, value) in [(1, 1), (3, 0), (8, 10), (2, 5), (6, 4)] {
            assert_eq!(check(Form::Narrow, 31, &fill, &|bytes| bytes[64 + at] = value), None, "{at} {value}");
        }
        // Start above the end before, end above its start.
        for (at, value) in [(2, 5), (1, 0), (6, 14), (7, 20)] {
            assert_eq!(check(Form::Packed(8), 31, &fill, &|bytes| bytes[64 + at] = value), None, "{at} {value}");
        }
        // 4 runs of 34 bits leave none, 1 run leaves 6.
        assert_eq!(check(Form::Packed(17), 31, &fill, &|bytes| bytes[64 + 17 + 4] |= 4), None);
    }
}
