// The question about stored files that do not fit together: the affected parts, and the person's decision.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { listed, t } from "../text/language.js";
import { button, h, setAttr, setText } from "../ui/dom.js";

/** @typedef {import("../types.d.ts").StoredDataFinding} StoredDataFinding */

/** Texts of parts and faults. */
const PARTS = /** @type {const} */ ({ store: "stored_data.part_store", programs: "stored_data.part_programs", folders: "stored_data.part_folders", journal: "stored_data.part_journal" });
const FAULTS = /** @type {const} */ ({ older: "stored_data.older", other_machine: "stored_data.other_machine", not_verified: "stored_data.not_verified" });
/** Texts of each decision: the button, the title and the consequence. */
const DECISIONS = /** @type {const} */ ({
  accept: ["stored_data.accept", "stored_data.accept_title", "stored_data.about_accept"],
  refuse: ["stored_data.refuse", "stored_data.refuse_title", "stored_data.about_refuse"],
});

/** @param {StoredDataFinding} finding */
function inWords({ part, fault }) {
  return t(FAULTS[fault], { part: t(PARTS[part]) });
}

/** @type {import("../main.js").View} */
export const storedData = {
  place: "banner",
  create(app) {
    const text = h("p", { class: "grow" });
    const refuse = button({ class: "button small", onclick: () => void ask("refuse") }, t("stored_data.refuse"));
    const accept = button({ class: "button small", onclick: () => void ask("accept") }, t("stored_data.accept"));
    const element = h("div", { class: "stored-data-note", role: "alert", "data-stored-data": "", hidden: true }, text, refuse, accept);
    const question = () => app.model.storedData?.question ?? null;
    /** @param {"accept" | "refuse"} decision */
    const ask = async (decision) => {
      const open = question();
      if (!open) return;
      const [yes, title, about] = DECISIONS[decision];
      const found = open.findings.map((finding) => finding.text).join("; ");
      const isSure = await app.confirm({ title: t(title), text: `${found}. ${t(about)}`, yes: t(yes), no: t("stored_data.decide_later") });
      if (isSure) await app.attempt(() => app.api.answerStoredData(decision));
    };
    const render = () => {
      const open = question();
      setAttr(element, "hidden", !open);
      if (!open) return;
      const newest = open.newest_journal_entry;
      const when = newest ? t("stored_data.newest", { time: new Date(newest).toLocaleString() }) : t("stored_data.no_entry");
      setText(text, `${t("stored_data.question", { list: listed(open.findings.map(inWords)) })} ${when}`);
      const whyNot = whyNotNow(app.model);
      disableFor(refuse, whyNot, t("stored_data.refuse"));
      disableFor(accept, whyNot, t("stored_data.accept"));
    };
    return { element, render };
  },
};
