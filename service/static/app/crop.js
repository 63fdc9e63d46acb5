/** The square of the footage that the models shall see: dragged on the picture, or typed. */

import { canvasOf } from "./dom.js";

const SMALLEST = 32;
const HANDLE_PX = 22;

/** The largest square in the middle of a picture. */
export function centred(width, height) {
  const size = Math.min(width, height);
  return { x: Math.floor((width - size) / 2), y: Math.floor((height - size) / 2), size };
}

/** A square that lies inside a picture, as near as possible to the one wished. */
export function inside(crop, width, height) {
  const size = Math.round(Math.min(Math.max(crop.size, SMALLEST), width, height));
  const clamp = (value, most) => Math.round(Math.min(Math.max(value || 0, 0), most));
  return { x: clamp(crop.x, width - size), y: clamp(crop.y, height - size), size };
}

export class CropEditor {
  /** @param {(crop: {x: number, y: number, size: number}) => void} changed */
  constructor(changed) {
    this._changed = changed;
    this._canvas = null;
  }

  /**
   * Draw a picture with the square on it, and let it be dragged.
   * @param {HTMLCanvasElement} canvas square
   * @param {CanvasImageSource} picture
   */
  show(canvas, picture, width, height, crop, isWhole = false) {
    const copy = canvasOf(width, height);
    copy.getContext("2d").drawImage(picture, 0, 0);
    Object.assign(this, { _picture: copy, _width: width, _height: height, _crop: crop });
    this._isWhole = isWhole;
    if (canvas !== this._canvas) {
      this._canvas = canvas;
      this._listen(canvas);
    }
    canvas.setAttribute("aria-label", "Your footage with the square that the models will see");
    this._draw();
  }

  move(crop) {
    this._crop = crop;
    this._isWhole = false;
    if (this._picture) this._draw();
  }

  hide() {
    this._picture = null;
    this._canvas?.classList.remove("cropping");
  }

  /** Canvas pixels a picture's pixel, and where the picture begins. */
  get _fit() {
    const side = this._canvas.width;
    const scale = side / Math.max(this._width, this._height);
    return {
      scale,
      left: (side - this._width * scale) / 2,
      top: (side - this._height * scale) / 2,
    };
  }

  _draw() {
    const canvas = this._canvas;
    canvas.classList.add("cropping");
    const context = canvas.getContext("2d");
    const { scale, left, top } = this._fit;
    const { x, y, size } = this._crop;
    const square = [left + x * scale, top + y * scale, size * scale, size * scale];
    context.fillStyle = "#08090b";
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.drawImage(this._picture, left, top, this._width * scale, this._height * scale);
    context.lineWidth = Math.max(canvas.width / 280, 1.5);
    context.strokeStyle = "#ffffff";
    if (this._isWhole) {
      context.strokeRect(left, top, this._width * scale, this._height * scale);
      return;
    }
    context.fillStyle = "rgba(8, 9, 11, 0.62)";
    context.beginPath();
    context.rect(0, 0, canvas.width, canvas.height);
    context.rect(...square);
    context.fill("evenodd");
    context.strokeRect(...square);
    this._drawThirds(context, square);
    this._drawHandles(context, square);
  }

  _drawThirds(context, [left, top, side]) {
    context.save();
    context.globalAlpha = 0.35;
    context.lineWidth = 1;
    for (const share of [1 / 3, 2 / 3]) {
      context.strokeRect(left + side * share, top, 0, side);
      context.strokeRect(left, top + side * share, side, 0);
    }
    context.restore();
  }

  _drawHandles(context, [left, top, side]) {
    const arm = this._canvas.width / 45;
    context.fillStyle = "#E69F00";
    for (const [x, y] of [[left, top], [left + side, top], [left, top + side], [left + side, top + side]]) {
      context.beginPath();
      context.arc(x, y, arm / 2, 0, 2 * Math.PI);
      context.fill();
    }
  }

  _listen(canvas) {
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (!this._picture) return;
      canvas.setPointerCapture(event.pointerId);
      const at = this._at(event);
      held = { at, crop: this._crop, corner: this._cornerAt(at) };
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this._picture) return;
      const at = this._at(event);
      canvas.style.cursor = this._cornerAt(at) ? "nwse-resize" : "move";
      if (!held) return;
      const wish = held.corner ? resized(held.crop, held.corner, at) : moved(held, at);
      this._crop = inside(wish, this._width, this._height);
      this._isWhole = false;
      this._draw();
      this._changed(this._crop);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, () => {
        held = null;
        canvas.style.cursor = "";
      });
    }
  }

  /** Where a pointer is, in the picture's pixels. */
  _at(event) {
    const { scale, left, top } = this._fit;
    const ratio = this._canvas.width / this._canvas.clientWidth;
    return { x: (event.offsetX * ratio - left) / scale, y: (event.offsetY * ratio - top) / scale };
  }

  /** The corner under a place, told by the one across from it, which stays. */
  _cornerAt({ x, y }) {
    const reach = (HANDLE_PX * (this._canvas.width / this._canvas.clientWidth)) / this._fit.scale;
    const { x: left, y: top, size } = this._crop;
    for (const [right, low] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
      const near = Math.hypot(x - left - right * size, y - top - low * size) < reach;
      if (near) return { right, low, fixedX: left + (1 - right) * size, fixedY: top + (1 - low) * size };
    }
    return null;
  }
}

function moved({ at, crop }, to) {
  return { ...crop, x: crop.x + to.x - at.x, y: crop.y + to.y - at.y };
}

function resized(_, { right, low, fixedX, fixedY }, { x, y }) {
  const size = Math.max(right ? x - fixedX : fixedX - x, low ? y - fixedY : fixedY - y, SMALLEST);
  return { x: right ? fixedX : fixedX - size, y: low ? fixedY : fixedY - size, size };
}
