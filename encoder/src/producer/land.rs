//! Land with what a height map cannot hold: overhangs, caves, things that float.

use super::hills::{land, mix, shade};
use super::noise::{ONE, hash};
use super::octaves::Octaves;
use super::{Area, Cells, Density, Interval, Part, SIDE, Spot};
use crate::{ColorMode, Rgb};

/// Voxels that are solid at the bottom, whatever else.
const FLOOR: i32 = 4;

/// Things that float: solid where noise is above a threshold, which grows away from a height.
struct Floating {
    noise: Octaves,
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
    bend: Option<Octaves>,
    bend_most: i32,
    /// In 4,096ths: tunnels are where both are near 0.
    caves: Option<[Octaves; 2]>,
    floating: Option<Floating>,
}

/// Squares of both caves' noise together where a tunnel ends, in 4,096ths.
const TUNNEL: i32 = 40;

impl Land {
    fn seeds(seed: u32) -> impl Fn(u32) -> u32 {
        move |i| hash(seed, i, 0, 7)
    }

    /// Rugged, with overhangs, tunnels and a few floating rocks.
    pub fn terrain(seed: u32) -> Land {
        let of = Land::seeds(seed);
        let bend = Octaves::new(of(2), 3, 7, 3, 36 << 4, 120);
        Land {
            seed,
            high: 512,
            base: 150,
            ground: Octaves::new(of(1), 2, 10, 2, 220 << 4, 120),
            bend_most: bend.most(),
            bend: Some(bend),
            caves: Some([3, 4].map(|i| Octaves::new(of(i), 3, 6, 5, 16, 100))),
            floating: Some(Floating {
                noise: Octaves::new(of(5), 3, 7, 4, 16, 120),
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
            bend_most: 0,
            caves: None,
            floating: Some(Floating {
                noise: Octaves::new(of(2), 3, 7, 2, 16, 115),
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
            bend_most: 0,
            caves: None,
            floating: Some(Floating {
                noise: Octaves::new(of(2), 3, 8, 2, 16, 128),
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
        let mut value = surface - y * (ONE / 2);
        if value.abs() <= self.bend_most {
            value += bend;
        }
        if value > 0 && squares.is_some_and(|squares| squares <= TUNNEL) {
            value = (squares.unwrap_or(TUNNEL) - TUNNEL) * 64;
        }
        if let Some(of) = &self.floating
            && floating > of.limit(y)
        {
            value = value.max((floating - of.limit(y)) * 64);
        }
        value.max((FLOOR * 2 - y) * (ONE / 2))
    }

    /// Whether a level shows tunnels at all: some ten voxels wide, they vanish where voxels are half as wide.
    fn caves_of(&self, level: u32) -> Option<&[Octaves; 2]> {
        self.caves.as_ref().filter(|_| level <= 2)
    }

    fn bounded(&self, surface: Interval, y: [u32; 2], part: &Part, caves: bool) -> Interval {
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
            let float = |floating: i32, y: i32| self.floating.as_ref().map_or(0, |of| (floating - of.limit(y)) * 64);
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
        let bend = far(self.bend.as_ref().map_or(0, Octaves::most));
        let floating = far(self.floating.as_ref().map_or(0, |of| of.noise.most()));
        let first = over(bend, any, floating);
        if first.least > 0 || first.most <= 0 {
            return first;
        }
        let bend = self.bend.as_ref().map_or(bend, |of| of.bounds(part));
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
    /// The threshold at a height in half voxels.
    #[inline(always)]
    fn limit(&self, y: i32) -> i32 {
        let away = ((y - 2 * self.middle).abs().min(16 << self.shift) << 11) >> self.shift;
        self.threshold + ((away * away >> 12) * (self.growth >> 4) >> 8)
    }
}

impl Density for Land {
    fn height(&self) -> u32 {
        self.high
    }

    fn value(&self, p: [u32; 3], level: u32) -> i32 {
        let of = |octaves: &Option<Octaves>| octaves.as_ref().map_or(0, |o| o.at3(p, level));
        let squares = self.caves_of(level).map(|caves| caves.iter().map(|o| square(o.at3(p, level))).sum());
        let floating = self.floating.as_ref().map_or(0, |of| of.noise.at3(p, level));
        let surface = self.surface(self.ground.at2([p[0], p[2]], level));
        self.combined(p[1].min(1 << 17) as i32, surface, of(&self.bend), squares, floating)
    }

    fn bounds(&self, part: &Part) -> Interval {
        let Interval { least, most } = self.ground.bounds(part);
        let surface = Interval { least: self.surface(least), most: self.surface(most) };
        self.bounded(surface, [part.from[1], part.to[1]], part, self.caves.is_some())
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
        let part = Part { from: [0, 1, 2].map(|axis| cells.middle(axis, 0)), to: [end(0), end(1), end(2)] };
        self.bounded(surface, [part.from[1], part.to[1]], &part, self.caves_of(cells.level).is_some())
    }

    fn fill(&self, shared: &[i32], cells: &Cells, values: &mut [i32]) {
        let n = values.len();
        let ny = cells.size[1] as usize;
        let ys: Vec<i32> = (0..cells.size[1]).map(|y| cells.middle(1, y).min(1 << 17) as i32).collect();
        let (low, high) = (ys[0], ys[ny - 1]);
        let sums = |octaves: &Octaves| {
            let mut sums = vec![0; n];
            octaves.fill(cells, &mut sums);
            sums
        };
        // Parts that cannot show are not made.
        let near = |of: &Floating| {
            let nearest = (2 * of.middle).clamp(low, high);
            of.noise.most() > of.limit(nearest)
        };
        let floating = self.floating.as_ref().filter(|of| near(of)).map(|of| sums(&of.noise));
        let highest = shared.iter().copied().max().unwrap_or(0);
        let lowest = shared.iter().copied().min().unwrap_or(0);
        let nearest = [highest - low * (ONE / 2), lowest - high * (ONE / 2)];
        let bends = nearest[0] >= -self.bend_most && nearest[1] <= self.bend_most;
        let bend = self.bend.as_ref().filter(|_| bends).map(sums);
        let under = nearest[0] + self.bend_most > 0;
        let squares = self.caves_of(cells.level).filter(|_| under).map(|[a, b]| {
            let mut a = sums(a);
            a.iter_mut().for_each(|a| *a = square(*a));
            if a.iter().any(|&a| a <= TUNNEL) {
                a.iter_mut().zip(sums(b)).for_each(|(a, b)| *a += square(b));
            }
            a
        });
        for (column, &surface) in shared.iter().enumerate() {
            for (y, &at) in ys.iter().enumerate() {
                let i = column * ny + y;
                let of = |sums: &Option<Vec<i32>>| sums.as_ref().map_or(0, |s| s[i]);
                let floating = floating.as_ref().map_or(-(1 << 23), |s| s[i]);
                values[i] = self.combined(at, surface, of(&bend), squares.as_ref().map(|s| s[i]), floating);
            }
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
        let bend = self.bend.as_ref().map_or(0, |of| (of.most() >> 12) as u32 / 2);
        [middle, highest + bend + 24, middle]
    }
}

fn square(v: i32) -> i32 {
    v * v >> 12
}
