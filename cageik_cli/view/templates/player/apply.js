// What only the page of `cageik view` does: it begins with an edit that is given, sends an edit to
// the program (view/session.py), and follows it until its end.
const STATUS_MILLISECONDS = 250;

async function ask(url, options) {
  const answer = await fetch(url, options), value = await answer.json();
  if (!answer.ok) throw Object.assign(new Error(value.error), { status: answer.status });
  return value;
}

// Sends a text of JSON.
const post = (url, body) => ask(url, { method: "POST", headers: { "Content-Type": "application/json" }, body });

// Applies an edit, { handles, cageEdits }, by some rounds, as `followJob`.
async function applyEdit(url, sent, rounds, tell) {
  return followJob(await post(`${url}?rigidity=${rounds}`, JSON.stringify(sent)), tell);
}

// Waits for the end of a job; `tell` gets a line of progress, and the last line is returned.
async function followJob({ job }, tell) {
  for (;;) {
    const { job: last, state, stage, done, total, rows, written, error } = await ask("status");
    if (last !== job) throw new Error("another edit has run since; look at its output, and apply again if it is not yours");
    if (state === "failed") throw new Error(error);
    if (state === "done") return [`wrote ${written.join(", ")}`, ...rows.filter(([label]) => label === "note").map(([, text]) => text)].join("; ");
    tell(total ? `${stage}: ${done} of ${total} frames` : `${stage || "waiting"} …`);
    await new Promise((go) => setTimeout(go, STATUS_MILLISECONDS));
  }
}

extensions.push((stage) => {
  const { clip, editor } = stage, { applyUrl } = clip;
  if (!editor) return;
  for (const button of stage.section.querySelectorAll("[data-apply], [data-cage-apply]")) {
    button.hidden = !applyUrl;
    on(button, "click", async () => {
      const tell = (text) => { editor.complaint = text; stage.request(); };
      const sent = { handles: editor.actingFile, cageEdits: editor.actingCageFile };
      const parts = stage.keeper?.read();
      await applyEdit(applyUrl, sent, editor.rounds, tell).then((text) => tell(text + (stage.keeper?.takeApplied(parts) ?? "")), (error) => tell(error.message));
    });
  }
  const begin = (name, mode, open) => {
    const given = document.getElementById(`player-${name}`);
    if (!given) return;
    stage.section.dataset.mode = mode;
    try { open(given.textContent); } catch (error) { editor.complaint = `${name}: ${error.message}`; }
  };
  begin("cage-edits", "cage", (text) => editor.open(editor.file, readCageEdits(text, clip)));
  begin("handles", "pose", (text) => editor.open(readFile(text, clip)));
});
