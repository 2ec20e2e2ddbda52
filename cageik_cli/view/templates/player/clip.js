// The frames of the page's clip, in diagonals of the model from the middle of its rest cage; it has all that the header says.
class Clip {
  /** @param {Payload} payload */
  constructor({ header, arrays }) {
    Object.assign(this, header, { arrays, count: arrays.rotations.length / 9 });
    // They are packed by coordinate.
    const n = arrays.cage.length / 3, place = (k) => (k % 3 * n + (k - k % 3) / 3) * this.count;
    this.cages = listOf(this.count, (frame) => Float32Array.from(arrays.cage, (_, k) => arrays.cages[place(k) + frame]));
    this.held = new Map(header.held.map(({ frame, label }, place) => [frame, { label, place }]));
  }

  cage(frame) { return this.cages[frame]; }

  rotation(frame) { return this.arrays.rotations.subarray(9 * frame, 9 * frame + 9); }

  // v − v̂ of a held frame, by coordinate.
  errors(frame) {
    const { place } = this.held.get(frame), size = this.arrays.lack.length;
    return this.arrays.held.subarray(place * size, (place + 1) * size);
  }

  // The input of a held frame, from its reconstruction.
  input(frame, positions, out) {
    const errors = this.errors(frame), m = out.length / 3, step = this.heldStep;
    for (let j = 0; j < m; j++) for (let a = 0; a < 3; a++) out[3 * j + a] = positions[3 * j + a] + step * errors[a * m + j];
  }

  // The number of a drawn vertex in the model's file, and back (-1 if it is not drawn).
  fileVertex(vertex) { return this.arrays.vertices ? this.arrays.vertices[vertex] : vertex; }

  drawnVertex(number) {
    if (!this.arrays.vertices) return number < this.arrays.lack.length / 3 ? number : -1;
    return this.arrays.vertices.indexOf(number);
  }

  toFile(point) { return point.map((x, k) => x * this.diagonal + this.origin[k]); }

  fromFile(point) { return point.map((x, k) => (x - this.origin[k]) / this.diagonal); }

  // The number of a frame, as handles files and people name it, and the frame whose number is nearest.
  numberOf(frame) { return Number((this.start + frame * this.step).toPrecision(10)); }

  frameOf(number) { return clamp(round((number - this.start) / this.step), 0, this.count - 1); }

  hasNumber(number) { return typeof number === "number" && abs(number - this.numberOf(this.frameOf(number))) <= 1e-6 * this.step; }

  get ends() { return [this.numberOf(0), this.numberOf(this.count - 1)]; }

  nameOf(frame) { return this.frames[frame] ?? "rest pose"; }
}

// A value between two lists of numbers.
function blend(a, b, share) {
  return share ? Float64Array.from(a, (x, k) => x + share * (b[k] - x)) : a;
}
