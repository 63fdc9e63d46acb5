/** Error messages, visible and announced to screen readers. */

import { LostService, ServiceProblem } from "./api.js";
import { byId, make } from "./dom.js";
import { FootageError } from "./footage.js";

/** Fields of a request and the controls that set them. */
const CONTROLS = {
  seed: "seed", horizon: "horizon", steps: "horizon", num_objects: "balls-1", balls: "picks", model: "models",
  frame_rate: "spacing", frames: "source-footage", final_frame: "final", scenario: "scenario-ellipsoid",
};

/** The control of a field of a request, if there is one. */
function controlOf(field) {
  const [name] = (field ?? "").replace(/^scene\./, "").split(/[.[]/);
  return CONTROLS[name] ?? (document.getElementById(`scene-${name}`) ? `scene-${name}` : undefined);
}

export function clearMessages() {
  byId("messages").replaceChildren();
  for (const control of document.querySelectorAll("[aria-invalid]")) {
    control.removeAttribute("aria-invalid");
  }
}

/**
 * @param {Error} error
 * @param {() => void} [again] offered as a button
 */
export function showError(error, again) {
  console.info(error.message); // not an error of the page's
  const said = wordsFor(error);
  const box = make(
    "div",
    { class: "message" },
    make("h2", {}, said.title),
    make("p", {}, said.detail),
    said.faults.length ? faultTable(said.faults) : null,
  );
  const buttons = make("p", { class: "buttons" });
  if (again) buttons.append(make("button", { type: "button", onclick: again }, "Try again"));
  const close = () => box.remove();
  buttons.append(make("button", { type: "button", class: "quiet", onclick: close }, "Dismiss"));
  box.append(buttons);
  byId("messages").replaceChildren(box);
  for (const { field } of said.faults) {
    document.getElementById(controlOf(field))?.setAttribute("aria-invalid", "true");
  }
}

/** Say why something that was pressed has no effect. */
export function showNotice(text) {
  const box = make("div", { class: "message waiting" }, make("p", {}, text));
  const close = { type: "button", class: "quiet", onclick: () => box.remove() };
  box.append(make("p", { class: "buttons" }, make("button", close, "Dismiss")));
  byId("messages").replaceChildren(box);
}

/** Say that the service is asked again, and when. */
export function showWait(error, seconds, attempt) {
  const { title, detail } = wordsFor(error);
  byId("messages").replaceChildren(
    make(
      "div",
      { class: "message waiting" },
      make("h2", {}, title),
      make("p", {}, `${detail} Asking again in ${seconds} s (attempt ${attempt}).`),
    ),
  );
}

function wordsFor(error) {
  if (error instanceof ServiceProblem) {
    const { title, detail, errors, field, status } = error.problem;
    const faults = errors ?? (field ? [error.problem] : []);
    return { title: `${title} (${status})`, detail: inSentence(detail), faults };
  }
  if (error instanceof LostService) {
    const detail = `${error.message} Is it still running at ${location.host}?`;
    return { title: "The service is lost", detail, faults: [] };
  }
  if (error instanceof FootageError) {
    return { title: "This footage cannot be used", detail: error.message, faults: [] };
  }
  console.error(error);
  return { title: "The page failed", detail: String(error.message ?? error), faults: [] };
}

function inSentence(text) {
  return /[.!?]$/.test(text) ? text : `${text}.`;
}

function faultTable(faults) {
  const head = ["Field", "Given", "Expected"].map((name) => make("th", { scope: "col" }, name));
  const rows = faults.map(({ field, value, expected }) =>
    make(
      "tr",
      {},
      make("td", {}, make("code", {}, field ?? "")),
      make("td", {}, make("code", {}, JSON.stringify(value ?? null))),
      make("td", {}, expected ?? ""),
    ),
  );
  return make(
    "table",
    {},
    make("thead", {}, make("tr", {}, ...head)),
    make("tbody", {}, ...rows),
  );
}
