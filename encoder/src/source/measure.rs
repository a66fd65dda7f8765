//! What is solid in a volume of which nobody said it, and how its voxels are coloured: by a sample of its values. Raw and
//! NumPy volumes, and other arrays of which nothing says how large their voxels are, are no part of this: their bytes are
//! solid above 0, other values need `--iso`.
//!
//! | values | solid | colours |
//! |---|---|---|
//! | the header says labels; whole numbers with 0 among them, 16 different at most, or 256 where neighbours are mostly the same | all but 0 | one a label; of a mask none |
//! | bytes to which the header gives a scale; other whole numbers to which it gives an intercept with 0 in between | what means more than 0 | by value |
//! | maps of density (MRC) | mean and three standard deviations, or more | by value |
//! | others | Otsu's threshold or more | by value |
//!
//! Otsu's threshold (N. Otsu, "A threshold selection method from gray-level histograms", 1979) is the one that parts values
//! into two classes with the greatest variance between them; here of the sample itself, not of a histogram, after its
//! topmost thousandth was cut to the least of it.

use super::volume::Data;
use crate::{Result, Rgb};

/// Values looked at: all of a volume that has no more.
const SAMPLE: u64 = 1 << 20;

/// Values that stand together in the sample.
const STRETCH: u64 = 4096;

/// Which values are solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Solid {
    AtLeast(f64),
    NotZero,
}

impl Solid {
    /// What means more than 0.
    pub const ABOVE_0: Solid = Solid::AtLeast(f64::from_bits(1));

    pub fn holds(self, value: f64) -> bool {
        match self {
            Solid::AtLeast(least) => value >= least,
            Solid::NotZero => value != 0.0,
        }
    }
}

/// How solid voxels are coloured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Paint {
    None,
    /// By value between these.
    Ramp(f64, f64),
    Labels,
}

/// From dark to light as the eye sees it, through the colours of flesh and bone. The darkest is light enough for shading to show on.
const RAMP: [[f64; 3]; 6] = [
    [176.0, 104.0, 84.0],
    [204.0, 138.0, 106.0],
    [224.0, 170.0, 134.0],
    [238.0, 200.0, 166.0],
    [248.0, 226.0, 200.0],
    [255.0, 247.0, 232.0],
];

impl Paint {
    pub fn color(self, value: f64) -> Rgb {
        match self {
            Paint::None => crate::encode::build::UNCOLORED,
            Paint::Ramp(low, high) => {
                let at = if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 1.0 };
                let at = at * (RAMP.len() - 1) as f64;
                let i = (at as usize).min(RAMP.len() - 2);
                let t = at - i as f64;
                [0, 1, 2].map(|c| (RAMP[i][c] + (RAMP[i + 1][c] - RAMP[i][c]) * t).round() as u8)
            }
            Paint::Labels => label(value),
        }
    }
}

/// Hues a golden section apart, in two lightnesses: labels that follow each other differ most.
fn label(value: f64) -> Rgb {
    let hue = (value * 0.618_033_988_749_895).rem_euclid(1.0) * 6.0;
    let light = if value.rem_euclid(2.0) == 0.0 { 235.0 } else { 205.0 };
    let channel = |shift: f64| {
        let distance = ((hue - shift).rem_euclid(6.0) - 3.0).abs() - 1.0;
        (light * (0.3 + 0.7 * distance.clamp(0.0, 1.0))).round() as u8
    };
    [channel(0.0), channel(2.0), channel(4.0)]
}

/// What a sample of values says.
#[derive(Debug, Default)]
pub(super) struct Measured {
    /// Ascending, without NaN.
    sorted: Vec<f64>,
    /// Different values; counted up to 257.
    distinct: usize,
    /// Of neighbours that are not 0, the part that are the same.
    same: f64,
    /// Whether it is all values.
    pub whole: bool,
}

impl Measured {
    /// Of values of `size` bytes; the same every time.
    pub fn of(data: &Data, size: u64, decode: &dyn Fn(&[u8], &mut Vec<f64>)) -> Result<Measured> {
        let n = data.len() / size;
        let (mut values, mut buffer, mut stretch) = (Vec::new(), Vec::new(), Vec::new());
        let (mut pairs, mut same) = (0u64, 0u64);
        let stretches = if n <= SAMPLE { n.div_ceil(STRETCH) } else { SAMPLE / STRETCH };
        let apart = n as f64 / stretches.max(1) as f64;
        for i in 0..stretches {
            let at = match n <= SAMPLE {
                true => i * STRETCH,
                // Even, but in step with no row or slice.
                false => {
                    let shift = (i as f64 * 0.618_033_988_749_895).fract() * (apart - STRETCH as f64).max(0.0);
                    ((i as f64 * apart + shift) as u64).min(n - STRETCH)
                }
            };
            let len = STRETCH.min(n - at);
            stretch.clear();
            decode(data.read(at * size, (len * size) as usize, &mut buffer)?, &mut stretch);
            for pair in stretch.windows(2).filter(|p| p[0] != 0.0 && p[1] != 0.0) {
                pairs += 1;
                same += u64::from(pair[0] == pair[1]);
            }
            values.extend(stretch.iter().filter(|v| !v.is_nan()));
        }
        values.sort_unstable_by(f64::total_cmp);
        let steps = values.windows(2).filter(|p| p[0] < p[1]).take(256).count();
        let distinct = steps + usize::from(!values.is_empty());
        Ok(Measured { sorted: values, distinct, same: same as f64 / pairs.max(1) as f64, whole: n <= SAMPLE })
    }

    /// Least and greatest value.
    pub fn range(&self) -> Option<[f64; 2]> {
        Some([*self.sorted.first()?, *self.sorted.last()?])
    }

    fn part(&self, part: f64) -> f64 {
        self.sorted[((self.sorted.len() - 1) as f64 * part) as usize]
    }

    fn looks_like_labels(&self) -> bool {
        let whole = |v: f64| v >= 0.0 && v.fract() == 0.0;
        self.sorted.first() == Some(&0.0)
            && (self.distinct <= 16 || self.distinct <= 256 && self.same >= 0.8)
            && self.sorted.chunk_by(|a, b| a == b).all(|same| whole(same[0]))
    }

    fn otsu(&self) -> f64 {
        let (n, high) = (self.sorted.len(), self.part(0.999));
        let total: f64 = self.sorted.iter().map(|v| v.min(high)).sum();
        let (mut best, mut threshold, mut below) = (-1.0, self.sorted[0], 0.0);
        for k in 1..n {
            let (a, b) = (self.sorted[k - 1].min(high), self.sorted[k].min(high));
            below += a;
            if a < b {
                let (lower, upper) = (below / k as f64, (total - below) / (n - k) as f64);
                let between = k as f64 * (n - k) as f64 * (upper - lower) * (upper - lower);
                if between > best {
                    (best, threshold) = (between, a + (b - a) / 2.0);
                }
            }
        }
        threshold
    }

    /// Which values are solid, how they are coloured, and how that is said.
    pub fn rule(&self, given: Option<f64>, meant: &Meant) -> (Solid, Paint, String) {
        let Some([low, high]) = self.range() else {
            return (Solid::AtLeast(given.unwrap_or(f64::INFINITY)), Paint::None, "no value is a number".to_owned());
        };
        let labels = meant.labels || !meant.scaled && self.looks_like_labels();
        let sample = if self.whole { "" } else { " of a sample" };
        if labels && given.is_none() {
            let n = self.distinct - usize::from(self.sorted.contains(&0.0));
            return match n {
                0 | 1 => (Solid::NotZero, Paint::None, "a mask: all but 0 is solid".to_owned()),
                _ => (
                    Solid::NotZero,
                    Paint::Labels,
                    format!("labels: all but 0 is solid, a colour for each of {n}{sample}"),
                ),
            };
        }
        let (solid, said) = match given {
            Some(iso) => (Solid::AtLeast(iso), format!("solid where at least {iso} (--iso)")),
            None if low == high => (Solid::NotZero, "one value everywhere: solid unless 0".to_owned()),
            None if meant.zero && (meant.bytes || low < 0.0 && high > 0.0) => {
                (Solid::ABOVE_0, "solid where more than 0, by the scale that the header states".to_owned())
            }
            None if meant.density => {
                let n = self.sorted.len() as f64;
                let mean = self.sorted.iter().sum::<f64>() / n;
                let sigma = (self.sorted.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n).sqrt();
                let least = mean + 3.0 * sigma;
                let said = format!(
                    "solid where at least {}, the mean{sample} and 3 standard deviations; --iso",
                    digits(least)
                );
                (Solid::AtLeast(least), said)
            }
            None => {
                let least = self.otsu();
                (
                    Solid::AtLeast(least),
                    format!("solid where at least {} (Otsu's threshold{sample}; --iso)", digits(least)),
                )
            }
        };
        if labels && self.distinct > 2 {
            return (solid, Paint::Labels, format!("{said}, a colour a label"));
        }
        // From the least that is solid to what few are beyond.
        let first = self.sorted.partition_point(|&v| !solid.holds(v));
        let shown = &self.sorted[first.min(self.sorted.len())..];
        let (Some(&from), Some(&to)) = (shown.first(), shown.get(((shown.len().max(1) - 1) as f64 * 0.995) as usize))
        else {
            return (solid, Paint::None, said);
        };
        // Between voxels of two values, others are found.
        match from < to && to.is_finite() && self.distinct > 2 {
            true => {
                (solid, Paint::Ramp(from, to), format!("{said}, coloured by value, {} to {}", digits(from), digits(to)))
            }
            false => (solid, Paint::None, said),
        }
    }
}

/// What is known of the meaning of values before any is looked at.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Meant {
    /// The header says that they are labels.
    pub labels: bool,
    /// The header gives them a scale.
    pub scaled: bool,
    /// That scale says where 0 is.
    pub zero: bool,
    pub bytes: bool,
    /// A map of density, most of it noise about a mean.
    pub density: bool,
}

/// Six digits are enough to be said.
fn digits(v: f64) -> String {
    let short: f64 = format!("{v:.5e}").parse().unwrap_or(v);
    short.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(values: &[f64]) -> Measured {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let decode = |bytes: &[u8], out: &mut Vec<f64>| {
            out.extend(bytes.as_chunks::<8>().0.iter().map(|&b| f64::from_le_bytes(b)));
        };
        Measured::of(&Data::Slice(&bytes), 8, &decode).unwrap()
    }

    #[test]
    fn otsu_parts_two_heaps_of_values_where_they_are_apart() {
        let mut values: Vec<f64> = (0..900).map(|i| 10.0 + f64::from(i % 20)).collect();
        values.extend((0..300).map(|i| 100.0 + f64::from(i % 30)));
        let m = measured(&values);
        let (solid, paint, said) = m.rule(None, &Meant::default());
        assert_eq!((solid, paint), (Solid::AtLeast(64.5), Paint::Ramp(100.0, 129.0)));
        assert!(said.starts_with("solid where at least 64.5 (Otsu's threshold; --iso), coloured"), "{said}");
        // One value far off does not pull it there.
        values.push(1e9);
        assert_eq!(measured(&values).rule(None, &Meant::default()).0, Solid::AtLeast(64.5));
        assert_eq!(m.rule(Some(7.0), &Meant::default()).0, Solid::AtLeast(7.0));
    }

    #[test]
    fn labels_and_masks_are_solid_but_for_0() {
        let few: Vec<f64> = (0..100).map(|i| f64::from(i % 4)).collect();
        assert_eq!(measured(&few).rule(None, &Meant::default()).1, Paint::Labels);
        let mask: Vec<f64> = (0..100).map(|i| f64::from(i % 2) * 255.0).collect();
        assert_eq!(
            measured(&mask).rule(None, &Meant::default()),
            (Solid::NotZero, Paint::None, "a mask: all but 0 is solid".into())
        );
        // Forty labels in large pieces are labels, forty values in disorder are not.
        let pieces: Vec<f64> = (0..4000).map(|i| f64::from(i / 100)).collect();
        assert_eq!(measured(&pieces).rule(None, &Meant::default()).0, Solid::NotZero);
        let disorder: Vec<f64> = (0..4000).map(|i| f64::from(i * 7 % 40)).collect();
        assert!(matches!(measured(&disorder).rule(None, &Meant::default()).0, Solid::AtLeast(_)));
        assert_eq!(measured(&disorder).rule(None, &Meant { labels: true, ..Meant::default() }).0, Solid::NotZero);
        let colors: Vec<Rgb> = (1..30).map(|v| Paint::Labels.color(f64::from(v))).collect();
        assert!((1..29).all(|i| !colors[..i].contains(&colors[i])));
    }

    #[test]
    fn a_scale_with_a_place_for_0_makes_what_is_above_it_solid() {
        let hu: Vec<f64> = (0..100).map(|i| -1000.0 + 20.0 * f64::from(i)).collect();
        let meant = Meant { scaled: true, zero: true, ..Meant::default() };
        assert_eq!(measured(&hu).rule(None, &meant).0, Solid::ABOVE_0);
        assert!(Solid::ABOVE_0.holds(1e-300) && !Solid::ABOVE_0.holds(0.0) && !Solid::ABOVE_0.holds(f64::NAN));
        let positive: Vec<f64> = (0..100).map(|i| 10.0 + f64::from(i)).collect();
        assert!(measured(&positive).rule(None, &meant).0 != Solid::ABOVE_0);
        assert_eq!(measured(&positive).rule(None, &Meant { bytes: true, ..meant }).0, Solid::ABOVE_0);
        assert_eq!(measured(&[f64::NAN; 3]).rule(None, &meant).0, Solid::AtLeast(f64::INFINITY));
    }

    #[test]
    fn a_large_volume_is_sampled_evenly() {
        let values: Vec<f64> = (0..SAMPLE * 2 + 77).map(|i| i as f64).collect();
        let m = measured(&values);
        assert!(!m.whole && m.sorted.len() as u64 == SAMPLE && m.sorted.windows(2).all(|w| w[0] < w[1]));
        let [low, high] = m.range().unwrap();
        assert!(low < 10_000.0 && high > values.len() as f64 - 20_000.0, "{low} {high}");
    }
}
