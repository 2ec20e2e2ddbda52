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

  const anchorPlaces = () => editor.layers[editor.active].anchors.map((one) => stage.skin.place(one, stage.cage, clip.rotation(transport.frame)));
  const hit = (x, y, reach) => {
    let best = reach, found = -1;
    anchorPlaces().forEach((place, k) => {
      const [u, v] = camera.project(place), away = Math.hypot(u - x, v - y);
      if (away < best) { best = away; found = k; }
    });
    return found;
  };
  // The surface point under a pixel: a vertex if one is near.
  const pick = (x, y) => {
    const found = stage.skin.pick(stage.positions, camera.ray(x, y));
    if (!found) return null;
    const near = found.corners[found.barycentric.indexOf(Math.max(...found.barycentric))];
    const [u, v] = camera.project([...stage.positions.subarray(3 * near, 3 * near + 3)]);
    const vertex = clip.fileVertex(near), isVertex = clip.arrays.vertices || Math.hypot(u - x, v - y) < SNAP_PIXELS;
    const shares = found.barycentric.map((share) => Number(share.toFixed(6)));
    shares[0] = Number((1 - shares[1] - shares[2]).toFixed(6));
    return { place: isVertex ? { vertex } : { face: found.face, barycentric: shares }, vertex, face: found.face, shares };
  };
  const select = (k) => { editor.selected = k; stage.request(); };

  const actions = {
    grab(x, y, event) {
      const k = transport.isPlaying ? -1 : hit(stage.partOf(x), y, event.pointerType === "touch" ? 2 * GRAB_PIXELS : GRAB_PIXELS);
      if (k < 0) return false;
      select(k);
      if (editor.handle.pin) return false;
      const { target } = editor.places(transport.frame)[k], axis = AXES[find("axis").value];
      grip = { target, axis, from: movePoint(camera, camera.ray(stage.partOf(x), y), target, axis), file: JSON.stringify(editor.file) };
      return true;
    },
    drag(x, y) {
      editor.isDragging = true;
      const to = movePoint(camera, camera.ray(stage.partOf(x), y), grip.target, grip.axis);
      editor.aim(transport.frame, add(grip.target, subtract(to, grip.from)));
    },
    drop() {
      if (editor.isDragging) { editor.past.push(grip.file); editor.future = []; }
      editor.isDragging = false;
      editor.refresh();
    },
    click(x, y) {
      const part = stage.partOf(x), k = hit(part, y, GRAB_PIXELS);
      if (k >= 0) { select(k); return; }
      const found = tool === "look" || transport.isPlaying ? null : pick(part, y);
      if (found) editor.add(found.place, tool); else select(-1);
    },
    hover(x, y) {
      const found = tool === "look" || transport.isPlaying ? null : pick(stage.partOf(x), y);
      find("under").textContent = found ? `vertex ${found.vertex}; face ${found.face}, barycentric ${found.shares.join(", ")}` : "";
    },
  };

  const tools = [...panel.querySelectorAll("[data-tool]")];
  for (const button of tools) button.addEventListener("click", () => {
    tool = button.dataset.tool;
    transport.play(false);
    for (const one of tools) one.setAttribute("aria-pressed", one === button);
  });
  const listen = (name, action, kind = "click") => find(name).addEventListener(kind, (event) => {
    try { action(event.target); editor.complaint = ""; } catch (error) { editor.complaint = error.message; }
    stage.request(true);
  });
  const numberOf = (input) => { if (input.value === "" || !Number.isFinite(input.valueAsNumber)) throw new Error(`${input.labels[0].textContent}: expected a number`); return input.valueAsNumber; };
  listen("undo", () => editor.undo());
  listen("redo", () => editor.redo());
  listen("remove", () => editor.remove());
  listen("add", () => {
    const vertex = numberOf(find("vertex"));
    resolvePlace({ vertex }, clip, "handle");
    editor.add({ vertex }, tool === "pin" ? "pin" : "handle");
  });
  listen("rounds", (input) => { editor.rounds = clamp(Math.round(numberOf(input)), 0, 1000); editor.refresh(); }, "change");
  listen("mirror", (input) => editor.change(() => { if (input.checked) editor.file.mirror = clip.header.mirror; else delete editor.file.mirror; }), "change");
  listen("layer", (list) => { editor.active = Number(list.value); editor.selected = -1; }, "change");
  const setFrames = () => editor.change(() => {
    const [first, last, falloff] = ["first", "last", "falloff"].map((name) => Math.round(numberOf(find(name)))), set = editor.set;
    set.frames = [clamp(first, 0, clip.count - 1), clamp(last, clamp(first, 0, clip.count - 1), clip.count - 1)];
    set.falloff = Math.max(0, falloff);
  });
  for (const name of ["first", "last", "falloff"]) listen(name, setFrames, "change");
  listen("name", (input) => {
    const name = input.value.trim();
    if (!name || editor.set.handles.some((one, k) => one.name === name && k !== editor.selected)) throw new Error("Name: expected a name of its own");
    editor.change(() => { editor.handle.name = name; });
  }, "change");
  listen("hard", (input) => editor.change(() => { if (input.checked) editor.handle.hard = true; else delete editor.handle.hard; }), "change");
  for (const [k, axis] of ["x", "y", "z"].entries()) listen(`move-${axis}`, (input) => {
    const value = numberOf(input), { start, target } = editor.places(transport.frame)[editor.selected];
    target[k] = start[k] + value / clip.header.diagonal * blendSet(editor.set, transport.frame);
    editor.change(() => editor.aim(transport.frame, target));
  }, "change");
  listen("key", () => editor.change(() => {
    const handle = editor.handle, motion = motionOf(handle), now = evaluateTrack(handle[motion], transport.frame);
    if (Array.isArray(handle[motion])) handle[motion] = { frames: [], values: [] };
    setValue(handle[motion], transport.frame, [...now]);
  }));
  listen("unkey", () => editor.change(() => {
    const handle = editor.handle, motion = motionOf(handle), { frames, values } = handle[motion], at = frames.indexOf(transport.frame);
    if (frames.length === 1) handle[motion] = values[0]; else { frames.splice(at, 1); values.splice(at, 1); }
  }));
  listen("save", () => {
    const url = URL.createObjectURL(new Blob([writeFile()], { type: "application/json" }));
    Object.assign(document.createElement("a"), { href: url, download: "handles.json" }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
  });
  const writeFile = () => `${JSON.stringify(editor.file, null, 2)}\n`;
  find("load").addEventListener("change", async ({ target }) => {
    try {
      const file = readFile(await target.files[0].text(), clip);
      editor.complaint = "";
      editor.change(() => { editor.selected = -1; editor.active = 0; editor.file = file; });
    } catch (error) { editor.complaint = `${target.files[0].name}: ${error.message}`; }
    target.value = "";
    stage.request(true);
  });
  find("apply").hidden = !clip.header.applyUrl;
  find("apply").addEventListener("click", async () => {
    const tell = (text) => { editor.complaint = text; stage.request(); };
    await applyHandles(clip.header.applyUrl, editor.file, editor.rounds, tell).then(tell, (error) => tell(error.message));
  });
  const given = document.getElementById("player-handles");
  if (given) {
    try { editor.open(readFile(given.textContent, clip)); } catch (error) { editor.complaint = `handles: ${error.message}`; }
  }
  stage.canvas.addEventListener("keydown", (event) => {
    const isCommand = event.ctrlKey || event.metaKey, key = event.key.toLowerCase();
    if (event.key === "Delete") editor.remove();
    else if (event.key === "Escape") select(-1);
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
  const { set, handle, file } = editor, { frame } = transport, motion = handle && motionOf(handle), isIdle = !editor.isDragging;
  const list = find("handles"), state = JSON.stringify([set.handles.map(({ name, vertex, face }) => [name, vertex, face]), editor.selected]);
  if (list.dataset.state !== state) {
    const focused = list.contains(document.activeElement);
    list.dataset.state = state;
    list.replaceChildren(...set.handles.map((one, k) => {
      const item = document.createElement("li"), button = Object.assign(document.createElement("button"), { type: "button" });
      button.textContent = `${one.name}: ${one.vertex === undefined ? `face ${one.face}, ${one.barycentric.join(", ")}` : `vertex ${one.vertex}`}`;
      button.setAttribute("aria-pressed", k === editor.selected);
      button.addEventListener("click", () => { editor.selected = k; editor.stage.request(); });
      item.append(button);
      return item;
    }));
    if (focused) list.querySelector('[aria-pressed="true"]')?.focus();
  }
  for (const [name, isOff] of [["undo", !editor.past.length], ["redo", !editor.future.length], ["save", !set.handles.length], ["apply", !set.handles.length]]) find(name).disabled = isOff;
  find("mirror").checked = Boolean(file.mirror);
  const sets = listSets(file);
  find("layer").closest("span").hidden = sets.length < 2;
  if (find("layer").length !== sets.length) find("layer").replaceChildren(...sets.map((_, k) => new Option(`${k + 1} of ${sets.length}`, k)));
  find("layer").value = editor.active;
  const [first, last] = set.frames ?? [0, clip.count - 1];
  const put = (name, value) => { const input = find(name); if (input !== document.activeElement || !isIdle) input.value = value; };
  put("first", first); put("last", last); put("falloff", set.falloff ?? 0);
  find("chosen").hidden = !handle;
  if (handle) {
    put("name", handle.name);
    find("hard").checked = Boolean(handle.hard);
    find("moves").hidden = motion === "pin";
    const value = motion === "pin" ? null : evaluateTrack(handle[motion], frame);
    if (value) {
      const place = motion === "offset" ? value : subtract(value, clip.toFile(editor.places(frame)[editor.selected].start));
      ["x", "y", "z"].forEach((axis, k) => put(`move-${axis}`, ROUND(place[k])));
    }
    const keys = handle[motion].frames;
    find("unkey").disabled = !keys?.includes(frame);
    find("keys").textContent = keys ? `keys at ${keys.join(", ")}` : "the same in all frames";
  }
  showStrip(find("strip"), set, handle?.[motion]?.frames ?? [], clip.count - 1);
  const beyond = moved?.count ? `${moved.count} vertices, in orange, move more than the handles do: vertex ${clip.fileVertex(moved.most.vertex)} by ${ROUND(moved.most.distance * clip.header.diagonal)}, the handles by ${ROUND(moved.largest * clip.header.diagonal)} at most. ` : "";
  const said = editor.complaint || editor.message || beyond;
  if (find("said").textContent !== said) find("said").textContent = said;
  const output = clip.header.isClip ? "edited.h5" : "posed.obj";
  const command = set.handles.length ? `cageik pose ${clip.header.target} handles.json --rigidity ${editor.rounds} -o ${output}` : "";
  if (find("command").textContent !== command) find("command").textContent = command;
}

// The frames of the edit and the keys of a handle, under the slider.
function showStrip(strip, { frames, falloff = 0, handles }, keys, last) {
  const state = JSON.stringify([frames, falloff, keys, handles.length > 0]), percent = (k) => 100 * clamp(k, 0, last) / (last || 1);
  if (strip.dataset.state === state) return;
  strip.dataset.state = state;
  const make = (kind, from, to) => {
    const mark = Object.assign(document.createElement("i"), { className: kind });
    Object.assign(mark.style, { left: `${percent(from)}%`, width: to === undefined ? "" : `${percent(to) - percent(from)}%` });
    return mark;
  };
  const range = frames ?? [0, last];
  strip.replaceChildren(...(handles.length ? [make("fade", range[0] - falloff, range[1] + falloff), make("full", ...range)] : []), ...keys.map((k) => make("key", k)));
}
