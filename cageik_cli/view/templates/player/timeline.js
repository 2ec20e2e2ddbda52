// The bar of time: the frames and keys of edits. Errors of frames are part of the page (view/player/section.py).
class Timeline {
  /** @param {Stage} stage */
  constructor(stage) {
    const { clip } = stage, bubble = stage.find("bubble"), slider = stage.find("time");
    Object.assign(this, { strip: stage.find("strip"), ends: clip.ends, marks: {} });
    // The number of the frame below the pointer.
    on(slider, "pointermove", ({ clientX }) => {
      const { left, width } = this.strip.getBoundingClientRect(), frame = clamp(round((clientX - left) / width * (clip.count - 1)), 0, clip.count - 1);
      bubble.textContent = clip.numberOf(frame);
      bubble.style.left = `${100 * frame / (clip.count - 1 || 1)}%`;
      bubble.hidden = false;
    });
    for (const kind of ["pointerleave", "pointercancel"]) on(slider, kind, () => { bubble.hidden = true; });
  }

  // Draws where an edit of some kind holds: its first and last frame, the frames over which it fades,
  // and its keys, all as numbers of frames. Without a range nothing is drawn.
  mark(kind, { range = null, falloff = 0, keys = [] } = {}) {
    const state = JSON.stringify([range, falloff, keys]);
    if (this.marks[kind]?.state === state) return;
    this.marks[kind] = { state, range, falloff, keys };
    this.show();
  }

  show() {
    const { ends } = this, percent = (number) => 100 * (clamp(number, ...ends) - ends[0]) / (ends[1] - ends[0] || 1);
    const make = (className, from, to = from) => {
      const mark = makeElement("i", { className });
      mark.style.left = `${percent(from)}%`;
      if (to !== from) mark.style.width = `${percent(to) - percent(from)}%`;
      return mark;
    };
    this.strip.replaceChildren(...Object.values(this.marks).flatMap(({ range, falloff, keys }) => range
      ? [make("fade", range[0] - falloff, range[1] + falloff), make("full", ...range), ...keys.map((number) => make("key", number))] : []));
  }
}
