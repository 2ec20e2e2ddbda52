// What the panels of editing modes share: their inputs by name, what these do and show, and what can be undone.
function refuse(where, what) { throw new Error(`${where}: ${what}`); }

const isIndex = (k, count) => Number.isInteger(k) && k >= 0 && k < count;

const isPoint = (value) => Array.isArray(value) && value.length === 3 && value.every((x) => typeof x === "number" && abs(x) <= 1e50);

// Refuses what is no number of a thing, of which there are so many.
function checkNumber(k, count, where, thing, owner) {
  if (!isIndex(k, count)) refuse(where, `there is no ${thing} ${k}; the ${owner} has ${count}, numbered from 0 to ${count - 1}`);
}

// Cage vertices of a list such as "3, 8-12", of so many.
function parseVertices(text, count) {
  return text.split(/[,;\s]+/).filter(Boolean).flatMap((word) => {
    const [, from, to = from] = word.match(/^(\d+)(?:-(\d+))?$/) ?? [];
    if (!(to - from >= 0)) refuse("Cage vertices", `${word} is no number or range; expected such as 3, 8-12`);
    for (const vertex of [from, to]) checkNumber(Number(vertex), count, "Cage vertices", "cage vertex", "cage");
    return listOf(to - from + 1, (k) => Number(from) + k);
  });
}

// The list of cage vertices: of a run, its ends.
function writeVertices(vertices) {
  const all = new Set(vertices), isInner = (k) => all.has(k - 1) && all.has(k + 1);
  return [...all].sort((a, b) => a - b).map((k) => isInner(k) ? "" : k).join(", ").replace(/,\s(,\s)+/g, "-");
}

// A number in a sentence.
const ROUND = (x) => Number(x.toPrecision(6));

// Refuses a name that is none, or that one of `others` has.
function checkName(name, others, where) {
  if (typeof name !== "string" || !name || others.some((one) => one.name === name)) refuse(where, "expected a name of its own");
}

// A first name such as "edit 3" that none of a list has.
function findName(kind, list) {
  let number = list.length + 1;
  while (list.some(({ name }) => name === `${kind} ${number}`)) number++;
  return `${kind} ${number}`;
}

// States that can be gone back to: `snapshot` returns the present one, and `restore` takes one.
class Past {
  constructor() { Object.assign(this, { past: [], future: [], complaint: "" }); }

  // Takes a state for one that can be gone back to.
  remember(before) {
    this.past.push(before);
    this.future = [];
  }

  travel(from, to) {
    if (!from.length) return;
    to.push(this.snapshot());
    this.restore(from.pop());
  }

  undo() { this.travel(this.past, this.future); }

  redo() { this.travel(this.future, this.past); }
}

// A panel whose inputs are marked by `data-`, a prefix and their names. What an action refuses is a complaint of the editor.
class Panel {
  /** @param {Stage} stage @param {string} mode @param {string} prefix @param {any} editor */
  constructor(stage, mode, prefix, editor) { Object.assign(this, { stage, prefix, editor, element: stage.find(`panel="${mode}"`) }); }

  /** @returns {any} */
  find(name) { return this.element.querySelector(`[data-${this.prefix}${name}]`); }

  act(action, where = "") {
    this.editor.complaint = "";
    try { action(); } catch (error) { this.editor.complaint = where + error.message; }
    this.stage.request(true);
  }

  // Buttons act on clicks, inputs on changes.
  listen(name, action) {
    const input = this.find(name);
    on(input, input.type === "button" ? "click" : "change", () => this.act(() => action(input)));
  }

  // As `listen`, and what the action does can be undone.
  edit(name, action) { this.listen(name, (input) => this.editor.change(() => action(input))); }

  numberOf(name) {
    const input = this.find(name), value = input.valueAsNumber;
    if (!Number.isFinite(value)) refuse(input.labels[0].textContent, "expected a number");
    return value;
  }

  // The name of a thing, which no other of a list has.
  editName(list, thing) {
    this.listen("name", ({ value, labels }) => {
      const name = value.trim();
      checkName(name, list().filter((one) => one !== thing()), labels[0].textContent);
      this.editor.change(() => { thing().name = name; });
    });
  }

  // In which frames something holds, and over how many it fades in and out.
  editSpan(thing) {
    const names = ["first", "last", "fade"], { clip } = this.stage;
    for (const name of names) this.edit(name, () => {
      const [first, last, fade] = names.map((one) => this.numberOf(one)), from = clip.frameOf(first);
      Object.assign(thing(), { frames: [from, max(from, clip.frameOf(last))].map((frame) => clip.numberOf(frame)), falloff: max(0, round(fade)) });
    });
  }

  // Three inputs, of one coordinate each.
  listenToPoint(name, action) {
    [..."xyz"].forEach((axis, k) => this.listen(name + axis, () => action(k, this.numberOf(name + axis))));
  }

  // Saves a file of JSON, and loads one.
  exchange(fileName, write, read) {
    this.listen("save", () => {
      const text = encodeURIComponent(writeFile(write()));
      makeElement("a", { href: `data:application/json,${text}`, download: fileName }).click();
    });
    on(this.find("load"), "change", async ({ target }) => {
      const [file] = target.files, text = await file.text();
      this.act(() => read(text), `${file.name}: `);
      target.value = "";
    });
  }

  // Shows a value, unless somebody is typing one.
  put(name, value) {
    const input = this.find(name);
    if (input !== document.activeElement || this.editor.isDragging) input.value = value;
  }

  say(name, text) { if (this.find(name).textContent !== text) this.find(name).textContent = text; }

  // Shows what of three numbers fits into narrow fields; they keep all digits.
  putPoint(name, point) { point.forEach((x, k) => this.put(name + "xyz"[k], Number(x.toPrecision(5)))); }

  // Shows the place in a list of things with these names.
  putChoice(name, names, chosen) {
    const list = this.find(name), state = JSON.stringify(names);
    if (list.dataset.state !== state) list.replaceChildren(...names.map((one, k) => new Option(one, k)));
    list.dataset.state = state;
    list.value = chosen;
  }

  // Shows what of buttons is possible, by name.
  enable(possible) { for (const name in possible) this.find(name).disabled = !possible[name]; }

  // Shows an edit, in which frames it holds, and the keys of a track of it; marks them in the bar of time, if it acts.
  showEdit(kind, edit, track, { isMarked, beyond = "" }) {
    const { stage: { clip, timeline, number }, editor } = this, keys = track?.frames, { frames: range = clip.ends, falloff = 0 } = edit ?? {};
    ["first", "last", "fade"].forEach((name, k) => this.put(name, [...range, falloff][k]));
    timeline.mark(kind, isMarked ? { range, falloff, keys } : {});
    this.say("keys", keys ? `keys at ${keys.join(", ")}` : "the same in all frames");
    this.enable({ unkey: keys?.includes(number), apply: editor.hasEdits });
    this.say("said", editor.complaint || editor.message || beyond);
    this.say("command", makeCommand(editor));
  }
}
