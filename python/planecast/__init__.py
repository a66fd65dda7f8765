"""Voxel terrains and volumes: encoded as run-length-encoded columns, drawn on GPU and CPU.

>>> import numpy, planecast
>>> z, x = numpy.mgrid[0:64, 0:64]
>>> world = planecast.encode((8 + 6 * numpy.sin(x / 9) * numpy.cos(z / 7)).astype("u1"))
>>> world.shape
(64, 14, 64)
>>> image = world.render(size=(160, 90), device="cpu")
>>> image.rgb.shape, image.depth.dtype.str
((90, 160, 3), '<f4')

Keyword arguments have the names and meanings of the command line's flags: ``--view-distance 400`` is
``view_distance=400``; a flag without a value is ``True``. Units are voxels of level 0 and degrees; the world is
right-handed with y up. ``planecast render --help`` and ``planecast encode --help`` list all of them.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any, Iterable, Iterator, Mapping, Sequence

import numpy

from . import _planecast
from ._planecast import __version__

__all__ = ["Camera", "Image", "World", "encode", "info", "open", "__version__"]


def _text(name: str, value: Any) -> str:
    """One value as the command line has it."""
    if isinstance(value, str):
        return value
    if isinstance(value, (os.PathLike, bytes)):
        return os.fsdecode(value)
    if isinstance(value, range):
        if value.step != 1:
            raise ValueError(f"{name}=: {value!r}; a range of frames has steps of 1")
        return f"{value.start}..{value.stop}"
    if isinstance(value, (Sequence, numpy.ndarray)):
        between = "x" if name in ("size", "window") else ","
        return between.join(_text("", v) for v in value)
    if isinstance(value, (bool, numpy.bool_)):
        raise ValueError(f"{name}=: {value!r}; it is a number or a word")
    if isinstance(value, (int, numpy.integer)):
        return str(int(value))
    if isinstance(value, (float, numpy.floating)):
        return repr(float(value))
    raise ValueError(f"{name}=: cannot take {type(value).__name__}; expected a number, a word or several of them")


def _words(arguments: Mapping[str, Any]) -> list[str]:
    """Keyword arguments as the words of a command; None and False stand for what is not said."""
    words = []
    for name, value in arguments.items():
        flag = "--" + name.replace("_", "-")
        if value is True:
            words.append(flag)
        elif value is not None and value is not False:
            words.append(f"{flag}={_text(name, value)}")
    return words


@dataclass(frozen=True)
class Camera:
    """Where a picture was taken from. `eye` in voxels, angles in degrees, `size` (width, height) in pixels."""

    eye: tuple[float, float, float]
    yaw: float
    pitch: float
    roll: float
    fov: float
    size: tuple[int, int]

    @classmethod
    def _of(cls, camera: tuple) -> "Camera":
        eye, yaw, pitch, roll, fov, width, height = camera
        return cls(eye, yaw, pitch, roll, fov, (width, height))

    def words(self) -> dict[str, Any]:
        """The keyword arguments of `World.render` that draw from here."""
        return dict(eye=self.eye, yaw=self.yaw, pitch=self.pitch, roll=self.roll, fov=self.fov, size=self.size)


@dataclass(frozen=True)
class Image:
    """A drawn picture. Arrays are those that the renderer wrote, without a copy.

    rgba   (H, W, 4) u1, sRGB; sky is transparent with ``sky="none"``, else alpha is 255
    rgb    (H, W, 3) u1, a view of `rgba`
    depth  (H, W) f4, voxels along the camera's forward axis; sky is +inf
    voxel  (H, W, 4) i4: x, y, z of the voxel of level 0 and the level, -1 for sky; None unless asked for
    stats  what the frame cost, by stage
    """

    rgba: numpy.ndarray
    depth: numpy.ndarray
    voxel: numpy.ndarray | None
    camera: Camera
    stats: dict[str, Any] = field(repr=False)

    @property
    def rgb(self) -> numpy.ndarray:
        return self.rgba[..., :3]

    def save(self, path: str | os.PathLike) -> None:
        """Writes the picture as PNG or JPEG, by its ending (needs Pillow)."""
        from PIL import Image as Pillow

        transparent = os.fspath(path).lower().endswith(".png") and (self.rgba[..., 3] != 255).any()
        Pillow.fromarray(self.rgba if transparent else numpy.ascontiguousarray(self.rgb)).save(path)

    def _repr_png_(self) -> bytes:
        import io

        from PIL import Image as Pillow

        out = io.BytesIO()
        Pillow.fromarray(numpy.ascontiguousarray(self.rgb)).save(out, "png")
        return out.getvalue()


class World:
    """A world that can be drawn and asked; made by `encode` or `open`."""

    def __init__(self, inner: _planecast.World, coords: tuple | None = None) -> None:
        self._inner = inner
        self._coords = coords

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nx, ny, nz), voxels of level 0, y up."""
        return self._inner.dims

    @property
    def notes(self) -> list[str]:
        """How the input was read, for a person."""
        return self._inner.notes

    def __repr__(self) -> str:
        return "<planecast.World of {} × {} × {} voxels>".format(*self.shape)

    def render(self, *, voxel: bool = False, **words: Any) -> Image:
        """Draws a picture; without `eye` and angles a good view of the whole world.

        eye=(x, y, z), yaw=, pitch=, roll=, fov=, size=(width, height), look_at=(x, y, z), orbit=(yaw, pitch[, distance]),
        fit=True, top=True, device="auto"|"gpu"|"cpu"|"exact", view_distance=, repeat="none"|"x"|"z"|"xz", lod=,
        planes=, shading=, sun=(azimuth, elevation), fog=, sky=, …: as ``planecast render --help`` has them.

        Raises ValueError where a word or its value is wrong, RuntimeError where a device fails, MemoryError.
        """
        (color, depth, voxels, stats), camera = self._inner.draw(_words(words), voxel)
        camera = Camera._of(camera)
        width, height = camera.size
        return Image(
            rgba=color.reshape(height, width, 4),
            depth=depth.reshape(height, width),
            voxel=None if voxels is None else voxels.reshape(height, width, 4),
            camera=camera,
            stats=json.loads(stats),
        )

    def render_many(self, poses: Iterable[Mapping[str, Any] | Camera], **words: Any) -> Iterator[Image]:
        """A picture for each pose, in order; `words` are those of all of them."""
        for pose in poses:
            pose = pose.words() if isinstance(pose, Camera) else pose
            yield self.render(**{**words, **pose})

    def flight(self, *, path: Sequence[Mapping[str, Any]] | None = None, **words: Any) -> list[Camera]:
        """The cameras of a flight: frames=, fps=, size=, fov=, and `path`, keyframes of {"t", "eye", "yaw", "pitch", …};
        without one, the tour of this world."""
        text = None if path is None else json.dumps(list(path))
        return [Camera._of(camera) for camera in self._inner.cameras(_words(words), text)]

    def fly(
        self,
        output: str | os.PathLike | None = None,
        *,
        path: Sequence[Mapping[str, Any]] | None = None,
        **words: Any,
    ) -> int | Iterator[Image]:
        """Makes a film (.mp4, .gif, .png, .y4m, or a folder of frames) and says of how many frames; without `output`,
        the frames one after the other."""
        if output is not None:
            text = None if path is None else json.dumps(list(path))
            return self._inner.fly(os.fspath(output), _words(words), text)
        of_flight = {name: words.pop(name) for name in ("frames", "fps", "size", "fov") if name in words}
        return self.render_many(self.flight(path=path, **of_flight), **words)

    def query(self, points: Any) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Of voxels (…, 3), whole numbers: which are solid (…) bool, and their colours (…, 3) i2, -1 where there is none."""
        points = numpy.asarray(points)
        if points.dtype.kind not in "iu":
            raise ValueError(f"points=: voxels of type {points.dtype}; expected whole numbers")
        points = _rows("points", points, numpy.int64)
        solid, color = self._inner.query(points.reshape(-1, 3))
        return solid.reshape(points.shape[:-1]), color.reshape(points.shape)

    def pick(self, origins: Any, directions: Any) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Of rays (…, 3) from `origins` along `directions`: how far the first solid voxel is (…) f8, +inf where there is
        none, and which it is (…, 3) i4, -1 where there is none. Either may be one point for all."""
        origins, directions = numpy.broadcast_arrays(
            _rows("origins", origins, numpy.float64), _rows("directions", directions, numpy.float64)
        )
        shape = origins.shape
        flat = [numpy.ascontiguousarray(a).reshape(-1, 3) for a in (origins, directions)]
        distance, voxel = self._inner.pick(*flat)
        return distance.reshape(shape[:-1]), voxel.reshape(shape)

    def heights(self) -> numpy.ndarray:
        """One past the highest solid voxel of each column, (nz, nx) i4; 0 where a column is empty."""
        nx, _, nz = self.shape
        return self._inner.heights().reshape(nz, nx)

    def coordinates(self, x: Any, z: Any) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Where columns lie in the coordinates of the xarray.DataArray that was encoded: those of its last axis at `x`, of
        the one before at `z`, in voxels."""
        if self._coords is None:
            raise ValueError("this world was not made of an xarray.DataArray with coordinates")
        along_x, along_z = self._coords
        # The middle of a voxel is that of its cell.
        places = [numpy.interp(numpy.asarray(v) - 0.5, numpy.arange(len(c)), c) for v, c in ((x, along_x), (z, along_z))]
        return places[0], places[1]


def _rows(name: str, values: Any, dtype: Any) -> numpy.ndarray:
    values = numpy.ascontiguousarray(values, dtype=dtype)
    if values.shape[-1:] != (3,):
        raise ValueError(f"{name}=: an array of shape {values.shape}; expected x, y, z along the last axis")
    return values


def _plain(array: Any) -> tuple[numpy.ndarray, tuple | None]:
    """An array's values as they can be read, without a copy where they lie side by side, and the coordinates of its axes."""
    coords = None
    if hasattr(array, "dims") and hasattr(array, "coords") and hasattr(array, "to_numpy"):  # xarray.DataArray
        if array.ndim >= 2 and all(d in array.coords for d in array.dims[-2:]):
            z, x = (numpy.asarray(array.coords[d].values) for d in array.dims[-2:])
            if array.ndim == 2 and all(c.dtype.kind in "iuf" for c in (z, x)):
                coords = (x, z)
        array = array.to_numpy()
    elif not isinstance(array, numpy.ndarray):
        array = numpy.asarray(array)
    if numpy.ma.isMaskedArray(array):
        raise ValueError("a masked array; say what stands for no data: array.filled(-9999) and nodata=-9999")
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
        raise ValueError(f"an array of {array.dtype}; expected integers, booleans or floats: array.astype('f4')")
    if not (array.flags.c_contiguous or array.flags.f_contiguous):
        array = numpy.ascontiguousarray(array)
    return array, coords


def encode(source: Any, output: str | os.PathLike | None = None, **words: Any) -> World:
    """A world of an array, or of whatever ``planecast encode`` reads.

    An array of two axes (row, column) is a map of heights, one of three axes (z, y, x) a volume: solid where it is above 0
    (u1, booleans) or at least `iso`. up="y"|"z", iso=, height_scale=, size=, ramp=, exaggeration=, spacing=, colors=,
    encoding=, color=, memory=, …: as ``planecast encode --help`` has them. With `output` the scene is kept there (.pcast).

    Values that lie side by side are read where they are; other arrays are copied first. An array that is written to
    meanwhile gives a world of some old and some new values.

    Raises ValueError, OSError or MemoryError, which say what was wrong and what is allowed.
    """
    output = None if output is None else os.fspath(output)
    if isinstance(source, (str, os.PathLike)):
        return World(_planecast.encode_path(os.fspath(source), _words(words), output))
    array, coords = _plain(source)
    if array.size == 0:
        raise ValueError(f"an array of shape {array.shape}; every side must be at least 1")
    fortran = array.flags.f_contiguous and not array.flags.c_contiguous
    # Bytes as they lie: the axes of an array in Fortran's order are turned round for that.
    lying = (array.T if fortran else array).reshape(-1).view(numpy.uint8)
    inner = _planecast.encode_array(lying, list(array.shape), array.dtype.str, fortran, _words(words), output)
    return World(inner, coords)


def open(path: str | os.PathLike, **words: Any) -> World:
    """Opens a scene (.pcast) or an input, a file or a URL; `words` say how an input is read, as in `encode`."""
    return World(_planecast.open(os.fspath(path), _words(words)))


def info(path: str | os.PathLike) -> dict[str, Any]:
    """What ``planecast info --json`` says of a scene file."""
    return json.loads(_planecast.scene_info(os.fspath(path)))


try:
    import xarray as _xarray
except ImportError:
    pass
else:

    @_xarray.register_dataarray_accessor("planecast")
    class _Accessor:
        """``da.planecast.render()`` draws a DataArray; ``da.planecast.encode()`` makes the world of it."""

        def __init__(self, array: Any) -> None:
            self._array = array

        def encode(self, output: str | os.PathLike | None = None, **words: Any) -> World:
            return encode(self._array, output, **words)

        def render(self, *, read: Mapping[str, Any] | None = None, **words: Any) -> Image:
            """`read` says how the array is read, as in `encode`; the others are those of `World.render`."""
            return encode(self._array, **(read or {})).render(**words)
