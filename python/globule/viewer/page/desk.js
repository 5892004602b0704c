// Toolbar, timeline, layers and inspector over the image, which comes here, too; see desk.py.
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
    folder: "M3 6h6l2 3h10v10H3z", load: "M12 4v11M7 10l5 5 5-5M4 20h16", help: "M9 9a3 3 0 1 1 4 3c-1 .6-1 1-1 2M12 18v.1",
    play: "M7 4l13 8-13 8z", pause: "M8 5v14M16 5v14", back: "M17 5 8 12l9 7zM6 5v14",
    next: "M7 5l9 7-9 7zM18 5v14", loop: "M4 12a7 7 0 0 1 12-5l3 3M20 12a7 7 0 0 1-12 5l-3-3M19 5v5h-5M5 19v-5h5",
    disk: "M5 4h11l4 4v12H4V4zM8 4v5h7V4M8 20v-6h8v6",
    close: "M6 6l12 12M18 6 6 18",
    reset: "M5 5v6h6M5 11a8 8 0 1 1 2 6", eye: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12M12 9a3 3 0 1 0 0 6 3 3 0 1 0 0-6",
    sliders: "M4 7h9M17 7h3M15 4v6M4 17h3M11 17h9M9 14v6",
    off: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12M4 4l16 16",
  };
  const { make, at, starting, arrived } = globule;
  const narrow = matchMedia("(max-width: 640px)");
  const kept = (name, usual) => { try { return localStorage.getItem("globule-" + name) ?? usual; } catch { return usual; } };
  const keep = (name, value) => { try { localStorage.setItem("globule-" + name, value); } catch { /* private window */ } };
  const tab = (() => { try { return (sessionStorage["globule-tab"] ??= crypto.getRandomValues(new Uint32Array(4)).join("-").slice(0, 64)); } catch { return "no-storage"; } })();
  let socket, model, wait = 500, sent = 0, lost = true, moves = -1, full = "", commands = [];
  const say = (name, value) => { if (socket?.readyState === 1) socket.send(JSON.stringify({ do: name, value })); };
  const set = (values) => say("set", values);
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
  const image = make("canvas", { id: "globule-image", role: "img", "aria-label": "Image of the scene" });
  // The camera is the page's; the server moves it, too, and counts its moves.
  let due = 0;
  const looked = () => { handles.draw(); due ||= requestAnimationFrame(() => { due = 0; say("look", { ...camera.view, moves }); }); };
  const camera = globuleCamera(looked), handles = globule.handles(camera, say);
  const desk = make("div", { id: "globule-desk", role: "region", "aria-label": "Tools, layers, inspector and time", hidden: "" });
  const tools = make("div", { class: "bar tools", role: "toolbar", "aria-label": "Tools" });
  const layers = make("section", { class: "bar layers", "aria-label": "Layers" });
  const time = make("div", { class: "bar time", role: "group", "aria-label": "Timeline", hidden: "" });
  const split = make("div", { class: "split", role: "slider", tabindex: "0", "aria-label": "Divider between the two data sets", "aria-valuemin": "0", "aria-valuemax": "100", hidden: "" });
  const plots = make("section", { class: "bar plots", "aria-label": "Plots", hidden: "" });
  const people = make("span", { class: "people", role: "status", hidden: "" });
  const said = make("div", { class: "card said", role: "status", hidden: "" });
  const banner = make("div", { class: "card banner", role: "alert" }, "Connecting …");
  const notes = make("div", { class: "notes", role: "log", "aria-label": "Notes" });
  const force = make("div", { class: "force", "aria-hidden": "true", hidden: "" });
  const inspector = globule.inspector(say, keep, kept);
  const sheet = inspector.card;
  desk.append(tools, layers, sheet, time, plots, split, said, force);

  const file = make("input", { type: "file", accept: ".toml,text/plain", hidden: "", "aria-label": "Settings to load", onchange: async () => { if (file.files[0]) say("load", [file.files[0].name, await file.files[0].text()]); file.value = ""; } });
  const data = make("input", { type: "file", multiple: "", hidden: "", "aria-label": "Files to open", onchange: () => { openFiles([...data.files]); data.value = ""; } });
  const of = {
    plane: button("plane", "Cutting plane", () => { set({ cuts__plane: !model.plane }); if (!model.plane) show_("Cut"); }, "Cutting plane on or off; drag its arrow (key C)"),
    fit: button("fit", "Fit the whole scene", () => say("fit"), "Show the whole scene (key F)"),
    undo: button("undo", "Undo the last change", () => say("undo"), "Undo the last change of a setting, or the last cut of tissue (Ctrl+Z)"),
    redo: button("redo", "Redo the setting", () => say("redo"), "Redo (Ctrl+Shift+Z)"),
    folder: button("folder", "Open files", () => data.click(), "Open files instead; or drop them on the image"),
    disk: button("disk", "Save view", () => say("state"), "Download all settings and the camera as a file; Load view opens it again"),
    load: button("load", "Load view", () => file.click(), "Load settings and a camera that were saved as a file"),
    camera: button("camera", "Screenshot", () => say("picture"), "Download the image as it is shown (key P)"),
    film: button("film", "Movie", () => say("record"), "Record a movie; press again to stop and download it (key R)"),
    layers: button("layers", "Layers", () => open(layers.hidden), "List of layers: what is seen, and its colors"),
    sliders: button("sliders", "Inspector", () => settings(sheet.hidden), "Show or hide the settings of what is selected"),
    help: button("help", "Help", () => say("command", "Help"), "Mouse and keys (key H)"),
  };
  const choices = {};
  const show_ = (section) => { inspector.choose(section); if (!narrow.matches) settings(true); };
  const row = () => {
    const hints = { Rotate: "Rotate the view; click to read values (key T: next tool)", Measure: "Measure the distance of two clicks", Cut: "Draw a line across the surface to cut it", Grasp: "Drag a part of the surface", Suction: "Drag over the fluid to remove it" };
    for (const name of model.tools) {
      const first = name.split(",")[0];
      choices[name] = button(first in ICONS ? first : "Rotate", first, () => { say("tool", name); show_({ Cut: model.tissue ? "Simulation" : "Cut", Measure: "Pick" }[first] ?? inspector.chosen()); }, hints[first]);
    }
    const gap = () => make("hr", { "aria-hidden": "true" });
    tools.replaceChildren(...Object.values(choices), of.plane, gap(), of.fit, of.undo, of.redo, gap(), of.folder, of.load, of.disk, of.camera, of.film, gap(), of.layers, of.sliders, of.help, file, data);
    // Names below the icons, where the window is wide enough; the buttons' own names contain them
    const words = { plane: "Plane", fit: "Fit", undo: "Undo", redo: "Redo", folder: "Open", load: "Load view", disk: "Save view", camera: "Screenshot", film: "Movie", layers: "Layers", sliders: "Inspector", help: "Help" };
    const labels = [...Object.entries(choices).map(([name, made]) => [made, name.split(",")[0]]), ...Object.entries(words).map(([key, word]) => [of[key], word])];
    for (const [made, word] of labels) made.append(make("span", { class: "word", "aria-hidden": "true" }, word));
  };

  // The list of layers
  const list = make("div");
  const by = make("select", { id: "globule-by", title: "Color the particles by a field or attribute", onchange: () => { set({ color__by: by.value }); inspector.choose("Layer"); by.blur(); } });
  const byLabel = make("div", { class: "field" }, make("label", { for: "globule-by" }, "Color by"), by);
  const plot = make("canvas", { class: "plot", role: "img", tabindex: "0", width: "432", height: "112" });
  const ends = make("div", { class: "ends" }), beyond = make("p", { class: "small" });
  const all = make("button", { type: "button", class: "text", title: "Color map from the lowest to the highest usual value", onclick: () => set({ color__automatic: true }) }, "Whole range");
  const graph = make("div", { hidden: "" }, plot, ends, beyond, all);
  layers.append(make("div", { class: "row" }, make("h2", {}, "Layers"), people), list, byLabel, graph);
  const fill = (select, options, value) => {
    const words = options.map(([v, t]) => v + "\n" + t).join("\n");
    if (select.dataset.words !== words) {
      select.dataset.words = words;
      select.replaceChildren(...options.map(([v, t]) => make("option", { value: v }, t)));
    }
    if (document.activeElement !== select || select.value !== value) select.value = value;
  };
  const settings = (on) => {
    sheet.hidden = !on;
    of.sliders.setAttribute("aria-pressed", String(on));
    if (!narrow.matches) keep("inspector", on ? "1" : "0");
    else if (on) open(false);
    place();
  };
  const open = (on) => {
    if (on && narrow.matches) settings(false);
    layers.hidden = !on; of.layers.setAttribute("aria-pressed", String(on));
    if (!narrow.matches) keep("layers", on ? "1" : "0");
    place();
  };
  const hide = (i, on) => {
    const gone = model.layers.map((one, k) => ((k === i ? !on : !one.shown) ? k + 1 : 0)).filter(Boolean);
    if (gone.length < model.layers.length) set({ layers__hidden: gone.join(" ") });
  };
  const short = (v) => Number(v.toPrecision(4)).toString();
  const ink = (name) => getComputedStyle(desk).getPropertyValue(name).trim();

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
    pen.fillStyle = ink("--paper") + "b0";
    const x = (v) => w * Math.min(1, Math.max(0, (v - lo) / (hi - lo)));
    pen.fillRect(0, 0, x(a), h); pen.fillRect(x(b), 0, w - x(b), h);
    plot.setAttribute("aria-label", `Histogram of ${name}, ${short(lo)} to ${short(hi)}, logarithmic; colors from ${short(a)} to ${short(b)}`);
    plot.title = "How often each value occurs (logarithmic). Drag to choose the range of the colors.";
    ends.replaceChildren(make("span", {}, short(lo)), make("span", {}, a > lo || b < hi ? `colors ${short(a)} … ${short(b)}` : ""), make("span", {}, short(hi)));
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
    if (brushed) { pen.fillStyle = ink("--soft"); pen.fillRect(px(Math.min(...brushed)), 0, Math.abs(px(brushed[1]) - px(brushed[0])), h); }
    pen.strokeStyle = ink("--mark"); pen.lineWidth = 3; pen.beginPath();
    data.y.forEach((v, i) => v !== null && (i && data.y[i - 1] !== null ? pen.lineTo(px(data.x[i]), py(v)) : pen.moveTo(px(data.x[i]), py(v))));
    pen.stroke();
    const words = (v, unit) => (unit ? `${short(v)} ${unit}` : short(v));
    if (at !== undefined && data.y[at] !== null && at < data.y.length) {
      pen.fillStyle = "#b3261e"; pen.beginPath(); pen.arc(px(data.x[at]), py(data.y[at]), 7, 0, 7); pen.fill();
      read.replaceChildren(make("span", {}, `at ${words(data.x[at], xUnit)}: ${words(data.y[at], yUnit)}`));
    } else read.replaceChildren(make("span", {}, words(x0, xUnit)), make("span", {}, known.length ? `height: ${short(lo)} … ${words(hi, yUnit)}` : "no particles here"), make("span", {}, words(x1, xUnit)));
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
  const reset = button("reset", "From the beginning", () => say("reset"), "Begin again");
  const words = make("span");
  time.append(run, back, scrub, next, words, again, reset);

  // The image: each new one takes the place of the last without a copy; the browser's compositor scales those that
  // are smaller than the window, which is filtered. At rest, a pixel of the image is one of the screen.
  const pen = image.getContext("bitmaprenderer");
  let download = null;  // a file that comes in parts, which have no number
  const paint = async (bytes) => {
    const number = bytes.slice(0, 4);
    try {
      pen.transferFromImageBitmap(await createImageBitmap(new Blob([bytes.slice(4)], { type: "image/jpeg" })));
    } finally { if (socket?.readyState === 1) socket.send(number); }
  };
  const keepPart = (part) => {
    download.parts.push(part); download.left -= part.byteLength;
    if (download.left > 0) return;
    const link = make("a", { href: URL.createObjectURL(new Blob(download.parts)), download: download.name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  };
  let drawn = Promise.resolve();  // images in their order

  // Clicks and strokes in the image; other drags move the camera
  const DRAWS = ["Cut", "Grasp", "Suction"];
  const spot = (e) => [e.clientX / innerWidth, e.clientY / innerHeight];
  let press = null, stroke = null, moved = null;
  camera.attach(image, () => !DRAWS.includes(model?.tool));
  image.addEventListener("pointerdown", (e) => {
    document.activeElement?.blur?.();
    if (!model || e.button !== 0 || (press && e.pointerType === "touch")) { press = null; return; }  // a second finger
    press = { x: e.clientX, y: e.clientY, at: Date.now(), id: e.pointerId };
    if (!DRAWS.includes(model.tool)) return;
    image.setPointerCapture(e.pointerId);
    stroke = spot(e); say("drag", ["start", stroke, stroke]);
    follow(e); feel(model.pull);
  });
  image.addEventListener("pointermove", (e) => {
    if (!stroke) return;
    follow(e);
    if (!moved) requestAnimationFrame(() => { if (stroke && moved) say("drag", ["move", stroke, moved]); moved = null; });
    moved = spot(e);
  });
  const ended = (e) => {
    if (stroke) { say("drag", ["end", stroke, spot(e)]); stroke = moved = null; feel(""); }
    else if (press && press.id === e.pointerId && e.type === "pointerup" && Date.now() - press.at < 800 && Math.hypot(e.clientX - press.x, e.clientY - press.y) < (e.pointerType === "touch" ? 12 : 5)) {
      say("click", spot(e)); asked = true;
    }
    press = null;
  };
  for (const end of ["pointerup", "pointercancel"]) image.addEventListener(end, ended);
  let asked = false;  // a click whose answer has not come
  // A button that the mouse has pressed does not take the space bar.
  addEventListener("click", (e) => { if (e.detail && e.target.closest?.("#globule-desk button")) document.activeElement?.blur(); });

  // Two data sets side by side
  const divide = (share) => { if (model.role === "look") return; sent = Date.now(); split.style.left = `${100 * share}%`; set({ compare__at: Math.min(1, Math.max(0, share)) }); };
  split.addEventListener("pointerdown", (e) => split.setPointerCapture(e.pointerId));
  split.addEventListener("pointermove", (e) => { if (e.buttons) divide(e.clientX / innerWidth); });
  split.addEventListener("keydown", (e) => {
    const way = { ArrowLeft: -0.02, ArrowRight: 0.02 }[e.key];
    if (way) divide(Math.min(1, Math.max(0, model.compare + way)));
  });

  // The force on a hand that holds tissue, beside its pointer; the server says it, "" for none
  const feel = (words) => {
    if (force.textContent !== words) force.textContent = words;
    force.hidden = !stroke || model?.tool !== "Grasp" || !words;
  };
  const follow = (e) => { force.style.translate = `${e.clientX}px ${e.clientY}px`; };  // without a new layout

  // Keys: of commands, wherever the focus is, but in a field
  const keyOf = (e) => `${e.ctrlKey || e.metaKey ? "Ctrl+" : ""}${e.shiftKey && (e.ctrlKey || e.metaKey) ? "Shift+" : ""}${e.key === " " ? "space" : e.key.length === 1 ? e.key.toUpperCase() : e.key}`;
  addEventListener("keydown", (e) => {
    const here = document.activeElement, field = here?.matches?.("input:not([type=range], [type=checkbox]), textarea");
    if (document.querySelector("dialog[open]")) return;
    if (e.key === "Escape") { here?.blur?.(); if (model?.tools) say("tool", model.tools[0]); return; }
    if (keyOf(e) === "Ctrl+K") { e.preventDefault(); palette(); return; }
    if (field) return;
    const ours = here?.closest?.("#globule-desk, #globule-handles");
    if (ours && /^(Arrow|Home|End|Page|Enter|Tab)/.test(e.key)) return;
    if (ours && e.key === " " && here.matches("button, input, select, [tabindex]") && here.matches(":focus-visible")) return;
    if (e.altKey || e.repeat) return;
    const found = commands.find(([, key]) => key === keyOf(e));
    if (found) { e.preventDefault(); say("command", found[0]); if (found[0].startsWith("Cutting plane") && !model.plane) inspector.choose("Cut"); }
    else if (!here?.matches?.("select") && camera.key(e)) e.preventDefault();
  }, true);

  // Dialogs, one at a time; Escape closes them
  const dialog = make("dialog", { "aria-labelledby": "globule-title" });
  dialog.addEventListener("click", (e) => { if (e.target === dialog) dialog.close(); });
  const pop = (title, ...inside) => {
    dialog.replaceChildren(make("h2", { id: "globule-title" }, title), ...inside, make("button", { type: "button", class: "text", onclick: () => dialog.close() }, "Close"));
    if (!dialog.open) dialog.showModal();
  };
  const palette = () => {
    const all = [...commands.map(([name, key]) => [key ? `${name} (${key})` : name, "", () => say("command", name)]), ...inspector.find().map(([label, section, does]) => [`${section}: ${label}`, "", () => { settings(true); does(); }])];
    const results = make("ul", { role: "listbox", "aria-label": "Commands and settings" });
    const filter = make("input", { type: "text", "aria-label": "Search commands and settings", placeholder: "Search commands and settings" });
    const shown = () => all.filter(([name]) => name.toLowerCase().includes(filter.value.toLowerCase())).slice(0, 12);
    const list_ = () => results.replaceChildren(...shown().map(([name, , does]) => make("li", {}, make("button", { type: "button", onclick: () => { dialog.close(); does(); } }, name))));
    filter.addEventListener("input", list_);
    filter.addEventListener("keydown", (e) => { if (e.key === "Enter" && shown()[0]) { e.preventDefault(); dialog.close(); shown()[0][2](); } });
    list_(); pop("All commands", filter, results); filter.focus();
  };

  // Notes: errors stay until they are closed
  const shownNotes = new Map();
  const note = (n) => {
    let one = shownNotes.get(n.number);
    if (n.gone) { one?.remove(); shownNotes.delete(n.number); return; }
    if (!one) {
      one = make("div", { class: "card note" });
      shownNotes.set(n.number, one); notes.append(one);
      if (notes.children.length > 4) notes.firstElementChild.remove();
    }
    one.classList.toggle("wrong", Boolean(n.wrong));
    const shut = button("close", "Close the note", () => { one.remove(); shownNotes.delete(n.number); });
    one.replaceChildren(make("div", {}, make("strong", {}, n.title), make("p", {}, n.body)), n.loading ? make("progress", { "aria-label": n.title }) : shut);
  };

  // Files: the start page takes the place of the viewer, and then another viewer that of the start page.
  const openFiles = async (files) => {
    if (!files.length) return;
    if (files.length === 1 && files[0].name.endsWith(".toml") && files[0].size < 2 ** 18) { say("load", [files[0].name, await files[0].text()]); return; }
    if (!model?.opens) { note({ number: -1, title: "Not possible", body: "This viewer belongs to a program, which opens its files. Start `globule view` to open others here.", wrong: true }); return; }
    full = `Sending ${files[0].name} …`; tell();
    say("open");
    await arrived("globule start page");
    const talk = starting((m) => {
      if (m.scenes) talk.send(files);
      else if (m.error) { full = ""; tell(); note({ number: -1, title: "Not possible", body: m.error, wrong: true }); setTimeout(() => location.reload(), 6000); }
      else if (m.share) { full = `Sending ${m.name}: ${Math.round(100 * m.share)} %`; tell(); }
      else if (m.opening) { full = `Opening ${m.opening} …`; tell(); }
      else if (m.opened) arrived("globule/desk.js").then(() => location.reload());
    }, () => {});
  };
  addEventListener("dragover", (e) => { e.preventDefault(); document.documentElement.classList.add("globule-drop"); });
  addEventListener("dragleave", (e) => { if (!e.relatedTarget) document.documentElement.classList.remove("globule-drop"); });
  addEventListener("drop", (e) => { e.preventDefault(); document.documentElement.classList.remove("globule-drop"); openFiles([...e.dataTransfer.files]); });

  // One banner over the image: why nothing happens
  const tell = () => {
    const words = full || (lost ? (model ? "The viewer does not answer. Trying again …" : "Connecting …") : model?.banner ?? "");
    if (banner.textContent !== words) banner.textContent = words;
    banner.hidden = !words;
    document.documentElement.classList.toggle("globule-lost", lost && Boolean(model));
  };

  const show = () => {
    if (desk.hidden) { row(); desk.hidden = false; }  // a browser for which there is no place gets none of this
    for (const [name, made] of Object.entries(choices)) made.setAttribute("aria-pressed", String(name === model.tool));
    of.plane.setAttribute("aria-pressed", String(model.plane));
    const looks = model.role === "look", [here, most] = model.people;
    for (const made of [of.plane, of.film, of.load, of.folder, by, all, run, back, next, scrub, again, reset]) made.disabled = looks;
    of.undo.disabled = looks || !model.undo; of.redo.disabled = looks || !model.redo;
    inspector.may(!looks);
    people.hidden = !looks && here < 2;
    const told = `${looks ? "You look" : "You steer"} · ${here} of ${most} browsers`;
    if (people.textContent !== told) people.textContent = told;
    people.title = looks ? "The camera is yours; another browser changes the settings" : "Settings are shared; each browser has its own camera";
    of.film.classList.toggle("hot", model.recording); of.film.setAttribute("aria-pressed", String(model.recording));
    const rows = JSON.stringify(model.layers);
    if (list.dataset.rows !== rows) {
      list.dataset.rows = rows;
      list.replaceChildren(...model.layers.map((one, i) => {
        const label = make("button", { type: "button", class: "name", title: `Settings of ${one.name}`, onclick: () => show_("Layer") }, one.name);
        if (model.layers.length === 1) return make("div", { class: "row" }, label);
        const eye = button(one.shown ? "eye" : "off", `Layer ${one.name} visible`, () => hide(i, !one.shown), "Show or hide this layer");
        eye.disabled = looks;
        eye.setAttribute("aria-pressed", String(one.shown));
        return make("div", { class: "row" }, eye, label);
      }));
    }
    byLabel.hidden = !model.color.options.length;
    fill(by, [["", "own colors"], ...model.color.options.map((n) => [n, n])], model.color.by);
    graph.hidden = !model.plot;
    all.hidden = model.color.automatic;
    beyond.textContent = model.color.beyond ? `0.5th to 99.5th percentile; ${model.color.beyond} values lie beyond` : "";
    if (model.plot && !brush) bars();
    plots.hidden = !model.line && !model.series;
    lineBox.hidden = !model.line; seriesBox.hidden = !model.series;
    closing.disabled = looks;
    if (model.line) { lineTitle.textContent = `${model.line.name} along the line`; if (!chosen) drawLine(); }
    if (model.series) { fill(seriesOf, model.series.names.map((n) => [n, n]), model.series.name); drawSeries(); }
    const t = model.time;
    time.hidden = !t;
    if (t) {
      draw(run, t.running ? "pause" : "play");
      run.setAttribute("aria-pressed", String(t.running));
      const frames = t.kind === "sequence", ran = t.kind === "simulation" && t.frames > 0;
      back.hidden = again.hidden = !frames;
      scrub.hidden = !frames && !ran;
      reset.hidden = frames; next.hidden = t.kind === "sweep";
      words.className = frames ? "" : "wide"; words.textContent = t.words;
      if (frames || ran) {
        scrub.max = String(ran ? t.frames : t.frames - 1);
        if (Date.now() - sent > 700) scrub.value = String(t.frame);
        scrub.setAttribute("aria-valuetext", ran ? t.words : `frame ${t.words}`);
        again.setAttribute("aria-pressed", String(t.loop));
      }
    }
    feel(model.pull);
    handles.take(model.handles);
    inspector.tell("Pick", model.picked || "Click the surface to read its values there. *Measure* gives the distance of two clicks, and the values between them.", 0);
    if (model.facts || inspector.chosen() === "Statistics") inspector.tell("Statistics", model.facts || "…", 2e8);
    else inspector.tell("Statistics", "…", 2e8);
    if (asked && model.picked && model.picked !== picked) { asked = false; show_("Pick"); }
    picked = model.picked;
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
  let picked = "";

  // Cards stand below the toolbar; the server fits scenes into what they leave free.
  let room = "";
  const place = () => {
    if (desk.hidden) return;
    const top = tools.offsetTop + tools.offsetHeight + 8;
    desk.style.setProperty("--top", `${top}px`);
    desk.style.setProperty("--low", `${time.hidden ? 8 : time.offsetHeight + 16}px`);
    const edge = (part, across) => (part.hidden || narrow.matches ? 0 : across);
    const shares = [edge(layers, layers.offsetLeft + layers.offsetWidth) / innerWidth, top / innerHeight, edge(sheet, innerWidth - sheet.offsetLeft) / innerWidth, (time.hidden ? 0 : time.offsetHeight + 8) / innerHeight];
    const words = JSON.stringify(shares.map((v) => Math.round(1000 * v) / 1000));
    if (words !== room && socket?.readyState === 1) { room = words; say("room", JSON.parse(words)); }
  };

  const night = matchMedia("(prefers-color-scheme: dark)");
  night.addEventListener("change", () => { say("dark", night.matches); if (model) show(); });

  const heard = (m) => {
    if (m.controls) inspector.take(m);
    else if (m.note) note(m.note);
    else if (m.dialog) pop(m.dialog.title, inspector.markdown(m.dialog.text));
    else if (m.commands) commands = m.commands;
    else if (m.camera) { Object.assign(camera.view, m.camera); moves = m.moves; handles.draw(); }
    else if (m.file) download = { name: m.file.name, left: m.file.size, parts: [] };
    else if (m.full) { full = m.full; tell(); }
    else { model = m; show(); tell(); place(); }
  };
  const size = () => [innerWidth, innerHeight].map((v) => Math.round(v * devicePixelRatio));
  const connect = () => {
    socket?.close();
    const own = socket = new WebSocket(at("globule/desk"));
    own.binaryType = "arraybuffer";
    own.onopen = () => { wait = 500; lost = false; room = ""; full = ""; moves = -1; inspector.again(); tell(); say("hello", { size: size(), tab, dark: night.matches }); say("section", inspector.chosen()); };
    own.onmessage = ({ data }) => {
      if (own !== socket) return;
      if (data instanceof ArrayBuffer && !new Uint32Array(data, 0, 1)[0]) keepPart(data.slice(4));
      else if (data instanceof ArrayBuffer) drawn = drawn.then(() => paint(data)).catch(() => {});
      else heard(JSON.parse(data));
    };
    own.onclose = () => { if (own !== socket) return; lost = true; feel(""); tell(); setTimeout(() => { if (own === socket) connect(); }, (wait = Math.min(2 * wait, 8000))); };
  };

  desk.prepend(make("h1", { class: "unseen" }, document.title));
  document.body.append(make("main", {}, image, handles.all), desk, banner, notes, dialog);
  const begin = () => [["inspector", settings], ["layers", open]].forEach(([name, put]) => put(!narrow.matches && kept(name, innerWidth >= 900 ? "1" : "0") === "1"));
  begin();
  narrow.addEventListener("change", begin);
  setInterval(place, 400);
  addEventListener("resize", () => { place(); say("size", size()); handles.draw(); });
  connect(); tell();
})();
