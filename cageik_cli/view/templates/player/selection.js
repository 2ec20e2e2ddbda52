// What is under the pointer, and boxes drawn with it. Points are flat [x, y, z]; pixels are of the picture.
const REACH_PIXELS = 14, TOUCH_REACH_PIXELS = 28, SAME_PLACE_PIXELS = 4;
const CHOSEN_PAINT = [0.95, 0.5, 0.05, 1];
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };

// The nearest of things to the pointer by their pixels away at a depth, of those that are seen; of those about as near, the one
// in front; -1 for none.
function nearestOf(things, event, isSeen = (_) => true) {
  const reach = event?.pointerType === "touch" ? TOUCH_REACH_PIXELS : REACH_PIXELS;
  const near = things.filter(({ away, depth, k }) => away <= reach && depth > 0 && isSeen(k)), least = min(...near.map(({ away }) => away));
  return near.filter(({ away }) => away <= least + SAME_PLACE_PIXELS).sort((a, b) => a.depth - b.depth)[0]?.k ?? -1;
}

/** @param {Camera} camera @param {number[][]} points @param {number} x @param {number} y @param {PointerEvent} [event] @param {(k: number) => boolean} [isSeen] */
function nearestPoint(camera, points, x, y, event, isSeen) {
  return nearestOf(points.map((point, k) => {
    const [u, v, depth] = camera.project(point);
    return { k, away: hypot(u - x, v - y), depth };
  }), event, isSeen);
}

// The nearest of points that the model does not hide.
/** @param {Stage} stage @param {number[][]} points @param {number} x @param {number} y @param {PointerEvent} [event] */
function nearestSeen(stage, points, x, y, event) { return nearestPoint(stage.camera, points, x, y, event, (k) => stage.isSeen(points[k])); }

// The nearest of segments, each of two points.
/** @param {Camera} camera @param {number[][][]} segments @param {number} x @param {number} y @param {PointerEvent} [event] */
function nearestSegment(camera, segments, x, y, event) {
  return nearestOf(segments.map((ends, k) => {
    const [[u, v, near], [s, t, far]] = ends.map((end) => camera.project(end)), size = (s - u) ** 2 + (t - v) ** 2;
    const share = size ? clamp(((x - u) * (s - u) + (y - v) * (t - v)) / size, 0, 1) : 0;
    return { k, away: hypot(u + share * (s - u) - x, v + share * (t - v) - y), depth: min(near, far) > 0 ? near + share * (far - near) : 0 };
  }), event);
}

// The point of a ray on the plane through `start` that is parallel to the screen, or nearest to it on an axis.
function movePoint(camera, { origin, direction }, start, axis) {
  if (!axis) {
    const normal = camera.axes()[2];
    return add(origin, scale(direction, dot(minus(start, origin), normal) / dot(direction, normal)));
  }
  const away = minus(start, origin), along = dot(axis, direction), size = 1 - along * along;
  return size < 1e-6 ? start : add(start, scale(axis, (along * dot(direction, away) - dot(axis, away)) / size));
}

// How far a pointer at a pixel has moved what it grabbed: a function of the pixel where it is now.
/** @param {Camera} camera @param {number} x @param {number} y @param {number[]} start @param {number[]} [axis] */
function followPointer(camera, x, y, start, axis) {
  const placeOf = (u, v) => movePoint(camera, camera.ray(u, v), start, axis), from = placeOf(x, y);
  return (u, v) => minus(placeOf(u, v), from);
}

// A rectangle between two corners, in pixels.
class SelectionBox {
  constructor(camera, x, y) {
    this.camera = camera;
    this.from = this.to = [x, y];
  }

  // The numbers of those of some points that are in it.
  list(points) {
    return [...points.keys()].filter((k) => {
      const [x, y, depth] = this.camera.project(points[k]);
      return depth > 0 && [x, y].every((z, i) => z >= min(this.from[i], this.to[i]) && z <= max(this.from[i], this.to[i]));
    });
  }

  draw(renderer) {
    const [[x, y], [u, v]] = [this.from, this.to], corners = [[x, y], [u, y], [u, v], [x, v]].map((pixel) => this.camera.unproject(pixel));
    renderer.drawLines(corners.flatMap((corner, k) => [...corner, ...corners[(k + 1) % 4]]), CHOSEN_PAINT);
  }
}
