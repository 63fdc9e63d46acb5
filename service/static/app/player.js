/** The clock: which frame is shown, and how it goes on by itself. */

import { FRAME_RATE_HZ, LAST_SEEN } from "./state.js";

/** The four seen frames stand still for a while each: they are what a forecast is made from. */
const SEEN_FRAME_MS = 280;

export class Player {
  /** @param {(index: number) => void} show called whenever the frame or the motion changes */
  constructor(show) {
    this._show = show;
    this.index = 0;
    this.playing = false;
    /** Index of the last frame that will ever be there. */
    this.last = LAST_SEEN;
    /** Index of the last frame whose forecast has come; the clock waits for it. */
    this.arrived = LAST_SEEN;
    this.framesPerSecond = FRAME_RATE_HZ;
    this.speed = 1;
  }

  /** @param {number} index */
  seek(index) {
    this.index = Math.min(Math.max(Math.round(index), 0), this.last);
    this._begun = performance.now();
    this._show(this.index);
  }

  step(frames) {
    this.pause();
    this.seek(this.index + frames);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.index >= this.last) this.index = 0;
    this.playing = true;
    this._begun = performance.now();
    this._show(this.index);
    this._request();
  }

  pause() {
    this.playing = false;
    cancelAnimationFrame(this._frame);
    this._show(this.index);
  }

  _request() {
    cancelAnimationFrame(this._frame);
    this._frame = requestAnimationFrame((now) => this._tick(now));
  }

  _tick(now) {
    if (!this.playing) return;
    const hold = () =>
      this.index < LAST_SEEN ? SEEN_FRAME_MS : 1000 / (this.framesPerSecond * this.speed);
    const before = this.index;
    while (this.index < this.last && now - this._begun >= hold()) {
      if (this.index >= Math.max(this.arrived, LAST_SEEN)) {
        this._begun = now;
        break;
      }
      this._begun += hold();
      this.index += 1;
    }
    if (this.index >= this.last) this.pause();
    else {
      if (this.index !== before) this._show(this.index);
      this._request();
    }
  }
}
