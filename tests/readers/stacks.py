"""Slices: TIFF stacks, NumPy and Zarr arrays, DICOM series, folders of images. Values by the library that wrote or reads the
file, as sizes (x, y, z), number of solid voxels and a checksum of which they are."""

import json
import pathlib
import struct
import zlib

import numpy as np

W, H, D = 23, 17, 6


def volume(seed=2, dtype="u1", top=255):
    """Shape (z, y, x); about half of it 0."""
    v = np.random.default_rng(seed).random((D, H, W)) * top
    v[v < top / 2] = 0
    return v.astype(dtype)


def digest(solid):
    """Of booleans (z, y, x)."""
    z, y, x = solid.shape
    bits = np.ascontiguousarray(solid, dtype="u1")
    return f"{x} × {y} × {z}, {int(bits.sum())} solid, {zlib.crc32(bits.tobytes()):08x}"


def found(planecast, path, *flags):
    """Voxels in the order in which they are stored, not turned upright nor made cubes."""
    scene, said = planecast.encode(path, "--spacing", "as-is", "--up", "y", *flags)
    if scene is None:
        return "refused: " + said.strip()
    raw, dims = planecast.occupancy(scene)
    x, y, z = dims
    return digest(np.frombuffer(raw, "u1").reshape(z, y, x))


def said(planecast, path, *flags):
    """What encode says of how it read a file."""
    return planecast.encode(path, *flags)[1]


def line(text, start):
    """Whether one of the lines holds this."""
    return start if start in text else text.strip().split("\n")[0]


def tiff_rows(planecast):
    import tifffile

    library = f"tifffile {tifffile.__version__}"
    v = volume()
    two = np.zeros((D, 2, H, W), "u1")
    two[:, 0], two[:, 1] = v, 255

    def case(prop, write, read=lambda a: a > 0, flags=("--format", "stack"), name="a.tif"):
        path = planecast.path(name)
        write(path)
        value = digest(read(tifffile.imread(path)))
        return "TIFF stack", prop, library, value, found(planecast, path, *flags)

    def write(*args, **options):
        return lambda path: tifffile.imwrite(path, *args, **options)

    yield case("pages", write(v))
    yield case("pages without --format are a stack", write(v), flags=())
    yield case("BigTIFF", write(v, bigtiff=True))
    yield case("big-endian 16 bits", write(v.astype(">u2"), byteorder=">"), flags=("--format", "stack", "--iso", "1"))
    yield case("tiles of 16", write(v, tile=(16, 16)))
    yield case("strips of 5 rows", write(v, rowsperstrip=5))
    yield case("bilevel", write(v > 0, photometric="minisblack"), read=lambda a: a)
    yield case("bilevel, Deflate", write(v > 0, photometric="minisblack", compression="deflate"), read=lambda a: a)
    yield case("MinIsWhite, u8", write((v > 0).astype("u1") * 255, photometric="miniswhite"))
    for dtype in ("i2", "u2", "f4", "f8", "u4"):
        yield case(
            f"MinIsWhite, {dtype}",
            write(v.astype(dtype), photometric="miniswhite"),
            read=lambda a: a >= 128,
            flags=("--format", "stack", "--iso", "128"),
        )
    yield case("f2 samples", write(v.astype("f2")), read=lambda a: a >= 128, flags=("--format", "stack", "--iso", "128"))
    for bits in (2, 4, 6, 10, 12, 14):
        packed = volume(bits, "u2", 2**bits - 1)
        flags = ("--format", "stack", "--iso", str(2 ** (bits - 1)))
        path = planecast.path("a.tif")
        write_packed(path, packed, bits)
        value = digest(tifffile.imread(path) >= 2 ** (bits - 1))
        yield "TIFF stack", f"{bits}-bit samples", library, value, found(planecast, path, *flags)
    for codec in ("lzw", "deflate", "packbits", "zstd", "lerc"):
        yield case(f"compression {codec}", write(v, compression=codec))
    for codec in ("lzw", "zstd"):
        wide = v.astype("u2") * 200
        yield case(
            f"compression {codec}, predictor 2, u16",
            write(wide, compression=codec, predictor=True),
            flags=("--format", "stack", "--iso", "1"),
        )
        yield case(
            f"compression {codec}, predictor 3, f32",
            write(v.astype("f4"), compression=codec, predictor=True),
            flags=("--format", "stack", "--iso", "1"),
        )
    floats = v.astype("f4") / 7
    for codec, options in (("lerc", {}), ("lerc", {"compressionargs": {"compression": "zstd"}})):
        yield case(
            f"compression {codec} {json.dumps(options) if options else ''} f32".replace("  ", " "),
            write(floats, compression=codec, **options),
            read=lambda a: a >= 20,
            flags=("--format", "stack", "--iso", "20"),
        )
    path = planecast.path("a.tif")
    values = volume(24, "u4", 2**24 - 1)
    write_packed(path, values, 24)
    expected = digest(tifffile.imread(path) >= 2**23)
    yield "TIFF stack", "24-bit samples", library, expected, found(planecast, path, "--format", "stack", "--iso", str(2**23))
    yield case("JPEG, quality 100", write(v, compression="jpeg", compressionargs={"level": 100}),
               read=lambda a: a >= 60, flags=("--format", "stack", "--iso", "60"))
    yield case("ImageJ", write(v, imagej=True, metadata={"axes": "ZYX"}))
    yield case("ImageJ, channels alone", write(v, imagej=True), read=lambda a: a[:1] > 0, flags=())
    yield case("ImageJ, one directory", write(v, imagej=True, truncate=True, metadata={"axes": "ZYX"}))
    yield case("tifffile's shape, one directory", write(v, truncate=True))
    first = {"read": lambda a: a[:, 0] > 0}
    yield case("ImageJ channels, the first", write(two, imagej=True, metadata={"axes": "ZCYX"}), **first)
    yield case("ImageJ channels in one directory", write(two, imagej=True, truncate=True, metadata={"axes": "ZCYX"}), **first)
    times = np.stack([v, 255 - v])
    yield case("ImageJ times, the first", write(times, imagej=True, metadata={"axes": "TZYX"}), read=lambda a: a[0] > 0)
    for axes in ("CZYX", "ZCYX", "TZYX"):
        data = two if axes == "ZCYX" else np.moveaxis(two, 1, 0)
        read = (lambda a: a[:, 0] > 0) if axes == "ZCYX" else (lambda a: a[0] > 0)
        yield case(f"OME-TIFF {axes}, the first", write(data, ome=True, metadata={"axes": axes}, photometric="minisblack"), read=read)
        yield case(f"tifffile axes {axes}, the first", write(data, metadata={"axes": axes}, photometric="minisblack"), read=read)
    path = planecast.path("ome.tif")
    tifffile.imwrite(path, np.moveaxis(two, 1, 0), ome=True, photometric="minisblack",
                     metadata={"axes": "CZYX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.5, "PhysicalSizeZ": 2.0})
    pixels = tifffile.xml2dict(tifffile.TiffFile(path).ome_metadata)["OME"]["Image"]["Pixels"]
    sizes = f"{pixels['SizeC'] - 1} of {pixels['SizeC']} channels: the first is read"
    text = said(planecast, path)
    yield "TIFF stack", "OME-TIFF: channels are said", library, sizes, line(text, sizes)

    def pyramid(path):
        with tifffile.TiffWriter(path) as t:
            t.write(v, subifds=0)
            t.write(v[0, ::2, ::2], subfiletype=1)

    def series(path):
        with tifffile.TiffFile(path) as t:
            return digest(np.asarray([p.asarray() for p in t.pages if not p.is_reduced]) > 0)

    path = planecast.path("reduced.tif")
    pyramid(path)
    yield "TIFF stack", "a reduced page after the stack", library, series(path), found(planecast, path)

    def sub(path):
        with tifffile.TiffWriter(path, ome=True) as t:
            t.write(v, subifds=1, metadata={"axes": "ZYX"}, photometric="minisblack")
            t.write(v[:, ::2, ::2], subfiletype=1, photometric="minisblack")

    yield case("OME-TIFF with coarser resolutions", sub)
    rgb = np.repeat(v[..., None], 3, -1)
    yield case("RGB pages of grey", write(rgb, photometric="rgb"), read=lambda a: a[..., 0] > 0)
    yield case("extra samples, the first", write(np.stack([v, 255 - v], -1), photometric="minisblack", planarconfig="contig"),
               read=lambda a: a[..., 0] > 0)
    yield case("planar samples, the first", write(np.stack([v, 255 - v], 1), photometric="minisblack", planarconfig="separate"),
               read=lambda a: a[:, 0] > 0)
    folder = planecast.path("slices")
    folder.mkdir()
    for z in range(D):
        tifffile.imwrite(folder / f"s{z + 8}.tif", v[z])
    yield "TIFF folder", "slices by number", library, digest(v > 0), found(planecast, folder)


def pillow_rows(planecast):
    import PIL
    from PIL import Image

    library = f"Pillow {PIL.__version__}"
    slices = [Image.fromarray(s) for s in volume() > 0]
    for compression in ("group4", "group3", "tiff_ccitt", "packbits", "tiff_lzw"):
        path = planecast.path("a.tif")
        slices[0].save(path, save_all=True, append_images=slices[1:], compression=compression)
        picture, frames = Image.open(path), []
        for i in range(picture.n_frames):
            picture.seek(i)
            frames.append(np.asarray(picture))
        yield "TIFF stack", f"bilevel, {compression}", library, digest(np.stack(frames)), found(planecast, path)


def write_packed(path, values, bits):
    """Pages of samples of so many bits, most significant first, rows from a byte on."""
    out = bytearray(b"II*\0" + struct.pack("<I", 8))
    pages, height, width = values.shape
    for z in range(pages):
        rows = b"".join(
            np.packbits(((row[:, None] >> np.arange(bits - 1, -1, -1)) & 1).astype("u1").ravel()).tobytes()
            for row in values[z].astype("u4")
        )
        tags = [(256, width), (257, height), (258, bits), (259, 1), (262, 1), (277, 1), (278, height)]
        data = len(out) + 2 + 12 * (len(tags) + 2) + 4
        tags = sorted(tags + [(273, data), (279, len(rows))])
        end = data + len(rows) + len(rows) % 2
        out += struct.pack("<H", len(tags))
        for tag, value in tags:
            out += struct.pack("<HHII", tag, 4, 1, value)
        out += struct.pack("<I", end if z + 1 < pages else 0) + rows + b"\0" * (len(rows) % 2)
    pathlib.Path(path).write_bytes(out)


def npy_rows(planecast):
    library = f"numpy {np.__version__}"
    v = volume()

    def case(prop, array, read, *flags):
        path = planecast.path("a.npy")
        np.save(path, array)
        return "NPY", prop, library, digest(read(np.load(path))), found(planecast, path, *flags)

    yield case("u1, C order", v, lambda a: a > 0)
    yield case("u1, Fortran order", np.asfortranarray(v), lambda a: a > 0)
    yield case("bool", v > 0, lambda a: a)
    for dtype in (">i2", "<f2", ">f2", ">f8", "<u8"):
        yield case(dtype, v.astype(dtype), lambda a: a >= 128, "--iso", "128")
    records = np.zeros(v.shape, [("name", "S3"), ("v", ">i2"), ("w", "f4")])
    records["v"] = v
    yield case("records, the first number", records, lambda a: a["v"] >= 128, "--iso", "128")
    records = np.zeros(v.shape, [("v", "f4")])
    records["v"] = v
    yield case("records of one field", records, lambda a: a["v"] >= 128, "--iso", "128")
    yield case("axes of one place before", v[None], lambda a: a[0] > 0)
    for prop, text in (
        ("header of another writer", '{"descr": "<u2", "shape": (6, 17, 23), "fortran_order": False}'),
        ("header of Python 2", "{'descr': '<u2', 'fortran_order': False, 'shape': (6L, 17L, 23L), }"),
        ("type by name", "{'descr': 'uint16', 'fortran_order': False, 'shape': (6, 17, 23), }"),
    ):
        path = planecast.path("a.npy")
        head = text.encode().ljust(117) + b"\n"
        path.write_bytes(b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head + v.astype("<u2").tobytes())
        yield "NPY", prop, library, digest(np.load(path) >= 128), found(planecast, path, "--iso", "128")


def zarr_rows(planecast):
    import xarray
    import zarr

    library = f"zarr {zarr.__version__}"
    v = volume()

    def ome(order, scale=None, version="0.4"):
        path = planecast.path("image.zarr")
        other = {"c": 2, "t": 3}
        shape = tuple({"x": W, "y": H, "z": D}.get(a, other.get(a)) for a in order)
        array = np.full(shape, 255, "u1")
        place = tuple(0 if a in other else slice(None) for a in order)
        space = "".join(a for a in order if a not in other)
        has = v if "z" in space else v[:1]
        of = [("zyx").index(a) for a in space]
        array[place] = (has if "z" in space else has[0]).transpose(of if "z" in space else [a - 1 for a in of])
        group = zarr.open_group(path, mode="w", zarr_format=2)
        z = group.create_array("0", shape=shape, dtype="u1", chunks=tuple(max(1, n // 2) for n in shape))
        z[...] = array
        kind = {"c": "channel", "t": "time"}
        group.attrs["multiscales"] = [{
            "version": version,
            "axes": [{"name": a, "type": kind.get(a, "space"), "unit": "micrometer"} for a in order],
            "datasets": [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": scale or [1.0] * len(order)}]}],
        }]
        read = zarr.open_group(path, mode="r")["0"][...]
        read = read[place].transpose([space.index(a) for a in "zyx" if a in space])
        return path, (read if "z" in space else read[None]) > 0

    for order in ("zyx", "xyz", "yxz", "czyx", "tczyx", "xyzct", "cyx", "tyx"):
        path, right = ome(order)
        yield "OME-Zarr", f"axes {order}", library, digest(right), found(planecast, path)
    path, right = ome("zyx", [5.0, 0.5, 0.5])
    # The shape may be the spacing's: what is compared is what is said.
    yield "OME-Zarr", "scale is said", library, "0.5 × 0.5 × 5", line(said(planecast, path), "0.5 × 0.5 × 5")
    path, _ = ome("czyx")
    phrase = "1 of 2 channels: the first is read"
    yield "OME-Zarr", "channels are said", library, phrase, line(said(planecast, path), phrase)

    def case(prop, array, read=lambda a: a > 0, flags=(), **options):
        path = planecast.path("a.zarr")
        z = zarr.create_array(path, shape=array.shape, dtype=array.dtype, chunks=(3, 8, 10), **options)
        z[...] = array
        return "Zarr", prop, library, digest(read(zarr.open_array(path, mode="r")[...])), found(planecast, path, *flags)

    for version in (2, 3):
        yield case(f"version {version}, u1", v, zarr_format=version)
        yield case(f"version {version}, booleans", v > 0, lambda a: a, zarr_format=version)
        yield case(f"version {version}, f2", v.astype("f2"), lambda a: a >= 128, ("--iso", "128"), zarr_format=version)
    path = planecast.path("names.zarr")
    z = zarr.create_array(path, shape=(W, H, D), dtype="u1", chunks=(W, H, D), dimension_names=["x", "y", "z"])
    z[...] = v.transpose(2, 1, 0)
    yield "Zarr", "dimension_names x, y, z", library, digest(z[...].transpose(2, 1, 0) > 0), found(planecast, path)
    import numcodecs

    path = planecast.path("bits.zarr")
    bits = zarr.create_array(path, shape=v.shape, dtype="?", zarr_format=2, chunks=(3, 8, 10), filters=[numcodecs.PackBits()])
    bits[...] = v > 0
    refusal = "codec packbits is not supported; write it without this codec or filter"
    yield "Zarr", "version 2, filter packbits: refused by name", library, refusal, line(said(planecast, path), refusal)
    path = planecast.path("shards.zarr")
    z = zarr.create_array(path, shape=v.shape, dtype="u1", chunks=(2, 4, 5), shards=(6, 8, 10))
    z[...] = v
    yield "Zarr", "shards", library, digest(z[...] > 0), found(planecast, path)
    library = f"xarray {xarray.__version__}"
    values = np.linspace(-5, 20, v.size).reshape(v.shape)
    for version in (2, 3):
        path = planecast.path("cf.zarr")
        data = xarray.Dataset({"v": (("z", "y", "x"), values)}, {"x": np.arange(W) * 0.5, "y": np.arange(H) * 0.5, "z": np.arange(D) * 2.0})
        data.v.values[2, 3:9] = np.nan
        data.to_zarr(path, zarr_format=version, encoding={"v": {"dtype": "int16", "scale_factor": 0.1, "add_offset": -5, "_FillValue": -999}})
        right = xarray.open_zarr(path, consolidated=False).v.values
        for iso in (10, -500):
            name = f"CF scale, offset, fill, version {version}, --iso {iso}"
            yield "Zarr", name, library, digest(right >= iso), found(planecast, path / "v", "--iso", iso)
        yield "Zarr", f"CF, version {version}: the group's only volume", library, digest(right >= 10), found(planecast, path, "--iso", 10)
        yield ("Zarr", f"CF, version {version}: coordinates give the voxel", library, "0.5 × 0.5 × 2",
               line(said(planecast, path, "--iso", 10), "0.5 × 0.5 × 2"))
    path = planecast.path("order.zarr")
    xarray.Dataset({"v": (("lon", "lat", "level"), v.transpose(2, 1, 0))}).to_zarr(path, zarr_format=2)
    right = xarray.open_zarr(path, consolidated=False).v.transpose("level", "lat", "lon").values
    yield "Zarr", "dimensions lon, lat, level", library, digest(right > 0), found(planecast, path / "v")


def dicom_rows(planecast):
    import pydicom
    from pydicom.dataset import FileDataset, FileMetaDataset
    from pydicom.uid import (DeflatedExplicitVRLittleEndian, ExplicitVRBigEndian, ExplicitVRLittleEndian, ImplicitVRLittleEndian,
                             RLELossless)

    library = f"pydicom {pydicom.__version__}"
    v = (np.random.default_rng(5).random((D, H, W)) * 2000).astype("i2") - 1000

    def write(path, a, z, n, syntax=ExplicitVRLittleEndian, **more):
        meta = FileMetaDataset()
        meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2"
        meta.MediaStorageSOPInstanceUID = f"1.2.3.{n + 1}"
        meta.TransferSyntaxUID = ExplicitVRLittleEndian if syntax == RLELossless else syntax
        d = FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128, is_implicit_VR=syntax == ImplicitVRLittleEndian,
                        is_little_endian=syntax != ExplicitVRBigEndian)
        d.SOPClassUID, d.SOPInstanceUID = meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID
        d.Modality, d.SeriesInstanceUID, d.InstanceNumber = "CT", "1.2.3", n
        d.ImagePositionPatient, d.ImageOrientationPatient = [0, 0, z], [1, 0, 0, 0, 1, 0]
        d.PixelSpacing, d.SliceThickness = [0.5, 0.5], 0.5
        d.Rows, d.Columns = a.shape[-2:]
        if a.ndim == 3:
            d.NumberOfFrames = len(a)
        d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
        d.BitsAllocated = d.BitsStored = 8 * a.itemsize
        d.PixelRepresentation = int(a.dtype.kind == "i")
        d.RescaleSlope, d.RescaleIntercept = 1, -24
        for name, value in more.items():
            setattr(d, name, value)
        d.HighBit = d.BitsStored - 1
        d.PixelData = (a.astype(a.dtype.newbyteorder(">")) if syntax == ExplicitVRBigEndian else a).tobytes()
        d["PixelData"].VR = "OW"
        if syntax == RLELossless:
            d.compress(RLELossless)
        d.save_as(path, enforce_file_format=True)

    def read(folder):
        slices = [pydicom.dcmread(p) for p in folder.iterdir()]
        slices.sort(key=lambda d: float(d.ImagePositionPatient[2]))
        return np.stack([d.pixel_array * float(d.RescaleSlope) + float(d.RescaleIntercept) for d in slices])

    syntaxes = [("explicit", ExplicitVRLittleEndian), ("implicit", ImplicitVRLittleEndian), ("big-endian", ExplicitVRBigEndian),
                ("deflated", DeflatedExplicitVRLittleEndian), ("RLE", RLELossless)]
    for name, syntax in syntaxes:
        folder = planecast.path("series")
        folder.mkdir()
        for i, z in enumerate(np.random.default_rng(1).permutation(D)):
            write(folder / f"{i}.dcm", v[z], z * 0.5, i, syntax)
        yield "DICOM", f"series, {name}", library, digest(read(folder) >= 100), found(planecast, folder, "--iso", 100)
    folder = planecast.path("series")
    folder.mkdir()
    for z in range(D):
        write(folder / f"{z}.dcm", v[z], z * 0.5, z, RescaleSlope=z + 1)
    yield "DICOM", "each slice rescaled by its own line", library, digest(read(folder) >= 100), found(planecast, folder, "--iso", 100)
    folder = planecast.path("series")
    folder.mkdir()
    for z in range(D):
        write(folder / f"{z}.dcm", v[z] & 0xFFF, z * 0.5, z, BitsStored=12)
    right = np.stack([((v[z] & 0xFFF) ^ 0x800) - 0x800 - 24 for z in range(D)])
    yield "DICOM", "12 bits of 16, signed", library, digest(right >= 100), found(planecast, folder, "--iso", 100)
    path = planecast.path("frames.dcm")
    write(path, v, 0, 0, SpacingBetweenSlices=0.5)
    right = pydicom.dcmread(path).pixel_array - 24
    yield "DICOM", "frames of a file", library, digest(right >= 100), found(planecast, path, "--iso", 100)
    import SimpleITK

    folder = planecast.path("series")
    folder.mkdir()
    for i, z in enumerate(np.random.default_rng(2).permutation(D)):
        write(folder / f"{i}.dcm", v[z], z * 0.5, i, ImageOrientationPatient=[1, 0, 0, 0, -1, 0])
    reader = SimpleITK.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    right = SimpleITK.GetArrayFromImage(reader.Execute())
    yield ("DICOM", "order along the normal", f"SimpleITK {SimpleITK.Version_VersionString()}", digest(right >= 100),
           found(planecast, folder, "--iso", 100))


def image_rows(planecast):
    import PIL
    from PIL import Image

    library = f"Pillow {PIL.__version__}"
    v = volume()

    def folder(prop, kind, pictures, read, *flags):
        path = planecast.path("slices")
        path.mkdir()
        for z, picture in enumerate(pictures):
            picture.save(path / f"slice{z + 7}.{kind}")
        names = sorted(path.iterdir(), key=lambda p: int(p.stem[5:]))
        right = np.stack([np.asarray(read(Image.open(p))) for p in names])
        iso = int(flags[1]) if flags else 1
        return "folder of images", prop, library, digest(right >= iso), found(planecast, path, *flags)

    yield folder("PNG, 8 bits", "png", [Image.fromarray(a) for a in v], lambda i: i)
    yield folder("PNG, 16 bits", "png", [Image.fromarray(a.astype("u2") * 200) for a in v], lambda i: i, "--iso", "30000")
    yield folder("PNG, bilevel", "png", [Image.fromarray(a > 0) for a in v], lambda i: i.convert("L"))
    yield folder("PNG, grey as RGBA", "png", [Image.fromarray(a).convert("RGBA") for a in v], lambda i: i.convert("L"))
    yield folder("JPEG", "jpg", [Image.fromarray(np.kron(a, np.ones((8, 8), "u1"))) for a in v], lambda i: i, "--iso", "64")


def rows(planecast):
    for some in (tiff_rows, pillow_rows, npy_rows, zarr_rows, dicom_rows, image_rows):
        yield from some(planecast)
