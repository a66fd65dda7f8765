//! The scene's tables on the device.

use crate::error::{Error, Result};
use crate::gpu::engine::Engine;
use crate::gpu::shaders::{Pages, TABLES};
use crate::gpu::types::{Level, MAX_LEVELS, NONE};
use crate::world::tables::{BLOCK_SHIFT, Paint, Resident, Table as Columns};

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
    /// `PAINT_*` of the shaders.
    pub paint: u32,
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
        let (levels, tables, paint) = gather(resident)?;
        let mut pages = [Pages { n: 1, shift: 31 }; 3];
        let limit = engine.limits.max_storage_buffer_binding_size.min(engine.limits.max_buffer_size).min(binding_size);
        let mut bytes = 0;
        for (table, (name, pages)) in tables.iter().zip(TABLES.iter().zip(&mut pages)) {
            let size = table.bytes();
            bytes += size;
            if size <= limit {
                continue;
            }
            let shift = (limit / table.element).ilog2();
            let n = size.div_ceil(table.element << shift);
            if n > u64::from(MAX_PAGES) {
                return Err(Error::Limit(format!(
                    "{name} of the scene take {} MiB: {} allows {MAX_PAGES} bindings of {} MiB \
                     (max_storage_buffer_binding_size); try --device cpu",
                    size >> 20,
                    engine.name,
                    (table.element << shift) >> 20
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
            for ((table, pages), (name, out)) in tables.iter().zip(&pages).zip(TABLES.iter().zip(&mut buffers)) {
                let page = if pages.n == 1 { u64::MAX } else { table.element << pages.shift };
                let mut left = table.bytes();
                while out.len() < pages.n as usize {
                    out.push(engine.buffer(name, left.min(page).max(8), wgpu::BufferUsages::STORAGE));
                    left -= left.min(page);
                }
            }
            buffers
        })?;
        for ((table, pages), buffers) in tables.iter().zip(&pages).zip(&buffers) {
            let page = if pages.n == 1 { u64::MAX } else { table.element << pages.shift };
            let mut at = 0;
            for part in &table.parts {
                let mut part = *part;
                while !part.is_empty() {
                    let n = (part.len() as u64).min(page - at % page).min(CHUNK as u64) as usize;
                    engine.queue.write_buffer(&buffers[(at / page) as usize], at % page, &part[..n]);
                    part = &part[n..];
                    at += n as u64;
                    if n == CHUNK {
                        engine.flush()?;
                    }
                }
            }
        }
        engine.flush()?;
        let level_buffer = engine.buffer("levels", size_of_val(&levels[..]) as u64, wgpu::BufferUsages::UNIFORM);
        engine.queue.write_buffer(&level_buffer, 0, bytemuck::cast_slice(&levels));
        Ok(GpuResident { levels: level_buffer, tables: buffers, pages, bytes, paint })
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

/// Storage buffers that the kernels of planes bind beside the scene's; with one binding a table that makes the eight that
/// every device has.
const OTHER_BINDINGS: u32 = 5;

/// All levels' tables one after the other, and where each level begins.
fn gather<'a>(resident: &'a Resident) -> Result<([Level; MAX_LEVELS], [Table<'a>; 3], u32)> {
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
    let mixed = resident.levels.iter().any(|level| matches!(level.paint, Paint::Voxel { .. }));
    let mut paint = 0;
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
                paint = 1;
                out.paint = put(paints, bytemuck::cast_slice(base))?;
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
            Paint::Voxel { base, exposed, colors } => {
                paint = 2;
                out.paint = put(paints, bytemuck::cast_slice(base))?;
                out.exposed = put(paints, bytemuck::cast_slice(exposed))?;
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
            Paint::Column { colors } => {
                // Among levels with a colour per voxel, one that needs none says so by where its exposed runs are.
                (paint, out.exposed) = if mixed { (2, NONE) } else { (3, 0) };
                out.colors = put(paints, bytemuck::cast_slice(colors))?;
            }
        }
    }
    Ok((levels, tables, paint))
}
