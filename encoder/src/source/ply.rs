//! PLY, text and binary: meshes, and clouds of points where there are no faces.

use std::io::Read;
use std::path::Path;

use super::mesh::{Mesh, PLAIN, Paint};
use super::texture::{Texture, Textures, Wrap};
use crate::{Error, Result, Rgb};

#[derive(Clone, Copy, PartialEq)]
enum Form {
    Text,
    Little,
    Big,
}

#[derive(Clone, Copy)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn parse(s: &str) -> Option<Type> {
        Some(match s {
            "char" | "int8" => Type::I8,
            "uchar" | "uint8" => Type::U8,
            "short" | "int16" => Type::I16,
            "ushort" | "uint16" => Type::U16,
            "int" | "int32" => Type::I32,
            "uint" | "uint32" => Type::U32,
            "float" | "float32" => Type::F32,
            "double" | "float64" => Type::F64,
            _ => return None,
        })
    }

    /// What a colour of this type is divided by.
    fn white(self) -> f64 {
        match self {
            Type::F32 | Type::F64 => 1.0,
            Type::U16 => 65_535.0,
            _ => 255.0,
        }
    }
}

struct Property {
    name: String,
    /// Type of the count, for lists.
    count: Option<Type>,
    of: Type,
}

struct Element {
    name: String,
    n: u64,
    properties: Vec<Property>,
}

/// Values one after the other, and where they stand.
struct Values<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    form: Form,
    /// Where the values of a row must end.
    end: usize,
}

impl Values<'_> {
    fn fail<T>(&self, what: impl std::fmt::Display) -> Result<T> {
        Err(Error::format(self.path, format!("byte {}: {what}", self.at)))
    }

    fn skip_blanks(&mut self) {
        while self.at < self.end && self.bytes[self.at].is_ascii_whitespace() {
            self.at += 1;
        }
    }

    /// Goes to the next line that is not empty: the next row stands in it.
    fn start_line(&mut self) {
        self.end = self.bytes.len();
        self.skip_blanks();
        let rest = &self.bytes[self.at..];
        self.end = self.at + rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(rest.len());
    }

    /// Whether more values stand in the line than were taken; goes behind them.
    fn end_line(&mut self) -> bool {
        self.skip_blanks();
        let more = self.at < self.end;
        (self.at, self.end) = (self.end, self.bytes.len());
        more
    }

    fn next(&mut self, of: Type) -> Result<f64> {
        if self.form == Form::Text {
            self.skip_blanks();
            let rest = &self.bytes[self.at..self.end];
            let len = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            let number = std::str::from_utf8(&rest[..len]).ok().and_then(|s| s.parse().ok());
            let Some(number) = number else {
                return self.fail(match len {
                    0 if self.end == self.bytes.len() => "the file ends among its values",
                    0 => "the line has fewer values than the header names",
                    _ => "expected a number",
                });
            };
            self.at += len;
            return Ok(number);
        }
        macro_rules! take {
            ($t:ty) => {{
                let Some(Ok(bytes)) =
                    self.bytes.get(self.at..self.at + size_of::<$t>()).map(<[u8; size_of::<$t>()]>::try_from)
                else {
                    return self.fail("the file ends among its values");
                };
                self.at += bytes.len();
                f64::from(if self.form == Form::Big { <$t>::from_be_bytes(bytes) } else { <$t>::from_le_bytes(bytes) })
            }};
        }
        Ok(match of {
            Type::I8 => take!(i8),
            Type::U8 => take!(u8),
            Type::I16 => take!(i16),
            Type::U16 => take!(u16),
            Type::I32 => take!(i32),
            Type::U32 => take!(u32),
            Type::F32 => take!(f32),
            Type::F64 => take!(f64),
        })
    }
}

/// What a property is read for.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    Nothing,
    Axis(usize),
    Color(usize),
    /// Place on a picture.
    Place(usize),
    /// Corners of a face.
    Corners,
    /// Corners of strips of triangles, -1 between them.
    Strips,
    /// Places on a picture of a face's corners.
    Places,
    /// Number of a face's picture.
    Picture,
}

impl Element {
    fn role(&self, property: &Property) -> Role {
        let is_list = property.count.is_some();
        let (vertex, face) = (self.name == "vertex", self.name == "face");
        match property.name.as_str() {
            "x" if vertex && !is_list => Role::Axis(0),
            "y" if vertex && !is_list => Role::Axis(1),
            "z" if vertex && !is_list => Role::Axis(2),
            "red" | "r" | "diffuse_red" if (vertex || face) && !is_list => Role::Color(0),
            "green" | "g" | "diffuse_green" if (vertex || face) && !is_list => Role::Color(1),
            "blue" | "b" | "diffuse_blue" if (vertex || face) && !is_list => Role::Color(2),
            "s" | "u" | "texture_u" if vertex && !is_list => Role::Place(0),
            "t" | "v" | "texture_v" if vertex && !is_list => Role::Place(1),
            "vertex_indices" | "vertex_index" if face && is_list => Role::Corners,
            "vertex_indices" | "vertex_index" if self.name == "tristrips" && is_list => Role::Strips,
            "texcoord" if face && is_list => Role::Places,
            "texnumber" if face && !is_list => Role::Picture,
            _ => Role::Nothing,
        }
    }

    fn has(&self, role: Role) -> bool {
        self.properties.iter().any(|p| self.role(p) == role)
    }

    fn has_colors(&self) -> bool {
        (0..3).all(|k| self.has(Role::Color(k)))
    }

    fn has_faces(&self) -> bool {
        self.has(Role::Corners) || self.has(Role::Strips)
    }
}

/// A mesh; one without triangles is a cloud of points. The bytes may be packed by gzip.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let mut unpacked = Vec::new();
    let bytes = if bytes.starts_with(b"\x1f\x8b") {
        let done = flate2::read::MultiGzDecoder::new(bytes).read_to_end(&mut unpacked);
        done.map_err(|e| Error::format(path, format!("gzip stream, after {} bytes: {e}", unpacked.len())))?;
        &unpacked
    } else {
        bytes
    };
    let header = header(path, bytes)?;
    let body = |by_lines| Body { path, bytes, header: &header, by_lines }.read();
    // A row of text stands in a line of its own, says the format, but not all writers keep to it; others write more into it than
    // the header names. Where all words are just those that are named, lines do not matter.
    let by_words = body(false);
    if header.form != Form::Text || by_words.as_ref().is_ok_and(|(_, left)| *left == 0) {
        let (mut mesh, left) = by_words?;
        if left > 0 {
            mesh.about.left_out.push(format!("{left} bytes after the last element"));
        }
        return Ok(mesh.finish());
    }
    let (mesh, left) = body(true).map_err(|e| by_words.err().unwrap_or(e))?;
    if left > 0 {
        let at = bytes.len() as u64 - left;
        let what = format!(
            "byte {at}: values are left after the last element; the header names too few elements or properties"
        );
        return Err(Error::format(path, what));
    }
    Ok(mesh.finish())
}

/// What follows a header.
struct Body<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    header: &'a Header,
    /// Whether a row is a line, whatever else stands in it.
    by_lines: bool,
}

/// A row of an element.
#[derive(Default)]
struct Row {
    position: [f64; 3],
    color: Rgb,
    place: [f32; 2],
    corners: Vec<i64>,
    places: Vec<f32>,
    picture: usize,
}

impl Body<'_> {
    /// The mesh, and how many bytes are left that are not blank.
    fn read(&self) -> Result<(Mesh, u64)> {
        let Header { form, elements, .. } = self.header;
        let names = ["ASCII", "binary", "big-endian"];
        let mut mesh = Mesh::new(format!("{} PLY", names[*form as usize]));
        self.say_unread(&mut mesh);
        // Faces need the places of their corners, which may come after them.
        let vertices = elements.iter().position(|e| e.name == "vertex");
        let faces = elements.iter().position(Element::has_faces);
        let mut left = 0;
        for (vertices, faces) in if vertices < faces { &[(true, true)][..] } else { &[(true, false), (false, true)] } {
            left = self.pass(&mut mesh, *vertices, *faces)?;
        }
        Ok((mesh, left))
    }

    /// Reads all values, and keeps vertices or faces or both.
    fn pass(&self, mesh: &mut Mesh, vertices: bool, faces: bool) -> Result<u64> {
        let Header { form, elements, start, .. } = self.header;
        let bytes = self.bytes;
        let mut values = Values { path: self.path, bytes, at: *start, form: *form, end: bytes.len() };
        let vertex_colors = elements.iter().any(|e| e.name == "vertex" && e.n > 0 && e.has_colors());
        let mut painter = Painter { pictures: vec![None; self.header.pictures.len()], textures: Textures::default() };
        for element in elements {
            let roles: Vec<Role> = element.properties.iter().map(|p| element.role(p)).collect();
            let is_vertex = element.name == "vertex";
            if is_vertex && (0..3).any(|k| !roles.contains(&Role::Axis(k))) {
                return Err(Error::format(self.path, "PLY: vertices without x, y and z"));
            }
            // An element takes a byte at least, so that no header makes this program wait for more than the file has.
            if element.n > bytes.len() as u64 && !element.properties.is_empty() {
                return values.fail(format!("{} of {} do not fit the file", element.n, element.name));
            }
            let colored = element.has_colors();
            let placed = !self.header.pictures.is_empty() && element.has(Role::Place(0)) && element.has(Role::Place(1));
            let (mut more, mut row) = (0u64, Row::default());
            let first = mesh.triangles.len();
            for _ in 0..element.n.min(bytes.len() as u64) {
                if self.by_lines {
                    values.start_line();
                }
                row.read(&mut values, element, &roles)?;
                if self.by_lines && values.end_line() {
                    more += 1;
                }
                if is_vertex && vertices {
                    mesh.positions.push(row.position);
                    if colored {
                        mesh.colors.push(row.color);
                    }
                    if placed {
                        mesh.uvs.push(row.place);
                    }
                } else if !is_vertex && faces && element.has_faces() {
                    let own = (colored && !vertex_colors).then_some(row.color);
                    let n = self.header.n_vertices();
                    if let Some(corner) = row.corners.iter().find(|&&c| !(0..n).contains(&c) && c != -1) {
                        return values.fail(format!("a face with corner {corner} of {n}"));
                    }
                    self.push(mesh, &row, own, roles.contains(&Role::Strips), &mut painter)?;
                }
            }
            if more > 0 && faces {
                let mut said =
                    format!("what {more} rows of {} hold beyond the values that the header names", element.name);
                if element.has_faces() && colored && !vertex_colors {
                    // Where a list is longer than named, other values have come to the place of colours.
                    mesh.face_colors.truncate(first);
                    said += ", and their colours";
                }
                mesh.about.left_out.push(said);
            }
        }
        let rest = &bytes[values.at..];
        Ok(rest.iter().position(|b| !b.is_ascii_whitespace() && *b != 0).map_or(0, |blank| (rest.len() - blank) as u64))
    }

    /// Adds a face or strips.
    fn push(&self, mesh: &mut Mesh, row: &Row, own: Option<Rgb>, strips: bool, painter: &mut Painter) -> Result<()> {
        let first = mesh.triangles.len();
        if strips {
            for strip in row.corners.split(|&c| c == -1) {
                mesh.triangles.extend(strip.windows(3).map(|t| [t[0] as u32, t[1] as u32, t[2] as u32]));
            }
            mesh.mark(first, own, PLAIN);
            return Ok(());
        }
        if row.corners.contains(&-1) {
            return Err(Error::format(self.path, "PLY: a face with corner -1"));
        }
        let mut corners: Vec<u32> = row.corners.iter().map(|&c| c as u32).collect();
        let of_face = row.places.len() == 2 * corners.len() && !corners.is_empty();
        let paint = match of_face || !mesh.uvs.is_empty() {
            true => painter.paint(self, mesh, row.picture),
            false => PLAIN,
        };
        if paint != PLAIN && of_face {
            for (corner, place) in corners.iter_mut().zip(row.places.as_chunks::<2>().0) {
                let n = mesh.positions.len();
                mesh.positions.push(mesh.positions[*corner as usize]);
                if let Some(&color) = mesh.colors.get(*corner as usize) {
                    mesh.colors.push(color);
                }
                mesh.lay(n, [[place[0], 1.0 - place[1]]].into_iter());
                *corner = n as u32;
            }
        }
        mesh.push_polygon(&corners);
        // A picture has all the colour there is.
        mesh.mark(first, if paint == PLAIN { own } else { Some([255; 3]) }, paint);
        Ok(())
    }

    /// Names what the header names and nothing reads.
    fn say_unread(&self, mesh: &mut Mesh) {
        let Header { elements, pictures, .. } = self.header;
        let vertex_colors = elements.iter().any(|e| e.name == "vertex" && e.n > 0 && e.has_colors());
        for element in elements.iter().filter(|e| e.n > 0) {
            let is_vertex = element.name == "vertex";
            let mut say = |what: String| mesh.about.left_out.push(what);
            if !is_vertex && !element.has_faces() {
                say(format!("{} of {:?}", element.n, shown(&element.name)));
                continue;
            }
            if !is_vertex && vertex_colors && element.has_colors() {
                say(format!("colours of {:?}: those of vertices are drawn", shown(&element.name)));
            }
            let without_picture =
                |role| pictures.is_empty() && matches!(role, Role::Place(_) | Role::Places | Role::Picture);
            let unread = element.properties.iter().filter(|p| {
                let role = element.role(p);
                role == Role::Nothing || without_picture(role)
            });
            let names: Vec<String> = unread.map(|p| shown(&p.name)).collect();
            match names.as_slice() {
                [] => {}
                few if few.len() <= 6 => say(format!("{} of {:?}", few.join(", "), shown(&element.name))),
                many => {
                    say(format!("{} and {} more of {:?}", many[..4].join(", "), many.len() - 4, shown(&element.name)))
                }
            }
        }
    }
}

/// As a message may show it.
fn shown(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(40).collect()
}

impl Row {
    fn read(&mut self, values: &mut Values, element: &Element, roles: &[Role]) -> Result<()> {
        for (property, &role) in element.properties.iter().zip(roles) {
            let n = match property.count {
                None => 1,
                Some(count) => {
                    let n = values.next(count)?;
                    if !(0.0..=values.bytes.len() as f64).contains(&n) {
                        return values.fail(format!("a list of {n} values"));
                    }
                    n as usize
                }
            };
            match role {
                Role::Corners | Role::Strips => self.corners.clear(),
                Role::Places => self.places.clear(),
                _ => {}
            }
            for _ in 0..n {
                let value = values.next(property.of)?;
                match role {
                    Role::Nothing => {}
                    Role::Axis(axis) => self.position[axis] = value,
                    Role::Color(channel) => {
                        self.color[channel] = (value / property.of.white() * 255.0).clamp(0.0, 255.0).round() as u8;
                    }
                    Role::Place(0) => self.place[0] = value as f32,
                    Role::Place(_) => self.place[1] = 1.0 - value as f32,
                    Role::Corners | Role::Strips => {
                        if !(-1.0..=f64::from(u32::MAX)).contains(&value) {
                            return values.fail(format!("a face with corner {value}"));
                        }
                        self.corners.push(value as i64);
                    }
                    Role::Places => self.places.push(value as f32),
                    Role::Picture => self.picture = value.max(0.0) as usize,
                }
            }
        }
        Ok(())
    }
}

/// The pictures that a header names, read where a face asks for them.
struct Painter {
    pictures: Vec<Option<u32>>,
    textures: Textures,
}

impl Painter {
    /// Number of the paint with that picture.
    fn paint(&mut self, body: &Body, mesh: &mut Mesh, picture: usize) -> u32 {
        let (Some(known), Some(name)) = (self.pictures.get_mut(picture), body.header.pictures.get(picture)) else {
            return PLAIN;
        };
        *known.get_or_insert_with(|| {
            let file = body.path.parent().unwrap_or(Path::new("")).join(name.replace('\\', "/"));
            let wrap = [Wrap::Repeat; 2];
            let texture = self
                .textures
                .number(mesh, name.clone(), wrap, false, || Texture::read(&file, &super::map(&file)?, wrap, false));
            texture.map_or(PLAIN, |texture| mesh.paint(Paint { texture: Some(texture), cutoff: None }))
        })
    }
}

/// What stands before the values.
struct Header {
    form: Form,
    elements: Vec<Element>,
    /// Names of pictures, which MeshLab and those that follow it put into comments.
    pictures: Vec<String>,
    /// Where the values start.
    start: usize,
}

impl Header {
    fn n_vertices(&self) -> i64 {
        self.elements.iter().filter(|e| e.name == "vertex").map(|e| e.n as i64).sum()
    }
}

fn header(path: &Path, bytes: &[u8]) -> Result<Header> {
    let (mut form, mut elements, mut pictures) = (None, Vec::<Element>::new(), Vec::new());
    // Lines end in LF, CR LF, or, as in the format's first description, in CR: all as the first does.
    let line_end = if bytes.get(3) == Some(&b'\r') && bytes.get(4) != Some(&b'\n') { b'\r' } else { b'\n' };
    let mut at = 0;
    let mut line_ix = 0;
    loop {
        let fail = |what: String| Err(Error::format(path, format!("byte {at}: {what}")));
        let Some(len) = bytes[at..].iter().position(|&b| b == line_end) else {
            return fail("the file ends inside the PLY header".to_owned());
        };
        let line = String::from_utf8_lossy(&bytes[at..at + len]);
        let words: Vec<&str> = line.split_whitespace().collect();
        let wrong = || fail(format!("PLY header: {:?} is not understood", line.trim_end()));
        match words.as_slice() {
            ["ply"] if line_ix == 0 => {}
            _ if line_ix == 0 => return fail("expected \"ply\"".to_owned()),
            ["format", name, _] => {
                form = Some(match *name {
                    "ascii" => Form::Text,
                    "binary_little_endian" => Form::Little,
                    "binary_big_endian" => Form::Big,
                    _ => return wrong(),
                });
            }
            ["comment", "TextureFile", _, ..] => {
                let name = line.split_once("TextureFile").map_or("", |(_, name)| name.trim());
                pictures.push(name.to_owned());
            }
            ["comment" | "obj_info", ..] | [] => {}
            ["element", name, n] => {
                let Ok(n) = n.parse() else { return wrong() };
                elements.push(Element { name: (*name).to_owned(), n, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let property = match rest {
                    ["list", count, of, name] => Some((Type::parse(count).map(Some), Type::parse(of), name)),
                    [of, name] => Some((Some(None), Type::parse(of), name)),
                    _ => None,
                };
                let (Some((Some(count), Some(of), name)), Some(element)) = (property, elements.last_mut()) else {
                    return wrong();
                };
                element.properties.push(Property { name: (*name).to_owned(), count, of });
            }
            ["end_header"] => {
                let Some(form) = form else { return fail("the PLY header ends without \"format\"".to_owned()) };
                return Ok(Header { form, elements, pictures, start: at + len + 1 });
            }
            _ => return wrong(),
        }
        at += len + 1;
        line_ix += 1;
    }
}
