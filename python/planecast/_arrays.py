"""Arrays of every kind, as the encoder takes them."""

from __future__ import annotations

import contextlib
import math
import os
import struct
import tempfile
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy

# Bytes that are taken at once of what is written to a passing file.
AT_ONCE = 64 << 20


def is_lazy(array: Any) -> bool:
    """Whether values come when they are asked for: of dask, zarr, h5py, or an xarray.DataArray of such."""
    if isinstance(array, numpy.ndarray):
        return False
    variable = getattr(array, "variable", None)
    if variable is not None and hasattr(array, "dims"):
        return not getattr(variable, "_in_memory", True)
    return hasattr(array, "chunks") and hasattr(array, "shape") and hasattr(array, "dtype")


def sides(array: Any) -> list[int]:
    """What is best read at once, along each axis."""
    chunks = getattr(array, "chunks", None)
    if getattr(array, "shards", None) is not None:
        chunks = array.shards
    if chunks is None and hasattr(array, "encoding"):
        chunks = array.encoding.get("preferred_chunks") or array.encoding.get("chunksizes")
        chunks = [chunks.get(d) for d in array.dims] if isinstance(chunks, dict) else chunks
    if chunks is None or len(chunks) != len(array.shape):
        return [min(256, n) for n in array.shape]
    # Dask has a list along each axis, of which the last is what is left over.
    return [max(1, int(c[0] if isinstance(c, Sequence) else c or n)) for c, n in zip(chunks, array.shape)]


def written(array: Any) -> tuple[list[list[int]], float] | None:
    """Numbers of the chunks of a Zarr array that were written, and what is elsewhere; None where that cannot be known."""
    try:
        from zarr.core.array import Array
        from zarr.core.sync import sync
    except ImportError:
        return None
    if not isinstance(array, Array):
        return None
    fill = array.fill_value
    prefix = f"{array.path}/" if array.path else ""

    async def names() -> list[str]:
        return [name async for name in array.store.list_prefix(prefix)]

    chunks = []
    for name in sync(names()):
        parts = name[len(prefix) :].replace(".", "/").split("/")
        parts = parts[1:] if parts[0] == "c" else parts
        if len(parts) == array.ndim and all(part.isdecimal() for part in parts):
            chunks.append([int(part) for part in parts])
    return chunks, 0.0 if fill is None else float(fill)


def native(dtype: numpy.dtype) -> numpy.dtype:
    """The type that values are handed over in."""
    check(dtype)
    return numpy.dtype("f4") if dtype == numpy.float16 else dtype.newbyteorder("=")


def check(dtype: numpy.dtype) -> None:
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise ValueError(f"an array of {dtype}; expected integers, booleans or floats: array.astype('f4')")


def fetch(array: Any, dtype: numpy.dtype) -> Callable[[list[int], list[int]], numpy.ndarray]:
    """A function that gives the bytes between two places of an array."""

    def get(starts: list[int], ends: list[int]) -> numpy.ndarray:
        part = array[tuple(slice(a, b) for a, b in zip(starts, ends))]
        part = part.compute() if hasattr(part, "compute") else part
        part = part.to_numpy() if hasattr(part, "to_numpy") else numpy.asarray(part)
        if numpy.ma.isMaskedArray(part):
            raise ValueError("a masked array; say what stands for no data: array.filled(-9999) and nodata=-9999")
        return numpy.ascontiguousarray(part, dtype=dtype).reshape(-1).view(numpy.uint8)

    return get


def plain(array: Any) -> numpy.ndarray:
    """An array's values as they can be read, without a copy where they lie side by side."""
    if hasattr(array, "to_numpy") and not isinstance(array, numpy.ndarray):
        array = array.to_numpy()
    elif not isinstance(array, numpy.ndarray):
        array = numpy.asarray(array)
    if numpy.ma.isMaskedArray(array):
        raise ValueError("a masked array; say what stands for no data: array.filled(-9999) and nodata=-9999")
    check(array.dtype)
    if not (array.flags.c_contiguous or array.flags.f_contiguous):
        array = numpy.ascontiguousarray(array)
    return array


def _blocks(array: Any, row: int) -> Iterator[numpy.ndarray]:
    """An array some rows of the first axis after the other, which take `row` bytes each."""
    step = max(1, AT_ONCE // max(1, row))
    if is_lazy(array):
        side = sides(array)[0]
        step = max(side, step // side * side)
    for start in range(0, array.shape[0], step):
        part = array[start : start + step]
        part = part.compute() if hasattr(part, "compute") else part
        yield part.to_numpy() if hasattr(part, "to_numpy") else numpy.asarray(part)


def _bytes(colors: Any, name: str) -> None:
    if colors.dtype.kind not in "iuf" or colors.dtype.kind == "f" or colors.dtype.itemsize > 2:
        raise ValueError(f"{name}=: an array of {colors.dtype}; expected 8 or 16 bits a channel: (colors * 255).astype('u1')")


@contextlib.contextmanager
def ply(points: Any, colors: Any | None) -> Iterator[str]:
    """A passing PLY file of points (N, 3), and colours (N, 3) u1 or u2 where there are any."""
    if len(points.shape) != 2 or points.shape[1] != 3 or points.dtype.kind not in "iuf":
        raise ValueError(f"points of shape {tuple(points.shape)} of {points.dtype}; expected (N, 3) numbers")
    if points.shape[0] == 0:
        raise ValueError("no points at all")
    n = points.shape[0]
    if colors is not None:
        if tuple(colors.shape) != (n, 3):
            raise ValueError(f"colors=: an array of shape {tuple(colors.shape)}; expected ({n}, 3), a colour per point")
        _bytes(colors, "colors")
    real = "f4" if points.dtype.itemsize <= 4 and points.dtype.kind == "f" else "f8"
    fields = [("at", "<" + real, 3)] + ([("rgb", "u1", 3)] if colors is not None else [])
    record = numpy.dtype(fields)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n"
    head += "".join(f"property {'float' if real == 'f4' else 'double'} {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) if colors is not None else ""
    with tempfile.TemporaryDirectory(prefix="planecast-") as folder:
        name = os.path.join(folder, "points.ply")
        with open(name, "wb") as file:
            file.write((head + "end_header\n").encode())
            start = 0
            for part in _blocks(points, 64):
                out: numpy.ndarray = numpy.zeros(len(part), record)
                out["at"] = part
                if colors is not None:
                    rgb = colors[start : start + len(part)]
                    rgb = numpy.asarray(rgb.compute() if hasattr(rgb, "compute") else rgb)
                    out["rgb"] = rgb >> 8 if rgb.dtype.itemsize == 2 else rgb
                file.write(out.data)
                start += len(part)
        yield name


@contextlib.contextmanager
def tiff(colors: Any) -> Iterator[str]:
    """A passing TIFF file of colours (rows, columns, 3 or 4) u1 or u2."""
    shape = tuple(colors.shape)
    if len(shape) != 3 or shape[2] not in (3, 4) or 0 in shape:
        raise ValueError(f"colors=: an array of shape {shape}; expected (rows, columns, 3)")
    _bytes(colors, "colors")
    height, width, _ = shape
    if 3 * height * width >= 1 << 32:
        raise MemoryError(f"colors=: {height} × {width} pixels; at most 2³² bytes: take every second one, [::2, ::2]")
    rows = max(1, min(height, (1 << 18) // (3 * width)))
    strips = math.ceil(height / rows)
    data_at = 8
    end = data_at + 3 * height * width
    lengths = [3 * width * min(rows, height - i * rows) for i in range(strips)]
    offsets = [data_at + 3 * width * rows * i for i in range(strips)]
    pad = end % 2
    bits_at = end + pad
    offsets_at = bits_at + 8
    lengths_at = offsets_at + 4 * strips
    head_at = lengths_at + 4 * strips
    one = strips == 1
    tags = [
        (256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, bits_at), (259, 3, 1, 1), (262, 3, 1, 2),
        (273, 4, strips, offsets[0] if one else offsets_at), (277, 3, 1, 3), (278, 4, 1, rows),
        (279, 4, strips, lengths[0] if one else lengths_at), (284, 3, 1, 1),
    ]  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="planecast-") as folder:
        name = os.path.join(folder, "colors.tif")
        with open(name, "wb") as file:
            file.write(b"II*\0" + struct.pack("<I", head_at))
            for part in _blocks(colors, width * 8):
                part = part[..., :3]
                part = part >> 8 if part.dtype.itemsize == 2 else part
                file.write(numpy.ascontiguousarray(part, dtype="u1").data)
            file.write(bytes(pad) + struct.pack("<4H", 8, 8, 8, 0))
            file.write(struct.pack(f"<{strips}I", *offsets) + struct.pack(f"<{strips}I", *lengths))
            file.write(struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4))
        yield name
