// The answer of a cage to its anchors: the minimum of method/pose/poser.py, by its steps, with the
// constraints of method/pose/constraints.py.
const FREE_TOLERANCE = 1e-9;

// Components of the cage, each of length one; `rings` are the neighbours of its vertices.
function listComponents(rings) {
  const number = new Int32Array(rings.length).fill(-1), components = [];
  rings.forEach((_, start) => {
    if (number[start] >= 0) return;
    const stack = [start], members = [];
    number[start] = components.length;
    while (stack.length) {
      const at = stack.pop();
      members.push(at);
      for (const next of rings[at]) if (number[next] < 0) { number[next] = number[start]; stack.push(next); }
    }
    const one = zeros(rings.length);
    for (const member of members) one[member] = members.length ** -0.5;
    components.push(one);
  });
  return components;
}

// One coordinate of all cage vertices; `sign` is -1 for that across a mirror.
class CoordinateSolver {
  constructor(rings, locked, partners, sign, gram) {
    const n = rings.length;
    Object.assign(this, { rings, gram, count: n, column: new Int32Array(n).fill(-1), share: zeros(n) });
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
    rings.forEach((near, i) => {
      if (near.length) add([entry(i, 1), ...near.map((j) => entry(j, -1 / near.length))].filter(([k]) => k >= 0));
    });
    for (const mode of this.modes) add([...this.restrict(mode)].map((x, k) => [k, x]));
    gram?.forEach((row, k) => row.forEach((value, i) => {
      if (this.column[k] >= 0 && this.column[i] >= 0) matrix[this.column[k]][this.column[i]] += this.share[k] * this.share[i] * value;
    }));
    this.factor = factorize(matrix);
  }

  restrict(values) {
    const out = zeros(this.width);
    for (let k = 0; k < this.count; k++) if (this.column[k] >= 0) out[this.column[k]] += this.share[k] * values[k];
    return out;
  }

  extend(values) { return Float64Array.from(this.share, (share, k) => this.column[k] < 0 ? 0 : share * values[this.column[k]]); }

  // Motions of whole components that are free; that of the whole cage is the first, if it is.
  findFreeModes() {
    // Components that the model is in are not free where it is held.
    const most = this.gram && FREE_TOLERANCE * sumOf(this.gram.map((row, k) => row[k])) / this.count;
    const components = listComponents(this.rings).filter((one) => !this.gram || dot(one, this.gram.map((row) => dot(row, one))) <= most);
    const { values, right } = decompose(components.map((one) => minus(one, this.extend(this.restrict(one)))));
    const free = right.filter((_, k) => values[k] < FREE_TOLERANCE).map((shares) => combine(components, shares));
    const whole = zeros(this.count).fill(this.count ** -0.5), shares = free.map((mode) => dot(mode, whole));
    if (!free.length || norm(minus(combine(free, shares), whole)) > FREE_TOLERANCE) return free;
    this.canMoveAsOne = true;
    const kept = [whole];
    for (const mode of free) {
      let rest = mode;
      for (const one of kept) rest = minus(rest, scale(one, dot(one, rest)));
      if (kept.length < free.length && norm(rest) > 1e-6) kept.push(normalize(rest));
    }
    return kept;
  }

  // Displacements by forces on cage vertices, without free modes.
  push(forces) {
    const moved = this.extend(solveFactored(this.factor, this.restrict(forces)));
    for (const mode of this.modes) addTo(moved, -dot(mode, forces), mode);
    return moved;
  }

  // The response to anchors with these rows; null if they cannot be met independently.
  respond(rows, compliance) {
    const count = rows.length, pushed = rows.map((row) => this.push(row));
    const system = rows.map((row, i) => Float64Array.from(pushed, (one, k) => dot(row, one) + (i === k ? compliance[i] : 0)));
    const coupling = this.modes.map((mode) => Float64Array.from(rows, (row) => dot(row, mode)));
    const { values, columns } = decompose(coupling);
    const rigid = columns.filter((_, k) => values[k] > FREE_TOLERANCE).map(normalize);
    const clean = (v) => rigid.reduce((rest, one) => minus(rest, scale(one, dot(one, rest))), v);
    // The system outside the rigid motions; on those, any number that keeps it regular.
    const half = system.map(clean), size = max(...system.map((row, i) => row[i])) || 1;
    const inner = listOf(count, (i) => clean(Float64Array.from(half, (row) => row[i])));
    for (const one of rigid) inner.forEach((row, i) => addTo(row, size * one[i], one));
    const factor = factorize(inner);
    if (!factor) return null;
    const units = makeIdentity(count), forces = units.map((unit) => clean(solveFactored(factor, clean(unit))));
    const left = forces.map((force, i) => minus(units[i], Float64Array.from(system, (row) => dot(row, force))));
    const resolve = this.resolveModes(coupling, count);
    return forces.map((force, i) => {
      const moved = combine(pushed, force, this.count);
      resolve.forEach((row, mode) => addTo(moved, dot(row, left[i]), this.modes[mode]));
      return moved;
    });
  }

  // Free modes per displacement of an anchor: with a choice, components stay together.
  resolveModes(coupling, count) {
    if (!this.canMoveAsOne || !count) return invert(coupling, count);
    const centre = (v) => { const mean = sumOf(v) / count; return v.map((x) => x - mean); };
    const apart = invert(coupling.slice(1).map(centre), count).map(centre);
    const together = zeros(count).fill(1 / count);
    apart.forEach((row, mode) => {
      const mean = sumOf(coupling[mode + 1]) / count;
      addTo(together, -mean, row);
    });
    return [scale(together, 1 / this.modes[0][0]), ...apart];
  }

  // Displacements by a change of δ, with the anchors where they are.
  change(differences, rows, response) {
    const forces = Float64Array.from(differences);
    this.rings.forEach((near, i) => {
      if (!near.length) forces[i] = 0;
      for (const j of near) forces[j] -= differences[i] / near.length;
    });
    return this.settle(forces, rows, response);
  }

  // Displacements by forces on cage vertices, with the anchors where they are.
  settle(forces, rows, response) {
    const moved = this.push(forces);
    const shares = rows.map((row) => dot(row, moved));
    response.forEach((one, i) => addTo(moved, -shares[i], one));
    return moved;
  }
}

function combine(vectors, shares, length = vectors[0]?.length ?? 0) {
  const sum = zeros(length);
  vectors.forEach((vector, k) => addTo(sum, shares[k], vector));
  return sum;
}

// The pseudoinverse of a matrix with these columns, by rows.
function invert(columns, count) {
  const { values, columns: left, right } = decompose(columns), rows = makeRows(columns.length, count);
  values.forEach((value, k) => {
    if (value <= FREE_TOLERANCE) return;
    rows.forEach((row, p) => addTo(row, right[k][p] / (value * value), left[k]));
  });
  return rows;
}
