// Toolbar, timeline, list of layers and hints over the image; see desk.py.
(() => {
  const ICONS = {
    Rotate: "M4 12a8 8 0 1 0 3-6M4 4v4h4M12 9v6M9 12h6",
    Measure: "M3 17 17 3l4 4L7 21zM8 12l2 2M11 9l2 2M14 6l2 2",
    Cut: "M6 6l12 12M18 6 6 18M4 19a2.5 2.5 0 1 0 4 0 2.5 2.5 0 1 0-4 0M16 19a2.5 2.5 0 1 0 4 0 2.5 2.5 0 1 0-4 0",
    Grasp: "M7 12V6a2 2 0 0 1 4 0v5V4a2 2 0 0 1 4 0v7V6a2 2 0 0 1 4 0v8a7 7 0 0 1-13 3l-3-5z",
    Suction: "M6 3v10a6 6 0 0 0 12 0V3M12 13v8",
    plane: "M12 3 4 7v10l8 4 8-4V7zM2 19 22 5",
    fit: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
    undo: "M9 14 4 9l5-5M4 9h10a6 6 0 0 1 0 12h-3",
    redo: "M15 14l5-5-5-5M20 9H10a6 6 0 0 0 0 12h3",
    camera: "M4 8h3l2-3h6l2 3h3v11H4zM12 10a3.5 3.5 0 1 0 0 7 3.5 3.5 0 1 0 0-7",
    film: "M3 7h12v10H3zM15 11l6-3v8l-6-3",
    layers: "M12 3 3 8l9 5 9-5zM3 12l9 5 9-5M3 16l9 5 9-5",
    moon: "M20 14A8 8 0 1 1 10 4a6.5 6.5 0 0 0 10 10",
    help: "M9 9a3 3 0 1 1 4 3c-1 .6-1 1-1 2M12 18v.1",
    play: "M7 4l13 8-13 8z", pause: "M8 5v14M16 5v14", back: "M17 5 8 12l9 7zM6 5v14",
    next: "M7 5l9 7-9 7zM18 5v14", loop: "M4 12a7 7 0 0 1 12-5l3 3M20 12a7 7 0 0 1-12 5l-3-3M19 5v5h-5M5 19v-5h5",
    disk: "M5 4h11l4 4v12H4V4zM8 4v5h7V4M8 20v-6h8v6",
    close: "M6 6l12 12M18 6 6 18",
    reset: "M5 5v6h6M5 11a8 8 0 1 1 2 6", eye: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12M12 9a3 3 0 1 0 0 6 3 3 0 1 0 0-6",
    sliders: "M4 7h9M17 7h3M15 4v6M4 17h3M11 17h9M9 14v6",
    off: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12M4 4l16 16",
  };
  const narrow = matchMedia("(max-width: 640px)");
  const HINTS = [
    matchMedia("(pointer: coarse)").matches
      ? "Drag to rotate, pinch to zoom, drag with two fingers to pan. The frame in the toolbar shows everything again."
      : "Drag to rotate, turn the wheel to zoom, right-drag to pan. Press F to see everything again.",
    "Click the surface to read its values. The toolbar measures, cuts, saves an image and records a movie.",
    narrow.matches
      ? "Layers in the toolbar colors by value. The sliders in the toolbar open all settings."
      : "The list of layers at the left colors by value. The panel at the right has all settings; H lists all keys.",
  ];
  const kept = (name, usual) => { try { return localStorage.getItem("globule-" + name) ?? usual; } catch { return usual; } };
  const keep = (name, value) => { try { localStorage.setItem("globule-" + name, value); } catch { /* private window */ } };
  let socket, model, wait = 500, sent = 0;
  const say = (name, value) => { if (socket?.readyState === 1) socket.send(JSON.stringify({ do: name, value })); };
  const set = (values) => say("set", values);

  const make = (tag, facts = {}, ...inside) => {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(facts))
      name.startsWith("on") ? made.addEventListener(name.slice(2), value) : made.setAttribute(name, value);
    made.append(...inside);
    return made;
  };
  const icon = (name) => {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    svg.setAttribute("viewBox", "0 0 24 24"); svg.setAttribute("aria-hidden", "true");
    const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    path.setAttribute("d", ICONS[name]); svg.append(path);
    return svg;
  };
  const button = (name, label, does, hint) => make("button", { "aria-label": label, title: hint || label, type: "button", onclick: does }, icon(name));
  const draw = (made, name) => { if (made.dataset.icon !== name) { made.dataset.icon = name; made.replaceChildren(icon(name)); } };

  // What stands where
  const desk = make("div", { id: "globule-desk", role: "region", "aria-label": "Tools, layers and time", hidden: "" });
  const tools = make("div", { class: "bar tools", role: "toolbar", "aria-label": "Tools" });
  const layers = make("section", { class: "bar layers", "aria-label": "Layers" });
  const time = make("div", { class: "bar time", role: "group", "aria-label": "Timeline", hidden: "" });
  const hint = make("div", { class: "card hint", role: "status", hidden: "" });
  const split = make("div", { class: "split", role: "slider", tabindex: "0", "aria-label": "Divider between the two data sets", "aria-valuemin": "0", "aria-valuemax": "100", hidden: "" });
  const plots = make("section", { class: "bar plots", "aria-label": "Plots", hidden: "" });
  const people = make("div", { class: "card people", role: "status", hidden: "" });
  const said = make("div", { class: "card said", role: "status", hidden: "" });
  const force = make("div", { class: "force", "aria-hidden": "true", hidden: "" });
  desk.append(tools, layers, time, plots, hint, split, people, said, force);

  const of = {
    plane: button("plane", "Cutting plane", () => set({ cuts__plane: !model.plane }), "Cutting plane on or off; drag its handles (key C)"),
    fit: button("fit", "Fit the whole scene", () => say("fit"), "Show the whole scene (key F)"),
    undo: button("undo", "Undo the last change", () => say("undo"), "Undo the last change of a setting, or the last cut of tissue (Ctrl+Z)"),
    redo: button("redo", "Redo the setting", () => say("redo"), "Redo (Ctrl+Shift+Z)"),
    camera: button("camera", "Screenshot", () => say("picture"), "Download a screenshot (key P); its size is set in Save and record"),
    disk: button("disk", "Save the view", () => say("state"), "Download all settings and the camera as a file; Load settings opens it again"),
    film: button("film", "Movie", () => say("record"), "Record a movie; press again to stop and download it (key R)"),
    layers: button("layers", "Layers", () => open(layers.hidden), "List of layers: color, surface, material"),
    moon: button("moon", "Dark or light", () => paint(!desk.classList.contains("dark"), true), "Dark or light page"),
    sliders: button("sliders", "All settings", () => settings(!document.documentElement.classList.contains("globule-settings")), "Show or hide the panel of all settings"),
    help: button("help", "Hints", () => tour(0), "Show the three hints again"),
  };
  const choices = {};
  const row = () => {
    const hints = { Rotate: "Rotate the view; click to read values (key T: next tool)", Measure: "Measure the distance of two clicks", Cut: "Draw a line across the surface to cut it", Grasp: "Drag a part of the surface", Suction: "Drag over the fluid to remove it" };
    for (const name of model.tools) {
      const first = name.split(",")[0];
      choices[name] = button(first in ICONS ? first : "Rotate", first, () => say("tool", name), hints[first]);
    }
    const gap = () => make("hr", { "aria-hidden": "true" });
    tools.replaceChildren(...Object.values(choices), of.plane, gap(), of.fit, of.undo, of.redo, gap(), of.camera, of.film, of.disk, gap(), of.layers, of.sliders, of.moon, of.help);
    of.sliders.classList.add("only-narrow");
    // Names below the icons, where the window is wide enough; the buttons' own names contain them
    const words = { plane: "Plane", fit: "Fit", undo: "Undo", redo: "Redo", camera: "Screenshot", film: "Movie", disk: "Save", layers: "Layers", sliders: "Settings", moon: "Dark", help: "Hints" };
    const labels = [...Object.entries(choices).map(([name, made]) => [made, name.split(",")[0]]), ...Object.entries(words).map(([key, word]) => [of[key], word])];
    for (const [made, word] of labels) made.append(make("span", { class: "word", "aria-hidden": "true" }, word));
  };

  // The list of layers
  const list = make("div");
  const field = (label, hintText, does) => {
    const select = make("select", { title: hintText, onchange: () => does(select.value) });
    return [make("label", {}, label, select), select];
  };
  const [byLabel, by] = field("Color by", "Color the particles by a field or attribute", (v) => set({ color__by: v }));
  const [shapeLabel, shape] = field("Surface", "smooth: one surface around a fluid; auto decides by the particles", (v) => set({ surface__shape: v }));
  const [presetLabel, preset] = field("Material", "Material, lights and surroundings", (v) => set({ look__preset: v }));
  const plot = make("canvas", { class: "plot", role: "img", tabindex: "0", width: "432", height: "128" });
  const ends = make("div", { class: "ends" });
  const all = make("button", { type: "button", class: "text", title: "Color map from the lowest to the highest value", onclick: () => set({ color__automatic: true }) }, "Whole range");
  const graph = make("div", { hidden: "" }, plot, ends, all);
  layers.append(make("h2", {}, "Layers"), list, byLabel, graph, shapeLabel, presetLabel);
  const fill = (select, options, value) => {
    const words = options.map(([v, t]) => v + "\n" + t).join("\n");
    if (select.dataset.words !== words) {
      select.dataset.words = words;
      select.replaceChildren(...options.map(([v, t]) => make("option", { value: v }, t)));
    }
    if (document.activeElement !== select || select.value !== value) select.value = value;
  };
  const settings = (on) => {
    document.documentElement.classList.toggle("globule-settings", on);
    of.sliders.setAttribute("aria-pressed", String(on));
    if (on && narrow.matches) open(false);
  };
  const open = (on) => { if (on && narrow.matches) settings(false); layers.hidden = !on; of.layers.setAttribute("aria-pressed", String(on)); keep("layers", on ? "1" : "0"); };
  const hide = (i, on) => {
    const gone = model.layers.map((one, k) => ((k === i ? !on : !one.shown) ? k + 1 : 0)).filter(Boolean);
    if (gone.length < model.layers.length) set({ layers__hidden: gone.join(" ") });
  };
  const short = (v) => Number(v.toPrecision(4)).toString();

  // The histogram; a drag over it chooses the range of the color map
  let brush = null;
  const value = (event) => {
    const box = plot.getBoundingClientRect(), share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    return model.plot.lo + share * (model.plot.hi - model.plot.lo);
  };
  plot.addEventListener("pointerdown", (e) => { if (model.plot && model.role !== "look") { brush = [value(e), value(e)]; plot.setPointerCapture(e.pointerId); } });
  plot.addEventListener("pointermove", (e) => { if (brush) { brush[1] = value(e); bars(); } });
  plot.addEventListener("pointerup", () => {
    if (!brush) return;
    const [a, b] = [Math.min(...brush), Math.max(...brush)];
    brush = null;
    if (b - a > 0.01 * (model.plot.hi - model.plot.lo)) set({ color__automatic: false, color__low: a, color__high: b });
    else bars();
  });
  const bars = () => {
    const { counts, colors, lo, hi, name } = model.plot, pen = plot.getContext("2d"), w = plot.width, h = plot.height;
    const most = Math.log1p(Math.max(...counts, 1)), step = w / counts.length;
    pen.clearRect(0, 0, w, h);
    counts.forEach((n, i) => {
      pen.fillStyle = `rgb(${colors[i].join()})`;
      const tall = (h - 2) * Math.log1p(n) / most;
      pen.fillRect(i * step, h - tall, step - 1, tall);
    });
    const [a, b] = brush ? [Math.min(...brush), Math.max(...brush)] : [model.plot.from, model.plot.to];
    pen.fillStyle = "#ffffffa0";
    const x = (v) => w * Math.min(1, Math.max(0, (v - lo) / (hi - lo)));
    pen.fillRect(0, 0, x(a), h); pen.fillRect(x(b), 0, w - x(b), h);
    plot.setAttribute("aria-label", `Histogram of ${name}, ${short(lo)} to ${short(hi)}, logarithmic; colors from ${short(a)} to ${short(b)}`);
    plot.title = "How often each value occurs (logarithmic). Drag to choose the range of the colors.";
    ends.replaceChildren(make("span", {}, short(lo)), make("span", {}, `${short(a)} … ${short(b)}`), make("span", {}, short(hi)));
  };

  // Curves: along the measured line, and over time
  const closing = button("close", "Remove the measurement", () => set({ measure__shown: false }), "Remove the measured line and its plot");
  const lineTitle = make("span"), lineRead = make("div", { class: "ends" });
  const linePlot = make("canvas", { class: "plot", role: "img", tabindex: "0", width: "560", height: "176" });
  const lineBox = make("div", { hidden: "" }, make("div", { class: "row" }, lineTitle, closing), linePlot, lineRead);
  const seriesOf = make("select", { title: "What is plotted over the simulated time", "aria-label": "Plot over time", onchange: () => say("series", seriesOf.value) });
  const seriesRead = make("div", { class: "ends" });
  const seriesPlot = make("canvas", { class: "plot", role: "img", tabindex: "0", width: "560", height: "176" });
  const seriesBox = make("div", { hidden: "" }, seriesOf, seriesPlot, seriesRead);
  plots.append(lineBox, seriesBox);
  const curve = (canvas, read, data, xUnit, yUnit, hint, brushed) => {
    const pen = canvas.getContext("2d"), w = canvas.width, h = canvas.height, edge = 4;
    const known = data.y.filter((v) => v !== null);
    const [lo, hi] = [Math.min(...known), Math.max(...known)], x0 = data.x[0], x1 = data.x.at(-1);
    const px = (v) => edge + (w - 2 * edge) * (v - x0) / (x1 - x0 || 1), py = (v) => h - edge - (h - 2 * edge) * (v - lo) / (hi - lo || 1);
    const at = canvas.at;
    pen.clearRect(0, 0, w, h);
    if (brushed) { pen.fillStyle = "#c9dcf2"; pen.fillRect(px(Math.min(...brushed)), 0, Math.abs(px(brushed[1]) - px(brushed[0])), h); }
    pen.strokeStyle = "#1f5c9e"; pen.lineWidth = 3; pen.beginPath();
    data.y.forEach((v, i) => v !== null && (i && data.y[i - 1] !== null ? pen.lineTo(px(data.x[i]), py(v)) : pen.moveTo(px(data.x[i]), py(v))));
    pen.stroke();
    const words = (v, unit) => (unit ? `${short(v)} ${unit}` : short(v));
    if (at !== undefined && data.y[at] !== null && at < data.y.length) {
      pen.fillStyle = "#b3261e"; pen.beginPath(); pen.arc(px(data.x[at]), py(data.y[at]), 7, 0, 7); pen.fill();
      read.replaceChildren(make("span", {}, `at ${words(data.x[at], xUnit)}: ${words(data.y[at], yUnit)}`));
    } else read.replaceChildren(make("span", {}, words(x0, xUnit)), make("span", {}, known.length ? `${short(lo)} … ${words(hi, yUnit)}` : "no particles here"), make("span", {}, words(x1, xUnit)));
    canvas.title = hint;
    canvas.setAttribute("aria-label", `${data.name} from ${words(x0, xUnit)} to ${words(x1, xUnit)}: ${known.length ? `${short(lo)} to ${words(hi, yUnit)}` : "no values"}`);
  };
  let chosen = null;  // part of the line, while it is brushed
  const drawLine = () => curve(linePlot, lineRead, model.line, model.line.unit, "", "Point at the curve to read it; drag to color the range of these values", chosen);
  const drawSeries = () => curve(seriesPlot, seriesRead, model.series, "s", model.series.unit, "Point at the curve to read it (arrow keys, too)");
  const nearest = (canvas, data, event) => {
    const box = canvas.getBoundingClientRect(), share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    const x = data.x[0] + share * (data.x.at(-1) - data.x[0]);
    return data.x.reduce((best, v, i) => (Math.abs(v - x) < Math.abs(data.x[best] - x) ? i : best), 0);
  };
  for (const [canvas, key, redraw] of [[linePlot, "line", drawLine], [seriesPlot, "series", drawSeries]]) {
    canvas.addEventListener("pointermove", (e) => { if (model[key]) { canvas.at = nearest(canvas, model[key], e); if (chosen && key === "line") chosen[1] = model.line.x[canvas.at]; redraw(); } });
    canvas.addEventListener("pointerleave", () => { canvas.at = undefined; if (model[key]) redraw(); });
    canvas.addEventListener("keydown", (e) => {
      const way = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
      if (way && model[key]) { canvas.at = Math.min(model[key].x.length - 1, Math.max(0, (canvas.at ?? -1) + way)); redraw(); }
    });
  }
  linePlot.addEventListener("pointerdown", (e) => {
    if (!model.color.by || model.role === "look") return;
    linePlot.setPointerCapture(e.pointerId);
    chosen = Array(2).fill(model.line.x[nearest(linePlot, model.line, e)]);
  });
  linePlot.addEventListener("pointerup", () => {
    if (!chosen) return;
    const [a, b] = [Math.min(...chosen), Math.max(...chosen)];
    const inside = model.line.y.filter((v, i) => v !== null && model.line.x[i] >= a && model.line.x[i] <= b);
    chosen = null;
    const [low, high] = [Math.min(...inside), Math.max(...inside)];
    if (high > low) set({ color__automatic: false, color__low: low, color__high: high });
    drawLine();
  });

  // The timeline
  const run = button("play", "Play or pause", () => say("play"), "Play or pause (space bar)");
  const goto = (i) => (model.time.kind === "simulation" ? say("time", i) : set({ time__playing: false, time__frame: Math.min(model.time.frames - 1, Math.max(0, i)) }));
  const back = button("back", "Previous frame", () => goto(model.time.frame - 1));
  const next = button("next", "Next frame", () => (model.time.kind === "sequence" ? goto(model.time.frame + 1) : say("step")), "One frame or step forward");
  const scrub = make("input", { type: "range", min: "0", "aria-label": "Position in time", title: "Drag to any time that has passed", oninput: () => { sent = Date.now(); goto(Number(scrub.value)); } });
  const again = button("loop", "Repeat", () => set({ time__loop: !model.time.loop }), "Begin again after the last frame");
  const reset = button("reset", "From the beginning", () => say("reset"), "Start the simulation again");
  const words = make("span");
  time.append(run, back, scrub, next, words, again, reset);

  // Hints
  let shown = HINTS.length;
  const done = (i) => { if (shown === i) tour(i + 1); };  // a person has done what the hint says
  const tour = (i) => {
    shown = i;
    hint.hidden = i >= HINTS.length;
    if (hint.hidden) { keep("hints", "seen"); return; }
    const last = i === HINTS.length - 1;
    hint.replaceChildren(
      make("p", {}, `${i + 1} of ${HINTS.length}. ${HINTS[i]}`),
      make("button", { type: "button", class: "text", onclick: () => tour(i + 1) }, last ? "Done" : "Next hint"),
      ...(last ? [] : [" ", make("button", { type: "button", class: "text", onclick: () => tour(HINTS.length) }, "Skip")]));
  };

  let pressed = null;  // where a mouse went down on the image
  addEventListener("pointerdown", (e) => { pressed = e.target.closest("#globule-desk, .mantine-Paper-root") ? null : [e.clientX, e.clientY]; }, true);
  addEventListener("pointerup", (e) => {
    if (pressed) done(Math.hypot(e.clientX - pressed[0], e.clientY - pressed[1]) > 8 ? 0 : 1);
    pressed = null;
  }, true);
  tools.addEventListener("click", (e) => { if (e.target.closest("button") !== of.help) done(1); });
  layers.addEventListener("change", () => done(2));

  // Two data sets side by side
  const divide = (share) => { if (model.role === "look") return; sent = Date.now(); split.style.left = `${100 * share}%`; set({ compare__at: Math.min(1, Math.max(0, share)) }); };
  split.addEventListener("pointerdown", (e) => split.setPointerCapture(e.pointerId));
  split.addEventListener("pointermove", (e) => { if (e.buttons) { const box = desk.getBoundingClientRect(); divide((e.clientX - box.left) / box.width); } });
  split.addEventListener("keydown", (e) => {
    const way = { ArrowLeft: -0.02, ArrowRight: 0.02 }[e.key];
    if (way) divide(Math.min(1, Math.max(0, model.compare + way)));
  });

  // The force on a hand that holds tissue, beside its pointer; the server says it, "" for none
  let pulls = false, corner;
  const feel = (words) => {
    if (force.textContent !== words) force.textContent = words;
    force.hidden = !pulls || !words;
  };
  const follow = (e) => { force.style.translate = `${e.clientX - corner.left}px ${e.clientY - corner.top}px`; };  // without a new layout
  addEventListener("pointerdown", (e) => { pulls = model?.tool === "Grasp" && !e.target.closest("#globule-desk, .mantine-Paper-root"); if (pulls) { corner = desk.getBoundingClientRect(); follow(e); } feel(model?.pull ?? ""); }, true);
  addEventListener("pointermove", (e) => { if (pulls) follow(e); }, true);
  for (const end of ["pointerup", "pointercancel"]) addEventListener(end, () => { if (pulls) { pulls = false; feel(""); } }, true);

  const paint = (dark, chosen) => {
    desk.classList.toggle("dark", dark);
    if (chosen) keep("dark", dark ? "1" : "0");
    say("dark", dark);
  };

  const show = () => {
    if (desk.hidden) {  // a browser for which there is no place gets none of this
      row();
      desk.hidden = false;
      if (kept("hints", "") !== "seen") tour(0);
    }
    for (const [name, made] of Object.entries(choices)) made.setAttribute("aria-pressed", String(name === model.tool));
    of.plane.setAttribute("aria-pressed", String(model.plane));
    const looks = model.role === "look", [here, most] = model.people;
    for (const made of [of.plane, of.film, by, shape, preset, all, run, back, next, scrub, again, reset]) made.disabled = looks;
    of.undo.disabled = looks || !model.undo; of.redo.disabled = looks || !model.redo;
    people.hidden = !looks && here < 2;
    const told = `${looks ? "You look" : "You steer"} · ${here} of ${most} browsers`;
    if (people.textContent !== told) people.textContent = told;
    people.title = looks ? "The camera is yours; another browser changes the settings" : "Settings are shared; each browser has its own camera";
    of.film.classList.toggle("hot", model.recording); of.film.setAttribute("aria-pressed", String(model.recording));
    const rows = JSON.stringify(model.layers);
    if (list.dataset.rows !== rows) {
      list.dataset.rows = rows;
      list.replaceChildren(...model.layers.map((one, i) => {
        const label = make("span", { title: one.name }, one.name);
        if (model.layers.length === 1) return make("div", { class: "row" }, label);
        const eye = button(one.shown ? "eye" : "off", `Layer ${one.name} visible`, () => hide(i, !one.shown), "Show or hide this layer");
        eye.disabled = looks;
        eye.setAttribute("aria-pressed", String(one.shown));
        return make("div", { class: "row" }, eye, label);
      }));
    }
    byLabel.hidden = !model.color.options.length;
    byLabel.style.display = shapeLabel.style.display = model.color.options.length ? "" : "none";
    fill(by, [["", "own colors"], ...model.color.options.map((n) => [n, n])], model.color.by);
    fill(shape, ["auto", "smooth", "balls"].map((n) => [n, n === "auto" && model.surface.shown ? `auto (${model.surface.shown})` : n]), model.surface.shape);
    fill(preset, model.preset.options.map((n) => [n, n]), model.preset.name);
    graph.hidden = !model.plot;
    all.hidden = model.color.automatic;
    if (model.plot && !brush) bars();
    plots.hidden = !model.line && !model.series;
    lineBox.hidden = !model.line; seriesBox.hidden = !model.series;
    closing.disabled = looks;
    if (model.line) { lineTitle.textContent = `${model.line.name} along the line`; if (!chosen) drawLine(); }
    if (model.series) { fill(seriesOf, model.series.names.map((n) => [n, n]), model.series.name); drawSeries(); }
    const t = model.time;
    time.hidden = !t;
    time.classList.toggle("beside", Boolean(model.color.by));
    if (t) {
      draw(run, t.running ? "pause" : "play");
      run.setAttribute("aria-pressed", String(t.running));
      const frames = t.kind === "sequence", ran = t.kind === "simulation" && t.frames > 0;
      back.hidden = again.hidden = !frames;
      scrub.hidden = !frames && !ran;
      reset.hidden = t.kind !== "simulation"; next.hidden = t.kind === "sweep";
      words.className = frames ? "" : "wide"; words.textContent = t.words;
      if (frames || ran) {
        scrub.max = String(ran ? t.frames : t.frames - 1);
        if (Date.now() - sent > 700) scrub.value = String(t.frame);
        scrub.setAttribute("aria-valuetext", ran ? t.words : `frame ${t.words}`);
        again.setAttribute("aria-pressed", String(t.loop));
      }
    }
    feel(model.pull);
    said.hidden = !model.said || (narrow.matches && !layers.hidden);
    if (said.textContent !== model.said) said.textContent = model.said;
    split.hidden = model.compare === null;
    if (split.dataset.sides !== model.sides.join("\n")) {
      split.dataset.sides = model.sides.join("\n");
      split.replaceChildren(...model.sides.map((name) => make("span", {}, name)));
    }
    if (model.compare !== null && Date.now() - sent > 700) split.style.left = `${100 * model.compare}%`;
    split.setAttribute("aria-valuenow", String(Math.round(100 * (model.compare ?? 0))));
  };

  // Names for screen readers where viser's panel has none
  const named = () => {
    for (const part of document.querySelectorAll('#root [role="slider"][aria-label=""], #root input:not([aria-label], [type="checkbox"], [type="file"])')) {
      if (part.labels?.length) continue;
      let row = part.parentElement;
      while (row && !row.querySelector("label")) row = row.parentElement;
      const words = row?.querySelector("label")?.textContent;
      if (words) part.setAttribute("aria-label", part.inputMode ? `${words}, value` : words);
    }
    document.querySelectorAll("#root button:not([aria-label])").forEach((part) => {
      if (part.className.includes("Notification-closeButton")) part.setAttribute("aria-label", "Close the note");
      else if (!part.textContent.trim() && part.querySelector("svg")) {
        const first = part.previousElementSibling?.tagName !== "BUTTON";
        part.setAttribute("aria-label", first ? "All commands" : "Settings of the page");
      }
    });
  };

  // viser forgets which folders of its panel are open
  const folders = (() => { try { return JSON.parse(kept("folders", "{}")); } catch { return {}; } })();
  const known = new WeakMap();
  const remember = () => {
    for (const arrow of document.querySelectorAll("#root svg.tabler-icon-chevron-up, #root svg.tabler-icon-chevron-down")) {
      const head = arrow.parentElement, title = head.textContent;
      if (!head.matches(".mantine-Paper-root") || getComputedStyle(arrow).display === "none") continue;
      const opened = arrow.matches(".tabler-icon-chevron-up"), wanted = folders[title] ?? opened;
      if (known.has(head) && known.get(head) !== opened) { folders[title] = opened; keep("folders", JSON.stringify(folders)); }
      else if (!known.has(head) && wanted !== opened) { head.click(); known.set(head, wanted); continue; }
      known.set(head, opened);
      head.dataset.known = "";  // it is as it was
    }
  };

  // Over the image, wherever viser puts it
  const place = () => {
    // The image comes from the server: a browser without a GPU shows it just as fast.
    for (const title of document.querySelectorAll(".mantine-Notification-title"))
      if (title.textContent.startsWith("Software WebGL")) title.closest(".mantine-Notification-root").style.display = "none";
    const image = document.querySelector("#root canvas");
    if (!image) return;
    const box = image.getBoundingClientRect();
    for (const part of narrow.matches ? document.querySelectorAll("#root .mantine-Paper-root:not(.globule-panel)") : [])
      if (getComputedStyle(part).position === "fixed") part.classList.add("globule-panel");
    document.documentElement.style.setProperty("--globule-left", layers.hidden || narrow.matches ? "10px" : `${layers.offsetLeft + layers.offsetWidth + 9}px`);
    layers.style.top = said.style.top = `${tools.offsetTop + tools.offsetHeight + 9}px`;
    Object.assign(desk.style, { left: `${box.left}px`, top: `${box.top}px`, width: `${box.width}px`, height: `${box.height}px` });
  };

  const connect = () => {
    const word = globalThis.globuleWord;
    if (!word) return;
    socket?.close();
    // Relative, so that a proxy may put the page below a path.
    const address = new URL("globule/desk" + location.search, location.href.split(/[?#]/)[0]);
    address.searchParams.set("word", word);
    const own = socket = new WebSocket(address.href.replace(/^http/, "ws"));
    own.onopen = () => {
      wait = 500; paint(desk.classList.contains("dark"));
      if (matchMedia("(min-width: 2560px)").matches) say("wide");
    };
    own.onmessage = (event) => { if (own === socket) { model = JSON.parse(event.data); show(); place(); } };
    own.onclose = () => { feel(""); if (own === socket) setTimeout(() => { if (own === socket) connect(); }, (wait = Math.min(2 * wait, 8000))); };
  };

  addEventListener("DOMContentLoaded", () => {
    document.documentElement.lang = "en";
    document.getElementById("root").setAttribute("role", "main");
    desk.prepend(make("h1", { class: "unseen" }, document.title));
    document.body.append(desk);
    // Keys that a control uses must not move the camera, too.
    desk.addEventListener("keydown", (e) => { if (/^(Arrow|Home|End|Enter| )/.test(e.key)) e.stopPropagation(); });
    desk.classList.toggle("dark", kept("dark", matchMedia("(prefers-color-scheme: dark)").matches ? "1" : "0") === "1");
    open(kept("layers", innerWidth >= 1200 ? "1" : "0") === "1");
    setInterval(() => { place(); named(); remember(); }, 400);
    addEventListener("resize", place);
    addEventListener("globule", connect);
    connect();
  });
})();
