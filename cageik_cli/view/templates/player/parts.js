// The parts of a model, of which each can be shown or hidden.

// The number of the part of each vertex that is drawn.
function listOwners(clip) {
  const owners = new Uint32Array(clip.vertexCount);
  let start = 0;
  clip.parts.forEach(({ vertices }, part) => {
    owners.fill(part, start, start + vertices);
    start += vertices;
  });
  return Uint32Array.from({ length: clip.arrays.lack.length / 3 }, (_, vertex) => owners[clip.fileVertex(vertex)]);
}

// Those of faces of 3 corners, or of edges of 2, whose part is shown: that of the first corner.
function selectParts(clip, corners, size, isShown) {
  const owners = listOwners(clip);
  return corners.filter((_, k) => isShown[owners[corners[k - k % size]]]);
}

/** @param {Stage} stage */
function makeParts(stage) {
  const details = stage.find("parts"), { clip } = stage, { parts } = clip;
  if (!parts.length) return;
  const boxes = [...details.querySelectorAll("input")];
  boxes.forEach((box, k) => {
    box.nextElementSibling.style.background = PALETTE[k % PALETTE.length];
    on(box, "change", () => show());
  });
  const show = (value) => {
    if (value !== undefined) for (const box of boxes) box.checked = value;
    const isShown = boxes.map((box) => box.checked);
    stage.selectShown = (corners, size) => selectParts(clip, corners, size, isShown);
    const count = isShown.filter(Boolean).length;
    details.querySelector("summary").textContent = count < parts.length ? `Parts: ${count} of ${parts.length} shown` : "Parts";
    const faces = stage.selectShown(clip.arrays.faces, 3);
    stage.renderer.sendIndices("faces", faces);
    stage.skin.shown = faces;
    stage.sendEdges();
    stage.request(true);
  };
  on(stage.find("all-parts"), "click", () => show(true));
  on(stage.find("no-parts"), "click", () => show(false));
}
