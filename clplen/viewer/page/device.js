/** Controls for computations on the device: depth, and exact pictures of the complete light field. */

import { fullState } from "./commands.js";
import { button, element, group, savePicture, select } from "./controls.js";
import { pictureCanvas } from "./display.js";
import { unpackFloats } from "./source.js";

const CUES = { "": "Default", correspondence: "Correspondence", energy: "Energy", "structure-tensor": "Structure tensor", combined: "Combined" };
const INTERPOLATIONS = { linear: "Linear", cubic: "Cubic", nearest: "Nearest", fourier: "Fourier" };
const FINER = { 1: "1 x", 2: "2 x", 3: "3 x", 4: "4 x" };

export class DeviceControls {
  constructor(view) {
    this.view = view;
    this.cue = "";
    this.interpolation = "linear";
    this.finer = 1;
    const bind = (name, label, options, parse = String) => {
      const made = select({
        label,
        options,
        onInput: (value) => {
          this[name] = parse(value);
        },
      });
      made.set(String(this[name]));
      return made.element;
    };
    this.progress = element("progress", { max: 1, value: 0, hidden: true, "aria-label": "Computation" });
    this.element = group("On the device",
      bind("cue", "Depth cue", CUES),
      element("div", { class: "buttons" }, button("Compute depth", () => this.depth())),
      bind("interpolation", "Interpolation", INTERPOLATIONS),
      bind("finer", "Pixels", FINER, Number),
      element("div", { class: "buttons" },
        button("Exact picture", () => this.picture(), "Compute the picture from the complete light field"),
        button("Save exact PNG", () => this.save())),
      this.progress,
    );
  }

  /** Send a request to the device; null if a newer request replaced it, or after an error message. */
  async ask(request, channel) {
    const { view, progress } = this;
    try {
      progress.hidden = false;
      progress.removeAttribute("value");
      return await view.source.compute({ item: view.index, ...request }, channel, (share, what) => {
        if (share > 0) progress.value = share;
        view.say(`${what} ...`);
      });
    } catch (error) {
      if (error) view.say(error.message);
      return null;
    } finally {
      progress.hidden = true;
    }
  }

  async depth() {
    const { view } = this;
    const found = await this.ask({ kind: "depth", cue: this.cue || null, downscale: view.item.full.downscale }, "depth");
    if (!found) return;
    await view.takeMap(found.result, { blob: async (n) => found.blobs[n] });
    view.say("The depth map is ready: clicks focus by it.");
    view.change({ depth: true });
  }

  /** Show the exact picture of the visible region. */
  async picture({ quiet = false } = {}) {
    const { view } = this;
    const before = this.signature();
    const made = await this.compute();
    if (!made || before !== this.signature()) return null;
    const n = view.item.full.downscale;
    view.stage.cover(made.canvas, made.region.map((end) => end / n));
    if (!quiet) view.say(`Exact picture of the visible region, from the complete light field (${this.interpolation}).`);
    return made.canvas;
  }

  signature() {
    const { link } = this.view.stage;
    return JSON.stringify([this.view.state, link.zoom, link.y, link.x]);
  }

  async compute() {
    const { view } = this;
    const { state, item, stage } = view;
    const full = fullState(item, state);
    if (!full) return view.say("This aperture cannot be computed, because the page keeps the central views only.");
    const { downscale: n, views } = item.full;
    const [y0, y1, x0, x1] = stage.sight.map((end) => end * n);
    const whole = { ...state, v: full.v, u: full.u, d: full.d };
    if (state.shape === "disc") whole.diameter = Number(full.aperture);
    else if (full.aperture !== null) Object.assign(whole, { shape: "square", across: Math.min(Number(full.aperture), Math.max(...views)) });
    const request = { kind: "picture", state: whole, interpolation: this.interpolation, upsample: this.finer, region: [y0, y1, x0, x1] };
    const found = await this.ask(request, "picture");
    if (!found) return null;
    const [height, width, channels] = found.result.shape;
    const values = await unpackFloats(found.blobs[0]);
    return { canvas: pictureCanvas(values, height, width, { stride: channels, channels }, state), region: found.result.region };
  }

  async save() {
    const made = await this.compute();
    if (made) savePicture(made.canvas, `${this.view.item.name} exact.png`);
  }

  /** Request the exact picture of the visible region if the page has coarser views than the file. */
  refine() {
    if (this.view.item.full.downscale > 1 && this.view.state.show === "picture") this.picture({ quiet: true });
  }
}
