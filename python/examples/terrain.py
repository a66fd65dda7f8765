"""A map of heights from numpy: a picture and a short film."""

import numpy as np
import planecast

z, x = np.mgrid[0:512, 0:512] / 512
heights = 40 * np.sin(9 * x) * np.cos(7 * z) + 25 * np.sin(31 * x + 5 * z) ** 2 + 60
world = planecast.encode(heights.astype("f4"), height_scale=1, ramp="terrain")
image = world.render(size=(640, 360), sun=(315, 45))
nearest = np.unravel_index(image.depth.argmin(), image.depth.shape)
print(f"{world}: nearest ground {image.depth[nearest]:.1f} voxels away, at pixel {nearest[::-1]}")
print(world.fly("terrain.mp4", frames=48, size=(640, 360)), "frames in terrain.mp4")
