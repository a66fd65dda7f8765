"""A world in a notebook: turned by the mouse, with a threshold to move.

Pictures are drawn where the notebook's kernel runs. With `page`, the folder of the built web page (``web/build`` leaves it in
``web/dist``), the page draws in the browser instead, and takes the scene's file from the kernel in ranges of bytes; where it does
not come up, stills are shown as without it. Needs anywidget.
"""

from __future__ import annotations

import functools
import http.server
import os
import pathlib
import re
import tempfile
import threading
from typing import Any
from urllib.parse import unquote, urlsplit

import anywidget
import numpy
import traitlets

import planecast

from ._image import png

_HERE = pathlib.Path(__file__).parent


class View(anywidget.AnyWidget):
    """Shows a world: drag to turn it, wheel or pinch to come nearer, double click for the first view.

    `source` is a `planecast.World`, or an array, which is encoded with `read`. Of a volume that is not of bytes or labels
    a slider moves the threshold `iso`. `words` are those of `World.render`; pose and size aside. `size` is (width, height) in pixels.
    """

    _esm = _HERE / "widget.js"
    _css = _HERE / "widget.css"

    pose = traitlets.Dict({"yaw": 30.0, "pitch": -25.0, "nearer": 1.0, "draft": False}).tag(sync=True)
    size = traitlets.Tuple((640, 400)).tag(sync=True)
    iso = traitlets.Float(0.0).tag(sync=True)
    # Ends and step of the slider; without one, empty.
    slider: traitlets.List[float] = traitlets.List([]).tag(sync=True)
    frame = traitlets.Bytes(b"").tag(sync=True)
    drawn = traitlets.Int(0).tag(sync=True)
    words = traitlets.Unicode("").tag(sync=True)
    # Address of the page, if it is to draw.
    page = traitlets.Unicode("").tag(sync=True)

    def __init__(
        self,
        source: Any,
        *,
        iso: float | None = None,
        size: tuple[int, int] = (640, 400),
        page: str | os.PathLike | None = None,
        read: dict[str, Any] | None = None,
        **words: Any,
    ) -> None:
        self._source, self._read, self._draw = source, dict(read or {}), words
        self._worlds: dict[float | None, planecast.World] = {}
        self._server: _Server | None = None
        self._distance: float | None = None
        slider: list[float] = []
        if isinstance(source, planecast.World):
            self._worlds[None] = source
        elif iso is not None or self._wants_iso():
            low, high = self._range()
            iso = (low + high) / 2 if iso is None else float(iso)
            step = 1.0 if getattr(source, "dtype", numpy.dtype("f4")).kind in "biu" else (high - low) / 200 or 1.0
            slider = [low, high, step]
        super().__init__(size=tuple(size), iso=float(iso or 0.0), slider=slider)
        if page is not None:
            self._server = _Server(pathlib.Path(page))
            self.page = self._server.address(self._scene())
        self._redraw()
        self.observe(self._redraw, names=["pose", "size"])
        self.observe(self._moved, names=["iso"])

    def _wants_iso(self) -> bool:
        dtype = getattr(self._source, "dtype", None)
        volume = len(getattr(self._source, "shape", ())) == 3
        return volume and dtype is not None and dtype.itemsize > 1 and self._read.get("kind") != "labels"

    def _range(self) -> tuple[float, float]:
        # Of a sample of large arrays.
        values = self._source
        strides = tuple(slice(None, None, max(1, n // 64)) for n in values.shape)
        sample = values[strides]
        sample = numpy.asarray(sample.compute() if hasattr(sample, "compute") else sample)
        sample = sample[numpy.isfinite(sample)] if sample.dtype.kind == "f" else sample
        if sample.size == 0:
            raise ValueError("no value of the array is a number")
        return float(sample.min()), float(sample.max())

    @property
    def world(self) -> planecast.World:
        """The world that is shown."""
        key = self.iso if self.slider else None
        if key not in self._worlds:
            # The last few thresholds stay at hand.
            while len(self._worlds) >= 4:
                self._worlds.pop(next(iter(self._worlds)))
            self._worlds[key] = planecast.encode(self._source, **{**self._read, "iso": key})
        return self._worlds[key]

    def _moved(self, _: Any) -> None:
        if self._server is not None:
            self.page = self._server.address(self._scene())
        self._redraw()

    def _scene(self) -> bytes:
        with tempfile.TemporaryDirectory(prefix="planecast-") as folder:
            name = os.path.join(folder, "world.pcast")
            self.world.save(name)
            return pathlib.Path(name).read_bytes()

    def _redraw(self, _: Any = None) -> None:
        try:
            pose = self.pose
            world = self.world
            width, height = map(int, self.size)
            if self._distance is None:
                # How far the eye is of the view that shows all.
                camera = world.render(orbit=(0, -25), size=(8, 8), device="cpu").camera
                middle = numpy.array(world.shape) / 2
                self._distance = float(numpy.linalg.norm(numpy.array(camera.eye) - middle)) or 1.0
            scale = 2 if pose.get("draft") else 1
            orbit = (float(pose["yaw"]), float(numpy.clip(pose["pitch"], -90, 90)), self._distance / max(0.02, float(pose["nearer"])))
            size = (max(1, width // scale), max(1, height // scale))
            image = world.render(orbit=orbit, size=size, **self._draw)
            self.frame = _packed(image.rgb, bool(pose.get("draft")))
            self.words = f"{world.shape[0]} × {world.shape[1]} × {world.shape[2]} voxels"
        except (ValueError, OSError, MemoryError, RuntimeError) as error:
            self.words = str(error)
        self.drawn += 1

    def close(self) -> None:
        """Ends it, and the page's server where there is one."""
        if self._server is not None:
            self._server.shutdown()
            self._server = None
        super().close()


def _packed(rgb: numpy.ndarray, draft: bool) -> bytes:
    """A picture as JPEG where Pillow is installed and it is shown for a moment alone, else as PNG."""
    if draft:
        try:
            import io

            from PIL import Image as Pillow

            out = io.BytesIO()
            Pillow.fromarray(numpy.ascontiguousarray(rgb)).save(out, "jpeg", quality=85)
            return out.getvalue()
        except ImportError:
            pass
    return png(rgb)


class _Server(http.server.ThreadingHTTPServer):
    """Gives this machine the page's files, and the scene in ranges."""

    daemon_threads = True

    def __init__(self, page: pathlib.Path) -> None:
        if not (page / "index.html").is_file():
            raise FileNotFoundError(f"{page}: no page is there; web/build makes it in web/dist")
        self.scene, self.number = b"", 0
        self.ranges: list[str] = []
        super().__init__(("127.0.0.1", 0), functools.partial(_Handler, directory=str(page)))
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def address(self, scene: bytes) -> str:
        """Where a scene is shown from now on."""
        self.scene, self.number = scene, self.number + 1
        return f"http://127.0.0.1:{self.server_address[1]}/index.html?scene=world-{self.number}.pcast"


class _Handler(http.server.SimpleHTTPRequestHandler):
    """Files of the page; of the scene one range of bytes where one is asked for (RFC 9110, section 14)."""

    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def do_GET(self) -> None:
        if not re.fullmatch(r"/world-\d+\.pcast", unquote(urlsplit(self.path).path)):
            return super().do_GET()
        server = self.server
        assert isinstance(server, _Server)
        scene = server.scene
        asked = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        first, last = 0, len(scene) - 1
        if asked:
            first, last = int(asked[1]), min(int(asked[2] or last), last)
            server.ranges.append(asked[0])
        if first > last:
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{len(scene)}")
            self.send_header("Content-Length", "0")
            return self.end_headers()
        self.send_response(206 if asked else 200)
        if asked:
            self.send_header("Content-Range", f"bytes {first}-{last}/{len(scene)}")
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Type", "application/octet-stream")
        self.send_header("Content-Length", str(last + 1 - first))
        self.end_headers()
        self.wfile.write(scene[first : last + 1])
