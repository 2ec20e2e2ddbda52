// What is not saved: the page is not left without a question, and the browser keeps it until it is. Without an output,
// edits go to new files beside what is viewed.
const KEPT = "cageik ", MAX_KEPT = 8, MAX_KEPT_LETTERS = 2e6, KEEP_MILLISECONDS = 800, DATE_LETTERS = 24;
const PART_WORDS = { handles: "the handles", cageEdits: "the cage edits", cage: "the cage" };
const SAVE_WORDS = { handles: "Save handles", cageEdits: "Save cage edits" };

// A name with the next number: walker-3.h5 after walker-2.h5.
const nextName = (name) => name.replace(/(\d*)(\.\w+)$/, (_, number, suffix) => number ? Number(number) + 1 + suffix : `-2${suffix}`);

// What the browser keeps of pages, by the digest of their files: a date, and then the text. The oldest goes first.
class KeptWork {
  constructor(key) {
    this.name = KEPT + key;
    // A browser may forbid it.
    try { this.store = window.localStorage; } catch { this.store = null; }
  }

  read() { return this.store?.getItem(this.name) ?? ""; }

  get date() { return new Date(this.read().slice(0, DATE_LETTERS)); }

  get text() { return this.read().slice(DATE_LETTERS); }

  drop() { this.store?.removeItem(this.name); }

  // Keeps a text, and returns whether there was room for it.
  write(text) {
    const { store, name } = this;
    if (!store || text.length > MAX_KEPT_LETTERS) { this.drop(); return false; }
    const others = Object.keys(store).filter((one) => one.startsWith(KEPT) && one !== name).sort((a, b) => store[a].slice(0, DATE_LETTERS) < store[b].slice(0, DATE_LETTERS) ? 1 : -1);
    while (others.length >= MAX_KEPT) store.removeItem(others.pop());
    for (;;) {
      try { store.setItem(name, new Date().toISOString() + text); return true; } catch {
        if (!others.length) { this.drop(); return false; }
        store.removeItem(others.pop());
      }
    }
  }
}

// Knows which parts of the work are saved as files, and which are in what was written.
class Keeper {
  constructor(stage, session, work) {
    const parts = work.parts();
    Object.assign(this, { stage, session, work, saved: parts, applied: {}, kept: new KeptWork(session.key), timer: 0, isOurs: false });
  }

  read() { return this.work.parts(); }

  // The names of the parts that are in no file of their own, or in nothing that was written.
  list(isWritten) {
    const parts = this.read();
    return Object.keys(parts).filter((name) => parts[name] && parts[name] !== this.saved[name] && !(isWritten && parts[name] === this.applied[name]));
  }

  // Parts, as they were when they were sent, are in files of their own.
  takeSaved(parts) {
    Object.assign(this.saved, parts);
    this.keep();
  }

  // Parts are in what was written; says which of them have no file of their own.
  takeApplied(parts) {
    const { keepsHandles, keepsCageEdits } = this.session;
    this.applied = parts;
    if (keepsHandles) this.saved.handles = parts.handles;
    if (keepsCageEdits) this.saved.cageEdits = parts.cageEdits;
    this.keep();
    const left = this.list(false);
    return left.length ? `; not saved: ${left.map((name) => PART_WORDS[name]).join(" and ")}, for which there ${left.length > 1 ? "are" : "is"} ${left.map((name) => SAVE_WORDS[name]).join(" and ")}` : "";
  }

  // Keeps in the browser what is in no file of its own.
  keep() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (this.list(false).length) {
      this.isOurs = true;
      this.isLost = !this.kept.write(JSON.stringify(this.read()));
    } else if (this.isOurs) this.kept.drop();
  }

  // Keeps soon: not at each step of a drag.
  keepSoon() { this.timer ||= setTimeout(() => this.keep(), KEEP_MILLISECONDS); }
}

// The work of the page that plays and poses.
const workOnEdits = ({ editor, clip }) => ({
  parts: () => ({ handles: editor.actingFile ? JSON.stringify(editor.actingFile) : "", cageEdits: editor.actingCageFile ? JSON.stringify(editor.actingCageFile) : "" }),
  open({ handles, cageEdits }) {
    const before = editor.snapshot();
    editor.open(handles ? readFile(handles, clip) : { handles: [] }, cageEdits ? readCageEdits(cageEdits, clip) : { edits: [] });
    editor.remember(before);
    return handles ? "pose" : "cage";
  },
  send(name) {
    const { handles, cageEdits } = this.parts();
    return post("save", `{"handles":${handles || null},"cageEdits":${cageEdits || null},"rigidity":${editor.rounds},"name":${JSON.stringify(name)}}`);
  },
});

extensions.push((stage) => {
  const session = JSON.parse(document.getElementById("player-session").textContent), find = (name) => stage.find(`keep-${name}`);
  const work = stage.work ??= workOnEdits(stage), keeper = stage.keeper = new Keeper(stage, session, work), { kept } = keeper, group = stage.section.querySelector("[data-keep]");
  const name = find("name"), tell = (text) => { find("said").textContent = text; };
  find("as").hidden = !session.save;
  name.value = session.save ?? "";
  on(find("save"), "click", async () => {
    const parts = work.parts();
    try {
      const said = await followJob(await work.send(name.value.trim()), tell);
      name.value = nextName(name.value);
      if ("cage" in parts) keeper.takeSaved(parts);
      tell(said + keeper.takeApplied(parts));
    } catch (error) { tell(error.message); }
  });
  for (const [button, part] of [["[data-save]", "handles"], ["[data-cage-save]", "cageEdits"]]) {
    const found = stage.section.querySelector(button);
    if (found) on(found, "click", () => keeper.takeSaved({ [part]: work.parts()[part] }));
  }
  on(window, "beforeunload", (event) => { if (keeper.list(true).length) event.preventDefault(); });
  on(document, "visibilitychange", () => { if (document.hidden) keeper.keep(); });
  on(window, "pagehide", () => keeper.keep());
  const dialog = find("ask"), offered = kept.text;
  on(dialog, "close", () => {
    if (dialog.returnValue === "drop") kept.drop();
    if (dialog.returnValue !== "open") return;
    try {
      const mode = work.open(JSON.parse(offered));
      if (mode) stage.modes.choose(mode);
    } catch (error) { tell(`what was kept cannot be opened: ${error.message}`); }
    stage.request(true);
  });
  if (offered && offered !== JSON.stringify(work.parts())) {
    find("question").textContent = `Work on ${session.beside} of ${kept.date.toLocaleString()} was not saved. This browser has kept it.`;
    dialog.showModal();
  }
  let wasLost = false;
  stage.listeners.push(() => {
    keeper.keepSoon();
    group.hidden = !["pose", "cage", "rest"].includes(stage.modes.active.name);
    if (keeper.isLost && !wasLost) tell("this browser has no room to keep what is not saved; save it");
    wasLost = keeper.isLost;
  });
});
