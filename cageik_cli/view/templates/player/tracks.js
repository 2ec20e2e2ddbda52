// Values over the numbers of frames, as editing/handles/model.py and schedule.py have them.

const EASES = ["smooth", "linear", "stepped"];

// A value, or keyframes: the monotone cubic of Fritsch and Butland 1984, straight lines or steps, constant beyond the keys.
function evaluateTrack(track, frame) {
  if (Array.isArray(track)) return track;
  const { frames, values, ease } = track, last = frames.length - 1, x = clamp(frame, frames[0], frames[last]);
  if (!last) return values[0];
  const before = max(0, frames.findLastIndex((one) => one <= x)), k = min(last - 1, before);
  const step = frames[k + 1] - frames[k], t = (x - frames[k]) / step;
  if (ease === "stepped") return values[before];
  if (ease === "linear") return values[k].map((y, axis) => y + t * (values[k + 1][axis] - y));
  return values[0].map((_, axis) => {
    const y = values.map((one) => one[axis]), a = slopeAt(frames, y, k), b = slopeAt(frames, y, k + 1);
    return y[k] * (1 + 2 * t) * (1 - t) ** 2 + y[k + 1] * t * t * (3 - 2 * t) + step * t * (1 - t) * (a * (1 - t) - b * t);
  });
}

function slopeAt(x, y, k) {
  const last = x.length - 1, width = (i) => x[i + 1] - x[i], rise = (i) => (y[i + 1] - y[i]) / width(i);
  if (last === 1) return rise(0);
  if (k > 0 && k < last) {
    const [m, p] = [rise(k - 1), rise(k)];
    if (m * p <= 0) return 0;
    const a = 2 * width(k) + width(k - 1), b = width(k) + 2 * width(k - 1);
    return (a + b) / (a / m + b / p);
  }
  const [i, j] = k ? [last - 1, last - 2] : [0, 1], near = rise(i), next = rise(j);
  const slope = ((2 * width(i) + width(j)) * near - width(i) * next) / (width(i) + width(j));
  if (slope * near <= 0) return 0;
  return near * next <= 0 && abs(slope) > 3 * abs(near) ? 3 * near : slope;
}

// The strength of a set of handles in a frame, from 0 to 1.
function blendSet({ frames, falloff = 0 }, frame) {
  if (!frames) return 1;
  const off = max(frames[0] - frame, frame - frames[1], 0), x = falloff ? clamp(1 - off / falloff, 0, 1) : Number(off === 0);
  return x ** 3 * (x * (6 * x - 15) + 10);
}

// The strength of a set or an edit, which has to have one in a frame.
const MIN_STRENGTH = 0.05;

function needStrength(set, frame) {
  const strength = blendSet(set, frame);
  if (strength < MIN_STRENGTH) refuse(set.name ?? "the edit", "has no strength in this frame; go to one between its first and last");
  return strength;
}

// A point with as many digits as files of edits have.
const shortenPoint = (point) => Array.from(point, (x) => Number(x.toPrecision(9)));

// Sets the value of a track in a frame: of its key there, which is added, or of all frames.
function setValue(track, frame, value) {
  if (Array.isArray(track)) return value;
  const at = track.frames.findIndex((one) => one >= frame), place = at < 0 ? track.frames.length : at;
  const isThere = track.frames[place] === frame;
  track.frames.splice(place, Number(isThere), frame);
  track.values.splice(place, Number(isThere), value);
  return track;
}

// A track with a key of its value in a frame.
function setKey(track, frame) {
  const now = [...evaluateTrack(track, frame)];
  return setValue(Array.isArray(track) ? { frames: [], values: [] } : track, frame, now);
}

// A track without its key in a frame; without the last, it is the same in all frames.
function removeKey(track, frame) {
  const at = track.frames?.indexOf(frame) ?? -1;
  if (at < 0) return track;
  if (track.frames.length === 1) return track.values[0];
  for (const list of [track.frames, track.values]) list.splice(at, 1);
  return track;
}
