#!/bin/sh
# meshio 5.3.5 (Python): reads the colours of a PLY file's faces, and writes a PLY file without them, and without a warning.
#
# `meshio.read` gives face properties (red, green, blue, a label, …) as cell data. `meshio.write` of the same mesh to PLY, text or
# binary, has a face element with the list of vertices alone: whoever converts or cleans a coloured mesh with it gets a grey
# one. Point data are kept, cell data are kept in VTK files, and for what it leaves out of an STL or OFF file it does warn.
#
# Seen, with two triangles, one red and one blue:
#   read: red [255, 0], blue [0, 255]
#   written as ply, text: 0 face properties beside the list; binary: 0; warnings: 0
#   written as vtk and read: red [255, 0]
#
# Needs python3 with venv, and PyPI. Exits with a status other than 0 where it comes out otherwise.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
python3 -m venv v
v/bin/pip install -q --disable-pip-version-check meshio==5.3.5 'numpy<3'
cat > f.ply <<'PLY'
ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
property uchar red
property uchar green
property uchar blue
end_header
0 0 0
1 0 0
1 1 0
0 1 0
3 0 1 2 255 0 0
3 0 2 3 0 0 255
PLY
cat > t.py <<'PY'
import contextlib, io, pathlib, warnings, meshio
words = io.StringIO()
with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words), warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    mesh = meshio.read("f.ply")
    beside = {}
    for name, binary in [("text", False), ("binary", True)]:
        meshio.write("g.ply", mesh, binary=binary)
        head = pathlib.Path("g.ply").read_bytes().split(b"end_header")[0]
        beside[name] = head.split(b"element face")[1].count(b"property") - 1
meshio.write("g.vtk", mesh)
colours = [mesh.cell_data[k][0].tolist() for k in ("red", "blue")]
kept = meshio.read("g.vtk").cell_data["red"][0].tolist()
said = len(caught) + len(words.getvalue())
print(f"read: red {colours[0]}, blue {colours[1]}")
print(f"written as ply, text: {beside['text']} face properties beside the list; binary: {beside['binary']}; warnings: {said}")
print(f"written as vtk and read: red {kept}")
assert colours == [[255, 0], [0, 255]] and kept == [255, 0], "reading has changed"
assert beside == {"text": 0, "binary": 0} and said == 0, "writing has changed"
PY
v/bin/python t.py
