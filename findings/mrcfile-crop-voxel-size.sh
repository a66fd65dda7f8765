#!/bin/sh
# mrcfile 1.5.4 keeps the cell when data of another shape is set, so the voxel size changes without a word; its validator agrees.
#
# An MRC header says how large the whole map's cell is and into how many intervals it is cut; the size of a voxel is the quotient.
# mrcfile sets the intervals from the new array and leaves the cell. Expected of a map of voxels of 1.5 Å, of which the lower half is
# kept: 1.5 Å in all three axes, or a warning. Seen (mrcfile 1.5.4, numpy 2.4.6, Linux x86-64, Python 3.11): 1.5, 1.5, 3.0 Å; the
# map comes out twice as thick as it was. A map whose voxel size was never set has a cell of 0 and voxels of 0 Å. `validate` finds
# both files valid. Setting the voxel size after the data is what helps.
#
# Exits with 0 while that is so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q mrcfile==1.5.4 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" -W error - <<'PYTHON'
import mrcfile
import numpy as np

volume = np.ones((6, 7, 8), "f4")
with mrcfile.new("map.mrc") as map:
    map.set_data(volume)
    assert map.voxel_size.item() == (0, 0, 0), map.voxel_size
assert mrcfile.validate("map.mrc")
with mrcfile.open("map.mrc", "r+") as map:
    map.voxel_size = 1.5
with mrcfile.open("map.mrc", "r+") as map:
    map.set_data(volume[:3])
with mrcfile.open("map.mrc") as map:
    print(map.data.shape, "voxels of", map.voxel_size, "cell", map.header.cella)
    assert map.voxel_size.item() == (1.5, 1.5, 3.0)
assert mrcfile.validate("map.mrc")
PYTHON
