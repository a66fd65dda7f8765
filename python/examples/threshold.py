"""How much of a CT stays solid, and what is seen of it, as the threshold rises: threshold.py [VOLUME.npy]."""

import sys

import numpy as np
import planecast

if len(sys.argv) > 1:
    volume = np.load(sys.argv[1], mmap_mode="r")
else:
    z, y, x = np.mgrid[-1:1:96j, -1:1:96j, -1:1:96j]
    volume = (1000 * np.exp(-3 * (x * x + y * y + z * z)) * (1 + 0.3 * np.sin(14 * x) * np.sin(14 * y))).astype("i2")
low, high = float(volume.min()), float(volume.max())
for i, iso in enumerate(np.linspace(low, high, 7)[1:-1]):
    world = planecast.encode(volume, iso=iso)
    image = world.render(size=(320, 240), orbit=(30, -20))
    image.save(f"threshold-{i}.png")
    print(f"from {iso:.0f}: {(volume >= iso).mean():6.2%} of voxels, {np.isfinite(image.depth).mean():6.2%} of the picture")
