//! Sets of what can be left out, as `--specialize` takes them: of tiles here, of frames in the renderer.

use std::fmt;
use std::marker::PhantomData;
use std::str::FromStr;

/// One thing that can be left out; at most eight of a kind.
pub trait Named: Copy + PartialEq + 'static {
    const ALL: &'static [Self];

    /// As on the command line.
    fn name(self) -> &'static str;
}

/// A set of features of one kind; all by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FeatureSet<F>(u8, PhantomData<F>);

impl<F: Named> FeatureSet<F> {
    pub const ALL: FeatureSet<F> = FeatureSet(((1u16 << F::ALL.len()) - 1) as u8, PhantomData);
    pub const NONE: FeatureSet<F> = FeatureSet(0, PhantomData);

    pub fn has(self, feature: F) -> bool {
        self.0 & bit(feature) != 0
    }

    #[must_use]
    pub fn with(self, feature: F) -> FeatureSet<F> {
        FeatureSet(self.0 | bit(feature), PhantomData)
    }

    pub fn iter(self) -> impl Iterator<Item = F> {
        F::ALL.iter().copied().filter(move |&f| self.has(f))
    }

    /// Every set.
    pub fn sets() -> impl Iterator<Item = FeatureSet<F>> {
        (0..=Self::ALL.0).map(|bits| FeatureSet(bits, PhantomData))
    }

    /// One bit a feature, in their order.
    pub(crate) fn code(self) -> u8 {
        self.0
    }

    pub(crate) fn from_code(code: u8) -> Option<FeatureSet<F>> {
        (code <= Self::ALL.0).then_some(FeatureSet(code, PhantomData))
    }
}

fn bit<F: Named>(feature: F) -> u8 {
    1 << F::ALL.iter().position(|&f| f == feature).expect("`ALL` names every feature")
}

impl<F: Named> Default for FeatureSet<F> {
    fn default() -> FeatureSet<F> {
        FeatureSet::ALL
    }
}

impl<F: Named> FromIterator<F> for FeatureSet<F> {
    fn from_iter<I: IntoIterator<Item = F>>(features: I) -> FeatureSet<F> {
        features.into_iter().fold(FeatureSet::NONE, FeatureSet::with)
    }
}

/// `auto` for all, `off` for none, else names with commas between.
impl<F: Named> FromStr for FeatureSet<F> {
    type Err = String;

    fn from_str(text: &str) -> Result<FeatureSet<F>, String> {
        let feature = |name: &str| {
            F::ALL.iter().copied().find(|f| f.name() == name).ok_or_else(|| {
                let names = F::ALL.iter().map(|f| f.name()).collect::<Vec<_>>().join(", ");
                format!("{name:?} is no feature; expected auto, off, or some of {names} with commas between")
            })
        };
        match text {
            "auto" => Ok(FeatureSet::ALL),
            "off" => Ok(FeatureSet::NONE),
            names => names.split(',').map(feature).collect(),
        }
    }
}

impl<F: Named> fmt::Display for FeatureSet<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            bits if bits == Self::ALL.0 => f.write_str("auto"),
            0 => f.write_str("off"),
            _ => f.write_str(&self.iter().map(F::name).collect::<Vec<_>>().join(",")),
        }
    }
}
