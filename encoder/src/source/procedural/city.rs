//! A city: streets between blocks of four houses with walls, floors, rooms, windows and flat or pitched roofs.

use super::noise::{hash, sub_seed, unit};
use super::{push_solid, shade};
use crate::{Colors, Columns, Input, Result, Rgb};

/// Columns a side of a block with its half of the streets around it, and of the lot of one house.
const BLOCK: u32 = 64;
const LOT: u32 = 27;
/// Half the width of a street, columns.
const STREET: u32 = (BLOCK - 2 * LOT) / 2;
const STOREY: u32 = 8;

/// What fills a voxel.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    Air,
    Road,
    Pavement,
    Wall,
    Floor,
    Roof,
    Furniture,
    Tree,
}

struct City {
    seed: u32,
    height: u32,
}

/// One house, and a column's place in its lot.
struct House {
    id: u32,
    /// From the nearest wall, columns, along x and z; 0 is the wall itself.
    inward: [u32; 2],
    at: [u32; 2],
    storeys: u32,
    pitched: bool,
}

impl City {
    /// The house over column (x, z), if one is there: streets and parks have none.
    fn house(&self, x: u32, z: u32) -> Option<House> {
        let lot = |v: u32| {
            let v = v % BLOCK;
            (STREET..STREET + 2 * LOT).contains(&v).then(|| ((v - STREET) / LOT, (v - STREET) % LOT))
        };
        let ((lx, ax), (lz, az)) = (lot(x)?, lot(z)?);
        let id = hash(self.seed, x / BLOCK * 2 + lx, 1, z / BLOCK * 2 + lz);
        // A gap of a column between neighbours, a park in place of every eighth house.
        if ax == LOT - 1 || az == LOT - 1 || id.is_multiple_of(8) {
            return None;
        }
        let most = (self.height * 3 / 4 / STOREY).max(1);
        let tall = unit(hash(id, 2, 0, 0));
        let storeys = 1 + ((most - 1) as f32 * tall * tall * tall) as u32;
        let inward = [ax, az].map(|a| a.min(LOT - 2 - a));
        Some(House { id, inward, at: [ax, az], storeys, pitched: storeys <= 5 })
    }

    fn part(&self, house: Option<&House>, x: u32, y: u32, z: u32) -> Part {
        let Some(house) = house else {
            let street = |v: u32| !(STREET..BLOCK - STREET).contains(&(v % BLOCK));
            let road = street(x) || street(z);
            return match y {
                0 => Part::Road,
                1 if !road => Part::Pavement,
                // Trees in parks and gaps: a stem and a round crown over a cell's middle.
                2..=14 if !road => {
                    let (dx, dz) = ((x % 9) as i32 - 4, (z % 9) as i32 - 4);
                    let flat = dx * dx + dz * dz;
                    let dy = y as i32 - 10;
                    let planted = hash(self.seed, x / 9, 3, z / 9).is_multiple_of(3);
                    let crown = flat + dy * dy < 16 && !hash(self.seed, x, y, z).is_multiple_of(4);
                    if planted && (crown || (flat == 0 && y < 10)) { Part::Tree } else { Part::Air }
                }
                _ => Part::Air,
            };
        };
        if y < 2 {
            return Part::Pavement;
        }
        let top = 2 + house.storeys * STOREY;
        let edge = house.inward[0].min(house.inward[1]);
        if y >= top {
            if house.pitched {
                // Rising from two sides, hollow.
                let rise = y - top;
                let way = (house.id >> 8 & 1) as usize;
                let (on, along) = (house.inward[way], house.inward[1 - way]);
                return match rise {
                    _ if rise == on || rise == on + 1 => Part::Roof,
                    // Gables.
                    _ if rise < on && along == 0 => Part::Wall,
                    _ => Part::Air,
                };
            }
            // A parapet and, on some, a water tank.
            let tank = house.id & 0x300 == 0 && edge > 8 && y < top + 6;
            return if (edge == 0 && y < top + 2) || y == top || tank { Part::Roof } else { Part::Air };
        }
        let (storey, up) = ((y - 2) / STOREY, (y - 2) % STOREY);
        let [ax, az] = house.at;
        if up == 0 {
            // Stairwells pass through all floors.
            return if storey > 0 && (4..8).contains(&ax) && (4..10).contains(&az) { Part::Air } else { Part::Floor };
        }
        let opening = |along: u32| match (storey, up) {
            (0, 1..=5) => (12..15).contains(&along),
            (_, 3..=5) => along % 6 >= 2 && along % 6 < 5,
            _ => false,
        };
        if edge == 0 {
            let along = if house.inward[0] == 0 { az } else { ax };
            return if opening(along) { Part::Air } else { Part::Wall };
        }
        // Rooms: a cross of inner walls with doors.
        if ax == 13 || az == 13 {
            let along = if ax == 13 { az } else { ax };
            return if up <= 5 && along % 13 >= 5 && along % 13 < 8 { Part::Air } else { Part::Wall };
        }
        let piece = hash(house.id, ax / 4, storey, az / 4);
        if up <= 1 + piece % 3 && piece & 0x70 == 0 && ax % 4 != 0 && az % 4 != 0 {
            return Part::Furniture;
        }
        Part::Air
    }
}

pub fn make(size: u32, seed: u64) -> Result<Input> {
    let height = (size / 4).max(32);
    let city = City { seed: sub_seed(seed, 0), height };
    let painted = City { ..city };
    let columns = Columns::try_from_rows([size, height, size], |z, columns| {
        for x in 0..size {
            let house = city.house(x, z);
            let top = house.as_ref().map_or(16, |h| 2 + h.storeys * STOREY + LOT / 2 + 3).min(height);
            push_solid(columns, 0..top, |y| city.part(house.as_ref(), x, y, z) != Part::Air);
            columns.end_column();
        }
        Ok(())
    })?;
    let color = move |x: u32, y: u32, z: u32| {
        let house = painted.house(x, z);
        let tone = house.as_ref().map_or(0, |h| h.id);
        const WALLS: [Rgb; 6] =
            [[196, 178, 150], [168, 98, 76], [206, 204, 196], [150, 152, 158], [214, 186, 128], [132, 110, 96]];
        const ROOFS: [Rgb; 3] = [[150, 64, 48], [92, 94, 104], [120, 84, 60]];
        let base = match painted.part(house.as_ref(), x, y, z) {
            Part::Road => [70, 70, 76],
            Part::Pavement | Part::Air => [140, 140, 136],
            Part::Wall => WALLS[(tone >> 4) as usize % WALLS.len()],
            Part::Floor => [160, 130, 96],
            Part::Roof => ROOFS[(tone >> 12) as usize % ROOFS.len()],
            Part::Furniture => [110, 76, 50],
            Part::Tree => [70, 120, 52],
        };
        shade(base, (hash(tone, x, y, z) >> 28) as i32 - 8)
    };
    Ok(Input { columns, colors: Colors::Function(Box::new(color)), notes: Vec::new() })
}
