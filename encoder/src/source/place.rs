//! Where a volume lies: how far its voxels are apart, where its axes point, and which axis of the world each becomes.

use super::Spacing;

/// Spacings further apart than this are taken for a slip of who wrote them.
const MOST_UNEQUAL: f64 = 1000.0;

/// Cubes are this many times as many as the file's voxels at most.
const MOST_CUBES: f64 = 64.0;

/// Where a volume lies.
#[derive(Clone, Debug)]
pub(super) struct Place {
    /// From one voxel to the next along each axis of the file, in coordinates of the source.
    pub steps: [[f64; 3]; 3],
    /// Centre of the first voxel.
    pub origin: [f64; 3],
    /// Whether the coordinates are a patient's: right, anterior, superior.
    pub anatomy: bool,
    /// What of the file states it, as in "sform"; empty where only spacing is stated.
    pub stated: &'static str,
}

/// A length by its name: in metres, and as it is said.
pub(super) fn length_unit(name: &str) -> Option<(f64, &'static str)> {
    Some(match name {
        "Å" | "\u{212b}" | "angstrom" => (1e-10, "Å"),
        "pm" | "picometer" | "picometre" => (1e-12, "pm"),
        "nm" | "nanometer" | "nanometre" => (1e-9, "nm"),
        "µm" | "\u{3bc}m" | "um" | "micrometer" | "micrometre" | "micron" | "microns" => (1e-6, "µm"),
        "mm" | "millimeter" | "millimetre" => (1e-3, "mm"),
        "cm" | "centimeter" | "centimetre" => (1e-2, "cm"),
        "m" | "meter" | "metre" | "meters" | "metres" => (1.0, "m"),
        "km" | "kilometer" | "kilometre" => (1e3, "km"),
        "in" | "inch" => (0.0254, "in"),
        "ft" | "foot" => (0.3048, "ft"),
        _ => return None,
    })
}

/// Distances with a unit each in the unit of the first; None where units differ that are no known lengths.
pub(super) fn in_one_unit(steps: [(f64, &str); 3]) -> Option<([f64; 3], String)> {
    let (_, first) = steps[0];
    if steps.iter().all(|(_, unit)| *unit == first) {
        let name = length_unit(first).map_or(first, |(_, name)| name);
        return Some((steps.map(|(v, _)| v), name.to_owned()));
    }
    let (to, name) = length_unit(first)?;
    let mut out = [0.0; 3];
    for (out, (v, unit)) in out.iter_mut().zip(steps) {
        // Without the last digits of a quotient.
        *out = format!("{:.9e}", v * length_unit(unit)?.0 / to).parse().ok()?;
    }
    Some((out, name.to_owned()))
}

/// Axes of the file that became x, y (up), z of the world.
pub(super) struct Oriented {
    pub axes: [usize; 3],
    /// Whether the world's axis runs against the file's.
    pub flips: [bool; 3],
    /// How it is said.
    pub words: String,
}

impl Place {
    /// Voxels along the axes of the source.
    pub fn spaced(spacing: [f64; 3], origin: [f64; 3]) -> Place {
        let [x, y, z] = spacing;
        Place { steps: [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]], origin, anatomy: false, stated: "" }
    }

    /// The same, where it is one: every axis has a length and a direction of its own. Else what is wrong, as a phrase.
    pub fn checked(self) -> Result<Place, String> {
        let spacing = self.steps.map(length);
        let [a, b, c] = spacing;
        let normal = |s: f64| s.is_finite() && s > 0.0;
        if !spacing.iter().all(|&s| normal(s)) || !self.origin.iter().all(|v| v.is_finite()) {
            return Err(format!("the spacing that the file states, {a} × {b} × {c}: voxels are drawn as cubes"));
        }
        let (least, most) = (a.min(b).min(c), a.max(b).max(c));
        if most > MOST_UNEQUAL * least {
            return Err(format!(
                "the spacing that the file states, {a} × {b} × {c}, of which one is over {MOST_UNEQUAL} times another: voxels are drawn as cubes"
            ));
        }
        let [u, v, w] = self.directions();
        let volume = u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0])
            + u[2] * (v[0] * w[1] - v[1] * w[0]);
        if volume.abs() < 0.01 {
            return Err("the directions that the file states, which lie in one plane: axes are as stored".to_owned());
        }
        Ok(self)
    }

    /// Sides of a voxel along the axes of the file, in six digits: what was a float is meant so.
    pub fn spacing(&self) -> [f64; 3] {
        self.steps.map(|step| format!("{:.5e}", length(step)).parse().expect("a number that was just written"))
    }

    fn directions(&self) -> [[f64; 3]; 3] {
        self.steps.map(|step| step.map(|v| v / length(step)))
    }

    /// For each axis of the file the coordinate that it runs along, all different, nearest as a whole.
    fn along(&self) -> [usize; 3] {
        let dirs = self.directions();
        let ways = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let fit = |way: &[usize; 3]| -> f64 { (0..3).map(|f| dirs[f][way[f]].abs()).sum() };
        // The first of equals.
        ways.into_iter().rev().max_by(|a, b| fit(a).total_cmp(&fit(b))).expect("there are six")
    }

    /// The axes as the coordinates have them: x to the right, y to the head, z to the back of a patient; else x, y, z.
    pub fn orient(&self) -> Oriented {
        let (along, dirs) = (self.along(), self.directions());
        // World x, y, z as coordinates.
        let target = if self.anatomy { [(0, 1.0), (2, 1.0), (1, -1.0)] } else { [(0, 1.0), (1, 1.0), (2, 1.0)] };
        let axis = |c: usize| (0..3).find(|&f| along[f] == c).expect("one axis a coordinate");
        let axes = target.map(|(c, _)| axis(c));
        let flips = target.map(|(c, sign)| dirs[axis(c)][c] * sign < 0.0);
        let tilt = (0..3).map(|f| dirs[f][along[f]].abs().min(1.0).acos().to_degrees()).fold(0.0, f64::max);
        let mut words = if self.anatomy {
            format!(
                "x to the right, y to the head, z to the back, by the {} (stored as {})",
                self.stated,
                self.letters()
            )
        } else {
            let name = |k: usize| format!("{}{}", if flips[k] { "−" } else { "" }, ["x", "y", "z"][axes[k]]);
            match (axes, flips) {
                ([0, 1, 2], [false, false, false]) => "axes as stored".to_owned(),
                _ => {
                    format!("x, y, z are the file's axes {}, {}, {}, by its {}", name(0), name(1), name(2), self.stated)
                }
            }
        };
        if tilt >= 0.5 {
            words.push_str(&format!(", turned by up to {tilt:.0}° to the nearest axes"));
        }
        Oriented { axes, flips, words }
    }

    /// Where the axes of the file point to in a patient, as in "LAS".
    pub fn letters(&self) -> String {
        let (along, dirs) = (self.along(), self.directions());
        let letter = |f: usize| [['L', 'R'], ['P', 'A'], ['I', 'S']][along[f]][usize::from(dirs[f][along[f]] > 0.0)];
        (0..3).map(letter).collect()
    }

    /// Whether the axes as stored show a patient as in a mirror.
    pub fn mirrored(&self) -> bool {
        let [u, v, w] = self.steps;
        self.anatomy
            && u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0])
                + u[2] * (v[0] * w[1] - v[1] * w[0])
                < 0.0
    }
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// Voxels of the world along an axis of the file: `n`, each `step` of the `of` that the file has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Along {
    pub n: u64,
    of: u64,
    step: f64,
}

impl Along {
    pub fn as_stored(n: u64) -> Along {
        Along { n, of: n, step: 1.0 }
    }

    pub fn is_as_stored(&self) -> bool {
        self.step == 1.0 && self.n == self.of
    }

    /// The file's voxel that holds the centre of voxel `i`.
    pub fn nearest(&self, i: u64) -> u64 {
        (((i as f64 + 0.5) * self.step) as u64).min(self.of - 1)
    }

    /// The file's voxels on both sides of the centre of voxel `i`, and how much of the second it is.
    pub fn between(&self, i: u64) -> (u64, u64, f64) {
        let at = ((i as f64 + 0.5) * self.step - 0.5).clamp(0.0, (self.of - 1) as f64);
        let low = at as u64;
        (low, (low + 1).min(self.of - 1), at - low as f64)
    }

    /// What a voxel of the world measures in voxels of the file.
    pub fn step(&self) -> f64 {
        self.step
    }
}

/// Cubes that fill a volume of `dims` voxels that are `spacing` apart: as wide as the closest are apart, or somewhat wider
/// where those would be very many. Where as many cubes as voxels fill every axis, voxels are cubes already.
pub(super) fn cubes(dims: [u64; 3], spacing: [f64; 3]) -> [Along; 3] {
    let least = spacing.into_iter().fold(f64::INFINITY, f64::min);
    let more: f64 = spacing.iter().map(|s| s / least).product();
    let side = if more > MOST_CUBES { least * (more / MOST_CUBES).cbrt() } else { least };
    let along = |f: usize| {
        let n = (dims[f] as f64 * spacing[f] / side).round().max(1.0) as u64;
        Along { n, of: dims[f], step: side / spacing[f] }
    };
    let cubes = [0, 1, 2].map(along);
    if dims.contains(&0) || (0..3).all(|f| cubes[f].n == dims[f]) { dims.map(Along::as_stored) } else { cubes }
}

/// Which spacing counts: the file's, none, or another; by axis of the file.
pub(super) fn spacing(of_file: Option<[f64; 3]>, wanted: Option<Spacing>, order: [usize; 3]) -> Option<[f64; 3]> {
    match wanted.unwrap_or_default() {
        Spacing::Auto => of_file,
        Spacing::AsIs => None,
        Spacing::Of(given) => {
            let mut spacing = [0.0; 3];
            (0..3).for_each(|k| spacing[order[k]] = given[k]);
            Some(spacing)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(steps: [[f64; 3]; 3]) -> Place {
        Place { steps, origin: [0.0; 3], anatomy: true, stated: "sform" }
    }

    #[test]
    fn a_patient_stands_upright_and_is_never_mirrored() {
        let ras = place([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let o = ras.orient();
        assert_eq!((o.axes, o.flips, ras.letters().as_str()), ([0, 2, 1], [false, false, true], "RAS"));
        assert!(!ras.mirrored());
        let las = place([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert_eq!((las.orient().flips, las.mirrored()), ([true, false, true], true));
        // Sagittal slices: the first axis runs down, the second to the back, the third to the left.
        let sagittal = place([[0.0, 0.1, -2.0], [0.0, -2.0, 0.0], [-3.0, 0.0, 0.0]]);
        let o = sagittal.orient();
        assert_eq!((o.axes, o.flips, sagittal.letters().as_str()), ([2, 0, 1], [true, true, false], "IPL"));
        assert!(o.words.ends_with("turned by up to 3° to the nearest axes"), "{}", o.words);
    }

    #[test]
    fn places_that_are_none_are_told() {
        let phrase = |steps| place(steps).checked().unwrap_err();
        assert!(phrase([[0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).contains("0 × 1 × 1"));
        assert!(phrase([[f64::NAN; 3]; 3]).contains("NaN"));
        assert!(phrase([[1e4, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).contains("1000 times"));
        assert!(phrase([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]).contains("one plane"));
    }

    #[test]
    fn cubes_fill_what_voxels_filled() {
        assert_eq!(cubes([10, 20, 5], [1.0, 1.0, 2.5]).map(|a| a.n), [10, 20, 13]);
        assert_eq!(cubes([10, 20, 5], [0.7; 3]), [10, 20, 5].map(Along::as_stored));
        // Less than half a voxel over all of it.
        assert_eq!(cubes([100, 100, 100], [1.0, 1.004, 1.0]), [100; 3].map(Along::as_stored));
        let far = cubes([10, 10, 10], [1000.0, 1.0, 1.0]);
        assert!(far.iter().map(|a| a.n).product::<u64>() <= 64_000 * 2, "{far:?}");
        let a = cubes([4, 4, 2], [1.0, 1.0, 2.0])[2];
        assert_eq!((0..4).map(|i| a.nearest(i)).collect::<Vec<_>>(), [0, 0, 1, 1]);
        assert_eq!(
            (0..4).map(|i| a.between(i)).collect::<Vec<_>>(),
            [(0, 1, 0.0), (0, 1, 0.25), (0, 1, 0.75), (1, 1, 0.0)]
        );
    }
}
