#!/usr/bin/env python3
"""Compares what planecast reads of files with what the library reads that people use.

    python3 -m venv v && v/bin/pip install -r tests/readers/requirements.txt
    cargo build --release --features zarr
    v/bin/python tests/readers/run.py target/release/planecast > tests/readers.md

Outside CI, since it needs Python and the packages named in requirements.txt. Every module beside this file that has a
function `rows(planecast)` takes part: it makes files with such a library, encodes them, and yields rows of (format,
property, library with its version, value by the library, value by planecast).
"""

import importlib
import json
import pathlib
import subprocess
import sys
import tempfile


class Planecast:
    """The program under test, and a folder for its files."""

    def __init__(self, program, folder):
        self.program, self.folder, self.n = program, pathlib.Path(folder), 0

    def path(self, name):
        """A fresh path that ends in `name`."""
        self.n += 1
        folder = self.folder / f"{self.n:04}"
        folder.mkdir()
        return folder / name

    def run(self, *args):
        return subprocess.run([self.program, *map(str, args)], capture_output=True, text=True, timeout=300)

    def encode(self, source, *flags):
        """The scene made of `source`, and what was said; the scene is None where it was refused."""
        scene = self.path("scene.pcast")
        done = self.run("encode", source, "-o", scene, *flags)
        assert done.returncode in (0, 1, 2), f"{source}: status {done.returncode}: {done.stderr}"
        return (scene if done.returncode == 0 else None), done.stderr

    def info(self, scene):
        return json.loads(self.run("info", scene, "--json").stdout)

    def query(self, scene, x, y, z):
        return json.loads(self.run("query", scene, x, y, z).stdout)

    def occupancy(self, scene):
        """Occupancy as a flat list of bytes, x fastest, then y, then z, and the size."""
        raw = self.path("volume.raw")
        done = self.run("decode", scene, "-o", raw)
        assert done.returncode == 0, done.stderr
        return raw.read_bytes(), self.info(scene)["dims"]


def main():
    here = pathlib.Path(__file__).parent
    sys.path.insert(0, str(here))
    names = sorted(p.stem for p in here.glob("*.py") if p.stem != "run")
    only = sys.argv[2:]
    wrong = n = 0
    print("# What readers read, beside the libraries that people use\n")
    print("Made by `tests/readers/run.py`, which says how to run it again.\n")
    print("| format | property | library | by the library | by planecast | result |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        planecast = Planecast(str(pathlib.Path(sys.argv[1]).resolve()), folder)
        for name in names:
            if only and name not in only:
                continue
            for format, prop, library, expected, got in importlib.import_module(name).rows(planecast):
                same = expected == got
                n, wrong = n + 1, wrong + (not same)
                cells = [format, prop, library, expected, got, "same" if same else "**differs**"]
                print("| " + " | ".join(str(c).replace("|", "\\|").replace("\n", " ") for c in cells) + " |", flush=True)
    print(f"\n{n} rows, {wrong} that differ.")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
