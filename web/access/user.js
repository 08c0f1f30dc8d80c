// The logged-in user and role at this screen; log-out, and the view mode.

import { chooseLarge, isLarge } from "../app/touch.js";
import { chooseLanguage, chosenLanguage, LANGUAGES, listed, t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";
import { forgetToken } from "./token.js";
import { disableFor } from "./why_not.js";

/** Interval of activity reports to the machine, which ends an unused login, ms. */
const ACTIVITY_INTERVAL_MS = 60_000;

/** Reports to the machine that a person uses this screen. @param {import("../main.js").App} app */
function reportActivity(app) {
  let reported = performance.now();
  const report = () => {
    if (!app.model.user?.is_login || performance.now() - reported < ACTIVITY_INTERVAL_MS) return;
    reported = performance.now();
    // the next request detects a login that has ended
    app.api.user().catch(() => {});
  };
  for (const kind of ["pointerdown", "keydown"]) document.addEventListener(kind, report, { capture: true });
}

/** @param {import("../main.js").App} app */
export function userButton(app) {
  reportActivity(app);
  const name = h("span", { class: "user-name" });
  const element = button({ class: "user", onclick: () => showUser(app) }, icon("user"), name);
  const render = () => {
    const { user, viewing } = app.model;
    const role = viewing ? t("user.view_mode") : (user?.role ?? "");
    setText(name, listed([user?.user, (user?.user || viewing) && role]));
    setAttr(element, "aria-label", user?.user ? t("user.logged_in", { user: user.user, role }) : listed([t("user.no_login"), viewing && role]));
  };
  return { element, render };
}

/** @param {import("../main.js").App} app */
function showUser(app) {
  const { user, viewing } = app.model;
  const says = user?.user
    ? t("user.who", { user: user.user, role: user.role })
    : t("user.this_machine_asks_nobody_who");
  const view = button({ "aria-pressed": String(viewing), onclick: () => {
    app.model.viewing = !viewing;
    app.invalidate();
    dialog.close();
  } }, viewing ? t("user.leave_view_mode") : t("user.enter_view_mode"));
  const leave = button({ onclick: () => void logOut(app) }, t("user.log_out"));
  const close = button({ autofocus: true, onclick: () => dialog.close() }, t("common.close"));
  const dialog = openDialog("user-dialog", t("user.user"), [
    h("p", {}, says),
    h("p", { class: "muted" }, t("user.in_view_mode_this_screen")),
    h("h3", {}, t("user.this_screen")),
    ...settings(app),
    h("div", { class: "row end wrap" }, h("a", { class: "button", href: "machines.html" }, t("machines.machines")), user?.user && leave, view, close),
  ]);
}

/** Shows the settings stored in this browser. @param {import("../main.js").App} app */
function settings(app) {
  const { alerts } = app;
  /** @param {string} says @param {string} about @param {() => boolean} isOn @param {(on: boolean) => unknown} set @param {() => string | null} [why] */
  const row = (says, about, isOn, set, why = () => null) => {
    const note = h("p", { class: "muted" });
    const one = button({ "aria-pressed": "false", onclick: async () => {
      await set(!isOn());
      render();
    } }, says);
    const render = () => {
      setAttr(one, "aria-pressed", String(isOn()));
      disableFor(one, why());
      setText(note, why() ?? about);
    };
    render();
    return h("div", { class: "setting" }, one, note);
  };
  return [
    languagePicker(app),
    row(t("user.sound"), t("user.questions_and_alarms_are_heard"), () => alerts.isOn("sound"), (on) => alerts.choose("sound", on)),
    row(t("user.notifications"), t("user.questions_and_alarms_are_shown"), () => alerts.isOn("notification"), (on) => alerts.choose("notification", on), () => alerts.whyNot("notification")),
    row(t("user.large_targets"), t("user.for_fingers_and_gloves_on"), isLarge, chooseLarge),
  ];
}

/** The language of this screen: a choice, or the browser's preference. @param {import("../main.js").App} app */
function languagePicker(app) {
  const chosen = chosenLanguage() ?? "";
  const choices = [["", t("user.language_of_browser")], ...Object.entries(LANGUAGES)];
  const picker = h("select", { class: "input", onchange: () => chooseLanguage(picker.value) || app.toast(t("alerts.this_browser_keeps_no_settings"), "error") }, ...choices.map(([code, name]) => h("option", { value: code, lang: code || null, selected: code === chosen }, name)));
  return h("div", { class: "setting language" }, h("label", { class: "row" }, t("user.language"), picker), h("p", { class: "muted" }, t("user.language_about")));
}

/** @param {import("../main.js").App} app */
async function logOut(app) {
  if (app.model.user?.is_login) await app.attempt(() => app.api.logOut());
  forgetToken();
  location.reload();
}
