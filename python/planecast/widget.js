// A world in a notebook: stills from the kernel, or the page in a frame of its own. One picture is asked for at a time, so that a
// slow kernel is never behind by more than one.

function render({ model, el }) {
  const root = document.createElement("div");
  root.className = "planecast";
  const picture = document.createElement("img");
  picture.draggable = false;
  picture.alt = "a world of voxels";
  const below = document.createElement("div");
  below.className = "planecast-below";
  const words = document.createElement("span");
  const label = document.createElement("label");
  const slider = document.createElement("input");
  const value = document.createElement("output");
  slider.type = "range";
  label.append("threshold ", slider, value);
  below.append(label, words);
  root.append(picture, below);
  el.append(root);

  let waiting = false;
  let wanted = null;
  let settle = 0;
  let url = null;

  function ask(pose) {
    wanted = pose;
    if (waiting) return;
    waiting = true;
    model.set("pose", wanted);
    wanted = null;
    model.save_changes();
  }

  function turned(change, draft) {
    const pose = { ...(wanted ?? model.get("pose")) };
    change(pose);
    ask({ ...pose, draft, n: Date.now() });
    clearTimeout(settle);
    // When the hand rests, the picture in full.
    if (draft) settle = setTimeout(() => turned(() => {}, false), 250);
  }

  function shown() {
    waiting = false;
    const frame = model.get("frame");
    if (frame && frame.byteLength) {
      const bytes = new Uint8Array(frame.buffer ?? frame, frame.byteOffset ?? 0, frame.byteLength);
      if (url) URL.revokeObjectURL(url);
      url = URL.createObjectURL(new Blob([bytes], { type: bytes[0] === 0x89 ? "image/png" : "image/jpeg" }));
      picture.src = url;
    }
    words.textContent = model.get("words");
    if (wanted) ask(wanted);
  }

  function sized() {
    const [width, height] = model.get("size");
    picture.style.width = `${width}px`;
    picture.style.aspectRatio = `${width} / ${height}`;
  }

  let last = null;
  picture.addEventListener("pointerdown", (event) => {
    picture.setPointerCapture(event.pointerId);
    last = [event.clientX, event.clientY];
  });
  picture.addEventListener("pointermove", (event) => {
    if (!last) return;
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
    last = [event.clientX, event.clientY];
    turned((pose) => {
      pose.yaw -= 0.4 * dx;
      pose.pitch = Math.max(-90, Math.min(90, pose.pitch - 0.4 * dy));
    }, true);
  });
  const end = () => { last = null; };
  picture.addEventListener("pointerup", end);
  picture.addEventListener("pointercancel", end);
  picture.addEventListener("wheel", (event) => {
    event.preventDefault();
    turned((pose) => { pose.nearer = Math.max(0.02, Math.min(50, pose.nearer * Math.exp(-event.deltaY / 500))); }, true);
  }, { passive: false });
  picture.addEventListener("dblclick", () => turned((pose) => Object.assign(pose, { yaw: 30, pitch: -25, nearer: 1 }), false));

  const range = model.get("slider");
  label.hidden = range.length === 0;
  if (range.length) {
    [slider.min, slider.max, slider.step] = range.map(String);
    slider.value = String(model.get("iso"));
    value.textContent = String(model.get("iso"));
    model.on("change:iso", () => { slider.value = value.textContent = String(model.get("iso")); });
    slider.addEventListener("input", () => { value.textContent = slider.value; });
    slider.addEventListener("change", () => {
      model.set("iso", Number(slider.value));
      model.save_changes();
    });
  }

  // The page instead of the picture, as soon as it says that it is there.
  let page = null;
  function paged() {
    page?.remove();
    page = null;
    picture.hidden = false;
    const address = model.get("page");
    if (!address) return;
    const [width, height] = model.get("size");
    page = document.createElement("iframe");
    page.allow = "fullscreen";
    page.style.width = `${width}px`;
    page.style.height = `${height}px`;
    page.hidden = true;
    const mine = page;
    // Loads in any case, even as an error: only what answers is shown.
    fetch(new URL("index.html", address), { mode: "no-cors" }).then(() => {
      if (mine !== page) return;
      mine.hidden = false;
      picture.hidden = true;
    }, () => mine.remove());
    page.src = address;
    root.prepend(page);
  }

  model.on("change:drawn", shown);
  model.on("change:size", sized);
  model.on("change:page", paged);
  sized();
  shown();
  paged();
  return () => {
    clearTimeout(settle);
    if (url) URL.revokeObjectURL(url);
  };
}

export default { render };
