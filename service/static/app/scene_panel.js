/** The folded panel of a scene's parameters; empty ones are sampled from the seed. */

import { byId, make } from "./dom.js";

const GROUNDS = ["heightfield", "table"];

/**
 * Numbers that `POST /simulate` takes, those of one scenario or of several balls only there.
 * @type {{name: string, label: string, min: number, max: number, step: number,
 *   scenarios?: string[], several?: boolean}[]}
 */
const NUMBERS = [
  { name: "radius_m", label: "Ball radius, m", min: 0.03, max: 0.25, step: 0.005 },
  { name: "axis_ratio", label: "Axis ratio", min: 0.4, max: 1, step: 0.05, scenarios: ["ellipsoid"] },
  { name: "noise_scale", label: "Width of hills, m", min: 0.2, max: 0.7, step: 0.05, scenarios: ["heightfield"] },
  { name: "friction", label: "Friction", min: 0.01, max: 1, step: 0.01 },
  { name: "rolling_resistance", label: "Rolling resistance", min: 0, max: 0.3, step: 0.001 },
  { name: "damping", label: "Air drag", min: 0, max: 1, step: 0.01 },
  { name: "wall_restitution", label: "Bounce of walls", min: 0.1, max: 1, step: 0.05, scenarios: GROUNDS },
  { name: "wall_friction", label: "Friction of walls", min: 0, max: 1, step: 0.05, scenarios: GROUNDS },
  { name: "ball_restitution", label: "Bounce of balls", min: 0.1, max: 1, step: 0.05, several: true },
  { name: "ball_friction", label: "Friction of balls", min: 0.01, max: 1, step: 0.01, several: true },
  { name: "start_step", label: "First frame", min: 0, max: 900, step: 1 },
];
const WHITE = "white";

/** Chosen parameters by name, without invalid text. */
function valuesOf({ scene }) {
  const given = new Map(scene.split(";").map((pair) => pair.split("=")));
  const values = {};
  for (const { name, min, max } of NUMBERS) {
    const value = Number(given.get(name));
    if (given.get(name) && value >= min && value <= max) values[name] = value;
  }
  if (given.has(WHITE)) values[WHITE] = true;
  return values;
}

/** The choices' text, as it stands in the address. */
function textOf(values) {
  return Object.entries(values)
    .map(([name, value]) => (value === true ? name : `${name}=${value}`))
    .join(";");
}

/** Understood text of an address. */
export function readScene(scene) {
  return textOf(valuesOf({ scene }));
}

function applies({ scenarios, several }, { scenario, balls }) {
  return (!scenarios || scenarios.includes(scenario)) && (!several || balls > 1);
}

/** Chosen and applicable parameters by name. */
function fixedOf(choices) {
  const values = valuesOf(choices);
  const fixed = {};
  for (const number of NUMBERS) {
    if (number.name in values && applies(number, choices)) fixed[number.name] = values[number.name];
  }
  if (values[WHITE] && choices.balls === 1) fixed.textured = false;
  return fixed;
}

/**
 * The fields of `POST /simulate` that are fixed.
 * @param {import("./state.js").Choices} choices
 */
export function parametersOf(choices) {
  const { textured, start_step, ...scene } = fixedOf(choices);
  return {
    ...(textured === undefined ? {} : { textured }),
    ...(start_step === undefined ? {} : { start_step }),
    ...(Object.keys(scene).length ? { scene } : {}),
  };
}

/** @param {ReturnType<typeof import("./state.js").createStore>} store of choices */
export function installScenePanel(store) {
  const set = (name, value) => {
    const values = valuesOf(store.get());
    if (value === null || value === false) delete values[name];
    else values[name] = value;
    store.set({ scene: textOf(values) });
  };
  byId("scene-numbers").replaceChildren(
    ...NUMBERS.map(({ name, label, min, max, step }) => {
      const id = `scene-${name}`;
      const input = make("input", {
        id, type: "number", min: String(min), max: String(max), step: String(step), placeholder: "sampled",
      });
      input.addEventListener("change", () => {
        const fits = input.value === "" || input.checkValidity();
        input.setAttribute("aria-invalid", String(!fits));
        if (fits) set(name, input.value === "" ? null : Number(input.value));
        else input.reportValidity();
      });
      return make("label", { class: "field", for: id }, `${label} `, input);
    }),
  );
  byId("scene-white").addEventListener("change", () => set(WHITE, byId("scene-white").checked));
  byId("scene-reset").addEventListener("click", () => store.set({ scene: "" }));
}

/** Show the chosen parameters in the panel. */
export function showScenePanel(choices) {
  const values = valuesOf(choices);
  for (const number of NUMBERS) {
    const input = byId(`scene-${number.name}`);
    input.parentElement.hidden = !applies(number, choices);
    if (document.activeElement !== input) input.value = values[number.name] ?? "";
  }
  byId("scene-white").checked = Boolean(values[WHITE]);
  byId("scene-white").parentElement.hidden = choices.balls !== 1;
  const count = Object.keys(fixedOf(choices)).length;
  byId("scene-count").textContent = count ? `${count} fixed` : "";
  byId("scene-reset").disabled = !Object.keys(values).length;
}
