// What pointers and keys on the picture do. One mode is on; its group of the panel is shown, and its
// part of the list of keys. A mode is an object of its name, which these have, and of functions that may be absent:
// - grab(x, y, event): whether something was grabbed, else the camera turns; then drag(x, y), drop();
// - click(x, y, event): in pixels of the part of the picture that shows the model;
// - hover(x, y, event): what is under the pointer, as a `Hover`;
// - press(event): a key on the picture; whether it was taken;
// - paint(values): the places of the vertices on a ramp, which it fills; returns what `Colours.choose` does, or null;
// - draw(renderer): marks over the picture;
// - chosen(): the points that are chosen, in the units of the picture, which the key F frames;
// - show(), hide(): the mode is chosen, left.
// A transform that began has the pointer and the keys until it ends.
const TRANSFORM_HINT = "X Y Z: along an axis; numbers; Enter or a click keeps it, Escape or a right click puts it back";

class Modes {
  constructor(stage) {
    Object.assign(this, { stage, list: [], active: {}, isDragging: false, transform: null, pointer: null, highlight: stage.find("highlight") });
    stage.listeners.push(() => this.describe());
  }

  /** @param {Mode} mode */
  add(mode) {
    const [button, panel, keys] = ["mode", "panel", "keys-of"].map((kind) => this.stage.find(`${kind}="${mode.name}"`));
    on(button, "click", () => {
      const { stage } = this, isOpen = this.active.name === mode.name && !stage.section.classList.contains("folded");
      this.choose(mode.name);
      // Where the panel is a sheet over the page, it has the tools of the mode.
      if (stage.isNarrow) stage.fold(isOpen);
    });
    this.list.push({ ...mode, button, panel, keys });
  }

  choose(name) {
    const mode = this.list.find((one) => one.name === name) ?? this.list[0];
    if (mode === this.active) return;
    this.transform?.finish(true);
    this.active.hide?.();
    this.active = mode;
    for (const one of this.list) {
      one.button.setAttribute("aria-pressed", one === mode);
      one.keys.hidden = one !== mode;
      // How the model is drawn can be changed in all modes.
      if (one.name === "look") one.panel.open = one === mode;
      else one.panel.hidden = one !== mode;
    }
    this.stage.section.dataset.mode = mode.name;
    this.say("");
    mode.show?.();
    this.hover();
    this.stage.request();
  }

  // Begins a transform, with the values of one; `end` keeps what it did, or puts it back.
  // Without a pixel to start from, that is where the pointer is.
  begin({ apply, end, ...values }) {
    const { stage, pointer } = this, start = pointer && [stage.partOf(pointer[0]), pointer[1]];
    this.transform?.finish(true);
    stage.transport.play(false);
    stage.history.complaint = "";
    this.transform = new Transform(stage, {
      start,
      ...values,
      apply: (transform) => {
        this.isDragging = true;
        apply(transform);
      },
      end: (isKept) => {
        this.transform = null;
        this.isDragging = false;
        this.say("");
        end(isKept);
        stage.request();
      },
    });
    if (!values.start) this.describe();
    this.hover(pointer);
    return this.transform;
  }

  // Says what a transform does.
  describe() { if (this.transform) this.say(this.stage.history.complaint || `${this.transform.text} (${TRANSFORM_HINT})`); }

  // Shows what is under a pixel of the canvas: says and highlights it, and sets the cursor. Without a pixel nothing is.
  hover(pointer = null) {
    const { stage, highlight, transform } = this;
    this.pointer = pointer;
    const found = transform ? { cursor: "move" } : !pointer || stage.transport.isPlaying ? {} : this.act("hover", ...pointer) ?? {};
    const { text, cursor = "", kind = "", points = [] } = found;
    if (text !== undefined) this.say(text);
    stage.canvas.style.cursor = cursor;
    highlight.className = kind;
    if (!kind) return;
    const [[x, y], [u, v]] = [points[0], points.at(-1)].map((point) => stage.camera.project(point)), left = stage.canvas.clientWidth - stage.camera.width;
    Object.assign(highlight.style, { left: `${x + left}px`, top: `${y}px`, width: kind === "arm" ? `${hypot(u - x, v - y)}px` : "", rotate: `${Math.atan2(v - y, u - x)}rad` });
  }

  // Says what is under the pointer.
  say(text) { this.stage.find("under").textContent = text; }

  // Does in the mode what its name says, at a pixel of the canvas.
  act(name, x, y, event) { return this.active[name]?.(this.stage.partOf(x), y, event); }

  drag(x, y) {
    this.isDragging = true;
    this.act("drag", x, y);
  }

  drop() {
    this.isDragging = false;
    this.active.drop?.();
    this.stage.request();
  }
}

// The surface point under a pixel, or null: the nearest vertex of its face, and how many pixels away it is.
/** @param {Stage} stage @param {number} x @param {number} y */
function pickSurface(stage, x, y) {
  if (stage.transport.isPlaying) return null;
  const { clip, camera, positions } = stage, found = stage.skin.pick(positions, camera.ray(x, y));
  if (!found) return null;
  const near = found.corners[found.barycentric.indexOf(max(...found.barycentric))];
  const [u, v] = camera.project(pointOf(positions, near)), shares = found.barycentric.map((share) => Number(share.toFixed(6)));
  shares[0] = Number((1 - shares[1] - shares[2]).toFixed(6));
  return { ...found, near, vertex: clip.fileVertex(near), shares, pixels: hypot(u - x, v - y) };
}

// A point of the surface, by its corners and shares.
const placeOn = (positions, { corners, shares }) => corners.reduce((sum, vertex, k) => add(sum, scale(pointOf(positions, vertex), shares[k])), [0, 0, 0]);

const describePlace = ({ vertex, face, shares }) => `vertex ${vertex}; face ${face}, barycentric ${shares.join(", ")}`;

// Nothing is changed; a click says what is there, and marks its vertex.
/** @param {Stage} stage */
function makeLook(stage) {
  let picked = null;
  stage.modes.add({
    name: "look",
    click(x, y) {
      picked = pickSurface(stage, x, y);
      stage.modes.say(picked ? describePlace(picked) : "");
      stage.request();
    },
    press(event) {
      if (event.key !== "Escape" || !picked) return false;
      picked = null;
      stage.modes.say("");
      return true;
    },
    draw: (renderer) => { if (picked) renderer.drawDots(pointOf(stage.positions, picked.near), RED, 9); },
    chosen: () => picked ? [pointOf(stage.positions, picked.near)] : [],
    hide() { picked = null; },
  });
}
