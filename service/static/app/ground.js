/** The ground of a scene out of its grid of heights: a mesh, contour lines, how balls lie on it. */

/** Metres between contour lines of bowls and of heightfields. */
const CONTOURS_M = { bowl: 0.1, heightfield: 0.04 };

/**
 * @typedef {{half_width_m: number, heights_m: (number | null)[][]}} Surface
 */

/**
 * Points, triangles and heights of the ground. World axes: x right, y up the frame, z to the camera.
 * @param {Surface} surface
 */
export function meshOf(surface) {
  const grid = surface.heights_m;
  const n = grid.length;
  const spacing = (2 * surface.half_width_m) / (n - 1);
  const rim = rimOf(surface, spacing);
  const points = [];
  const index = grid.map((row, i) =>
    row.map((height, j) => {
      const point =
        height === null
          ? rim(i, j)
          : [j * spacing - surface.half_width_m, surface.half_width_m - i * spacing, height];
      return point ? points.push(point) - 1 : -1;
    }),
  );
  const triangles = [];
  for (let i = 0; i + 1 < n; i++) {
    for (let j = 0; j + 1 < n; j++) {
      const corners = [index[i][j], index[i + 1][j], index[i + 1][j + 1], index[i][j + 1]];
      const there = corners.filter((corner) => corner >= 0);
      if (there.length < 3) continue;
      triangles.push([there[0], there[1], there[2]]);
      if (there.length === 4) triangles.push([there[0], there[2], there[3]]);
    }
  }
  return { points, triangles };
}

/**
 * Where points just outside a bowl have to move for its rim to be smooth. A bowl's wall is upright
 * at the rim, so its heights cannot be continued; (1 - z)^2 can, and is 0 there.
 */
function rimOf({ heights_m: grid, half_width_m: half }, spacing) {
  const smooth = (i, j) => {
    const height = grid[i]?.[j];
    return height === null || height === undefined ? null : (1 - height) ** 2;
  };
  const beyond = (i, j, di, dj) => {
    const [a, b, c] = [1, 2, 3].map((k) => smooth(i + k * di, j + k * dj));
    return a === null || b === null || c === null ? null : { value: 3 * a - 3 * b + c, next: a };
  };
  return (i, j) => {
    let best = null;
    for (const [di, dj] of [[0, 1], [0, -1], [1, 0], [-1, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]]) {
      const found = beyond(i, j, di, dj);
      if (!found || found.value > 0) continue;
      const share = found.value / (found.value - found.next);
      const length = share * Math.hypot(di, dj);
      if (!best || length < best.length) best = { length, i: i + share * di, j: j + share * dj };
    }
    return best && [best.j * spacing - half, half - best.i * spacing, 1];
  };
}

/**
 * Ends of the contour lines' pieces, two points after the other.
 * @returns {number[][]}
 */
export function contoursOf({ points, triangles }, isBowl) {
  const spacing = isBowl ? CONTOURS_M.bowl : CONTOURS_M.heightfield;
  const ends = [];
  for (const triangle of triangles) {
    const corners = triangle.map((corner) => points[corner]);
    const heights = corners.map((corner) => corner[2]);
    const first = Math.ceil(Math.min(...heights) / spacing);
    const last = Math.floor(Math.max(...heights) / spacing);
    for (let level = first; level <= last; level++) {
      const cut = crossings(corners, level * spacing + 1e-9);
      if (cut.length === 2) ends.push(...cut);
    }
  }
  return ends;
}

function crossings(corners, height) {
  const found = [];
  for (let k = 0; k < 3; k++) {
    const [a, b] = [corners[k], corners[(k + 1) % 3]];
    if (a[2] < height === b[2] < height) continue;
    const share = (height - a[2]) / (b[2] - a[2]);
    found.push([0, 1, 2].map((axis) => a[axis] + share * (b[axis] - a[axis])));
  }
  return found;
}

/** Height of the ground between its grid's points; null where there is none. */
function heightAt({ heights_m: grid, half_width_m: half }, x, y) {
  const n = grid.length;
  const column = ((x + half) / (2 * half)) * (n - 1);
  const row = ((half - y) / (2 * half)) * (n - 1);
  const i = Math.min(Math.max(Math.floor(row), 0), n - 2);
  const j = Math.min(Math.max(Math.floor(column), 0), n - 2);
  const corners = [grid[i][j], grid[i][j + 1], grid[i + 1][j], grid[i + 1][j + 1]];
  if (corners.includes(null)) return null;
  const [u, v] = [column - j, row - i];
  const [a, b, c, d] = corners;
  return (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d);
}

/**
 * Height of a ball's centre that lies on the ground at a place: it is let down until it touches.
 * @param {Surface} surface
 */
export function restingHeight(surface, x, y, radius) {
  let highest = null;
  for (let ring = 0; ring <= 5; ring++) {
    const distance = (radius * ring * 0.99) / 5;
    const lift = Math.sqrt(radius * radius - distance * distance);
    for (let turn = 0; turn < (ring ? 24 : 1); turn++) {
      const angle = (turn / 24) * 2 * Math.PI;
      const at = [x + distance * Math.cos(angle), y + distance * Math.sin(angle)];
      const ground = heightAt(surface, at[0], at[1]);
      if (ground !== null) highest = Math.max(highest ?? -Infinity, ground + lift);
    }
  }
  return highest ?? 1;
}
