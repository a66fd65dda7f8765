"""Arrays that are read block by block, clouds, labels, colours."""

import subprocess
import sys

import numpy as np
import planecast
import pytest

from test_planecast import occupancy

RNG = np.random.default_rng(3)


def lazies(array, chunks):
    """The same array in every kind that is read by blocks, by name."""
    out = {}
    try:
        import zarr

        out["zarr"] = zarr.create_array({}, shape=array.shape, chunks=chunks, dtype=array.dtype)
        out["zarr"][:] = array
        sharded = tuple(2 * c for c in chunks)
        out["sharded"] = zarr.create_array({}, shape=array.shape, chunks=chunks, shards=sharded, dtype=array.dtype)
        out["sharded"][:] = array
        out["zarr 2"] = zarr.create_array({}, shape=array.shape, chunks=chunks, dtype=array.dtype, zarr_format=2)
        out["zarr 2"][:] = array
    except ImportError:
        pass
    try:
        import dask.array

        out["dask"] = dask.array.from_array(array, chunks=chunks)
    except ImportError:
        pass
    assert out, "neither zarr nor dask is installed"
    return out


def test_volumes_by_blocks_are_the_volumes_at_once():
    for dtype in ("u1", "?", "<i2", ">f4", "<f2"):
        volume = (RNG.random((40, 21, 37)) * 2).astype(dtype)
        volume[10:30, :, 5:20] = 0
        for name, lazy in lazies(volume, (16, 8, 13)).items():
            for how in (dict(iso=1), dict(iso=1, up="z"), dict(iso=1, up="x")):
                found, wanted = planecast.encode(lazy, **how), planecast.encode(volume, **how)
                assert found.shape == wanted.shape
                assert (occupancy(found) == occupancy(wanted)).all(), (name, dtype, how)


def test_what_needs_all_values_gets_them():
    volume = (np.add.outer(np.add.outer(np.arange(20), np.arange(12)), np.arange(16)) * 3).astype("i2")
    for name, lazy in lazies(volume, (8, 8, 8)).items():
        with pytest.raises(ValueError, match="values range from 0 to 135; give iso="):
            planecast.encode(lazy)
        how = dict(iso=60, ramp="viridis")
        found, wanted = planecast.encode(lazy, **how), planecast.encode(volume, **how)
        places = np.stack(np.meshgrid(*map(np.arange, found.shape), indexing="ij"), -1)
        assert all((a == b).all() for a, b in zip(found.query(places), wanted.query(places))), name
        assert planecast.encode(lazy, iso=60, spacing=(1, 2, 1)).shape == (16, 24, 20)


def test_maps_by_blocks_are_the_maps_at_once():
    heights = RNG.integers(-20, 60, (70, 45)).astype("f4")
    heights[3, 4] = np.nan
    colors = RNG.integers(0, 255, (70, 45, 3)).astype("u1")
    for name, lazy in lazies(heights, (16, 32)).items():
        for how in (dict(), dict(height_scale=0.5), dict(ramp="terrain"), dict(nodata=7.0)):
            found, wanted = planecast.encode(lazy, **how), planecast.encode(heights, **how)
            assert (found.heights() == wanted.heights()).all(), (name, how)
        found = planecast.encode(lazy, height_scale=1, colors=colors)
        tops = found.heights()
        z, x = np.nonzero(tops)
        solid, color = found.query(np.stack([x, tops[z, x] - 1, z], -1))
        assert solid.all() and (color == colors[z, x]).all()
    lazy = lazies(colors, (16, 32, 3)).popitem()[1]
    assert (planecast.encode(heights, colors=lazy).query([[5, 0, 9]])[1] == colors[9, 5]).all()


def test_labels_have_a_colour_each():
    labels = np.zeros((12, 10, 14), "u2")
    labels[2:6], labels[7:10, 3:] = 5, 900
    for of in [labels, *lazies(labels, (8, 8, 8)).values()]:
        world = planecast.encode(of, kind="labels")
        assert (occupancy(world) == (labels != 0)).all()
        _, color = world.query([[0, 0, 2], [5, 0, 2], [0, 3, 7], [5, 9, 9]])
        assert (color[0] == color[1]).all() and (color[2] == color[3]).all() and (color[0] != color[2]).any()


def test_points_are_clouds():
    points = RNG.integers(0, 40, (500, 3)).astype("f8") + 0.5
    colors = RNG.integers(1, 255, (500, 3)).astype("u1")
    world = planecast.encode(points, kind="points", voxel=1, colors=colors)
    assert occupancy(world).sum() == len(np.unique(points, axis=0))
    for name, lazy in lazies(points, (128, 3)).items():
        again = planecast.encode(lazy, kind="points", voxel=1, colors=colors)
        assert (occupancy(again) == occupancy(world)).all(), name
    # One point, one colour.
    one = planecast.encode(np.array([[3.5, 4.5, 5.5], [9.5, 9.5, 9.5]], "f4"), kind="points", voxel=1, colors=colors[:2])
    z, y, x = np.argwhere(occupancy(one))[0]
    assert (one.query([[x, y, z]])[1] == colors[0]).all()


def test_what_an_array_raises_is_raised():
    class Broken:
        shape, chunks, dtype = (64, 64, 64), (16, 16, 16), np.dtype("u1")

        def __getitem__(self, _):
            raise KeyError("the store is gone")

    with pytest.raises(KeyError, match="the store is gone"):
        planecast.encode(Broken())

    class Short(Broken):
        def __getitem__(self, _):
            return np.zeros((2, 2, 2), "u1")

    with pytest.raises(ValueError, match="8 bytes of values"):
        planecast.encode(Short())


def test_lazy_xarrays_keep_their_coordinates(tmp_path):
    xarray, dask = pytest.importorskip("xarray"), pytest.importorskip("dask.array")
    pytest.importorskip("zarr")
    volume = (RNG.random((20, 12, 16)) < 0.3).astype("u1")
    coords = {"z": 2.0 * np.arange(20), "y": np.arange(12.0), "x": 5 + np.arange(16.0)}
    for data in (volume, dask.from_array(volume, chunks=8)):
        of = xarray.DataArray(data, dims=("z", "y", "x"), coords=coords)
        world = of.planecast.encode()
        assert (occupancy(world) == volume.astype(bool)).all()
        assert [v.tolist() for v in world.coordinates([0.5], [3.5])] == [[5.0], [6.0]]
    of.to_dataset(name="v").to_zarr(tmp_path / "v.zarr", zarr_format=2)
    for chunks in (None, {}):
        opened = xarray.open_zarr(tmp_path / "v.zarr", chunks=chunks)["v"]
        assert (occupancy(planecast.encode(opened, iso=1)) == volume.astype(bool)).all()


SPARSE = """
import resource, sys, time, numpy, zarr, planecast
shape, at = eval(sys.argv[2]), eval(sys.argv[3])
array = zarr.create_array(sys.argv[1], shape=shape, chunks=(64, 128, 64), dtype="u1", fill_value=0)
array[tuple(slice(a, a + 100) for a in at)] = 1
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
begun = time.time()
world = planecast.encode(zarr.open_array(sys.argv[1]), memory="256M")
image = world.render(size=(320, 240), device="cpu")
took = time.time() - begun
assert numpy.isfinite(image.depth).any()
z, y, x = at
inside, outside = world.query([[x, y, z], [x + 99, y + 99, z + 99]])[0], world.query([[x - 1, y, z], [x, y + 100, z]])[0]
assert inside.all() and not outside.any()
image.save(sys.argv[1] + ".png")
print(array.nbytes, took, before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def test_a_sparse_zarr_array_of_245_gb_is_drawn(tmp_path):
    pytest.importorskip("zarr")
    # Few columns, which are high: what is read does not depend on it.
    arguments = [str(tmp_path / "sparse.zarr"), "(1024, 65536, 3656)", "(300, 41000, 1700)"]
    made = subprocess.run([sys.executable, "-c", SPARSE, *arguments], capture_output=True, text=True, timeout=170)
    assert made.returncode == 0, made.stderr
    size, took, before, peak = map(float, made.stdout.split())
    assert size > 245e9 and peak - before < 1_500_000, made.stdout
    print(f"{size / 1e9:.0f} GB: first picture after {took:.1f} s, {(peak - before) / 1024:.0f} MiB of memory")


def test_memory_is_bounded_whatever_the_array(tmp_path):
    dask = pytest.importorskip("dask.array")
    program = """
import resource, dask.array, numpy, planecast
dask.config.set(scheduler="synchronous")
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
made = dask.array.ones((512, 512, 1024), chunks=(64, 512, 64), dtype="u1")
world = planecast.encode(made, memory="64M")
assert world.shape == (1024, 512, 512) and world.heights().min() == 512
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    made = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=170)
    assert made.returncode == 0, made.stderr
    # 256 MiB of values.
    assert int(made.stdout) < 200_000, made.stdout
