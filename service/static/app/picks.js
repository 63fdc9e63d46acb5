/** Points that select balls: clicked or dragged on the picture, or typed. */

import { byId, make } from "./dom.js";
import { MOST_BALLS } from "./state.js";

/** How near to a point a press has to be to take hold of it, pixels of the screen. */
const REACH_PX = 16;

/**
 * @typedef {object} Listener
 * @property {() => boolean} isOpen whether points can be chosen
 * @property {() => boolean} isLastSeen whether the picture shows the last seen frame
 * @property {() => void} showLastSeen
 * @property {() => {width: number, height: number} | null} size of the frames, pixels
 * @property {(points: number[][]) => void} changed
 * @property {(points: number[][]) => void} dragged
 */

export class Picks {
  /** @param {Listener} listener */
  constructor(listener) {
    this._listener = listener;
    this.points = [];
    this._held = null;
    this._listen();
  }

  _listen() {
    const panels = byId("panels");
    panels.addEventListener("pointerdown", (event) => this._press(event));
    panels.addEventListener("pointermove", (event) => this._move(event));
    panels.addEventListener("pointerup", () => this._release(true));
    panels.addEventListener("pointercancel", () => this._release(false));
    byId("pick-add").addEventListener("click", () => {
      const size = this._listener.size();
      if (!size || this.points.length >= MOST_BALLS) return;
      this._listener.showLastSeen();
      this._listener.changed([...this.points, [size.width / 2, size.height / 2]]);
      byId("pick-list").lastElementChild?.querySelector("input").focus();
    });
    byId("pick-clear").addEventListener("click", () => this._listener.changed([]));
    byId("pick-list").addEventListener("change", ({ target }) => {
      const { width, height } = this._listener.size() ?? { width: 4096, height: 4096 };
      const { point, axis } = target.dataset;
      const most = axis === "0" ? width : height;
      const points = this.points.map((pair) => [...pair]);
      points[point][axis] = Math.min(Math.max(Number(target.value) || 0, 0), most);
      this._listener.showLastSeen();
      this._listener.changed(points);
    });
    byId("pick-list").addEventListener("click", ({ target }) => {
      const index = target.closest("button")?.dataset.remove;
      if (index === undefined) return;
      this._listener.changed(this.points.filter((_, other) => other !== Number(index)));
      byId("pick-add").focus();
    });
  }

  _press(event) {
    const size = this._listener.size();
    if (!size || event.button !== 0 || !this._listener.isOpen()) return;
    if (!this._listener.isLastSeen()) {
      this._listener.showLastSeen();
      return;
    }
    const at = placeOf(event, size);
    const near = this.points.findIndex(
      (point) => Math.hypot(point[0] - at[0], point[1] - at[1]) * at.scale < REACH_PX,
    );
    const isInside = at[0] >= 0 && at[1] >= 0 && at[0] <= size.width && at[1] <= size.height;
    if (near < 0 && (!isInside || this.points.length >= MOST_BALLS)) return;
    event.target.setPointerCapture(event.pointerId);
    this._before = this.points;
    this._held = near < 0 ? this.points.length : near;
    this._place(at, size);
  }

  _move(event) {
    const size = this._listener.size();
    if (this._held !== null && size) this._place(placeOf(event, size), size);
  }

  _release(isKept) {
    if (this._held === null) return;
    this._held = null;
    if (isKept) this._listener.changed(this.points);
    else {
      this.points = this._before;
      this._listener.dragged(this.points);
    }
  }

  _place([x, y], { width, height }) {
    const within = (value, most) => Math.min(Math.max(value, 0), most);
    this.points = this.points.map((pair) => [...pair]);
    this.points[this._held] = [within(x, width), within(y, height)];
    this._listener.dragged(this.points);
  }
}

/** List the points, for those who type them. */
export function showPicks(points, isOffered) {
  byId("picks").hidden = !isOffered;
  byId("pick-clear").disabled = !points.length;
  byId("pick-add").disabled = points.length >= MOST_BALLS;
  const list = byId("pick-list");
  while (list.children.length > points.length) list.lastChild.remove();
  while (list.children.length < points.length) list.append(rowOf(list.children.length));
  for (const [index, point] of points.entries()) {
    for (const input of list.children[index].querySelectorAll("input")) {
      if (document.activeElement !== input) {
        input.value = String(Number(point[input.dataset.axis].toFixed(1)));
      }
    }
  }
}

function rowOf(index) {
  const field = (axis) =>
    make("input", {
      type: "number",
      min: "0",
      step: "any",
      "aria-label": `Ball ${index + 1}, ${"xy"[axis]} in pixels`,
      "data-point": String(index),
      "data-axis": String(axis),
    });
  return make(
    "li",
    {},
    make("span", { "aria-hidden": "true" }, String(index + 1)),
    field(0),
    field(1),
    make("button", {
      type: "button", class: "quiet", "data-remove": String(index), textContent: "Remove",
      "aria-label": `Remove ball ${index + 1}`,
    }),
  );
}

/** Where a pointer is in the frame's pixels; `scale` is pixels of the screen by one of them. */
function placeOf({ target, offsetX, offsetY }, { width, height }) {
  const side = target.clientWidth;
  const scale = side / Math.max(width, height);
  const place = [
    (offsetX - (side - width * scale) / 2) / scale,
    (offsetY - (side - height * scale) / 2) / scale,
  ];
  return Object.assign(place, { scale });
}
