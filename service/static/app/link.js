/** How fast the way to the service is, as far as the browser knows. */

/** Chromium tells 1.45 to 1.6 when it does not know. */
const SLOW_MBIT_S = 1;
const SLOW_BYTES_MS = 80;
const ENOUGH_BYTES = 20_000;

/** Whether pictures should be small, and the seen ones come first. */
export function isSlowLink() {
  const { connection } = navigator;
  if (connection) return Boolean(connection.saveData) || connection.downlink < SLOW_MBIT_S;
  // Other browsers tell how long the page's own files took.
  const files = performance
    .getEntriesByType("resource")
    .filter(({ transferSize }) => transferSize > 1000);
  const bytes = files.reduce((sum, { transferSize }) => sum + transferSize, 0);
  const begun = Math.min(...files.map(({ startTime }) => startTime));
  const ended = Math.max(...files.map(({ responseEnd }) => responseEnd));
  return bytes > ENOUGH_BYTES && bytes / (ended - begun) < SLOW_BYTES_MS;
}
