// The axes in the corner: a click looks along one of them, a second click from the other side.
// Directions of the world that the front, the side and the top are seen along, as rows of `upright`.
const FRONT = 2, SIDE = 0, TOP = 1;

function faceTwice(camera, direction) {
  const isThere = dot(camera.axes()[2], direction) > 1 - 1e-6;
  camera.face(isThere ? scale(direction, -1) : direction);
}

/** @param {Stage} stage */
function makeAxes(stage) {
  const { camera } = stage;
  const marks = Object.entries(AXES).map(([name, axis]) => {
    const [line, ...balls] = stage.find("axes").querySelectorAll(`.${name}`);
    balls.forEach((ball, k) => on(ball, "click", () => { faceTwice(camera, scale(axis, 1 - 2 * k)); stage.request(); }));
    return { axis, line, balls };
  });
  stage.listeners.push(() => {
    const [right, up, back] = camera.axes(), reach = stage.isNarrow ? 36 : 26;
    for (const { axis, line, balls } of marks) {
      const [x, y, z] = [reach * dot(right, axis), -reach * dot(up, axis), dot(back, axis)];
      balls.forEach((ball, k) => {
        const sign = 1 - 2 * k;
        Object.assign(ball.style, { transform: `translate(${sign * x}px, ${sign * y}px)`, zIndex: round(5 + 4 * sign * z) });
      });
      Object.assign(line.style, { width: `${hypot(x, y)}px`, transform: `rotate(${Math.atan2(y, x)}rad)` });
    }
  });
}
