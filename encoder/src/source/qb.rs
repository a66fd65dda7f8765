//! Qubicle models (`.qb`).
//!
//! ```text
//! u32 version | u32 colours: 0 RGBA, 1 BGRA | u32 axes: 0 left-handed, 1 right-handed | u32 packed | u32 mask | u32 n
//! n matrices: u8 length, name | u32 x, y, z | i32 place of its low corner | voxels: x fastest, then y, then z
//! packed, for each z: a voxel | 2, u32 count, a voxel | 6 ends the slice
//! ```
//! y points up. The last byte of a voxel is 0 where it is air: else 255, or which of its faces are in sight (`mask`), which
//! says no more here. Left-handed axes are made right-handed by turning z, so that nothing is seen as in a mirror. Source:
//! Qubicle's file specification.

use std::path::Path;

use super::cells::Placed;
use crate::model::about::Kind;
use crate::model::pieces::InMemory;
use crate::{About, Error, Result};

const REPEAT: u32 = 2;
const NEXT_SLICE: u32 = 6;

/// Whether a file that begins like this is one: it has no magic, but five words of two values each.
pub(super) fn is_one(head: &[u8]) -> bool {
    let word = |i: usize| head.get(4 * i..4 * i + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    head.get(..4).is_some_and(|version| version.contains(&1) && version.iter().all(|&v| v < 16))
        && (1..5).all(|i| word(i).is_some_and(|v| v <= 1))
        && word(5).is_some_and(|n| n > 0 && n < 1 << 16)
}

struct Words<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
}

impl Words<'_> {
    fn fail<T>(&self, what: impl std::fmt::Display) -> Result<T> {
        Err(Error::format(self.path, format!("byte {}: {what}", self.at)))
    }

    fn next(&mut self) -> Result<u32> {
        let Some(word) = self.bytes.get(self.at..self.at + 4) else {
            return self.fail("the file ends here, where a word was expected; it was cut short or is damaged");
        };
        self.at += 4;
        Ok(u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
    }
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<InMemory> {
    let mut words = Words { path, bytes, at: 0 };
    if !is_one(bytes) {
        return words.fail("expected the header of Qubicle Binary (.qbt and .qbcl are other formats: export as .qb)");
    }
    words.at = 4;
    let [bgra, right, packed, masked] = [words.next()?, words.next()?, words.next()?, words.next()?].map(|v| v == 1);
    let n = words.next()?;
    let mut placed = Placed::default();
    let mut empty = 0;
    for _ in 0..n {
        let Some(&len) = bytes.get(words.at) else {
            return words.fail(format!("the file ends before all {n} matrices"));
        };
        words.at += 1 + usize::from(len);
        let begun = words.at;
        let [x, y, z] = [words.next()?, words.next()?, words.next()?].map(u64::from);
        let low = [words.next()?, words.next()?, words.next()?].map(|w| i64::from(w as i32));
        let cells = [x, y, z].iter().try_fold(1u64, |n, &side| n.checked_mul(side));
        if cells == Some(0) {
            empty += 1;
            // Packed slices without voxels still end.
            if packed {
                for _ in 0..z {
                    if words.next()? != NEXT_SLICE {
                        return words.fail("a slice without voxels has some");
                    }
                }
            }
            continue;
        }
        let left = (bytes.len() - words.at) as u64 / 4;
        if cells.is_none_or(|cells| cells > 1 << 40 || if packed { z > left } else { cells > left }) {
            words.at = begun;
            return words
                .fail(format!("a matrix of {x} × {y} × {z} voxels does not fit the {left} words that are left"));
        }
        let turned = |z: i64| if right { z } else { -1 - z };
        let far = [0, 1, 2].map(|a| low[a] + [x, y, z][a] as i64 - 1);
        let (front, back) = (turned(low[2]), turned(far[2]));
        placed.part([low[0], low[1], front.min(back)], [far[0], far[1], front.max(back)]);
        let mut put = |cell: u64, z: u64, voxel: u32| {
            let [a, b, c, _] = voxel.to_le_bytes();
            let at = [low[0] + (cell % x) as i64, low[1] + (cell / x) as i64, turned(low[2] + z as i64)];
            placed.push(path, at, if bgra { [c, b, a] } else { [a, b, c] })
        };
        for slice in 0..z {
            let mut cell = 0;
            while packed || cell < x * y {
                let (mut count, mut voxel) = (1, words.next()?);
                if packed && voxel == NEXT_SLICE {
                    break;
                }
                if packed && voxel == REPEAT {
                    (count, voxel) = (u64::from(words.next()?), words.next()?);
                }
                if cell + count > x * y {
                    return words.fail(format!("slice {slice} has more than its {x} × {y} voxels"));
                }
                if voxel.to_le_bytes()[3] != 0 {
                    (cell..cell + count).try_for_each(|cell| put(cell, slice, voxel))?;
                }
                cell += count;
            }
        }
    }
    let mut about = About {
        axes: if right { "y is up" } else { "y is up; left-handed, so z is turned" }.to_owned(),
        rule: format!(
            "{} voxels of {n} matrices{}",
            placed.len(),
            if masked { ", faces in sight not needed" } else { "" }
        ),
        ..About::new(Kind::Model, "Qubicle qb")
    };
    if empty > 0 {
        about.left_out.push(format!("{empty} matrices without a size"));
    }
    if words.at < bytes.len() {
        about.left_out.push(format!("{} bytes after the last matrix", bytes.len() - words.at));
    }
    match placed.model(path, about)? {
        Some(model) => Ok(model),
        None => Err(Error::format(path, "Qubicle: no matrix with a size")),
    }
}
