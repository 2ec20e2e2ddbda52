// The answer of a cage to its anchors: the minimum of posing/poser.py, by the steps of
// posing/cage_response.py, with the constraints of posing/constraints.py.
const FREE_TOLERANCE = 1e-9, MAX_ASYMMETRY = 1e-3;

function listNeighbours(faces, count) {
  const sets = Array.from({ length: count }, () => new Set()), edges = listEdges(faces);
  for (let k = 0; k < edges.length; k += 2) { sets[edges[k]].add(edges[k + 1]); sets[edges[k + 1]].add(edges[k]); }
  return sets.map((set) => [...set]);
}

// Components of the cage, each of length one.
function listComponents(neighbours) {
  const number = new Int32Array(neighbours.length).fill(-1), components = [];
  neighbours.forEach((_, start) => {
    if (number[start] >= 0) return;
    const stack = [start], members = [];
    number[start] = components.length;
    while (stack.length) {
      const at = stack.pop();
      members.push(at);
      for (const next of neighbours[at]) if (number[next] < 0) { number[next] = number[start]; stack.push(next); }
    }
    const one = new Float64Array(neighbours.length);
    for (const member of members) one[member] = members.length ** -0.5;
    components.push(one);
  });
  return components;
}

// The partner of each vertex across a mirror; null if the cage is not symmetric.
function findPartners(cage, { normal, point }) {
  const count = cage.length / 3, [, radius] = enclose(cage), partners = new Int32Array(count);
  for (let i = 0; i < count; i++) {
    const p = [...cage.subarray(3 * i, 3 * i + 3)], image = subtract(p, scale(normal, 2 * dot(subtract(p, point), normal)));
    let best = Infinity;
    for (let k = 0; k < count; k++) {
      const away = Math.hypot(cage[3 * k] - image[0], cage[3 * k + 1] - image[1], cage[3 * k + 2] - image[2]);
      if (away < best) { best = away; partners[i] = k; }
    }
    if (best > MAX_ASYMMETRY * 2 * radius) return null;
  }
  return partners.every((k, i) => partners[k] === i) ? partners : null;
}

// One coordinate of all cage vertices; `sign` is -1 for that across a mirror.
class CoordinateSolver {
  constructor(neighbours, locked, partners, sign) {
    const n = this.count = neighbours.length;
    this.neighbours = neighbours;
    this.column = new Int32Array(n).fill(-1);
    this.share = new Float64Array(n);
    let width = 0;
    for (let k = 0; k < n; k++) {
      const partner = partners ? partners[k] : k;
      if (locked.has(k) || locked.has(partner) || k > partner || (k === partner && sign < 0)) continue;
      this.column[k] = this.column[partner] = width++;
      this.share[k] = k === partner ? 1 : Math.SQRT1_2;
      if (k !== partner) this.share[partner] = sign * Math.SQRT1_2;
    }
    this.width = width;
    this.modes = this.findFreeModes();
    const matrix = makeRows(width, width), add = (entries) => {
      for (const [i, x] of entries) for (const [j, y] of entries) matrix[i][j] += x * y;
    };
    const entry = (k, value) => [this.column[k], value * this.share[k]];
    neighbours.forEach((near, i) => {
      if (near.length) add([entry(i, 1), ...near.map((j) => entry(j, -1 / near.length))].filter(([k]) => k >= 0));
    });
    for (const mode of this.modes) add([...this.restrict(mode)].map((x, k) => [k, x]));
    this.factor = factorize(matrix);
  }

  restrict(values) {
    const out = new Float64Array(this.width);
    for (let k = 0; k < this.count; k++) if (this.column[k] >= 0) out[this.column[k]] += this.share[k] * values[k];
    return out;
  }

  extend(values) { return Float64Array.from(this.share, (share, k) => this.column[k] < 0 ? 0 : share * values[this.column[k]]); }

  // Motions of whole components that are free; that of the whole cage is the first, if it is.
  findFreeModes() {
    const components = listComponents(this.neighbours);
    const { values, right } = decompose(components.map((one) => subtract(one, this.extend(this.restrict(one)))));
    const free = right.filter((_, k) => values[k] < FREE_TOLERANCE).map((shares) => combine(components, shares));
    const whole = new Float64Array(this.count).fill(this.count ** -0.5), shares = free.map((mode) => dot(mode, whole));
    if (!free.length || norm(subtract(combine(free, shares), whole)) > FREE_TOLERANCE) return free;
    this.canMoveAsOne = true;
    const kept = [whole];
    for (const mode of free) {
      let rest = mode;
      for (const one of kept) rest = subtract(rest, scale(one, dot(one, rest)));
      if (kept.length < free.length && norm(rest) > 1e-6) kept.push(normalize(rest));
    }
    return kept;
  }

  // Displacements by forces on cage vertices, without free modes.
  push(forces) {
    const moved = this.extend(solveFactored(this.factor, this.restrict(forces)));
    for (const mode of this.modes) { const share = dot(mode, forces); for (let k = 0; k < moved.length; k++) moved[k] -= share * mode[k]; }
    return moved;
  }

  // The response to anchors with these rows; null if they cannot be met independently.
  respond(rows, compliance) {
    const count = rows.length, influence = rows.map((row) => this.push(row));
    const system = rows.map((row, i) => Float64Array.from(influence, (one, k) => dot(row, one) + (i === k ? compliance[i] : 0)));
    const coupling = this.modes.map((mode) => Float64Array.from(rows, (row) => dot(row, mode)));
    const { values, columns } = decompose(coupling);
    const rigid = columns.filter((_, k) => values[k] > FREE_TOLERANCE).map(normalize);
    const clean = (v) => rigid.reduce((rest, one) => subtract(rest, scale(one, dot(one, rest))), v);
    // The system outside the rigid motions; on those, any number that keeps it regular.
    const half = system.map(clean), size = Math.max(...system.map((row, i) => row[i])) || 1;
    const inner = Array.from({ length: count }, (_, i) => clean(Float64Array.from(half, (row) => row[i])));
    for (const one of rigid) for (let i = 0; i < count; i++) for (let k = 0; k < count; k++) inner[i][k] += size * one[i] * one[k];
    const factor = factorize(inner);
    if (!factor) return null;
    const unit = (i) => { const e = new Float64Array(count); e[i] = 1; return e; };
    const forces = Array.from({ length: count }, (_, i) => clean(solveFactored(factor, clean(unit(i)))));
    const left = forces.map((force, i) => subtract(unit(i), Float64Array.from(system, (row) => dot(row, force))));
    const resolve = this.resolveModes(coupling, count);
    return forces.map((force, i) => {
      const moved = combine(influence, force, this.count);
      resolve.forEach((row, mode) => { const share = dot(row, left[i]); for (let k = 0; k < this.count; k++) moved[k] += share * this.modes[mode][k]; });
      return moved;
    });
  }

  // Free modes per displacement of an anchor: with a choice, components stay together.
  resolveModes(coupling, count) {
    if (!this.canMoveAsOne || !count) return invert(coupling, count);
    const centre = (v) => { const mean = v.reduce((a, b) => a + b, 0) / count; return v.map((x) => x - mean); };
    const apart = invert(coupling.slice(1).map(centre), count).map(centre);
    const together = new Float64Array(count).fill(1 / count);
    apart.forEach((row, mode) => {
      const mean = coupling[mode + 1].reduce((a, b) => a + b, 0) / count;
      for (let i = 0; i < count; i++) together[i] -= mean * row[i];
    });
    return [scale(together, 1 / this.modes[0][0]), ...apart];
  }

  // Displacements by a change of δ, with the anchors where they are.
  change(differences, rows, response) {
    const forces = Float64Array.from(differences);
    this.neighbours.forEach((near, i) => {
      if (!near.length) forces[i] = 0;
      for (const j of near) forces[j] -= differences[i] / near.length;
    });
    const moved = this.push(forces);
    const shares = rows.map((row) => dot(row, moved));
    response.forEach((one, i) => { for (let k = 0; k < moved.length; k++) moved[k] -= shares[i] * one[k]; });
    return moved;
  }
}

function combine(vectors, shares, length = vectors[0]?.length ?? 0) {
  const sum = new Float64Array(length);
  vectors.forEach((vector, k) => { const share = shares[k]; for (let i = 0; i < length; i++) sum[i] += share * vector[i]; });
  return sum;
}

// The pseudoinverse of a matrix with these columns, by rows.
function invert(columns, count) {
  const { values, columns: left, right } = decompose(columns), rows = makeRows(columns.length, count);
  values.forEach((value, k) => {
    if (value <= FREE_TOLERANCE) return;
    rows.forEach((row, p) => { for (let i = 0; i < count; i++) row[i] += right[k][p] * left[k][i] / (value * value); });
  });
  return rows;
}
