/** The card from which forecasts are taken away: files, and the call itself. */

import { byId, canvasOf } from "./dom.js";
import { asGif, asJson, asPng, asWebm, canRecord, save } from "./export.js";
import { showError } from "./messages.js";
import { pngOf } from "./session.js";
import { snippetsOf } from "./snippets.js";
import { SEEN } from "./state.js";
import { zipped } from "./zip.js";

/** @param {() => any} now content of the page */
export function installSharing(now) {
  const buttons = ["json", "png", "gif", "webm", "frames"].map((name) => byId(`save-${name}`));
  let busy = false;
  let ready = false;

  const enable = () => {
    for (const button of buttons) button.disabled = busy || !ready;
    byId("copy").disabled = !ready;
    if (!canRecord()) byId("save-webm").disabled = true;
    byId("webm-hint").hidden = canRecord();
  };

  /** Offer the result of a function as a download, with progress. */
  const offer = (id, make) =>
    byId(id).addEventListener("click", async () => {
      const progress = byId("saving");
      busy = true;
      progress.hidden = false;
      progress.value = 0;
      enable();
      try {
        await make(now(), (share) => (progress.value = share));
      } catch (error) {
        showError(error);
      }
      busy = false;
      progress.hidden = true;
      enable();
    });

  const shownOf = ({ session: { take, forecasts }, choices, last }) => ({
    take,
    forecasts,
    choices,
    last,
  });
  const nameOf = ({ session }, ending) => `${session.take.file}.${ending}`;
  offer("save-json", async (it) => save(asJson(it.session, it.request), nameOf(it, "json")));
  offer("save-png", async (it) => save(await asPng(shownOf(it), it.index), nameOf(it, "png")));
  offer("save-gif", async (it, tell) => save(await asGif(shownOf(it), tell), nameOf(it, "gif")));
  offer("save-webm", async (it, tell) => save(await asWebm(shownOf(it), tell), nameOf(it, "webm")));
  offer("save-frames", async (it) => save(await framesOf(it.session), nameOf(it, "zip")));

  const snippet = () => {
    const it = now();
    const language = document.querySelector('input[name="language"]:checked').value;
    return it.session.take ? snippetsOf(it.session, it.choices, it.request)[language] : "";
  };
  const showSnippet = () => {
    byId("snippet").firstElementChild.textContent = snippet();
    byId("copied").textContent = "";
  };
  for (const radio of document.querySelectorAll('input[name="language"]')) {
    radio.addEventListener("change", showSnippet);
  }
  byId("copy").addEventListener("click", async () => {
    byId("copied").textContent = (await copied(snippet(), byId("snippet")))
      ? "Copied."
      : "This browser does not copy here: select the text.";
  });
  byId("copy-link").addEventListener("click", async () => {
    const said = byId("link-copied");
    said.textContent = location.href; // what is selected where the browser does not copy by itself
    const isCopied = await copied(location.href, said);
    const { source } = now().choices;
    const without = source === "scene" ? "" : " It holds the choices; your pictures stay here.";
    if (isCopied) said.textContent = `The link is copied.${without}`;
  });

  return {
    /** @param {boolean} isReady whether every forecast is there */
    show(isReady) {
      ready = isReady;
      enable();
      showSnippet();
    },
  };
}

/** The clipboard of browsers is for safe addresses alone, which a service in one's own net has not. */
async function copied(text, element) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    getSelection().selectAllChildren(element);
    return document.execCommand("copy");
  }
}

/** The frames that the model sees, as files that the calls below name. */
async function framesOf({ take, finalIndex }) {
  const named = take.frames.slice(0, SEEN).map((frame, index) => [frame, `frame-${index}.png`]);
  if (finalIndex !== null) named.push([take.frames[finalIndex], "final.png"]);
  const files = named.map(async ([frame, name]) => {
    const canvas = canvasOf(take.width, take.height);
    canvas.getContext("2d").drawImage(frame, 0, 0);
    return [name, await pngOf(canvas)];
  });
  return zipped(await Promise.all(files));
}
