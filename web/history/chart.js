// The timeline as a picture: a lane for each coordinate system, a bar for each section, the time of day below.

import { clockTime } from "../text/format.js";
import { t } from "../text/language.js";
import { h } from "../ui/dom.js";
import { picture, shape, text } from "./svg.js";
import { describe } from "./timeline.js";

const LANE_PX = 46;
const BAR_PX = 34;
const AXIS_PX = 26;
/** Width of the names of the lanes. */
const NAMES_PX = 66;
/** Width of a letter in a bar, and smallest width of a bar with letters. */
const LETTER_PX = 8;
const LEAST_PX = 1.5;
/** Width of a time of day. */
const TIME_PX = 66;
/** Least distance of marks of the time axis. */
const MARK_PX = 90;
const WIDTH_MAX_PX = 200_000;
const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400];

/** @typedef {import("./timeline.js").Run} Run @typedef {import("./timeline.js").Span} Span */

export class Chart {
  #picture = picture("timeline-picture");
  #scroll = h("div", { class: "timeline-scroll", tabindex: 0, role: "group", "aria-label": t("timeline.timeline_left_and_right_choose") });
  element = this.#scroll;
  #zoom = 1;
  /** @type {Run[]} */
  #runs = [];
  /** @type {number[]} */
  #lanes = [];
  #from = 0;
  #to = 1;
  /** @type {Span | null} */
  #chosen = null;
  #choose;

  /** @param {(cs: number, span: Span) => void} choose called with the chosen section */
  constructor(choose) {
    this.#choose = choose;
    this.#scroll.append(this.#picture);
    this.#scroll.addEventListener("keydown", (event) => this.#key(event));
    this.#picture.addEventListener("click", (event) => {
      const [run, span] = (event.target instanceof Element ? event.target.getAttribute("data-at") : null)?.split(" ").map(Number) ?? [];
      const found = this.#runs[run ?? -1]?.spans[span ?? -1];
      if (found) this.choose(found);
    });
    new ResizeObserver(() => this.#draw()).observe(this.#scroll);
  }

  /** @param {Run[]} runs @param {number[]} lanes @param {number} from @param {number} to */
  show(runs, lanes, from, to) {
    const chosen = this.#chosen;
    this.#runs = runs;
    this.#lanes = lanes;
    this.#from = from;
    this.#to = Math.max(to, from + 100);
    this.#chosen = chosen && (runs.flatMap(({ spans }) => spans).find((span) => span.from === chosen.from && span.kind === chosen.kind) ?? null);
    this.#draw();
  }

  /** @param {number} factor */
  zoom(factor) {
    const { scrollLeft, clientWidth } = this.#scroll;
    const middle = (scrollLeft + clientWidth / 2 - NAMES_PX) / Math.max(1, this.#width());
    const most = WIDTH_MAX_PX / Math.max(1, clientWidth);
    this.#zoom = factor === 0 ? 1 : Math.min(Math.max(1, this.#zoom * factor), most);
    this.#draw();
    this.#scroll.scrollLeft = middle * this.#width() + NAMES_PX - clientWidth / 2;
  }

  /** Marks a span, reports it and scrolls it into view. @param {Span} span */
  choose(span) {
    this.#chosen = span;
    this.#draw();
    const run = this.#runs.find(({ spans }) => spans.includes(span));
    const at = this.#x(span.from);
    const { scrollLeft, clientWidth } = this.#scroll;
    if (at < scrollLeft + NAMES_PX || at > scrollLeft + clientWidth - 40) this.#scroll.scrollLeft = at - clientWidth / 2;
    if (run) this.#choose(run.cs, span);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const { key } = event;
    if (key === "+" || key === "-") this.zoom(key === "+" ? 1.6 : 1 / 1.6);
    else if (/^Arrow/.test(key)) this.#move(key);
    else return;
    event.preventDefault();
  }

  /** @param {string} key */
  #move(key) {
    const of = (/** @type {number | undefined} */ cs) => this.#runs.filter((run) => run.cs === cs).flatMap(({ spans }) => spans).filter(({ from, to }) => to > this.#from && from < this.#to);
    const now = this.#chosen;
    const cs = this.#runs.find(({ spans }) => now && spans.includes(now))?.cs ?? this.#lanes[0];
    const spans = of(cs);
    if (!now) return spans[0] && this.choose(spans[0]);
    const step = { ArrowRight: 1, ArrowLeft: -1, ArrowUp: 0, ArrowDown: 0 }[key] ?? 0;
    const lane = this.#lanes[this.#lanes.indexOf(cs ?? 0) + (key === "ArrowDown" ? 1 : -1)];
    const next = step ? spans[spans.indexOf(now) + step] : of(lane).reduce((best, span) => (!best || Math.abs(span.from - now.from) < Math.abs(best.from - now.from) ? span : best), /** @type {Span | undefined} */ (undefined));
    if (next) this.choose(next);
  }

  #width() {
    return Math.max(100, (this.#scroll.clientWidth - NAMES_PX - 10) * this.#zoom);
  }

  /** @param {number} time */
  #x(time) {
    return NAMES_PX + ((time - this.#from) / (this.#to - this.#from)) * this.#width();
  }

  #draw() {
    const height = this.#lanes.length * LANE_PX + AXIS_PX;
    const width = this.#width() + NAMES_PX + 10;
    this.#picture.setAttribute("width", String(width));
    this.#picture.setAttribute("height", String(height));
    const bars = this.#runs.flatMap((run, at) => run.spans.map((span, index) => this.#bar(run, span, `${at} ${index}`)));
    const names = this.#lanes.map((cs, at) => text(6, at * LANE_PX + 27, t("common.cs", { cs }), "timeline-name"));
    this.#picture.replaceChildren(...this.#axis(height), ...bars.flat(), ...names);
  }

  /** @param {Run} run @param {Span} span @param {string} at */
  #bar(run, span, at) {
    const lane = this.#lanes.indexOf(run.cs);
    if (lane < 0 || span.to <= this.#from || span.from >= this.#to) return [];
    const x = this.#x(Math.max(span.from, this.#from));
    const width = Math.max(LEAST_PX, this.#x(Math.min(span.to, this.#to)) - x);
    const y = lane * LANE_PX + (LANE_PX - BAR_PX) / 2;
    const rect = shape("rect", { x, y, width, height: BAR_PX, class: `span-${span.kind}`, "data-at": at });
    if (span === this.#chosen) rect.setAttribute("data-chosen", "");
    const title = shape("title", {});
    title.textContent = describe(span);
    rect.append(title);
    const label = span.kind === "moving" ? "" : span.says;
    const fits = label !== "" && width > label.length * LETTER_PX + 6;
    return fits ? [rect, text(x + 5, y + 22, label, "timeline-label")] : [rect];
  }

  /** @param {number} height */
  #axis(height) {
    const perPx = (this.#to - this.#from) / 1000 / this.#width();
    const step = STEPS_S.find((one) => one / perPx >= MARK_PX) ?? 14400;
    const marks = [];
    for (let s = Math.ceil(this.#from / 1000 / step) * step; s * 1000 <= this.#to; s += step) {
      const x = this.#x(s * 1000);
      marks.push(shape("line", { x1: x, x2: x, y1: 0, y2: height - AXIS_PX + 4, class: "timeline-mark" }));
      if (x + TIME_PX < this.#width() + NAMES_PX) marks.push(text(x + 3, height - 8, clock(s * 1000, step < 1), "timeline-time"));
    }
    return marks;
  }
}

/** @param {number} ms @param {boolean} isFine */
function clock(ms, isFine) {
  return clockTime(new Date(ms), isFine ? 1 : 0);
}
