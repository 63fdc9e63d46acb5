/** Forecasts over the running picture of a camera: the newest four frames, again and again. */

import { LostService, predict, ServiceProblem } from "./api.js";
import { Camera, CameraError } from "./camera.js";
import { centred } from "./crop.js";
import { byId, make } from "./dom.js";
import { drawLive } from "./draw.js";
import { save } from "./export.js";
import { cut } from "./footage.js";
import { clipType, LastSeconds } from "./last_seconds.js";
import { trainedSteps } from "./models.js";
import { framesOf } from "./resample.js";
import { formOf, pause } from "./session.js";
import { LAST_SEEN, SEEN } from "./state.js";

const JPEG_QUALITY = 0.92;
/** How long to wait before the service is asked again when it did not answer. */
const RETRY_S = 2;
/** Statuses that say "too much at once", and those that another frame does not change. */
const OVERLOADED = [429, 503];
const FINAL = [401, 403];
/** Share of the model's rate below which the camera is too slow. */
const SLOW = 0.55;

/**
 * @typedef {object} Wanted options of requests
 * @property {object} fields of a PredictRequest besides frames and rate
 * @property {number} rate frames a second that the model knows
 * @property {[number, number] | null} toldRates lowest and highest rate that it is told
 * @property {boolean} isWhole whether it reads whole pictures
 * @property {boolean} ellipses
 */

export class Live {
  /**
   * @param {{canvas: () => HTMLCanvasElement, wanted: () => Wanted, entries: () => object[],
   *   changed: () => void, clip: (file: File) => void}} listener `clip` takes what was recorded
   */
  constructor(listener) {
    this._listener = listener;
    this._camera = null;
    /** The forecast over the picture, as a list like that of a session. */
    this.forecasts = [];
    byId("camera-start").addEventListener("click", () => this.start());
    byId("camera-stop").addEventListener("click", () => this.stop());
    byId("camera-save").addEventListener("click", () => this._take((clip) => save(clip, clip.name)));
    byId("camera-use").addEventListener("click", () => this._take(listener.clip));
    byId("camera-device").addEventListener("change", () => {
      if (this._camera) this.start();
    });
  }

  /** Open the camera and forecast until it is stopped. */
  async start() {
    this._close();
    const mine = (this._ended = new AbortController());
    this._say("Opening the camera …");
    try {
      const camera = await Camera.open(byId("camera-device").value);
      if (mine.signal.aborted) return camera.close();
      this._camera = camera;
      this._crop = null;
      camera.watch({
        taken: () => this._draw(),
        ended: () => this._fail(new CameraError("The camera was disconnected.")),
      });
      this._recorded = clipType() ? new LastSeconds(camera.stream) : null;
      this._say("");
      this._show(true);
      await this._offerOthers();
      await this._run(camera, mine.signal);
    } catch (error) {
      if (error.name !== "AbortError" && !mine.signal.aborted) this._fail(error);
    }
  }

  /** Release the camera. */
  stop() {
    this._close();
    this._say("");
    this._show(false);
  }

  _fail(error) {
    this._close();
    this._say(error.message, true);
    this._show(false);
    if (!(error instanceof CameraError)) console.error(error);
  }

  _close() {
    this._ended?.abort();
    this._recorded?.close();
    this._camera?.close();
    this._camera = this._recorded = null;
    this.forecasts = [];
  }

  /** Ask for a forecast of the newest frames; when it has come, for the next one. */
  async _run(camera, signal) {
    let shownMs = -Infinity;
    while (!signal.aborted) {
      if (!(camera.newest?.takenMs > shownMs)) {
        await pause(5, signal);
        continue;
      }
      const { fields, ...how } = this._listener.wanted();
      const seen = await this._newestFrames(camera, how);
      if (!seen) {
        await pause(20, signal);
        continue;
      }
      shownMs = seen.newestMs;
      const form = formOf({ ...fields, frame_rate: Number(seen.rate.toFixed(4)) }, seen.files);
      try {
        const done = await predict(form, signal);
        this._answer(done, seen);
      } catch (error) {
        await this._wait(error, signal);
      }
    }
  }

  /** @returns four frames that end with the newest, null while there are too few */
  async _newestFrames(camera, { rate, toldRates, isWhole }) {
    const footage = camera.backwards();
    const { width, height } = footage;
    const crop = isWhole ? { x: 0, y: 0, width, height } : centred(width, height);
    const frames = [];
    let spacingS = 0;
    const wanted = { startS: 0, spacingS: 1 / rate, toldRates, crop };
    for await (const taken of framesOf(footage, wanted)) {
      frames.unshift(taken.frame);
      spacingS = taken.spacingS;
      if (frames.length === SEEN) break;
    }
    if (frames.length < SEEN) return null;
    const files = await Promise.all(frames.map(jpegOf));
    return { files, crop, rate: 1 / spacingS, newestMs: footage.newestMs };
  }

  _answer(done, { newestMs, crop }) {
    const { model, objects, frame_rate: rate } = done;
    const latencyMs = performance.now() - newestMs;
    this._crop = crop;
    this.forecasts = [
      {
        slot: 0,
        label: `auto: ${model.name}`,
        state: "done",
        times: done.times_s,
        ellipse50Radii: done.ellipse50_radii,
        objects,
        done,
        trained: trainedSteps(this._listener.entries(), done),
        newestMs,
        rate,
      },
    ];
    this._say(this._slowness(latencyMs / 1000));
    byId("badge").textContent = `${Math.round(latencyMs)} ms behind`;
    this._listener.changed();
  }

  /** Return the reason for which the drawn forecast is too late, or an empty string. */
  _slowness(latencyS) {
    const [{ times }] = this.forecasts;
    if (latencyS > times.at(-1)) {
      return "The forecasts arrive after their last step: choose a longer horizon.";
    }
    const rate = 1 / this._camera.intervalS;
    const { rate: wanted, toldRates } = this._listener.wanted();
    return rate < Math.min(SLOW * wanted, toldRates?.[0] ?? Infinity)
      ? `The camera takes only ${Math.round(rate)} pictures a second; more light may help.`
      : "";
  }

  /** Report the failure of a forecast and wait for the time that the service requests. */
  async _wait(error, signal) {
    if (error.name === "AbortError") throw error;
    const isFinal = error instanceof ServiceProblem && FINAL.includes(error.problem.status);
    if (isFinal || !(error instanceof ServiceProblem || error instanceof LostService)) throw error;
    const waitS = error.retryAfterS ?? RETRY_S;
    this._say(`${reasonOf(error)} Next attempt in ${waitS} s.`, true);
    await pause(waitS * 1000, signal);
  }

  _draw() {
    const { newest } = this._camera;
    const [forecast] = this.forecasts;
    const step = forecast ? ((newest.takenMs - forecast.newestMs) / 1000) * forecast.rate : 0;
    const { width, height } = newest.picture;
    const crop = this._crop ?? { x: 0, y: 0, width, height };
    const frame = crop.size ? cut(newest.picture, crop) : newest.picture;
    const canvas = this._listener.canvas();
    drawLive(canvas.getContext("2d"), canvas.width, {
      frame,
      width: frame.width,
      height: frame.height,
      ellipses: this._listener.wanted().ellipses,
      forecast: forecast ?? null,
      step,
    });
    canvas.dataset.step = step.toFixed(1);
    const whose = forecast ? `, forecast by ${forecast.label}` : "";
    canvas.setAttribute("aria-label", `Running picture of the camera${whose}`);
  }

  async _take(use) {
    if (!this._recorded) return;
    const clip = await this._recorded.take();
    use(clip);
  }

  /** Offer the other cameras of this device, whose names are known once one was allowed. */
  async _offerOthers() {
    const cameras = await Camera.all();
    byId("camera-device").replaceChildren(
      ...cameras.map(({ id, name }) => make("option", { value: id, textContent: name })),
    );
    byId("camera-device").value = this._camera?.deviceId ?? "";
    byId("camera-device-field").hidden = cameras.length < 2;
  }

  _say(text, isError = false) {
    const said = byId("camera-said");
    if (said.textContent !== text) said.textContent = text;
    said.dataset.error = String(isError);
  }

  _show(isRunning) {
    const [start, stop] = [byId("camera-start"), byId("camera-stop")];
    const hadFocus = [start, stop].includes(document.activeElement);
    start.hidden = isRunning;
    stop.hidden = !isRunning;
    if (hadFocus) (isRunning ? stop : start).focus();
    for (const id of ["camera-save", "camera-use"]) byId(id).hidden = !isRunning || !this._recorded;
    byId("stage").dataset.camera = isRunning ? "on" : "off";
    if (isRunning) byId("stage").scrollIntoView({ block: "nearest" });
    if (!isRunning) byId("badge").textContent = "";
    this._listener.canvas();
    this._listener.changed();
  }
}

function reasonOf(error) {
  if (error instanceof LostService) return "The service cannot be reached.";
  const { title, detail, status } = error.problem;
  return OVERLOADED.includes(status)
    ? `The service is overloaded: ${title} (${status}).`
    : `${title} (${status}): ${detail.replace(/[.!?]?$/, ".")}`;
}

/** @returns {Promise<Blob>} smaller than PNG, and made in less time */
function jpegOf(canvas) {
  return new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", JPEG_QUALITY));
}
