"""How much of a volume stays solid, and what is seen of it, as a threshold rises."""

import numpy as np
import planecast

z, y, x = np.mgrid[-1:1:96j, -1:1:96j, -1:1:96j]
volume = (1000 * np.exp(-3 * (x * x + y * y + z * z)) * (1 + 0.3 * np.sin(14 * x) * np.sin(14 * y))).astype("i2")
for iso in (100, 300, 600):
    world = planecast.encode(volume, iso=iso)
    image = world.render(size=(160, 120))
    print(f"from {iso}: {(volume >= iso).mean():6.2%} of voxels, {np.isfinite(image.depth).mean():6.2%} of the picture")
