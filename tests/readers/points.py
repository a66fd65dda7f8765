"""Clouds of points and models of voxel editors: laspy (with lazrs), pypcd4, plyfile, trimesh, py-vox-io; for formats that no
library writes, files made by the format's own text."""

import hashlib
import io
import struct
from importlib.metadata import version as version_of

import laspy
import lazrs
import numpy as np
import trimesh
from PIL import Image
from plyfile import PlyData, PlyElement
from pypcd4 import Encoding, PointCloud

VOXEL = 1.0
RNG = np.random.default_rng


def library(name):
    return f"{name} {version_of(name)}"


def told(dims, voxels):
    """Size and solid voxels in a few words: equal for equal worlds."""
    voxels = np.unique(np.asarray(voxels, "<i8").reshape(-1, 3), axis=0)
    return f"{' × '.join(map(str, dims))}, {len(voxels)} voxels, {hashlib.sha256(voxels.tobytes()).hexdigest()[:8]}"


def read(planecast, path, *flags):
    scene, said = planecast.encode(path, *flags)
    if scene is None:
        return None, f"refused: {said.strip()}", said
    raw, dims = planecast.occupancy(scene)
    nx, ny, nz = dims
    zyx = np.argwhere(np.frombuffer(raw, "u1").reshape(nz, ny, nx))[:, [2, 1, 0]]
    return scene, told(dims, zyx), said


def cloud(points, voxel=VOXEL, up="z"):
    """What a cloud becomes: a voxel where a point is."""
    x, y, z = np.asarray(points, "f8").T
    world = np.stack([x, z, -y] if up == "z" else [x, y, z], 1)
    # Places are decimals: what lies on a boundary must not fall below it by the last bit of an f64.
    cells = np.floor(np.round((world - world.min(0)) * (1 / voxel), 6)).astype(int)
    return told(cells.max(0) + 1, cells)


def cells_of(grid):
    """What a boolean grid of (x, y up, z) becomes."""
    return told(grid.shape, np.argwhere(grid))


def color(planecast, scene, x, y, z):
    return planecast.query(scene, x, y, z)["color"]


# LAS.


def las(path, version, format, n=400, edit=None, offset=(0, 0, 0), crs=None):
    header = laspy.LasHeader(point_format=format, version=version)
    header.scales, header.offsets = [0.01] * 3, offset
    if crs:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(crs))
        header.global_encoding.wkt = True
    out = laspy.LasData(header)
    places = RNG(format).random((n, 3)) * [40, 30, 12] + offset
    out.x, out.y, out.z = places.T
    out.classification = np.full(n, 2, "u1")
    if edit:
        edit(out)
    out.write(path)
    with laspy.open(path) as opened:
        return opened.read()


def xyz(points, keep=slice(None)):
    return np.stack([points.x, points.y, points.z], 1)[keep]


def las_rows(planecast):
    name = f"{library('laspy')} with {library('lazrs')}"
    for version, format in [("1.2", 0), ("1.2", 1), ("1.2", 2), ("1.2", 3), ("1.3", 3), ("1.4", 6), ("1.4", 7), ("1.4", 8)]:
        for end in ("las", "laz"):
            path = planecast.path(f"a.{end}")
            points = las(path, version, format)
            kind = f"{end.upper()} {version}, format {format}"
            yield kind, "where points are", name, cloud(xyz(points)), read(planecast, path, "--voxel", VOXEL)[1]

    path = planecast.path("utm.las")
    points = las(path, "1.4", 6, offset=(448_000, 4_190_000, 200))
    yield "LAS", "coordinates of a map", name, cloud(xyz(points)), read(planecast, path, "--voxel", VOXEL)[1]
    wkt = (
        'PROJCS["NAD83 / UTM zone 17N",GEOGCS["NAD83",DATUM["North_American_Datum_1983",SPHEROID["GRS 1980",6378137,298.257222101]],'
        'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",-81],'
        'UNIT["metre",1],AUTHORITY["EPSG","26917"]]'
    )
    path = planecast.path("crs.las")
    las(path, "1.4", 6, offset=(448_000, 4_190_000, 200), crs=wkt)
    yield "LAS", "reference system (WKT)", name, "EPSG:26917", "EPSG:26917" if "EPSG:26917" in read(planecast, path)[2] else "not said"

    for what, most in (("16 bits", 65_535), ("8 bits where 16 belong", 255)):
        path = planecast.path("rgb.las")

        def paint(out):
            out.x, out.y, out.z = np.arange(400) % 20, np.arange(400) // 20, np.zeros(400)
            out.red, out.green, out.blue = np.full(400, most), np.arange(400) % 20 * (most // 255), np.zeros(400)

        las(path, "1.2", 3, edit=paint)
        scene = read(planecast, path, "--voxel", VOXEL)[0]
        yield "LAS", f"colours of {what}", name, ["#ff0000", "#ff0700"], [color(planecast, scene, x, 0, 19) for x in (0, 7)]

    boxes = {"wide": (1e7, -1e7), "narrow": (9.0, 8.0), "empty": (0.0, 0.0), "turned round": (-1e7, 1e7), "NaN": (np.nan, np.nan)}
    for what, (high, low) in boxes.items():
        path = planecast.path("box.las")
        points = las(path, "1.2", 1)
        data = bytearray(path.read_bytes())
        data[179:227] = struct.pack("<6d", *[high, low] * 3)
        path.write_bytes(data)
        yield "LAS", f"a header whose box is {what}", name, cloud(xyz(points)), read(planecast, path, "--voxel", VOXEL)[1]

    def marks(out):
        n = len(out.x)
        z = np.array(out.z)
        z[:6] = [900, -400, 700, 3, 4, 5]
        out.z = z
        withheld, synthetic = np.zeros(n, "u1"), np.zeros(n, "u1")
        withheld[0], synthetic[3] = 1, 1
        out.withheld, out.synthetic = withheld, synthetic
        if hasattr(out, "overlap"):
            out.overlap = synthetic[::-1].copy()
        classes = np.arange(n) % 7
        classes[1] = 7
        classes[2] = 18
        out.classification = classes.astype("u1")

    for version, format, end in (("1.2", 3, "las"), ("1.4", 6, "las"), ("1.4", 7, "laz")):
        path = planecast.path(f"flags.{end}")
        points = las(path, version, format, edit=marks)
        kind = f"{end.upper()} {version}, format {format}"
        classes, withheld = np.array(points.classification), np.array(points.withheld).astype(bool)
        kept = ~withheld & ~np.isin(classes, [7, 18])
        yield kind, "no withheld points, no noise", name, cloud(xyz(points, kept)), read(planecast, path, "--voxel", VOXEL)[1]
        for flag, wanted in (("2,6", [2, 6]), ("3-5,18", [3, 4, 5, 18])):
            kept = ~withheld & np.isin(classes, wanted)
            got = read(planecast, path, "--voxel", VOXEL, "--las-classes", flag)[1]
            yield kind, f"--las-classes {flag}", name, cloud(xyz(points, kept)), got


def copc(path, n=600):
    """LAZ whose chunks are the nodes of an octree, by the text of COPC 1.0: a root and its children."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = [0.01] * 3
    out = laspy.LasData(header)
    out.x, out.y, out.z = (RNG(6).random((n, 3)) * [40, 30, 12]).round(2).T
    out.classification = np.full(n, 2, "u1")
    places = np.stack([out.x, out.y, out.z], 1)
    node = np.where(np.arange(n) % 4 == 0, -1, (places >= 20).astype(int) @ [1, 2, 4])
    packing = lazrs.LazVlr.new_for_compression(6, 0, True)
    packed = bytes(packing.record_data())
    start = 375 + 54 + 160 + 54 + len(packed)
    file = io.BytesIO(bytes(start))
    file.seek(start)
    writer = lazrs.LasZipCompressor(file, packing)
    writer.reserve_offset_to_chunk_table()
    entries = []
    for k in np.unique(node).tolist():
        at, points = file.tell(), out.points.array[node == k]
        writer.compress_many(np.frombuffer(points.tobytes(), "u1"))
        writer.finish_current_chunk()
        key = (0, 0, 0, 0) if k < 0 else (1, k & 1, k >> 1 & 1, k >> 2)
        entries.append(struct.pack("<4iQii", *key, at, file.tell() - at, len(points)))
    writer.done()
    tree, end = b"".join(entries), len(file.getvalue())

    def record(user, number, data):
        return struct.pack("<H16sHH32s", 0, user, number, len(data), b"") + data

    ends = np.stack([places.max(0), places.min(0)], 1).ravel()
    head = struct.pack("<4sHH16sBB32s32sHHHIIBHI5I", b"LASF", 0, 16, b"", 1, 4, b"", b"", 1, 2026, 375, start, 2, 0x86, 30, *[0] * 6)
    head += struct.pack("<12d", *[0.01] * 3, *[0.0] * 3, *ends) + struct.pack("<QQIQ15Q", 0, end, 1, n, n, *[0] * 14)
    info = struct.pack("<5dQQ2d", *[20.0] * 4, 1.0, end + 60, len(tree), 0, 0) + bytes(88)
    head += record(b"copc", 1, info) + record(b"laszip encoded", 22204, packed)
    path.write_bytes(head + file.getvalue()[start:] + struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(tree), b"") + tree)


def copc_rows(planecast):
    path = planecast.path("a.copc.laz")
    copc(path)
    with laspy.CopcReader.open(path) as opened:
        points = opened.query()
    scene, got, said = read(planecast, path, "--voxel", VOXEL)
    name = f"{library('laspy')} with {library('lazrs')}"
    yield "COPC 1.0", "points of all nodes", f"{name}, CopcReader", cloud(xyz(points)), got
    yield "COPC 1.0", "its name", name, "COPC 1.4", "COPC 1.4" if "read as COPC 1.4" in said else said


# PCD and PLY.


def pcd_rows(planecast):
    name = library("pypcd4")
    rng = RNG(5)
    places = (rng.random((300, 3)) * [20, 30, 8]).astype("f4")
    missing = places.copy()
    missing[::10] = np.nan
    packed = PointCloud.encode_rgb(np.tile(np.array([[255, 128, 3]], "u1"), (300, 1)))
    kinds = {
        "x, y, z": PointCloud.from_xyz_points(places),
        "x, y, z, intensity": PointCloud.from_xyzi_points(np.column_stack([places, rng.random(300)]).astype("f4")),
        "x, y, z, rgb": PointCloud.from_xyzrgb_points(np.column_stack([places, packed])),
        "points that are nowhere (NaN)": PointCloud.from_xyz_points(missing),
    }
    for encoding in (Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED):
        for what, made in kinds.items():
            # pypcd4 writes these colours as 0 (findings/pypcd4_ascii_colors.sh).
            if encoding == Encoding.ASCII and "rgb" in what:
                continue
            path = planecast.path("a.pcd")
            made.save(path, encoding=encoding)
            again = PointCloud.from_path(path).numpy(("x", "y", "z")).astype("f8")
            again = again[np.isfinite(again).all(1)]
            scene, got, _ = read(planecast, path, "--voxel", VOXEL)
            expected = cloud(again)
            if "rgb" in what:
                world = again[:, [0, 2, 1]] * [1, 1, -1]
                first = np.floor(np.round((world - world.min(0))[0], 6)).astype(int)
                expected, got = f"{expected}, #ff8003", f"{got}, {color(planecast, scene, *first)}"
            yield f"PCD, {encoding.value}", what, name, expected, got


def ply_rows(planecast):
    name = library("plyfile")
    for form, options in (("text", {"text": True}), ("little-endian", {"byte_order": "<"}), ("big-endian", {"byte_order": ">"})):
        for of, far in (("f4", 0.0), ("f8", 4_190_000.0)):
            places = RNG(9).random((300, 3)) * [20, 30, 8] + far
            vertex = np.zeros(300, [(axis, of) for axis in "xyz"])
            for axis, values in zip("xyz", places.T):
                vertex[axis] = values
            path = planecast.path("a.ply")
            PlyData([PlyElement.describe(vertex, "vertex")], **options).write(path)
            again = PlyData.read(path)["vertex"]
            expected = cloud(np.stack([again[a] for a in "xyz"], 1), up="y")
            what = "places of a map in f64" if far else "places in f32"
            yield f"PLY cloud, {form}", what, name, expected, read(planecast, path, "--voxel", VOXEL)[1]


# Models.


def blob(shape, seed):
    """A solid thing with a cavity."""
    grid = np.indices(shape).astype("f8")
    middle = (np.array(shape).reshape(3, 1, 1, 1) - 1) / 2
    distance = (((grid - middle) / (middle + 0.5)) ** 2).sum(0)
    noise = RNG(seed).random(shape) < 0.9
    return (distance < 1) & (distance > 0.1) & noise


def binvox_rows(planecast):
    name = library("trimesh")
    for side in (8, 17, 32):
        grid = blob((side, side, side), side)
        path = planecast.path("a.binvox")
        path.write_bytes(trimesh.voxel.VoxelGrid(grid).export(file_type="binvox"))
        again = trimesh.load(path).matrix
        yield "binvox", f"a cube of {side}, y up", name, cells_of(again), read(planecast, path)[1]
        got = read(planecast, path, "--up", "z")[1]
        yield "binvox", f"a cube of {side}, z up", name, cells_of(again.transpose(0, 2, 1)[:, :, ::-1]), got


def vox_rows(planecast):
    import pyvox.models
    import pyvox.parser
    import pyvox.writer

    def z_up(grid):
        return cells_of(grid.transpose(0, 2, 1)[:, :, ::-1])

    for shape in ((5, 7, 9), (40, 30, 20)):
        grid = blob(shape, shape[0])
        path = planecast.path("a.vox")
        dense = np.where(grid, 5, 0).astype("u1")
        pyvox.writer.VoxWriter(str(path), pyvox.models.Vox.from_dense(dense.transpose(2, 1, 0)[:, ::-1, :])).write()
        parsed = pyvox.parser.VoxParser(str(path)).parse()
        again = np.zeros([getattr(parsed.models[0].size, a) for a in "xyz"], bool)
        for v in parsed.models[0].voxels:
            again[v.x, v.y, v.z] = True
        yield "MagicaVoxel vox", f"a model of {shape}", library("py-vox-io"), z_up(again), read(planecast, path)[1]

    # Colour 0 is air; the palette has 1 to 255.
    def chunk(name, content):
        return name + struct.pack("<II", len(content), 0) + content

    voxels = bytes([0, 0, 0, 94, 1, 0, 0, 0, 2, 0, 0, 89])
    body = chunk(b"SIZE", struct.pack("<3I", 3, 1, 1)) + chunk(b"XYZI", struct.pack("<I", 3) + voxels)
    path = planecast.path("hole.vox")
    path.write_bytes(b"VOX " + struct.pack("<I", 150) + b"MAIN" + struct.pack("<II", 0, len(body)) + body)
    seen = np.zeros((3, 1, 1), bool)
    for x, y, z, c in zip(*[iter(voxels)] * 4):
        seen[x, y, z] = c != 0
    yield "MagicaVoxel vox", "colour 0", "the format's text", z_up(seen), read(planecast, path)[1]


def words(*values):
    return struct.pack(f"<{len(values)}I", *values)


def silverman(grid):
    """kv6, kvx and Slab6's vox of a grid of (x, y, z down)."""
    nx, ny, nz = grid.shape
    padded = np.pad(grid, 1)
    faces = np.zeros(grid.shape, "u1")
    for bit, (axis, step) in enumerate([(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)]):
        near = np.roll(padded, -step, axis)[1:-1, 1:-1, 1:-1]
        faces |= (grid & ~near).astype("u1") << bit
    voxels, lens, slabs, xs, xys = b"", [], b"", [], b""
    table = 4 * (nx + 1) + 2 * nx * (ny + 1)
    for x in range(nx):
        begun = len(slabs)
        xs.append(table + begun)
        for y in range(ny):
            shown = np.flatnonzero(faces[x, y])
            lens.append(len(shown))
            voxels += b"".join(bytes([3, 2, 1, 128]) + struct.pack("<HBB", z, faces[x, y, z], 0) for z in shown)
            xys += struct.pack("<H", len(slabs) - begun)
            for run in np.split(shown, np.flatnonzero(np.diff(shown) > 1) + 1) if len(shown) else []:
                ends = (faces[x, y, run[0]] & 16) | (faces[x, y, run[-1]] & 32)
                slabs += bytes([run[0], len(run), (np.bitwise_or.reduce(faces[x, y, run]) & 15) | ends]) + bytes(len(run))
        xys += struct.pack("<H", len(slabs) - begun)
    xs.append(table + len(slabs))
    sizes = words(nx, ny, nz)
    per_x = [sum(lens[x * ny : x * ny + ny]) for x in range(nx)]
    kv6 = b"Kvxl" + sizes + bytes(12) + words(len(voxels) // 8) + voxels + words(*per_x) + struct.pack(f"<{nx * ny}H", *lens)
    level = sizes + bytes(12) + words(*xs) + xys + slabs
    return {
        "kv6": kv6,
        "kvx": words(len(level)) + level + bytes(768),
        "vox": sizes + np.where(grid, 0, 255).astype("u1").tobytes() + bytes(768),
    }


def editor_rows(planecast):
    text = "the format's text"
    for shape in ((5, 6, 9), (24, 30, 21)):
        grid = blob(shape, 3)
        for end, data in silverman(grid).items():
            path = planecast.path(f"a.{end}")
            path.write_bytes(data)
            expected = cells_of(grid.transpose(0, 2, 1)[:, ::-1, :])
            yield f"Slab6 {end}", f"a model of {shape}", text, expected, read(planecast, path)[1]

    grid = blob((6, 9, 5), 4)
    for right, packed in ((1, 0), (1, 1), (0, 0), (0, 1)):
        slices = []
        for z in range(5):
            cells = [b"\x07\x08\x09\xff" if grid[i % 6, i // 6, z] else bytes(4) for i in range(54)]
            if packed:
                runs, i = [], 0
                while i < 54:
                    n = next((k for k in range(i, 54) if cells[k] != cells[i]), 54) - i
                    runs += [words(2, n), cells[i]] if n > 2 else cells[i : i + n]
                    i += n
                cells = runs + [words(6)]
            slices.append(b"".join(cells))
        path = planecast.path("a.qb")
        matrix = b"\1m" + words(6, 9, 5) + struct.pack("<3i", -3, 2, 1) + b"".join(slices)
        path.write_bytes(words(257, 0, right, packed, 0, 1) + matrix)
        what = f"{'right' if right else 'left'}-handed, {'packed' if packed else 'not packed'}"
        yield "Qubicle qb", what, text, cells_of(grid if right else grid[:, :, ::-1]), read(planecast, path)[1]

    grid = blob((20, 33, 17), 5)
    at = np.array([-5, 3, -20])
    blocks, layer = [], []
    low, high = at // 16, (at + grid.shape - 1) // 16
    for block in np.ndindex(*(high - low + 1)):
        origin = (low + block) * 16
        pixels = np.zeros((16, 16, 16, 4), "u1")
        for z, y, x in np.ndindex(16, 16, 16):
            p = origin + [x, y, z] - at
            if (p >= 0).all() and (p < grid.shape).all() and grid[tuple(p)]:
                pixels[z, y, x] = [9, 8, 7, 255]
        file = io.BytesIO()
        Image.fromarray(pixels.reshape(64, 64, 4)).save(file, "PNG")
        layer.append(struct.pack("<5i", len(blocks), *origin, 0))
        blocks.append(file.getvalue())

    def chunk(name, content):
        return name + struct.pack("<i", len(content)) + content + bytes(4)

    path = planecast.path("a.gox")
    data = b"GOX " + struct.pack("<i", 2) + b"".join(chunk(b"BL16", b) for b in blocks)
    path.write_bytes(data + chunk(b"LAYR", struct.pack("<i", len(layer)) + b"".join(layer)))
    # The world ends where voxels do.
    held = np.argwhere(grid)
    (x0, y0, z0), (x1, y1, z1) = held.min(0), held.max(0) + 1
    expected = cells_of(grid[x0:x1, y0:y1, z0:z1].transpose(0, 2, 1)[:, :, ::-1])
    yield "Goxel gox", "blocks about the origin", f"{text}, blocks by {library('pillow')}", expected, read(planecast, path)[1]


def rows(planecast):
    for of in (las_rows, copc_rows, pcd_rows, ply_rows, binvox_rows, vox_rows, editor_rows):
        yield from of(planecast)
