// Builds elements. Text becomes text nodes only, so nothing from the machine or a program is ever parsed as markup.

/**
 * @typedef {Node | string | null | undefined | false} Child
 * @typedef {Record<string, string | number | boolean | null | undefined | ((event: any) => void)>} Props
 */

/**
 * An HTML element. Functions are event listeners, with names such as `onclick`; all other props are attributes, left out
 * if false, null or undefined.
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

/**
 * A button, of class `button` unless the props have another one.
 * @param {Props} props
 * @param {...Child} children
 */
export function button(props, ...children) {
  return h("button", { type: "button", class: "button", ...props }, ...children);
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
 * Sets a text that has changed, so that screen readers and selections are not disturbed otherwise.
 * @param {Element} element
 * @param {string} text
 */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * Sets or removes an attribute that has changed.
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
 * A card: a region of the screen with a title. `tools` are at the right of the title.
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
