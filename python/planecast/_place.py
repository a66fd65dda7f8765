"""Where a world made of an xarray.DataArray lies: its coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy

_ACROSS = {
    "x": ("x", "lon", "long", "longitude", "easting", "col", "column", "projection_x_coordinate"),
    "y": ("y", "lat", "latitude", "northing", "row", "projection_y_coordinate"),
    "z": ("z", "depth", "lev", "level", "altitude", "height", "elevation", "plev", "slice"),
}


def role(array: Any, dim: str) -> str | None:
    """Which axis a dimension is: by CF's attributes, then its name."""
    if dim in array.coords:
        attrs = array.coords[dim].attrs
        named = {"X": "x", "Y": "y", "Z": "z"}.get(str(attrs.get("axis", "")).upper())
        named = named or next((k for k, v in _ACROSS.items() if str(attrs.get("standard_name", "")).lower() in v), None)
        if named:
            return named
    return next((k for k, v in _ACROSS.items() if str(dim).lower() in v), None)


def ordered(array: Any) -> Any:
    """With the axes (z, y, x) where dimensions say which is which."""
    roles = {role(array, d): d for d in array.dims}
    wanted = [roles.get(k) for k in ("z", "y", "x")][-array.ndim :]
    return array.transpose(*wanted) if array.ndim in (2, 3) and None not in wanted and len(roles) == array.ndim else array


def _numbers(array: Any, dim: str) -> numpy.ndarray | None:
    if dim not in array.coords:
        return None
    values = numpy.asarray(array.coords[dim].values)
    return values.astype("f8") if values.ndim == 1 and values.dtype.kind in "iuf" else None


@dataclass
class Place:
    """The coordinates along a world's axes: (n,) each, or None; and what values of its y axis mean."""

    names: tuple[str | None, str | None, str | None]
    along: tuple[numpy.ndarray | None, numpy.ndarray | None, numpy.ndarray | None]
    attrs: dict[str, dict] = field(default_factory=dict)
    # Of a map of heights: value = y / scale + base.
    height: tuple[str, float, float] | None = None
    spatial_ref: Any = None
    template: Any = None
    # Rows of the array run to the north, columns to the west.
    flips: tuple[bool, bool] = (False, False)

    def reference(self) -> dict[str, Any]:
        return {} if self.spatial_ref is None else {"spatial_ref": self.spatial_ref}

    def at(self, axis: int, places: Any) -> numpy.ndarray:
        """The coordinate at places along a world's axis, in voxels; the middle of a voxel is that of its cell."""
        along = self.along[axis]
        if along is None:
            raise ValueError("this world was not made of an xarray.DataArray with coordinates along this axis")
        places = numpy.asarray(places, "f8")
        if len(along) < 2:
            return numpy.full(places.shape, along[0])
        at = numpy.clip(places - 0.5, -0.5, len(along) - 0.5)
        # Half a cell beyond the first and the last, as their cells reach.
        inner = numpy.interp(at, numpy.arange(len(along)), along)
        inner = numpy.where(at < 0, along[0] + at * (along[1] - along[0]), inner)
        last = len(along) - 1
        return numpy.where(at > last, along[-1] + (at - last) * (along[-1] - along[-2]), inner)

    def voxels(self, axis: int, values: Any) -> numpy.ndarray:
        """Places along a world's axis, in voxels, of coordinates."""
        along = self.along[axis]
        if along is None:
            raise ValueError("this world was not made of an xarray.DataArray with coordinates along this axis")
        order = numpy.argsort(along)
        return numpy.interp(numpy.asarray(values, "f8"), along[order], order.astype("f8")) + 0.5

    def of_voxels(self, voxel: numpy.ndarray) -> dict[str, tuple[numpy.ndarray, dict]]:
        """Coordinates by name of voxels (…, 3 or more), NaN where there is none."""
        none = voxel[..., 0] < 0
        out = {}
        for axis, name in enumerate(self.names):
            if name is not None and self.along[axis] is not None:
                values = numpy.where(none, numpy.nan, self.at(axis, voxel[..., axis] + 0.5))
                out[name] = (values, self.attrs.get(name, {}))
        if self.height is not None:
            name, scale, base = self.height
            # A column of value v is solid up to and with round(v · scale).
            out[name] = (numpy.where(none, numpy.nan, voxel[..., 1] / scale + base), self.attrs.get(name, {}))
        return out


def _metres(array: Any, xs: numpy.ndarray, ys: numpy.ndarray, dims: tuple) -> float | None:
    """How wide a pixel is, in metres, as far as coordinates and reference system say it."""
    step = abs(float(xs[-1] - xs[0])) / (len(xs) - 1)
    units = str(array.coords[dims[1]].attrs.get("units", "")).lower()
    crs = None
    try:
        crs = array.rio.crs
    except Exception:  # noqa: BLE001 - without rioxarray, or without a reference system
        pass
    if units.startswith("degree") or (crs is not None and crs.is_geographic):
        return step * 111_320.0 * float(numpy.cos(numpy.deg2rad(ys.mean())))
    if units in ("m", "metre", "metres", "meter", "meters"):
        return step
    if crs is not None and crs.is_projected:
        return step * float(crs.linear_units_factor[1])
    return None


def of_array(array: Any, words: dict[str, Any]) -> tuple[Any, "Place", dict[str, Any]]:
    """A DataArray with its rows from north to south and its columns from west to east, its place, and the words that its
    coordinates and attributes stand for."""
    array = ordered(array)
    words = dict(words)
    attrs = {str(d): dict(array.coords[d].attrs) for d in array.dims if d in array.coords}
    flips: list[bool] = []
    if array.ndim == 2 and words.get("size") is None:
        row, column = array.dims
        for dim, falls in ((row, True), (column, False)):
            values = _numbers(array, dim)
            turned = values is not None and len(values) > 1 and (values[0] < values[-1]) == falls and role(array, dim) in ("x", "y")
            flips.append(turned)
            array = array.isel({dim: slice(None, None, -1)}) if turned else array
        ys, xs = _numbers(array, row), _numbers(array, column)
        if words.get("nodata") is None and array.dtype.kind in "iuf":
            none = array.attrs.get("_FillValue", array.encoding.get("_FillValue"))
            words["nodata"] = none if none is not None and not numpy.isnan(none) else None
        if words.get("height_scale") is None and xs is not None and ys is not None and min(len(xs), len(ys)) > 1:
            metres = _metres(array, xs, ys, array.dims)
            words["height_scale"] = None if not metres else 1.0 / metres
        name = str(array.name or "height")
        attrs[name] = dict(array.attrs)
        place = Place((str(column), None, str(row)), (xs, None, ys), attrs)
        scale = words.get("height_scale")
        if scale is not None and words.get("exaggeration") in (None, 1, 1.0):
            place.height = (name, float(scale), numpy.nan)
    elif array.ndim == 3:
        z, y, x = array.dims
        along = {d: _numbers(array, d) for d in array.dims}
        if words.get("up") == "x":
            names = (z, x, y)
        elif words.get("up") == "z":
            names = (x, z, y)
        else:
            names = (x, y, z)
        ax, ay, az = (along[d] for d in names)
        if words.get("up") == "z" and az is not None:
            az = az[::-1]
        place = Place((str(names[0]), str(names[1]), str(names[2])), (ax, ay, az), attrs)
    else:
        place = Place((None, None, None), (None, None, None), attrs)
    if "spatial_ref" in array.coords:
        place.spatial_ref = array.coords["spatial_ref"]
    place.flips = (flips[0], flips[1]) if flips else (False, False)
    return array, place, words
