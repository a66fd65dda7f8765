#!/usr/bin/env python3
"""Makes a film on a Dask cluster: each task runs `planecast fly --frames A..B`, the last joins the parts.

    dask_fly.py SCENE.pcast -o FILM.mp4 [--scheduler tcp://host:8786 | --workers N] [--jobs N] [--frames N] [-- options of fly]

A task whose worker dies is run again by Dask elsewhere. Each attempt writes a file of its own, which takes the part's name
when it is whole. SCENE and parts must be where all workers see them. The film has the bytes that one `fly` makes.
"""

import argparse
import json
import os
import shutil
import sys
import uuid

from dask_encode import call


def fly_part(planecast, scene, options, start, end, frames, part):
    """Makes one part, unless it is there already; returns its name."""
    if not os.path.exists(part):
        attempt = f"{part[:-4]}.{uuid.uuid4().hex}.mp4"
        call([planecast, "fly", scene, "--frames", f"{start}..{end}/{frames}", "-o", attempt, *options])
        os.replace(attempt, part)
    return part


def fly(client, planecast, scene, output, jobs, frames, options, parts_dir):
    """Makes `output` of `scene` with about `jobs` tasks on the cluster of `client`."""
    whole = ["--frames", str(frames)] if frames else []
    plan = json.loads(call([planecast, "fly", scene, "-o", output, *whole, *options, "--plan"]))
    frames, segment = plan["frames"], plan["segment"]
    # Cut where segments begin, so that the film has no key frame more than one made at once.
    segments = -(-frames // segment)
    jobs = max(1, min(jobs, segments))
    os.makedirs(parts_dir, exist_ok=True)
    cuts = [min(frames, segments * i // jobs * segment) for i in range(jobs + 1)]
    parts = [f"{parts_dir}/{a}-{b}.mp4" for a, b in zip(cuts, cuts[1:])]
    tasks = [
        client.submit(fly_part, planecast, scene, options, a, b, frames, part, retries=3, pure=False)
        for a, b, part in zip(cuts, cuts[1:], parts)
    ]
    client.gather(tasks)
    call([planecast, "join", *parts, "-o", output])
    shutil.rmtree(parts_dir)


def main():
    argv = sys.argv[1:]
    cut = argv.index("--") if "--" in argv else len(argv)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("-o", "--output", required=True, help="film to write (.mp4)")
    parser.add_argument("--scheduler", help="address of a Dask scheduler [default: workers on this machine]")
    parser.add_argument("--workers", type=int, default=2, help="workers on this machine [default: %(default)s]")
    parser.add_argument("--jobs", type=int, help="tasks [default: four a worker]")
    parser.add_argument("--frames", type=int, help="frames of the film [default: as many as its time takes]")
    parser.add_argument("--parts", help="folder for parts that all machines see [default: OUTPUT.jobs]")
    parser.add_argument("--planecast", default="planecast", help="the command [default: %(default)s]")
    args = parser.parse_args(argv[:cut])

    from dask.distributed import Client, LocalCluster

    cluster = args.scheduler or LocalCluster(n_workers=args.workers, threads_per_worker=1, dashboard_address=None)
    with Client(cluster) as client:
        jobs = args.jobs or 4 * max(1, len(client.scheduler_info()["workers"]))
        scene, output = os.path.abspath(args.scene), os.path.abspath(args.output)
        parts = os.path.abspath(args.parts or args.output + ".jobs")
        fly(client, args.planecast, scene, output, jobs, args.frames, argv[cut + 1 :], parts)


if __name__ == "__main__":
    main()
