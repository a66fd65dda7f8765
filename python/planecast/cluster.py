"""Work on a Dask cluster: scenes by parts, films and pictures by ranges of them.

Parts are files, in a folder that all workers and the client see. A task whose worker dies is run again by Dask elsewhere; each
attempt writes a file of its own, which takes the part's name when it is whole. Scenes and films have the bytes that the work at
once gives.
"""

from __future__ import annotations

import functools
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy

import planecast

from . import _arrays, _planecast
from ._place import of_array
from ._words import words as _words

# Bytes of an array that a task holds, as far as one tile allows.
AT_ONCE = 256 << 20

RETRIES = 3


def _attempt(part: str) -> str:
    stem, ending = os.path.splitext(part)
    return f"{stem}.{uuid.uuid4().hex}{ending}"


def _part_of_array(values: Any, origin: list[int], how: dict[str, Any], tiles: tuple[int, int], region: list, part: str) -> str:
    if os.path.exists(part):
        return part
    dtype = numpy.dtype(how["dtype"])

    def get(starts: list[int], ends: list[int]) -> numpy.ndarray:
        block = values[tuple(slice(a - o, b - o) for a, b, o in zip(starts, ends, origin))]
        return numpy.ascontiguousarray(block, dtype=dtype).reshape(-1).view(numpy.uint8)

    attempt = _attempt(part)
    _planecast.encode_blocks(
        get, how["shape"], how["chunk"], dtype.name, 0.0, None, region, how["heights"], False, how["words"], attempt, tiles
    )
    os.replace(attempt, part)
    return part


def _part_of_path(path: str, words: list[str], tiles: tuple[int, int], part: str) -> str:
    if not os.path.exists(part):
        attempt = _attempt(part)
        _planecast.encode_path(path, words, attempt, tiles)
        os.replace(attempt, part)
    return part


def _workers(client: Any) -> int:
    return max(1, len(client.scheduler_info()["workers"]))


def encode(
    source: Any,
    output: str | os.PathLike | None,
    client: Any,
    *,
    parts: str | os.PathLike | None = None,
    jobs: int | None = None,
    **words: Any,
) -> planecast.World:
    """A world of a Dask array (heights or a volume), or of a file that all workers see, encoded on the cluster of `client`.

    `parts` is the folder for parts [default: OUTPUT.parts]; what is there from before is not made again. `jobs` is how many
    tasks there are at least where the input is a file [default: four a worker]. Without `output` parts and scene are in a
    passing folder, which workers on other machines do not see.
    """
    with tempfile.TemporaryDirectory(prefix="planecast-") as passing:
        scene = os.path.abspath(output) if output is not None else os.path.join(passing, "world.pcast")
        folder = os.path.abspath(parts) if parts is not None else scene + ".parts"
        os.makedirs(folder, exist_ok=True)
        place = None
        if isinstance(source, (str, os.PathLike)):
            path = os.fspath(source)
            path = path if "://" in path or path.startswith("procedural:") else os.path.abspath(path)
            said = _words(words)
            (across, down), _ = _planecast.tiles(None, path, said)
            n = across * down
            jobs = max(1, min(n, jobs or 4 * _workers(client)))
            cuts = [n * i // jobs for i in range(jobs + 1)]
            tasks = [
                client.submit(_part_of_path, path, said, (a, b), f"{folder}/{a}-{b}.part", retries=RETRIES, pure=False)
                for a, b in zip(cuts, cuts[1:])
            ]
        else:
            if hasattr(source, "dims") and hasattr(source, "coords"):
                source, place, words = of_array(source, words)
                place.height = None
                source = source.data
            tasks = _array_tasks(source, client, folder, words)
        done = client.gather(tasks)
        planecast.merge(done, scene, memory=words.get("memory"), zstd=words.get("zstd"))
        world = planecast.World(_planecast.open(scene, []), place)
        if parts is None:
            shutil.rmtree(folder)
        return world


def _array_tasks(array: Any, client: Any, folder: str, words: dict[str, Any]) -> list[Any]:
    import dask
    import dask.array

    if not isinstance(array, dask.array.Array):
        array = dask.array.from_array(array)
    planecast._check_shape(array.shape, None)
    if array.ndim not in (2, 3) or any(numpy.isnan(n) for n in array.shape):
        raise ValueError(f"an array of shape {array.shape}; expected three axes (z, y, x), or two, a map of heights; of known sizes")
    dtype = _arrays.native(array.dtype)
    heights = None
    words = dict(words)
    if array.ndim == 2:
        dtype = numpy.dtype("f4")
        array = array.astype("f4")
        if (none := words.pop("nodata", None)) is not None:
            array = dask.array.where(array == numpy.float32(none), numpy.float32("nan"), array)
        if words.get("size") is not None or words.get("ramp") is not None:
            raise ValueError("client=: a map of heights is encoded in parts without size= and ramp=, which need all of it at once")
        finite = dask.array.isfinite(array)
        low, high = client.gather(
            client.compute([dask.array.where(finite, array, numpy.inf).min(), dask.array.where(finite, array, -numpy.inf).max()])
        )
        heights = (float(low), float(high))
        axes: tuple[int, ...] = (1, -1, 0)
        turned = False
        nx, nz, up = array.shape[1], array.shape[0], 1
    else:
        if words.get("iso") is None and dtype.itemsize > 1:
            raise ValueError(f"an array of {dtype}; give iso=, voxels of at least that are solid")
        # The array's axes of world x, y, z; of z up, z runs against its axis.
        axes, turned = {"x": ((0, 2, 1), False), "z": ((2, 0, 1), True)}.get(str(words.get("up")), ((2, 1, 0), False))
        nx, up, nz = (array.shape[a] for a in axes)
    said = _words(words)
    (across, down), side = _planecast.tiles([nx, max(1, min(up, 65_536)), nz], None, [])
    tile = side * side * up * dtype.itemsize
    wide = max(1, min(across, AT_ONCE // tile))
    # Rows of tiles together, where one is much less than a task may hold.
    tall = max(1, min(down, AT_ONCE // (tile * across))) if wide == across else 1
    how = dict(shape=list(array.shape), chunk=_arrays.sides(array), dtype=dtype.str, heights=heights, words=said)
    tasks = []
    for row in range(0, down, tall):
        for column in range(0, across, wide):
            last_row, last = min(down, row + tall), min(across, column + wide)
            tiles = (row * across + column, (last_row - 1) * across + last)
            # One column around, which tells what is exposed at the edges.
            x = (max(0, column * side - 1), min(nx, last * side + 1))
            z = (max(0, row * side - 1), min(nz, last_row * side + 1))
            region = [(0, n) for n in array.shape]
            region[axes[0]] = x
            region[axes[2]] = (nz - z[1], nz - z[0]) if turned else z
            part = array[tuple(slice(a, b) for a, b in region)]
            name = f"{folder}/{tiles[0]}-{tiles[1]}.part"
            task = dask.delayed(_part_of_array, pure=False)(part, [a for a, _ in region], how, tiles, region, name)
            tasks.append(client.compute(task, retries=RETRIES))
    return tasks


@functools.lru_cache(maxsize=2)
def _opened(scene: str, stamp: float) -> planecast.World:
    """A scene, kept by a worker for its next task."""
    return planecast.open(scene)


def _world(scene: str) -> planecast.World:
    return _opened(scene, 0.0 if "://" in scene else os.path.getmtime(scene))


def _part_of_film(scene: str, words: dict[str, Any], path: Any, frames: range, n: int, part: str) -> str:
    if not os.path.exists(part):
        attempt = _attempt(part)
        _world(scene).fly(attempt, path=path, **{**words, "frames": (frames, n)})
        os.replace(attempt, part)
    return part


def fly(
    scene: str | os.PathLike,
    output: str | os.PathLike,
    client: Any,
    *,
    path: Any = None,
    jobs: int | None = None,
    parts: str | os.PathLike | None = None,
    **words: Any,
) -> int:
    """A film (.mp4) of a scene's file by ranges of frames, on the cluster of `client`; of how many frames. `words` are those of
    `World.fly`, `jobs` how many tasks [default: four a worker]."""
    scene, output = os.fspath(scene), os.path.abspath(output)
    scene = scene if "://" in scene else os.path.abspath(scene)
    folder = os.path.abspath(parts) if parts is not None else output + ".jobs"
    text = None if path is None else planecast.json.dumps(list(path))
    of_flight = {name: value for name, value in words.items() if name in ("frames", "fps", "size", "fov")}
    cameras, segment = planecast.open(scene)._inner.cameras(_words(of_flight), text)
    n = len(cameras)
    # Cut where segments begin, so that the film has no key frame more than one made at once.
    segments = -(-n // segment)
    jobs = max(1, min(jobs or 4 * _workers(client), segments))
    cuts = [min(n, segments * i // jobs * segment) for i in range(jobs + 1)]
    os.makedirs(folder, exist_ok=True)
    tasks = [
        client.submit(_part_of_film, scene, words, path, range(a, b), n, f"{folder}/{a}-{b}.mp4", retries=RETRIES, pure=False)
        for a, b in zip(cuts, cuts[1:])
    ]
    done = client.gather(tasks)
    if len(done) == 1:
        # All of it is no part.
        os.replace(done[0], output)
        frames = n
    else:
        frames = planecast.join(done, output)
    if parts is None:
        shutil.rmtree(folder)
    return frames


def _some_pictures(scene: str, poses: list[Any], words: dict[str, Any]) -> list[planecast.Image]:
    return list(_world(scene).render_many(poses, **words))


def render_many(
    scene: str | os.PathLike,
    poses: Iterable[Mapping[str, Any] | planecast.Camera],
    client: Any,
    *,
    at_once: int = 64,
    **words: Any,
) -> Iterator[planecast.Image]:
    """A picture of a scene's file for each pose, in order, drawn on the cluster of `client`, `at_once` of them a task."""
    name = os.fspath(scene)
    name = name if "://" in name else os.path.abspath(name)
    poses = list(poses)
    tasks = [
        client.submit(_some_pictures, name, poses[i : i + at_once], words, retries=RETRIES, pure=False)
        for i in range(0, len(poses), at_once)
    ]
    for task in tasks:
        yield from task.result()
        task.release()
