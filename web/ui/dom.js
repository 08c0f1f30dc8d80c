// Builds elements. Text becomes text nodes only, so nothing from the machine or a program is ever parsed as markup.

/**
 * @typedef {Node | string | null | undefined | false} Child
 * @typedef {Record<string, string | number | boolean | null | undefined | ((event: any) => void)>} Props
 */

/**
 * An HTML element. Functions are event listeners, with names such as `onclick`; all other props are attributes, left out
 * if false, null or undefined. While a promise of `onclick` is not settled, the element is shown as pending.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Props} [props]
 * @param {...Child} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function h(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (name === "onclick" && typeof value === "function") element.addEventListener("click", (event) => showPending(element, value(event)));
    else if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(name, value === true ? "" : String(value));
    }
  }
  append(element, children);
  return element;
}

/** Shows an element as pending until a promise is settled. @param {HTMLElement} element @param {unknown} work */
export function showPending(element, work) {
  if (!(work instanceof Promise)) return;
  setAttr(element, "data-pending", true);
  setAttr(element, "aria-busy", "true");
  const end = () => {
    setAttr(element, "data-pending", null);
    setAttr(element, "aria-busy", null);
  };
  void work.then(end, end);
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
  remove(() => element.replaceChildren());
  append(element, children);
}

let isRemoving = false;

/** @param {() => void} work */
function remove(work) {
  isRemoving = true;
  try {
    work();
  } finally {
    isRemoving = false;
  }
}

/** True while elements are removed: a change event of a field is then not caused by a person. */
export function isRemoved() {
  return isRemoving;
}

/**
 * Sets the children of an element. Children that keep their order are not touched, so that focus and typed text remain.
 * @param {Element} element @param {...Element} children
 */
export function arrange(element, ...children) {
  const wanted = new Set(children);
  const others = [...element.children].filter((child) => !wanted.has(child));
  remove(() => others.forEach((child) => child.remove()));
  for (const [at, child] of children.entries()) if (element.children[at] !== child) element.insertBefore(child, element.children[at] ?? null);
}

/**
 * Sets a text only if it differs, so that screen readers and selections are not disturbed.
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
