//! What an input is and how its reader understood it: `encode` says it in a line or two, a scene keeps it, `info` shows it.

use std::fmt;
use std::sync::Arc;

use crate::model::matter::Classes;

/// Kinds of things that inputs are pictures of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A grid of heights.
    Terrain,
    /// A grid of values, solid from a threshold on.
    Volume,
    /// A grid of labels, each a thing of its own.
    Labels,
    /// Surfaces, voxelised.
    Mesh,
    /// A cloud of points.
    Points,
    /// Voxels that somebody drew.
    Model,
    /// A seeded function.
    Procedural,
}

/// What an input is. Empty text: nothing is known of it, or it goes without saying.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct About {
    pub kind: Option<Kind>,
    /// The input's name, without its folder or host.
    pub source: String,
    /// Name of the format, as its own text has it: "GeoTIFF", "NIfTI-2".
    pub format: String,
    /// How the axes of the source became x, y (up) and z of the world.
    pub axes: String,
    /// Sides of a voxel of level 0 along x, y, z, in `unit`.
    pub voxel: Option<[f64; 3]>,
    /// "m", "mm", "µm", "ft", …
    pub unit: String,
    /// Coordinate reference system, as "EPSG:32617" or WKT.
    pub crs: String,
    /// Rows of the affine map that takes a place in the world (x, y, z, 1), in voxels of level 0, to coordinates of the source:
    /// east, north, up for terrains and points.
    pub affine: Option<[[f64; 4]; 3]>,
    /// Least and greatest value, as the data mean them.
    pub values: Option<[f64; 2]>,
    /// What made voxels solid: "values of at least 87 (Otsu)".
    pub rule: String,
    /// What the file holds and the world does not, and flags that were of no use: each a phrase.
    pub left_out: Vec<String>,
    /// Of a height field, how far the surface that it stands for is above each column's top, in 256ths of a voxel, 128 more, by
    /// rows of x; empty where that is not known.
    #[serde(skip)]
    pub fractions: Arc<[u8]>,
    /// The classes of the scene's translucent matter, where it has any.
    #[serde(skip)]
    pub classes: Option<Arc<Classes>>,
}

impl About {
    /// Of a reader that says this much.
    pub fn new(kind: Kind, format: impl Into<String>) -> About {
        About { kind: Some(kind), format: format.into(), ..About::default() }
    }

    /// Whether what this is of may be a height field. What does not say what it is may be: its tiles show otherwise.
    pub(crate) fn may_be_height_field(&self) -> bool {
        matches!(self.kind, None | Some(Kind::Terrain | Kind::Procedural))
    }

    /// Takes out what would not show as text: who made the file may have put commands for terminals there.
    pub(crate) fn clean(&mut self) {
        let About {
            kind: _,
            source,
            format,
            axes,
            voxel: _,
            unit,
            crs,
            affine: _,
            values: _,
            rule,
            left_out,
            fractions: _,
            classes: _,
        } = self;
        let texts = [source, format, axes, unit, crs, rule].into_iter().chain(left_out);
        texts.for_each(|text| text.retain(|c| !c.is_control()));
    }
}

impl Kind {
    pub fn name(self) -> &'static str {
        match self {
            Kind::Terrain => "terrain",
            Kind::Volume => "volume",
            Kind::Labels => "labels",
            Kind::Mesh => "mesh",
            Kind::Points => "points",
            Kind::Model => "model",
            Kind::Procedural => "procedural",
        }
    }
}

/// One line, and a second one where something was left out.
impl fmt::Display for About {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "read as {}", self.format)?;
        if let Some(kind) = self.kind {
            write!(f, " ({})", kind.name())?;
        }
        let mut parts: Vec<String> = Vec::new();
        parts.extend([&self.axes].into_iter().filter(|s| !s.is_empty()).cloned());
        if let Some([x, y, z]) = self.voxel {
            let unit = match self.unit.as_str() {
                "" if x == y && y == z && x == 1.0 => "unit",
                "" => "units",
                unit => unit,
            };
            parts.push(match x == y && y == z {
                true => format!("a voxel is {} {unit} wide", Short(x)),
                false => format!("a voxel is {} × {} × {} {unit}", Short(x), Short(y), Short(z)),
            });
        }
        if let Some([low, high]) = self.values {
            parts.push(format!("values {} to {}", Short(low), Short(high)));
        }
        parts.extend([&self.rule, &self.crs].into_iter().filter(|s| !s.is_empty()).cloned());
        if !parts.is_empty() {
            write!(f, ": {}", parts.join("; "))?;
        }
        if !self.left_out.is_empty() {
            write!(f, "\nleft out: {}", self.left_out.join("; "))?;
        }
        Ok(())
    }
}

/// A number in at most seven digits.
pub(crate) struct Short(pub f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Short(v) = *self;
        if v != 0.0 && !(1e-4..1e9).contains(&v.abs()) {
            return write!(f, "{v:.3e}");
        }
        let whole = if v == 0.0 { 1.0 } else { v.abs().log10().floor() + 1.0 };
        let text = format!("{v:.*}", (6.0 - whole).max(0.0) as usize);
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        f.write_str(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_says_how_a_file_was_read_and_a_second_what_was_left_out() {
        let mut about = About {
            axes: "columns are x, rows are z".to_owned(),
            voxel: Some([30.0, 30.0, 30.0]),
            unit: "m".to_owned(),
            values: Some([236.0, 1076.25]),
            crs: "EPSG:32617".to_owned(),
            ..About::new(Kind::Terrain, "GeoTIFF")
        };
        let line = "read as GeoTIFF (terrain): columns are x, rows are z; a voxel is 30 m wide; values 236 to 1076.25; EPSG:32617";
        assert_eq!(about.to_string(), line);
        about.left_out = vec!["2 overviews".to_owned(), "--up".to_owned()];
        assert_eq!(about.to_string(), format!("{line}\nleft out: 2 overviews; --up"));
        about = About { voxel: Some([0.5, 0.5, 5.0]), ..About::new(Kind::Volume, "OME-Zarr 0.4") };
        assert_eq!(about.to_string(), "read as OME-Zarr 0.4 (volume): a voxel is 0.5 × 0.5 × 5 units");
        assert_eq!(Short(1.0 / 3.0).to_string(), "0.333333");
        assert_eq!(Short(-123_456.7).to_string(), "-123457");
        assert_eq!(Short(0.0).to_string(), "0");
        assert_eq!(Short(2.5e-7).to_string(), "2.500e-7");
    }
}
