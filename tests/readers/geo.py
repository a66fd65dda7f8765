"""Height maps that lie somewhere: GeoTIFF, ESRI ASCII grids, SRTM tiles, USGS DEM, mosaics, PNG of heights in colours.

Each is written here, most with rasterio (GDAL), and read by rasterio and by planecast. Compared: size, columns without
data, heights in voxels (one voxel is as high as a pixel is wide), the ground size of a pixel (pyproj), the reference
system, and the affine map.
"""

import gzip
import hashlib
import re
import warnings

import numpy as np
import pyproj
import rasterio
import rasterio.merge
import tifffile
from rasterio.transform import Affine, from_origin

warnings.filterwarnings("ignore")

LIBRARY = f"rasterio {rasterio.__version__} (GDAL {rasterio.__gdal_version__}), pyproj {pyproj.__version__}"
FEET = {"ft": 0.3048, "foot": 0.3048, "US survey foot": 1200 / 3937, "ftUS": 1200 / 3937, "m": 1.0, "metre": 1.0, "cm": 0.01}

Z, X = np.mgrid[0:40, 0:60]
DEM = (100 + 20 * np.sin(X / 9) + 15 * np.cos(Z / 7)).astype("f4")
UTM = from_origin(500000, 4600000, 10, 10)


def write(path, a, crs="EPSG:32617", transform=UTM, after=None, mask=None, more=(), **k):
    bands = [a, *more]
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(
        path, "w", driver="GTiff", height=a.shape[0], width=a.shape[1], count=len(bands), dtype=a.dtype, crs=crs,
        transform=transform, **k
    ) as d:
        for i, band in enumerate(bands):
            d.write(band, i + 1)
        if mask is not None:
            d.write_mask(mask)
        if after:
            after(d)
    return path


def short(v):
    return f"{v:.4g}"


def pixel_metres(d, transform, unit=None):
    """East-west and north-south ground size of the pixel in the centre."""
    t, (h, w) = transform, d.shape
    a, b = np.hypot(t.a, t.d), np.hypot(t.b, t.e)
    if unit is not None:
        return a * unit, b * unit
    crs = pyproj.CRS.from_wkt(d.crs.to_wkt())
    x, y = t * (w / 2, h / 2)
    if crs.is_geographic:
        unit = crs.axis_info[0].unit_conversion_factor * 180 / np.pi
        geod = crs.get_geod()
        x, y, a, b = x * unit, y * unit, a * unit, b * unit
        return geod.inv(x - a / 2, y, x + a / 2, y)[2], geod.inv(x, y - b / 2, x, y + b / 2)[2]
    unit = d.crs.linear_units_factor[1]
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    method = horizontal.coordinate_operation.method_name if horizontal.coordinate_operation else ""
    if "Mercator" in method and "Transverse" not in method or "quidistant Cyl" in method:
        proj = pyproj.Proj(horizontal)
        f = proj.get_factors(*proj(x * unit, y * unit, inverse=True))
        return a * unit / f.parallel_scale, b * unit / f.meridional_scale
    return a * unit, b * unit


def crs_name(d):
    """As planecast says it: parts of a compound system by a plus."""
    if d.crs is None:
        return ""
    crs = pyproj.CRS.from_wkt(d.crs.to_wkt())
    parts = [c.to_epsg() for c in crs.sub_crs_list] if crs.is_compound else [crs.to_epsg()]
    if all(parts):
        return "EPSG:" + "+".join(map(str, parts))
    return crs.name


def by_library(d, values=None, unit=None, metres=None):
    """The properties as rasterio has them, south-up rasters turned."""
    t = d.transform
    if values is None:
        values = d.read(1, masked=True)
        values = values.astype("f8") * (d.scales[0] or 1) + (d.offsets[0] or 0)
        if np.issubdtype(np.dtype(d.dtypes[0]), np.floating):
            values = np.ma.masked_invalid(values)
    h, w = values.shape
    if t.e > 0 and t.b == 0:
        values, t = values[::-1], t * Affine(1, 0, 0, 0, -1, h)
    if t.a < 0 and t.b == 0:
        values, t = values[:, ::-1], t * Affine(-1, 0, w, 0, 1, 0)
    name = unit or d.units[0]
    if not name and d.crs:
        crs = pyproj.CRS.from_wkt(d.crs.to_wkt())
        vertical = [c for c in crs.sub_crs_list if c.is_vertical] if crs.is_compound else []
        name = vertical[0].axis_info[0].unit_name if vertical else ""
    up = FEET.get(name, 1.0)
    metres = metres or pixel_metres(d, t)
    base = min(0.0, float(values.min()))
    voxels = np.floor((values.astype("f4").astype("f8") - base) * up / metres[0] + 0.5).filled(-1).astype(int)
    return {
        "size": f"{w} × {h}",
        "empty": int(np.ma.getmaskarray(values).sum()),
        "heights": summary(voxels),
        "pixel": " × ".join(map(short, metres)),
        "crs": crs_name(d),
        "affine": " ".join(f"{v + 0:.9g}" for v in t[:6]),
    }


def summary(voxels):
    flat = voxels.ravel()
    return f"{flat[:4].tolist()} … {flat[-4:].tolist()}, sum {flat.sum()}, {hashlib.md5(voxels.astype('<i4').tobytes()).hexdigest()[:8]}"


def by_planecast(planecast, path, *flags):
    scene, said = planecast.encode(path, "--explain", *flags)
    if scene is None:
        return {"refusal": said.strip()}
    raw, (nx, ny, nz) = planecast.occupancy(scene)
    voxels = np.frombuffer(raw, "u1").reshape(nz, ny, nx).sum(1).astype(int) - 1
    line = said.splitlines()[0]
    cube = re.search(r"a voxel is (\S+) m wide", line)
    box = re.search(r"a voxel is (\S+) × (\S+) × (\S+) m", line)
    east, _, north = [cube[1]] * 3 if cube else box.groups() if box else ["?"] * 3
    crs = line.rsplit("; ", 1)[-1] if "; " in line else ""
    place = re.search(r"east = (\S+) x \+ (\S+) z \+ (\S+), north = (\S+) x \+ (\S+) z \+ (\S+)[,;]", said + ";")
    return {
        "size": f"{nx} × {nz}",
        "empty": int((voxels < 0).sum()),
        "heights": summary(voxels),
        "pixel": " × ".join(short(float(v)) for v in (east, north)) if east != "?" else "?",
        "crs": crs,
        "affine": " ".join(f"{float(v) + 0:.9g}" for v in place.groups()) if place else "?",
        "said": said,
    }


PROPERTIES = {
    "size": "size in pixels",
    "empty": "pixels without data",
    "heights": "heights in voxels",
    "pixel": "metres of a pixel east-west, north-south",
    "crs": "reference system",
    "affine": "affine map",
}


def compare(planecast, format, what, path, *flags, library=None, skip=(), **k):
    """A row for each property of one file."""
    if library is None:
        with rasterio.open(path) as d:
            library = by_library(d, **k)
    got = by_planecast(planecast, path, *flags)
    for key, name in PROPERTIES.items():
        if key in library and key not in skip:
            yield format, f"{what}: {name}", LIBRARY, library[key], got.get(key, got.get("refusal"))


def patched(path, tag, values, dtype=None):
    """Overwrites the values of a TIFF's tag in place (equal in number)."""
    with tifffile.TiffFile(path, mode="r+") as t:
        t.pages[0].tags[tag].overwrite(values, dtype=dtype) if dtype else t.pages[0].tags[tag].overwrite(values)
    return path


def rows(planecast):
    p = planecast.path
    yield from tiffs(planecast, p)
    yield from places(planecast, p)
    yield from grids(planecast, p)
    yield from mosaics(planecast, p)
    yield from refused(planecast, p)


def tiffs(planecast, p):
    """How values are stored."""
    i2 = ((DEM - 100) * 100).round().astype("i2")
    mask = np.full(DEM.shape, 255, "u1")
    mask[:10] = 0
    holes = DEM.copy()
    holes[5:9, 7:30] = -9999
    nan = DEM.copy()
    nan[3, 4:9] = np.nan

    def scaled(d):
        d.scales, d.offsets = (0.01,), (100.0,)

    def feet(d):
        d.units = ("ft",)

    def us_feet(d):
        d.units = ("US survey foot",)

    alpha = np.where(mask > 0, 255, 0).astype("u1")
    cases = [
        ("f32", dict(a=DEM)),
        ("f64", dict(a=DEM.astype("f8"))),
        ("i16", dict(a=DEM.astype("i2"))),
        ("u16 deflate, predictor 2", dict(a=DEM.astype("u2"), compress="deflate", predictor=2)),
        ("f32 deflate, predictor 3", dict(a=DEM, compress="deflate", predictor=3)),
        ("f32 LZW, predictor 3, tiles", dict(a=DEM, compress="lzw", predictor=3, tiled=True, blockxsize=16, blockysize=16)),
        ("f32 ZSTD, tiles", dict(a=DEM, compress="zstd", tiled=True, blockxsize=32, blockysize=32)),
        ("i32 ZSTD, predictor 2", dict(a=DEM.astype("i4"), compress="zstd", predictor=2)),
        ("f32 LERC, tiles", dict(a=DEM, compress="lerc", tiled=True, blockxsize=16, blockysize=16)),
        ("f32 LERC with NaN", dict(a=nan, compress="lerc", MAX_Z_ERROR=0)),
        ("i16 LERC and ZSTD", dict(a=DEM.astype("i2"), compress="lerc_zstd")),
        ("u8 LERC and deflate", dict(a=DEM.astype("u1"), compress="lerc_deflate")),
        ("i16 LERC, big endian", dict(a=DEM.astype("i2"), compress="lerc", ENDIANNESS="BIG")),
        ("u32 LERC, tiles, big endian", dict(a=DEM.astype("u4"), compress="lerc", ENDIANNESS="BIG", tiled=True, blockxsize=32, blockysize=16)),
        ("24 bits", dict(a=DEM.astype("u4"), NBITS=24)),
        ("1 bit, CCITT Group 4", dict(a=(DEM > 100).astype("u1"), NBITS=1, compress="ccittfax4")),
        ("1 bit, CCITT Group 3", dict(a=(DEM > 100).astype("u1"), NBITS=1, compress="ccittfax3")),
        ("1 bit, CCITT modified Huffman", dict(a=(DEM > 100).astype("u1"), NBITS=1, compress="ccittrle")),
        ("u8 PackBits", dict(a=DEM.astype("u1"), compress="packbits")),
        ("u32, big endian", dict(a=DEM.astype("u4"), ENDIANNESS="BIG")),
        ("f32 deflate, predictor 3, big endian", dict(a=DEM, compress="deflate", predictor=3, ENDIANNESS="BIG")),
        ("i16 LZW, predictor 2, big endian", dict(a=DEM.astype("i2"), compress="lzw", predictor=2, ENDIANNESS="BIG")),
        ("BigTIFF", dict(a=DEM, BIGTIFF="YES")),
        ("BigTIFF, big endian, tiles", dict(a=DEM, BIGTIFF="YES", ENDIANNESS="BIG", tiled=True, blockxsize=16, blockysize=32)),
        ("12 bits", dict(a=DEM.astype("u2"), NBITS=12)),
        ("half floats", dict(a=DEM, NBITS=16)),
        ("MinIsWhite, u8", dict(a=DEM.astype("u1"), PHOTOMETRIC="MINISWHITE")),
        ("MinIsWhite, f32", dict(a=DEM, PHOTOMETRIC="MINISWHITE")),
        ("no-data value", dict(a=holes, nodata=-9999)),
        ("no-data value of f32, rounded text", dict(a=np.where(holes < 0, np.float32(-3.4028235e38), DEM).astype("f4"), nodata=-3.4028234663852886e38)),
        ("NaN without a no-data value", dict(a=nan)),
        ("NaN as no-data value", dict(a=nan, nodata=np.nan)),
        ("scale and offset", dict(a=i2, after=scaled)),
        ("scale, offset and no-data value", dict(a=np.where(holes < 0, -32768, i2).astype("i2"), after=scaled, nodata=-32768)),
        ("unit ft of the band", dict(a=DEM, after=feet)),
        ("unit US survey foot of the band", dict(a=DEM, after=us_feet)),
        ("mask page", dict(a=np.where(mask > 0, DEM, -32767).astype("f4"), mask=mask)),
        ("mask page, deflate", dict(a=np.where(mask > 0, DEM, -32767).astype("f4"), mask=mask, compress="deflate", tiled=True, blockxsize=16, blockysize=16)),
        ("alpha band", dict(a=DEM.astype("u1"), more=[alpha], ALPHA="YES")),
        ("three bands, chunky", dict(a=DEM, more=[DEM + 5, DEM * 2], interleave="pixel")),
        ("three bands, planar, deflate", dict(a=DEM, more=[DEM + 5, DEM * 2], interleave="band", compress="deflate", predictor=3)),
        ("three bands, chunky, predictor 2", dict(a=DEM.astype("i2"), more=[DEM.astype("i2") + 5, DEM.astype("i2") * 2], interleave="pixel", compress="lzw", predictor=2)),
    ]
    near = np.where(holes < 0, np.float32(1e20), holes).astype("f8")
    cases.append(("no-data value of f64 that were f32", dict(a=near, nodata=1e20)))
    for what, k in cases:
        yield from compare(planecast, "GeoTIFF", what, write(p("a.tif"), **k))
    for compress in (None, "deflate", "lzw", "zstd"):
        for nodata in (-9999, None):
            a = np.full((96, 96), -9999 if nodata else 0, "f4")
            a[:40, :60] = DEM
            path = write(p("a.tif"), a, tiled=True, blockxsize=32, blockysize=32, SPARSE_OK=True, nodata=nodata, **({"compress": compress} if compress else {}))
            yield from compare(planecast, "GeoTIFF", f"sparse tiles, {compress}, no-data {nodata}", path, skip=("crs", "affine", "pixel"))
    path = write(p("a.tif"), DEM)
    with rasterio.open(path, "r+") as d:
        d.build_overviews([2, 4])
    yield from compare(planecast, "GeoTIFF", "overviews", path)
    got = by_planecast(planecast, path)["said"].splitlines()[1]
    yield "GeoTIFF", "overviews: what is left out", LIBRARY, "left out: 2 overviews", got


def places(planecast, p):
    """Where it lies."""
    geographic = from_origin(7.5, 46.5, 1 / 1200, 1 / 1200)
    cases = [
        ("EPSG:4326", dict(crs="EPSG:4326", transform=geographic)),
        ("EPSG:4326, southern", dict(crs="EPSG:4326", transform=from_origin(-70, -33, 1 / 3600, 1 / 3600))),
        ("EPSG:4326 at latitude 60", dict(crs="EPSG:4326", transform=from_origin(10, 60, 0.001, 0.002))),
        ("EPSG:4807, in grads", dict(crs="EPSG:4807", transform=from_origin(2, 51, 0.001, 0.001))),
        ("EPSG:3857 at latitude 60", dict(crs="EPSG:3857", transform=from_origin(1000000, 8400000, 20, 20))),
        ("EPSG:3857, southern", dict(crs="EPSG:3857", transform=from_origin(1000000, -5400000, 38.2, 38.2))),
        ("EPSG:3395", dict(crs="EPSG:3395", transform=from_origin(1000000, 8400000, 20, 20))),
        ("EPSG:3994, Mercator 41", dict(crs="EPSG:3994", transform=from_origin(1000000, -3767000, 20, 20))),
        ("EPSG:4087, equidistant", dict(crs="EPSG:4087", transform=from_origin(1000000, 5400000, 20, 20))),
        ("EPSG:2264, in ftUS", dict(crs="EPSG:2264", transform=from_origin(2000000, 600000, 20, 20))),
        ("EPSG:2222, in ft", dict(crs="EPSG:2222", transform=from_origin(600000, 900000, 20, 20))),
        ("EPSG:6543, in ftUS, step 2 of the table", dict(crs="EPSG:6543", transform=from_origin(2000000, 600000, 20, 20))),
        ("EPSG:27700", dict(crs="EPSG:27700", transform=from_origin(300000, 200000, 5, 5))),
        ("EPSG:2193", dict(crs="EPSG:2193", transform=from_origin(1500000, 5400000, 8, 8))),
        ("EPSG:26917+5703", dict(crs="EPSG:26917+5703")),
        ("EPSG:26917+6360, heights in ftUS", dict(crs="EPSG:26917+6360")),
        ("EPSG:26917+8228, heights in ft", dict(crs="EPSG:26917+8228")),
        ("EPSG:2264+6360, ftUS both", dict(crs="EPSG:2264+6360", transform=from_origin(2000000, 600000, 20, 20))),
        ("user-defined transverse Mercator in feet", dict(crs="+proj=tmerc +lat_0=36 +lon_0=-84 +k=0.9999 +x_0=200000 +units=us-ft +datum=NAD83", transform=from_origin(600000, 900000, 20, 20))),
        ("user-defined Mercator, true at 40", dict(crs="+proj=merc +lat_ts=40 +datum=WGS84", transform=from_origin(600000, 4900000, 20, 20))),
        ("user-defined Mercator of the Moon", dict(crs="+proj=merc +R=1737400 +units=m", transform=from_origin(600000, 1900000, 20, 20))),
        ("Moon in degrees", dict(crs="+proj=longlat +R=1737400 +no_defs", transform=from_origin(20, 30, 0.01, 0.01))),
        ("Moon, equidistant", dict(crs="+proj=eqc +R=1737400 +units=m", transform=from_origin(600000, 1200000, 100, 100))),
        ("pixel is point", dict(after=lambda d: d.update_tags(AREA_OR_POINT="Point"))),
        ("south-up", dict(transform=Affine(2, 0, 5e5, 0, 2, 4e6))),
        ("east-west mirrored", dict(transform=Affine(-2, 0, 5e5, 0, -2, 4e6))),
        ("turned by 180 degrees", dict(transform=Affine(-2, 0, 5e5, 0, 2, 4e6))),
        ("turned by 30 degrees", dict(transform=Affine.translation(5e5, 4e6) * Affine.rotation(30) * Affine.scale(10, -10))),
        ("sheared", dict(transform=Affine(10, 3, 5e5, 0, -10, 4e6))),
        ("pixels 10 × 20 m", dict(transform=from_origin(5e5, 4e6, 10, 20))),
    ]
    for what, k in cases:
        named = "user" not in what and "Moon" not in what
        yield from compare(planecast, "GeoTIFF", what, write(p("a.tif"), DEM, **k), skip=() if named else ("crs",))


def grids(planecast, p):
    """Formats beside TIFF."""
    holes = np.round(DEM, 2)
    holes[5:9, 7:30] = -9999

    def asc(path, head, values, prj=None, sep=" "):
        text = "".join(f"{k} {v}\n" for k, v in head.items()) + "\n".join(sep.join(f"{v:g}" for v in row) for row in values) + "\n"
        path.write_text(text)
        if prj:
            path.with_suffix(".prj").write_text(pyproj.CRS(prj).to_wkt("WKT1_ESRI"))
        return path

    head = dict(ncols=60, nrows=40, xllcorner=500000, yllcorner=4599600, cellsize=10, NODATA_value=-9999)
    centre = dict(NCOLS=60, NROWS=40, XLLCENTER=500005, YLLCENTER=4599605, CELLSIZE=10, nodata_value=-9999)
    names = ("crs",)
    yield from compare(planecast, "ESRI ASCII grid", "corner, .prj of UTM", asc(p("a.asc"), head, holes, "EPSG:32617"), skip=names)
    yield from compare(planecast, "ESRI ASCII grid", "centre, keys in capitals", asc(p("a.asc"), centre, holes, "EPSG:32617"), skip=names)
    yield from compare(planecast, "ESRI ASCII grid", ".prj in ftUS", asc(p("a.asc"), head, holes, "EPSG:2264"), skip=names)
    degrees = dict(ncols=60, nrows=40, xllcorner=7.5, yllcorner=46.5, cellsize=1 / 1200, NODATA_value=-9999)
    yield from compare(planecast, "ESRI ASCII grid", ".prj of degrees", asc(p("a.asc"), degrees, holes, "EPSG:4326"), skip=names)
    path = asc(p("a.asc"), head, holes)
    yield from compare(planecast, "ESRI ASCII grid", "no .prj: metres", path, metres=(10.0, 10.0), skip=names)
    no_nodata = {k: v for k, v in head.items() if k != "NODATA_value"}
    yield from compare(planecast, "ESRI ASCII grid", "no NODATA_value", asc(p("a.asc"), no_nodata, np.abs(holes)), metres=(10.0, 10.0), skip=names)
    two = {**{k: v for k, v in head.items() if k != "cellsize"}, "dx": 10, "dy": 20}
    path = asc(p("a.asc"), {k: two[k] for k in ("ncols", "nrows", "xllcorner", "yllcorner", "dx", "dy", "NODATA_value")}, holes)
    yield from compare(planecast, "ESRI ASCII grid", "dx and dy", path, metres=(10.0, 20.0), skip=names)

    for name, side in [("N46E007.hgt", 1201), ("S34W071.hgt", 1201), ("N60E010.hgt", 1201)]:
        z, x = np.mgrid[0:side, 0:side]
        a = (900 + 300 * np.sin(x / 90) + 200 * np.cos(z / 70)).astype(">i2")
        a[100:110, 200:205] = -32768
        path = p(name)
        path.write_bytes(a.tobytes())
        yield from compare(planecast, "SRTM HGT", name, path)
    packed = p("N46E007.hgt.gz")
    packed.write_bytes(gzip.compress(planecast.folder.glob("*/N46E007.hgt").__next__().read_bytes()))
    with rasterio.open(next(planecast.folder.glob("*/N46E007.hgt"))) as d:
        yield from compare(planecast, "SRTM HGT", "gzip", packed, library=by_library(d))

    # Heights in colours: the formulas that the services publish.
    height = np.round(DEM * 8 - 400, 1).astype("f8")
    code = np.round((height + 10000) * 10).astype(int)
    mapbox = np.stack([code >> 16, code >> 8 & 255, code & 255], -1).astype("u1")
    code = np.round((height + 32768) * 256).astype(int)
    terrarium = np.stack([code >> 16, code >> 8 & 255, code & 255], -1).astype("u1")
    from PIL import Image, __version__ as pillow
    for name, colours, metres in [("mapbox", mapbox, lambda c: c @ [6553.6, 25.6, 0.1] - 10000), ("terrarium", terrarium, lambda c: c @ [256, 1, 1 / 256] - 32768)]:
        path = p("a.png")
        Image.fromarray(colours).save(path)
        values = metres(np.asarray(Image.open(path)).astype("f8")).astype("f4").astype("f8")
        library = {"size": "60 × 40", "empty": 0, "heights": summary(np.floor(values - min(0, values.min()) + 0.5).astype(int))}
        for row in compare(planecast, "PNG", f"--rgb {name}", path, "--rgb", name, "--height-scale", "1", library=library):
            yield row[0], row[1], f"Pillow {pillow}, the published formula", row[3], row[4]
    grey = np.stack([DEM.astype("u1"), np.where(Z < 10, 0, 255).astype("u1")], -1)
    path = p("a.png")
    Image.fromarray(grey, "LA").save(path)
    values = np.where(grey[..., 1] > 0, grey[..., 0].astype(int), -1)
    library = {"size": "60 × 40", "empty": int((values < 0).sum()), "heights": summary(values)}
    for row in compare(planecast, "PNG", "grey and alpha", path, library=library):
        yield row[0], row[1], f"Pillow {pillow}", row[3], row[4]
    r16 = p("a.r16")
    values = (DEM[:40, :40] * 10).astype("<u2")
    values.tofile(r16)
    library = {"size": "40 × 40", "empty": 0, "heights": summary(np.fromfile(r16, "<u2").reshape(40, 40).astype(int))}
    for row in compare(planecast, "RAW16", "square", r16, "--height-scale", "1", library=library):
        yield row[0], row[1], f"numpy {np.__version__}", row[3], row[4]


def mosaics(planecast, p):
    """Folders of tiles, beside rasterio.merge."""

    def tiles(what, *parts, **k):
        folder = p("tiles")
        folder.mkdir()
        for i, (a, transform) in enumerate(parts):
            write(folder / f"t{i}.tif", a, transform=transform, **k)
        datasets = [rasterio.open(f) for f in sorted(folder.iterdir())]
        merged, transform = rasterio.merge.merge(datasets)
        with rasterio.MemoryFile() as memory:
            meta = dict(driver="GTiff", height=merged.shape[1], width=merged.shape[2], count=1, dtype=merged.dtype, crs=datasets[0].crs, transform=transform, nodata=datasets[0].nodata)
            with memory.open(**meta) as d:
                d.write(merged)
            with memory.open() as d:
                yield from compare(planecast, "mosaic", what, folder, library=by_library(d))

    b = DEM[:, 20:].copy()
    b[:, :20] = -9999
    at = lambda x, y: from_origin(500000 + 10 * x, 4600000 - 10 * y, 10, 10)
    yield from tiles("a collar without data", (DEM[:, :40], at(0, 0)), (b, at(20, 0)), nodata=-9999)
    yield from tiles("an overlap that differs", (DEM[:, :40], at(0, 0)), (DEM[:, 20:] + 50, at(20, 0)), nodata=-9999)
    yield from tiles("two by two", *[(DEM[z : z + 20, x : x + 30], at(x, z)) for z in (0, 20) for x in (0, 30)], nodata=-9999)
    yield from tiles("a gap", (DEM[:, :20], at(0, 0)), (DEM[:, 40:], at(40, 0)), nodata=-9999)
    south_up = lambda x: Affine(10, 0, 500000 + 10 * x, 0, 10, 4599600)
    folder = p("tiles")
    folder.mkdir()
    write(folder / "t0.tif", DEM[::-1, :30], transform=south_up(0))
    write(folder / "t1.tif", DEM[:, 30:], transform=at(30, 0))
    with rasterio.open(write(p("a.tif"), DEM)) as d:
        yield from compare(planecast, "mosaic", "a tile that is south-up", folder, library=by_library(d))
    folder = p("tiles")
    folder.mkdir()
    for i, name in enumerate(["N46E007.hgt", "N46E008.hgt"]):
        z, x = np.mgrid[0:1201, 0:1201]
        (900 + 300 * np.sin((x + 1200 * i) / 90) + 200 * np.cos(z / 70)).astype(">i2").tofile(folder / name)
    datasets = [rasterio.open(f) for f in sorted(folder.iterdir())]
    merged, transform = rasterio.merge.merge(datasets)
    path = write(p("a.tif"), merged[0], crs="EPSG:4326", transform=transform, nodata=-32768)
    with rasterio.open(path) as d:
        yield from compare(planecast, "mosaic", "two SRTM tiles that share a column", folder, library=by_library(d))


def refused(planecast, p):
    """What is refused, and by which name."""
    said = lambda path, *flags: by_planecast(planecast, path, *flags).get("refusal", "read")

    def names(what, path, *words):
        text = said(path)
        yield "GeoTIFF", f"{what}: refused by name", LIBRARY, " ".join(words), " ".join(w for w in words if w in text) or text

    folder = p("tiles")
    folder.mkdir()
    write(folder / "t0.tif", DEM[:, :30].copy())
    write(folder / "t1.tif", DEM[:, 30:].copy(), crs="EPSG:32618", transform=from_origin(500300, 4600000, 10, 10))
    yield from names("tiles of two zones", folder, "t1.tif", "EPSG:32618", "EPSG:32617")
    folder = p("tiles")
    folder.mkdir()
    write(folder / "t0.tif", DEM[:, :30].copy())
    write(folder / "t1.tif", DEM[:, 30:].copy(), transform=from_origin(500300, 4600000, 10, 10), after=lambda d: setattr(d, "units", ("ft",)))
    yield from names("tiles of two units", folder, "t1.tif", "ft")
    rgb = [DEM.astype("u1")] * 2
    yield from names("colours", write(p("a.tif"), DEM.astype("u1"), more=rgb, photometric="RGB"), "--rgb", "one band")
    yield from names("complex values", write(p("a.tif"), DEM.astype("c8")), "complex")
