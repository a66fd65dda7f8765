"""``da.planecast``: worlds and pictures of an xarray.DataArray, in its coordinates."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy

import planecast


class Accessor:
    """``da.planecast.render()`` draws a DataArray; ``da.planecast.encode()`` makes the world of it.

    Axes are found by CF's attributes and by name; a map whose rows run to the north is turned about, so that north is up. Where
    coordinates or the reference system (rioxarray) say how wide a pixel is, heights are taken as metres.
    """

    def __init__(self, array: Any) -> None:
        self._array = array
        self._worlds: dict[str, planecast.World] = {}

    def encode(self, output: str | os.PathLike | None = None, **words: Any) -> planecast.World:
        """As `planecast.encode`."""
        return planecast.encode(self._array, output, **words)

    def _world(self, read: Mapping[str, Any] | None) -> planecast.World:
        # Kept as long as the accessor, which xarray keeps as long as the array.
        key = repr(sorted((read or {}).items()))
        if key not in self._worlds:
            self._worlds[key] = self.encode(**(read or {}))
        return self._worlds[key]

    def render(self, *, read: Mapping[str, Any] | None = None, voxel: bool = True, **words: Any) -> planecast.Image:
        """A picture; `read` says how the array is read, as in `encode`, once: call `encode` again after its values changed. The
        others are those of `World.render`. ``.to_xarray()`` of the picture has the coordinates of what each pixel shows."""
        return self._world(read).render(voxel=voxel, **words)

    def pick(self, origins: Any, directions: Any, *, read: Mapping[str, Any] | None = None) -> Any:
        """An xarray.Dataset of what rays meet, in the array's coordinates: `distance` in voxels, +inf where there is nothing.
        Origins and directions are (…, 3), voxels, as in `World.pick`."""
        import xarray

        world = self._world(read)
        distance, voxel = world.pick(origins, directions)
        dims = tuple(f"ray_{i}" if distance.ndim > 1 else "ray" for i in range(distance.ndim))
        variables: dict[str, Any] = {"distance": (dims, distance, {"units": "voxels"})}
        variables |= {name: (dims, v, a) for name, (v, a) in world._placed().of_voxels(voxel).items()}
        return xarray.Dataset(variables | world._placed().reference())

    def viewshed(self, x: Any, y: Any, *, height: float = 2.0, read: Mapping[str, Any] | None = None) -> Any:
        """A DataArray like this one, a map of heights: how many places see each cell. Places are at the coordinates `x` (along
        columns) and `y` (along rows), `height` voxels above the ground."""
        world = self._world(read)
        if self._array.ndim != 2:
            raise ValueError(f"viewshed: of a map of heights, an array of two axes; this has {self._array.ndim}")
        vx, vz = numpy.broadcast_arrays(*world.voxels(numpy.atleast_1d(x), numpy.atleast_1d(y)))
        eyes = numpy.stack([vx, world.heights(vx, vz) + height, vz], -1)
        place = world._placed()
        seen = world.viewshed(eyes)[:: -1 if place.flips[0] else 1, :: -1 if place.flips[1] else 1]
        from ._place import ordered

        like = ordered(self._array)
        out = like.copy(data=seen).astype("u2", copy=False).rename("viewshed")
        out.attrs = {"long_name": "places that see the cell"}
        return out.transpose(*self._array.dims)
