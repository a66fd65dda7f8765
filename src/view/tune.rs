//! What a person changes of how an input is read while it is looked at.

use clap::ValueEnum;
use planecast_encoder::source::{Exaggeration, ReadOptions, Spacing, Up};
use serde::Deserialize;

/// Colours that can be chosen.
pub const RAMPS: [&str; 9] = ["terrain", "grey", "viridis", "cividis", "magma", "inferno", "plasma", "turbo", "none"];

/// What differs from how the input was opened.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tune {
    /// As `--iso`.
    pub threshold: Option<f64>,
    /// As `--up`: "x", "y" or "z".
    pub up: Option<String>,
    /// Voxels are cubes, as `encode --spacing as-is`; false: as the file states it.
    pub as_is: Option<bool>,
    pub ramp: Option<String>,
    pub exaggeration: Option<f64>,
}

/// What stays of the view when a world is made anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keeps {
    /// The camera where it is.
    All,
    /// The camera, raised or lowered with what it looks at.
    Height,
    /// Nothing: a good view.
    Nothing,
}

impl Tune {
    /// The options with these in them.
    pub fn of(&self, read: &ReadOptions) -> ReadOptions {
        let up = self.up.as_deref().and_then(|up| Up::from_str(up, true).ok());
        let spacing = self.as_is.map(|as_is| if as_is { Spacing::AsIs } else { Spacing::Auto });
        ReadOptions {
            iso: self.threshold.or(read.iso),
            up: up.or(read.up),
            spacing: spacing.or(read.spacing),
            ramp: self.ramp.clone().or_else(|| read.ramp.clone()),
            exaggeration: self.exaggeration.map(Exaggeration::Times).or(read.exaggeration),
            ..read.clone()
        }
    }

    /// Takes what `other` has.
    pub fn take(&mut self, other: Tune) {
        let Tune { threshold, up, as_is, ramp, exaggeration } = other;
        self.threshold = threshold.or(self.threshold);
        self.up = up.or_else(|| self.up.take());
        self.as_is = as_is.or(self.as_is);
        self.ramp = ramp.or_else(|| self.ramp.take());
        self.exaggeration = exaggeration.or(self.exaggeration);
    }

    /// Words of a command line that say how an input is read, with these in place of theirs.
    pub fn words(&self, reading: &[Vec<String>]) -> Vec<String> {
        let flags = self.flags();
        let flags: Vec<String> = flags.split_whitespace().map(str::to_owned).collect();
        let stays = |words: &&Vec<String>| {
            let name = words[0].split('=').next().unwrap_or_default();
            !flags.iter().any(|flag| flag == name)
        };
        reading.iter().filter(stays).flatten().cloned().chain(flags.iter().cloned()).collect()
    }

    /// The flags of `render` and `fly` that read an input so.
    pub fn flags(&self) -> String {
        let mut flags = Vec::new();
        flags.extend(self.threshold.map(|v| format!("--iso {v}")));
        flags.extend(self.up.as_ref().map(|up| format!("--up {up}")));
        flags.extend(self.as_is.map(|as_is| format!("--input-spacing {}", if as_is { "as-is" } else { "auto" })));
        flags.extend(self.ramp.as_ref().map(|ramp| format!("--ramp {ramp}")));
        flags.extend(self.exaggeration.map(|v| format!("--exaggeration {v}")));
        flags.join(" ")
    }
}

/// The number that follows `words` in a rule of [`planecast_encoder::About`].
pub fn number_after(rule: &str, words: &str) -> Option<f64> {
    let rest = rule.split_once(words)?.1;
    rest.split([' ', ',', ';']).next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tuning_adds_to_how_an_input_was_opened() {
        let read = ReadOptions { iso: Some(1.0), show: true, ..ReadOptions::default() };
        let mut tune = Tune::default();
        assert!(tune.flags().is_empty() && tune.of(&read).iso == Some(1.0));
        tune.take(serde_json::from_str(r#"{"threshold": -2.5, "up": "z"}"#).unwrap());
        tune.take(serde_json::from_str(r#"{"ramp": "viridis", "as_is": true, "exaggeration": 3}"#).unwrap());
        assert_eq!(tune.flags(), "--iso -2.5 --up z --input-spacing as-is --ramp viridis --exaggeration 3");
        let read_so = [vec!["--iso=1".to_owned()], vec!["--height-scale".into(), "0.1".into()]];
        let words = "--height-scale 0.1 --iso -2.5 --up z --input-spacing as-is --ramp viridis --exaggeration 3";
        assert_eq!(tune.words(&read_so).join(" "), words);
        assert_eq!(Tune::default().words(&read_so).join(" "), "--iso=1 --height-scale 0.1");
        let of = tune.of(&read);
        assert!(of.show && of.iso == Some(-2.5) && of.up == Some(Up::Z) && of.spacing == Some(Spacing::AsIs));
        assert!(of.exaggeration == Some(Exaggeration::Times(3.0)) && of.ramp.as_deref() == Some("viridis"));
        assert!(serde_json::from_str::<Tune>(r#"{"iso": 3}"#).is_err());
    }

    #[test]
    fn numbers_are_found_in_rules() {
        let rule = "relief 3.5 times as high (--exaggeration), solid where at least 87.25 (Otsu's threshold; --iso)";
        assert_eq!((number_after(rule, "at least "), number_after(rule, "relief ")), (Some(87.25), Some(3.5)));
        assert_eq!(number_after("labels: all but 0 is solid", "at least "), None);
    }
}
