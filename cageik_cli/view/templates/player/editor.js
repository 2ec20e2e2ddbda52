// The edit: the files of cage edits and of handles, the cages that follow from them, and what was undone.
const LIVE_MILLISECONDS = 12;

class Editor extends Past {
  /** @param {Stage} stage */
  constructor(stage) {
    super();
    const { clip, skin } = stage;
    Object.assign(this, { stage, clip, skin, active: 0, selected: -1, rounds: clip.rigidity, isDragging: false, cost: 0, message: "", cageFile: { edits: [] } });
    this.open({ handles: [] });
  }

  get set() { return listSets(this.file)[this.active]; }

  get handle() { return this.set.handles[this.selected]; }

  // What the selected handle has: an offset, a target or a pin.
  get motion() { return this.handle && motionOf(this.handle); }

  // The cage edits that are saved and applied, if any moves something.
  get actingCageFile() {
    const edits = listActing(this.cageFile);
    return edits.length ? { ...this.cageFile, edits } : null;
  }

  // The handles that are saved and applied: without sets that are empty, which files do not have.
  get actingFile() {
    const sets = listSets(this.file).filter(({ handles }) => handles.length);
    if (!sets.length) return null;
    return this.file.sets ? { ...this.file, sets } : this.file;
  }

  get hasEdits() { return Boolean(this.actingFile || this.actingCageFile); }

  open(file, cageFile = this.cageFile) {
    Object.assign(this, { file, cageFile });
    this.active = min(this.active, listSets(file).length - 1);
    this.selected = min(this.selected, this.set.handles.length - 1);
    this.refresh();
  }

  // Both files, as text: all modes have one history.
  snapshot() { return JSON.stringify([this.file, this.cageFile]); }

  restore(state) { this.open(...JSON.parse(state)); }

  // Changes the files by a function, so that it can be undone.
  change(action) {
    const before = this.snapshot();
    action();
    this.remember(before);
    this.refresh();
  }

  // A step of a drag: all of them are undone together.
  drag(action) {
    this.before ??= this.snapshot();
    this.isDragging = true;
    this.complaint = "";
    try { action(); } catch (error) { this.complaint = error.message; }
  }

  drop() {
    if (this.isDragging && this.before !== this.snapshot()) this.remember(this.before);
    Object.assign(this, { isDragging: false, before: null });
    this.refresh();
  }

  // Ends a drag, and puts back what it began with.
  cancel() {
    const { before } = this;
    Object.assign(this, { isDragging: false, before: null });
    if (before) this.restore(before);
  }

  // Computes again what depends on the file.
  refresh() {
    this.cages = new Map();
    this.layers = listSets(this.file).map((set, k) => this.prepare(set, this.layers?.[k]));
    this.stage.request(true);
  }

  // Anchors and poser of a set; a poser is kept while its anchors stay.
  prepare(set, old) {
    const { mirror, locked = [] } = this.file, isHeld = set.hold !== false;
    const key = JSON.stringify([mirror, locked, isHeld, set.handles.map(({ vertex, face, barycentric, weight, hard, radius }) => [vertex, face, barycentric, weight, hard, radius])]);
    if (old?.key === key) return { ...old, set };
    const layer = { key, set, anchors: set.handles.map((handle) => this.makeAnchor(handle)), poser: null };
    this.message = "";
    if (!set.handles.length) return layer;
    try {
      const shared = JSON.stringify([mirror, locked, isHeld]);
      if (this.shared?.key !== shared) this.shared = { key: shared, ...this.makeSolvers(mirror, locked, isHeld) };
      layer.poser = new Poser(this.shared, layer.anchors, this.clip.alpha);
      if (!layer.poser.isMet) throw new Error("two handles conflict: they cannot be met independently; move or delete one");
    } catch (error) {
      layer.poser = null;
      this.message = error.message;
    }
    return layer;
  }

  get surface() { return this.surfaceHeld ??= new HeldSurface(this.skin, this.clip.arrays); }

  makeSolvers(mirror, locked, isHeld) {
    const local = mirror && { normal: normalize(mirror.normal), point: this.clip.fromFile(mirror.point) };
    return makeSolvers(this.skin.cage, this.clip.arrays.cageFaces, locked, local, isHeld ? this.surface : null);
  }

  makeAnchor(handle) {
    const { corners, shares } = resolvePlace(handle, this.clip, handle.name);
    const radius = handle.radius && handle.radius / this.clip.diagonal;
    const place = [0, 1, 2].map((a) => sumOf(corners.map((k, i) => shares[i] * this.skin.base[3 * k + a])));
    return { corners, shares, place, radius, weight: handle.weight ?? 1, hard: Boolean(handle.hard), ...this.skin.anchor(corners, shares) };
  }

  // Whether an edit may change a frame.
  isActive(frame) {
    const number = this.clip.numberOf(frame), acts = (one) => blendSet(one, number) > 0;
    return listSets(this.file).some((set) => set.handles.length && acts(set)) || this.cageFile.edits.some(acts);
  }

  // The reach of the selected handle, and its ring on the surface; null where all of the model follows.
  get reach() { return this.layer.poser?.reaches.find(({ k, isImage }) => k === this.selected && !isImage) ?? null; }

  // The points of that ring in the mesh that is drawn, two for each face that it goes through.
  get ring() {
    const { reach, clip: { arrays: { faces } }, stage: { positions } } = this;
    if (!reach) return [];
    reach.ring ??= traceRing(reach, faces);
    return reach.ring.flatMap(([i, j, t]) => [0, 1, 2].map((a) => positions[3 * i + a] + t * (positions[3 * j + a] - positions[3 * i + a])));
  }

  isEdited(frame) { return this.cageAt(frame) !== this.clip.cage(frame); }

  // The cage of a frame after the cage edits, which handles begin from.
  movedCage(frame) { return moveCage(this.cageFile, this.clip, frame); }

  cageAt(frame) {
    if (!this.layers.some(({ poser }) => poser) && !this.cageFile.edits.length) return this.clip.cage(frame);
    let cage = this.cages.get(frame);
    if (!cage) {
      const start = performance.now();
      cage = this.apply(frame, this.layers.length);
      this.cages.set(frame, cage);
      if (this.roundsNow) this.cost = performance.now() - start;
    }
    return cage;
  }

  // Rounds of rotations wait for the end of a drag, unless they are fast.
  get roundsNow() { return this.isDragging && this.cost > LIVE_MILLISECONDS ? 0 : this.rounds; }

  // The cage of a frame after the cage edits and the first layers.
  apply(frame, count) {
    let cage = this.movedCage(frame);
    for (const layer of this.layers.slice(0, count)) {
      if (!layer.poser) continue;
      const moves = this.displace(layer, frame, cage), { mirror } = layer.poser;
      layer.poser.normal = mirror && turn(mirror.normal, this.clip.rotation(frame));
      if (moves.some(Boolean)) cage = layer.poser.edit(cage, moves, this.roundsNow);
    }
    return cage;
  }

  // An offset in the axes of the surface around its anchor.
  turnOffset(anchor, offset, frame, cage) {
    anchor.axes ??= this.surface.makeAxes(anchor);
    return turn(offset, this.surface.findTurn(anchor.axes, cage, this.clip.rotation(frame)));
  }

  // A move of the selected handle in this frame, in the axes of its offset.
  turnBack(move) {
    const { frame } = this.stage;
    if (this.handle.axes !== "surface") return move;
    const [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => this.turnOffset(this.layer.anchors[this.selected], axis, frame, this.apply(frame, this.active)));
    return [dot(x, move), dot(y, move), dot(z, move)];
  }

  // Where an anchor of a layer is in the first frame of its set, before it.
  findFirstPlace({ set, anchors }, k) {
    const first = set.frames ? this.clip.frameOf(set.frames[0]) : 0, at = this.layers.findIndex((layer) => layer.set === set);
    return this.skin.place(anchors[k], this.apply(first, max(0, at)), this.clip.rotation(first));
  }

  displace({ set, anchors }, frame, cage) {
    const moves = zeros(3 * anchors.length), number = this.clip.numberOf(frame), strength = blendSet(set, number), diagonal = this.clip.diagonal;
    if (!strength) return moves;
    anchors.forEach((anchor, k) => {
      const handle = set.handles[k], motion = motionOf(handle);
      if (motion === "pin") return;
      const place = this.skin.place(anchor, cage, this.clip.rotation(frame));
      let move = motion === "stay" ? minus(this.findFirstPlace({ set, anchors }, k), place) : evaluateTrack(handle[motion], number);
      if (motion === "target") move = minus(this.clip.fromFile(move), place);
      if (motion === "offset") move = scale(handle.axes === "surface" ? this.turnOffset(anchor, move, frame, cage) : move, 1 / diagonal);
      moves.set(scale(move, strength), 3 * k);
    });
    return moves;
  }

  get layer() { return this.layers[this.active]; }

  // Where a cage of this frame has the anchors of the active set.
  anchorsIn(cage) { return this.layer.anchors.map((anchor) => this.skin.place(anchor, cage, this.clip.rotation(this.stage.frame))); }

  get anchors() { return this.anchorsIn(this.stage.cage); }

  // Where anchors of the active set are before it, and where its targets are.
  get places() {
    const { frame } = this.stage, cage = this.apply(frame, this.active), moves = this.displace(this.layer, frame, cage);
    return this.anchorsIn(cage).map((start, k) => ({ start, target: add(start, pointOf(moves, k)) }));
  }

  // Moves the target of the selected handle in this frame; `target` is in diagonals.
  aim(target) {
    const { handle, motion, clip, stage: { number } } = this, strength = needStrength(this.set, number);
    const { start } = this.places[this.selected], move = scale(minus(target, start), 1 / strength);
    const value = motion === "target" ? clip.toFile(add(start, move)) : scale(this.turnBack(move), clip.diagonal);
    handle[motion] = setValue(handle[motion], number, shortenPoint(value));
    this.refresh();
  }

  // Adds a handle at a place, or selects the one that is there; returns whether it is new.
  add(place, kind) {
    const here = JSON.stringify(place), at = this.set.handles.findIndex(({ vertex, face, barycentric }) => JSON.stringify({ vertex, face, barycentric }) === here);
    if (at >= 0) { this.selected = at; return; }
    this.change(() => {
      this.set.handles.push({ name: findName(kind, this.set.handles), ...place, ...(kind === "pin" ? { pin: true } : { offset: [0, 0, 0] }) });
      this.selected = this.set.handles.length - 1;
    });
  }

  select(k) {
    this.selected = k;
    this.stage.request();
  }

  remove() {
    if (!this.handle) return;
    this.change(() => { this.set.handles.splice(this.selected, 1); this.selected = -1; });
  }

  // What moved more than the handles did, in the frame that is drawn; nothing where cage edits move the model.
  measure(stage) {
    const { frame, share, isPlaying } = stage.transport;
    if (share || isPlaying || !this.layer.poser || !this.isEdited(frame) || this.movedCage(frame) !== this.clip.cage(frame)) return null;
    const before = stage.originalPositions(frame), after = stage.positions, marks = new Float32Array(after.length / 3);
    const starts = this.anchorsIn(this.clip.cage(frame));
    const largest = max(...this.anchors.map((place, k) => norm(minus(place, starts[k])))), most = { vertex: 0, distance: 0 };
    for (let j = 0; j < marks.length; j++) {
      const k = 3 * j, distance = hypot(after[k] - before[k], after[k + 1] - before[k + 1], after[k + 2] - before[k + 2]);
      if (distance > most.distance) Object.assign(most, { vertex: j, distance });
      marks[j] = distance > 1.01 * largest + 1e-6 ? 1 : 0;
    }
    return { marks, most, largest, count: sumOf(marks) };
  }

  // Handles are discs, pins squares, and lines lead to targets that are not met.
  draw(renderer) {
    const { share, isPlaying } = this.stage.transport, { anchors } = this;
    if (share) return;
    const lines = isPlaying ? [] : this.places.flatMap(({ target }, k) => norm(minus(target, anchors[k])) > 0.002 ? [...anchors[k], ...target] : []);
    renderer.drawLines(lines, RED);
    if (!isPlaying && this.handle) renderer.drawLines(this.ring, VIOLET);
    this.set.handles.forEach(({ pin }, k) => {
      const [size, rim] = k === this.selected ? [15, BLACK] : [12, WHITE];
      if (pin) renderer.drawSquares(anchors[k], [0.1, 0.45, 0.3, 1], size, rim, true);
      else renderer.drawDots(anchors[k], RED, size, rim, true);
    });
  }
}
