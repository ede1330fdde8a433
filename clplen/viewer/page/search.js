/** Plane on which a pixel is in focus, by sharpness. */

const PLANES = 33;
const HALVES = [8, 16, 32]; // half sizes of the window in pixels, tried until it has enough detail
const DETAIL = 0.15; // minimum excess of the sharpest plane over blurred planes
const REACH = 1.5; // planes to either side of the best plane in the refinement
const FLAT = "This region has too little detail to estimate its depth; the sharpest plane is shown.";

/**
 * Return the disparity at which a window around a pixel is sharpest.
 *
 * The sharpness is the mean square of the differences of neighbouring pixels of the refocused
 * window, interpolated by cubics: linear interpolation blurs least at whole disparities, and would
 * attract the peak. `seen` is the viewpoint (v, u) of the pressed picture, null for the centre.
 * Returns {disparity, note}, with a note if the result is uncertain.
 */
export function sharpestDisparity(renderer, item, place, seen) {
  let best = null;
  for (const half of HALVES) {
    best = sharpest(renderer, place, half, seen, ...item.range);
    if (best.contrast < DETAIL) continue;
    const step = (item.range[1] - item.range[0]) / (PLANES - 1);
    const [low, high] = [best.disparity - REACH * step, best.disparity + REACH * step];
    return { disparity: sharpest(renderer, place, half, seen, low, high).disparity, note: null };
  }
  return { disparity: best.disparity, note: FLAT };
}

function sharpest(renderer, [y, x], half, seen, low, high) {
  const [ny, nx] = [renderer.ny, renderer.nx];
  const top = Math.max(y - half, 0);
  const left = Math.max(x - half, 0);
  const height = Math.min(y + half + 1, ny) - top;
  const width = Math.min(x + half + 1, nx) - left;
  const target = renderer.target(height, width);
  const state = { shape: "all", register: seen, cubic: true };
  const planes = Array.from({ length: PLANES }, (_, i) => low + ((high - low) * i) / (PLANES - 1));
  const curve = planes.map((disparity) => {
    renderer.sum(state, { disparity, target, corner: [top, left] });
    return detail(renderer.values(target), height, width, renderer.channels);
  });
  renderer.release(target);
  const at = curve.indexOf(Math.max(...curve));
  const sorted = [...curve].sort((a, b) => a - b);
  const contrast = sorted[PLANES - 1] > 0 ? 1 - sorted[PLANES >> 2] / sorted[PLANES - 1] : 0;
  let shift = 0;
  if (at > 0 && at < PLANES - 1) {
    const [a, b, c] = curve.slice(at - 1, at + 2);
    const bend = a - 2 * b + c;
    if (bend < 0) shift = (0.5 * (a - c)) / bend;
  }
  return { disparity: planes[at] + shift * (planes[1] - planes[0]), contrast };
}

/** Mean square of the differences of neighbours. */
function detail(values, height, width, channels) {
  let sum = 0;
  for (let i = 0; i + 1 < height; i++)
    for (let j = 0; j + 1 < width; j++)
      for (let c = 0; c < Math.min(channels, 3); c++) {
        const at = 4 * (i * width + j) + c;
        sum += (values[at + 4] - values[at]) ** 2 + (values[at + 4 * width] - values[at]) ** 2;
      }
  return sum / (height * width);
}
