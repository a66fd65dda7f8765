//! The inside of meshes: `--fill`.
//!
//! A voxel is inside where its middle is. What that means is decided part by part, a part being what hangs together by
//! corners at the same place:
//!
//! - A part is closed where every edge has an even number of faces. Holes whose flat covers have together at most
//!   [`HOLES`] of the part's area are closed by these covers, which are drawn nowhere; so are cracks, which have no area. A part
//!   with larger ones is open, and nothing is filled for it.
//! - Of parts whose neighbouring faces agree on which side is outside, those that overlap are one, and one that is turned inside
//!   out is a cavity: a voxel is inside where the number of layers around it, counted by that side, is not 0.
//! - A part whose faces do not agree is inside where a line upwards crosses it an odd number of times.
//!
//! Lines are those through the middles of columns. An edge that two faces share is crossed by both or by neither, as both
//! compute the same numbers, so that no line slips through between them.

use std::collections::HashMap;
use std::ops::Range;

use super::mesh::in_bands;
use super::spots::Filled;
use crate::Run;

/// Area of holes that are closed, in parts of that of the faces around them.
const HOLES: f64 = 0.01;

/// In [`Inside::part_of`]: one whose faces agree.
const AGREED: u32 = u32::MAX;

/// Faces around what is inside.
pub(super) struct Inside {
    /// Corners in voxels of the world, one a place.
    positions: Vec<[f32; 3]>,
    /// Faces of closed parts, and covers of their holes.
    triangles: Vec<[u32; 3]>,
    /// Number of the part of each triangle, where its faces do not agree; else [`AGREED`].
    part_of: Vec<u32>,
    bands: Vec<Vec<u32>>,
    n_parts: usize,
    n_open: usize,
    /// Edges of open parts with an odd number of faces.
    open_edges: usize,
    n_covers: usize,
}

/// An edge of a part, from the lower number to the higher.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Edge {
    part: u32,
    from: u32,
    to: u32,
    /// 1 where a face goes along it in this sense, −1 where in the other.
    sense: i32,
}

impl Inside {
    /// Of triangles whose corners are in voxels of a world with `nz` rows.
    pub fn new(corners: &[[f32; 3]], faces: &[[u32; 3]], nz: u32) -> Inside {
        let (positions, place_of) = weld(corners);
        let faces: Vec<[u32; 3]> = faces.iter().map(|t| t.map(|i| place_of[i as usize])).filter(has_area).collect();
        let roots = roots(positions.len(), &faces);
        let edges = edges(&faces, &roots);
        let mut area: HashMap<u32, f64> = HashMap::new();
        for face in &faces {
            *area.entry(roots[face[0] as usize]).or_default() += size(face.map(|i| positions[i as usize]));
        }
        let (mut n_parts, mut n_open, mut open_edges, mut n_covers) = (0, 0, 0, 0);
        let mut closed: HashMap<u32, u32> = HashMap::new();
        let mut covers: Vec<[u32; 3]> = Vec::new();
        for edges in edges.chunk_by(|a, b| a.part == b.part) {
            let part = edges[0].part;
            n_parts += 1;
            let (mut agree, mut odd) = (true, Vec::new());
            for same in edges.chunk_by(|a, b| (a.from, a.to) == (b.from, b.to)) {
                let senses = same.iter().map(|edge| edge.sense).sum::<i32>();
                agree &= senses.unsigned_abs() as usize == same.len() % 2;
                if same.len() % 2 == 1 {
                    // As a face that lies on the other side of it would go.
                    odd.push(if senses < 0 { (same[0].from, same[0].to) } else { (same[0].to, same[0].from) });
                }
            }
            let n = covers.len();
            cover(&odd, agree, &mut covers);
            let holes = covers[n..].iter().map(|t| size(t.map(|i| positions[i as usize]))).sum::<f64>();
            if holes > HOLES * area[&part] {
                n_open += 1;
                open_edges += odd.len();
                covers.truncate(n);
                continue;
            }
            n_covers += covers.len() - n;
            closed.insert(part, if agree { AGREED } else { part });
        }
        let (triangles, part_of): (Vec<[u32; 3]>, Vec<u32>) = faces
            .into_iter()
            .chain(covers)
            .filter_map(|t| closed.get(&roots[t[0] as usize]).map(|&part| (t, part)))
            .unzip();
        let bands = in_bands(&positions, &triangles, nz);
        Inside { positions, triangles, part_of, bands, n_parts, n_open, open_edges, n_covers }
    }

    /// Whether nothing is inside of anything.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// What was not filled.
    pub fn left_out(&self) -> Option<String> {
        let Inside { n_parts, n_open, open_edges, .. } = self;
        (*n_open > 0).then(|| {
            format!(
                "the inside of {n_open} of {n_parts} parts: they are open, {open_edges} edges have a face on one side alone \
                 and what they leave is above a hundredth of the part's area; close the mesh, or leave --fill away"
            )
        })
    }

    pub fn notes(&self) -> Option<String> {
        (self.n_covers > 0).then(|| format!("{} triangles close holes of parts that are filled", self.n_covers))
    }

    /// The runs inside, in the columns `xs × zs` of a band, whose rows are `zs`; `ny` is the world's height.
    pub fn runs(
        &self,
        band: u32,
        xs: &Range<u32>,
        zs: &Range<u32>,
        ny: u32,
        number: impl Fn(u32, u32) -> u32,
    ) -> Vec<Filled> {
        let mut crossings = Vec::new();
        for &i in self.bands.get(band as usize).into_iter().flatten() {
            let part = self.part_of[i as usize];
            let triangle = self.triangles[i as usize].map(|v| self.positions[v as usize].map(f64::from));
            cross(&triangle, xs, zs, |x, z, y, sense| crossings.push((number(x, z), y, part, sense)));
        }
        crossings.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then((a.2, a.3).cmp(&(b.2, b.3))));
        let mut out: Vec<Filled> = Vec::new();
        let mut odd: Vec<u32> = Vec::new();
        for column in crossings.chunk_by(|a, b| a.0 == b.0) {
            let mut layers = 0;
            odd.clear();
            for pair in column.windows(2) {
                let (_, low, part, sense) = pair[0];
                match part {
                    AGREED => layers += sense,
                    _ => match odd.iter().position(|&p| p == part) {
                        Some(i) => drop(odd.swap_remove(i)),
                        None => odd.push(part),
                    },
                }
                if layers == 0 && odd.is_empty() {
                    continue;
                }
                // Of voxels, those whose middles lie between.
                let cell = |y: f64| (y - 0.5).ceil().clamp(0.0, ny.into()) as u32;
                let (first, end) = (cell(low), cell(pair[1].1));
                if first < end {
                    out.push(Filled { column: pair[0].0, run: Run::new(first as u16, (end - 1) as u16) });
                }
            }
        }
        out
    }
}

/// Corners at different places, and of each corner which of these it is.
fn weld(corners: &[[f32; 3]]) -> (Vec<[f32; 3]>, Vec<u32>) {
    let mut places: HashMap<[u32; 3], u32> = HashMap::new();
    let mut positions: Vec<[f32; 3]> = Vec::new();
    let place_of = corners
        .iter()
        .map(|&p| {
            // −0 is 0.
            let p = p.map(|v| v + 0.0);
            *places.entry(p.map(f32::to_bits)).or_insert_with(|| {
                positions.push(p);
                positions.len() as u32 - 1
            })
        })
        .collect();
    (positions, place_of)
}

fn has_area([a, b, c]: &[u32; 3]) -> bool {
    a != b && b != c && c != a
}

/// All edges of faces, part by part.
fn edges(faces: &[[u32; 3]], roots: &[u32]) -> Vec<Edge> {
    let mut edges: Vec<Edge> = Vec::with_capacity(3 * faces.len());
    for &[a, b, c] in faces {
        let part = roots[a as usize];
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let sense = if from < to { 1 } else { -1 };
            edges.push(Edge { part, from: from.min(to), to: from.max(to), sense });
        }
    }
    edges.sort_unstable();
    edges
}

/// Whether each face is of a part without any hole.
pub(super) fn closed(corners: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<bool> {
    let (positions, place_of) = weld(corners);
    let places: Vec<[u32; 3]> = faces.iter().map(|t| t.map(|i| place_of[i as usize])).collect();
    let all: Vec<[u32; 3]> = places.iter().copied().filter(has_area).collect();
    let roots = roots(positions.len(), &all);
    let mut is_closed = vec![true; positions.len()];
    for same in edges(&all, &roots).chunk_by(|a, b| (a.from, a.to) == (b.from, b.to)) {
        is_closed[same[0].part as usize] &= same.len() % 2 == 0;
    }
    places.iter().map(|t| is_closed[roots[t[0] as usize] as usize]).collect()
}

/// Of each corner the number of one that stands for all it hangs together with.
fn roots(n: usize, faces: &[[u32; 3]]) -> Vec<u32> {
    let mut above: Vec<u32> = (0..n as u32).collect();
    fn root(above: &mut [u32], mut i: u32) -> u32 {
        while above[i as usize] != i {
            above[i as usize] = above[above[i as usize] as usize];
            i = above[i as usize];
        }
        i
    }
    for &[a, b, c] in faces {
        for other in [b, c] {
            let (p, q) = (root(&mut above, a), root(&mut above, other));
            above[p.max(q) as usize] = p.min(q);
        }
    }
    (0..n as u32).map(|i| root(&mut above, i)).collect()
}

/// Triangles over the rings that `edges` form, each a fan from a corner of the ring. At every corner as many edges come as go;
/// where they are of no sense (not `directed`) an even number meets.
fn cover(edges: &[(u32, u32)], directed: bool, out: &mut Vec<[u32; 3]>) {
    let mut from: HashMap<u32, Vec<usize>> = HashMap::new();
    for (i, &(a, b)) in edges.iter().enumerate() {
        from.entry(a).or_default().push(i);
        if !directed {
            from.entry(b).or_default().push(i);
        }
    }
    let mut done = vec![false; edges.len()];
    for (i, &(first, mut at)) in edges.iter().enumerate() {
        if std::mem::replace(&mut done[i], true) {
            continue;
        }
        while at != first {
            let next = loop {
                match from.get_mut(&at).and_then(Vec::pop) {
                    Some(next) if done[next] => {}
                    next => break next,
                }
            };
            let Some(next) = next else { break };
            done[next] = true;
            let before = at;
            at = if edges[next].0 == before { edges[next].1 } else { edges[next].0 };
            if at != first {
                out.push([first, before, at]);
            }
        }
    }
}

/// Area of a triangle.
fn size(corners: [[f32; 3]; 3]) -> f64 {
    let [a, b, c] = corners.map(|p| p.map(f64::from));
    let side = |p: [f64; 3], k: usize| p[k % 3] - a[k % 3];
    let normal = [0, 1, 2].map(|k| side(b, k + 1) * side(c, k + 2) - side(b, k + 2) * side(c, k + 1));
    normal.iter().map(|v| v * v).sum::<f64>().sqrt() / 2.0
}

/// Where the lines through the middles of the columns `xs × zs` cross a triangle: column, height, and 1 or −1 by the side
/// that they come from.
fn cross(triangle: &[[f64; 3]; 3], xs: &Range<u32>, zs: &Range<u32>, mut each: impl FnMut(u32, u32, f64, i32)) {
    let ends = |axis: usize| {
        let [a, b, c] = triangle.map(|p| p[axis]);
        (a.min(b).min(c), a.max(b).max(c))
    };
    // The first cell whose middle is not below.
    let cell = |v: f64| (v - 0.5).ceil().max(0.0) as u32;
    let (low, high) = ends(2);
    let (lowest, highest) = ends(1);
    let [a, b, c] = triangle;
    let side = |p: &[f64; 3], k: usize| p[k] - a[k];
    // Of the plane: its slopes, times what they are divided by.
    let along_x = side(b, 1) * side(c, 2) - side(b, 2) * side(c, 1);
    let along_z = side(b, 0) * side(c, 1) - side(b, 1) * side(c, 0);
    let below = side(b, 0) * side(c, 2) - side(b, 2) * side(c, 0);
    for z in cell(low).max(zs.start)..cell(high).min(zs.end) {
        let middle = f64::from(z) + 0.5;
        let (mut up, mut down) = (None, None);
        for (p, q) in [(a, b), (b, c), (c, a)] {
            // From the lower end to the higher, so that both faces of an edge compute the same.
            let (to, p, q) = if p[2] <= q[2] { (&mut up, p, q) } else { (&mut down, q, p) };
            if p[2] <= middle && middle < q[2] {
                *to = Some(p[0] + (middle - p[2]) * (q[0] - p[0]) / (q[2] - p[2]));
            }
        }
        let (Some(up), Some(down)) = (up, down) else { continue };
        let (from, to, sense) = if up <= down { (up, down, -1) } else { (down, up, 1) };
        for x in cell(from).max(xs.start)..cell(to).min(xs.end) {
            let (dx, dz) = (f64::from(x) + 0.5 - a[0], middle - a[2]);
            let y = a[1] + (dx * along_x + dz * along_z) / below;
            each(x, z, if y.is_finite() { y.clamp(lowest, highest) } else { lowest }, sense);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::BAND;
    use super::*;

    /// The rows of a band.
    fn rows(band: u32, nz: u32) -> Range<u32> {
        band * BAND..nz.min((band + 1) * BAND)
    }

    type Mesh = (Vec<[f32; 3]>, Vec<[u32; 3]>);

    /// A box, its faces turned outwards, or inwards where `inverted`.
    fn cuboid(low: [f32; 3], high: [f32; 3], inverted: bool) -> Mesh {
        let corner = |i: usize| [0, 1, 2].map(|k| if i >> (2 - k) & 1 == 1 { high[k] } else { low[k] });
        let faces = [
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
            [1, 7, 3u32],
        ];
        let turned = faces.map(|[a, b, c]| if inverted { [a, c, b] } else { [a, b, c] });
        ((0..8).map(corner).collect(), turned.to_vec())
    }

    fn join(parts: &[Mesh]) -> Mesh {
        let (mut corners, mut faces) = (Vec::new(), Vec::new());
        for (of, triangles) in parts {
            let n = corners.len() as u32;
            corners.extend(of);
            faces.extend(triangles.iter().map(|t| t.map(|i| i + n)));
        }
        (corners, faces)
    }

    /// Number of voxels inside, of a world of 40³.
    fn volume(mesh: &Mesh) -> (u32, Inside) {
        let inside = Inside::new(&mesh.0, &mesh.1, 40);
        let all: Vec<Filled> =
            (0..2).flat_map(|band| inside.runs(band, &(0..40), &rows(band, 40), 40, |x, z| 40 * z + x)).collect();
        assert!(all.windows(2).all(|f| f[0].column < f[1].column || f[0].run.end() <= f[1].run.first().into()));
        (all.iter().map(|f| f.run.end() - u32::from(f.run.first())).sum(), inside)
    }

    #[test]
    fn inside_of_boxes_is_what_they_enclose() {
        let outer = cuboid([2.0, 3.0, 4.0], [22.0, 33.0, 38.0], false);
        assert_eq!(volume(&outer).0, 20 * 30 * 34);
        // Middles alone count.
        assert_eq!(volume(&cuboid([2.4, 3.6, 4.0], [4.6, 5.4, 6.0], false)).0, 3 * 2);
        // Turned inside out as a whole, it is the same.
        assert_eq!(volume(&cuboid([2.0, 3.0, 4.0], [22.0, 33.0, 38.0], true)).0, 20 * 30 * 34);
        // A cavity, and a solid within a solid.
        let within = |inverted| cuboid([5.0, 6.0, 7.0], [10.0, 11.0, 12.0], inverted);
        assert_eq!(volume(&join(&[outer.clone(), within(true)])).0, 20 * 30 * 34 - 125);
        assert_eq!(volume(&join(&[outer.clone(), within(false)])).0, 20 * 30 * 34);
        // Two that overlap are one.
        let beside = cuboid([12.0, 3.0, 4.0], [32.0, 33.0, 38.0], false);
        assert_eq!(volume(&join(&[outer, beside])).0, 30 * 30 * 34);
    }

    #[test]
    fn inside_of_parts_whose_faces_disagree_is_by_parity() {
        let (corners, mut faces) = cuboid([2.0, 3.0, 4.0], [22.0, 33.0, 38.0], false);
        faces[4].swap(0, 1);
        faces[7].swap(0, 1);
        assert_eq!(volume(&(corners, faces)).0, 20 * 30 * 34);
    }

    #[test]
    fn small_holes_are_closed_and_large_ones_are_said() {
        // A lid with a hole of 2 × 2 of 7,160: a box with a shaft that ends nowhere.
        let (mut corners, mut faces) = cuboid([0.0, 0.0, 0.0], [30.0, 40.0, 40.0], false);
        let lid = faces.iter().position(|t| *t == [2, 3, 7]).unwrap();
        let before = faces.clone();
        // Around the middle of one of the two triangles of the lid.
        let n = corners.len() as u32;
        corners.extend([[19.0, 40.0, 29.0], [21.0, 40.0, 29.0], [21.0, 40.0, 31.0]]);
        let ring = [n, n + 1, n + 2];
        let outer = [2, 3, 7u32];
        faces.remove(lid);
        // A ring of triangles between the outer corners and the hole's.
        for k in 0..3 {
            let (a, b) = (outer[k], outer[(k + 1) % 3]);
            let (p, q) = (ring[k], ring[(k + 1) % 3]);
            faces.push([a, b, q]);
            faces.push([a, q, p]);
        }
        let (filled, inside) = volume(&(corners.clone(), faces));
        assert_eq!((filled, inside.n_open, inside.n_covers), (30 * 40 * 40, 0, 1));
        assert_eq!(inside.left_out(), None);
        // Without a lid it is open, and its neighbour is not.
        let mut open = before;
        open.retain(|t| *t != [2, 3, 7] && *t != [2, 7, 6]);
        let other = cuboid([32.0, 0.0, 0.0], [40.0, 10.0, 10.0], false);
        let (filled, inside) = volume(&join(&[(corners[..8].to_vec(), open), other]));
        assert_eq!((filled, inside.n_parts, inside.n_open), (8 * 10 * 10, 2, 1));
        let said = inside.left_out().unwrap();
        assert!(said.starts_with("the inside of 1 of 2 parts: they are open, 4 edges"), "{said}");
    }

    #[test]
    fn cracks_without_area_are_closed() {
        // The edge between two faces has a corner more on one side.
        let (mut corners, mut faces) = cuboid([0.0, 0.0, 0.0], [30.0, 40.0, 40.0], false);
        corners.push([0.0, 0.0, 13.0]);
        let first = faces.iter().position(|t| *t == [0, 1, 3]).unwrap();
        faces[first] = [0, 8, 3];
        faces.push([8, 1, 3]);
        assert_eq!(volume(&(corners, faces)).0, 30 * 40 * 40);
    }

    #[test]
    fn inside_of_a_ball_has_its_volume() {
        // Columns' lines pass through edges and corners of this one: its corners lie on middles.
        let (mut corners, mut faces) = (Vec::new(), Vec::new());
        let (rings, around) = (16u32, 24u32);
        for (i, j) in (0..=rings).flat_map(|i| (0..around).map(move |j| (i, j))) {
            let (a, b) = (
                std::f64::consts::PI * f64::from(i) / f64::from(rings),
                std::f64::consts::TAU * f64::from(j) / f64::from(around),
            );
            let r = if i == 0 || i == rings { 0.0 } else { a.sin() };
            corners.push(
                [20.5 + 18.0 * r * b.cos(), 20.5 + 18.0 * a.cos(), 20.5 + 18.0 * r * b.sin()]
                    .map(|v| (v * 2.0).round() as f32 / 2.0),
            );
        }
        for (i, j) in (0..rings).flat_map(|i| (0..around).map(move |j| (i, j))) {
            let at = |i: u32, j: u32| around * i + j % around;
            faces.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
            faces.push([at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)]);
        }
        let solid = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i: u32| corners[i as usize].map(|v: f32| f64::from(v) - 20.0));
            (a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0]))
                / 6.0
        };
        let exact = faces.iter().map(solid).sum::<f64>().abs();
        let (filled, inside) = volume(&(corners, faces));
        assert_eq!((inside.n_parts, inside.n_open), (1, 0));
        assert!((f64::from(filled) / exact - 1.0).abs() < 0.01, "{filled} of {exact}");
    }
}
