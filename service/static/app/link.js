/** How fast the way to the service is. */

const SLOW_BYTES_MS = 80;
const ENOUGH_BYTES = 20_000;

/** Whether pictures should be small, and the seen ones come first. */
export function isSlowLink() {
  if (navigator.connection?.saveData) return true;
  // Transfer times of the page's own files; the browser's estimates include other hosts.
  const files = performance
    .getEntriesByType("resource")
    .filter(({ transferSize }) => transferSize > 1000);
  const bytes = files.reduce((sum, { transferSize }) => sum + transferSize, 0);
  return bytes > ENOUGH_BYTES && bytes / busyMs(files) < SLOW_BYTES_MS;
}

/** Time in which at least one file was on its way: some are loaded minutes after the others. */
function busyMs(files) {
  let [busy, until] = [0, -Infinity];
  for (const { startTime, responseEnd } of files.sort((a, b) => a.startTime - b.startTime)) {
    busy += Math.max(responseEnd - Math.max(startTime, until), 0);
    until = Math.max(until, responseEnd);
  }
  return busy;
}
