/** Conversion of values to colours: levels, curves, lookup tables, histograms. */

import { TABLES } from "./lookup_tables.js";

export const CURVES = { linear: "Linear", srgb: "sRGB", gamma: "Gamma", log: "Logarithmic" };

const DECADES = 3; // range of the logarithmic curve

/** Value of the curve at t, both from 0 to 1. */
export function curve(t, tone) {
  if (tone.curve === "srgb") return t <= 0.0031308 ? 12.92 * t : 1.055 * t ** (1 / 2.4) - 0.055;
  if (tone.curve === "gamma") return t ** (1 / tone.gamma);
  if (tone.curve === "log") return Math.log10(1 + (10 ** DECADES - 1) * t) / DECADES;
  return t;
}

/** Names of the curves in the order of their numbers in shaders. */
export const curveNumber = (tone) => Object.keys(CURVES).indexOf(tone.curve);

/** GLSL of the curves. */
export const CURVE_GLSL = `
uniform int curve_number;
uniform float gamma, black, white;
float toned(float value) {
  float t = clamp((value - black) / (white - black), 0.0, 1.0);
  if (curve_number == 1) return t <= 0.0031308 ? 12.92 * t : 1.055 * pow(t, 1.0 / 2.4) - 0.055;
  if (curve_number == 2) return t > 0.0 ? pow(t, 1.0 / gamma) : 0.0;
  if (curve_number == 3) return log(1.0 + ${10 ** DECADES - 1}.0 * t) / log(${10 ** DECADES}.0);
  return t;
}`;

/** Return a lookup table: 256 colours of three bytes. */
export function lookup(name) {
  const table = new Uint8Array(768);
  const hex = TABLES[name];
  for (let i = 0; i < 768; i++)
    table[i] = hex ? parseInt(hex.slice(2 * i, 2 * i + 2), 16) : Math.floor(i / 3);
  return table;
}

const isFinite_ = Number.isFinite;

/**
 * Return the RGBA bytes of a picture; values that are not finite become transparent.
 *
 * values: channels numbers a pixel (1, or 3 and more, of which three are shown), stride apart.
 */
export function toBytes(values, count, { stride, channels }, tone, table = null) {
  const bytes = new Uint8ClampedArray(4 * count);
  const scale = 1 / (tone.white - tone.black);
  const byte = (value) => 255 * curve(Math.min(Math.max((value - tone.black) * scale, 0), 1), tone);
  for (let i = 0; i < count; i++) {
    const from = i * stride;
    if (!isFinite_(values[from])) continue;
    if (channels >= 3)
      for (let c = 0; c < 3; c++) bytes[4 * i + c] = byte(values[from + c]);
    else {
      const level = Math.round(byte(values[from]));
      for (let c = 0; c < 3; c++) bytes[4 * i + c] = table ? table[3 * level + c] : level;
    }
    bytes[4 * i + 3] = 255;
  }
  return bytes;
}

/** Return the histogram of values between two levels. */
export function histogram(values, count, stride, channels, low, high, bins = 128) {
  const counts = new Uint32Array(bins);
  const scale = bins / (high - low);
  for (let i = 0; i < count; i++)
    for (let c = 0; c < channels; c++) {
      const value = values[i * stride + c];
      if (isFinite_(value)) counts[Math.min(Math.max(Math.floor((value - low) * scale), 0), bins - 1)]++;
    }
  return counts;
}
