// Files are read here, by an instance of the program of its own: one that gives up takes neither the scene nor the page along.
import init, * as planecast from "./planecast_web.js";

let ready = null;
let reader = null;
let tiles = null;

const does = {
  start: (module) => { ready = init({ module_or_path: module }); },
  read: (name, bytes) => planecast.read(name, bytes),
  giveUp: () => planecast.give_up(),
  head: () => planecast.Reader.head(),
  open: (name, head, len) => { reader?.free(); reader = new planecast.Reader(name, head, len); },
  put: (at, bytes) => reader.put(at, bytes),
  // The finest level that is there, and what comes next.
  state: () => ({ level: reader.level(), progress: [...reader.progress()], wanted: [...reader.wanted()] }),
  scene: () => reader.scene(),
  // Of a world that comes in tiles: what is known of it, and a tile.
  tiles: (name) => { tiles?.free(); tiles = new planecast.Tiles(name); },
  facts: () => tiles.facts(),
  tile: (level, x, z, heights) => tiles.tile(level, x, z, heights),
  fetched: () => planecast.Tiles.fetched(),
};

onmessage = async ({ data: [id, what, ...given] }) => {
  try {
    await ready;
    const value = does[what](...given);
    postMessage({ id, value }, value instanceof Uint8Array ? [value.buffer] : []);
  } catch (error) {
    postMessage({ id, error: `${error?.message ?? error}`, gaveUp: error instanceof WebAssembly.RuntimeError });
  }
};
