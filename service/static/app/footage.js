/** Images or a video that the user brings, as pictures at given times. */

import { canvasOf, make } from "./dom.js";

/** The footage cannot be used; the message is for its user. */
export class FootageError extends Error {}

/**
 * @typedef {object} Shot what the camera took
 * @property {number} timeS
 * @property {CanvasImageSource} picture valid until the next shot is asked for
 */

/**
 * @param {File[]} files
 * @returns {Promise<ImageFootage | VideoFootage>}
 */
export async function openFootage(files) {
  const video = files.find((file) => file.type.startsWith("video/"));
  if (video) return VideoFootage.open(video);
  const images = files.filter((file) => file.type.startsWith("image/"));
  if (!images.length) {
    const names = files.map((file) => file.name).join(", ") || "what was dropped";
    throw new FootageError(`${names}: neither images nor a video that this browser knows.`);
  }
  return ImageFootage.open(images);
}

/** Images that follow each other evenly. */
export class ImageFootage {
  /** @param {File[]} files */
  static async open(files) {
    if (files.length < 4) {
      throw new FootageError(`Four images are needed at least, in order; here are ${files.length}.`);
    }
    const order = new Intl.Collator("en", { numeric: true });
    const sorted = files.toSorted((a, b) => order.compare(a.name, b.name));
    const footage = new ImageFootage(sorted);
    await footage._decode(0);
    return footage;
  }

  constructor(files) {
    this.kind = "images";
    this.name = `${files.length} images, ${files[0].name} to ${files.at(-1).name}`;
    /** Images a second: the files do not tell, their user does. */
    this.rate = 40;
    this._files = files;
    this._decoded = new Map();
  }

  get durationS() {
    return (this._files.length - 1) / this.rate;
  }

  /** Seconds between two shots near a time. */
  async intervalAt() {
    return 1 / this.rate;
  }

  /** The last shot at or before a time; null after the end. */
  async shotAt(timeS) {
    const index = Math.floor(timeS * this.rate + 1e-6);
    if (index >= this._files.length) return null;
    return { timeS: index / this.rate, picture: await this._decode(Math.max(index, 0)) };
  }

  async _decode(index) {
    const file = this._files[index];
    if (!this._decoded.has(index)) {
      const bitmap = await createImageBitmap(file).catch(() => {
        throw new FootageError(`${file.name} cannot be read as an image.`);
      });
      this.width ??= bitmap.width;
      this.height ??= bitmap.height;
      if (bitmap.width !== this.width || bitmap.height !== this.height) {
        throw new FootageError(
          `${file.name} is ${bitmap.width} × ${bitmap.height}, the first image ` +
            `${this.width} × ${this.height}: all have to be of one size.`,
        );
      }
      this._forgetOldest();
      this._decoded.set(index, bitmap);
    }
    return this._decoded.get(index);
  }

  _forgetOldest() {
    if (this._decoded.size < 8) return;
    const [oldest, bitmap] = this._decoded.entries().next().value;
    bitmap.close();
    this._decoded.delete(oldest);
  }

  close() {
    for (const bitmap of this._decoded.values()) bitmap.close();
    this._decoded.clear();
  }
}

/** A video that the browser decodes. */
export class VideoFootage {
  /** @param {File} file */
  static async open(file) {
    const video = make("video", { muted: true, playsInline: true, preload: "auto" });
    video.src = URL.createObjectURL(file);
    await new Promise((resolve, reject) => {
      video.addEventListener("loadeddata", resolve, { once: true });
      video.addEventListener(
        "error",
        () => reject(new FootageError(`This browser cannot decode ${file.name}.`)),
        { once: true },
      );
    });
    if (!video.videoWidth) throw new FootageError(`${file.name} has no pictures in it.`);
    if (!Number.isFinite(video.duration)) await findDuration(video);
    return new VideoFootage(file, video);
  }

  constructor(file, video) {
    this.kind = "video";
    this.name = file.name;
    this._video = video;
    this._turn = Promise.resolve();
  }

  get width() {
    return this._video.videoWidth;
  }

  get height() {
    return this._video.videoHeight;
  }

  get durationS() {
    return this._video.duration;
  }

  /** Seconds between two shots near a time: the mean over five of them, since files round it. */
  async intervalAt(timeS) {
    const first = await this.shotAt(timeS);
    let next = null;
    for (let ahead = 0.004; ahead < 1 && !(next?.timeS > first.timeS); ahead *= 1.25) {
      next = await this.shotAt(first.timeS + ahead);
      if (next === null) return this._interval ?? 1 / 30;
    }
    if (!(next.timeS > first.timeS)) return 1;
    const one = next.timeS - first.timeS;
    const fifth = await this.shotAt(first.timeS + 4.5 * one);
    const shots = fifth ? Math.round((fifth.timeS - first.timeS) / one) : 1;
    this._interval = shots > 1 ? (fifth.timeS - first.timeS) / shots : one;
    return this._interval;
  }

  /** The last shot at or before a time; null after the end. One is looked for after the other. */
  shotAt(timeS) {
    const shot = this._turn.then(() => this._seek(timeS));
    this._turn = shot.catch(() => {});
    return shot;
  }

  async _seek(timeS) {
    const video = this._video;
    if (timeS >= video.duration + 1e-3) return null;
    let shownS = null;
    const tells = "requestVideoFrameCallback" in video;
    const shown = tells
      ? new Promise((resolve) => {
          video.requestVideoFrameCallback((_, { mediaTime }) => {
            shownS = mediaTime;
            resolve();
          });
        })
      : Promise.resolve();
    await new Promise((resolve, reject) => {
      video.addEventListener("seeked", resolve, { once: true });
      video.addEventListener("error", () => reject(new FootageError("The video broke off.")), {
        once: true,
      });
      // Half a millisecond, so that a time that was rounded down does not miss its own frame.
      video.currentTime = Math.min(Math.max(timeS, 0) + 0.0005, video.duration);
    });
    // Which frame it is comes with the frame; a browser that shows none anew says nothing.
    await Promise.race([shown, new Promise((resolve) => setTimeout(resolve, 400))]);
    if (shownS === null) shownS = tells && this._shownS <= timeS ? this._shownS : timeS;
    this._shownS = shownS;
    return { timeS: shownS, picture: video };
  }

  close() {
    URL.revokeObjectURL(this._video.src);
    this._video.removeAttribute("src");
    this._video.load();
  }
}

/** Recordings of browsers do not say how long they are until one looks for their end. */
function findDuration(video) {
  return new Promise((resolve) => {
    video.addEventListener("durationchange", function known() {
      if (!Number.isFinite(video.duration)) return;
      video.removeEventListener("durationchange", known);
      video.addEventListener("seeked", resolve, { once: true });
      video.currentTime = 0;
    });
    video.currentTime = 1e9;
  });
}

/** Cut a square out of a picture, at most 512 pixels a side: the models see 128. */
export function cut(picture, crop) {
  const side = Math.max(Math.min(Math.round(crop.size), 512), 32);
  const canvas = canvasOf(side);
  const context = canvas.getContext("2d");
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, crop.x, crop.y, crop.size, crop.size, 0, 0, side, side);
  return canvas;
}
