/** The page: its parts and the events between them. */

import { health, LostService, models, ServiceProblem } from "./api.js";
import { Bring } from "./bring.js";
import { Chart } from "./chart.js";
import { installControls, possible, showControls, showRate, showSimulation } from "./controls.js";
import { byId } from "./dom.js";
import { signedSeconds } from "./figures.js";
import { LazySurface } from "./lazy_surface.js";
import { Live } from "./live.js";
import { clearMessages, showError, showNotice, showWait } from "./messages.js";
import {
  AUTO, finalStepOf, forAnyNumber, leading, rateOf, readRectangles, toldRates,
} from "./models.js";
import { Picks } from "./picks.js";
import { Player } from "./player.js";
import { showFigures, showHealth, showLegend, showNotes } from "./readout.js";
import { Session } from "./session.js";
import { installSharing } from "./sharing.js";
import { phaseOf, Stage } from "./stage.js";
import {
  choicesFrom, createStore, FRAME_RATE_HZ, fragmentOf, LAST_SEEN, pointsOf, textOf,
} from "./state.js";
import { installTheme } from "./theme.js";
import { installTransport, showTransport } from "./transport.js";
import { verdictOf } from "./verdict.js";
import { Zoom } from "./zoom.js";

const HEALTH_EVERY_MS = 5000;
/** Choices that only change how things are drawn; all others ask the service anew. */
const LOOKS = ["layout", "ellipses", "truth", "speed"];
/** Message before the first picture. */
const WAITING = {
  loading: "The service is loading its models …",
  "no usable model": "The service has no usable model.",
  draining: "The service is shutting down …",
  lost: "Waiting for the service …",
};
/** Status of `POST /simulate` when the service has no PyBullet. */
const NOT_INSTALLED = 501;
const CALM = matchMedia("(prefers-reduced-motion: reduce)");

const store = createStore(choicesFrom(location.hash));
let entries = [];
/** Whether the crop is being chosen, and no forecast is shown. */
let editing = false;

const stage = new Stage();
const player = new Player(showMoment);
const chart = new Chart((timeS) => {
  player.pause();
  player.seek(LAST_SEEN + timeS * (session.take?.rate ?? FRAME_RATE_HZ));
});
const surface = new LazySurface();
const session = new Session({
  changed: requestShow,
  waiting: showWait,
  answered: clearMessages,
});
const bring = new Bring({
  opened() {
    clearMessages();
    showStage();
    if (store.get().points) Object.assign(store.get(), { points: "" });
    suit(store.get());
    if (store.get().source === "footage") edit();
    else store.set({ source: "footage" });
  },
  changed() {
    if (!editing) edit();
  },
  failed: (error) => showError(error),
  canvas: () => stage.single(),
});

const live = new Live({
  canvas: () => stage.single(),
  wanted() {
    const choices = { ...store.get(), models: [AUTO] };
    const fields = { model: AUTO, horizon: choices.horizon };
    if (choices.balls) fields.num_objects = choices.balls;
    return {
      fields,
      rate: rateOf(entries, choices),
      toldRates: toldRates(entries, choices),
      isWhole: readRectangles(entries, choices),
      ellipses: choices.ellipses,
    };
  },
  entries: () => entries,
  changed: requestShow,
  clip: (file) => bring.open([file]),
});

const zoom = new Zoom({
  isOn: () => session.take !== null && !editing && store.get().source !== "camera",
  changed: requestShow,
});

const picks = new Picks({
  view: () => zoom.view,
  panned: (across, down) => zoom.move(across, down),
  refusal: () =>
    forAnyNumber(entries, store.get()) === null
      ? "Balls are selected for models that follow any number of them, and none is served here."
      : null,
  refused: showNotice,
  isLastSeen: () => player.index === LAST_SEEN && !player.playing,
  showLastSeen() {
    player.pause();
    player.seek(LAST_SEEN);
  },
  size: () => !editing && session.take && { width: session.take.width, height: session.take.height },
  changed: (points) => store.set({ points: textOf(scaled(points, 1 / session.pointScale)) }),
  dragged: () => showMoment(player.index),
});

/** Points that select balls, in pixels of the frames. */
function framePoints(choices) {
  return scaled(pointsOf(choices), session.pointScale);
}

function scaled(points, factor) {
  return points.map((pair) => pair.map((value) => value * factor));
}

/** The frames that the points in the address were chosen in. */
let pointed = null;
/** Points of earlier frames of the same footage, in the pixels of another crop of it. */
function pointsInFrames(choices) {
  const before = pointed;
  const { footage, wanted, width, height } = session.take;
  pointed = { footage, crop: wanted.crop, width };
  if (!choices.points || !before || before.footage !== footage) return choices.points;
  const [from, to] = [before, pointed].map(({ crop, width: across }) => ({
    ...crop,
    scale: (crop.size ?? crop.width) / across,
  }));
  const points = pointsOf(choices)
    .map(([x, y]) => [
      (from.x + x * from.scale - to.x) / to.scale,
      (from.y + y * from.scale - to.y) / to.scale,
    ])
    .filter(([x, y]) => x >= 0 && y >= 0 && x <= width && y <= height);
  return textOf(points);
}

/** What /predict is asked besides frames and model. */
function requestOf(choices) {
  const horizon = session.finalIndex === null ? choices.horizon : session.finalIndex - LAST_SEEN + 1;
  const points = framePoints(choices);
  const request = { horizon };
  if (points.length) request.balls = points.map(([x, y]) => ({ x, y }));
  else if (choices.balls) request.num_objects = choices.balls;
  if (choices.source === "scene") {
    return choices.scenario === "table" ? request : { ...request, scenario: choices.scenario };
  }
  return { ...request, frame_rate: Number(session.take.rate.toFixed(4)) };
}

/** Request of the current run: Enter in a field changes and submits at once. */
let running = null;
/** Whether the service went away in the middle of a run: it is done again when it is back. */
let interrupted = false;

async function run() {
  const choices = store.get();
  const asked = JSON.stringify(choices);
  if (choices.source === "camera" || running === asked) return;
  if (choices.source === "footage" && !bring.footage) {
    showNotice("There is no footage yet: choose a video, or at least four images.");
    return;
  }
  running = asked;
  interrupted = false;
  byId("stage").dataset.state = "busy";
  const signal = session.begin();
  const finalStep = choices.finalFrame ? finalStepOf(entries, choices) : null;
  session.finalIndex = finalStep === null ? null : finalStep + LAST_SEEN;
  const horizon = finalStep === null ? choices.horizon : finalStep + 1;
  player.pause();
  clearMessages();
  try {
    let others = null;
    if (choices.source === "scene") {
      showBusy("Simulating the scene …");
      others = await session.scene(choices, horizon + LAST_SEEN, signal);
    } else {
      showBusy("Taking the frames out of your footage …");
      others = await session.footage(bring.footage, bring.wanted, session.finalIndex, signal);
      choices.points = pointsInFrames(choices);
      showControls(choices, entries, store);
    }
    leaveEditing();
    begin(choices, horizon);
    const forecasts = session.forecast(choices.models, requestOf(choices), signal);
    const going = choices.source === "scene" ? "Loading the later frames …" : "Reading on in your footage …";
    showBusy(others ? going : null);
    await Promise.all([forecasts, others?.(horizon - 1 + LAST_SEEN)]);
    showBusy(null);
    showHealth("ready");
  } catch (error) {
    if (error.name === "AbortError") return;
    showBusy(null);
    if (error instanceof ServiceProblem && error.problem.status === NOT_INSTALLED) {
      showSimulation(false);
      store.set({ source: "footage" });
      showError(error);
      return;
    }
    showError(error, error instanceof ServiceProblem && error.problem.status === 422 ? undefined : run);
    interrupted = error instanceof LostService;
    if (interrupted) showHealth("lost");
  } finally {
    if (!signal.aborted) {
      running = null;
      requestShow();
    }
  }
}

let shownTake = null;
/** Set the clock to the beginning of what has just come. */
function begin(choices, horizon) {
  picks.points = framePoints(choices); // the frames may have another size than those before
  player.last = horizon - 1 + LAST_SEEN;
  player.arrived = LAST_SEEN;
  player.framesPerSecond = session.take.rate;
  player.speed = choices.speed;
  session.forecasts = [];
  if (session.take !== shownTake) zoom.reset();
  shownTake = session.take;
  stage.showSeen(session.take, session.finalIndex);
  // Points are chosen on the last seen frame, which stays until all of them are.
  player.seek(choices.points ? LAST_SEEN : 0);
  if (choices.points) return;
  if (CALM.matches) player.seek(player.last);
  else player.play();
}

/** Set the footage to the frame rate and, for a set-up, the crop of the selected model. */
function suit(choices) {
  const wish = { ...choices, source: "footage" };
  bring.offerWhole(readRectangles(entries, wish));
  return bring.suit({
    rate: rateOf(entries, wish),
    toldRates: toldRates(entries, wish),
    crop: leading(entries, wish)?.setup?.crop ?? null,
  });
}

function edit() {
  stop();
  editing = true;
  session.take = null;
  session.forecasts = [];
  player.pause();
  showBusy(null);
  byId("stage").dataset.mode = "editing";
  byId("stage-title").textContent = "Choose where it begins, and the square";
  requestShow();
  bring.edit();
}

/** Scroll to the picture where it is out of sight, as it is below the controls of a phone. */
function showStage() {
  const { top, bottom } = byId("screen").getBoundingClientRect();
  const isBelow = bottom > innerHeight && top > innerHeight / 3;
  if (isBelow || bottom < innerHeight / 3) byId("stage").scrollIntoView({ block: "start" });
}

/** End what is underway. */
function stop() {
  session.begin();
  running = null;
}

function leaveEditing() {
  editing = false;
  bring.leave();
  delete byId("stage").dataset.mode;
}

let shownRings = 0;
/** Say on the picture how far to trust it, and draw rings where balls were seen. */
function showVerdict(forecasts) {
  const { text, isWarning } = verdictOf(forecasts);
  if (byId("verdict").textContent !== text) byId("verdict").textContent = text;
  byId("verdict").dataset.warning = String(isWarning);
  const rings = forecasts.filter(({ done }) => done?.objects.some(({ seen }) => seen)).length;
  if (session.take && rings !== shownRings) {
    stage.showSeen(session.take, session.finalIndex, forecasts);
  }
  shownRings = rings;
}

let isAsked = false;
/** Show everything anew, once a frame of the screen however much has come. */
function requestShow() {
  if (isAsked) return;
  isAsked = true;
  requestAnimationFrame(show);
}

function show() {
  isAsked = false;
  const choices = store.get();
  const { take } = session;
  const forecasts = choices.source === "camera" ? live.forecasts : session.forecasts;
  const truth = take?.truth ?? null;
  const steps = forecasts.map(({ times, state }) => (state === "failed" ? Infinity : times.length));
  const least = Math.min(...(steps.length ? steps : [1]));
  const forecast = LAST_SEEN - 1 + (least === Infinity ? player.last : least);
  player.arrived = Math.min(forecast, take && !take.isComplete ? take.frames.length - 1 : Infinity);
  showLegend(forecasts, truth !== null);
  showVerdict(forecasts);
  showNotes(take, forecasts);
  // Of a running picture there is no time to look at a chart.
  chart.show(take ? forecasts : [], truth, take ? (player.last - LAST_SEEN) / take.rate : 1);
  surface.show(take, forecasts);
  sharing.show(take !== null && forecasts.length > 0 && forecasts.every(({ state }) => state === "done"));
  byId("recrop").hidden = !(choices.source === "footage" && take);
  byId("drop").classList.toggle("done", bring.footage !== null);
  if (take) {
    byId("stage-title").textContent = take.title;
    showRate(take.rate);
  }
  byId("stage").dataset.state = running ? "busy" : forecasts.map(({ state }) => state).join(" ");
  showMoment(player.index);
}

function showMoment(index) {
  const { take, forecasts } = session;
  showTransport(player, take);
  if (!take) {
    showFigures([], null, 0);
    return;
  }
  stage.show(take, forecasts, { ...store.get(), points: textOf(picks.points) }, index, zoom.view);
  showFigures(forecasts, take.truth, index);
  const timeS = (index - LAST_SEEN) / take.rate;
  byId("badge").textContent =
    index <= LAST_SEEN ? phaseOf(index) : take.frames[index] ? signedSeconds(timeS) : `${signedSeconds(timeS)}, no footage`;
  byId("badge").dataset.phase = index <= LAST_SEEN ? "seen" : "forecast";
  chart.mark(timeS);
  surface.mark(index);
}

function showBusy(text) {
  byId("busy").hidden = text === null;
  byId("busy-text").textContent = text ?? "";
}

store.subscribe((choices, before) => {
  const change = possible(choices, entries);
  if (Object.keys(change).length) {
    store.set(change);
    return;
  }
  if (choices.points && isOtherScene(choices, before)) {
    store.set({ points: "" });
    return;
  }
  const shown = lastShown;
  if (choices.source !== "camera" && shown.source === "camera") live.stop();
  picks.points = framePoints(choices);
  history.replaceState(null, "", `#${fragmentOf(choices)}`);
  showControls(choices, entries, store);
  player.speed = choices.speed;
  const asked = (all) => JSON.stringify({ ...all, ...Object.fromEntries(LOOKS.map((name) => [name, 0])) });
  if (asked(choices) === asked(shown)) requestShow();
  else if (choices.source === "camera") {
    if (shown.source !== "camera") enterLive();
  } else if (choices.source === "footage") {
    const isOther = suit(choices);
    if (bring.footage && (editing || isOther || shown.source !== "footage")) edit();
    else if (bring.footage) run();
    else empty();
  } else {
    leaveEditing();
    run();
  }
  lastShown = choices;
});
/** Whether points of the frames before would be of something else. */
function isOtherScene(choices, before) {
  const names = choices.source === "scene" ? ["source", "scenario", "seed", "scene", "balls"] : ["source"];
  return names.some((name) => choices[name] !== before[name]);
}

/** The choices that the page showed last: some changes take several steps. */
let lastShown = store.get();

/** Nothing has been brought yet. */
function empty() {
  showNothing("empty", "Bring a video, or at least four images");
}

/** The camera waits to be started. */
function enterLive() {
  leaveEditing();
  clearMessages();
  showNothing("live", "Live from the camera");
}

function showNothing(mode, title) {
  stop();
  session.take = null;
  session.forecasts = [];
  player.pause();
  showBusy(null);
  byId("badge").textContent = "";
  byId("stage").dataset.mode = mode;
  byId("stage-title").textContent = title;
  stage.single();
  requestShow();
}

const sharing = installSharing(() => ({
  session,
  choices: store.get(),
  request: session.take && requestOf(store.get()),
  index: player.index,
  last: player.last,
}));
installControls(store);
installTransport(player);
installTheme(() => {
  chart.recolor();
  surface.recolor();
});
byId("controls").addEventListener("submit", (event) => {
  event.preventDefault();
  const seed = byId("seed").value.trim();
  if (seed !== store.get().seed) store.set({ seed });
  else run();
  showStage();
});
byId("recrop").addEventListener("click", edit);
byId("surface-reset").addEventListener("click", () => surface.reset());
new ResizeObserver(() => (editing ? bring.edit() : requestShow())).observe(byId("panels"));

/** Look after the service: when it comes back, or has just begun, the page goes on by itself. */
async function watch() {
  const was = byId("health").dataset.status;
  const status = document.hidden && was === "ready" ? was : await health();
  showHealth(status);
  if (status !== "ready" && !session.take && !running) showBusy(WAITING[status] ?? WAITING.lost);
  if (status === "ready" && (was !== "ready" || !entries.length)) {
    try {
      session.entries = entries = await models();
      showSimulation(true);
      Object.assign(store.get(), possible(store.get(), entries));
      showControls(store.get(), entries, store);
      if (interrupted || (!session.take && store.get().source === "scene")) run();
    } catch (error) {
      showError(error, watch);
    }
  }
  setTimeout(watch, status === "ready" ? HEALTH_EVERY_MS : HEALTH_EVERY_MS / 5);
}

picks.points = pointsOf(store.get());
showControls(store.get(), entries, store);
stage.single();
watch();
