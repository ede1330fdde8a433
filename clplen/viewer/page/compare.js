/** Results side by side, with one zoom and one cursor, their difference, and their scores. */

import { digits, element, group, slider } from "./controls.js";
import { pictureCanvas } from "./display.js";
import { LightFieldView } from "./light_field.js";
import { CanvasStage } from "./stage.js";
import { VolumeView } from "./volume.js";

/** The view of an item. */
export function viewOf(item, source, options) {
  const View = item.kind === "light field" ? LightFieldView : VolumeView;
  return new View(item, source, options);
}

export class CompareView {
  constructor(items, source, { onChange = () => {}, say = () => {}, scores = null } = {}) {
    this.item = { name: items.map((item) => item.name).join(" and ") };
    this.link = { zoom: 1, y: 0.5, x: 0.5, stages: [] };
    this.views = items.map((item, index) => viewOf(item, source, { index, link: this.link, say, onChange }));
    this.gain = 1;
    this.chosen = 0;
    const { black, white, curve } = this.views[0].state;
    for (const view of this.views)
      if (view.item.unit === items[0].unit && view.item.kind === items[0].kind) Object.assign(view.state, { black, white, curve });
    for (const view of this.views) {
      view.onSettled = () => this.showDifference();
      view.onHover = (text) => this.tell(view, text);
    }
    this.build(items, scores);
  }

  get stage() {
    return this.views[0].stage;
  }

  get hints() {
    return this.views[0].hints;
  }

  get summary() {
    return this.views[this.chosen].summary;
  }

  get state() {
    return { ...Object.assign({}, ...this.views.map((view, i) => prefixed(view.state, i))), gain: this.gain };
  }

  /** Take a state as far as it fits. */
  take(state) {
    for (const [i, view] of this.views.entries()) {
      const own = Object.keys(view.state).map((name) => [name, state[`${i}.${name}`]]);
      view.take(Object.fromEntries(own));
    }
    this.gain = state.gain > 0 ? state.gain : 1;
  }

  async load() {
    await Promise.all(this.views.map((view) => view.load()));
  }

  changed() {
    for (const view of this.views) view.changed();
  }

  redraw() {
    for (const view of this.views) view.redraw();
  }

  picture() {
    return this.views[this.chosen].picture();
  }

  build(items, scores) {
    this.difference = new CanvasStage({ label: "Difference of the first two", size: this.stage.size, link: this.link });
    this.texts = items.map(() => element("p", { class: "said" }));
    this.said = element("p", { class: "said" });
    const panel = (name, main, text) => element("section", { class: "panel" }, element("h2", {}, name), main, text);
    const differs = panel(`Difference, ${items[1].name} - ${items[0].name}`, element("div", { class: "main" }, this.difference.element), this.said);
    this.main = element("div", { class: "compared" }, ...this.views.map((view, i) => panel(items[i].name, view.main, this.texts[i])), differs);
    this.gains = slider({ label: "Difference multiplied by", min: 1, max: 32, step: 1, onInput: (gain) => {
      this.gain = Math.max(gain, 0.01);
      this.showDifference();
    } });
    this.gains.set(this.gain);
    const names = element("div", { class: "buttons", role: "tablist", "aria-label": "Input to control" },
      ...items.map((item, i) => element("button", { type: "button", role: "tab", onclick: () => this.choose(i) }, item.name)));
    this.names = names;
    this.own = element("div", {});
    this.tools = element("div", { class: "tools" }, group("Difference", this.gains.element), scores ? table(scores) : null, names, this.own);
    this.choose(0);
  }

  choose(i) {
    this.chosen = i;
    for (const [k, tab] of [...this.names.children].entries()) tab.setAttribute("aria-selected", k === i);
    this.own.replaceChildren(this.views[i].tools);
  }

  tell(view, text) {
    this.texts[this.views.indexOf(view)].textContent = text;
  }

  showDifference() {
    const [a, b] = this.views.slice(0, 2).map((view) => (view.ready ? view.shownPixels() : null));
    if (!a || !b) return;
    if (a.height !== b.height || a.width !== b.width) {
      this.said.textContent = `No difference: ${a.height} x ${a.width} and ${b.height} x ${b.width} pixels.`;
      return;
    }
    const count = a.height * a.width;
    const difference = new Float32Array(count);
    let [sum, most, known] = [0, 0, 0];
    for (let i = 0; i < count; i++) {
      let total = 0;
      for (let c = 0; c < a.channels; c++) total += b.values[i * b.stride + (b.channels > c ? c : 0)] - a.values[i * a.stride + c];
      difference[i] = total / a.channels;
      if (!Number.isFinite(difference[i])) continue;
      sum += difference[i] ** 2;
      most = Math.max(most, Math.abs(difference[i]));
      known += 1;
    }
    const { black, white } = this.views[0].state;
    const half = (white - black) / 2 / this.gain;
    const tone = { black: -half, white: half, curve: "linear" };
    this.difference.show(pictureCanvas(difference, a.height, a.width, { stride: 1, channels: 1 }, tone, diverging()));
    this.said.textContent = `rms ${digits(Math.sqrt(sum / known), 3)}, maximum ${digits(most, 3)}; blue is negative, red is positive`;
  }
}

/** Blue, white, red: 256 colours. */
function diverging() {
  const colours = new Uint8Array(768);
  for (let i = 0; i < 256; i++) {
    const t = (i - 127.5) / 127.5;
    const side = Math.min(Math.abs(t), 1);
    const pale = 245 - 190 * side;
    colours.set(t < 0 ? [pale, pale + 40 * side, 245 - 35 * side] : [245 - 35 * side, pale, pale + 10 * side], 3 * i);
  }
  return colours;
}

const prefixed = (state, i) => Object.fromEntries(Object.entries(state).map(([name, value]) => [`${i}.${name}`, value]));

function table({ columns, rows }) {
  return group("Scores",
    element("table", {},
      element("thead", {}, element("tr", {}, ...["", ...columns].map((text) => element("th", { scope: "col" }, text)))),
      element("tbody", {}, ...rows.map(([name, ...values]) =>
        element("tr", {}, element("th", { scope: "row" }, name), ...values.map((value) => element("td", {}, value)))))));
}
