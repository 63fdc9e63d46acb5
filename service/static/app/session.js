/** Requests to the service, in order: from choices to frames and forecasts. */

import { predictStream, ServiceProblem, simulate } from "./api.js";
import { isSlowLink } from "./link.js";
import { trainedSteps } from "./models.js";
import { parametersOf } from "./scene_panel.js";
import { framesOf } from "./resample.js";
import { FootageError } from "./footage.js";
import { SEEN } from "./state.js";

const IMAGE_SIZE = 256;
/** Side of frames on a slow link, pixels. */
const SMALL_IMAGE_SIZE = 128;
const ATTEMPTS = 4;

/**
 * @typedef {object} Take displayed frames and paths
 * @property {string} title
 * @property {(CanvasImageSource | undefined)[]} frames
 * @property {number} width of the frames, pixels
 * @property {number} height of the frames, pixels
 * @property {number} frameSize their longer side, pixels
 * @property {number} rate frames a second
 * @property {object[] | null} truth
 * @property {object | null} surface
 * @property {string[]} notes
 * @property {boolean} isComplete whether no more frames will come
 */

/** One run of the page; a new one ends the one before. */
export class Session {
  /**
   * @param {{changed: () => void, waiting: (error: Error, seconds: number, attempt: number) => void,
   *   answered: () => void}} listener
   */
  constructor(listener) {
    this._listener = listener;
    /** @type {Take | null} */
    this.take = null;
    this.forecasts = [];
    this.finalIndex = null;
    /** Entries of GET /models. */
    this.entries = [];
    /** The take of footage that was made last. */
    this._kept = null;
    this._ended = new AbortController();
  }

  /** Pixels of the frames per pixel of points in the address, where a scene has 256. */
  get pointScale() {
    return this.take?.kind === "scene" ? this.take.frameSize / IMAGE_SIZE : 1;
  }

  /** Abort the current run; return the signal of the new one. */
  begin() {
    this._ended.abort();
    this._ended = new AbortController();
    return this._ended.signal;
  }

  /**
   * Simulate a scene, unless it is the one that is there.
   * @returns {Promise<(() => Promise<void>) | null>} function that loads the later frames, on a slow link
   */
  async scene(choices, steps, signal) {
    const { scenario, balls, seed } = choices;
    const isSlow = isSlowLink() && this.finalIndex === null;
    const asked = {
      scenario,
      num_objects: balls,
      seed: asNumber(seed),
      image_size: isSlow ? SMALL_IMAGE_SIZE : IMAGE_SIZE,
      ...parametersOf(choices),
    };
    const key = JSON.stringify(asked);
    if (this.take?.key === key && this.take.frames.length >= steps) return null;
    const simulated = async (part) => {
      const answer = await this._asked(() => simulate({ ...asked, ...part }, signal), signal);
      const frames = await Promise.all(answer.frames.map(bitmapOf));
      if (signal.aborted) throw new DOMException("", "AbortError");
      return { answer, frames };
    };
    const whole = { steps, include_surface: true };
    const { answer, frames } = await simulated(isSlow ? { steps: SEEN } : whole);
    const take = {
      key,
      kind: "scene",
      scenario,
      title: `${titled(scenario)}, ${balls === 1 ? "1 ball" : `${balls} balls`}, seed ${seed}`,
      file: `rollcast-${scenario}-${seed}`,
      frames,
      sent: answer.frames,
      width: answer.frame_size[0],
      height: answer.frame_size[1],
      frameSize: answer.frame_size[0],
      rate: answer.frame_rate,
      truth: answer.objects,
      radiusM: answer.scene.radius_m,
      surface: answer.surface,
      scene: answer.scene,
      notes: [],
      isComplete: !isSlow,
    };
    this.take = take;
    if (!isSlow) return null;
    return async () => {
      const later = await simulated(whole);
      const { objects: truth, surface } = later.answer;
      Object.assign(take, { frames: later.frames, truth, surface, isComplete: true });
      this._listener.changed();
    };
  }

  /**
   * Take the frames that the models see out of footage; the others follow when there is time. Those
   * that were taken for the forecast before are not taken again.
   */
  async footage(footage, wanted, finalIndex, signal) {
    const needed = finalIndex === null ? SEEN : finalIndex + 1;
    const take = this._takeOf(footage, wanted);
    const more = async () => {
      const isMore = await take.more();
      if (signal.aborted) throw new DOMException("", "AbortError");
      return isMore;
    };
    while (take.frames.length < needed) {
      if (!(await more())) throw new FootageError(tooShort(take, needed, wanted.startS));
    }
    for (const index of Array(needed).keys()) take.pngs[index] ??= pngOf(take.frames[index]);
    take.sent = await Promise.all(take.pngs);
    if (signal.aborted) throw new DOMException("", "AbortError");
    take.isComplete = false;
    this.take = take;
    this.forecasts = [];
    return async (last) => {
      while (take.frames.length <= last && (await more())) this._listener.changed();
      take.isComplete = true;
    };
  }

  /** The take of some footage, which may have frames already. */
  _takeOf(footage, wanted) {
    const key = JSON.stringify([wanted, footage.rate ?? null]);
    const kept = this._kept;
    if (kept?.footage === footage && kept.key === key) return kept;
    const source = framesOf(footage, wanted);
    const take = {
      key,
      footage,
      kind: "footage",
      title: footage.name,
      file: `rollcast-${footage.name.replace(/\.[^.]*$/, "").replace(/[^\w-]+/g, "-")}`,
      frames: [],
      pngs: [],
      truth: null,
      surface: null,
      wanted,
      notes: [],
      isComplete: false,
    };
    let blendedS = 0;
    take.more = async () => {
      const { value, done } = await source.next().catch((error) => {
        this._kept = null;
        throw error;
      });
      if (done) return false;
      const { frame, spacingS, blendedOverS } = value;
      take.frames.push(frame);
      take.rate = 1 / spacingS;
      take.width = frame.width;
      take.height = frame.height;
      take.frameSize = Math.max(frame.width, frame.height);
      if (take.frames.length <= SEEN) blendedS = Math.max(blendedS, blendedOverS);
      take.notes = footageNotes(blendedS);
      return true;
    };
    this._kept = take;
    return take;
  }

  /** Ask every model, side by side, for a forecast that is drawn as it comes. */
  async forecast(models, request, signal) {
    this.forecasts = models.map((model, slot) => ({
      slot,
      name: model,
      label: model,
      ...unanswered(),
    }));
    this._listener.changed();
    const results = await Promise.allSettled(
      this.forecasts.map((forecast) =>
        this._asked(() => this._stream(forecast, request, signal), signal).catch((error) => {
          forecast.state = "failed";
          this._listener.changed();
          throw error;
        }),
      ),
    );
    const failed = results.find(({ status }) => status === "rejected");
    if (failed) throw failed.reason;
  }

  /** The body of a forecast: frames of /simulate unchanged, footage as file parts. */
  body(model, request) {
    const frames = this.take.sent.slice(0, SEEN);
    const final = this.finalIndex === null ? null : this.take.sent[this.finalIndex];
    const fields = { model, ...request };
    if (this.take.kind === "scene") {
      return { ...fields, frames, ...(final && { final_frame: final }) };
    }
    const form = formOf(fields, frames);
    if (final) form.append("final_frame", final, "final.png");
    return form;
  }

  async _stream(forecast, request, signal) {
    const begun = performance.now();
    Object.assign(forecast, unanswered());
    for await (const { step, done } of predictStream(this.body(forecast.name, request), signal)) {
      if (step) {
        forecast.firstStepMs ??= performance.now() - begun;
        forecast.state = "streaming";
        append(forecast, step);
      }
      if (done) {
        finish(forecast, done, trainedSteps(this.entries, done), performance.now() - begun);
      }
      this._listener.changed();
    }
  }

  /** Repeat requests that were rejected because the queue was full, after Retry-After. */
  async _asked(ask, signal) {
    for (let attempt = 2; ; attempt++) {
      try {
        const answer = await ask();
        if (attempt > 2) this._listener.answered();
        return answer;
      } catch (error) {
        const wait = error instanceof ServiceProblem ? error.retryAfterS : null;
        if (wait === null || attempt > ATTEMPTS) throw error;
        this._listener.waiting(error, wait, attempt);
        await pause(wait * 1000, signal);
      }
    }
  }
}

/** A body of /predict with its images as file parts. */
export function formOf(fields, frames) {
  const form = new FormData();
  for (const [name, value] of Object.entries(fields)) {
    form.append(name, typeof value === "object" ? JSON.stringify(value) : String(value));
  }
  for (const [index, file] of frames.entries()) form.append("frames", file, `frame-${index}`);
  return form;
}

/** Return typed text as a number, or unchanged, so that the service reports the error. */
function asNumber(text) {
  if (text === "") return null;
  return Number.isFinite(Number(text)) ? Number(text) : text;
}

/** Forecast before its first step. */
function unanswered() {
  return { state: "waiting", objects: [], times: [], ellipse50Radii: [], done: null };
}

function append(forecast, step) {
  forecast.times.push(step.time_s);
  forecast.ellipse50Radii.push(step.ellipse50_radius);
  for (const { id, ...outputs } of step.objects) {
    const ball = (forecast.objects[id] ??= { id });
    for (const [name, value] of Object.entries(outputs)) (ball[plural(name)] ??= []).push(value);
  }
}

/** The name of an output at all steps: position -> positions, angular_velocity -> ..._velocities. */
function plural(name) {
  return name.endsWith("y") ? `${name.slice(0, -1)}ies` : `${name}s`;
}

function finish(forecast, done, trained, allMs) {
  const { model } = done;
  const label = forecast.name === "auto" ? `auto: ${model.name}` : forecast.name;
  Object.assign(forecast, { state: "done", done, allMs, label, trained });
  forecast.trainedS = (trained - 1) / done.frame_rate;
}

async function bitmapOf(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  return createImageBitmap(new Blob([bytes], { type: "image/png" }));
}

/** @returns {Promise<Blob>} */
export function pngOf(canvas) {
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

/** Wait, unless a signal ends that. */
export function pause(ms, signal) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, ms);
    signal.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(new DOMException("", "AbortError"));
    });
  });
}

function tooShort({ frames, rate }, needed, startS) {
  return (
    `It has ${frames.length} frames, ${Math.round(1000 / rate)} ms apart, from ${startS.toFixed(2)} s on; ` +
    `${needed} are needed. Start earlier, or bring a longer one.`
  );
}

function footageNotes(blendedS) {
  if (!(blendedS > 0)) return [];
  const apart = `${Math.round(blendedS * 1000)} ms apart`;
  const long = blendedS > 0.05 ? ", which is long for a rolling ball" : "";
  return [
    `The camera took no frames at these times: they are blended from those before and after, ${apart}${long}.`,
  ];
}

function titled(scenario) {
  return scenario[0].toUpperCase() + scenario.slice(1);
}

