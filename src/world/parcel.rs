//! Tiles of a world as bytes, from one instance of the program to another: a page's workers read them or make them, and the page
//! draws. Nothing of it is stored: both are of the same build.

use std::collections::HashMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use bytemuck::{AnyBitPattern, Pod, Zeroable, cast_slice, pod_collect_to_vec};
use glam::DVec3;
use planecast_encoder::format::write::write_scene_to;
use planecast_encoder::format::{TILE, grids};
use planecast_encoder::{ColorMode, Encoding, Level, PcastFile, TileKey, TileSource};
use serde::{Deserialize, Serialize};

pub use crate::world::fetch::{Order, Orders};
use crate::world::pager::{PINNED, Tile};
use crate::world::preview::Preview;
use crate::world::tables::{BLOCK_SHIFT, Paint, ResidentLevel, Table};
use crate::{Error, Result};

/// Tiles a side of the preview: those of the finest level that stays, so that no more need be fetched for it.
const PREVIEW: u32 = 2;

/// What is known of a world before its tiles come.
#[derive(Serialize, Deserialize)]
struct Facts {
    name: String,
    dims: [u32; 3],
    encoding: Encoding,
    color: ColorMode,
    /// Of each level.
    heights: Vec<[u32; 2]>,
    height_field: bool,
    matter: bool,
    /// Of the preview.
    scale: f64,
    origin: [f64; 3],
    preview: usize,
    /// Tiles that stay, as heights or as runs: level, x, z, whether as heights, and bytes of the parcel.
    coarse: Vec<(u32, u32, u32, bool, usize)>,
}

/// Packs the tiles of a source.
pub struct Packer {
    source: Arc<dyn TileSource>,
}

impl Packer {
    pub fn new(source: Arc<dyn TileSource>) -> Packer {
        Packer { source }
    }

    /// What [`Parcels::open`] begins with: all that is known of the world, and its coarsest tiles.
    ///
    /// # Errors
    /// Those of the coarsest tiles.
    pub fn facts(&self) -> Result<Vec<u8>> {
        let source = &*self.source;
        let preview = Preview::of(source, PREVIEW)?;
        let mut parts = Cursor::new(Vec::new());
        write_scene_to(&preview.scene, &mut parts, Path::new("preview"))?;
        let mut parts = parts.into_inner();
        let mut facts = Facts {
            name: source.name(),
            dims: source.dims(),
            encoding: source.encoding(),
            color: source.color(),
            heights: (0..source.levels()).map(|level| source.heights(level)).collect(),
            height_field: source.is_height_field(),
            matter: source.has_matter(),
            scale: preview.scale,
            origin: preview.origin.to_array(),
            preview: parts.len(),
            coarse: Vec::new(),
        };
        for (level, grid) in (0..).zip(grids(facts.dims)).filter(|(_, grid)| grid.n_tiles() <= PINNED) {
            let [tx, tz] = grid.tiles;
            for key in (0..tz).flat_map(|z| (0..tx).map(move |x| TileKey { level, x, z })) {
                // Heights may show later that they do not do.
                for heights in [true, false].into_iter().skip(usize::from(!facts.height_field)) {
                    let parcel = self.tile(key, heights)?;
                    facts.coarse.push((level, key.x, key.z, heights, parcel.len()));
                    parts.extend(parcel);
                }
            }
        }
        let facts = serde_json::to_vec(&facts).expect("facts are plain values");
        let mut bytes = (facts.len() as u32).to_le_bytes().to_vec();
        bytes.extend(facts);
        bytes.extend(parts);
        Ok(bytes)
    }

    /// A tile as heights or as runs; no bytes where it is to be heights and is not.
    ///
    /// # Errors
    /// Those of the source.
    pub fn tile(&self, key: TileKey, heights: bool) -> Result<Vec<u8>> {
        Ok(Tile::read(&*self.source, key, heights)?.as_ref().map(pack).unwrap_or_default())
    }
}

/// A world whose tiles come as parcels.
pub struct Parcels {
    facts: Facts,
    pub preview: Preview,
    coarse: HashMap<(TileKey, bool), Vec<u8>>,
}

impl Parcels {
    /// From [`Packer::facts`].
    ///
    /// # Errors
    /// [`Error::Scene`] where the bytes are no such.
    pub fn open(bytes: &[u8]) -> Result<Parcels> {
        let wrong = || broken("parcels", "facts were expected");
        let (len, rest) = bytes.split_first_chunk::<4>().ok_or_else(wrong)?;
        let (facts, mut rest) = rest.split_at_checked(u32::from_le_bytes(*len) as usize).ok_or_else(wrong)?;
        let facts: Facts = serde_json::from_slice(facts).map_err(|_| wrong())?;
        let mut next = |n: usize| -> Result<Vec<u8>> {
            let part;
            (part, rest) = rest.split_at_checked(n).ok_or_else(wrong)?;
            Ok(part.to_vec())
        };
        let scene = PcastFile::from_bytes("preview", next(facts.preview)?)?.read_scene()?;
        let preview = Preview { scene, scale: facts.scale, origin: DVec3::from_array(facts.origin) };
        let mut coarse = HashMap::new();
        for &(level, x, z, heights, n) in &facts.coarse {
            coarse.insert((TileKey { level, x, z }, heights), next(n)?);
        }
        if facts.dims.contains(&0) || facts.heights.len() != grids(facts.dims).len() {
            return Err(wrong());
        }
        Ok(Parcels { facts, preview, coarse })
    }

    /// A tile that stays.
    pub(crate) fn coarse(&self, key: TileKey, heights: bool) -> Result<Option<Tile>> {
        let parcel =
            self.coarse.get(&(key, heights)).ok_or_else(|| broken(&self.facts.name, "a coarse tile is missing"))?;
        unpack(&self.facts.name, parcel)
    }
}

impl TileSource for Parcels {
    fn name(&self) -> String {
        self.facts.name.clone()
    }

    fn dims(&self) -> [u32; 3] {
        self.facts.dims
    }

    fn encoding(&self) -> Encoding {
        self.facts.encoding
    }

    fn color(&self) -> ColorMode {
        self.facts.color
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        self.facts.heights[level as usize]
    }

    fn is_height_field(&self) -> bool {
        self.facts.height_field
    }

    fn is_empty(&self, _: TileKey) -> bool {
        false
    }

    fn tile(&self, key: TileKey) -> planecast_encoder::Result<Level> {
        let TileKey { level, x, z } = key;
        let what = format!("{}: tile ({x}, {z}) of level {level} comes when it is ordered", self.facts.name);
        Err(planecast_encoder::Error::Argument(what))
    }

    fn has_matter(&self) -> bool {
        self.facts.matter
    }
}

fn broken(name: &str, what: &str) -> Error {
    planecast_encoder::Error::format(name, format!("no parcel of this program: {what}")).into()
}

/// What a parcel begins with.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
struct Head {
    nx: u32,
    nz: u32,
    /// 0: heights, 1: runs.
    table: u32,
    /// 0: none, 1: by column, 2: by run, 3: of tops, 4: by voxel.
    paint: u32,
    /// Bytes that the tile took to read.
    bytes: u64,
    /// Bytes of the table, further runs, blocks, and up to three tables of colours.
    lens: [u32; 6],
}

fn pack(tile: &Tile) -> Vec<u8> {
    let ResidentLevel { nx, nz, table, blocks, paint, .. } = &tile.tables;
    let (table, runs, kind): (&[u8], &[u8], u32) = match table {
        Table::Heights(heights) => (cast_slice(heights), &[], 0),
        Table::Runs { columns, runs } => (cast_slice(columns), cast_slice(runs), 1),
    };
    let (paint, colors): (u32, [&[u8]; 3]) = match paint {
        // A tint by height is a level's, not a tile's.
        Paint::None | Paint::Height { .. } => (0, [&[]; 3]),
        Paint::Column { colors } => (1, [cast_slice(colors), &[], &[]]),
        Paint::Run { base, colors } => (2, [cast_slice(base), cast_slice(colors), &[]]),
        Paint::Top { starts, colors } => (3, [cast_slice(starts), cast_slice(colors), &[]]),
        Paint::Voxel { base, exposed, colors } => (4, [cast_slice(base), cast_slice(exposed), cast_slice(colors)]),
    };
    let parts = [table, runs, cast_slice(blocks), colors[0], colors[1], colors[2]];
    let lens = parts.map(|part| part.len() as u32);
    let head = Head { nx: *nx, nz: *nz, table: kind, paint, bytes: tile.bytes, lens };
    [bytemuck::bytes_of(&head)].iter().chain(&parts).flat_map(|part| part.iter().copied()).collect()
}

/// The tile in a parcel; `None` where it was to be heights and is not. Tables are as long as their columns want, and point nowhere
/// beyond.
pub(crate) fn unpack(name: &str, bytes: &[u8]) -> Result<Option<Tile>> {
    if bytes.is_empty() {
        return Ok(None);
    }
    let wrong = |what: &str| broken(name, what);
    let (head, mut rest) = bytes.split_at_checked(size_of::<Head>()).ok_or_else(|| wrong("its head is cut off"))?;
    let Head { nx, nz, table, paint, bytes, lens } = bytemuck::pod_read_unaligned(head);
    let mut parts = [&[][..]; 6];
    for (part, len) in parts.iter_mut().zip(lens) {
        (*part, rest) = rest.split_at_checked(len as usize).ok_or_else(|| wrong("it is cut off"))?;
    }
    let side = 1..=TILE;
    if !rest.is_empty() || !side.contains(&nx) || !side.contains(&nz) {
        return Err(wrong("of another size"));
    }
    let n = nx as usize * nz as usize;
    let is = |right: bool| if right { Ok(()) } else { Err(wrong("tables that do not fit together")) };
    let starts_fit = |starts: &[u32], of: usize| {
        starts.len() == n + 1 && starts.is_sorted() && starts.last().is_some_and(|&end| end as usize <= of)
    };
    let table = match table {
        0 => {
            let heights: Vec<u16> = values(parts[0]);
            is(heights.len() == n.next_multiple_of(2))?;
            Table::Heights(heights)
        }
        1 => {
            let (columns, runs): (Vec<[u32; 2]>, Vec<u32>) = (values(parts[0]), values(parts[1]));
            let inside = |&[_, at]: &[u32; 2]| {
                let rest = runs.get(at as usize).map(|&rest| rest as usize);
                at == 0 || rest.is_some_and(|rest| rest < runs.len() - at as usize)
            };
            is(columns.len() == n && !runs.is_empty() && columns.iter().all(inside))?;
            Table::Runs { columns, runs }
        }
        _ => return Err(wrong("a table of another kind")),
    };
    let blocks: Vec<u32> = values(parts[2]);
    let [across, along] = [nx, nz].map(|n| n.div_ceil(1 << BLOCK_SHIFT) as usize);
    is(blocks.len() == across * along)?;
    let of_columns = |table: &Table, ix: usize| match table {
        Table::Heights(heights) => u32::from(heights[ix] > 0),
        Table::Runs { columns, runs } => {
            let [top, at] = columns[ix];
            let rest = if at == 0 { 0 } else { runs[at as usize] };
            if top == crate::world::tables::EMPTY { 0 } else { 1 + rest }
        }
    };
    let paint = match paint {
        0 => Paint::None,
        1 => {
            let colors: Vec<u32> = values(parts[3]);
            is(colors.len() == n)?;
            Paint::Column { colors }
        }
        2 => {
            let (base, colors): (Vec<u32>, Vec<u32>) = (values(parts[3]), values(parts[4]));
            let inside = |(ix, &base): (usize, &u32)| base as usize + of_columns(&table, ix) as usize <= colors.len();
            is(base.len() == n && base.iter().enumerate().all(inside))?;
            Paint::Run { base, colors }
        }
        3 => {
            let (starts, colors): (Vec<u32>, Vec<u32>) = (values(parts[3]), values(parts[4]));
            is(starts_fit(&starts, colors.len()))?;
            Paint::Top { starts, colors }
        }
        4 => {
            let (base, exposed, colors): (Vec<u32>, Vec<[u32; 2]>, Vec<u32>) =
                (values(parts[3]), values(parts[4]), values(parts[5]));
            let inside = |&[run, at]: &[u32; 2]| {
                let run = planecast_encoder::Run(run);
                run.first() <= run.last() && (at as usize + usize::from(run.last() - run.first())) < colors.len()
            };
            is(starts_fit(&base, exposed.len()) && exposed.iter().all(inside))?;
            Paint::Voxel { base, exposed, colors }
        }
        _ => return Err(wrong("colours of another kind")),
    };
    let tables = ResidentLevel { nx, nz, table, blocks, bottom: 0, top: 0, paint, pages: None };
    Ok(Some(Tile { tables, bytes }))
}

/// A part as values; a rest that makes none is left out, and then there are too few.
fn values<T: AnyBitPattern + Pod>(part: &[u8]) -> Vec<T> {
    pod_collect_to_vec(&part[..part.len() / size_of::<T>() * size_of::<T>()])
}

#[cfg(test)]
mod tests {
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};

    use super::*;
    use crate::testing::noise;

    fn world(caves: bool, color: ColorMode) -> (planecast_encoder::Scene, Arc<dyn TileSource>) {
        let hill = |x: u32, z: u32| 20 + noise(x / 9, 1, z / 9) % 30;
        let solid = |x: u32, y: u32, z: u32| y < hill(x, z) && !(caves && (y / 4 + x / 7 + z / 5).is_multiple_of(3));
        let columns = Columns::from_fn(601, 60, 515, solid);
        let of = |x, y, z| noise(x / 4, y, z / 4).to_le_bytes()[..3].try_into().unwrap();
        let input = Input { columns, colors: Colors::Function(Box::new(of)), notes: Vec::new() };
        let scene = build(input, &BuildOptions { color: Some(color), ..BuildOptions::default() }).unwrap();
        let (mut bytes, name) = (Cursor::new(Vec::new()), Path::new("w.pcast"));
        write_scene_to(&scene, &mut bytes, name).unwrap();
        (scene, Arc::new(PcastFile::from_bytes(name, bytes.into_inner()).unwrap()))
    }

    const KINDS: [(bool, ColorMode); 6] = [
        (false, ColorMode::None),
        (false, ColorMode::Run),
        (false, ColorMode::Voxel),
        (true, ColorMode::None),
        (true, ColorMode::Run),
        (true, ColorMode::Voxel),
    ];

    #[test]
    fn parcels_hold_the_tables_of_their_tiles() {
        for (caves, color) in KINDS {
            let (_, source) = world(caves, color);
            let packer = Packer::new(source.clone());
            for (key, heights) in [(0, 0, 0), (0, 2, 2), (1, 1, 0), (9, 0, 0)]
                .into_iter()
                .flat_map(|(level, x, z)| [true, false].map(|heights| (TileKey { level, x, z }, heights)))
            {
                let expected = Tile::read(&*source, key, heights).unwrap();
                let parcel = packer.tile(key, heights).unwrap();
                let tile = unpack("w", &parcel).unwrap();
                let tables = |tile: Option<Tile>| tile.map(|tile| (tile.tables, tile.bytes));
                // A tile's height bounds are its level's.
                let expected = tables(expected).map(|(tables, n)| (ResidentLevel { bottom: 0, top: 0, ..tables }, n));
                assert!(tables(tile) == expected, "{caves} {color:?} {key:?} {heights}");
            }
        }
    }

    #[test]
    fn parcels_that_are_damaged_are_errors() {
        let packer = Packer::new(world(true, ColorMode::Voxel).1);
        let parcel = packer.tile(TileKey { level: 3, x: 0, z: 0 }, false).unwrap();
        let error = |bytes: &[u8]| unpack("w", bytes).err().map(|e| e.to_string());
        for n in (1..parcel.len()).step_by(97) {
            assert!(
                error(&parcel[..n]).is_some_and(|e| e.starts_with("w: no parcel")),
                "{n} of {} bytes",
                parcel.len()
            );
        }
        for word in 0..16 {
            let mut other = parcel.clone();
            other[4 * word..4 * word + 4].copy_from_slice(&0x7fff_fff7u32.to_le_bytes());
            // How long the tile took to read, and which run is topmost, points nowhere.
            assert_eq!(error(&other).is_some(), ![4, 5, 12, 14].contains(&word), "word {word}");
        }
        let facts = packer.facts().unwrap();
        assert!(Parcels::open(&facts).is_ok());
        for n in [0, 3, 4, 90, facts.len() / 2, facts.len() - 1] {
            assert!(Parcels::open(&facts[..n]).is_err(), "{n} of {} bytes", facts.len());
        }
    }

    #[cfg(feature = "gpu")]
    #[test]
    fn worlds_that_come_as_parcels_become_those_that_are_whole() {
        use crate::cpu::renderer::{CpuRenderer, Outputs};
        use crate::render::drawer::{Drawer, Drawn, Draws};
        use crate::world::tables::Resident;
        use crate::{Camera, Options};

        for (caves, color) in KINDS {
            let (scene, source) = world(caves, color);
            let packer = Packer::new(source.clone());
            let parcels = Arc::new(Parcels::open(&packer.facts().unwrap()).unwrap());
            assert_eq!((parcels.dims(), parcels.levels()), (source.dims(), source.levels()));
            assert_eq!(parcels.preview.scene.dims(), [301, 30, 258]);
            let (mut drawer, mut orders) = Drawer::of_parcels(parcels, 64 << 20, Draws::Cpu, None).unwrap();
            let eye = DVec3::new(300.0, 80.0, 250.0);
            let camera = Camera { eye, yaw: 40.0, pitch: -25.0, width: 120, height: 80, ..Camera::default() };
            let options = Options::default();
            let draw = |drawer: &mut Drawer| match drawer.draw(&camera, None, &options).unwrap() {
                Drawn::Here(frame) => frame,
                Drawn::OnDevice => unreachable!("the CPU draws"),
            };
            assert!(draw(&mut drawer).stats.paging.tiles_missing > 0);
            // One is not to be had at first.
            let first = orders.take().unwrap();
            orders.deliver(first.number, Err(Error::Limit("the way is closed".into())));
            orders.deliver(77, Ok(&[]));
            let mut sharp = draw(&mut drawer);
            assert!(drawer.take_notices().iter().any(|what| what.contains("the way is closed")));
            let mut frames = 0;
            while sharp.stats.paging.tiles_missing > 0 {
                while let Some(order) = orders.take() {
                    let parcel = packer.tile(order.key, order.heights).unwrap();
                    orders.deliver(order.number, Ok(&parcel));
                }
                assert_eq!(orders.out(), 0);
                // It is asked for again after half a second.
                std::thread::sleep(std::time::Duration::from_millis(10));
                sharp = draw(&mut drawer);
                frames += 1;
                assert!(frames < 1000, "the tiles never came");
            }
            let scene = Arc::new(scene);
            let resident = Arc::new(Resident::new(&scene));
            let whole = CpuRenderer::new(&scene, &resident).render(&camera, &options, Outputs::default()).unwrap();
            assert!(whole.color == sharp.color && whole.depth == sharp.depth, "{caves} {color:?}");
        }
    }
}
