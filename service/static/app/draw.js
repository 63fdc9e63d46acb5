/** One moment of footage with the forecasts over it, on any canvas: the stage's or a download's. */

import { ellipseOf, MOST } from "./figures.js";
import { CASING, UNCERTAIN, faded, ON_PICTURES, TRUTH } from "./palette.js";
import { LAST_SEEN } from "./state.js";
import { firstUntrained, isUncertain } from "./verdict.js";

/** How many ellipses along the way leave the ball of a running picture in sight. */
const LIVE_ELLIPSES = 6;

/**
 * @typedef {object} Picture
 * @property {CanvasImageSource | null} frame picture of the camera at that time
 * @property {CanvasImageSource | null} [lastFrame] last picture, after the end of the footage
 * @property {number} width of the frames, pixels: the unit of every position
 * @property {number} height of the frames, pixels
 * @property {number[][]} points that select balls, in the last seen frame
 * @property {number} index frame; the forecast's step is index - 3
 * @property {object[]} forecasts those to be drawn, with `slot` and `objects`
 * @property {object[] | null} truth
 * @property {boolean} ellipses
 * @property {import("./zoom.js").View} [view] the part that is shown; all of it by default
 */

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number} side of the square to draw on, canvas pixels
 * @param {Picture} picture
 */
export function drawMoment(context, side, picture) {
  const pen = begin(context, side, picture);
  for (const forecast of picture.forecasts) drawSeen(pen, forecast, picture.index);
  const step = picture.index - LAST_SEEN;
  if (picture.ellipses) {
    for (const forecast of picture.forecasts) drawUncertainty(pen, forecast, step);
  }
  for (const ball of picture.truth ?? []) {
    drawPath(pen, ball.positions.slice(0, picture.index + 1), TRUTH, 2, [1, 5]);
  }
  for (const forecast of picture.forecasts) {
    for (const [index, ball] of forecast.objects.entries()) {
      const color = colorOf(forecast, index);
      // While points are selected, the whole path is drawn.
      const isChoosing = picture.index === LAST_SEEN && picture.points.length > 0;
      const until = isChoosing ? ball.positions.length : Math.max(step + 1, 0);
      drawForecastPath(pen, forecast, ball.positions.slice(0, until), color);
    }
  }
  for (const ball of picture.truth ?? []) drawRing(pen, ball.positions[picture.index]);
  for (const forecast of picture.forecasts) {
    for (const [index, ball] of forecast.objects.entries()) {
      drawMark(pen, ball.positions[step], forecast.slot, colorOf(forecast, index));
    }
  }
  if (picture.index === LAST_SEEN) drawPoints(pen, picture.points);
  context.restore();
}

/**
 * A frame of a running picture with the forecast of an earlier one: the whole path, and a ring where
 * the forecast has each ball by now.
 * @param {{frame: CanvasImageSource, width: number, height: number, ellipses: boolean,
 *   forecast: object | null, step: number}} picture `step` of the forecast that the frame shows, a
 *   fraction
 */
export function drawLive(context, side, picture) {
  const pen = begin(context, side, picture);
  const { forecast, step } = picture;
  if (forecast) {
    const last = forecast.times.length - 1;
    if (picture.ellipses) drawUncertainty(pen, forecast, last, Math.ceil(last / LIVE_ELLIPSES));
    for (const [index, ball] of forecast.objects.entries()) {
      const color = colorOf(forecast, index);
      drawForecastPath(pen, forecast, ball.positions, color);
      drawMark(pen, ball.positions[last], forecast.slot, color);
      if (step > last) continue; // the forecast does not reach this picture
      const [x, y] = between(ball.positions, Math.max(step, 0));
      drawPlace(pen, { x, y, radius: ball.seen?.[LAST_SEEN].radius ?? 0 }, color);
    }
  }
  context.restore();
}

/** A position between two steps. */
function between(positions, step) {
  const [before, after] = [Math.floor(step), Math.ceil(step)].map((index) => positions[index]);
  const share = step - Math.floor(step);
  return before.map((value, axis) => value + share * (after[axis] - value));
}

/** Draw the frame of a picture in the middle of a square; `context` is to be restored afterwards. */
function begin(context, side, picture) {
  const { width, height } = picture;
  const scale = side / Math.max(width, height);
  context.save();
  context.lineJoin = context.lineCap = "round";
  context.fillStyle = "#08090b";
  context.fillRect(0, 0, side, side);
  const { zoom, x, y } = picture.view ?? { zoom: 1, x: 0, y: 0 };
  context.scale(zoom, zoom);
  context.translate(-x * side, -y * side);
  context.translate((side - width * scale) / 2, (side - height * scale) / 2);
  context.beginPath();
  context.rect(0, 0, width * scale, height * scale);
  context.clip();
  drawFrame(context, width * scale, height * scale, picture);
  return { context, scale, unit: side / 560 / zoom };
}

/** Rings where the model saw the balls in a seen frame. */
export function drawSeen(pen, forecast, frame) {
  for (const [index, ball] of (forecast.done?.objects ?? []).entries()) {
    const place = ball.seen?.[frame];
    if (place) drawPlace(pen, place, colorOf(forecast, index));
  }
}

function drawPlace({ context, scale, unit }, { x, y, radius }, color) {
  context.beginPath();
  context.arc(x * scale, y * scale, Math.max(radius * scale, 4 * unit), 0, 2 * Math.PI);
  outline(context, color, 2 * unit, unit);
}

/** The points that were chosen, with their numbers. */
function drawPoints({ context, scale, unit }, points) {
  context.font = `600 ${13 * unit}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  for (const [index, [x, y]] of points.entries()) {
    const [left, top] = [x * scale, y * scale];
    context.beginPath();
    for (const [dx, dy] of [[0, 1], [0, -1], [1, 0], [-1, 0]]) {
      context.moveTo(left + 3 * dx * unit, top + 3 * dy * unit);
      context.lineTo(left + 10 * dx * unit, top + 10 * dy * unit);
    }
    outline(context, "#ffffff", 1.5 * unit, unit);
    context.lineWidth = 3 * unit;
    context.strokeStyle = CASING;
    context.strokeText(String(index + 1), left + 11 * unit, top - 11 * unit);
    context.fillStyle = "#ffffff";
    context.fillText(String(index + 1), left + 11 * unit, top - 11 * unit);
  }
}

function colorOf(forecast, index) {
  return isUncertain(forecast, index) ? UNCERTAIN : ON_PICTURES[forecast.slot];
}

function drawFrame(context, width, height, { frame, lastFrame }) {
  const shown = frame ?? lastFrame;
  if (!shown) return;
  context.imageSmoothingQuality = "high";
  context.drawImage(shown, 0, 0, width, height);
  if (!frame) {
    context.fillStyle = "rgba(8, 9, 11, 0.55)";
    context.fillRect(0, 0, width, height);
  }
}

/**
 * Ellipses of 95 % along the way, and of 95 % and 50 % for now. There is none where nothing is known of
 * how often the ball lies in it: for balls that are uncertain, and beyond the training.
 */
function drawUncertainty({ context, scale, unit }, forecast, step, every = 2) {
  for (const [index, ball] of forecast.objects.entries()) {
    if (isUncertain(forecast, index)) continue;
    const color = colorOf(forecast, index);
    const last = Math.min(step, ball.positions.length - 1, firstUntrained(forecast) - 1);
    context.fillStyle = faded(color, 0.07);
    for (let past = last % every; past < last; past += every) {
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

/** A path, dashed beyond the training of its model. */
function drawForecastPath(pen, forecast, positions, color) {
  const trained = firstUntrained(forecast);
  drawPath(pen, positions.slice(0, trained), color, 3);
  drawPath(pen, positions.slice(Math.min(trained - 1, positions.length)), color, 3, [2, 8]);
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
function drawMark({ context, scale, unit }, position, slot, color) {
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
  outline(context, color, 2.5 * unit, 1.2 * unit);
}
