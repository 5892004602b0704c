// A gamepad as a mouse: its left stick moves a cross over the image, its first button is the mouse's; see desk.py.
(() => {
  const SPEED = 500;    // pixels a second, at most
  const STILL = 0.15;   // a stick that nobody touches
  const ARROWS = [["ArrowLeft", "ArrowRight"], ["ArrowUp", "ArrowDown"]];  // by which the page turns its camera
  const cross = document.createElement("div");
  cross.id = "globule-pad";
  cross.setAttribute("aria-hidden", "true");
  let at = null, down = [], held = {}, last = 0, running = false;

  const image = () => document.querySelector("#root canvas");
  const point = (Kind, name, buttons) => {
    const place = { clientX: at[0], clientY: at[1], pointerId: 1, pointerType: "mouse", isPrimary: true, button: name === "pointermove" ? -1 : 0, buttons, bubbles: true, cancelable: true };
    (document.elementFromPoint(...at) ?? image()).dispatchEvent(new Kind(name, place));
  };
  const key = (name, pressed) => {
    if (!!held[name] === pressed) return;
    held[name] = pressed;
    document.dispatchEvent(new KeyboardEvent(pressed ? "keydown" : "keyup", { key: name, code: name, bubbles: true }));
  };
  const press = (label) => document.querySelector(`#globule-desk button[aria-label="${label}"]:not(:disabled)`)?.click();
  const BUTTONS = { 1: "Undo the last change", 3: "Fit the whole scene", 9: "Play or pause" };

  const look = (now) => {
    const pad = [...navigator.getGamepads()].find((one) => one?.connected), box = image()?.getBoundingClientRect();
    if (!pad) { running = false; cross.remove(); return; }
    requestAnimationFrame(look);
    const passed = Math.min(0.1, (now - last) / 1000);
    last = now;
    if (!box) return;
    const stick = (i) => (Math.abs(pad.axes[i] ?? 0) > STILL ? pad.axes[i] : 0);
    const pressed = pad.buttons.map((b) => b.pressed);
    at ??= [box.left + box.width / 2, box.top + box.height / 2];
    const step = [stick(0) * SPEED * passed, stick(1) * SPEED * passed];
    if (step[0] || step[1] || pressed[0]) document.body.append(cross);
    at = [Math.min(box.right - 1, Math.max(box.left, at[0] + step[0])), Math.min(box.bottom - 1, Math.max(box.top, at[1] + step[1]))];
    Object.assign(cross.style, { left: `${at[0]}px`, top: `${at[1]}px` });
    if (step[0] || step[1]) point(PointerEvent, "pointermove", pressed[0] && down[0] ? 1 : 0);
    if (pressed[0] && !down[0]) point(PointerEvent, "pointerdown", 1);
    if (!pressed[0] && down[0]) { point(PointerEvent, "pointerup", 0); point(MouseEvent, "click", 0); }
    for (const [i, label] of Object.entries(BUTTONS)) if (pressed[i] && !down[i]) press(label);
    ARROWS.forEach((names, axis) => names.forEach((name, side) => key(name, stick(2 + axis) * (side ? 1 : -1) > 0)));
    down = pressed;
  };
  const begin = () => { if (!running) { running = true; last = performance.now(); requestAnimationFrame(look); } };
  addEventListener("gamepadconnected", begin);
})();
