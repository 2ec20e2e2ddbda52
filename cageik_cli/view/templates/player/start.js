// Unpacks the page's data and starts the player; without WebGL2 the still pictures are shown.
/** @param {any} section */
async function startPlayer(section) {
  let stage;
  try {
    stage = new Stage(section, await unpackPayload(document.getElementById("player-data").textContent));
  } catch (error) {
    showStill(section, error);
    return null;
  }
  const { canvas } = stage, modes = stage.modes = new Modes(stage);
  stage.timeline = new Timeline(stage);
  makeLook(stage);
  if (stage.find('panel="pose"')) {
    makeHandles(stage);
    makeCageMode(stage);
    makeInfluence(stage);
  }
  listenToPointers(stage);
  makeControls(stage);
  makeTips(stage);
  makeAxes(stage);
  makeParts(stage);
  for (const extend of extensions) extend(stage);
  modes.choose(section.dataset.mode);
  stage.reset();
  on(canvas, "webglcontextlost", () => showStill(section, new Error("the graphics card was lost; load the page again")));
  on(DARK, "change", () => stage.request());
  section.classList.add("ready");
  await new Promise((done) => { stage.listeners.push(done); stage.request(true); });
  return stage;
}

function showStill(section, { message }) {
  section.classList.add("still");
  const figure = section.querySelector("[data-still]"), picture = document.querySelector("#poses .pose:nth-of-type(2) img:last-of-type, #poses img");
  figure.querySelector("[data-why]").textContent = message;
  if (picture) {
    figure.prepend(picture.cloneNode());
    figure.querySelector("[data-advice]").textContent = "The pictures on this page show the same model.";
  }
  figure.hidden = false;
}

// What tests and other scripts can ask: the positions that are drawn, in the units of the file.
for (const section of document.querySelectorAll("[data-player]")) {
  window.cageikPlayer = startPlayer(section).then((stage) => stage && { stage, positions: () => listPoints(stage.positions).map((point) => stage.clip.toFile(point)) });
}
