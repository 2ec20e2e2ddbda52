// The model: positions from cages, v = base R + W (c − cage R), and normals.
class Skin {
  /** @param {Payload} payload */
  constructor({ header, arrays }) {
    this.cage = Float64Array.from(arrays.cage);
    this.count = arrays.lack.length / 3;
    this.cageCount = arrays.cage.length / 3;
    this.faces = arrays.faces;
    const m = this.count, n = this.cageCount, step = 1 / header.levels;
    this.weights = new Float32Array(m * n);
    for (let k = 0; k < n; k++) for (let j = 0, to = k; j < m; j++, to += n) this.weights[to] = step * arrays.weights[k * m + j];
    this.moves = zeros(3 * n);
    this.refine(arrays, header.restStep);
    const rest = this.cage;
    this.base = new Float32Array(3 * m);
    for (let k = 0; k < 3 * m; k++) this.base[k] = header.lackStep * arrays.lack[(k % 3) * m + (k - k % 3) / 3];
    // The mesh of the rest cage, as moved from a cage of zeros.
    this.cage = zeros(3 * n);
    this.deform(rest, [1, 0, 0, 0, 1, 0, 0, 0, 1], this.base);
    this.cage = rest;
  }

  // Adds what rounding lost of the weights in the smooth motions of the cage, which poses amplify.
  refine({ smooth, rests }, step) {
    const m = this.count, n = this.cageCount, modes = smooth.length / n;
    for (let mode = 0; mode < modes; mode++) for (let j = 0, at = 0; j < m; j++) {
      const share = step * rests[mode * m + j];
      for (let k = 0; k < n; k++, at++) this.weights[at] += share * smooth[mode * n + k];
    }
  }

  // Displacements of a cage from the rest cage, turned.
  displace(cage, rotation) {
    const rest = this.cage, moves = this.moves;
    for (let k = 0; k < cage.length; k += 3) {
      const turned = turn(rest.subarray(k, k + 3), rotation);
      for (let a = 0; a < 3; a++) moves[k + a] = cage[k + a] - turned[a];
    }
    return moves;
  }

  deform(cage, rotation, out) {
    const d = this.displace(cage, rotation), w = this.weights, n3 = d.length, base = this.base;
    const [a, b, c, e, f, g, h, i, j] = rotation;
    for (let v = 0, at = 0; v < base.length; v += 3) {
      let x = 0, y = 0, z = 0;
      for (let k = 0; k < n3; k += 3, at++) {
        const weight = w[at];
        x += weight * d[k]; y += weight * d[k + 1]; z += weight * d[k + 2];
      }
      const p = base[v], q = base[v + 1], r = base[v + 2];
      out[v] = p * a + q * e + r * h + x;
      out[v + 1] = p * b + q * f + r * i + y;
      out[v + 2] = p * c + q * g + r * j + z;
    }
  }

  // A surface point in cage space: its row, and its place on the base mesh.
  anchor(corners, shares) {
    const n = this.cageCount, row = zeros(n), base = [0, 0, 0];
    corners.forEach((vertex, corner) => {
      const share = shares[corner];
      addTo(row, share, this.weights.subarray(vertex * n));
      for (let a = 0; a < 3; a++) base[a] += share * this.base[3 * vertex + a];
    });
    return { row, base };
  }

  place({ row, base }, cage, rotation) {
    const d = this.displace(cage, rotation), p = turn(base, rotation);
    for (let k = 0; k < row.length; k++) for (let a = 0; a < 3; a++) p[a] += row[k] * d[3 * k + a];
    return p;
  }

  normals(positions, out) {
    const f = this.faces, p = positions;
    out.fill(0);
    for (let k = 0; k < f.length; k += 3) {
      const a = 3 * f[k], b = 3 * f[k + 1], c = 3 * f[k + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      out[a] += x; out[a + 1] += y; out[a + 2] += z;
      out[b] += x; out[b + 1] += y; out[b + 2] += z;
      out[c] += x; out[c + 1] += y; out[c + 2] += z;
    }
  }

  // The front-most point of the surface that is shown on a ray, or null; faces are hit from both sides.
  pick(positions, { origin, direction }) {
    const f = this.shown ?? this.faces, p = positions, [ox, oy, oz] = origin, [dx, dy, dz] = direction;
    let best = Infinity, found = null;
    for (let k = 0; k < f.length; k += 3) {
      const a = 3 * f[k], b = 3 * f[k + 1], c = 3 * f[k + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const hx = dy * vz - dz * vy, hy = dz * vx - dx * vz, hz = dx * vy - dy * vx;
      const size = ux * hx + uy * hy + uz * hz;
      if (size === 0) continue;
      const sx = ox - p[a], sy = oy - p[a + 1], sz = oz - p[a + 2];
      const s = (sx * hx + sy * hy + sz * hz) / size;
      if (s < 0 || s > 1) continue;
      const qx = sy * uz - sz * uy, qy = sz * ux - sx * uz, qz = sx * uy - sy * ux;
      const t = (dx * qx + dy * qy + dz * qz) / size;
      if (t < 0 || s + t > 1) continue;
      const depth = (vx * qx + vy * qy + vz * qz) / size;
      if (depth > 0 && depth < best) {
        best = depth;
        found = { depth, face: k / 3, corners: [f[k], f[k + 1], f[k + 2]], barycentric: [1 - s - t, s, t] };
      }
    }
    return found;
  }
}

// The edges of faces, each once, as pairs of vertices. `isJoined` marks the faces that go on with the
// polygon of the one before; edges within a polygon are left out.
function listEdges(faces, isJoined) {
  const polygonOf = new Map();
  let polygon = 0;
  for (let k = 0; k < faces.length; k++) {
    const a = faces[k], b = faces[k % 3 === 2 ? k - 2 : k + 1], low = min(a, b), high = max(a, b);
    if (k % 3 === 0 && !isJoined?.[k / 3]) polygon++;
    const key = low * 67108864 + high, other = polygonOf.get(key);
    if (!other) polygonOf.set(key, polygon);
    else if (isJoined && other === polygon) polygonOf.set(key, -1);
  }
  const keys = [...polygonOf.keys()].filter((key) => polygonOf.get(key) > 0);
  return Uint32Array.from(keys.flatMap((key) => [floor(key / 67108864), key % 67108864]));
}

// The other ends of the edges at each vertex; each edge is there once.
function listNeighbours(edges, count) {
  const near = listOf(count, () => []);
  for (let k = 0; k < edges.length; k += 2) { near[edges[k]].push(edges[k + 1]); near[edges[k + 1]].push(edges[k]); }
  return near;
}
