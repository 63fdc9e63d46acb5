/** Buttons, keys and the slider of time. */

import { byId } from "./dom.js";
import { signedSeconds } from "./figures.js";
import { LAST_SEEN } from "./state.js";

const LEAP = 10;

/** @param {import("./player.js").Player} player */
export function installTransport(player) {
  byId("play").addEventListener("click", () => player.toggle());
  byId("first").addEventListener("click", () => player.step(-Infinity));
  byId("back").addEventListener("click", () => player.step(-1));
  byId("forth").addEventListener("click", () => player.step(1));
  byId("end").addEventListener("click", () => player.step(Infinity));
  byId("scrub").addEventListener("input", () => {
    const index = Number(byId("scrub").value); // pausing shows where the clock was
    player.pause();
    player.seek(index);
  });
  byId("stage").addEventListener("keydown", (event) => {
    // Fields and buttons keep the keys that they use themselves.
    if (event.target.closest("input, select, button, .messages")) return;
    const leap = event.shiftKey ? LEAP : 1;
    const action = {
      " ": () => player.toggle(),
      ArrowLeft: () => player.step(-leap),
      ArrowRight: () => player.step(leap),
      Home: () => player.step(-Infinity),
      End: () => player.step(Infinity),
    }[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
}

/** Make buttons and slider say where the clock is. */
export function showTransport(player, take) {
  const { index, last, playing } = player;
  const scrub = byId("scrub");
  scrub.max = String(last);
  scrub.value = String(index);
  scrub.disabled = !take;
  const time = take ? signedSeconds((index - LAST_SEEN) / take.rate) : "";
  scrub.setAttribute("aria-valuetext", `step ${index - LAST_SEEN}, ${time}`);
  scrub.style.setProperty("--seen", `${(100 * LAST_SEEN) / last}%`);
  byId("seen-mark").style.width = `${(100 * LAST_SEEN) / last}%`;
  byId("time").textContent = time;
  byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  byId("play").classList.toggle("playing", playing);
  for (const id of ["play", "first", "back", "forth", "end"]) byId(id).disabled = !take;
}
