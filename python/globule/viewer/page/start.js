// The start page: scenes, recent files, files that are sent; see start.py.
const $ = (id) => document.getElementById(id), { make, starting, arrived } = globule;
let opened = false;
const tile = (title, words, does) => make("button", { type: "button", onclick: does }, make("strong", {}, title), make("small", {}, words));
const reload = () => arrived("globule/desk.js").then(() => location.reload());  // the viewer takes the place of this page
const told = (m) => {
  if (m.scenes) {
    $("kinds").textContent = `${m.endings.join(" ")}, up to ${Math.round(m.most / 2 ** 20)} MiB`;
    $("file").accept = m.endings.map((e) => "." + e.split(".").pop()).join();
    $("scenes").replaceChildren(...m.scenes.map(([name, words]) => tile(name, words, () => talk.say({ do: "scene", name }))));
    $("recent").replaceChildren(...m.recent.map(([name, folder], number) => tile(name, folder, () => talk.say({ do: "recent", number }))));
    $("recents").hidden = !m.recent.length;
  } else if (m.error) { $("said").textContent = m.error; $("bar").hidden = true; }
  else if (m.received) { $("bar").hidden = false; $("bar").value = m.share; $("said").textContent = `Sending ${m.name} …`; }
  else if (m.opening) $("said").textContent = `Opening ${m.opening} …`;
  else if (m.opened) { opened = true; reload(); }
};
const talk = starting(told, () => { if (!opened) { $("said").textContent = "Waiting for the viewer …"; reload(); } });
$("file").addEventListener("change", () => talk.send($("file").files));
addEventListener("dragover", (e) => { e.preventDefault(); $("drop").classList.add("over"); });
addEventListener("dragleave", () => $("drop").classList.remove("over"));
addEventListener("drop", (e) => { e.preventDefault(); $("drop").classList.remove("over"); talk.send(e.dataTransfer.files); });
