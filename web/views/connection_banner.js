// A banner that reports a lost connection and stale values.

import { seconds } from "../text/format.js";
import { sentences, t } from "../text/language.js";
import { button, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** @type {import("../main.js").View} */
export const connectionBanner = {
  place: "banner",
  create(app) {
    const text = h("p", {});
    const onclick = () => {
      asked = true;
      app.retry();
      app.invalidate();
    };
    const retry = button({ onclick }, t("connection.try_now"));
    const element = h("div", { class: "offline", role: "alert", hidden: true }, icon("unlink"), text, retry);
    let since = Date.now();
    let asked = false;
    const render = () => {
      const { online, retryAt, bootId, staleMs } = app.model;
      if (online) {
        since = Date.now();
        asked = false;
      }
      setAttr(retry, "hidden", online);
      if (staleMs > 0) {
        setAttr(element, "hidden", false);
        setText(text, t("connection.stale", { seconds: seconds(staleMs / 1000, 1) }));
        return;
      }
      // the banner is not shown before the first connection, which takes a moment
      setAttr(element, "hidden", online || Date.now() - since < 400);
      const left = retryAt === null || asked ? 0 : Math.ceil((retryAt - Date.now()) / 1000);
      const next = left > 0 ? t("connection.again_in", { seconds: left }) : t("connection.again_now");
      setText(text, sentences(t("connection.lost"), bootId !== null && t("connection.old"), next));
    };
    return { element, render };
  },
};
