/** A picture that is zoomed and moved by mouse, touch and keys; its owner draws it. */

import { element } from "./controls.js";

const CLICK = 4; // CSS pixels that a click may move
const STEP = 1.25; // factor of the zoom by key
const [MIN_ZOOM, MAX_ZOOM] = [1, 64];

export class Stage {
  /**
   * label: name of the canvas; size: (y, x) of the picture;
   * onDraw(), onClick(y, x), onDrag(down, right, ended) in CSS pixels from the start,
   * onHover(place or null), onKey(event) true if it used the key; link: zoom and position that
   * stages share, with onLook() after a change of zoom and onUse("drag" or "click").
   */
  constructor({ label, size, onDraw, onClick, onDrag, onHover, onKey, link = null }) {
    Object.assign(this, { size, onDraw, onClick, onDrag, onHover, onKey });
    this.link = link ?? { zoom: 1, y: 0.5, x: 0.5, stages: [] }; // middle as shares of the picture
    this.link.stages.push(this);
    this.canvas = element("canvas", { width: 1, height: 1 });
    this.top = element("canvas", { width: 1, height: 1, hidden: true }); // finer parts, over it
    this.marks = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    this.marks.setAttribute("aria-hidden", "true");
    this.element = element("div", { class: "stage", tabindex: 0, role: "img", "aria-label": label }, this.canvas, this.top, this.marks);
    this.pointers = new Map();
    this.cursor = null;
    this.listen();
    new ResizeObserver(() => this.resize()).observe(this.element);
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.element.clientWidth, this.element.clientHeight].map((n) => Math.max(1, Math.round(n * ratio)));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.onDraw();
  }

  /** Canvas pixels of a pixel of the picture. */
  get scale() {
    return Math.min(this.canvas.height / this.size[0], this.canvas.width / this.size[1]) * this.link.zoom;
  }

  /** Canvas pixel (y, x) of the picture's upper left corner. */
  get offset() {
    const { link, size, scale, canvas } = this;
    return [canvas.height / 2 - link.y * size[0] * scale, canvas.width / 2 - link.x * size[1] * scale].map(Math.round);
  }

  /** Place in the picture under a pointer, in pixels whose centres are whole numbers. */
  placeOf(event) {
    const box = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / box.width;
    const [top, left] = this.offset;
    return [
      ((event.clientY - box.top) * ratio - top) / this.scale - 0.5,
      ((event.clientX - box.left) * ratio - left) / this.scale - 0.5,
    ];
  }

  /** Rows and columns of the picture that are in sight, [y0, y1, x0, x1]. */
  get sight() {
    const [top, left] = this.offset;
    const end = (length, start, size) => [
      Math.min(Math.max(Math.floor(-start / this.scale), 0), size - 1),
      Math.max(Math.min(Math.ceil((length - start) / this.scale), size), 1),
    ];
    return [...end(this.canvas.height, top, this.size[0]), ...end(this.canvas.width, left, this.size[1])];
  }

  /** Draw a finer picture over a region [y0, y1, x0, x1], until the next change; null: remove it. */
  cover(source, region) {
    this.top.hidden = !source;
    if (!source) return;
    Object.assign(this.top, { width: this.canvas.width, height: this.canvas.height });
    const [top, left] = this.offset;
    const [y0, y1, x0, x1] = region.map((end) => end * this.scale);
    this.top.getContext("2d").drawImage(source, left + x0, top + y0, x1 - x0, y1 - y0);
  }

  isInside([y, x]) {
    return y >= -0.5 && x >= -0.5 && y < this.size[0] - 0.5 && x < this.size[1] - 0.5;
  }

  /** Zoom by a factor so that a place stays where it is. */
  zoomBy(factor, [y, x] = [this.link.y * this.size[0] - 0.5, this.link.x * this.size[1] - 0.5]) {
    const { link, size } = this;
    const zoom = Math.min(Math.max(link.zoom * factor, MIN_ZOOM), MAX_ZOOM);
    const share = link.zoom / zoom;
    const [sy, sx] = [(y + 0.5) / size[0], (x + 0.5) / size[1]];
    this.look({ zoom, y: sy + (link.y - sy) * share, x: sx + (link.x - sx) * share });
  }

  /** Move the picture by canvas pixels. */
  panBy(down, right) {
    const { link, size, scale } = this;
    this.look({ zoom: link.zoom, y: link.y - down / (size[0] * scale), x: link.x - right / (size[1] * scale) });
  }

  look({ zoom, y, x }) {
    const within = (share) => (zoom <= 1 ? 0.5 : Math.min(Math.max(share, 0), 1));
    Object.assign(this.link, { zoom, y: within(y), x: within(x) });
    for (const stage of this.link.stages) stage.onDraw();
    this.link.onLook?.();
  }

  listen() {
    const node = this.element;
    node.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY / (event.deltaMode ? 10 : 300)), this.placeOf(event));
    }, { passive: false });
    node.addEventListener("pointerdown", (event) => this.press(event));
    node.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) node.addEventListener(name, (event) => this.lift(event));
    node.addEventListener("pointerleave", () => this.pointers.size || this.hover(null));
    node.addEventListener("contextmenu", (event) => event.shiftKey && event.preventDefault());
    node.addEventListener("keydown", (event) => this.key(event));
  }

  press(event) {
    if (event.button > 1) return;
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, event);
    this.start = event;
    this.last = event;
    this.moved = this.pointers.size > 1;
    this.pans = event.shiftKey || event.button === 1 || this.pointers.size > 1;
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      const place = this.placeOf(event);
      this.hover(this.isInside(place) ? place.map(Math.round) : null);
      return;
    }
    const [down, right] = [event.clientY - this.start.clientY, event.clientX - this.start.clientX];
    if (Math.hypot(down, right) > CLICK) this.moved = true;
    if (this.pointers.size > 1) this.pinch(event, before);
    else if (this.moved && this.pans) {
      const ratio = window.devicePixelRatio || 1;
      this.panBy((event.clientY - this.last.clientY) * ratio, (event.clientX - this.last.clientX) * ratio);
    } else if (this.moved) this.onDrag?.(down, right, false);
    this.last = event;
    this.pointers.set(event.pointerId, event);
  }

  /** Two fingers: their distance zooms, their middle moves. */
  pinch(event, before) {
    const other = [...this.pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
    const distance = (a) => Math.hypot(a.clientX - other.clientX, a.clientY - other.clientY) || 1;
    const middle = { clientX: (event.clientX + other.clientX) / 2, clientY: (event.clientY + other.clientY) / 2 };
    this.zoomBy(distance(event) / distance(before), this.placeOf(middle));
    const ratio = window.devicePixelRatio || 1;
    this.panBy(((event.clientY - before.clientY) * ratio) / 2, ((event.clientX - before.clientX) * ratio) / 2);
  }

  lift(event) {
    if (!this.pointers.delete(event.pointerId) || this.pointers.size) return;
    if (event.type === "pointerup" && !this.moved) {
      const place = this.placeOf(event);
      if (this.isInside(place)) this.click(...place.map(Math.round));
    } else if (this.moved && !this.pans) {
      this.onDrag?.(event.clientY - this.start.clientY, event.clientX - this.start.clientX, true);
      this.link.onUse?.("drag");
    }
  }

  click(y, x) {
    this.onClick?.(y, x);
    this.link.onUse?.("click");
  }

  /** Show the cross at a pixel, here and in linked stages. */
  hover(place) {
    for (const stage of this.link.stages) {
      stage.cursor = place && stage.isInside(place) ? place : null;
      stage.onHover?.(stage.cursor);
      stage.mark();
    }
  }

  key(event) {
    if (event.ctrlKey || event.metaKey) return;
    const arrows = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
    const arrow = arrows[event.key];
    let used = true;
    if (event.key === "+" || event.key === "=") this.zoomBy(STEP);
    else if (event.key === "-") this.zoomBy(1 / STEP);
    else if (event.key === "0") this.look({ zoom: 1, y: 0.5, x: 0.5 });
    else if (arrow && event.shiftKey) this.panBy(-40 * arrow[0], -40 * arrow[1]);
    else if (arrow && event.altKey) {
      const from = this.cursor ?? this.size.map((n) => Math.floor(n / 2));
      this.hover(from.map((at, axis) => Math.min(Math.max(at + arrow[axis], 0), this.size[axis] - 1)));
    } else if (event.key === "Enter" && this.cursor) this.click(...this.cursor);
    else used = this.passKey(event, arrow);
    if (used) {
      event.preventDefault();
      event.stopPropagation();
    }
  }

  /** Give a key to the owner; an arrow counts as a drag. */
  passKey(event, arrow) {
    const used = Boolean(this.onKey?.(event, arrow));
    if (used && arrow) this.link.onUse?.("drag");
    return used;
  }

  /** Draw the marks: lines [y0, x0, y1, x1] and circles [y, x, radius] in pixels of the picture. */
  mark({ lines = [], circles = [] } = this.own ?? {}) {
    this.own = { lines, circles };
    const ratio = this.canvas.width / (this.element.clientWidth || 1);
    const [top, left] = this.offset;
    const place = (y, x) => [(top + (y + 0.5) * this.scale) / ratio, (left + (x + 0.5) * this.scale) / ratio];
    const shapes = lines.map(([y0, x0, y1, x1]) => {
      const [[ya, xa], [yb, xb]] = [place(y0, x0), place(y1, x1)];
      return svg("line", { x1: xa, y1: ya, x2: xb, y2: yb });
    });
    for (const [y, x, radius] of circles) {
      const [cy, cx] = place(y, x);
      shapes.push(svg("circle", { cx, cy, r: (radius * this.scale) / ratio }));
    }
    if (this.cursor) {
      const [cy, cx] = place(...this.cursor);
      for (const d of [`M${cx - 9} ${cy}h6m6 0h6`, `M${cx} ${cy - 9}v6m0 6v6`]) shapes.push(svg("path", { d }));
    }
    this.marks.replaceChildren(...shapes);
  }
}

function svg(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

/** A stage that shows a canvas, `source`, whose pixels are those of the picture. */
export class CanvasStage extends Stage {
  constructor(options) {
    super({ ...options, onDraw: () => this.paint() });
    this.source = null;
    this.onMarks = options.onMarks;
  }

  show(source, size = [source.height, source.width]) {
    this.source = source;
    this.size = size;
    this.paint();
  }

  paint() {
    const to = this.canvas.getContext("2d");
    to.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (!this.source) return;
    to.imageSmoothingEnabled = this.scale < 6 && this.scale !== 1;
    const [top, left] = this.offset;
    to.drawImage(this.source, left, top, this.size[1] * this.scale, this.size[0] * this.scale);
    this.onMarks?.(this);
    this.mark();
  }
}

/** A stage for a section along z beside a main one, whose zoom and place it shares. */
export class SectionStage extends CanvasStage {
  /** main: the stage of the picture; along: its axis that this one shares, 0 for y and 1 for x. */
  constructor({ main, along, ...options }) {
    super(options);
    Object.assign(this, { main, along });
  }

  get scale() {
    return this.main ? this.main.scale : 1;
  }

  get offset() {
    if (!this.main) return [0, 0];
    const middle = [this.canvas.height, this.canvas.width].map((n, axis) => Math.round((n - this.size[axis] * this.scale) / 2));
    middle[this.along] = this.main.offset[this.along];
    return middle;
  }

  zoomBy(factor) {
    this.main.zoomBy(factor);
  }

  panBy(down, right) {
    this.main.panBy(...(this.along ? [0, right] : [down, 0]));
  }
}

/** Length of a scale bar: 1, 2 or 5 times a power of ten, at most so long. */
export function barLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return power * ([5, 2, 1].find((n) => n * power <= most) ?? 1);
}
