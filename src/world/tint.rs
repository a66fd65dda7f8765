//! Colours by height instead of those that a scene has, or has not (`--ramp` of a scene): a table per level, no byte per column.

use planecast_encoder::format::grids;
use planecast_encoder::source::Ramp;
use planecast_encoder::{About, ColorMode, Encoding, Level, TileKey, TileSource};
use std::sync::Arc;

use crate::world::pager::PINNED;
use crate::world::tables::{EMPTY, Paint, Resident, ResidentLevel, pack_rgb};
use crate::{Error, Result};

/// A ramp, and what it needs to know of a scene.
#[derive(Clone, Debug)]
pub struct Tint {
    ramp: Ramp,
    /// Height of the world's floor and of a voxel, in the unit that the ramp's heights are in.
    floor: f64,
    voxel: f64,
}

impl Tint {
    /// A ramp by name or from a file, for the scene of which `about` tells; `None` for "none".
    ///
    /// # Errors
    /// [`Error::Argument`] where there is no such ramp, or it names heights and the scene does not say how high it is; what is
    /// wrong with the file.
    pub fn new(name: &str, about: &About) -> Result<Option<Tint>> {
        let Some(ramp) = Ramp::find(name)? else { return Ok(None) };
        let up = about.affine.map(|rows| rows[2]);
        if ramp.names_heights() && up.is_none() {
            return Err(Error::Argument(format!(
                "--ramp {name}: has heights, and the scene does not say how high it is; give shares instead, as in 50%"
            )));
        }
        let [_, voxel, _, floor] = up.unwrap_or([0.0, 1.0, 0.0, 0.0]);
        Ok(Some(Tint { ramp, floor, voxel }))
    }

    /// The ramp that was asked for, if any was.
    ///
    /// # Errors
    /// Those of [`Tint::new`].
    pub fn asked(ramp: Option<&str>, about: &About) -> Result<Option<Tint>> {
        ramp.map_or(Ok(None), |name| Tint::new(name, about))
    }

    /// Gives the levels of a resident world the ramp's colours.
    pub fn paint(&self, resident: &mut Resident) {
        let [low, high] = range(resident).map(|y| self.floor + self.voxel * f64::from(y));
        let table = self.ramp.over(low.min(high), low.max(high));
        for (level, l) in resident.levels.iter_mut().zip(0..) {
            let color = |y: u32| {
                let top = (f64::from(y) + 1.0) * f64::from(1u32 << l);
                let [r, g, b] = table.tint(self.floor + self.voxel * top);
                pack_rgb([r, g, b].map(|c| c.round() as u8))
            };
            // One more, so that a world of air has a table too.
            let heights = 0..=resident.dims[1].div_ceil(1 << l);
            level.paint = Paint::Height { colors: heights.map(color).collect() };
        }
        resident.color = ColorMode::None;
    }
}

/// How high the lowest column of all that are not empty is, and the highest, in voxels of level 0; as the finest level shows
/// them that is in memory whatever else is.
fn range(resident: &Resident) -> [u32; 2] {
    let l = grids(resident.dims).iter().position(|grid| grid.n_tiles() <= PINNED).unwrap_or(0);
    let level: &ResidentLevel = &resident.levels[l];
    let cells = (0..level.nz).flat_map(|z| (0..level.nx).map(move |x| (x, z)));
    let tops = cells.map(|(x, z)| level.entry(level.index(x, z))[0]).filter(|&top| top != EMPTY);
    let tops = tops.map(|top| ((top >> 16) + 1) << l);
    let [low, high] = tops.fold([u32::MAX, 0], |[low, high], top| [low.min(top), high.max(top)]);
    [low.min(high), high]
}

/// A world's tiles without their colours.
pub(crate) struct Uncolored(pub Arc<dyn TileSource>);

impl TileSource for Uncolored {
    fn name(&self) -> String {
        self.0.name()
    }

    fn dims(&self) -> [u32; 3] {
        self.0.dims()
    }

    fn levels(&self) -> u32 {
        self.0.levels()
    }

    fn encoding(&self) -> Encoding {
        self.0.encoding()
    }

    fn color(&self) -> ColorMode {
        ColorMode::None
    }

    fn about(&self) -> About {
        self.0.about()
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        self.0.heights(level)
    }

    fn is_height_field(&self) -> bool {
        self.0.is_height_field()
    }

    fn start(&self) -> Option<[u32; 3]> {
        self.0.start()
    }

    fn is_empty(&self, key: TileKey) -> bool {
        self.0.is_empty(key)
    }

    fn tile(&self, key: TileKey) -> planecast_encoder::Result<Level> {
        self.0.tile(key)
    }

    fn has_matter(&self) -> bool {
        self.0.has_matter()
    }

    fn bytes(&self, key: TileKey) -> u64 {
        self.0.bytes(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, Run, build};

    #[test]
    fn voxels_have_the_colour_of_their_height() {
        let columns = Columns::from_rows(300, 200, 1, |_, out| {
            for x in 0..300u32 {
                out.push_run(Run::new(0, (99 + x / 3) as u16));
                out.end_column();
            }
        });
        let scene =
            build(Input { columns, colors: Colors::None, notes: Vec::new() }, &BuildOptions::default()).unwrap();
        let plain = Resident::new(&scene);
        // A voxel is 2 m high, and the floor 100 m below the sea: columns are 100 m to 298 m high.
        let affine = Some([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 2.0, 0.0, -100.0]]);
        let about = About { affine, ..About::default() };
        let tint = Tint::new("grey", &about).unwrap().unwrap();
        let mut tinted = plain.clone();
        tint.paint(&mut tinted);
        assert!(tinted.bytes() < plain.bytes() + 4 * 600);
        let grey = |l: usize, y: u32| {
            let [r, g, b, a] = tinted.levels[l].color(7, 0, y).to_le_bytes();
            assert_eq!([r, r, 255], [g, b, a]);
            i32::from(r)
        };
        // `grey` goes from 40 to 230; what is below the lowest column is as it is.
        assert_eq!([grey(0, 99), grey(0, 0), grey(0, 198)], [40, 40, 230]);
        assert_eq!(grey(0, 149), (40.0 + 190.0 * 50.0 / 99.0_f64).round() as i32);
        assert!((grey(1, 74) - grey(0, 149)).abs() <= 1);
        // Heights of a file are in the scene's unit, and need one.
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("ramp.txt");
        std::fs::write(&file, "100 10 20 30\n298 10 20 250\n").unwrap();
        let name = file.to_str().unwrap();
        let tint = Tint::new(name, &about).unwrap().unwrap();
        assert!(Tint::new(name, &About::default()).unwrap_err().to_string().contains("give shares instead"));
        tint.paint(&mut tinted);
        assert_eq!(tinted.levels[0].color(0, 0, 198).to_le_bytes(), [10, 20, 250, 255]);
        assert!(Tint::new("none", &about).unwrap().is_none());
        assert!(Tint::new("no such", &about).is_err());
    }
}
