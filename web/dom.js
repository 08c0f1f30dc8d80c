// Builds elements. Text goes in as text nodes only, so nothing from the machine or a program is ever read as markup.

/**
 * @typedef {Node | string | null | undefined | false} Child
 * @typedef {Record<string, string | number | boolean | null | undefined | ((event: any) => void)>} Props
 */

/**
 * An HTML element. Props starting with `on` are event listeners, all others are attributes; false, null and
 * undefined leave the attribute out.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Props} [props]
 * @param {...Child} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function h(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(name, value === true ? "" : String(value));
    }
  }
  append(element, children);
  return element;
}

/** @param {Element} element @param {Child[]} children */
function append(element, children) {
  for (const child of children) if (child !== null && child !== undefined && child !== false) element.append(child);
}

/**
 * Replaces all children.
 * @param {Element} element
 * @param {...Child} children
 */
export function fill(element, ...children) {
  element.replaceChildren();
  append(element, children);
}

/**
 * Writes text where it differs, so that screen readers and selections are left alone.
 * @param {Element} element
 * @param {string} text
 */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * Sets or removes an attribute where it differs.
 * @param {Element} element
 * @param {string} name
 * @param {string | boolean | null} value
 */
export function setAttr(element, name, value) {
  const text = value === true ? "" : value;
  if (text === false || text === null) {
    if (element.hasAttribute(name)) element.removeAttribute(name);
  } else if (element.getAttribute(name) !== text) element.setAttribute(name, text);
}

/**
 * A card: a titled region of the screen. `tools` stand at the right of the title.
 * @param {string} name class and test name
 * @param {string} title
 * @param {Child[]} tools
 * @param {...Child} children
 */
export function card(name, title, tools, ...children) {
  const id = `title-${name}`;
  return h(
    "section",
    { class: `card ${name}`, "aria-labelledby": id },
    h("header", { class: "card-head" }, h("h2", { id }, title), h("div", { class: "card-tools" }, ...tools)),
    ...children,
  );
}
