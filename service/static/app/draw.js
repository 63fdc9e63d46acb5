/** One moment of footage with the forecasts over it, on any canvas: the stage's or a download's. */

import { ellipseOf, MOST } from "./figures.js";
import { CASING, faded, ON_PICTURES, TRUTH } from "./palette.js";
import { LAST_SEEN } from "./state.js";

/**
 * @typedef {object} Picture
 * @property {CanvasImageSource | null} frame what the camera saw then
 * @property {CanvasImageSource | null} [lastFrame] what it saw last, where the footage has ended
 * @property {number} frameSize side of the frames, pixels: the unit of every position
 * @property {number} index frame; the forecast's step is index - 3
 * @property {object[]} forecasts those to be drawn, with `slot` and `objects`
 * @property {object[] | null} truth
 * @property {boolean} ellipses
 */

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number} side of the square to draw on, canvas pixels
 * @param {Picture} picture
 */
export function drawMoment(context, side, picture) {
  const scale = side / picture.frameSize;
  const pen = { context, scale, unit: side / 560 };
  context.save();
  context.lineJoin = context.lineCap = "round";
  drawFrame(context, side, picture);
  const step = picture.index - LAST_SEEN;
  if (picture.ellipses) {
    for (const forecast of picture.forecasts) drawDoubt(pen, forecast, step);
  }
  for (const ball of picture.truth ?? []) {
    drawPath(pen, ball.positions.slice(0, picture.index + 1), TRUTH, 2, [1, 5]);
  }
  for (const forecast of picture.forecasts) {
    for (const ball of forecast.objects) {
      drawPath(pen, ball.positions.slice(0, Math.max(step + 1, 0)), ON_PICTURES[forecast.slot], 3);
    }
  }
  for (const ball of picture.truth ?? []) drawRing(pen, ball.positions[picture.index]);
  for (const forecast of picture.forecasts) {
    for (const ball of forecast.objects) drawMark(pen, ball.positions[step], forecast.slot);
  }
  context.restore();
}

function drawFrame(context, side, { frame, lastFrame }) {
  context.fillStyle = "#08090b";
  context.fillRect(0, 0, side, side);
  const shown = frame ?? lastFrame;
  if (!shown) return;
  context.imageSmoothingQuality = "high";
  context.drawImage(shown, 0, 0, side, side);
  if (!frame) {
    context.fillStyle = "rgba(8, 9, 11, 0.55)";
    context.fillRect(0, 0, side, side);
  }
}

/** Ellipses of 95 % along the way, and of 95 % and 50 % for now. */
function drawDoubt({ context, scale, unit }, forecast, step) {
  const color = ON_PICTURES[forecast.slot];
  for (const ball of forecast.objects) {
    const last = Math.min(step, ball.positions.length - 1);
    context.fillStyle = faded(color, 0.07);
    for (let past = last % 2; past < last; past += 2) {
      trace(context, scale, ball.positions[past], ball.covariances[past], MOST);
      context.fill();
    }
    if (step < 0 || step > last) continue;
    context.fillStyle = faded(color, 0.2);
    trace(context, scale, ball.positions[step], ball.covariances[step], MOST);
    context.fill();
    outline(context, color, 1.5 * unit, unit);
    trace(context, scale, ball.positions[step], ball.covariances[step], forecast.ellipse50Radii[step]);
    context.fill();
  }
}

function trace(context, scale, [x, y], covariance, sigmas) {
  const { major, minor, angle } = ellipseOf(covariance);
  const [long, short] = [major, minor].map((axis) => Math.max(axis * sigmas * scale, 0.5));
  context.beginPath();
  context.ellipse(x * scale, y * scale, long, short, angle, 0, 2 * Math.PI);
}

function outline(context, color, width, unit) {
  context.strokeStyle = CASING;
  context.lineWidth = width + 2 * unit;
  context.stroke();
  context.strokeStyle = color;
  context.lineWidth = width;
  context.stroke();
}

function drawPath({ context, scale, unit }, positions, color, width, dash = []) {
  if (positions.length < 2) return;
  context.beginPath();
  for (const [x, y] of positions) context.lineTo(x * scale, y * scale);
  context.strokeStyle = CASING;
  context.lineWidth = (width + 2) * unit;
  context.stroke();
  context.setLineDash(dash.map((length) => length * unit));
  context.strokeStyle = color;
  context.lineWidth = width * unit;
  context.stroke();
  context.setLineDash([]);
}

function drawRing({ context, scale, unit }, position) {
  if (!position) return;
  context.beginPath();
  context.arc(position[0] * scale, position[1] * scale, 6 * unit, 0, 2 * Math.PI);
  outline(context, TRUTH, 2 * unit, unit);
}

/** ×, + or a rhombus, by the forecast's slot. */
function drawMark({ context, scale, unit }, position, slot) {
  if (!position) return;
  const [x, y] = position.map((value) => value * scale);
  const arm = (slot === 0 ? 6 : 8) * unit;
  const strokes = [
    [[-arm, -arm, arm, arm], [-arm, arm, arm, -arm]],
    [[-arm, 0, arm, 0], [0, -arm, 0, arm]],
    [[-arm, 0, 0, -arm, arm, 0, 0, arm, -arm, 0]],
  ][slot];
  context.beginPath();
  for (const stroke of strokes) {
    for (let i = 0; i < stroke.length; i += 2) {
      context[i ? "lineTo" : "moveTo"](x + stroke[i], y + stroke[i + 1]);
    }
  }
  outline(context, ON_PICTURES[slot], 2.5 * unit, 1.2 * unit);
}
