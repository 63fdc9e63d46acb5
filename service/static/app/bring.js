/** Footage that the user brings: how it gets in, and where to begin and to cut it. */

import { centred, CropEditor, inside } from "./crop.js";
import { byId } from "./dom.js";
import { openFootage } from "./footage.js";
import { FRAME_RATE_HZ } from "./state.js";

const FIELDS = { x: "crop-x", y: "crop-y", size: "crop-size" };

export class Bring {
  /**
   * @param {{opened: () => void, changed: () => void, failed: (error: Error) => void,
   *   canvas: () => HTMLCanvasElement}} listener
   */
  constructor(listener) {
    this._listener = listener;
    this.footage = null;
    this.crop = { x: 0, y: 0, size: 128 };
    /** What the models expect: frames a second, those that they are told, the square of a set-up. */
    this.known = { rate: FRAME_RATE_HZ, toldRates: null, crop: null };
    this._editor = new CropEditor((crop) => this._cropped(crop));
    this._listen();
  }

  /** Selected part of the footage. */
  get wanted() {
    const typedMs = Number(byId("spacing").value);
    return {
      startS: Number(byId("start").value),
      spacingS: Math.max(typedMs || 1000 / this.known.rate, 0.1) / 1000,
      toldRates: typedMs ? null : this.known.toldRates,
      crop: this.isWhole
        ? { x: 0, y: 0, width: this.footage.width, height: this.footage.height }
        : this.crop,
    };
  }

  /** Whether the whole picture is sent, which models for any number of balls read. */
  get isWhole() {
    return byId("whole").checked;
  }

  /** Offer whole pictures where a model reads them; take them unless a square has been chosen. */
  offerWhole(isOffered) {
    byId("whole-field").hidden = !isOffered;
    byId("whole").checked = isOffered && !this._hasSquare;
  }

  /**
   * Take the frames as a model knows them.
   * @param {{rate: number, toldRates: [number, number] | null, crop: number[] | null}} known
   * @returns {boolean} whether that changes anything
   */
  suit(known) {
    if (JSON.stringify(known) === JSON.stringify(this.known)) return false;
    this.known = known;
    this._suit();
    return true;
  }

  _suit() {
    const { rate, toldRates, crop } = this.known;
    const usual = String(Number((1000 / rate).toFixed(2)));
    byId("spacing").value = toldRates ? "" : usual;
    byId("spacing").placeholder = toldRates ? "camera's own" : usual;
    byId("spacing-hint").textContent = toldRates
      ? "Left empty, the camera's own frames are sent, and the model is told their rate: " +
        `${toldRates.map((told) => Math.round(told)).join(" to ")} frames a second.`
      : `The model expects ${usual} ms, ${Number(rate.toFixed(2))} frames a second. ` +
        "Where the camera took no frame, one is blended from those before and after.";
    if (!crop || !this.footage) return;
    this._hasSquare = true;
    byId("whole").checked = false;
    const [x, y, size] = crop;
    this.crop = inside({ x, y, size }, this.footage.width, this.footage.height);
    this._showCrop();
  }

  /** @param {File[]} files */
  async open(files) {
    try {
      const footage = await openFootage(files);
      this.footage?.close();
      this.footage = footage;
    } catch (error) {
      this._listener.failed(error);
      return;
    }
    this.crop = centred(this.footage.width, this.footage.height);
    this._hasSquare = false;
    byId("footage-settings").hidden = false;
    byId("image-rate-field").hidden = this.footage.kind === "video";
    byId("image-rate").value = String(FRAME_RATE_HZ);
    byId("start").value = "0";
    this._suit();
    this._describe();
    this._showCrop();
    this._listener.opened();
  }

  /** Show the footage at its start, with the square on it. */
  async edit() {
    if (!this.footage) return;
    try {
      // The slider is faster than the decoder: only where it stands at last is shown.
      const asked = (this._asked = {});
      const shot = await this.footage.shotAt(Math.min(this.wanted.startS, this.footage.durationS));
      if (asked !== this._asked || !shot) return;
      const { width, height } = this.footage;
      this._editor.show(this._listener.canvas(), shot.picture, width, height, this.crop, this.isWhole);
    } catch (error) {
      this._listener.failed(error);
    }
  }

  leave() {
    this._asked = null;
    this._editor.hide();
  }

  _describe() {
    const { name, width, height, durationS } = this.footage;
    byId("footage-name").textContent = `${name}: ${width} × ${height}, ${durationS.toFixed(2)} s`;
    const start = byId("start");
    start.max = String(Math.max(durationS, 0.001));
    start.step = String(durationS > 60 ? 0.01 : 0.001);
    byId("start-text").textContent = `${Number(start.value).toFixed(3)} s`;
  }

  _cropped(crop) {
    this.crop = crop;
    this._hasSquare = true;
    byId("whole").checked = false;
    this._showCrop();
    this._listener.changed();
  }

  _showCrop() {
    for (const [name, id] of Object.entries(FIELDS)) byId(id).value = String(this.crop[name]);
  }

  _listen() {
    byId("files").addEventListener("change", () => {
      const files = [...byId("files").files];
      byId("files").value = "";
      if (files.length) this.open(files);
    });
    byId("start").addEventListener("input", () => {
      this._describe();
      this._listener.changed();
      this.edit();
    });
    byId("image-rate").addEventListener("change", () => {
      this.footage.rate = Math.max(Number(byId("image-rate").value) || FRAME_RATE_HZ, 0.1);
      this._describe();
      this._listener.changed();
    });
    byId("whole").addEventListener("change", () => {
      this._hasSquare = !this.isWhole;
      this._listener.changed();
      this.edit();
    });
    byId("spacing").addEventListener("change", () => this._listener.changed());
    for (const [name, id] of Object.entries(FIELDS)) {
      byId(id).addEventListener("change", () => {
        const wish = { ...this.crop, [name]: Number(byId(id).value) };
        this._cropped(inside(wish, this.footage.width, this.footage.height));
        this._editor.move(this.crop);
      });
    }
    this._listenToDrops();
  }

  _listenToDrops() {
    const curtain = byId("dropping");
    const carriesFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
    document.addEventListener("dragover", (event) => {
      if (!carriesFiles(event)) return;
      event.preventDefault();
      curtain.hidden = false;
    });
    document.addEventListener("dragleave", (event) => {
      if (event.relatedTarget === null) curtain.hidden = true;
    });
    document.addEventListener("drop", (event) => {
      curtain.hidden = true;
      if (!carriesFiles(event)) return;
      event.preventDefault();
      this.open([...event.dataTransfer.files]);
    });
  }
}
