//! Translucent matter made ready for drawing: its columns by level, and what each code of it does to light, which can be changed while
//! others draw.

use std::sync::{Arc, PoisonError, RwLock};

use planecast_encoder::Scene;
use planecast_encoder::model::matter::{Classes, Matter, Mode, STEPS, extinction};
use planecast_encoder::model::transfer::Transfer;
use rayon::prelude::*;

/// Columns a side of a block whose heights with matter are kept.
pub const BLOCK_SHIFT: u32 = 3;

/// What a code of matter does to light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Optics {
    /// 0 to 255.
    pub color: [f64; 3],
    /// Per voxel of level 0; of [`Mode::Surface`] at each entry.
    pub extinction: f64,
    pub mode: Mode,
    /// The same for codes of one material, 0 for those of values.
    pub material: u16,
}

/// The matter of a scene.
pub struct SceneMatter {
    /// Level 0 first.
    pub levels: Vec<Arc<Matter>>,
    /// As the scene file has them.
    pub classes: Arc<Classes>,
    look: RwLock<Arc<Look>>,
}

/// What matter looks like, and where it can be seen.
#[derive(Debug, PartialEq)]
pub struct Look {
    /// By code.
    pub optics: Vec<Optics>,
    pub levels: Vec<LookLevel>,
}

/// Where matter of a level can be seen.
#[derive(Debug, PartialEq)]
pub struct LookLevel {
    /// Heights of 64 equal layers are `1 << shift` voxels of the level.
    pub shift: u32,
    /// Of blocks of 8 × 8 columns, a bit a layer.
    pub blocks: Vec<u64>,
    /// Blocks along x.
    pub across: u32,
    /// Lowest voxel, and one past the highest.
    pub heights: [u32; 2],
}

impl Look {
    fn new(classes: &Classes, levels: &[Arc<Matter>]) -> Look {
        let optics: Vec<Optics> = (0..=classes.max_code()).map(|code| optics(classes, code)).collect();
        let levels = levels.iter().map(|matter| LookLevel::new(matter, &optics)).collect();
        Look { optics, levels }
    }

    /// Whether nothing of it can be seen.
    pub fn is_clear(&self) -> bool {
        self.levels[0].heights[0] >= self.levels[0].heights[1]
    }
}

/// Of mixtures extinctions are added up, as light passes through one part and then the other; colours by how much each takes.
fn optics(classes: &Classes, code: u16) -> Optics {
    let whole = |k: u16| {
        let class = &classes.classes[usize::from(k - 1)];
        (class.color.map(f64::from), extinction(class.opacity), class.mode)
    };
    if code == 0 {
        return Optics::default();
    }
    if classes.window.is_none() {
        let (material, eighths) = ((code - 1) / STEPS + 1, (code - 1) % STEPS + 1);
        let (color, all, mode) = whole(material);
        return Optics { color, extinction: all * f64::from(eighths) / f64::from(STEPS), mode, material };
    }
    let (k, part) = (code / STEPS, f64::from(code % STEPS) / f64::from(STEPS));
    let below = (k > 0).then(|| whole(k));
    let above = (part > 0.0).then(|| whole(k + 1));
    let (mut color, mut sum) = ([0.0; 3], 0.0);
    for ((of, extinction, _), share) in [below.map(|b| (b, 1.0 - part)), above.map(|a| (a, part))].into_iter().flatten()
    {
        let weight = extinction * share;
        sum += weight;
        (0..3).for_each(|i| color[i] += weight * of[i]);
    }
    if sum > 0.0 {
        color = color.map(|c| c / sum);
    }
    Optics { color, extinction: sum, mode: Mode::Volumetric, material: 0 }
}

impl LookLevel {
    fn new(matter: &Matter, optics: &[Optics]) -> LookLevel {
        let [nx, ny, nz] = matter.dims();
        let (across, along) = (nx.div_ceil(1 << BLOCK_SHIFT), nz.div_ceil(1 << BLOCK_SHIFT));
        let shift = ny.div_ceil(64).next_power_of_two().trailing_zeros();
        let mut blocks = vec![0u64; across as usize * along as usize];
        let rows = blocks.par_chunks_mut(across as usize).enumerate();
        let heights = rows.map(|(bz, row)| {
            let mut heights = [u32::MAX, 0];
            let bz = bz as u32;
            for z in bz << BLOCK_SHIFT..nz.min((bz + 1) << BLOCK_SHIFT) {
                for x in 0..nx {
                    let (mut from, mut bits) = (0, 0u64);
                    for run in matter.column(z as usize * nx as usize + x as usize) {
                        let end = run.end();
                        if optics[usize::from(run.code())].extinction > 0.0 {
                            heights = [heights[0].min(from), heights[1].max(end)];
                            let (a, b) = (from >> shift, (end - 1) >> shift);
                            bits |= (u64::MAX << a) & (u64::MAX >> (63 - b));
                        }
                        from = end;
                    }
                    row[(x >> BLOCK_SHIFT) as usize] |= bits;
                }
            }
            heights
        });
        let heights = rows_heights(heights);
        LookLevel { shift, blocks, across, heights }
    }
}

fn rows_heights(rows: impl ParallelIterator<Item = [u32; 2]>) -> [u32; 2] {
    rows.reduce(|| [u32::MAX, 0], |a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

impl SceneMatter {
    /// That of a scene; None where there is none.
    pub fn of(scene: &Scene) -> Option<Arc<SceneMatter>> {
        let levels: Option<Vec<Arc<Matter>>> = scene.levels.iter().map(|level| level.matter.clone()).collect();
        let (levels, classes) = (levels?, scene.classes.clone()?);
        let look = RwLock::new(Arc::new(Look::new(&classes, &levels)));
        Some(Arc::new(SceneMatter { levels, classes, look }))
    }

    /// What it looks like at this moment.
    pub fn look(&self) -> Arc<Look> {
        Arc::clone(&self.look.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Takes another transfer function from the next frame on. Says whether that means anything: materials have none.
    pub fn set_transfer(&self, transfer: &Transfer) -> bool {
        let Some(window) = self.classes.window else { return false };
        let classes = transfer.classes(window, self.classes.classes.len());
        let look = Arc::new(Look::new(&classes, &self.levels));
        *self.look.write().unwrap_or_else(PoisonError::into_inner) = look;
        true
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        self.levels.iter().map(|level| level.bytes()).sum()
    }
}

impl std::fmt::Debug for SceneMatter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SceneMatter").field("classes", &self.classes.classes.len()).finish_non_exhaustive()
    }
}

impl PartialEq for SceneMatter {
    fn eq(&self, other: &SceneMatter) -> bool {
        self.levels == other.levels && self.look() == other.look()
    }
}

#[cfg(test)]
mod tests {
    use planecast_encoder::model::matter::Class;

    use super::*;

    #[test]
    fn mixtures_take_what_their_parts_take() {
        let class = |color, opacity| Class { color, opacity, mode: Mode::Volumetric };
        let classes = vec![class([100, 0, 0], 0.5), class([0, 200, 0], 0.75)];
        let of_values = Classes { window: Some([0.0, 2.0]), classes: classes.clone() };
        let half = 2f64.ln();
        let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        close(optics(&of_values, 8).extinction, half);
        close(optics(&of_values, 4).extinction, half / 2.0);
        // Half of one that takes ln 2 and half of one that takes 2 ln 2.
        let mixed = optics(&of_values, 12);
        close(mixed.extinction, 1.5 * half);
        close(mixed.color[0], 100.0 / 3.0);
        close(mixed.color[1], 400.0 / 3.0);
        let materials = Classes { window: None, classes };
        close(optics(&materials, 12).extinction, half);
        assert_eq!(optics(&materials, 12).color, [0.0, 200.0, 0.0]);
        assert_eq!(optics(&materials, 0), Optics::default());
    }
}
