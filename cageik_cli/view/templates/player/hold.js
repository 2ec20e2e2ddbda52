// What handles take with them, and what turns with the surface: method/pose/hold.py, method/pose/local_axes.py and
// geometry/surface_distance.py, whose constants these are. Lengths are in diagonals.
const HOLD = 300, REACHED_SHARE = 0.12, MIN_RADIUS = 0.1, MAX_RADIUS = 0.4, CORE = 0.25, RING = 0.72, RING_WIDTH = 0.12;
const LEVELS = 2, MIN_STRETCH = 0.7, MAX_STRETCH = 1.4, SHORT_ARM = 0.2, LONG_ARM = 0.45, NEAREST = 1e-4;
const AXES_RADIUS = 0.08, MIN_COUNTED = 12, COUNTED_RADIUS = 0.6, COINCIDENT = 1e-9;

const smooth = (x) => { x = clamp(x, 0, 1); return x * x * (3 - 2 * x); };
const fallOff = (away) => 1 - smooth((away - CORE) / (1 - CORE));

// The surface at rest: distances along its edges and links, areas, and κ (n/m) HᵀH.
class HeldSurface {
  /** @param {Skin} skin @param {Record<string, any>} arrays */
  constructor(skin, { faces, links = [] }) {
    Object.assign(this, { skin, faces, areas: zeros(skin.count) });
    const { base, count, cageCount: n, weights } = skin, ends = [...links];
    for (let f = 0; f < faces.length; f += 3) {
      const corners = faces.slice(f, f + 3), [a, b, c] = [...corners].map((k) => [...base.subarray(3 * k, 3 * k + 3)]);
      const area = norm(cross(minus(b, a), minus(c, a))) / 6;
      corners.forEach((k, i) => { this.areas[k] += area; ends.push(k, corners[(i + 1) % 3]); });
    }
    if (!this.areas.some(Boolean)) this.areas.fill(1);
    // Neighbours of each vertex, one list after another.
    this.starts = new Uint32Array(count + 1);
    for (const k of ends) this.starts[k + 1]++;
    for (let k = 0; k < count; k++) this.starts[k + 1] += this.starts[k];
    const fill = this.starts.slice();
    this.near = new Uint32Array(ends.length);
    for (let k = 0; k < ends.length; k += 2) {
      this.near[fill[ends[k]]++] = ends[k + 1];
      this.near[fill[ends[k + 1]]++] = ends[k];
    }
    this.scale = HOLD * n / max(1, count);
    this.gram = makeRows(n, n);
    for (let j = 0; j < count; j++) this.addProduct(this.gram, weights.subarray(n * j, n * j + n), this.scale);
    mirrorRows(this.gram);
  }

  // Adds a multiple of w wᵀ to the lower half of a matrix.
  addProduct(matrix, w, share) {
    for (let k = 0; k < w.length; k++) {
      const row = matrix[k], x = share * w[k];
      if (x) for (let i = 0; i <= k; i++) row[i] += x * w[i];
    }
  }

  between(i, j) {
    const p = this.skin.base;
    return hypot(p[3 * i] - p[3 * j], p[3 * i + 1] - p[3 * j + 1], p[3 * i + 2] - p[3 * j + 2]);
  }

  // The distances of vertices from a point that are at most `limit` away, and these vertices by distance.
  measure({ corners, shares }, limit) {
    const { base, count } = this.skin, away = zeros(count).fill(Infinity), place = [0, 0, 0], order = [];
    corners.forEach((k, i) => { for (let a = 0; a < 3; a++) place[a] += shares[i] * base[3 * k + a]; });
    const from = (k) => hypot(base[3 * k] - place[0], base[3 * k + 1] - place[1], base[3 * k + 2] - place[2]);
    if (!this.faces.length) {
      for (let k = 0; k < count; k++) { away[k] = from(k); if (away[k] <= limit) order.push(k); }
      return { away, order: order.sort((a, b) => away[a] - away[b]) };
    }
    const heap = new Heap(), done = new Uint8Array(count);
    corners.forEach((k, i) => { if (shares[i] > 0) { away[k] = min(away[k], from(k)); heap.push(away[k], k); } });
    while (heap.size) {
      const k = heap.pop();
      if (done[k] || away[k] > limit) continue;
      done[k] = 1;
      order.push(k);
      for (let at = this.starts[k]; at < this.starts[k + 1]; at++) {
        const next = this.near[at], distance = away[k] + this.between(k, next);
        if (distance < away[next]) heap.push(away[next] = distance, next);
      }
    }
    return { away, order };
  }

  chooseRadius({ away, order }) {
    const wanted = REACHED_SHARE * sumOf(this.areas);
    let reached = 0;
    const last = order.find((k) => (reached += this.areas[k]) >= wanted);
    return last === undefined ? MAX_RADIUS : clamp(away[last], MIN_RADIUS, MAX_RADIUS);
  }

  // The reaches of anchors, and of their images across a mirror with a normal and a point.
  findReaches(anchors, mirror) {
    const places = anchors.map((anchor, k) => ({ ...anchor, k }));
    if (mirror) places.push(...places.map((one) => ({ ...this.reflect(one, mirror), isImage: true })));
    const reaches = places.map((one) => {
      const found = this.measure(one, one.radius ?? MAX_RADIUS), radius = one.radius ?? this.chooseRadius(found);
      return { ...one, ...found, radius, near: found.order.filter((k) => fallOff(found.away[k] / radius) > 0) };
    });
    const claims = zeros(this.skin.count), claim = ({ away, radius }, k) => fallOff(away[k] / radius) / max(away[k], NEAREST) ** 2;
    for (const one of reaches) for (const k of one.near) claims[k] += claim(one, k);
    return reaches.map((one) => this.makeReach(one, (k) => claim(one, k) / claims[k]));
  }

  makeReach({ k, isImage, row, radius, near, away, order }, share) {
    const { cageCount: n, weights } = this.skin, pivot = zeros(n), moments = listOf(LEVELS, () => makeRows(n, n)), shift = zeros(n);
    let ring = 0;
    for (const j of order) {
      const area = this.areas[j] * max(0, 1 - abs(away[j] / radius - RING) / RING_WIDTH);
      ring += area;
      if (area) addTo(pivot, area, weights.subarray(n * j));
    }
    for (const j of near) {
      const level = LEVELS * fallOff(away[j] / radius), w = weights.subarray(n * j, n * j + n);
      moments.forEach((matrix, i) => {
        const hat = this.scale * max(0, 1 - abs(level - i - 1)) * share(j);
        if (!hat) return;
        this.addProduct(matrix, w, hat);
        addTo(shift, hat * (i + 1) / LEVELS, w);
      });
    }
    moments.forEach(mirrorRows);
    return { k, isImage, row, radius, away, moments, shift, pivot: ring ? scale(pivot, 1 / ring) : row };
  }

  // The vertex that is nearest to the image of a point.
  reflect({ k, corners, shares, radius }, { normal, point }) {
    const { base, count } = this.skin, place = [0, 1, 2].map((a) => sumOf(corners.map((j, i) => shares[i] * base[3 * j + a])));
    const image = minus(place, scale(normal, 2 * dot(minus(place, point), normal)));
    let best = 0, least = Infinity;
    for (let j = 0; j < count; j++) {
      const away = hypot(base[3 * j] - image[0], base[3 * j + 1] - image[1], base[3 * j + 2] - image[2]);
      if (away < least) { least = away; best = j; }
    }
    const at = { corners: [best, best, best], shares: [1, 0, 0] };
    return { k, radius, ...at, row: this.skin.anchor(at.corners, at.shares).row };
  }

  // The turn of the surface around a point: what it is linear in.
  makeAxes(place) {
    const { base, cageCount: n, weights } = this.skin, found = this.measure(place, Infinity);
    const around = found.order.filter((k) => found.away[k] > COINCIDENT).slice(0, MIN_COUNTED), mean = [0, 0, 0];
    const radius = max(AXES_RADIUS, around.length ? found.away[around.at(-1)] / COUNTED_RADIUS : 0);
    const near = found.order.filter((k) => found.away[k] < radius), total = sumOf(near.map((k) => fallOff(found.away[k] / radius)));
    const counted = near.map((k) => fallOff(found.away[k] / radius) / total);
    near.forEach((k, i) => { for (let a = 0; a < 3; a++) mean[a] += counted[i] * base[3 * k + a]; });
    const rows = makeRows(3, n), rest = makeRows(3, 3);
    near.forEach((k, i) => {
      for (let a = 0; a < 3; a++) {
        const arm = counted[i] * (base[3 * k + a] - mean[a]);
        addTo(rows[a], arm, weights.subarray(n * k));
        addTo(rest[a], arm, base.subarray(3 * k));
      }
    });
    return { rows, rest };
  }

  // That turn in a cage of a frame with a rotation, as `turn` takes it.
  findTurn({ rows, rest }, cage, rotation) {
    const moves = this.skin.displace(cage, rotation), sum = zeros(9);
    rows.forEach((row, a) => {
      const still = turn(rest[a], rotation);
      for (let c = 0; c < 3; c++) sum[3 * a + c] = still[c] + sumOf(row.map((x, k) => x * moves[3 * k + c]));
    });
    nearestRotation(sum, sum);
    return sum;
  }
}

// Where the ring of a reach crosses edges of faces: [from, to, share], two for each face that it crosses.
function traceRing({ away, radius }, faces) {
  const ring = [];
  for (let f = 0; f < faces.length; f += 3) {
    const crossed = [];
    for (let i = 0; i < 3; i++) {
      const a = faces[f + i], b = faces[f + (i + 1) % 3], near = away[a] < radius;
      if (near !== away[b] < radius) crossed.push([a, b, Number.isFinite(away[a] - away[b]) ? (radius - away[a]) / (away[b] - away[a]) : Number(!near)]);
    }
    if (crossed.length === 2) ring.push(...crossed);
  }
  return ring;
}

// Copies the lower half of a matrix to the upper one.
function mirrorRows(matrix) { matrix.forEach((row, k) => { for (let i = 0; i < k; i++) matrix[i][k] = row[i]; }); }

// A queue whose smallest key comes first.
class Heap {
  constructor() { Object.assign(this, { keys: [], values: [] }); }

  get size() { return this.keys.length; }

  push(key, value) {
    let at = this.keys.length;
    for (; at; ) {
      const up = (at - 1) >> 1;
      if (this.keys[up] <= key) break;
      this.put(at, this.keys[up], this.values[up]);
      at = up;
    }
    this.put(at, key, value);
  }

  put(at, key, value) { this.keys[at] = key; this.values[at] = value; }

  pop() {
    const first = this.values[0], key = this.keys.pop(), value = this.values.pop(), { length } = this.keys;
    for (let at = 0; length; ) {
      let down = 2 * at + 1;
      if (down + 1 < length && this.keys[down + 1] < this.keys[down]) down++;
      if (down >= length || this.keys[down] >= key) { this.put(at, key, value); break; }
      this.put(at, this.keys[down], this.values[down]);
      at = down;
    }
    return first;
  }
}

// The motion of an arm whose end moves: per level (M − I)ᵀ as three rows, and what is left, a translation.
function swing(arm, move, radius) {
  const moved = add(arm, move), length = norm(arm), after = norm(moved), share = smooth((length / radius - SHORT_ARM) / (LONG_ARM - SHORT_ARM));
  if (!(share > 0 && after > 0)) return { turns: [], left: move };
  const a = scale(arm, 1 / length), along = dot(a, moved), across = minus(moved, scale(a, along)), height = norm(across);
  const least = a.map(abs).indexOf(min(...a.map(abs))), unit = [0, 1, 2].map((k) => Number(k === least));
  const b = height > 0 ? scale(across, 1 / height) : normalize(cross(a, unit)), angle = Math.atan2(height, along);
  const stretch = clamp(after / length, MIN_STRETCH, MAX_STRETCH);
  const turns = listOf(LEVELS, (k) => {
    const s = (k + 1) / LEVELS, lambda = stretch ** s, mu = stretch ** (-s / 2), sine = sin(s * angle), cosine = cos(s * angle);
    return [0, 1, 2].map((i) => {
      const ofA = share * ((lambda * cosine - mu) * a[i] - mu * sine * b[i]), ofB = share * (lambda * sine * a[i] - mu * (1 - cosine) * b[i]);
      return a.map((x, j) => ofA * x + ofB * b[j] + (i === j ? share * (mu - 1) : 0));
    });
  });
  const last = turns[LEVELS - 1];
  return { turns, left: move.map((d, j) => d - length * sumOf(a.map((x, i) => x * last[i][j]))) };
}

// Adds the forces on a cage that move a reach, whose anchor moves.
function addForces(forces, { row, pivot, radius, moments, shift }, cage, move) {
  const n = row.length, end = [0, 0, 0], centre = [0, 0, 0];
  for (let k = 0; k < n; k++) for (let a = 0; a < 3; a++) {
    end[a] += row[k] * cage[3 * k + a];
    centre[a] += pivot[k] * cage[3 * k + a];
  }
  const { turns, left } = swing(minus(end, centre), move, radius), places = cage.map((x, k) => x - centre[k % 3]);
  turns.forEach((rows, level) => {
    const swung = zeros(3 * n);
    for (let k = 0; k < n; k++) for (let c = 0; c < 3; c++) swung[3 * k + c] = places[3 * k] * rows[0][c] + places[3 * k + 1] * rows[1][c] + places[3 * k + 2] * rows[2][c];
    moments[level].forEach((row, k) => {
      let x = 0, y = 0, z = 0;
      for (let i = 0; i < n; i++) { x += row[i] * swung[3 * i]; y += row[i] * swung[3 * i + 1]; z += row[i] * swung[3 * i + 2]; }
      forces[3 * k] += x; forces[3 * k + 1] += y; forces[3 * k + 2] += z;
    });
  });
  shift.forEach((share, k) => { for (let a = 0; a < 3; a++) forces[3 * k + a] += share * left[a]; });
}
