/** Volumes, focal stacks, time series, maps and pictures: slices along three axes, projections. */

import { button, choice, copy, digits, element, group, metres, savePicture, slider } from "./controls.js";
import { acceptTone, colourBar, pictureCanvas, ToneControls } from "./display.js";
import { showBar } from "./light_field.js";
import { MOST, unpack16 } from "./source.js";
import { CanvasStage, SectionStage } from "./stage.js";
import { lookup } from "./tone.js";
import { trackMarks } from "./track_marks.js";

const LEAST_DEPTH = 0.12; // minimum height of a section along z, as a fraction of the picture's
const MOST_DEPTH = 0.94; // maximum fraction of the available height
const TABLES = { grey: "Grey", viridis: "Viridis", magma: "Magma" };

export class VolumeView {
  constructor(item, source, { link = null, onChange = () => {}, say = () => {} } = {}) {
    Object.assign(this, { item, source, onChange, say });
    [this.T, this.Z, this.ny, this.nx] = item.shape;
    this.channels = item.shape[4] ?? 1;
    const { black, white, curve, table } = item.shown;
    this.state = {
      t: 0, z: item.first ?? this.Z >> 1, y: this.ny >> 1, x: this.nx >> 1, projection: "slice",
      black, white, curve, gamma: 2.2, table: table ?? "grey",
    };
    this.frames = new Map();
    this.stage = new CanvasStage({
      label: `${item.name}: click to move the cross`,
      size: [this.ny, this.nx],
      link,
      onMarks: (stage) => {
        stage.own = this.cross("z");
        this.paintSections();
        if (item.spacing) showBar(this.bars, item.spacing[2], stage);
      },
      onClick: (y, x) => this.change({ y, x }),
      onHover: (place) => this.hover(place),
      onKey: (event, arrow) => this.key(event, arrow),
    });
    this.build();
  }

  /** Apply the valid parts of a state from a link. */
  take(state) {
    const within = (x, n) => Math.min(Math.max(Math.round(x), 0), n - 1);
    Object.assign(this.state, acceptTone(state, this.state), {
      t: within(state.t, this.T),
      z: within(state.z, this.Z),
      y: within(state.y, this.ny),
      x: within(state.x, this.nx),
      projection: state.projection === "maximum" ? "maximum" : "slice",
      table: Object.hasOwn(TABLES, state.table) ? state.table : "grey",
    });
  }

  get ready() {
    return this.frames.has(this.state.t);
  }

  /** Actions and the sentences that explain them until they were done. */
  get hints() {
    return this.Z > 1 ? { click: "Click to move the cross." } : {};
  }

  /** Size and position as a line of text. */
  get summary() {
    const { T, Z, ny, nx, state } = this;
    const size = `${Z > 1 ? `${Z} planes of ` : ""}${ny} x ${nx} pixels`;
    const time = T > 1 ? `, time ${state.t} of 0 to ${T - 1}` : "";
    return Z > 1 ? `${size}${time}; ${this.planeName()}, cross at y ${state.y}, x ${state.x}` : `${size}${time}`;
  }

  // ---- data

  async load() {
    await this.frame(this.state.t);
    this.changed();
  }

  /** Load the planes of a time as 16-bit arrays. */
  async frame(t) {
    if (this.frames.has(t)) return;
    const planes = new Array(this.Z);
    this.progress.hidden = false;
    for (let z = 0; z < this.Z; z += 1) {
      planes[z] = await unpack16(await this.source.blob(this.item.samples.blobs[t * this.Z + z]), this.nx * this.channels);
      if (planes[z].length !== this.ny * this.nx * this.channels) throw new Error(`Plane ${z} is damaged: it must have ${this.ny} x ${this.nx} pixels.`);
      this.progress.value = (z + 1) / this.Z;
    }
    this.progress.hidden = true;
    this.frames.set(t, planes);
  }

  /** Height of a plane in sections along z, in pixels of the picture, limited by the available space. */
  get thickness() {
    const { spacing } = this.item;
    const known = spacing?.[0] ? Math.abs(spacing[0] / spacing[1]) : 1;
    const room = Math.min(this.front.canvas.height, this.side.canvas.width) / this.stage.scale;
    return Math.min(Math.max(known * this.Z, LEAST_DEPTH * Math.min(this.ny, this.nx)), MOST_DEPTH * room) / this.Z;
  }

  /** Paint the sections, scaled like the picture. */
  paintSections() {
    const { Z, ny, nx, thickness } = this;
    if (Z === 1 || !this.front.source) return;
    this.front.show(this.front.source, [Z * thickness, nx]);
    this.side.show(this.side.source, [ny, Z * thickness]);
  }

  /** Return a slice or projection across an axis: {values, height, width}. */
  section(axis) {
    const { Z, ny, nx, channels } = this;
    const planes = this.frames.get(this.state.t);
    const { samples } = this.item;
    const [low, step] = samples.levels?.[this.state.t] ?? [samples.low, samples.step];
    const sizes = { z: [ny, nx], y: [Z, nx], x: [ny, Z] };
    const [height, width] = sizes[axis];
    const all = this.state.projection === "maximum";
    const count = { z: Z, y: ny, x: nx }[axis];
    const at = this.state[axis];
    const [first, last] = all ? [0, count - 1] : [at, at];
    const values = new Float32Array(height * width * channels).fill(NaN);
    const place = { z: (n, i, j) => [n, i * nx + j], y: (n, i, j) => [i, n * nx + j], x: (n, i, j) => [j, i * nx + n] }[axis];
    for (let n = first; n <= last; n++)
      for (let i = 0; i < height; i++)
        for (let j = 0; j < width; j++) {
          const [z, at] = place(n, i, j);
          for (let c = 0; c < channels; c++) {
            const q = planes[z][at * channels + c];
            const to = (i * width + j) * channels + c;
            if (q <= MOST && !(low + step * q <= values[to])) values[to] = low + step * q;
          }
        }
    return { values, height, width, stride: channels, channels: Math.min(channels, 3) };
  }

  // ---- drawing

  changed() {
    this.refresh();
    if (!this.ready) {
      this.frame(this.state.t).then(() => this.changed(), (error) => this.say(error.message));
      return;
    }
    this.draw();
    this.onChange();
  }

  draw() {
    const { ny, nx, Z, state } = this;
    this.values = this.section("z");
    const { values, height, width, ...layout } = this.values;
    this.shown = pictureCanvas(values, height, width, layout, state, this.table);
    this.tones.show(values, height * width, layout.stride, layout.channels);
    if (Z > 1)
      for (const [axis, stage] of [["y", this.front], ["x", this.side]]) {
        const cut = this.section(axis);
        stage.source = pictureCanvas(cut.values, cut.height, cut.width, layout, state, this.table);
      }
    this.stage.show(this.shown, [ny, nx]);
    this.onSettled?.();
  }

  redraw() {
    this.stage.paint();
  }

  get table() {
    return this.channels === 1 && this.state.table !== "grey" ? lookup(this.state.table) : null;
  }

  /** Return the slice, {values, stride, channels, height, width}, or null. */
  shownPixels() {
    return this.values ?? null;
  }

  pixels() {
    return this.values;
  }

  picture() {
    return this.shown;
  }

  /** Return the lines of the cross and the tracks for the stage across an axis. */
  cross(axis) {
    const { state, thickness, Z, ny, nx } = this;
    const place = (name, value) => (name === "z" ? (value + 0.5) * thickness - 0.5 : value);
    const { tracks } = this.item;
    const marks = tracks ? trackMarks(tracks, state, axis, place) : { lines: [], circles: [] };
    if (Z === 1) return marks;
    const along = { z: (state.z + 0.5) * thickness - 0.5, y: state.y, x: state.x };
    const [rows, columns] = { z: ["y", "x"], y: ["z", "x"], x: ["y", "z"] }[axis];
    const size = { z: Z * thickness, y: ny, x: nx };
    marks.lines.push(
      [along[rows], -0.5, along[rows], size[columns] - 0.5],
      [-0.5, along[columns], size[rows] - 0.5, along[columns]],
    );
    return marks;
  }

  // ---- actions of the user

  change(changes) {
    Object.assign(this.state, changes);
    this.changed();
  }

  key(event, arrow) {
    const { state } = this;
    const within = (name, by, n) => ({ [name]: Math.min(Math.max(state[name] + by, 0), n - 1) });
    if (arrow) this.change({ ...within("y", arrow[0], this.ny), ...within("x", arrow[1], this.nx) });
    else if (event.key === "[" || event.key === "]") this.change(within("z", event.key === "]" ? 1 : -1, this.Z));
    else if (event.key === "," || event.key === ".") this.change(within("t", event.key === "." ? 1 : -1, this.T));
    else if (event.key === "m") this.change({ projection: state.projection === "slice" ? "maximum" : "slice" });
    else return false;
    return true;
  }

  hover(place) {
    if (!place || !this.values) return this.onHover?.("");
    const [y, x] = place;
    const { values, stride, channels } = this.values;
    const at = stride * (y * this.nx + x);
    const text = [...values.slice(at, at + channels)].map((n) => digits(n) || "no value").join(", ");
    const plane = this.Z > 1 ? `${this.planeName()}, ` : "";
    const unit = this.item.unit ? ` ${this.item.unit}` : "";
    return this.onHover?.(`${plane}y ${y}, x ${x}: ${text}${unit}`);
  }

  planeName() {
    const { planes } = this.item;
    const value = planes?.values[this.state.z];
    if (this.state.projection === "maximum") return "maximum";
    if (value === undefined || value === null) return `plane ${this.state.z}`;
    return planes.unit === "m" ? `${planes.label} = ${metres(value)}` : `${planes.label} = ${digits(value)}`;
  }

  // ---- controls

  build() {
    const { item, state, T, Z, ny, nx } = this;
    const move = (name) => (value) => this.change({ [name]: Math.round(Math.min(Math.max(value, 0), { t: T, z: Z, y: ny, x: nx }[name] - 1)) });
    const axis = (label, name, n) => slider({ label, min: 0, max: n - 1, step: 1, onInput: move(name) });
    this.sliders = { t: axis("Time", "t", T), z: axis("Plane", "z", Z), y: axis("y", "y", ny), x: axis("x", "x", nx) };
    this.sliders.t.show(T > 1);
    this.plane = element("p", { class: "said" });
    this.projection = choice({ label: "Projection", options: { slice: "Slice", maximum: "Maximum" }, onInput: (projection) => this.change({ projection }) });
    this.tones = new ToneControls({ tone: state, range: item.shown.range, tables: this.channels === 1 ? TABLES : null, onChange: () => this.changed() });
    this.progress = element("progress", { max: 1, value: 0, "aria-label": "Loaded planes" });
    this.bars = element("div", { class: "scale-bar", hidden: true }, element("span"), element("i"));
    this.bar = element("div", {});
    const cut = (name, along, label, onClick) => {
      const onMarks = (stage) => (stage.own = this.cross(name));
      return new SectionStage({ main: this.stage, along, label, size: [1, 1], onMarks, onClick });
    };
    const planeAt = (at) => Math.min(Math.max(Math.floor((at + 0.5) / this.thickness), 0), Z - 1);
    this.front = cut("y", 1, `${item.name}, x and z`, (at, x) => this.change({ z: planeAt(at), x }));
    this.side = cut("x", 0, `${item.name}, y and z`, (y, at) => this.change({ z: planeAt(at), y }));
    const cuts = Z > 1 ? [this.side.element, this.front.element] : [];
    this.main = element("div", { class: Z > 1 ? "main sections" : "main" }, this.stage.element, ...cuts, this.progress);
    this.stage.element.append(this.bars);
    this.tools = element(
      "div",
      { class: "tools" },
      Z > 1 ? group("Position", this.sliders.t.element, this.sliders.z.element, this.plane, this.sliders.y.element, this.sliders.x.element, this.projection.element) : null,
      this.tones.element,
      this.bar,
      group("Export",
        element("div", { class: "buttons" },
          button("Save PNG", () => savePicture(this.picture(), `${item.name}.png`), "Save the displayed slice pixel by pixel"),
          button("Copy as Python", () => this.copyPython()),
          button("Copy link", () => this.copyLink()),
        ),
      ),
    );
    this.refresh();
  }

  refresh() {
    for (const [name, control] of Object.entries(this.sliders)) control.set(this.state[name]);
    this.plane.textContent = this.planeName();
    this.projection.set(this.state.projection);
    this.tones.refresh();
    const { black, white } = this.state;
    const name = (value) => (this.item.unit === "m" ? metres(value) : digits(value, 3));
    if (this.table) this.bar.replaceChildren(colourBar(this.table, name(black), name(white), this.item.unit ?? "value"));
    else this.bar.replaceChildren();
  }

  async copyPython() {
    await copy(`import clplen\n\n${this.item.python ?? "data = ...  # the displayed data"}\n`);
    this.say("The Python lines are on the clipboard.");
  }

  async copyLink() {
    await copy(location.href);
    this.say("The link is on the clipboard.");
  }
}
