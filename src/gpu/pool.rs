//! The scene's tables on the device.

use crate::error::{Error, Result};
use crate::gpu::engine::Engine;
use crate::gpu::shaders::{Pages, TABLES};
use crate::gpu::types::{Level, MAX_LEVELS, NONE, PaintKind};
use crate::world::pager::Change;
use crate::world::tables::{BLOCK_SHIFT, Paint, Resident, ResidentLevel, Table as Columns};
use planecast_encoder::format::TILE;
use std::collections::HashMap;
use std::ops::Range;

/// Bindings that one table may be cut into.
const MAX_PAGES: u32 = 8;

/// Bytes written to the device at a time: what is on its way takes host memory too.
const CHUNK: usize = 32 << 20;

/// A scene's tables, each cut into pages that a binding can hold.
pub struct GpuResident {
    pub levels: wgpu::Buffer,
    /// In the order of [`TABLES`].
    pub tables: [Vec<wgpu::Buffer>; 3],
    pub pages: [Pages; 3],
    pub bytes: u64,
    pub paint: PaintKind,
    /// Of tables whose tiles come and go.
    slots: Option<Slots>,
}

/// Where the tiles of tables stand that are not all there.
#[derive(Default)]
struct Slots {
    levels: Vec<Room>,
    /// Parts of the tables that each slot has, by level and slot.
    held: HashMap<(u32, u32), [Range<u32>; 3]>,
}

/// What one level may take of the tables that grow, in elements of theirs.
#[derive(Clone, Copy, Default)]
struct Room {
    level: Level,
    runs: u32,
    exposed: u32,
    colors: u32,
}

/// One table of all levels, as bytes.
struct Table<'a> {
    parts: Vec<&'a [u8]>,
    element: u64,
}

impl Table<'_> {
    fn bytes(&self) -> u64 {
        self.parts.iter().map(|p| p.len() as u64).sum()
    }
}

impl GpuResident {
    /// Uploads a scene; bindings take at most `binding_size` bytes and what the device allows.
    pub fn new(engine: &Engine, resident: &Resident, binding_size: u64) -> Result<GpuResident> {
        if resident.levels.len() > MAX_LEVELS {
            return Err(Error::Limit(format!(
                "scene of {} levels: the GPU draws at most {MAX_LEVELS}",
                resident.levels.len()
            )));
        }
        if resident.levels[0].pages.is_some() {
            return GpuResident::empty(engine, resident, binding_size);
        }
        let (levels, tables, paint) = gather(resident)?;
        let (buffers, pages, bytes) =
            allocate(engine, tables.each_ref().map(|table| (table.bytes(), table.element)), binding_size)?;
        for ((table, pages), buffers) in tables.iter().zip(&pages).zip(&buffers) {
            let mut at = 0;
            for part in &table.parts {
                at += write(engine, buffers, *pages, table.element, at, part)?;
            }
        }
        engine.flush()?;
        let level_buffer = engine.buffer("levels", size_of_val(&levels[..]) as u64, wgpu::BufferUsages::UNIFORM);
        engine.queue.write_buffer(&level_buffer, 0, bytemuck::cast_slice(&levels));
        Ok(GpuResident { levels: level_buffer, tables: buffers, pages, bytes, paint, slots: None })
    }

    /// Whether tiles stand in slots.
    pub fn is_paged(&self) -> bool {
        self.slots.is_some()
    }

    /// Room for tiles, none of which is there.
    fn empty(engine: &Engine, resident: &Resident, binding_size: u64) -> Result<GpuResident> {
        let levels = engine.buffer("levels", (MAX_LEVELS * size_of::<Level>()) as u64, wgpu::BufferUsages::UNIFORM);
        let pages = [Pages { n: 1, shift: 31 }; 3];
        let slots = Some(Slots::default());
        let mut tables =
            GpuResident { levels, tables: Default::default(), pages, bytes: 0, paint: PaintKind::None, slots };
        tables.sync(engine, resident, &[Change::All], binding_size)?;
        Ok(tables)
    }

    /// Brings what has changed in tables whose tiles come and go; how many bytes that was.
    ///
    /// # Errors
    /// [`Error::Limit`] where the device has no room for them.
    pub fn sync(&mut self, engine: &Engine, resident: &Resident, changes: &[Change], binding_size: u64) -> Result<u64> {
        let Some(slots) = &mut self.slots else { return Ok(0) };
        let (mut all, mut dirty, mut turned) = (false, Vec::new(), vec![false; resident.levels.len()]);
        for change in changes {
            match change {
                Change::All => {
                    slots.held.clear();
                    dirty.clear();
                    all = true;
                }
                Change::Slot { level, slot, runs, exposed, colors } => {
                    slots.held.insert((*level, *slot), [runs.clone(), exposed.clone(), colors.clone()]);
                    dirty.push((*level, *slot));
                }
                Change::Pages { level } => turned[*level as usize] = true,
            }
        }
        let full = |room: &Room, level: &ResidentLevel| {
            let [runs, exposed, colors] = grown(level);
            runs > room.runs || exposed > room.exposed || colors > room.colors
        };
        all |= slots.levels.iter().zip(&resident.levels).any(|(room, level)| full(room, level));
        if all {
            // The old ones go before the new ones come.
            self.tables = Default::default();
            let (rooms, sizes, paint) = lay_out(resident)?;
            (self.tables, self.pages, self.bytes) = allocate(engine, sizes, binding_size)?;
            self.paint = paint;
            let mut levels = [Level::default(); MAX_LEVELS];
            levels.iter_mut().zip(&rooms).for_each(|(out, room)| *out = room.level);
            engine.queue.write_buffer(&self.levels, 0, bytemuck::cast_slice(&levels));
            slots.levels = rooms;
            dirty = slots.held.keys().copied().collect();
            // Slot 0 of each level is empty.
            dirty.extend((0..resident.levels.len() as u32).map(|level| (level, 0)));
            turned.fill(true);
        }
        dirty.sort_unstable();
        dirty.dedup();
        let elements = [if resident.heights { 4 } else { 8 }, 4, 4];
        let mut bytes = 0;
        let mut put = |table: usize, element: u64, part: &[u8]| -> Result<()> {
            let at = element * elements[table];
            bytes += write(engine, &self.tables[table], self.pages[table], elements[table], at, part)?;
            Ok(())
        };
        const COLUMNS: usize = (TILE * TILE) as usize;
        const BLOCKS: usize = COLUMNS >> (2 * BLOCK_SHIFT);
        for (l, slot) in dirty {
            let (room, level) = (&slots.levels[l as usize].level, &resident.levels[l as usize]);
            let [runs, exposed, colors] = slots.held.get(&(l, slot)).cloned().unwrap_or_default();
            let part = |range: &Range<u32>| range.start as usize..range.end as usize;
            let of_slot = |n: usize| slot as usize * n..(slot as usize + 1) * n;
            let (columns, starts) = (of_slot(COLUMNS), of_slot(COLUMNS + 1));
            let at = |base: u32, first: usize| u64::from(base) + first as u64;
            match &level.table {
                Columns::Heights(heights) => {
                    put(0, at(room.columns, columns.start / 2), bytemuck::cast_slice(&heights[columns.clone()]))?;
                }
                Columns::Runs { columns: entries, runs: words } => {
                    put(0, at(room.columns, columns.start), bytemuck::cast_slice(&entries[columns.clone()]))?;
                    put(1, at(room.runs, runs.start as usize), bytemuck::cast_slice(&words[part(&runs)]))?;
                }
            }
            let blocks = slot as usize * BLOCKS..(slot as usize + 1) * BLOCKS;
            put(1, at(room.blocks, blocks.start), bytemuck::cast_slice(&level.blocks[blocks.clone()]))?;
            match &level.paint {
                Paint::None | Paint::Height { .. } => {}
                Paint::Column { colors } => {
                    put(2, at(room.colors, columns.start), bytemuck::cast_slice(&colors[columns.clone()]))?;
                }
                Paint::Run { base, colors: all } => {
                    put(2, at(room.paint, columns.start), bytemuck::cast_slice(&base[columns.clone()]))?;
                    put(2, at(room.colors, colors.start as usize), bytemuck::cast_slice(&all[part(&colors)]))?;
                }
                Paint::Top { starts: all_starts, colors: all } => {
                    put(2, at(room.paint, starts.start), bytemuck::cast_slice(&all_starts[starts.clone()]))?;
                    put(2, at(room.colors, colors.start as usize), bytemuck::cast_slice(&all[part(&colors)]))?;
                }
                Paint::Voxel { base, exposed: list, colors: all } => {
                    put(2, at(room.paint, starts.start), bytemuck::cast_slice(&base[starts.clone()]))?;
                    put(2, at(room.exposed, 2 * exposed.start as usize), bytemuck::cast_slice(&list[part(&exposed)]))?;
                    put(2, at(room.colors, colors.start as usize), bytemuck::cast_slice(&all[part(&colors)]))?;
                }
            }
        }
        for (room, level) in slots.levels.iter().zip(&resident.levels).filter(|_| all) {
            if let Paint::Height { colors } = &level.paint {
                put(2, room.level.colors.into(), bytemuck::cast_slice(colors))?;
            }
        }
        for (l, level) in resident.levels.iter().enumerate().filter(|&(l, _)| turned[l]) {
            let pages = level.pages.as_ref().expect("a paged level has pages");
            put(1, slots.levels[l].level.pages.into(), bytemuck::cast_slice(&pages.slots))?;
        }
        Ok(bytes)
    }

    /// The buffer that a shader calls `name` (`columns_0`, …), if it is one of the scene's.
    pub fn buffer(&self, name: &str) -> Option<&wgpu::Buffer> {
        if name == "levels" {
            return Some(&self.levels);
        }
        let (table, page) = name.rsplit_once('_')?;
        let at = TABLES.iter().position(|t| *t == table)?;
        self.tables[at].get(page.parse::<usize>().ok()?)
    }
}

/// Bytes of a table, and of one of its elements.
type Size = (u64, u64);

/// Buffers for three tables: with how they are cut, and bytes in all.
fn allocate(engine: &Engine, sizes: [Size; 3], binding_size: u64) -> Result<([Vec<wgpu::Buffer>; 3], [Pages; 3], u64)> {
    let mut pages = [Pages { n: 1, shift: 31 }; 3];
    let limit = engine.limits.max_storage_buffer_binding_size.min(engine.limits.max_buffer_size).min(binding_size);
    let mut bytes = 0;
    for ((size, element), (name, pages)) in sizes.into_iter().zip(TABLES.iter().zip(&mut pages)) {
        bytes += size;
        if size <= limit {
            continue;
        }
        let shift = (limit / element).ilog2();
        let n = size.div_ceil(element << shift);
        if n > u64::from(MAX_PAGES) {
            return Err(Error::Limit(format!(
                "{name} of the scene take {} MiB: {} allows {MAX_PAGES} bindings of {} MiB \
                     (max_storage_buffer_binding_size); try --device cpu",
                size >> 20,
                engine.name,
                (element << shift) >> 20
            )));
        }
        *pages = Pages { n: n as u32, shift };
    }
    let n: u32 = pages.iter().map(|p| p.n).sum();
    let allowed = engine.limits.max_storage_buffers_per_shader_stage.saturating_sub(OTHER_BINDINGS);
    if n > allowed {
        return Err(Error::Limit(format!(
            "scene of {} MiB needs {n} bindings: {} leaves {allowed} \
                 (max_storage_buffers_per_shader_stage); try --device cpu",
            bytes >> 20,
            engine.name
        )));
    }
    let buffers = engine.checked(&format!("scene of {} MiB", bytes >> 20), || {
        let mut buffers: [Vec<wgpu::Buffer>; 3] = Default::default();
        for (((size, element), pages), (name, out)) in sizes.iter().zip(&pages).zip(TABLES.iter().zip(&mut buffers)) {
            let page = pages.bytes(*element);
            let mut left = *size;
            while out.len() < pages.n as usize {
                out.push(engine.buffer(name, left.min(page).max(8), wgpu::BufferUsages::STORAGE));
                left -= left.min(page);
            }
        }
        buffers
    })?;
    Ok((buffers, pages, bytes))
}

/// Writes a part of a table from byte `at` on; how many bytes that was.
fn write(
    engine: &Engine,
    buffers: &[wgpu::Buffer],
    pages: Pages,
    element: u64,
    mut at: u64,
    mut part: &[u8],
) -> Result<u64> {
    let (page, whole) = (pages.bytes(element), part.len() as u64);
    while !part.is_empty() {
        let n = (part.len() as u64).min(page - at % page).min(CHUNK as u64) as usize;
        engine.queue.write_buffer(&buffers[(at / page) as usize], at % page, &part[..n]);
        part = &part[n..];
        at += n as u64;
        if n == CHUNK {
            engine.flush()?;
        }
    }
    Ok(whole)
}

/// How many words of runs, exposed runs and colours a level's growing tables have.
fn grown(level: &ResidentLevel) -> [u32; 3] {
    match &level.paint {
        Paint::None | Paint::Column { .. } | Paint::Height { .. } => [level.runs().len(), 0, 0],
        Paint::Top { colors, .. } | Paint::Run { colors, .. } => [level.runs().len(), 0, colors.len()],
        Paint::Voxel { exposed, colors, .. } => [level.runs().len(), exposed.len(), colors.len()],
    }
    .map(|n| n as u32)
}

/// Where the tables of levels begin whose tiles stand in slots, with room to grow; bytes and elements of the three tables, and
/// what their colours are.
fn lay_out(resident: &Resident) -> Result<(Vec<Room>, [Size; 3], PaintKind)> {
    if resident.levels.len() > MAX_LEVELS {
        let n = resident.levels.len();
        return Err(Error::Limit(format!("scene of {n} levels: the GPU draws at most {MAX_LEVELS}")));
    }
    let mut ends = [0u64; 3];
    let mut put = |table: usize, n: usize| -> Result<u32> {
        let at = u32::try_from(ends[table])
            .map_err(|_| Error::Limit("tiles of more than 2³² words a table: allow less memory".into()))?;
        ends[table] += n as u64;
        Ok(at)
    };
    let mut paint = PaintKind::None;
    let mut rooms = Vec::new();
    for level in &resident.levels {
        let pages = level.pages.as_ref().expect("a paged level has pages");
        // Twice what is there, so that growing is rare.
        let [runs, exposed, colors] = grown(level).map(|n| if n == 0 { 0 } else { 2 * n.max(1 << 15) });
        let mut out = Level {
            size: [level.nx as i32, level.nz as i32],
            blocks_row: pages.shift,
            bottom: level.bottom as i32,
            top: level.top as i32,
            ..Level::default()
        };
        match &level.table {
            Columns::Runs { columns, .. } => {
                out.columns = put(0, columns.len())?;
                out.runs = put(1, runs as usize)?;
            }
            Columns::Heights(heights) => out.columns = put(0, heights.len() / 2)?,
        }
        out.blocks = put(1, level.blocks.len())?;
        out.pages = put(1, pages.slots.len())?;
        match &level.paint {
            Paint::None => {}
            Paint::Column { colors } => {
                paint = PaintKind::Column;
                out.colors = put(2, colors.len())?;
            }
            Paint::Height { colors } => {
                paint = PaintKind::Height;
                out.colors = put(2, colors.len())?;
            }
            Paint::Top { starts, .. } => {
                paint = PaintKind::Top;
                out.paint = put(2, starts.len())?;
                out.colors = put(2, colors.max(1 << 15) as usize)?;
            }
            Paint::Run { base, .. } => {
                paint = PaintKind::Run;
                out.paint = put(2, base.len())?;
                out.colors = put(2, colors.max(1 << 15) as usize)?;
            }
            Paint::Voxel { base, .. } => {
                paint = PaintKind::Voxel;
                out.paint = put(2, base.len())?;
                out.exposed = put(2, 2 * exposed.max(1 << 15) as usize)?;
                out.colors = put(2, colors.max(1 << 15) as usize)?;
            }
        }
        rooms.push(Room { level: out, runs, exposed: exposed.max(1 << 15), colors: colors.max(1 << 15) });
    }
    let column = if resident.heights { 4 } else { 8 };
    Ok((rooms, [(column * ends[0], column), (4 * ends[1], 4), (4 * ends[2], 4)], paint))
}

/// Storage buffers that the kernels of planes bind beside the scene's; with one binding a table that makes the eight that
/// every device has.
const OTHER_BINDINGS: u32 = 5;

/// All levels' tables one after the other, and where each level begins.
fn gather<'a>(resident: &'a Resident) -> Result<([Level; MAX_LEVELS], [Table<'a>; 3], PaintKind)> {
    let mut levels = [Level::default(); MAX_LEVELS];
    let column = if resident.heights { 4 } else { 8 };
    let mut tables = [column, 4, 4].map(|element| Table { parts: Vec::new(), element });
    // Puts a part at the end of a table: where that is, in elements.
    let put = |table: &mut Table<'a>, part: &'a [u8]| -> Result<u32> {
        let at = u32::try_from(table.bytes() / table.element)
            .map_err(|_| Error::Limit("scene of more than 2³² words a table: try --device cpu".into()))?;
        table.parts.push(part);
        Ok(at)
    };
    let mixed = resident.levels.iter().any(|level| matches!(level.paint, Paint::Top { .. }));
    let mut paint = PaintKind::None;
    for (out, level) in levels.iter_mut().zip(&resident.levels) {
        let [columns, runs, paints] = &mut tables;
        *out = Level {
            size: [level.nx as i32, level.nz as i32],
            blocks_row: level.nx.div_ceil(1 << BLOCK_SHIFT),
            bottom: level.bottom as i32,
            top: level.top as i32,
            ..Level::default()
        };
        match &level.table {
            Columns::Runs { columns: entries, runs: words } => {
                out.columns = put(columns, bytemuck::cast_slice(entries))?;
                out.runs = put(runs, bytemuck::cast_slice(words))?;
            }
            Columns::Heights(heights) => out.columns = put(columns, bytemuck::cast_slice(heights))?,
        }
        out.blocks = put(runs, bytemuck::cast_slice(&level.blocks))?;
        match &level.paint {
            Paint::None => {}
            Paint::Run { base, colors } => {
                paint = PaintKind::Run;
                out.paint = put(paints, bytemuck::cast_slice(base))?;
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
            Paint::Top { starts, colors } => {
                paint = PaintKind::Top;
                out.paint = put(paints, bytemuck::cast_slice(starts))?;
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
            Paint::Voxel { base, exposed, colors } => {
                paint = PaintKind::Voxel;
                out.paint = put(paints, bytemuck::cast_slice(base))?;
                out.exposed = put(paints, bytemuck::cast_slice(exposed))?;
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
            Paint::Height { colors } => {
                paint = PaintKind::Height;
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
            Paint::Column { colors } => {
                // Among levels with more colours, one that needs no starts says so by where those are.
                (paint, out.paint) = if mixed { (PaintKind::Top, NONE) } else { (PaintKind::Column, 0) };
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
        }
    }
    Ok((levels, tables, paint))
}
