//! Whether a tile is right, and nothing else: [`Blob::level`] and [`Blob::check_figures`] say what is wrong, and take several
//! times as long.

use super::{Blob, ColorMode, Encoding, Form, Heights, Modes, Section, TileEntry, column_rle};
use crate::format::forms::{COLOR_GROUP_SHIFT, Painted, Table, edges};
use crate::format::lists::{Held, Lists};

/// What the colours of a column are as many as.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Each {
    Run,
    Voxel,
}

impl Blob<'_> {
    /// Whether [`Blob::level`] reads the blob and [`Blob::check_figures`] finds those of `entry`.
    pub(super) fn is_sound(&self, entry: &TileEntry) -> bool {
        let Modes { encoding, color } = self.place.modes;
        let shows = self.place.modes.shows();
        let each = match (color, self.forms.painted) {
            (ColorMode::None, _) | (_, Painted::Column | Painted::Tile) => None,
            (ColorMode::Voxel, Painted::Each) => Some(Each::Voxel),
            (ColorMode::Voxel | ColorMode::Run, _) => Some(Each::Run),
        };
        // How many colours each column has.
        let mut counts = Vec::with_capacity(each.map_or(0, |_| self.n_columns()));
        let held = match (self.heights(), encoding) {
            (Some(heights), _) => Some(heights_held(&heights, self.place.modes, each, &mut counts)),
            (None, Encoding::Solid) if shows => {
                let solid = self.lists_held(Section::GeometryTable, Section::Geometry, None, &mut counts);
                let exposed = self.lists_held(Section::ExposureTable, Section::Exposure, each, &mut counts);
                solid.zip(exposed).map(|(solid, exposed)| (solid, exposed.voxels))
            }
            (None, _) => {
                let held = self.lists_held(Section::GeometryTable, Section::Geometry, each, &mut counts);
                held.map(|held| (held, held.voxels))
            }
        };
        let Some((held, n_exposed)) = held else { return false };
        let found = TileEntry {
            n_solid: held.voxels + held.filled,
            // Without exposed runs only the neighbour tiles could tell.
            n_exposed: if shows { n_exposed } else { entry.n_exposed },
            n_runs: held.runs as u32,
            y_min: held.lowest.min(u16::MAX.into()) as u16,
            y_max: held.end.saturating_sub(1) as u16,
            ..*entry
        };
        held.end <= self.place.dims[1] && found == *entry && (each.is_none() || self.has_colors_of(&counts))
    }

    /// What the lists of a section hold, and how many colours their columns have; None where they are not right.
    fn lists_held(&self, table: Section, section: Section, each: Option<Each>, counts: &mut Vec<u32>) -> Option<Held> {
        let starts = self.starts(table);
        let ascend = starts.windows(2).fold(true, |ascend, pair| ascend & (pair[0] <= pair[1]));
        if starts[0] != 0 || !ascend {
            return None;
        }
        let (form, base) = self.list_form(section);
        let highest = self.place.dims[1] - base;
        let surface = self.place.modes.encoding == Encoding::Surface;
        let lists = Lists {
            bytes: &self.bytes,
            at: self.offset(section),
            starts: &starts,
            form,
            highest: if form == Form::Narrow { highest.min(256) } else { highest },
            fill: surface.then(|| &self.bytes[self.offset(Section::Fill)..]),
        };
        let held = lists.check()?;
        if let Some(each) = each {
            let bytes = self.section(section);
            let columns = starts.windows(2).map(|pair| &bytes[pair[0] as usize..pair[1] as usize]);
            match each {
                Each::Run => counts.extend(columns.map(|column| column_rle::count_runs(column, form) as u32)),
                Each::Voxel => counts.extend(columns.map(|column| column_rle::count(column, form)[1] as u32)),
            }
        }
        let base = if held.runs > 0 { base } else { 0 };
        Some(Held { lowest: held.lowest + base, end: held.end + base, ..held })
    }

    /// Whether there are as many colours as `counts` says, and the colour table says where those of each column start.
    fn has_colors_of(&self, counts: &[u32]) -> bool {
        let group = match self.forms.table(Section::ColorTable) {
            Table::Grouped => 1 << COLOR_GROUP_SHIFT,
            _ => 1,
        };
        let (mut before, mut right) = (0u64, true);
        for (&start, counts) in self.starts(Section::ColorTable).iter().zip(counts.chunks(group)) {
            right &= u64::from(start) == before;
            before += counts.iter().map(|&n| u64::from(n)).sum::<u64>();
        }
        right && before == self.len_of(Section::Colors) as u64
    }
}

/// What columns of heights hold, how many exposed voxels, and how many colours each column has.
fn heights_held(heights: &Heights, modes: Modes, each: Option<Each>, counts: &mut Vec<u32>) -> (Held, u64) {
    let Heights { width, depth, bytes, base, above, .. } = *heights;
    // In 16 bits, of which a processor compares many at once, also where a height has 17.
    let above: Vec<u16> = match bytes {
        0 => vec![0; heights.n_columns()],
        1 => above.iter().map(|&h| h.into()).collect(),
        _ => above.as_chunks().0.iter().map(|&h| u16::from_le_bytes(h)).collect(),
    };
    // 1 for columns that are not empty.
    let some = |above: u16| above.max(base.min(1) as u16).min(1);
    // Row by row: 256 numbers below 2¹⁶ add up to less than 2³².
    let mut held = Held::NOTHING;
    held.voxels = u64::from(base) * above.len() as u64;
    for row in above.chunks(width) {
        held.voxels += u64::from(row.iter().map(|&h| u32::from(h)).sum::<u32>());
        held.runs += u64::from(row.iter().map(|&h| u32::from(some(h))).sum::<u32>());
        held.end = row.iter().fold(held.end as u16, |end, &h| end.max(h)).into();
    }
    if held.runs > 0 {
        held.lowest = 0;
        held.end += base;
    }
    if !modes.shows() {
        if each.is_some() {
            counts.extend(above.iter().map(|&h| u32::from(some(h))));
        }
        return (held, 0);
    }

    // As `Heights::low` says, voxel 0 is exposed and as many at the top: as many as the least neighbour is lower, at least one,
    // and at most all but voxel 0.
    let rest = |above: u16| match base {
        0 => above.saturating_sub(1),
        _ => above.saturating_add((base - 1).min(u16::MAX.into()) as u16),
    };
    let mut top = vec![0; above.len()];
    for z in 1..depth.saturating_sub(1) {
        let row = |z: usize| &above[z * width..(z + 1) * width];
        let (before, here, behind) = (row(z - 1), row(z), row(z + 1));
        let top = &mut top[z * width..(z + 1) * width];
        for x in 1..width.saturating_sub(1) {
            let least = here[x - 1].min(here[x + 1]).min(before[x]).min(behind[x]);
            top[x] = here[x].saturating_sub(least).max(1).min(rest(here[x]));
        }
    }
    for ix in edges(width, depth) {
        let h = heights.height(ix);
        top[ix] = if h < 2 { 0 } else { (h - heights.low(ix)) as u16 };
    }
    let (mut n_exposed, mut n_runs) = (0, 0);
    for (above, top) in above.chunks(width).zip(top.chunks(width)) {
        let columns = || above.iter().zip(top);
        n_exposed += u64::from(columns().map(|(&h, &top)| u32::from(some(h)) + u32::from(top)).sum::<u32>());
        n_runs += u64::from(columns().map(|(&h, &top)| u32::from(some(h) + u16::from(rest(h) > top))).sum::<u32>());
    }
    let columns = above.iter().zip(&top);
    match each {
        Some(Each::Voxel) => counts.extend(columns.map(|(&h, &top)| u32::from(some(h)) + u32::from(top))),
        Some(Each::Run) => counts.extend(columns.map(|(&h, &top)| u32::from(some(h) + u16::from(rest(h) > top)))),
        None => {}
    }
    if modes.encoding == Encoding::Surface {
        held.runs = n_runs;
    }
    (held, n_exposed)
}
