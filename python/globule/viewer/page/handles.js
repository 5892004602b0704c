// Handles in the image: an arrow for each axis, and rings for those that turn. A person drags them, or moves the one
// that has the focus with the arrow keys; see page/panel.py.
globule.handles = (camera, say) => {
  const NS = "http://www.w3.org/2000/svg", SPACE = 700;  // ms after which a handle follows the server again
  const make = (tag, facts, ...inside) => {
    const made = document.createElementNS(NS, tag);
    for (const [name, value] of Object.entries(facts)) made.setAttribute(name, value);
    made.append(...inside);
    return made;
  };
  const all = make("svg", { id: "globule-handles", role: "group", "aria-label": "Handles in the image" });
  const known = new Map();  // name: facts, element, parts
  const { add, dot, cross, unit, turned, project, sides } = camera;
  const long = () => 90 * parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--u"));
  const places = (one) => ({ at: project(one.at), length: long() / project(one.at).scale });

  // The way on the screen, pixels, of a small step of a part
  const flow = (one, part) => {
    const { at, length } = places(one), eps = 1e-3 * length;
    const [from, by] = part.ring ? [add(one.at, part.from, length), cross(one.axes[part.k], part.from).map((v) => v * length)] : [one.at, one.axes[part.k]];
    const a = part.ring ? project(from) : at, b = project(add(from, by, part.ring ? 1e-3 : eps)), step = part.ring ? 1e-3 : eps;
    const way = [(b.x - a.x) / step, (b.y - a.y) / step], least = 0.25 * (part.ring ? long() : at.scale);
    return Math.hypot(...way) > least ? way : [0, -least];  // along the line of sight: upwards comes nearer
  };
  const pull = (one, part, amount) => {
    if (part.ring) {
      one.axes = one.axes.map((axis, k) => (k === part.k ? axis : turned(axis, one.axes[part.k], amount)));
      part.from = turned(part.from, one.axes[part.k], amount);
    } else one.at = add(one.at, one.axes[part.k], amount);
    moved(one);
  };
  const swing = (one, dx, dy) => {  // pixels of the tip
    const [right, up] = sides(), { length } = places(one), pixel = length / long();
    one.axes = [unit(add(add(one.axes[0].map((v) => v * length), right, dx * pixel), up, -dy * pixel))];
    moved(one);
  };
  const moved = (one) => {
    one.touched = Date.now();
    draw();
    if (!one.due) one.due = requestAnimationFrame(() => { one.due = 0; if (known.get(one.name) === one) say("handle", [one.name, one.at, one.three()]); });
  };
  const grab = (one, part) => {
    let last = null;
    part.made.addEventListener("pointerdown", (e) => {
      if (e.button !== 0) return;
      e.stopPropagation(); e.preventDefault();
      part.made.setPointerCapture(e.pointerId); part.made.focus({ preventScroll: true });
      last = [e.clientX, e.clientY]; one.held = true;
      if (part.ring) part.from = nearest(one, part, last);
    });
    part.made.addEventListener("pointermove", (e) => {
      if (!last) return;
      const way = flow(one, part), by = [e.clientX - last[0], e.clientY - last[1]];
      last = [e.clientX, e.clientY];
      if (one.swings) return swing(one, ...by);
      pull(one, part, (by[0] * way[0] + by[1] * way[1]) / (way[0] ** 2 + way[1] ** 2));
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) part.made.addEventListener(end, () => { last = null; one.held = false; });
    part.made.addEventListener("keydown", (e) => {
      const way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[e.key];
      if (!way) return;
      e.preventDefault(); e.stopPropagation();
      if (one.swings) swing(one, ...(/[RL]/.test(e.key) ? [8 * way, 0] : [0, -8 * way]));
      else pull(one, part, way * (part.ring ? Math.PI / 36 : places(one).length / 12));
    });
  };
  const around = (one, k, n) => {  // n unit vectors of a ring
    const [u, v] = [one.axes[(k + 1) % 3], one.axes[(k + 2) % 3]];
    return Array.from({ length: n }, (_, i) => add(u.map((x) => x * Math.cos((2 * Math.PI * i) / n)), v, Math.sin((2 * Math.PI * i) / n)));
  };
  const nearest = (one, part, [x, y]) => {
    const { length } = places(one), far = (way) => { const p = project(add(one.at, way, length)); return Math.hypot(p.x - x, p.y - y); };
    return around(one, part.k, 72).reduce((best, way) => (far(way) < far(best) ? way : best));
  };

  const draw = () => {
    if (!camera.view.eye) return;
    for (const one of known.values()) {
      const { at, length } = places(one);
      one.made.style.display = at.seen ? "" : "none";
      for (const part of one.parts) {
        let path;
        if (part.ring) path = `M${around(one, part.k, 48).map((way) => { const p = project(add(one.at, way, length)); return `${p.x.toFixed(1)} ${p.y.toFixed(1)}`; }).join("L")}Z`;
        else {
          const tip = project(add(one.at, one.axes[part.k], length));
          path = `M${at.x.toFixed(1)} ${at.y.toFixed(1)}L${tip.x.toFixed(1)} ${tip.y.toFixed(1)}`;
          part.tip.setAttribute("cx", tip.x.toFixed(1)); part.tip.setAttribute("cy", tip.y.toFixed(1));
        }
        for (const line of part.lines) line.setAttribute("d", path);
        part.made.setAttribute("aria-valuenow", (part.ring ? 0 : dot(one.at, one.axes[part.k])).toPrecision(4));
      }
    }
  };
  const begin = (facts) => {
    const one = { ...facts, made: make("g", { "data-handle": facts.name }), parts: [] };
    one.three = () => [0, 1, 2].map((k) => one.axes[k] ?? one.axes[0]);
    const colors = facts.axes.length > 1 ? ["x", "y", "z"] : [facts.swings ? "sun" : "normal"];
    for (const ring of facts.turns ? [true, false] : [false]) {
      colors.forEach((color, k) => {
        const lines = ["wide", "edge", "line"].map((name) => make("path", { class: name }));
        const part = { k, ring, lines, tip: make("circle", { r: 8 }), from: [1, 0, 0] };
        const label = facts.swings ? `${facts.label}, direction` : `${facts.label}, ${ring ? "around" : "along"} ${color === "normal" ? "its normal" : color}`;
        part.made = make("g", { class: color, role: "slider", tabindex: "0", "aria-label": label, "aria-valuenow": "0" }, make("title", {}), ...lines, ...(ring ? [] : [part.tip]));
        part.made.firstChild.textContent = `${label}: drag, or use the arrow keys`;
        if (ring) part.from = facts.axes[(k + 1) % 3];
        grab(one, part);
        one.parts.push(part); one.made.append(part.made);
      });
    }
    known.set(one.name, one); all.append(one.made);
    return one;
  };
  const take = (handles) => {
    const gone = new Set(known.keys());
    for (const facts of handles) {
      gone.delete(facts.name);
      const one = known.get(facts.name) ?? begin(facts);
      if (!one.held && Date.now() - (one.touched ?? 0) > SPACE) { one.at = facts.at; one.axes = facts.axes; }
    }
    for (const name of gone) { known.get(name).made.remove(); known.delete(name); }
    draw();
  };
  return { all, take, draw };
};
