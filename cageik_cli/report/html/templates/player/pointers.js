// Mouse, pen and touch on the picture: one pointer turns the model or drags a handle, two move it.
const CLICK_PIXELS = 5;

const listenTo = (target, kind, action, options) => target.addEventListener(kind, action, options);

// `actions`: orbit(dx, dy), pan(dx, dy), zoom(factor), grab(x, y, event) → whether a handle was
// grabbed, drag(x, y), drop(), click(x, y), hover(x, y).
function listenToPointers(canvas, actions) {
  const held = new Map();
  let moved = 0, grabbed = false;
  const placeOf = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const spread = () => {
    const [[x, y], [u, v]] = [...held.values()];
    return { middle: [(x + u) / 2, (y + v) / 2], size: hypot(x - u, y - v) };
  };
  listenTo(canvas, "pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, placeOf(event));
    if (held.size > 1) { if (grabbed) actions.drop(); grabbed = false; moved = Infinity; return; }
    moved = 0;
    grabbed = event.button === 0 && actions.grab(...placeOf(event), event);
  });
  listenTo(canvas, "pointermove", (event) => {
    const [x, y] = placeOf(event);
    if (!held.has(event.pointerId)) { actions.hover(x, y); return; }
    const [left, top] = held.get(event.pointerId), dx = x - left, dy = y - top;
    const before = held.size === 2 ? spread() : null;
    held.set(event.pointerId, [x, y]);
    if (before) {
      const now = spread();
      actions.pan(now.middle[0] - before.middle[0], now.middle[1] - before.middle[1]);
      actions.zoom(before.size / (now.size || 1));
      return;
    }
    moved += hypot(dx, dy);
    if (grabbed) { if (moved > CLICK_PIXELS) actions.drag(x, y); }
    else if (event.buttons & 6 || event.shiftKey) actions.pan(dx, dy);
    else actions.orbit(dx, dy);
  });
  const release = (event) => {
    if (!held.delete(event.pointerId) || held.size) return;
    if (grabbed) actions.drop();
    else if (event.type === "pointerup" && event.button === 0 && moved <= CLICK_PIXELS) actions.click(...placeOf(event));
    grabbed = false;
  };
  listenTo(canvas, "pointerup", release);
  listenTo(canvas, "pointercancel", release);
  listenTo(canvas, "contextmenu", (event) => event.preventDefault());
  listenTo(canvas, "wheel", (event) => {
    // The page scrolls unless the picture has the focus: a reader scrolls past it undisturbed.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    actions.zoom(Math.exp(0.0015 * clamp(event.deltaY, -300, 300)));
  }, { passive: false });
}
