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
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import numpy

from . import _arrays, _planecast
from ._image import Camera, Image
from ._place import Place, of_array
from ._planecast import __version__
from ._words import words as _words

__all__ = ["Camera", "Image", "World", "encode", "info", "join", "merge", "open", "report", "__version__"]

# Bytes of pictures that are drawn ahead of who takes them.
_AHEAD = 64 << 20

_POSE = ("eye", "yaw", "pitch", "roll")


def _pose(words: dict[str, Any]) -> tuple[dict[str, Any], list[float] | None]:
    """Words without a pose, and the pose, where they say all of one."""
    said = {name for name in _POSE if words.get(name) is not None}
    if not {"eye", "yaw", "pitch"} <= said or words.get("projection") or any(words.get(n) for n in ("look_at", "orbit", "fit", "top")):
        return words, None
    try:
        x, y, z = map(float, words["eye"])
        angles = [float(words.get(name) or 0.0) for name in _POSE[1:]]
    except (TypeError, ValueError):
        return words, None
    # What is out of bounds is told in the words' own terms.
    if not all(map(numpy.isfinite, (x, y, z, *angles))) or not -90 <= angles[1] <= 90 or isinstance(words["eye"], str):
        return words, None
    return {name: value for name, value in words.items() if name not in _POSE}, [x, y, z, *angles]


class World:
    """A world that can be drawn and asked; made by `encode` or `open`. May be used by several threads."""

    def __init__(self, inner: _planecast.World, place: Place | None = None) -> None:
        self._inner = inner
        self._place = place

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

    def _image(self, drawn: tuple) -> Image:
        (color, depth, voxels, stats), camera = drawn
        camera = Camera._of(camera)
        width, height = camera.size
        return Image(
            rgba=color.reshape(height, width, 4),
            depth=depth.reshape(height, width),
            voxel=None if voxels is None else voxels.reshape(height, width, 4),
            camera=camera,
            stats=json.loads(stats),
            _place=self._place,
        )

    def render(self, *, voxel: bool = False, **words: Any) -> Image:
        """Draws a picture; without `eye` and angles a good view of the whole world.

        eye=(x, y, z), yaw=, pitch=, roll=, fov=, size=(width, height), look_at=(x, y, z), orbit=(yaw, pitch[, distance]),
        fit=True, top=True, device="auto"|"gpu"|"cpu"|"exact", view_distance=, repeat="none"|"x"|"z"|"xz", lod=,
        planes=, shading=, sun=(azimuth, elevation), fog=, sky=, …: as ``planecast render --help`` has them.
        `voxel`: the picture's `voxel` is made, too.

        Raises ValueError where a word or its value is wrong, RuntimeError where a device fails, MemoryError.

        >>> world = encode(numpy.ones((8, 8, 8), "u1"))
        >>> image = world.render(eye=(4, 4, 20), yaw=0, pitch=0, size=(9, 9), device="cpu", voxel=True)
        >>> float(image.depth[4, 4]), image.voxel[4, 4].tolist()
        (12.0, [4, 4, 7, 0])
        """
        rest, pose = _pose(words)
        return self._image(self._inner.draw(_words(rest), voxel, pose))

    def render_many(self, poses: Iterable[Mapping[str, Any] | Camera], *, voxel: bool = False, **words: Any) -> Iterator[Image]:
        """A picture for each pose, in order: a `Camera`, or keyword arguments of `render` as a mapping; `words` are those of
        all of them. Pictures are drawn together some at a time, which for many small ones takes much less than one after
        the other.

        >>> world = encode(numpy.ones((8, 8, 8), "u1"))
        >>> poses = [dict(eye=(4, 4, 20 + i), yaw=0, pitch=0) for i in range(3)]
        >>> [float(image.depth[4, 4]) for image in world.render_many(poses, size=(9, 9), device="cpu")]
        [12.0, 13.0, 14.0]
        """
        waiting: list[list[float]] = []
        before: list[str] = []
        most = 1

        def drawn() -> Iterator[Image]:
            for one in self._inner.draw_many(before, voxel, waiting) if waiting else []:
                yield self._image(one)
            waiting.clear()

        for pose in poses:
            rest, place = _pose({**words, **(pose.words() if isinstance(pose, Camera) else pose)})
            said = _words(rest)
            if place is None or said != before or len(waiting) >= most:
                yield from drawn()
            if place is None:
                yield self._image(self._inner.draw(said, voxel))
                continue
            if said != before:
                # Frames of 8 bytes a pixel, of 24 with voxels.
                width, height = rest["size"] if isinstance(rest.get("size"), Sequence) and len(rest["size"]) == 2 else (1280, 720)
                most = max(1, min(256, _AHEAD // max(1, int(width) * int(height) * (24 if voxel else 8))))
                before = said
            waiting.append(place)
        yield from drawn()

    def flight(self, *, path: Sequence[Mapping[str, Any]] | None = None, **words: Any) -> list[Camera]:
        """The cameras of a flight: frames=, fps=, size=, fov=, and `path`, keyframes of {"t", "eye", "yaw", "pitch", …};
        without one, the tour of this world."""
        text = None if path is None else json.dumps(list(path))
        return [Camera._of(camera) for camera in self._inner.cameras(_words(words), text)[0]]

    def fly(
        self,
        output: str | os.PathLike | None = None,
        *,
        path: Sequence[Mapping[str, Any]] | None = None,
        **words: Any,
    ) -> int | Iterator[Image]:
        """Makes a film (.mp4, .gif, .png, .y4m, or a folder of frames) and says of how many frames; without `output`,
        the frames one after the other. frames=240, or of these some: frames=(range(24, 48), 240), which `join` puts
        together with others."""
        if output is not None:
            text = None if path is None else json.dumps(list(path))
            return self._inner.fly(os.fspath(output), _words(words), text)
        of_flight = {name: words.pop(name) for name in ("frames", "fps", "size", "fov", "orbit", "look_at", "fit", "top") if name in words}
        return self.render_many(self.flight(path=path, **of_flight), **words)

    def query(self, points: Any) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Of voxels (…, 3), whole numbers: which are solid (…) bool, and their colours (…, 3) i2, -1 where there is none.

        >>> world = encode(numpy.ones((8, 8, 8), "u1"))
        >>> world.query([[0, 0, 0], [0, 8, 0]])[0].tolist()
        [True, False]
        """
        points = numpy.asarray(points)
        if points.dtype.kind not in "iu":
            raise ValueError(f"points=: voxels of type {points.dtype}; expected whole numbers")
        points = _rows("points", points, numpy.int64)
        solid, color = self._inner.query(points.reshape(-1, 3))
        return solid.reshape(points.shape[:-1]), color.reshape(points.shape)

    def pick(self, origins: Any, directions: Any) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Of rays (…, 3) from `origins` along `directions`: how far the first solid voxel is (…) f8, voxels, +inf where there
        is none, and which it is (…, 3) i4, -1 where there is none. Either may be one point for all.

        >>> world = encode(numpy.ones((8, 8, 8), "u1"))
        >>> distance, voxel = world.pick([4.5, 20, 4.5], [[0, -1, 0], [0, 1, 0]])
        >>> distance.tolist(), voxel.tolist()
        ([12.0, inf], [[4, 7, 4], [-1, -1, -1]])
        """
        origins, directions = numpy.broadcast_arrays(
            _rows("origins", origins, numpy.float64), _rows("directions", directions, numpy.float64)
        )
        shape = origins.shape
        flat = [numpy.ascontiguousarray(a).reshape(-1, 3) for a in (origins, directions)]
        distance, voxel = self._inner.pick(*flat)
        return distance.reshape(shape[:-1]), voxel.reshape(shape)

    def heights(self, x: Any = None, z: Any = None) -> numpy.ndarray:
        """One past the highest solid voxel of each column, i4, 0 where a column is empty: of all (nz, nx), or of the columns at
        `x` and `z`, whole numbers or places within columns, in the shape that both have together."""
        nx, _, nz = self.shape
        heights = self._inner.heights().reshape(nz, nx)
        if x is None and z is None:
            return heights
        if x is None or z is None:
            raise ValueError("heights: give both x= and z=, or neither")
        x, z = numpy.broadcast_arrays(numpy.floor(x).astype("i8"), numpy.floor(z).astype("i8"))
        within = (x >= 0) & (x < nx) & (z >= 0) & (z < nz)
        return numpy.where(within, heights[numpy.clip(z, 0, nz - 1), numpy.clip(x, 0, nx - 1)], 0)

    def viewshed(self, eyes: Any, *, each: bool = False) -> numpy.ndarray:
        """How many of the places `eyes` (…, 3), voxels, see each column: (nz, nx) u2. With `each`, which columns each place
        sees: (…, nz, nx) bool.

        >>> wall = numpy.ones((16, 16), "u1"); wall[:, 8] = 9
        >>> seen = encode(wall, height_scale=1).viewshed([2, 4, 8])
        >>> bool(seen[8, 3]), bool(seen[8, 12])
        (True, False)
        """
        eyes = _rows("eyes", eyes, numpy.float64)
        nx, _, nz = self.shape
        if not each:
            return self._inner.viewshed(eyes.reshape(-1, 3)).reshape(nz, nx)
        out = numpy.empty((eyes.size // 3, nz, nx), bool)
        for i, eye in enumerate(eyes.reshape(-1, 1, 3)):
            out[i] = self._inner.viewshed(eye).reshape(nz, nx)
        return out.reshape(*eyes.shape[:-1], nz, nx)

    def coordinates(self, x: Any, z: Any) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Where columns lie in the coordinates of the xarray.DataArray that was encoded: those of its last axis at `x`, of
        the one before at `z`, in voxels (of a volume: those along the world's x and z)."""
        place = self._placed()
        return place.at(0, x), place.at(2, z)

    def voxels(self, x: Any, z: Any) -> tuple[numpy.ndarray, numpy.ndarray]:
        """The other way round: places in voxels of such coordinates."""
        place = self._placed()
        return place.voxels(0, x), place.voxels(2, z)

    def _placed(self) -> Place:
        if self._place is None:
            raise ValueError("this world was not made of an xarray.DataArray with coordinates")
        return self._place

    def save(self, output: str | os.PathLike) -> None:
        """Keeps the scene in a file (.pcast), which is written whole or not at all."""
        self._inner.save(os.fspath(output))

    def report(self, folder: str | os.PathLike, **words: Any) -> str | None:
        """Measures error against time on this world, as the function `report` does."""
        with tempfile.TemporaryDirectory(prefix="planecast-") as passing:
            scene = self._inner.file
            if scene is None:
                scene = os.path.join(passing, "world.pcast")
                self.save(scene)
            return report(scene, folder, **words)

    def view(self, **words: Any) -> Any:
        """A widget for a notebook: `planecast.widget.View` of this world."""
        from .widget import View

        return View(self, **words)


def _rows(name: str, values: Any, dtype: Any) -> numpy.ndarray:
    values = numpy.ascontiguousarray(values, dtype=dtype)
    if values.shape[-1:] != (3,):
        raise ValueError(f"{name}=: an array of shape {values.shape}; expected x, y, z along the last axis")
    return values


_KINDS = (None, "heights", "volume", "labels", "points")


def encode(
    source: Any,
    output: str | os.PathLike | None = None,
    *,
    kind: str | None = None,
    colors: Any = None,
    client: Any = None,
    **words: Any,
) -> World:
    """A world of an array, or of whatever ``planecast encode`` reads.

    An array of two axes (row, column) is a map of heights, one of three axes (z, y, x) a volume: solid where it is above 0
    (u1, booleans) or at least `iso`. ``kind="labels"``: a volume in which all but 0 is solid, with a colour for each value;
    ``kind="points"``: a cloud, (N, 3). `colors` lie on a map of heights, (rows, columns, 3) u1, nearest pixel, or are those of
    points, (N, 3) u1; or they are an image's path. up="y"|"z", iso=, height_scale=, size=, ramp=, exaggeration=, spacing=,
    encoding=, color=, memory=, …: as ``planecast encode --help`` has them. With `output` the scene is kept there (.pcast), and opened when the world is
    first asked for something.

    Values of an ndarray or memmap that lie side by side are read where they are; other ndarrays are copied first. Arrays of
    Zarr, Dask and h5py, and an xarray.DataArray of such, are read block by block and are never in memory as a whole; chunks
    of a Zarr array that were never written are not looked at where their fill value is air. With `client`, of Dask, the work
    is done on its cluster (`planecast.cluster`). An array that is written to meanwhile gives a world of some old and some
    new values. An xarray.DataArray's coordinates are kept: `World.coordinates`, `Image.to_xarray`.

    Raises ValueError, OSError or MemoryError, which say what was wrong and what is allowed; and what the array's own reading
    raises.
    """
    if kind not in _KINDS:
        raise ValueError(f"kind=: {kind!r}; expected one of {', '.join(map(repr, _KINDS[1:]))}")
    output = None if output is None else os.fspath(output)
    if client is not None:
        from . import cluster

        if kind not in (None, "heights", "volume") or colors is not None:
            raise ValueError("client=: is for maps of heights and volumes without colours")
        return cluster.encode(source, output, client, **words)
    with ExitStack() as passing:
        if colors is not None and not isinstance(colors, (str, os.PathLike)):
            colors = colors if _arrays.is_lazy(colors) else numpy.asarray(colors)
            if kind != "points":
                colors = passing.enter_context(_arrays.tiff(colors))
        if isinstance(source, (str, os.PathLike)):
            if kind is not None:
                raise ValueError("kind=: is for arrays; a file says what it is")
            return World(_whole(_planecast.encode_path(os.fspath(source), _words({**words, "colors": colors}), output, None)))
        if kind == "points":
            if isinstance(colors, (str, os.PathLike)):
                raise ValueError("colors=: points have an array of them, (N, 3)")
            points = source if _arrays.is_lazy(source) else numpy.asarray(source)
            name = passing.enter_context(_arrays.ply(points, colors))
            return World(_whole(_planecast.encode_path(name, _words(words), output, None)))
        return _of_array(source, output, kind, {**words, "colors": colors})


def _whole(world: _planecast.World | None) -> _planecast.World:
    assert world is not None, "all of it was encoded"
    return world


def _of_array(array: Any, output: str | None, kind: str | None, words: dict[str, Any]) -> World:
    place = None
    if hasattr(array, "dims") and hasattr(array, "coords") and hasattr(array, "to_numpy"):  # xarray.DataArray
        array, place, words = of_array(array, words)
    lazy = _arrays.is_lazy(array)
    if not lazy:
        array = _arrays.plain(array)
    _check_shape(array.shape, kind)
    said = _words(words)
    if not lazy and kind != "labels":
        if place is not None and place.height is not None:
            low = numpy.where(array == words.get("nodata"), numpy.nan, array) if words.get("nodata") is not None else array
            low = float(numpy.nanmin(low)) if low.dtype.kind != "f" or numpy.isfinite(low).any() else 0.0
            place.height = (*place.height[:2], min(low, 0.0))
        fortran = array.flags.f_contiguous and not array.flags.c_contiguous
        # Bytes as they lie: the axes of an array in Fortran's order are turned round for that.
        lying = (array.T if fortran else array).reshape(-1).view(numpy.uint8)
        inner = _planecast.encode_array(lying, list(array.shape), array.dtype.str, fortran, said, output)
        return World(_whole(inner), place)
    if place is not None:
        place.height = None
    dtype = _arrays.native(array.dtype)
    known = _arrays.written(array)
    chunks, fill = known if known is not None else (None, 0.0)
    inner = _planecast.encode_blocks(
        _arrays.fetch(array, dtype), list(array.shape), _arrays.sides(array), dtype.name, fill, chunks, [], None, kind == "labels",
        said, output, None,
    )  # fmt: skip
    return World(_whole(inner), place)


def _check_shape(shape: tuple[int, ...], kind: str | None) -> None:
    if 0 in shape:
        raise ValueError(f"an array of shape {tuple(shape)}; every side must be at least 1")
    rank = sum(n > 1 for n in shape) if len(shape) > 3 else len(shape)
    if kind == "heights" and rank != 2 or kind in ("volume", "labels") and rank != 3:
        wanted = "two axes (row, column)" if kind == "heights" else "three axes (z, y, x)"
        raise ValueError(f"kind={kind!r}: an array of shape {tuple(shape)}; expected {wanted}")


def open(path: str | os.PathLike, **words: Any) -> World:
    """Opens a scene (.pcast) or an input, a file or a URL; `words` say how an input is read, as in `encode`. As with
    ``planecast render`` a map of heights takes colours and is drawn as a surface."""
    return World(_planecast.open(os.fspath(path), _words(words)))


def info(path: str | os.PathLike) -> dict[str, Any]:
    """What ``planecast info --json`` says of a scene file."""
    return json.loads(_planecast.scene_info(os.fspath(path)))


def report(scene: str | os.PathLike, folder: str | os.PathLike, **words: Any) -> str | None:
    """Measures error against time on a scene or an input, into a folder: report.html, .csv, .json, plots. quick=True, size=,
    rounds=, fov=, device=, …: as ``planecast report --help`` has them; with budget_ms= or max_error=, what was chosen. stream=True
    measures a world in tiles, and gives its result in a sentence."""
    return _planecast.report(os.fspath(scene), os.fspath(folder), _words(words))


def merge(parts: Iterable[str | os.PathLike], output: str | os.PathLike, **words: Any) -> World:
    """Joins parts of a scene (``planecast encode --tiles``, `planecast.cluster`) to the scene that one encode would give."""
    _planecast.merge([os.fspath(part) for part in parts], os.fspath(output), _words(words))
    return open(output)


def join(parts: Iterable[str | os.PathLike], output: str | os.PathLike) -> int:
    """Joins parts of a film (.mp4), in order; how many frames it has."""
    return _planecast.join([os.fspath(part) for part in parts], os.fspath(output))


try:
    import xarray as _xarray
except ImportError:
    pass
else:
    from .accessor import Accessor as _Accessor

    _xarray.register_dataarray_accessor("planecast")(_Accessor)
