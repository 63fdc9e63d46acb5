/** Images or a video that the user brings, as pictures at given times. */

import { canvasOf, make } from "./dom.js";
import { FRAME_RATE_HZ } from "./state.js";

/** How long a browser may take to show a picture, and how long at the end, where there may be none. */
const PATIENCE_MS = 2000;
const END_MS = 500;

/** The footage cannot be used; the message is for its user. */
export class FootageError extends Error {}

/**
 * @typedef {object} Shot picture of the camera
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
    throw new FootageError(`${names}: neither images nor a video that this browser supports.`);
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
    this.rate = FRAME_RATE_HZ;
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
        () =>
          reject(
            new FootageError(
              `This browser cannot decode ${file.name}: H.264 in MP4 and VP9 in WebM work in most. ` +
                "rollcast predict, in a shell, reads every kind of video.",
            ),
          ),
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

  /**
   * Seconds between two shots near a time: the mean over some of them, since files round it. Every
   * search here ends at another shot than the one before, which is when browsers are quick.
   */
  async intervalAt(timeS) {
    const first = await this.shotAt(timeS);
    let later = null;
    for (let ahead = 0.05; ahead < 2 && !(later?.timeS > first.timeS); ahead *= 2) {
      later = await this.shotAt(first.timeS + ahead);
      if (later === null) return this._interval ?? 1 / 30;
    }
    const before = await this.shotAt(later.timeS - 0.002);
    const one = later.timeS - before.timeS;
    if (!(one > 0)) return 1 / 30;
    const last = (await this.shotAt(first.timeS + 5.5 * one)) ?? later;
    const shots = Math.round((last.timeS - first.timeS) / one);
    this._interval = shots > 1 ? (last.timeS - first.timeS) / shots : one;
    return this._interval;
  }

  /** The last shot at or before a time; null after the end. One is looked for after the other. */
  shotAt(timeS) {
    const shot = this._turn.then(() => this._seek(timeS));
    this._turn = shot.catch(() => {});
    return shot;
  }

  async _seek(timeS) {
    const { _video: video, _shownS: shownS, _interval: intervalS = 0 } = this;
    if (timeS >= video.duration + 1e-3) return null;
    const isSame = timeS >= shownS && timeS - shownS < 0.5 * intervalS;
    if (timeS !== this._askedS && !isSame) this._shownS = await this._shownAt(timeS);
    this._askedS = timeS;
    return { timeS: this._shownS, picture: video };
  }

  /**
   ** Seek to a time and return the time of the picture that is shown. A browser says so with every picture
   * that it shows anew; where it stays silent, it is sent away and back.
   */
  async _shownAt(timeS) {
    const video = this._video;
    const isLast = timeS > video.duration - 2e-3;
    const told = await this._goTo(timeS, isLast ? END_MS : PATIENCE_MS);
    if (told !== null) return told;
    if (isLast && this._shownS !== undefined) return this._shownS;
    await this._goTo(timeS > 0.5 ? timeS - 0.4 : timeS + 0.4, PATIENCE_MS);
    return (await this._goTo(timeS, PATIENCE_MS)) ?? timeS;
  }

  /** @returns {Promise<number | null>} when the picture was taken; null if the browser does not say */
  async _goTo(timeS, patienceMs) {
    const video = this._video;
    // Half a millisecond, so that a time that was rounded down does not miss its own frame.
    const target = Math.min(Math.max(timeS, 0) + 0.0005, video.duration);
    const seeked = new Promise((resolve, reject) => {
      video.addEventListener("seeked", resolve, { once: true });
      video.addEventListener("error", () => reject(new FootageError("The video broke off.")), {
        once: true,
      });
    });
    if (!("requestVideoFrameCallback" in video)) {
      video.currentTime = target;
      await seeked;
      return timeS;
    }
    let request = 0;
    const told = new Promise((resolve) => {
      const listen = () => {
        request = video.requestVideoFrameCallback((_, { mediaTime }) => {
          // A picture of the search before may come late.
          const isIt = mediaTime <= target + 1e-3 && target - mediaTime < 1;
          if (isIt && mediaTime !== this._toldS) resolve(mediaTime);
          else listen();
        });
      };
      listen();
    });
    video.currentTime = target;
    await seeked;
    const silence = new Promise((resolve) => setTimeout(() => resolve(null), patienceMs));
    const shownS = await Promise.race([told, silence]);
    video.cancelVideoFrameCallback(request);
    this._toldS = shownS ?? this._toldS;
    return shownS;
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

/** Sides of sent pictures, pixels: models for a fixed number of balls see 128 of a square. */
const LARGEST_SQUARE = 512;
const LARGEST_PICTURE = 1280;
const SMALLEST = 32;

/**
 * Cut a square, or a whole picture, out of a picture.
 * @param {{x: number, y: number, size: number} | {x: number, y: number, width: number, height: number}} crop
 */
export function cut(picture, crop) {
  const { x, y, width = crop.size, height = crop.size } = crop;
  const largest = crop.size ? LARGEST_SQUARE : LARGEST_PICTURE;
  const scale = Math.min(largest / Math.max(width, height), 1);
  const [across, down] = [width, height].map((side) => Math.max(Math.round(side * scale), SMALLEST));
  const canvas = canvasOf(across, down);
  const context = canvas.getContext("2d");
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, x, y, width, height, 0, 0, across, down);
  return canvas;
}
