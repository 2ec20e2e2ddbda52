// The picture: what is drawn of a clip at a moment, from where, and how long it took.
const TIMED_FRAMES = 120, TELL_EVERY = 200, FIRST_TURN = 32, FIRST_TILT = 14;

// Half the size of what F shows of a single point, in diagonals; cells of the ground on each side.
const CLOSE_RADIUS = 0.08, GRID_CELLS = 60;

// How far behind the surface a point is still taken to be on it, in diagonals: marks are as thick.
const SURFACE_DEPTH = 0.012;

// What other pages add to the player: functions of its stage.
const extensions = [];

class Stage {
  constructor(section, payload) {
    const canvas = section.querySelector("canvas");
    Object.assign(this, { section, canvas });
    this.clip = new Clip(payload);
    this.skin = new Skin(payload);
    this.renderer = new Renderer(canvas, payload.arrays.faces, listEdges(payload.arrays.cageFaces, payload.arrays.joinedCageFaces));
    this.colours = new Colours(this.clip);
    if (payload.arrays.tints) this.renderer.upload("tints", Float32Array.from(payload.arrays.tints, (x) => x / 255));
    this.camera = new Camera(this.clip.up);
    this.transport = new Transport(this.clip.count, this.clip.fps);
    for (const name of ["positions", "input", "normals"]) this[name] = new Float32Array(payload.arrays.lack.length);
    this.view = { show: "model", colours: "clay", cage: true, edges: false, grid: true, xray: false, follow: travels(this.clip) };
    Object.assign(this, { editor: null, listeners: [], timings: { solve: [], skin: [], normals: [], draw: [], frames: [] }, isStale: true, toldAt: 0 });
    this.before = new Before(this);
    this.reset();
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  // An element of the player that is marked by `data-` and a name.
  /** @returns {any} */
  find(name) { return this.section.querySelector(`[data-${name}]`); }

  // Draws soon; `isStale` says that the mesh changed, too.
  request(isStale = false) {
    this.isStale ||= isStale;
    this.pending ??= requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    this.pending = null;
    if (this.transport.isPlaying) { this.transport.advance(now); this.isStale = true; }
    if (this.isStale) this.compute();
    this.measure("draw", () => this.draw());
    this.note("frames", now);
    // To paint texts costs as much as the model, so that they wait while it moves.
    if (!this.isMoving || now - this.toldAt > TELL_EVERY) {
      this.toldAt = now;
      for (const listener of this.listeners) listener();
    } else this.later ??= setTimeout(() => { this.later = null; this.request(); }, TELL_EVERY);
    if (this.transport.isPlaying) this.request();
    // What is below the pointer may be another thing now.
    if (this.modes?.pointer) this.modes.hover(this.modes.pointer);
  }

  // Does something, and notes how many milliseconds it takes.
  measure(what, action) {
    const start = performance.now();
    action();
    this.note(what, performance.now() - start);
  }

  note(what, value) {
    const list = this.timings[what];
    list.push(value);
    if (list.length > TIMED_FRAMES) list.shift();
  }

  get frame() { return this.transport.frame; }

  // Whether the mesh before is shown beside the model.
  get isSplit() { return this.before.isSplit; }

  // Whether the panel is a sheet below the picture.
  get isNarrow() { return this.section.clientWidth <= NARROW; }

  get isMoving() { return this.transport.isPlaying || this.modes?.isDragging; }

  // The number of the frame that is shown.
  get number() { return this.clip.numberOf(this.frame); }

  cageAt(frame) { return this.editor ? this.editor.cageAt(frame) : this.clip.cage(frame); }

  compute() {
    this.isStale = false;
    const { clip, skin, renderer, positions, normals, transport: { frame, share } } = this;
    const after = share > 0 ? frame + 1 : frame, rotation = blend(clip.rotation(frame), clip.rotation(after), share);
    this.measure("solve", () => { this.cage = blend(this.cageAt(frame), this.cageAt(after), share); });
    this.measure("skin", () => { if (!this.mold?.(positions)) skin.deform(this.cage, rotation, positions); });
    this.measure("normals", () => skin.normals(positions, normals));
    renderer.upload("positions", positions);
    renderer.upload("normals", normals);
    renderer.uploadCage(this.drawnCage?.() ?? this.cage);
    this.moved = this.editor?.measure(this) ?? null;
    this.before.compute();
    this.scale = this.modes?.active.paint?.(this.colours.values) ?? this.colours.choose(this.view.colours, share ? -1 : frame, this.moved?.marks);
    renderer.upload("values", this.colours.values);
    if (this.view.follow) this.camera.shift = minus(meanOf(this.cage), meanOf(skin.cage));
  }

  // Sends the edges of the model to be drawn, if they are wanted: those of the parts that are shown.
  sendEdges() {
    if (!this.view.edges) return;
    const { faces, joinedFaces } = this.clip.arrays;
    this.edges ??= listEdges(faces, joinedFaces);
    this.renderer.sendIndices("edges", this.selectShown?.(this.edges, 2) ?? this.edges);
  }

  // The positions of a frame before any edit.
  originalPositions(frame) {
    if (this.original?.frame !== frame) {
      this.original = { frame, positions: new Float32Array(this.positions.length) };
      this.skin.deform(this.clip.cage(frame), this.clip.rotation(frame), this.original.positions);
    }
    return this.original.positions;
  }

  draw() {
    this.ground = getComputedStyle(this.canvas).backgroundColor.match(/\d+/g).slice(0, 3).map((x) => Number(x) / 255);
    // Without a graphics card, what moves has a quarter of the pixels.
    const canvas = this.canvas, ratio = this.ratio = min(devicePixelRatio, 2) / (this.renderer.isSlow && this.isMoving ? 2 : 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => max(1, round(size * ratio)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.sizeCamera();
    const part = this.isSplit ? width >> 1 : width;
    if (this.isSplit) this.drawPart(0, part, height, true);
    this.drawPart(width - part, part, height, this.before.isAlone);
  }

  // Tells the camera the size of its part of the picture.
  sizeCamera() {
    const { clientWidth, clientHeight } = this.canvas;
    Object.assign(this.camera, { width: max(1, clientWidth / (this.isSplit ? 2 : 1)), height: max(1, clientHeight) });
  }

  drawPart(left, width, height, isInput) {
    const { renderer, camera, colours, view } = this, [right, up, back] = camera.axes();
    renderer.begin({ left, width, height, ground: this.ground, toClip: camera.matrix(), pixels: this.ratio, isSolid: this.isSolid, lift: [...camera.eye(), SURFACE_DEPTH / camera.distance] });
    if (view.grid) this.drawGrid();
    const light = normalize(add(add(back, scale(up, 0.8)), scale(right, -0.5)));
    const drawMesh = (names, ramp) => {
      renderer.drawMesh(names, { missing: colours.missing, opacity: view.xray ? 0.45 : 1, light, eye: back, ramp, tinted: Number(names.length > 3) });
      if (view.edges) renderer.drawEdges(names[0]);
    };
    if (isInput) { drawMesh(["inputPositions", "inputNormals", "zeros"], PLAIN.input); return; }
    if (view.show !== "cage") drawMesh(["positions", "normals", "values", ...this.scale.isTinted ? ["tints"] : []], this.scale.ramp);
    this.before.draw(renderer, light);
    if (view.cage || view.show === "cage") renderer.drawCage(this.cageColour());
    this.modes?.active.draw?.(renderer);
    this.modes?.transform?.draw(renderer);
  }

  // The ground, at the lowest point of the clip.
  drawGrid() {
    const { upright, distance } = this.camera, up = upright[1], { ground } = this.clip, here = this.camera.centre();
    const [cell, lines] = this.grid ??= makeGrid(this.clip, upright);
    // It goes with the camera, by whole cells.
    const middle = [0, 2].map((k) => round(dot(upright[k], here) / cell) * cell);
    const offset = add(add(scale(upright[0], middle[0]), scale(upright[2], middle[1])), scale(up, ground));
    const foot = add(here, scale(up, ground - dot(up, here))), paint = DARK.matches ? [0.75, 0.8, 0.85] : [0.3, 0.34, 0.38];
    lines.forEach((list, k) => this.renderer.drawGrid(`grid ${k}`, list, { paint: [...paint, k ? 0.5 : 0.22], offset, foot, reach: min(GRID_CELLS * cell, (k ? 2.2 : 1.2) * max(distance, 1)) }));
  }

  cageColour() { return DARK.matches ? [0.44, 0.66, 1] : [0.12, 0.44, 0.82]; }

  // Whether the model hides what is behind it.
  get isSolid() { return !this.view.xray && this.view.show !== "cage"; }

  // Whether a point is not behind the surface.
  isSeen(point) {
    if (!this.isSolid) return true;
    const origin = this.camera.eye(), away = minus(point, origin), distance = norm(away);
    const found = this.skin.pick(this.positions, { origin, direction: scale(away, 1 / distance) });
    return !found || found.depth > distance - SURFACE_DEPTH;
  }

  // Where a pixel of the picture is in the part of it that shows the model.
  partOf(x) {
    return this.isSplit ? x - this.canvas.clientWidth / 2 : x;
  }

  reset() {
    Object.assign(this.camera, { turn: FIRST_TURN, tilt: FIRST_TILT });
    this.frameModel();
  }

  // Shows all of the model as it is now, or of its cage if that is drawn alone.
  frameModel() {
    const { camera } = this;
    if (this.isStale) this.compute();
    this.sizeCamera();
    // Below the buttons over the picture.
    const top = this.find("modes").offsetHeight + 22, bottom = 26 * min(1, camera.height / 500);
    camera.fit(this.framed?.() ?? (this.view.show === "cage" ? this.cage : this.positions), { top, bottom, side: 14 });
    this.fitted = [camera.target, camera.distance];
    this.request();
  }

  // All of the model stays in a picture of another size, if it was and nobody has moved it since.
  resize() {
    const [target, distance] = this.fitted ?? [];
    if (target === this.camera.target && distance === this.camera.distance) this.frameModel();
    else this.request();
  }

  // Shows what is chosen in the mode that is on, else the model.
  frameChosen() {
    const points = this.modes.active.chosen?.() ?? [];
    if (!points.length) { this.frameModel(); return; }
    const [centre, radius] = enclose(points.flat());
    this.camera.frame(centre, max(1.3 * radius, CLOSE_RADIUS));
    this.request();
  }

  // Goes to the worst region, in its frame.
  frameWorst() {
    const { frame, vertex, extent, turn } = this.clip.focus;
    this.transport.play(false);
    this.transport.go(frame);
    this.compute();
    this.camera.tilt = FIRST_TILT;
    this.camera.frame(pointOf(this.positions, vertex), extent, turn);
    this.request(true);
  }
}

const DARK = matchMedia("(prefers-color-scheme: dark)");

// Lines of the ground around the origin, in the units of the picture: fine ones, and every tenth.
// The distance between fine lines is a power of ten in the units of the file.
function makeGrid(clip, upright) {
  const fine = 10 ** floor(Math.log10(clip.diagonal / 4)) / clip.diagonal, size = GRID_CELLS * fine, lists = [[], []];
  for (let k = -GRID_CELLS; k <= GRID_CELLS; k++) for (const [along, across] of [[0, 2], [2, 0]]) {
    const side = scale(upright[across], k * fine);
    for (const end of [-size, size]) lists[k % 10 ? 0 : 1].push(...add(side, scale(upright[along], end)));
  }
  return [10 * fine, lists.map((list) => Float32Array.from(list))];
}

function meanOf(points) {
  const sum = [0, 0, 0];
  for (let k = 0; k < points.length; k++) sum[k % 3] += points[k];
  return scale(sum, 3 / points.length);
}

// The middle of points, and the radius of a ball around it that holds them.
function enclose(points) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < points.length; k++) {
    low[k % 3] = min(low[k % 3], points[k]);
    high[k % 3] = max(high[k % 3], points[k]);
  }
  return [scale(add(low, high), 0.5), norm(minus(high, low)) / 2];
}

// Whether the model goes so far that the camera has to go with it.
function travels(clip) {
  const middles = listOf(clip.count, (frame) => meanOf(clip.cage(frame)));
  return enclose(middles.flat())[1] > 0.25;
}
