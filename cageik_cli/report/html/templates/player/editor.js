// The edit: the handles file, the cages that follow from it, and what was undone.
const LIVE_MILLISECONDS = 12;

class Editor {
  constructor(stage) {
    const { clip, skin } = stage;
    Object.assign(this, { stage, clip, skin, active: 0, selected: -1, rounds: clip.header.rigidity, past: [], future: [], isDragging: false, cost: 0, message: "" });
    this.open({ handles: [] });
  }

  get set() { return listSets(this.file)[this.active]; }

  get handle() { return this.set.handles[this.selected]; }

  open(file) {
    this.file = file;
    this.active = min(this.active, listSets(file).length - 1);
    this.selected = min(this.selected, this.set.handles.length - 1);
    this.refresh();
  }

  // Changes the file by a function, so that it can be undone.
  change(action) {
    const before = JSON.stringify(this.file);
    action();
    this.past.push(before);
    this.future = [];
    this.refresh();
  }

  travel(from, to) {
    if (!from.length) return;
    to.push(JSON.stringify(this.file));
    this.open(JSON.parse(from.pop()));
  }

  undo() { this.travel(this.past, this.future); }

  redo() { this.travel(this.future, this.past); }

  // Computes again what depends on the file.
  refresh() {
    this.cages = new Map();
    this.layers = listSets(this.file).map((set, k) => this.prepare(set, this.layers?.[k]));
    this.stage.request(true);
  }

  // Anchors and poser of a set; a poser is kept while its anchors stay.
  prepare(set, old) {
    const { mirror, locked = [] } = this.file;
    const key = JSON.stringify([mirror, locked, set.handles.map(({ vertex, face, barycentric, weight, hard }) => [vertex, face, barycentric, weight, hard])]);
    if (old?.key === key) return { ...old, set };
    const layer = { key, set, anchors: set.handles.map((handle) => this.makeAnchor(handle)), poser: null };
    this.message = "";
    if (!set.handles.length) return layer;
    try {
      const shared = JSON.stringify([mirror, locked]);
      if (this.shared?.key !== shared) this.shared = { key: shared, ...this.makeSolvers(mirror, locked) };
      layer.poser = new Poser(this.shared, layer.anchors, this.clip.header.alpha);
      if (!layer.poser.isMet) throw new Error("two handles conflict: they cannot be met independently; move or delete one");
    } catch (error) {
      layer.poser = null;
      this.message = error.message;
    }
    return layer;
  }

  makeSolvers(mirror, locked) {
    const local = mirror && { normal: normalize(mirror.normal), point: this.clip.fromFile(mirror.point) };
    return makeSolvers(this.skin.cage, this.clip.arrays.cageFaces, locked, local);
  }

  makeAnchor(handle) {
    const { corners, shares } = resolvePlace(handle, this.clip, handle.name);
    return { corners, shares, weight: handle.weight ?? 1, hard: Boolean(handle.hard), ...this.skin.anchor(corners, shares) };
  }

  isEdited(frame) { return this.cageAt(frame) !== this.clip.cage(frame) && this.set.handles.length > 0; }

  cageAt(frame) {
    if (!this.layers.some(({ poser }) => poser)) return this.clip.cage(frame);
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

  // The cage of a frame after the first layers.
  apply(frame, count) {
    let cage = this.clip.cage(frame);
    for (const layer of this.layers.slice(0, count)) {
      if (!layer.poser) continue;
      const moves = this.displace(layer, frame, cage);
      if (moves.some(Boolean)) cage = layer.poser.edit(cage, moves, this.roundsNow);
    }
    return cage;
  }

  displace({ set, anchors }, frame, cage) {
    const moves = zeros(3 * anchors.length), number = this.clip.numberOf(frame), strength = blendSet(set, number), diagonal = this.clip.header.diagonal;
    if (!strength) return moves;
    anchors.forEach((anchor, k) => {
      const handle = set.handles[k], motion = motionOf(handle);
      if (motion === "pin") return;
      const value = evaluateTrack(handle[motion], number);
      const move = motion === "offset" ? scale(value, 1 / diagonal)
        : subtract(this.clip.fromFile(value), this.skin.place(anchor, cage, this.clip.rotation(frame)));
      moves.set(scale(move, strength), 3 * k);
    });
    return moves;
  }

  get layer() { return this.layers[this.active]; }

  // Where a cage of a frame has the anchors of the active set.
  anchorsIn(cage, frame) { return this.layer.anchors.map((anchor) => this.skin.place(anchor, cage, this.clip.rotation(frame))); }

  // Where anchors of the active set are before it, and where its targets are.
  places(frame) {
    const cage = this.apply(frame, this.active), moves = this.displace(this.layer, frame, cage);
    return this.anchorsIn(cage, frame).map((start, k) => ({ start, target: add(start, pointOf(moves, k)) }));
  }

  // Moves the target of the selected handle in a frame; `target` is in diagonals.
  aim(frame, target) {
    const number = this.clip.numberOf(frame), strength = blendSet(this.set, number), handle = this.handle, motion = motionOf(handle), { header } = this.clip;
    if (strength < 0.05) { this.message = "the edit has no strength in this frame; go to one between its first and last"; return; }
    const { start } = this.places(frame)[this.selected], move = scale(subtract(target, start), 1 / strength);
    const value = motion === "target" ? this.clip.toFile(add(start, move)) : scale(move, header.diagonal);
    handle[motion] = setValue(handle[motion], number, [...value].map((x) => Number(x.toPrecision(9))));
    this.refresh();
  }

  // Adds a handle at a place, or selects the one that is there; returns whether it is new.
  add(place, kind) {
    const here = JSON.stringify(place), at = this.set.handles.findIndex(({ vertex, face, barycentric }) => JSON.stringify({ vertex, face, barycentric }) === here);
    if (at >= 0) { this.selected = at; return; }
    let number = this.set.handles.length + 1;
    while (this.set.handles.some(({ name }) => name === `${kind} ${number}`)) number++;
    this.change(() => {
      this.set.handles.push({ name: `${kind} ${number}`, ...place, ...(kind === "pin" ? { pin: true } : { offset: [0, 0, 0] }) });
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

  // What moved more than the handles did, in the frame that is drawn.
  measure(stage) {
    const { frame, share, isPlaying } = stage.transport;
    if (share || isPlaying || !this.layer.poser || !this.isEdited(frame)) return null;
    const before = stage.originalPositions(frame), after = stage.positions, marks = new Float32Array(after.length / 3);
    const starts = this.anchorsIn(this.clip.cage(frame), frame);
    const largest = max(...this.anchorsIn(stage.cage, frame).map((place, k) => norm(subtract(place, starts[k])))), most = { vertex: 0, distance: 0 };
    for (let j = 0; j < marks.length; j++) {
      const k = 3 * j, distance = hypot(after[k] - before[k], after[k + 1] - before[k + 1], after[k + 2] - before[k + 2]);
      if (distance > most.distance) Object.assign(most, { vertex: j, distance });
      marks[j] = distance > 1.01 * largest + 1e-6 ? 1 : 0;
    }
    return { marks, most, largest, count: sumOf(marks) };
  }

  // Handles are discs, pins squares, and lines lead to targets that are not met.
  drawMarks(renderer, toClip, ratio) {
    const { frame, share, isPlaying } = this.stage.transport, lines = [], red = [0.85, 0.25, 0.1, 1];
    if (share) return;
    const places = this.anchorsIn(this.stage.cage, frame);
    if (!isPlaying) this.places(frame).forEach(({ target }, k) => { if (norm(subtract(target, places[k])) > 0.002) lines.push(...places[k], ...target); });
    renderer.drawMarks(lines, toClip, { paint: red });
    this.set.handles.forEach((handle, k) => {
      const isSelected = k === this.selected, paint = handle.pin ? [0.1, 0.45, 0.3, 1] : red;
      renderer.drawMarks(places[k], toClip, { paint, rim: isSelected ? [0, 0, 0, 1] : [1, 1, 1, 1], shape: handle.pin ? 2 : 1, size: (isSelected ? 15 : 12) * ratio });
    });
  }
}
