//! Models of voxel editors.

use std::collections::BTreeMap;

use super::*;

/// What is said of a file.
pub(super) fn about(name: &str, bytes: &[u8], flags: &str) -> About {
    match find(Path::new(name), bytes, false, &opts(flags)).map_err(|e| e.to_string()).unwrap() {
        World::Volume(volume) => volume.about,
        World::Pieces(pieces) => pieces.about(),
    }
}

/// Voxels of the world with their colours.
fn voxels(input: &Input) -> BTreeMap<[u32; 3], Option<Rgb>> {
    let c = &input.columns;
    let mut out = BTreeMap::new();
    for (x, z) in (0..c.nz()).flat_map(|z| (0..c.nx()).map(move |x| (x, z))) {
        let ys = c.column(x, z).iter().flat_map(|r| u32::from(r.first())..r.end());
        out.extend(ys.map(|y| ([x, y, z], None)));
        if let Colors::Voxel { offsets, entries } = &input.colors {
            let ix = c.index(x, z);
            for &(y, color) in &entries[offsets[ix] as usize..offsets[ix + 1] as usize] {
                out.insert([x, y.into(), z], Some(color));
            }
        }
    }
    out
}

#[test]
fn vox_color_0_is_no_voxel() {
    let bytes = vox_file(&[model([3, 1, 1], &[[0, 0, 0, 94], [1, 0, 0, 0], [2, 0, 0, 89]])]);
    let input = read("hole.vox", &bytes, "");
    assert_eq!(input.columns.dims(), [3, 1, 1]);
    // Of the palette that is used where none is stored: 216 colours in steps of 0x33 from white on, the first at 1.
    let color = |i: u32| [5 - (i - 1) % 6, 5 - (i - 1) / 6 % 6, 5 - (i - 1) / 36].map(|v| v as u8 * 0x33);
    let expected = [([0, 0, 0], Some(color(94))), ([2, 0, 0], Some(color(89)))];
    let sorted = |c: Option<Rgb>| c.map(|mut c| (c.sort_unstable(), c).1);
    let got: Vec<_> = voxels(&input).into_iter().map(|(p, c)| (p, sorted(c))).collect();
    assert_eq!(got, expected.map(|(p, c)| (p, sorted(c))));
    assert_eq!(about("hole.vox", &bytes, "").left_out, ["1 voxels of colour 0, which is none"]);
}

#[test]
fn vox_frames_are_chosen_by_their_number_for_place_and_model_alike() {
    let frames = |frames: &[&[(&str, &str)]]| {
        let all: Vec<u8> = frames.iter().flat_map(|f| dict(f)).collect();
        chunk("nTRN", &[words(&[0]), dict(&[]), words(&[1, u32::MAX, 0, frames.len() as u32]), all].concat())
    };
    let models = |models: &[(u32, &[(&str, &str)])]| {
        let all: Vec<u8> = models.iter().flat_map(|(m, f)| [words(&[*m]), dict(f)].concat()).collect();
        chunk("nSHP", &[words(&[1]), dict(&[]), words(&[models.len() as u32]), all].concat())
    };
    let file = |order: [usize; 2]| {
        let moves: [&[(&str, &str)]; 2] = [&[("_t", "0 0 7"), ("_f", "3")], &[("_r", "17"), ("_f", "0")]];
        let shows: [(u32, &[(&str, &str)]); 2] = [(0, &[("_f", "4")]), (1, &[("_f", "2")])];
        vox_file(&[
            model([1, 1, 1], &[[0, 0, 0, 1]]),
            model([3, 1, 1], &[[0, 0, 0, 2], [2, 0, 0, 3]]),
            frames(&order.map(|i| moves[i])),
            models(&order.map(|i| shows[i])),
            palette(),
        ])
    };
    for order in [[0, 1], [1, 0]] {
        // 17 makes x of the model y of the scene.
        let input = read("a.vox", &file(order), "");
        assert_eq!(input.columns.dims(), [1, 1, 3], "{order:?}");
        assert_eq!(cells(&input), [([0, 0, 0], G), ([0, 2, 0], B)], "{order:?}");
        assert_eq!(about("a.vox", &file(order), "").left_out, ["2 later frames of 2 animated nodes"]);
    }
    let pack = vox_file(&[model([1, 1, 1], &[[0, 0, 0, 1]]), model([2, 2, 2], &[]), palette()]);
    assert!(about("a.vox", &pack, "").left_out[0].contains("1 models after the first"));
}

#[test]
fn vox_glass_is_a_surface_and_media_are_matter() {
    let material = |id: u32, of: &[(&str, &str)]| chunk("MATL", &[words(&[id]), dict(of)].concat());
    let bytes = vox_file(&[
        model([3, 1, 2], &[[0, 0, 0, 1], [1, 0, 0, 2], [2, 0, 1, 3]]),
        palette(),
        material(1, &[("_type", "_diffuse"), ("_trans", "0.9")]),
        material(2, &[("_type", "_glass"), ("_trans", "0.75")]),
        material(3, &[("_type", "_media"), ("_media_type", "_emit"), ("_d", "0.125")]),
    ]);
    assert_eq!(cells(&read("g.vox", &bytes, "")), [([0, 0, 0], R)]);
    let World::Pieces(pieces) = find(Path::new("g.vox"), &bytes, false, &opts("")).unwrap() else { panic!() };
    let matter = pieces.matter(0..3, 0..1).unwrap().unwrap();
    assert_eq!([matter.at(0, 0, 0), matter.at(1, 0, 0), matter.at(2, 0, 0), matter.at(2, 1, 0)], [0, 8, 0, 16]);
    let classes = pieces.about().classes.unwrap();
    use crate::model::matter::Mode;
    let found: Vec<_> = classes.classes.iter().map(|c| (c.color, c.opacity, c.mode)).collect();
    assert_eq!(found, [(G, 0.25, Mode::Surface), (B, 0.125, Mode::Emissive)]);
}

#[test]
fn water_stands_at_its_height_in_the_unit_of_the_values() {
    let map = png(image::GrayImage::from_raw(2, 1, vec![10, 40]).unwrap());
    let world = |flags: &str| open_pieces(&file("m.png", &map).1, &opts(flags)).unwrap();
    let lake = world("--height-scale 0.5 --water 30");
    // Heights are 0.5 a unit: 6 and 21 voxels of ground, water up to 16.
    let matter = lake.matter(0..2, 0..1).unwrap().unwrap();
    let deep: Vec<u32> = (0..lake.dims()[1]).filter(|&y| matter.at(0, y, 0) > 0).collect();
    assert_eq!(deep, (6..16).collect::<Vec<_>>());
    assert!(matter.column(1).is_empty());
    assert_eq!(world("--height-scale 0.5 --water 60").dims()[1], 31);
    assert!(world("").about().classes.is_none());
}

// Ken Silverman's formats: x 5, y 5, z 9 with z down; solid but for a notch, a cavity and two voxels of air on top.

const SIDES: [usize; 3] = [5, 5, 9];

fn solid([x, y, z]: [usize; 3]) -> bool {
    let cavity = x == 2 && y == 2 && z == 3;
    let notch = x == 4 && y == 0 && z > 2;
    z > 1 - usize::from(x == 0) && !cavity && !notch
}

/// Faces in sight from outside the voxel: left, right, front, back, above, below.
fn faces(p: [usize; 3]) -> u8 {
    let near = |axis: usize, step: isize| {
        let v = p[axis] as isize + step;
        let mut q = p;
        q[axis] = v as usize;
        v >= 0 && v < SIDES[axis] as isize && solid(q)
    };
    let sides = [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)];
    sides.iter().enumerate().map(|(bit, &(axis, step))| u8::from(!near(axis, step)) << bit).sum()
}

fn index([x, y, z]: [usize; 3]) -> u8 {
    (1 + x + 5 * y + 25 * z) as u8
}

fn small_palette() -> Vec<u8> {
    (0..256).flat_map(|i: usize| [i % 64, (i / 2) % 64, 63 - i % 64]).map(|v| v as u8).collect()
}

fn color_of(index: u8) -> Rgb {
    let i = usize::from(index);
    [i % 64, (i / 2) % 64, 63 - i % 64].map(|v| 4 * v as u8)
}

fn columns_of_surface() -> impl Iterator<Item = ([usize; 2], Vec<usize>)> {
    let [nx, ny, nz] = SIDES;
    (0..nx)
        .flat_map(move |x| (0..ny).map(move |y| [x, y]))
        .map(move |[x, y]| ([x, y], (0..nz).filter(|&z| solid([x, y, z]) && faces([x, y, z]) != 0).collect()))
}

fn sizes() -> Vec<u8> {
    words(&SIDES.map(|n| n as u32))
}

fn kv6_file() -> Vec<u8> {
    let (mut voxels, mut lens, mut xlens) = (Vec::new(), Vec::new(), vec![0u32; SIDES[0]]);
    for ([x, y], zs) in columns_of_surface() {
        for &z in &zs {
            let [r, g, b] = color_of(index([x, y, z]));
            voxels.extend([b, g, r, 128, z as u8, 0, faces([x, y, z]), 0]);
        }
        lens.extend((zs.len() as u16).to_le_bytes());
        xlens[x] += zs.len() as u32;
    }
    let n = words(&[voxels.len() as u32 / 8]);
    [b"Kvxl".to_vec(), sizes(), vec![0; 12], n, voxels, words(&xlens), lens].concat()
}

fn kvx_file(more: &[u8]) -> Vec<u8> {
    let [nx, ny, _] = SIDES;
    let (mut slabs, mut xs, mut xys) = (Vec::new(), Vec::new(), Vec::new());
    let tables = 4 * (nx + 1) + 2 * nx * (ny + 1);
    let mut of_x = 0;
    for ([x, y], zs) in columns_of_surface() {
        if y == 0 {
            of_x = slabs.len();
            xs.push((tables + of_x) as u32);
        }
        xys.extend(((slabs.len() - of_x) as u16).to_le_bytes());
        for run in zs.chunk_by(|a, b| b - a == 1) {
            let all = run.iter().fold(0, |all, &z| all | faces([x, y, z]) & 15);
            let ends = faces([x, y, run[0]]) & 16 | faces([x, y, run[run.len() - 1]]) & 32;
            slabs.extend([run[0] as u8, run.len() as u8, all | ends]);
            slabs.extend(run.iter().map(|&z| index([x, y, z])));
        }
        if y == ny - 1 {
            xys.extend(((slabs.len() - of_x) as u16).to_le_bytes());
        }
    }
    xs.push((tables + slabs.len()) as u32);
    let level = [sizes(), vec![0; 12], words(&xs), xys, slabs].concat();
    [words(&[level.len() as u32]), level, more.to_vec(), small_palette()].concat()
}

fn slab6_file() -> Vec<u8> {
    let [nx, ny, nz] = SIDES;
    let voxel = |p| if solid(p) { index(p) } else { 255 };
    let voxels = (0..nx * ny * nz).map(|i| voxel([i / nz / ny, i / nz % ny, i % nz])).collect();
    [sizes(), voxels, small_palette()].concat()
}

#[test]
fn kv6_kvx_and_slab6_vox_hold_the_same_model() {
    let dense = read("m.vox", &slab6_file(), "");
    assert_eq!(dense.columns.dims(), [5, 9, 5]);
    for (x, y, z) in (0..9).flat_map(|z| (0..5).flat_map(move |y| (0..5).map(move |x| (x, y, z)))) {
        let here = dense.columns.solid(x as i64, 8 - z as i64, y as i64);
        assert_eq!(here, solid([x, y, z]), "({x}, {y}, {z})");
    }
    let dense = voxels(&dense);
    assert!(dense.keys().any(|&[x, y, z]| faces([x as usize, z as usize, 8 - y as usize]) == 0), "there is an inside");
    assert_eq!(dense[&[0, 7, 0]], Some(color_of(index([0, 0, 1]))));
    for (name, bytes) in [("m.kv6", kv6_file()), ("m.kvx", kvx_file(&[]))] {
        let got = voxels(&read(name, &bytes, ""));
        assert_eq!(got.keys().collect::<Vec<_>>(), dense.keys().collect::<Vec<_>>(), "{name}: insides are filled");
        for (p, color) in &got {
            let [x, y, z] = p.map(|v| v as usize);
            let in_sight = faces([x, z, 8 - y]) != 0;
            assert_eq!(*color, in_sight.then(|| dense[p].unwrap()), "{name}: {p:?}");
        }
    }
}

#[test]
fn kv6_and_kvx_say_what_they_leave_out_and_fill() {
    let level = [words(&[24]), words(&[1, 1, 1]), vec![0; 12]].concat();
    let told = about("m.kvx", &kvx_file(&[level, vec![9; 2]].concat()), "");
    assert_eq!(told.left_out, ["1 coarser levels", "2 bytes before the palette"]);
    let told = about("m.kv6", &[kv6_file(), b"SPal".to_vec(), vec![0; 768]].concat(), "");
    assert!(told.left_out.is_empty() && told.rule.contains("inside"), "{told}");
    // Writers that say nothing of faces: nothing is filled.
    let mut blind = kv6_file();
    let n = u32::from_le_bytes(blind[28..32].try_into().unwrap()) as usize;
    (0..n).for_each(|i| blind[32 + 8 * i + 6] = 0);
    assert_eq!(read("m.kv6", &blind, "").columns.voxels(), n as u64);
    assert!(about("m.kv6", &blind, "").rule.contains("nothing is filled"));
}

#[test]
fn kv6_kvx_and_slab6_damage_is_an_error() {
    for (name, bytes) in [("m.kv6", kv6_file()), ("m.kvx", kvx_file(&[])), ("m.vox", slab6_file())] {
        refuses_every_prefix(name, &bytes, "");
        survives_changed_bytes(name, &bytes, "");
    }
    let mut far = kv6_file();
    far[36] = 9;
    assert!(error("m.kv6", &far, "").contains("has a voxel at z 9, the model is 9 high"));
    let mut short = kvx_file(&[]);
    short[28] += 1;
    assert!(error("m.kvx", &short, "").contains("byte 28: the first offset"));
    assert!(error("m.vox", &[7; 64], "").contains("Slab6"));
}

// Qubicle.

/// A matrix of that size at that place; voxels in the order of the file.
fn matrix(name: &str, size: [u32; 3], at: [i32; 3], voxels: &[u8]) -> Vec<u8> {
    let at = words(&at.map(|v| v as u32));
    [&[name.len() as u8][..], name.as_bytes(), &words(&size), &at, voxels].concat()
}

fn qb_file(flags: [u32; 4], matrices: &[Vec<u8>]) -> Vec<u8> {
    [words(&[257]), words(&flags), words(&[matrices.len() as u32]), matrices.concat()].concat()
}

const RED: [u8; 4] = [200, 1, 2, 255];
const LEAF: [u8; 4] = [3, 210, 4, 255];
const AIR: [u8; 4] = [9, 9, 9, 0];

#[test]
fn qb_matrices_lie_where_they_say_packed_or_not() {
    let raw = [RED, RED, RED, AIR, AIR, LEAF, LEAF, LEAF, LEAF, AIR, AIR, AIR].concat();
    let two = |u: u32| u.to_le_bytes().to_vec();
    let packed = [
        [two(2), two(3), RED.to_vec(), AIR.to_vec(), AIR.to_vec(), LEAF.to_vec(), two(6)].concat(),
        [two(2), two(3), LEAF.to_vec(), two(2), two(3), AIR.to_vec(), two(6)].concat(),
    ]
    .concat();
    let other = |voxel: Vec<u8>| matrix("b", [1, 1, 1], [-1, 0, -2], &voxel);
    let a = qb_file([0, 1, 0, 0], &[matrix("a", [3, 2, 2], [1, -1, 0], &raw), other(LEAF.to_vec())]);
    let b =
        qb_file([0, 1, 1, 1], &[matrix("a", [3, 2, 2], [1, -1, 0], &packed), other([LEAF.to_vec(), two(6)].concat())]);
    let (red, leaf) = (Some([200, 1, 2]), Some([3, 210, 4]));
    // The box is from (−1, −1, −2) to (3, 0, 1).
    let expected = BTreeMap::from([
        ([2, 0, 2], red),
        ([3, 0, 2], red),
        ([4, 0, 2], red),
        ([4, 1, 2], leaf),
        ([2, 0, 3], leaf),
        ([3, 0, 3], leaf),
        ([4, 0, 3], leaf),
        ([0, 1, 0], leaf),
    ]);
    for bytes in [&a, &b] {
        let input = read("m", bytes, "");
        assert_eq!((input.columns.dims(), voxels(&input)), ([5, 2, 4], expected.clone()));
        refuses_every_prefix("m.qb", bytes, "");
    }
    for (flag, data) in [(0, &raw), (1, &packed)] {
        survives_changed_bytes("m.qb", &qb_file([0, 1, flag, 0], &[matrix("a", [3, 2, 2], [1, -1, 0], data)]), "");
    }
    // Left-handed: z is turned about 0, cell 0 to cell −1.
    let mut left = a.clone();
    left[8] = 0;
    let turned: BTreeMap<_, _> = expected.iter().map(|(&[x, y, z], &c)| ([x, y, 3 - z], c)).collect();
    assert_eq!(voxels(&read("m.qb", &left, "")), turned);
    assert!(about("m.qb", &left, "").axes.contains("left-handed"));
    let mut bgra = a.clone();
    bgra[4] = 1;
    assert_eq!(voxels(&read("m.qb", &bgra, ""))[&[2, 0, 2]], Some([2, 1, 200]));
}

#[test]
fn qb_of_few_bytes_and_many_voxels_is_refused() {
    let slice = [2u32, 60_000 * 60_000 / 2, u32::MAX, 6].map(u32::to_le_bytes).concat();
    let bytes = qb_file([0, 1, 1, 0], &[matrix("", [60_000, 30_000, 1], [0; 3], &slice)]);
    assert!(error("m.qb", &bytes, "").contains("more than 67108864 voxels"));
    let bytes = qb_file([0, 1, 1, 0], &[matrix("", [1, 1, u32::MAX], [0; 3], &[6, 0, 0, 0])]);
    assert!(error("m.qb", &bytes, "").contains("does not fit the 1 words that are left"));
    let bytes = qb_file([0, 1, 1, 0], &[matrix("", [1, 1, 1], [0; 3], &[2, 0, 0, 0, 2, 0, 0, 0, 1, 1, 1, 255])]);
    assert!(error("m.qb", &bytes, "").contains("slice 0 has more than its 1 × 1 voxels"));
    assert!(error("m.qbt", b"QB 2\0\0\0\0", "").contains("export it as Qubicle Binary"));
}

// Goxel.

fn gox_chunk(id: &str, content: &[u8]) -> Vec<u8> {
    [id.as_bytes(), &(content.len() as i32).to_le_bytes(), content, &[0; 4]].concat()
}

/// A block of these voxels, the others air.
fn block(voxels: &[([u32; 3], [u8; 4])]) -> Vec<u8> {
    let mut image = image::RgbaImage::new(64, 64);
    for &([x, y, z], color) in voxels {
        let i = x + 16 * y + 256 * z;
        image.put_pixel(i % 64, i / 64, image::Rgba(color));
    }
    gox_chunk("BL16", &png(image))
}

fn layer(blocks: &[[i32; 4]], entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut content = (blocks.len() as i32).to_le_bytes().to_vec();
    blocks.iter().for_each(|b| content.extend([b[0], b[1], b[2], b[3], 0].map(i32::to_le_bytes).concat()));
    for (key, value) in entries {
        content.extend((key.len() as i32).to_le_bytes());
        content.extend(key.as_bytes());
        content.extend((value.len() as i32).to_le_bytes());
        content.extend(*value);
    }
    gox_chunk("LAYR", &content)
}

fn gox_file(version: i32, chunks: &[Vec<u8>]) -> Vec<u8> {
    [&b"GOX "[..], &version.to_le_bytes(), &chunks.concat()].concat()
}

fn mat(side: f32, at: [f32; 3]) -> Vec<u8> {
    let [x, y, z] = at;
    let m = [[side, 0.0, 0.0, 0.0], [0.0, side, 0.0, 0.0], [0.0, 0.0, side, 0.0], [x, y, z, 1.0]];
    m.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn gox_layers_are_shown_moved_or_left_out() {
    let (red, green) = ([250, 0, 0, 255], [0, 250, 0, 255]);
    let chunks = |chunks: &[Vec<u8>]| {
        let blocks =
            [block(&[([0, 0, 0], red), ([2, 1, 3], green), ([5, 5, 5], [1, 1, 1, 60])]), block(&[([0, 0, 0], green)])];
        gox_file(2, &[&[gox_chunk("PREV", b"any"), blocks.concat()], chunks].concat())
    };
    let id = |n: i32| n.to_le_bytes();
    let (one, two, three) = (id(1), id(2), id(3));
    let shown = layer(&[[0, 0, 0, 0]], &[("name", b"a"), ("id", &one), ("visible", &[1])]);
    let hidden = layer(&[[1, 90, 0, 0]], &[("name", b"b"), ("id", &two), ("visible", &[0])]);
    let copy = layer(&[], &[("name", b"c"), ("id", &three), ("base_id", &one), ("mat", &mat(1.0, [4.0, 0.0, -1.0]))]);
    let bytes = chunks(&[shown.clone(), hidden, copy]);
    let input = read("m", &bytes, "");
    // z is up, y goes into the distance: x 0 to 6, z −1 to 3, y 0 to 1.
    assert_eq!(input.columns.dims(), [7, 5, 2]);
    let (r, g) = (Some([250, 0, 0]), Some([0, 250, 0]));
    assert_eq!(voxels(&input), BTreeMap::from([([0, 1, 1], r), ([2, 4, 0], g), ([4, 0, 1], r), ([6, 3, 0], g)]));
    let told = about("m", &bytes, "");
    assert_eq!(told.left_out, ["the hidden layer \"b\"", "2 voxels of opacity below 127, which Goxel does not show"]);
    let turned = layer(&[], &[("name", b"t"), ("base_id", &one), ("mat", &mat(2.0, [0.0; 3]))]);
    assert!(about("m", &chunks(&[shown.clone(), turned]), "").left_out[0].contains("turned or scaled"));
    refuses_every_prefix_but(4, "m.gox", &chunks(std::slice::from_ref(&shown)), "");
    survives_changed_bytes("m.gox", &chunks(&[shown]), "");
    assert!(error("m.gox", &chunks(&[layer(&[[7, 0, 0, 0]], &[])]), "").contains("shows block 7, the file has 2"));
    assert!(error("m.gox", &chunks(&[]), "").contains("no visible voxel"));
}

#[test]
fn gox_shapes_are_the_voxels_whose_centres_lie_within() {
    let shape = |kind: &str, side: f32| {
        let (color, m) = ([7, 8, 9, 255], mat(side, [0.5, 0.5, 0.5]));
        let layer = layer(&[], &[("shape", kind.as_bytes()), ("color", &color), ("mat", &m)]);
        read("m.gox", &gox_file(2, &[layer]), "").columns
    };
    assert_eq!((shape("cube", 2.0).dims(), shape("cube", 2.0).voxels()), ([5, 5, 5], 125));
    // Centres at most 2 away: 1 + 6 + 12 + 8 + 6.
    assert_eq!(shape("sphere", 2.0).voxels(), 33);
    assert_eq!((shape("cylinder", 2.0).dims(), shape("cylinder", 2.0).voxels()), ([5, 5, 5], 5 * 13));
    let strange = gox_file(2, &[layer(&[], &[("shape", b"teapot"), ("mat", &mat(2.0, [0.0; 3]))])]);
    assert!(error("m.gox", &strange, "").contains("no visible voxel"));
}

#[test]
fn gox_of_version_1_counts_blocks_from_their_middle() {
    let file = |version| {
        let blocks = [block(&[([0, 0, 0], [1, 2, 3, 255])]), block(&[([0, 0, 0], [4, 5, 6, 255])])];
        let layers = [layer(&[[0, 0, 0, 0]], &[]), layer(&[[1, 16, 0, 0]], &[])];
        voxels(&read("m.gox", &gox_file(version, &[blocks.concat(), layers.concat()]), ""))
    };
    assert_eq!(file(1), file(2), "all move alike");
    assert_eq!(file(2).len(), 2);
}

// binvox.

fn binvox_file(sides: [u32; 3], data: &[u8]) -> Vec<u8> {
    let [d, h, w] = sides;
    let head = format!("#binvox 1\ndim {d} {h} {w}\ntranslate -1.5 2 0.25\nscale 8\ndata\n");
    [head.as_bytes(), data].concat()
}

#[test]
fn binvox_runs_go_along_y_then_z_then_x() {
    // Cells of x 0, z 0: y 1 and 2; of x 1, z 3: all of y.
    let data = [0, 1, 1, 2, 0, 1 + 3 * 4 + 4 * 3, 1, 4, 0, 32];
    let bytes = binvox_file([4, 4, 4], &data);
    let input = read("m", &bytes, "");
    let expected = [[0, 1, 0], [0, 2, 0], [1, 0, 3], [1, 1, 3], [1, 2, 3], [1, 3, 3]];
    assert_eq!(voxels(&input).into_keys().collect::<Vec<_>>(), expected);
    let told = about("m", &bytes, "");
    assert_eq!(told.voxel, Some([2.0; 3]));
    assert_eq!(told.affine.unwrap()[1], [0.0, 2.0, 0.0, 2.0]);
    // z up: (x, z, Y−1−y).
    let up: Vec<[u32; 3]> = voxels(&read("m", &bytes, "--up z")).into_keys().collect();
    let mut turned = expected.map(|[x, y, z]| [x, z, 3 - y]);
    turned.sort_unstable();
    assert_eq!(up, turned);
    refuses_every_prefix("m.binvox", &bytes, "");
    survives_changed_bytes("m.binvox", &bytes, "");
    let uneven = about("m", &binvox_file([2, 3, 4], &[1, 24]), "");
    assert!(uneven.rule.contains("sides 2, 3, 4 differ"), "{uneven}");
    assert_eq!(read("m", &binvox_file([2, 3, 4], &[1, 24]), "").columns.dims(), [2, 4, 3]);
    assert!(error("m", &binvox_file([4, 4, 4], &[1, 63]), "").contains("ends after 63 of 64 voxels"));
    assert!(error("m", &binvox_file([9000, 9000, 9000], &[1, 255]), "").contains("2 bytes hold at most 255 in two"));
    assert!(error("m", b"#binvox 3\n", "").contains("version 3 of binvox"));
}
