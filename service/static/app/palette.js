/** Colours of forecasts, by Okabe and Ito as in rollcast/plot.py, and marks that need no colour. */

import { styled } from "./dom.js";

/** On pictures, over a dark casing: the same in every theme. */
export const ON_PICTURES = ["#E69F00", "#56B4E9", "#CC79A7"];
/** Paths and rings of uncertain balls. */
export const UNCERTAIN = "#B4B8BF";
export const TRUTH = "#FFFFFF";
export const CASING = "rgba(0, 0, 0, 0.72)";

/** On the page's own ground, where the style sheet sees to the contrast. */
export function onPage(slot) {
  return styled(`--slot-${slot}`);
}

/** Marks that tell forecasts apart without any colour. */
export const MARKS = ["×", "+", "◇"];

/** A CSS colour with an opacity. */
export function faded(color, opacity) {
  const [r, g, b] = [1, 3, 5].map((start) => parseInt(color.slice(start, start + 2), 16));
  return `rgba(${r}, ${g}, ${b}, ${opacity})`;
}
