/** The last seconds of a stream, as a clip. */

/** Seconds that a clip has at least, once the camera has run for so long. */
export const LAST_S = 10;
const TYPES = ["video/webm", "video/mp4"];

/** Whether this browser records, and as what. */
export function clipType() {
  return typeof MediaRecorder === "function"
    ? TYPES.find((type) => MediaRecorder.isTypeSupported(type))
    : undefined;
}

/**
 * Two recordings that begin one after the other: a recording cannot lose its beginning, so the older
 * one is given up when the newer one is long enough.
 */
export class LastSeconds {
  /** @param {MediaStream} stream */
  constructor(stream) {
    this._stream = stream;
    this._laps = [];
    this._begin();
    this._timer = setInterval(() => this._begin(), LAST_S * 1000);
  }

  _begin() {
    if (this._laps.length === 2) this._laps.shift().recorder.stop();
    const recorder = new MediaRecorder(this._stream, {
      mimeType: clipType(),
      videoBitsPerSecond: 4e6,
    });
    const parts = [];
    recorder.addEventListener("dataavailable", ({ data }) => parts.push(data));
    recorder.start();
    this._laps.push({ recorder, parts });
  }

  /** End the older recording. @returns {Promise<File>} between LAST_S and twice as long */
  async take() {
    const { recorder, parts } = this._laps.shift();
    const stopped = new Promise((resolve) => recorder.addEventListener("stop", resolve));
    recorder.stop();
    await stopped;
    if (!this._laps.length && this._stream.active) this._begin();
    const type = clipType();
    const stamp = new Date().toISOString().slice(0, 19).replaceAll(":", "-");
    return new File(parts, `camera-${stamp}.${type.split("/")[1]}`, { type });
  }

  close() {
    clearInterval(this._timer);
    for (const { recorder } of this._laps.splice(0)) recorder.stop();
  }
}
