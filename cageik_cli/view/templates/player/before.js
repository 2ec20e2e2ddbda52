// What is shown beside the model or over it: the mesh before, of which the page holds some frames and may ask its server for all
// (view/before.py), or which the model is without the edits of this page; and ghosts of neighbouring frames.
const ASKED_FRAMES = 16, KEPT_BYTES = 1 << 26, BUSY = 409, BUSY_MILLISECONDS = 300;

const GHOSTS = { before: [0.72, 0.25, 0.62], past: [0.86, 0.42, 0.1], future: [0.1, 0.58, 0.5] };

class Before {
  /** @param {Stage} stage */
  constructor(stage) {
    const choice = stage.section.querySelector("[data-before]");
    Object.assign(this, { stage, choice, isHeld: false, kept: new Map(), asking: "", errors: {}, drawn: [], ghosts: 0, every: 1 });
  }

  get kind() { return this.choice.value; }

  // Whether it is drawn alone, beside the model, or over it.
  get isAlone() { return Boolean(this.mesh) && (this.isHeld || this.stage.view.show === "input"); }

  get isSplit() { return Boolean(this.mesh) && !this.isHeld && this.stage.view.show === "both"; }

  get isGhost() { return Boolean(this.mesh) && !this.isHeld && this.stage.view.show === "ghost"; }

  get isWanted() { return Boolean(this.kind) && (this.isHeld || ["input", "both", "ghost"].includes(this.stage.view.show)); }

  // Why it is not shown, in words; "" if it is, or is not wanted.
  explain() {
    if (!this.isWanted || this.mesh) return "";
    const { kind, errors, stage: { clip } } = this;
    if (errors[kind]) return `${errors[kind]}.`;
    if (this.asking) return "Reading …";
    return kind === clip.original ? this.listHeld(`No ${this.choice.selectedOptions[0].textContent} in this frame`) : "This frame has none.";
  }

  // Says of what a frame lacks which frames the page holds it of.
  listHeld(what) {
    const { clip } = this.stage, held = [...clip.held.keys()].sort((a, b) => a - b).map((frame) => clip.numberOf(frame));
    return `${what}; the page holds that of frames ${held.join(", ")}.`;
  }

  // Finds the mesh, if it is wanted, and those of the neighbours.
  compute() {
    const { stage } = this, { frame, share } = stage.transport;
    this.mesh = null;
    if (this.isWanted) {
      const one = this.find(frame), other = share && one ? this.find(frame + 1) : null;
      if (one && !share) this.mesh = one;
      else if (one && other) this.mesh = blend(one, other, share);
      this.fetchMissing(frame);
    }
    if (this.mesh) {
      stage.input.set(this.mesh);
      this.send("input", stage.input);
      stage.renderer.upload("zeros", new Float32Array(stage.colours.values.length));
    }
    this.computeNeighbours();
  }

  send(name, positions) {
    const { skin, renderer } = this.stage, normals = new Float32Array(positions.length);
    skin.normals(positions, normals);
    renderer.upload(`${name}Positions`, positions);
    renderer.upload(`${name}Normals`, normals);
  }

  // The positions of a frame; null if they are not here.
  find(frame) {
    const { stage, kind } = this, { clip } = stage;
    if (kind === "live") return stage.originalPositions(frame);
    const kept = this.kept.get(`${kind} ${frame}`);
    if (kept) return isNaN(kept[0]) ? null : kept;
    if (kind !== clip.original || !clip.held.has(frame)) return null;
    const held = new Float32Array(stage.input.length);
    clip.input(frame, stage.originalPositions(frame), held);
    return held;
  }

  // Asks the server for the first of the next frames that are not here, one request at a time.
  fetchMissing(frame) {
    const { kind, stage: { clip } } = this;
    if (this.asking || !clip.before.includes(kind) || this.errors[kind]) return;
    const next = listOf(ASKED_FRAMES / 2, (k) => (frame + k) % clip.count), first = next.find((k) => !this.kept.has(`${kind} ${k}`));
    if (first !== undefined) this.ask(kind, first);
  }

  async ask(kind, first) {
    this.asking = kind;
    try {
      const all = await fetchFrames(kind, first, min(ASKED_FRAMES, this.stage.clip.count - first)), size = this.stage.input.length;
      for (let k = 0; k * size < all.length; k++) this.keep(`${kind} ${first + k}`, all.slice(k * size, (k + 1) * size));
    } catch (error) {
      // Another page asks at the same time: it is soon done.
      if (error.status === BUSY) await new Promise((go) => setTimeout(go, BUSY_MILLISECONDS));
      else this.errors[kind] = error.message;
    }
    this.asking = "";
    this.stage.request(true);
  }

  // Keeps positions; those that were kept first go when there are too many.
  keep(name, positions) {
    this.kept.set(name, positions);
    const most = max(2 * ASKED_FRAMES, floor(KEPT_BYTES / positions.byteLength));
    for (const old of this.kept.keys()) if (this.kept.size > most) this.kept.delete(old);
  }

  // Ghosts of the frames before and after, the farthest first. While the model is dragged they stay as they were; without a
  // graphics card they go, so that a drag stays smooth.
  computeNeighbours() {
    const { stage, ghosts, every } = this, { transport, clip, skin } = stage;
    if (!ghosts || transport.isPlaying || stage.renderer.isSlow && stage.isMoving) { this.drawn = []; return; }
    if (stage.isMoving && this.drawn.length) return;
    this.drawn = [];
    for (let k = ghosts; k; k--) for (const way of [-1, 1]) {
      const frame = transport.frame + way * k * every;
      if (frame < 0 || frame >= clip.count) continue;
      const name = `ghost ${this.drawn.length}`, positions = new Float32Array(stage.positions.length);
      skin.deform(stage.cageAt(frame), clip.rotation(frame), positions);
      this.send(name, positions);
      this.drawn.push({ name, paint: [...way < 0 ? GHOSTS.past : GHOSTS.future, 0.5 / (k + 0.6)] });
    }
  }

  draw(renderer, light) {
    const all = this.isGhost ? [...this.drawn, { name: "input", paint: [...GHOSTS.before, 0.5] }] : this.drawn;
    for (const { name, paint } of all) renderer.drawGhost([`${name}Positions`, `${name}Normals`], paint, light);
  }
}

// Its lists, its button and its key, which show the mesh before while they are held; and the button that copies the view.
extensions.push((stage) => {
  const { before, view, camera } = stage, find = (name) => stage.find(name);
  const ask = () => {
    before.errors = {};
    stage.request(true);
  };
  for (const name of ["before", "show"]) on(find(name), "change", ask);
  for (const name of ["ghosts", "every"]) on(find(name), "change", () => { before[name] = Number(find(name).value); ask(); });
  const hold = (isHeld) => {
    if (before.isHeld === isHeld || !before.kind) return;
    before.isHeld = isHeld;
    find("hold").setAttribute("aria-pressed", isHeld);
    stage.request(true);
  };
  const release = () => hold(false), places = [stage.section, ...stage.section.classList.contains("app") ? [document.body] : []];
  on(document, "keydown", (event) => {
    const isPlain = !event.ctrlKey && !event.metaKey && !event.altKey;
    const isHere = places.some((place) => place.contains(event.target)) && !event.target.matches?.(TEXT_FIELDS);
    if (event.key.toLowerCase() === "v" && isPlain && isHere && !stage.section.querySelector("dialog[open]")) hold(true);
  });
  on(document, "keyup", (event) => { if (event.key.toLowerCase() === "v") release(); });
  on(window, "blur", release);
  const button = find("hold");
  on(button, "pointerdown", (event) => { button.setPointerCapture(event.pointerId); hold(true); });
  for (const kind of ["pointerup", "pointercancel", "blur"]) on(button, kind, release);
  on(button, "keydown", (event) => { if (" Enter".includes(event.key)) { event.preventDefault(); hold(true); } });
  on(button, "keyup", release);
  on(find("copy"), "click", async () => {
    const place = view.follow ? camera.target : camera.centre();
    const text = [camera.turn, camera.tilt, camera.distance, ...place].map(ROUND).join() + (view.follow ? ",follow" : "");
    try {
      await navigator.clipboard.writeText(text);
      stage.modes.say(`copied ${text}`);
    } catch { stage.modes.say(`view ${text}`); }
  });
  stage.listeners.push(() => { find("before-name").textContent = before.kind && before.choice.selectedOptions[0].textContent; });
});
