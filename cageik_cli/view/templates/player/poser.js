// Poses a cage by anchors, with rounds of rigid rotations (method/pose/poser.py).
const SETTLING_ROUNDS = 3;

class Poser {
  // `cageSolvers` is of `makeSolvers`; `anchors` have a place, a row in cage space, a weight, `hard` and a radius or none.
  constructor(cageSolvers, anchors, alpha) {
    Object.assign(this, cageSolvers, { rows: anchors.map((one) => one.row) });
    this.reaches = this.surface ? this.surface.findReaches(anchors, this.mirror) : [];
    const unit = alpha * anchors.length / this.rings.length;
    const compliance = anchors.map(({ hard, weight }) => hard ? 0 : unit / weight);
    // Across a mirror, anchors on its plane stay.
    const { mirror } = this, isOff = ({ place }) => abs(dot(minus(place, mirror.point), mirror.normal)) > MAX_ASYMMETRY * this.size;
    this.responses = this.solvers.map((solver, k) => {
      const acts = anchors.map((one) => !k || isOff(one)), pick = (list) => list.filter((_, i) => acts[i]);
      const found = solver.respond(pick(this.rows), pick(compliance));
      return found && acts.map((isActing) => isActing ? found.shift() : zeros(this.rings.length));
    });
    this.isMet = this.responses.every(Boolean);
  }

  // Applies a map of one coordinate to points; across a mirror it is another one.
  map(points, apply) {
    const count = points.length / 3, out = zeros(3 * this.rings.length);
    const take = (axis) => Float64Array.from({ length: count }, (_, k) => dot(axis, pointOf(points, k)));
    const give = (values, axis, sign = 1) => values.forEach((x, k) => { for (let a = 0; a < 3; a++) out[3 * k + a] += sign * x * axis[a]; });
    for (const axis of [[1, 0, 0], [0, 1, 0], [0, 0, 1]]) give(apply(0, take(axis)), axis);
    if (this.normal) {
      const heights = take(this.normal);
      give(apply(1, heights), this.normal);
      give(apply(0, heights), this.normal, -1);
    }
    return out;
  }

  // The cage whose anchors are displaced.
  edit(cage, moves, rounds) {
    let straight = this.map(moves, (k, t) => combine(this.responses[k], t, this.rings.length));
    const forces = zeros(cage.length);
    for (const reach of this.reaches) {
      const move = pointOf(moves, reach.k), image = reach.isImage ? minus(move, scale(this.normal, 2 * dot(move, this.normal))) : move;
      if (move.some(Boolean)) addForces(forces, reach, cage, image);
    }
    if (forces.some(Boolean)) straight = add(straight, this.map(forces, (k, f) => this.solvers[k].settle(f, this.rows, this.responses[k])));
    // The anchors go to their targets in steps, one per round, all but the last.
    const steps = max(1, rounds - max(SETTLING_ROUNDS, floor(rounds / 10)));
    let moved = scale(straight, 1 / steps);
    for (let step = 2; step < rounds + 2; step++) {
      const turned = this.map(this.turnCells(cage, moved), (k, b) => this.solvers[k].change(b, this.rows, this.responses[k]));
      moved = add(scale(straight, min(1, step / steps)), turned);
    }
    return add(Float64Array.from(cage), moved);
  }

  // The change of δ when each cell of the cage turns with its motion.
  turnCells(cage, moved) {
    const near = this.rings, n = near.length, turns = zeros(9 * n), s = zeros(9), out = zeros(3 * n);
    for (let i = 0; i < n; i++) {
      s.fill(0);
      for (const j of near[i]) for (let c = 0; c < 3; c++) {
        const edge = cage[3 * i + c] - cage[3 * j + c];
        for (let r = 0; r < 3; r++) {
          s[3 * r + c] += (cage[3 * i + r] - cage[3 * j + r] + moved[3 * i + r] - moved[3 * j + r]) * edge / near[i].length;
        }
      }
      nearestRotation(s, turns.subarray(9 * i, 9 * i + 9));
    }
    for (let i = 0; i < n; i++) for (const j of near[i]) for (let c = 0; c < 3; c++) {
      const edge = (cage[3 * i + c] - cage[3 * j + c]) / near[i].length;
      for (let r = 0; r < 3; r++) out[3 * i + r] += ((turns[9 * i + 3 * r + c] + turns[9 * j + 3 * r + c]) / 2 - Number(r === c)) * edge;
    }
    return out;
  }
}

// What all posers of a cage share. `mirror` is null, or a normal and a point in the cage's units; `surface` is
// null where all of the model follows the handles.
function makeSolvers(cage, faces, locked, mirror, surface) {
  const rings = listNeighbours(listEdges(faces), cage.length / 3), partners = mirror && findPartners(cage, mirror);
  if (mirror && !partners) throw new Error("mirror: the cage is not symmetric; move the plane, or remove the mirror");
  const solvers = (mirror ? [1, -1] : [1]).map((sign) => new CoordinateSolver(rings, new Set(locked), partners, sign, surface?.gram));
  const size = norm([0, 1, 2].map((a) => { const all = listPoints(cage).map((p) => p[a]); return max(...all) - min(...all); }));
  return { rings, solvers, surface, mirror, size, normal: mirror?.normal };
}
