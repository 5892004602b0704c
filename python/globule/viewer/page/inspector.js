// The inspector: the controls that the server has (gui.py), a section at a time.
globule.inspector = (say, keep, kept) => {
  const { make } = globule;
  const known = new Map();  // number of a control: its facts, row, and how to show a value
  const tabs = make("div", { class: "tabs", role: "tablist", "aria-label": "Sections" });
  const body = make("div", { class: "body", role: "tabpanel", tabindex: "0" });
  const card = make("section", { class: "bar inspector", "aria-label": "Inspector" }, tabs, body);
  const sections = new Map();  // title: its tab, its part of the body, and groups in it
  let chosen = kept("section", "Layer"), mayAll = true;

  const short = (v, digits = 5) => Number(v.toPrecision(digits)).toString();

  // Markdown as far as the server writes it; nothing in it becomes HTML
  const inline = (text) => {
    const parts = [];
    for (const [i, part] of text.replace(/&#(\d+);/g, (_, n) => String.fromCodePoint(n)).split(/\*\*/).entries())
      for (const [k, inner] of part.split("*").entries())
        if (inner) parts.push(i % 2 ? make("strong", {}, inner) : k % 2 ? make("em", {}, inner) : inner);
    return parts;
  };
  const markdown = (text) => {
    const made = make("div", { class: "text" });
    let table = null, code = null;
    for (const line of text.split("\n")) {
      const fence = line.match(/^(`{3,})(.*)$/);
      if (code) { if (fence && fence[1] === code.fence) code = null; else code.made.textContent += `${line}\n`; continue; }
      if (fence) { code = { fence: fence[1], made: make("code") }; made.append(make("pre", { tabindex: "0" }, code.made)); continue; }
      if (line.startsWith("|")) {
        const cells = line.slice(1, -1).split("|").map((cell) => cell.trim());
        if (cells.every((cell) => /^-*$/.test(cell))) continue;
        if (!table) made.append((table = make("table")));
        table.append(make("tr", {}, ...cells.map((cell, i) => make(i ? "td" : "th", i ? {} : { scope: "row" }, ...inline(cell)))));
        continue;
      }
      table = null;
      if (line.trim()) made.append(make("p", {}, ...inline(line.trim())));
    }
    return made;
  };

  const section = (title, order = 1e9) => {
    let one = sections.get(title);
    if (!one) {
      const tab = make("button", { type: "button", role: "tab", onclick: () => choose(title, true) }, title);
      one = { tab, part: make("div", { class: "part", hidden: title !== chosen }), groups: new Map(), order };
      sections.set(title, one);
      tab.setAttribute("aria-selected", String(title === chosen));
      const sorted = [...sections.values()].sort((a, b) => a.order - b.order);
      tabs.replaceChildren(...sorted.map((s) => s.tab)); body.replaceChildren(...sorted.map((s) => s.part));
    }
    return one;
  };
  const choose = (title, byHand) => {
    if (!sections.has(title)) return;
    chosen = title;
    if (byHand) keep("section", title);
    for (const [name, one] of sections) {
      one.part.hidden = name !== title;
      one.tab.setAttribute("aria-selected", String(name === title));
      one.tab.tabIndex = name === title ? 0 : -1;
    }
    body.setAttribute("aria-label", title); body.scrollTop = 0;
    say("section", title);
  };
  tabs.addEventListener("keydown", (e) => {
    const way = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[e.key];
    if (!way) return;
    const all = [...tabs.children], next = all[(all.indexOf(document.activeElement) + way + all.length) % all.length];
    next.focus(); next.click(); e.preventDefault();
  });

  // A field in which a person types is not written to.
  const typed = new Set();
  body.addEventListener("input", (e) => typed.add(e.target), true);
  for (const end of ["change", "focusout"]) body.addEventListener(end, (e) => typed.delete(e.target), true);
  const put = (box, value) => { if (!typed.has(box)) box.value = value; };

  const send = (id, value) => say("control", [id, value]);
  // Makes the row of a control: [row, show, parts to disable]
  const row = (c) => {
    const id = `globule-c${c.id}`, hint = c.hint ?? c.label, head = make("label", { for: id, title: hint }, c.label);
    const f = () => known.get(c.id)?.facts.factor ?? c.factor ?? 1;
    const unit = c.unit ? [make("span", { class: "unit" }, c.unit)] : [];
    const number = (name, does) => make("input", { type: "number", step: "any", title: hint, "aria-label": name, onchange: (e) => { if (e.target.value !== "") does(Number(e.target.value) / f()); else show(known.get(c.id).facts); } });
    let show;
    if (c.kind === "switch") {
      const box = make("input", { type: "checkbox", id, title: hint, onchange: () => send(c.id, box.checked) });
      show = (now) => { box.checked = now.value; };
      return [make("div", { class: "row" }, head, box), show, [box]];
    }
    if (c.kind === "slider") {
      const slide = make("input", { type: "range", id, title: hint, oninput: () => { mark(); send(c.id, whole(Number(slide.value))); box.value = short(Number(slide.value) * f()); } });
      const whole = (v) => (Number.isInteger(c.step) && Number.isInteger(c.min) ? Math.round(v) : v);
      const box = number(`${c.label}, value`, (v) => send(c.id, whole(v)));
      let touched = 0;
      const mark = () => { touched = Date.now(); };
      show = (now) => {
        slide.min = now.min; slide.max = now.max; slide.step = now.step;
        if (Date.now() - touched > 700) slide.value = now.value;
        if (Date.now() - touched > 700) put(box, short(now.value * f()));
        slide.setAttribute("aria-valuetext", `${short(now.value * f())} ${c.unit ?? ""}`.trim());
      };
      return [make("div", { class: "row slide" }, head, slide, box, ...unit), show, [slide, box]];
    }
    if (c.kind === "number") {
      const box = number(c.label, (v) => send(c.id, v));
      box.id = id;
      show = (now) => put(box, short(now.value * f()));
      return [make("div", { class: "row" }, head, box, ...unit), show, [box]];
    }
    if (c.kind === "vector") {
      const boxes = [0, 1, 2].map((i) => number(`${c.label}, ${"xyz"[i]}`, () => send(c.id, boxes.map((b) => Number(b.value)))));
      boxes[0].id = id;
      show = (now) => boxes.forEach((b, i) => put(b, short(now.value[i])));
      return [make("div", { class: "row three" }, head, make("span", { class: "boxes" }, ...boxes), ...unit), show, boxes];
    }
    if (c.kind === "text") {
      const box = make("input", { type: "text", id, title: hint, onchange: () => send(c.id, box.value) });
      show = (now) => put(box, now.value);
      return [make("div", { class: "row" }, head, box), show, [box]];
    }
    if (c.kind === "choice") {
      const list = make("select", { id, title: hint, onchange: () => { send(c.id, list.value); list.blur(); } });
      show = (now) => {
        const words = now.options.join("\n");
        if (list.dataset.words !== words) { list.dataset.words = words; list.replaceChildren(...now.options.map((o) => make("option", { value: o }, o))); }
        list.value = now.value;
      };
      return [make("div", { class: "row" }, head, list), show, [list]];
    }
    if (c.kind === "button") {
      const made = make("button", { type: "button", class: "text", title: hint, onclick: () => send(c.id, true) }, c.label);
      show = (now) => { made.textContent = now.label; };
      return [made, show, [made]];
    }
    if (c.kind === "buttons") {
      const all = c.options.map((o) => make("button", { type: "button", class: "text", title: hint, onclick: () => send(c.id, o) }, o));
      return [make("div", { class: "row buttons", role: "group", "aria-label": c.label || "More" }, make("span", { class: "head" }, c.label), make("span", { class: "boxes" }, ...all)), () => {}, all];
    }
    const text = make("div");
    let said = null;
    show = (now) => { if (now.content !== said) { said = now.content; text.replaceChildren(markdown(said)); } };
    return [text, show, []];
  };

  const rights = (one) => one.parts.forEach((part) => { part.disabled = one.facts.disabled || (!mayAll && !one.facts.private); });
  const take = ({ controls, gone }) => {
    for (const facts of controls) {
      let one = known.get(facts.id);
      if (!one) {
        const [made, show, parts] = row(facts), home = section(facts.section, facts.id);
        one = { facts, made, show, parts };
        known.set(facts.id, one);
        let place = home.part;
        if (facts.group) {
          if (!home.groups.has(facts.group)) {
            const set = make("fieldset", {}, make("legend", {}, facts.group));
            home.groups.set(facts.group, set); home.part.append(set);
          }
          place = home.groups.get(facts.group);
        }
        place.append(made);
      }
      one.facts = facts; one.made.hidden = !facts.visible;
      one.show(facts); rights(one);
    }
    for (const number of gone) { known.get(number)?.made.remove(); known.delete(number); }
    if (![...sections.values()].some((one) => one.tab.getAttribute("aria-selected") === "true") && sections.size) choose(sections.keys().next().value);
  };
  const may = (all) => { if (all !== mayAll) { mayAll = all; known.forEach(rights); } };
  // Shows a text in a section that has no controls of its own
  const texts = new Map();
  const tell = (title, text, order) => {
    if (texts.get(title) === text) return;
    texts.set(title, text);
    const part = section(title, order).part;
    let here = part.querySelector(":scope > .told");
    if (!here) part.prepend((here = make("div", { class: "told" })));
    here.replaceChildren(markdown(text));
  };
  const find = () => [...known.values()].filter((one) => one.facts.visible && one.facts.label).map((one) => [one.facts.label, one.facts.section, () => { choose(one.facts.section); (one.parts[0] ?? one.made).focus(); }]);
  return { card, take, choose, may, tell, find, markdown, short, chosen: () => chosen, again: () => { for (const one of known.values()) one.made.remove(); known.clear(); sections.clear(); texts.clear(); tabs.replaceChildren(); body.replaceChildren(); } };
};
