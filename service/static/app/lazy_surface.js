/** The surface in three dimensions, whose library is loaded when it is looked at. */

import { byId } from "./dom.js";

export class LazySurface {
  constructor() {
    this._isSeen = false;
    this._surface = null;
    this._index = 0;
    const observer = new IntersectionObserver((seen) => {
      if (!seen.some(({ isIntersecting }) => isIntersecting)) return;
      this._isSeen = true;
      observer.disconnect();
      this._load();
    });
    observer.observe(byId("surface").parentElement);
  }

  /** Show a scene and its forecasts; none for footage, whose ground is not known. */
  show(take, forecasts) {
    this._shown = [take, forecasts];
    if (this._surface) {
      this._surface.show(take, forecasts);
      return;
    }
    const isFootage = take?.kind === "footage";
    byId("surface").hidden = isFootage;
    byId("surface-note").textContent = isFootage
      ? "The ground of your footage is unknown; only simulated scenes have a surface."
      : "";
    this._load();
  }

  mark(index) {
    this._index = index;
    this._surface?.mark(index);
  }

  reset() {
    this._surface?.reset();
  }

  recolor() {
    this._surface?.recolor();
  }

  /** Load it once it is in sight; the first forecast comes before. */
  async _load() {
    const [take, forecasts] = this._shown ?? [];
    const isDone = forecasts?.length && forecasts.every(({ state }) => state === "done");
    if (!this._isSeen || !isDone || !take?.surface || this._isLoading) return;
    this._isLoading = true;
    try {
      const { Surface3d } = await import("./surface3d.js");
      this._surface = new Surface3d();
      this._surface.show(...this._shown);
      this._surface.mark(this._index);
    } catch {
      this._isLoading = false; // tried again with the next forecast
    }
  }
}
