// Mouse, pen and touch on the picture: one pointer turns the model, drags a handle or moves what is transformed; two move the model.
const CLICK_PIXELS = 5, PAN_BUTTONS = 6;

const on = (target, kind, action, options) => target.addEventListener(kind, action, options);

/** @param {Stage} stage */
function listenToPointers(stage) {
  const { canvas, camera, modes } = stage, held = new Map(), isWindow = Boolean(canvas.closest(".app"));
  // What the pointer that is down does: "camera", "grab", "transform", or nothing.
  let moved = 0, work = "";
  const placeOf = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const spread = () => {
    const [[x, y], [u, v]] = [...held.values()];
    return { middle: [(x + u) / 2, (y + v) / 2], size: hypot(x - u, y - v) };
  };
  const transform = (x, y) => { modes.transform?.move(stage.partOf(x), y); };
  on(canvas, "pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    const at = placeOf(event), { cursor } = canvas.style;
    held.set(event.pointerId, at);
    if (held.size > 1) {
      if (work === "grab") modes.drop();
      modes.transform?.finish(false);
      work = "camera";
      moved = Infinity;
      return;
    }
    moved = 0;
    if (modes.transform) {
      work = "transform";
      if (event.button === 2) modes.transform.finish(false);
      else transform(...at);
      return;
    }
    work = event.button === 0 && modes.act("grab", ...at, event) ? "grab" : "camera";
    modes.hover();
    canvas.style.cursor = cursor === "crosshair" ? cursor : work === "camera" && (event.button || event.shiftKey) ? "move" : "grabbing";
  });
  on(canvas, "pointermove", (event) => {
    const [x, y] = placeOf(event);
    if (!held.has(event.pointerId)) {
      modes.hover([x, y, event]);
      transform(x, y);
      return;
    }
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
    // A right click ends a drag; a button beside another one is told by a move.
    if (work === "grab" && event.buttons & 2) modes.transform?.finish(false);
    if (work === "transform") transform(x, y);
    else if (work === "grab") { if (moved > CLICK_PIXELS) modes.drag(x, y); }
    else if (event.buttons & PAN_BUTTONS || event.shiftKey) camera.pan(dx, dy);
    else camera.orbit(dx, dy);
  });
  const release = (event) => {
    if (!held.delete(event.pointerId) || held.size) return;
    const at = placeOf(event);
    if (work === "transform") modes.transform?.finish(event.type === "pointerup");
    else if (work === "grab") modes.drop();
    else if (event.type === "pointerup" && event.button === 0 && moved <= CLICK_PIXELS) modes.act("click", ...at, event);
    work = "";
    modes.hover(event.pointerType === "touch" ? null : [...at, event]);
  };
  on(canvas, "pointerup", release);
  on(canvas, "pointercancel", release);
  on(canvas, "pointerleave", () => { if (!held.size) modes.hover(); });
  // What is pressed beside the picture acts on what was transformed.
  on(document, "pointerdown", ({ target }) => { if (target !== canvas) modes.transform?.finish(true); }, true);
  on(canvas, "contextmenu", (event) => event.preventDefault());
  on(canvas, "wheel", (event) => {
    // A page with more than the picture scrolls, unless that has the focus: a reader scrolls past it undisturbed.
    if (!isWindow && document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    stage.request();
    const factor = Math.exp(0.0015 * clamp(event.deltaY, -300, 300));
    if (!modes.transform?.reach(1 / factor)) camera.zoom(factor);
  }, { passive: false });
}
