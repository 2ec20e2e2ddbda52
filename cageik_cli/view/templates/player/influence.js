// What cage vertices move of the mesh: the weights of one of them as colours, or of a surface point the
// cage vertices that move it, in a list and as marks in proportion.
const LISTED_WEIGHTS = 12, SMALL_WEIGHT = 0.01, NEGATIVE_SHARE = 0.02;

// The numbers of weights that are not small, the largest first, with their signs.
function rankWeights(row) {
  const kept = [...row.keys()].filter((k) => abs(row[k]) >= SMALL_WEIGHT);
  return kept.sort((a, b) => abs(row[b]) - abs(row[a])).map((vertex) => ({ vertex, weight: row[vertex] }));
}

const writeWeight = (weight) => weight.toFixed(3).replace("-", "\u2212");

class Influence {
  /** @param {Stage} stage */
  constructor(stage) {
    Object.assign(this, { stage, skin: stage.skin });
    this.clear();
  }

  // Chooses a cage vertex: its weights in all vertices of the mesh.
  showVertex(vertex) {
    const { weights, count, cageCount } = this.skin;
    this.clear();
    this.vertex = vertex;
    this.column = Float32Array.from({ length: count }, (_, j) => weights[j * cageCount + vertex]);
    const low = this.column.reduce((a, b) => min(a, b), 0), high = this.column.reduce((a, b) => max(a, b), 0);
    this.range = [low, high];
    // Negative weights have colours of their own, unless they are too small to be seen.
    this.top = max(high, -low) || 1;
    this.isSigned = -low > NEGATIVE_SHARE * this.top;
  }

  // Chooses a point of the surface: the weights of all cage vertices there.
  showPlace(place) {
    this.clear();
    this.place = place;
    this.row = this.skin.anchor(place.corners, place.shares).row;
  }

  clear() { Object.assign(this, { vertex: -1, place: null, row: null }); }

  get position() {
    return placeOn(this.stage.positions, this.place);
  }

  // Fills the places of the vertices on a ramp; returns it, and what its scale says.
  paint(values) {
    if (this.vertex < 0) return null;
    const { colours, signedColours } = this.stage.clip, { top, isSigned } = this;
    for (let j = 0; j < values.length; j++) values[j] = clamp(isSigned ? (this.column[j] / top + 1) / 2 : this.column[j] / top, 0, 1);
    const shown = isSigned ? signedColours : colours;
    return { ramp: makeRamp(shown), shown, low: isSigned ? -top : 0, end: top, unit: `weight of cage vertex ${this.vertex}` };
  }

  // What the chosen vertex moves of the mesh, or what of the cage moves the chosen point.
  get ranked() { return rankWeights(this.row ?? this.column); }

  // The first of the cage vertices that move the chosen point.
  get listed() { return this.row ? this.ranked.slice(0, LISTED_WEIGHTS) : []; }
}

/** @param {Stage} stage */
function makeInfluence(stage) {
  const influence = new Influence(stage), { clip } = stage, told = { complaint: "" };
  const panel = new Panel(stage, "influence", "", told), list = panel.find("weights");
  const refresh = () => {
    const { vertex, place } = influence;
    panel.find("cage-vertex").value = vertex < 0 ? "" : vertex;
    panel.find("mesh-vertex").value = place ? clip.fileVertex(place.near) : "";
    panel.say("told", place ? describePlace() : vertex < 0 ? "Click a cage vertex or the surface." : describeVertex());
    const { listed } = influence;
    list.replaceChildren(...listed.map(({ vertex: one, weight }) => {
      const item = makeElement("li"), bar = makeElement("i", { className: weight < 0 ? "less" : "" });
      bar.style.width = `${100 * abs(weight / listed[0].weight)}%`;
      item.append(makeButton(`cage vertex ${one}: ${writeWeight(weight)}`, () => choose(one), "Show what this cage vertex moves."), bar);
      return item;
    }));
    stage.request(true);
  };
  const describeVertex = () => {
    const { vertex, ranked, column, range: [low, high] } = influence, most = ranked[0] ? `, the largest at vertex ${clip.fileVertex(ranked[0].vertex)}` : "";
    return `Cage vertex ${vertex}: weights ${writeWeight(low)} to ${writeWeight(high)}${most}; ${SMALL_WEIGHT} or more in ${ranked.length} of ${column.length} vertices.`;
  };
  const describePlace = () => {
    const { row, place: { near, shares }, listed } = influence, rest = sumOf(row) - sumOf(listed.map(({ weight }) => weight));
    return `${max(...shares) > 0.999 ? "Vertex" : "A point near vertex"} ${clip.fileVertex(near)} is moved most by these; all others together have ${writeWeight(rest)}.`;
  };
  const choose = (vertex) => { influence.showVertex(vertex); refresh(); };
  const choosePlace = (place) => { influence.showPlace(place); refresh(); };
  const clear = () => { influence.clear(); refresh(); };
  const listenToNumber = (name, action) => panel.listen(name, () => action(panel.numberOf(name)));
  listenToNumber("cage-vertex", (vertex) => { checkCageVertex(vertex, clip, "Cage vertex"); choose(vertex); });
  listenToNumber("mesh-vertex", (vertex) => choosePlace({ near: clip.drawnVertex(vertex), ...resolvePlace({ vertex }, clip, "Model") }));
  panel.listen("clear", clear);
  refresh();
  stage.listeners.push(() => { if (told.complaint) stage.modes.say(told.complaint); });
  stage.modes.add({
    name: "influence",
    hover(x, y, event) {
      const vertex = nearestSeen(stage, listPoints(stage.cage), x, y, event);
      return vertex < 0 ? { cursor: "crosshair" } : { cursor: "pointer", kind: "ring", points: [pointOf(stage.cage, vertex)] };
    },
    click(x, y, event) {
      const vertex = nearestSeen(stage, listPoints(stage.cage), x, y, event), place = vertex < 0 ? pickSurface(stage, x, y) : null;
      told.complaint = "";
      stage.modes.say("");
      if (vertex >= 0) choose(vertex);
      else if (place) choosePlace({ ...place, shares: place.barycentric });
      else clear();
    },
    press(event) {
      const step = { "[": -1, "]": 1 }[event.key], count = stage.skin.cageCount;
      if (step) choose((max(influence.vertex, step < 0 ? 0 : -1) + step + count) % count);
      else if (event.key === "Escape" && (influence.row || influence.vertex >= 0)) clear();
      else return false;
      return true;
    },
    paint: (values) => influence.paint(values),
    draw(renderer) {
      if (influence.vertex >= 0) renderer.drawDots(pointOf(stage.cage, influence.vertex), RED, 13);
      if (!influence.row) return;
      const { listed, position } = influence;
      renderer.drawLines(listed.flatMap(({ vertex }) => [...position, ...pointOf(stage.cage, vertex)]), [0.5, 0.5, 0.5, 0.6]);
      for (const { vertex, weight } of listed) renderer.drawDots(pointOf(stage.cage, vertex), weight < 0 ? [0.12, 0.35, 0.75, 1] : [0.85, 0.4, 0.1, 1], 5 + 17 * abs(weight / listed[0].weight));
      renderer.drawSquares(position, [0.1, 0.12, 0.15, 1], 9);
    },
    chosen: () => influence.vertex >= 0 ? [pointOf(stage.cage, influence.vertex)] : influence.row ? [influence.position] : [],
    show: () => stage.request(true),
    hide: () => stage.request(true),
  });
}
