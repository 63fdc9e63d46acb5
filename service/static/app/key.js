/** The API key, where the service asks for one: kept for this tab alone. */

const NAME = "rollcast-api-key";

/** @type {Promise<boolean> | null} one question at a time, whoever asks */
let asking = null;

/** @param {RequestInit} init */
export function withKey(init) {
  const key = sessionStorage.getItem(NAME);
  if (key === null) return init;
  return { ...init, headers: { ...init.headers, Authorization: `Bearer ${key}` } };
}

/**
 * Ask the user for a key.
 * @param {string} reason message of the service
 * @returns {Promise<boolean>} whether there is another one now
 */
export function askForKey(reason) {
  asking ??= ask(reason).finally(() => {
    asking = null;
  });
  return asking;
}

function ask(reason) {
  const dialog = document.getElementById("key-dialog");
  const input = document.getElementById("key");
  document.getElementById("key-reason").textContent = reason;
  input.value = "";
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener(
      "close",
      () => {
        const given = dialog.returnValue === "use" && input.value.trim() !== "";
        if (given) sessionStorage.setItem(NAME, input.value.trim());
        resolve(given);
      },
      { once: true },
    );
  });
}
