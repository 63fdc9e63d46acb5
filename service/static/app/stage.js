/** The pictures: one for all forecasts, or one beside the other for each of them. */

import { byId, make } from "./dom.js";
import { drawMoment, drawSeen } from "./draw.js";
import { LAST_SEEN, pointsOf } from "./state.js";

/** Content of one panel of the stage at a moment, also for downloads. */
export function panelsOf(take, forecasts, choices, index) {
  const common = {
    frame: take.frames[index] ?? null,
    lastFrame: take.frames.findLast((frame) => frame) ?? null,
    width: take.width,
    height: take.height,
    points: pointsOf(choices),
    index,
    truth: choices.truth ? take.truth : null,
    ellipses: choices.ellipses,
  };
  const split = choices.layout === "split" && forecasts.length > 1;
  const groups = split ? forecasts.map((forecast) => [forecast]) : [forecasts];
  return groups.map((group) => ({ ...common, forecasts: group }));
}

/** "seen 2 of 4" or "forecast". */
export function phaseOf(index) {
  return index <= LAST_SEEN ? `seen ${index + 1} of 4` : "forecast";
}

export class Stage {
  constructor() {
    this._panels = byId("panels");
    this._strip = byId("strip");
  }

  /** Draw a moment, or the part of it that a view shows. */
  show(take, forecasts, choices, index, view) {
    const panels = panelsOf(take, forecasts, choices, index);
    const canvases = this._canvases(panels.length);
    for (const [number, panel] of panels.entries()) {
      const canvas = canvases[number];
      fit(canvas);
      drawMoment(canvas.getContext("2d"), canvas.width, { ...panel, view });
      const whose = panel.forecasts.map((forecast) => forecast.label).join(", ");
      canvas.setAttribute(
        "aria-label",
        `${take.title}, ${phaseOf(index)}${whose ? `, forecast by ${whose}` : ""}`,
      );
    }
  }

  /** Put the frames that the models see under the stage, with rings where they saw balls. */
  showSeen(take, finalIndex, forecasts = []) {
    const indices = [0, 1, 2, 3, ...(finalIndex === null ? [] : [finalIndex])];
    this._strip.replaceChildren(
      ...indices.map((index) => {
        const canvas = make("canvas", { width: 144, height: 144, "aria-hidden": "true" });
        const frame = take.frames[index];
        if (frame) drawThumbnail(canvas, take, index, forecasts);
        const step = index - LAST_SEEN;
        const caption = step > 0 ? `t = ${step}, final` : `t = ${String(step).replace("-", "−")}`;
        return make("li", {}, canvas, make("span", {}, caption));
      }),
    );
  }

  /** The canvas on which a crop is chosen. */
  single() {
    const [canvas] = this._canvases(1);
    canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
    fit(canvas);
    return canvas;
  }

  _canvases(count) {
    while (this._panels.children.length > count) this._panels.lastChild.remove();
    while (this._panels.children.length < count) {
      this._panels.append(make("canvas", { role: "img", "aria-label": "" }));
    }
    this._panels.dataset.count = String(count);
    return [...this._panels.children];
  }
}

function drawThumbnail(canvas, { width, height, frames }, index, forecasts) {
  const context = canvas.getContext("2d");
  const scale = canvas.width / Math.max(width, height);
  context.translate((canvas.width - width * scale) / 2, (canvas.height - height * scale) / 2);
  context.drawImage(frames[index], 0, 0, width * scale, height * scale);
  if (index > LAST_SEEN) return;
  for (const forecast of forecasts) drawSeen({ context, scale, unit: 0.7 }, forecast, index);
}

/** Give a canvas as many pixels as the screen has there. */
function fit(canvas) {
  const side = Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)) || 560;
  if (canvas.width !== side) canvas.width = canvas.height = side;
}
