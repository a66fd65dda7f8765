//! One line of a bench: a configuration with what it took, or a figure quoted from a paper.

use serde::{Deserialize, Serialize};

/// Where a figure comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Here, by this run.
    #[default]
    Measured,
    /// Elsewhere; `citation` says where.
    Quoted,
}

/// What does not apply is empty. Times are milliseconds a frame, medians of `n` frames after a warm-up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub part: String,
    /// The row's name, unique in a run; begins with the part.
    pub key: String,
    pub source: Source,
    pub citation: String,
    pub scene: String,
    pub encoding: String,
    pub device: String,
    pub kernel: String,
    pub threads: Option<u32>,
    pub width: Option<u32>,
    pub height: Option<u32>,
    pub view: String,
    /// Culling switches that are on.
    pub culling: String,
    /// What else the row differs in from its neighbours, and its amount where it is one.
    pub variant: String,
    pub x: Option<f64>,
    pub n: u32,
    pub total_ms: Option<f64>,
    pub total_min_ms: Option<f64>,
    pub total_max_ms: Option<f64>,
    pub setup_ms: Option<f64>,
    pub traverse_ms: Option<f64>,
    pub traverse_min_ms: Option<f64>,
    pub traverse_max_ms: Option<f64>,
    pub remap_ms: Option<f64>,
    pub shade_ms: Option<f64>,
    /// Frames a second: of the median frame, the slowest and the fastest; of a quoted row as its source has them.
    pub fps: Option<f64>,
    pub fps_low: Option<f64>,
    pub fps_high: Option<f64>,
    /// Work of a frame, means.
    pub planes: Option<f64>,
    pub columns: Option<f64>,
    pub runs: Option<f64>,
    pub spans: Option<f64>,
    /// Geometry runs of the scene at level 0, and over all levels.
    pub scene_runs: Option<f64>,
    pub scene_runs_all: Option<f64>,
    /// Runs met a second.
    pub runs_per_s: Option<f64>,
    /// Of the scene's file, a surface voxel of level 0: geometry with column tables of level 0, and everything.
    pub geometry_bits_per_voxel: Option<f64>,
    pub bits_per_voxel: Option<f64>,
}
