// Who is logged in at this screen, and as what; log-out, and the view mode.

import { openDialog } from "./dialog.js";
import { button, h, setAttr, setText } from "./dom.js";
import { icon } from "./icons.js";
import { forgetToken } from "./token.js";
import { chooseLarge, isLarge } from "./touch.js";
import { disableFor } from "./why_not.js";

/** @param {import("./main.js").App} app */
export function userButton(app) {
  const name = h("span", { class: "user-name" });
  const element = button({ class: "user", onclick: () => showUser(app) }, icon("user"), name);
  const render = () => {
    const { user, viewing } = app.model;
    const role = viewing ? "view mode" : (user?.role ?? "");
    setText(name, user?.user ? `${user.user}, ${role}` : viewing ? role : "");
    setAttr(element, "aria-label", user?.user ? `Logged in: ${user.user}, ${role}` : `No login${viewing ? `, ${role}` : ""}`);
  };
  return { element, render };
}

/** @param {import("./main.js").App} app */
function showUser(app) {
  const { user, viewing } = app.model;
  const says = user?.user
    ? `${user.user} is logged in here with the role ${user.role}.`
    : "This machine asks nobody who it is: whoever reaches it may do everything.";
  const view = button({ "aria-pressed": String(viewing), onclick: () => {
    app.model.viewing = !viewing;
    app.invalidate();
    dialog.close();
  } }, viewing ? "Leave view mode" : "View mode");
  const leave = button({ onclick: () => void logOut(app) }, "Log out");
  const close = button({ autofocus: true, onclick: () => dialog.close() }, "Close");
  const dialog = openDialog("user-dialog", "User", [
    h("p", {}, says),
    h("p", { class: "muted" }, "In view mode this screen only looks: nothing but Hold, Stop and Abort can be pressed."),
    h("h3", {}, "This screen"),
    ...settings(app),
    h("div", { class: "row end wrap" }, user?.user && leave, view, close),
  ]);
}

/** What this browser remembers. @param {import("./main.js").App} app */
function settings({ alerts }) {
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
    row("Sound", "Questions and alarms are heard.", () => alerts.isOn("sound"), (on) => alerts.choose("sound", on)),
    row("Notifications", "Questions and alarms are shown by the system, also over other windows.", () => alerts.isOn("notification"), (on) => alerts.choose("notification", on), () => alerts.whyNot("notification")),
    row("Large targets", "For fingers and gloves; on by itself where the screen is touched.", isLarge, chooseLarge),
  ];
}

/** @param {import("./main.js").App} app */
async function logOut(app) {
  if (app.model.user?.is_login) await app.attempt(() => app.api.logOut());
  forgetToken();
  location.reload();
}
