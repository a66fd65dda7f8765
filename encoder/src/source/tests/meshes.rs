//! Meshes as programs write them, each with the voxels and colours that are right.

use std::ops::Range;

use super::*;
use crate::About;

/// A box of 4 × 6 × 8, and its faces: 144 voxels of side 1 are touched.
const CORNERS: [[f32; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [0.0, 0.0, 8.0],
    [0.0, 6.0, 0.0],
    [0.0, 6.0, 8.0],
    [4.0, 0.0, 0.0],
    [4.0, 0.0, 8.0],
    [4.0, 6.0, 0.0],
    [4.0, 6.0, 8.0],
];
const FACES: [[u16; 3]; 12] = [
    [0, 1, 3],
    [0, 3, 2],
    [4, 6, 7],
    [4, 7, 5],
    [0, 4, 5],
    [0, 5, 1],
    [2, 3, 7],
    [2, 7, 6],
    [0, 2, 6],
    [0, 6, 4],
    [1, 5, 7],
    [1, 7, 3],
];

/// The world of a file and what is said of it.
fn told(name: &str, bytes: &[u8], flags: &str) -> (Input, About) {
    let file = file(name, bytes);
    told_of(&file.1, flags)
}

fn told_of(path: &Path, flags: &str) -> (Input, About) {
    let pieces = open_pieces(path, &opts(flags)).unwrap();
    let input = pieces::whole(&*pieces).unwrap();
    assert_eq!(broken_promise(&input), None);
    (input, pieces.about())
}

/// Size and number of solid voxels.
fn shape(input: &Input) -> ([u32; 3], u64) {
    (input.columns.dims(), input.columns.voxels())
}

const BOX: ([u32; 3], u64) = ([4, 6, 8], 144);

/// All colours of a world, each once.
fn colors(input: &Input) -> Vec<Rgb> {
    let Colors::Voxel { entries, .. } = &input.colors else { return Vec::new() };
    let mut all: Vec<Rgb> = entries.iter().map(|e| e.1).collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn left_out(about: &About, what: &str) -> bool {
    about.left_out.iter().any(|said| said.contains(what))
}

#[test]
fn mesh_says_how_it_was_read() {
    let (_, about) = told("a.ply", &ply_box("", ""), "--voxel 0.5 --up z");
    assert_eq!(
        about.to_string(),
        "read as ASCII PLY (mesh): z of the file is up; a voxel is 0.5 units wide; solid where a face touches"
    );
    // A corner of the world, back in the file's coordinates.
    let [x, y, z] = about.affine.unwrap().map(|row| row[0] * 3.0 + row[1] * 5.0 + row[2] * 2.0 + row[3]);
    assert_eq!([x, y, z], [1.5, 6.0 - 1.0, 2.5]);
}

/// What libFuzzer starts from.
#[cfg(feature = "mesh")]
#[test]
fn seeds_of_meshes_survive_changed_bytes() {
    let mut n = 0;
    for name in ["stl", "obj", "ply", "gltf"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds").join(name);
        for seed in fs::read_dir(folder).unwrap() {
            let bytes = fs::read(seed.unwrap().path()).unwrap();
            survives_changed_bytes(&format!("a.{name}"), &bytes[2..], "--size 16 --fill");
            n += 1;
        }
    }
    assert!(n >= 20, "{n} seeds");
}

#[cfg(feature = "mesh")]
mod stl {
    use super::*;

    fn solid(name: &str, dx: f32) -> String {
        let mut out = format!("solid{name}\n");
        for face in FACES {
            out += " facet normal 0 0 0\n  outer loop\n";
            for [x, y, z] in face.map(|i| CORNERS[i as usize]) {
                out += &format!("   vertex {} {y} {z}\n", x + dx);
            }
            out += "  endloop\n endfacet\n";
        }
        out + &format!("endsolid{name}\n")
    }

    fn binary(head: &str, attribute: impl Fn(usize) -> u16) -> Vec<u8> {
        let mut out = head.as_bytes().to_vec();
        out.resize(80, 0);
        out.extend(12u32.to_le_bytes());
        for (i, face) in FACES.into_iter().enumerate() {
            out.extend([0; 12]);
            let corners = face.map(|i| CORNERS[i as usize]);
            out.extend_from_slice(bytemuck::cast_slice(&corners));
            out.extend(attribute(i).to_le_bytes());
        }
        out
    }

    #[test]
    fn stl_text_has_any_solids_names_case_and_blanks() {
        let read = |text: &str| shape(&told("a.stl", text.as_bytes(), "--voxel 1").0);
        let two = solid(" a", 0.0) + &solid(" b", 10.0);
        assert_eq!(read(&two), ([14, 6, 8], 288));
        assert_eq!(read(&two.replace('\n', "\r")), ([14, 6, 8], 288));
        for text in [
            solid("", 0.0),
            solid(" A", 0.0).to_uppercase(),
            format!(" {}", solid(" A", 0.0)),
            format!("\n\u{feff}{}", solid(" A", 0.0)).replacen('\n', "", 1),
            solid(" two words, facet and vertex", 0.0),
            solid(" normal", 0.0).replace('\n', " "),
            // A name that reads as a facet starts.
            solid(" facet normal vertex of a name", 0.0),
            // Without numbers behind "normal".
            solid("", 0.0).replace("normal 0 0 0", "normal"),
            solid("", 0.0).replace("   vertex", "vertex\t"),
        ] {
            assert_eq!(read(&text), BOX, "{text}");
        }
    }

    #[test]
    fn stl_that_is_cut_or_wrong_is_said() {
        let whole = solid(" a", 0.0);
        let (_, about) = told("a.stl", &whole.as_bytes()[..whole.len() - 11], "--voxel 1");
        assert!(left_out(&about, "there is no \"endsolid\""), "{about:?}");
        let cut = &whole.as_bytes()[..whole.rfind("endloop").unwrap()];
        assert!(error("a.stl", cut, "").contains("the file ends inside a facet"));
        let text = error("a.stl", whole.replace("vertex 4 6", "vertex 4,0 6").as_bytes(), "");
        assert!(text.contains("expected a number, found \"4,0\""), "{text}");
        assert!(error("a.stl", b"", "").contains("empty") || error("a.stl", b"", "").contains("STL"));
        assert!(error("a.stl", b"solid a\nendsolid a\n", "").contains("no faces"));
        let utf16: Vec<u8> = [0xfeff].into_iter().chain(whole.encode_utf16()).flat_map(u16::to_le_bytes).collect();
        assert!(error("a.stl", &utf16, "").contains("UTF-16"));
    }

    #[test]
    fn stl_is_binary_by_its_length_and_may_have_colours() {
        let read = |bytes: &[u8]| told("a.stl", bytes, "--voxel 1");
        let plain = |_| 0;
        assert_eq!(shape(&read(&binary("", plain)).0), BOX);
        assert_eq!(shape(&read(&binary("solid of a program that does not know better", plain)).0), BOX);
        let longer = [binary("made", plain), vec![1; 7]].concat();
        let (input, about) = read(&longer);
        assert_eq!((shape(&input), left_out(&about, "7 bytes after the last facet")), (BOX, true));
        let text = error("a.stl", &binary("", plain)[..600], "");
        assert!(text.contains("byte 80: STL: 12 facets are claimed, 10 are there"), "{text}");
        // The whole is grey, the first two facets, which are x = 0, are red: 31 of 31.
        let head = format!("{}COLOR=\u{10}\u{20}\u{30}\u{7f}", "made by Magics ");
        let colored = read(&binary(&head, |i| if i < 2 { 31 } else { 1 << 15 })).0;
        assert!(colors(&colored).contains(&[255, 0, 0]) && colors(&colored).contains(&[16, 32, 48]));
        assert!(left_out(&read(&binary("", |_| 7)).1, "attributes of 12 facets"));
    }
}

#[cfg(feature = "mesh")]
mod obj {
    use super::*;

    fn text() -> String {
        let corners = CORNERS.map(|[x, y, z]| format!("v {x} {y} {z}\n")).concat();
        corners + &FACES.map(|t| format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1)).concat()
    }

    #[test]
    fn obj_text_has_marks_line_ends_and_goes_on() {
        let read = |text: &str| told("a.obj", text.as_bytes(), "--voxel 1");
        let t = text();
        for text in [
            format!("\u{feff}{t}"),
            t.replace('\n', "\r"),
            t.replace('\n', "\r\n"),
            t.replace("f 1 2", "f 1 \\\n 2"),
            format!("usemtl \n{t}"),
            format!("usemtl\nmtllib\no\ng\ns off\n{t}"),
            t.replace('f', "  f "),
            t.replace("f 1 2 4", "f 1 2 4 # a comment"),
            t.replace("f 1 2 4", "f -8 -7 -5"),
            t.replace("f 1 2 4", "f 1//7 2//8 4//9"),
            t.replace("v 4 6 8", "v 4 6 8 1.0"),
            // Faces before their corners.
            t[t.find('f').unwrap()..].to_owned() + &t[..t.find('f').unwrap()],
        ] {
            assert_eq!(shape(&read(&text).0), BOX, "{text}");
        }
        // A corner that no face uses, behind the others: neither index nor box are touched by it.
        let (input, about) = read(&format!("\u{feff}{}", t.replacen('f', "v 9 9 9\nf", 1)));
        assert_eq!((shape(&input), left_out(&about, "1 point that no face uses")), (BOX, true));
        let (input, about) = read(&format!("{t}l 1 2 3\np 1\ncurv 0 1 1 2\nf 1 2\nwhat is this\n"));
        assert_eq!(shape(&input), BOX);
        for said in
            ["2 lines and points", "1 curves", "1 faces of fewer", "1 statements that are not known, the first at byte"]
        {
            assert!(left_out(&about, said), "{said}: {about:?}");
        }
        let wrong = |from: &str, to: &str| error("a.obj", t.replacen(from, to, 1).as_bytes(), "");
        assert!(wrong("f 1 2 4", "f 1 2 9").contains("face 1: vertex 9 of 8"));
        assert!(wrong("f 1 2 4", "f 0 2 4").contains("none of the numbers 1 to 8"));
        assert!(wrong("f 1 2 4", "f -9 2 4").contains("none of the numbers 1 to 8"));
        assert!(wrong("f 1 2 4", "f 1/1 2/1 4/1").contains("texture coordinate 1 of 0"));
        assert!(wrong("v 0 0 8", "v 0 0 1,5").contains("\"1,5\" is no number"));
        assert!(wrong("v 0 0 8", "v 0 0").contains("byte 8: OBJ: fewer than three numbers"));
    }

    #[test]
    fn boxes_are_as_large_wherever_they_stand() {
        let boxes = |places: &[[f32; 3]]| {
            let mut out = String::new();
            for (i, at) in places.iter().enumerate() {
                out += &CORNERS.map(|[x, y, z]| format!("v {} {} {}\n", x + at[0], y + at[1], z + at[2])).concat();
                out += &FACES
                    .map(|t| t.map(|k| usize::from(k) + 1 + 8 * i))
                    .map(|[a, b, c]| format!("f {a} {b} {c}\n"))
                    .concat();
            }
            told("a.obj", out.as_bytes(), "--voxel 1").0
        };
        assert_eq!(shape(&boxes(&[[0.0; 3], [10.0, 7.0, 9.0], [20.0, 20.0, 20.0]])), ([24, 26, 28], 3 * 144));
        // An open sheet between layers touches those above, all of it.
        let sheet = "v 0 0 0\nv 0 9 0\nv 1 0 0\nv 2 3 2\nv 8 3 2\nv 8 3 8\nv 2 3 8\nf 1 2 3\nf 4 6 5\nf 4 7 6\n";
        let c = told("a.obj", sheet.as_bytes(), "--voxel 1").0.columns;
        assert!((2..8).all(|x| (2..8).all(|z| c.solid(x, 3, z) && !c.solid(x, 2, z))));
    }

    #[test]
    fn obj_coordinates_of_maps_keep_their_digits() {
        // A grid of 0.1 m, half of it faces, where f32 has steps of 0.5 m.
        let grid = |east: f64, north: f64| {
            let mut out = String::new();
            for (j, i) in (0..10).flat_map(|j| (0..10).map(move |i| (j, i))) {
                out += &format!("v {:.1} {:.1} 100\n", east + 0.1 * f64::from(i), north + 0.1 * f64::from(j));
            }
            for (j, i) in (0..9).flat_map(|j| (0..9).map(move |i| (j, i))) {
                out += &format!("f {} {} {}\n", j * 10 + i + 1, j * 10 + i + 2, j * 10 + i + 11);
            }
            told("a.obj", out.as_bytes(), "--voxel 0.1 --up z").0.columns
        };
        let far = grid(500_000.0, 4_649_776.0);
        assert_eq!(far.dims()[1], 1);
        // Each of the 9 × 9 cells has a face at least.
        assert!(far.dims()[0] >= 9 && far.dims()[2] >= 9 && far.voxels() >= 81, "{:?} {}", far.dims(), far.voxels());
        assert!(far.dims()[0] <= 10 && far.dims()[2] <= 10);
    }

    #[test]
    fn polygons_that_are_not_convex_keep_their_outline() {
        // An L of area 7: at 0.1 it touches 759 cells, whichever its first corner is, and however it lies.
        let outline = [[0, 4], [0, 0], [4, 0], [4, 1], [1, 1], [1, 4]];
        for (first, turn) in (0..6).flat_map(|first| (0..2).map(move |turn| (first, turn))) {
            for axes in [[0, 1, 2], [1, 2, 0], [2, 0, 1]] {
                let mut text = String::new();
                let mut own: Vec<[i32; 2]> = (0..6).map(|k| outline[(k + first) % 6]).collect();
                if turn == 1 {
                    own.reverse();
                }
                for [a, b] in own {
                    let p = axes.map(|axis| [a, b, 0][axis]);
                    text += &format!("v {} {} {}\n", p[0], p[1], p[2]);
                }
                let input = told("l.obj", (text + "f 1 2 3 4 5 6\n").as_bytes(), "--voxel 0.1").0;
                assert_eq!(input.columns.voxels(), 759, "{first} {turn} {axes:?}");
            }
        }
        // A comb with 40 teeth on a slope.
        let mut outline = vec![[0.0, 0.0], [80.0, 0.0]];
        for tooth in (0..40).rev() {
            let x = 2.0 * f64::from(tooth);
            outline.extend([[x + 1.0, 2.0], [x + 1.0, 30.0], [x, 30.0], [x, 2.0]]);
        }
        let text: String = outline.iter().map(|[x, z]| format!("v {x} {} {z}\n", x + z)).collect();
        let face: String = (1..=outline.len()).map(|i| format!(" {i}")).collect();
        let c = told("comb.obj", format!("{text}f{face}\n").as_bytes(), "--voxel 0.5").0.columns;
        assert_eq!((c.nx(), c.nz()), (160, 60));
        let filled = |x: u32, z: u32| !c.column(x, z).is_empty();
        for (tooth, z) in (0..40).flat_map(|tooth| (6..58).map(move |z| (tooth, z))) {
            assert!(filled(4 * tooth, z) && filled(4 * tooth + 1, z) && !filled(4 * tooth + 3, z), "{tooth} {z}");
        }
    }

    #[test]
    fn obj_colours_are_those_of_corners_or_of_materials() {
        let t = text();
        let dir = tempfile::tempdir().unwrap();
        let with = |mtl: &str, obj: &str| {
            fs::write(dir.path().join("my m.mtl"), mtl).unwrap();
            fs::write(dir.path().join("a.obj"), obj).unwrap();
            told_of(&dir.path().join("a.obj"), "--voxel 1")
        };
        let red = format!("mtllib my m.mtl\nusemtl a b\n{t}");
        let mtl = "newmtl a b\nKd 1 0 0\n";
        for mtl in [
            mtl.to_owned(),
            format!("\u{feff}{mtl}"),
            mtl.replace('\n', "\r"),
            mtl.replace("1 0", "1 \\\n0"),
            mtl.replace("newmtl", "  newmtl"),
        ] {
            let (input, about) = with(&mtl, &red);
            assert_eq!(colors(&input), [[255, 0, 0]], "{mtl:?} {about:?}");
        }
        // One face of a material that is not there, one of none.
        let (input, about) =
            with(mtl, &red.replace("f 1 2 4", "usemtl c\nf 1 2 4\nusemtl\nf 1 4 3\nusemtl a b\nf 1 2 4"));
        assert!(
            colors(&input).contains(&[255, 0, 0]) && left_out(&about, "materials that no library has: c"),
            "{about:?}"
        );
        assert!(left_out(&with("newmtl a b\nKd 1 0 0\nd 0.5\n", &red).1, "transparency of 1 materials"));
        let (input, _) = with(mtl, &red.replace("v 0 0 0\n", "v 0 0 0 0 1 0\n"));
        assert!(colors(&input).contains(&[255, 0, 0]));
        let green: String =
            t.lines().map(|l| if l.starts_with('v') { format!("{l} 0 1 0\n") } else { format!("{l}\n") }).collect();
        assert_eq!(colors(&with(mtl, &green).0), [[0, 255, 0]]);
        assert_eq!(colors(&with(mtl, &green.replace(" 0 1 0\n", " 0 255 51\n")).0), [[0, 255, 51]]);
    }

    #[test]
    fn obj_pictures_are_moved_and_scaled() {
        // Two pixels, red and blue; all corners at u = 1/4, which is red.
        let dir = tempfile::tempdir().unwrap();
        let mut png = std::io::Cursor::new(Vec::new());
        let two = image::RgbImage::from_fn(2, 1, |x, _| image::Rgb([255 - 255 * x as u8, 0, 255 * x as u8]));
        two.write_to(&mut png, image::ImageFormat::Png).unwrap();
        fs::write(dir.path().join("two.png"), png.into_inner()).unwrap();
        let t = text();
        let faces = FACES.map(|f| format!("f {}/1 {}/1 {}/1\n", f[0] + 1, f[1] + 1, f[2] + 1)).concat();
        let obj = format!("mtllib a.mtl\nusemtl m\nvt 0.25 0.5\n{}{faces}", &t[..t.find('f').unwrap()]);
        fs::write(dir.path().join("a.obj"), obj).unwrap();
        let with = |options: &str| {
            fs::write(dir.path().join("a.mtl"), format!("newmtl m\nmap_Kd {options}two.png\n")).unwrap();
            colors(&told_of(&dir.path().join("a.obj"), "--voxel 1").0)
        };
        assert_eq!(with(""), [[255, 0, 0]]);
        assert_eq!(with("-o 0.5 0 0 "), [[0, 0, 255]]);
        assert_eq!(with("-s 3 1 1 "), [[0, 0, 255]]);
        fs::write(dir.path().join("a.mtl"), "NEWMTL m\nMAP_KD two.png\n").unwrap();
        assert_eq!(colors(&told_of(&dir.path().join("a.obj"), "--voxel 1").0), [[255, 0, 0]]);
        assert_eq!(with("-o 4.5 0 0 -clamp on "), [[0, 0, 255]]);
        assert_eq!(with("-o -4.5 0 0 -clamp on "), [[255, 0, 0]]);
    }
}

/// The box as text, with more properties of faces and more values in their rows.
fn ply_box(properties: &str, values: &str) -> Vec<u8> {
    let corners = CORNERS.map(|[x, y, z]| format!("{x} {y} {z}\n")).concat();
    let faces = FACES.map(|[a, b, c]| format!("3 {a} {b} {c} {values}\n")).concat();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\nelement face 12\n\
         property list uchar int vertex_indices\n{properties}end_header\n{corners}{faces}"
    )
    .into_bytes()
}

#[test]
fn ply_rows_are_lines_where_words_are_too_many() {
    let colors_of = "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n";
    let wedges = format!("property list uchar float texcoord\n{colors_of}");
    let extra = ply_box(&wedges, "6 0 0 1 0 1 1 9 1 1 1 1 1 1 1 1 1");
    let (input, about) = told("a.ply", &extra, "--voxel 1");
    assert_eq!((shape(&input), colors(&input)), (BOX, vec![]));
    assert!(left_out(&about, "what 12 rows of face hold beyond the values that the header names, and their colours"));
    // As many as named: colours are those of faces.
    let (input, about) = told("a.ply", &ply_box(colors_of, "255 10 0 255"), "--voxel 1");
    assert_eq!((shape(&input), colors(&input)), (BOX, vec![[255, 10, 0]]));
    assert_eq!(about.left_out, ["alpha of \"face\""]);
    // Rows without regard to lines.
    let plain = String::from_utf8(ply_box("", "")).unwrap();
    let (head, body) = plain.split_at(plain.find("end_header").unwrap() + 11);
    assert_eq!(shape(&told("a.ply", format!("{head}{}", body.replace('\n', " ")).as_bytes(), "--voxel 1").0), BOX);
    assert_eq!(shape(&told("a.ply", format!("{head}{}", body.replace(' ', "\n")).as_bytes(), "--voxel 1").0), BOX);
    assert_eq!(shape(&told("a.ply", plain.replace('\n', "\r").as_bytes(), "--voxel 1").0), BOX);
    let text = error("a.ply", format!("{plain}3 0 1 2\n").as_bytes(), "");
    assert!(text.contains("values are left after the last element"), "{text}");
    let text = error("a.ply", plain.replace("3 0 1 3", "3 0 1 8").as_bytes(), "");
    assert!(text.contains("a face with corner 8 of 8"), "{text}");
}

#[test]
fn ply_has_strips_and_faces_in_any_order() {
    let corners = "0 0 0\n8 0 0\n0 0 8\n8 0 8\n0 0 20\n8 0 20\n0 0 28\n";
    let strips = |list: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement tristrips 1\nproperty list int int vertex_indices\nelement vertex 7\n\
             property double x\nproperty double y\nproperty double z\nproperty float nx\nelement edge 1\nproperty int vertex1\n\
             property int vertex2\nend_header\n{list}\n{}0 1\n",
            corners.replace('\n', " 0\n")
        )
    };
    let (input, about) = told("a.ply", strips("8 0 1 2 3 -1 4 5 6").as_bytes(), "--voxel 1");
    // 8 × 8, and the half of 8 × 8 with its diagonal's neighbours.
    assert_eq!(input.columns.dims(), [8, 1, 28]);
    let of =
        |rows: Range<u32>| rows.map(|z| (0..8).filter(|&x| input.columns.solid(x, 0, z.into())).count()).sum::<usize>();
    assert_eq!((of(0..8), of(9..20), of(20..28) > 36 && of(20..28) < 52), (64, 0, true), "{}", of(20..28));
    assert_eq!(about.left_out, ["nx of \"vertex\"", "1 of \"edge\""]);
    let text = error("a.ply", strips("4 0 1 2 7").as_bytes(), "");
    assert!(text.contains("a face with corner 7 of 7"), "{text}");
}

#[test]
fn ply_pictures_lie_on_faces_or_on_corners() {
    let dir = tempfile::tempdir().unwrap();
    let mut png = std::io::Cursor::new(Vec::new());
    // Red above, blue below; v is up in PLY.
    let two = image::RgbImage::from_fn(1, 2, |_, z| image::Rgb([255 - 255 * z as u8, 0, 255 * z as u8]));
    two.write_to(&mut png, image::ImageFormat::Png).unwrap();
    fs::write(dir.path().join("a b.png"), png.into_inner()).unwrap();
    let read = |text: String| {
        fs::write(dir.path().join("a.ply"), text).unwrap();
        told_of(&dir.path().join("a.ply"), "--voxel 1")
    };
    let plain = |properties: &str, values: &str| {
        let text = String::from_utf8(ply_box(properties, values)).unwrap();
        text.replacen("element", "comment TextureFile a b.png\nelement", 1)
    };
    let wedges = "property list uchar float texcoord\n";
    assert_eq!(colors(&read(plain(wedges, "6 0 0.9 1 0.9 1 0.9")).0), [[255, 0, 0]]);
    assert_eq!(colors(&read(plain(wedges, "6 0 0.1 1 0.1 1 0.1")).0), [[0, 0, 255]]);
    let numbered = format!("{wedges}property int texnumber\n");
    assert_eq!(colors(&read(plain(&numbered, "6 0 0.1 1 0.1 1 0.1 0")).0), [[0, 0, 255]]);
    let on_corners =
        plain("", "").replace("property float z\n", "property float z\nproperty float s\nproperty float t\n");
    let on_corners = CORNERS.iter().fold(on_corners, |text, [x, y, z]| {
        text.replacen(&format!("\n{x} {y} {z}\n"), &format!("\n{x} {y} {z} 0.5 0.1\n"), 1)
    });
    let (input, about) = read(on_corners);
    assert_eq!((shape(&input), colors(&input), about.left_out.len()), (BOX, vec![[0, 0, 255]], 0));
    let (input, about) = read(plain(wedges, "6 0 0 1 0 1 1").replace("a b.png", "none.png"));
    assert_eq!(shape(&input), BOX);
    assert!(left_out(&about, "a texture is left out") && left_out(&about, "none.png"), "{about:?}");
}

#[test]
fn ply_points_of_maps_fall_into_their_cells() {
    // 40 × 40 points, 0.1 m apart, where f32 has steps of 0.5 m.
    let mut bytes =
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1600\nproperty double x\nproperty double y\n\
                      property double z\nend_header\n"
            .to_vec();
    for (i, j) in (0..40).flat_map(|i| (0..40).map(move |j| (i, j))) {
        for v in [500_000.0 + f64::from(i) * 0.1, 4_649_776.0 + f64::from(j) * 0.1, 100.0] {
            bytes.extend(v.to_le_bytes());
        }
    }
    let (input, _) = told("a.ply", &bytes, "--voxel 0.1 --up z");
    assert_eq!(shape(&input), ([40, 1, 40], 1600));
}

#[test]
fn closed_meshes_are_filled_where_that_is_asked_for() {
    let (input, about) = told("a.ply", &ply_box("", ""), "--voxel 1 --fill");
    assert_eq!(shape(&input), ([4, 6, 8], 4 * 6 * 8));
    assert!(about.rule == "solid where a face touches, and inside closed parts" && about.left_out.is_empty());
    let open = String::from_utf8(ply_box("", "")).unwrap().replace("face 12", "face 11").replace("3 1 7 3 \n", "");
    let (input, about) = told("a.ply", open.as_bytes(), "--voxel 1 --fill");
    assert!(input.columns.voxels() < 144 && about.rule.ends_with("nothing is closed"));
    assert!(left_out(&about, "the inside of 1 of 1 parts"), "{about:?}");
    // Pieces are cut out of the whole.
    let file = file("a.ply", &ply_box("", ""));
    let pieces = open_pieces(&file.1, &opts("--size 100 --fill")).unwrap();
    let whole = pieces::whole(&*pieces).unwrap().columns;
    assert_eq!(whole.voxels(), 50 * 75 * 100);
    for (xs, zs) in [(3..17, 31..65), (49..50, 99..100)] {
        assert_eq!(pieces.piece(xs.clone(), zs.clone()).unwrap().columns, whole.crop(xs, zs));
    }
    let cloud =
        b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n\
                  0 0 0\n4 0 7.9\n";
    assert_eq!(told("p.ply", cloud, "--voxel 1 --fill").0.columns.voxels(), 2);
}

#[cfg(feature = "mesh")]
mod gltf {
    use super::*;

    /// A binary glTF under construction.
    #[derive(Default)]
    struct Glb {
        bin: Vec<u8>,
        views: Vec<String>,
        accessors: Vec<String>,
    }

    impl Glb {
        fn view(&mut self, bytes: &[u8]) -> usize {
            self.bin.resize(self.bin.len().next_multiple_of(4), 0);
            let at = self.bin.len();
            self.views.push(format!(r#"{{"buffer": 0, "byteOffset": {at}, "byteLength": {}}}"#, bytes.len()));
            self.bin.extend_from_slice(bytes);
            self.views.len() - 1
        }

        /// Number of an accessor of elements of a type; `more` has a comma in front.
        fn add<T: bytemuck::NoUninit>(
            &mut self,
            component: u32,
            kind: &str,
            count: usize,
            data: &[T],
            more: &str,
        ) -> usize {
            let view = self.view(bytemuck::cast_slice(data));
            self.accessors.push(format!(
                r#"{{"bufferView": {view}, "componentType": {component}, "count": {count}, "type": "{kind}"{more}}}"#
            ));
            self.accessors.len() - 1
        }

        fn floats(&mut self, kind: &str, data: &[f32], each: usize) -> usize {
            let more = if each == 3 { r#", "min": [0, 0, 0], "max": [9, 9, 9]"# } else { "" };
            self.add(5126, kind, data.len() / each, data, more)
        }

        fn indices(&mut self, data: &[u16]) -> usize {
            self.add(5123, "SCALAR", data.len(), data, "")
        }

        /// The box: attributes and indices of a primitive.
        fn cuboid() -> (Glb, String) {
            let mut glb = Glb::default();
            let p = glb.floats("VEC3", CORNERS.as_flattened(), 3);
            let i = glb.indices(FACES.as_flattened());
            (glb, format!(r#""attributes": {{"POSITION": {p}}}, "indices": {i}"#))
        }

        fn bytes(&self, json: &str) -> Vec<u8> {
            let scene = if json.contains("\"scenes\"") { "" } else { r#""scene": 0, "scenes": [{"nodes": [0]}], "# };
            let mut json = format!(
                r#"{{"asset": {{"version": "2.0"}}, {scene}{json}, "buffers": [{{"byteLength": {}}}], "bufferViews": [{}], "accessors": [{}]}}"#,
                self.bin.len(),
                self.views.join(", "),
                self.accessors.join(", ")
            )
            .into_bytes();
            json.resize(json.len().next_multiple_of(4), b' ');
            let mut bin = self.bin.clone();
            bin.resize(bin.len().next_multiple_of(4), 0);
            let chunk = |kind: &[u8; 4], bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes()[..], kind, bytes].concat();
            let chunks = [chunk(b"JSON", &json), chunk(b"BIN\0", &bin)].concat();
            let len = 12 + chunks.len() as u32;
            [b"glTF", &2u32.to_le_bytes()[..], &len.to_le_bytes(), &chunks].concat()
        }

        fn read(&self, json: &str) -> (Input, About) {
            told("a.glb", &self.bytes(json), "--voxel 1")
        }
    }

    /// A mesh with one primitive and a node that has it.
    fn one(primitive: &str, more: &str) -> String {
        format!(r#""meshes": [{{"primitives": [{{{primitive}}}]}}], "nodes": [{{"mesh": 0}}]{more}"#)
    }

    fn png(pixels: &[[u8; 4]]) -> Vec<u8> {
        let mut out = std::io::Cursor::new(Vec::new());
        let image = image::RgbaImage::from_fn(pixels.len() as u32, 1, |x, _| image::Rgba(pixels[x as usize]));
        image.write_to(&mut out, image::ImageFormat::Png).unwrap();
        out.into_inner()
    }

    #[test]
    fn gltf_triangles_come_in_strips_and_fans() {
        let square = [0.0, 0.0, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0, 8.0, 8.0, 0.0, 8.0];
        for (mode, order) in [(5, [0, 1, 2, 3]), (6, [0, 1, 3, 2])] {
            let mut glb = Glb::default();
            let p = glb.floats("VEC3", &square, 3);
            let i = glb.indices(&order);
            let with = format!(r#""attributes": {{"POSITION": {p}}}, "indices": {i}, "mode": {mode}"#);
            assert_eq!(shape(&glb.read(&one(&with, "")).0), ([8, 1, 8], 64), "mode {mode}");
        }
        // Without indices.
        let mut glb = Glb::default();
        let p = glb.floats("VEC3", &square, 3);
        let strip = format!(r#"{{"attributes": {{"POSITION": {p}}}, "mode": 5}}"#);
        let points = format!(r#"{{"attributes": {{"POSITION": {p}}}, "mode": 0}}"#);
        let mesh = format!(r#""meshes": [{{"primitives": [{points}, {strip}]}}], "nodes": [{{"mesh": 0}}]"#);
        let (input, about) = glb.read(&mesh);
        assert_eq!((shape(&input), about.unit.as_str()), (([8, 1, 8], 64), "m"));
        assert_eq!(about.left_out, ["1 primitives that are no triangles"]);
    }

    #[test]
    fn gltf_instances_stand_where_they_are_put() {
        let (mut glb, p) = Glb::cuboid();
        let t = glb.floats("VEC3", &[0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 20.0, 0.0, 0.0], 3);
        let with = |attributes: &str, more: &str| {
            format!(
                r#""meshes": [{{"primitives": [{{{p}}}]}}], "extensionsUsed": ["EXT_mesh_gpu_instancing"], "nodes": [{{"mesh": 0,
                "extensions": {{"EXT_mesh_gpu_instancing": {{"attributes": {{{attributes}}}}}}}}}]{more}"#
            )
        };
        let move_only = format!(r#""TRANSLATION": {t}"#);
        let required = r#", "extensionsRequired": ["EXT_mesh_gpu_instancing"]"#;
        let (input, about) = glb.read(&with(&move_only, required));
        assert_eq!((shape(&input), about.left_out.len()), (([24, 6, 8], 432), 0));
        // Half as large, and a quarter turn about y, which takes x to −z and z to x.
        let s = glb.floats("VEC3", &[0.5; 9], 3);
        let half = (0.5f32).sqrt();
        let r = glb.floats("VEC4", &[0.0, half, 0.0, half, 0.0, half, 0.0, half, 0.0, half, 0.0, half], 4);
        let all = format!(r#""TRANSLATION": {t}, "ROTATION": {r}, "SCALE": {s}"#);
        assert_eq!(glb.read(&with(&all, "")).0.columns.dims(), [24, 3, 2]);
        let few = glb.floats("VEC3", &[0.0; 3], 3);
        let text =
            error("a.glb", &glb.bytes(&with(&format!(r#""TRANSLATION": {t}, "SCALE": {few}"#), "")), "--voxel 1");
        assert!(text.contains("attributes of instances that differ in number"), "{text}");
    }

    #[test]
    fn gltf_materials_have_pictures_that_are_turned_and_holes() {
        let (mut glb, p) = Glb::cuboid();
        let uv = glb.floats("VEC2", &[0.25, 0.5].repeat(8), 2);
        let other = glb.floats("VEC2", &[0.75, 0.5].repeat(8), 2);
        let p = p.replace('}', &format!(r#", "TEXCOORD_0": {uv}, "TEXCOORD_1": {other}}}"#));
        let four = png(&[[255, 0, 0, 255], [0, 0, 255, 255]]);
        let clear = png(&[[0, 255, 0, 0], [0, 255, 0, 255]]);
        let (a, b) = (glb.view(&four), glb.view(&clear));
        let with = |material: &str| {
            let image = |view: usize| format!(r#"{{"bufferView": {view}, "mimeType": "image/png"}}"#);
            let more = format!(
                r#", "materials": [{{{material}}}], "textures": [{{"source": 0}}, {{"source": 1}}], "images": [{}, {}]"#,
                image(a),
                image(b)
            );
            glb.read(&one(&format!(r#"{p}, "material": 0"#), &more))
        };
        let picture = |n: usize, transform: &str| {
            let extension = format!(r#""extensions": {{"KHR_texture_transform": {{{transform}}}}}"#);
            format!(r#""pbrMetallicRoughness": {{"baseColorTexture": {{"index": {n}, {extension}}}}}"#)
        };
        let of = |transform: &str| colors(&with(&picture(0, transform)).0);
        assert_eq!(of(""), [[255, 0, 0]]);
        assert_eq!(of(r#""offset": [0.5, 0]"#), [[0, 0, 255]]);
        assert_eq!(of(r#""scale": [3, 1]"#), [[0, 0, 255]]);
        assert_eq!(of(r#""texCoord": 1"#), [[0, 0, 255]]);
        // A quarter turn takes (u, v) to (v, −u): 0.5 + 0.1 is blue. The other way it were −0.5 + 0.1, red.
        assert_eq!(of(r#""rotation": 1.57079632679, "offset": [0.1, 0]"#), [[0, 0, 255]]);
        // Holes: the left pixel is clear, the right one is not.
        let masked = |more: &str, transform: &str| shape(&with(&format!("{}, {more}", picture(1, transform))).0);
        assert_eq!(masked(r#""alphaMode": "MASK""#, ""), ([4, 6, 8], 0));
        assert_eq!(masked(r#""alphaMode": "MASK""#, r#""offset": [0.5, 0]"#), BOX);
        assert_eq!(masked(r#""alphaMode": "MASK", "alphaCutoff": 0"#, ""), BOX);
        assert_eq!(masked(r#""alphaMode": "OPAQUE""#, ""), BOX);
        let (input, about) = with(&format!(r#"{}, "alphaMode": "BLEND", "emissiveFactor": [1, 0, 0]"#, picture(1, "")));
        assert_eq!(shape(&input), BOX);
        assert!(left_out(&about, "alphaMode BLEND") && left_out(&about, "light of their own"), "{about:?}");
        // Factors count as well.
        let factor =
            |a: f32| format!(r#""pbrMetallicRoughness": {{"baseColorFactor": [1, 1, 1, {a}]}}, "alphaMode": "MASK""#);
        assert_eq!(shape(&with(&factor(0.4)).0), ([4, 6, 8], 0));
        assert_eq!(shape(&with(&factor(0.6)).0), BOX);
        // Specular and glossiness, with the other picture.
        let diffuse = |of: &str| format!(r#""extensions": {{"KHR_materials_pbrSpecularGlossiness": {{{of}}}}}"#);
        assert_eq!(colors(&with(&diffuse(r#""diffuseFactor": [1, 0, 0, 1]"#)).0), [[255, 0, 0]]);
        assert_eq!(
            colors(&with(&diffuse(r#""diffuseTexture": {"index": 0}, "diffuseFactor": [1, 1, 1, 1]"#)).0),
            [[255, 0, 0]]
        );
    }

    #[test]
    fn gltf_corners_may_be_clear_one_by_one() {
        // The lower half of a wall is clear, the upper is not.
        let mut glb = Glb::default();
        let p = glb.floats("VEC3", &[0.0, 0.0, 0.5, 8.0, 0.0, 0.5, 0.0, 8.0, 0.5, 8.0, 8.0, 0.5], 3);
        let c = glb.add(
            5121,
            "VEC4",
            4,
            &[255u8, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 255, 255, 0, 0, 255],
            r#", "normalized": true"#,
        );
        let with = format!(r#""attributes": {{"POSITION": {p}, "COLOR_0": {c}}}, "mode": 5, "material": 0"#);
        let (input, _) = glb.read(&one(&with, r#", "materials": [{"alphaMode": "MASK", "alphaCutoff": 0.5}]"#));
        // Column by column: one is opaque where the middle of what lies in it is; all of a column is one polygon.
        assert_eq!(input.columns.dims(), [8, 8, 1]);
        assert!(colors(&input).iter().all(|c| *c == [255, 0, 0]));
    }

    #[test]
    fn gltf_skins_move_corners_with_joints_alone() {
        let (mut glb, p) = Glb::cuboid();
        let joints = glb.add(5121, "VEC4", 8, &[0u8, 1, 0, 0].repeat(8), "");
        // Half with each joint: rounded to bytes, with the sum 254 of 255.
        let weights = glb.add(5121, "VEC4", 8, &[127u8, 127, 0, 0].repeat(8), r#", "normalized": true"#);
        let matrix = |x: f32| {
            let mut m = [0.0f32; 16];
            (m[0], m[5], m[10], m[15], m[12]) = (1.0, 1.0, 1.0, 1.0, x);
            m
        };
        let inverse = glb.floats("MAT4", &[matrix(0.0), matrix(-2.0)].concat(), 16);
        let skinned = p.replace('}', &format!(r#", "JOINTS_0": {joints}, "WEIGHTS_0": {weights}}}"#));
        let json = format!(
            r#""scenes": [{{"nodes": [0, 1, 3]}}], "scene": 0, "meshes": [{{"primitives": [{{{skinned}}}]}}, {{"primitives": [{{{p}}}]}}],
            "nodes": [{{"mesh": 0, "skin": 0, "translation": [1000, 0, 0], "scale": [9, 9, 9]}},
            {{"translation": [10, 0, 0], "children": [2]}}, {{"translation": [2, 0, 0]}}, {{"mesh": 1}}],
            "skins": [{{"joints": [1, 2], "inverseBindMatrices": {inverse}}}]"#
        );
        // Both joints take the mesh 10 along x, to 10 .. 14; beside it the same mesh at 0.
        let (input, about) = glb.read(&json);
        assert_eq!(shape(&input), ([14, 6, 8], 288), "{about:?}");
        let far = json.replace("\"joints\": [1, 2]", "\"joints\": [1]");
        let text = error("a.glb", &glb.bytes(&far), "--voxel 1");
        assert!(text.contains("a corner moves with joint 1 of 1"), "{text}");
    }

    #[test]
    fn gltf_morph_targets_have_their_default_weights() {
        let (mut glb, p) = Glb::cuboid();
        let stretch: Vec<f32> = CORNERS.iter().flat_map(|[x, _, _]| [x * 2.0, 0.0, 0.0]).collect();
        let t = glb.floats("VEC3", &stretch, 3);
        let with = |mesh: &str, node: &str| {
            let json = format!(
                r#""meshes": [{{"primitives": [{{{p}, "targets": [{{"POSITION": {t}}}]}}]{mesh}}}], "nodes": [{{"mesh": 0{node}}}]"#
            );
            glb.read(&json).0.columns.dims()
        };
        assert_eq!(with("", ""), [4, 6, 8]);
        assert_eq!(with(r#", "weights": [0.5]"#, ""), [8, 6, 8]);
        assert_eq!(with(r#", "weights": [0.5]"#, r#", "weights": [1]"#), [12, 6, 8]);
    }

    #[test]
    fn gltf_numbers_may_be_whole_sparse_or_hidden() {
        let mut glb = Glb::default();
        let whole: Vec<i16> = CORNERS.iter().flat_map(|p| p.map(|v| v as i16)).collect();
        let padded: Vec<i16> = whole.chunks(3).flat_map(|p| [p[0], p[1], p[2], 0]).collect();
        let view = glb.view(bytemuck::cast_slice(&padded));
        glb.views[view] = glb.views[view].replace('}', r#", "byteStride": 8}"#);
        glb.accessors.push(format!(
            r#"{{"bufferView": {view}, "componentType": 5122, "count": 8, "type": "VEC3", "min": [0, 0, 0], "max": [4, 6, 8]}}"#
        ));
        let i = glb.indices(FACES.as_flattened());
        let p = format!(r#""attributes": {{"POSITION": 0, "_BATCHID": {i}}}, "indices": {i}"#);
        let quantized =
            r#", "extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"]"#;
        assert_eq!(shape(&glb.read(&one(&p, quantized)).0), BOX);
        // All zeros but those of seven corners.
        let mut glb = Glb::default();
        let at = glb.view(&[1u8, 2, 3, 4, 5, 6, 7]);
        let to = glb.view(bytemuck::cast_slice(&CORNERS[1..]));
        let sparse = |count: u64| {
            format!(
                r#"{{"componentType": 5126, "count": {count}, "type": "VEC3", "min": [0, 0, 0], "max": [4, 6, 8], "sparse": {{"count": 7,
                "indices": {{"bufferView": {at}, "componentType": 5121}}, "values": {{"bufferView": {to}}}}}}}"#
            )
        };
        glb.accessors.push(sparse(8));
        let i = glb.indices(FACES.as_flattened());
        let p = format!(r#""attributes": {{"POSITION": 0}}, "indices": {i}"#);
        assert_eq!(shape(&glb.read(&one(&p, "")).0), BOX);
        glb.accessors[0] = sparse(5);
        assert!(error("a.glb", &glb.bytes(&one(&p, "")), "--voxel 1").contains("a sparse value of element 5 of 5"));
        glb.accessors[0] = sparse(1 << 40);
        assert!(error("a.glb", &glb.bytes(&one(&p, "")), "--voxel 1").contains("elements without data"));
        // One of two nodes is hidden.
        let (glb, p) = Glb::cuboid();
        let json = format!(
            r#""scenes": [{{"nodes": [0, 1]}}, {{"nodes": []}}], "meshes": [{{"primitives": [{{{p}}}]}}], "nodes": [{{"mesh": 0}}, {{"children": [2],
            "translation": [20, 0, 0], "extensions": {{"KHR_node_visibility": {{"visible": false}}}}}}, {{"mesh": 0}}]"#
        );
        let (input, about) = glb.read(&json);
        assert_eq!(shape(&input), BOX);
        assert!(left_out(&about, "1 nodes that are not visible") && left_out(&about, "1 other scenes"), "{about:?}");
    }

    #[test]
    fn gltf_nodes_keep_the_digits_of_maps() {
        let (glb, p) = Glb::cuboid();
        let json = |x: f64| {
            format!(
                r#""scenes": [{{"nodes": [0, 1]}}], "meshes": [{{"primitives": [{{{p}}}]}}], "nodes": [
                {{"mesh": 0, "translation": [{x}, 0, 4649776]}}, {{"mesh": 0, "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, {}, 0, 4649776.25, 1]}}]"#,
                x + 4.25
            )
        };
        let near = told("a.glb", &glb.bytes(&json(0.0)), "--voxel 0.25").0.columns;
        let far = told("a.glb", &glb.bytes(&json(7_500_000.125)), "--voxel 0.25").0.columns;
        assert_eq!((near.dims(), near), ([33, 24, 33], far));
    }

    #[test]
    fn gltf_that_needs_what_is_not_read_is_refused_with_advice() {
        let (glb, p) = Glb::cuboid();
        let with = |name: &str| {
            glb.bytes(&one(&p, &format!(r#", "extensionsUsed": ["{name}"], "extensionsRequired": ["{name}"]"#)))
        };
        let refused = |name: &str, advice: &str| {
            let text = error("a.glb", &with(name), "--voxel 1");
            assert!(text.contains(&format!("needs the extension {name}")) && text.contains(advice), "{text}");
        };
        refused("KHR_draco_mesh_compression", "write the file without compression");
        refused("EXT_meshopt_compression", "write the file without compression");
        refused("KHR_texture_basisu", "pictures in PNG or JPEG");
        refused("VENDOR_of_tomorrow", "write the file without it");
        assert_eq!(shape(&told("a.glb", &with("KHR_materials_unlit"), "--voxel 1").0), BOX);
        let (input, about) =
            glb.read(&one(&p, r#", "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_variants"]"#));
        assert_eq!(shape(&input), BOX);
        assert_eq!(about.left_out, ["what these extensions say: KHR_lights_punctual, KHR_materials_variants"]);
        // Nodes that are no tree.
        let twice = format!(
            r#""scenes": [{{"nodes": [0, 1]}}], "meshes": [{{"primitives": [{{{p}}}]}}],
            "nodes": [{{"children": [2]}}, {{"children": [2]}}, {{"mesh": 0}}]"#
        );
        assert!(error("a.glb", &glb.bytes(&twice), "--voxel 1").contains("node 2 is a child of two nodes"));
        let ring = twice.replace("[0, 1]}", "[0]}").replacen("[2]", "[1]", 1).replacen("[2]", "[0]", 1);
        assert!(error("a.glb", &glb.bytes(&ring), "--voxel 1").contains("children of each other"));
        // Without scenes all is drawn.
        let library = one(&p, "").replace("\"nodes\"", "\"scenes\": [], \"nodes\"");
        assert_eq!(shape(&told("a.glb", &glb.bytes(&library), "--voxel 1").0), BOX);
    }
}
