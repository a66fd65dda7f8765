//! Voxel models of Ken Silverman's programs: `.kv6` (Voxlap, Slab6), `.kvx` (Build, Slab6), and Slab6's `.vox`, which shares no more
//! than its name with MagicaVoxel's.
//!
//! ```text
//! kv6:  "Kvxl" | i32 x, y, z | 3 × f32 pivot | i32 n | n × [B G R – | u16 z | u8 faces | u8 normal]
//!       | x × u32 voxels of each x | x·y × u16 voxels of each column | perhaps "SPal" and 768 bytes
//! kvx:  each level: u32 bytes after this word | i32 x, y, z | 3 × i32 pivot | (x+1) × u32 offsets | x·(y+1) × u16 offsets
//!       | slabs [u8 z, u8 n, u8 faces, n × u8 colour]      then 768 bytes of palette, R G B from 0 to 63
//! vox:  i32 x, y, z | x·y·z × u8 colour, z fastest, 255 is air | 768 bytes of palette, as in kvx
//! ```
//! z points down; a voxel (x, y, z) becomes (x, Z−1−z, y), as in `.vxl`. Of kv6 and kvx only voxels with a face in sight are
//! stored. Faces 16 and 32 are those above and below: where neither the voxel above a gap nor the one beneath has its face
//! in sight, the gap is the inside, and solid. Sources: Slab6's slab6.txt; Voxlap's kv6 structures. Colours of palettes are
//! times 4, as Slab6 writes them when it turns one of its formats into another.

use std::path::Path;

use super::cells;
use super::spots::Spot;
use crate::model::about::Kind;
use crate::model::pieces::InMemory;
use crate::{About, Error, Result, Rgb, Run};

const PALETTE: usize = 768;
const FACE_ABOVE: u8 = 16;
const FACE_BELOW: u8 = 32;

fn fail<T>(path: &Path, at: usize, what: impl std::fmt::Display) -> Result<T> {
    Err(Error::format(path, format!("byte {at}: {what}")))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

fn half(bytes: &[u8], at: usize) -> usize {
    u16::from_le_bytes([bytes[at], bytes[at + 1]]).into()
}

/// Three sizes at byte `at`.
fn sizes(path: &Path, bytes: &[u8], at: usize) -> Result<[usize; 3]> {
    let size = |i: usize| word(bytes, at + 4 * i).filter(|&n| (1..=65_536).contains(&n)).map(|n| n as usize);
    match (size(0), size(1), size(2)) {
        (Some(x), Some(y), Some(z)) => Ok([x, y, z]),
        _ => fail(path, at, "expected three sizes of 1 to 65536"),
    }
}

fn about(format: &str) -> About {
    About { axes: "x is x, y is z, z points down".to_owned(), ..About::new(Kind::Model, format) }
}

/// Colours of a palette whose values reach 63, or where a writer did not know that, 255.
fn palette(bytes: &[u8]) -> impl Fn(u8) -> Rgb {
    let bytes: Vec<u8> = bytes[bytes.len() - PALETTE..].to_vec();
    let times = if bytes.iter().all(|&v| v < 64) { 4 } else { 1 };
    move |i| [0, 1, 2].map(|c| bytes[3 * usize::from(i) + c] * times)
}

/// A voxel of a column: height above the ground, colour, faces in sight.
type Voxel = (u16, Rgb, u8);

/// Puts columns together, each from the top down, and fills what their faces say is inside.
struct Model {
    dims: [u32; 3],
    spots: Vec<Spot>,
    inside: Vec<(u32, Run)>,
    faces: u8,
    /// Gaps of which one side says that it is inside and the other that it is not.
    disputed: u64,
}

impl Model {
    fn new(path: &Path, [x, y, z]: [usize; 3]) -> Result<Model> {
        let dims = cells::dims(path, [x, z, y].map(|n| n as u64))?;
        Ok(Model { dims, spots: Vec::new(), inside: Vec::new(), faces: 0, disputed: 0 })
    }

    fn column(&mut self, x: usize, y: usize, voxels: &mut [Voxel]) {
        let column = y as u32 * self.dims[0] + x as u32;
        voxels.sort_by_key(|v| std::cmp::Reverse(v.0));
        for pair in voxels.windows(2) {
            let [(above, _, below_it), (beneath, _, above_it)] = [pair[0], pair[1]];
            // Not `beneath + 1`: a damaged file may have two voxels at 65535.
            if above - beneath > 1 {
                match (below_it & FACE_BELOW == 0, above_it & FACE_ABOVE == 0) {
                    (true, true) => self.inside.push((column, Run::new(beneath + 1, above - 1))),
                    (false, false) => {}
                    _ => self.disputed += 1,
                }
            }
        }
        for &(y, color, faces) in &*voxels {
            self.faces |= faces;
            self.spots.push(Spot { column, y, color });
        }
    }

    fn finish(mut self, mut about: About) -> InMemory {
        let n = self.spots.len();
        let filled: u64 = self.inside.iter().map(|(_, run)| u64::from(run.len())).sum();
        about.rule = if self.faces == 0 {
            self.inside.clear();
            format!("{n} voxels; none says which of its faces are in sight, so nothing is filled")
        } else {
            format!("{n} voxels of the surface, and {filled} inside that its faces enclose")
        };
        if self.disputed > 0 {
            about.left_out.push(format!("{} gaps that one side calls inside and the other does not", self.disputed));
        }
        InMemory::new(cells::input(self.dims, self.spots, self.inside)).about(about)
    }
}

pub(super) fn kv6(path: &Path, bytes: &[u8]) -> Result<InMemory> {
    if !bytes.starts_with(b"Kvxl") {
        return fail(path, 0, "expected \"Kvxl\"");
    }
    let [x, y, z] = sizes(path, bytes, 4)?;
    let Some(n) = word(bytes, 28).map(|n| n as usize) else { return fail(path, 28, "the file ends inside its header") };
    let lens = 32 + 8 * n;
    let end = lens + 4 * x + 2 * x * y;
    if end > bytes.len() {
        let what = format!("{n} voxels in {x} × {y} columns need {end} bytes, the file has {}", bytes.len());
        return fail(path, 4, format!("{what}; it was cut short or is damaged"));
    }
    let mut model = Model::new(path, [x, y, z])?;
    let (mut at, mut column) = (32, Vec::new());
    for ix in 0..x {
        let begun = at;
        for iy in 0..y {
            let len_at = lens + 4 * x + 2 * (ix * y + iy);
            let len = half(bytes, len_at);
            if at + 8 * len > lens {
                return fail(
                    path,
                    len_at,
                    format!("column ({ix}, {iy}) claims {len} voxels, {} are left", (lens - at) / 8),
                );
            }
            column.clear();
            for v in bytes[at..at + 8 * len].chunks_exact(8) {
                let iz = half(v, 4);
                if iz >= z {
                    return fail(path, at, format!("column ({ix}, {iy}) has a voxel at z {iz}, the model is {z} high"));
                }
                column.push(((z - 1 - iz) as u16, [v[2], v[1], v[0]], v[6]));
            }
            at += 8 * len;
            model.column(ix, iy, &mut column);
        }
        let claimed = word(bytes, lens + 4 * ix).map(|n| n as usize);
        if claimed != Some((at - begun) / 8) {
            let what = format!("x {ix} claims {} voxels, its columns have {}", claimed.unwrap_or(0), (at - begun) / 8);
            return fail(path, lens + 4 * ix, what);
        }
    }
    if at != lens {
        return fail(path, 28, format!("{n} voxels, of which columns have {}", (at - 32) / 8));
    }
    let mut about = about("Voxlap kv6");
    let rest = &bytes[end..];
    let suggested = rest.starts_with(b"SPal") && rest.len() == 4 + PALETTE;
    if !rest.is_empty() && !suggested {
        about.left_out.push(format!("{} bytes after the voxels", rest.len()));
    }
    Ok(model.finish(about))
}

pub(super) fn kvx(path: &Path, bytes: &[u8]) -> Result<InMemory> {
    let Some(len) = word(bytes, 0).map(|n| n as usize) else {
        return fail(path, 0, "the file has no length of a level");
    };
    let end = 4 + len;
    if end + PALETTE > bytes.len() {
        let what = format!("the first level ends at byte {end}, and a palette of {PALETTE} bytes is to follow");
        return fail(path, 0, format!("{what}, but the file has {} bytes; is it a .kvx?", bytes.len()));
    }
    let [x, y, z] = sizes(path, bytes, 4)?;
    let tables = 4 * (x + 1) + 2 * x * (y + 1);
    if 28 + tables > end {
        return fail(path, 4, format!("{x} × {y} columns need tables of {tables} bytes, the level has {len}"));
    }
    if word(bytes, 28) != Some(tables as u32) {
        return fail(path, 28, format!("the first offset is {:?}, expected {tables}", word(bytes, 28).unwrap_or(0)));
    }
    let color = palette(bytes);
    let mut model = Model::new(path, [x, y, z])?;
    let mut column = Vec::new();
    for ix in 0..x {
        let base = 28 + word(bytes, 28 + 4 * ix).unwrap_or(0) as usize;
        for iy in 0..y {
            let table = 28 + 4 * (x + 1) + 2 * (ix * (y + 1) + iy);
            let (mut at, to) = (base + half(bytes, table), base + half(bytes, table + 2));
            if at > to || to > end {
                return fail(
                    path,
                    table,
                    format!("column ({ix}, {iy}) has bytes {at} to {to} of a level that ends at {end}"),
                );
            }
            column.clear();
            while at < to {
                let slab = bytes.get(at..at + 3).filter(|s| at + 3 + usize::from(s[1]) <= to);
                let Some(&[top, n, faces]) = slab else {
                    return fail(path, at, format!("column ({ix}, {iy}) ends inside a slab"));
                };
                let (top, n) = (usize::from(top), usize::from(n));
                if top + n > z {
                    return fail(path, at, format!("a slab reaches z {}, the model is {z} high", top + n - 1));
                }
                for k in 0..n {
                    // A slab's upper face is that of its first voxel, its lower one that of its last.
                    let hidden = (u8::from(k > 0) * FACE_ABOVE) | (u8::from(k + 1 < n) * FACE_BELOW);
                    column.push(((z - 1 - top - k) as u16, color(bytes[at + 3 + k]), faces & !hidden));
                }
                at += 3 + n;
            }
            model.column(ix, iy, &mut column);
        }
    }
    let mut about = about("kvx");
    let (mut at, palette_at, mut n) = (end, bytes.len() - PALETTE, 0);
    while let Some(len) = word(bytes, at).filter(|&len| len >= 24 && at + 4 + len as usize <= palette_at) {
        (at, n) = (at + 4 + len as usize, n + 1);
    }
    if n > 0 {
        about.left_out.push(format!("{n} coarser levels"));
    }
    if at < palette_at {
        about.left_out.push(format!("{} bytes before the palette", palette_at - at));
    }
    Ok(model.finish(about))
}

/// Whether a file of this length is a Slab6 `.vox`.
pub(super) fn is_slab6(head: &[u8], len: u64) -> bool {
    let size = |i: usize| word(head, 4 * i).filter(|&n| n > 0).map(u64::from);
    let voxels = (|| size(0)?.checked_mul(size(1)?)?.checked_mul(size(2)?))();
    voxels.and_then(|n| n.checked_add(12 + PALETTE as u64)) == Some(len)
}

pub(super) fn slab6(path: &Path, bytes: &[u8]) -> Result<InMemory> {
    if !is_slab6(bytes, bytes.len() as u64) {
        let what = "expected three sizes, a byte a voxel and a palette of 768 bytes, as a Slab6 .vox has them";
        return fail(path, 0, format!("{what}; the file has {} bytes", bytes.len()));
    }
    let [x, y, z] = sizes(path, bytes, 0)?;
    let dims = cells::dims(path, [x, z, y].map(|n| n as u64))?;
    let color = palette(bytes);
    let mut spots = Vec::new();
    for (i, column) in bytes[12..12 + x * y * z].chunks_exact(z).enumerate() {
        let number = (i % y) as u32 * dims[0] + (i / y) as u32;
        let solid = column.iter().enumerate().filter(|(_, v)| **v != 255);
        spots.extend(solid.map(|(iz, &v)| Spot { column: number, y: (z - 1 - iz) as u16, color: color(v) }));
    }
    let rule = format!("{} voxels, 255 is air", spots.len());
    Ok(InMemory::new(cells::input(dims, spots, Vec::new())).about(About { rule, ..about("Slab6 vox") }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::pieces::Pieces;

    /// Found by fuzzing.
    #[test]
    fn a_voxel_that_stands_twice_at_the_top_of_a_column_fills_nothing() {
        let mut model = Model::new(Path::new("m.kvx"), [1, 1, 1 << 16]).unwrap();
        model.column(
            0,
            0,
            &mut [(u16::MAX, [1; 3], FACE_ABOVE), (u16::MAX, [2; 3], FACE_ABOVE), (9, [3; 3], FACE_BELOW)],
        );
        assert_eq!((model.inside.len(), model.disputed), (1, 0));
        assert_eq!(model.inside[0], (0, Run::new(10, u16::MAX - 1)));
        let input = model.finish(About::default());
        assert_eq!(input.dims(), [1, 1 << 16, 1]);
    }
}
