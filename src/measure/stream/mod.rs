//! Error against run time of worlds that come in tiles: memory × velocity × link × patience.
//!
//! A *row* is one flight. It is flown with so much memory for tiles (`--memory`), at so many voxels of level 0 per frame, over a link of
//! so many bytes per second that answers so late ([`link`]), and its frames wait for tiles or do not (`--stream`). Frames are drawn
//! back to back, as `fly` draws them: the next is asked for as soon as one is there, and its tiles a frame ahead. No row waits for a
//! clock between frames, so who draws at a fixed rate has more time for tiles than is measured here.
//!
//! Each frame is compared with the same frame drawn with all of its tiles there. Frames that wait show that, where the memory holds
//! the view; then what is paid is time. Frames with a deadline are on time, and what is paid is error.
//!
//! ```text
//! world ─► flight × settings ─► frames, times ─► rows ─► JSON, CSV, Markdown, plots, page
//!          (`flight`, `link`)   (`run`)                  (`present`)
//! ```

pub mod flight;
pub mod link;
pub mod present;
pub mod run;

use std::path::Path as FilePath;

use planecast_encoder::Error as FileError;
use planecast_encoder::encode::memory;

use crate::error::{Error, Result};
use crate::measure::machine::Machine;
use crate::measure::report;
use crate::render::device::Device;
use crate::world::pager::Patience;
use crate::{Options, Repeat};
use flight::Flight;
use link::Link;
use run::{Plan, World};

/// What a report is to be made of.
#[derive(Clone, Copy, Debug)]
pub struct Job<'j> {
    /// Where it goes.
    pub folder: &'j FilePath,
    /// Fewer settings and frames.
    pub quick: bool,
    /// Pixels.
    pub size: Option<[u32; 2]>,
    pub device: Device,
    /// What all frames are drawn with.
    pub options: Options,
    /// Bytes for tiles, one row each; none: parts of what the first view needs.
    pub memories: &'j [u64],
}

/// Pixels of a frame unless told otherwise.
pub const SIZE: [u32; 2] = [320, 240];

/// Memory for tiles, by what the first view needs.
const PARTS: [f64; 4] = [0.25, 0.5, 1.0, 2.0];

/// What is combined.
struct Extent {
    /// Voxels of level 0 per frame.
    velocities: &'static [f64],
    links: Vec<Link>,
    parts: &'static [f64],
    patiences: &'static [Patience],
    frames: usize,
}

impl Extent {
    fn new(quick: bool) -> Extent {
        // A local file; a wide network nearby; a home's line and a server far away.
        let links = vec![Link::UNLIMITED, Link::new(1000.0, 1), Link::new(100.0, 50)];
        if quick {
            return Extent {
                velocities: &[4.0, 100.0],
                links: vec![links[0], links[2]],
                parts: &PARTS[2..],
                patiences: &[Patience::Wait, Patience::Deadline(0.0)],
                frames: 12,
            };
        }
        Extent {
            velocities: &[1.0, 4.0, 20.0, 100.0],
            links,
            parts: &PARTS,
            patiences: &[Patience::Wait, Patience::Deadline(0.0), Patience::Deadline(4.0), Patience::Deadline(16.0)],
            frames: 40,
        }
    }
}

/// Makes a report of a world along a flight; its result in a sentence or two. `tell` hears of the progress.
///
/// # Errors
/// Those of the folder, of tiles and of drawing; [`Error::Limit`] where memory does not hold the pictures of a row, or nothing was
/// flown.
pub fn report(world: &World, flight: &Flight, job: &Job<'_>, tell: &mut dyn FnMut(&str)) -> Result<String> {
    if job.options.repeat != Repeat::default() {
        return Err(Error::Argument("a world that comes in tiles is not repeated; leave out --repeat".into()));
    }
    std::fs::create_dir_all(job.folder).map_err(|e| FileError::io(job.folder, "make", e))?;
    let extent = Extent::new(job.quick);
    let size = job.size.unwrap_or(SIZE);
    let first = flight.poses(1.0, 1)[0].camera(size);
    let working_set = run::working_set(world, &first, job.device, &job.options, tell)?;
    tell(&format!("the first view needs {} for tiles", memory::display(working_set)));
    let parts = || extent.parts.iter().map(|part| (part * working_set as f64) as u64);
    let memories: Vec<u64> = if job.memories.is_empty() { parts().collect() } else { job.memories.to_vec() };
    let plan = Plan {
        world,
        flight,
        velocities: extent.velocities,
        links: &extent.links,
        memories: &memories,
        patiences: extent.patiences,
        frames: extent.frames,
        size,
        device: job.device,
        options: job.options,
        working_set,
    };
    let measured = plan.run(tell)?;
    if let Some(why) = measured.rows.iter().all(|row| row.refused.is_some()).then(|| measured.rows[0].refused.clone()) {
        let why = why.unwrap_or_default();
        return Err(Error::Limit(format!("{why}: nothing was flown; give more with --memory")));
    }
    let machine = Machine::new((measured.device != "cpu").then(|| measured.device.clone()));
    let files = present::files(&plan, &measured, &machine);
    report::present::write(job.folder, &files)?;
    tell(&format!("the report is {}", job.folder.join("stream.html").display()));
    Ok(present::result(&measured.rows))
}
