/** A light field: viewpoint, focus, aperture, depth, views, epipolar planes, raw image. */

import { commandOf, pythonOf } from "./commands.js";
import { button, checkbox, choice, copy, digits, element, group, metres, numberField, savePicture, slider } from "./controls.js";
import { acceptTone, colourBar, pictureCanvas, ToneControls } from "./display.js";
import { alphaOf, centreOf, disparityOfAlpha, disparityOfMetres, fNumberOf, metresOf, rounded, weightsOf } from "./law.js";
import { DeviceControls } from "./device.js";
import { Renderer } from "./renderer.js";
import { sharpestDisparity } from "./search.js";
import { bitmap, readMap } from "./source.js";
import { barLength, CanvasStage, Stage } from "./stage.js";
import { lookup } from "./tone.js";

const SHAPES = { one: "One", disc: "Disc", square: "Square", all: "All" };
const SWING = 0.6; // fraction of the stage between the first and the last view of a drag
const FRAME = 25; // time limit of a picture during motion, in milliseconds
const REST = 150; // delay before the exact picture is drawn, in milliseconds
const OVERLAY = 0.65; // opacity of the depth map
const EPI_ROW = 6; // height of a view in an epipolar-plane image, in CSS pixels
const LENS = 90; // size of the picture of the lens in pixels
const MONTAGE = 2048; // maximum size of the grid of views in pixels

export class LightFieldView {
  constructor(item, source, { index = 0, link = null, onChange = () => {}, say = () => {} } = {}) {
    Object.assign(this, { item, source, index, onChange, say });
    const [V, U, ny, nx] = item.shape;
    this.first = [V >> 1, U >> 1]; // initial view
    this.state = this.start();
    this.loaded = 0;
    this.speed = 0; // milliseconds per pixel and view
    this.stage = new Stage({
      label: `${item.name}: drag to move the viewpoint, click to focus`,
      size: [ny, nx],
      link,
      onDraw: () => this.redraw(),
      onClick: (y, x) => this.focusAt(y, x),
      onDrag: (down, right, ended) => this.drag(down, right, ended),
      onHover: (place) => this.hover(place),
      onKey: (event, arrow) => this.key(event, arrow),
    });
    this.renderer = new Renderer(this.stage.canvas, item);
    this.build();
  }

  /** Return the initial state. */
  start() {
    const { item, first } = this;
    const { black, white, curve } = item.shown;
    return {
      v: first[0], u: first[1], shape: "one", diameter: 0.5, across: 1, d: rounded(item.focus, 4),
      sharp: false, depth: false, show: "picture", black, white, curve, gamma: 2.2,
    };
  }

  /** Apply the valid parts of a state from a link. */
  take(state) {
    const [V, U] = this.item.shape;
    const within = (x, low, high, decimals) => rounded(Math.min(Math.max(x, low), high), decimals);
    Object.assign(this.state, acceptTone(state, this.state), {
      v: within(state.v, 0, V - 1, 2),
      u: within(state.u, 0, U - 1, 2),
      shape: Object.hasOwn(SHAPES, state.shape) ? state.shape : "one",
      diameter: within(state.diameter, 0.01, 1, 3),
      across: within(state.across, 1, Math.max(V, U), 0),
      d: rounded(state.d, 4),
      sharp: state.sharp && Boolean(this.item.depth),
      depth: state.depth && Boolean(this.item.depth),
      show: ["picture", "views", "slices", "raw"].includes(state.show) && (state.show !== "raw" || this.item.raw) ? state.show : "picture",
    });
  }

  get ready() {
    return this.loaded === this.item.samples.blobs.length;
  }

  /** Actions and the sentences that explain them until they were done. */
  get hints() {
    return this.state.show === "picture" ? { drag: "Drag to look around.", click: "Click to focus." } : {};
  }

  /** Viewpoint or aperture, and focus, as a line of text. */
  get summary() {
    const { state, item } = this;
    const [V, U] = item.shape;
    const at = `(v, u) = (${digits(state.v, 3)}, ${digits(state.u, 3)})`;
    const shapes = {
      one: `View ${at} of ${V} x ${U}`,
      disc: `Disc of ${digits(100 * state.diameter, 3)} % of the views at ${at}`,
      square: `${state.across} x ${state.across} views at ${at}`,
      all: `All ${V} x ${U} views`,
    };
    return `${shapes[state.shape]}; ${state.sharp ? "all in focus" : `focus at ${this.planeName()}`}`;
  }

  // ---- data

  async load() {
    const { item, source, renderer, first } = this;
    const U = item.shape[1];
    const order = item.samples.blobs.map((_, k) => k);
    const distance = (k) => Math.hypot(Math.floor(k / U) - first[0], (k % U) - first[1]);
    order.sort((a, b) => distance(a) - distance(b));
    const take = async (k) => {
      await renderer.load(k, await source.blob(item.samples.blobs[k]));
      this.loaded += 1;
    };
    await take(order[0]);
    this.redraw();
    await new Promise((resume) => requestAnimationFrame(() => setTimeout(resume)));
    for (let i = 1; i < order.length; i += 8) {
      await Promise.all(order.slice(i, i + 8).map(take));
      this.progress.value = this.loaded / order.length;
    }
    this.progress.hidden = true;
    if (item.depth) await this.takeMap(item.depth);
    this.changed();
  }

  /** Use a depth map, from the page or from the device. */
  async takeMap(depth, source = this.source) {
    const { values, height, width } = await readMap(source, depth.disparity);
    const [ny, nx] = this.stage.size;
    if (height !== ny || width !== nx) throw new Error(`The depth map has ${height} x ${width} pixels, the views have ${ny} x ${nx}.`);
    this.item.depth = depth;
    this.renderer.loadMap(values);
    for (const box of [this.sharp, this.overlay]) box.disable(false);
    const [low, high] = depth.range;
    const name = (d) => metres(metresOf(this.item, d)) || digits(d, 3);
    this.bar.replaceChildren(colourBar(lookup("viridis"), name(low), name(high), this.item.metres ? "from the plane in focus" : "disparity"));
  }

  // ---- drawing

  /** Draw the state, with fewer pixels during motion. */
  redraw({ exact = false } = {}) {
    if (!this.loaded || !this.renderer) return;
    const { renderer, stage } = this;
    const state = this.ready ? this.state : { ...this.state, shape: "one", v: this.first[0], u: this.first[1], sharp: false };
    const key = JSON.stringify([state.v, state.u, state.shape, state.diameter, state.across, state.d, state.sharp, renderer.hasMap]);
    const [ny, nx] = stage.size;
    if (key !== this.drawn || (exact && renderer.stride > 1)) {
      const { texels } = renderer.tableOf(state, state.d);
      const cost = this.speed * ny * nx * (texels.length / 8);
      const stride = exact || cost <= FRAME ? 1 : Math.min(Math.ceil(Math.sqrt(cost / FRAME)), 8);
      const start = performance.now();
      const count = renderer.sum(state, { disparity: state.sharp && renderer.hasMap ? null : state.d, stride });
      renderer.read(renderer.picture, 0, 0, 1, 1); // waits for the drawing
      this.speed = ((performance.now() - start) * stride * stride) / (ny * nx * count);
      this.drawn = key;
    }
    stage.cover(null);
    renderer.display({
      offset: stage.offset,
      scale: stage.scale,
      tone: state,
      overlay: this.state.depth ? OVERLAY : 0,
      range: this.item.depth?.range ?? [0, 1],
    });
    stage.mark(this.marks());
    if (this.item.pixel) this.scaleBar();
    clearTimeout(this.rest);
    if (!exact) this.rest = setTimeout(() => this.settle(), REST);
  }

  /** Draw the exact picture, its histogram and its slices when the motion ends. */
  settle() {
    if (!this.ready) return;
    this.redraw({ exact: true });
    const [ny, nx] = this.stage.size;
    this.values = this.renderer.values();
    this.tones.show(this.values, ny * nx, 4, Math.min(this.renderer.channels, 3));
    this.hover(this.stage.cursor);
    this.settled = this.drawn;
    this.onSettled?.();
    this.device?.refine();
  }

  /** Return the latest exact picture, {values, stride, channels, height, width}, or null. */
  shownPixels() {
    const [height, width] = this.stage.size;
    return this.values ? { values: this.values, stride: 4, channels: Math.min(this.renderer.channels, 3), height, width } : null;
  }

  /** Draw and return the exact picture of the state. */
  pixels() {
    this.settle();
    return this.shownPixels();
  }

  /** Return the displayed picture as a canvas, pixel by pixel. */
  picture() {
    const { values, height, width, ...layout } = this.pixels();
    return pictureCanvas(values, height, width, layout, this.state);
  }

  // ---- actions of the user

  change(changes) {
    Object.assign(this.state, changes);
    this.changed();
  }

  changed() {
    this.refresh();
    this.redraw();
    this.showSlices();
    this.onChange();
  }

  drag(down, right, ended) {
    if (this.state.show !== "picture") return;
    this.from ??= [this.state.v, this.state.u];
    const [V, U] = this.item.shape;
    const { clientHeight, clientWidth } = this.stage.element;
    this.moveTo(
      this.from[0] - (down * (V - 1)) / (SWING * clientHeight),
      this.from[1] - (right * (U - 1)) / (SWING * clientWidth),
    );
    if (ended) this.from = null;
  }

  /** Move the viewpoint to (v, u); a full aperture closes to a single view. */
  moveTo(v, u) {
    const [V, U] = this.item.shape;
    const within = (x, n) => rounded(Math.min(Math.max(x, 0), n - 1), 2);
    this.change({ v: within(v, V), u: within(u, U), shape: this.state.shape === "all" ? "one" : this.state.shape });
  }

  /** Focus on a pixel; open the aperture if it was a single view. */
  focusAt(y, x) {
    const { state, item, renderer } = this;
    const seen = state.shape === "one" ? [state.v, state.u] : null;
    let d = NaN;
    if (renderer.hasMap) {
      this.redraw({ exact: true });
      d = renderer.read(renderer.picture, y, x, 1, 1)[3];
    }
    const found = Number.isFinite(d) ? { disparity: d } : sharpestDisparity(renderer, item, [y, x], seen);
    if (found.note) this.say(found.note);
    this.change({ d: rounded(found.disparity, 4), sharp: false, ...(state.shape === "one" ? this.opened : {}) });
    if (!found.note) this.say(`Focus at ${this.planeName()}.`);
    return found.disparity;
  }

  /** The previous aperture, centred. */
  get opened() {
    const [v, u] = centreOf(this.item.shape);
    return { shape: this.wide ?? "all", v, u };
  }

  /** Focus on a plane; open the aperture if it is a single view, which looks alike on all planes. */
  focusOn(d) {
    const { shape, v, u } = this.state;
    const isOneView = shape === "one" && Number.isInteger(v) && Number.isInteger(u);
    this.change({ d: rounded(d, 4), sharp: false, ...(isOneView ? this.opened : {}) });
  }

  planeName() {
    const { d } = this.state;
    const alpha = alphaOf(this.item, d);
    const z = metres(metresOf(this.item, d));
    return `disparity ${digits(d)}${Number.isFinite(alpha) ? `, alpha ${digits(alpha)}` : ""}${z && `, ${z} from the plane in focus`}`;
  }

  key(event, arrow) {
    const { state, item } = this;
    const [low, high] = item.range;
    if (arrow) this.moveTo(state.v + arrow[0] / 2, state.u + arrow[1] / 2);
    else if (event.key === "[" || event.key === "]")
      this.focusOn(state.d + ((event.key === "]" ? 1 : -1) * (high - low)) / 100);
    else if (event.key === "a" && renderable(this)) this.change({ sharp: !state.sharp });
    else if (event.key === "d" && renderable(this)) this.change({ depth: !state.depth });
    else if (event.key === "e") this.show("slices");
    else if (event.key === "g") this.show("views");
    else if (event.key === "r" && item.raw) this.show("raw");
    else if (event.key === "p") this.show("picture");
    else return false;
    return true;
  }

  // ---- controls

  build() {
    const { item, state, stage } = this;
    const [V, U] = item.shape;
    const [low, high] = item.range;
    this.focus = slider({ label: "Disparity", unit: "px per view", min: low, max: high, step: 0.001, onInput: (d) => this.focusOn(d) });
    this.alpha = numberField({ label: "alpha = F/F'", onInput: (alpha) => this.setPlane(disparityOfAlpha(item, alpha), "alpha") });
    this.metres = numberField({ label: item.metres?.linear ? "z (\u00b5m)" : "z (mm)", onInput: (z) => this.setPlane(disparityOfMetres(item, z * this.metreUnit), "z") });
    this.sharp = checkbox({ label: "All in focus", title: "Needs a depth map", onInput: (sharp) => this.change({ sharp }) });
    this.overlay = checkbox({ label: "Show depth map", title: "Needs a depth map", onInput: (depth) => this.change({ depth }) });
    this.bar = element("div", {});
    for (const box of [this.sharp, this.overlay]) box.disable(true);
    this.shape = choice({ label: "Shape", options: SHAPES, onInput: (shape) => this.open(shape) });
    this.diameter = slider({ label: "Diameter", unit: "fraction of the views", min: 0.05, max: 1, step: 0.01, onInput: (x) => this.change({ diameter: rounded(Math.min(Math.max(x, 0.01), 1), 3) }) });
    this.across = slider({ label: "Views across", min: 1, max: Math.max(V, U), step: 1, onInput: (x) => this.change({ across: Math.min(Math.max(Math.round(x), 1), Math.max(V, U)) }) });
    this.fNumber = element("p", { class: "said" });
    this.lens = element("canvas", { width: this.cell * U, height: this.cell * V, class: "lens", role: "img", "aria-label": "Aperture on the main lens", style: `aspect-ratio: ${U} / ${V}` });
    this.lens.addEventListener("pointerdown", (event) => this.pick(event));
    this.lens.addEventListener("pointermove", (event) => event.buttons && this.pick(event));
    this.v = slider({ label: "Viewpoint v", min: 0, max: V - 1, step: 0.01, onInput: (v) => this.moveTo(v, this.state.u) });
    this.u = slider({ label: "Viewpoint u", min: 0, max: U - 1, step: 0.01, onInput: (u) => this.moveTo(this.state.v, u) });
    this.tones = new ToneControls({ tone: state, range: item.shown.range, onChange: () => this.changed() });
    const shows = { picture: "Picture", views: "Views", slices: "EPI", ...(item.raw && { raw: "Raw" }) };
    this.shows = choice({ label: "Show", options: shows, onInput: (show) => this.show(show) });
    this.progress = element("progress", { max: 1, value: 0, "aria-label": "Loaded views" });
    this.bars = element("div", { class: "scale-bar", hidden: true }, element("span"), element("i"));
    this.slices = element("div", { class: "slices", hidden: true });
    this.grid = new CanvasStage({ label: "All views", size: [V, U], onClick: (y, x) => this.pickView(y, x) });
    this.grid.element.hidden = true;
    stage.element.append(this.bars);
    this.main = element("div", { class: "main" }, stage.element, this.grid.element, this.slices, this.progress);
    this.device = this.source.canCompute ? new DeviceControls(this) : null;
    this.tools = element(
      "div",
      { class: "tools" },
      this.shows.element,
      group("Focus", this.focus.element, item.alpha ? this.alpha.element : null, item.metres ? this.metres.element : null, this.sharp.element, this.overlay.element, this.bar),
      group("Aperture", this.shape.element, this.diameter.element, this.across.element, this.fNumber, element("div", { class: "lens-row" }, this.lens, element("div", {}, this.v.element, this.u.element))),
      this.device?.element ?? null,
      this.tones.element,
      group("Export",
        element("div", { class: "buttons" },
          button("Save PNG", () => this.save(), "Save the displayed picture pixel by pixel"),
          item.command ? button("Copy as command", () => this.copyText(this.command(), "The command")) : null,
          button("Copy as Python", () => this.copyText(this.python(), "The Python lines")),
          button("Copy link", () => this.copyText(location.href, "The link")),
        ),
      ),
    );
    this.refresh();
  }

  /** Pixels of a view in the picture of the lens. */
  get cell() {
    return Math.max(2, Math.round(LENS / Math.max(...this.item.shape.slice(0, 2))));
  }

  get metreUnit() {
    return this.item.metres?.linear ? 1e-6 : 1e-3;
  }

  setPlane(d, name) {
    if (Number.isFinite(d)) this.focusOn(d);
    else this.say(`No plane has this ${name}.`);
  }

  open(shape) {
    if (shape !== "one") this.wide = shape;
    const centre = centreOf(this.item.shape);
    const moved = shape === "all" ? { v: centre[0], u: centre[1] } : {};
    const whole = shape === "one" && this.state.shape === "all" ? { v: this.first[0], u: this.first[1] } : {};
    this.change({ shape, ...moved, ...whole });
  }

  /** Move the viewpoint to the pressed position on the lens. */
  pick(event) {
    const [V, U] = this.item.shape;
    const box = this.lens.getBoundingClientRect();
    this.moveTo(((event.clientY - box.top) / box.height) * V - 0.5, ((event.clientX - box.left) / box.width) * U - 0.5);
  }

  /** Show the pressed view of the grid. */
  pickView(y, x) {
    const [V, U] = this.item.shape;
    const [high, wide] = this.grid.size;
    this.change({ shape: "one", v: Math.floor((y * V) / high), u: Math.floor((x * U) / wide), show: "picture" });
  }

  show(show) {
    this.change({ show: show === this.state.show ? "picture" : show });
  }

  /** Update the controls from the state. */
  refresh() {
    const { item, state } = this;
    this.focus.set(state.d, digits(state.d, 5));
    this.alpha.set(digits(alphaOf(item, state.d), 6));
    this.metres.set(digits(metresOf(item, state.d) / this.metreUnit, 5));
    this.sharp.set(state.sharp);
    this.overlay.set(state.depth);
    this.bar.hidden = !state.depth;
    this.shape.set(state.shape);
    this.diameter.show(state.shape === "disc");
    this.diameter.set(state.diameter);
    this.across.show(state.shape === "square");
    this.across.set(state.across);
    const number = fNumberOf(item, state.shape === "disc" ? state.diameter : 1);
    this.fNumber.textContent = state.shape !== "one" && state.shape !== "square" && Number.isFinite(number) ? `f/${digits(number, 3)} at the image` : "";
    this.v.set(state.v);
    this.u.set(state.u);
    this.shows.set(state.show);
    this.tones.refresh();
    this.drawLens();
    this.stage.element.hidden = state.show === "views" || state.show === "raw";
    this.grid.element.hidden = !this.stage.element.hidden;
    this.slices.hidden = state.show !== "slices";
  }

  /** Draw the weights of the views. */
  drawLens() {
    const [V, U] = this.item.shape;
    const to = this.lens.getContext("2d");
    const { weights } = weightsOf(this.item, this.state);
    const { cell } = this;
    const gap = cell > 5 ? 1 : 0;
    const most = Math.max(...weights);
    to.clearRect(0, 0, cell * U, cell * V);
    weights.forEach((w, k) => {
      to.globalAlpha = 0.12 + (0.88 * w) / most;
      to.fillStyle = getComputedStyle(this.lens).color;
      to.fillRect(cell * (k % U), cell * Math.floor(k / U), cell - gap, cell - gap);
    });
  }

  marks() {
    if (this.state.show !== "slices") return {};
    const [y, x] = this.cut();
    const [ny, nx] = this.stage.size;
    return { lines: [[y, -0.5, y, nx - 0.5], [-0.5, x, ny - 0.5, x]] };
  }

  /** Pixel (y, x) of the slices. */
  cut() {
    return this.stage.cursor ?? this.lastCut ?? this.stage.size.map((n) => n >> 1);
  }

  showSlices() {
    if (!this.ready) return;
    if (this.state.show === "slices") this.showEpi();
    else if (this.state.show === "views") this.showGrid();
    else if (this.state.show === "raw") this.showRaw();
  }

  showEpi() {
    const [V, U] = this.item.shape;
    const [y, x] = this.cut();
    this.lastCut = [y, x];
    const [v, u] = [Math.min(Math.round(this.state.v), V - 1), Math.min(Math.round(this.state.u), U - 1)];
    const layout = { stride: 4, channels: this.renderer.channels };
    const drawn = (slice, label) => {
      const canvas = pictureCanvas(slice.values, slice.height, slice.width, layout, this.state);
      return element("figure", {}, canvas, element("figcaption", {}, label));
    };
    const row = this.renderer.slice("row", { fixed: [v, y] });
    const column = this.renderer.slice("column", { fixed: [u, x] });
    this.slices.replaceChildren(
      drawn(row, `x and u, at y = ${y}, v = ${v}`),
      drawn(transposed(column), `y and v, at x = ${x}, u = ${u}`),
    );
    for (const [figure, n] of [[this.slices.firstChild, U], [this.slices.lastChild, V]])
      figure.firstChild.style.height = `${Math.min(n * EPI_ROW, 96)}px`;
  }

  showGrid() {
    const [V, U, ny, nx] = this.item.shape;
    const share = Math.min(1, MONTAGE / (V * ny), MONTAGE / (U * nx));
    const tile = [ny, nx].map((n) => Math.max(1, Math.floor(n * share)));
    const { values, height, width } = this.renderer.slice("grid", { tile });
    this.grid.mark({});
    this.grid.show(pictureCanvas(values, height, width, { stride: 4, channels: this.renderer.channels }, this.state));
  }

  async showRaw() {
    const { raw } = this.item;
    this.raw ??= await bitmap(await this.source.blob(raw.blob));
    this.grid.onMarks = (stage) => (stage.own = this.state.show === "raw" ? lenslets(raw, stage) : {});
    this.grid.show(this.raw, raw.shape);
  }

  hover(place) {
    const [ny, nx] = this.stage.size;
    if (this.state.show === "slices" && place) {
      this.showEpi();
      this.stage.own = this.marks();
    }
    if (!place || !this.values || this.values.length !== 4 * ny * nx) return this.onHover?.("");
    const [y, x] = place;
    const at = 4 * (y * nx + x);
    const value = [...this.values.slice(at, at + Math.min(this.renderer.channels, 3))].map((n) => digits(n)).join(", ");
    const d = this.values[at + 3];
    const depth = this.renderer.hasMap ? `, disparity ${digits(d, 3)}${metres(metresOf(this.item, d)) && `, ${metres(metresOf(this.item, d))}`}` : "";
    return this.onHover?.(`y ${y}, x ${x}: ${value}${depth}`);
  }

  scaleBar() {
    showBar(this.bars, this.item.pixel[1], this.stage);
  }

  save() {
    savePicture(this.picture(), `${this.item.name}.png`);
  }

  /** Return the command that makes the picture. */
  command() {
    return commandOf(this.item, this.state, this.state);
  }

  /** Return the lines of Python that make the picture. */
  python() {
    return pythonOf(this.item, this.state);
  }

  async copyText(text, what) {
    if (text === null) {
      this.say("This aperture has no command, because the page keeps the central views only.");
      return;
    }
    await copy(text);
    this.say(`${what} ${what.endsWith("s") ? "are" : "is"} on the clipboard.`);
  }
}

const renderable = (view) => view.renderer.hasMap;

function transposed({ values, height, width }) {
  const turned = new Float32Array(values.length);
  for (let i = 0; i < height; i++)
    for (let j = 0; j < width; j++) turned.set(values.subarray(4 * (i * width + j), 4 * (i * width + j) + 4), 4 * (j * height + i));
  return { values: turned, height: width, width: height };
}

/** Circles of the visible lenslets, if they are large enough. */
function lenslets({ lattice }, stage) {
  if (!lattice || lattice.pitch * stage.scale < 24) return {};
  const { origin, rows, columns, pitch } = lattice;
  const [top, left] = stage.offset;
  const ends = [[0, 0], [stage.canvas.height, stage.canvas.width], [0, stage.canvas.width], [stage.canvas.height, 0]].map(
    ([y, x]) => [(y - top) / stage.scale - origin[0], (x - left) / stage.scale - origin[1]],
  );
  const det = rows[0] * columns[1] - rows[1] * columns[0];
  const at = ends.map(([y, x]) => [(y * columns[1] - x * columns[0]) / det, (x * rows[0] - y * rows[1]) / det]);
  const circles = [];
  const [first, last] = [Math.min, Math.max].map((end) => [0, 1].map((axis) => Math.floor(end(...at.map((place) => place[axis])))));
  for (let i = Math.max(first[0], 0); i <= Math.min(last[0], lattice.count[0] - 1); i++)
    for (let j = Math.max(first[1], 0); j <= Math.min(last[1], lattice.count[1] - 1); j++) {
      const shift = lattice.hexagonal && i % 2 ? 0.5 : 0;
      circles.push([origin[0] + i * rows[0] + (j + shift) * columns[0], origin[1] + i * rows[1] + (j + shift) * columns[1], pitch / 2]);
    }
  return { circles };
}

/** Show a scale bar for pixels of a size in metres. */
export function showBar(bars, pixel, stage) {
  const ratio = stage.canvas.width / (stage.element.clientWidth || 1);
  const length = barLength((pixel * 110 * ratio) / stage.scale);
  bars.firstChild.textContent = metres(length);
  bars.lastChild.style.width = `${((length / pixel) * stage.scale) / ratio}px`;
  bars.hidden = false;
}
