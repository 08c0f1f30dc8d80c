// The control lease of this screen: a button takes and releases it, and the page renews it.

import { Refusal } from "../machine/api.js";
import { forgetFence, ownFence } from "../machine/fences.js";
import { sentences, t } from "../text/language.js";
import { button, setAttr, setText } from "../ui/dom.js";
import { disableFor, whyNotNow } from "./why_not.js";

/** Time between two renewals, ms: a third of the duration of a lease. */
const RENEW_MS = 10000;

/** @param {import("../main.js").App} app */
export function leaseButton(app) {
  const element = button({});
  /** Whether a request about the lease is pending. */
  let busy = false;

  /** @param {() => Promise<void>} work */
  const ask = async (work) => {
    busy = true;
    app.invalidate();
    await app.attempt(work);
    busy = false;
    app.invalidate();
  };
  element.addEventListener("click", async () => {
    const cs = app.model.selected;
    const holder = app.model.current?.lease?.holder;
    if (ownFence(cs) !== undefined) return ask(() => app.api.releaseLease(cs));
    if (!holder) return ask(() => app.api.takeLease(cs));
    const sure = await app.confirm({
      title: t("lease.end_the_control_of", { holder }),
      text: t("lease.end_about", { holder, cs }),
      yes: t("lease.end_it"),
      no: t("lease.leave_it"),
    });
    if (sure) await ask(() => app.api.breakLease(cs));
  });

  /** @param {number} cs */
  const renew = async (cs) => {
    try {
      await app.api.takeLease(cs);
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      // without an answer the lease may still be held: the next renewal may succeed
      if (error.problem.status === undefined) return;
      forgetFence(cs);
      app.toast(sentences(t("lease.lost", { cs }), error.message), "error");
      app.invalidate();
    }
  };
  setInterval(() => {
    for (const cs of app.model.systems.keys()) if (ownFence(cs) !== undefined && !busy) void renew(cs);
  }, RENEW_MS);

  const render = () => {
    const cs = app.model.selected;
    const own = ownFence(cs) !== undefined;
    const other = !own && app.model.current?.lease?.holder;
    setText(element, own ? t("lease.give_control_back") : other ? t("lease.end_control_of", { holder: other }) : t("lease.take_control"));
    setAttr(element, "data-own", own);
    const ending = other ? whyNotNow(app.model, "administrate") : whyNotNow(app.model);
    disableFor(element, busy ? t("lease.one_moment") : ending, t("lease.while_control_is_taken_only"));
  };
  return { element, render };
}
