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

/** Whether the path of a ball is drawn in grey. */
export function isUncertain(forecast, index) {
  return isOutOfDistribution(forecast) || !isFound(forecast.done?.objects[index]);
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

function sentenceOf(forecast) {
  const { done, label } = forecast;
  const say = (text, isWarning) => ({ text, isWarning, label });
  const lost = done.objects.filter((ball) => !isFound(ball));
  if (lost.length) {
    const which = done.objects.length === 1 ? "the ball" : namesOf(lost);
    const scores = lost.map(({ score }) => score.toFixed(2)).join(", ");
    return say(`Uncertain detection of ${which} (score ${scores}): the grey path may be wrong.`, true);
  }
  if (isOutOfDistribution(forecast)) {
    return say("These frames look unlike the training data: the grey path may be far off.", true);
  }
  const warned = done.objects.find(({ warnings }) => warnings?.length);
  if (warned) {
    const which = done.objects.length === 1 ? "" : `Ball ${warned.id + 1}: `;
    return say(which + warned.warnings[0], true);
  }
  if (done.warnings?.some((warning) => warning.startsWith(STILL))) return say(`${STILL}.`, true);
  const scores = done.objects.map(({ score }) => score ?? null);
  if (scores.includes(null)) return say("", false);
  const found = scores.length === 1 ? "Ball found" : `${scores.length} balls found`;
  return say(`${found} (score ${scores.map((score) => score.toFixed(2)).join(", ")}).`, false);
}

function namesOf(balls) {
  const numbers = balls.map(({ id }) => id + 1);
  return numbers.length === 1
    ? `Ball ${numbers[0]}`
    : `Balls ${numbers.slice(0, -1).join(", ")} and ${numbers.at(-1)}`;
}
