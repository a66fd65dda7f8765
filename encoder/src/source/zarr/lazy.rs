//! Zarr arrays and images whose tiles are read and thresholded when they are asked for.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

use super::{Image, above, array, find, node};
use crate::encode::mips;
use crate::format::{Grid, TILE, grids};
use crate::model::pieces::Pieces;
use crate::model::tiles::{TileKey, TileSource, tile_size};
use crate::source::{ReadOptions, Spacing, guarded};
use crate::{ColorMode, Columns, Error, Level, MipRule, Result};

/// Voxels, and columns, of a level from which coarser ones are made in memory.
const MOST_VOXELS: u64 = 1 << 28;
const MOST_COLUMNS: u64 = 1 << 22;

/// An array, or an image of several resolutions.
pub struct ZarrTiles {
    path: PathBuf,
    /// Resolutions that are halvings of each other, finest first.
    scales: Vec<Box<dyn Pieces>>,
    grids: Vec<Grid>,
    /// Levels coarser than the coarsest resolution.
    coarser: OnceLock<Vec<Columns>>,
    making: Mutex<()>,
}

impl ZarrTiles {
    /// The image or array at `path`. None where it must be read as a whole first: what is solid is found from all its values without
    /// --iso, and voxels that are no cubes are made to be, without --spacing as-is; colours of --ramp come from values.
    pub fn open(path: &Path, opts: &ReadOptions) -> Result<Option<ZarrTiles>> {
        if opts.iso.is_none() || opts.ramp.is_some() {
            return Ok(None);
        }
        let (folder, image) = find(path)?;
        let opts = ReadOptions { show: false, size: None, ..opts.clone() };
        let first = look(&folder, image, &opts)?;
        let cubes = first.about().voxel.is_none_or(|[x, y, z]| x == y && y == z);
        if !cubes && opts.spacing != Some(Spacing::AsIs) {
            return Ok(None);
        }
        let opts = ReadOptions { spacing: Some(Spacing::AsIs), ..opts };
        let grids = grids(first.dims());
        let mut scales = vec![first];
        for (next, grid) in coarser(&folder).into_iter().zip(&grids[1..]) {
            let Ok(scale) = above(&next).and_then(|image| look(&next, image, &opts)) else { break };
            // Halves are rounded up or down.
            let halved = (0..3).all(|i| (scale.dims()[i]..=scale.dims()[i] + 1).contains(&grid.dims[i]));
            if !halved {
                break;
            }
            scales.push(scale);
        }
        let (coarser, making) = Default::default();
        Ok(Some(ZarrTiles { path: path.to_owned(), scales, grids, coarser, making }))
    }

    /// Columns of a resolution; those that it lacks at its far edges are empty.
    fn columns(&self, level: usize, xs: Range<u32>, zs: Range<u32>) -> Result<Columns> {
        let (scale, ny) = (&self.scales[level], self.grids[level].dims[1]);
        let [nx, _, nz] = scale.dims();
        let [width, depth] = [&xs, &zs].map(|r| r.len() as u32);
        let inside = |r: &Range<u32>, n: u32| r.start.min(n)..r.end.min(n);
        let (xs, zs) = (inside(&xs, nx), inside(&zs, nz));
        if xs.is_empty() || zs.is_empty() {
            return Ok(Columns::empty(width, ny, depth));
        }
        let (w, d) = (xs.len() as u32, zs.len() as u32);
        let found = scale.piece(xs, zs)?.columns;
        let none = Columns::empty(width, ny, 1);
        Ok(Columns::gather(ny, 0..width, 0..depth, |x, z| match x < w && z < d {
            true => (&found, found.index(x, z), w - x),
            false => (&none, x as usize, width - x),
        }))
    }

    fn coarser(&self) -> Result<&[Columns]> {
        let _one = self.making.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(levels) = self.coarser.get() {
            return Ok(levels);
        }
        let last = self.scales.len() - 1;
        let [nx, ny, nz] = self.grids[last].dims;
        let columns = u64::from(nx) * u64::from(nz);
        if columns > MOST_COLUMNS || columns * u64::from(ny) > MOST_VOXELS {
            let what = format!(
                "Zarr: its coarsest resolution has {nx} × {ny} × {nz} voxels; coarser levels are made of up to {MOST_VOXELS} voxels \
                 in {MOST_COLUMNS} columns: write an image of more resolutions, or encode it"
            );
            return Err(Error::format(&self.path, what));
        }
        let mut levels = vec![self.columns(last, 0..nx, 0..nz)?];
        while levels.last().is_some_and(|l| l.nx().max(l.nz()) > 1) {
            levels.push(mips::next(levels.last().expect("there is one"), MipRule::Majority));
        }
        Ok(self.coarser.get_or_init(|| levels))
    }
}

/// An array whose chunks are read when they are asked for, its voxels taken as cubes.
fn look(folder: &Path, image: Option<Image>, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    let opts = ReadOptions { spacing: Some(Spacing::AsIs), ..opts.clone() };
    guarded(folder, "Zarr", || array(folder, image, &opts))
}

/// The resolutions of an image after one.
fn coarser(folder: &Path) -> Vec<PathBuf> {
    for (group, inner) in folder.ancestors().skip(1).take(3).zip([1, 2, 3]) {
        let Ok(node) = node(group) else { continue };
        let image = node.attributes.get("ome").unwrap_or(&node.attributes);
        let Some(datasets) = image["multiscales"][0]["datasets"].as_array() else { continue };
        let names: Vec<&str> = datasets.iter().filter_map(|d| d["path"].as_str()).collect();
        let own: PathBuf = folder.components().rev().take(inner).collect::<Vec<_>>().into_iter().rev().collect();
        let Some(at) = names.iter().position(|name| Path::new(name) == own) else { continue };
        let down = |name: &&&str| !name.split(['/', '\\']).any(|part| part.is_empty() || part == "..");
        return names[at + 1..].iter().take_while(down).map(|name| group.join(name)).collect();
    }
    Vec::new()
}

impl TileSource for ZarrTiles {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn dims(&self) -> [u32; 3] {
        self.grids[0].dims
    }

    fn color(&self) -> ColorMode {
        ColorMode::None
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        [0, self.grids[level as usize].dims[1]]
    }

    fn is_empty(&self, _: TileKey) -> bool {
        false
    }

    fn tile(&self, key: TileKey) -> Result<Level> {
        let TileKey { level, x, z } = key;
        let [w, d] = tile_size(self.dims(), key);
        if level >= self.levels() || w == 0 || d == 0 {
            let path = self.path.display();
            return Err(Error::Argument(format!("{path}: there is no tile ({x}, {z}) of level {level}")));
        }
        let (xs, zs) = (x * TILE..x * TILE + w, z * TILE..z * TILE + d);
        let own = level as usize;
        let solid = match own.checked_sub(self.scales.len() - 1) {
            Some(above) if above > 0 => self.coarser()?[above].crop(xs, zs),
            _ => self.columns(own, xs, zs)?,
        };
        Ok(Level { solid, exposed: None, colors: Vec::new(), matter: None })
    }
}
