/** Tracks over a volume: circles at current points, and lines along past positions. */

const NEAR = 1.5; // maximum distance of a point from the slice, in planes, rows or columns
const RADIUS = 2.5; // radius of a circle in pixels of the picture
const AXES = { z: ["y", "x"], y: ["z", "x"], x: ["y", "z"] }; // rows and columns across an axis

/**
 * Lines and circles across an axis: tracks {ids, frames, z, y, x}, sorted by track and frame, in
 * voxels; state {t, z, y, x, projection}; along(axis, value): pixel of a coordinate.
 */
export function trackMarks(tracks, state, axis, along) {
  const { ids, frames } = tracks;
  const [rows, columns] = AXES[axis];
  const at = (n) => [along(rows, tracks[rows][n]), along(columns, tracks[columns][n])];
  const isNear = (n) => state.projection === "maximum" || Math.abs(tracks[axis][n] - state[axis]) <= NEAR;
  const [lines, circles] = [[], []];
  for (let n = 0; n < ids.length; n += 1) {
    if (frames[n] > state.t || !isNear(n)) continue;
    if (frames[n] === state.t) circles.push([...at(n), RADIUS]);
    if (n > 0 && ids[n - 1] === ids[n] && isNear(n - 1)) lines.push([...at(n - 1), ...at(n)]);
  }
  return { lines, circles };
}
