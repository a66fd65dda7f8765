"""Two workers, one killed in mid-job: test_dask_fly.py PLANECAST SCENE OUTPUT FRAMES [options of fly]."""

import os
import signal
import sys
import threading
import time

from dask.distributed import Client, LocalCluster

import dask_fly


def main():
    planecast, scene, output, frames, *options = sys.argv[1:]
    scene, output = os.path.abspath(scene), os.path.abspath(output)
    parts = output + ".jobs"
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        first = next(iter(cluster.workers.values()))
        pid = client.run(os.getpid, workers=[first.worker_address])[first.worker_address]
        killed = threading.Event()

        def kill():
            # Once it is at work: an attempt of a part has saved a segment.
            while not killed.is_set():
                names = os.listdir(parts) if os.path.isdir(parts) else []
                begun = [n for n in names if n.endswith(".parts") and "000" in "".join(os.listdir(f"{parts}/{n}"))]
                if begun and client.processing().get(first.worker_address):
                    os.kill(pid, signal.SIGKILL)
                    killed.set()
                time.sleep(0.01)

        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        dask_fly.fly(client, planecast, scene, output, 6, int(frames), options, parts)
        if not killed.is_set():
            sys.exit("no worker was killed; the test shows nothing")


if __name__ == "__main__":
    main()
