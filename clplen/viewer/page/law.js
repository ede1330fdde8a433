/**
 * Conventions of clplen for light fields: weights of apertures, shifts of views, alpha, metres.
 *
 * Views are numbered k = v * U + u. Weights are arrays of V * U numbers; steps are pairs (y, x) of
 * pixels from a point's position in the centre view to that in view k, for disparity 1.
 */

const FINE = 2 ** 20; // shifts are rounded to such parts of a pixel, so that 3 * 0.1 is 0.3

const ROUNDING = 1e-12; // smaller fractions of a cell count as 0

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

/** Middle (v, u) of the views. */
export const centreOf = ([V, U]) => [(V - 1) / 2, (U - 1) / 2];

/** Area of the unit disc between the axes and (y, x), odd in both, for y and x from -1 to 1. */
function discArea(y, x) {
  const underArc = (t) => (t * Math.sqrt(1 - t * t) + Math.asin(t)) / 2;
  const height = Math.abs(y);
  const width = Math.abs(x);
  const corner = Math.min(width, Math.sqrt(1 - height * height));
  return Math.sign(y) * Math.sign(x) * (height * corner + underArc(width) - underArc(corner));
}

/** Covered fraction of every view's cell by an ellipse of two diameters, in view steps. */
export function discWeights([V, U], [high, wide], [cv, cu]) {
  const edges = (n, centre, radius) =>
    Array.from({ length: n + 1 }, (_, i) => clamp((i - 0.5 - centre) / radius, -1, 1));
  const y = edges(V, cv, high / 2);
  const x = edges(U, cu, wide / 2);
  const weights = new Float64Array(V * U);
  for (let v = 0; v < V; v++)
    for (let u = 0; u < U; u++) {
      const area =
        discArea(y[v + 1], x[u + 1]) - discArea(y[v + 1], x[u]) -
        discArea(y[v], x[u + 1]) + discArea(y[v], x[u]);
      const cell = clamp((area * high * wide) / 4, 0, 1);
      weights[v * U + u] = cell < ROUNDING ? 0 : cell;
    }
  return weights;
}

/** Weights of a square of views around a centre; by default (N - N')/2, rounded down, lie below. */
export function squareWeights(views, across, centre) {
  const [rows, columns] = views.map((n, axis) => {
    const kept = Math.min(across, n);
    const below = centre ? centre[axis] - (kept - 1) / 2 : Math.floor((n - kept) / 2);
    return Array.from({ length: n }, (_, i) =>
      clamp(Math.min(i + 1, below + kept) - Math.max(i, below), 0, 1),
    );
  });
  return Float64Array.from(rows.flatMap((row) => columns.map((column) => row * column)));
}

/** Bilinear weights of the four views around a viewpoint. */
export function pointWeights(views, at) {
  const [rows, columns] = views.map((n, axis) =>
    Array.from({ length: n }, (_, i) => Math.max(1 - Math.abs(i - at[axis]), 0)),
  );
  return Float64Array.from(rows.flatMap((row) => columns.map((column) => row * column)));
}

/**
 * Weights of the summed views, and the viewpoint that pictures are registered to.
 *
 * state.shape is "one" (a single viewpoint), "disc" (state.diameter, a fraction of the views),
 * "square" (state.across views) or "all". Views of weight 0 are left out, but a single view is
 * shown as it is stored. state.register, a viewpoint (v, u), registers the picture of an
 * aperture to it; state.cubic interpolates as single views do.
 */
export function weightsOf(item, state) {
  const views = item.shape.slice(0, 2);
  const own = (weights) => weights.map((w, k) => w * item.weights[k]);
  const at = [state.v, state.u];
  if (state.shape === "one") {
    const nearest = pointWeights(views, at);
    const weights = own(nearest);
    return { weights: weights.some(Boolean) ? weights : nearest, viewpoint: nearest, cubic: true };
  }
  const moved = isCentred(item, state) ? null : at;
  let weights;
  if (state.shape === "disc")
    weights = discWeights(views, views.map((n) => n * state.diameter), moved ?? centreOf(views));
  else if (state.shape === "square") weights = squareWeights(views, state.across, moved);
  else weights = new Float64Array(item.weights.length).fill(1);
  const viewpoint = state.register ? pointWeights(views, state.register) : null;
  return { weights: own(weights), viewpoint, cubic: Boolean(state.cubic) };
}

/** True if the aperture is centred on the views. */
export function isCentred(item, state) {
  const [v, u] = centreOf(item.shape);
  return state.v === v && state.u === u;
}

/** Steps of the views from a viewpoint, given as bilinear weights; null: from the centre. */
export function stepsFrom(item, viewpoint) {
  if (!viewpoint) return { steps: item.steps, origin: [0, 0] };
  const origin = [0, 0];
  item.steps.forEach(([y, x], k) => {
    origin[0] += viewpoint[k] * y;
    origin[1] += viewpoint[k] * x;
  });
  return { steps: item.steps.map(([y, x]) => [y - origin[0], x - origin[1]]), origin };
}

/** Split a shift into whole pixels and a fraction from 0 to 1; round shifts of cubic taps first. */
export function split(shift, cubic) {
  const fine = cubic ? Math.round(shift * FINE) / FINE : shift;
  const whole = Math.floor(fine);
  return [whole, fine - whole];
}

/** alpha = F/F' of a disparity; NaN if unknown. */
export function alphaOf(item, disparity) {
  if (!item.alpha) return NaN;
  const scaled = -disparity / item.alpha.ratio;
  return item.alpha.inverse ? 1 / (1 + scaled) : 1 - scaled;
}

/** Disparity of an alpha; NaN if unknown. */
export function disparityOfAlpha(item, alpha) {
  if (!item.alpha || !(alpha > 0)) return NaN;
  return -item.alpha.ratio * (item.alpha.inverse ? 1 / alpha - 1 : 1 - alpha);
}

/** Distance of a disparity from the plane in focus in metres; NaN if unknown. */
export function metresOf(item, disparity) {
  const law = item.metres;
  if (!law) return NaN;
  return law.linear ? law.slope * disparity : 1 / (law.offset + law.slope * disparity) - law.object;
}

/** Disparity of a distance in metres; NaN if unknown. */
export function disparityOfMetres(item, z) {
  const law = item.metres;
  if (!law) return NaN;
  return law.linear ? z / law.slope : (1 / (z + law.object) - law.offset) / law.slope;
}

/** Image-side f-number of a disc, a fraction of the views; NaN if unknown. */
export function fNumberOf(item, diameter) {
  return item.f_number ? item.f_number / diameter : NaN;
}

/** Round a number to decimals, so that its text restores it. */
export const rounded = (x, decimals) => Number(x.toFixed(decimals));
