"""A thousand depth maps from random places over a terrain, as one array, for a data set."""

import numpy as np
import planecast

world = planecast.encode("procedural:terrain?size=512")
tops, rng = world.heights(), np.random.default_rng(1)
places = rng.integers(0, 512, (1000, 2))
poses = [dict(eye=(x + 0.5, tops[z, x] + 4.0, z + 0.5), yaw=yaw) for (x, z), yaw in zip(places.tolist(), rng.uniform(0, 360, 1000).tolist())]
images = world.render_many(poses, size=(64, 64), shading="none", view_distance=400)
depth = np.stack([image.depth for image in images])
print(depth.shape, f"{np.isfinite(depth).mean():.1%} of the pixels see ground, median {np.median(depth[np.isfinite(depth)]):.0f} voxels away")
