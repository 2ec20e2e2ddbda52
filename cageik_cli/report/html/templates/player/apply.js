// Sends handles to `cageik view` (workflows/view/requests.py), and follows the edit until its end.
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
    if (last !== job) throw new Error("another page has applied its handles since");
    if (state === "failed") throw new Error(error);
    if (state === "done") return [`wrote ${written.join(", ")}`, ...rows.filter(([label]) => label === "note").map(([, text]) => text)].join("; ");
    tell(total ? `${stage}: ${done} of ${total} frames` : `${stage || "waiting"} …`);
    await new Promise((go) => setTimeout(go, STATUS_MILLISECONDS));
  }
}
