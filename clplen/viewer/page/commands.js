/** Code that makes the current picture: a command for the shell, and lines of Python. */

import { isCentred, rounded } from "./law.js";

const isControl = (c) => c < " " || c === "\x7f";
const escaped = (c) => (isControl(c) ? `\\x${c.charCodeAt(0).toString(16).padStart(2, "0")}` : c.replace(/[\\']/, "\\$&"));

/** A word for the shell; control characters, which a terminal could execute, are escaped. */
const quote = (word) => {
  if ([...word].some(isControl)) return `$'${[...word].map(escaped).join("")}'`;
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
};

/** A file name that no program takes for an option. */
const file = (name) => (name.startsWith("-") ? `./${name}` : name);

/** A number as text with a decimal point, for Python and --aperture. */
const float = (x) => (Number.isInteger(x) ? x.toFixed(1) : String(x));

/**
 * The state in terms of the complete light field, since a page may keep only its central views and
 * downscaled pixels: {v, u, d, aperture}, with aperture null for all views; null if impossible.
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

/** The command that makes the picture of a light field; null if impossible. */
export function commandOf(item, state, tone) {
  const full = fullState(item, state);
  if (!item.command || !full) return null;
  const { options } = item.command;
  const input = file(item.command.input);
  const aside = state.shape !== "all" && !isCentred(item, state);
  const byRender = state.shape === "one" || aside;
  const words = ["clplen", byRender ? "render" : "refocus", input, ...options, "-o", "picture.png"];
  if (byRender) words.push("--viewpoint", String(full.v), String(full.u));
  if (full.aperture !== null) words.push("--aperture", full.aperture);
  if (state.sharp) words.push("--depth-map", file(item.depth?.file ?? "depth.pfm"));
  else words.push("--disparity", String(full.d));
  words.push("--limits", `${tone.black}:${tone.white}`);
  if (tone.curve !== "linear") words.push("--curve", tone.curve === "gamma" ? String(tone.gamma) : tone.curve);
  const line = words.map(quote).join(" ");
  if (!state.sharp || item.depth?.file) return line;
  return `${["clplen", "depth", input, ...options, "-o", "depth.pfm"].map(quote).join(" ")}\n${line}`;
}

/** Lines of Python that make the picture; null if impossible. */
export function pythonOf(item, state) {
  const full = fullState(item, state);
  if (!full) return null;
  const lines = ["import clplen", "", item.python ?? "lf = ...  # the displayed light field"];
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
