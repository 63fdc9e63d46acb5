/** The call that the page makes, for a shell and for Python. */

import { address } from "./api.js";
import { parametersOf } from "./scene_panel.js";

const FILES = ["frame-0.png", "frame-1.png", "frame-2.png", "frame-3.png"];

/**
 * @param {import("./session.js").Session} session
 * @param {import("./state.js").Choices} choices
 * @param {object} request fields of /predict other than frames and model
 * @returns {{curl: string, python: string}}
 */
export function snippetsOf(session, choices, request) {
  const base = address("").replace(/\/$/, "");
  const calls = { session, models: choices.models, request, base, final: session.finalIndex };
  return session.take.kind === "scene"
    ? { curl: curlOfScene(calls, choices), python: pythonOfScene(calls, choices) }
    : { curl: curlOfFiles(calls), python: pythonOfFiles(calls) };
}

function curlOfScene({ session, models, request, base, final }, choices) {
  const { scenario, balls, seed } = choices;
  const steps = session.take.frames.length;
  const scene = { scenario, num_objects: balls, seed: Number(seed), steps, ...parametersOf(choices) };
  const finalFrame = final === null ? "" : `, "final_frame": f[${final}]`;
  const fields = models.map((model) => JSON.stringify({ model, ...request }).slice(1, -1));
  const bodies = fields.map(
    (text, index) =>
      `python3 -c 'import json; f = json.load(open("scene.json"))["frames"]; ` +
      `print(json.dumps({${text.replace(/:/g, ": ").replace(/,/g, ", ")}, "frames": f[:4]${finalFrame}}))' |\n` +
      `  curl -sS ${base}/predict -H 'Content-Type: application/json' -d @- -o ${outputOf(models, index)}`,
  );
  return [
    `curl -sS ${base}/simulate -H 'Content-Type: application/json' \\\n` +
      `  -d '${JSON.stringify(scene)}' -o scene.json`,
    ...bodies,
  ].join("\n");
}

function curlOfFiles({ models, request, base, final }) {
  const frames = FILES.map((file) => `-F frames=@${file}`).join(" ");
  return models
    .map((model, index) => {
      const fields = Object.entries({ model, ...request }).map(([name, value]) =>
        typeof value === "object" ? `-F '${name}=${JSON.stringify(value)}'` : `-F ${name}=${value}`,
      );
      if (final !== null) fields.push("-F final_frame=@final.png");
      return (
        `curl -sS ${base}/predict \\\n  ${frames} \\\n  ${fields.join(" ")} ` +
        `\\\n  -o ${outputOf(models, index)}`
      );
    })
    .join("\n");
}

function outputOf(models, index) {
  return models.length === 1 ? "forecast.json" : `forecast-${index}.json`;
}

function pythonOfScene(calls, choices) {
  const { session, final } = calls;
  const { scenario, balls, seed } = choices;
  const steps = session.take.frames.length;
  const { textured, start_step: start, scene } = parametersOf(choices);
  const fixed =
    (textured === undefined ? "" : ", textured=False") +
    (start === undefined ? "" : `, start_step=${start}`) +
    (scene === undefined ? "" : `, scene=${JSON.stringify(scene)}`);
  return python(
    calls,
    `    scene = client.simulate("${scenario}", num_objects=${balls}, seed=${Number(seed)}, steps=${steps}${fixed})\n`,
    `scene.frames[:4]${final === null ? "" : `, final_frame=scene.frames[${final}]`}`,
  );
}

function pythonOfFiles(calls) {
  const files = FILES.map((file) => `"${file}"`).join(", ");
  const final = calls.final === null ? "" : ', final_frame="final.png"';
  return python(calls, `    frames = [${files}]\n`, `frames${final}`);
}

/** A value of a request in Python; points are pairs. */
function literal(value) {
  if (!Array.isArray(value)) return JSON.stringify(value);
  return `[${value.map(({ x, y }) => `(${x}, ${y})`).join(", ")}]`;
}

function python({ models, request, base }, before, frames) {
  const fields = Object.entries(request).map(([name, value]) => `, ${name}=${literal(value)}`);
  const call = (model) => `client.predict(${frames}, model=${model}${fields.join("")})`;
  const names = JSON.stringify(models).replace(/,/g, ", ");
  const ask =
    models.length === 1
      ? `    forecasts = [${call(JSON.stringify(models[0]))}]\n`
      : `    forecasts = [\n        ${call("model")}\n        for model in ${names}\n    ]\n`;
  return (
    "from rollcast.client import Client\n\n" +
    `with Client("${base}") as client:\n${before}${ask}` +
    "for forecast in forecasts:\n" +
    "    print(forecast.model.name, forecast.positions[:, -1], forecast.covariances[:, -1])\n"
  );
}
