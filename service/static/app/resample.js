/**
 * Frames at even times out of footage at any rate.
 *
 * As rollcast/footage.py does it: the camera's own frames are taken where their rate is a multiple of
 * the one asked for, or one that the model is told; where the camera took none near a time, the shots
 * before and after are faded into each other.
 */

import { cut, FootageError } from "./footage.js";

/** Relative difference between rates that counts as none. */
const RATE_TOLERANCE = 0.05;
/** Share of the time between two frames by which a shot may come early or late. */
const SNAP = 0.1;

/**
 * The time between frames: a multiple of the camera's own where that comes near the one wanted, or
 * where the model is told the rate.
 * @param {number} intervalS the camera's own
 * @param {number} wantedS
 * @param {[number, number] | null} told lowest and highest rate that the model is told
 */
export function spacingOf(intervalS, wantedS, told = null) {
  const multiple = Math.max(1, Math.round(wantedS / intervalS)) * intervalS;
  const isNear = Math.abs(multiple / wantedS - 1) <= RATE_TOLERANCE;
  return isNear || (told && isAmong(1 / multiple, told)) ? multiple : wantedS;
}

/** Whether a rate lies between two others, or is as good as one. */
export function isAmong(rate, [low, high]) {
  return low * (1 - RATE_TOLERANCE) <= rate && rate <= high * (1 + RATE_TOLERANCE);
}

/**
 * Yield frames from a start until the footage ends.
 * @param {import("./footage.js").ImageFootage | import("./footage.js").VideoFootage} footage
 * @param {{startS: number, spacingS: number, toldRates?: [number, number] | null, crop: object}} wanted
 *   crop as for `cut`, toldRates as for `spacingOf`
 * @returns {AsyncGenerator<{frame: HTMLCanvasElement, blendedOverS: number, spacingS: number}>}
 */
export async function* framesOf(footage, { startS, spacingS, toldRates = null, crop }) {
  const intervalS = await footage.intervalAt(startS);
  const evenS = spacingOf(intervalS, spacingS, toldRates);
  const isOwn = evenS !== spacingS || evenS === intervalS;
  const snap = (isOwn && footage.snap) || SNAP;
  const shots = new Shots(footage, intervalS, crop);
  const first = await shots.nearest(startS);
  if (!first) throw new FootageError(`The footage ends before ${startS.toFixed(3)} s.`);
  for (let index = 0; ; index++) {
    const frame = await shots.at(first.timeS + index * evenS, snap * evenS);
    if (!frame) return;
    yield { ...frame, spacingS: evenS };
  }
}

/** Shots that have been cut already: neighbours in time are asked for again and again. */
class Shots {
  constructor(footage, intervalS, crop) {
    this._footage = footage;
    this._intervalS = intervalS;
    this._crop = crop;
    this._cut = [];
  }

  async nearest(timeS) {
    const before = await this._before(timeS);
    const after = before && (await this._after(before));
    return after && after.timeS - timeS < timeS - before.timeS ? after : before;
  }

  async at(timeS, nearS) {
    const before = await this._before(timeS);
    if (!before) return null;
    if (Math.abs(before.timeS - timeS) <= nearS) return { frame: before.frame, blendedOverS: 0 };
    const after = await this._after(before);
    if (!after) return null;
    if (Math.abs(after.timeS - timeS) <= nearS) return { frame: after.frame, blendedOverS: 0 };
    const blendedOverS = after.timeS - before.timeS;
    const share = (timeS - before.timeS) / blendedOverS;
    return { frame: faded(before.frame, after.frame, share), blendedOverS };
  }

  async _before(timeS) {
    const known = this._cut.find(
      (shot) => shot.timeS <= timeS + 1e-4 && timeS < shot.timeS + 0.9 * this._intervalS,
    );
    return known ?? this._take(timeS);
  }

  async _after({ timeS }) {
    const known = this._cut
      .filter((shot) => shot.timeS > timeS + 1e-4)
      .sort((a, b) => a.timeS - b.timeS)[0];
    if (known && known.timeS - timeS < 1.5 * this._intervalS) return known;
    const next = await this._take(timeS + 1.5 * this._intervalS);
    if (!next || next.timeS <= timeS + 1e-4) return null;
    return next;
  }

  async _take(timeS) {
    const shot = await this._footage.shotAt(timeS);
    if (!shot) return null;
    const taken = { timeS: shot.timeS, frame: cut(shot.picture, this._crop) };
    this._cut.push(taken);
    if (this._cut.length > 8) this._cut.shift();
    return taken;
  }
}

function faded(before, after, share) {
  const canvas = document.createElement("canvas");
  canvas.width = before.width;
  canvas.height = before.height;
  const context = canvas.getContext("2d");
  context.drawImage(before, 0, 0);
  context.globalAlpha = share;
  context.drawImage(after, 0, 0);
  return canvas;
}
