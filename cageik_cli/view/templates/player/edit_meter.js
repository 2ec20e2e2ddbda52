// What an edit does to the mesh, frame by frame, as editing/summary.py measures it: volume, largest move, share that moves.
// Frames are measured while the page has nothing else to do; of many, some evenly.
const MIN_MOTION = 0.005, MAX_VOLUME_PERCENT = 5, MEASURED_FRAMES = 60, SLOW_FRAMES = 12, SLICE_MILLISECONDS = 12;

class EditMeter {
  /** @param {Stage} stage */
  constructor(stage) {
    const { clip, skin } = stage, edges = new Map();
    Object.assign(this, { stage, found: new Map(), waiting: [], before: new Float32Array(3 * skin.count), after: new Float32Array(3 * skin.count) });
    const { faces } = clip.arrays;
    for (let f = 0; f < faces.length; f += 3) for (let i = 0; i < 3; i++) {
      const a = faces[f + i], b = faces[f + (i + 1) % 3], key = min(a, b) * skin.count + max(a, b);
      edges.set(key, (edges.get(key) ?? 0) + (a < b ? 1 : -1));
    }
    // Only a closed surface has a volume.
    this.isClosed = faces.length > 0 && [...edges.values()].every((count) => count === 0);
    this.used = new Set(faces.length ? faces : listOf(skin.count, (k) => k));
  }

  // Begins anew; frames that an edit does not change need no measure.
  start() {
    const { clip, editor } = this.stage, all = listOf(clip.count, (frame) => frame).filter((frame) => editor.isActive(frame));
    // Rounds of rotations take long, and a page that waits for them does not answer.
    const count = min(editor.cost > SLICE_MILLISECONDS ? SLOW_FRAMES : MEASURED_FRAMES, all.length);
    this.found = new Map();
    this.waiting = listOf(count, (k) => all[count > 1 ? round(k * (all.length - 1) / (count - 1)) : 0]);
    if (!this.timer && count) this.timer = setTimeout(() => this.proceed());
  }

  proceed() {
    const end = performance.now() + SLICE_MILLISECONDS;
    this.timer = 0;
    if (this.stage.editor.isDragging) return;
    while (this.waiting.length && performance.now() < end) {
      const frame = this.waiting.shift();
      this.found.set(frame, this.measure(frame));
    }
    if (this.waiting.length) this.timer = setTimeout(() => this.proceed());
    else this.stage.request();
  }

  measure(frame) {
    const { clip, skin, editor } = this.stage, rotation = clip.rotation(frame), { before, after } = this;
    skin.deform(clip.cage(frame), rotation, before);
    skin.deform(editor.cageAt(frame), rotation, after);
    let most = 0, count = 0;
    for (const k of this.used) {
      const away = hypot(after[3 * k] - before[3 * k], after[3 * k + 1] - before[3 * k + 1], after[3 * k + 2] - before[3 * k + 2]);
      most = max(most, away);
      if (away > MIN_MOTION) count++;
    }
    const volume = this.isClosed ? 100 * (this.sumVolume(after) / this.sumVolume(before) - 1) : null;
    return { frame, most, share: 100 * count / this.used.size, volume };
  }

  sumVolume(p) {
    const { faces } = this.stage.clip.arrays;
    let sum = 0;
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      sum += p[a] * (p[b + 1] * p[c + 2] - p[b + 2] * p[c + 1]) + p[a + 1] * (p[b + 2] * p[c] - p[b] * p[c + 2]) + p[a + 2] * (p[b] * p[c + 1] - p[b + 1] * p[c]);
    }
    return sum / 6;
  }

  // The largest of all frames, once they are measured.
  get worst() {
    const all = [...this.found.values()];
    if (this.waiting.length || !all.length) return null;
    const largest = (size) => all.reduce((one, other) => size(other) > size(one) ? other : one);
    return { moved: largest(({ most }) => most), shared: largest(({ share }) => share), changed: this.isClosed ? largest(({ volume }) => abs(volume)) : null };
  }
}

const signed = (x) => `${x < 0 ? "−" : "+"}${abs(x).toFixed(1)}`;

// Says what the edit does, and where most; marks it in the bar of time.
function showMeter(stage, meter) {
  const { clip, section } = stage, { worst } = meter, at = (one) => clip.isClip ? ` in frame ${clip.numberOf(one.frame)}` : "";
  const bars = section.querySelector("[data-edited]"), top = worst?.moved.most || 1;
  const path = !worst ? "" : [...meter.found.values()].map(({ frame, most }) => `M${frame - 0.5} 1V${(1 - most / top).toFixed(3)}H${frame + 0.5}V1z`).join("");
  if (bars.getAttribute("d") !== path) bars.setAttribute("d", path);
  const volume = worst?.changed ? `; volume ${signed(worst.changed.volume)} %${at(worst.changed)}` : "";
  for (const line of section.querySelectorAll("[data-measured]")) {
    const text = worst?.moved.most ? `${worst.shared.share.toFixed(1)} % of the mesh moves${at(worst.shared)}, at most ${ROUND(worst.moved.most * clip.diagonal)}${at(worst.moved)}${volume}.` : "";
    if (line.textContent !== text) line.textContent = text;
  }
  const isWrong = worst?.changed && abs(worst.changed.volume) > MAX_VOLUME_PERCENT;
  for (const button of section.querySelectorAll("[data-volume]")) {
    button.hidden = !isWrong;
    if (isWrong) button.textContent = `Volume ${signed(worst.changed.volume)} %, show it${at(worst.changed)}`;
  }
}

extensions.push((stage) => {
  const { editor } = stage;
  if (!editor) return;
  const meter = stage.meter = new EditMeter(stage);
  for (const button of stage.section.querySelectorAll("[data-volume]")) on(button, "click", () => stage.transport.go(meter.worst.changed.frame));
  stage.listeners.push(() => {
    if (editor.isDragging || (editor.cages === meter.cages && (meter.timer || !meter.waiting.length))) { showMeter(stage, meter); return; }
    meter.cages = editor.cages;
    meter.start();
  });
});
