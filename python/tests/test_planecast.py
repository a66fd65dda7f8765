"""What the package promises, checked against plain numpy."""

import doctest
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import planecast
import pytest

RNG = np.random.default_rng(7)
CPU = dict(device="cpu", size=(96, 64))


def ball(n=24, dtype="u1"):
    z, y, x = np.mgrid[0:n, 0:n, 0:n] - (n - 1) / 2
    return ((x * x + y * y + z * z) < (n / 2.5) ** 2).astype(dtype)


def occupancy(world):
    """(nz, ny, nx) of a world, by its own answers."""
    nx, ny, nz = world.shape
    z, y, x = np.mgrid[0:nz, 0:ny, 0:nx]
    return world.query(np.stack([x, y, z], -1))[0]


def test_docs_say_what_happens():
    assert doctest.testmod(planecast).failed == 0


def test_volumes_of_every_type_and_order_are_the_same_world():
    volume = RNG.random((5, 6, 7)) < 0.4
    for dtype in ("?", "u1", "i1", "<u2", ">i2", "<u4", ">i4", "<i8", ">u8", "<f2", "<f4", ">f8"):
        for order in (np.ascontiguousarray, np.asfortranarray, lambda a: np.repeat(a, 2, 1)[:, ::2], lambda a: a[::-1][::-1]):
            world = planecast.encode(order(volume.astype(dtype)), iso=0.5)
            assert world.shape == (7, 6, 5)
            assert (occupancy(world) == volume).all(), (dtype, order)
    assert (occupancy(planecast.encode(volume[:, ::-1], iso=0.5)) == volume[:, ::-1]).all()
    # z up: input (x, y, z) is world (x, z, Y-1-y).
    assert (occupancy(planecast.encode(volume, iso=0.5, up="z")) == volume[:, ::-1].transpose(1, 0, 2)).all()


def test_height_maps_are_columns():
    heights = RNG.integers(1, 40, (9, 11)).astype("u1")
    world = planecast.encode(heights, height_scale=1)
    # A column of value v is solid for 0 <= y <= v.
    assert (world.heights() == heights.astype(int) + 1).all()
    assert (planecast.encode(np.asfortranarray(heights.astype("f4")), height_scale=2).heights() == 2 * heights.astype(int) + 1).all()


def test_a_picture_has_the_arrays_it_says():
    world = planecast.encode(ball())
    image = world.render(voxel=True, **CPU)
    assert image.rgba.shape == (64, 96, 4) and image.rgba.dtype == np.uint8
    assert image.rgb.base is not None and np.shares_memory(image.rgb, image.rgba)
    assert image.depth.shape == (64, 96) and image.depth.dtype == np.float32
    seen = np.isfinite(image.depth)
    assert 0.2 < seen.mean() < 0.9
    assert (image.voxel[~seen] == -1).all()
    solid, _ = world.query(image.voxel[seen][image.voxel[seen][:, 3] == 0][:, :3])
    assert solid.all()
    exact = world.render(voxel=True, **{**CPU, "device": "exact"})
    assert (exact.voxel == image.voxel).all(-1).mean() > 0.995
    again = world.render(**image.camera.words(), device="cpu")
    assert (again.rgba == image.rgba).all()
    assert image.stats["cpu_ms"]["total"] > 0


def test_render_many_and_fly_draw_what_render_draws(tmp_path):
    world = planecast.encode(ball())
    cameras = world.flight(frames=4, size=(64, 48))
    many = list(world.render_many(cameras, device="cpu"))
    for camera, image in zip(cameras, many):
        assert image.camera == camera
        assert (image.rgba == world.render(**camera.words(), device="cpu").rgba).all()
    flown = list(world.fly(frames=4, size=(64, 48), device="cpu"))
    assert all((a.rgba == b.rgba).all() for a, b in zip(many, flown))
    assert world.fly(tmp_path / "film.mp4", frames=4, size=(64, 48), device="cpu") == 4
    assert (tmp_path / "film.mp4").stat().st_size > 500
    path = [dict(t=0, eye=(0, 9, 60), yaw=0, pitch=0), dict(t=1, eye=(0, 9, 50), yaw=0, pitch=0)]
    assert [c.eye[2] for c in world.flight(path=path, frames=2)] == [60, 50]
    assert len(world.flight(path=path, fps=10)) == 10


def test_rays_find_what_is_there():
    world = planecast.encode(ball())
    distance, voxel = world.pick([12.0, 12.0, 60.0], [[0, 0, -1], [0, 0, 1], [0, 0, -5]])
    assert distance[1] == np.inf and (voxel[1] == -1).all()
    near = np.flatnonzero(ball()[:, 12, 12]).max()
    assert distance[0] == distance[2] == 60 - (near + 1)
    assert tuple(voxel[0]) == (12, 12, near)


def test_a_scene_kept_in_a_file_is_the_world_it_was(tmp_path):
    file = tmp_path / "ball.pcast"
    made = planecast.encode(ball(), file, color="none")
    assert (occupancy(planecast.open(file)) == occupancy(made)).all()
    info = planecast.info(file)
    assert info["dims"] == [24, 24, 24] and info["solid_voxels"] == int(ball().sum())
    np.save(tmp_path / "ball.npy", ball())
    planecast.encode(tmp_path / "ball.npy", tmp_path / "same.pcast", color="none")
    assert planecast.info(tmp_path / "same.pcast")["content_hash"] == info["content_hash"]
    assert (planecast.open("procedural:rocks?size=32").shape) == planecast.encode("procedural:rocks?size=32").shape


def test_xarray_keeps_coordinates():
    xarray = pytest.importorskip("xarray")
    heights = RNG.integers(1, 9, (4, 5)).astype("u1")
    map = xarray.DataArray(heights, dims=("y", "x"), coords={"y": [40.0, 30, 20, 10], "x": [100.0, 110, 120, 130, 140]})
    world = map.planecast.encode(height_scale=1)
    assert (world.heights() == heights + 1).all()
    x, y = world.coordinates([0.5, 2.5], [0.5, 3.0])
    assert (x == [100, 120]).all() and (y == [40, 15]).all()
    assert map.planecast.render(**CPU).rgb.shape == (64, 96, 3)


@pytest.mark.parametrize(
    "call, error, text",
    [
        (lambda: planecast.encode(np.zeros((3, 3), "c8")), ValueError, "expected integers, booleans or floats"),
        (lambda: planecast.encode(np.zeros(4)), ValueError, "expected three axes (z, y, x), or two"),
        (lambda: planecast.encode(np.zeros((2, 2, 2, 2))), ValueError, "expected three axes"),
        (lambda: planecast.encode(np.zeros((0, 3))), ValueError, "at least 1"),
        (lambda: planecast.encode(np.full((3, 3), np.nan)), ValueError, "no pixel of the height map has data"),
        (lambda: planecast.encode(np.ma.masked_all((3, 3))), ValueError, "masked"),
        (lambda: planecast.encode(ball(dtype="f4")), ValueError, "iso="),
        (lambda: planecast.encode(ball(), iso="red"), ValueError, "expected a number"),
        (lambda: planecast.encode(ball(), yso=1), ValueError, "yso="),
        (lambda: planecast.encode(ball()).render(pitch=120), ValueError, "pitch="),
        (lambda: planecast.encode(ball()).render(size=(0, 4)), ValueError, "size="),
        (lambda: planecast.encode(ball()).render(fov=True), ValueError, "fov="),
        (lambda: planecast.encode(ball()).query([[0.5, 0, 0]]), ValueError, "whole numbers"),
        (lambda: planecast.encode(ball()).pick([0, 0, 0], [0, 0, 0]), ValueError, "direction"),
        (lambda: planecast.open("/nowhere/none.pcast"), OSError, "none.pcast"),
        (lambda: planecast.encode(ball(), "/nowhere/none.pcast"), OSError, "none.pcast"),
    ],
)
def test_what_is_wrong_is_said_in_pythons_terms(call, error, text):
    with pytest.raises(error) as raised:
        call()
    assert text in str(raised.value)
    assert "--" not in str(raised.value)


def test_other_threads_run_while_a_world_is_made():
    counted = 0
    done = threading.Event()

    def count():
        nonlocal counted
        while not done.is_set():
            counted += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    planecast.encode("procedural:rocks?size=256")
    done.set()
    thread.join()
    assert counted > 5


def test_ctrl_c_stops_an_encode():
    program = "import planecast; print('begun', flush=True); planecast.encode('procedural:mixing?size=2048')"
    made = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert made.stdout.readline() == "begun\n"
    time.sleep(1)
    made.send_signal(signal.SIGINT)
    _, error = made.communicate(timeout=60)
    assert made.returncode != 0 and "KeyboardInterrupt" in error
