/** What makes the picture that is seen: a line for the shell, and lines of Python. */

import { isCentred, rounded } from "./law.js";

const quote = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** A number as a float of Python and of --aperture, with a point. */
const float = (x) => (Number.isInteger(x) ? x.toFixed(1) : String(x));

/**
 * The state in terms of the whole light field, of which a page may keep the middle views and means
 * of pixels: {v, u, d, aperture}, aperture being null for all views; null where there is none.
 */
export function fullState(item, state) {
  const [V, U] = item.shape;
  const { views, first, downscale } = item.full;
  const cut = V !== views[0] || U !== views[1];
  const across = Math.max(V, U);
  const full = { v: rounded(state.v + first[0], 2), u: rounded(state.u + first[1], 2), d: rounded(state.d * downscale, 4), aperture: null };
  if (state.shape === "disc") {
    const share = (state.diameter * V) / views[0];
    if (Math.abs(share - (state.diameter * U) / views[1]) > 1e-9) return null;
    full.aperture = float(rounded(share, 12));
  } else if (state.shape === "square") full.aperture = String(state.across);
  else if (state.shape === "all" && cut) {
    if (Math.min(across, views[0]) !== V || Math.min(across, views[1]) !== U) return null;
    full.aperture = String(across);
  }
  return full;
}

/** The command line that makes the picture of a light field; null where none is known. */
export function commandOf(item, state, tone) {
  const full = fullState(item, state);
  if (!item.command || !full) return null;
  const { input, options } = item.command;
  const aside = state.shape !== "all" && !isCentred(item, state);
  const byRender = state.shape === "one" || aside;
  const words = ["clplen", byRender ? "render" : "refocus", input, ...options, "-o", "picture.png"];
  if (byRender) words.push("--viewpoint", String(full.v), String(full.u));
  if (full.aperture !== null) words.push("--aperture", full.aperture);
  if (state.sharp) words.push("--depth-map", item.depth?.file ?? "depth.pfm");
  else words.push("--disparity", String(full.d));
  words.push("--limits", `${tone.black}:${tone.white}`);
  if (tone.curve !== "linear") words.push("--curve", tone.curve === "gamma" ? String(tone.gamma) : tone.curve);
  const line = words.map(quote).join(" ");
  if (!state.sharp || item.depth?.file) return line;
  return `${["clplen", "depth", input, ...options, "-o", "depth.pfm"].map(quote).join(" ")}\n${line}`;
}

/** The same in Python; null where there is no such picture of the whole light field. */
export function pythonOf(item, state) {
  const full = fullState(item, state);
  if (!full) return null;
  const lines = ["import clplen", "", item.python ?? "lf = ...  # the light field that was shown"];
  if (state.sharp)
    lines.push(
      item.depth?.file
        ? `depth = clplen.io.read_disparity(${JSON.stringify(item.depth.file)})`
        : "depth = clplen.depth_map(lf).disparity",
    );
  const plane = state.sharp ? "disparity=depth" : `disparity=${full.d}`;
  if (state.shape === "one") lines.push(`picture = lf.view(${full.v}, ${full.u}, ${plane})`);
  else if (full.aperture === null) lines.push(`picture = clplen.refocus(lf, ${plane})`);
  else {
    const at = isCentred(item, state) || state.shape === "all" ? "" : `, viewpoint=(${full.v}, ${full.u})`;
    lines.push(`picture = lf.flatten(${plane}, aperture=${full.aperture}${at})`);
  }
  lines.push('picture.save("picture.tif")');
  return lines.join("\n");
}
