/** How far a forecast is to be trusted: a sentence on the picture, and which balls are uncertain. */

/** Score from which on a ball counts as found. */
const SURE = 0.5;
/** How the service's warning about out-of-distribution frames begins. */
const OOD_WARNING = "The frames look unlike";

/** How it begins about four frames that are the same. */
const STILL = "Nothing moves in the four frames";

/** Whether a forecast says that its frames are unlike those of the training. */
export function isOutOfDistribution({ done }) {
  return (done?.warnings ?? []).some((warning) => warning.startsWith(OOD_WARNING));
}

/** Whether the path of a ball is drawn in grey, without ellipses. */
export function isUncertain(forecast, index) {
  return isOutOfDistribution(forecast) || !isFound(forecast.done?.objects[index]);
}

/** First step of a forecast that is beyond its model's training. */
export function firstUntrained({ trained }) {
  return trained ?? Infinity;
}

function isFound(ball) {
  return ball === undefined || (ball.score ?? 1) >= SURE;
}

/**
 * Return the message on the picture.
 * @returns {{text: string, isWarning: boolean}} an empty text if there is nothing to say
 */
export function verdictOf(forecasts) {
  const answered = forecasts.filter(({ done }) => done);
  const lines = answered.map((forecast) => sentenceOf(forecast)).filter(({ text }) => text);
  const told = lines.find(({ isWarning }) => isWarning) ?? lines[0] ?? { text: "", isWarning: false };
  const whose = answered.length > 1 && told.text ? `${told.label}: ` : "";
  return { text: whose + told.text, isWarning: told.isWarning };
}

/** The figures behind the sentences, a line for each forecast that has some. */
export function scoresOf(forecasts) {
  return forecasts.flatMap(({ done, label }) => {
    const scores = (done?.objects ?? []).map(({ score }) => score ?? null);
    if (!scores.length || scores.includes(null)) return [];
    const all = scores.map((score) => score.toFixed(2)).join(", ");
    return [`${label}: score ${all}; from ${SURE} on a ball counts as found.`];
  });
}

function sentenceOf(forecast) {
  const { label } = forecast;
  const { text, isWarning } = trustIn(forecast);
  const beyond = beyondTraining(forecast);
  const all = [text, beyond].filter((part) => part).join(" ");
  return { text: all, isWarning: isWarning || beyond !== "", label };
}

/** That the horizon is beyond the training, if it is. */
function beyondTraining(forecast) {
  const { times } = forecast;
  const first = firstUntrained(forecast);
  if (first >= times.length) return "";
  return `After ${times[first - 1].toFixed(2)} s the forecast goes beyond its training: the dashed path may be far off.`;
}

function trustIn(forecast) {
  const { done } = forecast;
  const say = (text, isWarning) => ({ text, isWarning });
  const lost = done.objects.filter((ball) => !isFound(ball));
  if (lost.length) {
    const which = done.objects.length === 1 ? "The ball" : namesOf(lost);
    const verb = lost.length === 1 ? "was" : "were";
    return say(`${which} ${verb} not surely found: the grey path may be wrong.`, true);
  }
  if (isOutOfDistribution(forecast)) {
    return say("These frames look unlike the training data: the grey path may be far off.", true);
  }
  const warned = done.objects.find(({ warnings }) => warnings?.length);
  if (warned) {
    const which = done.objects.length === 1 ? "" : `Ball ${warned.id + 1}: `;
    return say(which + plain(warned.warnings[0]), true);
  }
  if (done.warnings?.some((warning) => warning.startsWith(STILL))) return say(`${STILL}.`, true);
  const { length } = done.objects;
  if (done.objects.some(({ score }) => score === null || score === undefined)) return say("", false);
  return say(length === 1 ? "Ball found." : `${length} balls found.`, false);
}

/** A warning up to its reason, which stands below the picture. */
function plain(warning) {
  if (warning.startsWith("The place of the ball")) return "The place of the ball is not exactly known.";
  return warning.replace(/(: .*|\.)$/s, ".");
}

function namesOf(balls) {
  const numbers = balls.map(({ id }) => id + 1);
  return numbers.length === 1
    ? `Ball ${numbers[0]}`
    : `Balls ${numbers.slice(0, -1).join(", ")} and ${numbers.at(-1)}`;
}
