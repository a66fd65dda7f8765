"""A flight in rerun: picture, depth and camera of each frame. rerun_log.py [FILE.rrd]; needs rerun-sdk."""

import sys

import numpy as np
import planecast
import rerun as rr

rr.init("planecast", spawn=len(sys.argv) < 2)
if len(sys.argv) > 1:
    rr.save(sys.argv[1])
rr.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
world = planecast.encode("procedural:terrain?size=256")
for i, image in enumerate(world.fly(frames=24, size=(320, 180))):
    camera = image.camera
    yaw, pitch, roll = np.deg2rad([camera.yaw, camera.pitch, camera.roll])
    forward = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), -np.cos(yaw) * np.cos(pitch)])
    right = np.array([np.cos(yaw), 0, np.sin(yaw)])
    up = np.cross(right, forward)
    right, up = right * np.cos(roll) - up * np.sin(roll), up * np.cos(roll) + right * np.sin(roll)
    width, height = camera.size
    focal = height / 2 / np.tan(np.deg2rad(camera.fov) / 2)
    rr.set_time("frame", sequence=i)
    rr.log("world/camera", rr.Transform3D(translation=camera.eye, mat3x3=np.stack([right, up, -forward], 1)))
    rr.log("world/camera", rr.Pinhole(focal_length=focal, width=width, height=height, camera_xyz=rr.ViewCoordinates.RUB))
    rr.log("world/camera/rgb", rr.Image(image.rgb))
    rr.log("world/camera/depth", rr.DepthImage(np.where(np.isfinite(image.depth), image.depth, 0), meter=1.0))
