// Mouse, pen and touch on the picture: one pointer turns the model or drags a handle, two move it.
const CLICK_PIXELS = 5;

const on = (target, kind, action, options) => target.addEventListener(kind, action, options);

/** @param {Stage} stage */
function listenToPointers(stage) {
  const { canvas, camera, modes } = stage, held = new Map(), isWindow = Boolean(canvas.closest(".app"));
  let moved = 0, grabbed = false;
  const placeOf = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const spread = () => {
    const [[x, y], [u, v]] = [...held.values()];
    return { middle: [(x + u) / 2, (y + v) / 2], size: hypot(x - u, y - v) };
  };
  on(canvas, "pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, placeOf(event));
    if (held.size > 1) { if (grabbed) modes.drop(); grabbed = false; moved = Infinity; return; }
    moved = 0;
    grabbed = event.button === 0 && modes.act("grab", ...placeOf(event), event);
  });
  on(canvas, "pointermove", (event) => {
    const [x, y] = placeOf(event);
    if (!held.has(event.pointerId)) { modes.act("hover", x, y); return; }
    const [left, top] = held.get(event.pointerId), dx = x - left, dy = y - top;
    const before = held.size === 2 ? spread() : null;
    held.set(event.pointerId, [x, y]);
    stage.request();
    if (before) {
      const now = spread();
      camera.pan(now.middle[0] - before.middle[0], now.middle[1] - before.middle[1]);
      camera.zoom(before.size / (now.size || 1));
      return;
    }
    moved += hypot(dx, dy);
    if (grabbed) { if (moved > CLICK_PIXELS) modes.drag(x, y); }
    else if (event.buttons & 6 || event.shiftKey) camera.pan(dx, dy);
    else camera.orbit(dx, dy);
  });
  const release = (event) => {
    if (!held.delete(event.pointerId) || held.size) return;
    if (grabbed) modes.drop();
    else if (event.type === "pointerup" && event.button === 0 && moved <= CLICK_PIXELS) modes.act("click", ...placeOf(event), event);
    grabbed = false;
  };
  on(canvas, "pointerup", release);
  on(canvas, "pointercancel", release);
  on(canvas, "contextmenu", (event) => event.preventDefault());
  on(canvas, "wheel", (event) => {
    // A page with more than the picture scrolls, unless that has the focus: a reader scrolls past it undisturbed.
    if (!isWindow && document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    stage.request();
    camera.zoom(Math.exp(0.0015 * clamp(event.deltaY, -300, 300)));
  }, { passive: false });
}
