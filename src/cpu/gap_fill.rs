//! Stage `gap_fill`: pixels that no plane passes take the sample of the nearest pixel that one does.
//!
//! Only with fewer planes than pixels. As in Forstmann & Ohya 2009 §3.7 by repetition, along the row where planes run
//! upright (up, down) and along the column where they lie (left, right).

use crate::cpu::remap::{HOLE, Row};
use crate::frame::plane_setup::{Setup, vertical};
use rayon::prelude::*;

/// Replaces each [`HOLE`] in `index`; returns how many there were, and how many are left (a fan without any covered pixel
/// on the line, which then takes its nearest plane whatever the distance, leaves none).
pub fn gap_fill(setup: &Setup, width: u32, index: &mut [u32]) -> [u64; 2] {
    let holes = index.par_iter().filter(|&&i| i == HOLE).count() as u64;
    if holes == 0 {
        return [0, 0];
    }
    let before = index.to_vec();
    let (w, height) = (width as i64, (index.len() / width as usize) as i64);
    index.par_chunks_mut(width as usize).enumerate().for_each(|(r, out)| {
        let row = Row::new(setup, r as u32, width);
        for stretch in row.stretches() {
            let fan = &setup.fans[stretch.fan];
            let own = fan.first_sample..fan.first_sample + (fan.n_planes * fan.n_samples) as usize;
            row.gather(stretch, |x, place| {
                if out[x] != HOLE {
                    return;
                }
                let (dx, dy) = if vertical(stretch.fan) { (1, 0) } else { (0, 1) };
                // Nearer neighbours first, the right or lower one of two.
                let found = (1..w.max(height)).find_map(|d| {
                    let mut inside = false;
                    for d in [d, -d] {
                        let (nx, ny) = (x as i64 + dx * d, r as i64 + dy * d);
                        if (0..w).contains(&nx) && (0..height).contains(&ny) {
                            inside = true;
                            let i = before[(ny * w + nx) as usize];
                            if i != HOLE && own.contains(&(i as usize)) {
                                return Some(Some(i));
                            }
                        }
                    }
                    (!inside).then_some(None)
                });
                // The neighbour names the plane; the sample along it stays the pixel's own.
                let n = fan.n_samples as usize;
                out[x] = match found.flatten() {
                    Some(i) => {
                        let plane = (i as usize - fan.first_sample) / n;
                        (fan.first_sample + plane * n + place.sample as usize) as u32
                    }
                    None => (fan.first_sample + place.plane as usize * n + place.sample as usize) as u32,
                };
            });
        }
    });
    [holes, index.par_iter().filter(|&&i| i == HOLE).count() as u64]
}
