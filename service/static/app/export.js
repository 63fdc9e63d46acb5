/** Downloads: the forecast as JSON, the stage as a picture, an animation or a video. */

import { GIFEncoder, applyPalette, quantize } from "../vendor/gifenc/gifenc.esm.js";
import { breathe, canvasOf, make } from "./dom.js";
import { drawMoment } from "./draw.js";
import { signedSeconds } from "./figures.js";
import { MARKS, ON_PICTURES } from "./palette.js";
import { panelsOf, phaseOf } from "./stage.js";
import { LAST_SEEN } from "./state.js";
import { verdictOf } from "./verdict.js";

const PICTURE_PX = 720;
const VIDEO_PX = 480;
const GIF_PX = 320;
const STRIP = 0.085;
/** Colour of a verdict that warns, on the dark strip. */
const WARNING = "#FFB59A";

/**
 * @typedef {object} Shown
 * @property {import("./session.js").Take} take
 * @property {object[]} forecasts
 * @property {import("./state.js").Choices} choices
 * @property {number} last index of the last frame
 */

/** Hand a file to the user. */
export function save(blob, name) {
  const url = URL.createObjectURL(blob);
  make("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Request and response as sent, with the true path if it is known. */
export function asJson({ take, forecasts }, request) {
  const document = {
    title: take.title,
    request,
    scene: take.scene ?? null,
    forecasts: forecasts.map(({ objects, times, ellipse50Radii, done }) => ({
      ...done,
      objects: objects.map((ball, index) => ({
        ...done?.objects[index],
        ...ball,
      })),
      times_s: times,
      ellipse50_radii: ellipse50Radii,
    })),
    truth: take.truth,
  };
  return new Blob([JSON.stringify(document, null, 1)], { type: "application/json" });
}

/** @returns {Promise<Blob>} the moment that is shown */
export function asPng(shown, index) {
  const canvas = new Composition(shown, PICTURE_PX).draw(index);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

/**
 * @param {(share: number) => void} progress
 * @returns {Promise<Blob>} every frame, at half speed: a GIF knows hundredths of a second
 */
export async function asGif(shown, progress) {
  const composition = new Composition(shown, GIF_PX);
  const encoder = GIFEncoder();
  const delay = Math.max(Math.round(200 / shown.take.rate), 2) * 10;
  for (let index = 0; index <= shown.last; index++) {
    const canvas = composition.draw(index);
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const palette = quantize(data, 128);
    const pixels = applyPalette(data, palette);
    encoder.writeFrame(pixels, canvas.width, canvas.height, { palette, delay });
    progress((index + 1) / (shown.last + 1));
    await breathe();
  }
  encoder.finish();
  return new Blob([encoder.bytes()], { type: "image/gif" });
}

/**
 * @param {(share: number) => void} progress
 * @returns {Promise<Blob>} a video at half speed, recorded while it plays
 */
export async function asWebm(shown, progress) {
  const composition = new Composition(shown, VIDEO_PX);
  const canvas = composition.draw(0);
  const stream = canvas.captureStream(0);
  const [track] = stream.getVideoTracks();
  const recorder = new MediaRecorder(stream, { mimeType: "video/webm", videoBitsPerSecond: 5e6 });
  const parts = [];
  recorder.addEventListener("dataavailable", ({ data }) => parts.push(data));
  const stopped = new Promise((resolve) => recorder.addEventListener("stop", resolve));
  recorder.start();
  const frameMs = 2000 / shown.take.rate;
  const begun = performance.now();
  for (let index = 0; index <= shown.last; index++) {
    composition.draw(index);
    track.requestFrame();
    progress((index + 1) / (shown.last + 1));
    const due = begun + (index + 1) * frameMs;
    await new Promise((resolve) => setTimeout(resolve, Math.max(due - performance.now(), 0)));
  }
  recorder.stop();
  track.stop();
  await stopped;
  return new Blob(parts, { type: "video/webm" });
}

export function canRecord() {
  return typeof MediaRecorder === "function" && MediaRecorder.isTypeSupported("video/webm");
}

/** The panels side by side, above a caption. */
class Composition {
  constructor(shown, side) {
    this._shown = shown;
    const { take, forecasts, choices } = shown;
    const count = panelsOf(take, forecasts, choices, 0).length;
    this._side = count > 1 ? Math.round(side * 0.75) : side;
    this._strip = 2 * Math.round((side * STRIP) / 2);
    // Encoders of videos want even sides.
    const width = 2 * Math.ceil((this._side * count) / 2);
    this._verdict = verdictOf(forecasts);
    this._lines = linesOf(this._verdict.text, this._font, width - 2 * this._margin);
    const said = 2 * Math.ceil((this._lines.length * 1.5 * this._size) / 2);
    this._canvas = canvasOf(width, this._side + this._strip + said);
    this._canvas.getContext("2d", { willReadFrequently: true });
  }

  /** Height of letters, pixels. */
  get _size() {
    return this._strip * 0.4;
  }

  get _margin() {
    return this._size * 0.7;
  }

  get _font() {
    return `${this._size}px system-ui, sans-serif`;
  }

  draw(index) {
    const { take, forecasts, choices } = this._shown;
    const context = this._canvas.getContext("2d");
    context.fillStyle = "#08090b";
    context.fillRect(0, 0, this._canvas.width, this._canvas.height);
    for (const [number, panel] of panelsOf(take, forecasts, choices, index).entries()) {
      context.save();
      context.beginPath();
      context.translate(number * this._side, 0);
      context.rect(0, 0, this._side, this._side);
      context.clip();
      drawMoment(context, this._side, panel);
      context.restore();
    }
    this._caption(context, index);
    return this._canvas;
  }

  _caption(context, index) {
    const { take, forecasts } = this._shown;
    const size = this._size;
    const y = this._side + this._strip / 2;
    context.font = this._font;
    context.textBaseline = "middle";
    let x = this._margin;
    for (const { slot, label } of forecasts) {
      context.fillStyle = ON_PICTURES[slot];
      context.fillText(`${MARKS[slot]} ${label}`, x, y);
      x += context.measureText(`${MARKS[slot]} ${label}`).width + size * 1.2;
    }
    const time = signedSeconds((index - LAST_SEEN) / take.rate);
    const text = index <= LAST_SEEN ? `${phaseOf(index)}, ${time}` : time;
    context.fillStyle = "#ffffff";
    const left = this._canvas.width - context.measureText(text).width - this._margin;
    if (left > x) context.fillText(text, left, y);
    context.fillStyle = this._verdict.isWarning ? WARNING : "#ffffff";
    for (const [number, line] of this._lines.entries()) {
      context.fillText(line, this._margin, y + (number + 1.1) * 1.5 * size);
    }
  }
}

/** A sentence in lines of a width, pixels. */
function linesOf(text, font, width) {
  const context = canvasOf(1).getContext("2d");
  context.font = font;
  const lines = [];
  for (const word of text.split(" ").filter(Boolean)) {
    const longer = lines.length ? `${lines.at(-1)} ${word}` : word;
    if (lines.length && context.measureText(longer).width <= width) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}
