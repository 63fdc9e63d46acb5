/** The form of choices: input events and displayed text. */

import { byId } from "./dom.js";
import {
  finalStepOf, forAnyNumber, isServed, rateOf, showModels, stillFitting,
} from "./models.js";
import { showPicks } from "./picks.js";
import { installScenePanel, showScenePanel } from "./scene_panel.js";
import { MOST_BALLS, MOST_SIMULATED, pointsOf } from "./state.js";

const SCENARIOS = ["hemisphere", "ellipsoid", "heightfield", "table"];
const RADIOS = { source: String, scenario: String, balls: Number };

/**
 * @param {ReturnType<typeof import("./state.js").createStore>} store of choices
 */
export function installControls(store) {
  for (const [name, read] of Object.entries(RADIOS)) {
    for (const radio of document.querySelectorAll(`input[name="${name}"]`)) {
      radio.addEventListener("change", () => store.set({ [name]: read(radio.value) }));
    }
  }
  byId("seed").addEventListener("change", () => store.set({ seed: byId("seed").value.trim() }));
  byId("dice").addEventListener("click", () => {
    store.set({ seed: String(Math.floor(Math.random() * 100_000)) });
  });
  installScenePanel(store);
  byId("horizon").addEventListener("input", () => {
    showHorizon(Number(byId("horizon").value), Number(byId("horizon").dataset.rate));
  });
  byId("horizon").addEventListener("change", () => {
    store.set({ horizon: Number(byId("horizon").value) });
  });
  byId("final").addEventListener("change", () => store.set({ finalFrame: byId("final").checked }));
  for (const name of ["ellipses", "truth"]) {
    byId(name).addEventListener("change", () => store.set({ [name]: byId(name).checked }));
  }
  byId("split").addEventListener("change", () => {
    store.set({ layout: byId("split").checked ? "split" : "overlay" });
  });
  byId("speed").addEventListener("change", () => store.set({ speed: Number(byId("speed").value) }));
  byId("fold").addEventListener("click", () => {
    const open = byId("controls").classList.toggle("open");
    byId("fold").setAttribute("aria-expanded", String(open));
  });
}

/**
 ** Return the choices that the served models support.
 * @param {import("./state.js").Choices} choices
 */
export function possible(choices, entries) {
  const change = {};
  // A running picture has neither a last frame to choose points on nor a final one.
  if (choices.source === "camera" && choices.points) change.points = "";
  if (choices.source === "camera" && choices.finalFrame) change.finalFrame = false;
  const source = { ...choices, ...change };
  const any = forAnyNumber(entries, choices);
  if (choices.points && entries.length && !any) change.points = source.points = "";
  const isNone = choices.source === "scene" && choices.balls > MOST_SIMULATED;
  if (isNone || (choices.balls === 0 && entries.length && (choices.source === "scene" || !any))) {
    change.balls = source.balls = 1;
  }
  if (!isServed(entries, { ...source, finalFrame: false }) && entries.length) {
    change.balls = source.balls = 1;
  }
  if (choices.finalFrame && !isServed(entries, source)) {
    change.finalFrame = source.finalFrame = false;
  }
  const models = stillFitting(choices.models, entries, source);
  if (models.join() !== choices.models.join()) change.models = models;
  return change;
}

/** Show the current choices in the form. */
export function showControls(choices, entries, store) {
  for (const name of Object.keys(RADIOS)) {
    for (const radio of document.querySelectorAll(`input[name="${name}"]`)) {
      radio.checked = radio.value === String(choices[name]);
    }
  }
  if (document.activeElement !== byId("seed")) byId("seed").value = choices.seed;
  byId("scene-controls").hidden = choices.source !== "scene";
  byId("footage-controls").hidden = choices.source !== "footage";
  byId("camera-controls").hidden = choices.source !== "camera";
  for (const id of ["models-field", "final-field", "go"]) byId(id).hidden = choices.source === "camera";
  for (const name of ["ellipses", "truth"]) byId(name).checked = choices[name];
  byId("truth").disabled = choices.source !== "scene";
  byId("split").checked = choices.layout === "split";
  byId("split").disabled = choices.models.length < 2;
  byId("view-hint").textContent = viewHint(choices);
  byId("speed").value = String(choices.speed);
  showScenePanel(choices);
  showBalls(choices, entries);
  showFinal(choices, entries);
  showModels(entries, choices, (models) => store.set({ models }));
  byId("summary").textContent = summaryOf(choices);
}

/** Show whether the service can simulate; otherwise footage is the only source of frames. */
export function showSimulation(isInstalled) {
  const radio = byId("source-scene");
  radio.disabled = !isInstalled;
  radio.nextElementSibling.textContent = isInstalled
    ? "Simulation"
    : "Simulation (not installed)";
}

/** Why options of the picture cannot be chosen. */
function viewHint({ source, models }) {
  if (source === "camera") return "";
  const reasons = [];
  if (models.length < 2) reasons.push("Side by side needs a second model.");
  if (source !== "scene") reasons.push("Only simulations have a true path.");
  return reasons.join(" ");
}

function showBalls(choices, entries) {
  const numbers = { ...choices, points: "", finalFrame: false };
  const served = (balls) => isServed(entries, { ...numbers, balls });
  for (let balls = 0; balls <= MOST_BALLS; balls++) {
    const radio = byId(`balls-${balls}`);
    radio.disabled = !served(balls);
    const isExtra = balls === 0 || balls > MOST_SIMULATED;
    radio.parentElement.hidden = isExtra && (choices.source === "scene" || !served(balls));
  }
  const isOffered = choices.source !== "camera" && forAnyNumber(entries, choices) !== null;
  showPicks(pointsOf(choices), isOffered);
  const absent = [2, 3].filter((balls) => !served(balls));
  byId("balls-hint").hidden = !absent.length || !entries.length;
  byId("balls-hint").textContent = absent.map((balls) => absentHint(balls, numbers, entries)).join(" ");
}

/** Where a number of balls has a model. */
function absentHint(balls, choices, entries) {
  const known = SCENARIOS.filter((scenario) => isServed(entries, { ...choices, scenario, balls }));
  return known.length
    ? `For ${balls} balls there are models of the ${known.join(" and the ")} alone.`
    : `No model for ${balls} balls is served.`;
}

function showFinal(choices, entries) {
  const finalStep = finalStepOf(entries, choices);
  byId("final").checked = choices.finalFrame;
  byId("final").disabled = finalStep === null;
  byId("final-hint").textContent = finalHint(choices, finalStep);
  byId("horizon").disabled = choices.finalFrame;
  const horizon = choices.finalFrame ? finalStep + 1 : choices.horizon;
  byId("horizon").value = String(horizon);
  const rate = rateOf(entries, choices);
  byId("horizon").dataset.rate = String(rate);
  showHorizon(horizon, rate);
}

function finalHint({ source, finalFrame }, finalStep) {
  if (source === "camera") return "";
  if (finalStep === null) return "No model that is served takes one.";
  return finalFrame
    ? `It shows step ${finalStep}, so the horizon is ${finalStep + 1} steps.`
    : "";
}

/** Say how far the horizon reaches at the rate of the frames that are there. */
export function showRate(rate) {
  if (byId("horizon").dataset.rate === String(rate)) return;
  byId("horizon").dataset.rate = String(rate);
  showHorizon(Number(byId("horizon").value), rate);
}

function showHorizon(steps, rate) {
  byId("horizon-text").textContent = `${steps} steps, ${(steps / rate).toFixed(2)} s`;
}

function summaryOf({ source, scenario, seed, balls, models }) {
  const others = { footage: "your footage", camera: "camera" };
  const what = others[source] ?? `${scenario}, seed ${seed}`;
  const number = balls === 0 ? "any balls" : balls === 1 ? "1 ball" : `${balls} balls`;
  return `${what} · ${number} · ${source === "camera" ? "auto" : models.join(", ")}`;
}
