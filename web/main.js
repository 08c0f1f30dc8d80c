// Builds the screen: the connection feeds the model, and each view shows the model at most once per frame.

import { signedIn } from "./access/token.js";
import { reportWhyNot } from "./access/why_not.js";
import { Alerts } from "./app/alerts.js";
import { startWorker } from "./app/install.js";
import { listenToKeys } from "./app/shortcuts.js";
import { startTheme } from "./app/theme.js";
import { startTouch } from "./app/touch.js";
import { Jogger } from "./by_hand/jog.js";
import { api, Refusal } from "./machine/api.js";
import { machine } from "./machine/machine.js";
import { MACHINE_TOPICS, Model } from "./machine/model.js";
import { stateWord } from "./machine/sentence.js";
import { language, t } from "./text/language.js";
import { confirm } from "./ui/confirm.js";
import { fill, h, setAttr, setText } from "./ui/dom.js";
import { Panels } from "./ui/panels.js";
import { Toasts } from "./ui/toasts.js";
import { views } from "./views/index.js";

/**
 * Interface for views.
 * @typedef {object} App
 * @property {Model} model
 * @property {typeof api} api
 * @property {typeof confirm} confirm
 * @property {(text: string, tone?: "info" | "error", kind?: string) => void} toast replaces a notice of the same kind
 * @property {(work: () => Promise<unknown>) => Promise<boolean>} attempt runs the work; shows a refusal, and then returns false
 * @property {(command: (onAccepted: () => void) => Promise<unknown>) => Promise<void>} accepted attempts a command, and waits until it is accepted or refused
 * @property {(verb: import("./types.d.ts").Verb, args?: object) => Promise<void>} command commands the selected coordinate system, until it is accepted or refused
 * @property {(verb: import("./types.d.ts").Verb, args: object, onAccepted: () => void) => Promise<void>} commandAsSeen commands the selected coordinate system only if its state is the one on the screen
 * @property {(verb: "start" | "resume") => Promise<void>} go begins or resumes a run, only if the state is the one on
 * the screen
 * @property {(cs: number, program: number) => Promise<void>} load
 * @property {Jogger} jogger
 * @property {Alerts} alerts
 * @property {(cs: number) => void} select
 * @property {(panel: string) => void} open shows a panel at the right
 * @property {() => Promise<void>} readPrograms
 * @property {() => void} retry tries to connect without waiting
 * @property {() => void} invalidate renders everything in the next frame
 */

/**
 * A view: one file, with its import and its entry in views/index.js.
 * @typedef {object} View
 * @property {"header" | "banner" | "now" | "left" | "middle" | "right" | "footer" | "far"} place
 * @property {{name: string, title: string}} [panel] of a view at the right
 * @property {(app: App) => {element: HTMLElement, render: () => void, isThere?: () => boolean}} create without `isThere` the panel is always shown
 */

/** Interval at which running times are shown, ms. */
const TICK_MS = 250;

/** Refusal text of a command that was meant for another state. */
const MOVED_ON = t("main.the_state_has_changed_since");

const model = new Model();
const toasts = new Toasts();
let framePending = false;

/** @type {App} */
const app = {
  model,
  api,
  confirm,
  toast: (text, tone, kind) => toasts.show(text, tone, kind),
  async attempt(work) {
    try {
      await work();
      return true;
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      toasts.show(error.message, "error");
      return false;
    }
  },
  accepted(command) {
    return new Promise((resolve) => {
      void app.attempt(() => command(resolve)).finally(() => resolve());
    });
  },
  command(verb, args) {
    const cs = model.selected;
    return app.accepted((onAccepted) => api.command(cs, verb, args, {}, onAccepted));
  },
  async commandAsSeen(verb, args, onAccepted) {
    const { selected: cs, bootId: boot_id } = model;
    const state_rev = model.current?.state?.rev;
    try {
      await api.command(cs, verb, args, { boot_id, state_rev }, onAccepted);
    } catch (error) {
      if (error instanceof Refusal && error.problem.code === "precondition_failed") throw new Refusal(MOVED_ON, error.problem);
      throw error;
    }
  },
  go(verb) {
    return app.accepted((onAccepted) => app.commandAsSeen(verb, {}, onAccepted));
  },
  async load(cs, program) {
    const { text = "", hash = null } = await api.command(cs, "load", { program });
    const system = model.systems.get(cs);
    if (system) system.note = { hash, text };
    invalidate();
  },
  select(cs) {
    model.selected = cs;
    invalidate();
  },
  open(panel) {
    model.panel = panel;
    invalidate();
  },
  async readPrograms() {
    await app.attempt(async () => {
      model.programs = await api.programs();
    });
    invalidate();
  },
  retry: () => machine.retryNow(),
  invalidate,
  // these need the other members
  jogger: /** @type {any} */ (null),
  alerts: /** @type {any} */ (null),
};
app.jogger = new Jogger(app);
app.alerts = new Alerts(app);

/** Topics that are subscribed. @type {Set<string>} */
const watched = new Set();

/** @param {string[]} topics */
function watch(topics) {
  for (const topic of topics) {
    if (watched.has(topic)) continue;
    watched.add(topic);
    machine.on(topic, applyMessage);
  }
}

/** @param {any} message @param {string} topic */
function applyMessage(message, topic) {
  if (model.apply(topic, message)) {
    toasts.show(t("main.the_runtime_was_started_again"));
  }
  if (topic === "birth") {
    watch(model.topics());
    void app.readPrograms();
    void readUser();
    for (const system of model.systems.values()) void readLastRun(system);
  }
  invalidate();
}

machine.onRefused((text) => toasts.show(text, "error"));
machine.onLink(({ online, retryAt }) => {
  if (!online) model.disconnected();
  model.online = online;
  model.retryAt = retryAt;
  invalidate();
});

/** @param {import("./machine/model.js").CoordinateSystem} system */
async function readLastRun(system) {
  await app.attempt(async () => {
    system.lastRun = await api.lastRun(system.info.number);
  });
  invalidate();
}

async function readUser() {
  await app.attempt(async () => {
    model.user = await api.user();
  });
  invalidate();
}

function build() {
  /** @type {Record<string, HTMLElement>} */
  const places = {
    header: h("header", { class: "place-header" }),
    banner: h("div", { class: "place-banner" }),
    now: h("div", { class: "place-now" }),
    left: h("div", { class: "place-left" }),
    middle: h("div", { class: "place-middle" }),
    right: h("div", { class: "place-right" }),
    footer: h("footer", { class: "place-footer" }),
    far: h("div", { class: "place-far" }),
  };
  const panels = new Panels(app);
  places.right?.append(panels.element);
  const shown = views.map((view) => {
    const made = view.create(app);
    if (view.panel) panels.add(view.panel, made);
    else places[view.place]?.append(made.element);
    return made;
  });
  const screen = h("div", { id: "panel", class: "screen", role: "tabpanel" }, places.now, places.left, places.middle, places.right);
  const heading = h("h1", { class: "visually-hidden" });
  const main = h("main", {}, heading, screen, places.far);
  fill(document.body, places.header, places.banner, main, places.footer, toasts.element);
  measure(places);
  return { shown: [...shown, panels], screen, heading };
}

/**
 * Passes the heights of the state above and the commands below, which stay in view, to the style sheet: dialogs leave the
 * commands free, and elements that get the focus are scrolled between both. On a phone the footer has no box of its own, and
 * only the commands stay in view.
 * @param {Record<string, HTMLElement>} places
 */
function measure({ banner, footer }) {
  const commands = /** @type {HTMLElement | null | undefined} */ (footer?.querySelector(".commands"));
  if (!banner || !footer || !commands) return;
  const { style } = document.documentElement;
  const observer = new ResizeObserver(() => {
    style.setProperty("--banner-height", `${banner.offsetHeight}px`);
    style.setProperty("--bar-height", `${footer.offsetHeight || commands.offsetHeight}px`);
  });
  for (const one of [banner, footer, commands]) observer.observe(one);
}

const { shown, screen, heading } = build();

function render() {
  framePending = false;
  setAttr(document.body, "data-online", String(model.online));
  setAttr(document.body, "data-stale", model.staleMs > 0);
  setAttr(document.body, "data-far", model.far);
  setAttr(screen, "aria-labelledby", `tab-${model.selected}`);
  setText(heading, t("main.machine", { machine: model.birth?.machine ?? "" }).trim());
  app.jogger.render();
  app.alerts.render();
  const state = model.current?.state;
  document.title = `${model.birth?.machine ?? "Tandem"} – ${state ? stateWord(state.execution) : t("main.not_connected")}`;
  for (const view of shown) {
    try {
      view.render();
    } catch (error) {
      console.error(error);
    }
  }
}

function invalidate() {
  if (framePending) return;
  framePending = true;
  requestAnimationFrame(render);
}

document.documentElement.lang = language;
startTheme(invalidate);
startTouch();
startWorker();
listenToKeys(app);
reportWhyNot((text) => toasts.show(text));
setInterval(invalidate, TICK_MS);
await signedIn();
watch(MACHINE_TOPICS);
machine.connect();
