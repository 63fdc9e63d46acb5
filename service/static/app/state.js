/** Choices of the user, stored in the address of the page for sharing. */

import { readScene } from "./scene_panel.js";

/**
 * @typedef {object} Choices
 * @property {"scene" | "footage" | "camera"} source
 * @property {"hemisphere" | "ellipsoid" | "heightfield" | "table"} scenario
 * @property {number} balls 0 leaves the number to the model, of footage
 * @property {string} points of the last seen frame that select balls: "x,y;x,y", pixels
 * @property {string} seed as it was typed
 * @property {string} scene parameters that are fixed: "radius_m=0.1;white"
 * @property {string[]} models one to three, "auto" or names
 * @property {number} horizon steps
 * @property {boolean} finalFrame
 * @property {"overlay" | "split"} layout
 * @property {boolean} ellipses
 * @property {boolean} truth
 * @property {number} speed of the playback, 1 is real time
 */

export const MOST_MODELS = 3;
export const SEEN = 4;
/** Largest number of balls that a model follows. */
export const MOST_BALLS = 8;
/** Largest number of balls of a simulated scene. */
export const MOST_SIMULATED = 3;
/** Frames that the models see; frame i shows step i - 3. */
export const LAST_SEEN = SEEN - 1;

/** Frame rate of simulations, and of models that do not state one. */
export const FRAME_RATE_HZ = 40;

/** @type {Choices} */
const DEFAULTS = {
  source: "scene",
  scenario: "ellipsoid",
  balls: 1,
  points: "",
  seed: "7",
  scene: "",
  models: ["auto"],
  horizon: 40,
  finalFrame: false,
  layout: "overlay",
  ellipses: true,
  truth: true,
  speed: 0.5,
};

/** Choices that also work in another browser; footage is not shared. */
const SHARED = ["scenario", "balls", "points", "seed", "scene", "models", "horizon", "finalFrame", "layout"];

/**
 * A value whose changes are told to those who asked for it.
 * @template {object} T
 * @param {T} initial
 */
export function createStore(initial) {
  let state = initial;
  const listeners = new Set();
  return {
    get: () => state,
    /** @param {Partial<T>} change */
    set(change) {
      const before = state;
      state = { ...state, ...change };
      for (const listener of listeners) listener(state, before);
    },
    /** @param {(state: T, before: T) => void} listener */
    subscribe(listener) {
      listeners.add(listener);
    },
  };
}

/** Choices out of an address' fragment; unknown values keep their defaults. */
export function choicesFrom(fragment) {
  const given = new URLSearchParams(fragment.replace(/^#/, ""));
  const choices = { ...DEFAULTS };
  for (const name of SHARED) {
    const text = given.get(name);
    if (text !== null) choices[name] = parsed(text, DEFAULTS[name]);
  }
  if (!["hemisphere", "ellipsoid", "heightfield", "table"].includes(choices.scenario)) {
    choices.scenario = DEFAULTS.scenario;
  }
  choices.balls = Math.min(Math.max(Math.round(choices.balls) || 1, 1), MOST_SIMULATED);
  choices.points = textOf(pointsOf(choices));
  choices.scene = readScene(choices.scene);
  return choices;
}

/** Points that select balls, [x, y] in pixels. */
export function pointsOf({ points }) {
  return points
    .split(";")
    .map((pair) => pair.split(",").map(Number))
    .filter((pair) => pair.length === 2 && pair.every(Number.isFinite))
    .slice(0, MOST_BALLS);
}

/** Points as text of the address. */
export function textOf(points) {
  return points.map((pair) => pair.map((value) => Number(value.toFixed(1))).join(",")).join(";");
}

/** The fragment that brings back these choices. */
export function fragmentOf(choices) {
  const changed = SHARED.filter((name) => String(choices[name]) !== String(DEFAULTS[name]));
  return new URLSearchParams(changed.map((name) => [name, String(choices[name])])).toString();
}

function parsed(text, like) {
  if (Array.isArray(like)) return text.split(",").slice(0, MOST_MODELS);
  if (typeof like === "number") return Number(text) || like;
  if (typeof like === "boolean") return text === "true";
  return text;
}
