/**
 * Views on the graphics processor: refocused pictures, single views, slices, and their display.
 *
 * A picture is summed as by clplen.refocus and LightField.view (docs/conventions.md): taps are
 * fetched one by one and weighted in float, a sample outside a view counts neither in the sum nor
 * in the weights, and only then come black, white and the curve. Views lie in the layers of one
 * texture array, several below each other where there are more views than layers.
 */

import { split, stepsFrom, weightsOf } from "./law.js";
import { bitmap, unpack16 } from "./source.js";
import { CURVE_GLSL, curveNumber, lookup } from "./tone.js";

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`;

const head = (integers) => `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
precision highp ${integers ? "usampler2DArray" : "sampler2DArray"};
uniform ${integers ? "usampler2DArray" : "sampler2DArray"} views;
uniform ivec2 size;
uniform vec2 levels;
vec4 sample_at(ivec2 layer, int y, int x) {
  return levels.x + levels.y * vec4(texelFetch(views, ivec3(x, y + layer.y, layer.x), 0));
}`;

// Pairs are (y, x) throughout. Texels of the table, two a view: shift (whole y, x, part y, x), or by
// the map the step (y, x); weight, layer and row in it, and whether interpolation is cubic.
const SUM = `
uniform sampler2D table, map;
uniform int count, stride, mode;
uniform ivec2 corner;
uniform vec2 origin;
out vec4 result;
float tap(float t, int i) {
  if (i == 0) return ((-0.5 * t + 1.0) * t - 0.5) * t;
  if (i == 1) return (1.5 * t - 2.5) * t * t + 1.0;
  if (i == 2) return ((-1.5 * t + 2.0) * t + 0.5) * t;
  return (0.5 * t - 0.5) * t * t;
}
vec4 linear(ivec2 layer, ivec2 at, vec2 part) {
  vec4 sum = vec4(0);
  for (int a = 0; a < 2; ++a)
    for (int b = 0; b < 2; ++b) {
      ivec2 p = at + ivec2(a, b);
      float w = (a == 0 ? 1.0 - part.x : part.x) * (b == 0 ? 1.0 - part.y : part.y);
      if (w > 0.0 && p.x >= 0 && p.y >= 0 && p.x < size.x && p.y < size.y)
        sum += w * vec4(sample_at(layer, p.x, p.y).rgb, 1);
    }
  return sum;
}
vec4 cubic(ivec2 layer, ivec2 at, vec2 part) {
  ivec2 last = size - 1;
  if (at.x < 0 || at.y < 0 || at.x > last.x || at.y > last.y) return vec4(0);
  if ((at.x == last.x && part.x > 0.0) || (at.y == last.y && part.y > 0.0)) return vec4(0);
  vec3 sum = vec3(0);
  for (int a = 0; a < 4; ++a)
    for (int b = 0; b < 4; ++b) {
      ivec2 p = clamp(at + ivec2(a - 1, b - 1), ivec2(0), size - 1);
      sum += tap(part.x, a) * tap(part.y, b) * sample_at(layer, p.x, p.y).rgb;
    }
  return vec4(sum, 1);
}
float disparity_at(vec2 p) {
  vec2 at = clamp(p, vec2(0), vec2(size - 1));
  ivec2 low = ivec2(floor(at)), high = min(low + 1, size - 1);
  vec2 t = at - vec2(low);
  return mix(
    mix(texelFetch(map, low.yx, 0).r, texelFetch(map, ivec2(high.y, low.x), 0).r, t.y),
    mix(texelFetch(map, ivec2(low.y, high.x), 0).r, texelFetch(map, high.yx, 0).r, t.y), t.x);
}
void main() {
  ivec2 pixel = corner + ivec2(gl_FragCoord.yx) * stride;
  float d = 0.0;
  if (mode > 0) {
    d = texelFetch(map, pixel.yx, 0).r;
    for (int round = 0; round < 8 && origin != vec2(0); ++round)
      d = disparity_at(vec2(pixel) - origin * d);
  }
  vec4 sum = vec4(0);
  for (int k = 0; k < count; ++k) {
    vec4 shift = texelFetch(table, ivec2(2 * k, 0), 0);
    vec4 view = texelFetch(table, ivec2(2 * k + 1, 0), 0);
    ivec2 layer = ivec2(view.yz);
    ivec2 at = ivec2(shift.xy);
    vec2 part = shift.zw;
    if (mode == 2) {
      vec2 whole = floor(shift.xy * d);
      at = ivec2(whole);
      part = shift.xy * d - whole;
    }
    if (view.w > 0.0) sum += view.x * cubic(layer, pixel + at, part);
    else sum += view.x * linear(layer, pixel + at, part);
  }
  result = vec4(sum.a > 0.0 ? sum.rgb / sum.a : vec3(0), d);
}`;

const SLICE = `
uniform int across;
uniform ivec2 tile, fixed_at;
uniform int kind, stacked;
out vec4 result;
ivec2 layer_of(int k) { return ivec2(k / stacked, (k % stacked) * size.x); }
void main() {
  ivec2 p = ivec2(gl_FragCoord.yx);
  int v, u, y, x;
  if (kind == 0) { v = fixed_at.x; y = fixed_at.y; u = p.x; x = p.y; }
  else if (kind == 1) { u = fixed_at.x; x = fixed_at.y; v = p.y; y = p.x; }
  else {
    v = p.x / tile.x; u = p.y / tile.y;
    y = (p.x % tile.x) * size.x / tile.x; x = (p.y % tile.y) * size.y / tile.y;
  }
  result = vec4(sample_at(layer_of(v * across + u), y, x).rgb, 1);
}`;

const DISPLAY = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
uniform sampler2D picture, table;
uniform vec2 offset, range;
uniform float scale, opacity;
uniform ivec2 size;
uniform int stride, height, grey;
${CURVE_GLSL}
out vec4 colour;
vec4 pixel(ivec2 p) { return texelFetch(picture, clamp(p, ivec2(0), size - 1).yx / stride, 0); }
vec4 smooth_at(vec2 p) {
  vec2 low = floor(p), t = p - low;
  ivec2 i = ivec2(low);
  return mix(mix(pixel(i), pixel(i + ivec2(0, 1)), t.y),
             mix(pixel(i + ivec2(1, 0)), pixel(i + ivec2(1, 1)), t.y), t.x);
}
void main() {
  vec2 place = (vec2(float(height) - gl_FragCoord.y, gl_FragCoord.x) - offset) / scale;
  if (place.x < 0.0 || place.y < 0.0 || place.x >= float(size.x) || place.y >= float(size.y)) {
    colour = vec4(0);
    return;
  }
  vec4 value = pixel(ivec2(floor(place)));
  if (scale < 1.0) {
    int n = int(min(ceil(1.0 / scale), 8.0));
    vec4 sum = vec4(0);
    for (int a = 0; a < n; ++a)
      for (int b = 0; b < n; ++b)
        sum += pixel(ivec2(floor(place + (vec2(a, b) + 0.5) / (float(n) * scale) - 0.5 / scale)));
    value = sum / float(n * n);
  } else if (scale > 1.0 && scale < 6.0) value = smooth_at(place - 0.5);
  vec3 shown = vec3(toned(value.r));
  if (grey == 0) shown = vec3(toned(value.r), toned(value.g), toned(value.b));
  float level = clamp((value.a - range.x) / (range.y - range.x), 0.0, 1.0);
  vec3 over = texelFetch(table, ivec2(int(floor(level * 255.0 + 0.5)), 0), 0).rgb;
  float light = dot(shown, vec3(0.299, 0.587, 0.114));
  colour = vec4(opacity > 0.0 ? mix(vec3(light), over, opacity) : shown, 1);
}`;

const NO_WEBGL =
  "This browser has no WebGL 2 with floating-point textures, which light fields need: update it, or " +
  "enable hardware acceleration.";

/** Renderer of a light field in a canvas. */
export class Renderer {
  constructor(canvas, item) {
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error(NO_WEBGL);
    const full = gl.getExtension("EXT_color_buffer_float");
    if (!full && !gl.getExtension("EXT_color_buffer_half_float")) throw new Error(NO_WEBGL);
    this.gl = gl;
    this.item = item;
    [this.V, this.U, this.ny, this.nx] = item.shape;
    this.channels = item.shape[4] ?? 1;
    this.integers = item.samples.type === "uint16";
    this.format = full ? gl.RGBA32F : gl.RGBA16F;
    this.programs = {
      sum: program(gl, head(this.integers) + SUM),
      slice: program(gl, head(this.integers) + SLICE),
      display: program(gl, DISPLAY),
    };
    gl.bindVertexArray(gl.createVertexArray());
    gl.disable(gl.DITHER);
    this.hasMap = false;
    this.picture = this.target(this.ny, this.nx);
    this.scratch = null;
    this.stride = 1;
    this.layers();
    this.table = texture(gl);
    this.map = texture(gl);
    this.colours = texture(gl);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, lookup("viridis"));
  }

  /** Allocate the textures of the views. */
  layers() {
    const { gl, V, U, ny, nx } = this;
    const [most, side] = [gl.MAX_ARRAY_TEXTURE_LAYERS, gl.MAX_TEXTURE_SIZE].map((n) => gl.getParameter(n));
    this.stacked = Math.ceil((V * U) / most);
    if (Math.max(ny * this.stacked, nx, 2 * V * U) > side)
      throw new Error(
        `The ${V} x ${U} views of ${ny} x ${nx} pixels exceed the limits of this graphics processor ` +
          `(${most} layers, ${side} pixels): write the page with --most-views or --downscale.`,
      );
    const three = this.channels === 3;
    const kinds = {
      uint8: [three ? gl.RGB8 : gl.R8, three ? gl.RGB : gl.RED, gl.UNSIGNED_BYTE],
      uint16: [three ? gl.RGB16UI : gl.R16UI, three ? gl.RGB_INTEGER : gl.RED_INTEGER, gl.UNSIGNED_SHORT],
    };
    this.kind = kinds[this.item.samples.type];
    this.views = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.views);
    const count = Math.ceil((V * U) / this.stacked);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, this.kind[0], nx, ny * this.stacked, count);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, gl.NEAREST);
    if (gl.getError())
      throw new Error(
        `The graphics processor has too little memory for ${V} x ${U} views of ${ny} x ${nx} pixels: ` +
          "write the page with --most-views or --downscale.",
      );
  }

  /** Upload view k from its bytes. */
  async load(k, bytes) {
    const { gl, nx, ny, kind } = this;
    const integers = this.integers;
    const data = integers ? await unpack16(bytes, nx * this.channels) : await bitmap(bytes);
    if ((integers ? data.length : data.width * data.height * this.channels) !== nx * ny * this.channels)
      throw new Error(`View ${k} must have ${ny} x ${nx} pixels: the file is damaged.`);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.views);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    const at = [0, (k % this.stacked) * ny, Math.floor(k / this.stacked)];
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, ...at, nx, ny, 1, kind[1], kind[2], data);
    data.close?.();
  }

  /** Upload the disparity of every pixel of the centre view. */
  loadMap(values) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.map);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, this.nx, this.ny, 0, gl.RED, gl.FLOAT, values);
    this.hasMap = true;
  }

  /** Return the texels (shifts, weights, layers) of the views with weight. */
  tableOf(state, disparity) {
    const { weights, viewpoint, cubic } = weightsOf(this.item, state);
    const { steps, origin } = stepsFrom(this.item, viewpoint);
    const byMap = disparity === null;
    const texels = [];
    weights.forEach((w, k) => {
      if (!(w > 0)) return;
      const [sy, sx] = steps[k];
      const [[y, py], [x, px]] = byMap ? [[sy, 0], [sx, 0]] : [sy, sx].map((s) => split(s * disparity, cubic));
      const [layer, row] = [Math.floor(k / this.stacked), (k % this.stacked) * this.ny];
      texels.push(y, x, py, px, w, layer, row, cubic ? 1 : 0);
    });
    return { texels, origin };
  }

  /**
   * Sum the picture of a state into a target, `this.picture` if none is given.
   *
   * options: disparity (null: by the map), stride (draw every so manyth pixel), target,
   * corner (y, x) of the part that the target holds.
   */
  sum(state, { disparity = state.d, stride = 1, target = this.picture, corner = [0, 0] } = {}) {
    const { gl } = this;
    const { texels, origin } = this.tableOf(state, disparity);
    const run = this.programs.sum;
    gl.useProgram(run.program);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, texels.length / 4, 1, 0, gl.RGBA, gl.FLOAT, new Float32Array(texels));
    run.bind("views", 0, gl.TEXTURE_2D_ARRAY, this.views);
    run.bind("table", 1, gl.TEXTURE_2D, this.table);
    run.bind("map", 2, gl.TEXTURE_2D, this.map);
    gl.uniform2i(run.at("size"), this.ny, this.nx);
    gl.uniform2f(run.at("levels"), this.item.samples.low, this.item.samples.step);
    gl.uniform1i(run.at("count"), texels.length / 8);
    gl.uniform1i(run.at("stride"), stride);
    gl.uniform1i(run.at("mode"), disparity === null ? 2 : this.hasMap ? 1 : 0);
    gl.uniform2i(run.at("corner"), ...corner);
    gl.uniform2f(run.at("origin"), ...origin);
    const [height, width] = [target.height, target.width].map((n) => Math.ceil(n / stride));
    this.draw(target, height, width);
    if (target === this.picture) this.stride = stride;
    return texels.length / 8;
  }

  /** Fill the lower left part of a target with the program in use. */
  draw(target, height, width) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target?.buffer ?? null);
    gl.viewport(0, 0, width, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Show the picture in the canvas: canvas pixel = offset + scale * picture pixel, (y, x). */
  display({ offset, scale, tone, overlay = 0, range = [0, 1] }) {
    const { gl } = this;
    const run = this.programs.display;
    const { width, height } = gl.canvas;
    gl.useProgram(run.program);
    run.bind("picture", 0, gl.TEXTURE_2D, this.picture.texture);
    run.bind("table", 1, gl.TEXTURE_2D, this.colours);
    gl.uniform2f(run.at("offset"), ...offset);
    gl.uniform2f(run.at("range"), ...range);
    gl.uniform1f(run.at("scale"), scale);
    gl.uniform1f(run.at("opacity"), this.hasMap ? overlay : 0);
    gl.uniform2i(run.at("size"), this.ny, this.nx);
    gl.uniform1i(run.at("stride"), this.stride);
    gl.uniform1i(run.at("height"), height);
    gl.uniform1i(run.at("grey"), this.channels === 1 ? 1 : 0);
    gl.uniform1i(run.at("curve_number"), curveNumber(tone));
    for (const name of ["gamma", "black", "white"]) gl.uniform1f(run.at(name), tone[name]);
    this.draw(null, height, width);
  }

  /** RGBA floats of the picture: values, and in the fourth channel its disparity. */
  values(target = this.picture) {
    return this.read(target, 0, 0, target.height, target.width);
  }

  read(target, y, x, height, width) {
    const { gl } = this;
    const values = new Float32Array(4 * height * width);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.buffer);
    gl.readPixels(x, y, width, height, gl.RGBA, gl.FLOAT, values);
    return values;
  }

  /**
   * Samples without interpolation, as RGBA floats: kind "row" is (u, x) at fixed [v, y], "column"
   * (y, v) at fixed [u, x], "grid" all views, each in tile [height, width] pixels.
   */
  slice(kind, { fixed = [0, 0], tile = [1, 1] } = {}) {
    const { gl, V, U, ny, nx } = this;
    const shapes = { row: [U, nx], column: [ny, V], grid: [V * tile[0], U * tile[1]] };
    const [height, width] = shapes[kind];
    const run = this.programs.slice;
    gl.useProgram(run.program);
    run.bind("views", 0, gl.TEXTURE_2D_ARRAY, this.views);
    gl.uniform2i(run.at("size"), ny, nx);
    gl.uniform2f(run.at("levels"), this.item.samples.low, this.item.samples.step);
    gl.uniform1i(run.at("across"), U);
    gl.uniform2i(run.at("tile"), ...tile);
    gl.uniform2i(run.at("fixed_at"), ...fixed);
    gl.uniform1i(run.at("kind"), Object.keys(shapes).indexOf(kind));
    gl.uniform1i(run.at("stacked"), this.stacked);
    const target = this.target(height, width);
    this.draw(target, height, width);
    const values = this.values(target);
    this.release(target);
    return { values, height, width };
  }

  /** Create a floating-point render target. */
  target(height, width) {
    const { gl } = this;
    const made = { texture: texture(gl), buffer: gl.createFramebuffer(), height, width };
    gl.texStorage2D(gl.TEXTURE_2D, 1, this.format, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, made.buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.texture, 0);
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) throw new Error(NO_WEBGL);
    return made;
  }

  release({ texture: used, buffer }) {
    this.gl.deleteTexture(used);
    this.gl.deleteFramebuffer(buffer);
  }
}

/** Create and bind a texture without interpolation. */
function texture(gl) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  return made;
}

/** Compile a program; return it with its uniforms by name. */
function program(gl, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) {
    const logs = gl.getAttachedShaders(made).map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(`The graphics processor rejects a shader: ${[gl.getProgramInfoLog(made), ...logs].join(" ")}`);
  }
  const uniforms = {};
  const at = (name) => (uniforms[name] ??= gl.getUniformLocation(made, name));
  const bind = (name, unit, kind, bound) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, bound);
    gl.uniform1i(at(name), unit);
  };
  return { program: made, at, bind };
}
