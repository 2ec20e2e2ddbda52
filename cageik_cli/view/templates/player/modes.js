// What pointers and keys on the picture do. One mode is on; its group of the panel is shown, and its
// part of the list of keys. A mode is an object of its name, which these have, and of functions that may be absent:
// - grab(x, y, event): whether something was grabbed, else the camera turns; then drag(x, y), drop();
// - click(x, y, event), hover(x, y): in pixels of the part of the picture that shows the model;
// - press(event): a key on the picture; whether it was taken;
// - paint(values): the places of the vertices on a ramp, which it fills; returns what `Colours.choose` does, or null;
// - draw(renderer): marks over the picture;
// - chosen(): the points that are chosen, in the units of the picture, which the key F frames;
// - show(), hide(): the mode is chosen, left.
class Modes {
  constructor(stage) { Object.assign(this, { stage, list: [], active: {}, isDragging: false }); }

  /** @param {Mode} mode */
  add(mode) {
    const [button, panel, keys] = ["mode", "panel", "keys-of"].map((kind) => this.stage.find(`${kind}="${mode.name}"`));
    on(button, "click", () => this.choose(mode.name));
    this.list.push({ ...mode, button, panel, keys });
  }

  choose(name) {
    const mode = this.list.find((one) => one.name === name) ?? this.list[0];
    if (mode === this.active) return;
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
    this.stage.request();
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
