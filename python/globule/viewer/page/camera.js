// A camera that a person turns, moves and zooms with mouse, fingers and keys: of the page, and of a notebook's cell.
const globuleCamera = (changed) => {
  const sub = (a, b) => a.map((v, i) => v - b[i]), add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const length = Math.hypot(...a) || 1; return a.map((v) => v / length); };
  const turned = (v, axis, angle) => {  // Rodrigues
    const c = Math.cos(angle), s = Math.sin(angle);
    return add(add(v.map((x) => x * c), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
  };
  const view = {};  // eye, look_at, up; fov, degrees, or height
  let part = null;  // the element

  const away = () => sub(view.eye, view.look_at);
  const sides = () => { const right = unit(cross(view.up, away())); return [right, unit(cross(away(), right))]; };
  const slope = () => 2 * Math.tan((view.fov * Math.PI) / 360);
  const across = () => view.height ?? slope() * Math.hypot(...away());  // world units of the image's height
  const turn = (dx, dy) => {  // pixels
    const rate = (2 * Math.PI) / Math.max(800, part.clientHeight), up = unit(view.up);
    const around = turned(away(), up, -dx * rate), tilted = turned(around, unit(cross(up, around)), -dy * rate);
    view.eye = add(view.look_at, Math.abs(dot(unit(tilted), up)) < 0.9999 ? tilted : around);
    changed();
  };
  const shift = (by) => { view.eye = add(view.eye, by); view.look_at = add(view.look_at, by); changed(); };
  const pan = (dx, dy) => {
    const step = across() / part.clientHeight, [right, up] = sides();
    shift(add(right.map((v) => -v * dx * step), up, dy * step));
  };
  const zoom = (factor) => {
    if (view.height != null) view.height *= factor;
    else view.eye = add(view.look_at, away(), factor);
    changed();
  };

  // Keys that are held: W A S D Q E fly, arrows turn, + and - zoom
  const WAYS = { w: [0, 0, -1], s: [0, 0, 1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, 1, 0], q: [0, -1, 0] };
  const TURNS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const held = new Set();
  let before = 0;
  const fly = (now) => {
    if (!held.size) { before = 0; return; }
    const seconds = before ? Math.min(0.1, (now - before) / 1000) : 1 / 60, [right, up] = sides();
    before = now;
    for (const key of held) {
      if (WAYS[key]) {
        const far = 0.8 * seconds * across(), [x, y, z] = WAYS[key];
        if (z && view.height != null) zoom(1 + z * seconds);
        else shift(add(add(right.map((v) => v * x * far), up, y * far), unit(away()), z * far));
      } else if (TURNS[key]) turn(...TURNS[key].map((v) => 300 * seconds * v));
      else zoom(key === "-" ? 1 + seconds : 1 / (1 + seconds));
    }
    requestAnimationFrame(fly);
  };
  const key = (event) => {  // whether the camera uses it
    const name = event.key.length === 1 ? event.key.toLowerCase().replace("=", "+") : event.key;
    if (!view.eye || event.ctrlKey || event.metaKey || event.altKey || !(WAYS[name] || TURNS[name] || "+-".includes(name))) return false;
    if (!held.size) requestAnimationFrame(fly);
    held.add(name);
    return true;
  };
  addEventListener("keyup", (event) => { held.delete(event.key.length === 1 ? event.key.toLowerCase().replace("=", "+") : event.key); });
  addEventListener("blur", () => held.clear());

  // Mouse and fingers. `free` says whether a left drag or one finger turns the view.
  const attach = (element, free = () => true) => {
    const down = new Map();  // of pointers: where they are
    let way = turn;
    part = element;
    element.addEventListener("pointerdown", (event) => {
      if (!view.eye || (event.button === 0 && !down.size && !free())) return;
      down.set(event.pointerId, [event.clientX, event.clientY]);
      way = event.button > 0 || event.shiftKey ? pan : turn;
      element.setPointerCapture(event.pointerId);
    });
    element.addEventListener("pointermove", (event) => {
      const last = down.get(event.pointerId), here = [event.clientX, event.clientY];
      if (!last) return;
      const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
      down.set(event.pointerId, here);
      if (!other) return way(here[0] - last[0], here[1] - last[1]);
      pan((here[0] - last[0]) / 2, (here[1] - last[1]) / 2);
      zoom(Math.hypot(...sub(last, other)) / Math.max(1, Math.hypot(...sub(here, other))));
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) element.addEventListener(end, (event) => down.delete(event.pointerId));
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (view.eye) zoom(Math.exp(event.deltaY * [1, 16, 400][event.deltaMode] * (event.ctrlKey ? 0.01 : 0.001)));
    }, { passive: false });
  };

  // Where a point of the world is in the element, and how many pixels one world unit has there
  const project = (point) => {
    const [right, up] = sides(), from = sub(point, view.eye), depth = -dot(from, unit(away()));
    const scale = part.clientHeight / (view.height ?? slope() * Math.max(depth, 1e-9));
    return { x: part.clientWidth / 2 + scale * dot(from, right), y: part.clientHeight / 2 - scale * dot(from, up), scale, seen: depth > 0 };
  };
  return { view, attach, key, project, add, sub, dot, cross, unit, turned, sides };
};
