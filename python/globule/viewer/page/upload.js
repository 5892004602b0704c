// Before all other scripts: what they share, and how a file gets to the server; see server.py.
globalThis.globule = (() => {
  const make = (tag, facts = {}, ...inside) => {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(facts)) {
      if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
      else if (value !== undefined && value !== null && value !== false) made.setAttribute(name, value === true ? "" : value);
    }
    made.append(...inside);
    return made;
  };

  // The address of a websocket, relative, so that a proxy may put the page below a path
  const at = (path) => new URL(path + location.search, location.href.split(/[?#]/)[0]).href.replace(/^http/, "ws");

  // The start page's talk: `told` gets each message. The server takes a file in parts.
  const PART = 256 * 1024;
  const starting = (told, closed) => {
    const socket = new WebSocket(at("globule/start"));
    let sending = null, waiting = [];
    const say = (facts) => socket.send(JSON.stringify(facts));
    const part = async () => socket.send(await sending.file.slice(sending.done, sending.done + PART).arrayBuffer());
    const next = () => {
      const file = waiting.shift();
      sending = { file, done: 0 };
      say({ do: "upload", name: file.name, size: file.size, more: waiting.length });
      part();
    };
    socket.onmessage = ({ data }) => {
      const m = JSON.parse(data);
      if (m.received) {
        sending.done = m.received;
        if (sending.done < sending.file.size) part();
        m.share = sending.done / sending.file.size; m.name = sending.file.name;
      } else if (m.kept) next();
      else if (m.error) { sending = null; waiting = []; }
      told(m);
    };
    socket.onclose = closed;
    return { say, send: (files) => { if (!sending && files.length) { waiting = [...files]; next(); } } };
  };

  // Wait until the server shows another page at this address.
  const arrived = async (word) => {
    for (;;) {
      await new Promise((done) => setTimeout(done, 400));
      try { if ((await (await fetch("", { cache: "no-store" })).text()).includes(word)) return; } catch { /* not yet */ }
    }
  };
  return { make, at, starting, arrived };
})();
