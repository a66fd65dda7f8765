#!/bin/sh
# stl_io 0.11.0 (Rust): of a text STL with several solids, read_stl gives the first alone, and no error.
#
# Many programs write one "solid … endsolid" for each part, one after the other in a file, and trimesh, numpy-stl and MeshLab read them
# all. The reader of stl_io ends at the first "endsolid": the facets behind it are neither read nor reported, so that what is
# left looks like a whole, smaller model. `create_stl_reader` ends there as well.
#
# Seen, with a triangle in each of two solids:
#   read_stl: 1 of 2 facets
#   create_stl_reader: 1 of 2 facets, 0 errors
#
# Needs cargo and a registry. Exits with a status other than 0 where it comes out otherwise.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
mkdir src
cat > Cargo.toml <<'TOML'
[package]
name = "several-solids"
version = "0.0.0"
edition = "2021"

[dependencies]
stl_io = "=0.11.0"
TOML
cat > src/main.rs <<'RUST'
use std::io::Cursor;

fn main() {
    let solid = |name: &str| {
        format!(
            "solid {name}\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid {name}\n"
        )
    };
    let text = solid("a") + &solid("b");
    let mesh = stl_io::read_stl(&mut Cursor::new(text.as_bytes())).unwrap();
    println!("read_stl: {} of 2 facets", mesh.faces.len());
    let mut cursor = Cursor::new(text.as_bytes());
    let all: Vec<_> = stl_io::create_stl_reader(&mut cursor).unwrap().collect();
    let errors = all.iter().filter(|facet| facet.is_err()).count();
    println!("create_stl_reader: {} of 2 facets, {errors} errors", all.len() - errors);
}
RUST
found=$(cargo run --quiet 2>&1)
echo "$found"
expected='read_stl: 1 of 2 facets
create_stl_reader: 1 of 2 facets, 0 errors'
[ "$found" = "$expected" ]
