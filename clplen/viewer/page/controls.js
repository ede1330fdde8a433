/** Parts of a page: elements, sliders, fields, buttons. Text is inserted as text, never as markup. */

let counter = 0;

/** Create an element with attributes, listeners ("onclick") and children. */
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null) made.setAttribute(key, value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** Create a labelled slider with a number field. */
export function slider({ label, min, max, step, unit = "", title = null, onInput }) {
  const id = `clplen-${++counter}`;
  const range = element("input", { type: "range", id, min, max, step, title });
  const field = element("input", { type: "number", "aria-label": `${label}${unit && `, ${unit}`}`, step: "any" });
  const say = (text) => text !== "" && Number.isFinite(Number(text)) && onInput(Number(text));
  range.addEventListener("input", () => say(range.value));
  field.addEventListener("change", () => say(field.value));
  const row = element("div", { class: "row" }, range, field);
  const made = element("div", { class: "control" }, element("label", { for: id }, unit ? `${label} (${unit})` : label), row);
  return {
    element: made,
    range,
    set(value, text = String(value)) {
      if (document.activeElement !== range || Number(range.value) !== value) range.value = value;
      range.setAttribute("aria-valuetext", text);
      if (document.activeElement !== field) field.value = text;
    },
    show: (visible) => (made.hidden = !visible),
    disable: (disabled) => (range.disabled = field.disabled = disabled),
  };
}

/** Create a labelled number field. */
export function numberField({ label, onInput }) {
  const id = `clplen-${++counter}`;
  const field = element("input", { type: "number", id, step: "any" });
  field.addEventListener("change", () => field.value !== "" && onInput(Number(field.value)));
  return {
    element: element("div", { class: "control inline" }, element("label", { for: id }, label), field),
    set(text) {
      if (document.activeElement !== field) field.value = text;
    },
  };
}

/** Create radio buttons from {value: label}. */
export function choice({ label, options, onInput }) {
  const name = `clplen-${++counter}`;
  const inputs = {};
  const parts = Object.entries(options).map(([value, text]) => {
    inputs[value] = element("input", { type: "radio", name, value, onchange: () => onInput(value) });
    return element("label", {}, inputs[value], element("span", {}, text));
  });
  const made = element("fieldset", { class: "choice" }, element("legend", {}, label), element("div", { class: "segments" }, ...parts));
  return {
    element: made,
    set(value) {
      if (inputs[value]) inputs[value].checked = true;
    },
  };
}

/** Create a labelled drop-down list from {value: label}. */
export function select({ label, options, onInput }) {
  const id = `clplen-${++counter}`;
  const made = element(
    "select",
    { id, onchange: () => onInput(made.value) },
    ...Object.entries(options).map(([value, text]) => element("option", { value }, text)),
  );
  return {
    element: element("div", { class: "control inline" }, element("label", { for: id }, label), made),
    set: (value) => (made.value = value),
  };
}

/** Create a check box. */
export function checkbox({ label, title = null, onInput }) {
  const box = element("input", { type: "checkbox", onchange: () => onInput(box.checked) });
  const made = element("label", { class: "check", title }, box, label);
  return {
    element: made,
    set: (on) => (box.checked = on),
    disable: (disabled) => {
      box.disabled = disabled;
      made.title = disabled ? (title ?? "") : "";
    },
  };
}

export function button(label, onclick, title = null) {
  return element("button", { type: "button", onclick, title }, label);
}

/** Group controls under a heading. */
export function group(title, ...children) {
  return element("section", { class: "group" }, element("h2", {}, title), ...children);
}

/** Format a number with significant digits, without trailing zeros. */
export function digits(value, count = 4) {
  return Number.isFinite(value) ? String(Number(value.toPrecision(count))) : "";
}

/** Format a length in metres with the unit that gives a number from 1 to 999. */
export function metres(value, count = 3) {
  if (!Number.isFinite(value)) return "";
  const units = [[1, "m"], [1e-3, "mm"], [1e-6, "\u00b5m"], [1e-9, "nm"]];
  const [size, unit] = units.find(([least]) => Math.abs(value) >= least) ?? (value ? units[3] : units[1]);
  return `${digits(value / size, count)} ${unit}`;
}

/** Copy text to the clipboard. */
export async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const area = element("textarea", { class: "hidden" }, text);
    document.body.append(area);
    area.select();
    document.execCommand("copy"); // pages of file:// may have no clipboard
    area.remove();
  }
}

/** Save a canvas as PNG. */
export function savePicture(canvas, name) {
  canvas.toBlob((blob) => {
    const link = element("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  });
}
