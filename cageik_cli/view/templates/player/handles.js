// Handles by mouse, touch and keyboard, and the panel that lists them.
const SNAP_PIXELS = 7;

/** @param {Stage} stage */
function makeHandles(stage) {
  const editor = stage.editor = stage.history = new Editor(stage), { clip, transport } = stage;
  const panel = new Panel(stage, "pose", "", editor);
  let tool = "move", grip = null, pull = null;
  stage.travel = (name) => panel.act(() => editor[name]());

  const hit = (x, y, event) => nearestSeen(stage, editor.anchors, x, y, event);
  // Where a click would add one: a vertex that is near, else the point of the face.
  const pick = (x, y) => {
    const found = tool === "move" ? null : pickSurface(stage, x, y);
    if (!found) return null;
    const { vertex, face, shares, pixels, near } = found, isVertex = clip.arrays.vertices || pixels < SNAP_PIXELS;
    return { ...found, place: isVertex ? { vertex } : { face, barycentric: shares }, point: isVertex ? pointOf(stage.positions, near) : placeOn(stage.positions, found) };
  };
  const begin = (values) => {
    const { target } = editor.places[editor.selected], { value } = panel.find("axis");
    return stage.modes.begin({
      kind: "g", kinds: "g", axis: AXES[value] ? value : "", pivot: target, ...values,
      apply: (transform) => editor.drag(() => editor.aim(add(target, transform.displace(target, 1)))),
      end: (isKept) => isKept ? editor.drop() : editor.cancel(),
    });
  };
  stage.modes.add({
    name: "pose",
    grab(x, y, event) {
      const k = transport.isPlaying ? -1 : hit(x, y, event);
      pull = k < 0 && tool === "move" && !transport.isPlaying ? grabRing(stage, x, y, event) : null;
      if (pull) return true;
      if (k < 0) return false;
      editor.select(k);
      if (!(editor.motion in TRACKS)) return false;
      grip = begin({ start: [x, y] });
      return true;
    },
    drag: (x, y) => { if (pull) editor.drag(() => pull(x, y)); else grip?.move(x, y); },
    drop: () => { if (pull) editor.drop(); else grip?.finish(true); pull = null; },
    click(x, y, event) {
      const k = hit(x, y, event), found = k < 0 && pick(x, y);
      if (!found) { editor.select(k); return; }
      editor.add(found.place, tool);
    },
    hover(x, y, event) {
      const k = hit(x, y, event), found = k < 0 ? pick(x, y) : null, handle = editor.set.handles[k];
      if (handle) return { text: handle.name, cursor: motionOf(handle) in TRACKS ? "move" : "pointer", kind: "ring", points: [editor.anchors[k]] };
      if (!found && tool === "move" && hitRing(stage, x, y, event)) return { text: "radius: drag it over the surface", cursor: "ew-resize" };
      return found ? { text: describePlace(found), cursor: "crosshair", kind: `ghost ${tool}`, points: [found.point] } : { text: "" };
    },
    press(event) {
      if (event.key === "Escape" && pull) { pull = null; editor.cancel(); }
      else if (event.key === "Delete") editor.remove();
      else if (event.key.toLowerCase() === "g" && editor.motion in TRACKS && !event.ctrlKey && !event.metaKey) begin();
      else if (event.key === "Escape") editor.select(-1);
      else return false;
      return true;
    },
    draw: (renderer) => editor.draw(renderer),
    chosen: () => editor.handle ? [editor.anchors[editor.selected]] : editor.anchors,
  });

  /** @type {any[]} */
  const tools = [...panel.element.querySelectorAll("[data-tool]")];
  for (const button of tools) on(button, "click", () => {
    tool = button.dataset.tool;
    transport.play(false);
    for (const one of tools) one.setAttribute("aria-pressed", one === button);
  });
  panel.listen("remove", () => editor.remove());
  panel.listen("add", () => {
    const vertex = panel.numberOf("vertex");
    resolvePlace({ vertex }, clip, "handle");
    editor.add({ vertex }, tool === "pin" ? "pin" : "handle");
  });
  panel.listen("rounds", () => { editor.rounds = clamp(round(panel.numberOf("rounds")), 0, 1000); editor.refresh(); });
  // What is undefined is not in the file that is saved.
  panel.edit("mirror", (input) => { editor.file.mirror = input.checked ? clip.mirror : undefined; });
  panel.edit("held", (input) => {
    editor.set.hold = input.checked ? undefined : false;
    if (!input.checked) for (const handle of editor.set.handles) delete handle.radius;
  });
  panel.edit("radius", (input) => { editor.handle.radius = input.valueAsNumber > 0 ? input.valueAsNumber : undefined; });
  panel.edit("axes", (input) => { editor.handle.axes = input.value === "surface" ? "surface" : undefined; });
  panel.edit("ease", (input) => { editor.handle[editor.motion].ease = input.value; });
  panel.edit("motion", (input) => {
    const { handle, motion, places, selected } = editor, { start, target } = places[selected];
    delete handle[motion];
    delete handle.axes;
    handle[input.value] = { offset: shortenPoint(scale(minus(target, start), clip.diagonal)), target: shortenPoint(clip.toFile(target)) }[input.value] ?? true;
  });
  panel.edit("hard", (input) => { editor.handle.hard = input.checked || undefined; });
  panel.listen("layer", (list) => { editor.active = Number(list.value); editor.selected = -1; });
  panel.editSpan(() => editor.set);
  panel.editName(() => editor.set.handles, () => editor.handle);
  panel.listenToPoint("move-", (k, value) => {
    const { start, target } = editor.places[editor.selected];
    target[k] = start[k] + value / clip.diagonal * blendSet(editor.set, stage.number);
    editor.change(() => editor.aim(target));
  });
  for (const [name, change] of Object.entries({ key: setKey, unkey: removeKey })) panel.edit(name, () => {
    const { handle, motion } = editor;
    handle[motion] = change(handle[motion], stage.number);
  });
  panel.exchange("handles.json", () => editor.actingFile, (text) => {
    const file = readFile(text, clip);
    editor.change(() => Object.assign(editor, { selected: -1, active: 0, file }));
  });
  panel.find("rounds").value = editor.rounds;
  stage.listeners.push(() => showHandles(panel, stage));
}

function hitRing(stage, x, y, event) {
  const points = stage.editor.ring;
  return nearestSeen(stage, listOf(points.length / 3, (k) => points.slice(3 * k, 3 * k + 3)), x, y, event) >= 0;
}

// Drags the ring of the selected handle to another place of the surface, which is its new radius.
function grabRing(stage, x, y, event) {
  const { editor, clip } = stage, { reach } = editor;
  if (!hitRing(stage, x, y, event)) return null;
  const { away } = editor.surface.measure(editor.layer.anchors[reach.k], Infinity);
  return (u, v) => {
    const found = pickSurface(stage, u, v);
    if (!found || !(away[found.near] > 0)) return;
    editor.handle.radius = Number((away[found.near] * clip.diagonal).toPrecision(4));
    editor.refresh();
  };
}

// Brings the panel up to date.
function showHandles(panel, { editor, clip, number, moved }) {
  const { set, handle, motion, file } = editor;
  const list = panel.find("handles"), state = JSON.stringify([set.handles.map(({ name, vertex, face }) => [name, vertex, face]), editor.selected]);
  if (list.dataset.state !== state) {
    const focused = list.contains(document.activeElement);
    list.dataset.state = state;
    list.replaceChildren(...set.handles.map((one, k) => {
      const place = one.vertex === undefined ? `face ${one.face}, ${one.barycentric.join(", ")}` : `vertex ${one.vertex}`;
      const item = makeElement("li"), button = makeButton(`${one.name}: ${place}`, () => editor.select(k), "Choose this handle.");
      button.setAttribute("aria-pressed", k === editor.selected);
      item.append(button);
      return item;
    }));
    if (focused) list.querySelector('[aria-pressed="true"]')?.focus();
  }
  panel.find("mirror").checked = file.mirror;
  panel.find("held").checked = set.hold !== false;
  const sets = listSets(file);
  panel.find("layer").closest("span").hidden = sets.length < 2;
  panel.putChoice("layer", sets.map((_, k) => `${k + 1} of ${sets.length}`), editor.active);
  panel.find("chosen").hidden = !handle;
  if (handle) {
    panel.put("name", handle.name);
    panel.find("hard").checked = handle.hard;
    panel.find("moves").hidden = !(motion in TRACKS);
    panel.find("motion").value = motion;
    panel.find("reach").hidden = set.hold === false;
    panel.put("radius", handle.radius ?? "");
    if (editor.reach) panel.find("radius").placeholder = ROUND(Number((editor.reach.radius * clip.diagonal).toPrecision(3)));
    panel.find("offset").hidden = motion !== "offset";
    panel.find("axes").value = handle.axes ?? "world";
    panel.find("ease").hidden = !handle[motion].frames;
    panel.find("ease").value = handle[motion].ease ?? "smooth";
    const value = motion in TRACKS ? evaluateTrack(handle[motion], number) : null;
    if (value) panel.putPoint("move-", motion === "offset" ? value : minus(value, clip.toFile(editor.places[editor.selected].start)));
  }
  const beyond = moved?.count ? `${moved.count} vertices, in orange, move more than the handles do: vertex ${clip.fileVertex(moved.most.vertex)} by ${ROUND(moved.most.distance * clip.diagonal)}, the handles by ${ROUND(moved.largest * clip.diagonal)} at most. ` : "";
  panel.enable({ save: editor.actingFile });
  panel.showEdit("pose", set, handle?.[motion], { isMarked: set.handles.length, beyond });
}

// The command that does what the page shows; nothing if there is no edit.
function makeCommand({ actingFile, actingCageFile, hasEdits, clip, rounds }) {
  const words = rounds ? ` --rigidity ${rounds}` : "", handles = actingFile ? ` handles.json${words}` : "", cages = actingCageFile ? " --cage-edits cage_edits.json" : "";
  return hasEdits ? `cageik pose ${clip.target}${handles}${cages} -o ${clip.isClip ? "edited.h5" : "posed.obj"}` : "";
}
