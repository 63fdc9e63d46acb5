/** Figures of a forecast: ellipses, errors, and the computed part of a path. */

import { LAST_SEEN } from "./state.js";

/** Radius, in standard deviations, of the ellipse that holds 95 % of a plane's Gaussian. */
export const MOST = Math.sqrt(-2 * Math.log(0.05));

/**
 * Half axes and turn of the ellipse of one standard deviation.
 * @param {number[][]} covariance
 */
export function ellipseOf([[a, b], [, c]]) {
  const middle = (a + c) / 2;
  const spread = Math.hypot((a - c) / 2, b);
  return {
    major: Math.sqrt(Math.max(middle + spread, 0)),
    minor: Math.sqrt(Math.max(middle - spread, 0)),
    angle: Math.atan2(2 * b, a - c) / 2,
  };
}

/** Radius of the circle as large as the 95 % ellipse, pixels. */
export function radius95([[a, b], [, c]]) {
  return MOST * Math.max(a * c - b * b, 0) ** 0.25;
}

/** Whether the 95 % ellipse around one point holds another. */
export function holds([[a, b], [, c]], [x, y], [trueX, trueY]) {
  const [dx, dy] = [trueX - x, trueY - y];
  const squared = (c * dx * dx - 2 * b * dx * dy + a * dy * dy) / (a * c - b * b);
  return squared <= MOST * MOST;
}

/**
 * Figures of every step that has come, the mean over the balls.
 * @returns {{errors: (number | null)[], radii: number[], held: (boolean | null)[]}}
 */
export function curvesOf(forecast, truth) {
  const steps = forecast.times.length;
  const curves = { errors: [], radii: [], held: [] };
  const paths = truePathsOf(forecast, truth);
  for (let step = 0; step < steps; step++) {
    const balls = forecast.objects.map((ball, index) => {
      const position = ball.positions[step];
      const covariance = ball.covariances[step];
      const at = paths[index]?.positions[step + LAST_SEEN];
      return {
        radius: radius95(covariance),
        error: at ? Math.hypot(at[0] - position[0], at[1] - position[1]) : null,
        held: at ? holds(covariance, position, at) : null,
      };
    });
    curves.radii.push(mean(balls.map((ball) => ball.radius)));
    const known = balls.every((ball) => ball.error !== null);
    curves.errors.push(known ? mean(balls.map((ball) => ball.error)) : null);
    curves.held.push(known ? balls.every((ball) => ball.held) : null);
  }
  return curves;
}

/** The true path of each object: by its number or, where the model finds balls, the nearest at t = 0. */
function truePathsOf({ objects, done }, truth) {
  const isFound = done?.objects.some(({ seen }) => seen);
  if (!truth || !isFound) return truth ?? [];
  return objects.map(({ positions: [[x, y]] }) => {
    const far = truth.map(({ positions }) => {
      const [trueX, trueY] = positions[LAST_SEEN];
      return Math.hypot(trueX - x, trueY - y);
    });
    return truth[far.indexOf(Math.min(...far))];
  });
}

export function mean(values) {
  return values.reduce((sum, value) => sum + value, 0) / values.length;
}

/** "+0.500 s"; a minus sign is as wide as a plus. */
export function signedSeconds(seconds) {
  return `${seconds < -1e-9 ? "−" : "+"}${Math.abs(seconds).toFixed(3)} s`;
}
