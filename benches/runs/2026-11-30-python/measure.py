#!/usr/bin/env python3
"""measure.py PLANECAST [PARTS]: the Python package beside the command PLANECAST, in one run; both of the same release profile.

encode  a volume of 1,024³ bytes from an ndarray, and from its .npy by the command, in turn; the process's peak before and after
render  1,024 × 768 on the CPU: from Python, and what Rust says that its part of the same call took
sparse  a Zarr array of 245 GB, of which one block was written: opened, encoded, drawn; its peak
"""

import os
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np
import planecast

MIB = 1 << 20


def spread(values):
    return f"median {np.median(values):.3f}, {min(values):.3f} to {max(values):.3f} of {len(values)}"


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def ball(n):
    """Shells of hollow balls: few runs a column and many, as bytes."""
    axis = np.arange(n, dtype="f4")
    out = np.empty((n, n, n), "u1")
    for z in range(n):
        r = np.sqrt((axis[None] - n / 2) ** 2 + (axis[:, None] - n / 2) ** 2 + np.float32(z - n / 2) ** 2)
        out[z] = ((r < 0.48 * n) & (np.sin(r / 9) > -0.3)).astype("u1")
    return out


def encode(command, folder):
    n = 1024
    array = ball(n)
    np.save(f"{folder}/ball.npy", array)
    before = peak()
    rates = {"python": [], "command": []}
    for _ in range(5):
        begun = time.perf_counter()
        subprocess.run([command, "encode", f"{folder}/ball.npy", "-o", f"{folder}/command.pcast"], check=True, capture_output=True)
        rates["command"].append(array.nbytes / (time.perf_counter() - begun) / 1e9)
        begun = time.perf_counter()
        planecast._planecast.encode_array(array.reshape(-1), [n] * 3, "|u1", False, [], f"{folder}/python.pcast")
        rates["python"].append(array.nbytes / (time.perf_counter() - begun) / 1e9)
    same = planecast.info(f"{folder}/python.pcast")["content_hash"] == planecast.info(f"{folder}/command.pcast")["content_hash"]
    for name, of in rates.items():
        print(f"encode 1,024^3 u1, {name}: GB/s {spread(of)}")
    ratios = np.array(rates["python"]) / rates["command"]
    print(f"  python / command: {spread(ratios)}; the same scene: {same}")
    print(f"  peak {before:.0f} MiB before (array {array.nbytes / MIB:.0f} MiB), {peak():.0f} MiB after")


def render():
    world = planecast.encode("procedural:terrain?size=1024")
    words = dict(size=(1024, 768), device="cpu", eye=(512, 180, 512), yaw=30, pitch=-15)
    world.render(**words)
    whole, inner = [], []
    for _ in range(40):
        begun = time.perf_counter()
        image = world.render(**words)
        whole.append(1000 * (time.perf_counter() - begun))
        inner.append(image.stats["cpu_ms"]["total"])
    print(f"render 1,024 x 768, python: ms {spread(whole)}")
    print(f"  rust's part of the same calls: ms {spread(inner)}")
    print(f"  python / rust: {spread(np.array(whole) / inner)}")
    poses = [dict(eye=(512 + i % 50, 180, 512), yaw=3 * i, pitch=-15) for i in range(300)]
    begun = time.perf_counter()
    n = sum(1 for _ in world.render_many(poses, size=(64, 64), device="cpu"))
    many = time.perf_counter() - begun
    begun = time.perf_counter()
    for pose in poses:
        world.render(**pose, size=(64, 64), device="cpu")
    print(f"{n} pictures of 64 x 64: {many:.2f} s by render_many, {time.perf_counter() - begun:.2f} s one after the other")


def sparse(folder):
    import zarr

    array = zarr.create_array(f"{folder}/sparse.zarr", shape=(6260, 6260, 6260), chunks=(128, 128, 128), dtype="u1", fill_value=0)
    array[3000:3300, 2900:3200, 3100:3400] = 1
    before = peak()
    for name, of in (("zarr array", zarr.open_array(f"{folder}/sparse.zarr")),):
        begun = time.perf_counter()
        world = planecast.encode(of, memory="512M")
        encoded = time.perf_counter()
        image = world.render(size=(1024, 768), device="cpu")
        done = time.perf_counter()
        assert np.isfinite(image.depth).any()
        image.save(f"{folder}/sparse.png")
        print(f"sparse {name} of {array.nbytes / 1e9:.0f} GB: encoded in {encoded - begun:.1f} s, drawn after {done - begun:.1f} s, "
              f"peak {before:.0f} MiB before, {peak():.0f} MiB after")


def main():
    parts = sys.argv[2:] or ["encode", "render", "sparse"]
    print(f"planecast {planecast.__version__}, numpy {np.__version__}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as folder:
        if "encode" in parts:
            encode(sys.argv[1], folder)
        if "render" in parts:
            render()
        if "sparse" in parts:
            sparse(folder)


if __name__ == "__main__":
    main()
