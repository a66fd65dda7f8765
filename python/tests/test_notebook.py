"""The widget: its notebook is executed without a browser, its page is opened in one without a screen."""

import base64
import functools
import http.server
import io
import json
import os
import pathlib
import shutil
import sys
import threading
import time

import numpy as np
import planecast
import pytest

pytest.importorskip("anywidget")
from PIL import Image  # noqa: E402

from planecast.widget import View  # noqa: E402

HERE = pathlib.Path(__file__).parent
REPOSITORY = HERE.parent.parent
CHROMIUM = next(filter(None, map(shutil.which, ["chromium", "chromium-browser", "google-chrome"])), None)


def volume(n=48):
    z, y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j, -1 : 1 : n * 1j]
    return (1000 * np.exp(-3 * (x * x + y * y + z * z)) * (1 + 0.3 * np.sin(14 * x) * np.sin(14 * y))).astype("i2")


def pixels(view):
    return np.asarray(Image.open(io.BytesIO(view.frame)).convert("RGB")).astype(int)


def test_poses_and_thresholds_change_the_picture():
    view = View(volume(), size=(160, 100), device="cpu")
    assert view.slider == [float(volume().min()), float(volume().max()), 1.0]
    first = pixels(view)
    assert first.shape == (100, 160, 3)
    view.pose = dict(view.pose, yaw=120.0)
    turned = pixels(view)
    assert (turned != first).any(-1).mean() > 0.05
    view.iso = 900.0
    assert (view.world.query([[24, 24, 24]])[0]).all() and (pixels(view) != turned).any(-1).mean() > 0.05
    view.pose = dict(view.pose, draft=True)
    assert pixels(view).shape == (50, 80, 3)
    n = view.drawn
    view.iso = float("nan")
    assert view.drawn == n + 1 and "iso" in view.words
    fixed = View(planecast.encode((volume() > 300).astype("u1")), device="cpu")
    assert fixed.slider == [] and pixels(fixed).shape == (400, 640, 3)


def test_the_notebook_runs():
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    book = nbformat.read(HERE.parent / "examples" / "notebook.ipynb", 4)
    client = nbclient.NotebookClient(book, timeout=120, kernel_name="python3")
    # The interpreter that runs the tests.
    client.create_kernel_manager()
    client.km.kernel_spec.argv[0] = sys.executable
    client.execute()
    shown = [output for cell in book.cells for output in cell.get("outputs", [])]
    widget = next(o.data["application/vnd.jupyter.widget-view+json"]["model_id"] for o in shown if "application/vnd.jupyter.widget-view+json" in o.get("data", {}))
    state = client.widget_state[widget]
    assert state["iso"] == 600 and state["pose"]["yaw"] == 75 and state["drawn"] >= 3
    assert any("96 × 96 × 96" in str(o.get("data", {}).get("text/plain")) for o in shown)
    picture = next(o.data["image/png"] for o in shown if "image/png" in o.get("data", {}))
    assert Image.open(io.BytesIO(base64.b64decode(picture))).size == (480, 320)


HOST = """<!doctype html><meta charset="utf-8"><title>host</title><link rel="stylesheet" href="widget.css"><body style="margin:8px">
<div id="el"></div><script type="module">
// What Jupyter is to a widget: a model that both sides change.
import widget from "./widget.js";
let state = {};
let changed = {};
const heard = {};
const take = (next) => {
  for (const [k, v] of Object.entries(next)) state[k] = k === "frame" ? new DataView(Uint8Array.from(atob(v), (c) => c.charCodeAt(0)).buffer) : v;
};
const model = {
  get: (k) => state[k],
  set: (k, v) => { state[k] = v; changed[k] = v; },
  on: (name, f) => { (heard[name] ??= []).push(f); },
  save_changes: async () => {
    const sent = JSON.stringify(changed);
    changed = {};
    const before = { ...state };
    take(await (await fetch("state", { method: "POST", body: sent })).json());
    for (const k of Object.keys(state)) if (before[k] !== state[k] || k === "drawn") (heard[`change:${k}`] ?? []).forEach((f) => f());
  },
};
take(await (await fetch("state")).json());
window.model = model;
widget.render({ model, el: document.getElementById("el") });
window.ready = true;
</script>"""


class Host(http.server.SimpleHTTPRequestHandler):
    """The widget's files, and the widget's state as Jupyter would carry it."""

    def __init__(self, *args, view, **kwargs):
        self.view = view
        super().__init__(*args, directory=str(pathlib.Path(planecast.__file__).parent), **kwargs)

    def log_message(self, *_):
        pass

    def answer(self, body, kind):
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def state(self):
        names = ["pose", "size", "iso", "slider", "drawn", "words", "page"]
        state = {name: getattr(self.view, name) for name in names}
        self.answer(json.dumps(state | {"frame": base64.b64encode(self.view.frame).decode()}).encode(), "application/json")

    def do_GET(self):
        if self.path == "/host.html":
            self.answer(HOST.encode(), "text/html")
        elif self.path == "/state":
            self.state()
        else:
            super().do_GET()

    def do_POST(self):
        for name, value in json.loads(self.rfile.read(int(self.headers["Content-Length"]))).items():
            setattr(self.view, name, value)
        self.state()


@pytest.fixture
def browser():
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    # The page's test knows how to talk to it; all but its last line.
    source = (REPOSITORY / "web" / "test").read_text()
    names = {"__file__": str(REPOSITORY / "web" / "test"), "__name__": "page_test"}
    exec(compile(source.rsplit("\nmain()", 1)[0], "web/test", "exec"), names)
    browser = names["Browser"](["--disable-gpu"])
    yield browser
    browser.close()


def until(of, seconds=60):
    end = time.time() + seconds
    while time.time() < end:
        if found := of():
            return found
        time.sleep(0.05)
    raise AssertionError("it did not come in time")


def hosted(view, browser):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Host, view=view))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser.call("Page.navigate", url=f"http://127.0.0.1:{server.server_port}/host.html")
    until(lambda: browser.evaluate("Boolean(window.ready) && document.querySelector('img').naturalWidth > 0"))
    return server


def screenshot(browser, name):
    """Where PLANECAST_PICTURES names a folder, to be looked at."""
    shot = base64.b64decode(browser.call("Page.captureScreenshot", format="png")["data"])
    if folder := os.environ.get("PLANECAST_PICTURES"):
        (pathlib.Path(folder) / name).write_bytes(shot)
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def mouse(browser, kind, x, y, **more):
    browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)


def test_the_mouse_turns_it_in_a_browser(browser):
    view = View(volume(), size=(480, 320), device="cpu")
    server = hosted(view, browser)
    before = screenshot(browser, "widget-first.png")
    assert len(np.unique(before[8:328, 8:488].reshape(-1, 3), axis=0)) > 100
    yaw = view.pose["yaw"]
    mouse(browser, "mousePressed", 200, 150, button="left", clickCount=1)
    for x in range(210, 301, 10):
        mouse(browser, "mouseMoved", x, 150, button="left", buttons=1)
    mouse(browser, "mouseReleased", 300, 150, button="left", clickCount=1)
    until(lambda: abs(view.pose["yaw"] - (yaw - 40)) < 1e-6 and not view.pose["draft"])
    # The wheel comes nearer, the slider moves the threshold.
    mouse(browser, "mouseWheel", 200, 150, deltaX=0, deltaY=-250)
    until(lambda: view.pose["nearer"] > 1.5 and not view.pose["draft"])
    browser.evaluate("(() => { const s = document.querySelector('input'); s.value = '700'; s.dispatchEvent(new Event('change')); })()")
    until(lambda: view.iso == 700)
    shown = until(lambda: browser.evaluate("document.querySelector('img').naturalWidth") == 480)
    time.sleep(0.3)
    after = screenshot(browser, "widget-turned.png")
    assert shown and (after[8:328, 8:488] != before[8:328, 8:488]).any(-1).mean() > 0.1
    assert "48 × 48 × 48" in browser.evaluate("document.querySelector('.planecast').innerText")
    assert not browser.errors, browser.errors
    server.shutdown()


def test_the_page_takes_the_scene_in_ranges_and_stills_stand_in_for_it(browser):
    page = REPOSITORY / "web" / "dist"
    if not (page / "index.html").exists():
        pytest.skip("needs web/build")
    # Large enough to come in parts.
    view = View(planecast.encode("procedural:terrain?size=512"), size=(480, 320), page=page, device="cpu")
    server = hosted(view, browser)
    until(lambda: browser.evaluate("Boolean(document.querySelector('iframe:not([hidden])')) && document.querySelector('img').hidden"))
    until(lambda: len(view._server.ranges) >= 2)
    time.sleep(4)
    shot = screenshot(browser, "widget-page.png")
    assert len(np.unique(shot[8:328, 8:488].reshape(-1, 3), axis=0)) > 50
    server.shutdown()
    # Nobody answers there: stills.
    view.page = "http://127.0.0.1:9/index.html?scene=none.pcast"
    server = hosted(view, browser)
    until(lambda: browser.evaluate("!document.querySelector('iframe') && !document.querySelector('img').hidden"))
    server.shutdown()
    view.close()
