// Elements of a page, each made by one call.

const SVG_NAMESPACE = new DOMParser().parseFromString("<svg></svg>", "text/html").querySelector("svg").namespaceURI;

function html(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

function svg(parent, tag, attributes = {}) {
  const element = document.createElementNS(SVG_NAMESPACE, tag);
  set(element, attributes);
  parent.append(element);
  return element;
}

function set(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
}

// Where the user prefers reduced motion, nothing moves before Play is pressed.
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

function scrolling() {
  return STILL.matches ? "auto" : "smooth";
}

const MODE_NAMES = { stick: "stick", slip_forward: "slip forward", slip_backward: "slip backward", flight: "flight" };

function modeKey(modes) {
  const key = html("p", { class: "key" });
  for (const mode of Object.keys(MODE_NAMES).filter((mode) => modes.includes(mode)))
    key.append(html("span", {}, html("span", { class: `swatch ${mode}` }), ` ${MODE_NAMES[mode]}`));
  return key;
}
