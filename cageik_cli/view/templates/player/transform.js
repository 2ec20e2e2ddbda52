// What is chosen is moved, turned or scaled by the pointer, by keys and by typed numbers, until it is kept or put back.
const AXIS_PAINTS = { x: [0.84, 0.19, 0.19, 1], y: [0.13, 0.55, 0.13, 1], z: [0.16, 0.36, 0.9, 1] };
const TRANSFORM_KEYS = { g: "Move", r: "Rotate", s: "Scale" }, TRANSFORM_GREY = [0.5, 0.5, 0.5, 0.8];

// Turns a vector around an axis of length one, counterclockwise as seen from its tip.
function turnAround(vector, axis, angle) {
  return add(add(scale(vector, cos(angle)), scale(cross(axis, vector), sin(angle))), scale(axis, dot(axis, vector) * (1 - cos(angle))));
}

class Transform {
  // `kind` is a key of `TRANSFORM_KEYS`; `apply` puts what is displaced where it goes, `end` keeps that, or puts it back.
  // Without a pixel `start` it begins where the pointer is seen first. `resize` changes how far others move along.
  /** @param {Stage} stage @param {any} values */
  constructor(stage, values) {
    Object.assign(this, { stage, axis: "", start: null, typed: "", angle: 0, isBegun: false, isOver: false, ...values });
    this.at = this.start;
  }

  // The pointer is at a pixel.
  move(x, y) {
    if (this.isOver) return;
    const [u, v] = this.stage.camera.project(this.pivot), [p, q] = this.at ?? [x, y];
    this.start ??= [x, y];
    this.at = [x, y];
    // Whole turns count, so that steps are added.
    const step = Math.atan2(q - v, p - u) - Math.atan2(y - v, x - u);
    this.angle += Math.atan2(sin(step), cos(step));
    this.update();
  }

  update() {
    this.isBegun ||= Boolean(this.start || this.typed);
    if (this.isBegun) this.apply(this);
  }

  // How far it moves, in the file's units along an axis, degrees or a factor, as typed; NaN without a number.
  get number() { return this.typed === "" || this.typed === "-" ? NaN : Number(this.typed); }

  get moved() {
    const { camera, clip } = this.stage, { number, axis, start, at } = this;
    if (number === number) return scale(AXES[axis || "x"], number / clip.diagonal);
    return start ? followPointer(camera, start[0], start[1], this.pivot, AXES[axis])(at[0], at[1]) : [0, 0, 0];
  }

  get turned() {
    const back = this.stage.camera.axes()[2], axis = AXES[this.axis], { number } = this;
    if (number === number) return { axis: axis ?? back, angle: number * DEGREE };
    return { axis: axis ?? back, angle: axis && dot(axis, back) < 0 ? -this.angle : this.angle };
  }

  get factor() {
    const [u, v] = this.stage.camera.project(this.pivot), { number, start, at } = this, reach = (pixel) => hypot(pixel[0] - u, pixel[1] - v);
    return number === number ? number : start ? reach(at) / (reach(start) || 1) : 1;
  }

  // How a point goes that moves by a share.
  displace(point, share) {
    const { kind, pivot } = this, from = minus(point, pivot);
    if (kind === "g") return scale(this.moved, share);
    if (kind === "r") {
      const { axis, angle } = this.turned;
      return minus(turnAround(from, axis, share * angle), from);
    }
    const axis = AXES[this.axis];
    return scale(axis ? scale(axis, dot(axis, from)) : from, share * (this.factor - 1));
  }

  // A key; whether it was taken.
  press(event) {
    const key = event.key.toLowerCase(), { typed } = this;
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    if (AXES[key]) this.axis = this.axis === key ? "" : key;
    else if (TRANSFORM_KEYS[key] && this.kinds.includes(key)) this.kind = key;
    else if (/^\d$/.test(key) || (key === "." && !typed.includes("."))) this.typed += key;
    else if (key === "-") this.typed = typed[0] === "-" ? typed.slice(1) : `-${typed}`;
    else if (key === "backspace") this.typed = typed.slice(0, -1);
    else if (key === "pageup" || key === "pagedown") return this.reach(key === "pageup" ? 1.1 : 1 / 1.1);
    else if (key === "enter" || key === "escape") { this.finish(key === "enter"); return true; }
    else return false;
    this.update();
    return true;
  }

  // Others move along from farther or nearer; whether any do.
  reach(factor) {
    if (!this.resize?.(factor)) return false;
    this.update();
    return true;
  }

  finish(isKept) {
    if (this.isOver) return;
    this.isOver = true;
    this.end(isKept);
  }

  // What it does, in words.
  get text() {
    const { kind, axis, typed, stage: { clip } } = this, along = axis ? ` ${kind === "r" ? "around" : "along"} ${axis}` : "";
    const found = ROUND3(kind === "g" ? norm(this.moved) * clip.diagonal : kind === "r" ? this.turned.angle / DEGREE : this.factor);
    return `${TRANSFORM_KEYS[kind]}${along}: ${typed ? typed + "_" : found}${kind === "r" && !typed ? "°" : ""}`;
  }

  draw(renderer) {
    const { camera } = this.stage, { axis, pivot, kind, at } = this, reach = scale(AXES[axis] ?? [0, 0, 0], 2 * camera.distance);
    if (axis) renderer.drawLines([...minus(pivot, reach), ...add(pivot, reach)], AXIS_PAINTS[axis]);
    if (kind !== "g" && at) renderer.drawLines([...pivot, ...camera.unproject(at)], TRANSFORM_GREY);
  }
}

const ROUND3 = (x) => Number(x.toPrecision(3));
