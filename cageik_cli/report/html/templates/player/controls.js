// The buttons and lists under the picture, and its keys.
function makeControls(section, stage) {
  const { transport, clip, view, camera } = stage;
  const find = (name) => section.querySelector(`[data-${name}]`);
  const slider = find("time"), play = find("play"), text = find("frame"), note = find("note");
  const last = clip.count - 1;
  const goTo = (frame) => { transport.play(false); transport.go(frame); stage.request(true); };
  const toggle = () => { transport.play(!transport.isPlaying); stage.request(true); };

  slider.max = last;
  listenTo(slider, "input", () => goTo(Number(slider.value)));
  const clicks = { play: toggle, back: () => goTo(transport.frame - 1), on: () => goTo(transport.frame + 1), reset: () => stage.reset(), worst: () => stage.frameWorst() };
  for (const name in clicks) listenTo(find(name), "click", clicks[name]);
  const bind = (name, owner, key) => {
    const input = find(name), part = input.type === "checkbox" ? "checked" : "value";
    input[part] = owner[key];
    listenTo(input, "change", () => { owner[key] = input[part]; stage.request(true); });
  };
  for (const key of ["speed", "loop", "smooth"]) bind(key, transport, key);
  for (const key of ["follow", "show", "colours", "cage", "edges"]) bind(key, view, key);
  listenTo(find("edges"), "change", () => stage.sendEdges());
  find("worst").hidden = !clip.header.focus;
  const jumps = find("jumps");
  for (const [frame, { label }] of clip.held) {
    jumps.append(makeButton(`${label} frame`, () => goTo(frame)));
  }
  const needs = { clip: clip.header.isClip, held: clip.held.size, rms: clip.header.rms };
  for (const need in needs) for (const one of section.querySelectorAll(`[data-${need}-only]`)) one.hidden = one.disabled = !needs[need];

  const keys = {
    " ": toggle, ",": clicks.back, ".": clicks.on,
    Home: () => goTo(0), End: () => goTo(last), PageUp: () => goTo(transport.frame - 10), PageDown: () => goTo(transport.frame + 10),
    "+": () => camera.zoom(0.8), "=": () => camera.zoom(0.8), "-": () => camera.zoom(1.25),
    c: () => find("cage").click(), w: () => { if (clip.header.focus) stage.frameWorst(); }, r: clicks.reset,
  };
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  listenTo(stage.canvas, "keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented) return;
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
    const parts = [clip.nameOf(frame), clip.header.skipped.includes(frame) ? "skipped, interpolated" : "", why ? `${why} frame` : ""];
    return `frame ${clip.numberOf(frame)} of ${clip.ends.join(" to ")}: ${parts.filter(Boolean).join(", ")}`;
  };
  const listHeld = () => `the page holds the input of frames ${[...clip.held.keys()].sort((a, b) => a - b).map((frame) => clip.numberOf(frame)).join(", ")}`;
  let shown = "";
  stage.listeners.push(() => {
    const state = [transport.frame, transport.isPlaying, view.show, view.colours].join();
    if (state === shown) return;
    shown = state;
    slider.value = transport.frame;
    slider.setAttribute("aria-valuetext", describe());
    play.textContent = transport.isPlaying ? "Pause" : "Play";
    text.textContent = clip.header.isClip ? describe() : "";
    const isMissing = !stage.hasInput && !transport.isPlaying;
    const wantsInput = ["input", "both"].includes(view.show), wantsError = view.colours === "frame";
    note.textContent = isMissing && (wantsInput || wantsError) ? `No input in this frame; ${listHeld()}.` : "";
    section.classList.toggle("split", view.show === "both" && stage.hasInput);
    showScale(find("scale"), stage.scale, clip.header.colours);
  });
}

const makeElement = (tag, values) => Object.assign(document.createElement(tag), values);

const makeButton = (textContent, onclick) => makeElement("button", { type: "button", textContent, onclick });

function showScale(figure, { end }, colours) {
  figure.hidden = end === undefined;
  if (figure.hidden) return;
  figure.querySelector(".ramp").style.background = `linear-gradient(to right, ${colours.join(", ")})`;
  const ticks = [0, 1, 2, 3, 4].map((k) => Number((end * k / 4).toPrecision(4)));
  figure.querySelectorAll(".ticks span").forEach((tick, k) => { tick.textContent = ticks[k]; });
}
