/** How far a forecast is to be trusted: a sentence on the picture, and which balls are doubtful. */

/** Score from which on a ball counts as found. */
const SURE = 0.5;
/** How the service's warning about unfamiliar frames begins. */
const UNFAMILIAR = "The frames look unlike";

/** How it begins about four frames that are the same. */
const STILL = "Nothing moves in the four frames";

/** Whether a forecast says that its frames are unlike those of the training. */
export function isUnfamiliar({ done }) {
  return (done?.warnings ?? []).some((warning) => warning.startsWith(UNFAMILIAR));
}

/** Whether the path of a ball is drawn in grey. */
export function isDoubtful(forecast, index) {
  return isUnfamiliar(forecast) || !isFound(forecast.done?.objects[index]);
}

function isFound(ball) {
  return ball === undefined || (ball.score ?? 1) >= SURE;
}

/**
 * Return the message on the picture.
 * @returns {{text: string, isDoubt: boolean}} an empty text if there is nothing to say
 */
export function verdictOf(forecasts) {
  const answered = forecasts.filter(({ done }) => done);
  const lines = answered.map((forecast) => sentenceOf(forecast)).filter(({ text }) => text);
  const told = lines.find(({ isDoubt }) => isDoubt) ?? lines[0] ?? { text: "", isDoubt: false };
  const whose = answered.length > 1 && told.text ? `${told.label}: ` : "";
  return { text: whose + told.text, isDoubt: told.isDoubt };
}

function sentenceOf(forecast) {
  const { done, label } = forecast;
  const say = (text, isDoubt) => ({ text, isDoubt, label });
  const lost = done.objects.filter((ball) => !isFound(ball));
  if (lost.length) {
    const which = done.objects.length === 1 ? "the ball" : namesOf(lost);
    const scores = lost.map(({ score }) => score.toFixed(2)).join(", ");
    return say(`Uncertain detection of ${which} (score ${scores}): the grey path may be wrong.`, true);
  }
  if (isUnfamiliar(forecast)) {
    return say("These frames look unlike the training data: the grey path may be far off.", true);
  }
  const doubted = done.objects.find(({ warnings }) => warnings?.length);
  if (doubted) {
    const which = done.objects.length === 1 ? "" : `Ball ${doubted.id + 1}: `;
    return say(which + doubted.warnings[0], true);
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
