// A camera that looks at a point from a distance, `turn` degrees right of the front and `tilt` above it.
const DEGREE = Math.PI / 180, HALF_VIEW = 15 * DEGREE, MAX_TILT = 89;
const UPRIGHT = { Y: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], Z: [[1, 0, 0], [0, 0, 1], [0, -1, 0]] };

class Camera {
  constructor(up) {
    Object.assign(this, { upright: UPRIGHT[up], target: [0, 0, 0], shift: [0, 0, 0], turn: 32, tilt: 14, distance: 3, width: 1, height: 1 });
  }

  // Right, up and backward of the picture, as rows.
  axes() {
    const t = this.turn * DEGREE, u = this.tilt * DEGREE;
    const c = Math.cos(t), s = Math.sin(t), d = Math.cos(u), e = Math.sin(u);
    const rows = [[c, 0, -s], [-e * s, d, -e * c], [d * s, e, d * c]];
    return rows.map((row) => [0, 1, 2].map((k) => row.reduce((sum, x, i) => sum + x * this.upright[i][k], 0)));
  }

  centre() { return add(this.target, this.shift); }

  eye() { return add(this.centre(), scale(this.axes()[2], this.distance)); }

  // The flat 4 x 4 matrix from the world to clip space, by columns.
  matrix() {
    const [right, up, back] = this.axes(), eye = this.eye(), near = this.distance / 50, far = this.distance * 20 + 20;
    const [x, y] = this.spans().map((span) => 1 / span);
    const a = (near + far) / (near - far), b = 2 * near * far / (near - far);
    const rows = [
      [...scale(right, x), -x * dot(right, eye)], [...scale(up, y), -y * dot(up, eye)],
      [...scale(back, a), -a * dot(back, eye) + b], [...scale(back, -1), dot(back, eye)],
    ];
    return Float32Array.from({ length: 16 }, (_, k) => rows[k % 4][k >> 2]);
  }

  // Half the size of the picture at distance one.
  spans() {
    const wide = min(1, this.width / this.height), y = Math.tan(HALF_VIEW) / wide;
    return [y * this.width / this.height, y];
  }

  ray(x, y) {
    const [right, up, back] = this.axes(), [wide, high] = this.spans();
    const across = (2 * x / this.width - 1) * wide, over = (1 - 2 * y / this.height) * high;
    return { origin: this.eye(), direction: normalize(subtract(add(scale(right, across), scale(up, over)), back)) };
  }

  // The pixel of a point, and its depth.
  project(point) {
    const [right, up, back] = this.axes(), [wide, high] = this.spans(), from = subtract(point, this.eye()), depth = -dot(from, back);
    return [(1 + dot(from, right) / depth / wide) * this.width / 2, (1 - dot(from, up) / depth / high) * this.height / 2, depth];
  }

  orbit(dx, dy) {
    this.turn = (this.turn - 0.4 * dx) % 360;
    this.tilt = clamp(this.tilt + 0.4 * dy, -MAX_TILT, MAX_TILT);
  }

  pan(dx, dy) {
    const [right, up] = this.axes(), size = 2 * this.spans()[1] * this.distance / this.height;
    this.target = add(this.target, add(scale(right, -dx * size), scale(up, dy * size)));
  }

  zoom(factor) { this.distance = clamp(this.distance * factor, 0.02, 50); }

  // Shows a ball.
  frame(centre, radius, turnTo = this.turn) {
    this.target = subtract(centre, this.shift);
    this.turn = turnTo;
    this.distance = clamp(1.05 * radius / Math.sin(HALF_VIEW), 0.02, 50);
  }
}
