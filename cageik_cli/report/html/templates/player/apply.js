// What only the page of `cageik view` does: it begins with handles that are given, sends handles to
// the program (workflows/view/requests.py), and follows the edit until its end.
const STATUS_MILLISECONDS = 250;

async function ask(url, options) {
  const answer = await fetch(url, options), value = await answer.json();
  if (!answer.ok) throw new Error(value.error);
  return value;
}

// Applies a handles file by some rounds; `tell` gets a line of progress, and the last line is returned.
async function applyHandles(url, file, rounds, tell) {
  const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(file, null, 2) };
  const { job } = await ask(`${url}?rigidity=${rounds}`, options);
  for (;;) {
    const { job: last, state, stage, done, total, rows, written, error } = await ask("status");
    if (last !== job) throw new Error("another edit has run since; look at its output, and apply again if it is not yours");
    if (state === "failed") throw new Error(error);
    if (state === "done") return [`wrote ${written.join(", ")}`, ...rows.filter(([label]) => label === "note").map(([, text]) => text)].join("; ");
    tell(total ? `${stage}: ${done} of ${total} frames` : `${stage || "waiting"} …`);
    await new Promise((go) => setTimeout(go, STATUS_MILLISECONDS));
  }
}

extensions.push((section, stage) => {
  const { clip, editor } = stage, { applyUrl } = clip.header, button = section.querySelector("[data-apply]");
  const given = document.getElementById("player-handles");
  button.hidden = !applyUrl;
  listenTo(button, "click", async () => {
    const tell = (text) => { editor.complaint = text; stage.request(); };
    await applyHandles(applyUrl, editor.file, editor.rounds, tell).then(tell, (error) => tell(error.message));
  });
  if (given) {
    try { editor.open(readFile(given.textContent, clip)); } catch (error) { editor.complaint = `handles: ${error.message}`; }
  }
});
