// The handles file (editing/handles/schema.json): the page edits its JSON, and saves it as it is.
const MAX_FILE_BYTES = 2e6, BARYCENTRIC_TOLERANCE = 1e-6;

const TRACKS = { offset: 1, target: 1 };

const listSets = (file) => file.sets ?? [file];

const motionOf = (handle) => ["offset", "target", "pin", "stay"].find((name) => name in handle);

// Reads the text of a file of JSON.
function parseFile(text, kind) {
  if (text.length > MAX_FILE_BYTES) refuse("file", `is too large for a ${kind} file`);
  return JSON.parse(text);
}

// Returns the text of a file: indented, or short if it then is too large to be read.
function writeFile(content) {
  const text = `${JSON.stringify(content, null, 2)}\n`;
  return new Blob([text]).size > MAX_FILE_BYTES ? `${JSON.stringify(content)}\n` : text;
}

// Reads a handles file; refuses what the page cannot show, and says why.
function readFile(text, clip) {
  const file = parseFile(text, "handles");
  if (Object(file) !== file || Array.isArray(file)) refuse("file", "is not a handles file; expected an object with handles");
  if (file.mirror && ![file.mirror.normal, file.mirror.point].every(isPoint)) refuse("mirror", "expected a normal and a point");
  if (file.locked && !(Array.isArray(file.locked) && file.locked.every((k) => isIndex(k, clip.arrays.cage.length / 3)))) refuse("locked", "expected cage vertices");
  const sets = listSets(file);
  if (!Array.isArray(sets) || !sets.length) refuse("sets", "expected a list of sets");
  sets.forEach((set, k) => checkSet(set, clip, sets.length > 1 ? `sets[${k}]: ` : ""));
  return file;
}

function checkSet(set, clip, where) {
  if (!Array.isArray(set?.handles) || !set.handles.length) refuse(`${where}handles`, "expected a list of handles");
  checkSpan(set, clip, where);
  if (!(set.hold === undefined || typeof set.hold === "boolean")) refuse(`${where}hold`, "expected true or false");
  const places = new Set();
  set.handles.forEach((handle, k) => {
    const at = `${where}handle ${JSON.stringify(handle?.name)}`, motion = handle && motionOf(handle);
    checkName(handle?.name, set.handles.slice(0, k), at);
    if ("screen" in handle || "position" in handle) refuse(at, "its place is on the screen or in space; the page needs a vertex or a face");
    const place = resolvePlace(handle, clip, at), key = place.corners.map((corner, k) => place.shares[k] ? corner : "").join();
    if (place.shares.includes(1) && places.has(key)) refuse(at, "another handle is at the same vertex");
    places.add(key);
    if ("radius" in handle && !(handle.radius > 0 && handle.radius <= 1e50)) refuse(`${at}: radius`, "expected a number above 0");
    if ("radius" in handle && set.hold === false) refuse(`${at}: radius`, "needs `hold`, which is false; remove one of them");
    if (!(handle.axes === undefined || ("offset" in handle && ["world", "surface"].includes(handle.axes)))) refuse(`${at}: axes`, 'expected "world" or "surface", of an offset');
    if (!(handle.weight === undefined || (handle.weight >= 1e-12 && handle.weight <= 1e12))) refuse(`${at}: weight`, "expected a number from 1e-12 to 1e12");
    if (!motion) refuse(at, "expected a target, an offset, a pin or stay");
    if (motion in TRACKS) checkTrack(handle[motion], clip, `${at}: ${motion}`);
  });
}

// Refuses frames that the clip does not have.
function checkSpan({ frames, falloff = 0, pick_frame }, clip, where) {
  if ((frames || pick_frame !== undefined) && !clip.isClip) refuse(`${where}frames`, "not possible for a single pose; remove it");
  if (frames && !(frames.length === 2 && frames.every((one) => clip.hasNumber(one)) && frames[0] <= frames[1])) refuse(`${where}frames`, `expected two frames from ${clip.ends.join(" to ")}`);
  if (!isIndex(falloff, Infinity)) refuse(`${where}falloff`, "expected a number of frames");
}

// Refuses what is neither three numbers nor keyframes of the clip.
function checkTrack(track, clip, where) {
  if (isPoint(track)) return;
  const keys = track?.frames, isKeyed = Array.isArray(keys) && keys.length && keys.length === track.values?.length && track.values.every(isPoint);
  if (!isKeyed || !clip.isClip || !keys.every((k, i) => clip.hasNumber(k) && (!i || k > keys[i - 1]))) refuse(where, "expected three numbers, or keyframes of the clip");
  if (!(track.ease === undefined || EASES.includes(track.ease))) refuse(`${where}: ease`, `expected one of ${EASES.join(", ")}`);
}

// The drawn vertices and shares of a handle's place.
/** @param {{ vertex?: number, face?: number, barycentric?: number[] }} place @param {Clip} clip @param {string} where */
function resolvePlace({ vertex, face, barycentric }, clip, where) {
  if (vertex !== undefined) {
    const drawn = clip.drawnVertex(vertex);
    checkNumber(vertex, clip.vertexCount, `${where}: vertex`, "vertex", "mesh");
    if (drawn < 0) refuse(`${where}: vertex`, `vertex ${vertex} is not among those that the page draws`);
    return { corners: [drawn, drawn, drawn], shares: [1, 0, 0] };
  }
  const { faces } = clip.arrays;
  if (clip.arrays.vertices) refuse(`${where}: face`, "the page draws fewer faces than the model has; give a vertex");
  checkNumber(face, faces.length / 3, `${where}: face`, "face", "mesh");
  if (!isPoint(barycentric)) refuse(`${where}: barycentric`, "expected three numbers");
  const sum = sumOf(barycentric);
  if (abs(sum - 1) > BARYCENTRIC_TOLERANCE || min(...barycentric) < -BARYCENTRIC_TOLERANCE) refuse(`${where}: barycentric`, "expected numbers of 0 or above with the sum 1");
  return { corners: pointOf(faces, face), shares: scale(barycentric, 1 / sum) };
}
