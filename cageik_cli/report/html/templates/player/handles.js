// Handles by mouse, touch and keyboard, and the panel that lists them.
const GRAB_PIXELS = 16, SNAP_PIXELS = 7;
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };

// The point of a ray on the plane through `start` that is parallel to the screen, or nearest to it on an axis.
function movePoint(camera, { origin, direction }, start, axis) {
  if (!axis) {
    const normal = camera.axes()[2];
    return add(origin, scale(direction, dot(subtract(start, origin), normal) / dot(direction, normal)));
  }
  const away = subtract(start, origin), along = dot(axis, direction), size = 1 - along * along;
  return size < 1e-6 ? start : add(start, scale(axis, (along * dot(direction, away) - dot(axis, away)) / size));
}

function makeHandles(section, stage) {
  const editor = stage.editor = new Editor(stage), { clip, camera, transport } = stage;
  const find = (name) => section.querySelector(`[data-${name}]`), panel = find("posing");
  let tool = "look", grip = null;

  const hit = (x, y, reach) => {
    let best = reach, found = -1;
    editor.anchorsIn(stage.cage, transport.frame).forEach((place, k) => {
      const [u, v] = camera.project(place), away = hypot(u - x, v - y);
      if (away < best) { best = away; found = k; }
    });
    return found;
  };
  // The surface point under a pixel: a vertex if one is near.
  const pick = (x, y) => {
    if (tool === "look" || transport.isPlaying) return null;
    const found = stage.skin.pick(stage.positions, camera.ray(x, y));
    if (!found) return null;
    const near = found.corners[found.barycentric.indexOf(max(...found.barycentric))];
    const [u, v] = camera.project(pointOf(stage.positions, near));
    const vertex = clip.fileVertex(near), isVertex = clip.arrays.vertices || hypot(u - x, v - y) < SNAP_PIXELS;
    const shares = found.barycentric.map((share) => Number(share.toFixed(6)));
    shares[0] = Number((1 - shares[1] - shares[2]).toFixed(6));
    return { place: isVertex ? { vertex } : { face: found.face, barycentric: shares }, vertex, face: found.face, shares };
  };
  const actions = {
    grab(x, y, event) {
      const k = transport.isPlaying ? -1 : hit(stage.partOf(x), y, event.pointerType === "touch" ? 2 * GRAB_PIXELS : GRAB_PIXELS);
      if (k < 0) return false;
      editor.select(k);
      if (editor.handle.pin) return false;
      const { target } = editor.places(transport.frame)[k], axis = AXES[find("axis").value];
      const follow = (u, v) => movePoint(camera, camera.ray(stage.partOf(u), v), target, axis), from = follow(x, y);
      grip = { move: (u, v) => add(target, subtract(follow(u, v), from)), file: JSON.stringify(editor.file) };
      return true;
    },
    drag(x, y) {
      editor.isDragging = true;
      editor.aim(transport.frame, grip.move(x, y));
    },
    drop() {
      if (editor.isDragging) { editor.past.push(grip.file); editor.future = []; }
      editor.isDragging = false;
      editor.refresh();
    },
    click(x, y) {
      const part = stage.partOf(x), k = hit(part, y, GRAB_PIXELS);
      const found = k < 0 && pick(part, y);
      if (found) editor.add(found.place, tool);
      else editor.select(k);
    },
    hover(x, y) {
      const found = pick(stage.partOf(x), y);
      find("under").textContent = found ? `vertex ${found.vertex}; face ${found.face}, barycentric ${found.shares.join(", ")}` : "";
    },
  };

  const tools = [...panel.querySelectorAll("[data-tool]")];
  for (const button of tools) listenTo(button, "click", () => {
    tool = button.dataset.tool;
    transport.play(false);
    for (const one of tools) one.setAttribute("aria-pressed", one === button);
  });
  // Buttons act on clicks, inputs on changes; `edit` is for actions that can be undone.
  const listen = (name, action) => listenTo(find(name), find(name).type === "button" ? "click" : "change", ({ target }) => {
    try { action(target); editor.complaint = ""; } catch (error) { editor.complaint = error.message; }
    stage.request(true);
  });
  const edit = (name, action) => listen(name, (input) => editor.change(() => action(input)));
  const numberOf = (input) => { if (input.value === "" || !Number.isFinite(input.valueAsNumber)) refuse(input.labels[0].textContent, "expected a number"); return input.valueAsNumber; };
  for (const name of ["undo", "redo", "remove"]) listen(name, () => editor[name]());
  listen("add", () => {
    const vertex = numberOf(find("vertex"));
    resolvePlace({ vertex }, clip, "handle");
    editor.add({ vertex }, tool === "pin" ? "pin" : "handle");
  });
  listen("rounds", (input) => { editor.rounds = clamp(Math.round(numberOf(input)), 0, 1000); editor.refresh(); });
  // What is undefined is not in the file that is saved.
  edit("mirror", (input) => { editor.file.mirror = input.checked ? clip.header.mirror : undefined; });
  edit("hard", (input) => { editor.handle.hard = input.checked || undefined; });
  listen("layer", (list) => { editor.active = Number(list.value); editor.selected = -1; });
  const spans = ["first", "last", "falloff"];
  for (const name of spans) edit(name, () => {
    const [first, last, falloff] = spans.map((one) => numberOf(find(one))), [from, to] = [first, last].map((number) => clip.frameOf(number));
    Object.assign(editor.set, { frames: [from, max(from, to)].map((frame) => clip.numberOf(frame)), falloff: max(0, Math.round(falloff)) });
  });
  listen("name", (input) => {
    const name = input.value.trim();
    if (!name || editor.set.handles.some((one, k) => one.name === name && k !== editor.selected)) refuse("Name", "expected a name of its own");
    editor.change(() => { editor.handle.name = name; });
  });
  [..."xyz"].forEach((axis, k) => listen(`move-${axis}`, (input) => {
    const value = numberOf(input), { start, target } = editor.places(transport.frame)[editor.selected];
    target[k] = start[k] + value / clip.header.diagonal * blendSet(editor.set, clip.numberOf(transport.frame));
    editor.change(() => editor.aim(transport.frame, target));
  }));
  edit("key", () => {
    const { handle } = editor, motion = motionOf(handle), number = clip.numberOf(transport.frame), now = evaluateTrack(handle[motion], number);
    if (Array.isArray(handle[motion])) handle[motion] = { frames: [], values: [] };
    setValue(handle[motion], number, [...now]);
  });
  edit("unkey", () => {
    const { handle } = editor, motion = motionOf(handle), { frames, values } = handle[motion], at = frames.indexOf(clip.numberOf(transport.frame));
    if (frames.length === 1) handle[motion] = values[0];
    else for (const list of [frames, values]) list.splice(at, 1);
  });
  listen("save", () => {
    const text = encodeURIComponent(`${JSON.stringify(editor.file, null, 2)}\n`);
    makeElement("a", { href: `data:application/json,${text}`, download: "handles.json" }).click();
  });
  listenTo(find("load"), "change", async ({ target }) => {
    try {
      const file = readFile(await target.files[0].text(), clip);
      editor.complaint = "";
      editor.change(() => Object.assign(editor, { selected: -1, active: 0, file }));
    } catch (error) { editor.complaint = `${target.files[0].name}: ${error.message}`; }
    target.value = "";
    stage.request(true);
  });
  listenTo(stage.canvas, "keydown", (event) => {
    const isCommand = event.ctrlKey || event.metaKey, key = event.key.toLowerCase();
    if (event.key === "Delete") editor.remove();
    else if (event.key === "Escape") editor.select(-1);
    else if (isCommand && (key === "y" || (key === "z" && event.shiftKey))) editor.redo();
    else if (isCommand && key === "z") editor.undo();
    else return;
    event.preventDefault();
  });
  find("mirror").closest("span").hidden = !clip.header.mirror;
  find("rounds").value = editor.rounds;
  stage.listeners.push(() => showHandles(find, stage));
  return actions;
}

const ROUND = (x) => Number(x.toPrecision(6));

// Brings the panel up to date.
function showHandles(find, { editor, clip, transport, moved }) {
  const { set, handle, file } = editor, { frame } = transport, number = clip.numberOf(frame), motion = handle && motionOf(handle), isIdle = !editor.isDragging;
  const list = find("handles"), state = JSON.stringify([set.handles.map(({ name, vertex, face }) => [name, vertex, face]), editor.selected]);
  if (list.dataset.state !== state) {
    const focused = list.contains(document.activeElement);
    list.dataset.state = state;
    list.replaceChildren(...set.handles.map((one, k) => {
      const place = one.vertex === undefined ? `face ${one.face}, ${one.barycentric.join(", ")}` : `vertex ${one.vertex}`;
      const item = makeElement("li"), button = makeButton(`${one.name}: ${place}`, () => editor.select(k));
      button.setAttribute("aria-pressed", k === editor.selected);
      item.append(button);
      return item;
    }));
    if (focused) list.querySelector('[aria-pressed="true"]')?.focus();
  }
  for (const [name, { length }] of Object.entries({ undo: editor.past, redo: editor.future, save: set.handles, apply: set.handles })) find(name).disabled = !length;
  find("mirror").checked = Boolean(file.mirror);
  const sets = listSets(file);
  find("layer").closest("span").hidden = sets.length < 2;
  if (find("layer").length !== sets.length) find("layer").replaceChildren(...sets.map((_, k) => new Option(`${k + 1} of ${sets.length}`, k)));
  find("layer").value = editor.active;
  const [first, last] = set.frames ?? clip.ends;
  const put = (name, value) => { const input = find(name); if (input !== document.activeElement || !isIdle) input.value = value; };
  put("first", first); put("last", last); put("falloff", set.falloff ?? 0);
  find("chosen").hidden = !handle;
  if (handle) {
    put("name", handle.name);
    find("hard").checked = Boolean(handle.hard);
    find("moves").hidden = motion === "pin";
    const value = motion === "pin" ? null : evaluateTrack(handle[motion], number);
    if (value) {
      const place = motion === "offset" ? value : subtract(value, clip.toFile(editor.places(frame)[editor.selected].start));
      [..."xyz"].forEach((axis, k) => put(`move-${axis}`, ROUND(place[k])));
    }
    const keys = handle[motion].frames;
    find("unkey").disabled = !keys?.includes(number);
    find("keys").textContent = keys ? `keys at ${keys.join(", ")}` : "the same in all frames";
  }
  showStrip(find("strip"), set, handle?.[motion]?.frames ?? [], clip.ends);
  const beyond = moved?.count ? `${moved.count} vertices, in orange, move more than the handles do: vertex ${clip.fileVertex(moved.most.vertex)} by ${ROUND(moved.most.distance * clip.header.diagonal)}, the handles by ${ROUND(moved.largest * clip.header.diagonal)} at most. ` : "";
  const said = editor.complaint || editor.message || beyond;
  const say = (name, text) => { if (find(name).textContent !== text) find(name).textContent = text; };
  say("said", said);
  const output = clip.header.isClip ? "edited.h5" : "posed.obj";
  say("command", set.handles.length ? `cageik pose ${clip.header.target} handles.json --rigidity ${editor.rounds} -o ${output}` : "");
}

// The frames of the edit and the keys of a handle, under the slider.
function showStrip(strip, { frames, falloff = 0, handles }, keys, ends) {
  const state = JSON.stringify([frames, falloff, keys, handles.length > 0]), percent = (k) => 100 * (clamp(k, ...ends) - ends[0]) / (ends[1] - ends[0] || 1);
  if (strip.dataset.state === state) return;
  strip.dataset.state = state;
  const make = (kind, from, to) => {
    const mark = makeElement("i", { className: kind });
    Object.assign(mark.style, { left: `${percent(from)}%`, width: to === undefined ? "" : `${percent(to) - percent(from)}%` });
    return mark;
  };
  const range = frames ?? ends;
  strip.replaceChildren(...(handles.length ? [make("fade", range[0] - falloff, range[1] + falloff), make("full", ...range)] : []), ...keys.map((k) => make("key", k)));
}
