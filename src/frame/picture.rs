//! A finished picture and what it cost.

/// A drawn frame, all arrays row by row from the top, `width · height` long.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    pub width: u32,
    pub height: u32,
    /// sRGB, alpha 255.
    pub color: Vec<[u8; 4]>,
    /// Distance along `forward` at which the pixel's ray enters the voxel it shows; sky is +inf.
    pub depth: Vec<f32>,
    /// Level-0 x, y, z of the voxel's minimum corner and its level; −1, −1, −1, −1 for sky. Empty unless asked for.
    pub voxel: Vec<[i32; 4]>,
    pub stats: Stats,
}

#[cfg(not(target_arch = "wasm32"))]
impl Frame {
    /// Writes the picture as PNG, 8-bit sRGB; the whole file or, where that fails, none.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] names the file and what could not be done.
    pub fn save_png(&self, path: impl AsRef<std::path::Path>) -> crate::Result<()> {
        Ok(crate::output::write(path.as_ref(), |out| crate::output::png(out, self))?.finish()?)
    }
}

/// Milliseconds by stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct StageTimes {
    pub setup: f64,
    pub traverse: f64,
    pub remap: f64,
    pub shade: f64,
    pub total: f64,
}

impl std::ops::AddAssign for StageTimes {
    fn add_assign(&mut self, o: StageTimes) {
        self.setup += o.setup;
        self.traverse += o.traverse;
        self.remap += o.remap;
        self.shade += o.shade;
        self.total += o.total;
    }
}

impl Stats {
    /// What a frame owes whose tiles are not all there, in words; `None` where they are.
    pub fn owed(&self) -> Option<String> {
        let paging = &self.paging;
        let pixels = (f64::from(self.width) * f64::from(self.height)).max(1.0);
        (paging.tiles_missing > 0).then(|| {
            format!(
                "{} of {} tiles are on their way: pixels are {:.3} levels too coarse, in the mean",
                paging.tiles_missing,
                paging.tiles_wanted,
                paging.debt as f64 / pixels
            )
        })
    }

    /// Of two pictures that are put together: work and times are added, the rest is that of the other where this is empty.
    #[must_use]
    pub fn joined(mut self, other: Stats) -> Stats {
        if self.device.is_empty() {
            return other;
        }
        self.planes += other.planes;
        self.planes_full += other.planes_full;
        self.levels_drawn = self.levels_drawn.max(other.levels_drawn);
        self.holes += other.holes;
        self.columns_visited += other.columns_visited;
        self.runs_visited += other.runs_visited;
        self.spans_drawn += other.spans_drawn;
        for (own, other) in [(&mut self.cpu_ms, other.cpu_ms), (&mut self.gpu_ms, other.gpu_ms)] {
            if let (Some(own), Some(other)) = (own, other) {
                *own += other;
            }
        }
        self
    }
}

/// What a frame had of the tiles that it wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PagingStats {
    /// Pixels that show a coarser tile than they should, each times how many levels coarser.
    pub debt: u64,
    /// Tiles that the frame's planes can touch, those that stand-ins are shown for, and those that pixels show.
    pub tiles_wanted: u32,
    pub tiles_missing: u32,
    pub tiles_used: u32,
    pub tiles_arrived: u32,
    pub tiles_evicted: u32,
    pub bytes_read: u64,
    pub bytes_resident: u64,
    pub bytes_uploaded: u64,
    pub unpack_ms: f64,
    pub upload_ms: f64,
    /// The level of detail that was drawn, in pixels: larger than asked for where the budget does not hold it.
    pub lod: f64,
}

/// Work of one frame.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Stats {
    /// The adapter's name, or "cpu".
    pub device: String,
    pub kernel: String,
    /// Planes cast, and how many the spacing of one pixel along each far edge would cast.
    pub planes: u32,
    pub planes_full: u32,
    /// Levels that the scene has, and how many of them the frame could draw.
    pub levels: u32,
    pub levels_drawn: u32,
    /// Pixels that no plane passes within half a pixel, before gap fill.
    pub holes: u64,
    pub width: u32,
    pub height: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu_ms: Option<StageTimes>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu_ms: Option<StageTimes>,
    pub columns_visited: u64,
    pub runs_visited: u64,
    pub spans_drawn: u64,
    pub bytes_scene_gpu: u64,
    /// Of a world that is not all in memory; else nothing is missing.
    #[serde(flatten)]
    pub paging: PagingStats,
    /// Features that the frame paid for.
    pub specialization: Vec<String>,
    /// What was left out, since the frame does not need it: [`crate::Feature`]s by name, with the reason.
    pub left_out: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_says_what_it_owes_until_its_tiles_are_there() {
        let mut stats = Stats { width: 40, height: 25, ..Stats::default() };
        (stats.paging.tiles_wanted, stats.paging.tiles_missing, stats.paging.debt) = (60, 7, 310);
        let said = "7 of 60 tiles are on their way: pixels are 0.310 levels too coarse, in the mean";
        assert_eq!(stats.owed().as_deref(), Some(said));
        stats.paging.tiles_missing = 0;
        assert_eq!(stats.owed(), None);
    }
}
