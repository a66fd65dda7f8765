#!/bin/sh
# pypcd4 1.5.1 writes colours of points as 0 in the text form of PCD, without a word; its binary forms keep them.
#
# PCL packs a colour into the bits of a float ("rgb", type F). As a number that is near 1e-38, so text has to be written
# with digits that count, as PCL's own 2.3463973e-38. pypcd4 writes ten decimals, "0.0000000000", and what it reads back is
# black. Expected: (255, 128, 3) from each of the three forms. Seen (Linux x86-64, Python 3.11): ascii (0, 0, 0), binary and
# binary_compressed (255, 128, 3).
#
# Exits with 0 while that is so.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/venv"
"$dir/venv/bin/pip" install --quiet pypcd4==1.5.1 numpy==2.4.6
cd "$dir"
"$dir/venv/bin/python" - <<'PYTHON'
import numpy as np
from pypcd4 import Encoding, PointCloud

packed = PointCloud.encode_rgb(np.array([[255, 128, 3]], "u1"))
cloud = PointCloud.from_xyzrgb_points(np.column_stack([np.zeros((1, 3), "f4"), packed]))
seen = {}
for encoding in (Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED):
    cloud.save("a.pcd", encoding=encoding)
    rgb = PointCloud.decode_rgb(PointCloud.from_path("a.pcd").numpy(("rgb",)))
    seen[encoding.value] = tuple(int(v) for v in rgb[0])
print(seen)
assert seen == {"ascii": (0, 0, 0), "binary": (255, 128, 3), "binary_compressed": (255, 128, 3)}, seen
PYTHON
