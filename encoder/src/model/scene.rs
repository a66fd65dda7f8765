//! A world in memory, with all its levels.

use std::sync::Arc;

use crate::Columns;
use crate::model::matter::{Classes, Matter};

/// sRGB, 8 bits a channel.
pub type Rgb = [u8; 3];

/// What the geometry runs of a scene hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// Whole solid intervals (culls best).
    Solid,
    /// Only voxels with an exposed face; a bit a gap tells solid interior from air.
    Surface,
}

/// How finely a scene is coloured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ColorMode {
    /// Geometry alone.
    None,
    /// One colour a run of the encoded geometry.
    Run,
    /// One colour a voxel with an exposed face.
    Voxel,
}

/// When a voxel of a level is solid, given its up to eight children.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MipRule {
    /// Any child is solid: nothing vanishes, thin things thicken.
    Any,
    /// At least half of its eight children are solid (children outside the world count as air): volume is kept,
    /// thin things vanish.
    Majority,
}

/// One level of a scene. A voxel of level `k` is `2^k` voxels of level 0 wide in x, y and z.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Every solid voxel, whatever the encoding.
    pub solid: Columns,
    /// Every voxel with an exposed face (a face towards air or towards the outside of the world), as runs.
    /// Present where the encoding is [`Encoding::Surface`] or colours are [`ColorMode::Voxel`].
    pub exposed: Option<Columns>,
    /// Colours: none; one a run of the geometry, in its order; or one an exposed voxel, in the order of
    /// `exposed` (column by column, ascending).
    pub colors: Vec<Rgb>,
    /// Translucent matter beside what is solid; `None` where the level has none.
    pub matter: Option<Arc<Matter>>,
}

impl Level {
    /// The runs that the encoding keeps.
    pub fn geometry(&self, encoding: Encoding) -> &Columns {
        match encoding {
            Encoding::Solid => &self.solid,
            Encoding::Surface => self.exposed.as_ref().expect("a surface scene has exposed runs"),
        }
    }
}

/// A world with its levels, level 0 first, each half of the one before (rounded up), down to one column.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    pub encoding: Encoding,
    pub color: ColorMode,
    pub mip_rule: MipRule,
    pub levels: Vec<Level>,
    /// The classes of translucent matter, where levels have any.
    pub classes: Option<Arc<Classes>>,
}

impl Scene {
    /// `[nx, ny, nz]` of level 0.
    pub fn dims(&self) -> [u32; 3] {
        self.levels[0].solid.dims()
    }

    /// The same with the matter of level 0, of these classes, where nothing is solid; coarser levels are made of it.
    pub fn with_matter(mut self, matter: Matter, classes: Arc<Classes>) -> Scene {
        let mut matter = matter.without(&self.levels[0].solid);
        for level in &mut self.levels {
            let next = matter.next(&classes);
            level.matter = Some(Arc::new(std::mem::replace(&mut matter, next)));
        }
        Scene { classes: Some(classes), ..self }
    }
}
