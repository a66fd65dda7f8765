//! Voxlap and Ace of Spades maps (`.vxl`).
//!
//! ```text
//! header, Voxlap only:  u32 magic | u32 xsiz | u32 ysiz | 12 × f64 position and axes       (108 bytes)
//! column, x fastest:    span [N S E A] colours…, span…, last span (N = 0) colours…
//! ```
//! z points down. A span is air from A to S−1 (A of the first span is not used), then solid: top colours for S ..= E,
//! then up to the A of the next span, where the last voxels before it carry the remaining N−1−(E−S+1) colours. Below
//! the last span all is solid. Colours are B, G, R and a baked shade, which is not applied.

use std::path::Path;

use super::world_dims;
use crate::model::about::Kind;
use crate::model::pieces::InMemory;
use crate::{About, Colors, ColumnsBuilder, Error, Input, Result, Rgb, Run};

/// First word of a file with a header.
pub(super) const MAGIC: u32 = 0x0907_2000;

const HEADER_LEN: usize = 108;

/// Sides of a map without header.
const PLAIN_SIDE: u32 = 512;

/// One span, with its place in the file.
#[derive(Clone, Copy)]
struct Span {
    at: usize,
    /// Words to the next span; 0 for the last.
    n: usize,
    /// First solid z, and one past the last top colour.
    top: u32,
    top_end: u32,
    /// First z of the air above.
    air: u32,
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<InMemory> {
    let word = |i: usize| bytes.get(i * 4..i * 4 + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (nx, nz, start) = if word(0) == Some(MAGIC) {
        match (word(1), word(2)) {
            (Some(x), Some(y)) if bytes.len() >= HEADER_LEN => (x, y, HEADER_LEN),
            _ => return Err(Error::format(path, format!("{} bytes; a Voxlap header has {HEADER_LEN}", bytes.len()))),
        }
    } else {
        (PLAIN_SIDE, PLAIN_SIDE, 0)
    };
    // A column takes at least the four bytes of one span.
    let claimed = u64::from(nx) * u64::from(nz);
    if claimed == 0 || claimed > (bytes.len() as u64 - start as u64) / 4 {
        return Err(Error::format(
            path,
            format!(
                "{} bytes; a map of {nx} × {nz} columns needs at least {}",
                bytes.len(),
                claimed.saturating_mul(4).saturating_add(start as u64)
            ),
        ));
    }

    // The depth is not stated, so the file is walked twice.
    let mut depth = 0;
    let mut spans = Vec::new();
    let mut at = start;
    for column in 0..claimed {
        at = walk_column(bytes, at, &mut spans).map_err(|what| place(path, nx, column, what))?;
        depth = spans.iter().fold(depth, |d: u32, s| d.max(s.top_end).max(s.top));
    }
    if at != bytes.len() {
        return Err(Error::format(
            path,
            format!("byte {at}: the last of {nx} × {nz} columns ends here, but the file has {} bytes", bytes.len()),
        ));
    }
    let depth = if depth <= 64 && start == 0 { 64 } else { 256 };

    let dims = world_dims(path, [nx.into(), depth.into(), nz.into()], "")?;
    let mut columns = ColumnsBuilder::new(dims[0], dims[1], dims[2]);
    let mut offsets = Vec::with_capacity(claimed as usize + 1);
    let mut entries: Vec<(u16, Rgb)> = Vec::new();
    offsets.push(0u32);
    let mut at = start;
    for column in 0..claimed {
        at = walk_column(bytes, at, &mut spans).map_err(|what| place(path, nx, column, what))?;
        // From the lowest span up: z down becomes y up.
        for (i, span) in spans.iter().enumerate().rev() {
            let end = spans.get(i + 1).map_or(depth, |below| below.air);
            if span.top < end {
                columns.push_run(Run::new((depth - end) as u16, (depth - 1 - span.top) as u16));
            }
            let n_top = (span.top_end - span.top) as usize;
            let n_bottom = span.n.saturating_sub(1 + n_top) as u32;
            let color = |k: usize| {
                let at = span.at + 4 + 4 * k;
                [bytes[at + 2], bytes[at + 1], bytes[at]]
            };
            let bottom = (0..n_bottom).rev().map(|k| (end - n_bottom + k, color(n_top + k as usize)));
            let top = (0..n_top).rev().map(|k| (span.top + k as u32, color(k)));
            entries.extend(bottom.chain(top).map(|(z, rgb)| ((depth - 1 - z) as u16, rgb)));
        }
        columns.end_column();
        offsets.push(entries.len() as u32);
    }
    let variant = if start == 0 { "Ace of Spades vxl (no header)" } else { "Voxlap vxl" };
    let about = About {
        axes: "x is x, y is z, z points down".to_owned(),
        rule: format!("{} coloured voxels, all below a column's last span solid", entries.len()),
        ..About::new(Kind::Model, variant)
    };
    let input = Input { columns: columns.finish(), colors: Colors::Voxel { offsets, entries }, notes: Vec::new() };
    Ok(InMemory::new(input).about(about))
}

fn place(path: &Path, nx: u32, column: u64, (at, what): (usize, String)) -> Error {
    Error::format(path, format!("byte {at}, column ({}, {}): {what}", column % u64::from(nx), column / u64::from(nx)))
}

/// Reads the spans of the column at byte `at`, top to bottom, proves that they ascend and lie in the file, and
/// returns where the next column starts.
fn walk_column(bytes: &[u8], mut at: usize, spans: &mut Vec<Span>) -> Result<usize, (usize, String)> {
    spans.clear();
    loop {
        let Some(&[n, s, e, a]) = bytes.get(at..at + 4) else {
            return Err((
                at,
                "the file ends inside a column; it is cut off, or has other sides than assumed".to_owned(),
            ));
        };
        // Files say "no top colours" as E = S − 1, in bytes: S = 0 gives E = 255. Only in a last span (N = 0) can that
        // be 256 colours as well, and then it is.
        let (n, top) = (usize::from(n), u32::from(s));
        let top_end = if e == s.wrapping_sub(1) && (n != 0 || s != 0) { top } else { u32::from(e) + 1 };
        let span = Span { at, n, top, top_end, air: u32::from(a) };
        let fail = |what: String| Err((at, format!("span [N={n} S={s} E={e} A={a}]: {what}")));
        if span.top_end < span.top {
            return fail("E is above S − 1".to_owned());
        }
        let n_top = (span.top_end - span.top) as usize;
        if let Some(&Span { at: above_at, n: above_n, top: above_top, top_end: above_end, .. }) = spans.last() {
            let n_bottom = (above_n - 1 - (above_end - above_top) as usize) as u32;
            if span.air > span.top || span.air < above_end + n_bottom {
                return fail(format!(
                    "air from A to S must start at {} or below, under the span at byte {above_at}, and end at S",
                    above_end + n_bottom
                ));
            }
        }
        if n != 0 && n - 1 < n_top {
            return fail(format!("N leaves no room for {n_top} top colours"));
        }
        let len = if n == 0 { 4 + 4 * n_top } else { 4 * n };
        if bytes.len() - at < len {
            return Err((at, format!("a span of {len} bytes reaches past the end of the file ({})", bytes.len())));
        }
        spans.push(span);
        at += len;
        if n == 0 {
            return Ok(at);
        }
    }
}
