/** Error and uncertainty over time, as they come. */

import { byId, styled } from "./dom.js";
import { curvesOf } from "./figures.js";
import { faded, onPage } from "./palette.js";
import { FRAME_RATE_HZ } from "./state.js";

const HEIGHT_PX = 240;
/** Uncertainty that has lost all bounds leaves the chart at this multiple of the largest error. */
const MOST_OF_ERROR = 3;

export class Chart {
  /** @param {(timeS: number) => void} seek called when a moment is clicked */
  constructor(seek) {
    this._root = byId("chart");
    this._seek = seek;
    this._nowS = 0;
    this._shown = null;
    new ResizeObserver(() => this._resize()).observe(this._root);
  }

  /**
   * @param {object[]} forecasts
   * @param {object[] | null} truth
   * @param {number} seconds that the whole forecast takes
   */
  show(forecasts, truth, seconds) {
    this._shown = [forecasts, truth, seconds];
    const key = forecasts.map(({ slot, label }) => `${slot} ${label}`).join() + Boolean(truth);
    if (key !== this._key || !this._plot) this._make(forecasts, Boolean(truth));
    this._key = key;
    const times = forecasts.reduce(
      (longest, { times }) => (times.length > longest.length ? times : longest),
      [],
    );
    this._mostPx = Infinity;
    const columns = forecasts.flatMap((forecast) => {
      const { errors, radii } = curvesOf(forecast, truth);
      const most = MOST_OF_ERROR * Math.max(...errors);
      if (most > 0) this._mostPx = Math.max(this._mostPx === Infinity ? 0 : this._mostPx, most);
      const padded = (values) => times.map((_, step) => values[step] ?? null);
      return truth ? [padded(radii), padded(errors)] : [padded(radii)];
    });
    this._secondsInAll = Math.max(seconds, 1 / FRAME_RATE_HZ);
    this._trainedS = forecasts.map(({ trainedS }) => trainedS ?? null);
    this._plot.setData([times, ...columns]);
  }

  /** Mark the moment that the stage shows. */
  mark(timeS) {
    this._nowS = timeS;
    this._plot?.redraw(false);
  }

  /** Draw anew in the colours of another theme. */
  recolor() {
    this._plot?.destroy();
    this._plot = null;
    if (this._shown) this.show(...this._shown);
  }

  _make(forecasts, withTruth) {
    this._plot?.destroy();
    const ink = styled("--muted");
    const grid = { stroke: styled("--line"), width: 1 };
    const axis = { stroke: ink, grid, ticks: grid, font: "12px " + styled("--font") };
    this._plot = new window.uPlot(
      {
        width: this._root.clientWidth || 360,
        height: HEIGHT_PX,
        legend: { show: false },
        cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
        scales: {
          x: { time: false, range: () => [0, this._secondsInAll ?? 1] },
          y: { range: (_, __, max) => [0, Math.max(Math.min(max || 0, this._mostPx) * 1.08, 1)] },
        },
        axes: [
          { ...axis, values: (_, ticks) => ticks.map((tick) => `${+tick.toFixed(3)} s`) },
          { ...axis, size: 50, values: (_, ticks) => ticks.map((tick) => `${tick} px`) },
        ],
        series: [{}, ...forecasts.flatMap((forecast) => curvesFor(forecast, withTruth))],
        hooks: { draw: [(plot) => this._drawMarks(plot)] },
      },
      [[], ...forecasts.flatMap(() => (withTruth ? [[], []] : [[]]))],
      this._root,
    );
    this._plot.over.addEventListener("click", (event) => {
      this._seek(this._plot.posToVal(event.offsetX, "x"));
    });
  }

  /** A line for now, and dotted ones where the models' training ended. */
  _drawMarks(plot) {
    const { ctx, bbox } = plot;
    const line = (timeS, color, dash) => {
      const x = Math.round(plot.valToPos(timeS, "x", true)) + 0.5;
      if (!(x >= bbox.left && x <= bbox.left + bbox.width + 1)) return;
      ctx.strokeStyle = color;
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    };
    ctx.save();
    ctx.lineWidth = 1.5 * devicePixelRatio;
    for (const trainedS of new Set(this._trainedS ?? [])) {
      if (trainedS !== null && trainedS < this._secondsInAll) {
        line(trainedS, styled("--muted"), [2, 6].map((part) => part * devicePixelRatio));
      }
    }
    if (this._nowS >= 0) line(this._nowS, styled("--ink"), []);
    ctx.restore();
  }

  _resize() {
    const width = this._root.clientWidth;
    if (width && this._plot) this._plot.setSize({ width, height: HEIGHT_PX });
  }
}

function curvesFor({ slot, label }, withTruth) {
  const color = onPage(slot);
  const radius = {
    label: `${label}: 95 % radius`,
    stroke: color,
    width: 1.5,
    dash: [6, 4],
    fill: faded(color, 0.1),
    points: { show: false },
  };
  const error = { label: `${label}: error`, stroke: color, width: 2.5, points: { show: false } };
  return withTruth ? [radius, error] : [radius];
}
