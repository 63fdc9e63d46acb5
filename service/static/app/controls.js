/** The form of choices: input events and displayed text. */

import { byId } from "./dom.js";
import {
  finalStepOf, forAnyNumber, isServed, rateOf, showModels, stillFitting,
} from "./models.js";
import { showPicks } from "./picks.js";
import { installScenePanel, showScenePanel } from "./scene_panel.js";
import { pointsOf } from "./state.js";

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
  if (choices.balls === 0 && entries.length && (choices.source === "scene" || !any)) {
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

function showBalls(choices, entries) {
  const numbers = { ...choices, points: "", finalFrame: false };
  const served = (balls) => isServed(entries, { ...numbers, balls });
  for (const balls of [0, 1, 2, 3, 4]) byId(`balls-${balls}`).disabled = !served(balls);
  byId("balls-0").parentElement.hidden = choices.source === "scene" || !served(0);
  const isOffered = choices.source !== "camera" && forAnyNumber(entries, choices) !== null;
  showPicks(pointsOf(choices), isOffered);
  // No scene has four.
  byId("balls-4").parentElement.hidden = choices.source === "scene" || !served(4);
  const absent = [2, 3].filter((balls) => !served(balls));
  const elsewhere = SCENARIOS.filter((scenario) =>
    absent.some((balls) => isServed(entries, { ...numbers, scenario, balls })),
  );
  byId("balls-hint").hidden = !absent.length || !entries.length;
  byId("balls-hint").textContent = elsewhere.length
    ? `For ${absent.join(" and ")} balls there are models of the ${elsewhere.join(" and the ")} alone.`
    : `No model for ${absent.join(" or ")} balls is served.`;
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

function showHorizon(steps, rate) {
  byId("horizon-text").textContent = `${steps} steps, ${(steps / rate).toFixed(2)} s`;
}

function summaryOf({ source, scenario, seed, balls, models }) {
  const others = { footage: "your footage", camera: "camera" };
  const what = others[source] ?? `${scenario}, seed ${seed}`;
  const number = balls === 0 ? "any balls" : balls === 1 ? "1 ball" : `${balls} balls`;
  return `${what} · ${number} · ${source === "camera" ? "auto" : models.join(", ")}`;
}
