// The mode in which a rest cage is edited: its vertices, edges and faces, with the faults that the program finds. The
// cage is in the file's units; what is drawn, in those of the picture.
const KINDS = ["vertices", "edges", "faces"], FAULT_PAINT = [0.85, 0.1, 0.1, 1], WARNING_PAINT = [0.8, 0.55, 0, 1];

// JSON has a zero below zero, and JavaScript does not write it.
const numberText = (x) => Object.is(x, -0) ? "-0.0" : String(x);

// The text of a cage, and of the name of the file that it is for, if it has one.
/** @param {CageMesh} mesh @param {string} [name] */
const writeCage = ({ vertices, polygons }, name) => '{"vertices":[' + vertices.map((point) => "[" + point.map(numberText).join() + "]").join() + '],"polygons":' + JSON.stringify(polygons) + (name === undefined ? "" : `,"name":${JSON.stringify(name)}`) + "}";

// Reads such a text; refuses what is no cage of so many vertices.
function readCage(text, most) {
  const { vertices, polygons } = JSON.parse(text), isCorner = (k) => isIndex(k, vertices.length);
  if (!vertices?.every(isPoint) || vertices.length > most || !polygons?.every((polygon) => polygon?.length > 2 && polygon.every(isCorner))) refuse("cage", "expected vertices and polygons");
  return new CageMesh(vertices, polygons);
}

// The cage, what of it is chosen, and what was undone.
class CageEditor extends Past {
  constructor(mesh, most) {
    super();
    Object.assign(this, { mesh, most, kind: "vertices", chosen: new Set() });
  }

  // Vertices that are chosen, or that chosen edges and faces have.
  get vertices() {
    const { mesh, chosen, kind } = this;
    if (kind === "vertices") return [...chosen];
    return [...new Set([...chosen].flatMap((k) => kind === "edges" ? mesh.edges[k] : mesh.polygons[k]))];
  }

  // Faces that are chosen, or all of whose vertices are.
  get faces() {
    const chosen = new Set(this.vertices);
    return this.kind === "faces" ? [...this.chosen] : this.mesh.facesOf((k) => chosen.has(k), "every");
  }

  // Edges that are chosen, or both of whose ends are.
  get edges() {
    const chosen = new Set(this.vertices);
    return this.kind === "edges" ? [...this.chosen].map((k) => this.mesh.edges[k]) : this.mesh.edges.filter(([a, b]) => chosen.has(a) && chosen.has(b));
  }

  choose(kind, chosen) { Object.assign(this, { kind, chosen: new Set(chosen) }); }

  // Goes over to another kind of elements, and keeps what has it.
  turnTo(kind) {
    const { vertices } = this, isChosen = new Set(vertices);
    this.choose(kind, kind === "vertices" ? vertices : kind === "faces" ? this.faces : this.mesh.edges.flatMap(([a, b], k) => isChosen.has(a) && isChosen.has(b) ? [k] : []));
  }

  // Takes another mesh, so that it can be undone.
  /** @param {CageMesh} mesh @param {ElementKind} [kind] @param {Iterable<number>} [chosen] */
  set(mesh, kind = this.kind, chosen = this.chosen) {
    if (mesh.vertices.length > this.most) refuse("cage", `would have ${mesh.vertices.length} vertices, at most ${this.most} can be edited`);
    this.remember(this.snapshot());
    this.mesh = mesh;
    this.choose(kind, chosen);
  }

  snapshot() { return { mesh: this.mesh, kind: this.kind, chosen: this.chosen }; }

  restore(state) { Object.assign(this, state); }

  split() {
    const count = this.mesh.vertices.length;
    const mesh = this.some("edge", this.edges).reduce((found, [a, b]) => found.split(a, b), this.mesh);
    this.set(mesh, "vertices", listOf(mesh.vertices.length - count, (k) => count + k));
  }

  collapse() {
    if (this.kind !== "edges") { this.set(this.mesh.merge(this.some("vertex", this.vertices)), "vertices", [min(...this.vertices)]); return; }
    let mesh = this.mesh, waiting = this.some("edge", this.edges);
    const left = new Set();
    while (waiting.length) {
      const [[a, b], ...others] = waiting, first = min(a, b), gone = max(a, b), numberOf = (k) => k === gone ? first : k - Number(k > gone);
      mesh = mesh.collapse(a, b);
      left.add(first);
      waiting = others.map((edge) => edge.map(numberOf)).filter(([c, d]) => c !== d && mesh.polygonsAt(c, d).length);
    }
    this.set(mesh, "vertices", [...left].filter((k) => k < mesh.vertices.length));
  }

  turn() {
    let mesh = this.mesh;
    const turned = this.some("edge", this.edges).map(([a, b]) => {
      const found = mesh.turn(a, b);
      mesh = found.mesh;
      return pairKey(...found.edge);
    });
    this.set(mesh, "edges", [...mesh.sides.keys()].flatMap((key, k) => turned.includes(key) ? [k] : []));
  }

  subdivide() {
    const { mesh, chosen } = this.mesh.subdivide(this.chosen.size ? this.some("face", this.faces) : this.mesh.polygons.keys());
    this.set(mesh, "faces", chosen);
  }

  relax() { this.set(this.mesh.relax(this.someOrAll())); }

  inflate(distance, directions) { this.set(this.mesh.inflate(this.someOrAll(), distance, directions)); }

  remove() {
    const mesh = this.kind === "vertices" ? this.mesh.removeVertices(this.some("vertex", this.vertices)) : this.mesh.remove(this.kind === "faces" ? this.some("face", this.faces) : this.some("edge", this.edges).flatMap(([a, b]) => this.mesh.polygonsAt(a, b)));
    this.set(mesh, this.kind, []);
  }

  fill() {
    const count = this.mesh.polygons.length, mesh = this.mesh.fill(this.vertices);
    this.set(mesh, "faces", listOf(mesh.polygons.length - count, (k) => count + k));
  }

  flip() { this.set(this.mesh.flip(this.some("face", this.faces))); }

  orient() { this.set(this.mesh.orient()); }

  separate() { this.set(this.mesh.separate(this.some("vertex", this.vertices)), "vertices", []); }

  link() {
    const isChosen = new Set(this.vertices), faces = this.kind === "faces" ? [...this.chosen] : this.mesh.facesOf((k) => isChosen.has(k), "some");
    this.choose("faces", this.mesh.link(this.some("face", faces)));
  }

  // Chooses the mirror images of what is chosen, too.
  reflect(partners) {
    const { mesh, kind, chosen } = this, elements = kind === "vertices" ? [...mesh.vertices.keys()].map((k) => [k]) : mesh[kind === "edges" ? kind : "polygons"];
    const keyOf = (corners) => [...corners].sort().join(), numbers = new Map(elements.map((corners, k) => [keyOf(corners), k]));
    const images = [...chosen].map((k) => numbers.get(keyOf(elements[k].map((one) => partners[one]))));
    this.choose(kind, [...chosen, ...images.filter((k) => k !== undefined)]);
  }

  all() { this.choose(this.kind, this.mesh[this.kind === "faces" ? "polygons" : this.kind].keys()); }

  some(noun, found) {
    if (!found.length) refuse("selection", `choose ${noun === "edge" ? "an" : "a"} ${noun} first`);
    return found;
  }

  someOrAll() { return this.chosen.size ? this.vertices : [...this.mesh.vertices.keys()]; }
}

// What the program says of the cage: one request at a time, and of checks the last that is wanted.
class CageService {
  constructor(tell) { Object.assign(this, { tell, queue: Promise.resolve(), waiting: null, verdict: null, solved: null, error: "" }); }

  // Sends a cage; while the program is busy for another page, it is sent again.
  async send(path, mesh, name) {
    for (;;) {
      try {
        return await post(path, writeCage(mesh, name));
      } catch (error) {
        if (error.status !== 409 || !["check", "weights", "repair"].includes(path)) throw error;
        await new Promise((go) => setTimeout(go, STATUS_MILLISECONDS));
      }
    }
  }

  check(mesh) {
    const isWaiting = this.waiting;
    this.waiting = mesh;
    if (isWaiting) return;
    this.enqueue(async () => {
      const checked = this.waiting;
      this.waiting = null;
      this.verdict = { mesh: checked, ...await this.send("check", checked) };
    });
  }

  solve(mesh) {
    this.enqueue(async () => {
      const { payload } = await this.send("weights", mesh);
      this.solved = { mesh, skin: new Skin(await unpackPayload(payload)) };
    });
  }

  // Repairs a cage: `take` gets the mesh, and what was done.
  repair(mesh, take) {
    this.enqueue(async () => {
      const { vertices, polygons, steps, is_fit } = await this.send("repair", mesh);
      take(new CageMesh(vertices, polygons), `${steps.join("; ") || "nothing was to be repaired"}${is_fit ? "" : "; the rest is up to you"}`);
    });
  }

  enqueue(work) {
    this.isBusy = true;
    const last = this.queue = this.queue.then(work).then(() => { this.error = ""; }, (error) => { this.error = error.message; }).then(() => {
      if (last === this.queue) this.isBusy = false;
      this.tell();
    });
  }
}

extensions.push((stage) => {
  const given = document.getElementById("player-rest");
  if (!given) return;
  const { clip, camera } = stage, { vertices, polygons, most, mirror } = JSON.parse(given.textContent), { diagonal, applyUrl } = clip;
  const editor = stage.history = stage.cageEditor = new CageEditor(new CageMesh(vertices, polygons), most), panel = new Panel(stage, "rest", "rest-", editor);
  const service = stage.cageService = new CageService(() => stage.request(true));
  let trial = null, grip = null, box = null, picked = null, drawnEdges = null;

  // What would be lost with the page.
  stage.work = {
    parts: () => ({ cage: writeCage(editor.mesh) }),
    open({ cage }) {
      editor.set(readCage(cage, most), "vertices", []);
      changed();
    },
    send: (name) => service.send("save", editor.mesh, name),
  };

  // The cage that is drawn: of a trial, or as it is edited.
  const shown = () => trial ?? editor.mesh;
  const points = () => { const mesh = shown(); return mesh.foundPoints ??= mesh.vertices.map((point) => clip.fromFile(point)); };
  const solved = () => service.solved?.mesh === editor.mesh ? service.solved : null;
  const segmentsOf = (edges) => { const all = points(); return edges.map((edge) => edge.map((k) => all[k])); };
  const triangles = () => { const mesh = shown(); return mesh.foundTriangles ??= mesh.polygons.flatMap((polygon, k) => fansOf([polygon]).map((corners) => ({ k, corners }))); };
  const changed = () => { service.check(editor.mesh); trial &&= editor.mesh; picked = null; stage.request(true); };
  const edit = (name, ...words) => panel.act(() => {
    if (trial) refuse("try it", "is on, so that the cage stays; switch it off to edit");
    const before = editor.mesh;
    editor[name](...words);
    if (editor.mesh !== before) changed();
  });

  stage.travel = (name) => edit(name);

  // Both sides are edited: the partner of each vertex, or null.
  const findSides = () => {
    if (!panel.find("mirror").checked) return null;
    return findPartners(Float64Array.from(shown().vertices.flat()), mirror) ?? refuse("mirror", "the cage is not its own mirror image any more; undo what made it so, or switch Mirror off");
  };
  const editSides = (name, ...words) => {
    const sides = findSides();
    if (sides && name === "collapse" && editor.kind === "vertices") refuse("collapse", "would join both sides; choose edges, or switch Mirror off");
    if (sides) editor.reflect(sides);
    edit(name, ...words);
  };
  // What `factor` 2 mirrors, and 1 puts on the plane.
  const across = (vector, factor) => minus(vector, scale(mirror.normal, factor * dot(vector, mirror.normal)));
  const heightOf = (place) => dot(minus(place, mirror.point), mirror.normal);
  // Moves of vertices and of their partners; the side of the first leads.
  const moveSides = (mesh, moved, offset, sides) => {
    if (!sides) return mesh.move(moved, offset);
    const leading = Math.sign(heightOf(mesh.vertices[moved[0]])) || 1;
    return mesh.place([...new Set(moved.flatMap((k) => [k, sides[k]]))].map((k) => {
      const isLeading = Math.sign(heightOf(mesh.vertices[k])) === leading;
      return [k, add(mesh.vertices[k], sides[k] === k ? across(offset, 1) : isLeading ? offset : across(offset, 2))];
    }));
  };

  // The element under a pixel, or -1.
  const hit = (x, y, event) => {
    const all = points();
    if (editor.kind === "vertices") return nearestPoint(camera, all, x, y, event);
    if (editor.kind === "edges") return nearestSegment(camera, segmentsOf(shown().edges), x, y, event);
    const found = triangles(), at = firstHit(camera.ray(x, y), found.map(({ corners }) => corners.map((k) => all[k])));
    return at < 0 ? -1 : found[at].k;
  };
  const choose = (k, isAdded) => {
    const { chosen } = editor;
    if (!isAdded) editor.choose(editor.kind, k < 0 ? [] : [k]);
    else if (k >= 0) { if (!chosen.delete(k)) chosen.add(k); }
    stage.request(true);
  };
  const isAdding = (event) => event?.shiftKey || panel.find("add").checked;
  const middleOf = (k) => meanPoint((editor.kind === "vertices" ? [k] : editor.kind === "edges" ? shown().edges[k] : shown().polygons[k]).map((one) => points()[one]));
  const put = (mesh) => { if (trial) trial = mesh; else editor.mesh = mesh; };

  const mode = {
    name: "rest",
    grab(x, y, event) {
      const k = hit(x, y, event), isChosen = editor.chosen.has(k);
      const isBox = panel.find("box").checked || event.ctrlKey || event.metaKey;
      if (isBox || k < 0 || (editor.kind === "faces" && !isChosen)) {
        if (!isBox && !event.shiftKey) return false;
        box = new SelectionBox(camera, x, y);
        return true;
      }
      // A click on what is chosen chooses it alone, or no more; a drag moves all that is chosen.
      const click = isChosen ? () => choose(k, isAdding(event)) : null;
      if (!isChosen) choose(k, isAdding(event));
      const follow = followPointer(camera, x, y, middleOf(k), AXES[panel.find("axis").value]);
      const first = editor.kind === "vertices" ? [k] : editor.kind === "edges" ? shown().edges[k] : shown().polygons[k];
      grip = { before: editor.snapshot(), mesh: shown(), vertices: [...first, ...editor.vertices], sides: null, follow, click };
      panel.act(() => { grip.sides = findSides(); });
      return true;
    },
    drag(x, y) {
      if (box) { box.to = [x, y]; stage.request(); return; }
      const { mesh, vertices: moved, sides, follow } = grip;
      grip.click = null;
      grip.isMoved = true;
      put(moveSides(mesh, [...new Set(moved)], scale(follow(x, y), diagonal), sides));
      // The model stays, unless it is tried how it follows.
      if (!trial) stage.renderer.uploadCage(stage.drawnCage());
      stage.request(Boolean(trial));
    },
    drop() {
      if (box) {
        const middles = shown()[editor.kind === "faces" ? "polygons" : editor.kind].map((_, k) => middleOf(k));
        editor.choose(editor.kind, [...editor.chosen, ...box.list(middles)]);
        box = null;
        stage.request(true);
        return;
      }
      grip.click?.();
      if (grip.isMoved && !trial) {
        editor.remember(grip.before);
        panel.act(changed);
      }
      grip = null;
    },
    click(x, y, event) { choose(hit(x, y, event), isAdding(event)); },
    hover(x, y) {
      const k = hit(x, y);
      stage.modes.say(k < 0 ? "" : editor.kind === "vertices" ? `vertex ${k}` : editor.kind === "edges" ? `edge ${shown().edges[k].join("-")}` : `face ${k}: ${shown().polygons[k].join(", ")}`);
    },
    press(event) {
      const key = event.key.toLowerCase();
      const keys = { s: "split", k: "collapse", t: "turn", d: "subdivide", e: "relax", h: "fill", delete: "remove", backspace: "remove", l: "link", a: "all", i: "inflate" };
      if (event.ctrlKey || event.metaKey || event.altKey) return false;
      if (["1", "2", "3"].includes(key)) panel.act(() => editor.turnTo(KINDS[key - 1]));
      else if (key === "escape") choose(-1);
      else if (keys[key]) panel.find(keys[key]).click();
      else return false;
      return true;
    },
    draw(renderer) {
      const all = points(), corners = (faces) => faces.flatMap((face) => face.flatMap((k) => all[k]));
      const lines = (edges, paint, pixels) => renderer.drawTriangles(thicken(camera, segmentsOf(edges), pixels), paint);
      const dots = (found, paint, size) => renderer.drawDots(found.flat(), paint, size);
      const verdict = findings();
      for (const found of verdict) {
        const paint = found.severity === "warning" ? WARNING_PAINT : FAULT_PAINT, [r, g, b] = paint, isPicked = found === picked;
        renderer.drawTriangles(corners(found.faces), [r, g, b, isPicked ? 0.6 : 0.35]);
        lines([...found.edges, ...found.faces.flatMap(sidesOf)], paint, isPicked ? 4 : 2.5);
        dots(found.points.map((point) => clip.fromFile(point)), paint, isPicked ? 8 : 5);
        dots(found.vertices.map((k) => all[k]), paint, isPicked ? 15 : 11);
      }
      if (editor.kind === "faces") renderer.drawTriangles(corners(fansOf([...editor.chosen].map((k) => shown().polygons[k]))), [0.95, 0.5, 0.05, 0.4]);
      if (editor.kind !== "vertices") lines(editor.kind === "edges" ? [...editor.chosen].map((k) => shown().edges[k]) : [...editor.chosen].flatMap((k) => sidesOf(shown().polygons[k])), CHOSEN_PAINT, 3);
      if (editor.kind === "vertices") dots([...editor.chosen].map((k) => all[k]), CHOSEN_PAINT, 12);
      box?.draw(renderer);
    },
    // With weights, colours show the influence of what is chosen.
    paint(values) {
      const { skin } = solved() ?? {}, found = skin && editor.vertices;
      if (!found?.length) return null;
      for (let j = 0, n = skin.cageCount; j < values.length; j++) values[j] = sumOf(found.map((k) => skin.weights[j * n + k]));
      return { ramp: stage.colours.ramp };
    },
    chosen: () => (editor.chosen.size ? editor.vertices.map((k) => points()[k]) : points()),
  };

  // What is known of the cage's faults, if it still has the vertices that they name.
  const findings = () => service.verdict?.mesh.polygons === editor.mesh.polygons ? service.verdict.findings : [];

  // The camera goes where a finding is.
  const goTo = (found) => {
    const places = [...found.vertices, ...found.edges.flat(), ...found.faces.flat()].map((k) => points()[k]).concat(found.points.map((point) => clip.fromFile(point)));
    picked = picked === found ? null : found;
    // What is to be dragged is chosen, so that it can be.
    if (picked && found.kind === "outside" && found.vertices.length) editor.choose("vertices", found.vertices);
    if (!places.length) return;
    const [centre, radius] = enclose(places.flat());
    camera.frame(centre, max(radius, 0.15));
  };

  // The stage draws this cage in place of its own, which is a box around it.
  stage.drawnCage = () => {
    const mesh = shown();
    if (drawnEdges !== mesh.polygons) { drawnEdges = mesh.polygons; stage.renderer.sendIndices("cageEdges", Uint32Array.from(mesh.edges.flat())); }
    return points().flat();
  };
  // With weights, the model follows the cage that is tried.
  stage.mold = (out) => {
    const { skin } = solved() ?? {};
    if (!trial || !skin) return false;
    skin.deform(Float64Array.from(points().flat()), [1, 0, 0, 0, 1, 0, 0, 0, 1], out);
    return true;
  };
  for (const name of ["split", "collapse", "turn", "subdivide", "relax", "remove", "fill", "flip", "orient", "separate", "link", "all"]) panel.listen(name, () => editSides(name));
  panel.listen("inflate", () => editSides("inflate", panel.numberOf("amount") / 100 * diagonal, panel.find("along").value === "model" ? directionsFromModel(editor.mesh, stage, clip) : undefined));
  for (const kind of KINDS) panel.listen(kind, () => editor.turnTo(kind));
  panel.listen("solve", () => service.solve(editor.mesh));
  panel.listen("repair", () => {
    const before = editor.mesh;
    service.repair(before, (mesh, done) => {
      if (editor.mesh !== before) { editor.complaint = "the cage was edited while it was repaired; press Repair again"; return; }
      editor.set(mesh, "vertices", []);
      editor.complaint = done;
      changed();
    });
  });
  panel.listen("try", (input) => { trial = input.checked ? editor.mesh : null; });
  panel.listen("list", (input) => editor.choose("vertices", parseVertices(input.value, editor.mesh.vertices.length)));
  panel.listenToPoint("", (k, value) => {
    const [vertex] = editor.vertices, place = [...shown().vertices[vertex]];
    place[k] = value;
    const sides = findSides(), partner = sides?.[vertex] ?? vertex, height = sides ? heightOf(place) : 0;
    if (sides && partner === vertex) place.splice(0, 3, ...minus(place, scale(mirror.normal, height)));
    const next = shown().place([[vertex, place], ...partner === vertex ? [] : [[partner, minus(place, scale(mirror.normal, 2 * height))]]]);
    if (trial) { trial = next; return; }
    editor.set(next);
    changed();
  });
  on(panel.find("apply"), "click", async () => {
    const tell = (text) => { editor.complaint = text; stage.request(); }, parts = stage.work.parts();
    try {
      tell(await followJob(await service.send(applyUrl, editor.mesh), tell));
      stage.keeper.takeSaved(parts);
    } catch (error) { tell(error.message); }
  });
  panel.find("apply").hidden = !applyUrl;
  panel.find("mirror").parentElement.hidden = !mirror;
  stage.modes.add(mode);
  // The model may come out of the cage: both are seen.
  stage.framed = () => [...points().flat(), ...stage.view.show === "cage" ? [] : stage.positions];
  makeAgain(stage, panel);
  stage.listeners.push(() => showRest(panel, { service, stage, findings: findings(), goTo, picked, trial, solved: solved(), shown: shown() }));
  changed();
});

// Extracts the result, whose cage it is, again: bad places of the clip, a new file, and the errors before and after.
/** @param {Stage} stage @param {Panel} panel */
function makeAgain(stage, panel) {
  const { cageEditor: editor, cageService: service, clip, camera } = stage, { again } = JSON.parse(document.getElementById("player-session").textContent);
  if (!again) return;
  const find = (name) => panel.find(name), list = find("places"), colours = stage.find("colours"), tell = (text) => panel.say("again-said", text);
  let errors = null;
  const showPlaces = (places) => list.replaceChildren(...places.map((place) => {
    const item = makeElement("li"), centre = clip.fromFile(place.point);
    item.append(makeButton(place.sentence, () => {
      // The faces of the cage, as it is now, that are nearest.
      const { mesh } = editor, awayOf = (k) => norm(minus(meanPoint(mesh.polygons[k].map((corner) => clip.fromFile(mesh.vertices[corner]))), centre));
      editor.choose("faces", [...mesh.polygons.keys()].map((k) => [awayOf(k), k]).sort(([a], [b]) => a - b).slice(0, place.faces).map(([, k]) => k));
      camera.frame(centre, place.size);
      stage.request(true);
    }));
    return item;
  }));
  const showColours = (mode) => {
    stage.view.colours = colours.value = mode;
    stage.request(true);
  };
  // The colours of both have one scale.
  const showErrors = () => {
    const found = errors[find("which").value], top = found.rms.reduce((most, x) => max(most, x ?? 0), 0) || 1;
    clip.arrays.rms = Uint16Array.from(found.rms, (x) => x === null ? 65535 : round(x / top * 65534));
    clip.rms = { ...clip.rms, top };
    showPlaces(found.places);
    showColours("rms");
  };
  find("again-name").value = again.name;
  panel.say("before", `${again.before.name}: ${again.before.text}`);
  tell(again.problem);
  showPlaces(again.places);
  showColours("rms");
  panel.listen("which", showErrors);
  on(find("again"), "click", async () => {
    const name = find("again-name"), { mesh } = editor, button = find("again");
    button.disabled = true;
    try {
      const said = await followJob(await service.send("extract", mesh, name.value.trim()), tell);
      errors = await post("errors", "{}");
      name.value = nextName(name.value);
      panel.say("after", `${errors.after.name}: ${errors.after.text}`);
      Object.assign(find("which"), { value: "after" }).parentElement.hidden = false;
      showErrors();
      tell(said);
      stage.keeper.takeSaved({ cage: writeCage(mesh) });
    } catch (error) { tell(error.message); }
    button.disabled = false;
  });
}

// The first of triangles, each of three points, that a ray hits, from either side; -1 for none.
function firstHit({ origin, direction }, triangles) {
  let best = Infinity, found = -1;
  triangles.forEach(([a, b, c], k) => {
    const u = minus(b, a), v = minus(c, a), h = cross(direction, v), size = dot(u, h);
    if (!size) return;
    const from = minus(origin, a), s = dot(from, h) / size, q = cross(from, u), t = dot(direction, q) / size, depth = dot(v, q) / size;
    if (s >= 0 && t >= 0 && s + t <= 1 && depth > 0 && depth < best) { best = depth; found = k; }
  });
  return found;
}

// Triangles on the screen for lines of some width between pairs of points.
function thicken(camera, segments, pixels) {
  return segments.flatMap((ends) => {
    const [[x, y, near], [u, v, far]] = ends.map((end) => camera.project(end)), length = hypot(u - x, v - y);
    if (min(near, far) <= 0 || !length) return [];
    const [a, b] = [(y - v) / length * pixels / 2, (u - x) / length * pixels / 2];
    const corners = [[x + a, y + b], [x - a, y - b], [u - a, v - b], [u + a, v + b]].map((pixel) => camera.unproject(pixel));
    return [0, 1, 2, 0, 2, 3].flatMap((k) => corners[k]);
  });
}

// From the nearest vertex of the model to each vertex of the cage; along the normal where that points inward.
function directionsFromModel(mesh, { positions }, clip) {
  const normals = mesh.normals();
  return mesh.vertices.map((vertex, k) => {
    const [x, y, z] = clip.fromFile(vertex);
    let best = Infinity, from = 0;
    for (let j = 0; j < positions.length; j += 3) {
      const away = (positions[j] - x) ** 2 + (positions[j + 1] - y) ** 2 + (positions[j + 2] - z) ** 2;
      if (away < best) { best = away; from = j; }
    }
    const direction = normalize([x - positions[from], y - positions[from + 1], z - positions[from + 2]]);
    return dot(direction, normals[k]) > 0 ? direction : normals[k];
  });
}

// Brings the panel up to date.
function showRest(panel, { service, stage, findings, goTo, picked, trial, solved, shown }) {
  const { editor } = panel, { mesh, kind, chosen } = editor, find = (name) => panel.find(name);
  for (const one of KINDS) find(one).setAttribute("aria-pressed", one === kind);
  panel.enable({ solve: !service.isBusy && !solved, try: solved, repair: !service.isBusy && !trial });
  if (trial && !solved) find("try").click();
  find("try").checked = Boolean(trial);
  panel.say("counts", `${mesh.vertices.length} vertices, ${mesh.polygons.length} faces; chosen ${kind}: ${chosen.size}`);
  const isChecked = service.verdict?.mesh === mesh;
  panel.say("verdict", service.error || (isChecked ? service.verdict.verdict_word : "checking …"));
  find("verdict").dataset.verdict = isChecked && !service.error ? service.verdict.verdict : "";
  const list = find("findings"), state = service.verdict;
  if (list.shownState !== state || list.shownPicked !== picked) {
    Object.assign(list, { shownState: state, shownPicked: picked });
    // Where the panel is folded, as on a phone, the picture says it.
    if (isChecked) stage.modes.say(`check: ${[service.verdict.verdict_word, ...findings.slice(0, 1).map(({ kind: fault }) => fault.replaceAll("-", " "))].join(", ")}`);
    list.replaceChildren(...findings.map((found) => {
      const item = makeElement("li"), button = makeButton("", () => { goTo(found); stage.request(true); }, "Look at this finding.");
      button.append(makeElement("strong", { textContent: found.severity }), ` ${found.sentence}`);
      button.setAttribute("aria-pressed", found === picked);
      item.append(button);
      return item;
    }));
  }
  const numbers = kind === "vertices" ? [...chosen] : [], isOne = numbers.length === 1;
  panel.put("list", writeVertices(numbers));
  panel.enable({ x: isOne, y: isOne, z: isOne });
  if (isOne) panel.putPoint("", shown.vertices[numbers[0]]); else for (const axis of "xyz") panel.put(axis, "");
  panel.say("influence", !solved ? (service.solved ? "the cage has changed since its weights were solved" : "") : editor.vertices.length ? `largest weight on the model ${ROUND(stage.colours.values.reduce((most, x) => max(most, x), 0))}` : "choose a vertex to see its influence");
  panel.say("said", editor.complaint);
}
