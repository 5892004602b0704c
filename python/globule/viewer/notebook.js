// Shows images, acknowledges each on arrival, and asks for what is at a click; page/camera.js stands before it.

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
  bar.append(button("Fit", () => { Object.assign(camera.view, structuredClone(home)); look(); }), cut, by, value);
  image.style = `width:100%;height:${model.get("height")}px;object-fit:fill;` +
    "touch-action:none;cursor:grab;display:block;background:#eee";
  note.style = "color:#b00;font:13px sans-serif";
  el.append(bar, image, note);

  const look = () => {
    const ratio = window.devicePixelRatio || 1;
    const size = [image.clientWidth * ratio, image.clientHeight * ratio].map(Math.round);
    if (size[0] > 0 && size[1] > 0) model.send({ type: "camera", ...camera.view, size });
  };

  const camera = globuleCamera(look);
  Object.assign(camera.view, structuredClone(home));
  camera.attach(image);
  let pressed = null;
  image.addEventListener("pointerdown", (event) => { pressed = event.button === 0 ? [event.clientX, event.clientY] : null; });
  image.addEventListener("pointerup", (event) => {
    if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 5) return;
    const box = image.getBoundingClientRect();
    model.send({ type: "click", place: [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height] });
  });

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
