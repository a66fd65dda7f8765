"""What towers see of a terrain, as a map and a picture: viewshed.py."""

import numpy as np
import planecast

z, x = np.mgrid[0:400, 0:400]
ground = (30 + 22 * np.sin(x / 41) * np.cos(z / 33) + 9 * np.sin(x / 13 + z / 19)).astype("f4")
plain = planecast.encode(ground, height_scale=1)
towers = np.array([[60, 60], [200, 330], [350, 140]]) + 0.5
eyes = np.stack([towers[:, 0], plain.heights(towers[:, 0], towers[:, 1]) + 15.0, towers[:, 1]], 1)
seen = plain.viewshed(eyes)
print([f"{(seen == n).mean():.1%} seen by {n}" for n in range(4)])
shades = np.array([[70, 70, 80], [120, 160, 90], [220, 190, 80], [250, 250, 250]], "u1")
world = planecast.encode(ground, height_scale=1, colors=shades[seen])
world.render(size=(640, 400), orbit=(25, -50)).save("viewshed.png")
np.save("viewshed.npy", seen)
