/** How fast the way to the service is. */

const SLOW_BYTES_MS = 80;
const ENOUGH_BYTES = 20_000;

/** Whether pictures should be small, and the seen ones come first. */
export function isSlowLink() {
  if (navigator.connection?.saveData) return true;
  // What the page's own files took: estimates of the browser are of other links, too.
  const files = performance
    .getEntriesByType("resource")
    .filter(({ transferSize }) => transferSize > 1000);
  const bytes = files.reduce((sum, { transferSize }) => sum + transferSize, 0);
  const begun = Math.min(...files.map(({ startTime }) => startTime));
  const ended = Math.max(...files.map(({ responseEnd }) => responseEnd));
  return bytes > ENOUGH_BYTES && bytes / (ended - begun) < SLOW_BYTES_MS;
}
