// A rest cage that is edited: polygons, counter-clockwise seen from outside. An operation returns another mesh and
// leaves this one as it was, so that to undo is to go back. It refuses what would make the cage less of a surface.
const NEW_FAULTS = {
  repeated: "a face would have a vertex twice",
  twins: "two faces would have the same corners",
  crowded: "more than two faces would meet at an edge",
  turned: "neighbours would face opposite ways",
  pinched: "parts of the cage would touch in a point",
  unused: "a vertex would be in no face",
  open: "the cage would be open",
};

const pairKey = (a, b) => min(a, b) * 67108864 + max(a, b);

const turnList = (list, k) => [...list.slice(k), ...list.slice(0, k)];

const meanPoint = (points) => points.reduce((sum, point) => add(sum, point)).map((x) => x / points.length);

// The sides of a polygon, as pairs of vertices.
const sidesOf = (polygon) => polygon.map((a, k) => [a, polygon[(k + 1) % polygon.length]]);

// The triangles that the program computes with, as long as polygons do not fold over.
const fansOf = (polygons) => polygons.flatMap((polygon) => polygon.slice(2).map((c, k) => [polygon[0], polygon[k + 1], c]));

// Two polygons in place of one whose side k got a vertex. A corner is cut off: none is on a line with its neighbours.
function cutSide(polygon, k, middle) {
  const turned = turnList(polygon, k);
  return [[turned.at(-1), turned[0], middle], [middle, ...turned.slice(1)]];
}

class CageMesh {
  constructor(vertices, polygons) { Object.assign(this, { vertices, polygons }); }

  // The polygons at each side, by the pair of its ends.
  get sides() { return this.foundSides ??= collectSides(this.polygons); }

  get edges() { return this.foundEdges ??= [...this.sides.keys()].map((key) => [floor(key / 67108864), key % 67108864]); }

  get faults() { return this.foundFaults ??= countFaults(this); }

  polygonsAt(a, b) { return this.sides.get(pairKey(a, b)) ?? []; }

  // Another mesh, unless it has faults that this one has not.
  change(vertices, polygons, where) {
    const next = new CageMesh(vertices, polygons);
    for (const kind in NEW_FAULTS) if (next.faults[kind] > this.faults[kind]) refuse(where, `${NEW_FAULTS[kind]}; nothing was changed`);
    if (!polygons.length) refuse(where, "no face would be left; nothing was changed");
    return next;
  }

  // Puts vertices elsewhere: pairs of a number and a position.
  place(positions) {
    const { polygons, foundSides, foundEdges, foundFaults } = this, vertices = [...this.vertices];
    for (const [k, position] of positions) vertices[k] = position;
    return Object.assign(new CageMesh(vertices, polygons), { foundSides, foundEdges, foundFaults });
  }

  move(chosen, offset) { return this.place(chosen.map((k) => [k, add(this.vertices[k], offset)])); }

  // Adds a vertex in the middle of an edge: it is the last.
  split(a, b) {
    const where = `edge ${a}-${b}`;
    if (!this.polygonsAt(a, b).length) refuse(where, "is no edge of the cage");
    const middle = this.vertices.length, polygons = this.polygons.flatMap((polygon) => {
      const k = sidesOf(polygon).findIndex((side) => pairKey(...side) === pairKey(a, b));
      return k < 0 ? [polygon] : cutSide(polygon, k, middle);
    });
    return this.change([...this.vertices, meanPoint([this.vertices[a], this.vertices[b]])], polygons, where);
  }

  // Makes one vertex of several, in their middle: it has the number of the first.
  merge(chosen) {
    const first = min(...chosen), where = chosen.length === 2 ? `edge ${chosen.join("-")}` : "the chosen vertices";
    if (chosen.length < 2) refuse("collapse", "choose an edge, or two vertices or more");
    const gone = new Set(chosen.filter((k) => k !== first)), vertices = [...this.vertices];
    vertices[first] = meanPoint(chosen.map((k) => this.vertices[k]));
    const polygons = this.polygons.map((polygon) => polygon.map((k) => gone.has(k) ? first : k).filter((k, i, all) => k !== all.at(i - 1)));
    const kept = polygons.filter((polygon) => polygon.length > 2);
    return this.change(...dropVertices(vertices, kept, gone), where);
  }

  collapse(a, b) {
    if (!this.polygonsAt(a, b).length) refuse(`edge ${a}-${b}`, "is no edge of the cage");
    return this.merge([a, b]);
  }

  // Joins the next corners of the two faces at an edge in its place. Returns the mesh and the ends of the new edge.
  turn(a, b) {
    const where = `edge ${a}-${b}`, at = this.polygonsAt(a, b);
    if (at.length !== 2) refuse(where, `has ${at.length} ${at.length === 1 ? "face" : "faces"}; an edge with two can be turned`);
    const startAt = (start, stop) => at.map((k) => turnList(this.polygons[k], max(0, this.polygons[k].indexOf(start)))).find(([x, y]) => x === start && y === stop);
    const one = startAt(a, b), other = startAt(b, a);
    if (!one || !other) refuse(where, "its faces face opposite ways; recalculate the normals first");
    const ring = [b, ...one.slice(2), a, ...other.slice(2)], stop = one.length, polygons = [...this.polygons];
    [polygons[at[0]], polygons[at[1]]] = [ring.slice(1, stop + 1), [...ring.slice(stop), b, ring[1]]];
    return { mesh: this.change(this.vertices, polygons, where), edge: [ring[stop], ring[1]] };
  }

  // Divides faces at the middles of their sides: triangles into four, others into a quad per corner. Returns the
  // mesh and the new faces.
  subdivide(chosen) {
    const isChosen = new Set(chosen), vertices = [...this.vertices], middles = new Map(), polygons = [], made = [];
    const addPoint = (corners) => vertices.push(meanPoint(corners.map((k) => this.vertices[k]))) - 1;
    for (const k of isChosen) for (const side of sidesOf(this.polygons[k])) {
      const key = pairKey(...side);
      if (!middles.has(key)) middles.set(key, addPoint(side));
    }
    const middleOf = (side) => middles.get(pairKey(...side));
    this.polygons.forEach((polygon, k) => {
      if (!isChosen.has(k)) { polygons.push(...cutSides(polygon, middleOf)); return; }
      const ring = sidesOf(polygon).map(middleOf), centre = polygon.length > 3 && addPoint(polygon);
      const parts = polygon.map((corner, i) => [corner, ring[i], ...(centre ? [centre] : []), ring.at(i - 1)]);
      if (!centre) parts.push(ring);
      made.push(...parts.map((_, i) => polygons.length + i));
      polygons.push(...parts);
    });
    return { mesh: this.change(vertices, polygons, "subdivide"), chosen: made };
  }

  // Moves vertices half of the way to the middle of their neighbours.
  relax(chosen) {
    const near = listNeighbours(this.edges.flat(), this.vertices.length);
    return this.place(chosen.filter((k) => near[k].length).map((k) => [k, meanPoint([this.vertices[k], meanPoint(near[k].map((j) => this.vertices[j]))])]));
  }

  // Moves vertices along directions of length one; along the normals if there are none.
  inflate(chosen, distance, directions = this.normals()) {
    return this.place(chosen.map((k) => [k, add(this.vertices[k], scale(directions[k], distance))]));
  }

  // The normals of vertices, outward also if the faces turn inward.
  normals() {
    const sums = this.vertices.map(() => [0, 0, 0]), sign = this.volume() < 0 ? -1 : 1;
    for (const triangle of fansOf(this.polygons)) {
      const [p, q, r] = triangle.map((k) => this.vertices[k]), normal = cross(minus(q, p), minus(r, p));
      for (const k of triangle) sums[k] = add(sums[k], scale(normal, sign));
    }
    return sums.map(normalize);
  }

  // The volume, with a sign, of some faces; of all by default.
  volume(polygons = this.polygons) {
    const from = meanPoint(this.vertices), corner = (k) => minus(this.vertices[k], from);
    return sumOf(fansOf(polygons).map(([a, b, c]) => dot(corner(a), cross(corner(b), corner(c))) / 6));
  }

  // Without faces, the vertices that are then in none, and vertices that are in none.
  remove(faces, chosen = []) {
    const isGone = new Set(faces), polygons = this.polygons.filter((_, k) => !isGone.has(k)), kept = new Set(polygons.flat());
    if (!polygons.length) refuse("delete", "no face would be left; nothing was changed");
    const gone = [...this.polygons.flat(), ...chosen].filter((k) => !kept.has(k));
    return new CageMesh(...dropVertices(this.vertices, polygons, new Set(gone)));
  }

  // Without vertices and the faces that have them.
  removeVertices(chosen) {
    const isGone = new Set(chosen);
    return this.remove(this.facesOf((k) => isGone.has(k), "some"), chosen);
  }

  /** @param {(vertex: number) => boolean} test @param {"some" | "every"} how */
  facesOf(test, how) { return this.polygons.flatMap((polygon, k) => polygon[how](test) ? [k] : []); }

  // Closes the holes that have one of these vertices; all without any.
  fill(chosen) {
    const wanted = new Set(chosen), vertices = [...this.vertices], polygons = [...this.polygons], holes = this.listHoles().filter((hole) => !wanted.size || hole.some((k) => wanted.has(k)));
    if (!holes.length) refuse("fill", wanted.size ? "no hole has a chosen vertex; choose none to fill all holes" : "the cage has no hole around which the faces turn one way");
    for (const hole of holes) {
      if (hole.length < 5) { polygons.push(hole); continue; }
      const centre = vertices.push(meanPoint(hole.map((k) => vertices[k]))) - 1;
      polygons.push(...sidesOf(hole).map(([a, b]) => [a, b, centre]));
    }
    return this.change(vertices, polygons, "fill");
  }

  // The rings of sides that have one face.
  listHoles() {
    const next = new Map(), holes = [];
    for (const polygon of this.polygons) for (const [a, b] of sidesOf(polygon)) if (this.polygonsAt(a, b).length === 1) next.set(b, [...(next.get(b) ?? []), a]);
    for (const start of next.keys()) while (next.get(start)?.length) {
      const hole = [start];
      for (let at = next.get(start).pop(); at !== start && at !== undefined; at = next.get(at)?.pop()) hole.push(at);
      if (hole.length > 2 && this.polygonsAt(hole.at(-1), start).length === 1) holes.push(hole);
    }
    return holes;
  }

  flip(chosen) {
    const isChosen = new Set(chosen);
    return new CageMesh(this.vertices, this.polygons.map((polygon, k) => isChosen.has(k) ? [...polygon].reverse() : polygon));
  }

  // Turns the faces of each part so that they agree, and outward.
  orient() {
    const turned = new Array(this.polygons.length).fill(undefined);
    const sideOf = (k, a, b) => sidesOf(this.polygons[k]).some(([x, y]) => x === a && y === b) !== turned[k];
    this.polygons.forEach((_, start) => {
      if (turned[start] !== undefined) return;
      const part = [start];
      turned[start] = false;
      for (const k of part) for (const [a, b] of sidesOf(this.polygons[k])) {
        const at = this.polygonsAt(a, b), other = at.length === 2 ? at.find((one) => one !== k) : undefined;
        if (other === undefined || turned[other] !== undefined) continue;
        turned[other] = false;
        turned[other] = sideOf(other, a, b) === sideOf(k, a, b);
        part.push(other);
      }
      const faces = part.map((k) => turned[k] ? [...this.polygons[k]].reverse() : this.polygons[k]);
      if (this.volume(faces) < 0) for (const k of part) turned[k] = !turned[k];
    });
    return this.flip(turned.flatMap((isTurned, k) => isTurned ? [k] : []));
  }

  // Gives each fan of faces around a vertex a vertex of its own.
  separate(chosen) {
    const vertices = [...this.vertices], polygons = this.polygons.map((polygon) => [...polygon]);
    for (const vertex of chosen) for (const fan of this.listFans(vertex).slice(1)) {
      const copy = vertices.push(this.vertices[vertex]) - 1;
      for (const k of fan) polygons[k] = polygons[k].map((one) => one === vertex ? copy : one);
    }
    if (vertices.length === this.vertices.length) refuse("separate", "the faces at the chosen vertices hold together");
    return new CageMesh(vertices, polygons);
  }

  // The faces at a vertex, by what sides with two faces hold together.
  listFans(vertex) {
    const left = new Set(this.facesOf((k) => k === vertex, "some")), fans = [];
    for (const start of left) fans.push(this.spread([start], left, (a, b) => a === vertex || b === vertex));
    return fans;
  }

  // The faces that sides with two faces hold together with some.
  link(chosen) {
    const left = new Set(this.polygons.keys());
    for (const k of chosen) left.delete(k);
    return this.spread([...chosen], left, () => true);
  }

  // Goes from faces over sides to those that are left, and takes them.
  spread(found, left, mayCross) {
    for (const k of found) {
      left.delete(k);
      for (const [a, b] of sidesOf(this.polygons[k])) {
        const at = this.polygonsAt(a, b);
        if (at.length !== 2 || !mayCross(a, b)) continue;
        for (const other of at) if (left.delete(other)) found.push(other);
      }
    }
    return found;
  }
}

function collectSides(polygons) {
  const found = new Map();
  polygons.forEach((polygon, k) => {
    for (const side of sidesOf(polygon)) {
      const key = pairKey(...side), at = found.get(key);
      if (at) at.push(k); else found.set(key, [k]);
    }
  });
  return found;
}

// Cuts a polygon at all sides that have a middle.
function cutSides(polygon, middleOf) {
  const parts = [polygon];
  for (const side of sidesOf(polygon)) {
    const middle = middleOf(side);
    if (middle === undefined) continue;
    const holds = (part) => sidesOf(part).findIndex(([a, b]) => a === side[0] && b === side[1]), at = parts.findIndex((part) => holds(part) >= 0);
    parts.splice(at, 1, ...cutSide(parts[at], holds(parts[at]), middle));
  }
  return parts;
}

// Vertices and polygons without some vertices, which no polygon has.
function dropVertices(vertices, polygons, gone) {
  if (!gone.size) return [vertices, polygons];
  let count = 0;
  const numbers = vertices.map((_, k) => gone.has(k) ? -1 : count++);
  return [vertices.filter((_, k) => !gone.has(k)), polygons.map((polygon) => polygon.map((k) => numbers[k]))];
}

// Counts the faults of a surface that cageik check calls unfit, by their kinds (cages/check/faults.py).
function countFaults({ vertices, polygons }) {
  const triangles = fansOf(polygons), corners = new Set(), edges = new Map(), group = triangles.flatMap((_, t) => [3 * t, 3 * t + 1, 3 * t + 2]);
  const leaderOf = (k) => { while (group[k] !== k) k = group[k] = group[group[k]]; return k; };
  const counts = { repeated: 0, twins: 0, crowded: 0, turned: 0, pinched: 0, unused: 0, open: 0 };
  for (const polygon of polygons) if (new Set(polygon).size < polygon.length) counts.repeated++;
  triangles.forEach((triangle, t) => {
    const key = [...triangle].sort((a, b) => a - b).join();
    if (corners.has(key)) counts.twins++;
    corners.add(key);
    for (let k = 0; k < 3; k++) {
      const a = triangle[k], b = triangle[(k + 1) % 3], isForward = a < b, ends = [3 * t + k, 3 * t + (k + 1) % 3];
      if (!isForward) ends.reverse();
      const edge = edges.get(pairKey(a, b));
      if (!edge) { edges.set(pairKey(a, b), { faces: 1, forward: Number(isForward), ends }); continue; }
      edge.faces++;
      edge.forward += Number(isForward);
      ends.forEach((corner, end) => { group[leaderOf(corner)] = leaderOf(edge.ends[end]); });
    }
  });
  for (const { faces, forward } of edges.values()) {
    if (faces > 2) counts.crowded++;
    else if (faces < 2) counts.open++;
    else if (forward !== 1) counts.turned++;
  }
  const used = new Set(triangles.flat()), fans = new Set(group.map((_, k) => leaderOf(k)));
  counts.pinched = fans.size - used.size;
  counts.unused = vertices.length - used.size;
  return counts;
}
