// Elements of pictures: lines, boxes, texts.

const SVG = "http://www.w3.org/2000/svg";

/**
 * @param {string} tag
 * @param {Record<string, string | number>} attributes
 * @param {...Element} children
 */
export function shape(tag, attributes, ...children) {
  const element = /** @type {SVGElement} */ (document.createElementNS(SVG, tag));
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
}

/** @param {number} x @param {number} y @param {string} says @param {string} name its class */
export function text(x, y, says, name) {
  const element = shape("text", { x, y, class: name });
  element.textContent = says;
  return element;
}

/** Returns a picture whose content is also in a table next to it. @param {string} name its class */
export function picture(name) {
  return shape("svg", { class: name, "aria-hidden": "true" });
}
