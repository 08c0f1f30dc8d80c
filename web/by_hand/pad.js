// Jogging by keyboard and gamepad, while the operator has switched it on: arrows and Page Up and Down, or the left stick and
// the shoulder buttons. It switches itself off when the window loses the focus.

/** Deflection above which a stick jogs. */
const DEFLECTED = 0.6;

/** @type {Record<string, [number, 1 | -1]>} axis of the cross, and its direction */
const KEYS = {
  ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowUp: [1, 1], ArrowDown: [1, -1], PageUp: [2, 1], PageDown: [2, -1],
};
/** Buttons of the standard layout: the cross, and the shoulders. @type {[number, number, 1 | -1][]} */
const BUTTONS = [[15, 0, 1], [14, 0, -1], [12, 1, 1], [13, 1, -1], [5, 2, 1], [4, 2, -1]];

export class Pad {
  on = false;
  /** The held input: a key, or `pad`. */
  #held = "";

  /**
   * @param {import("../main.js").App} app
   * @param {(at: number, direction: 1 | -1) => void} begin of an axis of the cross
   */
  constructor(app, begin) {
    this.app = app;
    this.begin = begin;
    document.addEventListener("keydown", (event) => this.#down(event));
    document.addEventListener("keyup", (event) => {
      if (event.key === this.#held) this.#up();
    });
    addEventListener("blur", () => this.set(false));
  }

  /** @param {boolean} on */
  set(on) {
    if (on === this.on) return;
    this.on = on;
    if (on) this.#look();
    else this.#up();
    this.app.invalidate();
  }

  /** Names of the connected gamepads. */
  get names() {
    return pads().map((pad) => pad.id);
  }

  /** @param {KeyboardEvent} event */
  #down(event) {
    const way = KEYS[event.key];
    const typing = event.target instanceof Element && event.target.closest("input, textarea, select, [role=tablist], dialog");
    if (!this.on || !way || typing) return;
    event.preventDefault();
    if (event.repeat || this.#held !== "") return;
    this.#held = event.key;
    this.begin(...way);
  }

  #up() {
    if (this.#held === "") return;
    this.#held = "";
    this.app.jogger.release();
  }

  #look() {
    if (!this.on) return;
    const way = pads().map(deflection).find((one) => one !== null) ?? null;
    if (way && this.#held === "") {
      this.#held = "pad";
      this.begin(...way);
    } else if (!way && this.#held === "pad") this.#up();
    requestAnimationFrame(() => this.#look());
  }
}

function pads() {
  return (navigator.getGamepads?.() ?? []).filter((pad) => pad !== null);
}

/** Returns the axis of the cross to which a gamepad points. @param {Gamepad} pad @returns {[number, 1 | -1] | null} */
function deflection(pad) {
  for (const [at, axis, direction] of BUTTONS) if (pad.buttons[at]?.pressed) return [axis, direction];
  const [x = 0, y = 0] = pad.axes;
  if (Math.max(Math.abs(x), Math.abs(y)) < DEFLECTED) return null;
  return Math.abs(x) > Math.abs(y) ? [0, x > 0 ? 1 : -1] : [1, y > 0 ? -1 : 1];
}
