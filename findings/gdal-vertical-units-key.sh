#!/usr/bin/env bash
# GDAL (rasterio 1.4.4 with GDAL 3.10.3): the unit of heights that a GeoTIFF names in its key VerticalUnitsGeoKey (4099) is
# dropped as soon as the file also names a vertical reference system by code (VerticalGeoKey, 4096), and `units` says the
# unit of that code instead. The horizontal keys work the other way round: a linear unit named beside a code for the map
# (ProjLinearUnitsGeoKey, 3076) replaces the code's own.
#
# It matters because elevation data in feet often name NAVD 88 as EPSG:5703, which is in metres, together with a unit of
# feet: taken as metres they are drawn 3.28 times too high, and nothing warns.
#
# Expected before it was run: the key wins in both places, as it does for the map.
# Seen:
#   key 4099 = foot alone                  -> units foot
#   key 4099 = foot and 4096 = EPSG:5703   -> units metre
#   key 3076 = foot and 3072 = EPSG:32617  -> linear unit foot (0.3048)
# Exits with a status other than 0 once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/v"
"$folder/v/bin/pip" install --quiet rasterio==1.4.4 tifffile==2026.3.3 numpy
cd "$folder"
v/bin/python - <<'PY'
import numpy, rasterio, tifffile, warnings
warnings.simplefilter("ignore")

def read(keys):
    """What rasterio says of a map of 2 x 3 pixels with these keys."""
    directory = (1, 1, 0, len(keys)) + tuple(n for id, value in keys for n in (id, 0, 1, value))
    tifffile.imwrite("a.tif", numpy.zeros((2, 3), "i2"), metadata=None, extratags=[
        (34735, "H", len(directory), directory, True),
        (33550, "d", 3, (10, 10, 0), True),
        (33922, "d", 6, (0, 0, 0, 500000, 4000000, 0), True)])
    with rasterio.open("a.tif") as d:
        return d.units[0], d.crs.linear_units_factor

FOOT, NAVD88_METRES, UTM_METRES = 9002, 5703, 32617
utm = [(1024, 1), (3072, UTM_METRES)]
alone = read(utm + [(4099, FOOT)])
beside_code = read(utm + [(4096, NAVD88_METRES), (4099, FOOT)])
of_map = read(utm + [(3076, FOOT)])
print("key alone:", alone[0], "| key beside a vertical code:", beside_code[0], "| map:", of_map[1])
assert alone[0] == "foot", alone
assert beside_code[0] == "metre", beside_code
assert of_map[1] == ("foot", 0.3048), of_map
PY
