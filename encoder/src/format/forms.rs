//! The forms that tiles of version 3 take when their general layout holds what they do not need: which of them a scene
//! may use, the word of the blob's header that names them, and the heights that stand for run lists.
//!
//! The bytes are described in [`crate::format`].

use crate::format::Section;
use crate::format::column_rle::{Form, PACKED_BITS};
use crate::format::features::{FeatureSet, Named};
use crate::format::file::Modes;
use crate::{ColorMode, Columns, Encoding, Run};

/// One way in which a tile leaves out what it does not need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Feature {
    /// A height a column instead of a run list, where every column is empty or one run from y = 0 up.
    Heights,
    /// Lists without a first level, where the tile spans at most 256 heights or a first level is longer than none.
    Lists,
    /// No column tables where all columns take the same bytes; elsewhere a byte a column.
    Tables,
    /// A colour a tile, a column or a run, where finer ones say the same.
    Colors,
    /// Starts and ends of as few bits as the tile's heights need, instead of lists that number voxels.
    Packed,
}

impl Feature {
    pub const ALL: [Feature; 5] = [Feature::Heights, Feature::Lists, Feature::Tables, Feature::Colors, Feature::Packed];
}

impl Named for Feature {
    const ALL: &'static [Feature] = &Feature::ALL;

    fn name(self) -> &'static str {
        match self {
            Feature::Heights => "heights",
            Feature::Lists => "lists",
            Feature::Tables => "tables",
            Feature::Colors => "colors",
            Feature::Packed => "packed",
        }
    }
}

/// [`Feature`]s that tiles may use. None is the general layout, as of version 1.
pub type Features = FeatureSet<Feature>;

/// How a table tells where a column starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Table {
    /// A 32-bit base a row, a 16-bit offset a column.
    Short,
    /// 32 bits a column.
    Long,
    /// No table: all columns take the same.
    Even,
    /// A 32-bit base a group of columns, and a byte a column; for colours, the base alone.
    Grouped,
}

/// What stands for the runs of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lists {
    /// Run lists, of runs that start `base` higher than the list says.
    Runs { form: Form, base: u32 },
    /// The same with packed geometry, of so many bits a boundary; `base` is a multiple of 16. Exposed runs, which number
    /// voxels, are in the shorter of the forms without a first level that the level's height allows, and have no base.
    Packed { bits: u32, base: u32 },
    /// Heights: `base`, and that many bytes (0, 1 or 2) a column to add to it.
    Heights { bytes: usize, base: u32 },
}

impl Lists {
    /// Lists of the general layout.
    pub fn general(ny: u32) -> Lists {
        Lists::Runs { form: Form::of(ny), base: 0 }
    }

    /// Packed lists for the geometry of a tile whose solid voxels lie between `heights`; None where something numbers the
    /// voxels of its runs.
    pub fn packed(modes: Modes, heights: &std::ops::RangeInclusive<u16>) -> Option<Lists> {
        let base = u32::from(heights.start() & !15);
        let span = u32::from(*heights.end()) + 1 - base;
        let bits = (u32::BITS - span.leading_zeros()).max(Lists::least_bits(modes)?);
        Some(Lists::Packed { bits, base })
    }

    /// The fewest bits of a boundary that packed lists may have; None where there may be none. A bit of fill belongs to two
    /// bytes of a list, so that runs of surface scenes take at least two.
    pub fn least_bits(modes: Modes) -> Option<u32> {
        match (modes.encoding, modes.color) {
            (Encoding::Solid, _) => Some(*PACKED_BITS.start()),
            (Encoding::Surface, ColorMode::Voxel) => None,
            (Encoding::Surface, _) => Some(8),
        }
    }

    /// Form and base of the run lists of a section, in a level `ny` high.
    pub fn of(self, section: Section, ny: u32) -> (Form, u32) {
        match self {
            Lists::Runs { form, base } => (form, base),
            Lists::Packed { bits, base } if section == Section::Geometry => (Form::Packed(bits), base),
            Lists::Packed { .. } if ny <= 256 => (Form::Narrow, 0),
            Lists::Packed { .. } => (Form::Flat, 0),
            Lists::Heights { .. } => unreachable!("tiles of heights have no run lists"),
        }
    }
}

/// What a tile has one colour of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Painted {
    /// What the scene's colour mode says.
    Each,
    /// Exposed runs, in scenes with a colour a voxel.
    Run,
    Column,
    Tile,
}

/// The forms of a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Forms {
    /// Of geometry, exposure and colours.
    pub tables: [Table; 3],
    /// Columns of a group, as a power of two, in tables of geometry and exposure.
    pub group_shift: u32,
    pub lists: Lists,
    pub painted: Painted,
}

/// Bits of the word that the general layout uses: which tables are long.
pub(crate) const GENERAL: u32 = 7;
/// Columns of a group, as a power of two, in colour tables.
pub(crate) const COLOR_GROUP_SHIFT: u32 = 4;
const LEAST_SHIFT: u32 = 3;
/// [`Forms::group_shift`]s, the shortest tables first.
pub(crate) const GROUP_SHIFTS: [u32; 3] = [5, 4, LEAST_SHIFT];

impl Forms {
    /// The forms of the general layout, with short tables.
    pub fn general(ny: u32) -> Forms {
        Forms { tables: [Table::Short; 3], group_shift: LEAST_SHIFT, lists: Lists::general(ny), painted: Painted::Each }
    }

    pub fn table(&self, section: Section) -> Table {
        self.tables[table_number(section)]
    }

    pub fn table_mut(&mut self, section: Section) -> &mut Table {
        &mut self.tables[table_number(section)]
    }

    /// Bytes that the offsets of grouped tables of lists count in.
    pub fn unit(&self) -> usize {
        match self.lists {
            Lists::Runs { form: Form::Narrow, .. } | Lists::Packed { .. } => 1,
            _ => 2,
        }
    }

    /// The word in the blob's header, for a level `ny` high.
    pub fn pack(&self, ny: u32) -> u32 {
        let mut word = 0;
        for (i, table) in self.tables.iter().enumerate() {
            word |= match table {
                Table::Short => 0,
                Table::Long => 1 << i,
                Table::Even => 8 << i,
                Table::Grouped => 64 << i,
            };
        }
        if self.tables[..2].contains(&Table::Grouped) {
            word |= (self.group_shift - LEAST_SHIFT) << 9;
        }
        let (lists, base) = match self.lists {
            lists if lists == Lists::general(ny) => (0, 0),
            Lists::Runs { form: Form::Narrow, base } => (1, base),
            Lists::Runs { .. } => (2, 0),
            Lists::Heights { bytes, base } => (3 + bytes as u32, base),
            Lists::Packed { bits, base } => (6, base | (bits - PACKED_BITS.start())),
        };
        word | lists << 11 | (self.painted as u32) << 14 | base << 16
    }

    /// The forms that a word names; None where it is not one that [`Forms::pack`] gives.
    pub fn unpack(word: u32, ny: u32) -> Option<Forms> {
        let base = word >> 16;
        let tables = [0, 1, 2].map(|i| match word >> i & 0b1001001 {
            0 => Some(Table::Short),
            0b1 => Some(Table::Long),
            0b1000 => Some(Table::Even),
            0b1000000 => Some(Table::Grouped),
            _ => None,
        });
        let [Some(a), Some(b), Some(c)] = tables else { return None };
        let lists = match word >> 11 & 7 {
            0 => Lists::general(ny),
            1 => Lists::Runs { form: Form::Narrow, base },
            2 => Lists::Runs { form: Form::Flat, base },
            n @ 3..=5 => Lists::Heights { bytes: n as usize - 3, base },
            6 => Lists::Packed { bits: (base & 15) + PACKED_BITS.start(), base: base & !15 },
            _ => return None,
        };
        let painted = [Painted::Each, Painted::Run, Painted::Column, Painted::Tile][(word >> 14 & 3) as usize];
        let forms = Forms { tables: [a, b, c], group_shift: LEAST_SHIFT + (word >> 9 & 3), lists, painted };
        let in_range = match lists {
            Lists::Heights { base, .. } => base <= ny,
            Lists::Runs { base, .. } => base < ny,
            Lists::Packed { bits, base } => base < ny && PACKED_BITS.contains(&bits),
        };
        let fits = GROUP_SHIFTS.contains(&forms.group_shift) && in_range && forms.pack(ny) == word;
        fits.then_some(forms)
    }
}

/// Number of a table among the three.
fn table_number(section: Section) -> usize {
    section.long_bit().trailing_zeros() as usize
}

/// The columns of a tile as heights: column number `ix` is solid for `0 ≤ y < height(ix)`. Its exposed voxels, where the
/// tile tells them, are voxel 0 and those from `low(ix)` up.
#[derive(Clone, Copy)]
pub(crate) struct Heights<'a> {
    pub width: usize,
    pub depth: usize,
    /// Bytes a column in `above`, and what they are counted from.
    pub bytes: usize,
    pub base: u32,
    pub above: &'a [u8],
    /// `low` of the columns at the tile's edges, whose neighbours are in other tiles: u16 each, in the order of columns.
    pub edges: &'a [u8],
}

impl Heights<'_> {
    pub fn n_columns(&self) -> usize {
        self.width * self.depth
    }

    #[inline]
    pub fn height(&self, ix: usize) -> u32 {
        self.base
            + match self.bytes {
                0 => 0,
                1 => u32::from(self.above[ix]),
                _ => u32::from(u16::from_le_bytes([self.above[2 * ix], self.above[2 * ix + 1]])),
            }
    }

    /// The lowest exposed voxel above voxel 0, 0 where there is none.
    #[inline]
    pub fn low(&self, ix: usize) -> u32 {
        let h = self.height(ix);
        if h < 2 {
            return 0;
        }
        match edge(self.width, self.depth, ix) {
            Some(i) => u32::from(u16::from_le_bytes([self.edges[2 * i], self.edges[2 * i + 1]])),
            None => {
                let around = [ix - 1, ix + 1, ix - self.width, ix + self.width].map(|ix| self.height(ix));
                around.into_iter().fold(h - 1, u32::min).max(1)
            }
        }
    }

    /// Exposed runs and voxels of a column.
    pub fn count_exposed(&self, ix: usize) -> [usize; 2] {
        let (h, low) = (self.height(ix) as usize, self.low(ix) as usize);
        match h {
            0 | 1 => [h, h],
            // A forged `low` may lie above.
            _ => [1 + usize::from(low > 1), 1 + h.saturating_sub(low)],
        }
    }

    /// The exposed run and voxel of column `ix` that lie at height `y`, by number in the column.
    pub fn find_exposed(&self, ix: usize, y: u32) -> Option<[usize; 2]> {
        let (h, low) = (self.height(ix), self.low(ix));
        if y >= h || (y > 0 && y < low) {
            return None;
        }
        if y == 0 { Some([0, 0]) } else { Some([usize::from(low > 1), (1 + y - low) as usize]) }
    }

    /// The solid runs, in columns `ny` high.
    pub fn solid(&self, ny: u32) -> Columns {
        let mut offsets = Vec::with_capacity(self.n_columns() + 1);
        let mut runs = Vec::with_capacity(self.n_columns());
        offsets.push(0);
        for ix in 0..self.n_columns() {
            let h = self.height(ix);
            if h > 0 {
                runs.push(Run::new(0, (h - 1) as u16));
            }
            offsets.push(runs.len() as u32);
        }
        Columns::from_parts(self.width as u32, ny, self.depth as u32, offsets, runs)
    }

    /// The exposed runs.
    pub fn exposed(&self, ny: u32) -> Columns {
        let mut offsets = Vec::with_capacity(self.n_columns() + 1);
        let mut runs = Vec::with_capacity(2 * self.n_columns());
        offsets.push(0);
        for ix in 0..self.n_columns() {
            let (h, low) = (self.height(ix), self.low(ix));
            if h > 0 {
                if low > 1 {
                    runs.push(Run::new(0, 0));
                }
                runs.push(Run::new(if low > 1 { low as u16 } else { 0 }, (h - 1) as u16));
            }
            offsets.push(runs.len() as u32);
        }
        Columns::from_parts(self.width as u32, ny, self.depth as u32, offsets, runs)
    }
}

/// Columns at the edges of a tile.
pub(crate) fn n_edges(width: usize, depth: usize) -> usize {
    width * depth - width.saturating_sub(2) * depth.saturating_sub(2)
}

/// Number of a column among those at the edges, None inside.
#[inline]
pub(crate) fn edge(width: usize, depth: usize, ix: usize) -> Option<usize> {
    let (x, z) = (ix % width, ix / width);
    let sides = width.min(2);
    let inner_rows = depth.saturating_sub(2);
    match z {
        0 => Some(x),
        _ if z == depth - 1 => Some(width + inner_rows * sides + x),
        _ if x == 0 => Some(width + (z - 1) * sides),
        _ if x == width - 1 => Some(width + (z - 1) * sides + 1),
        _ => None,
    }
}

/// The numbers of the columns at the edges, in their order.
pub(crate) fn edges(width: usize, depth: usize) -> impl Iterator<Item = usize> {
    (0..depth).flat_map(move |z| {
        let inside = z > 0 && z + 1 < depth;
        let step = if inside { width.saturating_sub(1).max(1) } else { 1 };
        (z * width..(z + 1) * width).step_by(step)
    })
}

/// The bytes of [`Heights`] in a tile.
pub(crate) struct HeightBytes {
    pub bytes: usize,
    pub base: u32,
    pub above: Vec<u8>,
    pub edges: Vec<u8>,
}

impl HeightBytes {
    /// Of a tile whose columns are all empty or one run from 0 up, none of 65,536 voxels beside an empty one; with what is
    /// exposed, where that is given. None for other tiles.
    pub fn of(solid: &Columns, exposed: Option<&Columns>) -> Option<HeightBytes> {
        let [width, ny, depth] = solid.dims();
        let n = solid.offsets().len() - 1;
        let mut heights = Vec::with_capacity(n);
        for ix in 0..n {
            heights.push(match solid.runs()[solid.range(ix)] {
                [] => 0,
                [run] if run.first() == 0 => run.end(),
                _ => return None,
            });
        }
        // The base has 16 bits, too few for a world of columns of 65,536.
        let (base, top) = (heights.iter().min()?.min(&0xFFFF), heights.iter().max()?);
        let bytes = match top - base {
            0 => 0,
            1..=0xFF => 1,
            0x100..=0xFFFF => 2,
            _ => return None,
        };
        let above = heights.iter().flat_map(|h| ((h - base) as u16).to_le_bytes().into_iter().take(bytes)).collect();
        let mut edges = Vec::new();
        if let Some(exposed) = exposed {
            for ix in self::edges(width as usize, depth as usize) {
                let low = match (heights[ix], &exposed.runs()[exposed.range(ix)]) {
                    (0 | 1, _) => 0,
                    (_, [_]) => 1,
                    (_, [_, top]) => top.first(),
                    _ => return None,
                };
                edges.extend(low.to_le_bytes());
            }
        }
        let made = HeightBytes { bytes, base: *base, above, edges };
        // An exposure that heights do not imply stays in lists.
        if exposed.is_some_and(|e| made.heights(width as usize, depth as usize).exposed(ny) != *e) {
            return None;
        }
        Some(made)
    }

    pub fn heights(&self, width: usize, depth: usize) -> Heights<'_> {
        Heights { width, depth, bytes: self.bytes, base: self.base, above: &self.above, edges: &self.edges }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_words_are_read_as_they_are_written_and_no_others_are_read() {
        for ny in [1, 9, 256, 257, 65_536] {
            let mut read = 0;
            for word in (0..0x1_0000).flat_map(|low: u32| [0, 1, 8, 256, 65_535].map(|base| low | base << 16)) {
                if let Some(forms) = Forms::unpack(word, ny) {
                    assert_eq!(forms.pack(ny), word);
                    let base = match forms.lists {
                        Lists::Packed { base, .. } => base,
                        _ => word >> 16,
                    };
                    assert!(base <= ny);
                    read += 1;
                }
            }
            assert!(read > 1000, "{ny} {read}");
            for long in 0..=GENERAL {
                let forms = Forms::unpack(long, ny).unwrap();
                assert_eq!((forms.lists, forms.painted), (Lists::general(ny), Painted::Each));
            }
        }
        // Two forms of one table; a group without a grouped table; a base where none is; no lists; 18 bits; a base too high.
        for word in [
            1 | 8,
            64 | 1,
            1 << 9,
            3 << 9 | 64,
            5 << 16,
            7 << 11,
            2 << 11 | 5 << 16,
            6 << 11 | 14 << 16,
            6 << 11 | 304 << 16,
        ] {
            assert_eq!(Forms::unpack(word, 300), None, "{word:#x}");
        }
    }

    #[test]
    fn forms_edges_of_a_tile_are_numbered_in_order() {
        for (width, depth) in [(1, 1), (1, 5), (5, 1), (2, 2), (2, 7), (3, 3), (9, 4)] {
            let numbers: Vec<usize> = (0..width * depth).filter_map(|ix| edge(width, depth, ix)).collect();
            assert_eq!(numbers, (0..n_edges(width, depth)).collect::<Vec<_>>(), "{width} x {depth}");
            let found: Vec<usize> = edges(width, depth).collect();
            let expected: Vec<usize> = (0..width * depth).filter(|&ix| edge(width, depth, ix).is_some()).collect();
            assert_eq!(found, expected, "{width} x {depth}");
        }
    }

    #[test]
    fn forms_heights_refuse_exposure_that_they_do_not_imply() {
        let solid = Columns::from_fn(5, 9, 5, |x, y, _| y < 3 + x);
        let exposed = crate::model::exposure::exposed(&solid);
        assert!(HeightBytes::of(&solid, Some(&exposed)).is_some());
        // As beside a tile with a cave: another voxel is shown, or not, at the edge and inside.
        for (x, z) in [(4, 2), (3, 2)] {
            let other =
                Columns::from_fn(5, 9, 5, |a, y, b| exposed.find(a, y, b).is_some() != ((a, y, b) == (x, 2, z)));
            assert_ne!(exposed, other);
            assert!(HeightBytes::of(&solid, Some(&other)).is_none(), "({x}, {z})");
        }
        assert!(HeightBytes::of(&Columns::from_fn(2, 9, 1, |x, y, _| y < 3 && y >= x), None).is_none());
    }

    #[test]
    fn forms_features_are_named_as_they_are_read() {
        for features in (0..32).map(|code| Features::from_code(code).unwrap()) {
            assert_eq!(features.to_string().parse(), Ok(features));
        }
        assert_eq!("colors,heights".parse::<Features>().unwrap().to_string(), "heights,colors");
        assert_eq!(
            "heigths".parse::<Features>().unwrap_err(),
            "\"heigths\" is no feature; expected auto, off, or some of heights, lists, tables, colors, packed with commas between"
        );
        assert_eq!(Features::from_code(32), None);
    }
}
