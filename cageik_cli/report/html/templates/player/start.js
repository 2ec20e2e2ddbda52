// Unpacks the page's data and starts the player; without WebGL2 the still pictures are shown.
async function startPlayer(section) {
  const canvas = section.querySelector("canvas");
  let stage;
  try {
    const payload = await unpackPayload(document.getElementById("player-data").textContent);
    stage = new Stage(canvas, payload);
  } catch (error) {
    showStill(section, error);
    return null;
  }
  listenToPointers(canvas, {
    orbit: (dx, dy) => { stage.camera.orbit(dx, dy); stage.request(); },
    pan: (dx, dy) => { stage.camera.pan(dx, dy); stage.request(); },
    zoom: (factor) => { stage.camera.zoom(factor); stage.request(); },
    ...makeHandles(section, stage),
  });
  makeControls(section, stage);
  makeParts(section, stage);
  for (const extend of extensions) extend(section, stage);
  listenTo(canvas, "webglcontextlost", () => showStill(section, new Error("the graphics card was lost; load the page again")));
  listenTo(matchMedia("(prefers-color-scheme: dark)"), "change", () => stage.request());
  section.classList.add("ready");
  await new Promise((done) => { stage.listeners.push(done); stage.request(true); });
  return stage;
}

function showStill(section, error) {
  section.classList.add("still");
  const figure = section.querySelector("[data-still]");
  const picture = document.querySelector("#poses .pose:nth-of-type(2) img:last-of-type, #poses img");
  if (picture) figure.prepend(picture.cloneNode());
  const advice = picture ? "The pictures on this page show the same model." : "Open the page in another browser.";
  figure.querySelector("figcaption").textContent = `The player needs WebGL2, which this browser does not offer (${error.message}). ${advice}`;
  figure.hidden = false;
}

// What tests and other scripts can ask: the positions that are drawn, in the units of the file.
function makeHook(stage) {
  return {
    stage,
    get frame() { return stage.transport.frame; },
    positions: () => listOf(stage.positions.length / 3, (j) => stage.clip.toFile(pointOf(stage.positions, j))),
    timings: stage.timings,
  };
}

for (const section of document.querySelectorAll("[data-player]")) {
  window.cageikPlayer = startPlayer(section).then((stage) => stage && makeHook(stage));
}
