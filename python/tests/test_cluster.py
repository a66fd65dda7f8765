"""A Dask cluster of two processes here, one of which is killed in mid-job."""

import os
import signal
import threading
import time

import numpy as np
import planecast
import pytest

distributed = pytest.importorskip("distributed")
dask_array = pytest.importorskip("dask.array")

from planecast import cluster  # noqa: E402

from test_planecast import occupancy  # noqa: E402


@pytest.fixture(scope="module")
def client():
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as here, distributed.Client(here) as client:
        yield client


def slow(block):
    time.sleep(0.02)
    return block


def killing(client, folder, ending):
    """Kills one worker as soon as there is a part; says whether it did."""
    killed = threading.Event()
    address, pid = next(iter(client.run(os.getpid).items()))

    def watch():
        while not killed.is_set():
            parts = os.listdir(folder) if os.path.isdir(folder) else []
            if any(name.endswith(ending) for name in parts) and client.processing().get(address):
                os.kill(pid, signal.SIGKILL)
                killed.set()
            time.sleep(0.005)

    threading.Thread(target=watch, daemon=True).start()
    return killed


def test_a_dask_array_is_encoded_though_a_worker_dies(client, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "AT_ONCE", 1)
    rng = np.random.default_rng(5)
    volume = (rng.random((300, 9, 1700)) < 0.1).astype("u1")
    array = dask_array.from_array(volume, chunks=(64, 9, 128)).map_blocks(slow)
    killed = killing(client, tmp_path / "dask.pcast.parts", ".part")
    world = planecast.encode(array, tmp_path / "dask.pcast", client=client)
    assert killed.is_set(), "no worker was killed; the test shows nothing"
    assert (occupancy(world) == volume.astype(bool)).all()
    planecast.encode(volume, tmp_path / "once.pcast")
    assert planecast.info(tmp_path / "dask.pcast")["content_hash"] == planecast.info(tmp_path / "once.pcast")["content_hash"]
    assert not (tmp_path / "dask.pcast.parts").exists()


def test_every_way_up_and_maps_of_heights_are_as_at_once(client, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "AT_ONCE", 1 << 20)
    rng = np.random.default_rng(6)
    volume = rng.integers(0, 9, (20, 300, 290)).astype("i2")
    array = dask_array.from_array(volume, chunks=(20, 100, 100))
    for up in ("x", "y", "z"):
        found, wanted = planecast.encode(array, client=client, iso=5, up=up), planecast.encode(volume, iso=5, up=up)
        assert (occupancy(found) == occupancy(wanted)).all(), up
    heights = rng.integers(-9, 90, (300, 520)).astype("f4")
    heights[7, 8] = np.nan
    map = dask_array.from_array(heights, chunks=(128, 128))
    assert (planecast.encode(map, client=client).heights() == planecast.encode(heights).heights()).all()
    with pytest.raises(ValueError, match="iso="):
        planecast.encode(array, client=client)
    with pytest.raises(ValueError, match="ramp="):
        planecast.encode(map, client=client, ramp="terrain")


def test_films_and_pictures_are_those_made_at_once(client, tmp_path):
    scene = tmp_path / "rocks.pcast"
    world = planecast.encode("procedural:rocks?size=64", scene, client=client)
    assert (occupancy(world) == occupancy(planecast.encode("procedural:rocks?size=64"))).all()
    how = dict(size=(64, 48), device="cpu")
    assert cluster.fly(scene, tmp_path / "parts.mp4", client, frames=144, jobs=3, **how) == 144
    world.fly(tmp_path / "once.mp4", frames=144, **how)
    assert (tmp_path / "parts.mp4").read_bytes() == (tmp_path / "once.mp4").read_bytes()
    poses = world.flight(frames=10, size=(40, 30))
    pictures = list(cluster.render_many(scene, poses, client, at_once=4, device="cpu"))
    assert len(pictures) == 10
    assert all((a.rgba == b.rgba).all() for a, b in zip(pictures, world.render_many(poses, device="cpu")))
