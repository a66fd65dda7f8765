"""The examples run; types and stubs agree with the code."""

import importlib.util
import pathlib
import shutil
import subprocess
import sys

import planecast
import pytest

EXAMPLES = pathlib.Path(__file__).parent.parent / "examples"


def has(*modules):
    return all(importlib.util.find_spec(m) for m in modules)


@pytest.mark.parametrize(
    "name, arguments, needs, makes",
    [
        ("terrain.py", ["--frames", "8"], [], ["terrain.png", "terrain.mp4"]),
        ("depth_maps.py", ["20"], [], ["depth_maps.npz"]),
        ("threshold.py", [], [], ["threshold-0.png"]),
        ("viewshed.py", [], [], ["viewshed.png", "viewshed.npy"]),
        ("cluster.py", [], ["distributed"], ["cluster.pcast", "cluster.mp4"]),
        ("rerun_log.py", ["flight.rrd"], ["rerun"], ["flight.rrd"]),
    ],
)
def test_examples_run(name, arguments, needs, makes, tmp_path):
    if not has(*needs):
        pytest.skip(f"needs {', '.join(needs)}")
    made = subprocess.run([sys.executable, EXAMPLES / name, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert made.returncode == 0, made.stderr
    assert all((tmp_path / file).stat().st_size > 500 for file in makes)


def test_stubs_and_hints_hold(tmp_path):
    if not has("mypy"):
        pytest.skip("needs mypy")
    program = tmp_path / "use.py"
    program.write_text(
        "import planecast\nimport numpy\n"
        "world: planecast.World = planecast.encode(numpy.ones((4, 4), 'u1'))\n"
        "image: planecast.Image = world.render(size=(8, 8))\nn: int = image.rgb.shape[0]\n"
        "world.render(yaw=[], voxel=3)\n"
    )
    folder = tmp_path / "planecast"
    # Beside its program alone: where it is installed, mypy takes all that stands beside it for what it is to check.
    shutil.copytree(pathlib.Path(planecast.__file__).parent, folder, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    assert (folder / "py.typed").exists()
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--follow-imports=skip", "--ignore-missing-imports", "--cache-dir", tmp_path / "cache", folder, program],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    errors = [line for line in checked.stdout.splitlines() if ": error:" in line]
    # The one planted fault, and no other.
    assert len(errors) == 1 and "use.py:6" in errors[0], checked.stdout
    stub = (folder / "_planecast.pyi").read_text()
    from planecast import _planecast

    for name in [n for n in dir(_planecast) if not n.startswith("_")]:
        assert f"def {name}(" in stub or f"class {name}:" in stub, name
    for name in [n for n in dir(_planecast.World) if not n.startswith("_")]:
        assert f"    def {name}(" in stub or f"    {name}: " in stub, name
