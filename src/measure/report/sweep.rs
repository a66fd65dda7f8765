//! What a report compares: configurations, and the sources of error one by one.

use crate::frame::options::{Culling, Options, Planes, Remap, Shading};
use planecast_encoder::MipRule;

/// What draws a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    Cpu,
    /// With the kernel of this name.
    Gpu(&'static str),
    /// One f64 ray a pixel at level 0.
    Exact,
}

impl Backend {
    pub fn name(self) -> &'static str {
        match self {
            Backend::Cpu => "cpu",
            Backend::Gpu(_) => "gpu",
            Backend::Exact => "exact",
        }
    }
}

/// One way to draw.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Unique in a report.
    pub name: String,
    /// What is swept: configurations of one sweep are read together.
    pub sweep: &'static str,
    pub backend: Backend,
    pub options: Options,
    /// Picture's width and height as a share of the report's; the picture is then enlarged by repetition.
    pub scale: f64,
    /// The rule that the scene's levels are built by; `None` for the file's own.
    pub rule: Option<MipRule>,
    /// Can be chosen for use: not a measurement of one source of error, of culling, or of holes.
    pub candidate: bool,
}

/// A source of error: `with` has it, `without` is the same but for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    pub name: &'static str,
    pub without: &'static str,
    pub with: &'static str,
}

/// Everything at its most exact, and the sources of error (DESIGN: angular sampling of planes, placement of samples, remap,
/// levels and their rule, equidistant stepping, gap fill, f32) put back one at a time.
pub const SOURCES: [Source; 9] = [
    Source { name: "planes a pixel apart", without: "most exact", with: "most exact, planes 100 %" },
    Source { name: "samples two pixels apart", without: "most exact", with: "most exact, samples 50 %" },
    Source { name: "remap by nearest plane", without: "most exact", with: "most exact, remap nearest" },
    Source { name: "levels at 2 pixels, any-solid", without: "most exact", with: "most exact, lod 2 any" },
    Source { name: "levels at 2 pixels, majority", without: "most exact", with: "most exact, lod 2 majority" },
    Source { name: "equidistant beyond 1/8 of the map", without: "most exact", with: "most exact, equidistant 1/8" },
    Source {
        name: "half the planes, gaps left open",
        without: "most exact",
        with: "most exact, planes 50 %, gaps open",
    },
    Source { name: "half the planes, gaps filled", without: "most exact", with: "most exact, planes 50 %" },
    Source { name: "f32", without: "most exact", with: "most exact, f32" },
];

/// All configurations for a scene `extent` columns long. `base`: view distance, repetition, fog. `kernels`: of a usable
/// GPU, its fastest first. With `few`, those that matter most.
pub fn configs(extent: u32, base: &Options, kernels: &[&'static str], few: bool) -> Vec<Config> {
    let mut out: Vec<Config> = Vec::new();
    let config = |name: &str, sweep, options| Config {
        name: name.into(),
        sweep,
        backend: Backend::Cpu,
        options,
        scale: 1.0,
        rule: None,
        // Other pictures than what is asked for, and the same picture by more work.
        candidate: !["gap fill", "culling", "arithmetic"].contains(&sweep) && options.shading == Shading::Full,
    };
    let usual = Options { shading: Shading::Full, ..*base };
    let nearest = Options { remap: Remap::Nearest, ..usual };
    let retest = Options { remap: Remap::Retest, ..usual };
    let planes = |f: f64, o: Options| Options { planes: Planes::Factor(f), ..o };
    let lod = |px: f64, o: Options| Options { lod: Some(px), ..o };
    let exact = Options { lod: None, ..usual };

    // (name, sweep, options, also in a short run)
    let mut list = vec![("default".to_owned(), "default", usual, true)];
    for (percent, short) in [(25, true), (50, true), (75, false), (150, false), (200, true), (400, false)] {
        list.push((format!("planes {percent} %"), "planes", planes(f64::from(percent) / 100.0, usual), short));
    }
    for percent in [50, 75, 150, 200] {
        let options = Options { samples: f64::from(percent) / 100.0, ..usual };
        list.push((format!("samples {percent} %"), "samples", options, false));
    }
    for (px, short) in [(0.5, false), (2.0, true), (4.0, false), (8.0, true)] {
        list.push((format!("lod {px}"), "levels", lod(px, usual), short));
    }
    list.push(("lod off".into(), "levels", exact, true));
    for part in [2, 8, 32] {
        let distance = f64::from(extent) / f64::from(part);
        let options = Options { equidistant: Some(distance), ..usual };
        list.push((format!("equidistant 1/{part}"), "equidistant", options, part == 8));
    }
    list.push(("remap nearest".into(), "remap", nearest, true));
    list.push(("remap retest".into(), "remap", retest, true));
    list.push(("planes 50 %, gaps open".into(), "gap fill", Options { gap_fill: false, ..planes(0.5, usual) }, false));
    list.push(("planes 25 %, gaps open".into(), "gap fill", Options { gap_fill: false, ..planes(0.25, usual) }, false));
    list.push(("full spacing".into(), "spacing", Options { readjust: false, ..usual }, true));
    let all = Culling::ALL;
    for (name, culling) in [
        ("no culling", Culling::NONE),
        ("without horizon", Culling { horizon: false, ..all }),
        ("without center", Culling { center: false, ..all }),
        ("without forward", Culling { forward: false, ..all }),
        ("without bits", Culling { bits: false, ..all }),
        ("without coarse", Culling { coarse: false, ..all }),
    ] {
        list.push((name.into(), "culling", Options { culling, ..usual }, name == "no culling"));
    }
    for samples in [4, 20] {
        let options = Options { ssao_samples: samples, ..usual };
        list.push((format!("ssao {samples} samples"), "shading", options, samples == 4));
    }
    list.push(("no shading".into(), "shading", Options { shading: Shading::None, ..usual }, false));
    list.push(("f64".into(), "arithmetic", Options { f64_traversal: true, ..usual }, false));
    // Several at once, towards either end of the front.
    for (name, options, short) in [
        ("nearest, planes 75 %, lod 2", planes(0.75, lod(2.0, nearest)), false),
        ("nearest, planes 50 %, lod 2", planes(0.5, lod(2.0, nearest)), false),
        ("nearest, planes 50 %, lod 4", planes(0.5, lod(4.0, nearest)), false),
        ("retest, planes 75 %, lod 2", planes(0.75, lod(2.0, retest)), false),
        ("retest, planes 50 %, lod 2", planes(0.5, lod(2.0, retest)), true),
        ("retest, planes 200 %, lod 0.5", planes(2.0, lod(0.5, retest)), false),
        ("planes 50 %, lod 2", planes(0.5, lod(2.0, usual)), false),
        ("planes 50 %, lod 2, ssao 4 samples", planes(0.5, lod(2.0, Options { ssao_samples: 4, ..usual })), false),
        ("planes 150 %, lod 0.5", planes(1.5, lod(0.5, usual)), false),
        ("planes 200 %, lod 0.5", planes(2.0, lod(0.5, usual)), true),
        ("planes 200 %, lod off", planes(2.0, exact), false),
    ] {
        list.push((name.into(), "several", options, short));
    }
    let keep = |short: bool| short || !few;
    out.extend(list.iter().filter(|l| keep(l.3)).map(|(name, sweep, options, _)| config(name, sweep, *options)));
    for (name, rule, options, short) in [
        ("majority, lod 1", MipRule::Majority, usual, true),
        ("majority, lod 2", MipRule::Majority, lod(2.0, usual), false),
    ] {
        let c = Config { rule: Some(rule), ..config(name, "levels", options) };
        out.extend(keep(short).then_some(c));
    }
    for (name, scale, options, short) in [
        ("resolution 50 %", 0.5, usual, true),
        ("resolution 75 %", 0.75, usual, false),
        ("resolution 75 %, nearest", 0.75, nearest, false),
    ] {
        let c = Config { scale, ..config(name, "resolution", options) };
        out.extend(keep(short).then_some(c));
    }

    // The sources.
    let most = Options { readjust: false, f64_traversal: true, ..planes(4.0, exact) };
    let source = |name: &str, options| Config { candidate: false, ..config(name, "source", options) };
    out.push(Config { backend: Backend::Exact, sweep: "exact", ..source("exact", usual) });
    let any = Config { rule: Some(MipRule::Any), ..source("most exact, lod 2 any", lod(2.0, most)) };
    let majority = Config { rule: Some(MipRule::Majority), ..source("most exact, lod 2 majority", lod(2.0, most)) };
    let equidistant = Options { equidistant: Some(f64::from(extent) / 8.0), ..most };
    if !few {
        out.extend([
            source("most exact", most),
            source("most exact, samples 50 %", Options { samples: 0.5, ..most }),
            source("most exact, planes 100 %", planes(1.0, most)),
            source("most exact, remap nearest", Options { remap: Remap::Nearest, ..most }),
            any,
            majority,
            source("most exact, equidistant 1/8", equidistant),
            source("most exact, planes 50 %, gaps open", Options { gap_fill: false, ..planes(0.5, most) }),
            source("most exact, planes 50 %", planes(0.5, most)),
            source("most exact, f32", Options { f64_traversal: false, ..most }),
        ]);
    }

    // The GPU: all that it can draw with its fastest kernel, and the other kernels as they come.
    if let Some((first, others)) = kernels.split_first() {
        let drawable = |c: &&Config| {
            let o = &c.options;
            c.candidate && !o.f64_traversal && c.sweep != "culling"
        };
        let fastest: Vec<Config> = (out.iter().filter(drawable))
            .map(|c| Config { name: format!("gpu, {}", c.name), backend: Backend::Gpu(first), ..c.clone() })
            .collect();
        out.extend(fastest);
        for kernel in others {
            let name = format!("gpu, kernel {kernel}");
            out.push(Config { backend: Backend::Gpu(kernel), ..config(&name, "kernel", usual) });
        }
    }
    out
}

impl Config {
    /// The flags of `render` and `fly` that draw this, beside those that every configuration of a report has.
    pub fn flags(&self) -> String {
        let device = match self.backend {
            Backend::Cpu => "--device cpu".to_owned(),
            Backend::Gpu(kernel) => format!("--device gpu --kernel {kernel}"),
            Backend::Exact => "--device exact".to_owned(),
        };
        let flags = self.options.flags();
        if flags.is_empty() { device } else { device + " " + &flags }
    }

    /// What `flags` cannot say: a smaller picture, levels of another rule.
    pub fn beside_flags(&self) -> Option<String> {
        let mut parts = Vec::new();
        if self.scale != 1.0 {
            parts.push(format!("--size at {} % of the picture's, enlarged", self.scale * 100.0));
        }
        match self.rule {
            Some(MipRule::Any) => parts.push("a scene encoded with --mip-rule any".into()),
            Some(MipRule::Majority) => parts.push("a scene encoded with --mip-rule majority".into()),
            None => {}
        }
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn configs_have_names_of_their_own_and_sources_exist() {
        let all = configs(512, &Options::default(), &["workgroup", "invocation"], false);
        let names: HashSet<&str> = all.iter().map(|c| &*c.name).collect();
        assert_eq!(names.len(), all.len());
        for source in SOURCES {
            assert!(names.contains(source.with) && names.contains(source.without), "{}", source.name);
        }
        let few = configs(512, &Options::default(), &[], true);
        assert!(few.len() < 24 && few.iter().all(|c| all.contains(c)));
    }

    #[test]
    fn configs_differ_in_what_they_draw() {
        let all = configs(512, &Options::default(), &["workgroup", "invocation"], false);
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                let same = (a.backend, a.options, a.scale, a.rule) == (b.backend, b.options, b.scale, b.rule);
                assert!(!same, "{} and {}", a.name, b.name);
            }
        }
    }
}
