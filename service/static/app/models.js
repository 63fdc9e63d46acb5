/** Models that fit the current choices, and the list from which up to three are selected. */

import { byId, make } from "./dom.js";
import { MARKS } from "./palette.js";
import { isAmong } from "./resample.js";
import { FRAME_RATE_HZ, MOST_MODELS } from "./state.js";

export const AUTO = "auto";

/**
 * Models that can answer, those with the lowest validation error first.
 * @param {object[]} entries of GET /models
 * @param {import("./state.js").Choices} choices
 */
export function fitting(entries, choices) {
  const { source, scenario, finalFrame } = choices;
  return entries
    .filter(
      (entry) =>
        entry.status === "ready" &&
        follows(entry, choices) &&
        entry.frames === (finalFrame ? 5 : 4) &&
        (source !== "scene" || knows(entry, scenario)),
    )
    .sort((a, b) => errorOf(a) - errorOf(b));
}

/** Whether a model forecasts a scenario; tables are level ground, of which none is a model's own. */
function knows(entry, scenario) {
  return scenario === "table" ? isForAny(entry) : entry.scenarios.includes(scenario);
}

/** Whether a model forecasts the balls that are chosen, by their number or by points. */
function follows(entry, { balls, points }) {
  if (points) return isForAny(entry);
  if (!isForAny(entry)) return entry.objects === balls;
  return balls === 0 || (entry.objects <= balls && balls <= entry.max_objects);
}

/** Whether a model follows any number of balls, in frames of any rectangle. */
export function isForAny(entry) {
  return (entry.max_objects ?? null) !== null;
}

/** The model for any number of balls that "auto" would use; null if none is served. */
export function forAnyNumber(entries, choices) {
  const open = { ...choices, balls: 0, points: "", finalFrame: false };
  return fitting(entries, open).find(isForAny) ?? null;
}

/** Whether every chosen model can be sent whole pictures; "auto" then takes one that reads them. */
export function readRectangles(entries, choices) {
  if (choices.finalFrame || forAnyNumber(entries, choices) === null) return false;
  const found = fitting(entries, choices);
  return choices.models.every(
    (name) => name === AUTO || found.some((entry) => labelOf(entry) === name && isForAny(entry)),
  );
}

/**
 * The model that the frames are made for: the first one chosen. "auto" takes one for footage only
 * where no other forecasts so many balls.
 */
export function leading(entries, choices) {
  const found = fitting(entries, choices);
  const [name] = choices.models;
  if (name !== AUTO) return found.find((entry) => labelOf(entry) === name) ?? null;
  const general = found.filter((entry) => !entry.setup);
  return general.find((entry) => !isForAny(entry)) ?? general[0] ?? found[0] ?? null;
}

/**
 * Lowest and highest rate of frames that every chosen model is told, frames a second; null where one
 * of them is not told the rate. "auto" takes a model that is told it for frames at another rate than
 * the usual one.
 */
export function toldRates(entries, choices) {
  if (choices.finalFrame) return null;
  const found = fitting(entries, choices);
  const told = choices.models.map((name) => {
    const isIt = (entry) => (name === AUTO ? isForAny(entry) && entry.default : labelOf(entry) === name);
    return found.find(isIt)?.frame_rates_hz ?? null;
  });
  if (told.includes(null)) return null;
  return [Math.max(...told.map(([low]) => low)), Math.min(...told.map(([, high]) => high))];
}

/** Steps of a forecast up to which its model was trained; later ones are extrapolated. */
export function trainedSteps(entries, { model, frame_rate: rate }) {
  const entry = entries.find((one) => one.name === model.name && one.version === model.version);
  const isTold = entry?.frame_rates_hz && isAmong(rate, entry.frame_rates_hz);
  const spacing = isTold ? entry.frame_rate_hz / rate : 1;
  return 1 + Math.floor((model.trained_horizon - 1) / spacing + 1e-9);
}

/** Frames a second that a model expects. */
export function rateOf(entries, choices) {
  return leading(entries, choices)?.frame_rate_hz ?? FRAME_RATE_HZ;
}

/** Whether anything is served for a number of balls in a scenario. */
export function isServed(entries, choices) {
  return fitting(entries, choices).length > 0;
}

/** A bare name means the default version. */
export function labelOf(entry) {
  return entry.default ? entry.name : `${entry.name}@${entry.version}`;
}

/** The step that a final frame shows, for a number of balls; null where no model takes one. */
export function finalStepOf(entries, choices) {
  const [entry] = fitting(entries, { ...choices, finalFrame: true });
  return entry?.final_step ?? null;
}

/** Keep of the chosen models those that fit; one at least, each once. */
export function stillFitting(chosen, entries, choices) {
  const known = new Set([AUTO, ...fitting(entries, choices).map(labelOf)]);
  const kept = [...new Set(chosen)].filter((name) => known.has(name)).slice(0, MOST_MODELS);
  return kept.length ? kept : [AUTO];
}

function errorOf(entry) {
  return entry.metrics?.validation_error_px ?? Infinity;
}

/**
 * Show the list.
 * @param {(chosen: string[]) => void} chose
 */
export function showModels(entries, choices, chose) {
  const rows = [
    { name: AUTO, about: "the best that fits" },
    ...fitting(entries, choices).map((entry) => ({
      name: labelOf(entry),
      about: `${entry.setup ? "own set-up, " : ""}${errorOf(entry).toFixed(2)} px`,
      title: `${entry.variant}, ${entry.preset}: mean error on validation data up to its trained horizon of ${entry.trained_horizon} steps, in 128-pixel frames`,
    })),
  ];
  const list = byId("models");
  const focused = document.activeElement?.closest("#models") && document.activeElement.value;
  list.replaceChildren(...rows.map((row) => rowOf(row, choices.models, chose)));
  if (focused) list.querySelector(`input[value="${focused}"]`)?.focus();
  showRefused(entries);
}

function rowOf({ name, about, title = "" }, chosen, chose) {
  const slot = chosen.indexOf(name);
  const box = make("input", {
    type: "checkbox",
    name: "model",
    value: name,
    checked: slot >= 0,
    disabled: slot < 0 && chosen.length >= MOST_MODELS,
  });
  box.addEventListener("change", () => {
    const others = chosen.filter((other) => other !== name);
    const next = box.checked ? [...others, name] : others;
    box.checked ||= next.length === 0; // at least one model stays selected
    if (next.length) chose(next);
  });
  const chip = make("span", { class: "chip", "aria-hidden": "true" }, MARKS[slot] ?? "");
  if (slot >= 0) chip.dataset.slot = String(slot);
  return make(
    "label",
    { title },
    box,
    chip,
    make("span", { class: "model-name" }, name),
    make("span", { class: "model-about" }, about),
  );
}

function showRefused(entries) {
  const absent = entries.filter((entry) => entry.status !== "ready");
  const text = absent.map((entry) => `${entry.name}@${entry.version} is ${entry.status}`).join(", ");
  byId("refused").textContent = text ? `Not served: ${text}.` : "";
}
