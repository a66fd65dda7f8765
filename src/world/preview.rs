//! A coarse look at a world that comes in tiles: enough to find a view of it.

use glam::DVec3;
use planecast_encoder::format::TILE;
use planecast_encoder::model::tiles::tile_size;
use planecast_encoder::{BuildOptions, ColorMode, Colors, Columns, Input, Level, Scene, TileKey, TileSource, build};
use rayon::prelude::*;

use crate::Result;
use crate::film::path::{Path, Pose};
#[cfg(not(target_arch = "wasm32"))]
use crate::frame::aim::AimArgs;

/// Tiles a side that are looked at.
const TILES: u32 = 4;

/// Of worlds without end so many levels are passed over: 4,096 columns a side are looked at.
const ENDLESS_LEVEL: u32 = 2;

/// A part of a world at a coarse level, as a scene without colours, and where its voxels lie in the world.
pub struct Preview {
    pub scene: Scene,
    /// Voxels of level 0 in one of the scene's, along each axis; a power of two.
    pub scale: f64,
    pub origin: DVec3,
}

impl Preview {
    /// Of the whole world, or of what lies round the place where one first stands in a world without end.
    ///
    /// # Errors
    /// Those of the tiles.
    pub fn new(source: &dyn TileSource) -> Result<Preview> {
        Preview::of(source, TILES)
    }

    /// The same of so many tiles a side, a power of two.
    pub(crate) fn of(source: &dyn TileSource, most: u32) -> Result<Preview> {
        let dims = source.dims();
        let side = |level: u32, axis: usize| dims[axis].div_ceil(1 << level).div_ceil(TILE);
        let (level, first) = match source.start() {
            Some([x, _, z]) => {
                let first = |v: u32, axis: usize| {
                    let last = side(ENDLESS_LEVEL, axis).saturating_sub(most);
                    ((v >> ENDLESS_LEVEL) / TILE).saturating_sub(most / 2).min(last)
                };
                (ENDLESS_LEVEL, [first(x, 0), first(z, 2)])
            }
            None => {
                let fits = |&level: &u32| side(level, 0).max(side(level, 2)) <= most;
                let last = source.levels() - 1;
                ((0..last).find(fits).unwrap_or(last), [0, 0])
            }
        };
        let tiles = [0, 1].map(|k| side(level, 2 * k).min(first[k] + most) - first[k]);
        let keys: Vec<TileKey> = (0..tiles[1])
            .flat_map(|z| (0..tiles[0]).map(move |x| TileKey { level, x: first[0] + x, z: first[1] + z }))
            .collect();
        let read: Vec<Level> = keys.par_iter().map(|&key| Ok(source.tile(key)?)).collect::<Result<_>>()?;
        let sizes: Vec<[u32; 2]> = keys.iter().map(|&key| tile_size(dims, key)).collect();
        let nx = sizes[..tiles[0] as usize].iter().map(|size| size[0]).sum();
        let nz = sizes.iter().step_by(tiles[0] as usize).map(|size| size[1]).sum();
        let columns = Columns::from_rows(nx, dims[1].div_ceil(1 << level).max(1), nz, |z, out| {
            for x in 0..nx {
                let tile = &read[((z / TILE) * tiles[0] + x / TILE) as usize];
                tile.solid.column(x % TILE, z % TILE).iter().for_each(|&run| out.push_run(run));
                out.end_column();
            }
        });
        let input = Input { columns, colors: Colors::None, notes: Vec::new() };
        let scene = build(input, &BuildOptions { color: Some(ColorMode::None), ..BuildOptions::default() })?;
        let scale = f64::from(1u32 << level);
        let origin = DVec3::new(f64::from(first[0] * TILE), 0.0, f64::from(first[1] * TILE)) * scale;
        Ok(Preview { scene, scale, origin })
    }

    /// A place of the world, in the scene.
    pub fn within(&self, place: DVec3) -> DVec3 {
        (place - self.origin) / self.scale
    }

    /// What is aimed at, in the scene.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn aim(&self, aim: &AimArgs) -> AimArgs {
        let orbit = aim.orbit.map(|orbit| orbit.scaled(1.0 / self.scale));
        let mut inner = *aim;
        (inner.look_at, inner.orbit) = (aim.look_at.map(|place| self.within(place)), orbit);
        inner
    }

    /// A pose in the scene, in the world.
    pub fn pose(&self, pose: Pose) -> Pose {
        Pose { eye: self.origin + pose.eye * self.scale, ..pose }
    }

    /// The same of a path.
    pub fn path(&self, path: &Path) -> Path {
        path.with_poses(|pose| self.pose(pose))
    }
}
