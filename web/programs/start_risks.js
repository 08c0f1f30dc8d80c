// The question before a start whose run would end in an alarm. Start, a start from a line and an order of parts ask it.

import { risksOfStart } from "../machine/start_conditions.js";
import { programName } from "../text/format.js";
import { sentences, t } from "../text/language.js";

/**
 * Returns whether a run of the loaded program may start: nothing speaks against it, or the operator starts it anyway.
 * @param {import("../main.js").App} app @returns {Promise<boolean>}
 */
export async function acceptsRisks(app) {
  const risks = risksOfStart(app.model.current);
  if (risks.length === 0) return true;
  return app.confirm({
    title: t("start.anyway", { program: programName(app.model.current?.state?.program) }),
    text: sentences(...risks),
    yes: t("start.start"),
    no: t("start.do_not"),
  });
}
