// The mode of cage vertices: they are chosen by clicks, boxes and numbers, and moved, rotated and scaled by the pointer,
// the arms of a gizmo and keys; the panel has their offsets, frames and keys.
const GIZMO_PIXELS = 64, CIRCLE_SIDES = 48;

// The active cage edit of the editor, and how it is changed.
class CageEditing {
  constructor(stage) {
    const { clip, editor } = stage, { mirror } = clip;
    // Transforms are around the middle of what is chosen, the vertex that was chosen last, or the cursor.
    Object.assign(this, { stage, clip, editor, active: 0, mirrors: false, pivots: "middle", cursor: meanOf(stage.cage) });
    this.selection = new CageSelection(clip, () => stage.cage);
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

  get pivot() {
    const { pivots, cursor, chosen, selection: { last } } = this;
    return pivots === "cursor" ? cursor : pivots === "last" ? this.place(last) : meanOf(chosen.flat());
  }

  // The offsets of this frame if what is chosen moves from `starts`; `find` returns the move of a vertex of some share, as a
  // vector of the world, in file units.
  spread(find, starts = this.offsets) {
    const { shares } = this.selection, moved = new Map();
    for (const [vertex, share] of shares) moved.set(vertex, find(vertex, share));
    if (this.mirrors) this.reflect(moved);
    const { clip, stage: { frame } } = this, turns = this.edit?.axes === "surface";
    const { edits } = this.file, before = turns && moveCage({ edits: edits.slice(0, edits.indexOf(this.edit)) }, clip, frame);
    const asInFile = (vertex, move) => turns ? turnWithCage(move, vertex, clip, before, true) : move;
    return [...moved].map(([vertex, move]) => [vertex, add(starts[vertex], asInFile(vertex, move))]);
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

  // The pivot of what is chosen, and the tips of axes there by their names; not of those that are seen end on.
  gizmo() {
    const { chosen, stage: { camera } } = this;
    if (!chosen.length) return null;
    const middle = this.pivot, size = 2 * GIZMO_PIXELS * camera.spans()[1] * camera.project(middle)[2] / camera.height;
    const isSeen = ({ tip }) => { const [x, y] = camera.project(tip); return nearestPoint(camera, [middle], x, y) < 0; };
    return { middle, tips: Object.entries(AXES).map(([axis, unit]) => ({ axis, tip: add(middle, scale(unit, size)) })).filter(isSeen) };
  }
}

/** @param {Stage} stage */
function makeCageMode(stage) {
  const cages = stage.cages = new CageEditing(stage), { editor, clip, camera, transport } = stage, { selection } = cages, panel = new Panel(stage, "cage", "cage-", editor);
  let grip = null, boxes = false, lastFalloff = "edges";

  const isBox = (event) => boxes || event.ctrlKey || event.metaKey;

  const hit = (x, y, event) => nearestSeen(stage, cages.places, x, y, event);
  // The arm of the gizmo under a pixel: not at its foot, where the vertex itself is.
  const armAt = (x, y) => {
    const gizmo = cages.gizmo();
    if (!gizmo || !nearestPoint(camera, [gizmo.middle], x, y)) return undefined;
    return gizmo.tips[nearestSegment(camera, gizmo.tips.map(({ tip }) => [gizmo.middle, tip]), x, y)]?.axis;
  };
  // The next drag draws a box, unless it begins on the gizmo.
  const setBox = (isOn) => {
    boxes = isOn;
    panel.find("box").setAttribute("aria-pressed", boxes);
    stage.modes.hover(stage.modes.pointer);
  };
  const grabBox = (x, y) => {
    const box = new SelectionBox(camera, x, y), kept = [...selection.chosen], seen = new Map();
    const isSeen = (vertex) => {
      if (!seen.has(vertex)) seen.set(vertex, stage.isSeen(cages.place(vertex)));
      return seen.get(vertex);
    };
    return {
      box,
      move(u, v) {
        box.to = [u, v];
        selection.choose([...kept, ...box.list(cages.places).filter(isSeen)]);
        stage.request();
      },
      finish: () => setBox(false),
    };
  };
  const begin = (values) => {
    if (!selection.chosen.size) { stage.modes.say("choose cage vertices first"); return null; }
    const cage = editor.cageAt(stage.frame), starts = cages.offsets;
    selection.spread(cage);
    return stage.modes.begin({
      kinds: "grs", pivot: cages.pivot, ...values,
      apply: (transform) => editor.drag(() => {
        const size = clip.diagonal / cages.strength;
        cages.set(cages.spread((vertex, share) => scale(transform.displace(pointOf(cage, vertex), share), size), starts));
      }),
      end: (isKept) => isKept ? editor.drop() : editor.cancel(),
      resize(factor) {
        if (!selection.falloff) return false;
        selection.radius *= factor;
        selection.spread(cage);
        // What moves no more goes back.
        if (editor.before) editor.restore(editor.before);
        return true;
      },
    });
  };
  const grabVertices = (x, y, event) => {
    const vertex = hit(x, y, event), start = [x, y];
    if (vertex < 0 || event.shiftKey) return null;
    if (!selection.chosen.has(vertex)) selection.choose([vertex]);
    return begin({ kind: "g", start, pivot: cages.place(vertex) });
  };
  const setFalloff = (falloff) => {
    lastFalloff = falloff || lastFalloff;
    Object.assign(selection, { falloff }).spread();
  };
  stage.modes.add({
    name: "cage",
    grab(x, y, event) {
      if (transport.isPlaying) return false;
      const axis = armAt(x, y);
      grip = axis ? begin({ kind: "g", start: [x, y], axis }) : isBox(event) ? grabBox(x, y) : grabVertices(x, y, event);
      stage.request();
      return Boolean(grip);
    },
    drag: (x, y) => grip.move(x, y),
    drop() {
      grip.finish(true);
      grip = null;
    },
    click(x, y, event) {
      const vertex = hit(x, y, event);
      if (vertex >= 0 && event?.shiftKey) selection.toggle(vertex);
      else if (!event?.shiftKey) selection.choose(vertex < 0 ? [] : [vertex]);
      stage.request();
    },
    hover(x, y, event) {
      const axis = armAt(x, y), { middle, tips } = cages.gizmo() ?? {};
      if (axis) return { text: `move along ${axis}`, cursor: "move", kind: "arm", points: [middle, tips.find((one) => one.axis === axis).tip] };
      if (isBox(event)) return { text: "drag a box", cursor: "crosshair" };
      const vertex = hit(x, y, event);
      return vertex < 0 ? { text: "" } : { text: `cage vertex ${vertex}`, cursor: event.shiftKey ? "pointer" : "move", kind: "ring", points: [cages.place(vertex)] };
    },
    press(event) {
      const key = event.key.toLowerCase(), isCommand = event.ctrlKey || event.metaKey;
      if (key === "a" && !event.altKey) selection.choose(selection.near.keys());
      else if (isCommand || event.altKey) return false;
      else if (TRANSFORM_KEYS[key]) begin({ kind: key });
      else if (key === "b") setBox(!boxes);
      else if (key === "o") setFalloff(selection.falloff ? "" : lastFalloff);
      else if (event.key === "Escape" && boxes) setBox(false);
      else if (event.key === "Escape") selection.choose([]);
      else if (event.key === "]") selection.grow();
      else if (event.key === "[") selection.shrink();
      else if (event.key === "Delete" && cages.edit) editor.change(() => cages.clear());
      else return false;
      return true;
    },
    draw(renderer) {
      if (transport.share) return;
      const { transform } = stage.modes, paint = [...stage.cageColour(), 0.45], { middle, tips = [] } = cages.gizmo() ?? {};
      if (selection.falloff && !transform) selection.spread();
      renderer.drawDots(stage.cage, paint, 6, paint, true);
      // What is chosen hides its smaller dot of what moves along.
      renderer.drawDots(cages.placesOf([...selection.shares.keys()]).flat(), [1, 0.75, 0.3, 1], 10, BLACK, true);
      renderer.drawDots(cages.chosen.flat(), CHOSEN_PAINT, 13, BLACK, true);
      if (transform && selection.falloff) drawCircle(renderer, transform.pivot);
      if (cages.pivots === "cursor") renderer.drawSquares(cages.cursor, RED, 9);
      for (const { axis, tip } of tips) {
        renderer.drawLines([...middle, ...tip], AXIS_PAINTS[axis]);
        renderer.drawSquares(tip, AXIS_PAINTS[axis], 9);
      }
      grip?.box?.draw(renderer);
    },
    chosen: () => cages.chosen,
    show() { stage.view.cage ||= true; },
  });

  // The radius of what moves along, around a point.
  const drawCircle = (renderer, middle) => {
    const [right, up] = camera.axes(), place = (k) => {
      const angle = 360 * DEGREE * k / CIRCLE_SIDES, { radius } = selection;
      return add(middle, add(scale(right, radius * cos(angle)), scale(up, radius * sin(angle))));
    };
    renderer.drawLines(listOf(CIRCLE_SIDES, (k) => [...place(k), ...place(k + 1)]).flat(), TRANSFORM_GREY);
  };

  panel.listen("box", () => setBox(!boxes));
  for (const [kind, name] of Object.entries({ g: "grab", r: "rotate", s: "scale" })) panel.listen(name, () => begin({ kind, start: null }));
  panel.listen("vertices", (input) => selection.choose(parseVertices(input.value, selection.near.length)));
  for (const name of ["grow", "shrink"]) panel.listen(name, () => selection[name]());
  panel.listen("falloff", ({ value }) => setFalloff(value));
  panel.listen("radius", () => {
    const radius = panel.numberOf("radius") / clip.diagonal;
    if (radius <= 0) refuse("Radius", "expected a number above 0");
    Object.assign(selection, { radius }).spread();
  });
  panel.listen("pivot", ({ value }) => { cages.pivots = value; });
  panel.listen("cursor", () => {
    if (!selection.chosen.size) refuse("Cursor", "choose the cage vertices in whose middle it is to be");
    cages.cursor = meanOf(cages.chosen.flat());
    cages.pivots = "cursor";
  });
  panel.listen("mirror", (input) => { cages.mirrors = input.checked; });
  panel.listen("edit", (list) => { cages.active = Number(list.value); });
  panel.edit("add", () => cages.add());
  panel.edit("delete", () => { cages.file.edits.splice(cages.file.edits.indexOf(cages.edit), 1); cages.active = 0; });
  panel.edit("axes", ({ value }) => { cages.edit.axes = value === "surface" ? value : undefined; });
  panel.editName(() => cages.file.edits, () => cages.edit);
  panel.editSpan(() => cages.need());
  panel.listenToPoint("move-", (k, value) => {
    const vector = [0, 0, 0];
    vector[k] = value - cages.offset(selection.last)[k];
    editor.change(() => cages.set(cages.spread((_, share) => scale(vector, share))));
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
  panel.find("axes").value = edit?.axes ?? "world";
  panel.find("chosen").hidden = !size;
  if (size) panel.putPoint("move-", cages.offset(selection.last));
  panel.put("falloff", selection.falloff);
  panel.find("radius").parentElement.hidden = !selection.falloff;
  panel.put("radius", ROUND3(selection.radius * cages.clip.diagonal));
  panel.put("pivot", cages.pivots);
  panel.enable({ save: acting, grow: size, shrink: size, grab: size, rotate: size, scale: size, cursor: size, clear: edit?.moves.some(({ vertex }) => selection.shares.has(vertex)) });
  panel.showEdit("cage", edit, cages.moveOf(selection.last)?.offset, { isMarked: acting && edit });
}
