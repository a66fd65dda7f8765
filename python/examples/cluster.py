"""A Dask array encoded, filmed and pictured on a Dask cluster: cluster.py [ADDRESS of a scheduler]; without one, on two workers
here. Array, parts and scene must be where all workers see them."""

import sys

import dask.array
import planecast
import planecast.cluster
from dask.distributed import Client, LocalCluster


def main() -> None:
    here = None if len(sys.argv) > 1 else LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with Client(sys.argv[1] if here is None else here) as client:
        z, y, x = (dask.array.arange(n, chunks=64) for n in (192, 64, 256))
        volume = ((x - 128) ** 2 / 4 + (y[:, None] - 20) ** 2 * 3 + (z[:, None, None] - 96) ** 2 < 2500).astype("u1")
        world = planecast.encode(volume, "cluster.pcast", client=client)
        print(world, planecast.info("cluster.pcast")["solid_voxels"], "solid voxels")
        print(planecast.cluster.fly("cluster.pcast", "cluster.mp4", client, frames=24, size=(320, 180)), "frames in cluster.mp4")
        poses = [dict(eye=(128, 40, 300), yaw=a, pitch=-5) for a in range(-20, 21, 5)]
        images = planecast.cluster.render_many("cluster.pcast", poses, client, size=(160, 90))
        print(sum(1 for _ in images), "pictures")
    if here is not None:
        here.close()


if __name__ == "__main__":
    main()
