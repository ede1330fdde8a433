/** Display of values: levels, curve, lookup table and histogram. */

import { digits, element, group, select, slider } from "./controls.js";
import { CURVES, histogram, toBytes } from "./tone.js";

/** Controls of black, white and the curve of `state.tone`, with a histogram. */
export class ToneControls {
  constructor({ tone, range, tables = null, onChange }) {
    this.tone = tone;
    this.range = range;
    const change = (name) => (value) => {
      tone[name] = value;
      if (tone.white <= tone.black) tone.white = tone.black + (range[1] - range[0]) / 1000;
      this.refresh();
      onChange();
    };
    const step = (range[1] - range[0]) / 500 || 1e-6;
    const level = (label, name) => slider({ label, min: range[0], max: range[1], step, onInput: (x) => change(name)(shorten(x)) });
    this.black = level("Black", "black");
    this.white = level("White", "white");
    this.curve = select({ label: "Curve", options: CURVES, onInput: change("curve") });
    this.gamma = slider({ label: "Gamma", min: 0.25, max: 4, step: 0.05, onInput: change("gamma") });
    this.table = tables && select({ label: "Colours", options: tables, onInput: change("table") });
    this.canvas = element("canvas", { width: 256, height: 56, class: "histogram", role: "img", "aria-label": "Histogram of the picture's values" });
    this.element = group("Brightness", this.canvas, this.black.element, this.white.element, this.curve.element, this.gamma.element, this.table?.element ?? null);
    this.refresh();
  }

  refresh() {
    const { tone } = this;
    this.black.set(tone.black, digits(tone.black));
    this.white.set(tone.white, digits(tone.white));
    this.curve.set(tone.curve);
    this.gamma.set(tone.gamma);
    this.gamma.show(tone.curve === "gamma");
    this.table?.set(tone.table);
    if (this.counts) this.drawHistogram();
  }

  /** Show the histogram of count pixels. */
  show(values, count, stride, channels) {
    this.counts = histogram(values, count, stride, channels, ...this.range);
    this.drawHistogram();
  }

  drawHistogram() {
    const { canvas, counts, tone, range } = this;
    const to = canvas.getContext("2d");
    const style = getComputedStyle(canvas);
    const { width, height } = canvas;
    to.clearRect(0, 0, width, height);
    const inner = [...counts].sort((a, b) => a - b);
    const most = Math.max(inner[Math.floor(0.98 * (inner.length - 1))], 1);
    to.fillStyle = style.color;
    counts.forEach((count, i) => {
      const high = Math.min(count / most, 1) * height;
      to.fillRect((i * width) / counts.length, height - high, width / counts.length, high);
    });
    to.fillStyle = style.borderTopColor;
    for (const level of [tone.black, tone.white]) {
      const x = ((level - range[0]) / (range[1] - range[0])) * width;
      to.fillRect(Math.min(Math.max(x, 0), width - 2), 0, 2, height);
    }
  }
}

/** Return the valid levels and curve of a link, else the current ones. */
export function acceptTone(tone, now) {
  const fits = tone.white > tone.black;
  return {
    black: fits ? tone.black : now.black,
    white: fits ? tone.white : now.white,
    curve: Object.hasOwn(CURVES, tone.curve) ? tone.curve : now.curve,
    gamma: tone.gamma > 0 ? tone.gamma : now.gamma,
  };
}

/** Round a number to four digits, so that its text restores it. */
export const shorten = (x) => Number(x.toPrecision(4));

/** Draw values into a canvas pixel by pixel. */
export function pictureCanvas(values, height, width, layout, tone, table = null) {
  const canvas = element("canvas", { width, height });
  const bytes = toBytes(values, height * width, layout, tone, table);
  canvas.getContext("2d").putImageData(new ImageData(bytes, width, height), 0, 0);
  return canvas;
}

/** Draw a colour bar between two numbers, with a label. */
export function colourBar(table, low, high, label) {
  const canvas = element("canvas", { width: 256, height: 1, "aria-hidden": "true" });
  const image = new ImageData(256, 1);
  for (let i = 0; i < 256; i++) image.data.set([...table.slice(3 * i, 3 * i + 3), 255], 4 * i);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return element(
    "figure",
    { class: "colour-bar" },
    canvas,
    element("figcaption", {}, element("span", {}, low), element("span", {}, label), element("span", {}, high)),
  );
}

