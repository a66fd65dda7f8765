// Events, files and words of the page; scene, camera and kernels are in planecast_web.wasm, and once more in worker.js, where
// files are read.
//
// Address: ?scene=URL opens that file in place of the demo, or a world that is made: ?scene=procedural:hills%3Fsize=inf; ?tiles has
// a scene come in tiles, as large ones do, and ?memory=MB says how much of those is kept; ?device=cpu draws without WebGPU,
// ?device=gpu with it even where it is software; ?size=WxH fixes the picture. #eye=X,Y,Z&yaw=D&pitch=D&roll=D&mode=NAME is the view, and follows it.
import init, { Page } from "./planecast_web.js";

const element = (id) => document.getElementById(id);
const canvas = element("canvas");
const asked = new URLSearchParams(location.search);
const began = performance.now();
let page = null;
let gpu = false;
let adapter = "";
let broken = false;
let firstPicture = null;
let scene = null;
// The program, compiled: for the page and for its workers.
let program = null;
// Counts what is opened: what was begun before gives way.
let opened = 0;
// The picture of the present scene has been seen.
let seen = false;
// Brings the tiles of the scene that is open, where it comes in such.
let crew = null;
// Bytes of the file that are here, and of it; and what was here at the first picture.
let fetched = null;
let fetchedAtFirst = null;

/** Says something; what is no fault goes away after some milliseconds. */
function say(text, lasts) {
  element("words").textContent = text;
  clearTimeout(say.timer);
  if (text && lasts) say.timer = setTimeout(() => say(""), lasts);
}

/** How long words stay that tell how something is, and those that answer a click. */
const FACT = 20_000, ANSWER = 4_000;

/** What went wrong, for a person. A trap is the end of the module: nothing of it can be used afterwards. */
function wrong(what, error) {
  if (error instanceof WebAssembly.RuntimeError) {
    broken = true;
    say(`${what}: planecast gave up (${error.message}). Reload the page to go on.`);
  } else {
    const why = `${error?.message ?? error}`;
    say(why.startsWith(what) ? why : `${what}: ${why}`);
  }
}

const NEEDS = "WebGPU is in Chrome and Edge 113 and later, Safari 26, and Firefox 141 on Windows";

/** Whether an adapter is software. */
function isSoftware(found) {
  const { vendor, architecture, device, description, isFallbackAdapter } = found.info;
  return Boolean(isFallbackAdapter ?? found.isFallbackAdapter)
    || /swiftshader|llvmpipe|lavapipe|software|basic render|warp/i.test([vendor, architecture, device, description].join(" "));
}

async function open() {
  if (asked.get("device") === "cpu") {
    say("Drawing on the CPU, one thread, as the address asks for.");
  } else if (!navigator.gpu) {
    say(isSecureContext
      ? `This browser has no WebGPU: drawing on the CPU, one thread, with fewer pixels. ${NEEDS}.`
      : "WebGPU needs a secure page (https, or http://localhost): drawing on the CPU, one thread, with fewer pixels.");
  } else {
    const found = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
    // As on the desktop: software that plays a GPU is slower than the CPU's own kernels, so it draws only where it is asked for.
    if (found && isSoftware(found) && asked.get("device") !== "gpu") {
      say("WebGPU has only a software adapter here: drawing on the CPU, one thread, with fewer pixels.");
    } else if (found) {
      gpu = true;
      const { description, vendor, architecture } = found.info;
      adapter = description || `WebGPU, ${vendor} ${architecture}`;
    } else {
      say("WebGPU finds no usable GPU here: drawing on the CPU, one thread, with fewer pixels.");
    }
  }
  fit();
  try {
    page = await Page.open(canvas, gpu);
  } catch (error) {
    if (!gpu) throw error;
    gpu = false;
    say(`WebGPU does not work here (${error}): drawing on the CPU, one thread, with fewer pixels.`);
    // A canvas that was given to WebGPU cannot be drawn on otherwise.
    page = await Page.open(document.createElement("canvas"), false);
  }
}

/** When somebody last did something. */
let touched = 0;

/** The CPU draws a quarter of the pixels, and all of them once nobody does anything, where that takes no longer than a second or so. */
function isSharp(now) {
  const rests = now - Math.max(touched, keepView.since ?? now) > 500;
  return rests && seen && !scene?.level && (fit.ms ?? Infinity) < 400;
}

/** Gives the picture the canvas's own pixels, beside the panel where there is room for both. */
function fit(now = 0) {
  const panel = element("panel");
  const beside = panel.open && innerWidth > 1000 ? panel.offsetWidth + 16 : 0;
  canvas.style.marginLeft = `${beside}px`;
  canvas.style.width = `${innerWidth - beside}px`;
  const fixed = asked.get("size")?.match(/^(\d+)x(\d+)$/);
  fit.sharp = !gpu && !fixed && isSharp(now);
  const scale = gpu ? devicePixelRatio : fit.sharp ? 1 : 0.5;
  const size = fixed ? [Number(fixed[1]), Number(fixed[2])] : [(innerWidth - beside) * scale, innerHeight * scale];
  const [width, height] = size.map((n) => Math.max(1, Math.min(8192, Math.round(n))));
  if (canvas.width !== width || canvas.height !== height || !page) {
    [canvas.width, canvas.height] = [width, height];
    page?.resize(width, height);
  }
}

/** Whoever reads files, in a worker. What it cannot do, or gives up, is an error here. */
class Reads {
  constructor() {
    this.worker = new Worker(new URL("worker.js", import.meta.url), { type: "module" });
    this.waiting = new Map();
    this.n = 0;
    this.worker.onmessage = ({ data: { id, value, error, gaveUp } }) => {
      const { done, failed } = this.waiting.get(id);
      this.waiting.delete(id);
      if (error === undefined) done(value);
      else failed(new Error(gaveUp ? `the reader gave up (${error}); what was shown before is still here` : error));
    };
    this.worker.onerror = (event) => {
      for (const { failed } of this.waiting.values()) failed(new Error(`the reader ended (${event.message})`));
      this.waiting.clear();
    };
    this.ask("start", program);
  }

  ask(what, ...given) {
    const id = this.n++;
    const moved = given.filter((g) => g instanceof Uint8Array).map((g) => g.buffer);
    return new Promise((done, failed) => {
      this.waiting.set(id, { done, failed });
      this.worker.postMessage([id, what, ...given], moved);
    });
  }

  /** Ends it, with its memory. */
  end() { this.worker.terminate(); }
}

/** Workers that bring the tiles of a world as frames want them. */
class Crew {
  constructor(name, first) {
    [this.name, this.workers, this.idle, this.ended] = [name, [first], [first], false];
  }

  /** More of them, once there is a picture: each reads what is known of the world for itself. */
  async grow(n) {
    while (this.workers.length < n && !this.ended) {
      const worker = new Reads();
      this.workers.push(worker);
      try {
        await worker.ask("tiles", this.name);
        this.idle.push(worker);
      } catch {
        // The others go on.
        worker.end();
      }
    }
  }

  /** Gives whoever is idle the tile that is wanted most. */
  work() {
    while (this.idle.length > 0 && !this.ended) {
      const [number, level, x, z, heights] = page.order();
      if (number === undefined) return;
      const worker = this.idle.pop();
      worker.ask("tile", level, x, z, heights === 1).then(
        (parcel) => { if (!this.ended) page.deliver(number, parcel); },
        (error) => { if (!this.ended) page.refuse(number, error.message); },
      ).finally(() => {
        this.idle.push(worker);
        // Frames may be far apart.
        this.work();
      }).catch((error) => wrong("tiles", error));
    }
  }

  end() {
    this.ended = true;
    for (const worker of this.workers) worker.end();
  }
}

/** Opens a file by what `steps` does with whoever reads, and says what that has to say in the end; false where it failed,
 * which is said. */
async function opening(name, steps) {
  if (broken) return false;
  const turn = ++opened;
  const reads = new Reads();
  const still = () => {
    if (turn !== opened) throw new Error("another file was opened");
    crew?.end();
    crew = null;
  };
  const show = (bytes, level, goesOn) => {
    still();
    scene = { name, ...JSON.parse(page.load(name, bytes, level, goesOn)) };
    seen = false;
  };
  let kept = false;
  // The same of a world in tiles, which whoever reads goes on to bring.
  const showTiles = (facts, address) => {
    still();
    crew = new Crew(address, reads);
    kept = true;
    const bytes = 1e6 * (Number(asked.get("memory")) || 256);
    scene = { name, ...JSON.parse(page.load_tiles(facts, bytes)) };
    seen = false;
  };
  try {
    const words = await steps(reads, show, showTiles);
    if (turn === opened) say(words ?? "", FACT);
    return true;
  } catch (error) {
    if (turn === opened) wrong(name, error);
    return false;
  } finally {
    if (!kept) reads.end();
  }
}

/** Opens a file that is here. */
function load(name, bytes, what = "read") {
  fetched = null;
  return opening(name, async (reads, show) => {
    say(`reading ${name}`);
    show(await reads.ask(what, name, bytes), 0, false);
  });
}

/** Waits until what is shown now has been seen, if anybody looks; no longer than a slow device takes for its first picture. */
async function untilSeen() {
  const begin = performance.now();
  while (!seen && !document.hidden && !broken && performance.now() - begin < 3000) {
    await new Promise((done) => setTimeout(done, 10));
  }
}

const megabytes = (n) => (n / 1e6).toFixed(1);

/** The bytes of an answer; says how far it is. */
async function bytesOf(answer, url) {
  if (!answer.ok) throw new Error(`the server answers ${answer.status} ${answer.statusText}`);
  const total = Number(answer.headers.get("content-length")) || 0;
  const reader = answer.body.getReader();
  const parts = [];
  let n = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    n += value.length;
    if (url) say(`${url}: ${megabytes(n)}${total >= n ? ` of ${megabytes(total)}` : ""} MB`);
  }
  const bytes = new Uint8Array(n);
  let at = 0;
  for (const part of parts) { bytes.set(part, at); at += part.length; }
  return bytes;
}

async function fetchRange(url, from, to) {
  const answer = await fetch(url, { headers: { Range: `bytes=${from}-${to - 1}` } });
  if (answer.status !== 206) throw new Error(`the server answers ${answer.status} where it sent a part before`);
  return [from, await bytesOf(answer)];
}

/** Bytes that a server says a file has, in its answer to a range. */
const lengthIn = (answer) => Number(answer.headers.get("content-range")?.match(/\/(\d+)$/)?.[1]) || undefined;

/** Scene files of more bytes than this come in tiles. */
const TILES_FROM = 64e6;

/** Opens a file by its address: scene files in ranges of bytes, coarse levels first, where the server gives such; large ones,
 * worlds of several and those that are made in tiles, as frames want them. */
async function loadFrom(url, view = "") {
  const name = nameOf(url);
  return opening(name, async (reads, show, showTiles) => {
    say(`${url}: asking for it`);
    const inTiles = async () => {
      const made = url.startsWith("procedural:");
      const address = made ? url : new URL(url, location.href).href;
      await reads.ask("tiles", address);
      const facts = await reads.ask("facts");
      fetched = { bytes: await reads.ask("fetched"), of: undefined, ranges: !made };
      showTiles(facts, address);
      goToView(view);
      const mine = crew;
      // One core is left for the page.
      untilSeen().then(() => mine.grow(Math.max(1, Math.min(4, (navigator.hardwareConcurrency || 2) - 1))));
    };
    if (/^procedural:|\.pworld($|[?#])/i.test(url)) return inTiles();
    const first = await fetch(url, { headers: { Range: `bytes=0-${await reads.ask("head") - 1}` } });
    let head = await bytesOf(first, url);
    const isScene = [0x89, 0x50, 0x43, 0x56].every((byte, i) => head[i] === byte);
    if (first.status !== 206 || !isScene) {
      if (first.status === 206 && !(lengthIn(first) <= head.length)) head = await bytesOf(await fetch(url), url);
      const why = isScene ? "the server gives no parts of files, so all of it was fetched first" : "";
      fetched = { bytes: head.length, of: head.length, ranges: false };
      show(await reads.ask("read", name, head), 0, false);
      goToView(view);
      return why && `${url}: ${why}`;
    }
    if (asked.has("tiles") || lengthIn(first) > TILES_FROM) return inTiles();
    await reads.ask("open", name, head, lengthIn(first));
    let state = await reads.ask("state");
    let shown = null;
    const ask = ({ wanted }) => {
      const ranges = [];
      for (let i = 0; i < wanted.length; i += 2) ranges.push(fetchRange(url, wanted[i], wanted[i + 1]));
      const all = Promise.all(ranges);
      // It is waited for below, after other work.
      all.catch(() => {});
      return all;
    };
    for (;;) {
      const coming = ask(state);
      fetched = { bytes: state.progress[0], of: state.progress[1], ranges: true };
      if (state.level !== undefined && state.level !== shown) {
        const bytes = await reads.ask("scene");
        // So that what there is can be seen before more of it is.
        if (shown !== null) await untilSeen();
        show(bytes, state.level, shown !== null);
        if (shown === null) goToView(view);
        shown = state.level;
      }
      if (state.wanted.length === 0) break;
      say(`${url}: ${megabytes(state.progress[0])} of ${megabytes(state.progress[1])} MB, `
        + (shown === null ? "coarse first" : `at 1 : ${2 ** shown} so far`));
      for (const [at, bytes] of await coming) await reads.ask("put", at, bytes);
      state = await reads.ask("state");
    }
  });
}

const nameOf = (url) => (url.startsWith("procedural:") ? url : decodeURIComponent(new URL(url, location.href).pathname.split("/").pop() || "scene"));

/** Keys that a gamepad holds. */
const padKeys = new Set();

/** A gamepad of the standard layout: the left stick, shoulders and triggers are keys, the right stick looks. */
function gamepad(seconds) {
  const pad = [...(navigator.getGamepads?.() ?? [])].find((p) => p?.mapping === "standard");
  if (!pad && padKeys.size === 0) return;
  const [x = 0, y = 0, lookX = 0, lookY = 0] = pad?.axes ?? [];
  const pressed = (i) => (pad?.buttons[i]?.value ?? 0) > 0.3;
  const keys = {
    KeyA: x < -0.3, KeyD: x > 0.3, KeyW: y < -0.3, KeyS: y > 0.3, KeyQ: pressed(4), KeyE: pressed(5),
    ControlLeft: pressed(6), Space: pressed(7), ShiftLeft: pressed(10),
  };
  for (const [code, down] of Object.entries(keys)) {
    if (down === padKeys.has(code)) continue;
    page.key(code, down);
    if (down) padKeys.add(code); else padKeys.delete(code);
  }
  // Fine near the middle, 900 pixels of a mouse a second at the rim.
  const bent = (v) => (Math.abs(v) < 0.1 ? 0 : v * Math.abs(v) * 900 * seconds);
  if (bent(lookX) || bent(lookY)) page.look(bent(lookX), bent(lookY));
}

let then = performance.now();
let shown = [];
function tick(now) {
  requestAnimationFrame(tick);
  if (!page || broken) return;
  const seconds = (now - then) / 1000;
  then = now;
  try {
    fit(now);
    gamepad(Math.max(0, Math.min(0.25, seconds)));
    crew?.work();
    if (page.frame(Math.max(0, seconds))) {
      shown.push(now);
      if (!gpu) paint();
      // Of a quarter of the pixels.
      if (!gpu && !fit.sharp) fit.ms = JSON.parse(page.figures()).cpu_ms?.total;
    }
  } catch (error) {
    wrong("drawing", error);
    return;
  }
  // Figures come when the picture is done, not when it is asked for.
  if (scene && !seen) {
    const f = JSON.parse(page.figures());
    seen = Boolean(f.gpu_ms ?? f.cpu_ms);
    if (seen && firstPicture === null) {
      firstPicture = performance.now() - began;
      fetchedAtFirst = { ...fetched, level: scene.level };
    }
  }
  while (now - shown[0] > 1000) shown.shift();
  if (scene && element("panel").open) {
    element("scene").textContent = `${scene.name}: ${scene.dims.join(" × ")} voxels`;
    element("mode").textContent = JSON.parse(page.pose()).mode;
    if (element("more").open) figures();
  }
  if (crew) {
    element("owed").textContent = page.owed();
    const notices = page.notices();
    if (notices) say(notices, FACT);
  }
  if (scene && seen && !asked.has("size")) keepView(now);
}

function paint() {
  const pixels = page.pixels();
  if (pixels.length === 4 * canvas.width * canvas.height) {
    const image = new ImageData(new Uint8ClampedArray(pixels.buffer), canvas.width, canvas.height);
    canvas.getContext("2d").putImageData(image, 0, 0);
  }
}

function figures() {
  const f = JSON.parse(page.figures());
  const p = JSON.parse(page.pose());
  const ms = f.gpu_ms ?? f.cpu_ms;
  const stages = ms ? ["setup", "traverse", "remap", "shade", "total"].map((s) => `${s} ${ms[s].toFixed(2)}`).join(", ") : "";
  element("figures").textContent = [
    `${scene.name}: ${scene.dims.join(" × ")} voxels${scene.level ? ` at 1 : ${2 ** scene.level} so far` : ""}, ${scene.levels} levels, ${(scene.bytes / 1e6).toFixed(1)} MB`,
    `${gpu ? adapter : "cpu"}, ${canvas.width} × ${canvas.height}, ${shown.length} frames/s`,
    `ms: ${stages}`,
    `${f.planes} planes, ${f.columns_visited} columns, ${f.runs_visited} runs`,
    ...(crew ? [`${f.tiles_wanted} tiles wanted, ${f.tiles_missing} missing, ${(f.bytes_resident / 1e6).toFixed(0)} MB of tiles`] : []),
    `eye ${p.eye.map((v) => v.toFixed(1)).join(", ")}, yaw ${p.yaw.toFixed(0)}°, pitch ${p.pitch.toFixed(0)}°`,
    `${p.mode}, ${p.speed.toFixed(1)} voxels/s`,
  ].join("\n");
}

/** What keys do here: Ctrl with W, T or N closes tabs and opens windows, so C goes down in its place. */
const keyOf = (code) => (code === "KeyC" ? "ControlLeft" : code.startsWith("Control") ? "" : code);

/** Mouse and fingers: one looks or turns, two move across the picture and pinch, the right button moves. */
function pointers() {
  const down = new Map();
  const middle = () => {
    const [a, b] = [...down.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus();
    down.set(event.pointerId, { x: event.clientX, y: event.clientY, button: event.button });
  });
  const up = (event) => { down.delete(event.pointerId); };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    // A notch is about 100 pixels, 3 lines or a page.
    if (page && !broken) page.wheel(-event.deltaY / [100, 3, 1][event.deltaMode]);
  }, { passive: false });
  canvas.addEventListener("pointermove", (event) => {
    if (!page || broken) return;
    if (document.pointerLockElement === canvas) { page.look(event.movementX, event.movementY); return; }
    const last = down.get(event.pointerId);
    if (!last) return;
    const before = down.size === 2 ? middle() : null;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    Object.assign(last, { x: event.clientX, y: event.clientY });
    const pixels = canvas.height / canvas.clientHeight;
    if (before) {
      const after = middle();
      page.pan((after.x - before.x) * pixels, (after.y - before.y) * pixels);
      // A notch of the wheel brings an eighth nearer.
      if (before.apart > 0 && after.apart > 0) page.nearer(Math.log(after.apart / before.apart) / -Math.log(0.88));
    } else if (down.size === 1) {
      if (last.button === 2 || event.shiftKey) page.pan(dx * pixels, dy * pixels); else page.look(dx, dy);
    }
  });
}

/** Fingers that hold a key of the panel's. */
function held() {
  for (const button of document.querySelectorAll("[data-key]")) {
    const key = (down) => (event) => { event.preventDefault(); if (page && !broken) page.key(button.dataset.key, down); };
    button.addEventListener("pointerdown", key(true));
    for (const end of ["pointerup", "pointerleave", "pointercancel"]) button.addEventListener(end, key(false));
  }
}

/** The view in the address, once it rests. */
let shownView = "";
function keepView(now) {
  const p = JSON.parse(page.pose());
  const short = (v) => `${Number(v.toFixed(3))}`;
  const view = `#eye=${p.eye.map(short).join(",")}&yaw=${short(p.yaw)}&pitch=${short(p.pitch)}&roll=${short(p.roll)}&mode=${p.mode}`;
  if (view !== keepView.last) { keepView.last = view; keepView.since = now; }
  if (view !== shownView && now - keepView.since > 400) {
    shownView = view;
    history.replaceState(null, "", view.replaceAll(" ", "%20"));
  }
}

/** Goes to the view that the address has. */
function goToView(hash) {
  const view = new URLSearchParams(decodeURIComponent(hash.slice(1)));
  if (!view.has("eye")) return;
  const number = (name) => Number(view.get(name) ?? 0);
  const eye = new Float64Array(view.get("eye").split(",").map(Number));
  if (!page.place(eye, number("yaw"), number("pitch"), number("roll"), view.get("mode") ?? "")) say("the address has no view that can be gone to", FACT);
}

/** The picture as a file. */
async function screenshot() {
  const bytes = await planecast.picture();
  if (!bytes) return;
  const [width, height] = [canvas.width, canvas.height];
  const sheet = document.createElement("canvas");
  [sheet.width, sheet.height] = [width, height];
  sheet.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(bytes), width, height), 0, 0);
  const link = document.createElement("a");
  link.href = sheet.toDataURL("image/png");
  link.download = `${scene.name.replace(/\.[^.]*$/, "")}-view.png`;
  link.click();
}

function events() {
  const typing = (event) => event.target instanceof HTMLInputElement && event.target.type !== "checkbox";
  addEventListener("keydown", (event) => {
    if (!page || broken || typing(event) || event.metaKey || event.altKey || event.ctrlKey) return;
    if (event.code === "KeyM") canvas.requestPointerLock?.();
    if (event.code === "F12") return;
    if (event.code === "KeyP") screenshot();
    if (page.key(keyOf(event.code), true)) event.preventDefault();
  });
  addEventListener("keyup", (event) => { if (page && !broken) page.key(keyOf(event.code), false); });
  addEventListener("blur", () => { if (page && !broken) page.release(); });
  addEventListener("hashchange", () => { if (page && !broken && scene) goToView(location.hash); });
  for (const what of ["pointerdown", "pointermove", "wheel", "keydown"]) {
    addEventListener(what, () => { touched = performance.now(); }, { capture: true, passive: true });
  }
  pointers();
  held();
  canvas.addEventListener("dblclick", (event) => {
    const box = canvas.getBoundingClientRect();
    const at = [(event.clientX - box.left) / box.width * canvas.width, (event.clientY - box.top) / box.height * canvas.height];
    if (page && !broken && scene && !page.fly_to(...at)) say("nothing but sky there", ANSWER);
  });
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", async (event) => {
    event.preventDefault();
    const file = event.dataTransfer.files[0];
    if (file) await load(file.name, new Uint8Array(await file.arrayBuffer()));
  });
  element("file").addEventListener("change", async (event) => {
    const file = event.target.files[0];
    if (file) await load(file.name, new Uint8Array(await file.arrayBuffer()));
  });
  for (const button of document.querySelectorAll("[data-preset]")) {
    button.addEventListener("click", () => { if (page && !broken) page.preset(button.dataset.preset); });
  }
  element("repeat").addEventListener("change", (event) => { if (page && !broken) page.repeat(event.target.checked); });
  element("shot").addEventListener("click", () => { if (page && !broken && scene) screenshot(); });
  element("home").addEventListener("click", () => { if (page && !broken) page.key("Home", true); });
  element("mode").addEventListener("click", () => { if (page && !broken) page.key("KeyG", true); });
  element("full").addEventListener("click", () => document.documentElement.requestFullscreen?.());
}

/** For tests: the GPU's picture, the CPU's of the same view, and what the page says. */
globalThis.planecast = {
  state: () => ({
    gpu, scene, broken, firstPicture, fetched, fetchedAtFirst, words: element("words").textContent, adapter: gpu ? adapter : null,
    pose: page ? JSON.parse(page.pose()) : null, figures: page ? JSON.parse(page.figures()) : null,
  }),
  load,
  loadFrom,
  giveUp: () => load("giving-up", new Uint8Array(1), "giveUp"),
  picture: async () => {
    if (!gpu) return page.pixels();
    if (!page.read_picture()) return null;
    for (;;) {
      const bytes = page.picture();
      if (bytes) return bytes;
      await new Promise((done) => setTimeout(done, 5));
    }
  },
  cpuPicture: () => page.cpu_picture(),
};

events();
requestAnimationFrame(tick);
try {
  say("loading");
  const answer = await fetch(new URL("planecast_web_bg.wasm", import.meta.url));
  program = await WebAssembly.compile(await answer.arrayBuffer());
  await init({ module_or_path: program });
  await open();
  const words = element("words").textContent;
  const [view, path] = [location.hash, asked.get("scene") ?? "demo.pcast"];
  // A small screen has no room for it at first.
  element("panel").open = innerWidth > 640;
  if (await loadFrom(path, view) && !gpu) say(words, FACT);
} catch (error) {
  wrong("the scene", error);
}
