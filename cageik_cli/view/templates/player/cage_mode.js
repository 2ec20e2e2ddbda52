// The mode of cage vertices: they are chosen by clicks, boxes and numbers, and dragged in the plane of the screen
// or along the axes of a gizmo; the panel has their offsets, frames and keys.
const GIZMO_PIXELS = 64;
const AXIS_PAINTS = { x: [0.84, 0.19, 0.19, 1], y: [0.13, 0.55, 0.13, 1], z: [0.16, 0.36, 0.9, 1] };

// The active cage edit of the editor, and how it is changed.
class CageEditing {
  constructor(stage) {
    const { clip, editor } = stage, { mirror } = clip;
    Object.assign(this, { stage, clip, editor, active: 0, mirrors: false, selection: new CageSelection(clip) });
    this.mirror = mirror && { normal: normalize(mirror.normal), point: clip.fromFile(mirror.point) };
    this.partners = this.mirror && findPartners(stage.skin.cage, this.mirror);
  }

  get file() { return this.editor.cageFile; }

  get edit() { return this.file.edits[min(this.active, this.file.edits.length - 1)]; }

  // The edit that is active, or a first one.
  need() {
    if (!this.edit) this.add();
    return this.edit;
  }

  add() {
    const { edits } = this.file;
    edits.push({ name: findName("edit", edits), moves: [] });
    this.active = edits.length - 1;
  }

  moveOf(vertex) { return this.edit?.moves.find((move) => move.vertex === vertex); }

  // The offset of a vertex in this frame at full strength.
  offset(vertex) {
    const move = this.moveOf(vertex);
    return move ? evaluateTrack(move.offset, this.stage.number) : [0, 0, 0];
  }

  get offsets() { return this.selection.near.map((_, vertex) => this.offset(vertex)); }

  // The move of a vertex, or a first one.
  needMove(vertex) {
    const { moves } = this.need();
    if (!this.moveOf(vertex)) moves.push({ vertex, offset: [0, 0, 0] });
    return this.moveOf(vertex);
  }

  place(vertex) { return pointOf(this.stage.cage, vertex); }

  placesOf(vertices) { return vertices.map((vertex) => this.place(vertex)); }

  get places() { return listPoints(this.stage.cage); }

  // Where what is chosen is.
  get chosen() { return this.placesOf([...this.selection.chosen]); }

  // The offsets of this frame if what is chosen moves from `starts` by a vector of the world, in file units.
  spread(vector, starts = this.offsets) {
    const { shares } = this.selection, moved = new Map();
    for (const [vertex, share] of shares) moved.set(vertex, scale(vector, share));
    if (this.mirrors) this.reflect(moved);
    return [...moved].map(([vertex, move]) => [vertex, add(starts[vertex], move)]);
  }

  // Moves partners as mirror images; of two that are chosen, the one on the side of the last leads.
  reflect(moved) {
    const normal = turn(this.mirror.normal, this.clip.rotation(this.stage.frame)), { cage } = this.stage.skin;
    const sideOf = (vertex) => Math.sign(dot(minus(pointOf(cage, vertex), this.mirror.point), this.mirror.normal));
    const leading = sideOf(this.selection.last) || 1, across = (move, factor) => minus(move, scale(normal, factor * dot(move, normal)));
    for (const [vertex, move] of [...moved]) {
      const partner = this.partners[vertex];
      if (partner === vertex) moved.set(vertex, across(move, 1));
      else if (!moved.has(partner) || sideOf(vertex) === leading) moved.set(partner, across(move, 2));
    }
  }

  // How strong the edit is in this frame; refused if it is not.
  get strength() { return needStrength(this.need(), this.stage.number); }

  // Sets offsets of vertices in this frame: keys of moves that have keys, else all frames.
  set(offsets) {
    needStrength(this.need(), this.stage.number);
    for (const [vertex, offset] of offsets) {
      const move = this.needMove(vertex);
      move.offset = setValue(move.offset, this.stage.number, shortenPoint(offset));
    }
    this.editor.refresh();
  }

  // Makes keys of the offsets of all that moves along.
  setKeys() {
    for (const vertex of this.selection.shares.keys()) {
      const move = this.needMove(vertex);
      move.offset = setKey(move.offset, this.stage.number);
    }
  }

  removeKeys() {
    for (const move of this.edit?.moves ?? []) if (this.selection.shares.has(move.vertex)) move.offset = removeKey(move.offset, this.stage.number);
  }

  // Takes the moves of what is chosen out of the edit.
  clear() {
    this.edit.moves = this.edit.moves.filter(({ vertex }) => !this.selection.shares.has(vertex));
  }

  // The middle of what is chosen, and the tips of axes there by their names; not of those that are seen end on.
  gizmo() {
    const { chosen, stage: { camera } } = this;
    if (!chosen.length) return null;
    const middle = meanOf(chosen.flat()), size = 2 * GIZMO_PIXELS * camera.spans()[1] * camera.project(middle)[2] / camera.height;
    const isSeen = ({ tip }) => { const [x, y] = camera.project(tip); return nearestPoint(camera, [middle], x, y) < 0; };
    return { middle, tips: Object.entries(AXES).map(([axis, unit]) => ({ axis, tip: add(middle, scale(unit, size)) })).filter(isSeen) };
  }
}

/** @param {Stage} stage */
function makeCageMode(stage) {
  const cages = stage.cages = new CageEditing(stage), { editor, clip, camera, transport } = stage, { selection } = cages, panel = new Panel(stage, "cage", "cage-", editor);
  let grip = null, boxes = false;

  const hit = (x, y, event) => nearestPoint(camera, cages.places, x, y, event);
  // The arm of the gizmo under a pixel: not at its foot, where the vertex itself is.
  const armAt = (x, y) => {
    const gizmo = cages.gizmo();
    if (!gizmo || !nearestPoint(camera, [gizmo.middle], x, y)) return undefined;
    return gizmo.tips[nearestSegment(camera, gizmo.tips.map(({ tip }) => [gizmo.middle, tip]), x, y)]?.axis;
  };
  const grabBox = (x, y) => {
    const box = new SelectionBox(camera, x, y), kept = [...selection.chosen];
    return {
      box,
      drag(u, v) {
        box.to = [u, v];
        selection.choose([...kept, ...box.list(cages.places)]);
        stage.request();
      },
    };
  };
  const grabVertices = (x, y, event) => {
    const axis = armAt(x, y), vertex = axis ? -1 : hit(x, y, event);
    if (!axis && (vertex < 0 || event.shiftKey)) return null;
    if (!axis && !selection.chosen.has(vertex)) selection.choose([vertex]);
    const follow = followPointer(camera, x, y, axis ? cages.gizmo().middle : cages.place(vertex), AXES[axis]), starts = cages.offsets;
    return {
      drag: (u, v) => editor.drag(() => cages.set(cages.spread(scale(follow(u, v), clip.diagonal / cages.strength), starts))),
      drop: () => editor.drop(),
    };
  };
  stage.modes.add({
    name: "cage",
    grab(x, y, event) {
      if (transport.isPlaying) return false;
      grip = event.ctrlKey || event.metaKey || boxes ? grabBox(x, y) : grabVertices(x, y, event);
      stage.request();
      return Boolean(grip);
    },
    drag: (x, y) => grip.drag(x, y),
    drop() {
      grip?.drop?.();
      grip = null;
    },
    click(x, y, event) {
      const vertex = hit(x, y, event);
      if (vertex >= 0 && event?.shiftKey) selection.toggle(vertex);
      else if (!event?.shiftKey) selection.choose(vertex < 0 ? [] : [vertex]);
      stage.request();
    },
    hover(x, y) {
      const vertex = transport.isPlaying ? -1 : hit(x, y);
      stage.modes.say(vertex < 0 ? "" : `cage vertex ${vertex}`);
    },
    press(event) {
      if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "a") selection.choose(selection.near.keys());
      else if (event.key === "Escape") selection.choose([]);
      else if (event.key === "]") selection.grow();
      else if (event.key === "[") selection.shrink();
      else if (event.key === "Delete" && cages.edit) editor.change(() => cages.clear());
      else return false;
      return true;
    },
    draw(renderer) {
      if (transport.share) return;
      const paint = [...stage.cageColour(), 0.45], { middle, tips = [] } = cages.gizmo() ?? {};
      renderer.drawDots(stage.cage, paint, 6, paint);
      // What is chosen hides its smaller dot of what moves along.
      renderer.drawDots(cages.placesOf([...selection.shares.keys()]).flat(), [1, 0.75, 0.3, 1], 10, BLACK);
      renderer.drawDots(cages.chosen.flat(), CHOSEN_PAINT, 13, BLACK);
      for (const { axis, tip } of tips) {
        renderer.drawLines([...middle, ...tip], AXIS_PAINTS[axis]);
        renderer.drawSquares(tip, AXIS_PAINTS[axis], 9);
      }
      grip?.box?.draw(renderer);
    },
    chosen: () => cages.chosen,
    show() { stage.view.cage ||= true; },
  });

  panel.listen("box", (button) => {
    boxes = !boxes;
    button.setAttribute("aria-pressed", boxes);
  });
  panel.listen("vertices", (input) => selection.choose(parseVertices(input.value, selection.near.length)));
  for (const name of ["grow", "shrink"]) panel.listen(name, () => selection[name]());
  panel.listen("soft", () => { selection.steps = clamp(round(panel.numberOf("soft")), 0, 100); selection.spread(); });
  panel.listen("mirror", (input) => { cages.mirrors = input.checked; });
  panel.listen("edit", (list) => { cages.active = Number(list.value); });
  panel.edit("add", () => cages.add());
  panel.edit("delete", () => { cages.file.edits.splice(cages.file.edits.indexOf(cages.edit), 1); cages.active = 0; });
  panel.editName(() => cages.file.edits, () => cages.edit);
  panel.editSpan(() => cages.need());
  panel.listenToPoint("move-", (k, value) => {
    const vector = [0, 0, 0];
    vector[k] = value - cages.offset(selection.last)[k];
    editor.change(() => cages.set(cages.spread(vector)));
  });
  panel.edit("key", () => cages.setKeys());
  panel.edit("unkey", () => cages.removeKeys());
  panel.edit("clear", () => cages.clear());
  panel.exchange("cage_edits.json", () => editor.actingCageFile, (text) => {
    const file = readCageEdits(text, clip);
    editor.change(() => { editor.cageFile = file; cages.active = 0; });
  });
  stage.listeners.push(() => showCages(panel, stage));
}

// Brings the panel up to date.
function showCages(panel, { cages, editor }) {
  const { edit, file, selection } = cages, { size } = selection.chosen, along = selection.shares.size - size, acting = editor.actingCageFile;
  panel.put("vertices", writeVertices(selection.chosen));
  panel.say("count", size ? `${size} chosen${along ? ", others along: " + along : ""}` : "none is chosen: click one, or type its number");
  panel.putChoice("edit", file.edits.map(({ name }) => name), file.edits.indexOf(edit));
  panel.find("edit").parentElement.hidden = !edit;
  panel.find("active").hidden = !edit;
  panel.put("name", edit?.name ?? "");
  panel.find("chosen").hidden = !size;
  if (size) panel.putPoint("move-", cages.offset(selection.last));
  panel.enable({ save: acting, grow: size, shrink: size, clear: edit?.moves.some(({ vertex }) => selection.shares.has(vertex)) });
  panel.showEdit("cage", edit, cages.moveOf(selection.last)?.offset, { isMarked: acting && edit });
}
