// The views, in the order of their places and of the Tab key.

import { added } from "./added.js";
import { alarms } from "./alarms.js";
import { byHand } from "./by_hand.js";
import { commands } from "./commands.js";
import { connectionBanner } from "./connection_banner.js";
import { far } from "./far.js";
import { feed } from "./feed.js";
import { forced } from "./forced.js";
import { header } from "./header.js";
import { mCodes } from "./m_codes.js";
import { path } from "./path.js";
import { plant } from "./plant.js";
import { positions } from "./positions.js";
import { program } from "./program.js";
import { programs } from "./programs.js";
import { setUp } from "./set_up.js";
import { status } from "./status.js";
import { storedData } from "./stored_data.js";
import { switches } from "./switches.js";

/** @type {import("../main.js").View[]} */
export const views = [
  header,
  connectionBanner,
  status,
  storedData,
  forced,
  mCodes,
  alarms,
  positions,
  feed,
  path,
  program,
  programs,
  byHand,
  setUp,
  plant,
  added,
  far,
  commands,
  switches,
];
