/** A camera of this device: its newest pictures, and why there is none. */

import { canvasOf, make } from "./dom.js";

/** Longer side of the pictures that are kept, pixels. */
const LARGEST = 640;
/** How far back pictures are kept, and how many at least: cameras in the dark are slow. */
const KEPT_MS = 400;
const FEWEST = 6;
/**
 * Share of the time between two pictures by which one of them may come early or late: the clocks of
 * browsers jitter, while cameras take their pictures evenly.
 */
const SNAP = 0.5;

/** No camera; the message is for its user. */
export class CameraError extends Error {}

/** Explanations of browser errors. */
const REASONS = {
  NotAllowedError:
    "The camera was not allowed. Allow it for this page, in the address bar of the browser or in " +
    "the settings of the system, and start it again.",
  NotFoundError: "No camera was found. Connect one and start it again.",
  OverconstrainedError: "This camera is gone. Choose another one and start it again.",
  NotReadableError:
    "The camera does not start: another program may be using it. Close that and start it again.",
};
REASONS.SecurityError = REASONS.NotAllowedError;
REASONS.AbortError = REASONS.NotReadableError;

/**
 * @typedef {object} Shot
 * @property {number} takenMs when the picture was taken, by the clock of `performance.now()`
 * @property {HTMLCanvasElement} picture
 */

export class Camera {
  /**
   * @param {string} deviceId empty for any, that on the back of a phone if it has one
   * @returns {Promise<Camera>}
   */
  static async open(deviceId) {
    const { mediaDevices } = navigator;
    if (!mediaDevices) {
      throw new CameraError(
        `Browsers allow cameras only over https or on localhost, and ${location.origin} is neither. ` +
          "Serve Rollcast behind https, or run rollcast live 0 in a shell.",
      );
    }
    const which = deviceId
      ? { deviceId: { exact: deviceId } }
      : { facingMode: { ideal: "environment" } };
    const size = { width: { ideal: 640 }, height: { ideal: 480 }, frameRate: { ideal: 60 } };
    const stream = await mediaDevices
      .getUserMedia({ video: { ...which, ...size }, audio: false })
      .catch((error) => {
        throw new CameraError(REASONS[error.name] ?? `The camera does not start: ${error.message}`);
      });
    const video = make("video", { muted: true, playsInline: true, srcObject: stream });
    const camera = new Camera(stream, video);
    await video.play().catch((error) => {
      camera.close();
      throw new CameraError(`The picture of the camera does not play: ${error.message}`);
    });
    return camera;
  }

  /** @returns {Promise<{id: string, name: string}[]>} those of this device, once one was allowed */
  static async all() {
    const devices = (await navigator.mediaDevices?.enumerateDevices()) ?? [];
    return devices
      .filter(({ kind }) => kind === "videoinput")
      .map(({ deviceId, label }, index) => ({ id: deviceId, name: label || `Camera ${index + 1}` }));
  }

  constructor(stream, video) {
    this.stream = stream;
    this._video = video;
    /** @type {Shot[]} the oldest first */
    this._shots = [];
    this._isOpen = true;
  }

  get deviceId() {
    return this.stream.getVideoTracks()[0].getSettings().deviceId ?? "";
  }

  /** @returns {Shot | undefined} */
  get newest() {
    return this._shots.at(-1);
  }

  /** Seconds between two pictures: the median of late. */
  get intervalS() {
    const gaps = this._shots
      .slice(1)
      .map(({ takenMs }, index) => takenMs - this._shots[index].takenMs)
      .sort((a, b) => a - b);
    return gaps.length ? gaps[Math.floor(gaps.length / 2)] / 1000 : 1 / 30;
  }

  /**
   * Take every picture that comes.
   * @param {{taken: () => void, ended: () => void}} listener `ended` when the camera is unplugged
   */
  watch({ taken, ended }) {
    this.stream.getVideoTracks()[0].addEventListener("ended", ended);
    const video = this._video;
    const next = (now, metadata) => {
      if (!this._isOpen) return;
      this._keep(metadata?.captureTime ?? now);
      taken();
      ask();
    };
    // Firefox before 132 does not say when a picture comes.
    const ask = () =>
      "requestVideoFrameCallback" in video
        ? video.requestVideoFrameCallback(next)
        : requestAnimationFrame(next);
    ask();
  }

  _keep(takenMs) {
    const { videoWidth, videoHeight } = this._video;
    if (takenMs <= (this.newest?.takenMs ?? -Infinity)) return;
    const scale = Math.min(LARGEST / Math.max(videoWidth, videoHeight), 1);
    const [width, height] = [videoWidth, videoHeight].map((side) => Math.round(side * scale));
    // A telephone that is turned gives pictures of another size.
    if (this.newest?.picture.width !== width) this._shots = [];
    const isOld = (shot) => shot.takenMs < takenMs - KEPT_MS;
    const reused =
      this._shots.length > FEWEST && isOld(this._shots[0]) ? this._shots.shift().picture : null;
    const picture = reused ?? canvasOf(width, height);
    picture.getContext("2d").drawImage(this._video, 0, 0, width, height);
    this._shots.push({ takenMs, picture });
  }

  /**
   * The last moments as footage whose time runs backwards: the newest picture is at 0 s, so that
   * frames at even times end exactly with it.
   */
  backwards() {
    const shots = this._shots.toReversed();
    const [{ takenMs: newestMs, picture }] = shots;
    const intervalS = this.intervalS;
    const ages = shots.map((shot) => ({
      timeS: (newestMs - shot.takenMs) / 1000,
      picture: shot.picture,
    }));
    return {
      width: picture.width,
      height: picture.height,
      newestMs,
      snap: SNAP,
      intervalAt: async () => intervalS,
      shotAt: async (timeS) => {
        if (timeS > ages.at(-1).timeS + intervalS) return null;
        return ages.findLast((shot) => shot.timeS <= timeS + 1e-4) ?? null;
      },
    };
  }

  close() {
    this._isOpen = false;
    for (const track of this.stream.getTracks()) track.stop();
    this._video.srcObject = null;
  }
}
