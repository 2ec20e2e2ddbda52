// A camera that looks at a point from a distance, `turn` degrees right of the front and `tilt` above it.
const DEGREE = Math.PI / 180, HALF_VIEW = 15 * DEGREE, MAX_TILT = 90;
const UPRIGHT = { Y: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], Z: [[1, 0, 0], [0, 0, 1], [0, -1, 0]] };

class Camera {
  constructor(up) {
    Object.assign(this, { upright: UPRIGHT[up], shift: [0, 0, 0] });
  }

  // Right, up and backward of the picture, as rows.
  axes() {
    const t = this.turn * DEGREE, u = this.tilt * DEGREE;
    const c = cos(t), s = sin(t), d = cos(u), e = sin(u);
    const rows = [[c, 0, -s], [-e * s, d, -e * c], [d * s, e, d * c]];
    return rows.map((row) => turn(row, this.upright.flat()));
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
    return { origin: this.eye(), direction: normalize(minus(add(scale(right, across), scale(up, over)), back)) };
  }

  // A point in front of the camera that is seen at a pixel.
  /** @param {number[]} pixel */
  unproject([x, y]) {
    const { origin, direction } = this.ray(x, y);
    return add(origin, scale(direction, this.distance));
  }

  // The pixel of a point, and its depth.
  project(point) {
    const [right, up, back] = this.axes(), [wide, high] = this.spans(), from = minus(point, this.eye()), depth = -dot(from, back);
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

  // Looks along a direction of the world.
  face(direction) {
    const [x, y, z] = this.upright.map((row) => dot(row, direction));
    this.tilt = Math.asin(clamp(y, -1, 1)) / DEGREE;
    // From above and below, the front stays at the foot of the picture.
    this.turn = hypot(x, z) > 1e-6 ? Math.atan2(x, z) / DEGREE : 0;
  }

  // Goes to where points fill the picture, all but margins in pixels.
  fit(points, { top, bottom, side }) {
    const [right, up, back] = this.axes(), [wide, high] = this.spans();
    const across = wide * (1 - 2 * side / this.width), above = high * (1 - 2 * top / this.height), below = high * (1 - 2 * bottom / this.height);
    const most = [-Infinity, -Infinity, -Infinity, -Infinity], depths = [Infinity, -Infinity];
    for (let k = 0; k < points.length; k += 3) {
      const p = [points[k], points[k + 1], points[k + 2]], [x, y, z] = [dot(right, p), dot(up, p), dot(back, p)];
      [x + across * z, across * z - x, y + above * z, below * z - y].forEach((value, i) => { if (value > most[i]) most[i] = value; });
      depths[0] = min(depths[0], z); depths[1] = max(depths[1], z);
    }
    // A point at x, z is in the picture from an eye at c, d if |x - c| is at most the span times d - z.
    const eye = max((most[0] + most[1]) / (2 * across), (most[2] + most[3]) / (above + below), depths[1] + 0.02);
    const middle = (depths[0] + depths[1]) / 2, over = (most[2] - above * eye + below * eye - most[3]) / 2;
    const place = add(add(scale(right, (most[0] - most[1]) / 2), scale(up, over)), scale(back, middle));
    this.target = minus(place, this.shift);
    this.distance = clamp(eye - middle, 0.02, 50);
  }

  // Shows a ball.
  frame(centre, radius, turnTo = this.turn) {
    this.target = minus(centre, this.shift);
    this.turn = turnTo;
    this.distance = clamp(1.05 * radius / sin(HALF_VIEW), 0.02, 50);
  }
}
