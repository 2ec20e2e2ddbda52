// Colours of vertices: a ramp of nine colours, and for each vertex a place on it, 0 to 1, or -1 if
// it is missing data. Parts of a model have a colour of the palette each.
const CLAY = "#e2d6c8", INPUT = "#cfd6dd", MOVED = "#e0792c";

const PALETTE = [CLAY, "#9dbbd8", "#e3bd7c", "#a9c8a0", "#d6a5b8", "#b9abd6", "#8fc4bf", "#dd9f86", "#c3c58f"];

const parseColour = (text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255);

const makeRamp = (colours) => Float32Array.from(colours.flatMap(parseColour));

const PLAIN = { clay: makeRamp(Array(9).fill(CLAY)), input: makeRamp(Array(9).fill(INPUT)), parts: makeRamp(PALETTE) };

class Colours {
  /** @param {Clip} clip */
  constructor(clip) {
    this.clip = clip;
    this.ramp = makeRamp(clip.colours);
    this.movedRamp = makeRamp([...Array(8).fill(CLAY), MOVED]);
    this.missing = parseColour(clip.missing);
    this.values = new Float32Array(clip.arrays.lack.length / 3);
    this.parts = clip.parts.length ? listOwners(clip).map((part) => part % PALETTE.length) : null;
  }

  // Fills `values` for a mode and a frame; returns the ramp, and what its scale says, if any.
  choose(mode, frame, moved) {
    const { clip, values } = this, { arrays } = clip;
    values.fill(0);
    if (mode === "base" && arrays.tints) return { ramp: PLAIN.clay, isTinted: true };
    if (mode === "rms" && clip.rms) {
      const factor = clip.rms.top / 65534 / clip.rms.end;
      for (let j = 0; j < values.length; j++) values[j] = arrays.rms[j] * factor;
      return this.markMissing(clip.rms.end);
    }
    if (mode === "frame" && clip.held.has(frame)) {
      const errors = clip.errors(frame), m = values.length, factor = 100 * clip.heldStep / clip.deviationEnd;
      for (let j = 0; j < m; j++) values[j] = factor * hypot(errors[j], errors[m + j], errors[2 * m + j]);
      return this.markMissing(clip.deviationEnd);
    }
    if (moved) {
      values.set(moved);
      return { ramp: this.movedRamp };
    }
    if (!this.parts) return { ramp: PLAIN.clay };
    for (let j = 0; j < values.length; j++) values[j] = this.parts[j] / (PALETTE.length - 1);
    return { ramp: PLAIN.parts };
  }

  // Marks what is missing data; returns the ramp of errors up to `end`.
  markMissing(end) {
    this.clip.arrays.rms?.forEach((level, j) => { if (level === 65535) this.values[j] = -1; });
    return { ramp: this.ramp, end };
  }
}
