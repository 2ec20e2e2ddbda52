// The buttons and lists under the picture, and its keys.
function makeControls(section, stage) {
  const { transport, clip, view, camera } = stage;
  const find = (name) => section.querySelector(`[data-${name}]`);
  const slider = find("time"), play = find("play"), text = find("frame"), note = find("note");
  const last = clip.count - 1;
  const goTo = (frame) => { transport.play(false); transport.go(frame); stage.request(true); };
  const toggle = () => { transport.play(!transport.isPlaying); stage.request(true); };

  slider.max = last;
  slider.addEventListener("input", () => goTo(Number(slider.value)));
  play.addEventListener("click", toggle);
  find("back").addEventListener("click", () => goTo(transport.frame - 1));
  find("on").addEventListener("click", () => goTo(transport.frame + 1));
  find("speed").addEventListener("change", (event) => { transport.speed = Number(event.target.value); });
  find("loop").addEventListener("change", (event) => { transport.isLooping = event.target.checked; });
  find("smooth").addEventListener("change", (event) => { transport.isSmooth = event.target.checked; });
  find("follow").checked = view.isFollowing;
  find("follow").addEventListener("change", (event) => { view.isFollowing = event.target.checked; stage.request(true); });
  find("show").addEventListener("change", (event) => { view.show = event.target.value; stage.request(true); });
  find("colours").addEventListener("change", (event) => { view.colours = event.target.value; stage.request(true); });
  find("cage").addEventListener("change", (event) => { view.hasCage = event.target.checked; stage.request(); });
  find("reset").addEventListener("click", () => stage.reset());
  find("worst").hidden = !clip.header.focus;
  find("worst").addEventListener("click", () => stage.frameWorst());
  const jumps = find("jumps");
  for (const [frame, { label }] of clip.held) {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: `${label} frame` });
    button.addEventListener("click", () => goTo(frame));
    jumps.append(button);
  }
  for (const one of section.querySelectorAll("[data-clip-only]")) one.hidden = !clip.header.isClip;
  for (const one of section.querySelectorAll("[data-held-only]")) one.hidden = one.disabled = !clip.held.size;
  for (const one of section.querySelectorAll("[data-rms-only]")) one.hidden = one.disabled = !clip.header.rms;

  const keys = {
    " ": toggle, ",": () => goTo(transport.frame - 1), ".": () => goTo(transport.frame + 1),
    Home: () => goTo(0), End: () => goTo(last), PageUp: () => goTo(transport.frame - 10), PageDown: () => goTo(transport.frame + 10),
    ArrowLeft: () => camera.orbit(-25, 0), ArrowRight: () => camera.orbit(25, 0), ArrowUp: () => camera.orbit(0, -25), ArrowDown: () => camera.orbit(0, 25),
    "+": () => camera.zoom(0.8), "=": () => camera.zoom(0.8), "-": () => camera.zoom(1.25),
    c: () => find("cage").click(), w: () => { if (clip.header.focus) stage.frameWorst(); }, r: () => stage.reset(),
  };
  const shifted = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
  stage.canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented) return;
    const pan = event.shiftKey && shifted[event.key], action = pan ? () => camera.pan(...pan) : keys[event.key];
    if (!action) return;
    event.preventDefault();
    action();
    stage.request();
  });

  const describe = () => {
    const { frame } = transport, why = clip.held.get(frame)?.label;
    const parts = [clip.nameOf(frame), clip.header.skipped.includes(frame) ? "skipped, interpolated" : "", why ? `${why} frame` : ""];
    return `frame ${frame} of 0 to ${last}: ${parts.filter(Boolean).join(", ")}`;
  };
  const listHeld = () => `the page holds the input of frames ${[...clip.held.keys()].sort((a, b) => a - b).join(", ")}`;
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

function showScale(figure, { end }, colours) {
  figure.hidden = end === undefined;
  if (figure.hidden) return;
  figure.querySelector(".ramp").style.background = `linear-gradient(to right, ${colours.join(", ")})`;
  const ticks = [0, 1, 2, 3, 4].map((k) => Number((end * k / 4).toPrecision(4)));
  figure.querySelectorAll(".ticks span").forEach((tick, k) => { tick.textContent = ticks[k]; });
}
