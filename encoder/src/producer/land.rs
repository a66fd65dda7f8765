//! Land with what a height map cannot hold: overhangs, caves, things that float.

use super::hills::{land, mix, shade};
use super::noise::{ONE, hash};
use super::octaves::{Field, Octaves};
use super::{Area, Cells, Density, Interval, Part, SIDE, Spot};
use crate::{ColorMode, Rgb};

/// Voxels that are solid at the bottom, whatever else.
const FLOOR: i32 = 4;

/// Things that float: solid where noise is above a threshold, which grows away from a height.
struct Floating {
    noise: Field,
    /// In voxels; half as high as 2^`shift`.
    middle: i32,
    shift: u32,
    /// In 4,096ths: at the middle, and how much more at a distance of 2^`shift` voxels.
    threshold: i32,
    growth: i32,
    color: Rgb,
}

/// Ground that bends, with caves in it and something above it.
pub struct Land {
    seed: u32,
    high: u32,
    base: i32,
    /// In 4,096ths of a voxel: the ground's height, and how it bends.
    ground: Octaves,
    bend: Option<Field>,
    /// In 4,096ths: tunnels are where both are near 0.
    caves: Option<[Field; 2]>,
    floating: Option<Floating>,
}

/// Squares of both caves' noise together where a tunnel ends, in 4,096ths.
const TUNNEL: i32 = 40;

/// Voxels of ground that tunnels leave above them, but where it bends up by more than so many.
const ROOF: i32 = 8;
const ENTRY: i32 = 20;

/// What ground bends by at most, in 4,096ths of a voxel.
const BEND: i32 = 48 * ONE;

/// Ground that bends, near its surface.
#[inline(always)]
fn bent(value: i32, bend: i32) -> i32 {
    if value.abs() <= BEND { value + bend.clamp(-BEND, BEND) } else { value }
}

/// Ground with a tunnel in it.
#[inline(always)]
fn hollowed(value: i32, bend: i32, squares: i32) -> i32 {
    let roofed = value > ROOF * ONE || (value > 0 && bend > ENTRY * ONE);
    if roofed && squares <= TUNNEL { (squares - TUNNEL) * 64 } else { value }
}

/// What floats, where its noise is above the threshold.
#[inline(always)]
fn added(value: i32, above: i32) -> i32 {
    if above > 0 { value.max(above * 64) } else { value }
}

impl Land {
    fn seeds(seed: u32) -> impl Fn(u32) -> u32 {
        move |i| hash(seed, i, 0, 7)
    }

    /// Rugged, with overhangs, tunnels and a few floating rocks.
    pub fn terrain(seed: u32) -> Land {
        let of = Land::seeds(seed);
        let bend = Field::new(Octaves::new(of(2), 3, 7, 3, 36 << 4, 100));
        Land {
            seed,
            high: 512,
            base: 150,
            ground: Octaves::new(of(1), 2, 10, 2, 220 << 4, 120),
            bend: Some(bend),
            caves: Some([3, 4].map(|i| Field::new(Octaves::new(of(i), 3, 6, 5, 16, 100)))),
            floating: Some(Floating {
                noise: Field::new(Octaves::new(of(5), 3, 7, 4, 16, 80)),
                middle: 400,
                shift: 7,
                threshold: 1900,
                growth: 3500,
                color: [112, 108, 104],
            }),
        }
    }

    /// Smooth, under many floating rocks.
    pub fn rocks(seed: u32) -> Land {
        let of = Land::seeds(seed);
        Land {
            seed,
            high: 512,
            base: 130,
            ground: Octaves::new(of(1), 2, 10, 5, 160 << 4, 110),
            bend: None,
            caves: None,
            floating: Some(Floating {
                noise: Field::new(Octaves::new(of(2), 3, 7, 3, 16, 80)),
                middle: 340,
                shift: 7,
                threshold: 900,
                growth: 2600,
                color: [118, 108, 96],
            }),
        }
    }

    /// Hills under a shell of clouds.
    pub fn clouds(seed: u32) -> Land {
        let of = Land::seeds(seed);
        Land {
            seed,
            high: 768,
            base: 140,
            ground: Octaves::new(of(1), 2, 11, 2, 260 << 4, 112),
            bend: None,
            caves: None,
            floating: Some(Floating {
                noise: Field::new(Octaves::new(of(2), 3, 8, 3, 16, 100)),
                middle: 600,
                shift: 6,
                threshold: 700,
                growth: 1400,
                color: [246, 248, 252],
            }),
        }
    }

    /// Height of the ground in 4,096ths of a voxel.
    #[inline(always)]
    fn surface(&self, ground: i32) -> i32 {
        (self.base * ONE + ground).clamp(FLOOR * ONE, (self.high as i32 - 1) * ONE)
    }

    /// The density from its parts. All but the height of the voxel's middle, half voxels, and the tunnels' squares are in 4,096ths.
    #[inline(always)]
    fn combined(&self, y: i32, surface: i32, bend: i32, squares: Option<i32>, floating: i32) -> i32 {
        // Each part counts only where it can tell, so that who knows that it cannot need not make it.
        let mut value = bent(surface - y * (ONE / 2), bend);
        if let Some(squares) = squares {
            value = hollowed(value, bend, squares);
        }
        if let Some(of) = &self.floating
            && of.reaches(y)
        {
            value = added(value, floating - of.limit(y));
        }
        value.max((FLOOR * 2 - y) * (ONE / 2))
    }

    /// Whether a level shows tunnels at all: some ten voxels wide, they vanish where voxels are half as wide.
    fn caves_of(&self, level: u32) -> Option<&[Field; 2]> {
        self.caves.as_ref().filter(|_| level <= 3)
    }

    fn bounded(&self, surface: Interval, y: [u32; 2], part: &Part, caves: bool, closely: bool) -> Interval {
        let [low, high] = y.map(|y| y.min(1 << 17) as i32);
        let far = |most: i32| Interval { least: -most, most };
        let any = caves.then_some(Interval { least: 0, most: 1 << 22 });
        // What costs nothing first.
        let over = |bend: Interval, squares: Option<Interval>, floating: Interval| {
            let middle = self.floating.as_ref().map_or(low, |of| (2 * of.middle).clamp(low, high));
            let squares = |end: fn(Interval) -> i32| squares.map(end);
            let least = surface.least - high * (ONE / 2) + bend.least;
            let least = squares(|s| s.least).map_or(least, |s| least.min((s - TUNNEL) * 64));
            let most = surface.most - low * (ONE / 2) + bend.most;
            let most = squares(|s| s.most).map_or(most, |s| most.min((s - TUNNEL) * 64));
            let float = |floating: i32, y: i32| match &self.floating {
                Some(of) if of.reaches(y) => (floating - of.limit(y)) * 64,
                _ => i32::MIN,
            };
            let farther = self
                .floating
                .as_ref()
                .map_or(high, |of| if (low - 2 * of.middle).abs() > (high - 2 * of.middle).abs() { low } else { high });
            // It adds where it is above the threshold, and nothing elsewhere.
            let sure = float(floating.least, farther);
            let least = if sure > 0 { least.max(sure) } else { least };
            let ground = |y: i32| (FLOOR * 2 - y) * (ONE / 2);
            Interval { least: least.max(ground(high)), most: most.max(float(floating.most, middle)).max(ground(low)) }
        };
        let bend = far(if self.bend.is_some() { BEND } else { 0 });
        let floating = far(self.floating.as_ref().map_or(0, |of| of.noise.most()));
        let first = over(bend, any, floating);
        if first.least > 0 || first.most <= 0 || !closely {
            return first;
        }
        let bend = self.bend.as_ref().map_or(bend, |of| {
            let Interval { least, most } = of.bounds(part);
            Interval { least: least.clamp(-BEND, 0), most: most.clamp(0, BEND) }
        });
        // Only where it can matter: rocks are far above the ground.
        let floating = match &self.floating {
            Some(of) if (low - 2 * of.middle).abs().min((high - 2 * of.middle).abs()) < 8 << of.shift => {
                of.noise.bounds(part)
            }
            _ => floating,
        };
        over(bend, any, floating)
    }
}

impl Floating {
    /// Whether there is any at a height in half voxels.
    #[inline(always)]
    fn reaches(&self, y: i32) -> bool {
        (y - 2 * self.middle).abs() <= 2 << self.shift
    }

    /// The threshold at a height in half voxels.
    #[inline(always)]
    fn limit(&self, y: i32) -> i32 {
        let away = ((y - 2 * self.middle).abs().min(16 << self.shift) << 11) >> self.shift;
        self.threshold + ((((away * away) >> 12) * (self.growth >> 4)) >> 8)
    }
}

impl Density for Land {
    fn height(&self) -> u32 {
        self.high
    }

    fn value(&self, p: [u32; 3], level: u32) -> i32 {
        let of = |field: &Option<Field>| field.as_ref().map_or(0, |f| f.at(p, level));
        let squares = self.caves_of(level).map(|caves| caves.iter().map(|o| square(o.at(p, level))).sum());
        let floating = self.floating.as_ref().map_or(0, |of| of.noise.at(p, level));
        let surface = self.surface(self.ground.at2([p[0], p[2]], level));
        self.combined(p[1].min(1 << 17) as i32, surface, of(&self.bend), squares, floating)
    }

    fn bounds(&self, part: &Part) -> Interval {
        let Interval { least, most } = self.ground.bounds(part);
        let surface = Interval { least: self.surface(least), most: self.surface(most) };
        self.bounded(surface, [part.from[1], part.to[1]], part, self.caves.is_some(), true)
    }

    fn shared(&self, area: &Area) -> Vec<i32> {
        let mut ground = self.ground.over(area);
        ground.iter_mut().for_each(|g| *g = self.surface(*g));
        ground
    }

    fn n_shared(&self) -> usize {
        1
    }

    fn bounds_in(&self, shared: &[i32], cells: &Cells) -> Interval {
        let surface = shared.iter().fold(Interval { least: i32::MAX, most: i32::MIN }, |i, &s| Interval {
            least: i.least.min(s),
            most: i.most.max(s),
        });
        let end = |axis: usize| cells.middle(axis, cells.size[axis] - 1);
        let part = Part {
            level: cells.level,
            from: [0, 1, 2].map(|axis| cells.middle(axis, 0)),
            to: [end(0), end(1), end(2)],
        };
        self.bounded(surface, [part.from[1], part.to[1]], &part, self.caves_of(cells.level).is_some(), false)
    }

    fn fill(&self, shared: &[i32], cells: &Cells, values: &mut [i32]) {
        let n = values.len();
        let ny = cells.size[1] as usize;
        let ys: Vec<i32> = (0..cells.size[1]).map(|y| cells.middle(1, y).min(1 << 17) as i32).collect();
        let (low, high) = (ys[0], ys[ny - 1]);
        let sums = |field: &Field| {
            let mut sums = vec![0; n];
            field.fill(cells, &mut sums);
            sums
        };
        // Parts that cannot show are not made.
        let near = |of: &&Floating| of.reaches((2 * of.middle).clamp(low, high));
        let floating = self.floating.as_ref().filter(near).map(|of| (of, sums(&of.noise)));
        let ends = shared.iter().fold([i32::MAX, i32::MIN], |[a, b], &s| [a.min(s), b.max(s)]);
        let [lowest, highest] = [ends[0] - high * (ONE / 2), ends[1] - low * (ONE / 2)];
        let bend = self.bend.as_ref().filter(|_| highest >= -BEND && lowest <= BEND).map(sums);
        let under = highest + BEND > 0;
        let squares = self.caves_of(cells.level).filter(|_| under).map(|[a, b]| {
            let mut a = sums(a);
            a.iter_mut().for_each(|a| *a = square(*a));
            if a.iter().any(|&a| a <= TUNNEL) {
                a.iter_mut().zip(sums(b)).for_each(|(a, b)| *a += square(b));
            }
            a
        });
        let limits: Vec<i32> = match &floating {
            Some((of, _)) => ys.iter().map(|&y| if of.reaches(y) { of.limit(y) } else { i32::MAX / 2 }).collect(),
            None => Vec::new(),
        };
        for (i, (column, &surface)) in values.chunks_exact_mut(ny).zip(shared).enumerate() {
            let own = i * ny..(i + 1) * ny;
            column.iter_mut().zip(&ys).for_each(|(value, y)| *value = surface - y * (ONE / 2));
            let none = [0; Cells::MOST];
            let bend = match &bend {
                Some(bend) => {
                    column.iter_mut().zip(&bend[own.clone()]).for_each(|(value, &bend)| *value = bent(*value, bend));
                    &bend[own.clone()]
                }
                None => &none[..ny],
            };
            if let Some(squares) = &squares {
                let parts = squares[own.clone()].iter().zip(bend);
                column.iter_mut().zip(parts).for_each(|(value, (&s, &bend))| *value = hollowed(*value, bend, s));
            }
            if let Some((_, noise)) = &floating {
                let above = noise[own.clone()].iter().zip(&limits);
                column.iter_mut().zip(above).for_each(|(value, (n, limit))| *value = added(*value, n - limit));
            }
            column.iter_mut().zip(&ys).for_each(|(value, y)| *value = (*value).max((FLOOR * 2 - y) * (ONE / 2)));
        }
    }

    fn color_mode(&self) -> ColorMode {
        ColorMode::Voxel
    }

    fn color(&self, spot: &Spot) -> Rgb {
        const EARTH: Rgb = [118, 86, 58];
        const ROCK: Rgb = [128, 122, 116];
        const WARM: Rgb = [154, 128, 102];
        let [x, y, z] = spot.at;
        let height = (y / 2) as i32;
        let grain = if spot.level == 0 { (hash(self.seed, x, y, z) >> 28) as i32 - 8 } else { 0 };
        if let Some(of) = &self.floating
            && height > of.middle - (1 << of.shift)
        {
            let skin = if spot.depth < 2 && of.color[2] < 200 { [104, 138, 66] } else { of.color };
            return shade(skin, grain);
        }
        let strata = mix(ROCK, WARM, (hash(11, 0, y / 2 / 5, 0) >> 24) as i32);
        let color = match spot.depth {
            0..2 if !spot.steep => land(height, 0, 0),
            2..5 if !spot.steep => EARTH,
            _ if spot.level > 2 && spot.depth == 0 => land(height, if spot.steep { 2 } else { 0 }, 0),
            _ => strata,
        };
        shade(color, grain)
    }

    fn start(&self) -> [u32; 3] {
        let middle = SIDE / 2;
        let top = |z: u32| (self.surface(self.ground.at2([2 * middle + 1, 2 * z + 1], 0)) >> 12) as u32;
        let highest = (0..=8).map(|i| top(middle - 32 * i)).max().unwrap_or(0);
        let bend = if self.bend.is_some() { (BEND >> 12) as u32 / 2 } else { 0 };
        [middle, highest + bend + 24, middle]
    }
}

fn square(v: i32) -> i32 {
    (v * v) >> 12
}
