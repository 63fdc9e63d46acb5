/** The part of the picture that is shown: zoomed and moved with buttons, keys, fingers and mouse. */

import { byId } from "./dom.js";

const MOST = 8;
const STEP = 1.5;
/** Part of the picture by which a key moves it. */
const MOVE = 0.1;

/**
 * @typedef {object} View
 * @property {number} zoom 1 shows all of the picture
 * @property {number} x left border of what is shown, as a share of the picture's side
 * @property {number} y upper border
 */

export class Zoom {
  /** @param {{isOn: () => boolean, changed: () => void}} listener */
  constructor(listener) {
    this._listener = listener;
    /** @type {View} */
    this.view = { zoom: 1, x: 0, y: 0 };
    byId("zoom-in").addEventListener("click", () => this._by(STEP));
    byId("zoom-out").addEventListener("click", () => this._by(1 / STEP));
    byId("zoom-reset").addEventListener("click", () => this.reset());
    this._listenToKeys();
    this._listenToPointers(byId("panels"));
    this._show();
  }

  /** Show all of the picture. */
  reset() {
    this._set({ zoom: 1, x: 0, y: 0 });
  }

  /** Move the picture by shares of the side of what is shown. */
  move(across, down) {
    const { zoom, x, y } = this.view;
    this._set({ zoom, x: x - across / zoom, y: y - down / zoom });
  }

  /** Zoom by a factor around a place, in shares of what is shown. */
  _by(factor, [across, down] = [0.5, 0.5]) {
    const { zoom, x, y } = this.view;
    const next = Math.min(Math.max(zoom * factor, 1), MOST);
    const keep = 1 / zoom - 1 / next;
    this._set({ zoom: next, x: x + across * keep, y: y + down * keep });
  }

  _set({ zoom, x, y }) {
    if (!this._listener.isOn() && zoom > 1) return;
    const within = (value) => Math.min(Math.max(value, 0), 1 - 1 / zoom);
    this.view = { zoom, x: within(x), y: within(y) };
    this._show();
    this._listener.changed();
  }

  _show() {
    const { zoom } = this.view;
    byId("zoom-out").disabled = byId("zoom-reset").disabled = zoom === 1;
    byId("zoom-in").disabled = zoom === MOST;
    byId("panels").dataset.zoomed = String(zoom > 1);
    byId("panels").dataset.view = JSON.stringify(this.view);
  }

  _listenToKeys() {
    byId("screen").addEventListener("keydown", (event) => {
      if (event.target !== event.currentTarget || event.ctrlKey || event.metaKey) return;
      const action = {
        "+": () => this._by(STEP),
        "=": () => this._by(STEP),
        "-": () => this._by(1 / STEP),
        0: () => this.reset(),
        a: () => this.move(MOVE, 0),
        d: () => this.move(-MOVE, 0),
        w: () => this.move(0, MOVE),
        s: () => this.move(0, -MOVE),
      }[event.key];
      if (!action) return;
      event.preventDefault();
      action();
    });
  }

  _listenToPointers(panels) {
    panels.addEventListener("dblclick", (event) => {
      if (!this._listener.isOn()) return;
      if (this.view.zoom === MOST) this.reset();
      else this._by(2, placeIn(event.target, event));
    });
    const wheel = (event) => {
      // A pinch on a trackpad; the wheel alone scrolls the page.
      if (!event.ctrlKey || !this._listener.isOn()) return;
      event.preventDefault();
      this._by(Math.exp(-event.deltaY / 100), placeIn(event.target, event));
    };
    panels.addEventListener("wheel", wheel, { passive: false });
    let before = null;
    const pinch = (event) => {
      if (event.touches.length !== 2 || !this._listener.isOn()) {
        before = null;
        return;
      }
      event.preventDefault();
      const [one, other] = event.touches;
      const span = Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      const middle = placeIn(event.target, {
        clientX: (one.clientX + other.clientX) / 2,
        clientY: (one.clientY + other.clientY) / 2,
      });
      if (before) {
        this.move(middle[0] - before.middle[0], middle[1] - before.middle[1]);
        this._by(span / before.span, middle);
      }
      before = { span, middle };
    };
    for (const name of ["touchstart", "touchmove", "touchend"]) {
      panels.addEventListener(name, pinch, { passive: false });
    }
  }
}

/** Where a pointer is on a picture, as shares of its sides. */
function placeIn(canvas, { clientX, clientY }) {
  const { left, top, width, height } = canvas.getBoundingClientRect();
  return [(clientX - left) / width, (clientY - top) / height];
}
