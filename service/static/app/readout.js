/** Words and figures around the pictures: legend, table, notes, controls' texts. */

import { byId, make } from "./dom.js";
import { curvesOf, mean } from "./figures.js";
import { MARKS } from "./palette.js";
import { LAST_SEEN } from "./state.js";
import { scoresOf } from "./verdict.js";

/** Who draws in which colour and with which mark. */
export function showLegend(forecasts, hasTruth) {
  const chips = forecasts.map(({ slot, label, done }) => {
    return make("span", {}, chipOf(slot), label, ...ballsOf(done));
  });
  if (hasTruth) {
    const chip = make("span", { class: "chip", "aria-hidden": "true" }, "○");
    chip.dataset.slot = "truth";
    chips.push(make("span", {}, chip, "truth"));
  }
  byId("legend").replaceChildren(...chips);
}

/** A row a forecast: its figures at the moment that is shown, and over all its steps. */
export function showFigures(forecasts, truth, index) {
  const rows = forecasts.map((forecast) => {
    const { errors, radii, held } = curvesOf(forecast, truth);
    const step = index - LAST_SEEN;
    const known = errors.filter((error) => error !== null);
    const name = make("th", { scope: "row" }, chipOf(forecast.slot), forecast.label);
    const cells = [
      pixels(errors[step]),
      pixels(radii[step]),
      held[step] === true ? "yes" : held[step] === false ? "no" : "–",
      pixels(known.length ? mean(known) : null),
      forecast.state === "failed"
        ? "failed"
        : forecast.firstStepMs
          ? `${Math.round(forecast.firstStepMs)} ms`
          : "…",
    ].map((text) => make("td", {}, text));
    return make("tr", {}, name, ...cells);
  });
  byId("figures").tBodies[0].replaceChildren(...rows);
}

/** The balls of a user's own set-up, in the order of a forecast's objects. */
function ballsOf(done) {
  const balls = (done?.objects ?? []).filter(({ color }) => color.startsWith("#"));
  return balls.map(({ id, color }) => {
    const ball = make("span", { class: "ball", title: `ball ${id}: ${color}` });
    ball.style.backgroundColor = color;
    return ball;
  });
}

function chipOf(slot) {
  const chip = make("span", { class: "chip", "aria-hidden": "true" }, MARKS[slot]);
  chip.dataset.slot = String(slot);
  return chip;
}

function pixels(value) {
  return value === null || value === undefined ? "–" : `${value.toFixed(1)} px`;
}

/** The figures and warnings of the answers, each once, and what the page itself has to say. */
export function showNotes(take, forecasts) {
  const said = forecasts.flatMap(({ label, done }) =>
    (done?.warnings ?? []).map((warning) => (forecasts.length > 1 ? `${label}: ${warning}` : warning)),
  );
  const warnings = [...new Set([...(take?.notes ?? []), ...said, ...ballWarnings(forecasts)])];
  const notes = [...warnings, ...scoresOf(forecasts)];
  const count = warnings.length ? ` (${warnings.length})` : "";
  byId("notes-title").textContent = `Warnings and figures${count}`;
  byId("notes-panel").hidden = !notes.length;
  const shown = [...byId("notes").children].map(({ textContent }) => textContent);
  if (shown.join("\n") === notes.join("\n")) return;
  byId("notes").replaceChildren(...notes.map((note) => make("li", {}, note)));
}

function ballWarnings(forecasts) {
  return forecasts.flatMap(({ done }) =>
    (done?.objects ?? []).flatMap(({ id, warnings }) =>
      (warnings ?? []).map((warning) => `Ball ${id + 1}: ${warning}`),
    ),
  );
}

export function showHealth(status) {
  const words = {
    ready: "ready",
    loading: "loading models",
    draining: "shutting down",
    "no usable model": "no usable model",
    lost: "service lost",
  };
  const pill = byId("health");
  if (pill.dataset.status === status) return;
  pill.dataset.status = status;
  pill.firstElementChild.textContent = words[status] ?? status;
}
