// Events, files and words of the page; scene, camera and kernels are in planecast_web.wasm.
//
// Address: ?scene=URL opens that file in place of the demo; ?device=cpu draws without WebGPU; ?size=WxH fixes the picture.
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

const say = (text) => { element("words").textContent = text; };

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

async function open() {
  if (asked.get("device") === "cpu") {
    say("Drawing on the CPU, one thread, as the address asks for.");
  } else if (!navigator.gpu) {
    say(isSecureContext
      ? `This browser has no WebGPU: drawing on the CPU, one thread, with fewer pixels. ${NEEDS}.`
      : "WebGPU needs a secure page (https, or http://localhost): drawing on the CPU, one thread, with fewer pixels.");
  } else {
    const found = await navigator.gpu.requestAdapter();
    if (found) {
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

/** Gives the picture the canvas's own pixels; a quarter of them where the CPU draws. */
function fit() {
  const fixed = asked.get("size")?.match(/^(\d+)x(\d+)$/);
  const scale = (gpu ? devicePixelRatio : 0.5);
  const size = fixed ? [Number(fixed[1]), Number(fixed[2])] : [innerWidth * scale, innerHeight * scale];
  const [width, height] = size.map((n) => Math.max(1, Math.min(8192, Math.round(n))));
  if (canvas.width !== width || canvas.height !== height || !page) {
    [canvas.width, canvas.height] = [width, height];
    page?.resize(width, height);
  }
}

async function load(name, bytes) {
  if (broken) return false;
  try {
    say(`reading ${name}`);
    // So that the words are on the screen before the work begins.
    await new Promise((done) => setTimeout(done));
    scene = JSON.parse(page.load(name, bytes));
    scene.name = name;
    say("");
    return true;
  } catch (error) {
    wrong(name, error);
    return false;
  }
}

async function fetchBytes(url) {
  const answer = await fetch(url);
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
    say(`${url}: ${(n / 1e6).toFixed(1)}${total >= n ? ` of ${(total / 1e6).toFixed(1)}` : ""} MB`);
  }
  const bytes = new Uint8Array(n);
  let at = 0;
  for (const part of parts) { bytes.set(part, at); at += part.length; }
  return bytes;
}

const nameOf = (url) => decodeURIComponent(new URL(url, location.href).pathname.split("/").pop() || "scene");

let then = performance.now();
let shown = [];
function tick(now) {
  requestAnimationFrame(tick);
  if (!page || broken) return;
  const seconds = (now - then) / 1000;
  then = now;
  try {
    fit();
    if (page.frame(Math.max(0, seconds))) {
      shown.push(now);
      if (!gpu) paint();
    }
  } catch (error) {
    wrong("drawing", error);
    return;
  }
  // Figures come when the picture is done, not when it is asked for.
  if (scene && firstPicture === null) {
    const f = JSON.parse(page.figures());
    if (f.gpu_ms ?? f.cpu_ms) firstPicture = performance.now() - began;
  }
  while (now - shown[0] > 1000) shown.shift();
  if (scene && element("panel").open) figures();
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
    `${scene.name}: ${scene.dims.join(" × ")} voxels, ${scene.levels} levels, ${(scene.bytes / 1e6).toFixed(1)} MB`,
    `${gpu ? adapter : "cpu"}, ${canvas.width} × ${canvas.height}, ${shown.length} frames/s`,
    `ms: ${stages}`,
    `${f.planes} planes, ${f.columns_visited} columns, ${f.runs_visited} runs`,
    `eye ${p.eye.map((v) => v.toFixed(1)).join(", ")}, yaw ${p.yaw.toFixed(0)}°, pitch ${p.pitch.toFixed(0)}°`,
    `${p.mode}, ${p.speed.toFixed(1)} voxels/s`,
  ].join("\n");
}

function events() {
  let dragging = false;
  const typing = (event) => event.target instanceof HTMLInputElement && event.target.type !== "checkbox";
  addEventListener("keydown", (event) => {
    if (!page || broken || typing(event) || event.metaKey || event.altKey) return;
    if (event.code === "KeyM") canvas.requestPointerLock?.();
    if (page.key(event.code, true)) event.preventDefault();
  });
  addEventListener("keyup", (event) => { if (page && !broken) page.key(event.code, false); });
  addEventListener("blur", () => { if (page && !broken) page.release(); });
  canvas.addEventListener("pointerdown", (event) => { dragging = true; canvas.setPointerCapture(event.pointerId); canvas.focus(); });
  canvas.addEventListener("pointerup", () => { dragging = false; });
  canvas.addEventListener("pointermove", (event) => {
    if (page && !broken && (dragging || document.pointerLockElement === canvas)) page.look(event.movementX, event.movementY);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (page && !broken) page.wheel(-Math.sign(event.deltaY));
  }, { passive: false });
  canvas.addEventListener("dblclick", (event) => {
    const box = canvas.getBoundingClientRect();
    const at = [(event.clientX - box.left) / box.width * canvas.width, (event.clientY - box.top) / box.height * canvas.height];
    if (page && !broken && scene && !page.fly_to(...at)) say("nothing but sky there");
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
  element("full").addEventListener("click", () => document.documentElement.requestFullscreen?.());
}

/** For tests: the GPU's picture, the CPU's of the same view, and what the page says. */
globalThis.planecast = {
  state: () => ({
    gpu, scene, broken, firstPicture, words: element("words").textContent, adapter: gpu ? adapter : null,
    pose: page ? JSON.parse(page.pose()) : null, figures: page ? JSON.parse(page.figures()) : null,
  }),
  load,
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
  await init();
  await open();
  const words = element("words").textContent;
  const url = asked.get("scene") ?? "demo.pcast";
  const bytes = await fetchBytes(url);
  if (await load(nameOf(url), bytes) && !gpu) say(words);
} catch (error) {
  wrong("the scene", error);
}
