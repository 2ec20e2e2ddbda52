// Time: which moment of the clip is shown, and how it goes on.
class Transport {
  constructor(count, fps) {
    Object.assign(this, { count, fps, time: 0, isPlaying: false, speed: 1, loop: true, smooth: true, last: null });
  }

  // Goes on to the moment `now`, in milliseconds.
  advance(now) {
    const passed = this.last === null ? 0 : min(now - this.last, 500) / 1000;
    this.last = now;
    const end = this.loop ? this.count : this.count - 1;
    this.time += passed * this.fps * this.speed;
    if (this.time < end) return;
    if (this.loop) this.time %= this.count;
    else { this.time = this.count - 1; this.isPlaying = false; }
  }

  play(isPlaying) {
    if (isPlaying && !this.loop && this.time >= this.count - 1) this.time = 0;
    this.isPlaying = isPlaying && this.count > 1;
    this.last = null;
    if (!this.isPlaying) this.time = this.frame;
  }

  go(frame) { this.time = clamp(round(frame), 0, this.count - 1); }

  get frame() { return min(floor(this.time), this.count - 1); }

  // The share of the next frame; the last frame of a loop is not blended with the first.
  get share() { return this.isPlaying && this.smooth && this.frame < this.count - 1 ? this.time - this.frame : 0; }
}
