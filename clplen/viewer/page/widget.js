/** The viewer in a notebook, with data and computations in the kernel (anywidget's protocol). */

import { mount } from "./viewer.js";

class ModelSource {
  constructor(model) {
    this.model = model;
    this.content = model.get("content");
    this.canCompute = model.get("computes");
    this.waiting = new Map(); // by channel
    model.on("msg:custom", (message, buffers) => this.receive(message, buffers));
  }

  missing() {
    return null;
  }

  async blob(n) {
    const view = this.model.get("blobs")[n];
    return new Uint8Array(view.buffer, view.byteOffset, view.byteLength);
  }

  compute(request, channel, onProgress) {
    this.waiting.get(channel)?.reject(null);
    const id = crypto.getRandomValues(new Uint32Array(1))[0];
    return new Promise((resolve, reject) => {
      this.waiting.set(channel, { id, resolve, reject, onProgress });
      this.model.send({ id, channel, request });
    });
  }

  receive(message, buffers) {
    const asked = this.waiting.get(message.channel);
    if (!asked || asked.id !== message.id) return;
    if (message.progress !== undefined) {
      asked.onProgress?.(message.progress, message.what);
      return;
    }
    this.waiting.delete(message.channel);
    if (message.error) asked.reject(new Error(message.error));
    else asked.resolve({ result: message.result, blobs: buffers.map((b) => new Uint8Array(b.buffer, b.byteOffset, b.byteLength)) });
  }
}

/** Render a model in an element of a notebook. */
export function render({ model, el }) {
  const root = document.createElement("div");
  root.style.height = `${model.get("height")}px`;
  el.append(root);
  const viewer = mount(root, new ModelSource(model), { hash: false });
  return () => {
    viewer.end();
    root.remove();
  };
}
