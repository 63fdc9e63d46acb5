/** Points that select balls: clicked or dragged on the picture, or typed. */

import { byId, make } from "./dom.js";
import { MOST_BALLS } from "./state.js";

/** How near to a point a press has to be to take hold of it, pixels of the screen. */
const REACH_PX = 16;
/** How far a press may move and still select, pixels of the screen. */
const MOVED_PX = 6;
/** Why a press selects nothing. */
const FULL = `${MOST_BALLS} balls are the most that a model follows: remove a point first.`;
const NO_FRAMES = "Points lie in the last of the four frames: press Forecast first.";
const OUTSIDE = "That is beside the frame: a ball is selected inside it.";

/**
 * @typedef {object} Listener
 * @property {() => string | null} refusal why points cannot be chosen; null if they can
 * @property {(reason: string) => void} refused
 * @property {() => boolean} isLastSeen whether the picture shows the last seen frame
 * @property {() => void} showLastSeen
 * @property {() => import("./zoom.js").View} view the part of the picture that is shown
 * @property {(across: number, down: number) => void} panned by shares of the picture's side
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
    this._tap = null;
    this._added = null;
    this._listen();
  }

  _listen() {
    const panels = byId("panels");
    panels.addEventListener("pointerdown", (event) => this._press(event));
    panels.addEventListener("pointermove", (event) => this._move(event));
    panels.addEventListener("pointerup", (event) => this._release(event, true));
    panels.addEventListener("pointercancel", (event) => this._release(event, false));
    panels.addEventListener("dblclick", () => this._undo());
    byId("pick-add").addEventListener("click", () => {
      const size = this._listener.size();
      if (!size) {
        this._listener.refused(NO_FRAMES);
        return;
      }
      if (this.points.length >= MOST_BALLS) {
        this._listener.refused(FULL);
        return;
      }
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
    this._tap = null;
    if (event.button !== 0 || !event.isPrimary) return;
    const size = this._listener.size();
    const at = size && placeOf(event, size, this._listener.view());
    const near = at ? this._near(at) : -1;
    if (!at || !this._added || distance(this._added.at, at) * at.scale > REACH_PX) this._added = null;
    if (near >= 0 && this._listener.isLastSeen()) {
      event.target.setPointerCapture(event.pointerId);
      this._before = this.points;
      this._held = near;
      this._place(at, size);
      return;
    }
    if (size) this._tap = { x: event.clientX, y: event.clientY, isMoved: false };
  }

  _near(at) {
    return this.points.findIndex((point) => distance(point, at) * at.scale < REACH_PX);
  }

  _move(event) {
    const size = this._listener.size();
    if (this._held !== null && size) this._place(placeOf(event, size, this._listener.view()), size);
    if (event.buttons === 0) this._tap = null; // it was released beside the picture
    if (!this._tap || !event.isPrimary) return;
    const [across, down] = [event.clientX - this._tap.x, event.clientY - this._tap.y];
    this._tap.isMoved ||= Math.hypot(across, down) > MOVED_PX;
    if (!this._tap.isMoved || this._listener.view().zoom === 1) return;
    const side = event.target.clientWidth;
    this._listener.panned(across / side, down / side);
    Object.assign(this._tap, { x: event.clientX, y: event.clientY });
  }

  _release(event, isKept) {
    const tap = this._tap;
    this._tap = null;
    if (tap && isKept && !tap.isMoved) this._add(event);
    if (this._held === null) return;
    this._held = null;
    if (isKept) this._listener.changed(this.points);
    else {
      this.points = this._before;
      this._listener.dragged(this.points);
    }
  }

  /** Select the ball at a place of the last seen frame; of others, show that one first. */
  _add(event) {
    const size = this._listener.size();
    if (!size) return;
    const at = placeOf(event, size, this._listener.view());
    const isInside = at[0] >= 0 && at[1] >= 0 && at[0] <= size.width && at[1] <= size.height;
    const isFull = this.points.length >= MOST_BALLS ? FULL : null;
    const refusal = this._listener.refusal() ?? (isInside ? isFull : OUTSIDE);
    if (refusal !== null) this._listener.refused(refusal);
    else if (!this._listener.isLastSeen()) this._listener.showLastSeen();
    else {
      this._added = { before: this.points, at };
      this._listener.changed([...this.points, [at[0], at[1]]]);
    }
  }

  /** The first click of a double click, which zooms, selects nothing. */
  _undo() {
    if (!this._added) return;
    this._listener.changed(this._added.before);
    this._added = null;
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

function distance([x, y], [otherX, otherY]) {
  return Math.hypot(x - otherX, y - otherY);
}

/** Where a pointer is in the frame's pixels; `scale` is pixels of the screen by one of them. */
function placeOf({ target, offsetX, offsetY }, { width, height }, { zoom, x, y }) {
  const side = target.clientWidth;
  const scale = side / Math.max(width, height);
  const place = [
    (x * side + offsetX / zoom - (side - width * scale) / 2) / scale,
    (y * side + offsetY / zoom - (side - height * scale) / 2) / scale,
  ];
  return Object.assign(place, { scale: scale * zoom });
}
