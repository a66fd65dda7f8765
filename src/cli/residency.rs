//! What of a world is in memory while it is drawn: all of it, or the tiles that frames show.

use std::path::Path as FilePath;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use planecast_encoder::encode::memory;
use planecast_encoder::encode::open::Opened;
use planecast_encoder::source::{ReadOptions, tiles};
use planecast_encoder::{Scene, TileSource};

use super::{Surface, positive, tell};
use crate::render::device::{Device, Renderer};
use crate::world::pager::Patience;
use crate::world::preview::Preview;
use crate::world::tint::Tint;
use crate::{Error, Result};

/// Bytes that a scene takes in memory once it is ready to be drawn, for each byte of its lists.
const READY: u64 = 3;

/// Bytes of tiles on a GPU unless others are given.
const USUAL_GPU: u64 = 1 << 30;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Residency {
    Whole,
    Paged,
    Auto,
}

#[derive(Debug, Args)]
pub struct ResidencyArgs {
    /// Have the world in memory as a whole, or only tiles that frames show, read as they are wanted; auto: as a whole where it fits
    #[arg(long, value_enum, value_name = "whole|paged|auto", default_value = "auto")]
    residency: Residency,
    /// Memory for the tiles of a world that is not whole, as in 512M or 4G [default: half of what is free]
    #[arg(long, value_name = "SIZE", value_parser = memory::parse)]
    memory: Option<u64>,
    /// The same on a GPU [default: 1G]
    #[arg(long, value_name = "SIZE", value_parser = memory::parse)]
    memory_gpu: Option<u64>,
    /// Let each frame wait until its tiles are there, or draw after so many milliseconds and show coarser tiles meanwhile
    #[arg(long, value_name = "wait|deadline:MS", value_parser = patience, default_value = "wait")]
    stream: Patience,
}

fn patience(s: &str) -> Result<Patience, String> {
    let deadline = |s: &str| if s == "0" { Ok(0.0) } else { positive(s) };
    match s.split_once(':') {
        None if s == "wait" => Ok(Patience::Wait),
        Some(("deadline", ms)) => {
            deadline(ms).map(Patience::Deadline).map_err(|_| "expected deadline:MS, as in deadline:4".into())
        }
        _ => Err("expected wait, or deadline:MS as in deadline:4".into()),
    }
}

/// A world that is open.
pub enum Held {
    Whole { scene: Scene, surface: Box<Surface> },
    Tiles(Tiles),
}

/// A world that comes in tiles.
pub struct Tiles {
    pub source: Arc<dyn TileSource>,
    pub preview: Preview,
    /// Colours instead of its own.
    pub tint: Option<Tint>,
}

impl Tiles {
    /// Opens a world so that it comes in tiles; an input that has none is encoded in memory first.
    pub fn open(path: &FilePath, read: &ReadOptions) -> Result<Tiles> {
        match tiles::open(path, read)? {
            Some(source) => Tiles::of(source, read),
            None => Tiles::of_file(planecast_encoder::cli::open(path, read, true)?, read),
        }
    }

    fn of(source: Arc<dyn TileSource>, read: &ReadOptions) -> Result<Tiles> {
        let tint = Tint::asked(read.ramp.as_deref(), &source.about())?;
        let preview = Preview::new(&*source)?;
        Ok(Tiles { source, preview, tint })
    }

    fn of_file(opened: Opened, read: &ReadOptions) -> Result<Tiles> {
        // An input has the ramp's colours by now.
        let read = if opened.encoded { &ReadOptions::default() } else { read };
        Tiles::of(Arc::new(opened.file), read)
    }
}

impl ResidencyArgs {
    /// Opens a scene or an input.
    pub fn open(&self, path: &FilePath, read: &ReadOptions, skip_broken: bool) -> Result<Held> {
        // Some of these are never whole.
        let sheets = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("pworld"));
        let made = path.to_str().is_some_and(|name| name.starts_with("procedural:"));
        if (sheets || made || self.residency == Residency::Paged)
            && let Some(source) = tiles::open(path, read)?
        {
            if self.residency == Residency::Whole {
                let what = format!("{}: is drawn in tiles alone; leave out --residency whole", path.display());
                return Err(Error::Argument(what));
            }
            return Ok(Held::Tiles(Tiles::of(source, read)?));
        }
        let opened = planecast_encoder::cli::open(path, read, true)?;
        let need = opened.file.scene_bytes_at_least().saturating_mul(READY);
        let room = self.memory.or_else(memory::available).unwrap_or(u64::MAX);
        let paged = match self.residency {
            Residency::Whole => false,
            Residency::Paged => true,
            // A small world is drawn faster as a whole.
            Residency::Auto => !skip_broken && need > room,
        };
        if !paged {
            let surface = Box::new(Surface::of(&opened, read)?);
            return Ok(Held::Whole { scene: planecast_encoder::cli::read_scene(&opened.file, skip_broken)?, surface });
        }
        if self.residency == Residency::Auto {
            let [need, room] = [need, room].map(memory::display);
            tell(&format!(
                "the world takes some {need} of memory, {room} are allowed: tiles are read as frames show them"
            ));
        }
        Ok(Held::Tiles(Tiles::of_file(opened, read)?))
    }

    /// Opens the device that draws tiles.
    pub fn renderer(&self, tiles: &Tiles, device: Device) -> Result<Renderer> {
        let half = || memory::available().map_or(1 << 30, |free| free / 2);
        let host = self.memory.unwrap_or_else(half);
        // The GPU's tiles are on the host too.
        let budget = if device == Device::Cpu { host } else { host.min(self.memory_gpu.unwrap_or(USUAL_GPU)) };
        Renderer::of_tiles(Arc::clone(&tiles.source), device, budget, self.stream, tiles.tint.clone(), &mut tell)
    }
}
