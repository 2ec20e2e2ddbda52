// The buttons and lists beside the picture, and the keys.
const NARROW = 700, MAX_FPS = 240;

// Where keys are typed, and what has keys of its own once Tab has gone to it.
const TEXT_FIELDS = "input:not([type=checkbox], [type=range], [type=file], [type=button]), textarea";
const OWN_KEYS = { SELECT: /./, INPUT: /^(\s|Enter|Arrow.*|Home|End|Page.*)$/, DIV: /^(Arrow.*|Home|End|Page.*)$/, BUTTON: /^(\s|Enter)$/, SUMMARY: /^(\s|Enter)$/ };

/** @param {Stage} stage */
function makeControls(stage) {
  const { section, transport, clip, view, camera } = stage, find = (name) => stage.find(name);
  const slider = find("time"), play = find("play"), text = find("frame"), note = find("note");
  const last = clip.count - 1;
  const goTo = (frame) => { transport.play(false); transport.go(frame); stage.request(true); };
  const toggle = () => { transport.play(!transport.isPlaying); stage.request(true); };

  on(slider, "input", () => goTo(Number(slider.value)));
  const clicks = { play: toggle, back: () => goTo(transport.frame - 1), on: () => goTo(transport.frame + 1), reset: () => stage.reset(), worst: () => stage.frameWorst(), help: () => section.querySelector("dialog").showModal() };
  for (const name in clicks) on(find(name), "click", clicks[name]);
  for (const name of ["undo", "redo"]) on(find(name), "click", () => stage.travel(name));
  const bind = (name, owner, key) => {
    const input = find(name), part = input.type === "checkbox" ? "checked" : "value";
    input[part] = owner[key];
    on(input, "change", () => { owner[key] = input[part]; stage.request(true); });
  };
  for (const key of ["speed", "loop", "smooth"]) bind(key, transport, key);
  for (const key of ["follow", "show", "colours", "cage", "edges", "grid"]) bind(key, view, key);
  on(find("edges"), "change", () => stage.sendEdges());
  on(find("xray"), "click", ({ currentTarget }) => {
    view.xray = !view.xray;
    currentTarget.setAttribute("aria-pressed", view.xray);
    stage.request();
  });
  const number = find("number"), fps = find("fps");
  Object.assign(number, { min: clip.ends[0], max: clip.ends[1], step: clip.step });
  on(number, "change", () => {
    if (Number.isFinite(number.valueAsNumber)) goTo(clip.frameOf(number.valueAsNumber));
    number.value = stage.number;
  });
  on(fps, "change", () => {
    if (fps.valueAsNumber > 0) transport.fps = min(fps.valueAsNumber, MAX_FPS);
    fps.value = transport.fps;
  });
  fps.value = ROUND(transport.fps);
  stage.fold = (isFolded) => {
    section.classList.toggle("folded", isFolded);
    find("fold").setAttribute("aria-expanded", !isFolded);
  };
  on(find("fold"), "click", () => stage.fold(!section.classList.contains("folded")));
  stage.fold(stage.isNarrow);
  for (const button of find("jumps").children) on(button, "click", () => goTo(Number(button.dataset.jump)));
  const face = (row) => faceTwice(camera, camera.upright[row]);
  const keys = {
    " ": toggle, ",": clicks.back, ".": clicks.on,
    Home: () => goTo(0), End: () => goTo(last), PageUp: () => goTo(transport.frame - 10), PageDown: () => goTo(transport.frame + 10),
    "+": () => camera.zoom(0.8), "=": () => camera.zoom(0.8), "-": () => camera.zoom(1.25),
    n: () => find("fold").click(), c: () => find("cage").click(), f: () => stage.frameChosen(), "?": clicks.help,
    0: clicks.reset, 1: () => face(FRONT), 3: () => face(SIDE), 7: () => face(TOP), w: () => { if (clip.focus) stage.frameWorst(); }, x: () => find("xray").click(),
  };
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  // In a window of its own the keys act wherever the focus is, on a page where it is in the player.
  const isWindow = section.classList.contains("app"), dialog = section.querySelector("dialog");
  let isByKey = false;
  on(document, "keydown", (event) => { isByKey ||= event.key === "Tab"; }, true);
  on(document, "pointerdown", () => { isByKey = false; }, true);
  const returnFocus = () => stage.canvas.focus({ preventScroll: true });
  // What was clicked with a pointer does not keep the keys.
  if (isWindow) for (const kind of ["click", "change"]) on(section, kind, ({ target, detail }) => {
    const control = target.closest("button, summary, select, input:not([type=file], [type=range])");
    if (isByKey || dialog.open || !control || control.matches(TEXT_FIELDS) || (kind === "click" && (!detail || control.matches("select")))) return;
    returnFocus();
  });
  on(isWindow ? document : section, "keydown", (event) => {
    const key = event.key.toLowerCase(), isCommand = event.ctrlKey || event.metaKey, { target } = event, isOf = (texts) => target.matches?.(texts);
    if (section.querySelector("dialog[open]")) return;
    // Texts that are typed have an undo of their own; Enter and Escape leave them.
    if (isOf(TEXT_FIELDS)) {
      if (!isByKey && (event.key === "Enter" || event.key === "Escape")) returnFocus();
      return;
    }
    const { transform } = stage.modes;
    if (transform) {
      if (transform.press(event)) event.preventDefault();
      stage.modes.describe();
      stage.request();
      return;
    }
    if (isCommand && "zy".includes(key)) {
      event.preventDefault();
      // Not by the button, which is as it was drawn last.
      stage.travel?.(event.shiftKey || key === "y" ? "redo" : "undo");
      return;
    }
    if ((isByKey || isOf("[type=range]")) && OWN_KEYS[target.tagName]?.test(event.key)) return;
    if (stage.modes.active.press?.(event)) { event.preventDefault(); stage.request(); return; }
    if (isCommand || event.altKey) return;
    const arrow = arrows[event.key], action = keys[event.key];
    if (!arrow && !action) return;
    event.preventDefault();
    if (action) action();
    else if (event.shiftKey) camera.pan(...scale(arrow, -40));
    else camera.orbit(...scale(arrow, 25));
    stage.request();
  });

  const describe = () => {
    const { frame } = transport, why = clip.held.get(frame)?.label;
    const error = clip.frameRms?.[frame];
    const parts = [clip.nameOf(frame), error == null ? "" : `error ${Number(error.toPrecision(3))} %`, clip.skipped.includes(frame) ? "skipped, interpolated" : "", why ? `${why} frame` : ""];
    return `frame ${clip.numberOf(frame)} of ${clip.ends.join(" to ")}: ${parts.filter(Boolean).join(", ")}`;
  };
  let shown = "";
  stage.listeners.push(() => {
    for (const [name, list] of Object.entries({ undo: stage.history?.past, redo: stage.history?.future })) find(name).disabled = !list?.length;
    note.textContent = transport.isPlaying ? "" : stage.before.explain() || (view.colours === "frame" && !clip.held.has(transport.frame) ? stage.before.listHeld("No error in this frame") : "");
    section.classList.toggle("split", stage.isSplit);
    const state = [transport.frame, transport.isPlaying, view.show, view.colours, stage.scale.unit, stage.scale.end].join();
    if (state === shown) return;
    shown = state;
    slider.value = transport.frame;
    if (number !== document.activeElement || transport.isPlaying) number.value = stage.number;
    slider.setAttribute("aria-valuetext", describe());
    play.textContent = transport.isPlaying ? "Pause" : "Play";
    text.textContent = clip.isClip ? describe() : "";
    showScale(find("scale"), stage.scale, clip.colours, ["rms", "frame"].includes(view.colours) && find("colours").selectedOptions[0].textContent);
  });
}

// Shows the title of what Tab has gone to; pointers see it by themselves.
/** @param {Stage} stage */
function makeTips(stage) {
  const { section } = stage, tip = stage.find("tip"), hide = () => { tip.hidden = true; };
  on(section, "focusin", ({ target }) => {
    tip.hidden = !target.title || !target.matches(":focus-visible") || target.matches("[type=range]");
    if (tip.hidden) return;
    tip.textContent = target.title;
    const box = target.getBoundingClientRect(), below = box.bottom + 8, { width, height } = tip.getBoundingClientRect();
    Object.assign(tip.style, { left: `${max(4, min(box.left, innerWidth - width - 4))}px`, top: `${below + height > innerHeight ? box.top - height - 8 : below}px` });
  });
  for (const kind of ["focusout", "pointerdown", "keydown", "scroll"]) on(section, kind, hide, true);
}

const makeElement = (tag, values) => Object.assign(document.createElement(tag), values);

const makeButton = (textContent, onclick, title = "") => makeElement("button", { type: "button", textContent, title, onclick });

// What the colours of the picture mean: from `low` (0, unless it is given) to `end`, in a unit.
function showScale(figure, { low = 0, end, unit = "% of the diagonal", shown }, colours, what) {
  figure.hidden = end === undefined;
  if (figure.hidden) return;
  figure.querySelector(".ramp").style.background = `linear-gradient(to right, ${(shown ?? colours).join(", ")})`;
  figure.querySelector("figcaption").textContent = what ? `${what}, ${unit}` : unit;
  const ticks = [0, 1, 2, 3, 4].map((k) => String(Number((low + (end - low) * k / 4).toPrecision(3))).replace("-", "\u2212"));
  figure.querySelectorAll(".ticks span").forEach((tick, k) => { tick.textContent = ticks[k]; });
}
