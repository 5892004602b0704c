// Shows images, acknowledges each on arrival, moves the camera, and asks for what is at a click.

const sub = (a, b) => a.map((v, i) => v - b[i]);
const add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const unit = (a) => a.map((v) => v / Math.hypot(...a));

function turned(v, axis, angle) {  // Rodrigues
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(v.map((x) => x * c), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
}

function render({ model, el }) {
  const image = document.createElement("img");
  const note = document.createElement("div"), bar = document.createElement("div");
  image.draggable = false;
  image.alt = "The scene; drag to rotate, click to read its values";
  bar.style = "display:flex;gap:8px;align-items:center;font:13px system-ui,sans-serif;padding:4px 0";
  const button = (words, does) => {
    const made = Object.assign(document.createElement("button"), { type: "button", textContent: words });
    made.addEventListener("click", does);
    return made;
  };
  const by = document.createElement("select");
  by.ariaLabel = "Color by";
  by.append(...["", ...(model.get("names") ?? [])].map((name) => Object.assign(document.createElement("option"), { value: name, textContent: name || "own colors" })));
  by.addEventListener("change", () => model.send({ type: "set", color__by: by.value }));
  let plane = false;
  const cut = button("Plane", () => { plane = !plane; cut.ariaPressed = String(plane); model.send({ type: "set", cuts__plane: plane }); });
  const value = document.createElement("span");
  value.role = "status";
  const home = structuredClone(model.get("view"));
  bar.append(button("Fit", () => { Object.assign(view, structuredClone(home)); look(); }), cut, by, value);
  image.style = `width:100%;height:${model.get("height")}px;object-fit:fill;` +
    "touch-action:none;cursor:grab;display:block;background:#eee";
  note.style = "color:#b00;font:13px sans-serif";
  el.append(bar, image, note);
  const view = structuredClone(model.get("view"));

  const look = () => {
    const ratio = window.devicePixelRatio || 1;
    const size = [image.clientWidth * ratio, image.clientHeight * ratio].map(Math.round);
    if (size[0] > 0 && size[1] > 0) model.send({ type: "camera", ...view, size });
  };

  const rotate = (dx, dy) => {
    const up = unit(view.up);
    let away = turned(sub(view.eye, view.look_at), up, -dx * 0.008);
    const right = unit(cross(up, away));
    const tilted = turned(away, right, -dy * 0.008);
    if (Math.abs(dot(unit(tilted), up)) < 0.999) away = tilted;
    view.eye = add(view.look_at, away);
  };
  const move = (dx, dy) => {
    const away = sub(view.eye, view.look_at);
    const right = unit(cross(view.up, away)), up = unit(cross(away, right));
    const step = 2 * Math.hypot(...away) * Math.tan((view.fov * Math.PI) / 360) / image.clientHeight;
    for (const name of ["eye", "look_at"])
      view[name] = add(add(view[name], right, -dx * step), up, dy * step);
  };

  let held = null, pressed = null;
  image.addEventListener("pointerdown", (event) => {
    pressed = event.button === 0 ? [event.clientX, event.clientY] : null;
    held = event.button === 2 || event.shiftKey ? move : rotate;
    image.setPointerCapture(event.pointerId);
  });
  image.addEventListener("pointermove", (event) => {
    if (!held) return;
    held(event.movementX, event.movementY);
    look();
  });
  image.addEventListener("pointerup", (event) => {
    held = null;
    if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 5) return;
    const box = image.getBoundingClientRect();
    model.send({ type: "click", place: [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height] });
  });
  image.addEventListener("contextmenu", (event) => event.preventDefault());
  image.addEventListener("wheel", (event) => {
    event.preventDefault();
    const away = sub(view.eye, view.look_at), factor = Math.exp(event.deltaY * 0.001);
    view.eye = add(view.look_at, away, factor);
    look();
  }, { passive: false });

  let address = null;
  const heard = async (message, buffers) => {
    if (message.type === "said") value.textContent = message.text;
    if (message.type === "error") note.textContent = message.message;
    if (message.type !== "picture") return;
    const next = URL.createObjectURL(new Blob([buffers[0]], { type: "image/jpeg" }));
    image.src = next;
    try { await image.decode(); } catch { /* a newer one came */ }
    if (address) URL.revokeObjectURL(address);
    address = next;
    note.textContent = "";
    image.dataset.number = message.number;
    model.send({ type: "ack", number: message.number });
  };
  model.on("msg:custom", heard);
  const watcher = new ResizeObserver(look);
  watcher.observe(image);
  return () => {
    model.off("msg:custom", heard);
    watcher.disconnect();
    if (address) URL.revokeObjectURL(address);
  };
}

export default { render };
