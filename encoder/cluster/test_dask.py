"""Two workers, one killed in mid-job: test_dask.py PLANECAST INPUT OUTPUT."""

import os
import signal
import sys
import threading
import time

from dask.distributed import Client, LocalCluster

import dask_encode


def main():
    planecast, source, output = sys.argv[1:]
    output = os.path.abspath(output)
    parts = output + ".parts"
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        first = next(iter(cluster.workers.values()))
        pid = client.run(os.getpid, workers=[first.worker_address])[first.worker_address]
        killed = threading.Event()

        def kill():
            # Once it is at work: an attempt of a part is there.
            while not killed.is_set():
                names = os.listdir(parts) if os.path.isdir(parts) else []
                if any(name.endswith(".unfinished") for name in names) and client.processing().get(first.worker_address):
                    os.kill(pid, signal.SIGKILL)
                    killed.set()
                time.sleep(0.01)

        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        dask_encode.encode(client, planecast, source, output, 12, ["--encoding", "surface"], parts)
        if not killed.is_set():
            sys.exit("no worker was killed; the test shows nothing")


if __name__ == "__main__":
    main()
