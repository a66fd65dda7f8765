//! Volumes of the program binvox (`.binvox`), which voxelises meshes.
//!
//! ```text
//! #binvox 1 | dim D H W | translate X Y Z | scale S | data, each a line     then [u8 value, u8 count]…
//! ```
//! y runs fastest, then z, then x: voxel number x·H·W + z·W + y, so that D is the side along x, H along z and W along y. binvox
//! itself writes cubes. A voxel's centre lies at S·(i + ½)/side + T. Axes are those of the mesh: y up unless `--up` says
//! otherwise. In version 2 solid voxels may have any value but 0. Source: Patrick Min's description of the format and its reference reader.

use std::path::Path;

use super::{ReadOptions, Up, world_dims};
use crate::model::about::Kind;
use crate::model::pieces::InMemory;
use crate::{About, Colors, Columns, Error, Input, Result};

/// Lines of a header.
const MAX_LINES: usize = 100;

pub(super) fn read(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<InMemory> {
    let (mut at, mut dims, mut translate, mut scale) = (0, None, [0.0; 3], 1.0);
    let mut left_out = Vec::new();
    for line_ix in 0.. {
        let fail = |what: String| Err(Error::format(path, format!("byte {at}: {what}")));
        let Some(len) = bytes[at..].iter().position(|&b| b == b'\n').filter(|_| line_ix < MAX_LINES) else {
            return fail("the header has no line \"data\"".to_owned());
        };
        let line = String::from_utf8_lossy(&bytes[at..at + len]).into_owned();
        let words: Vec<&str> = line.split_whitespace().collect();
        fn three<T: std::str::FromStr + Copy>(words: &[&str]) -> Option<[T; 3]> {
            let values: Vec<T> = words.iter().map(|w| w.parse().ok()).collect::<Option<_>>()?;
            values.try_into().ok()
        }
        match words.as_slice() {
            ["#binvox", version] if line_ix == 0 => {
                if !matches!(*version, "1" | "2") {
                    return fail(format!("version {version} of binvox; 1 and 2 are read"));
                }
            }
            _ if line_ix == 0 => return fail("expected \"#binvox 1\"".to_owned()),
            ["dim", sides @ ..] => match three::<u32>(sides) {
                Some(sides) if !sides.contains(&0) => dims = Some(sides.map(u64::from)),
                _ => return fail(format!("{line:?}: expected three sides of at least 1")),
            },
            ["translate", values @ ..] => match three(values) {
                Some(values) => translate = values,
                None => return fail(format!("{line:?}: expected three numbers")),
            },
            ["scale", value] => match value.parse::<f64>() {
                Ok(value) => scale = value,
                Err(_) => return fail(format!("{line:?}: expected a number")),
            },
            ["data"] => {
                at += len + 1;
                break;
            }
            [] => {}
            [word, ..] if word.starts_with('#') => {}
            _ => left_out.push(format!("the header's line {line:?}")),
        }
        at += len + 1;
    }
    let Some([d, h, w]) = dims else { return Err(Error::format(path, "binvox: the header has no line \"dim\"")) };
    let data = &bytes[at..];
    let cells = d.checked_mul(h).and_then(|n| n.checked_mul(w));
    let Some(cells) = cells.filter(|&n| n <= 255 * (data.len() as u64 / 2)) else {
        let what = format!("{d} × {h} × {w} voxels, {} bytes hold at most 255 in two", data.len());
        return Err(Error::format(path, format!("byte {at}: {what}; it was cut short or is damaged")));
    };

    let mut solid = vec![0u64; cells.div_ceil(64) as usize];
    let (mut n, mut values) = (0u64, [false; 256]);
    for (i, pair) in data.chunks(2).enumerate() {
        let here = at + 2 * i;
        let &[value, count] = pair else {
            return Err(Error::format(path, format!("byte {here}: a value without a count")));
        };
        let end = n + u64::from(count);
        if end > cells {
            return Err(Error::format(path, format!("byte {here}: {end} voxels, {d} × {h} × {w} are {cells}")));
        }
        if value != 0 {
            (n..end).for_each(|v| solid[(v / 64) as usize] |= 1 << (v % 64));
        }
        values[usize::from(value)] |= count > 0;
        n = end;
    }
    if n < cells {
        let end = bytes.len();
        return Err(Error::format(path, format!("byte {end}: the file ends after {n} of {cells} voxels")));
    }
    let sides = [d, w, h];
    let up = opts.up.unwrap_or_default();
    // Which axis of the file each axis of the world is.
    let axes = match up {
        Up::X => [2, 0, 1],
        Up::Y => [0, 1, 2],
        Up::Z => [0, 2, 1],
    };
    let dims = world_dims(path, axes.map(|a| sides[a]), "choose another axis with --up x, y or z")?;
    let columns = Columns::from_fn(dims[0], dims[1], dims[2], |x, y, z| {
        let z = if up == Up::Z { dims[2] - 1 - z } else { z };
        let mut p = [0; 3];
        axes.iter().zip([x, y, z]).for_each(|(&axis, v)| p[axis] = u64::from(v));
        let v = p[0] * h * w + p[2] * w + p[1];
        solid[(v / 64) as usize] >> (v % 64) & 1 == 1
    });
    let side = sides.map(|n| scale / n as f64);
    let mut affine = [[0.0; 4]; 3];
    for (world, &axis) in axes.iter().enumerate() {
        let turned = up == Up::Z && world == 2;
        affine[axis][world] = if turned { -side[axis] } else { side[axis] };
        affine[axis][3] = translate[axis] + if turned { scale } else { 0.0 };
    }
    let indices = values[2..].iter().any(|&v| v);
    let mut rule = if indices { "solid where not 0" } else { "solid where 1" }.to_owned();
    if h != w {
        rule += &format!("; sides {d}, {h}, {w} differ, which the format does not foresee: they are read as x, z, y");
    }
    let about = About {
        axes: match up {
            Up::X => "x is up",
            Up::Y => "y is up",
            Up::Z => "z is up",
        }
        .to_owned(),
        voxel: Some(axes.map(|a| side[a])),
        affine: Some(affine),
        rule,
        left_out,
        ..About::new(Kind::Volume, "binvox")
    };
    Ok(InMemory::new(Input { columns, colors: Colors::None, notes: Vec::new() }).about(about))
}
