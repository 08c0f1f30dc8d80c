// The recent path in the plane of the first two axes, drawn live, with equal scales.

import { button, card, h, setText } from "../dom.js";
import { position } from "../format.js";
import { icon } from "../icons.js";

/** Smallest range shown, mm. */
const SPAN_MIN_MM = 20;
/** Margin around the path, as a fraction of its size. */
const MARGIN = 0.1;
/** Smallest distance between grid lines, px. */
const GRID_MIN_PX = 56;

/** @typedef {{x0: number, x1: number, y0: number, y1: number}} Box */
/** @typedef {{scale: number, x: (mm: number) => number, y: (mm: number) => number, width: number, height: number, box: Box}} View */

/** @type {import("../main.js").View} */
export const path = {
  place: "middle",
  create(app) {
    const canvas = h("canvas", { role: "img" });
    const where = h("span", { class: "muted" });
    const onclick = () => {
      app.model.current?.trail.clear();
      fitted = null;
      app.invalidate();
    };
    const clear = button({ class: "button small", onclick }, icon("trash"), "Clear");
    const legend = h(
      "span",
      { class: "legend", "aria-hidden": "true" },
      h("i", { class: "feed-line" }), "feed", h("i", { class: "rapid-line" }), "rapid",
    );
    /** @type {Box | null} */
    let fitted = null;
    let drawn = "";
    const box = h("div", { class: "canvas-box" }, canvas);
    new ResizeObserver(() => {
      drawn = "";
      app.invalidate();
    }).observe(box);

    const render = () => {
      const system = app.model.current;
      const context = canvas.getContext("2d");
      if (!system || !context) return;
      const [h1, v1] = planeOf(system, app.model.birth?.motors ?? []);
      const at = system.position?.machine;
      const key = [system.info.number, system.trail.revision, box.clientWidth, box.clientHeight, devicePixelRatio, document.documentElement.dataset.theme, at?.[h1], at?.[v1], system.position?.work[h1]].join();
      if (key === drawn) return;
      if (drawn.split(",")[0] !== String(system.info.number)) fitted = null;
      drawn = key;
      setText(where, `${h1} ${v1}, machine`);
      fitted = fit(fitted, bounds(system, h1, v1));
      const view = layout(canvas, context, box, fitted);
      const colours = palette(canvas);
      drawGrid(context, view, colours, h1, v1);
      drawTrail(context, view, colours, system, h1, v1);
      drawOrigin(context, view, colours, system, h1, v1);
      if (at) drawTool(context, view, colours, at[h1] ?? 0, at[v1] ?? 0);
      canvas.setAttribute("aria-label", `Path of the tool; now at ${h1} ${position(at?.[h1])}, ${v1} ${position(at?.[v1])}`);
    };
    return { element: card("path-card", "Path", [where, legend, clear], box), render };
  },
};

/**
 * X and Y, or the first two axes there are.
 * @param {import("../model.js").CoordinateSystem} system
 * @param {import("../types.d.ts").MotorInfo[]} motors
 * @returns {[string, string]}
 */
function planeOf({ info }, motors) {
  const linear = Object.keys(info.axes).filter((a) => motors.find((m) => m.number === info.axes[a])?.kind !== "rotary");
  const letters = linear.length >= 2 ? linear.sort() : Object.keys(info.axes).sort();
  if (letters.includes("X") && letters.includes("Y")) return ["X", "Y"];
  return [letters[0] ?? "X", letters[1] ?? "Y"];
}

/** @param {import("../model.js").CoordinateSystem} system @param {string} h1 @param {string} v1 @returns {Box} */
function bounds(system, h1, v1) {
  const box = { x0: Infinity, x1: -Infinity, y0: Infinity, y1: -Infinity };
  const take = (/** @type {number} */ x, /** @type {number} */ y) => {
    box.x0 = Math.min(box.x0, x);
    box.x1 = Math.max(box.x1, x);
    box.y0 = Math.min(box.y0, y);
    box.y1 = Math.max(box.y1, y);
  };
  for (const { at } of system.trail.points) take(at[h1] ?? 0, at[v1] ?? 0);
  const now = system.position?.machine;
  take(now?.[h1] ?? 0, now?.[v1] ?? 0);
  return box;
}

/**
 * The box to show: as before while the path fits in well, so that the picture does not creep.
 * @param {Box | null} before
 * @param {Box} needed
 * @returns {Box}
 */
function fit(before, needed) {
  const span = Math.max(needed.x1 - needed.x0, needed.y1 - needed.y0, SPAN_MIN_MM);
  if (before) {
    const inside = needed.x0 >= before.x0 && needed.x1 <= before.x1 && needed.y0 >= before.y0 && needed.y1 <= before.y1;
    const size = Math.max(before.x1 - before.x0, before.y1 - before.y0);
    if (inside && size < 3 * span) return before;
  }
  const grow = (/** @type {number} */ low, /** @type {number} */ high) => {
    const room = Math.max(MARGIN * span, (SPAN_MIN_MM - (high - low)) / 4);
    return [low - room, high + room];
  };
  const [x0 = 0, x1 = 0] = grow(needed.x0, needed.x1);
  const [y0 = 0, y1 = 0] = grow(needed.y0, needed.y1);
  return { x0, x1, y0, y1 };
}

/**
 * Sizes the canvas to the screen's pixels and places the box in its middle.
 * @param {HTMLCanvasElement} canvas
 * @param {CanvasRenderingContext2D} context
 * @param {HTMLElement} room
 * @param {Box} box
 * @returns {View}
 */
function layout(canvas, context, room, box) {
  const ratio = devicePixelRatio || 1;
  const width = Math.max(room.clientWidth, 1);
  const height = Math.max(room.clientHeight, 1);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const scale = Math.min(width / (box.x1 - box.x0), height / (box.y1 - box.y0));
  const midX = (box.x0 + box.x1) / 2;
  const midY = (box.y0 + box.y1) / 2;
  const x = (/** @type {number} */ mm) => width / 2 + (mm - midX) * scale;
  const y = (/** @type {number} */ mm) => height / 2 - (mm - midY) * scale;
  const half = { w: width / 2 / scale, h: height / 2 / scale };
  return { scale, x, y, width, height, box: { x0: midX - half.w, x1: midX + half.w, y0: midY - half.h, y1: midY + half.h } };
}

/** Colours of the current scheme. @param {Element} element */
function palette(element) {
  const style = getComputedStyle(element);
  const of = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
  return { grid: of("--grid"), axis: of("--grid-axis"), text: of("--muted"), feed: of("--accent"), rapid: of("--rapid"), tool: of("--tool"), font: style.fontFamily };
}

/** @typedef {ReturnType<typeof palette>} Palette */

/** 1, 2 or 5 times a power of ten, so that lines are at least GRID_MIN_PX apart. @param {number} scale */
function gridStep(scale) {
  const least = GRID_MIN_PX / scale;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * ([1, 2, 5, 10].find((n) => n * power >= least) ?? 10);
}

/** @param {CanvasRenderingContext2D} c @param {View} view @param {Palette} colours @param {string} h1 @param {string} v1 */
function drawGrid(c, view, colours, h1, v1) {
  const step = gridStep(view.scale);
  const decimals = Math.max(0, -Math.floor(Math.log10(step)));
  const label = (/** @type {number} */ n) => (n * step + 0).toFixed(decimals);
  c.lineWidth = 1;
  c.font = `11px ${colours.font}`;
  c.fillStyle = colours.text;
  const line = (/** @type {number} */ n, /** @type {number} */ xa, /** @type {number} */ ya, /** @type {number} */ xb, /** @type {number} */ yb) => {
    c.strokeStyle = n === 0 ? colours.axis : colours.grid;
    c.beginPath();
    c.moveTo(xa, ya);
    c.lineTo(xb, yb);
    c.stroke();
  };
  c.textAlign = "center";
  c.textBaseline = "bottom";
  for (let n = Math.ceil(view.box.x0 / step); n * step <= view.box.x1; n += 1) {
    const x = Math.round(view.x(n * step)) + 0.5;
    line(n, x, 0, x, view.height);
    if (x > 44 && x < view.width - 60) c.fillText(label(n), x, view.height - 4);
  }
  c.textAlign = "left";
  c.textBaseline = "middle";
  for (let n = Math.ceil(view.box.y0 / step); n * step <= view.box.y1; n += 1) {
    const y = Math.round(view.y(n * step)) + 0.5;
    line(n, 0, y, view.width, y);
    if (y > 32 && y < view.height - 24) c.fillText(label(n), 5, y - 7);
  }
  c.textBaseline = "bottom";
  c.textAlign = "right";
  c.fillText(`${h1} mm`, view.width - 6, view.height - 4);
  c.textAlign = "left";
  c.textBaseline = "top";
  c.fillText(`${v1} mm`, 5, 5);
}

/** @param {CanvasRenderingContext2D} c @param {View} view @param {Palette} colours @param {import("../model.js").CoordinateSystem} system @param {string} h1 @param {string} v1 */
function drawTrail(c, view, colours, system, h1, v1) {
  const { points } = system.trail;
  c.lineJoin = "round";
  for (const rapid of [true, false]) {
    c.strokeStyle = rapid ? colours.rapid : colours.feed;
    c.lineWidth = rapid ? 1 : 2;
    c.setLineDash(rapid ? [5, 4] : []);
    c.beginPath();
    let down = false;
    for (let i = 1; i < points.length; i += 1) {
      const from = points[i - 1];
      const to = points[i];
      if (!from || !to) continue;
      if (to.rapid !== rapid) {
        down = false;
        continue;
      }
      if (!down) c.moveTo(view.x(from.at[h1] ?? 0), view.y(from.at[v1] ?? 0));
      c.lineTo(view.x(to.at[h1] ?? 0), view.y(to.at[v1] ?? 0));
      down = true;
    }
    c.stroke();
  }
  c.setLineDash([]);
}

/** The origin of work coordinates: a small corner sign. @param {CanvasRenderingContext2D} c @param {View} view @param {Palette} colours @param {import("../model.js").CoordinateSystem} system @param {string} h1 @param {string} v1 */
function drawOrigin(c, view, colours, { position: now, modal }, h1, v1) {
  if (!now) return;
  const x = view.x((now.machine[h1] ?? 0) - (now.work[h1] ?? 0));
  const y = view.y((now.machine[v1] ?? 0) - (now.work[v1] ?? 0));
  c.strokeStyle = colours.text;
  c.lineWidth = 1.5;
  c.beginPath();
  c.arc(x, y, 4, 0, 2 * Math.PI);
  c.moveTo(x, y);
  c.lineTo(x + 16, y);
  c.moveTo(x, y);
  c.lineTo(x, y - 16);
  c.stroke();
  c.fillStyle = colours.text;
  c.textAlign = "left";
  c.textBaseline = "bottom";
  c.fillText(modal?.work_offset ?? "0", x + 6, y - 4);
}

/** @param {CanvasRenderingContext2D} c @param {View} view @param {Palette} colours @param {number} h1 @param {number} v1 */
function drawTool(c, view, colours, h1, v1) {
  const x = view.x(h1);
  const y = view.y(v1);
  c.strokeStyle = colours.tool;
  c.lineWidth = 2;
  c.beginPath();
  c.moveTo(x - 11, y);
  c.lineTo(x + 11, y);
  c.moveTo(x, y - 11);
  c.lineTo(x, y + 11);
  c.moveTo(x + 6, y);
  c.arc(x, y, 6, 0, 2 * Math.PI);
  c.stroke();
}
