/**
 * The viewer: mount(element, source) shows the content of a source (source.js) in an element.
 *
 * source.content is {title, items, compare, scores, sizes}; an item has the kind "light field"
 * (light_field.js) or "volume" (volume.js). The page's hash stores the state of the view.
 */

import { CompareView, viewOf } from "./compare.js";
import { button, element } from "./controls.js";
import { EmbeddedSource, ServerSource } from "./source.js";

const KEYS = [
  ["drag", "move the viewpoint"],
  ["click, Enter", "focus, or move the cross"],
  ["wheel, + and -", "zoom"],
  ["shift + drag or arrows", "move the picture"],
  ["0", "fit the picture"],
  ["arrows", "move the viewpoint or the cross"],
  ["alt + arrows", "move the cursor"],
  ["[ and ]", "focus or plane"],
  [", and .", "time"],
  ["a", "all in focus"],
  ["d", "depth map"],
  ["p, g, e, r", "picture, grid of views, epipolar planes, raw image"],
  ["m", "maximum projection"],
  ["f", "full screen"],
];
const HASH_DELAY = 200; // milliseconds
const HINTS_KEY = "clplen-hints"; // names of the actions that need no hint any more

/**
 * Show the content of a source; return {view, views, ready, end} with a promise ready and a function
 * end() that removes the listeners.
 *
 * hash: true to store the state in the page's address.
 */
export function mount(root, source, { hash = true } = {}) {
  root.classList.add("clplen");
  const status = element("p", { class: "status", role: "status" });
  const said = element("p", { class: "said", "aria-live": "polite" });
  const fail = (error) => {
    if (error === null) return;
    root.replaceChildren(element("p", { class: "failure", role: "alert" }, error.message ?? String(error)));
  };
  const listening = new AbortController();
  const viewer = { view: null, views: [], ready: null, end: () => listening.abort() };
  try {
    const cut = source.missing();
    if (cut) throw new Error(cut);
    viewer.ready = show(root, source, viewer, { status, said, hash, signal: listening.signal }).catch(fail);
  } catch (error) {
    fail(error);
    viewer.ready = Promise.resolve();
  }
  return viewer;
}

async function show(root, source, viewer, { status, said, hash, signal }) {
  const { content } = source;
  let timer = null;
  let shown = 0;
  const hint = new Hint();
  let hovered = "";
  const describe = () => {
    hint.show(viewer.view.hints);
    status.textContent = [viewer.view.summary, hovered].filter(Boolean).join(" \u00b7 ");
  };
  const write = () => {
    if (viewer.view) describe();
    clearTimeout(timer);
    if (hash) timer = setTimeout(() => root.isConnected && writeHash(viewer.view, shown), HASH_DELAY);
  };
  let quiet = null;
  const say = (text) => {
    said.textContent = text;
    clearTimeout(quiet);
    quiet = setTimeout(() => (said.textContent = ""), 8000);
  };
  const options = { say, onChange: write };
  viewer.views = content.compare
    ? [new CompareView(content.items, source, { ...options, scores: content.scores })]
    : content.items.map((item, index) => viewOf(item, source, { ...options, index }));
  const main = element("main", {});
  const tools = element("aside", { "aria-label": "Controls" });
  const tabs = element("div", { class: "buttons tabs", role: "tablist", hidden: viewer.views.length < 2 });
  const choose = async (index) => {
    shown = index;
    const view = viewer.views[index];
    viewer.view = view;
    main.replaceChildren(view.main, hint.element);
    tools.replaceChildren(view.tools);
    for (const [i, tab] of [...tabs.children].entries()) tab.setAttribute("aria-selected", i === index);
    hovered = "";
    view.onHover ??= (text) => {
      hovered = text;
      describe();
    };
    view.stage.link.onLook = write;
    view.stage.link.onUse = (action) => {
      hint.finish(action);
      describe();
    };
    if (!view.begun) {
      view.begun = true;
      await view.load();
    }
    view.changed();
  };
  for (const [i, view] of viewer.views.entries())
    tabs.append(element("button", { type: "button", role: "tab", onclick: () => choose(i) }, view.item.name));
  const keys = element("dialog", { class: "keys", "aria-label": "Keys" },
    element("h2", {}, "Mouse and keys"),
    element("dl", {}, ...KEYS.flatMap(([key, what]) => [element("dt", {}, key), element("dd", {}, what)])),
    button("Close", () => keys.close()));
  const full = () => (document.fullscreenElement ? document.exitFullscreen() : root.requestFullscreen?.());
  const top = element("header", {},
    element("h1", {}, content.title),
    tabs,
    element("div", { class: "buttons" }, button("Keys", () => keys.showModal()), button("Full screen", full)));
  root.replaceChildren(top, main, tools, element("footer", {}, status, said), keys);
  const press = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || keys.open || !takesKey(event)) return;
    if (event.key === "f") full();
    else if (event.key === "?") keys.showModal();
    else viewer.view.stage.key(event);
  };
  // a page takes keys wherever its focus is, a widget only its own
  (hash ? document : root).addEventListener("keydown", press, { signal });
  const follow = () => {
    readHash(viewer.views);
    viewer.view.changed();
  };
  if (hash) window.addEventListener("hashchange", follow, { signal });
  await choose(hash ? readHash(viewer.views) : 0);
}

/** A line over the picture that explains actions until each was done once, in any page of this browser. */
class Hint {
  constructor() {
    this.finished = new Set(stored());
    this.element = element("p", { class: "hint", hidden: true });
  }

  /** Show the sentences of the actions that were not done yet: {action: sentence}. */
  show(hints) {
    const open = Object.entries(hints).filter(([action]) => !this.finished.has(action));
    this.element.hidden = open.length === 0;
    this.element.textContent = [...open.map(([, sentence]) => sentence), "Press ? for all keys."].join(" ");
  }

  finish(action) {
    this.finished.add(action);
    try {
      localStorage.setItem(HINTS_KEY, JSON.stringify([...this.finished]));
    } catch {
      // storage is disabled, or a frame without an address of its own
    }
  }
}

function stored() {
  try {
    const names = JSON.parse(localStorage.getItem(HINTS_KEY) ?? "[]");
    return Array.isArray(names) ? names : [];
  } catch {
    return [];
  }
}

/** True if a key is for the picture: not typed into a field, and not used by a control. */
function takesKey({ key, target }) {
  const control = target.closest?.("input, select, textarea, button");
  if (!control) return true;
  const isTyped = !/^(button|checkbox|radio|range)$/.test(control.type);
  return !isTyped && key.length === 1 && key !== " ";
}

/** Put the state of a view into the page's hash. */
function writeHash(view, index) {
  const words = new URLSearchParams();
  if (index) words.set("item", index);
  for (const [name, value] of Object.entries(view.state)) words.set(name, value);
  const { zoom, y, x } = view.stage.link;
  if (zoom !== 1) for (const [name, value] of Object.entries({ zoom, cy: y, cx: x })) words.set(name, Number(value.toFixed(5)));
  try {
    history.replaceState(null, "", `#${words}`);
  } catch {
    // a frame without an address of its own
  }
}

/** Take the state from the page's hash, as far as it fits; the number of the item. */
function readHash(views) {
  const words = new URLSearchParams(location.hash.slice(1));
  const index = Math.min(Math.max(Number(words.get("item")) || 0, 0), views.length - 1);
  const view = views[index];
  const state = { ...view.state };
  for (const [name, now] of Object.entries(state)) {
    const text = words.get(name);
    if (text === null) continue;
    if (typeof now === "boolean") state[name] = text === "true";
    else if (typeof now === "string") state[name] = text;
    else if (Number.isFinite(Number(text))) state[name] = Number(text);
  }
  view.take(state);
  const look = ["zoom", "cy", "cx"].map((name) => Number(words.get(name)));
  if (look[0] >= 1 && look.every(Number.isFinite)) Object.assign(view.stage.link, { zoom: look[0], y: look[1], x: look[2] });
  return index;
}

/** Mount what the page itself holds or its server has. */
export function start(root) {
  const holder = document.getElementById("clplen-content");
  if (!holder) {
    root.textContent = "This page is incomplete: it has no data. Download the file again.";
    return null;
  }
  try {
    const content = JSON.parse(holder.textContent);
    return mount(root, content.server ? new ServerSource(content) : new EmbeddedSource());
  } catch {
    root.textContent = "This page is incomplete: its data are truncated. Download the file again.";
    return null;
  }
}
