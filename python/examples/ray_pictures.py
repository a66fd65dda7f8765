"""Many pictures of a scene on a Ray cluster: ray_pictures.py SCENE.pcast; needs ray, and the scene where all workers see it."""

import sys

import planecast
import ray


@ray.remote
class Draws:
    """One a node or GPU; it keeps the scene open."""

    def __init__(self, scene: str) -> None:
        self.world = planecast.open(scene)

    def some(self, cameras: list) -> list:
        return [image.rgb for image in self.world.render_many(cameras)]


ray.init()
cameras = planecast.open(sys.argv[1]).flight(frames=240, size=(320, 180))
parts = [cameras[i : i + 20] for i in range(0, len(cameras), 20)]
workers = [Draws.remote(sys.argv[1]) for _ in range(max(1, int(ray.cluster_resources()["CPU"]) // 4))]
print(sum(len(p) for p in ray.util.ActorPool(workers).map(lambda worker, part: worker.some.remote(part), parts)), "pictures")
