// The parts of a model: a list with their errors, in which each can be shown or hidden.

// The number of the part of each vertex.
function listOwners(clip) {
  const stops = [];
  for (const { vertices } of clip.header.parts) stops.push((stops.at(-1) ?? 0) + vertices);
  return Uint32Array.from({ length: clip.arrays.lack.length / 3 }, (_, vertex) => findPart(stops, clip.fileVertex(vertex)));
}

// Those of faces of 3 corners, or of edges of 2, whose part is shown: that of the first corner.
function selectParts(clip, corners, size, isShown) {
  const owners = listOwners(clip);
  return corners.filter((_, k) => isShown[owners[corners[k - k % size]]]);
}

// The first place whose stop is beyond a vertex.
function findPart(stops, vertex) {
  let low = 0, high = stops.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (stops[middle] > vertex) high = middle; else low = middle + 1;
  }
  return low;
}

function makeParts(section, stage) {
  const details = section.querySelector("[data-parts]"), { clip } = stage, { parts } = clip.header;
  details.hidden = !parts.length;
  if (!parts.length) return;
  const boxes = parts.map(({ name, rms }, k) => {
    const box = makeElement("input", { type: "checkbox", checked: true, id: `player-part-${k}` });
    const label = makeElement("label", { htmlFor: box.id, textContent: name });
    const error = makeElement("span", { className: "soft number", textContent: rms === null ? "" : `${rms.toFixed(4)} %` });
    const item = makeElement("li", {}), swatch = makeElement("span", { className: "swatch" });
    swatch.style.background = PALETTE[k % PALETTE.length];
    item.append(box, swatch, label, error);
    details.querySelector("ul").append(item);
    listenTo(box, "change", () => show());
    return box;
  });
  const show = (value) => {
    if (value !== undefined) for (const box of boxes) box.checked = value;
    const isShown = boxes.map((box) => box.checked);
    stage.selectShown = (corners, size) => selectParts(clip, corners, size, isShown);
    const faces = stage.selectShown(clip.arrays.faces, 3);
    stage.renderer.setFaces(faces);
    stage.skin.shown = faces;
    stage.sendEdges();
    stage.request(true);
  };
  listenTo(details.querySelector("[data-all-parts]"), "click", () => show(true));
  listenTo(details.querySelector("[data-no-parts]"), "click", () => show(false));
}
