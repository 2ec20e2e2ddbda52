// The buttons and lists beside the picture, and its keys.
const NARROW = 700;

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
  const fold = (isFolded) => {
    section.classList.toggle("folded", isFolded);
    find("fold").setAttribute("aria-expanded", !isFolded);
  };
  on(find("fold"), "click", () => fold(!section.classList.contains("folded")));
  fold(section.clientWidth < NARROW);
  for (const button of find("jumps").children) on(button, "click", () => goTo(Number(button.dataset.jump)));
  const face = (row) => faceTwice(camera, camera.upright[row]);
  const keys = {
    " ": toggle, ",": clicks.back, ".": clicks.on,
    Home: () => goTo(0), End: () => goTo(last), PageUp: () => goTo(transport.frame - 10), PageDown: () => goTo(transport.frame + 10),
    "+": () => camera.zoom(0.8), "=": () => camera.zoom(0.8), "-": () => camera.zoom(1.25),
    n: () => find("fold").click(), c: () => find("cage").click(), f: () => stage.frameChosen(), "?": clicks.help,
    1: () => face(FRONT), 3: () => face(SIDE), 7: () => face(TOP), w: () => { if (clip.focus) stage.frameWorst(); }, r: clicks.reset,
  };
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  // In a window of its own the keys also act while nothing has the focus.
  const isWindow = section.classList.contains("app");
  on(isWindow ? document : stage.canvas, "keydown", (event) => {
    const key = event.key.toLowerCase(), isCommand = event.ctrlKey || event.metaKey;
    // Texts that are typed have an undo of their own.
    if (isCommand && "zy".includes(key) && !event.target.matches("input")) {
      event.preventDefault();
      // Not by the button, which is as it was drawn last.
      stage.travel?.(event.shiftKey || key === "y" ? "redo" : "undo");
    }
    if (![stage.canvas, document.body].includes(event.target)) return;
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
  const listHeld = () => `the page holds the input of frames ${[...clip.held.keys()].sort((a, b) => a - b).map((frame) => clip.numberOf(frame)).join(", ")}`;
  let shown = "";
  stage.listeners.push(() => {
    for (const [name, list] of Object.entries({ undo: stage.history?.past, redo: stage.history?.future })) find(name).disabled = !list?.length;
    const state = [transport.frame, transport.isPlaying, view.show, view.colours, stage.scale.unit, stage.scale.end].join();
    if (state === shown) return;
    shown = state;
    slider.value = transport.frame;
    slider.setAttribute("aria-valuetext", describe());
    play.textContent = transport.isPlaying ? "Pause" : "Play";
    text.textContent = clip.isClip ? describe() : "";
    const wantsInput = ["input", "both"].includes(view.show) || view.colours === "frame";
    note.textContent = wantsInput && !stage.hasInput && !transport.isPlaying ? `No input in this frame; ${listHeld()}.` : "";
    section.classList.toggle("split", stage.isSplit);
    showScale(find("scale"), stage.scale, clip.colours, ["rms", "frame"].includes(view.colours) && find("colours").selectedOptions[0].textContent);
  });
}

const makeElement = (tag, values) => Object.assign(document.createElement(tag), values);

const makeButton = (textContent, onclick) => makeElement("button", { type: "button", textContent, onclick });

// What the colours of the picture mean: from `low` (0, unless it is given) to `end`, in a unit.
function showScale(figure, { low = 0, end, unit = "% of the diagonal", shown }, colours, what) {
  figure.hidden = end === undefined;
  if (figure.hidden) return;
  figure.querySelector(".ramp").style.background = `linear-gradient(to right, ${(shown ?? colours).join(", ")})`;
  figure.querySelector("figcaption").textContent = what ? `${what}, ${unit}` : unit;
  const ticks = [0, 1, 2, 3, 4].map((k) => String(Number((low + (end - low) * k / 4).toPrecision(3))).replace("-", "\u2212"));
  figure.querySelectorAll(".ticks span").forEach((tick, k) => { tick.textContent = ticks[k]; });
}
