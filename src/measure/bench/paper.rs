//! Figures quoted from papers, each in one place only, and what the papers' letters mean here.
//!
//! Table 1 of Forstmann & Ohya 2009 switches (F)orward, (C)entersegment and (S)haremem. Here:
//!
//! | paper | here | deviates |
//! |---|---|---|
//! | no letter | [`Culling::horizon`] | the text calls the floating horizon the first culling mechanism and gives it no letter, so it is on in every row |
//! | F | [`Culling::forward`] | with S, in words of visibility bits; without S, by looking at the plane's samples one by one |
//! | C | [`Culling::center`] | none |
//! | S | [`Culling::bits`] | in workgroup memory on the GPU as in the paper, in the cache on the CPU |
//! | – | [`Culling::coarse`] | not in the paper: off in its rows |
//!
//! Full is [`Encoding::Solid`], Surface [`Encoding::Surface`], both with a colour a run. The paper's 1,024 planes are one a
//! pixel column; its far columns are looked at equidistantly from a distance that it does not state, ours never are. Its views
//! are known from a figure alone. Its frames end on the screen; ours are the stages alone, without display or read-back.

use crate::Culling;
use planecast_encoder::Encoding;

pub const FORSTMANN_2009: &str = "Forstmann & Ohya 2009, GeForce 8800 GTS, Pentium D 3.0 GHz";
pub const FORSTMANN_2010: &str =
    "Forstmann & Ohya, IEICE Trans. E93-D no. 11, 2010, GeForce GTX 285, 2 x 1 anti-aliasing";

/// The device a row of Table 1 was measured on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    Gpu,
    Cpu,
}

/// A row of Table 1 of Forstmann & Ohya 2009: frames a second of the far and near view of its Fig. 6.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Table1 {
    pub dataset: Encoding,
    pub letters: &'static str,
    pub far: f64,
    pub near: f64,
    pub average: f64,
    pub version: Version,
    pub screen: [u32; 2],
}

const SMALL: [u32; 2] = [512, 512];
const LARGE: [u32; 2] = [1024, 768];

const fn row(
    dataset: Encoding,
    letters: &'static str,
    [far, near, average]: [f64; 3],
    version: Version,
    screen: [u32; 2],
) -> Table1 {
    Table1 { dataset, letters, far, near, average, version, screen }
}

/// In the paper's order.
pub const TABLE1: [Table1; 18] = {
    use Encoding::{Solid as Full, Surface};
    use Version::{Cpu, Gpu};
    [
        row(Full, "F,C", [43.0, 45.0, 44.0], Gpu, SMALL),
        row(Full, "S,C", [43.0, 42.0, 42.5], Gpu, SMALL),
        row(Full, "F,C", [17.5, 21.2, 19.35], Gpu, LARGE),
        row(Full, "S,C", [19.2, 19.0, 19.1], Gpu, LARGE),
        row(Surface, "S", [18.8, 18.5, 18.65], Gpu, LARGE),
        row(Surface, "S,C", [18.2, 17.8, 18.0], Gpu, LARGE),
        row(Full, "S", [16.3, 14.7, 15.5], Gpu, LARGE),
        row(Surface, "C", [15.3, 15.6, 15.45], Gpu, LARGE),
        row(Surface, "F,C", [15.0, 15.8, 15.4], Gpu, LARGE),
        row(Surface, "F", [14.9, 15.8, 15.35], Gpu, LARGE),
        row(Full, "C", [15.4, 15.3, 15.35], Gpu, LARGE),
        row(Surface, "", [14.7, 15.1, 14.9], Gpu, LARGE),
        row(Full, "F", [13.9, 15.6, 14.75], Gpu, LARGE),
        row(Full, "", [10.8, 10.2, 10.5], Gpu, LARGE),
        row(Full, "C", [1.7, 2.1, 1.9], Cpu, LARGE),
        row(Full, "", [1.5, 2.0, 1.75], Cpu, LARGE),
        row(Surface, "C", [1.2, 1.6, 1.4], Cpu, LARGE),
        row(Surface, "", [1.2, 1.4, 1.3], Cpu, LARGE),
    ]
};

/// The switches that the paper's letters stand for.
pub fn culling(letters: &str) -> Culling {
    let has = |letter| letters.contains(letter);
    Culling { horizon: true, center: has('C'), forward: has('F'), bits: has('S'), coarse: false }
}

/// The letters as a table shows them.
pub fn letters(letters: &str) -> &str {
    if letters.is_empty() { "none" } else { letters }
}

/// A row of Table 1 of Forstmann & Ohya 2010, 1,024 × 768.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ieice {
    pub scene: &'static str,
    pub size: &'static str,
    /// Millions of RLE elements: of the scene, met in a frame, drawn in it.
    pub total: f64,
    pub processed: f64,
    pub drawn: f64,
    pub fps: f64,
    /// Millions of elements processed a second.
    pub rate: f64,
    pub bits_per_voxel: f64,
}

const fn ieice(
    scene: &'static str,
    size: &'static str,
    [total, processed, drawn]: [f64; 3],
    fps: f64,
    rate: f64,
    bits_per_voxel: f64,
) -> Ieice {
    Ieice { scene, size, total, processed, drawn, fps, rate, bits_per_voxel }
}

pub const IEICE: [Ieice; 5] = [
    ieice("Procedural", "1k³", [14.1, 7.7, 0.58], 47.5, 365.75, 17.9),
    ieice("Bonsai (CT)", "512³", [8.8, 8.7, 0.35], 21.7, 188.79, 18.25),
    ieice("Buddha (mesh)", "1k × 2k × 1k", [31.3, 7.38, 0.4], 48.2, 355.72, 12.0),
    ieice("Mansion (map)", "1k × 256 × 1k", [11.48, 3.1, 0.43], 78.5, 243.35, 10.83),
    ieice("Dragon (mesh)", "1k³", [2.67, 1.67, 0.29], 67.1, 112.06, 26.3),
];

/// A figure of the papers' text: which part of the bench it stands beside, what it is of, and frames a second as median (or
/// average), least and greatest, as far as they are stated.
pub struct Stated {
    pub part: &'static str,
    pub what: &'static str,
    pub scene: &'static str,
    pub fps: [Option<f64>; 3],
    pub citation: &'static str,
}

pub const STATED: [Stated; 4] = [
    Stated {
        part: "landscape",
        what: "landscape, view 180,000",
        scene: "landscape",
        fps: [None, Some(15.0), Some(30.0)],
        citation: FORSTMANN_2009,
    },
    Stated {
        part: "mixing",
        what: "single",
        scene: "Richtmyer-Meshkov, 2048³",
        fps: [Some(16.0), Some(9.0), Some(40.0)],
        citation: FORSTMANN_2009,
    },
    Stated {
        part: "mixing",
        what: "repeated to 40k × 2k × 40k",
        scene: "Richtmyer-Meshkov, 2048³",
        fps: [Some(10.0), Some(8.0), Some(40.0)],
        citation: FORSTMANN_2009,
    },
    Stated {
        part: "mixing",
        what: "about 400 copies",
        scene: "Richtmyer-Meshkov, 2048³",
        fps: [None, Some(5.0), Some(8.0)],
        citation: FORSTMANN_2009,
    },
];

/// Per cent that readjusted planes save at most, looking straight down (2009, §6).
pub const READJUSTED_SAVES: f64 = 50.0;
/// Milliseconds of SSN and SSAO together at 1,024 × 768 (2009, §6).
pub const SSN_SSAO_MS: f64 = 2.0;
/// GPU over CPU with the same culling, and over the basic CPU version (2009, §6 and §7).
pub const GPU_OVER_CPU: f64 = 5.0;
pub const GPU_OVER_BASIC: f64 = 10.0;
/// GPU over a quad-core CPU (2010), least and greatest.
pub const GPU_OVER_QUAD_CORE: [f64; 2] = [3.0, 7.0];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_table_1_adds_up() {
        for r in TABLE1 {
            assert!(((r.far + r.near) / 2.0 - r.average).abs() < 1e-9, "{r:?}");
        }
        let count = |f: fn(&Table1) -> bool| TABLE1.iter().filter(|r| f(r)).count();
        assert_eq!(count(|r| r.version == Version::Gpu), 14);
        assert_eq!(count(|r| r.screen == SMALL), 2);
        assert_eq!(count(|r| r.dataset == Encoding::Surface), 8);
        assert!((TABLE1.iter().map(|r| r.average).sum::<f64>() - 285.15).abs() < 1e-9);
    }

    #[test]
    fn paper_table_of_2010_adds_up() {
        for r in IEICE {
            assert!((r.processed * r.fps - r.rate).abs() < 0.03 * r.fps.sqrt(), "{r:?}");
            assert!(r.total > r.processed && r.processed > r.drawn, "{r:?}");
        }
    }

    #[test]
    fn paper_letters_are_switches() {
        let paper = |center, forward, bits| Culling { horizon: true, center, forward, bits, coarse: false };
        for (letters, switches) in [
            ("", paper(false, false, false)),
            ("F", paper(false, true, false)),
            ("C", paper(true, false, false)),
            ("S", paper(false, false, true)),
            ("F,C", paper(true, true, false)),
            ("S,C", paper(true, false, true)),
        ] {
            assert_eq!(culling(letters), switches, "{letters}");
            assert!(TABLE1.iter().any(|r| r.letters == letters));
        }
    }
}
