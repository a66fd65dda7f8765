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
    done = doctest.testmod(planecast)
    assert done.failed == 0 and done.attempted > 15


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


def test_heights_are_asked_for_in_arrays():
    heights = RNG.integers(1, 40, (9, 11)).astype("u1")
    world = planecast.encode(heights, height_scale=1)
    x, z = np.meshgrid(np.arange(11), np.arange(9))
    assert (world.heights(x, z) == world.heights()).all()
    assert world.heights([0.9, -1, 11], 2.5).tolist() == [heights[2, 0] + 1, 0, 0]
    with pytest.raises(ValueError, match="both"):
        world.heights(x=1)


def test_what_is_seen_is_what_lines_of_sight_reach():
    heights = RNG.integers(1, 12, (24, 20)).astype("u1")
    world = planecast.encode(heights, height_scale=1)
    eyes = np.array([[4.5, 30.0, 3.5], [12.5, 16.0, 20.5]])
    each = world.viewshed(eyes, each=True)
    assert each.shape == (2, 24, 20) and each.dtype == bool
    assert (world.viewshed(eyes) == each.sum(0)).all()
    assert world.viewshed(eyes[0]).dtype == np.uint16
    # Where a ray at the middle of a column's top meets that column, it is seen.
    z, x = np.mgrid[0:24, 0:20] + 0.5
    tops = np.stack([x, world.heights() - 0.01, z], -1)
    for eye, seen in zip(eyes, each):
        _, voxel = world.pick(eye, tops - eye)
        reached = (voxel[..., 0] == x - 0.5) & (voxel[..., 2] == z - 0.5)
        # Rays to the border miss slivers of a few columns in a thousand.
        assert reached.mean() > 0.3 and seen[reached].mean() > 0.99
    with pytest.raises(ValueError, match="x, y, z"):
        world.viewshed([1, 2])


def test_many_pictures_are_those_drawn_alone():
    world = planecast.encode(ball(), color="none")
    poses = [dict(eye=(12, 12, 40 + i), yaw=3 * i, pitch=-i) for i in range(7)] + [dict(orbit=(40, -20)), dict(eye=(0, 9, 50), yaw=0, pitch=0, size=(32, 32))]
    many = list(world.render_many(poses, device="cpu", size=(48, 32), voxel=True))
    assert len(many) == len(poses)
    for pose, image in zip(poses, many):
        alone = world.render(**{**dict(device="cpu", size=(48, 32)), **pose}, voxel=True)
        assert image.camera == alone.camera
        assert (image.rgba == alone.rgba).all() and (image.voxel == alone.voxel).all()
    assert many[-1].rgb.shape == (32, 32, 3)
    # Poses are taken as they are needed.
    endless = world.render_many((dict(eye=(12, 12, 40), yaw=i, pitch=0) for i in range(10**9)), device="cpu", size=(8, 8))
    assert next(endless).depth.shape == (8, 8)
    with pytest.raises(ValueError, match="pitch"):
        list(world.render_many([dict(eye=(1, 1, 1), yaw=0, pitch=99)], device="cpu"))


def test_films_are_made_in_parts(tmp_path):
    world = planecast.encode(ball())
    how = dict(size=(64, 48), device="cpu")
    world.fly(tmp_path / "whole.mp4", frames=96, **how)
    parts = [tmp_path / f"{a}.mp4" for a in (0, 48)]
    for part, a in zip(parts, (0, 48)):
        assert world.fly(part, frames=(range(a, a + 48), 96), **how) == 48
    assert planecast.join(parts, tmp_path / "joined.mp4") == 96
    with pytest.raises(ValueError, match="frames="):
        world.fly(tmp_path / "none.mp4", frames=(range(90, 120), 96), **how)


def test_pictures_become_files(tmp_path):
    image = planecast.encode(ball()).render(**CPU)
    image.save(tmp_path / "ball.png")
    from PIL import Image

    assert (np.asarray(Image.open(tmp_path / "ball.png")) == image.rgb).all()
    assert image._repr_png_()[:4] == b"\x89PNG"
    open_sky = planecast.encode(ball()).render(sky="none", **CPU)
    open_sky.save(tmp_path / "sky.png")
    assert (np.asarray(Image.open(tmp_path / "sky.png"))[..., 3] == open_sky.rgba[..., 3]).all()
    with pytest.raises(OSError):
        image.save(tmp_path / "nowhere" / "ball.png")
    assert not list(tmp_path.glob("*.tmp"))


def test_a_report_is_made_of_a_world(tmp_path):
    world = planecast.encode(ball(16))
    chosen = world.report(tmp_path / "report", quick=True, size=(32, 24), rounds=1, device="cpu", max_error=0.9)
    assert (tmp_path / "report" / "report.html").stat().st_size > 1000 and chosen
    with pytest.raises(ValueError, match="size="):
        planecast.report("procedural:rocks?size=16", tmp_path / "none", size="red")


def test_a_world_is_kept(tmp_path):
    world = planecast.encode(ball(), color="none")
    world.save(tmp_path / "kept.pcast")
    assert (occupancy(planecast.open(tmp_path / "kept.pcast")) == occupancy(world)).all()
    with pytest.raises(OSError, match="nowhere"):
        world.save("/nowhere/kept.pcast")


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
    x, y = world.coordinates([0.5, 2.5, 0, 5], [0.5, 3.0, 0, 4])
    assert (x == [100, 120, 95, 145]).all() and (y == [40, 15, 45, 5]).all()
    assert [v.tolist() for v in world.voxels([100, 120], [40, 10])] == [[0.5, 2.5], [0.5, 3.5]]
    assert map.planecast.render(**CPU).rgb.shape == (64, 96, 3)


def test_pixels_and_picks_have_coordinates():
    xarray = pytest.importorskip("xarray")
    z, x = np.mgrid[0:40, 0:60]
    values = (100 + 8 * np.sin(x / 9) + 5 * np.cos(z / 7)).astype("f4")
    map = xarray.DataArray(
        values, dims=("y", "x"), name="elevation", attrs={"units": "m"},
        coords={"y": 5000.0 - 10 * np.arange(40), "x": ("x", 3000.0 + 10 * np.arange(60), {"units": "m"})},
    )  # fmt: skip
    image = map.planecast.render(size=(80, 60), orbit=(20, -40), device="cpu")
    seen = image.to_xarray()
    assert seen.rgb.shape == (60, 80, 3) and seen.elevation.attrs["units"] == "m" and seen.x.attrs["units"] == "m"
    ground = np.isfinite(image.depth)
    assert ground.mean() > 0.1 and (np.isfinite(seen.x.values) == ground).all()
    there = map.sel(x=xarray.DataArray(seen.x.values[ground]), y=xarray.DataArray(seen.y.values[ground]), method="nearest").values
    # What is seen of a column is no higher than its top; one voxel is ten metres.
    assert (seen.elevation.values[ground] <= there + 5.01).all() and np.median(there - seen.elevation.values[ground]) < 10
    # Turned about: rows that run to the north, columns to the west, axes the other way.
    for other in (map[::-1], map[:, ::-1], map.T, map[::-1, ::-1].T):
        again = other.planecast.render(size=(80, 60), orbit=(20, -40), device="cpu")
        assert (again.rgba == image.rgba).all()
        assert (again.to_xarray().y.values[ground] == seen.y.values[ground]).all()
    picked = map.planecast.pick([[15.5, 90, 20.5], [0, 90, -9]], [0, -1, 0])
    assert picked.x.values[0] == 3150 and picked.y.values[0] == 4800 and np.isnan(picked.x.values[1])
    assert abs(picked.elevation.values[0] - values[20, 15]) <= 5.01 and picked.distance.values[1] == np.inf
    for of in (map, map[::-1, ::-1].T):
        shed = of.planecast.viewshed([3150.0, 3300.0], [4800.0, 4700.0], height=3)
        assert shed.dims == of.dims and (shed.x == of.x).all() and (shed.y == of.y).all()
        assert shed.sel(x=3150, y=4800) == 2 or shed.sel(x=3150, y=4800) == 1
        assert 0 < (shed > 0).mean() <= 1
    volume = xarray.DataArray(ball(), dims=("z", "y", "x"), coords={k: 0.5 * np.arange(24) for k in "zyx"})
    ray = volume.planecast.pick([12.0, 12.0, 60.0], [0, 0, -1])
    assert float(ray.z) == 0.5 * np.flatnonzero(ball()[:, 12, 12]).max() and float(ray.x) == 6.0
    up = volume.planecast.pick([12.0, 60.0, 12.0], [0, -1, 0], read={"up": "z"})
    assert float(up.z) == float(ray.z)


def test_reference_systems_are_kept():
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("rioxarray")
    values = RNG.integers(100, 160, (6, 7)).astype("i2")
    values[2, 3] = -99
    map = xarray.DataArray(values, dims=("y", "x"), coords={"y": 60.0 - 30 * np.arange(6), "x": 500000 + 30.0 * np.arange(7)})
    map = map.rio.write_crs("EPSG:32633").rio.write_nodata(-99)
    world = map.planecast.encode()
    heights = world.heights()
    # A voxel is as high as a pixel is wide, 30 m; no data is no column.
    assert heights[2, 3] == 0 and (heights[0] == np.floor(values[0] / 30 + 0.5) + 1).all()
    assert map.planecast.viewshed(500090.0, 0.0).rio.crs == map.rio.crs
    assert "spatial_ref" in map.planecast.render(**CPU).to_xarray()


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
        (lambda: planecast.encode(np.array([["a"]])), ValueError, "expected integers, booleans or floats"),
        (lambda: planecast.encode(np.array([[None]])), ValueError, "expected integers, booleans or floats"),
        (lambda: planecast.encode(np.zeros((3, 3), "M8[s]")), ValueError, "expected integers, booleans or floats"),
        (lambda: planecast.encode(np.zeros((3, 3), np.longdouble)), ValueError, "expected integers, booleans or floats"),
        (lambda: planecast.encode(np.zeros((3, 3), [("a", "f4")])), ValueError, "expected integers, booleans or floats"),
        (lambda: planecast.encode(np.zeros((3, 3)), kind="volume"), ValueError, "three axes"),
        (lambda: planecast.encode(np.zeros((3, 3, 3)), kind="heights"), ValueError, "two axes"),
        (lambda: planecast.encode(ball(), kind="sphere"), ValueError, "expected one of"),
        (lambda: planecast.encode("procedural:rocks?size=16", kind="volume"), ValueError, "for arrays"),
        (lambda: planecast.encode(np.full((4, 4, 4), np.nan, "f4"), spacing="red", iso=1), ValueError, "spacing="),
        (lambda: planecast.encode(np.broadcast_to(np.uint8(1), (1, 70_000, 1))), MemoryError, "65536"),
        (lambda: planecast.encode(np.zeros((5, 4)), kind="points"), ValueError, "(N, 3)"),
        (lambda: planecast.encode(np.zeros((5, 3)), kind="points", colors=np.zeros((4, 3), "u1")), ValueError, "a colour per point"),
        (lambda: planecast.encode(np.zeros((5, 5)), colors=np.zeros((5, 5), "u1")), ValueError, "(rows, columns, 3)"),
        (lambda: planecast.encode(np.zeros((5, 5)), colors=np.zeros((5, 5, 3))), ValueError, "astype('u1')"),
        (lambda: planecast.encode(ball()).fly("film.xyz"), ValueError, "film.xyz"),
        (lambda: planecast.encode(ball()).coordinates(1, 1), ValueError, "xarray"),
        (lambda: planecast.encode(ball()).render(eye=(1, 2)), ValueError, "eye="),
        (lambda: planecast.encode(ball()).render(eye=(1, np.nan, 2), yaw=0, pitch=0), ValueError, "eye="),
        (lambda: planecast.merge([], "/tmp/none.pcast"), ValueError, "no parts"),
        (lambda: planecast.join([], "/tmp/none.mp4"), ValueError, "no parts"),
    ],
)
def test_what_is_wrong_is_said_in_pythons_terms(call, error, text):
    with pytest.raises(error) as raised:
        call()
    assert text in str(raised.value)
    assert "--" not in str(raised.value) and " -o " not in str(raised.value)


def test_nan_is_air_or_no_data():
    volume = RNG.random((5, 6, 7)).astype("f4")
    volume[1:3, 2:4] = np.nan
    with np.errstate(invalid="ignore"):
        assert (occupancy(planecast.encode(volume, iso=0.5)) == (volume >= 0.5)).all()
    heights = RNG.integers(1, 30, (6, 7)).astype("f4")
    heights[2, 3] = np.nan
    heights[4, 1] = np.inf
    found = planecast.encode(heights, height_scale=1).heights()
    known = np.isfinite(heights)
    assert (found[known] == heights[known].astype(int) + 1).all() and (found[~known] == 0).all()


def test_negative_strides_and_views_are_right():
    volume = (RNG.random((9, 12, 14)) < 0.4).astype("u1")
    for view in (volume[::-1], volume[:, ::-1], volume[..., ::-1], volume[::2, 1::3], volume.T, volume.transpose(1, 2, 0), np.asfortranarray(volume)[::-1]):
        assert (occupancy(planecast.encode(view)) == view.astype(bool)).all()
    heights = RNG.integers(1, 40, (9, 11)).astype("i2")
    for view in (heights[::-1], heights[:, ::-2], heights.T, np.broadcast_to(heights[0], (5, 11))):
        assert (planecast.encode(view, height_scale=1).heights() == view + 1).all()
    big = volume.astype(">u2")
    big.flags.writeable = False
    assert (occupancy(planecast.encode(big, iso=1)) == volume.astype(bool)).all()


def test_an_array_that_changes_under_way_gives_old_or_new_values():
    one, other = (RNG.random((2, 96, 64, 96)) < 0.5).astype("u1")
    array = one.copy()
    done = threading.Event()

    def change():
        while not done.is_set():
            for of in (other, one):
                array[:] = of

    thread = threading.Thread(target=change)
    thread.start()
    try:
        for up in ("y", "z"):
            solid = occupancy(planecast.encode(array, up=up))
            lying = (lambda a: a) if up == "y" else (lambda a: a[:, ::-1].transpose(1, 0, 2))
            assert not (solid & lying((one | other) == 0)).any() and solid[lying((one & other) == 1)].all()
    finally:
        done.set()
        thread.join()


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


WORK = {
    "encode": "planecast.encode('procedural:mixing?size=2048')",
    "pictures": "w = planecast.encode('procedural:rocks?size=64')\nfor i in w.render_many((dict(eye=(9, 99, 9), yaw=a, pitch=0) for a in range(10**9)), device='cpu'): pass",
    "film": "planecast.encode('procedural:rocks?size=64').fly('film.mp4', frames=100000, device='cpu')",
}


@pytest.mark.parametrize("work", WORK)
def test_ctrl_c_stops_work(work, tmp_path):
    program = f"import planecast; print('begun', flush=True)\n{WORK[work]}"
    made = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    assert made.stdout.readline() == "begun\n"
    time.sleep(1)
    made.send_signal(signal.SIGINT)
    _, error = made.communicate(timeout=60)
    assert made.returncode != 0 and "KeyboardInterrupt" in error
