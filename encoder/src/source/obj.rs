//! Wavefront OBJ, with vertex colours or the diffuse colours of its materials, and with their pictures.
//!
//! Polygons alone: lines, points, curves and surfaces are named and left out.

use std::collections::HashMap;
use std::path::Path;

use super::mesh::{Mesh, PLAIN, Paint};
use super::text::{Lines, number, shown, without_bom, words};
use super::texture::{Texture, Textures, Wrap};
use crate::{Error, Result, Rgb};

/// Instead of the number of a place on a picture, or of a material.
const NONE: u32 = u32::MAX;

/// What the statements of a file say, in its own numbers from 0.
#[derive(Default)]
struct Statements {
    positions: Vec<[f64; 3]>,
    /// One a position up to the last that has one.
    colors: Vec<Option<[f64; 3]>>,
    places: Vec<[f64; 2]>,
    /// Corners of all faces: position and place.
    corners: Vec<[u32; 2]>,
    /// Of each face the end of its corners, its material, and where in the file it stands.
    faces: Vec<(u32, u32, u64)>,
    /// Names of materials, in the order of their first use.
    materials: Vec<String>,
    libraries: Vec<String>,
    left_out: Vec<String>,
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let all = statements(path, without_bom(path, bytes)?, bytes)?;
    let mut mesh = Mesh::new("Wavefront OBJ");
    mesh.about.left_out = all.left_out.clone();
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut library = HashMap::new();
    for name in &all.libraries {
        if let Err(e) = materials(folder, name, &mut library) {
            mesh.about.left_out.push(format!("materials are left out: {e}"));
        }
    }
    let unknown: Vec<&str> =
        all.materials.iter().map(String::as_str).filter(|name| !library.contains_key(*name)).collect();
    if !unknown.is_empty() && !library.is_empty() {
        let names: Vec<String> = unknown.iter().take(3).map(|name| shown(name.as_bytes())).collect();
        let more = if unknown.len() > 3 { ", …" } else { "" };
        mesh.about.left_out.push(format!("materials that no library has: {}{more}", names.join(", ")));
    }
    let mut textures = Textures::default();
    let used: Vec<Option<Material>> = all.materials.iter().map(|name| library.remove(name)).collect();
    let clear = used.iter().flatten().filter(|m| m.clear).count();
    if clear > 0 {
        mesh.about.left_out.push(format!("transparency of {clear} materials"));
    }
    let looks: Vec<Look> = used
        .iter()
        .map(|m| m.as_ref().map_or_else(Look::default, |m| m.look(folder, &mut mesh, &mut textures)))
        .collect();
    build(path, all, &looks, mesh)
}

/// How the faces of a material look.
#[derive(Clone, Copy)]
struct Look {
    color: Option<Rgb>,
    paint: u32,
    scale: [f64; 2],
    offset: [f64; 2],
}

impl Default for Look {
    fn default() -> Look {
        Look { color: None, paint: PLAIN, scale: [1.0; 2], offset: [0.0; 2] }
    }
}

fn byte(v: f64) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0).round() as u8
}

fn build(path: &Path, all: Statements, looks: &[Look], mut mesh: Mesh) -> Result<Mesh> {
    let n = all.positions.len();
    mesh.positions = all.positions;
    let mut colors = all.colors;
    let white = colors.iter().flatten().flatten().fold(1.0, |a: f64, &v| a.max(v));
    let any = !colors.is_empty() || looks.iter().any(|look| look.color.is_some());
    if !colors.is_empty() {
        // Some writers take 255 for white, though 1 is.
        let white = if white > 1.0 { 255.0 } else { 1.0 };
        colors.resize(n, None);
        mesh.colors = colors.iter().map(|c| c.map_or([200; 3], |c| c.map(|v| byte(v / white)))).collect();
    }
    let mut placed: HashMap<[u32; 3], u32> = HashMap::new();
    let mut uvs: Vec<[f32; 2]> = Vec::new();
    let (mut from, mut bare, mut corners) = (0, 0u64, Vec::new());
    for (i, &(end, material, at)) in all.faces.iter().enumerate() {
        let own = &all.corners[from as usize..end as usize];
        from = end;
        let look = looks.get(material as usize).copied().unwrap_or_default();
        let outside = |what: &str, index: u32, n: usize| {
            Err(Error::format(path, format!("byte {at}: face {}: {what} {} of {n}", i + 1, u64::from(index) + 1)))
        };
        corners.clear();
        let laid = look.paint != PLAIN && own.iter().all(|c| c[1] != NONE);
        bare += u64::from(look.paint != PLAIN && !laid);
        for &[v, place] in own {
            if v as usize >= n {
                return outside("vertex", v, n);
            }
            if place != NONE && place as usize >= all.places.len() {
                return outside("texture coordinate", place, all.places.len());
            }
            corners.push(match laid {
                false => v,
                true => *placed.entry([v, place, look.paint]).or_insert_with(|| {
                    let uv = all.places[place as usize];
                    let [s, t] = [0, 1].map(|k| uv[k] * look.scale[k] + look.offset[k]);
                    uvs.push([s as f32, (1.0 - t) as f32]);
                    mesh.positions.push(mesh.positions[v as usize]);
                    if let Some(&color) = mesh.colors.get(v as usize) {
                        mesh.colors.push(color);
                    }
                    mesh.positions.len() as u32 - 1
                }),
            });
        }
        let first = mesh.triangles.len();
        mesh.push_polygon(&corners);
        let colored = !colors.is_empty() && own.iter().all(|c| colors[c[0] as usize].is_some());
        let color = if colored || !any { None } else { Some(look.color.unwrap_or([200; 3])) };
        mesh.mark(first, color, if laid { look.paint } else { PLAIN });
    }
    if bare > 0 {
        mesh.about.left_out.push(format!("pictures on {bare} faces without texture coordinates"));
    }
    if !uvs.is_empty() {
        mesh.lay(n, uvs.into_iter());
    }
    Ok(mesh.finish())
}

fn statements(path: &Path, text: &[u8], bytes: &[u8]) -> Result<Statements> {
    let before = bytes.len() - text.len();
    let mut all = Statements::default();
    let mut lines = Lines::new(text, true);
    let mut numbers: HashMap<String, u32> = HashMap::new();
    let mut material = NONE;
    let (mut drawn, mut curved, mut unknown) = (0u64, 0u64, None);
    let mut n_unknown = 0u64;
    while let Some((at, line)) = lines.next() {
        let at = at + before;
        let mut of = words(line).take_while(|word| !word.starts_with(b"#"));
        let Some(statement) = of.next() else { continue };
        let rest = line[statement.len()..].trim_ascii();
        let fail = |what: String| Error::format(path, format!("byte {at}: OBJ: {what} in {:?}", shown(line)));
        let value = |word: &[u8]| number(word).ok_or_else(|| fail(format!("{:?} is no number", shown(word))));
        match statement {
            b"v" => {
                let values: Vec<f64> = of.map(value).collect::<Result<_>>()?;
                let [x, y, z, more @ ..] = values.as_slice() else {
                    return Err(fail("fewer than three numbers".to_owned()));
                };
                if let [r, g, b, ..] = *more {
                    all.colors.resize(all.positions.len(), None);
                    all.colors.push(Some([r, g, b]));
                }
                all.positions.push([*x, *y, *z]);
            }
            b"vt" => {
                let mut values = of.map(value);
                let u = values.next().unwrap_or_else(|| Err(fail("no number".to_owned())))?;
                all.places.push([u, values.next().unwrap_or(Ok(0.0))?]);
            }
            b"f" | b"fo" => {
                for word in of {
                    let mut parts = word.split(|&b| b == b'/');
                    let mut index = |n: usize| match parts.next().filter(|part| !part.is_empty()) {
                        None => Ok(NONE),
                        Some(part) => index(part, n).ok_or_else(|| {
                            fail(format!("{:?} is none of the numbers 1 to {n} or −1 to −{n}", shown(part)))
                        }),
                    };
                    let corner = [index(all.positions.len())?, index(all.places.len())?];
                    if corner[0] == NONE {
                        return Err(fail("a corner without a vertex".to_owned()));
                    }
                    all.corners.push(corner);
                }
                let end = u32::try_from(all.corners.len());
                let end =
                    end.map_err(|_| Error::Limit(format!("{}: more corners than can be held", path.display())))?;
                all.faces.push((end, material, at as u64));
            }
            b"usemtl" => {
                material = NONE;
                let name = String::from_utf8_lossy(rest).into_owned();
                if !name.is_empty() {
                    material = *numbers.entry(name).or_insert_with_key(|name| {
                        all.materials.push(name.clone());
                        all.materials.len() as u32 - 1
                    });
                }
            }
            b"mtllib" if !rest.is_empty() => {
                let name = String::from_utf8_lossy(rest).into_owned();
                if !all.libraries.contains(&name) {
                    all.libraries.push(name);
                }
            }
            b"l" | b"p" => drawn += 1,
            b"curv" | b"curv2" | b"surf" => curved += 1,
            b"vn" | b"g" | b"o" | b"s" | b"mg" | b"mtllib" | b"vp" | b"cstype" | b"deg" | b"bmat" | b"step"
            | b"parm" | b"trim" | b"hole" | b"scrv" | b"sp" | b"end" | b"con" | b"bevel" | b"c_interp"
            | b"d_interp" | b"lod" | b"shadow_obj" | b"trace_obj" | b"ctech" | b"stech" | b"usemap" | b"maplib" => {}
            _ => {
                n_unknown += 1;
                unknown.get_or_insert_with(|| format!("the first at byte {at}: {:?}", shown(line)));
            }
        }
    }
    if drawn > 0 {
        all.left_out.push(format!("{drawn} lines and points"));
    }
    if curved > 0 {
        all.left_out.push(format!("{curved} curves and surfaces"));
    }
    if let Some(first) = unknown {
        all.left_out.push(format!("{n_unknown} statements that are not known, {first}"));
    }
    Ok(all)
}

/// The number, from 0, of a word that counts from 1, or where it is negative back from the `n` that there are so far.
fn index(word: &[u8], n: usize) -> Option<u32> {
    let i: i64 = number(word)?;
    let i = match i {
        1.. => i - 1,
        0 => return None,
        _ => n as i64 + i,
    };
    u32::try_from(i).ok().filter(|&i| i != NONE)
}

#[derive(Clone, Default)]
struct Material {
    diffuse: Option<[f64; 3]>,
    picture: Option<Picture>,
    /// Whether light goes through it.
    clear: bool,
}

#[derive(Clone)]
struct Picture {
    name: String,
    scale: [f64; 2],
    offset: [f64; 2],
    clamp: bool,
}

impl Material {
    fn look(&self, folder: &Path, mesh: &mut Mesh, textures: &mut Textures) -> Look {
        let mut look = Look { color: self.diffuse.map(|c| c.map(byte)), ..Look::default() };
        let Some(Picture { name, scale, offset, clamp }) = &self.picture else { return look };
        let wrap = [if *clamp { Wrap::Clamp } else { Wrap::Repeat }; 2];
        let file = folder.join(name);
        let texture =
            textures.number(mesh, name.clone(), wrap, false, || Texture::read(&file, &super::map(&file)?, wrap, false));
        if let Some(texture) = texture {
            // Many writers leave the diffuse colour of what has a picture black.
            look.color = Some(look.color.filter(|&c| c != [0; 3]).unwrap_or([255; 3]));
            look.paint = mesh.paint(Paint { texture: Some(texture), cutoff: None });
            (look.scale, look.offset) = (*scale, *offset);
        }
        look
    }
}

/// Adds the materials of a library, or of several whose names stand one after the other.
fn materials(folder: &Path, names: &str, to: &mut HashMap<String, Material>) -> Result<()> {
    let file = |name: &str| folder.join(name.replace('\\', "/"));
    // A name may have blanks in it.
    let names = if names.contains(' ') && !file(names).is_file() {
        words(names.as_bytes()).collect()
    } else {
        vec![names.as_bytes()]
    };
    let mut failed = None;
    for name in names {
        let path = file(&String::from_utf8_lossy(name));
        if let Err(e) = super::map(&path).and_then(|bytes| library(&path, &bytes, to)) {
            failed.get_or_insert(e);
        }
    }
    failed.map_or(Ok(()), Err)
}

fn library(path: &Path, bytes: &[u8], to: &mut HashMap<String, Material>) -> Result<()> {
    let text = without_bom(path, bytes)?;
    let mut lines = Lines::new(text, true);
    let mut current: Option<(String, Material)> = None;
    while let Some((at, line)) = lines.next() {
        let statement = words(line).next().unwrap_or_default();
        let rest = line[statement.len()..].trim_ascii();
        let fail = || {
            let at = at + bytes.len() - text.len();
            Error::format(path, format!("byte {at}: MTL: {:?} is not understood", shown(line)))
        };
        // Some writers have keywords in capitals or small letters throughout.
        let statement = statement.to_ascii_lowercase();
        if statement == b"newmtl" {
            to.extend(current.replace((String::from_utf8_lossy(rest).into_owned(), Material::default())));
            continue;
        }
        let Some((_, material)) = &mut current else { continue };
        let one = || words(rest).next().and_then(number::<f64>);
        match statement.as_slice() {
            b"kd" => {
                let mut of = words(rest).peekable();
                match of.peek() {
                    // Spectra and CIE XYZ, which hardly anybody writes.
                    Some(&b"spectral" | &b"xyz") => continue,
                    _ => {
                        let values: Option<Vec<f64>> = of.take_while(|w| !w.starts_with(b"#")).map(number).collect();
                        let values = values.filter(|v| v.iter().all(|v| v.is_finite())).ok_or_else(fail)?;
                        material.diffuse = Some(match values.as_slice() {
                            [r, g, b, ..] => [*r, *g, *b],
                            [grey] => [*grey; 3],
                            _ => return Err(fail()),
                        });
                    }
                }
            }
            b"d" => material.clear |= one().is_some_and(|d| d < 1.0),
            b"tr" => material.clear |= one().is_some_and(|t| t > 0.0 && t < 1.0),
            b"map_d" => material.clear = true,
            b"map_kd" => material.picture = picture(rest),
            _ => {}
        }
    }
    to.extend(current);
    Ok(())
}

/// What stands behind `map_Kd`: options, then a name that may have blanks in it.
fn picture(rest: &[u8]) -> Option<Picture> {
    let mut picture = Picture { name: String::new(), scale: [1.0; 2], offset: [0.0; 2], clamp: false };
    let mut rest = rest;
    let word = |rest: &[u8]| -> usize { rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()) };
    while rest.starts_with(b"-") {
        let len = word(rest);
        let option = &rest[..len];
        let (fewest, most) = match option {
            b"-blendu" | b"-blendv" | b"-cc" | b"-clamp" | b"-texres" | b"-bm" | b"-imfchan" | b"-type" | b"-boost" => {
                (1, 1)
            }
            b"-mm" => (2, 2),
            b"-o" | b"-s" | b"-t" => (1, 3),
            _ => break,
        };
        rest = rest[len..].trim_ascii_start();
        let mut values = [None; 3];
        for (i, value) in values.iter_mut().enumerate().take(most) {
            let len = word(rest);
            let v = number::<f64>(&rest[..len]);
            // What is no number, where there may be fewer, is the name.
            if i >= fewest && v.is_none() {
                break;
            }
            if option == b"-clamp" {
                picture.clamp = rest[..len].eq_ignore_ascii_case(b"on");
            }
            *value = v;
            rest = rest[len..].trim_ascii_start();
        }
        let to = match option {
            b"-s" => &mut picture.scale,
            b"-o" => &mut picture.offset,
            _ => continue,
        };
        for (to, v) in to.iter_mut().zip(values) {
            *to = v.filter(|v| v.is_finite()).unwrap_or(*to);
        }
    }
    picture.name = String::from_utf8_lossy(rest).replace('\\', "/");
    (!rest.is_empty()).then_some(picture)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_have_options_and_blanks_in_their_names() {
        let read = |text: &str| picture(text.as_bytes()).map(|p| (p.name, p.scale, p.offset, p.clamp));
        let plain = |name: &str| Some((name.to_owned(), [1.0; 2], [0.0; 2], false));
        assert_eq!(read("a b.png"), plain("a b.png"));
        assert_eq!(read("a\\b.png"), plain("a/b.png"));
        assert_eq!(read("-bm 1 -mm 0 1 a.png"), plain("a.png"));
        assert_eq!(read("-s 2 3 1 -o .5 a b.png"), Some(("a b.png".to_owned(), [2.0, 3.0], [0.5, 0.0], false)));
        assert_eq!(read("-clamp on a.png"), Some(("a.png".to_owned(), [1.0; 2], [0.0; 2], true)));
        assert_eq!(read("-odd.png"), plain("-odd.png"));
        assert_eq!(read("-s 1 1"), None);
    }
}
