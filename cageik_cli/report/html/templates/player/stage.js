// The picture: what is drawn of a clip at a moment, from where, and how long it took.
const TIMED_FRAMES = 120, TELL_EVERY = 200;

// What other pages add to the player: functions of its section and stage.
const extensions = [];

class Stage {
  constructor(canvas, payload) {
    this.canvas = canvas;
    this.clip = new Clip(payload);
    this.skin = new Skin(payload);
    this.renderer = new Renderer(canvas, payload.arrays.faces, listEdges(payload.arrays.cageFaces, payload.arrays.joinedCageFaces));
    this.colours = new Colours(this.clip);
    this.camera = new Camera(this.clip.header.up);
    this.transport = new Transport(this.clip.count, this.clip.header.fps);
    for (const name of ["positions", "input", "normals"]) this[name] = new Float32Array(payload.arrays.lack.length);
    this.view = { show: "model", colours: "clay", cage: true, edges: false, follow: travels(this.clip) };
    Object.assign(this, { editor: null, listeners: [], timings: { solve: [], skin: [], normals: [], draw: [], frames: [] }, isStale: true, toldAt: 0 });
    this.reset();
    new ResizeObserver(() => this.request()).observe(canvas);
  }

  // Draws soon; `isStale` says that the mesh changed, too.
  request(isStale = false) {
    this.isStale ||= isStale;
    this.pending ??= requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    this.pending = null;
    if (this.transport.isPlaying) { this.transport.advance(now); this.isStale = true; }
    if (this.isStale) this.compute();
    const start = performance.now();
    this.draw();
    this.note("draw", performance.now() - start);
    this.note("frames", now);
    // To paint texts costs as much as the model, so that they wait while it moves.
    const isMoving = this.transport.isPlaying || this.editor?.isDragging;
    if (!isMoving || now - this.toldAt > TELL_EVERY) {
      this.toldAt = now;
      for (const listener of this.listeners) listener();
    }
    if (this.transport.isPlaying) this.request();
  }

  note(what, value) {
    const list = this.timings[what];
    list.push(value);
    if (list.length > TIMED_FRAMES) list.shift();
  }

  cageAt(frame) { return this.editor ? this.editor.cageAt(frame) : this.clip.cage(frame); }

  compute() {
    this.isStale = false;
    const { frame, share } = this.transport, clip = this.clip, start = performance.now();
    const isBetween = share > 0, after = isBetween ? frame + 1 : frame;
    this.cage = interpolate(this.cageAt(frame), this.cageAt(after), share);
    const rotation = interpolate(clip.rotation(frame), clip.rotation(after), share), solved = performance.now();
    this.skin.deform(this.cage, rotation, this.positions);
    const placed = performance.now();
    this.skin.normals(this.positions, this.normals);
    this.renderer.upload("positions", this.positions);
    this.renderer.upload("normals", this.normals);
    this.renderer.uploadCage(this.cage);
    this.note("solve", solved - start);
    this.note("skin", placed - solved);
    this.note("normals", performance.now() - placed);
    this.moved = this.editor?.measure(this) ?? null;
    this.computeInput();
    this.scale = this.colours.choose(this.view.colours, share ? -1 : frame, this.moved?.marks);
    this.renderer.upload("values", this.colours.values);
    if (this.view.follow) this.camera.shift = subtract(meanOf(this.cage), meanOf(this.skin.cage));
  }

  // Sends the edges of the model to be drawn, if they are wanted: those of the parts that are shown.
  sendEdges() {
    if (!this.view.edges) return;
    const { faces, joinedFaces } = this.clip.arrays;
    this.edges ??= listEdges(faces, joinedFaces);
    this.renderer.setEdges(this.selectShown?.(this.edges, 2) ?? this.edges);
  }

  // The input of this frame, if the page holds it and it is wanted.
  computeInput() {
    const { frame, share } = this.transport;
    this.hasInput = !share && this.clip.held.has(frame);
    if (!this.hasInput || !["input", "both"].includes(this.view.show)) return;
    const source = this.editor?.isEdited(frame) ? this.originalPositions(frame) : this.positions;
    this.clip.input(frame, source, this.input);
    const normals = new Float32Array(this.normals.length);
    this.skin.normals(this.input, normals);
    this.renderer.upload("inputPositions", this.input);
    this.renderer.upload("inputNormals", normals);
    this.renderer.upload("zeros", new Float32Array(this.colours.values.length));
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
    this.ground = getComputedStyle(this.canvas).backgroundColor.match(/\d+/g).slice(0, 3).map((x) => x / 255);
    const canvas = this.canvas, ratio = min(devicePixelRatio, 2);
    const width = max(1, Math.round(canvas.clientWidth * ratio)), height = max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const isSplit = this.view.show === "both" && this.hasInput, part = isSplit ? width >> 1 : width;
    Object.assign(this.camera, { width: part / ratio, height: height / ratio });
    if (isSplit) this.drawPart(0, part, height, true, ratio);
    this.drawPart(isSplit ? part : 0, part, height, this.view.show === "input" && this.hasInput, ratio);
  }

  drawPart(left, width, height, isInput, ratio) {
    const { renderer, camera, colours } = this, toClip = camera.matrix(), [right, up, back] = camera.axes();
    renderer.begin(left, width, height, this.ground);
    const light = normalize(add(add(back, scale(up, 0.8)), scale(right, -0.5)));
    const drawMesh = (names, ramp) => {
      renderer.drawMesh(names, toClip, { missing: colours.missing, light, eye: back, ramp });
      if (this.view.edges) renderer.drawEdges(names[0], toClip);
    };
    if (isInput) { drawMesh(["inputPositions", "inputNormals", "zeros"], PLAIN.input); return; }
    if (this.view.show !== "cage") drawMesh(["positions", "normals", "values"], this.scale.ramp);
    if (this.view.cage || this.view.show === "cage") renderer.drawCage(toClip, this.cageColour(), ratio);
    this.editor?.drawMarks(renderer, toClip, ratio);
  }

  cageColour() {
    return matchMedia("(prefers-color-scheme: dark)").matches ? [0.44, 0.66, 1] : [0.12, 0.44, 0.82];
  }

  // Where a pixel of the picture is in the part of it that shows the model.
  partOf(x) {
    return this.view.show === "both" && this.hasInput ? x - this.canvas.clientWidth / 2 : x;
  }

  reset() {
    const [centre, radius] = enclose(this.clip.cage(this.transport.frame));
    this.camera.tilt = 14;
    if (this.view.follow) this.camera.shift = subtract(meanOf(this.clip.cage(this.transport.frame)), meanOf(this.skin.cage));
    this.camera.frame(centre, radius, 32);
    this.request();
  }

  // Goes to the worst region, in its frame.
  frameWorst() {
    const { frame, vertex, extent, turn } = this.clip.header.focus;
    this.transport.play(false);
    this.transport.go(frame);
    this.compute();
    this.camera.tilt = 14;
    this.camera.frame(pointOf(this.positions, vertex), extent, turn);
    this.request(true);
  }
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
  return [scale(add(low, high), 0.5), norm(subtract(high, low)) / 2 || 1];
}

// Whether the model goes so far that the camera has to go with it.
function travels(clip) {
  const middles = listOf(clip.count, (frame) => meanOf(clip.cage(frame)));
  return enclose(middles.flat())[1] > 0.25;
}
