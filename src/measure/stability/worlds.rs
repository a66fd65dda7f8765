//! The worlds that the catalogue stands in: small, made on the spot.

use crate::world::tables::Resident;
use planecast_encoder::source::procedural::{Kind, procedural};
use planecast_encoder::{BuildOptions, Colors, Columns, Input, Scene, build};
use std::sync::Arc;

/// A world of the catalogue by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum WorldName {
    /// Hills under floating rocks, 64³.
    Rocks,
    /// A mixing layer: many runs a column, 64³.
    Mixing,
    /// Closed on all six sides, walls one voxel thick, pillars and a beam in it.
    Room,
    /// Closed on all six sides, walls one voxel thick, so large that they stand where levels change.
    Hall,
    /// Solid up to height 4.
    Floor,
    /// A floor with one pole in 512 × 512 columns.
    Pole,
    /// A full column of 65,536 voxels and one of 32,768 runs.
    Tower,
    /// Columns that end at the top of a world 256 high.
    Top,
    /// 2²⁴ columns long, two wide: slabs, every fourth one higher.
    Plank,
    /// No two voxels share a face.
    Checkerboard,
    /// One voxel in 300.
    Dust,
    SingleVoxel,
    Empty,
    Full,
    /// Sheets one voxel thick, across each axis.
    Sheets,
    Stairs,
    /// Columns one voxel wide.
    Poles,
    /// A fence one voxel thick, 2,048 long.
    Fence,
    /// A block in the air over a floor, on even places.
    Block,
}

/// A scene and its tables.
pub struct World {
    pub name: WorldName,
    pub scene: Arc<Scene>,
    pub resident: Arc<Resident>,
}

impl WorldName {
    /// `[nx, ny, nz]`.
    pub fn dims(self) -> [u32; 3] {
        match self {
            WorldName::Rocks | WorldName::Mixing | WorldName::Stairs | WorldName::Poles => [64; 3],
            WorldName::Room => [28, 18, 22],
            WorldName::Hall => [192, 96, 192],
            WorldName::Floor => [32, 8, 32],
            WorldName::Pole => [512, 16, 512],
            WorldName::Tower => [4, 65_536, 4],
            WorldName::Top => [32, 256, 32],
            WorldName::Plank => [1 << 24, 8, 2],
            WorldName::Checkerboard => [32, 16, 32],
            WorldName::Dust | WorldName::Sheets => [64, 48, 64],
            WorldName::SingleVoxel => [33, 17, 41],
            WorldName::Empty | WorldName::Full => [24, 20, 40],
            WorldName::Fence => [64, 32, 2048],
            WorldName::Block => [24, 20, 24],
        }
    }

    /// Makes the world. (Panics if a world of this catalogue cannot be made, which is a fault of the program.)
    pub fn make(self) -> World {
        let [nx, ny, nz] = self.dims();
        let shell = move |x: u32, y: u32, z: u32| [x, y, z].contains(&0) || x == nx - 1 || y == ny - 1 || z == nz - 1;
        type Solid = Box<dyn Fn(u32, u32, u32) -> bool + Sync>;
        let solid: Solid = match self {
            WorldName::Rocks => return self.of(procedural(Kind::Rocks, nx, 7).expect("a size that it has")),
            WorldName::Mixing => return self.of(procedural(Kind::Mixing, nx, 7).expect("a size that it has")),
            WorldName::Room => {
                Box::new(move |x, y, z| shell(x, y, z) || (x % 9 == 5 && z % 7 == 4) || (y == 12 && z == 10))
            }
            WorldName::Hall => Box::new(shell),
            WorldName::Floor => Box::new(|_, y, _| y < 4),
            WorldName::Pole => Box::new(|x, y, z| y == 0 || (x == 256 && z == 256)),
            WorldName::Tower => Box::new(|x, y, z| (x == 1 && z == 1) || (x == 2 && z == 1 && y % 2 == 0)),
            WorldName::Top => Box::new(|x, y, z| y < 8 || (x / 4 + z / 4) % 3 == 0),
            WorldName::Plank => Box::new(|x, y, _| y < 3 || (x % 4 == 3 && y < 6)),
            WorldName::Checkerboard => Box::new(|x, y, z| (x + y + z) % 2 == 0),
            WorldName::Dust => Box::new(|x, y, z| mix([x, y, z]).is_multiple_of(300)),
            WorldName::SingleVoxel => Box::new(|x, y, z| [x, y, z] == [16, 8, 20]),
            WorldName::Empty => Box::new(|_, _, _| false),
            WorldName::Full => Box::new(|_, _, _| true),
            WorldName::Sheets => Box::new(|x, y, z| {
                (z % 16 == 9 && y < 30 && x > 8) || (y % 12 == 5 && x < 40 && z > 20) || (x == 50 && y < 40 && z < 50)
            }),
            WorldName::Stairs => Box::new(|x, y, z| y <= x && (y + 6 >= x || z < 20)),
            WorldName::Poles => Box::new(|x, y, z| y == 0 || (x % 8 == 3 && z % 8 == 5 && y < 40 + x / 8)),
            WorldName::Fence => Box::new(|x, y, _| x == 40 && y < 24),
            WorldName::Block => {
                Box::new(|x, y, z| y == 0 || ((8..16).contains(&x) && (8..12).contains(&y) && (8..16).contains(&z)))
            }
        };
        let columns = Columns::from_fn(nx, ny, nz, solid);
        if self == WorldName::Plank {
            // Too many for colours.
            return self.of(Input { columns, colors: Colors::None, notes: Vec::new() });
        }
        let colors = Colors::Function(Box::new(|x, y, z| {
            let [r, g, b, _] = mix([x, y, z]).to_le_bytes();
            [r, g, b]
        }));
        self.of(Input { columns, colors, notes: Vec::new() })
    }

    fn of(self, input: Input) -> World {
        let scene = build(input, &BuildOptions::default()).expect("its size is within every limit");
        let resident = Arc::new(Resident::new(&scene));
        World { name: self, scene: Arc::new(scene), resident }
    }
}

/// A well-mixed word from a place (murmur3's finaliser over a linear mix).
fn mix([x, y, z]: [u32; 3]) -> u32 {
    let mut h = x.wrapping_mul(0x8DA6_B343) ^ y.wrapping_mul(0xD816_3841) ^ z.wrapping_mul(0xCB1A_B31F);
    h = (h ^ (h >> 16)).wrapping_mul(0x85EB_CA6B);
    h = (h ^ (h >> 13)).wrapping_mul(0xC2B2_AE35);
    h ^ (h >> 16)
}
