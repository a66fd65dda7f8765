#!/bin/sh
# trimesh 5.2.0 reads the voxels of a .binvox file as scale/(n-1) wide, with the first one's centre at `translate`.
#
# The format's text (https://www.patrickmin.com/binvox/binvox.html) says that n voxels fill a cube of side 1: voxel i has its
# centre at (i + 0.5)/n, which is multiplied by `scale` and moved by `translate`. So a cube of 4 voxels with `scale 4` and
# `translate 0 0 0` fills 0 to 4, each voxel 1 wide. trimesh gives voxels 1.333 wide that fill -0.667 to 4.667: a third too
# large at n = 4, 0.8 % at n = 128, and moved by half a voxel. What is solid is read rightly; only the place is not.
# Seen: "pitch 1.3333 box -0.6667 to 4.6667".
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/venv"
"$dir/venv/bin/pip" install --quiet trimesh==5.2.0 numpy==2.4.6
"$dir/venv/bin/python" - <<'PY'
import io
import trimesh

data = b"#binvox 1\ndim 4 4 4\ntranslate 0 0 0\nscale 4\ndata\n" + bytes([1, 64])
grid = trimesh.load(io.BytesIO(data), file_type="binvox")
low, high = grid.bounds[0][0], grid.bounds[1][0]
seen = f"pitch {grid.scale[0]:.4f} box {low:.4f} to {high:.4f}"
print(seen)
assert grid.matrix.all()
assert seen == "pitch 1.3333 box -0.6667 to 4.6667", seen
PY
