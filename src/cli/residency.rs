//! Flags that say what of a world is in memory while it is drawn.

use std::path::Path as FilePath;

use clap::{Args, ValueEnum};
use planecast_encoder::Scene;
use planecast_encoder::encode::memory;
use planecast_encoder::source::ReadOptions;

use super::{Surface, positive, tell};
use crate::Result;
use crate::render::device::{Device, Renderer};
use crate::world::pager::Patience;
use crate::world::residency::{Residency, ResidencyOptions, Tiles};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ResidencyArg {
    Whole,
    Paged,
    Auto,
}

#[derive(Debug, Args)]
pub struct ResidencyArgs {
    /// Have the world in memory as a whole, or only tiles that frames show, read as they are wanted; auto: as a whole where it fits
    #[arg(long, value_enum, value_name = "whole|paged|auto", default_value = "auto")]
    residency: ResidencyArg,
    /// Memory for the tiles of a world that is not whole, as in 512M or 4G [default: half of what is free]
    #[arg(long, value_name = "SIZE", value_parser = memory::parse)]
    memory: Option<u64>,
    /// The same on a GPU [default: 1G]
    #[arg(long, value_name = "SIZE", value_parser = memory::parse)]
    memory_gpu: Option<u64>,
    /// Let each frame wait until its tiles are there, or draw after so many milliseconds and show coarser tiles meanwhile [default:
    /// wait; in a window deadline:8]
    #[arg(long, value_name = "wait|deadline:MS", value_parser = patience)]
    stream: Option<Patience>,
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
pub enum Loaded {
    Whole { scene: Scene, surface: Box<Surface> },
    Tiles(Box<Tiles>),
}

/// Opens a world so that it comes in tiles; an input that has none is encoded in memory first.
#[cfg(feature = "report")]
pub fn tiles(path: &FilePath, read: &ReadOptions) -> Result<Tiles> {
    match planecast_encoder::source::tiles::open(path, read)? {
        Some(source) => Tiles::new(path, source, read),
        None => {
            let opened = planecast_encoder::cli::open(path, read, true)?;
            Tiles::of_file(path, opened.file, opened.encoded, read)
        }
    }
}

impl ResidencyArgs {
    /// What was asked for; frames wait as `usual` has it where nothing was.
    pub fn options(&self, usual: Patience) -> ResidencyOptions {
        let residency = match self.residency {
            ResidencyArg::Whole => Residency::Whole,
            ResidencyArg::Paged => Residency::Paged,
            ResidencyArg::Auto => Residency::Auto,
        };
        let patience = self.stream.unwrap_or(usual);
        ResidencyOptions { residency, memory: self.memory, memory_gpu: self.memory_gpu, patience }
    }

    /// Opens a scene or an input.
    pub fn open(&self, path: &FilePath, read: &ReadOptions, skip_broken: bool) -> Result<Loaded> {
        let options = self.options(Patience::Wait);
        if let Some(tiles) = options.tiles(path, read)? {
            return Ok(Loaded::Tiles(Box::new(tiles)));
        }
        let opened = planecast_encoder::cli::open(path, read, true)?;
        if options.pages(&opened.file, skip_broken, &mut tell) {
            let tiles = Tiles::of_file(path, opened.file, opened.encoded, read)?;
            return Ok(Loaded::Tiles(Box::new(tiles)));
        }
        let surface = Box::new(Surface::of(&opened, read)?);
        Ok(Loaded::Whole { scene: planecast_encoder::cli::read_scene(&opened.file, skip_broken)?, surface })
    }

    /// Opens the device that draws tiles.
    pub fn renderer(&self, tiles: &Tiles, device: Device) -> Result<Renderer> {
        let options = self.options(Patience::Wait);
        let budget = options.budget(device != Device::Cpu);
        Renderer::of_tiles(tiles.source.clone(), device, budget, options.patience, tiles.tint.clone(), &mut tell)
    }
}
