/** What makes the picture that is seen: a line for the shell, and lines of Python. */

import { centreOf, isCentred } from "./law.js";

const quote = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** Options or arguments of the aperture and viewpoint of a state. */
function aperture(item, state) {
  if (state.shape === "all") return null;
  return state.shape === "disc" ? Number(state.diameter).toFixed(3).replace(/(\.\d+?)0+$/, "$1") : String(state.across);
}

/** The command line that makes the picture of a light field; null where its file is not known. */
export function commandOf(item, state, tone) {
  if (!item.command) return null;
  const { input, options } = item.command;
  const words = ["clplen"];
  const size = aperture(item, state);
  const byRender = state.shape === "one" || (size !== null && !isCentred(item, state));
  words.push(byRender ? "render" : "refocus", input, ...options, "-o", "picture.png");
  if (byRender) words.push("--viewpoint", String(state.v), String(state.u));
  if (state.shape !== "one" && size !== null) words.push("--aperture", size);
  if (state.sharp) words.push("--depth-map", item.depth?.file ?? "depth.tif");
  else words.push("--disparity", String(state.d));
  words.push("--limits", `${tone.black}:${tone.white}`);
  if (tone.curve !== "linear") words.push("--curve", tone.curve === "gamma" ? String(tone.gamma) : tone.curve);
  const line = words.map(quote).join(" ");
  return state.sharp && !item.depth?.file
    ? `clplen depth ${[input, ...options].map(quote).join(" ")} -o depth.tif\n${line}`
    : line;
}

/** The same in Python. */
export function pythonOf(item, state) {
  const lines = ["import clplen", ""];
  const text = (value) => JSON.stringify(value);
  lines.push(item.python ?? "lf = ...  # the light field that was shown");
  let plane = `disparity=${state.d}`;
  if (state.sharp) {
    lines.push(
      item.depth?.file
        ? `depth = clplen.io.read_disparity(${text(item.depth.file)})`
        : "depth = clplen.depth_map(lf).disparity",
    );
    plane = "disparity=depth";
  }
  const size = aperture(item, state);
  const [v, u] = centreOf(item.shape);
  if (state.shape === "one") lines.push(`picture = lf.view(${state.v}, ${state.u}, ${plane})`);
  else if (size === null) lines.push(`picture = clplen.refocus(lf, ${plane})`);
  else {
    const at = state.v === v && state.u === u ? "" : `, viewpoint=(${state.v}, ${state.u})`;
    lines.push(`picture = lf.flatten(${plane}, aperture=${size}${at})`);
  }
  lines.push('picture.save("picture.tif")');
  return lines.join("\n");
}
