// Shared parts of the elements of `elements.js`: the machine that they show, and the time of drawing.

import { MACHINE_TOPICS, Model } from "../machine/model.js";
import { Tandem } from "../tandem.js";
import { language } from "../text/language.js";

/** Interval at which running times are shown, ms. */
const TICK_MS = 250;

/** @typedef {import("../machine/model.js").CoordinateSystem} CoordinateSystem */

/**
 * A machine that elements show.
 * @typedef {object} WatchedConnection
 * @property {Tandem} tandem
 * @property {Model} model
 * @property {Set<() => void>} shown drawn after each change
 */

/** By address. @type {Map<string, WatchedConnection>} */
const machines = new Map();

/**
 * Returns the machine at an address, shared by all its elements; the connection begins with the first element, or here.
 * @param {import("../tandem.js").Options} [options] only the options of the first caller are used
 * @returns {Tandem}
 */
export function machineAt(options = {}) {
  return watch(options).tandem;
}

/** @param {import("../tandem.js").Options} options @returns {WatchedConnection} */
function watch(options) {
  const url = options.url ?? location.origin;
  const known = machines.get(url);
  if (known) return known;
  const tandem = new Tandem({ ...options, url });
  const model = new Model();
  /** @type {Set<() => void>} */
  const shown = new Set();
  const draw = () => shown.forEach((one) => one());
  /** @type {Set<string>} */
  const topics = new Set();
  const subscribe = (/** @type {string[]} */ wanted) => {
    for (const topic of wanted) {
      if (!topics.has(topic)) tandem.on(topic, take);
      topics.add(topic);
    }
  };
  const take = (/** @type {any} */ message, /** @type {string} */ topic) => {
    model.apply(topic, message);
    if (topic === "birth") subscribe(model.topics());
    draw();
  };
  subscribe(MACHINE_TOPICS);
  tandem.onLink(({ online }) => {
    model.online = online;
    if (!online) model.disconnected();
    draw();
  });
  setInterval(draw, TICK_MS);
  const watched = { tandem: tandem.connect(), model, shown };
  machines.set(url, watched);
  return watched;
}

/** An element that shows a coordinate system: `cs`, without it the first one; of the machine at `url`, without it this server. */
export class TandemElement extends HTMLElement {
  static observedAttributes = ["cs"];
  root = this.attachShadow({ mode: "open" });
  /** @type {WatchedConnection | null} */
  #watched = null;
  #frame = 0;
  #draw = () => {
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0;
      const { system } = this;
      this.toggleAttribute("online", this.model.online);
      this.toggleAttribute("stale", this.model.staleMs > 0);
      if (system) this.render(system);
    });
  };

  /** @param {...string} styles */
  constructor(...styles) {
    super();
    this.root.adoptedStyleSheets = [COMMON, ...styles].map((text) => {
      const sheet = new CSSStyleSheet();
      sheet.replaceSync(text);
      return sheet;
    });
  }

  connectedCallback() {
    this.#watched ??= watch({ url: this.getAttribute("url") ?? undefined });
    this.#watched.shown.add(this.#draw);
    if (this.lang === "") this.lang = language;
    this.#draw();
  }

  disconnectedCallback() {
    this.#watched?.shown.delete(this.#draw);
    cancelAnimationFrame(this.#frame);
    this.#frame = 0;
  }

  attributeChangedCallback() {
    if (this.#watched) this.#draw();
  }

  /** The machine. */
  get tandem() {
    return this.#of.tandem;
  }

  /** The known data of the machine. */
  get model() {
    return this.#of.model;
  }

  /** Number of the coordinate system; 0 until one is known. */
  get cs() {
    return Number(this.getAttribute("cs")) || (this.system?.info.number ?? 0);
  }

  /** The coordinate system, once it is known. @returns {CoordinateSystem | null} */
  get system() {
    const { systems } = this.model;
    const written = Number(this.getAttribute("cs"));
    return (written ? systems.get(written) : [...systems.values()][0]) ?? null;
  }

  /** Shows the current data. @param {CoordinateSystem} _system */
  render(_system) {}

  /** Draws the element in the next frame. */
  redraw() {
    this.#draw();
  }

  /** Reports a refusal by the event `tandem-refused` with its text. @param {() => Promise<unknown>} work */
  async attempt(work) {
    try {
      await work();
    } catch (error) {
      const detail = error instanceof Error ? error.message : String(error);
      this.dispatchEvent(new CustomEvent("tandem-refused", { detail, bubbles: true, composed: true }));
    }
  }

  get #of() {
    if (!this.#watched) throw new TypeError(`<${this.localName}> is in no page yet`);
    return this.#watched;
  }
}

/** Colours: those of the HMI, as custom properties that a page may set. */
const COMMON = `
:host { display: block; color-scheme: light dark; font: 16px/1.4 system-ui, sans-serif; color: var(--text);
  --text: #14202b; --muted: #566472; --card: #ffffff; --line: #d3dae1; --accent: #0b62b8; --on-accent: #ffffff; --grid: #e4e9ee; --grid-axis: #b4c0cb; --rapid: #8796a5; --tool: #c2410c;
  --ready: #50606f; --active: #137a43; --wait: #0b62b8; --attention: #9a5b00; --alarm: #b8232f; --done: #0c7580; --ended: #7a3596; }
@media (prefers-color-scheme: dark) { :host {
  --text: #e7edf3; --muted: #97a5b3; --card: #161d25; --line: #2f3a45; --accent: #62acf7; --on-accent: #08131f; --grid: #212b35; --grid-axis: #3f4d5a; --rapid: #7b8a99; --tool: #ff9a62;
  --ready: #9fb0bf; --active: #4ecb88; --wait: #62acf7; --attention: #f0b04c; --alarm: #ff7b83; --done: #4fc3cf; --ended: #cf95e8; } }
:host([hidden]) { display: none; }
:host(:is(:not([online]), [stale])) { filter: grayscale(1); opacity: 0.7; }
* { box-sizing: border-box; }
.muted { color: var(--muted); font-size: 0.85em; }
button { font: inherit; color: var(--text); background: var(--card); border: 1px solid var(--grid-axis); border-radius: 8px; min-height: 44px; min-width: 44px; padding: 0.4em 1em; cursor: pointer; }
button:focus-visible { outline: 3px solid var(--accent); outline-offset: 2px; }
`;
