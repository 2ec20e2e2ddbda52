// Cage edits (editing/cage_edits.py): offsets of cage vertices, in a file of their own, and which vertices are chosen.
function readCageEdits(text, clip) {
  const file = parseFile(text, "cage edits");
  if (!Array.isArray(file?.edits) || !file.edits.length) refuse("file", "is not a cage edits file; expected an object with edits");
  file.edits.forEach((edit, k) => {
    const at = `edit ${JSON.stringify(edit?.name)}`, vertices = new Set();
    checkName(edit?.name, file.edits.slice(0, k), at);
    checkSpan(edit, clip, `${at}: `);
    if (!(edit.axes === undefined || ["world", "surface"].includes(edit.axes))) refuse(`${at}: axes`, 'expected "world" or "surface"');
    if (!Array.isArray(edit.moves) || !edit.moves.length) refuse(`${at}: moves`, "expected a list of moves");
    for (const move of edit.moves) {
      checkCageVertex(move?.vertex, clip, at);
      if (vertices.has(move.vertex)) refuse(`${at}: vertex ${move.vertex}`, "is moved twice");
      vertices.add(move.vertex);
      checkTrack(move.offset, clip, `${at}: vertex ${move.vertex}: offset`);
    }
  });
  return file;
}

function checkCageVertex(vertex, clip, where) { checkNumber(vertex, clip.arrays.cage.length / 3, where, "cage vertex", "cage"); }

// The cage of a frame after all edits; the clip's own if none moves it.
function moveCage({ edits }, clip, frame) {
  const number = clip.numberOf(frame), own = clip.cage(frame);
  let cage = own;
  for (const edit of edits) {
    const strength = blendSet(edit, number) / clip.diagonal;
    const before = edit.axes === "surface" ? Float64Array.from(cage) : cage;
    if (strength) for (const { vertex, offset } of edit.moves) {
      let move = evaluateTrack(offset, number);
      if (!move.some(Boolean)) continue;
      if (edit.axes === "surface") move = turnWithCage(move, vertex, clip, before);
      if (cage === own) cage = Float64Array.from(own);
      for (let a = 0; a < 3; a++) cage[3 * vertex + a] += strength * move[a];
    }
  }
  return cage;
}

// An offset at rest, turned with the cage around a vertex (method/pose/rigidity.py), or turned back.
function turnWithCage(move, vertex, clip, cage, isBack = false) {
  const { cage: rest, cageFaces } = clip.arrays, sum = zeros(9);
  clip.rings ??= listNeighbours(listEdges(cageFaces), rest.length / 3);
  for (const near of clip.rings[vertex]) for (let r = 0; r < 3; r++) for (let c = 0; c < 3; c++) {
    sum[3 * r + c] += (cage[3 * vertex + r] - cage[3 * near + r]) * (rest[3 * vertex + c] - rest[3 * near + c]);
  }
  nearestRotation(sum, sum);
  return isBack ? turn(move, sum) : [0, 3, 6].map((r) => dot(sum.subarray(r, r + 3), move));
}

// What a file holds: edits that move something.
function listActing({ edits }) {
  const isStill = (offset) => Array.isArray(offset) && !offset.some(Boolean);
  return edits.map((edit) => ({ ...edit, moves: edit.moves.filter(({ offset }) => !isStill(offset)) })).filter(({ moves }) => moves.length);
}

// The cage vertices that are chosen, and those around them that move along by a share: with a falloff over "edges" or in
// "space", those within a radius, in diagonals.
class CageSelection {
  // `findCage` returns the cage in which the radius is measured.
  constructor(clip, findCage) {
    const { cage, cageFaces, joinedCageFaces } = clip.arrays;
    this.near = listNeighbours(listEdges(cageFaces, joinedCageFaces), cage.length / 3);
    Object.assign(this, { findCage, falloff: "", radius: 0.15 });
    this.choose([]);
  }

  choose(vertices) {
    this.chosen = new Set(vertices);
    this.spread();
  }

  toggle(vertex) {
    if (!this.chosen.delete(vertex)) this.chosen.add(vertex);
    this.spread();
  }

  // The one that is chosen last: panels show its offset.
  get last() { return [...this.chosen].at(-1); }

  grow() { this.choose([...this.chosen, ...[...this.chosen].flatMap((vertex) => this.near[vertex])]); }

  // Leaves out what is beside a vertex that is not chosen, unless nothing were left.
  shrink() {
    const inner = [...this.chosen].filter((vertex) => this.near[vertex].every((one) => this.chosen.has(one)));
    if (inner.length) this.choose(inner);
  }

  // Shares by the distance from the chosen ones: 1 there, and 0 at the radius.
  spread(cage = this.falloff ? this.findCage() : null) {
    const { chosen, radius } = this, shares = this.shares = new Map([...chosen].map((vertex) => [vertex, 1]));
    if (!this.falloff || !chosen.size) return;
    const points = listPoints(cage);
    (this.falloff === "edges" ? this.walk(points) : this.reach(points)).forEach((away, vertex) => {
      const x = 1 - away / radius;
      if (x > 0 && !chosen.has(vertex)) shares.set(vertex, x * x * (3 - 2 * x));
    });
  }

  // How far vertices are from those that are chosen: in a straight line, and over edges, as far as the radius.
  reach(points) {
    const from = [...this.chosen].map((vertex) => points[vertex]);
    return points.map((point) => min(...from.map((one) => norm(minus(point, one)))));
  }

  walk(points) {
    const away = points.map((_, vertex) => this.chosen.has(vertex) ? 0 : Infinity), queue = [...this.chosen];
    while (queue.length) {
      const vertex = queue.shift();
      for (const next of this.near[vertex]) {
        const distance = away[vertex] + norm(minus(points[next], points[vertex]));
        if (distance < min(away[next], this.radius)) { away[next] = distance; queue.push(next); }
      }
    }
    return away;
  }
}
