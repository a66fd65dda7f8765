//! A cumulus: five octaves of noise that eat into a dome, as classes of density; nothing of it is solid.

use std::ops::Range;
use std::sync::Arc;

use super::noise::{gradient_noise, sub_seed};
use crate::model::about::Kind;
use crate::model::matter::Matter;
use crate::model::pieces::Pieces;
use crate::model::transfer::Transfer;
use crate::{About, Colors, Columns, Input, Result};

const OCTAVES: u32 = 5;

/// Steps of density.
const CLASSES: u16 = 32;

/// Cells of the widest octave along a side.
const CELLS: u32 = 4;

pub struct Cloud {
    size: u32,
    seeds: [u32; OCTAVES as usize],
    about: About,
}

pub fn make(size: u32, seed: u64) -> Cloud {
    let window = [0.0, 1.0];
    let transfer = Transfer::preset("cloud", window).expect("a preset of this name");
    let classes = transfer.classes(window, CLASSES.into());
    let about = About { kind: Some(Kind::Procedural), classes: Some(Arc::new(classes)), ..About::default() };
    Cloud { size, seeds: std::array::from_fn(|i| sub_seed(seed, i as u32)), about }
}

impl Cloud {
    /// From 0 where the dome ends to 1 in its middle; its bottom is flat.
    fn dome(&self, [x, y, z]: [f32; 3]) -> f32 {
        let (dx, dz) = ((x - 0.5) / 0.48, (z - 0.5) / 0.48);
        let dy = if y > 0.3 { (y - 0.3) / 0.62 } else { (y - 0.3) / 0.24 };
        1.0 - (dx * dx + dy * dy + dz * dz)
    }

    /// The class of a voxel, 0 for clear air.
    fn class(&self, voxel: [u32; 3]) -> u16 {
        let scale = 1.0 / self.size as f32;
        let at = voxel.map(|v| (v as f32 + 0.5) * scale);
        let dome = self.dome(at);
        // Noise adds less than this.
        if dome < -0.7 {
            return 0;
        }
        let (mut sum, mut share, mut cells) = (0.0, 1.0, CELLS);
        for seed in self.seeds {
            sum += share * gradient_noise(seed, [cells; 2], at.map(|v| v * cells as f32));
            (share, cells) = (share * 0.55, cells * 2);
        }
        let density = (dome * 1.2 + 0.9 * sum - 0.25).clamp(0.0, 1.0);
        (density * f32::from(CLASSES) + 0.5) as u16
    }
}

impl Pieces for Cloud {
    fn dims(&self) -> [u32; 3] {
        [self.size; 3]
    }

    fn colored(&self) -> bool {
        false
    }

    fn notes(&self) -> &[String] {
        &[]
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let columns = Columns::empty(xs.len() as u32, self.size, zs.len() as u32);
        Ok(Input { columns, colors: Colors::None, notes: Vec::new() })
    }

    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        let dims = [xs.len() as u32, self.size, zs.len() as u32];
        let matter = Matter::try_from_rows(dims, |z, out| {
            for x in xs.clone() {
                (0..self.size).for_each(|y| out.push(1, 8 * self.class([x, y, z + zs.start])));
                out.end_column();
            }
            Ok(())
        })?;
        Ok(Some(matter))
    }
}
