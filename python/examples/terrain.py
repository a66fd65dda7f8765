"""A DEM to a picture and a film: terrain.py [DEM.tif] [--frames N]. Without a file, hills from numpy."""

import sys

import numpy as np
import planecast

frames = int(sys.argv[sys.argv.index("--frames") + 1]) if "--frames" in sys.argv else 48
files = [a for a in sys.argv[1:] if a.endswith((".tif", ".tiff", ".asc", ".hgt", ".png"))]
if files:
    world = planecast.open(files[0])
else:
    z, x = np.mgrid[0:512, 0:512] / 512
    heights = 40 * np.sin(9 * x) * np.cos(7 * z) + 25 * np.sin(31 * x + 5 * z) ** 2 + 60
    world = planecast.encode(heights.astype("f4"), height_scale=1, ramp="terrain")
image = world.render(size=(640, 360), sun=(315, 45))
image.save("terrain.png")
nearest = np.unravel_index(image.depth.argmin(), image.depth.shape)
print(f"{world}: terrain.png; nearest ground {image.depth[nearest]:.1f} voxels away, at pixel {nearest[::-1]}")
print(world.fly("terrain.mp4", frames=frames, size=(640, 360)), "frames in terrain.mp4")
