#!/usr/bin/env python3
"""Encodes a scene on a Dask cluster: each task runs `planecast encode --tiles A..B`, the last joins the parts.

    dask_encode.py INPUT -o SCENE.pcast [--scheduler tcp://host:8786 | --workers N] [--jobs N] [-- options of encode]

A task whose worker dies is run again by Dask elsewhere. Each attempt writes a file of its own, which takes the part's name
when it is whole, so that a process that outlives its worker does no harm. INPUT, SCENE.pcast and --parts may be URLs of objects, where
planecast was built with object storage: there a part is seen when it is whole, whoever puts it.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import uuid


def call(command):
    """Standard output of a command; what it says on standard error is the text of the failure."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
    return done.stdout


def is_url(name):
    return "://" in name


def absolute(name):
    return name if is_url(name) or name.startswith("procedural:") else os.path.abspath(name)


def encode_part(planecast, source, options, start, end, part):
    """Makes one part, unless it is there already; returns its name."""
    if is_url(part):
        call([planecast, "encode", source, "--tiles", f"{start}..{end}", "-o", part, *options])
    elif not os.path.exists(part):
        attempt = f"{part}.{uuid.uuid4().hex}"
        call([planecast, "encode", source, "--tiles", f"{start}..{end}", "-o", attempt, *options])
        os.replace(attempt, part)
    return part


def encode(client, planecast, source, output, jobs, options, parts_dir):
    """Encodes `source` to `output` with about `jobs` tasks on the cluster of `client`."""
    tiles = json.loads(call([planecast, "encode", source, *options, "--plan"]))["tiles"]
    jobs = max(1, min(jobs, tiles))
    if not is_url(parts_dir):
        os.makedirs(parts_dir, exist_ok=True)
    cuts = [tiles * i // jobs for i in range(jobs + 1)]
    parts = [f"{parts_dir}/{a}-{b}.part" for a, b in zip(cuts, cuts[1:])]
    tasks = [
        client.submit(encode_part, planecast, source, options, a, b, part, retries=3, pure=False)
        for a, b, part in zip(cuts, cuts[1:], parts)
    ]
    client.gather(tasks)
    # Where the client is: merging reads every part once.
    call([planecast, "merge", *parts, "-o", output])
    # Objects are left to the bucket's own rules.
    if not is_url(parts_dir):
        shutil.rmtree(parts_dir)


def main():
    argv = sys.argv[1:]
    cut = argv.index("--") if "--" in argv else len(argv)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input")
    parser.add_argument("-o", "--output", required=True, help="scene to write")
    parser.add_argument("--scheduler", help="address of a Dask scheduler [default: workers on this machine]")
    parser.add_argument("--workers", type=int, default=2, help="workers on this machine [default: %(default)s]")
    parser.add_argument("--jobs", type=int, help="tasks [default: four a worker]")
    parser.add_argument("--parts", help="folder for parts that all machines see [default: OUTPUT.parts]")
    parser.add_argument("--planecast", default="planecast", help="the command [default: %(default)s]")
    args = parser.parse_args(argv[:cut])

    from dask.distributed import Client, LocalCluster

    cluster = args.scheduler or LocalCluster(n_workers=args.workers, threads_per_worker=1, dashboard_address=None)
    with Client(cluster) as client:
        jobs = args.jobs or 4 * max(1, len(client.scheduler_info()["workers"]))
        parts = absolute(args.parts or args.output + ".parts").rstrip("/")
        encode(client, args.planecast, absolute(args.input), absolute(args.output), jobs, argv[cut + 1 :], parts)


if __name__ == "__main__":
    main()
