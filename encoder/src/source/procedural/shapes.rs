//! An artificial scene of many coloured shapes on a floor: spheres, tori, arches, pillars, cones, lattices, shells.

use super::noise::{hash, sub_seed, unit};
use super::{push_solid, shade};
use crate::{Colors, Columns, Input, Result, Rgb, Run};

/// Columns along a side of a cell of the index from columns to shapes.
const CELL: u32 = 32;

#[derive(Clone, Copy)]
enum Form {
    Sphere,
    /// A hollow ball with holes along the axes.
    Shell,
    /// Lying: the axis points up.
    Torus,
    /// Standing: the axis points along z.
    Ring,
    /// Half a ring on two legs.
    Arch,
    /// A shaft with a wider foot and head.
    Pillar,
    Cone,
    /// Beams of a cubic grid.
    Lattice,
    /// Steps around a shaft.
    Stair,
}

const FORMS: [Form; 9] = [
    Form::Sphere,
    Form::Shell,
    Form::Torus,
    Form::Ring,
    Form::Arch,
    Form::Pillar,
    Form::Cone,
    Form::Lattice,
    Form::Stair,
];

#[derive(Clone, Copy)]
struct Shape {
    form: Form,
    /// Middle, in voxels.
    at: [f32; 3],
    /// The shape lies within this of its middle on each axis.
    radius: f32,
    color: Rgb,
}

impl Shape {
    /// Whether voxel (x, y, z), by its centre, belongs to the shape.
    fn holds(&self, x: u32, y: u32, z: u32) -> bool {
        let r = self.radius;
        let [dx, dy, dz] = [(x, 0), (y, 1), (z, 2)].map(|(v, i)| (v as f32 + 0.5 - self.at[i]) / r);
        let flat = dx * dx + dz * dz;
        let round = flat + dy * dy;
        // Squares only: (√a − R)² + b < s² without the root where possible, with it where not; a root is exact.
        let torus = |a: f32, b: f32| {
            let d = a.sqrt() - 0.72;
            d * d + b * b < 0.075
        };
        if dx.abs() > 1.0 || dy.abs() > 1.0 || dz.abs() > 1.0 {
            return false;
        }
        match self.form {
            Form::Sphere => round < 1.0,
            Form::Shell => {
                let hole = 0.16;
                round < 1.0 && round > 0.74 && flat > hole && dx * dx + dy * dy > hole && dy * dy + dz * dz > hole
            }
            Form::Torus => torus(flat, dy),
            Form::Ring => torus(dx * dx + dy * dy, dz),
            Form::Arch if dy > 0.0 => torus(dx * dx + dy * dy, dz),
            Form::Arch => (dx.abs() - 0.72).abs() < 0.27 && dz.abs() < 0.27,
            Form::Pillar => {
                let end = dy.abs();
                let wide = if end > 0.9 {
                    0.36
                } else if end > 0.82 {
                    0.30
                } else {
                    0.22
                };
                flat < wide * wide && (end > 0.82 || (dx * dz).abs() > 0.002 || flat < 0.035)
            }
            Form::Cone => {
                let wide = 0.5 * (1.0 - dy);
                flat < wide * wide * 0.7
            }
            Form::Lattice => {
                let on_beam = |v: f32| {
                    let f = (v + 1.0) * 2.5;
                    let f = f - (f as u32) as f32;
                    u32::from(!(0.22..0.78).contains(&f))
                };
                on_beam(dx) + on_beam(dy) + on_beam(dz) >= 2
            }
            Form::Stair => {
                // Eight steps a turn: which eighth of the circle by signs and by the larger side.
                let eighth = match (dx >= 0.0, dz >= 0.0, dx.abs() > dz.abs()) {
                    (true, true, true) => 0,
                    (true, true, false) => 1,
                    (false, true, false) => 2,
                    (false, true, true) => 3,
                    (false, false, true) => 4,
                    (false, false, false) => 5,
                    (true, false, false) => 6,
                    (true, false, true) => 7,
                };
                let step = ((dy + 1.0) * 8.0) as u32;
                flat < 0.03 || (flat < 0.55 && step % 8 == eighth)
            }
        }
    }

    /// Voxels along an axis that the shape can reach, within `0 .. n`.
    fn extent(&self, axis: usize, n: u32) -> std::ops::Range<u32> {
        let low = (self.at[axis] - self.radius - 1.0).max(0.0) as u32;
        let high = ((self.at[axis] + self.radius + 2.0).max(0.0) as u32).min(n);
        low.min(high)..high
    }
}

/// Shapes, by the cells of columns they reach.
struct Index {
    cells: u32,
    lists: Vec<Vec<Shape>>,
}

impl Index {
    fn over(&self, x: u32, z: u32) -> &[Shape] {
        &self.lists[(z / CELL * self.cells + x / CELL) as usize]
    }
}

pub fn make(size: u32, seed: u64) -> Result<Input> {
    let seed = sub_seed(seed, 0);
    let side = size as f32;
    let floor = (size / 64).max(1);
    // Places on a jittered grid, smaller shapes in between and above.
    let across = (size / 48).clamp(1, 10);
    let mut shapes = Vec::new();
    for i in 0..across * across * 3 {
        let number = |k: u32| unit(hash(seed, i, k, 1));
        let (column, layer) = (i % (across * across), i / (across * across));
        let pitch = side / across as f32;
        let radius = pitch * (0.22 + 0.26 * number(0)) * if layer == 0 { 1.0 } else { 0.8 };
        let place = |cell: u32, k: u32| (cell as f32 + 0.5) * pitch + (number(k) - 0.5) * (pitch - 1.6 * radius);
        let y = match layer {
            0 => floor as f32 + radius * 0.96,
            _ => floor as f32 + radius + (side * 0.85 - 2.0 * radius).max(0.0) * number(3) * number(4),
        };
        let form = FORMS[(hash(seed, i, 5, 1) % FORMS.len() as u32) as usize];
        let color = [6, 7, 8].map(|k| (60.0 + 195.0 * number(k)) as u8);
        shapes.push(Shape { form, at: [place(column % across, 1), y, place(column / across, 2)], radius, color });
    }

    let cells = size.div_ceil(CELL);
    let mut lists = vec![Vec::new(); (cells * cells) as usize];
    for shape in &shapes {
        let (xs, zs) = (shape.extent(0, size), shape.extent(2, size));
        if xs.is_empty() || zs.is_empty() {
            continue;
        }
        for cz in zs.start / CELL..=(zs.end - 1) / CELL {
            for cx in xs.start / CELL..=(xs.end - 1) / CELL {
                lists[(cz * cells + cx) as usize].push(*shape);
            }
        }
    }
    let index = Index { cells, lists };

    let columns = Columns::try_from_rows([size; 3], |z, columns| {
        let mut solid = vec![false; size as usize];
        for x in 0..size {
            let mut high = floor;
            for shape in index.over(x, z) {
                if !shape.extent(0, size).contains(&x) || !shape.extent(2, size).contains(&z) {
                    continue;
                }
                let ys = shape.extent(1, size);
                high = high.max(ys.end);
                for y in ys {
                    solid[y as usize] |= shape.holds(x, y, z);
                }
            }
            columns.push_run(Run::new(0, (floor - 1) as u16));
            push_solid(columns, floor..high, |y| std::mem::take(&mut solid[y as usize]));
            solid[..floor as usize].fill(false);
            columns.end_column();
        }
        Ok(())
    })?;
    let color = move |x: u32, y: u32, z: u32| {
        if y < floor {
            let tile = (x / 16 + z / 16) % 2;
            return if tile == 0 { [176, 172, 164] } else { [112, 112, 118] };
        }
        let owner = index.over(x, z).iter().find(|s| s.holds(x, y, z));
        owner.map_or([200; 3], |s| shade(s.color, (hash(seed, x, y, z) >> 29) as i32 * 3 - 10))
    };
    Ok(Input { columns, colors: Colors::Function(Box::new(color)), notes: Vec::new() })
}
