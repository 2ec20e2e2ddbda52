// Frames of what was before, from the program (view/before.py): the positions of the vertices that are drawn, frame by frame.
async function fetchFrames(kind, first, count) {
  const answer = await fetch("before", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ kind, first, count }) });
  if (!answer.ok) throw Object.assign(new Error((await answer.json()).error), { status: answer.status });
  return new Float32Array(await answer.arrayBuffer());
}
