"""Depth maps from random places over a terrain, as one array for a data set: depth_maps.py [COUNT, 1000 unless said]."""

import sys

import numpy as np
import planecast

count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
world = planecast.encode("procedural:terrain?size=512")
rng = np.random.default_rng(1)
x, z = rng.integers(0, 512, (2, count)) + 0.5
y, yaw = world.heights(x, z) + 4.0, rng.uniform(0, 360, count)
poses = [dict(eye=eye, yaw=a, pitch=0) for eye, a in zip(np.stack([x, y, z], 1).tolist(), yaw.tolist())]
images = world.render_many(poses, size=(64, 64), shading="none", view_distance=400)
depth = np.stack([image.depth for image in images])
np.savez_compressed("depth_maps.npz", depth=depth, eye=np.stack([x, y, z], 1), yaw=yaw)
seen = np.isfinite(depth)
print(depth.shape, f"{seen.mean():.1%} of the pixels see ground, median {np.median(depth[seen]):.0f} voxels away: depth_maps.npz")
