// Small linear algebra in double precision. Matrices are lists of rows, or flat 3 x 3 and 4 x 4.
const { abs, cos, floor, hypot, max, min, round, sin, sqrt } = Math;

const zeros = (count) => new Float64Array(count);
const dot = (a, b) => { let sum = 0; for (let k = 0; k < a.length; k++) sum += a[k] * b[k]; return sum; };
const add = (a, b) => a.map((x, k) => x + b[k]);
const minus = (a, b) => a.map((x, k) => x - b[k]);
const scale = (a, factor) => a.map((x) => x * factor);
const norm = (a) => sqrt(dot(a, a));
const normalize = (a) => scale(a, 1 / (norm(a) || 1));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const clamp = (x, low, high) => min(high, max(low, x));
const pointOf = (points, k) => [...points.subarray(3 * k, 3 * k + 3)];
const listPoints = (points) => listOf(points.length / 3, (k) => pointOf(points, k));
const sumOf = (values) => values.reduce((a, b) => a + b, 0);
const listOf = (count, make) => Array.from({ length: count }, (_, k) => make(k));
const makeRows = (count, width) => listOf(count, () => zeros(width));

const makeIdentity = (count) => listOf(count, (k) => zeros(count).fill(1, k, k + 1));

// Adds a multiple of a list to another.
function addTo(sum, share, values) { for (let k = 0; k < sum.length; k++) sum[k] += share * values[k]; }

// A row vector times a flat 3 x 3 matrix: rotations of results act so.
const turn = (p, r) => [0, 1, 2].map((k) => p[0] * r[k] + p[1] * r[3 + k] + p[2] * r[6 + k]);

// Cholesky's factor of a symmetric matrix; null unless it is positive by more than rounding.
function factorize(matrix) {
  const n = matrix.length, lower = makeRows(n, n);
  let largest = 0, smallest = Infinity;
  for (let i = 0; i < n; i++) {
    const row = lower[i];
    for (let j = 0; j <= i; j++) {
      const other = lower[j];
      let sum = matrix[i][j];
      for (let k = 0; k < j; k++) sum -= row[k] * other[k];
      if (j < i) { row[j] = sum / other[j]; continue; }
      largest = max(largest, sum);
      smallest = min(smallest, sum);
      if (!(smallest > 1e-13 * largest)) return null;
      row[i] = sqrt(sum);
    }
  }
  return lower;
}

function solveFactored(lower, right) {
  const n = lower.length, x = Float64Array.from(right);
  for (let i = 0; i < n; i++) {
    const row = lower[i];
    let sum = x[i];
    for (let k = 0; k < i; k++) sum -= row[k] * x[k];
    x[i] = sum / row[i];
  }
  for (let i = n - 1; i >= 0; i--) {
    const row = lower[i], value = x[i] /= row[i];
    for (let k = 0; k < i; k++) x[k] -= row[k] * value;
  }
  return x;
}

// Turns two entries of a list by an angle with this cosine and sine.
function turnPair(list, i, j, c, s) {
  const x = list[i], y = list[j];
  list[i] = c * x - s * y;
  list[j] = s * x + c * y;
}

// The tangent of the angle that makes [[p, r], [r, q]] diagonal.
function findTangent(p, q, r) {
  const zeta = (q - p) / (2 * r);
  return (zeta < 0 ? -1 : 1) / (abs(zeta) + sqrt(1 + zeta * zeta));
}

// Singular values by one-sided Jacobi rotations of columns (Hestenes 1958): `columns` become left
// vectors times values, and `right` holds the right vectors, one per column.
function decompose(source) {
  const columns = source.map((column) => Float64Array.from(column)), count = columns.length, right = makeIdentity(count);
  for (let sweep = 0, turned = true; turned && sweep < 60; sweep++) {
    turned = false;
    for (let p = 0; p < count; p++) for (let q = p + 1; q < count; q++) {
      const pp = dot(columns[p], columns[p]), qq = dot(columns[q], columns[q]), pq = dot(columns[p], columns[q]);
      if (abs(pq) <= 1e-16 * sqrt(pp * qq) || pq === 0) continue;
      turned = true;
      const t = findTangent(pp, qq, pq), c = 1 / hypot(1, t), s = c * t;
      for (const lists of [columns, right]) {
        const a = scale(lists[p], c), b = scale(lists[q], c);
        addTo(a, -s, lists[q]);
        addTo(b, s, lists[p]);
        lists[p] = a;
        lists[q] = b;
      }
    }
  }
  return { values: columns.map(norm), columns, right };
}

// The rotation that is nearest to a flat 3 x 3 matrix: the largest eigenvector of Horn's matrix, a
// quaternion, by Jacobi's rotations.
function nearestRotation(a, out) {
  const m = [
    a[0] + a[4] + a[8], a[7] - a[5], a[2] - a[6], a[3] - a[1],
    0, a[0] - a[4] - a[8], a[3] + a[1], a[2] + a[6],
    0, 0, a[4] - a[0] - a[8], a[7] + a[5],
    0, 0, 0, a[8] - a[0] - a[4],
  ];
  for (let i = 0; i < 4; i++) for (let j = 0; j < i; j++) m[4 * i + j] = m[4 * j + i];
  const v = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  for (let sweep = 0; sweep < 20; sweep++) {
    let off = 0;
    for (let p = 0; p < 3; p++) for (let q = p + 1; q < 4; q++) {
      const pq = m[4 * p + q], size = abs(m[5 * p]) + abs(m[5 * q]);
      if (abs(pq) <= 1e-17 * size) continue;
      off = 1;
      const t = findTangent(m[5 * p], m[5 * q], pq), c = 1 / sqrt(1 + t * t), s = c * t;
      for (let k = 0; k < 16; k += 4) { turnPair(m, k + p, k + q, c, s); turnPair(v, k + p, k + q, c, s); }
      for (let k = 0; k < 4; k++) turnPair(m, 4 * p + k, 4 * q + k, c, s);
    }
    if (!off) break;
  }
  let best = 0;
  for (let k = 1; k < 4; k++) if (m[5 * k] > m[5 * best]) best = k;
  const w = v[best], x = v[4 + best], y = v[8 + best], z = v[12 + best];
  out[0] = w * w + x * x - y * y - z * z; out[1] = 2 * (x * y - w * z); out[2] = 2 * (x * z + w * y);
  out[3] = 2 * (x * y + w * z); out[4] = w * w - x * x + y * y - z * z; out[5] = 2 * (y * z - w * x);
  out[6] = 2 * (x * z - w * y); out[7] = 2 * (y * z + w * x); out[8] = w * w - x * x - y * y + z * z;
}

// How far partners may be from mirror images, in diameters of the cage.
const MAX_ASYMMETRY = 1e-3;

// The partner of each vertex across a mirror; null if the cage is not symmetric.
function findPartners(cage, { normal, point }) {
  const points = listPoints(cage), [, radius] = enclose(cage);
  const partners = points.map((p) => {
    const image = minus(p, scale(normal, 2 * dot(minus(p, point), normal))), away = points.map((q) => norm(minus(image, q))), best = min(...away);
    return best > MAX_ASYMMETRY * 2 * radius ? -1 : away.indexOf(best);
  });
  return partners.every((k, i) => partners[k] === i) ? partners : null;
}
